"""Phase one for a batch of shade points: sweep them all, cover what the sweep could not settle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from silint.core.arcs import boundary_arcs
from silint.core.arcs_types import Arcs
from silint.core.bundles import EdgeBundles
from silint.core.caps import (
    LINES_OF_FALLOFF,
    NO_FALLOFF,
    NO_GROUND,
    UNLIMITED,
    LineLimits,
    clip_lines,
    reach_table,
)
from silint.core.contour import N_TALLY
from silint.core.cover import COVER_BLOCK, covered_intervals
from silint.core.face_bundles import FaceBundles, with_corners
from silint.core.jit import each_block
from silint.core.partition import aligned_order
from silint.core.radial import NO_AIM, RadialIntervals, line_table, normal_table, set_frames
from silint.core.radial_cover import covered_radial_intervals
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


# What both ways cost a point, in ns per count of the tally: nodes, edges or faces, contours, crossings,
# snapped sides, and what a distance takes: faces on its sphere, or faces that reach out of it.
# Fitted to twelve scenes of 6k to 2.5M triangles, to 30 % (the sphere's to a factor of two, on three scenes);
# only ratios matter.
_SWEEP_COST = np.array([0.0, 6.0, 40.0, 52.0, 0.0, 750.0])
_COVER_COST = np.array([59.0, 27.0, 0.0, 30.0, 0.0, 120.0])
# Lines with distances of their own take longer over what they sweep: counts alone tell 0.5 to 1.3 times what
# a falloff costs, and of covering 1.3 times (five scenes at 2 to 50 % of their diagonals).
_FALLOFF_SWEEP = 1.6
# What covering costs at least: the front layer of a simple scene.
_LEAST_COVER = 25e3
# The faces that are probed: some runs of neighbours, as far apart as so many points on the scene would be,
# seen from just above.
_PROBES, _PROBE_LINES, _PROBE_LIFT = 8, 64, 2.0**-20
_PROBE_POINTS = 1 << 17

# A unit of difference in normals counts like this part of the points' extent when they are put in tiles.
_TILE_NORMAL = 0.1


def tile_order(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """An order in which every run of TILE points are neighbours in space and alike in normal."""
    extent = max(float(np.ptp(points, axis=0).max()), 1e-30)
    return aligned_order(
        np.concatenate([points / extent, _TILE_NORMAL * normals], axis=1, dtype=np.float32), TILE
    )


class FoundRadial(NamedTuple):
    """Visible intervals on the radial isolines of n points, and how they were found."""

    visible: RadialIntervals
    tally: np.ndarray  # (N_TALLY,) int64: what the search counted
    contradicted: int  # points that were covered because their depth counts contradicted each other


def find_radial(
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    normals: np.ndarray,
    isolines: int,
    per_block: int,
    capacity: int,
    cover: bool,
    aim: np.ndarray = NO_AIM,
    limits: LineLimits = UNLIMITED,
) -> FoundRadial | int:
    """Visible intervals on radial isolines: sweep, and cover where counts fail; or cover all.

    Parameters
    ----------
    bundles : Bundles
        With corners, if `cover` or where distance is limited.
    points, normals : (n, 3) float64
        In scaled units, lifted, in tile order; unit normals.
    per_block : int
        Points that a thread takes at a time, a multiple of TILE.
    capacity : int
        Intervals for which such a block has room.
    aim : (3,) float64
        Direction that a line of each point passes through; see `radial.set_frames`. Integrands have to be
        told, unless they do not look at frames.
    limits : LineLimits
        Faces that only block from their front have to be covered.

    Returns
    -------
    FoundRadial, or the capacity that is needed
    """
    n = len(points)
    lines = line_table(isolines)
    # The sweep looks at all of the hemisphere; covering goes no lower than lines count.
    horizon = np.ascontiguousarray(normal_table(lines, limits.cone if cover else 0.0)[:, 1])
    reach = reach_table(limits, isolines) if limits.reach < np.inf else None
    frames = np.empty((n, 3, 3))
    set_frames(normals, aim, isolines, frames)
    counts, starts = np.empty((n, isolines), np.int32), np.empty(n, np.int64)
    blocks = -(-n // per_block)
    intervals, needed = np.empty((blocks, capacity, 2)), np.zeros(blocks, np.int64)
    tally = np.zeros((n, N_TALLY), np.int64)
    given = points, normals, frames, lines, horizon
    blocked = per_block, counts, starts, intervals, needed, tally
    if cover:
        one_sided = limits.one_sided
        each_block(
            covered_radial_intervals, blocks, geometry, bundles.face, *given, reach, one_sided, *blocked
        )
    else:
        each_block(radial_intervals, blocks, geometry, *bundles, *given, reach, *blocked)
    if needed.max(initial=0) > capacity:
        return int(needed.max())
    starts += capacity * (np.arange(n) // per_block)
    found = RadialIntervals(normals, counts, starts, intervals.reshape(-1, 2))
    failed = np.flatnonzero(counts[:, 0] == CONTRADICTED)
    if len(failed):
        found = _repaired(found, failed, geometry, bundles, points, per_block, aim, limits)
    if limits.cone > 0.0 or limits.ground.any():
        found = _clipped(found, points, frames, lines, limits)
    return FoundRadial(found, tally.sum(axis=0), len(failed))


def _repaired(
    found: RadialIntervals,
    failed: np.ndarray,
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    per_block: int,
    aim: np.ndarray,
    limits: LineLimits,
) -> RadialIntervals:
    """What the sweep found, with some points covered instead."""
    normals, counts, starts = found.normals, found.counts, found.starts
    isolines = counts.shape[1]
    whole = bundles if len(bundles.face.corners) else _with_corners(bundles, geometry)
    repaired: FoundRadial | int = 4 * per_block * isolines
    while isinstance(repaired, int):
        repaired = find_radial(
            geometry,
            whole,
            points[failed],
            normals[failed],
            isolines,
            per_block,
            repaired,
            True,
            aim,
            limits._replace(cone=0.0, ground=NO_GROUND),  # by which all are clipped together
        )
    more = repaired.visible
    counts[failed] = more.counts
    starts[failed] = len(found.intervals) + more.starts
    return found._replace(intervals=np.concatenate([found.intervals, more.intervals]))


def _clipped(
    found: RadialIntervals, points: np.ndarray, frames: np.ndarray, lines: np.ndarray, limits: LineLimits
) -> RadialIntervals:
    """What the ground and the cone leave."""
    counts = found.counts.copy()
    room = counts.sum(axis=1) + len(lines)
    starts = np.cumsum(room) - room
    intervals = np.empty((int(room.sum()), 2))
    clip_lines(
        points,
        frames,
        lines,
        np.ascontiguousarray(normal_table(lines, limits.cone)[:, 1]),
        reach_table(limits, len(lines), of_ground=True),
        limits.ground,
        counts,
        found.starts,
        found.intervals,
        starts,
        intervals,
    )
    return RadialIntervals(found.normals, counts, starts, intervals, limits.cone)


def _with_corners(bundles: Bundles, geometry: Topology) -> Bundles:
    return bundles._replace(face=with_corners(bundles.face, geometry))


class FoundArcs(NamedTuple):
    """Boundary arcs of what points see, and how they were found."""

    arcs: Arcs
    tally: np.ndarray  # (N_TALLY,) int64: what the search counted
    frames: np.ndarray  # (n,) int8: the frame that gave them, 1 or 2; 0 where both contradicted themselves


class ArcRoom(NamedTuple):
    """Room for the arcs of some blocks of points; it may be used again once they have been read."""

    directions: np.ndarray  # (blocks, capacity, 9) float64
    edges: np.ndarray  # (blocks, capacity, 2) int32


def arc_room(blocks: int, capacity: int, limited: bool = False) -> ArcRoom:
    """Room for so many arcs a block; `limited` to some distance, they may be of small circles."""
    width = 10 if limited else 9
    return ArcRoom(np.empty((blocks, capacity, width)), np.empty((blocks, capacity, 2), np.int32))


def find_arcs(
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    normals: np.ndarray,
    per_block: int,
    room: ArcRoom,
    reach: float | None = None,
) -> FoundArcs | int:
    """Boundary arcs of what points see.

    Parameters
    ----------
    points, normals : (n, 3) float64
        In scaled units, lifted, in tile order; unit normals.
    per_block : int
        Points that a thread takes at a time, a multiple of TILE.
    room : ArcRoom
        For all blocks; what is found stands in it.
    reach : float, optional
        Nothing blocks from this distance on. Faces need their corners for it.

    Returns
    -------
    FoundArcs, or the arcs a block that there has to be room for
    """
    n = len(points)
    blocks, capacity = -(-n // per_block), room.directions.shape[1]
    counts, starts, frames = np.zeros(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int8)
    needed, tally = np.zeros(blocks, np.int64), np.zeros((n, N_TALLY), np.int64)
    each_block(
        boundary_arcs,
        blocks,
        geometry,
        *bundles,
        points,
        normals,
        reach,
        per_block,
        counts,
        starts,
        frames,
        room.directions[:blocks],
        room.edges[:blocks],
        needed,
        tally,
    )
    if needed.max(initial=0) > capacity:
        return int(needed.max())
    starts += capacity * (np.arange(n) // per_block)
    width = room.directions.shape[2]
    arcs = Arcs(
        points, normals, counts, starts, room.directions.reshape(-1, width), room.edges.reshape(-1, 2)
    )
    return FoundArcs(arcs, tally.sum(axis=0), frames)


def prefers_cover(
    geometry: Topology, bundles: Bundles, limits: LineLimits = UNLIMITED
) -> tuple[bool, Bundles]:
    """Whether covering is the cheaper way to see past a scene, judged by counts on some of its faces.

    The choice belongs to the scene and the limits: it depends neither on the points that are asked for nor on
    a clock.

    Returns
    -------
    cover : bool
    bundles : Bundles
        With corners, where they are needed.
    """
    order = bundles.face.order
    if len(order) == 0:
        return False, bundles
    starts = (np.arange(_PROBES) * len(order)) // _PROBES
    step = max(len(order) // _PROBE_POINTS, 1)
    faces = order[np.unique(np.minimum(starts[:, None] + step * np.arange(TILE), len(order) - 1))]
    codes = geometry.face_planes[faces]
    normals = geometry.planes[np.where(codes < 0, ~codes, codes), :3] * np.where(codes < 0, -1, 1)[:, None]
    points = geometry.vertices[geometry.faces[faces]].mean(axis=1) + _PROBE_LIFT * normals
    # One way first, covering where lines end: what costs little is taken at once, and the other way not
    # compiled only to be looked at.
    cover = limits.reach < np.inf
    whole = bundles if len(bundles.face.corners) or not cover else _with_corners(bundles, geometry)
    cost = _probe(geometry, whole, points, normals, cover, limits)
    if cost <= _LEAST_COVER * len(points):
        return cover, whole
    whole = whole if len(whole.face.corners) else _with_corners(bundles, geometry)
    if _probe(geometry, whole, points, normals, not cover, limits) < cost:
        cover = not cover
    return cover, whole if cover else bundles


def _probe(
    geometry: Topology,
    bundles: Bundles,
    points: np.ndarray,
    normals: np.ndarray,
    cover: bool,
    limits: LineLimits,
) -> float:
    """What one way costs for some points, in ns."""
    lines = _PROBE_LINES * (1 if limits.falloff == NO_FALLOFF else LINES_OF_FALLOFF)
    found: FoundRadial | int = 8 * TILE * lines
    while isinstance(found, int):
        found = find_radial(geometry, bundles, points, normals, lines, TILE, found, cover, limits=limits)
    cost = float(found.tally @ (_COVER_COST if cover else _SWEEP_COST))
    return cost * _FALLOFF_SWEEP if limits.falloff != NO_FALLOFF and not cover else cost


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
