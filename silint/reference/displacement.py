"""Points as Embree needs them: off the surface by more than float32 can confuse."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from silint.validation import InputError, mesh_arrays, normals_array, points_array

__all__ = ["embree_points", "on_surface"]

FloatArray = npt.NDArray[np.float64]

# Share of the shortest local edge, and float32 units in the last place.
EDGE_SHARE = 1e-3
ULPS = 16.0

_CANDIDATES = 16
_CHUNK = 8192


def embree_points(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    face_ids: npt.ArrayLike | None = None,
) -> FloatArray:
    """Points moved along their normals, far enough for Embree, and rounded to float32.

    The distance is the greater of 1e-3 of the shortest edge of the nearest face, and 16 float32 units in
    the last place of the largest coordinate at hand (the point's, or the mesh's: Embree subtracts the
    ray's origin from the vertices of whole faces, however large they are). The same points go to
    silint, so that displacement is part of the question and not of the error.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
    faces : array_like of int, shape (F, 3)
    points, normals : array_like, shape (n, 3)
    face_ids : array_like of int, shape (n,), optional
        The face that each point lies on, where the caller knows it. Else the nearest of the 16 faces with
        the nearest centroids: near enough for a length that matters only by its order of magnitude.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        Each number exactly representable in float32.
    """
    positions, triangles, _ = mesh_arrays(vertices, faces)
    p, _ = points_array(points)
    n = normals_array(normals, len(p))
    corners = positions[triangles]
    if face_ids is None:
        nearest = _nearest_faces(corners, p)
    else:
        nearest = np.asarray(face_ids)
        if nearest.shape != (len(p),) or nearest.dtype.kind not in "iu":
            raise InputError(
                f"face_ids has shape {nearest.shape}, {nearest.dtype}; expected ({len(p)},) integers"
            )
        if len(nearest) and not (0 <= nearest.min() and nearest.max() < len(triangles)):
            raise InputError(f"face_ids must lie in 0..{len(triangles) - 1}")
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    # Edges of no length say nothing about scale; a face of nothing else leaves it to the other bound.
    shortest = np.where(edges > 0, edges, np.inf).min(axis=1)
    shortest = np.where(np.isfinite(shortest), shortest, 0.0)
    largest = np.maximum(np.abs(p).max(axis=1, initial=0.0), np.abs(positions).max())
    ulp = np.spacing(largest.astype(np.float32)).astype(np.float64)
    distance = np.maximum(EDGE_SHARE * shortest[nearest], ULPS * ulp)
    return (p + distance[:, None] * n).astype(np.float32).astype(np.float64)


def on_surface(
    vertices: FloatArray, faces: npt.NDArray[np.int32], points: FloatArray
) -> npt.NDArray[np.bool_]:
    """Displaced points that lie on a face all the same, to a few float32 units in the last place: (n,).

    A normal that runs within a neighbouring face does not lead off it. Which side of that face such a point
    sees is left to rounding, and rays from there hit it or do not as it falls.
    """
    corners = vertices[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = 0.25 * ULPS * np.spacing(np.abs(points).max(axis=1, initial=0.0).astype(np.float32))
    touching = np.zeros(len(points), bool)
    for i, (p, r) in enumerate(zip(points, near.astype(np.float64), strict=True)):
        beside = np.flatnonzero(((p >= low - r) & (p <= high + r)).all(axis=1))
        touching[i] = (_squared_distance(p, corners[beside]) < r * r).any()
    return touching


def _nearest_faces(corners: FloatArray, points: FloatArray) -> npt.NDArray[np.int64]:
    from scipy.spatial import cKDTree

    k = min(_CANDIDATES, len(corners))
    tree = cKDTree(corners.mean(axis=1))
    nearest = np.empty(len(points), np.int64)
    for start in range(0, len(points), _CHUNK):
        part = points[start : start + _CHUNK]
        _, ids = tree.query(part, k=[*range(1, k + 1)])
        distance = _squared_distance(part[:, None, :], corners[ids])
        nearest[start : start + len(part)] = ids[np.arange(len(part)), distance.argmin(axis=1)]
    return nearest


def _squared_distance(p: FloatArray, corners: FloatArray) -> FloatArray:
    """Points (..., 3) to triangles (..., 3, 3): to the plane if the foot is inside, else to the border."""
    following = np.roll(corners, -1, axis=-2)
    edge = following - corners
    to_point = p[..., None, :] - corners
    length2 = (edge**2).sum(axis=-1)
    t = np.clip((to_point * edge).sum(axis=-1) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    border = ((to_point - t[..., None] * edge) ** 2).sum(axis=-1).min(axis=-1)
    normal = np.cross(edge[..., 0, :], edge[..., 1, :])
    area2 = (normal**2).sum(axis=-1)
    inside = ((np.cross(edge, to_point) * normal[..., None, :]).sum(axis=-1) >= 0).all(axis=-1) & (area2 > 0)
    height = (to_point[..., 0, :] * normal).sum(axis=-1)
    return np.where(inside, height**2 / np.where(area2 > 0, area2, 1.0), border)
