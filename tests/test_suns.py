"""Small bright sources taken out of maps."""

from __future__ import annotations

import numpy as np
import pytest

from silint import Environment
from silint.core import equirect
from silint.suns import split_map

SUN = np.array([0.48, 0.6, 0.64])
OTHER = np.array([-0.8, 0.6, 0.0])


def light_of(radiance: np.ndarray) -> np.ndarray:
    solid = equirect.solid_angles(len(radiance))
    total: np.ndarray = (radiance.sum(axis=1) * solid[:, None]).sum(axis=0)
    return total


def disc(centre: np.ndarray, degrees: float, radiance: float, height: int = 256) -> np.ndarray:
    """A uniform disc on a grey sky."""
    w = equirect.texel_centres(height, 0, height)
    inside = w @ centre > np.cos(np.deg2rad(degrees))
    return np.where(inside[..., None], radiance, np.array([1.0, 0.8, 0.5]))


def test_discs_and_rest_hold_the_light_of_the_map() -> None:
    radiance = disc(SUN, 1.0, 1e4) + disc(OTHER, 0.8, 3e3)
    split = split_map(radiance)
    assert len(split.sources.radius) >= 2
    np.testing.assert_allclose(
        split.sources.flux.sum(axis=0) + light_of(split.rest), light_of(radiance), rtol=1e-12
    )
    assert split.rest.max() < 10.0


def test_a_disc_is_found_where_it_is_and_as_large_as_it_is() -> None:
    """To a fraction of a texel, 0.7 degrees."""
    sources = split_map(disc(SUN, 2.0, 1e5)).sources
    assert sources.directions[0] @ SUN > np.cos(np.deg2rad(0.1))
    assert abs(np.rad2deg(sources.radius[0]) - 2.0) < 0.2


def test_the_brightest_comes_first() -> None:
    sources = split_map(disc(SUN, 1.0, 1e4) + disc(OTHER, 1.0, 3e4)).sources
    assert sources.directions[0] @ OTHER > 0.999
    assert (sources.directions @ SUN > 0.999).any()


def test_a_smooth_sky_has_none() -> None:
    radiance = Environment.cie_clear_sky(SUN, height=64).texel_radiance
    split = split_map(radiance)
    assert len(split.sources.radius) == 0 and split.sources.directions.shape == (0, 3)
    np.testing.assert_array_equal(split.rest, radiance)


@pytest.mark.parametrize("centre", [(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
def test_at_poles_and_across_the_seam(centre: tuple[float, float, float]) -> None:
    radiance = disc(np.array(centre), 1.5, 1e5)
    split = split_map(radiance)
    assert split.sources.directions[0] @ centre > np.cos(np.deg2rad(0.2))
    assert split.rest.max() < 10.0
