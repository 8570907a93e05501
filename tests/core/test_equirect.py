"""Equirectangular maps: solid angles and moments of texels against quadrature, and irradiance."""

from __future__ import annotations

import numpy as np
import pytest

from silint.core import equirect

# Closed forms of a few operations each, and Gauss points enough for texels of 90 degrees.
ROUNDING = 1e-13


def gauss_texel(theta: float, phi: float, h: float) -> np.ndarray:
    """Integrals of 1, x, y, z over a texel of h by h radians about (theta, phi): (4,)."""
    nodes, weights = np.polynomial.legendre.leggauss(16)
    t, p = theta + 0.5 * h * nodes[:, None], phi + 0.5 * h * nodes
    one = np.ones((16, 16))
    values = np.array([one, np.sin(t) * np.cos(p), np.cos(t) * one, np.sin(t) * np.sin(p)])
    return (0.5 * h) ** 2 * np.einsum("i,j,kij->k", weights, weights, values * np.sin(t))


@pytest.mark.nojit
@pytest.mark.parametrize("height", [1, 2, 3, 8, 257])
def test_solid_angles_sum_to_the_sphere(height: int) -> None:
    assert 2 * height * equirect.solid_angles(height).sum() == pytest.approx(4 * np.pi, rel=ROUNDING)


@pytest.mark.nojit
@pytest.mark.parametrize(("height", "row"), [(2, 0), (4, 1), (8, 0), (8, 7), (64, 20)])
def test_moments_of_a_texel(height: int, row: int) -> None:
    h = np.pi / height
    theta, phi = h * (row + 0.5), 0.7
    a, b = equirect.row_moments(theta, h)
    chord = 2 * np.sin(h / 2)
    exact = gauss_texel(theta, phi, h)
    found = [equirect.solid_angles(height)[row], a * chord * np.cos(phi), b * h, a * chord * np.sin(phi)]
    np.testing.assert_allclose(found, exact, rtol=0, atol=ROUNDING)


@pytest.mark.nojit
@pytest.mark.parametrize("height", [1, 4, 11])
def test_centres_lie_in_their_texels(height: int) -> None:
    centres = equirect.texel_centres(height, 0, height)
    row, column = equirect.texel_of(7.0 * centres.reshape(-1, 3), height)
    np.testing.assert_array_equal(row, np.repeat(np.arange(height), 2 * height))
    np.testing.assert_array_equal(column, np.tile(np.arange(2 * height), height))
    np.testing.assert_array_equal(equirect.texel_centres(height, height - 1, height), centres[-1:])


@pytest.mark.nojit
def test_the_ends_of_the_map_are_inside() -> None:
    """Poles and the seam, where the column or row would be one too many."""
    w = np.array([[0.0, 1, 0], [0, -1, 0], [-1, 0, 0.0], [-1, 0, -0.0], [-1, 0, 1e-30], [-1, 0, -1e-30]])
    row, column = equirect.texel_of(w, 4)
    np.testing.assert_array_equal(row, [0, 3, 2, 2, 2, 2])
    np.testing.assert_array_equal(column[2:], [0, 0, 0, 0])


@pytest.mark.parametrize("height", [2, 5, 16])
def test_irradiance_of_random_maps(height: int) -> None:
    rng = np.random.default_rng(height)
    radiance = rng.random((height, 2 * height, 2))
    n = rng.normal(size=(5, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    # Midpoints of 48 x 48 parts of each texel. Where max(n.w, 0) has its kink, its mean over a part of side d
    # exceeds that of the mean by d^2 / 24 on average: 2 pi times that along the horizon, with d =
    # pi / (48 H), times the mean radiance of 1/2, is 6e-4 / H^2.
    parts = 48
    w = equirect.texel_centres(parts * height, 0, parts * height).reshape(-1, 3)
    fine = np.repeat(np.repeat(radiance, parts, axis=0), parts, axis=1).reshape(-1, 2)
    omega = np.repeat(equirect.solid_angles(parts * height), 2 * parts * height)
    expected = np.array([(fine * (omega * np.maximum(w @ k, 0.0))[:, None]).sum(axis=0) for k in n])
    np.testing.assert_allclose(equirect.irradiance(radiance, n), expected, rtol=0, atol=7e-4 / height**2)


@pytest.mark.parametrize("height", [1, 2, 5, 64])
def test_an_even_map_is_pi_from_everywhere(height: int) -> None:
    n = np.random.default_rng(height).normal(size=(50, 3))
    n[:4] = [(1, 0, 0), (0, 1, 0), (0, 0, -1), (1, 1, 0)]
    n /= np.linalg.norm(n, axis=1)[:, None]
    found = equirect.irradiance(np.ones((height, 2 * height, 1)), n)
    np.testing.assert_allclose(found, np.pi, rtol=1e-12, atol=0)


@pytest.mark.parametrize("row", [0, 3, 11, 31])
def test_a_bright_texel_on_the_horizon(row: int) -> None:
    """A sun of one texel, 1e6 times the sky, cut at random: its parts along theta in closed form, along phi
    with 4000 midpoints, whose kinks leave 1e-7 of the texel."""
    height, column = 32, 41
    rng = np.random.default_rng(row)
    h = np.pi / height
    sky = np.ones((height, 2 * height, 1))
    sun = sky.copy()
    sun[row, column] = 1e6
    phi = h * (column - height + (np.arange(4000) + 0.5) / 4000)
    for _ in range(20):
        theta, azimuth = h * (row + rng.random()), h * (column - height + rng.random())
        w = [np.sin(theta) * np.cos(azimuth), np.cos(theta), np.sin(theta) * np.sin(azimuth)]
        n = np.cross(w, rng.normal(size=3))
        n /= np.linalg.norm(n)
        across = n[0] * np.cos(phi) + n[2] * np.sin(phi)
        zero = np.clip(np.arctan2(n[1], -across) % np.pi, h * row, h * (row + 1))
        expected = 0.0
        for a, b in ((h * row, zero), (zero, h * (row + 1))):
            lit = across * np.sin(0.5 * (a + b)) + n[1] * np.cos(0.5 * (a + b)) > 0
            part = across * (0.5 * (b - a) - 0.5 * np.cos(a + b) * np.sin(b - a))
            part += n[1] * 0.5 * np.sin(a + b) * np.sin(b - a)
            expected += (part * lit).sum() * h / 4000
        found = (equirect.irradiance(sun, n[None]) - equirect.irradiance(sky, n[None]))[0, 0] / (1e6 - 1)
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * h * equirect.solid_angles(height)[row])


def test_irradiance_does_not_depend_on_company_or_bands() -> None:
    rng = np.random.default_rng(1)
    radiance = rng.random((16, 32, 3)).astype(np.float32)
    n = rng.normal(size=(1100, 3))  # more than are taken at once
    n /= np.linalg.norm(n, axis=1)[:, None]
    together = equirect.irradiance(radiance, n)
    np.testing.assert_array_equal(together[::-1], equirect.irradiance(radiance, n[::-1].copy()))
    np.testing.assert_array_equal(together[7:8], equirect.irradiance(radiance, n[7:8]))
    assert sum(len(band) for _, band in equirect.bands(radiance, texels=100)) == 16
    assert [first for first, _ in equirect.bands(radiance, texels=100)] == [0, 3, 6, 9, 12, 15]
