"""Skies as maps: the CIE's luminance distributions, the sun's disc and the ground, drawn into texels."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import cie_sky, equirect

__all__ = ["Sun", "draw_sky"]

FloatArray = npt.NDArray[np.float64]

_SUN_SAMPLES = 1 << 16


class Sun(NamedTuple):
    """A disc of even radiance."""

    direction: FloatArray
    """(3,) unit, to its centre, in the frame of the map."""
    radius: float
    """Angular, in radians."""
    irradiance: FloatArray
    """(3,) on a surface that faces it."""


def draw_sky(
    luminance: Callable[[FloatArray], FloatArray],
    zenith: FloatArray,
    ground_albedo: FloatArray,
    height: int,
    sun: Sun | None = None,
) -> FloatArray:
    """Texels (H, 2 H, 3) of a sky, +y up.

    Parameters
    ----------
    luminance : callable
        Directions (m, 3) above the horizon -> luminance (m,), 1 at the zenith.
    zenith : (3,) float64
        Radiance of the zenith.
    ground_albedo : (3,) float64
        Below the horizon radiance is this times the irradiance on level ground, sun included, over pi.
    height : int
        H, even, so that the horizon lies between two rows.
    sun : Sun, optional
    """
    texels = np.zeros((height, 2 * height, 3))
    centres = equirect.texel_centres(height, 0, height // 2)
    relative = luminance(centres.reshape(-1, 3)).reshape(centres.shape[:2])
    texels[: height // 2] = relative[..., None] * zenith
    if sun is not None:
        _add_disc(texels, sun)
    level = equirect.irradiance(texels, np.array([[0.0, 1.0, 0.0]]))[0]
    texels[height // 2 :] += ground_albedo * level / np.pi
    return texels


def _add_disc(texels: FloatArray, sun: Sun) -> None:
    """Add the sun, by the share of each texel in its disc."""
    height = len(texels)
    samples = cie_sky.disc_directions(sun.direction, sun.radius, _SUN_SAMPLES)
    shares = np.zeros((height, 2 * height, 1))
    np.add.at(shares[..., 0], equirect.texel_of(samples, height), 1.0)
    shares /= equirect.solid_angles(height)[:, None, None]
    texels += shares * sun.irradiance / equirect.irradiance(shares, sun.direction[None])[0]
