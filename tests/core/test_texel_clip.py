"""Texels cut by a horizon against quadrature, and where rounding could open the loop."""

from __future__ import annotations

import math
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad

from silint.core.texel_clip import lit_part

pytestmark = pytest.mark.nojit

# The terms of the closed form are as long as the sides of a texel, in radians, and cancel.
ROUNDING = 5e-15


def unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


def by_quadrature(theta0: float, theta1: float, phi0: float, phi1: float, n: np.ndarray) -> float:
    """Columns of a texel by their closed form, summed by an adaptive rule that knows of their kinks."""

    def column(phi: float) -> float:
        across = n[0] * math.cos(phi) + n[2] * math.sin(phi)
        # The height is a cosine about its highest theta; its zero within [0, pi], and on which side is up.
        zero = (math.atan2(across, n[1]) + math.pi / 2) % math.pi
        total = 0.0
        for a, b in ((theta0, min(max(zero, theta0), theta1)), (min(max(zero, theta0), theta1), theta1)):
            middle = 0.5 * (a + b)
            if b > a and across * math.sin(middle) + n[1] * math.cos(middle) > 0:
                total += across * 0.5 * ((b - a) - math.cos(a + b) * math.sin(b - a))
                total += n[1] * 0.5 * math.sin(a + b) * math.sin(b - a)
        return total

    kinks = []
    rho, centre = math.hypot(n[0], n[2]), math.atan2(n[2], n[0])
    for theta, turn, sign in product((theta0, theta1, math.pi / 2), (-1, 0, 1), (-1, 1)):
        level = -n[1] * math.cos(theta) / max(rho * math.sin(theta), 1e-300)
        if abs(level) <= 1:
            kinks.append(centre + 2 * math.pi * turn + sign * math.acos(level))
    edges = sorted({phi0, phi1, *(k for k in kinks if phi0 < k < phi1)})
    return sum(quad(column, a, b, epsabs=1e-15, epsrel=1e-13, limit=200)[0] for a, b in pairwise(edges))


def texel(height: int, row: int, column: int) -> tuple[float, float, float, float]:
    h = np.pi / height
    return row * h, (row + 1) * h, (column - height) * h, (column + 1 - height) * h


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 3, 7, 64, 512]))
@example(0, 1)
def test_any_normal_against_quadrature(seed: int, height: int) -> None:
    """The normal is such that the horizon passes through the texel."""
    rng = np.random.default_rng(seed)
    row, column = rng.integers(height), rng.integers(2 * height)
    rectangle = texel(height, row, column)
    theta, phi = rng.uniform(*rectangle[:2]), rng.uniform(*rectangle[2:])
    w = np.array([math.sin(theta) * math.cos(phi), math.cos(theta), math.sin(theta) * math.sin(phi)])
    n = unit(*np.cross(w, rng.normal(size=3)))
    found = lit_part(*rectangle, *n)
    assert found == pytest.approx(by_quadrature(*rectangle, n), rel=1e-9, abs=ROUNDING)


AXES = [
    np.array(v) for v in ([1.0, 0, 0], [-1.0, 0, 0], [0.0, 1, 0], [0.0, -1, 0], [0.0, 0, 1], [0.0, 0, -1])
]


@pytest.mark.parametrize("height", [1, 2, 4, 6])
@pytest.mark.parametrize("n", [*AXES, unit(1, 1, 0), unit(1, 1, 1), unit(1, 0, -1), unit(1e-9, 1, 0)])
def test_horizons_along_sides_and_through_corners(height: int, n: np.ndarray) -> None:
    """Where a corner or a whole side lies on the horizon but for rounding."""
    total = 0.0
    for row, column in product(range(height), range(2 * height)):
        rectangle = texel(height, row, column)
        found = lit_part(*rectangle, *n)
        assert found == pytest.approx(by_quadrature(*rectangle, n), rel=1e-9, abs=ROUNDING)
        total += found
    assert total == pytest.approx(math.pi, rel=1e-13)


@pytest.mark.parametrize("height", [1, 2, 16, 512])
def test_corners_on_the_horizon(height: int) -> None:
    """Normals at right angles to corners: rounding says of each side whether it reaches the horizon."""
    rng = np.random.default_rng(height)
    for _ in range(200 if height < 512 else 50):
        row, column = rng.integers(height), rng.integers(2 * height)
        rectangle = texel(height, row, column)
        theta, phi = rectangle[rng.integers(2)], rectangle[2 + rng.integers(2)]
        w = np.array([math.sin(theta) * math.cos(phi), math.cos(theta), math.sin(theta) * math.sin(phi)])
        n = unit(*np.cross(w, rng.normal(size=3)))
        above, below = lit_part(*rectangle, *n), lit_part(*rectangle, *-n)
        h = np.pi / height
        moment = [0.5 * h - 0.5 * math.cos(2 * h * (row + 0.5)) * math.sin(h)]
        moment.append(0.5 * math.sin(2 * h * (row + 0.5)) * math.sin(h) * h)
        middle = h * (column + 0.5 - height)
        along = n[0] * math.cos(middle) + n[2] * math.sin(middle)
        whole = moment[0] * 2 * math.sin(0.5 * h) * along + moment[1] * n[1]
        assert above >= -ROUNDING and below >= -ROUNDING
        assert above - below == pytest.approx(whole, rel=1e-9, abs=ROUNDING)


def test_texels_on_one_side() -> None:
    rectangle = texel(8, 2, 11)
    middle = unit(math.cos(math.pi * 3.5 / 8), 0, math.sin(math.pi * 3.5 / 8))
    assert lit_part(*rectangle, *-middle) == pytest.approx(0.0, abs=ROUNDING)
    whole = by_quadrature(*rectangle, middle)
    assert lit_part(*rectangle, *middle) == pytest.approx(whole, rel=1e-12)
