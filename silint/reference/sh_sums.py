"""Spherical harmonics summed over rays, by recurrences of its own.

Real, orthonormal, no Condon-Shortley phase, (l, m) at l (l + 1) + m (silint.core.conventions): with
P(l, m) the associated Legendre function over sin^m(theta), normalised,

    Y(l, m) = P(l, |m|)(z) times Re (x + iy)^m for m >= 0, Im (x + iy)^|m| for m < 0
    P(l, m) = a z P(l-1, m) - b P(l-2, m),   a^2 = (4 l^2 - 1) / (l^2 - m^2),
                                             b^2 = a^2 ((l-1)^2 - m^2) / (4 (l-1)^2 - 1)   [DLMF 14.10.3]
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

__all__ = ["recurrence", "sum_harmonics"]

# Rays that are evaluated together, lane by lane: 10 ns a ray at degree 4, against 24 ns with 16 lanes.
_LANES = 64


def recurrence(degree: int) -> npt.NDArray[np.float64]:
    """Factors of the recurrences: (L + 1, L + 1, 2), a and b at (l, m); P(m, m) in place of b at (m, m)."""
    out = np.zeros((degree + 1, degree + 1, 2))
    for m in range(degree + 1):
        # (2m - 1)!!^2 / (2m)!, and once 2 for cosine and sine.
        ratio = math.prod((2 * k - 1) / (2 * k) for k in range(1, m + 1))
        out[m, m, 1] = math.sqrt((1 if m == 0 else 2) * (2 * m + 1) * ratio / (4 * math.pi))
        for l in range(m + 1, degree + 1):  # noqa: E741
            a2 = (4 * l * l - 1) / (l * l - m * m)
            out[l, m] = math.sqrt(a2), math.sqrt(a2 * ((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def sum_harmonics(hits, directions, factors, out):
    """Sums of all Y over the rays that met nothing, for each of len(out) points: out (n, (L + 1)^2)."""
    m = len(hits) // len(out)
    sums = np.empty((out.shape[1], _LANES))
    w = np.empty((4, _LANES))  # x, y, z, and 1 where there is a ray
    work = np.empty((4, _LANES))
    for i in range(len(out)):
        sums[:] = 0.0
        lane = 0
        w[:] = 0.0
        for k in range(i * m, (i + 1) * m):
            if hits[k] < 0:
                w[0, lane], w[1, lane], w[2, lane] = directions[k, 0], directions[k, 1], directions[k, 2]
                w[3, lane] = 1.0
                lane += 1
                if lane == _LANES:
                    _add_lanes(w, factors, work, sums)
                    lane = 0
                    w[3] = 0.0
        if lane:
            _add_lanes(w, factors, work, sums)
        for coefficient in range(out.shape[1]):
            out[i, coefficient] = sums[coefficient].sum()


@njit(cache=True, nogil=True, error_model="numpy")
def _add_lanes(w, factors, work, sums):
    """Add the harmonics of as many directions to sums (C, lanes); work is (4, lanes)."""
    degree = len(factors) - 1
    x, y, z = w[0], w[1], w[2]
    re, im, one, two = work[0], work[1], work[2], work[3]
    re[:] = w[3]
    im[:] = 0.0
    for m in range(degree + 1):
        one[:] = factors[m, m, 1]
        two[:] = 0.0
        for l in range(m, degree + 1):  # noqa: E741
            if l > m:
                a, b = factors[l, m, 0], factors[l, m, 1]
                for j in range(_LANES):
                    p = a * z[j] * one[j] - b * two[j]
                    two[j] = one[j]
                    one[j] = p
            cosine, sine = sums[l * (l + 1) + m], sums[l * (l + 1) - m]
            for j in range(_LANES):
                cosine[j] += one[j] * re[j]
            if m > 0:
                for j in range(_LANES):
                    sine[j] += one[j] * im[j]
        for j in range(_LANES):
            t = re[j] * x[j] - im[j] * y[j]
            im[j] = re[j] * y[j] + im[j] * x[j]
            re[j] = t
