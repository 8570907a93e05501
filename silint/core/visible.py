"""Phase one for a batch of shade points: sweep them all, cover what the sweep could not settle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from silint.core.bundles import EdgeBundles
from silint.core.contour import N_TALLY
from silint.core.cover import COVER_BLOCK, covered_intervals
from silint.core.face_bundles import FaceBundles
from silint.core.partition import aligned_order
from silint.core.radial import RadialIntervals, line_table, normal_table
from silint.core.radial_sweep import radial_intervals
from silint.core.search import TILE
from silint.core.sweep import CONTRADICTED, visible_intervals
from silint.core.topology import Topology


class Bundles(NamedTuple):
    """The wide hierarchies over a scene."""

    contour: EdgeBundles  # edges with two faces
    boundary: EdgeBundles  # all other edges
    face: FaceBundles


class VisibleIntervals(NamedTuple):
    """Visible intervals on the isolines of n points."""

    offsets: np.ndarray  # (n K + 1,) int64
    intervals: np.ndarray  # (m, 2) float64 loop coordinates
    tally: np.ndarray  # (N_TALLY,) int64: what the search counted
    covered: int  # isolines that were covered because their depth counts contradicted each other


# A unit of difference in normals counts like this part of the points' extent when they are put in tiles.
_TILE_NORMAL = 0.1


def tile_order(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """An order in which every run of TILE points are neighbours in space and alike in normal."""
    extent = max(float(np.ptp(points, axis=0).max()), 1e-30)
    return aligned_order(
        np.concatenate([points / extent, _TILE_NORMAL * normals], axis=1, dtype=np.float32), TILE
    )


def find_radial(
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    normals: np.ndarray,
    isolines: int,
    per_block: int,
    capacity: int,
) -> tuple[RadialIntervals, np.ndarray] | int:
    """Visible intervals on radial isolines.

    Parameters
    ----------
    points, normals : (n, 3) float64
        In scaled units, lifted, in tile order; unit normals.
    per_block : int
        Points that a thread takes at a time, a multiple of TILE.
    capacity : int
        Intervals for which such a block has room.

    Returns
    -------
    RadialIntervals and the tally of the search (N_TALLY,), or the capacity that is needed. The counts of points
    whose depth counts contradict each other are CONTRADICTED.
    """
    n = len(points)
    lines = line_table(isolines)
    horizon = np.ascontiguousarray(normal_table(lines)[:, 1])
    counts, starts = np.empty((n, isolines), np.int32), np.empty(n, np.int64)
    blocks = -(-n // per_block)
    intervals = np.empty((blocks, capacity, 2))
    needed = np.zeros(blocks, np.int64)
    tally = np.zeros((n, N_TALLY), np.int64)
    radial_intervals(
        geometry,
        *bundles,
        points,
        normals,
        lines,
        horizon,
        per_block,
        counts,
        starts,
        intervals,
        needed,
        tally,
    )
    if needed.max(initial=0) > capacity:
        return int(needed.max())
    starts += capacity * (np.arange(n) // per_block)
    return RadialIntervals(normals, counts, starts, intervals.reshape(-1, 2)), tally.sum(axis=0)


def find_visible(
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    normals: np.ndarray,
    isolines: int,
    capacity: int,
) -> VisibleIntervals | int:
    """Sweep, and cover where counts fail.

    Parameters
    ----------
    points, normals : (n, 3) float64
        In scaled units, lifted, in tile order; unit normals.
    capacity : int
        Intervals for which a tile of TILE points has room.

    Returns
    -------
    VisibleIntervals, or the capacity that is needed
    """
    blocks = -(-len(points) // TILE)
    counts = np.zeros((len(points), isolines), np.int32)
    buffer = np.empty((blocks, capacity, 2))
    needed = np.zeros(blocks, np.int64)
    tally = np.zeros((len(points), N_TALLY), np.int64)
    visible_intervals(geometry, *bundles, points, normals, counts, buffer, needed, tally)
    if needed.max() > capacity:
        return int(needed.max())
    swept = _pack(buffer, needed)

    per_line = counts.ravel().astype(np.int64)
    failed = per_line == CONTRADICTED
    if not failed.any():
        return VisibleIntervals(_offsets(per_line), swept, tally.sum(axis=0), 0)
    lines = np.argwhere(counts == CONTRADICTED)
    per_line[failed], covered = cover_lines(geometry, bundles.face, points, normals, lines, isolines)
    offsets = _offsets(per_line)
    merged = np.empty((offsets[-1], 2))
    from_cover = np.repeat(failed, per_line)
    merged[from_cover], merged[~from_cover] = covered, swept
    return VisibleIntervals(offsets, merged, tally.sum(axis=0), len(lines))


def cover_visible(
    geometry: Topology, bundles: Bundles, points: np.ndarray, normals: np.ndarray, isolines: int
) -> VisibleIntervals:
    """The same intervals by covering alone: the second opinion."""
    lines = np.argwhere(np.ones((len(points), isolines), dtype=bool))
    counts, intervals = cover_lines(geometry, bundles.face, points, normals, lines, isolines)
    return VisibleIntervals(_offsets(counts), intervals, np.zeros(N_TALLY, np.int64), len(lines))


def cover_lines(
    geometry: Topology,
    tree: FaceBundles,
    points: np.ndarray,
    normals: np.ndarray,
    lines: np.ndarray,
    isolines: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Counts and intervals of single isolines: rows (point, isoline) of `lines`."""
    counts = np.zeros(len(lines), np.int64)
    needed = np.zeros(-(-len(lines) // COVER_BLOCK), np.int64)
    capacity = 4 * COVER_BLOCK
    while True:
        buffer = np.empty((len(needed), capacity, 2))
        covered_intervals(geometry, tree, points, normals, lines, isolines, counts, buffer, needed)
        if needed.max() <= capacity:
            return counts, _pack(buffer, needed)
        capacity = int(needed.max())


def _pack(buffer: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The rows of all blocks, without the gaps between them."""
    return np.concatenate([rows[:n] for rows, n in zip(buffer, used, strict=True)])


def _offsets(counts: np.ndarray) -> np.ndarray:
    offsets = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=offsets[1:])
    return offsets
