"""The pyramid behind light along radial isolines: no light is lost, and every size shows the same sky."""

from __future__ import annotations

import numpy as np
import pytest

from silint.core import equirect, sky_map


def smooth(w: np.ndarray) -> np.ndarray:
    x, y, z = w.T
    return np.stack([1.5 + x * y, 1 + 0.5 * z, 2 - z * z + 0.3 * x], axis=1)


def smooth_map(height: int) -> np.ndarray:
    centres = equirect.texel_centres(height, 0, height)
    return smooth(centres.reshape(-1, 3)).reshape(height, 2 * height, 3)


@pytest.mark.parametrize("height", [1, 5, 64, 129])
def test_every_level_holds_all_light(height: int) -> None:
    radiance = np.random.default_rng(0).random((height, 2 * height, 3)) ** 8
    want = (radiance.sum(axis=1) * equirect.solid_angles(height)[:, None]).sum(axis=0)
    for level in sky_map.build_pyramid(radiance):
        np.testing.assert_allclose(level[..., :3].sum(axis=(0, 1)), want, rtol=1e-12)
        np.testing.assert_allclose(level[..., 3].sum(), 4 * np.pi, rtol=1e-12)
        assert (level[..., 3] > 0).all()


def test_texels_hold_the_directions_of_their_centres() -> None:
    n = 16
    w = sky_map.directions_of((np.arange(n) + 0.5) * (2.0 / n) - 1.0)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, rtol=1e-14)
    assert [sky_map.texel_of(*row, n) for row in 3.0 * w] == list(range(n * n))
    assert sky_map.texel_of(0.0, 1.0, 0.0, n) == n * n // 2 + n // 2
    assert w[0, 1] < -0.8 < 0.8 < w[n * n // 2 + n // 2, 1]


def test_a_spread_level_is_the_sky_between_its_centres() -> None:
    """Linear over a texel of 2 / 32 and nearest over half of one: a few hundredths, halved in turn.

    Over the seams, too: all directions are looked at.
    """
    levels = sky_map.build_pyramid(smooth_map(128))
    rng = np.random.default_rng(1)
    w = rng.normal(size=(4000, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    worst = []
    for n in (16, 32, 64):
        spread = sky_map.spread_level(next(a for a in levels if len(a) == n))
        at = [sky_map.texel_of(*row, 2 * n) for row in w]
        worst.append(np.abs(spread[at, :3] - smooth(w)).max())
    assert worst[1] < 0.1
    assert worst[1] < 0.65 * worst[0] and worst[2] < 0.65 * worst[1]


def test_padding_continues_over_edges_and_corners() -> None:
    """Beyond an edge the map goes on: neighbours in the padded square are neighbours on the sphere."""
    n = 32
    w = sky_map.directions_of((np.arange(n) + 0.5) * (2.0 / n) - 1.0).reshape(n, n, 3)
    padded = sky_map.pad_square(w)
    nearest = np.linalg.norm(np.diff(w, axis=0), axis=2).max()
    assert np.linalg.norm(np.diff(padded, axis=0), axis=2).max() <= nearest + 1e-12
    assert np.linalg.norm(np.diff(padded, axis=1), axis=2).max() <= nearest + 1e-12


def test_open_irradiance_at_its_nodes() -> None:
    """Against the map's own sum over texels; both see the smooth sky in texels of a degree or so: 2e-4."""
    radiance = smooth_map(128)
    table = sky_map.open_irradiance(sky_map.build_pyramid(radiance))
    g = sky_map.OPEN_NORMALS
    normals = sky_map.directions_of(np.arange(g + 1) * (2.0 / g) - 1.0)
    rows = np.random.default_rng(2).choice(len(normals), 300, replace=False)
    want = equirect.irradiance(radiance, normals[rows])
    np.testing.assert_allclose(table.reshape(-1, 3)[rows], want, rtol=5e-4)
