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

from silint.core.jit import INNER, KERNEL, PARALLEL
from silint.core.partition import balanced_order, node_range
from silint.core.topology import Edges, Topology, edges_of

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
    edges = edges_of(topology)
    codes = _edge_planes(edges.faces, topology.face_planes)
    flat = _flat_edges(edges.offsets, codes)
    ordinary = np.diff(edges.offsets) == 2
    contour = _build(topology, edges, codes, np.flatnonzero(ordinary & ~flat).astype(np.int32), True)
    boundary = _build(topology, edges, codes, np.flatnonzero(~ordinary & ~flat).astype(np.int32), False)
    return contour, boundary, int(flat.sum())


def _edge_planes(edge_faces: np.ndarray, face_planes: np.ndarray) -> np.ndarray:
    """Codes of planes for codes of faces: the two directions multiply."""
    against = edge_faces < 0
    plane = face_planes[np.where(against, ~edge_faces, edge_faces)]
    return np.where(against, ~plane, plane).astype(np.int32)


@njit(**KERNEL)
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


def _build(
    topology: Topology, found: Edges, codes: np.ndarray, chosen: np.ndarray, dual: bool
) -> EdgeHierarchy:
    ends = found.ends[chosen]
    offsets, planes = _gather(found.offsets, codes, chosen)
    order, depth = balanced_order(_keys(topology.vertices, topology.planes, ends, offsets, planes, dual))
    ends = np.ascontiguousarray(ends[order])
    offsets, planes = _gather(offsets, planes, order)
    bounds = np.empty((2 ** (depth + 1) - 1, N_DUAL if dual else N_POSITION))
    for level in range(depth + 1):
        _bound_level(
            topology.vertices,
            topology.planes,
            topology.plane_errors,
            ends,
            offsets,
            planes,
            dual,
            level,
            bounds,
        )
    return EdgeHierarchy(ends, offsets, planes, bounds, depth, float(topology.plane_errors.max(initial=0.0)))


def _gather(offsets: np.ndarray, values: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a ragged array, in a new order."""
    counts = np.diff(offsets)[rows]
    new_offsets = np.zeros(len(rows) + 1, dtype=np.int32)
    np.cumsum(counts, out=new_offsets[1:])
    source = np.repeat(offsets[:-1][rows] - new_offsets[:-1], counts) + np.arange(new_offsets[-1])
    return new_offsets, np.ascontiguousarray(values[source])


def _keys(
    vertices: np.ndarray,
    planes: np.ndarray,
    ends: np.ndarray,
    offsets: np.ndarray,
    codes: np.ndarray,
    dual: bool,
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


@njit(**PARALLEL)
def _bound_level(vertices, planes, plane_errors, ends, offsets, codes, dual, level, bounds):
    """Bound every node of one level straight from its edges: nothing is inherited, so nothing is loose.

    The second plane of an edge is negated: it runs the other way along the edge, so an edge is a contour
    when the two values differ in sign. For an inconsistently wound pair the same rule is right as it is.
    """
    n = len(ends)
    first_node = (1 << level) - 1
    for j in prange(1 << level):
        node = first_node + j
        first, last = node_range(n, level, j)
        for i in range(3):
            low, high = np.inf, -np.inf
            for e in range(first, last):
                for k in range(2):
                    x = vertices[ends[e, k], i]
                    low, high = min(low, x), max(high, x)
            bounds[node, CENTRE + i] = 0.5 * (low + high) if last > first else 0.0
            bounds[node, HALF + i] = 0.5 * (high - low) if last > first else 0.0
        if dual:
            _bound_dual(planes, plane_errors, offsets, codes, first, last, bounds, node)


@njit(**INNER)
def _bound_dual(planes, plane_errors, offsets, codes, first, last, bounds, node):
    for i in range(4):
        low, high, error = np.inf, -np.inf, 0.0
        for e in range(first, last):
            for side in range(2):
                code = codes[offsets[e] + side]
                k = max(code, ~code)
                x = planes[k, i]
                if i == 3:
                    for axis in range(3):
                        x += planes[k, axis] * bounds[node, CENTRE + axis]
                if (code >= 0) != (side == 0):
                    x = -x
                low, high, error = min(low, x), max(high, x), max(error, plane_errors[k])
        middle, half = (0.5 * (low + high), 0.5 * (high - low)) if last > first else (0.0, 0.0)
        if i < 3:
            bounds[node, NORMAL + i], bounds[node, NORMAL_HALF + i] = middle, half
        else:
            # The faces' sides are trusted only beyond their planes' errors (contour.plane_side).
            bounds[node, OFFSET], bounds[node, OFFSET_HALF] = middle, half + error
