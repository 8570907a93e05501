"""Edges as segments in dual space, bounded in dual space and in position [HZ00; NBMJ14 3.1].

The plane of a face is a point (N, d) in 4D dual space, an edge the segment between its faces' planes, and
a shade point p the hyperplane N.p + d = 0: an edge is a contour seen from p when the hyperplane cuts its
segment. A node bounds its segments relative to its own centre c, N.p + d = N.(p - c) + (N.c + d), which is
far tighter than bounding d about the origin. Edges with one face, or with many, are contours from nearly
everywhere: they have no bounds in dual space, and position alone rejects them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.partition import balanced_order, node_range
from silint.core.topology import Topology

# A unit of normal spread counts like this part of the scene's extent when edges are grouped. Larger
# values make the dual test reject more, smaller ones the position test; measured on clutter and scans.
NORMAL_WEIGHT = 0.06

# Columns of a node's bounds. A halved width is relative to the centre beside it.
CENTRE, HALF, N_POSITION = 0, 3, 6
NORMAL, NORMAL_HALF, OFFSET, OFFSET_HALF, N_DUAL = 6, 9, 12, 13, 14


class EdgeHierarchy(NamedTuple):
    """Edges in leaf order under a complete binary tree (see `partition`)."""

    ends: np.ndarray  # (E, 2) int32 vertices, lower first
    offsets: np.ndarray  # (E + 1,) int32 into planes
    planes: np.ndarray  # (M,) int32 codes: ~p where the edge has plane p's front on its other side
    bounds: np.ndarray  # (2^(depth + 1) - 1, 14) float64, columns above; 6 where the dual test does not apply
    depth: int
    largest_error: float  # of any plane


def build_edge_hierarchies(topology: Topology) -> tuple[EdgeHierarchy, EdgeHierarchy, int]:
    """Hierarchies of ordinary edges (two faces) and of all others, and the number of flat edges left out.

    A *flat* edge has faces that share planes and cancel: its jump is 0 from everywhere.
    """
    codes = _edge_planes(topology.edge_faces, topology.face_planes)
    flat = _flat_edges(topology.edge_offsets, codes)
    ordinary = np.diff(topology.edge_offsets) == 2
    contour = _build(topology, codes, np.flatnonzero(ordinary & ~flat).astype(np.int32), True)
    boundary = _build(topology, codes, np.flatnonzero(~ordinary & ~flat).astype(np.int32), False)
    return contour, boundary, int(flat.sum())


def _edge_planes(edge_faces: np.ndarray, face_planes: np.ndarray) -> np.ndarray:
    """Codes of planes for codes of faces: the two directions multiply."""
    against = edge_faces < 0
    plane = face_planes[np.where(against, ~edge_faces, edge_faces)]
    return np.where(against, ~plane, plane).astype(np.int32)


@njit(cache=True)
def _flat_edges(offsets, codes):
    """True where every plane occurs as often along the edge as against it."""
    flat = np.zeros(len(offsets) - 1, dtype=np.bool_)
    for e in range(len(flat)):
        flat[e] = True
        for i in range(offsets[e], offsets[e + 1]):
            plane = max(codes[i], ~codes[i])
            balance = 0
            for j in range(offsets[e], offsets[e + 1]):
                if max(codes[j], ~codes[j]) == plane:
                    balance += 1 if codes[j] >= 0 else -1
            flat[e] = flat[e] and balance == 0
    return flat


def _build(topology: Topology, codes: np.ndarray, chosen: np.ndarray, dual: bool) -> EdgeHierarchy:
    ends = topology.edges[chosen]
    offsets, planes = _gather(topology.edge_offsets, codes, chosen)
    order, depth = balanced_order(_keys(topology.vertices, topology.planes, ends, offsets, planes, dual))
    ends = np.ascontiguousarray(ends[order])
    offsets, planes = _gather(offsets, planes, order)
    bounds = np.empty((2 ** (depth + 1) - 1, N_DUAL if dual else N_POSITION))
    for level in range(depth + 1):
        _bound_level(
            topology.vertices, topology.planes, topology.plane_errors, ends, offsets, planes, dual, level, bounds
        )
    return EdgeHierarchy(ends, offsets, planes, bounds, depth, float(topology.plane_errors.max()))


def _gather(offsets: np.ndarray, values: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a ragged array, in a new order."""
    counts = np.diff(offsets)[rows]
    new_offsets = np.zeros(len(rows) + 1, dtype=np.int32)
    np.cumsum(counts, out=new_offsets[1:])
    source = np.repeat(offsets[:-1][rows] - new_offsets[:-1], counts) + np.arange(new_offsets[-1])
    return new_offsets, np.ascontiguousarray(values[source])


