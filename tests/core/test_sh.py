"""Spherical harmonics: orthonormality, against SciPy's, products with the direction, and rotation."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.special
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from silint.core import sh, sh_rotation

DEGREES = (0, 1, 4, 16)

# Double precision: a value at degree 16 reaches 5.2 and comes out of 16 steps of a recurrence.
ROUNDING = 1e-12

# Poles, axes, and where x or y vanishes.
SPECIAL = np.array(
    [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0.6, 0, 0.8), (0, -0.6, 0.8)]
)


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return np.concatenate([v / np.linalg.norm(v, axis=1)[:, None], SPECIAL])


def scipy_harmonics(directions: np.ndarray, max_degree: int) -> np.ndarray:
    """The same from SciPy's complex harmonics, which carry (-1)^m."""
    theta = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
    phi = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in range(max_degree + 1):
        for m in range(-degree, degree + 1):
            if hasattr(scipy.special, "sph_harm_y"):
                y = scipy.special.sph_harm_y(degree, abs(m), theta, phi)
            else:  # before SciPy 1.15
                y = scipy.special.sph_harm(abs(m), degree, phi, theta)
            part = y.imag if m < 0 else y.real
            columns.append(part * (np.sqrt(2.0) * (-1) ** m if m else 1.0))
    return np.stack(columns, axis=1)


def test_orthonormal_by_exact_quadrature() -> None:
    # Gauss-Legendre and trapezoid here, so that the rule is not the one under test.
    z, weight = np.polynomial.legendre.leggauss(20)
    phi = 2 * np.pi * np.arange(36) / 36
    s = np.sqrt(1 - z * z)
    w = np.stack(
        [np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(36))], axis=-1
    ).reshape(-1, 3)
    y = sh.harmonics(w, 16)
    gram = y.T @ (np.repeat(weight * 2 * np.pi / 36, 36)[:, None] * y)
    np.testing.assert_allclose(gram, np.eye(289), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("max_degree", DEGREES)
def test_the_same_as_scipy(max_degree: int) -> None:
    directions = units(100)
    expected = scipy_harmonics(directions, max_degree)
    # SciPy goes through angles and complex exponentials.
    np.testing.assert_allclose(sh.harmonics(directions, max_degree), expected, rtol=0, atol=5e-13)


@pytest.mark.nojit
def test_the_first_degrees_by_hand() -> None:
    x, y, z = 0.48, 0.6, 0.64
    out = np.empty(9)
    sh.evaluate(x, y, z, sh.recurrence(2), out)
    a, b, c = np.sqrt(1 / (4 * np.pi)), np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi))
    expected = [a, b * y, b * z, b * x, c * x * y, c * y * z]
    expected += [np.sqrt(5 / (16 * np.pi)) * (3 * z * z - 1), c * x * z, 0.5 * c * (x * x - y * y)]
    np.testing.assert_allclose(out, expected, rtol=1e-15)


def test_alone_as_in_company() -> None:
    directions = units(30)
    together = sh.harmonics(directions, 9)
    out = np.empty(100)
    for w, row in zip(directions, together, strict=True):
        sh.evaluate(*w, sh.recurrence(9), out)
        assert (out == row).all()


