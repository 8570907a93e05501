"""Shading normals at the corners of faces, tangents, and normal maps.

*Normals.* A file's own are taken as they are. Else each corner gets the angle-weighted mean [TW98] of the
faces that reach it over edges bent by less than `CREASE`: a ball is smooth, a box has flat sides.

*Tangents* as in MikkTSpace [Mikk08]: along growing u in the plane of the corner's normal, the angle-weighted
mean over the corners that share position, normal, texture coordinates and handedness. They and the normals
are interpolated linearly and made orthonormal where they are used: n unit, t unit and orthogonal to n,
bitangent b = s n x t with s = +-1 by the sign of the face's area in the texture. (Mikkelsen's own decoder
leaves both at their interpolated lengths, and groups corners by edges, not by position: the two agree on flat
faces.)

*Normal maps* hold (x, y, z) as 2 c - 1 with c in [0, 1], no sRGB curve; x t + y b + z n, at unit length, is
the shading normal. "Green up" (OpenGL) has y along growing v, "down" (DirectX) against it.

References
----------
Mikk08
    Mikkelsen 2008, Simulation of wrinkled surfaces revisited (master's thesis, Copenhagen).
TW98
    Thuermer and Wuethrich 1998, Computing vertex normals from polygonal facets.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.io.images import read_image
from silint.validation import InputError

__all__ = [
    "CREASE",
    "Tangents",
    "corner_normals",
    "corner_tangents",
    "face_normals",
    "frames",
    "read_normal_map",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Edges bent by more than this many degrees are hard where a file has no normals of its own.
CREASE = 40.0


class Tangents(NamedTuple):
    """Of the corners of all faces."""

    tangent: FloatArray
    """(F, 3, 3) unit, orthogonal to the corner's normal."""
    sign: FloatArray
    """(F,) +1 where the texture shows the face as seen from the front, -1 where mirrored."""


def face_normals(corners: FloatArray) -> FloatArray:
    """Unit normals (F, 3) of triangles (F, 3, 3), zero for those without area."""
    size = np.abs(corners - corners[:, :1]).max(axis=(1, 2))[:, None]
    edge = corners[:, 1:] - corners[:, :1]
    edge = np.divide(edge, size[:, None], out=np.zeros_like(edge), where=size[:, None] > 0.0)
    return _unit(np.cross(edge[:, 0], edge[:, 1]))


def corner_normals(
    corners: FloatArray,
    welded: IntArray,
    flat: FloatArray,
    own: FloatArray | None,
    crease: float = CREASE,
) -> FloatArray:
    """Shading normals.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        Positions.
    welded : (F, 3) int
        Their vertices, one number a position.
    flat : (F, 3) float64
        Unit normals of the faces.
    own : (F, 3, 3) float64 or None
        The file's, of any length; zero ones are replaced by those of the faces.
    crease : float
        Without `own`: edges bent by more than this many degrees are hard.

    Returns
    -------
    (F, 3, 3) float64
        Unit, or zero where a face has no area either.
    """
    whole = np.broadcast_to(flat[:, None], corners.shape)
    if own is not None:
        unit = _unit(np.where(np.isfinite(own), own, 0.0))
        return np.where(unit.any(axis=2, keepdims=True), unit, whole)
    weights = _corner_angles(corners)
    group = _smoothing_groups(welded, flat, crease)
    total = _sums(group, (weights[..., None] * whole).reshape(-1, 3))[group].reshape(corners.shape)
    # Opposite faces cancel to rounding; what is left then is no direction.
    length = np.linalg.norm(total, axis=2, keepdims=True)
    return np.where(length > 1e-9, _unit(total), whole)


def corner_tangents(corners: FloatArray, uvs: FloatArray, welded: IntArray, normals: FloatArray) -> Tangents:
    """Tangents of the corners of all faces (see the module's head).

    Parameters
    ----------
    corners, normals : (F, 3, 3) float64
    uvs : (F, 3, 2) float64
    welded : (F, 3) int

    Returns
    -------
    Tangents
    """
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d1, d2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    sign = np.where(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0] < 0.0, -1.0, 1.0)
    # dp/du up to a positive factor.
    along = _unit((d2[:, 1:] * e1 - d1[:, 1:] * e2) * sign[:, None])
    projected = _orthogonal(np.broadcast_to(along[:, None], normals.shape), normals)
    weights = _corner_angles(corners)
    keys = np.concatenate(
        [
            welded.reshape(-1, 1),
            uvs.reshape(-1, 2),
            np.round(normals.reshape(-1, 3), 6),
            np.repeat(sign, 3)[:, None],
        ],
        axis=1,
    )
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = group.ravel()
    total = _sums(group, (weights[..., None] * projected).reshape(-1, 3))[group].reshape(normals.shape)
    tangent = _unit(total)
    tangent = np.where(tangent.any(axis=2, keepdims=True), tangent, _any_orthogonal(normals))
    return Tangents(tangent, sign)


