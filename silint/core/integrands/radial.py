"""Closed forms along radial isolines: what an interval of keys contributes.

On the half-plane phi about the axis A a direction is w = cos(theta) A + sin(theta) t with t = cos(phi) T +
sin(phi) M, and dw = sin(theta) dtheta dphi. With y = cot(theta) all integrals over theta are algebraic in y
and r = 1 / sqrt(1 + y^2) = sin(theta), but for the angle itself in the cosine-weighted one, which is there
only because A is not quite the normal.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, PARALLEL
from silint.core.radial import horizon_key, set_frame

UNIFORM, COSINE = 0, 1


@njit(**INNER)
def _primitive(y, na, nt, weighting):
    """Integral from the zenith down to key y: of n.w sin(theta) for COSINE, of sin(theta) for UNIFORM."""
    square = 1.0 / (1.0 + y * y)
    if weighting == UNIFORM:
        # 1 - cos(theta), without cancelling near the zenith.
        r = np.sqrt(square)
        return r * r / (1.0 + y * r) if y > 0.0 else 1.0 - y * r
    return 0.5 * (na * square + nt * (0.5 * np.pi - np.arctan(y) - y * square))


@njit(**PARALLEL)
def radial_fraction(normals, lines, counts, starts, intervals, weighting, out):
    """Sums over lines of the integrals over visible intervals and over the whole line, even and odd lines apart.

    Parameters
    ----------
    normals : (n, 3) float64
    lines : (K, 2) float64
    counts : (n, K) int32
    starts : (n,) int64
        First row of each point's intervals.
    intervals : (m, 2) float64
    weighting : int
        COSINE or UNIFORM.
    out : (n, 4) float64, out
        Visible and whole of the even lines, of the odd lines.
    """
    for i in prange(len(normals)):
        frame = np.empty((3, 3))
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        set_frame(n, frame)
        nt0 = n[0] * frame[0, 0] + n[1] * frame[0, 1] + n[2] * frame[0, 2]
        nm0 = n[0] * frame[1, 0] + n[1] * frame[1, 1] + n[2] * frame[1, 2]
        na = n[0] * frame[2, 0] + n[1] * frame[2, 1] + n[2] * frame[2, 2]
        row = starts[i]
        for j in range(4):
            out[i, j] = 0.0
        for k in range(len(lines)):
            nt = nt0 * lines[k, 0] + nm0 * lines[k, 1]
            whole = _primitive(horizon_key(n, frame, lines[k, 0], lines[k, 1]), na, nt, weighting)
            seen = 0.0
            for _ in range(counts[i, k]):
                seen += _primitive(intervals[row, 1], na, nt, weighting)
                if intervals[row, 0] < np.inf:
                    seen -= _primitive(intervals[row, 0], na, nt, weighting)
                row += 1
            out[i, 2 * (k % 2)] += seen
            out[i, 2 * (k % 2) + 1] += whole
