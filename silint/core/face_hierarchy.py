"""Boxes over faces: which faces a line through the shade point meets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import PARALLEL
from silint.core.partition import balanced_order, node_range
from silint.core.topology import Topology


class FaceHierarchy(NamedTuple):
    """Faces in leaf order under a complete binary tree (see `partition`)."""

    order: np.ndarray  # (F,) int32 faces of the topology
    boxes: np.ndarray  # (2^(depth + 1) - 1, 6) float64: centre, half width
    depth: int


def build_face_hierarchy(topology: Topology) -> FaceHierarchy:
    """Group faces by their centroids."""
    keys = topology.vertices[topology.faces].mean(axis=1).astype(np.float32)
    order, depth = balanced_order(keys)
    boxes = np.empty((2 ** (depth + 1) - 1, 6))
    for level in range(depth + 1):
        _bound_level(topology.vertices, topology.faces, order, level, boxes)
    return FaceHierarchy(order, boxes, depth)


@njit(**PARALLEL)
def _bound_level(vertices, faces, order, level, boxes):
    n = len(order)
    for j in prange(1 << level):
        first, last = node_range(n, level, j)
        row = boxes[(1 << level) - 1 + j]
        for i in range(3):
            low, high = np.inf, -np.inf
            for k in range(first, last):
                for c in range(3):
                    x = vertices[faces[order[k], c], i]
                    low = min(low, x)
                    high = max(high, x)
            row[i] = 0.5 * (low + high) if last > first else 0.0
            row[3 + i] = 0.5 * (high - low) if last > first else 0.0
