"""Seams and charts of texture coordinates.

Faces are of one chart if the edge between them has the same coordinates in both. Every other edge is part
of the border of its charts, and one with two faces is a *seam*: a place of the mesh at two places of the
texture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

__all__ = ["Charts", "InSquare", "Seams", "charts_of", "in_unit_square"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# How far coordinates may leave the square, by rounding: half a texel, which is no more than what a texel
# stands for, but neither less than float32 and text files need nor so much that it would be no rounding.
_BEYOND_TEXELS = 0.5
_BEYOND = (1e-5, 1e-3)

# Normals closer than this are one: corners with such are smooth, and faces flat.
_SAME_NORMAL = np.cos(np.radians(1.0))

# Folds sharper than this many degrees are hard edges, even where a file gives both sides one normal: what
# they see has little in common.
_FOLD = 60.0


class Seams(NamedTuple):
    """Seams across which the surface is smooth, so that both sides have to look alike."""

    left: FloatArray
    """(E, 2, 2) ends of an edge in UV, as one of its faces has them."""
    right: FloatArray
    """(E, 2, 2) the same ends as the other face has them."""
    n_sharp: int
    """Seams along hard edges, whose sides differ by right and are not among these."""


class Charts(NamedTuple):
    """What stands where in the texture."""

    of_face: npt.NDArray[np.int32]
    """(F,) chart of each face."""
    n_charts: int
    borders: IntArray
    """(B, 2) half-edges on the borders of charts: face, and corner that the half-edge starts from."""
    hard: npt.NDArray[np.bool_]
    """(F, 3) whether the half-edge from each corner is a border, or one at which the chart bends."""
    joined: IntArray
    """(J, 2) faces on the two sides of each edge within a chart."""
    across: npt.NDArray[np.int32]
    """(F, 3) the face on the other side of a half-edge on a smooth seam; -1 elsewhere."""
    seams: Seams


class InSquare(NamedTuple):
    """Coordinates in the unit square."""

    uvs: FloatArray
    """(F, 3, 2)"""
    shifted: int
    """Faces that were moved by whole squares."""
    clamped: int
    """Corners that lay beyond the square by more than float32's rounding."""


