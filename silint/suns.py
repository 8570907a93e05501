"""Small bright sources in a map: what no sampling of its cells would do justice to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import equirect
from silint.core.integrands.radial_light import Sources

__all__ = ["Split", "split_map"]

FloatArray = npt.NDArray[np.float64]

# A source has more than the light of one of this many equal parts, the cells of 64 lines on both hemispheres:
# none should hold much more than its share. So has each of its texels, ...
_CELLS = 4096
# ... whose radiance is so many times the mean of the map (a clear sky is 10 times as bright near the sun).
_CONTRAST = 50.0
# They lie within this (radians), or so many texels, of its centre, ...
_REACH, _REACH_TEXELS = np.deg2rad(2.5), 2.5
_CENTRINGS = 3
# ... and its glow is taken in discs of so many times its radius, beyond which the last begins to be sky.
_DISCS = (1.0, 2.0, 4.0, 8.0)
_MOST_SOURCES = 8


class Split(NamedTuple):
    """A map as discs and the rest; together they hold the light of the map."""

    sources: Sources
    """Discs in the frame of the map; those of one source follow each other, the brightest first."""
    rest: FloatArray
    """(H, 2 H, C)."""


def split_map(radiance: npt.NDArray[np.floating]) -> Split:
    """Take small bright sources out of a map, as discs.

    Parameters
    ----------
    radiance : (H, 2 H, C) float

    Returns
    -------
    Split

    Notes
    -----
    A source is what stands together of texels much brighter than the map, each of which holds more than
    1/4096 of all light. Its disc
    has the same flux, centre and mean squared radius, beyond the mean of the ring around it; what that ring
    and the next are brighter than those around them, its glow, becomes discs of uniform radiance as well.
    """
    height = len(radiance)
    rest = radiance.astype(np.float64)
    solid = equirect.solid_angles(height)
    light = rest.sum(axis=2) * solid[:, None]
    least = light.sum() / _CELLS
    floor = _CONTRAST * light.sum() / (4.0 * np.pi)
    light[rest.sum(axis=2) < floor] = 0.0
    texel = np.pi / height
    reach = max(_REACH, _REACH_TEXELS * texel)
    found: list[tuple[FloatArray, float, FloatArray]] = []
    for _ in range(_MOST_SOURCES):
        if light.max() <= least:
            break
        row, column = np.unravel_index(light.argmax(), light.shape)
        centre = equirect.texel_centres(height, int(row), int(row) + 1)[0, column]
        for _ in range(_CENTRINGS):
            near = _Surroundings(centre, reach, height)
            weights = np.where(light[near.at] > least, light[near.at], 0.0)
            centre = (near.directions * weights[:, None]).sum(axis=0)
            centre /= np.linalg.norm(centre)
        away = float(_angles(near.directions[weights > 0.0], centre).max())
        found += _take_discs(rest, centre, away + texel, least, solid)
        # Whatever stays behind, it is no source.
        light[near.at] = np.minimum(light[near.at], least)
        light[row, column] = 0.0
    arrays = (
        np.array([d for d, _, _ in found]).reshape(-1, 3),
        np.array([r for _, r, _ in found], dtype=np.float64),
        np.array([np.broadcast_to(f, 3) for _, _, f in found], dtype=np.float64).reshape(-1, 3),
    )
    for array in arrays:
        array.setflags(write=False)
    return Split(Sources(*arrays), rest)


class _Surroundings:
    """Texels about a direction."""

    def __init__(self, centre: FloatArray, radius: float, height: int) -> None:
        theta = np.arccos(np.clip(centre[1], -1.0, 1.0))
        first = max(int((theta - radius) / np.pi * height) - 1, 0)
        last = min(int((theta + radius) / np.pi * height) + 2, height)
        rows = equirect.texel_centres(height, first, last)
        row, column = np.nonzero(_angles(rows, centre) < radius)
        self.at = row + first, column
        self.directions = rows[row, column]


def _take_discs(
    rest: FloatArray, centre: FloatArray, radius: float, least: float, solid: FloatArray
) -> list[tuple[FloatArray, float, FloatArray]]:
    """Take a source and its glow from the map: directions, radii and fluxes of discs."""
    edges = radius * np.array([0.0, *_DISCS])
    near = _Surroundings(centre, edges[-1], len(rest))
    angle, area = _angles(near.directions, centre), solid[near.at[0]]
    radiance = rest[near.at]
    rings = [(edges[i] <= angle) & (angle < edges[i + 1]) for i in range(len(_DISCS))]
    means = [(radiance[r] * area[r, None]).sum(axis=0) / area[r].sum() for r in rings]
    # The source itself: all that is above the level of the ring around it.
    core = rings[0]
    excess = (radiance[core] - means[1]) * area[core, None]
    total = excess.sum()
    if total <= least:
        return []  # part of something larger
    squared = (excess.sum(axis=1) * angle[core] ** 2).sum() / total
    discs = [(centre, float(np.sqrt(max(2.0 * squared, (0.5 * np.pi / len(rest)) ** 2))), excess.sum(axis=0))]
    radiance[core] = means[1]
    for i in range(1, len(_DISCS) - 1):
        step = np.maximum(means[i] - means[i + 1], 0.0)
        inside = angle < edges[i + 1]
        if step.any():
            radiance[inside] -= step
            discs.append((centre, float(edges[i + 1]), step * area[inside].sum()))
    rest[near.at] = radiance
    return discs


def _angles(directions: FloatArray, centre: FloatArray) -> FloatArray:
    angles: FloatArray = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(directions - centre, axis=-1), 1.0))
    return angles
