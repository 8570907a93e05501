"""Which points belong together: smooth surfaces, and points that repeat each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from silint.core.scattered import SAME_SURFACE
from silint.validation import InputError, row_numbers

__all__ = ["SAME_NORMAL", "distinct_points", "face_surfaces", "in_order", "smooth_surfaces"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Cosine between the normals of points at one place that are one: as seams of textures have it.
SAME_NORMAL = float(np.cos(np.radians(1.0)))


def smooth_surfaces(points: FloatArray, normals: FloatArray, faces: npt.ArrayLike) -> IntArray:
    """The smooth surface that each point is on: joined by edges of triangles, up to creases.

    Edges join points whose normals differ by up to 30 degrees. Points at one place are joined if their
    normals agree within a degree: a seam of texture coordinates, not a crease.

    Parameters
    ----------
    points, normals : (n, 3) float64
        Unit normals.
    faces : array_like of int, shape (F, 3)

    Returns
    -------
    (n,) int64
        From 0.
    """
    rows = np.asarray(faces)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"faces has shape {rows.shape}; expected (F, 3), rows of points")
    rows = row_numbers(rows.ravel(), "faces", rows.size, len(points)).reshape(-1, 3)
    edges = np.concatenate([rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]])
    cosine = (normals[edges[:, 0]] * normals[edges[:, 1]]).sum(axis=1)
    edges = edges[cosine > SAME_SURFACE]
    # Neighbours in an order by place; of three and more copies those that agree follow each other by normal.
    order = np.lexsort((*normals.T, *points.T))
    a, b = order[:-1], order[1:]
    copies = (points[a] == points[b]).all(axis=1) & ((normals[a] * normals[b]).sum(axis=1) > SAME_NORMAL)
    ends = np.concatenate([edges, np.stack([a[copies], b[copies]], axis=1)])
    return _joined(len(points), ends)


def face_surfaces(
    welded: npt.NDArray[np.integer[Any]], normals: FloatArray, cosine: float = SAME_SURFACE
) -> IntArray:
    """The smooth surface that each face is on: joined across edges, up to creases.

    Parameters
    ----------
    welded : (F, 3) int
        Corners' vertices, one number a position.
    normals : (F, 3, 3) float64
        Unit normals of the corners.
    cosine : float
        Faces are joined where their normals at both ends of the edge are closer than this.

    Returns
    -------
    (F,) int64
        From 0.
    """
    corner = np.stack([[0, 1, 2], [1, 2, 0]], axis=1)
    ends = welded[:, corner].reshape(-1, 2).astype(np.int64)
    at_ends = normals[:, corner].reshape(-1, 2, 3)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], at_ends[turned] = ends[turned, ::-1], at_ends[turned, ::-1]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    a, b = order[:-1], order[1:]
    same = (ends[a] == ends[b]).all(axis=1) & ((at_ends[a] * at_ends[b]).sum(axis=2) > cosine).all(axis=1)
    return _joined(len(welded), np.stack([a[same] // 3, b[same] // 3], axis=1))


def _joined(n: int, edges: npt.NDArray[np.integer[Any]]) -> IntArray:
    """The component (n,) of each of n things under edges (E, 2), from 0."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), (n, n))
    label: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
    return label


def distinct_points(points: FloatArray, normals: FloatArray, label: IntArray) -> tuple[IntArray, IntArray]:
    """Rows of points that differ in place, normal or label, and which of them each point is.

    The order is by place, then normal: whatever the order of the points, it is the same.
    """
    keys = np.concatenate([points, normals, label[:, None]], axis=1) + 0.0  # no negative zeros
    order = np.argsort(keys[:, 0], kind="stable")
    # Most are told apart by their first coordinate alone; the rest are few to sort by all.
    same = np.zeros(len(order) + 1, bool)
    same[1:-1] = keys[order[1:], 0] == keys[order[:-1], 0]
    tied = np.flatnonzero(same[:-1] | same[1:])
    order[tied] = order[tied][np.lexsort(keys[order[tied]].T[::-1])]
    first = np.ones(len(order), bool)
    again = np.flatnonzero(same[1:-1]) + 1
    first[again] = (keys[order[again]] != keys[order[again - 1]]).any(axis=1)
    of_point = np.empty(len(order), np.int64)
    of_point[order] = np.cumsum(first) - 1
    return order[first], of_point


def in_order(label: IntArray) -> IntArray:
    """The same labels, numbered by their first appearance."""
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[inverse.ravel()])
