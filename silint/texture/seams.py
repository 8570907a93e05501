"""Both sides of a seam made to look alike.

A bilinear lookup on one side of a seam and the lookup at the same place of the mesh on the other side read
different texels, whose values differ by what the surface changes within a texel. Where the surface is smooth
both should give one value. With x the texels beside seams, x0 their values as baked, and A and B the bilinear
weights of samples along either side, x minimises

    |A x - B x|^2 + PULL |x - x0|^2

by conjugate gradients. All else keeps its value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.texture.charts import Seams

__all__ = ["SeamLookups", "equalised", "jumps", "seam_lookups"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Samples a texel of seam.
_DENSITY = 2.0
# Weight of a texel's own value: a jump falls to some thousandths, and nothing is moved without need.
_PULL = 1e-3
_STEPS = 200
# Values that leave their range are cut off, and the rest made to agree with them, this many times.
_ROUNDS = 8
_ENOUGH = 1e-6  # of the residual


class SeamLookups(NamedTuple):
    """Bilinear lookups at the same places of the mesh, on both sides of its seams."""

    texels: IntArray
    """(m,) rows of the covered texels that they read."""
    difference: Any
    """(n, m) sparse: left lookups less right ones."""


def seam_lookups(seams: Seams, row_of_texel: IntArray, size: int) -> SeamLookups:
    """The lookups along all seams.

    Parameters
    ----------
    seams : Seams
    row_of_texel : (size * size,) int64
        Row of each texel among the covered ones, -1 for those that are not.
    size : int
        Texels a side.

    Returns
    -------
    SeamLookups
    """
    from scipy.sparse import csr_matrix

    lengths = [np.linalg.norm(side[:, 1] - side[:, 0], axis=1) * size for side in (seams.left, seams.right)]
    counts = np.ceil(_DENSITY * np.maximum(*lengths)).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = ((place + 0.5) / counts[edge])[:, None]
    rows, columns, weights = [], [], []
    for side, sign in ((seams.left, 1.0), (seams.right, -1.0)):
        uv = (1.0 - t) * side[edge, 0] + t * side[edge, 1]
        read, weight = _bilinear(uv, size)
        rows.append(np.repeat(np.arange(len(edge)), 4))
        # Every texel that a lookup on a chart reads is covered, but for those that it weights by rounding.
        covered = row_of_texel[read] >= 0
        columns.append(np.where(covered, row_of_texel[read], 0).ravel())
        weights.append(sign * np.where(covered, weight, 0.0).ravel())
    column = np.concatenate(columns)
    texels, compact = np.unique(column, return_inverse=True)
    shape = (len(edge), len(texels))
    entries = (np.concatenate(weights), (np.concatenate(rows), compact.ravel()))
    return SeamLookups(texels, csr_matrix(entries, shape=shape))


def jumps(lookups: SeamLookups, values: FloatArray) -> FloatArray:
    """Differences (n,) between the two sides, in the component where it is largest.

    Parameters
    ----------
    lookups : SeamLookups
    values : (T, C) float64
        Of the covered texels.
    """
    between = np.abs(lookups.difference @ values[lookups.texels])
    return np.asarray(between.max(axis=1)) if len(between) else np.zeros(0)


def equalised(lookups: SeamLookups, values: FloatArray, positive: bool = False) -> FloatArray:
    """The values with those beside seams moved as little as makes both sides agree.

    Parameters
    ----------
    lookups : SeamLookups
    values : (T, C) float64
        Of the covered texels.
    positive : bool
        Whether they may neither fall below 0 nor rise above the largest of them.

    Returns
    -------
    (T, C) float64
    """
    out = values.copy()
    stops = np.zeros(values.shape[1])
    for _ in range(_ROUNDS if positive else 1):
        _add_least_change(lookups, out, stops)
        if positive:
            np.clip(out, 0.0, values.max(axis=0), out=out)
    return out


def _add_least_change(lookups: SeamLookups, out: FloatArray, stops: FloatArray) -> None:
    """Solve for each component of values (T, C), in place.

    Squared residuals (C,) at which to stop are those of the first call, which finds zeros.
    """
    d = lookups.difference
    transposed = d.T.tocsr()
    for c in range(out.shape[1]):
        # For the change y = x - x0: (D' D + PULL) y = -D' D x0.
        r = -(transposed @ (d @ out[lookups.texels, c]))
        y, p = np.zeros_like(r), r.copy()
        # Sums by NumPy, not BLAS: those of BLAS depend on the number of threads.
        old = float((r * r).sum())
        stops[c] = stops[c] or _ENOUGH**2 * old
        for _ in range(_STEPS):
            if old <= stops[c]:
                break
            q = transposed @ (d @ p) + _PULL * p
            step = old / float((p * q).sum())
            y += step * p
            r -= step * q
            new = float((r * r).sum())
            p = r + (new / old) * p
            old = new
        out[lookups.texels, c] += y


def _bilinear(uv: FloatArray, size: int) -> tuple[IntArray, FloatArray]:
    """Texels (n, 4) and weights (n, 4) of lookups that end at the texture's edges."""
    x, y = uv[:, 0] * size - 0.5, (1.0 - uv[:, 1]) * size - 0.5
    column, row = np.floor(x), np.floor(y)
    fx, fy = x - column, y - row
    columns = np.clip(np.stack([column, column + 1.0], axis=1), 0, size - 1).astype(np.int64)
    rows = np.clip(np.stack([row, row + 1.0], axis=1), 0, size - 1).astype(np.int64)
    texels = (rows[:, :, None] * size + columns[:, None, :]).reshape(-1, 4)
    across, down = np.stack([1.0 - fx, fx], axis=1), np.stack([1.0 - fy, fy], axis=1)
    return texels, (down[:, :, None] * across[:, None, :]).reshape(-1, 4)
