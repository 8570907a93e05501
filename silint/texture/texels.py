"""Texels to shade points.

Every texel that a bilinear lookup on a chart can read has a value of its own: that of the point of the chart
that is nearest to the texel's centre, or, with the centre just beyond a seam of a smooth surface, of the
point of the surface that lies there (`across_seams`). Where a texel's square holds an edge - the border of
its chart while the centre is inside, or faces that meet at more than `BEND` degrees - one point says too
little: then it is the mean over several positions in the square, each moved to the nearest point of the
chart.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import uv_cover
from silint.texture.charts import Charts

__all__ = ["BEND", "MAX_SAMPLES", "Texels", "across_seams", "find_texels", "sample_offsets"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Faces that meet in a texel at more than this many degrees make it a mixed one.
BEND = 15.0
MAX_SAMPLES = 64

# Texels off the edge, for points on it; see `uv_cover.locate`.
_INSET = 0.05
# Texels, with room for what the stretch of neighbours adds to the 2.8 of a footprint's diagonal.
_REACH = 5.0
# Tests in one call into a kernel: some tenths of a second, so that Ctrl-C is heard.
_TESTS = 4_000_000


class Texels(NamedTuple):
    """The covered texels, and the samples of each."""

    texel: IntArray
    """(T,) of a covered texel: row * size + column, ascending."""
    face: npt.NDArray[np.int32]
    """(T,) of the point nearest to the centre."""
    weights: FloatArray
    """(T, 3) barycentric coordinates of that point."""
    outside: IntArray
    """Rows of those whose centre lies outside all charts."""
    offsets: IntArray
    """(T + 1,) where each texel's samples begin."""
    sample_face: npt.NDArray[np.int32]
    """(m,)"""
    sample_weights: FloatArray
    """(m, 3)"""
    inside: int
    """Texels whose centre lies in a chart."""
    overlapping: int
    """Those of them whose centre lies in several faces."""
    mixed: int
    """Those with several samples."""
    shared: int
    """Covered texels whose footprint meets a second chart, or its own beyond a slit: of the lookups that read
    them, some want another place."""
    rivals: npt.NDArray[np.int32]
    """(r, 2) face that a shared texel belongs to, and one of those that compete with it."""

    def means(self, values: FloatArray) -> FloatArray:
        """Values (T, C) of texels from those of samples (m, C)."""
        sums = np.add.reduceat(values, self.offsets[:-1], axis=0)
        return np.asarray(sums / np.diff(self.offsets)[:, None])


