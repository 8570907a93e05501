"""Phase one for the integrator: shade points in chunks to visible intervals, on either family of isolines."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import numpy.typing as npt

from silint.core.arcs_types import Arcs
from silint.core.bundles import build_edge_bundles
from silint.core.caps import LINEAR, NO_FALLOFF, NO_GROUND, QUADRATIC, UNLIMITED, LineLimits
from silint.core.contour import CONTOURS, CROSSINGS, EDGES, NODES, SNAPPED
from silint.core.face_bundles import build_face_bundles, with_corners
from silint.core.jit import KERNEL_LOCK
from silint.core.lift import lift_points
from silint.core.radial import NO_AIM, RadialIntervals
from silint.core.search import TILE
from silint.core.visible import (
    Bundles,
    VisibleIntervals,
    arc_room,
    cover_visible,
    find_arcs,
    find_radial,
    find_visible,
    prefers_cover,
    tile_order,
)
from silint.limits import Limits
from silint.scene import Scene
from silint.validation import InputError, normal_rows, normals_array, points_array
from silint.visibility import FloatArray, Visibility

Progress = Callable[[int, int], None]

# Shade points are lifted along their normals by the first distance, and off the faces that touch them and
# hold their normal by the second; a face touches within the third (core.lift). In units of the scene, for
# points that are exact in float64 and for coordinates that came as float32. Far above the rounding of the
# mesh, so that an edge below a lifted point keeps its direction to 1e-5; far below any feature of a mesh.
LIFT = (2.0**-36, 2.0**-44, 2.0**-48)
LIFT_FLOAT32 = (2.0**-18, 2.0**-21, 2.0**-23)

# A call into the kernels is kept near this time, so that Ctrl-C and progress bars stay responsive.
_CHUNK_SECONDS = 0.2
_CHUNK_BYTES = 1 << 28

# Points that are put into tiles together. More make better tiles and take more memory.
_TILED_POINTS = 1 << 17
# Points that a thread takes at a time.
_PER_BLOCK = 8 * TILE
_ARCS_PER_BLOCK = 2 * TILE

# Distances for which is kept whether they are covered; each takes a probe to find out again.
_KEPT_CHOICES = 64

_FALLOFFS = {"none": NO_FALLOFF, "linear": LINEAR, "quadratic": QUADRATIC}


class VisibleFinder:
    """The hierarchies over a scene, and what is visible past it."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.geometry = scene.topology
        with KERNEL_LOCK:
            contour, boundary, self.flat_edges = build_edge_bundles(self.geometry)
            self.bundles = Bundles(contour, boundary, build_face_bundles(self.geometry, corners=False))
            used = self.geometry.vertices[self.geometry.faces].reshape(-1, 3)
            if len(used) == 0:
                used = np.zeros((1, 3))
            self._box = used.min(axis=0), used.max(axis=0)
        self._cover: bool | None = None
        self._covers_near: dict[tuple[float, int], bool] = {}
        self._arc_capacity = _ARCS_PER_BLOCK * 256  # arcs for which a block has room

    @property
    def cover(self) -> bool:
        """Whether radial isolines are covered: what is cheaper for the scene, found when first needed."""
        if self._cover is None:
            with KERNEL_LOCK:
                if self._cover is None:
                    self._cover, self.bundles = prefers_cover(self.geometry, self.bundles)
        return self._cover

    def line_limits(self, limits: Limits) -> LineLimits:
        """The same limits in scaled units, as the kernels take them; faces are made ready to be covered."""
        exponent = -self.scene.welding.exponent
        diagonal = float(np.ldexp(np.linalg.norm(self._box[1] - self._box[0]), -exponent))
        with np.errstate(over="ignore", under="ignore"):
            reach = float(np.ldexp(limits.distance(diagonal), exponent))
            ground = NO_GROUND
            if limits.ground is not None:
                ground = np.array(limits.ground)
                ground[3] = np.ldexp(ground[3], exponent)
        found = LineLimits(
            max(reach, np.finfo(np.float64).tiny),  # no direction is as near as that
            _FALLOFFS[limits.falloff],
            limits.backfaces == "ignore",
            limits.cone,
            ground,
        )
        with KERNEL_LOCK:
            if found.by_faces and len(self.bundles.face.corners) == 0:
                face = with_corners(self.bundles.face, self.geometry)
                self.bundles = self.bundles._replace(face=face)
        return found

    def _covers(self, limits: LineLimits) -> bool:
        """`cover` where only what is near counts."""
        wanted = limits.reach, limits.falloff
        with KERNEL_LOCK:
            if wanted not in self._covers_near:
                if len(self._covers_near) >= _KEPT_CHOICES:
                    self._covers_near.clear()
                near = LineLimits(*wanted)
                self._covers_near[wanted] = prefers_cover(self.geometry, self.bundles, near)[0]
            return self._covers_near[wanted]

    def _within(self, p: FloatArray, limits: LineLimits) -> list[tuple[npt.NDArray[np.int64], LineLimits]]:
        """Rows of points, and what limits them.

        Points from which the scene ends within the distance are served as without one: to the same bits.
        """
        rows = np.arange(len(p))
        if limits.reach == np.inf or limits.falloff != NO_FALLOFF:
            return [(rows, limits)]
        low, high = self._box
        farthest = np.maximum(np.abs(p - low), np.abs(p - high))
        beyond = (farthest * farthest).sum(axis=1) <= limits.reach * limits.reach
        unlimited = limits._replace(reach=np.inf, ground_reach=limits.reach)
        parts = [(rows[beyond], unlimited), (rows[~beyond], limits)]
        return [part for part in parts if len(part[0])]

    def _is_covered(self, limits: LineLimits) -> bool:
        """Whether radial isolines are covered under these limits."""
        return limits.one_sided or (self.cover if limits.reach == np.inf else self._covers(limits))

    def shade_points(self, points: npt.ArrayLike, normals: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Points in scaled units, lifted along their unit normals, and these."""
        p, float32_points = points_array(points)
        n = normals_array(normals, len(p))
        return self._lifted(p, n, float32_points, 0), n

    def shade_point_chunks(
        self, points: npt.ArrayLike, normals: npt.ArrayLike
    ) -> tuple[int, Iterator[tuple[slice, FloatArray, FloatArray]]]:
        """The same, some at a time, so that memory does not grow with their number: how many, and the chunks.

        All of them are checked before the first is handed out.
        """
        p, float32_points = points_array(points)
        rows = normal_rows(normals, len(p))
        chunks = [slice(i, min(i + _TILED_POINTS, len(p))) for i in range(0, len(p), _TILED_POINTS)]

        def unit(chunk: slice) -> FloatArray:
            return normals_array(rows[chunk], chunk.stop - chunk.start, first_row=chunk.start)

        for chunk in chunks:
            unit(chunk)
            self._scaled(p[chunk], chunk.start)

        def lifted() -> Iterator[tuple[slice, FloatArray, FloatArray]]:
            for chunk in chunks:
                n = unit(chunk)
                yield chunk, self._lifted(p[chunk], n, float32_points, chunk.start), n

        return len(p), lifted()

    def _scaled(self, points: FloatArray, first_row: int) -> FloatArray:
        with np.errstate(over="ignore"):
            p: FloatArray = np.ldexp(points, -self.scene.welding.exponent)
        far = np.flatnonzero(~(np.abs(p) < 1e100).all(axis=1))
        if len(far):
            raise InputError(f"points row {far[0] + first_row} lies more than 1e100 scene extents away")
        return p

    def _lifted(self, points: FloatArray, n: FloatArray, float32_points: bool, first_row: int) -> FloatArray:
        p = self._scaled(points, first_row)
        lift = LIFT_FLOAT32 if float32_points or self.scene.float32_source else LIFT
        lifted = np.empty_like(p)
        with KERNEL_LOCK:
            lift_points(self.geometry, self.bundles.face, p, n, *lift, lifted)
        return lifted

    def octahedral(
        self,
        p: FloatArray,
        n: FloatArray,
        isolines: int,
        progress: Progress | None,
        cover_all: bool = False,
    ) -> Iterator[tuple[Visibility, npt.NDArray[np.int64]]]:
        """Visible intervals on octahedral isolines of groups of points, and their rows."""
        capacity, done = 4 * TILE * isolines, 0
        for points, normals, rows in self._in_tiles(p, n):
            first, size = 0, 4 * TILE
            while first < len(rows):
                group = slice(first, min(first + size, len(rows)))
                began = time.perf_counter()
                with KERNEL_LOCK:
                    found: VisibleIntervals | int
                    if cover_all:
                        found = cover_visible(
                            self.geometry, self.bundles, points[group], normals[group], isolines
                        )
                    else:
                        found = find_visible(
                            self.geometry, self.bundles, points[group], normals[group], isolines, capacity
                        )
                if isinstance(found, int):
                    # Grow the buffers, in fewer points at a time if they would become large.
                    capacity = found + found // 4
                    size = _next_size(size, TILE, capacity, 1.0)
                    continue
                seen = np.diff(found.offsets[::isolines])
                diagnostics = diagnose(found, len(seen), int((seen == 0).sum()), isolines)
                diagnostics["covered_points" if cover_all else "swept_points"] = len(seen)
                yield (
                    Visibility(
                        normals[group],
                        isolines,
                        found.offsets,
                        found.intervals,
                        "octahedral",
                        diagnostics,
                    ),
                    rows[group],
                )
                first = group.stop
                done += len(seen)
                if progress is not None:
                    progress(done, len(p))
                size = _next_size(size, TILE, capacity, time.perf_counter() - began)

    def radial(
        self,
        p: FloatArray,
        n: FloatArray,
        isolines: int,
        progress: Progress | None,
        aim: FloatArray = NO_AIM,
        limits: LineLimits = UNLIMITED,
    ) -> Iterator[tuple[RadialIntervals, dict[str, int], npt.NDArray[np.int64]]]:
        """Visible intervals on radial isolines of groups of points, what was counted, and their rows."""
        done = 0
        for rows, within in self._within(p, limits):
            report, cover = _after(progress, done, len(p)), self._is_covered(within)
            for visible, totals, group in self._radial(
                p[rows], n[rows], isolines, report, aim, within, cover
            ):
                yield visible, totals, rows[group]
            done += len(rows)

    def _radial(
        self,
        p: FloatArray,
        n: FloatArray,
        isolines: int,
        progress: Progress | None,
        aim: FloatArray,
        limits: LineLimits,
        cover: bool,
    ) -> Iterator[tuple[RadialIntervals, dict[str, int], npt.NDArray[np.int64]]]:
        """The same one way."""
        capacity, done = 2 * _PER_BLOCK * isolines, 0
        for points, normals, rows in self._in_tiles(p, n):
            first, size = 0, 4 * _PER_BLOCK
            while first < len(rows):
                group = slice(first, min(first + size, len(rows)))
                began = time.perf_counter()
                with KERNEL_LOCK:
                    found = find_radial(
                        self.geometry,
                        self.bundles,
                        points[group],
                        normals[group],
                        isolines,
                        _PER_BLOCK,
                        capacity,
                        cover,
                        aim,
                        limits,
                    )
                if isinstance(found, int):
                    capacity = found + found // 4
                    size = _next_size(size, _PER_BLOCK, capacity, 1.0)
                    continue
                visible = found.visible
                n_points = len(visible.counts)
                totals = diagnose(None, n_points, int((~visible.counts.any(axis=1)).sum()), isolines)
                totals["fallback_isolines"] = found.contradicted * isolines
                totals["covered_points"] = n_points if cover else found.contradicted
                totals["swept_points"] = n_points - totals["covered_points"]
                count_work(totals, found.tally)
                yield visible, totals, rows[group]
                first = group.stop
                done += group.stop - group.start
                if progress is not None:
                    progress(done, len(p))
                size = _next_size(size, _PER_BLOCK, capacity, time.perf_counter() - began)

    def arcs(
        self, p: FloatArray, n: FloatArray, progress: Progress | None, limits: LineLimits = UNLIMITED
    ) -> Iterator[tuple[Arcs, npt.NDArray[np.bool_], dict[str, int], npt.NDArray[np.int64]]]:
        """Boundary arcs of groups of points, whether they are certain, what was counted, and the rows.

        The arcs of a group stand where those of the next will: they have to be read before it is asked for.
        Of the limits, they know the distance.
        """
        done = 0
        for rows, within in self._within(p, limits):
            reach = within.reach if within.reach < np.inf else None
            report = _after(progress, done, len(p))
            for arcs, certain, totals, part in self._arcs_within(p[rows], n[rows], reach, report):
                yield arcs, certain, totals, rows[part]
            done += len(rows)

    def _arcs_within(
        self, p: FloatArray, n: FloatArray, reach: float | None, progress: Progress | None
    ) -> Iterator[tuple[Arcs, npt.NDArray[np.bool_], dict[str, int], npt.NDArray[np.int64]]]:
        """The same for points with one distance, None for no limit."""
        done, room = 0, arc_room(0, 0, reach is not None)
        for points, normals, rows in self._in_tiles(p, n):
            first, size = 0, 4 * _ARCS_PER_BLOCK
            while first < len(rows):
                group = slice(first, min(first + size, len(rows)))
                blocks, capacity = -(-(group.stop - first) // _ARCS_PER_BLOCK), self._arc_capacity
                if room.directions.shape[0] < blocks or room.directions.shape[1] < capacity:
                    room = arc_room(blocks, capacity, reach is not None)
                began = time.perf_counter()
                with KERNEL_LOCK:
                    found = find_arcs(
                        self.geometry,
                        self.bundles,
                        points[group],
                        normals[group],
                        _ARCS_PER_BLOCK,
                        room,
                        reach,
                    )
                if isinstance(found, int):
                    # Of the finder, since what was learned once serves all queries; no value depends on it.
                    self._arc_capacity = max(2 * found, self._arc_capacity)
                    size = _next_size(size, _ARCS_PER_BLOCK, 5 * self._arc_capacity, 1.0)
                    continue
                certain = found.frames > 0
                totals = diagnose(None, len(certain), int((found.arcs.counts == 0).sum()), 0)
                totals["exact_points"] = int(certain.sum())
                totals["second_frames"] = int((found.frames == 2).sum())
                totals["uncertified_points"] = int((~certain).sum())
                count_work(totals, found.tally)
                yield found.arcs, certain, totals, rows[group]
                first = group.stop
                done += len(certain)
                if progress is not None:
                    progress(done, len(p))
                size = _next_size(size, _ARCS_PER_BLOCK, 5 * capacity, time.perf_counter() - began)

    def _in_tiles(
        self, p: FloatArray, n: FloatArray
    ) -> Iterator[tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]]:
        """Points and normals in tile order, and their rows, some at a time."""
        for start in range(0, len(p), _TILED_POINTS):
            chunk = slice(start, min(start + _TILED_POINTS, len(p)))
            with KERNEL_LOCK:
                order = tile_order(p[chunk], n[chunk])
            yield p[chunk][order], n[chunk][order], start + order.astype(np.int64)


def _after(progress: Progress | None, before: int, total: int) -> Progress | None:
    """Progress of some points, as that of all where so many were done before."""
    if progress is None:
        return None
    return lambda done, _: progress(before + done, total)


def _next_size(size: int, block: int, capacity: int, seconds: float) -> int:
    """How many points to take next: for _CHUNK_SECONDS, in whole blocks whose buffers stay small."""
    factor = min(max(_CHUNK_SECONDS / max(seconds, 1e-9), 0.25), 4.0)
    most = max(_CHUNK_BYTES // (16 * capacity), 1)
    return block * min(max(int(size * factor) // block, 1), most)


def diagnose(found: VisibleIntervals | None, points: int, buried: int, isolines: int) -> dict[str, int]:
    """Counts of a group of points; see `SilhouetteIntegrator`."""
    totals = {
        "points": points,
        "isolines": isolines,
        "buried": buried,
        "swept_points": 0,
        "covered_points": 0,
        "exact_points": 0,
        "second_frames": 0,
        "uncertified_points": 0,
        "fallback_isolines": 0 if found is None else found.covered,
        "snapped_sides": 0,
        "nodes_visited": 0,
        "edges_tested": 0,
        "contour_edges": 0,
        "crossings": 0,
    }
    if found is not None:
        count_work(totals, found.tally)
    return totals


def count_work(totals: dict[str, int], tally: npt.NDArray[np.int64]) -> None:
    """Add what a search counted."""
    for name, column in (
        ("snapped_sides", SNAPPED),
        ("nodes_visited", NODES),
        ("edges_tested", EDGES),
        ("contour_edges", CONTOURS),
        ("crossings", CROSSINGS),
    ):
        totals[name] += int(tally[column])


def add_counts(totals: dict[str, int], more: Mapping[str, int]) -> None:
    """Add the counts of another group of points."""
    for key in more:
        if key == "isolines":
            totals[key] = max(totals[key], more[key])
        else:
            totals[key] += more[key]
