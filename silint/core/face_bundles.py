"""Bundles of 16 faces under a tree with 16 children a node: what lies along an axis, or in front.

Nodes come in blocks of 16 siblings, field by field, as those of edge bundles; so do the corners of a bundle's
faces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import PARALLEL
from silint.core.lanes import WIDTH
from silint.core.partition import aligned_box_order, level_blocks
from silint.core.topology import Topology

# Fields of a node: centre and half width of its box.
CENTRE, HALF, N_FIELDS = 0, 3, 6
BLOCK = N_FIELDS * WIDTH
# Corners of 16 faces: three coordinates each.
CORNER_BLOCK = 9 * WIDTH
FULL_SCALE = 32767.0  # what an int16 of 1 means

_UP = 2.0**-22  # bounds are rounded up by this, relative to the scene


class FaceBundles(NamedTuple):
    """Faces in the order of the tree's leaves."""

    order: np.ndarray  # (F,) int32 faces of the topology
    coarse: np.ndarray  # (bundles * CORNER_BLOCK,) int16: corners from the centre, in longest half widths
    nodes: np.ndarray  # (blocks * BLOCK,) float32, level by level, bundles first
    levels: np.ndarray  # (depth + 1,) int64: first block of each level
    # (bundles * CORNER_BLOCK,) float64, in rising order of a face's vertices, zero beyond the last face;
    # empty where nothing is to be covered.
    corners: np.ndarray


def build_face_bundles(topology: Topology, corners: bool = True) -> FaceBundles:
    """Group faces so that boxes about groups are small."""
    placed = topology.vertices[topology.faces].astype(np.float32)
    order = aligned_box_order(placed.min(axis=1), placed.max(axis=1))
    levels, sizes = level_blocks(len(order))
    nodes = np.empty(levels[-1] * BLOCK, np.float32)
    for level, size in enumerate(sizes):
        _bound_level(
            topology.vertices,
            topology.faces,
            order,
            size,
            nodes[levels[level] * BLOCK : levels[level + 1] * BLOCK],
        )
    coarse = np.zeros(-(-len(order) // WIDTH) * CORNER_BLOCK, np.int16)
    _quantise(topology.vertices, topology.faces, order, nodes, coarse)
    bundles = FaceBundles(order, coarse, nodes, levels, np.zeros(0))
    return with_corners(bundles, topology) if corners else bundles


def with_corners(bundles: FaceBundles, topology: Topology) -> FaceBundles:
    """The same bundles with their corners in float64, which covering reads."""
    lanes = np.zeros(-(-len(bundles.order) // WIDTH) * CORNER_BLOCK)
    _copy_corners(topology.vertices, topology.faces, bundles.order, lanes)
    return bundles._replace(corners=lanes)


@njit(**PARALLEL)
def _bound_level(vertices, faces, order, size, nodes):
    n = len(order)
    for block in prange(len(nodes) // BLOCK):
        for lane in range(WIDTH):
            first = (block * WIDTH + lane) * size
            last = min(first + size, n)
            base = block * BLOCK + lane
            for axis in range(3):
                low, high = np.inf, -np.inf
                for k in range(first, last):
                    for c in range(3):
                        x = vertices[faces[order[k], c], axis]
                        low, high = min(low, x), max(high, x)
                if first >= last:
                    # Met by nothing.
                    nodes[base + (CENTRE + axis) * WIDTH] = 0.0
                    nodes[base + (HALF + axis) * WIDTH] = -1e30
                    continue
                middle = np.float32(0.5 * (low + high))
                nodes[base + (CENTRE + axis) * WIDTH] = middle
                nodes[base + (HALF + axis) * WIDTH] = max(high - middle, middle - low) * (1.0 + _UP) + _UP


@njit(**PARALLEL)
def _copy_corners(vertices, faces, order, corners):
    for i in prange(len(order)):
        a, b, c = faces[order[i], 0], faces[order[i], 1], faces[order[i], 2]
        low, high = min(a, b, c), max(a, b, c)
        base = (i // WIDTH) * CORNER_BLOCK + i % WIDTH
        for axis in range(3):
            corners[base + axis * WIDTH] = vertices[low, axis]
            corners[base + (3 + axis) * WIDTH] = vertices[a + b + c - low - high, axis]
            corners[base + (6 + axis) * WIDTH] = vertices[high, axis]


@njit(**PARALLEL)
def _quantise(vertices, faces, order, nodes, corners):
    for bundle in prange(len(corners) // CORNER_BLOCK):
        base = (bundle // WIDTH) * BLOCK + bundle % WIDTH
        widest = 0.0
        for axis in range(3):
            widest = max(widest, nodes[base + (HALF + axis) * WIDTH])
        scale = FULL_SCALE / widest
        for lane in range(min(WIDTH, len(order) - bundle * WIDTH)):
            f = order[bundle * WIDTH + lane]
            for c in range(3):
                for axis in range(3):
                    x = (vertices[faces[f, c], axis] - nodes[base + (CENTRE + axis) * WIDTH]) * scale
                    corners[bundle * CORNER_BLOCK + (3 * c + axis) * WIDTH + lane] = np.int16(np.rint(x))