@pytest.mark.parametrize("degree", [0, 1, 2, 9, 34])
def test_the_rule_integrates_its_degree(degree: int) -> None:
    w, weights = sh.sphere_rule(degree)
    assert np.isclose(weights.sum(), 4 * np.pi, rtol=1e-14)
    half = degree // 2
    # int x^a y^b z^c dw for even exponents is 2 prod Gamma((e + 1) / 2) / Gamma(sum (e + 1) / 2).
    for a, b in ((0, 0), (half // 2, half // 2), (half, 0)):
        a, b = 2 * (a // 2), 2 * (b // 2)
        c = degree - a - b
        found = (weights * w[:, 0] ** a * w[:, 1] ** b * w[:, 2] ** c).sum()
        g = [scipy.special.gamma((e + 1) / 2) for e in (a, b, c)]
        expected = 2 * np.prod(g) / scipy.special.gamma((a + b + c + 3) / 2) if c % 2 == 0 else 0.0
        assert np.isclose(found, expected, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("max_degree", [0, 1, 2, 5, 16])
def test_coupling_multiplies_by_the_direction(max_degree: int) -> None:
    terms = sh.coupling(max_degree)
    out = np.empty((max_degree + 1) ** 2)
    for w in units(20, 1):
        y = sh.harmonics(w[None], max_degree + 1)[0]
        for axis in range(3):
            sh.contract(*terms, np.eye(3)[axis], y, out)
            np.testing.assert_allclose(out, w[axis] * y[: len(out)], rtol=0, atol=ROUNDING)
        n = np.array([0.3, -2.0, 0.7])
        sh.contract(*terms, n, y, out)
        np.testing.assert_allclose(out, (w @ n) * y[: len(out)], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_open_hemispheres_by_quadrature(weighting: str) -> None:
    t, weight = np.polynomial.legendre.leggauss(40)
    z = 0.5 * (t + 1)
    found = sh.hemisphere_zonal(16, weighting)
    for degree in range(17):
        p = scipy.special.eval_legendre(degree, z)
        factor = 2 * np.pi * p if weighting == "uniform" else 2 * z * p
        assert np.isclose(found[degree], (0.5 * weight * factor).sum(), rtol=0, atol=ROUNDING)
    w = units(10, 2)
    expected = found[sh.degrees(16)] * sh.harmonics(w, 16)
    assert (sh.open_hemisphere(w, 16, weighting) == expected).all()


# ------------------------------------------------------------------------------------------------ rotation


def rotated(rotation: np.ndarray, max_degree: int, x: np.ndarray) -> np.ndarray:
    out = x.copy()
    sh_rotation.rotate(rotation, max_degree + 1, *sh_rotation.exchange(max_degree), out, np.empty_like(x))
    return out


angles = st.floats(-7, 7)


@given(angles, angles, angles, st.sampled_from((1, 3, 16)))
@example(0.0, 0.0, 0.0, 16)
@example(np.pi, 0.0, 0.0, 16)
@example(0.0, np.pi, 0.0, 16)
@example(np.pi / 2, 0.0, 0.0, 16)
@example(0.0, 0.0, np.pi / 2, 16)
@example(1e-9, -2e-9, 0.3, 16)
@example(0.0, 3e-160, 0.0, 16)
@example(np.pi - 1e-10, 1e-10, 0.0, 16)
def test_rotation_turns_the_function(a: float, b: float, c: float, max_degree: int) -> None:
    """f(R^-1 w), for every small turn and half turn too, where Euler's angles are not determined."""
    r = Rotation.from_rotvec([a, b, c]).as_matrix()
    x = np.random.default_rng(0).normal(size=(max_degree + 1) ** 2)
    w = units(20, 3)
    found = sh.harmonics(w, max_degree) @ rotated(r, max_degree, x)
    # 289 terms of up to 5 times coefficients of 1.
    np.testing.assert_allclose(found, sh.harmonics(w @ r, max_degree) @ x, rtol=0, atol=1e-11)


def test_rotation_is_the_projection_of_the_rotated_function() -> None:
    r = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    w, weights = sh.sphere_rule(32)
    x = np.random.default_rng(1).normal(size=289)
    projected = (sh.harmonics(w @ r, 16) @ x * weights) @ sh.harmonics(w, 16)
    np.testing.assert_allclose(rotated(r, 16, x), projected, rtol=0, atol=1e-10)


def test_rotations_compose_and_keep_lengths() -> None:
    a, b = (Rotation.random(random_state=s).as_matrix() for s in (2, 3))
    x = np.random.default_rng(2).normal(size=289)
    np.testing.assert_allclose(rotated(a, 16, rotated(b, 16, x)), rotated(a @ b, 16, x), rtol=0, atol=1e-12)
    back = rotated(a.T, 16, rotated(a, 16, x))
    np.testing.assert_allclose(back, x, rtol=0, atol=1e-12)
    blocks = sh_rotation.rotation_blocks(a, 16)
    for degree, block in enumerate(blocks):
        assert block.shape == (2 * degree + 1, 2 * degree + 1)
        np.testing.assert_allclose(block @ block.T, np.eye(len(block)), rtol=0, atol=1e-13)
        part = slice(degree**2, (degree + 1) ** 2)
        np.testing.assert_allclose(block @ x[part], rotated(a, 16, x)[part], rtol=0, atol=1e-12)
    # Degree 1 is the matrix itself, in the order y, z, x.
    order = [1, 2, 0]
    np.testing.assert_allclose(blocks[1], a[np.ix_(order, order)], rtol=0, atol=1e-14)


@pytest.mark.parametrize("max_degree", [0, 4, 17])
def test_exchange_is_its_own_inverse_and_sparse(max_degree: int) -> None:
    offsets, columns, weights = sh_rotation.exchange(max_degree)
    n = (max_degree + 1) ** 2
    dense = np.zeros((n, n))
    for row in range(n):
        part = slice(offsets[row], offsets[row + 1])
        dense[row, columns[part]] = weights[part]
    np.testing.assert_allclose(dense @ dense, np.eye(n), rtol=0, atol=1e-13)
    np.testing.assert_allclose(dense, dense.T, rtol=0, atol=1e-13)
    assert len(weights) <= 0.3 * sum((2 * d + 1) ** 2 for d in range(max_degree + 1)) + 3
