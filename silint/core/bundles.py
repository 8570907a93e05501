"""Bundles of 16 edges under a tree with 16 children a node, laid out for vector code.

The search for contour edges is a filter in float32 with an error bound: what it drops is no contour that
crosses a line above the horizon, what it keeps is decided in float64. Nodes come in *blocks* of 16 siblings,
field by field, so that one loop over 16 lanes tests a whole block. An edge is kept beside its bundle in 16
bit integers relative to the bundle's centre and radius: 28 bytes, where 14 float64 would be 112, and the
error that this makes is part of the bound.

An edge with two faces has f = o N.p + d for each, the second negated: it is a contour where both differ in
sign. Edges with one face, or with many, are contours from nearly everywhere; position alone rejects them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, KERNEL, PARALLEL
from silint.core.lanes import WIDTH
from silint.core.partition import aligned_order, level_blocks
from silint.core.topology import Edges, Topology, edges_of

# A unit of normal spread counts like this part of the scene's extent when edges are grouped. Larger
# values make the dual test reject more, smaller ones the position test; measured on clutter and scans.
NORMAL_WEIGHT = 0.06

# Fields of a node: f = NORMAL.(p - CENTRE) + OFFSET within NORMAL_HALF and OFFSET_HALF, for all of its
# planes.
CENTRE, HALF, RADIUS, NORMAL, NORMAL_HALF, OFFSET, OFFSET_HALF, N_FIELDS = 0, 3, 6, 7, 10, 13, 14, 15
BLOCK = N_FIELDS * WIDTH

# Fields of an edge: two planes (normal, offset) and two vertices, relative to the bundle.
PLANE_A, PLANE_B, VERTEX_A, VERTEX_B, N_EDGE_FIELDS = 0, 4, 8, 11, 14
EDGE_BLOCK = N_EDGE_FIELDS * WIDTH
FULL_SCALE = 32767.0  # what an int16 of 1 means

# Bounds are rounded up by this, relative to the scene; a plane's own error is part of its offset's bound.
_UP = 2.0**-22
_ANYWHERE = np.float32(1e30)  # an offset bound that every point meets


class EdgeBundles(NamedTuple):
    """Edges in the order of the tree's leaves."""

    ends: np.ndarray  # (E, 2) int32 vertices, lower first
    offsets: np.ndarray  # (E + 1,) int32 into codes; empty where every edge has two
    codes: np.ndarray  # (M,) int32 planes: ~p where the edge has plane p's front on its other side
    edges: np.ndarray  # (bundles * EDGE_BLOCK,) int16
    nodes: np.ndarray  # (blocks * BLOCK,) float32, level by level, bundles first
    levels: np.ndarray  # (depth + 1,) int64: first block of each level
    largest_error: float  # of any plane


def build_edge_bundles(topology: Topology) -> tuple[EdgeBundles, EdgeBundles, int]:
    """Bundles of ordinary edges (two faces) and of all others, and the number of flat edges left out.

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
        is_flat = True
        for i in range(offsets[e], offsets[e + 1]):
            plane = max(codes[i], ~codes[i])
            balance = 0
            for j in range(offsets[e], offsets[e + 1]):
                if max(codes[j], ~codes[j]) == plane:
                    balance += 1 if codes[j] >= 0 else -1
            is_flat = is_flat and balance == 0
        flat[e] = is_flat
    return flat


def _build(
    topology: Topology, found: Edges, codes: np.ndarray, chosen: np.ndarray, pairs: bool
) -> EdgeBundles:
    ends = found.ends[chosen]
    offsets, planes = _gather(found.offsets, codes, chosen)
    order = aligned_order(_keys(topology.vertices, topology.planes, ends, planes, pairs))
    ends = np.ascontiguousarray(ends[order])
    offsets, planes = _gather(offsets, planes, order)
    geometry = topology.vertices, topology.planes, topology.plane_errors, ends, planes, pairs
    levels, sizes = level_blocks(len(ends))
    nodes = np.empty(levels[-1] * BLOCK, np.float32)
    for level, size in enumerate(sizes):
        bound_level(*geometry, size, nodes[levels[level] * BLOCK : levels[level + 1] * BLOCK])
    edges = np.zeros(-(-len(ends) // WIDTH) * EDGE_BLOCK, np.int16)
    _quantise(*geometry, nodes, edges)
    error = float(topology.plane_errors.max(initial=0.0))
    return EdgeBundles(ends, np.zeros(0, np.int32) if pairs else offsets, planes, edges, nodes, levels, error)


def _gather(offsets: np.ndarray, values: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a ragged array, in a new order."""
    counts = np.diff(offsets)[rows]
    new_offsets = np.zeros(len(rows) + 1, dtype=np.int32)
    np.cumsum(counts, out=new_offsets[1:])
    source = np.repeat(offsets[:-1][rows] - new_offsets[:-1], counts)
    source += np.arange(new_offsets[-1], dtype=np.int32)
    return new_offsets, np.ascontiguousarray(values[source])