def find_texels(
    uvs: FloatArray, positions: FloatArray, charts: Charts, flat: FloatArray, size: int, samples: int
) -> Texels:
    """The covered texels of a texture.

    Parameters
    ----------
    uvs : (F, 3, 2) float64
        In the unit square, v upwards.
    positions : (F, 3, 3) float64
    charts : Charts
        Faces without a chart are left out.
    flat : (F, 3) float64
        Unit normals of the faces.
    size : int
        Texels a side.
    samples : int
        Positions in a mixed texel.

    Returns
    -------
    Texels
    """
    used = np.flatnonzero(charts.of_face >= 0).astype(np.int32)
    corners = np.ascontiguousarray(_in_texels(uvs[used], size))
    chart, hard = charts.of_face[used], charts.hard[used]
    shape = (size, size)
    owner, distance = np.full(shape, -1, np.int32), np.full(shape, np.inf)
    held = np.zeros(shape, np.uint8)
    for first, last in _parts(corners):
        uv_cover.cover(corners, first, last, owner, distance, held)

    mixed, rival = np.zeros(shape, bool), np.full(shape, -1, np.int32)
    cosine = float(np.cos(np.radians(BEND)))
    normals, places = np.ascontiguousarray(flat[used]), np.ascontiguousarray(positions[used])
    reach = _REACH * _stretch(corners, places)
    for first, last in _parts(corners):
        uv_cover.mark(corners, places, reach, chart, normals, cosine, first, last, owner, mixed, rival)
    ends = np.stack([charts.borders[:, 1], (charts.borders[:, 1] + 1) % 3], axis=1)
    segments = np.ascontiguousarray(_in_texels(uvs[charts.borders[:, :1], ends], size))
    border_chart = charts.of_face[charts.borders[:, 0]]
    for first, last in _parts(segments):
        uv_cover.mark_borders(segments, chart, first, last, border_chart, owner, distance, mixed)
    if samples == 1:
        mixed[:] = False

    index = np.flatnonzero(owner.ravel() >= 0)
    of_index = np.flatnonzero(mixed.ravel()[index])  # rows of the mixed ones among the covered
    centres = _centres(index, size)
    face = owner.ravel()[index]
    weights = np.empty((len(index), 3))
    uv_cover.locate(corners, hard, face, centres, _INSET, weights)

    offsets = sample_offsets(samples)
    sample_owner = np.repeat(face[of_index][:, None], samples, axis=1)
    sample_distance = np.full(sample_owner.shape, np.inf)
    slot = np.full(shape, -1, np.int32)
    slot.ravel()[index[of_index]] = np.arange(len(of_index))
    for first, last in _parts(corners):
        uv_cover.cover_samples(
            corners, chart, offsets, first, last, owner, slot, sample_owner, sample_distance
        )

    shared = rival >= 0
    pairs = np.unique(np.stack([owner[shared], rival[shared]], axis=1), axis=0)
    counts = np.ones(len(index), np.int64)
    counts[of_index] = samples
    starts = np.concatenate([[0], np.cumsum(counts)])
    sample_face = np.repeat(face, counts)
    positions = np.repeat(centres, counts, axis=0)
    where = (starts[of_index][:, None] + np.arange(samples)).ravel()
    sample_face[where] = sample_owner.ravel()
    positions[where] += np.tile(offsets, (len(of_index), 1))
    sample_weights = np.empty((len(sample_face), 3))
    uv_cover.locate(corners, hard, sample_face, positions, _INSET, sample_weights)
    return Texels(
        index,
        used[face],
        weights,
        np.flatnonzero(distance.ravel()[index] > 0.0),
        starts,
        used[sample_face],
        sample_weights,
        int((held > 0).sum()),
        int((held > 1).sum()),
        len(of_index),
        int(shared.sum()),
        used[pairs],
    )


def across_seams(texels: Texels, charts: Charts, positions: FloatArray, uvs: FloatArray, size: int) -> Texels:
    """Texels outside charts, beside smooth seams, moved to where they lie on the mesh beyond the seam.

    The nearest point of the chart would do to within half a texel. The chart continued in its face's plane,
    and from there to the nearest point of the face on the other side of the seam, does to second order:
    lookups on both sides of the seam then read the same part of the surface.

    Parameters
    ----------
    texels : Texels
    charts : Charts
    positions : (F, 3, 3) float64
        Corners of the faces.
    uvs : (F, 3, 2) float64
    size : int

    Returns
    -------
    Texels
    """
    rows = texels.outside
    face, corners = texels.face[rows], _in_texels(uvs[texels.face[rows]], size)
    to = _centres(texels.texel[rows], size) - corners[:, 0]
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]
    b = (to[:, 0] * e2[:, 1] - to[:, 1] * e2[:, 0]) / area
    c = (e1[:, 0] * to[:, 1] - e1[:, 1] * to[:, 0]) / area
    beyond = np.stack([1.0 - b - c, b, c], axis=1)
    # The edge that the point lies beyond is the one across from the corner of the least weight; beyond two of
    # them it lies beside a corner, where the nearest point has to do.
    edge = (beyond.argmin(axis=1) + 1) % 3
    other = charts.across[face, edge]
    keep = (other >= 0) & ((beyond < 0.0).sum(axis=1) == 1)
    keep &= np.diff(texels.offsets)[rows] == 1  # a fold that ends here matters more than half a texel
    rows, face, other, beyond = rows[keep], face[keep], other[keep], beyond[keep]
    place = np.einsum("mi,mid->md", beyond, positions[face])
    weights = _nearest_weights(positions[other], place)
    sample_face, sample_weights = texels.sample_face.copy(), texels.sample_weights.copy()
    sample_face[texels.offsets[rows]] = other
    sample_weights[texels.offsets[rows]] = weights
    return texels._replace(sample_face=sample_face, sample_weights=sample_weights)


