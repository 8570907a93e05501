"""The oracle for half-planes: every face against every half-plane through a point, in plain NumPy.

A half-plane is bounded by an axis through the point and holds the directions cos(theta) axis + sin(theta) t
with 0 <= theta <= pi. A triangle meets its plane in a segment, and hides the range of theta that this segment
spans. What lies above the horizon of the normal and in no such range is visible. Nothing here is shared with
silint/core: half-planes are handed in as vectors, and no edge knows its neighbours.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["count_along", "difference", "visible_ranges"]

FloatArray = npt.NDArray[np.float64]


def visible_ranges(
    corners: FloatArray, point: FloatArray, normal: FloatArray, axis: FloatArray, sides: FloatArray
) -> list[FloatArray]:
    """Visible ranges of theta on half-planes through one point.

    Parameters
    ----------
    corners : ndarray, shape (F, 3, 3)
        Of each triangle.
    point, normal : ndarray, shape (3,)
        Displaced already; a unit normal.
    axis : ndarray, shape (3,)
        The edge of all half-planes, of unit length.
    sides : ndarray, shape (K, 3)
        The unit vector t of each, square to the axis.

    Returns
    -------
    list of ndarray, shape (m, 2)
        For each half-plane, sorted and apart.
    """
    across = np.cross(axis, sides)
    x, y, z = (np.moveaxis((corners - point) @ v.T, -1, 0) for v in (sides, across, axis[None]))
    z = np.broadcast_to(z, x.shape)
    low, high = _hidden(x, y, z)
    ends = np.arctan2(normal @ axis, -(sides @ normal))
    return [_uncovered(low[k], high[k], ends[k]) for k in range(len(sides))]


def _hidden(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Range of theta that each triangle (last axis: corners) hides in the half-plane y = 0, x >= 0."""
    ahead = y >= 0.0
    ends_x, ends_z = np.full(x.shape, np.nan), np.full(x.shape, np.nan)
    for i in range(3):
        j = (i + 1) % 3
        cut = ahead[..., i] != ahead[..., j]
        # From the end ahead to the other, so that two triangles cut their common edge in the same place.
        a, b = np.where(ahead[..., i], i, j)[..., None], np.where(ahead[..., i], j, i)[..., None]
        ya, yb = (np.take_along_axis(y, c, -1)[..., 0] for c in (a, b))
        t = np.where(cut, ya, 0.0) / np.where(cut, ya - yb, 1.0)
        for values, ends in ((x, ends_x), (z, ends_z)):
            va, vb = (np.take_along_axis(values, c, -1)[..., 0] for c in (a, b))
            ends[..., i] = np.where(cut, va + t * (vb - va), np.nan)
    n_cuts = (~np.isnan(ends_x)).sum(axis=-1)
    # Two of the three sides are cut, or none: bring the two to the front.
    order = np.argsort(np.isnan(ends_x), axis=-1, kind="stable")[..., :2]
    px, qx = np.moveaxis(np.take_along_axis(ends_x, order, -1), -1, 0)
    pz, qz = np.moveaxis(np.take_along_axis(ends_z, order, -1), -1, 0)
    theta = np.arctan2(np.stack([px, qx]), np.stack([pz, qz]))
    front = np.stack([px, qx]) >= 0.0
    low = np.where(front, theta, np.inf).min(axis=0)
    high = np.where(front, theta, -np.inf).max(axis=0)
    # Where the segment leaves the half-plane it does so through the axis: at the top or at the bottom.
    leaves = front[0] != front[1]
    height = pz + np.where(leaves, px, 0.0) / np.where(leaves, px - qx, 1.0) * (qz - pz)
    with np.errstate(invalid="ignore"):
        above = height > 0.0
    low = np.where(leaves & above, 0.0, low)
    high = np.where(leaves & ~above, np.pi, high)
    hides = (n_cuts == 2) & front.any(axis=0)
    return np.where(hides, low, np.inf), np.where(hides, high, -np.inf)


def _uncovered(low: FloatArray, high: FloatArray, end: float) -> FloatArray:
    """What of [0, end] lies in no [low, high]."""
    hides = low <= high
    order = np.argsort(low[hides])
    low, high = low[hides][order], np.maximum.accumulate(high[hides][order])
    starts = np.concatenate([[0.0], high])
    stops = np.minimum(np.concatenate([low, [end]]), end)
    seen = stops > starts
    return np.column_stack([starts[seen], stops[seen]])


def difference(a: FloatArray, b: FloatArray) -> float:
    """Length of what lies in one union of disjoint ranges and not in the other."""
    cuts = np.unique(np.concatenate([a.ravel(), b.ravel()]))
    middle = 0.5 * (cuts[1:] + cuts[:-1])
    in_a, in_b = (
        ((r[:, :1] < middle) & (middle < r[:, 1:])).any(axis=0) if len(r) else np.zeros(len(middle), bool)
        for r in (a, b)
    )
    return float(np.diff(cuts)[in_a != in_b].sum())


def count_along(corners: FloatArray, point: FloatArray, axis: FloatArray) -> int:
    """Number of triangles that the half-line from a point meets [Moeller and Trumbore 1997]."""
    a, b, c = (corners - point).transpose(1, 0, 2)
    e, f = b - a, c - a
    h = np.cross(axis, f)
    det = (e * h).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        u = -(a * h).sum(axis=1) / det
        q = np.cross(-a, e)
        v = (q @ axis) / det
        t = (f * q).sum(axis=1) / det
    return int(((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (det != 0)).sum())