@njit(**KERNEL)
def _keys(vertices, planes, ends, codes, pairs):
    """What to keep together: edges near each other and, where the dual test applies, alike in normal."""
    keys = np.zeros((len(ends), 6 if pairs else 3), np.float32)
    for e in range(len(ends)):
        for axis in range(3):
            keys[e, axis] = 0.5 * (vertices[ends[e, 0], axis] + vertices[ends[e, 1], axis])
        for side in range(2 if pairs else 0):
            # The second plane is negated, as everywhere.
            code = codes[2 * e + side]
            weight = 0.5 * NORMAL_WEIGHT if (code >= 0) == (side == 0) else -0.5 * NORMAL_WEIGHT
            for axis in range(3):
                keys[e, 3 + axis] += weight * planes[max(code, ~code), axis]
    return keys


@njit(**INNER)
def _plane(planes, code, side, centre, out):
    """Oriented plane of one side of an edge, its offset taken at a centre."""
    k = max(code, ~code)
    sign = 1.0 if (code >= 0) == (side == 0) else -1.0
    offset = planes[k, 3]
    for axis in range(3):
        out[axis] = sign * planes[k, axis]
        offset += planes[k, axis] * centre[axis]
    out[3] = sign * offset
    return k


@njit(**PARALLEL)
def bound_level(vertices, planes, plane_errors, ends, codes, pairs, size, nodes):
    """Bound every node of one level straight from its edges: nothing is inherited, so nothing is loose."""
    n = len(ends)
    for block in prange(len(nodes) // BLOCK):
        centre, plane = np.empty(3), np.empty(4)
        for lane in range(WIDTH):
            first = (block * WIDTH + lane) * size
            last = min(first + size, n)
            base = block * BLOCK + lane
            if first >= last:
                # Never above a horizon.
                for field in range(N_FIELDS):
                    nodes[base + field * WIDTH] = 0.0
                for axis in range(3):
                    nodes[base + (HALF + axis) * WIDTH] = -_ANYWHERE
                continue
            for axis in range(3):
                low, high = np.inf, -np.inf
                for e in range(first, last):
                    for k in range(2):
                        x = vertices[ends[e, k], axis]
                        low, high = min(low, x), max(high, x)
                middle = np.float32(0.5 * (low + high))
                centre[axis] = middle
                nodes[base + (CENTRE + axis) * WIDTH] = middle
                nodes[base + (HALF + axis) * WIDTH] = max(high - middle, middle - low) * (1.0 + _UP) + _UP
            radius = 0.0
            for e in range(first, last):
                for k in range(2):
                    square = 0.0
                    for axis in range(3):
                        square += (vertices[ends[e, k], axis] - centre[axis]) ** 2
                    radius = max(radius, square)
            nodes[base + RADIUS * WIDTH] = np.sqrt(radius) * (1.0 + _UP) + _UP
            if pairs:
                _bound_planes(planes, plane_errors, codes, first, last, centre, plane, nodes, base)
            else:
                for field in range(NORMAL, OFFSET_HALF):
                    nodes[base + field * WIDTH] = 0.0
                nodes[base + OFFSET_HALF * WIDTH] = _ANYWHERE


@njit(**INNER)
def _bound_planes(planes, plane_errors, codes, first, last, centre, plane, nodes, base):
    for i in range(4):
        low, high, error = np.inf, -np.inf, 0.0
        for j in range(2 * first, 2 * last):
            k = _plane(planes, codes[j], j % 2, centre, plane)
            low, high, error = min(low, plane[i]), max(high, plane[i]), max(error, plane_errors[k])
        middle = np.float32(0.5 * (low + high))
        half = max(high - middle, middle - low) * (1.0 + _UP) + _UP
        if i < 3:
            nodes[base + (NORMAL + i) * WIDTH] = middle
            nodes[base + (NORMAL_HALF + i) * WIDTH] = half
        else:
            # The faces' sides are trusted only beyond their planes' errors (contour.plane_side).
            nodes[base + OFFSET * WIDTH] = middle
            nodes[base + OFFSET_HALF * WIDTH] = half + error


@njit(**PARALLEL)
def _quantise(vertices, planes, plane_errors, ends, codes, pairs, nodes, edges):
    n = len(ends)
    for bundle in prange(len(edges) // EDGE_BLOCK):
        centre, plane = np.empty(3), np.empty(4)
        base = (bundle // WIDTH) * BLOCK + bundle % WIDTH
        for axis in range(3):
            centre[axis] = nodes[base + (CENTRE + axis) * WIDTH]
        scale = FULL_SCALE / nodes[base + RADIUS * WIDTH]
        for lane in range(WIDTH):
            e = bundle * WIDTH + lane
            out = bundle * EDGE_BLOCK + lane
            if e >= n:
                continue  # planes of 0: the lane is masked where the number of edges is known
            for k in range(2):
                for axis in range(3):
                    x = (vertices[ends[e, k], axis] - centre[axis]) * scale
                    edges[out + (VERTEX_A + 3 * k + axis) * WIDTH] = np.int16(np.rint(x))
                if not pairs:
                    # Two sides that always differ.
                    edges[out + (PLANE_A + 4 * k + 3) * WIDTH] = 32767 if k == 0 else -32767
                    continue
                _plane(planes, codes[2 * e + k], k, centre, plane)
                for i in range(3):
                    edges[out + (PLANE_A + 4 * k + i) * WIDTH] = np.int16(np.rint(plane[i] * FULL_SCALE))
                x = min(max(plane[3] * scale, -FULL_SCALE), FULL_SCALE)
                edges[out + (PLANE_A + 4 * k + 3) * WIDTH] = np.int16(np.rint(x))