def in_unit_square(uvs: FloatArray, welded: IntArray, size: int) -> InSquare:
    """Coordinates moved into the unit square where that is sound.

    Charts that stand whole in another square of the integer grid, as where textures are repeated or come in
    tiles (UDIM), are moved by integers: a repeated texture shows the same. What is beyond the square by half
    a texel at most, and by 1e-3, is clamped.

    Parameters
    ----------
    uvs : (F, 3, 2) float64
    welded : (F, 3) int
        Corners' vertices, one number a position.
    size : int
        Texels a side.

    Returns
    -------
    InSquare

    Raises
    ------
    InputError
        They are not finite, or a chart lies across squares.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not np.isfinite(uvs).all():
        raise InputError("its texture coordinates are not finite")
    beyond = float(np.clip(_BEYOND_TEXELS / size, *_BEYOND))
    out = uvs
    if not _holds(uvs, beyond).all():
        # Faces that share a corner in the texture move together.
        corners = np.concatenate([welded.reshape(-1, 1), uvs.reshape(-1, 2)], axis=1)
        _, corner = np.unique(corners, axis=0, return_inverse=True)
        n = len(uvs)
        face = np.repeat(np.arange(n), 3)
        graph = coo_matrix((np.ones(3 * n, bool), (face, n + corner.ravel())), (n + 3 * n, n + 3 * n))
        label = np.unique(connected_components(graph, directed=False)[1][:n], return_inverse=True)[1].ravel()
        low, high = np.full((label.max() + 1, 2), np.inf), np.full((label.max() + 1, 2), -np.inf)
        np.minimum.at(low, label, uvs.min(axis=1))
        np.maximum.at(high, label, uvs.max(axis=1))
        inside = _holds(np.stack([low, high], axis=1), beyond)
        shift = np.where(inside[:, None], 0.0, np.floor(0.5 * (low + high)))
        out = uvs - shift[label][:, None]
        if not _holds(out, beyond).all():
            low, high = uvs.min(axis=(0, 1)), uvs.max(axis=(0, 1))
            spans = " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(low, high, strict=True))
            raise InputError(f"its texture coordinates span {spans}, beyond the [0, 1] of one texture")
    clamped = np.clip(out, 0.0, 1.0)
    return InSquare(
        clamped,
        int((out != uvs).any(axis=(1, 2)).sum()),
        int((np.abs(clamped - out).max(axis=2) > _BEYOND[0]).sum()),
    )


def _holds(uvs: FloatArray, beyond: float) -> npt.NDArray[np.bool_]:
    """Whether the unit square holds all (n, k, 2) of each row, up to `beyond`."""
    return np.asarray(((uvs >= -beyond) & (uvs <= 1.0 + beyond)).all(axis=(1, 2)))


def charts_of(
    uvs: FloatArray,
    welded: IntArray,
    normals: FloatArray,
    flat: FloatArray,
    usable: npt.NDArray[np.bool_],
) -> Charts:
    """Charts and seams.

    Parameters
    ----------
    uvs : (F, 3, 2) float64
    welded : (F, 3) int
        Corners' vertices, one number a position.
    normals : (F, 3, 3) float64
        Shading normals of the corners, unit.
    flat : (F, 3) float64
        Unit normals of the faces.
    usable : (F,) bool
        Faces that count.

    Returns
    -------
    Charts

    Raises
    ------
    InputError
        No face counts.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    faces = np.flatnonzero(usable)
    if not len(faces):
        raise InputError("has no face with an area both in space and in its texture coordinates")
    face = np.repeat(faces, 3)
    start = np.tile(np.arange(3), len(faces))
    ends = np.stack([start, (start + 1) % 3], axis=1)
    vertices = welded[face[:, None], ends]
    # Either end first, so that the half-edges of an edge have the same key.
    ends = np.where((vertices[:, 0] > vertices[:, 1])[:, None], ends[:, ::-1], ends)
    vertices = np.sort(vertices, axis=1)
    order = np.lexsort((vertices[:, 1], vertices[:, 0]))
    keys = vertices[order]
    new = np.ones(len(order), bool)
    new[1:] = (keys[1:] != keys[:-1]).any(axis=1)
    runs = np.flatnonzero(new)
    lengths = np.diff(np.append(runs, len(order)))

    # Edges with exactly two faces; those with more have no two that belong together.
    a, b = order[runs[lengths == 2]], order[runs[lengths == 2] + 1]
    uv = uvs[face[:, None], ends]
    same = (uv[a] == uv[b]).all(axis=(1, 2))
    pairs = np.stack([face[a[same]], face[b[same]]], axis=1)
    joined = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), (len(uvs), len(uvs)))
    _, label = connected_components(joined, directed=False)
    _, numbered = np.unique(label[faces], return_inverse=True)
    of_face = np.full(len(uvs), -1, np.int32)
    of_face[faces] = numbered.ravel()

    inner = np.zeros(len(face), bool)
    inner[a[same]] = inner[b[same]] = True
    borders = np.stack([face[~inner], start[~inner]], axis=1)
    flush = (flat[face[a]] * flat[face[b]]).sum(axis=1) > _SAME_NORMAL
    hard = np.ones((len(uvs), 3), bool)
    for h in (a[same & flush], b[same & flush]):
        hard[face[h], start[h]] = False

    a, b = a[~same], b[~same]
    n = normals[face[:, None], ends]
    smooth = ((n[a] * n[b]).sum(axis=2) > _SAME_NORMAL).all(axis=1)
    smooth &= (flat[face[a]] * flat[face[b]]).sum(axis=1) > np.cos(np.radians(_FOLD))
    across = np.full((len(uvs), 3), -1, np.int32)
    a, b = a[smooth], b[smooth]
    across[face[a], start[a]], across[face[b], start[b]] = face[b], face[a]
    seams = Seams(uv[a], uv[b], int((~smooth).sum()))
    return Charts(of_face, int(numbered.max()) + 1, borders, hard, pairs, across, seams)
