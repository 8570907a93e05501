"""The oracle: every face and every edge against every line, in plain double precision.

Nothing here is shared with silint/core: not the topology, not the lines, not the sums. Slow (10k faces,
200 points and 64 lines take some seconds) and short enough to be checked by eye.

On an isoline u = const of the octahedral map, within one quarter of its loop, the direction w(r) is linear
in r. A face with corners a, b, c (relative to the point) hides w if and only if w lies in their cone, that
is, if s n_ab.w >= 0, s n_bc.w >= 0 and s n_ca.w >= 0 with n_ab = a x b and s the sign of det(a, b, c):
three linear inequalities in r, so an interval. What is above the horizon and in no such interval is
visible. Both faces of an edge compute n_ab from the same numbers in the same order, so their intervals
meet in the same bits.

All points are shade points: displaced already (`shade_points`), normals of unit length.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from silint.core.jit import KERNEL_LOCK
from silint.reference import strip_cells

__all__ = [
    "ContourJumps",
    "Intervals",
    "ambient_occlusion",
    "bent_normals",
    "contour_jumps",
    "interval_difference",
    "shade_points",
    "sky_view_factor",
    "visible_intervals",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


def shade_points(
    vertices: FloatArray, points: FloatArray, normals: FloatArray, float32_source: bool = False
) -> FloatArray:
    """p' = p + delta n: the points that everything here expects.

    delta is 2^-36, or 64 * 2^-24 where vertices or points came as float32, of the largest coordinate at
    hand: that of the point or of any vertex.

    For points that lie in no face that holds their normal; what the others see is a matter of the
    integrator's convention, and to compare with it, take its own shade points.
    """
    scale = np.maximum(np.abs(points).max(axis=1, initial=0.0), np.abs(vertices).max())
    share = 64.0 * 2.0**-24 if float32_source else 2.0**-36
    return points + (share * scale)[:, None] * normals


# ------------------------------------------------------------------------------------------ contour edges


@dataclass(frozen=True)
class ContourJumps:
    """By how much the number of surfaces along a ray changes across each edge, seen from one point.

    Attributes
    ----------
    edges : ndarray of int64, shape (E, 2)
        Every undirected edge of the welded mesh, lower vertex first: rows of `positions`.
    jumps : ndarray of int64, shape (E,)
        Depth count on the side of a x b (a, b the edge's ends seen from the point) less that on the other
        side. Contour edges are those that are not 0.
    edge_on : ndarray of bool, shape (E,)
        Whether a face of the edge contains the point in its plane, exactly. Such a face counts 0.
    positions : ndarray of float64, shape (W, 3)
        The welded vertices, sorted.
    """

    edges: IntArray
    jumps: IntArray
    edge_on: npt.NDArray[np.bool_]
    positions: FloatArray


def contour_jumps(vertices: FloatArray, faces: npt.NDArray[np.int32], point: FloatArray) -> ContourJumps:
    """The jump of the depth count across every edge, by the exact side of every face.

    Parameters
    ----------
    vertices : ndarray of float64, shape (V, 3)
    faces : ndarray of int, shape (F, 3)
    point : ndarray of float64, shape (3,)
        Its bits are taken as exact.

    Returns
    -------
    ContourJumps
    """
    positions, triangles = _welded(vertices, faces)
    sides = _exact_sides(positions, triangles, np.asarray(point, np.float64))
    # Each face passes its three edges; along an edge from the lower vertex up its inside is where a x b
    # and det(a, b, c) agree, and the other way round on the way down.
    start = triangles.reshape(-1)
    end = np.roll(triangles, -1, axis=1).reshape(-1)
    weight = np.repeat(sides, 3) * np.where(start < end, 1, -1)
    ends = np.sort(np.column_stack([start, end]), axis=1)
    edges, inverse = np.unique(ends, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    jumps = np.bincount(inverse, weights=weight, minlength=len(edges)).astype(np.int64)
    edge_on = np.bincount(inverse, weights=np.repeat(sides == 0, 3), minlength=len(edges)) > 0
    return ContourJumps(edges, jumps, edge_on, positions)


def _welded(vertices: FloatArray, faces: npt.NDArray[np.int32]) -> tuple[FloatArray, IntArray]:
    """Equal positions become one vertex; faces that lose a corner to that are left out."""
    positions, inverse = np.unique(np.asarray(vertices, np.float64) + 0.0, axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[np.asarray(faces, np.int64)]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return np.ascontiguousarray(positions), np.ascontiguousarray(triangles[whole].astype(np.int64))


def _exact_sides(positions: FloatArray, triangles: IntArray, point: FloatArray) -> IntArray:
    """Sign of det(a, b, c) of each face's corners seen from the point: exact for the numbers as given."""
    a, b, c = (positions[triangles[:, k]] - point for k in range(3))
    det = (np.cross(a, b) * c).sum(axis=1)
    # Three rounded differences, a cross product and a dot product: 8 roundings of terms whose sum is at
    # most the product of the 1-norms; 16 unit roundoffs bound that with room.
    size = np.abs(a).sum(axis=1) * np.abs(b).sum(axis=1) * np.abs(c).sum(axis=1)
    sides = np.sign(det).astype(np.int64)
    for f in np.flatnonzero(np.abs(det) <= 16 * 2.0**-53 * size):
        p = [Fraction(float(x)) for x in point]
        r = [[Fraction(float(positions[v, k])) - p[k] for k in range(3)] for v in triangles[f]]
        exact = (
            r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1])
            + r[0][1] * (r[1][2] * r[2][0] - r[1][0] * r[2][2])
            + r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0])
        )
        sides[f] = (exact > 0) - (exact < 0)
    return sides