def frames(normals: FloatArray, tangents: FloatArray, sign: FloatArray) -> FloatArray:
    """Rows t, b, n (m, 3, 3) of orthonormal frames from interpolated normals and tangents (m, 3)."""
    n = _unit(normals)
    t = _orthogonal(tangents, n)
    t = np.where(t.any(axis=1, keepdims=True), t, _any_orthogonal(n))
    return np.stack([t, sign[:, None] * np.cross(n, t), n], axis=1)


def read_normal_map(path: str | os.PathLike[str], green: str) -> FloatArray:
    """A normal map as vectors (H, W, 3), y along growing v, the top row first.

    Parameters
    ----------
    path : str or path-like
        .png or .jpg (taken without the sRGB curve), or .exr with the same values in [0, 1].
    green : {"up", "down"}
        Which way its second channel points.

    Raises
    ------
    InputError
        It cannot be read, or is a grey picture.
    """
    file = Path(path)
    if file.suffix.lower() in (".png", ".jpg", ".jpeg"):
        read_image(file)  # for what it says of bad files
        from PIL import Image

        with warnings.catch_warnings(), Image.open(file) as image:
            warnings.simplefilter("ignore")
            grey = image.mode.startswith(("I", "L", "1", "F"))
            pixels = np.asarray(image.convert("RGB"), dtype=np.float64) / 255.0
    else:
        pixels = np.asarray(read_image(file).pixels, dtype=np.float64)
        grey = pixels.shape[2] == 1
    if grey:
        raise InputError(f"{file}: is grey; expected a normal map, with three channels")
    vectors = 2.0 * pixels - 1.0
    if green == "down":
        vectors[..., 1] *= -1.0
    return vectors


def _smoothing_groups(welded: IntArray, flat: FloatArray, crease: float) -> IntArray:
    """(3 F,) for each corner, the group of corners at its position that soft edges join."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n_faces = len(welded)
    face = np.repeat(np.arange(n_faces), 3)
    ends = np.stack([np.arange(3 * n_faces), 3 * face + (np.arange(3 * n_faces) + 1) % 3], axis=1)
    vertices = welded.ravel()[ends]
    ends = np.where((vertices[:, 0] > vertices[:, 1])[:, None], ends[:, ::-1], ends)
    vertices = np.sort(vertices, axis=1)
    order = np.lexsort((vertices[:, 1], vertices[:, 0]))
    keys = vertices[order]
    # Fans of more than two faces are joined neighbour by neighbour, each only where it is soft.
    a, b = order[:-1], order[1:]
    together = (keys[1:] == keys[:-1]).all(axis=1)
    together &= (flat[face[a]] * flat[face[b]]).sum(axis=1) > np.cos(np.radians(crease))
    pairs = np.concatenate([np.stack([ends[a, i], ends[b, i]], axis=1)[together] for i in range(2)])
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (3 * n_faces, 3 * n_faces))
    group: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
    return group


def _corner_angles(corners: FloatArray) -> FloatArray:
    """(F, 3)."""
    angles = np.empty(corners.shape[:2])
    for i in range(3):
        a = _unit(corners[:, (i + 1) % 3] - corners[:, i])
        b = _unit(corners[:, (i + 2) % 3] - corners[:, i])
        angles[:, i] = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
    return angles


def _sums(group: IntArray, rows: FloatArray) -> FloatArray:
    return np.stack([np.bincount(group, rows[:, i]) for i in range(rows.shape[1])], axis=1)


def _orthogonal(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Unit vectors: the part that is orthogonal to unit normals; zero where there is none."""
    rest = vectors - (vectors * normals).sum(axis=-1, keepdims=True) * normals
    return _unit(np.where(np.linalg.norm(rest, axis=-1, keepdims=True) > 1e-12, rest, 0.0))


def _any_orthogonal(normals: FloatArray) -> FloatArray:
    """Some unit vectors orthogonal to unit normals."""
    axis = np.where(np.abs(normals[..., :1]) < 0.6, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    return _unit(np.cross(normals, axis))


def _unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors, zero where there is no direction; safe for any magnitude."""
    size = np.abs(vectors).max(axis=-1, keepdims=True)
    scaled = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    unit: FloatArray = np.divide(scaled, length, out=scaled, where=length > 0.0)
    return unit