def _nearest_weights(triangles: FloatArray, points: FloatArray) -> FloatArray:
    """(m, 3) barycentric coordinates of the points of triangles (m, 3, 3) nearest to points (m, 3).

    Kept a thousandth of the triangle off its edges.
    """
    e1, e2 = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    to = points - triangles[:, 0]
    d11, d12, d22 = (e1 * e1).sum(1), (e1 * e2).sum(1), (e2 * e2).sum(1)
    t1, t2 = (to * e1).sum(1), (to * e2).sum(1)
    determinant = d11 * d22 - d12 * d12
    with np.errstate(divide="ignore", invalid="ignore"):
        b, c = (d22 * t1 - d12 * t2) / determinant, (d11 * t2 - d12 * t1) / determinant
    best = np.stack([1.0 - b - c, b, c], axis=1)
    inside = np.isfinite(best).all(axis=1) & (best >= 0.0).all(axis=1)
    distance = np.where(inside, 0.0, np.inf)  # in the plane; off it all candidates have the same
    for i in range(3):
        j = (i + 1) % 3
        along = triangles[:, j] - triangles[:, i]
        t = ((points - triangles[:, i]) * along).sum(1) / np.maximum((along * along).sum(1), 1e-300)
        t = np.clip(t, 0.0, 1.0)
        off = points - triangles[:, i] - t[:, None] * along
        square = (off * off).sum(1)
        nearer = square < distance
        distance = np.where(nearer, square, distance)
        candidate = np.zeros_like(best)
        candidate[:, i], candidate[:, j] = 1.0 - t, t
        best[nearer] = candidate[nearer]
    kept: FloatArray = best + 3e-3 * (1.0 / 3.0 - best)
    return kept


def sample_offsets(n: int) -> FloatArray:
    """Positions (n, 2) in a texel, from its centre: Hammersley's, moved so that their mean is the centre.

    Four of them have four different rows and columns, so that an edge along an axis has five shades.
    """
    i = np.arange(n)
    down, scale, rest = np.zeros(n), 0.5, i.copy()
    while rest.any():
        down += scale * (rest % 2)
        rest //= 2
        scale *= 0.5
    places = np.stack([(i + 0.5) / n, down], axis=1)
    centred: FloatArray = places - places.mean(axis=0)
    return centred


def _stretch(corners: FloatArray, places: FloatArray) -> FloatArray:
    """(F,) the largest length in space of a texel along the edges and heights of triangles."""
    length = [np.linalg.norm(np.roll(a, -1, axis=1) - a, axis=2) for a in (corners, places)]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    area_in_space = np.linalg.norm(np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]), axis=1)
    along = np.divide(length[1], length[0], out=np.zeros_like(length[0]), where=length[0] > 0.0)
    height = [np.divide(s, x.max(axis=1)) for s, x in ((area, length[0]), (area_in_space, length[1]))]
    across = np.divide(height[1], height[0], out=np.zeros_like(area), where=height[0] > 0.0)
    return np.asarray(np.maximum(along.max(axis=1), across))


def _in_texels(uvs: FloatArray, size: int) -> FloatArray:
    return np.stack([uvs[..., 0] * size, (1.0 - uvs[..., 1]) * size], axis=-1)


def _centres(index: IntArray, size: int) -> FloatArray:
    row, column = np.divmod(index, size)
    return np.stack([column + 0.5, row + 0.5], axis=1)


def _parts(corners: FloatArray) -> Iterator[tuple[int, int]]:
    """Rows to be handed to a kernel at a time: about equal numbers of texels in their bounding boxes."""
    if not len(corners):
        return
    tests = (corners.max(axis=1) - corners.min(axis=1) + 3.0).prod(axis=1)
    group = (np.cumsum(tests) // _TESTS).astype(np.int64)
    cuts = [0, *(np.flatnonzero(np.diff(group)) + 1).tolist(), len(corners)]
    yield from pairwise(cuts)