# --------------------------------------------------------------------------------------- visible intervals


@dataclass(frozen=True)
class Intervals:
    """Visible parts of K isolines for each of n points.

    Attributes
    ----------
    offsets : ndarray of int64, shape (n * K + 1,)
        Intervals of point i on line k are rows ``offsets[i * K + k]`` to ``offsets[i * K + k + 1]``.
    intervals : ndarray of float64, shape (m, 2)
        Start and end in the loop coordinate v of [0, 4], ascending, cut where v wraps from 4 to 0.
    isolines : int
        K. Line k has u = -1 + (2 k + 1) / K.
    """

    offsets: IntArray
    intervals: FloatArray
    isolines: int


def visible_intervals(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
    up: FloatArray | None = None,
) -> Intervals:
    """What each point sees above its horizon, on every octahedral isoline.

    Parameters
    ----------
    vertices : ndarray of float64, shape (V, 3)
    faces : ndarray of int, shape (F, 3)
        No faces at all give the whole runs above the horizon.
    points, normals : ndarray of float64, shape (n, 3)
        Shade points (`shade_points`) and unit normals.
    isolines : int
    up : ndarray of float64, shape (3,), optional
        Keep only directions with up.w > 0 as well.

    Returns
    -------
    Intervals
    """
    positions, triangles = _welded(vertices, faces)
    points = np.ascontiguousarray(points, np.float64)
    normals = np.ascontiguousarray(normals, np.float64)
    planes = np.empty((len(points), 1 if up is None else 2, 3))
    planes[:, 0] = normals
    if up is not None:
        planes[:, 1] = up
    capacity = 16
    while True:
        counts = np.zeros(len(points) * isolines, np.int64)
        slots = np.empty((len(points) * isolines, capacity, 2))
        with KERNEL_LOCK:
            _visible(positions, triangles, points, planes, isolines, counts, slots)
        if counts.max(initial=0) <= capacity:
            break
        capacity = int(counts.max())
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return Intervals(offsets, slots[np.arange(slots.shape[1]) < counts[:, None]], isolines)


@njit(cache=True)
def _quarter(g, q, sign):
    """Where on quarter q a function, linear between the corner values g, has the sign wanted (or is 0)."""
    g0, g1 = sign * g[q], sign * g[(q + 1) % 4]
    if g0 >= 0.0 and g1 >= 0.0:
        return 0.0, 1.0
    if g0 < 0.0 and g1 < 0.0:
        return 1.0, 0.0
    root = g0 / (g0 - g1)
    if g0 >= 0.0:
        return 0.0, root
    return root, 1.0