@njit(cache=True)
def _dual_end(planes, code, flip, out):
    """The plane behind a code as a dual point, negated as its direction (and `flip`) say."""
    p = max(code, ~code)
    sign = 1.0 if (code >= 0) != flip else -1.0
    for i in range(4):
        out[i] = sign * planes[p, i]


def _keys(
    vertices: np.ndarray, planes: np.ndarray, ends: np.ndarray, offsets: np.ndarray, codes: np.ndarray, dual: bool
) -> np.ndarray:
    """What to keep together: edges near each other and, where the dual test applies, alike in normal."""
    middle = vertices[ends].mean(axis=1)
    if not dual:
        return middle.astype(np.float32)
    pairs = codes.reshape(-1, 2)
    index = np.where(pairs < 0, ~pairs, pairs)
    # The second plane is negated, as in `_bound_level`.
    signs = np.where(pairs < 0, -1.0, 1.0) * (1.0, -1.0)
    normal = (signs[..., None] * planes[index, :3]).mean(axis=1)
    return np.concatenate([middle, NORMAL_WEIGHT * normal], axis=1).astype(np.float32)


@njit(cache=True, parallel=True)
def _bound_level(vertices, planes, plane_errors, ends, offsets, codes, dual, level, bounds):
    """Bound every node of one level straight from its edges: nothing is inherited, so nothing is loose.

    The second plane of an edge is negated: it runs the other way along the edge, so an edge is a contour
    when the two values differ in sign. For an inconsistently wound pair the same rule is right as it is.
    """
    n = len(ends)
    for j in prange(1 << level):
        first, last = node_range(n, level, j)
        row = bounds[(1 << level) - 1 + j]
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for e in range(first, last):
            for k in range(2):
                for i in range(3):
                    x = vertices[ends[e, k], i]
                    low[i] = min(low[i], x)
                    high[i] = max(high[i], x)
        for i in range(3):
            row[CENTRE + i] = 0.5 * (low[i] + high[i]) if last > first else 0.0
            row[HALF + i] = 0.5 * (high[i] - low[i]) if last > first else 0.0
        if not dual:
            continue
        low, high = np.full(4, np.inf), np.full(4, -np.inf)
        f = np.empty(4)
        error = 0.0
        for e in range(first, last):
            for k in range(2):
                code = codes[offsets[e] + k]
                _dual_end(planes, code, k == 1, f)
                for i in range(3):
                    f[3] += f[i] * row[CENTRE + i]
                error = max(error, plane_errors[max(code, ~code)])
                for i in range(4):
                    low[i] = min(low[i], f[i])
                    high[i] = max(high[i], f[i])
        for i in range(3):
            row[NORMAL + i] = 0.5 * (low[i] + high[i])
            row[NORMAL_HALF + i] = 0.5 * (high[i] - low[i])
        row[OFFSET] = 0.5 * (low[3] + high[3])
        # The faces' sides are trusted only beyond their planes' errors (contour.plane_side).
        row[OFFSET_HALF] = 0.5 * (high[3] - low[3]) + error
