"""SH transfer on octahedral isolines, by prefix sums of the harmonics.

One table serves all normals: n.w Y_lm are harmonics one degree further (core.sh.coupling). What the isolines
miss of an open hemisphere is given back in the proportion that is open, so that an open sky is exact and a
closed room exactly 0.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numba import njit, prange

from silint.core.integrands.fractions import Intervals
from silint.core.jit import PARALLEL
from silint.core.prefix_table import PrefixTable, build_prefix_table, integrate_intervals
from silint.core.runs import horizon_runs
from silint.core.sh import contract, coupling, harmonics, moment_degree, open_hemisphere

# The error of all lines per distance of what their even and odd halves say, all coefficients together. At a
# rate of lines^-1.5 a half errs 2.8 times as much. Calibrated such that the estimate holds for 95 % of points
# (benchmarks/estimates.py).
ERROR_OF_HALVES = 0.6

# What a table of harmonics may take.
TABLE_BYTES = 2**31

# Moments of all points at once would outgrow their intervals: bytes to be held at a time.
_CHUNK_BYTES = 2**26


def nodes_per_quarter(max_degree: int) -> int:
    """Nodes on each side of an isoline: at least 12 for every degree.

    A harmonic turns at most 2 l times as fast as the loop coordinate, and cubic Hermite pieces of length h
    err by h^4 / 384 times the fourth derivative: below 1e-6 of the whole sphere.
    """
    return max(32, 2 ** int(np.ceil(np.log2(12 * max(max_degree, 1)))))


def table_bytes(max_degree: int, isolines: int) -> int:
    """Size of the table of all harmonics up to a degree."""
    return isolines * (4 * nodes_per_quarter(max_degree) + 1) * 2 * (max_degree + 1) ** 2 * 8


def most_isolines(max_degree: int, weighting: str) -> int:
    """How many isolines, a power of two, a transfer of some degree may take for its table's sake."""
    degree = moment_degree(max_degree, weighting)
    return 1 << (TABLE_BYTES // table_bytes(degree, 1)).bit_length() - 1


@lru_cache(maxsize=4)
def sh_table(max_degree: int, isolines: int) -> PrefixTable:
    """Prefix sums of all Y_lm up to a degree, in the order of core.sh."""
    table = build_prefix_table(lambda w: harmonics(w, max_degree), isolines, nodes_per_quarter(max_degree))
    table.values.setflags(write=False)
    return table


def sh_transfer(
    normals: np.ndarray, visible: Intervals, isolines: int, max_degree: int, weighting: str
) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) Y dw for "cosine", int V Y dw over the hemisphere of n for "uniform".

    Returns
    -------
    value : (n, (L + 1)^2) float64
    error_estimate : (n,) float64
        Of the square root of the sum of the squared errors of all coefficients.
    """

    def moments(intervals: Intervals) -> np.ndarray:
        return _moments(intervals, isolines, max_degree, weighting)[:, :, None]

    value, estimate = masked_transfer(normals, visible, isolines, max_degree, weighting, moments, 1)
    return value[..., 0], ERROR_OF_HALVES * estimate


def masked_transfer(
    normals: np.ndarray,
    visible: Intervals,
    isolines: int,
    max_degree: int,
    weighting: str,
    moments: Callable[[Intervals], np.ndarray],
    n_channels: int,
) -> tuple[np.ndarray, np.ndarray]:
    """The same of Y times the light of C channels, whose `moments` over intervals are given.

    What the isolines miss of an open hemisphere is given back as dark as what is seen is on average.

    Parameters
    ----------
    moments : callable
        Intervals -> (n, 2, C, (M + 1)^2) with M = `moment_degree`, even and odd isolines apart.

    Returns
    -------
    value : (n, (L + 1)^2, C) float64
    error_estimate : (n,) float64
        Of the channel in which it is largest.
    """
    value = np.empty((len(normals), (max_degree + 1) ** 2, n_channels))
    estimate = np.empty(len(normals))
    step = max(_CHUNK_BYTES // (32 * n_channels * (max_degree + 2) ** 2), 1)
    for first in range(0, len(normals), step):
        part = slice(first, first + step)
        some = np.ascontiguousarray(normals[part])
        offsets = visible[0][first * isolines : (first + len(some)) * isolines + 1]
        seen = moments((offsets, visible[1]))
        whole = _transfer(some, horizon_runs(some, isolines), isolines, max_degree, weighting)
        exact = open_hemisphere(some, max_degree, weighting)
        worst = np.zeros(len(some))
        for c in range(n_channels):
            light = _weighted(some, np.ascontiguousarray(seen[:, :, c]), max_degree, weighting)
            # Both halves together, then each by itself.
            value[part, :, c] = _given_back(light.sum(axis=1), whole.sum(axis=1), exact)
            even, odd = (_given_back(2.0 * light[:, h], 2.0 * whole[:, h], exact) for h in (0, 1))
            worst = np.maximum(worst, np.sqrt(((even - odd) ** 2).sum(axis=1)))
        estimate[part] = worst
    return value, estimate


def _transfer(
    normals: np.ndarray, intervals: Intervals, isolines: int, max_degree: int, weighting: str
) -> np.ndarray:
    """Transfer over intervals, even and odd isolines apart: (n, 2, (L + 1)^2)."""
    return _weighted(normals, _moments(intervals, isolines, max_degree, weighting), max_degree, weighting)


def _moments(intervals: Intervals, isolines: int, max_degree: int, weighting: str) -> np.ndarray:
    """Harmonics over intervals, even and odd isolines apart: (n, 2, (M + 1)^2)."""
    table = sh_table(moment_degree(max_degree, weighting), isolines)
    return integrate_intervals(table.values, table.nodes_per_quarter, *intervals, isolines)


def _weighted(normals: np.ndarray, moments: np.ndarray, max_degree: int, weighting: str) -> np.ndarray:
    """Transfer from moments (n, 2, (M + 1)^2): (n, 2, (L + 1)^2)."""
    if weighting == "uniform":
        return moments
    out = np.empty((len(normals), 2, (max_degree + 1) ** 2))
    _contract_halves(*coupling(max_degree), normals, moments, out)
    return out / np.pi


@njit(**PARALLEL)
def _contract_halves(offsets, columns, axes, weights, normals, moments, out):
    for i in prange(len(normals)):
        for half in range(2):
            contract(offsets, columns, axes, weights, normals[i], moments[i, half], out[i, half])


def _given_back(seen: np.ndarray, whole: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """What is seen, and of what the isolines miss the part that degree 0 says is open, or lit."""
    share = np.divide(seen[:, 0], whole[:, 0], out=np.zeros(len(seen)), where=whole[:, 0] > 0.0)
    return seen + share[:, None] * (exact - whole)
