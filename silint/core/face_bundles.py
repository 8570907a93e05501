"""Bundles of 16 faces under a tree with 16 children a node: what lies along an axis, or in front.

Nodes come in blocks of 16 siblings, field by field, as those of edge bundles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import PARALLEL
from silint.core.lanes import WIDTH
from silint.core.partition import aligned_order, level_blocks
from silint.core.topology import Topology

# Fields of a node: centre and half width of its box.
CENTRE, HALF, N_FIELDS = 0, 3, 6
BLOCK = N_FIELDS * WIDTH

# Fields of a face: its corners.
N_CORNERS = 9
CORNER_BLOCK = N_CORNERS * WIDTH
FULL_SCALE = 32767.0  # what an int16 of 1 means

_UP = 2.0**-22  # bounds are rounded up by this, relative to the scene


class FaceBundles(NamedTuple):
    """Faces in the order of the tree's leaves."""

    order: np.ndarray  # (F,) int32 faces of the topology
    corners: (
        np.ndarray
    )  # (bundles * CORNER_BLOCK,) int16, relative to the bundle's centre and longest half width
    nodes: np.ndarray  # (blocks * BLOCK,) float32, level by level, bundles first
    levels: np.ndarray  # (depth + 1,) int64: first block of each level


def build_face_bundles(topology: Topology) -> FaceBundles:
    """Group faces by the centres of their boxes."""
    corners = topology.vertices[topology.faces]
    order = aligned_order((0.5 * (corners.min(axis=1) + corners.max(axis=1))).astype(np.float32))
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
    corners = np.zeros(-(-len(order) // WIDTH) * CORNER_BLOCK, np.int16)
    _quantise(topology.vertices, topology.faces, order, nodes, corners)
    return FaceBundles(order, corners, nodes, levels)


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
                if first < last:
                    middle = np.float32(0.5 * (low + high))
                    half = np.float32(max(high - middle, middle - low) * (1.0 + _UP) + _UP)
                else:
                    middle, half = np.float32(0.0), np.float32(-1e30)  # met by nothing
                nodes[base + (CENTRE + axis) * WIDTH] = middle
                nodes[base + (HALF + axis) * WIDTH] = half


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