@njit(cache=True)
def _corner_values(n, u, g):
    """n.w at the four corners of the loop: +y, +z, -y, -z."""
    side = 1.0 - abs(u)
    g[0] = n[0] * u + side * n[1]
    g[1] = n[0] * u + side * n[2]
    g[2] = n[0] * u - side * n[1]
    g[3] = n[0] * u - side * n[2]


@njit(cache=True)
def _edge_normal(positions, p, v, w, out):
    """a x b for an edge, always from the lower vertex to the higher; the sign undoes the exchange."""
    i, j = (v, w) if v < w else (w, v)
    ax, ay, az = positions[i, 0] - p[0], positions[i, 1] - p[1], positions[i, 2] - p[2]
    bx, by, bz = positions[j, 0] - p[0], positions[j, 1] - p[1], positions[j, 2] - p[2]
    out[0] = ay * bz - az * by
    out[1] = az * bx - ax * bz
    out[2] = ax * by - ay * bx
    return 1.0 if v < w else -1.0


@njit(cache=True)
def _facing_faces(positions, triangles, p, n, normals, signs):
    """Edge normals and signs of the faces that can hide anything above the horizon; returns how many."""
    m = 0
    for f in range(len(triangles)):
        i, j, k = triangles[f]
        above = False
        for v in triangles[f]:
            x, y, z = positions[v, 0] - p[0], positions[v, 1] - p[1], positions[v, 2] - p[2]
            if n[0] * x + n[1] * y + n[2] * z > 0.0:
                above = True
        if not above:
            continue
        s0 = _edge_normal(positions, p, i, j, normals[m, 0])
        s1 = _edge_normal(positions, p, j, k, normals[m, 1])
        s2 = _edge_normal(positions, p, k, i, normals[m, 2])
        det = s0 * (
            normals[m, 0, 0] * (positions[k, 0] - p[0])
            + normals[m, 0, 1] * (positions[k, 1] - p[1])
            + normals[m, 0, 2] * (positions[k, 2] - p[2])
        )
        if det == 0.0:
            continue  # seen edge-on: no area, hides nothing
        s = 1.0 if det > 0.0 else -1.0
        signs[m, 0], signs[m, 1], signs[m, 2] = s * s0, s * s1, s * s2
        m += 1
    return m


@njit(cache=True, parallel=True)
def _visible(positions, triangles, points, planes, isolines, counts, slots):
    capacity = slots.shape[1]
    for i in prange(len(points)):
        normals = np.empty((len(triangles), 3, 3))
        signs = np.empty((len(triangles), 3))
        n_facing = _facing_faces(positions, triangles, points[i], planes[i, 0], normals, signs)
        hidden = np.empty((4 * n_facing + 16, 2))
        g = np.empty((3, 4))
        for k in range(isolines):
            u = -1.0 + (2.0 * k + 1.0) / isolines
            m = 0
            # Below the horizon counts as hidden.
            for h in range(planes.shape[1]):
                _corner_values(planes[i, h], u, g[0])
                for q in range(4):
                    lo, hi = _quarter(g[0], q, -1.0)
                    if lo <= hi:
                        hidden[m, 0], hidden[m, 1] = q + lo, q + hi
                        m += 1
            for f in range(n_facing):
                for e in range(3):
                    _corner_values(normals[f, e], u, g[e])
                for q in range(4):
                    lo, hi = _quarter(g[0], q, signs[f, 0])
                    for e in range(1, 3):
                        if lo > hi:
                            break
                        lo_e, hi_e = _quarter(g[e], q, signs[f, e])
                        lo, hi = max(lo, lo_e), min(hi, hi_e)
                    if lo <= hi:
                        hidden[m, 0], hidden[m, 1] = q + lo, q + hi
                        m += 1
            # What the union of the hidden intervals leaves of [0, 4].
            line = i * isolines + k
            found, reached = 0, 0.0
            order = np.argsort(hidden[:m, 0])
            for j in range(m + 1):
                start = hidden[order[j], 0] if j < m else 4.0
                if start > reached:
                    if found < capacity:
                        slots[line, found, 0], slots[line, found, 1] = reached, start
                    found += 1
                if j < m:
                    reached = max(reached, hidden[order[j], 1])
            counts[line] = found


def interval_difference(
    first_offsets: IntArray, first: FloatArray, second_offsets: IntArray, second: FloatArray
) -> FloatArray:
    """Length, line by line, of what lies in one of two sets of intervals and not in the other.

    Intervals may wrap: an end beyond 4, or before its start, continues from 0. Each set's intervals must
    not overlap on one line.

    Parameters
    ----------
    first_offsets, second_offsets : ndarray of int, shape (L + 1,)
    first, second : ndarray of float64, shape (m, 2)

    Returns
    -------
    ndarray of float64, shape (L,)
    """
    if len(first_offsets) != len(second_offsets):
        raise ValueError(f"{len(first_offsets) - 1} lines against {len(second_offsets) - 1}")
    out = np.zeros(len(first_offsets) - 1)
    for line in range(len(out)):
        changes = []
        for weight, offsets, intervals in ((1, first_offsets, first), (-1, second_offsets, second)):
            for start, end in intervals[offsets[line] : offsets[line + 1]]:
                pieces = [(start, end)]
                if end > 4.0:
                    pieces = [(start, 4.0), (0.0, end - 4.0)]
                elif end < start:
                    pieces = [(start, 4.0), (0.0, end)]
                for a, b in pieces:
                    changes += [(a, weight), (b, -weight)]
        changes.sort()
        depth, previous = 0, 0.0
        for v, weight in changes:
            if depth != 0:
                out[line] += v - previous
            depth, previous = depth + weight, v
    return out


# ---------------------------------------------------------------------------------------------- integrals


def ambient_occlusion(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
    weighting: str = "cosine",
) -> FloatArray:
    """Visible over whole runs: each interval stands for its cell, the strip of its line times its v-range.

    1 open, 0 closed; "cosine" or "uniform". Arguments as for `visible_intervals`; shape (n,).
    """
    moment = {"cosine": 1, "uniform": 0}[weighting]
    return _ratio(vertices, faces, points, normals, isolines, moment, None)


def sky_view_factor(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
    up: FloatArray,
) -> FloatArray:
    """As `ambient_occlusion` over what is above both horizons, times the open value (1 + n.up) / 2."""
    up = np.asarray(up, np.float64) / np.linalg.norm(up)
    return 0.5 * (1.0 + normals @ up) * _ratio(vertices, faces, points, normals, isolines, 1, up)


def bent_normals(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
) -> FloatArray:
    """(1/pi) times the integral of V max(n.w, 0) w, corrected so that an open sky gives (2/3) n: (n, 3)."""
    normals = np.ascontiguousarray(normals, np.float64)
    visible = visible_intervals(vertices, faces, points, normals, isolines)
    whole = visible_intervals(vertices, np.zeros((0, 3), np.int32), points, normals, isolines)
    seen, total = (
        strip_cells.second_moments(s.offsets, s.intervals, isolines, normals) for s in (visible, whole)
    )
    open_share = _ratio(vertices, faces, points, normals, isolines, 1, None)
    return (seen + open_share[:, None] * (2 / 3 * np.pi * normals - total)) / np.pi


def _ratio(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
    moment: int,
    up: FloatArray | None,
) -> FloatArray:
    normals = np.ascontiguousarray(normals, np.float64)
    visible = visible_intervals(vertices, faces, points, normals, isolines, up)
    whole = visible_intervals(vertices, np.zeros((0, 3), np.int32), points, normals, isolines, up)
    seen, total = (
        strip_cells.first_moments(s.offsets, s.intervals, isolines, normals, moment) for s in (visible, whole)
    )
    # A request whose lines all miss the hemisphere (one line, a normal along it) has nothing to hide.
    return np.divide(seen, total, out=np.ones_like(seen), where=total > 0)
