"""Intervals that need no scene: the runs of isolines above a horizon, and clipping intervals by a plane."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.isolines import horizon_reach, start_corner
from silint.core.jit import INNER, KERNEL


@njit(**INNER)
def _run(n, k, n_lines):
    """Loop coordinates of the run of isoline k above the horizon of n; start < 0 for none."""
    corner = start_corner(n)
    left, right = horizon_reach(n, corner, k, n_lines)
    if left < 0.0:
        return -1.0, -1.0
    start = corner - left
    start = start + 4.0 if start < 0.0 else start
    return start, start + (left + right)


@njit(**KERNEL)
def horizon_runs(normals, n_lines):
    """The unoccluded hemisphere, in the form of visible intervals: offsets (n K + 1,), intervals (m, 2)."""
    n = len(normals)
    offsets = np.zeros(n * n_lines + 1, np.int64)
    intervals = np.empty((n * n_lines, 2))
    count = 0
    for i in range(n):
        for k in range(n_lines):
            start, end = _run((normals[i, 0], normals[i, 1], normals[i, 2]), k, n_lines)
            if start >= 0.0:
                intervals[count, 0], intervals[count, 1] = start, end
                count += 1
            offsets[i * n_lines + k + 1] = count
    return offsets, intervals[:count]


@njit(**INNER)
def _clip(t0, t1, run0, run1, out, n_out):
    """Append the overlap of two intervals on a loop of length 4; both start in [0, 4) and may run past it."""
    for turn in range(-1, 2):
        low = max(t0, run0 + 4.0 * turn)
        high = min(t1, run1 + 4.0 * turn)
        if low < high:
            out[n_out, 0], out[n_out, 1] = (low, high) if low < 4.0 else (low - 4.0, high - 4.0)
            n_out += 1
    return n_out


@njit(**KERNEL)
def clip_intervals(offsets, intervals, up, n_lines):
    """What remains of intervals above the horizon of one direction."""
    n = (len(offsets) - 1) // n_lines
    new_offsets = np.zeros_like(offsets)
    # Two arcs of a loop overlap in two pieces at most.
    out = np.empty((2 * len(intervals), 2))
    n_out = 0
    for k_of_point in range(n * n_lines):
        run0, run1 = _run((up[0], up[1], up[2]), k_of_point % n_lines, n_lines)
        if run0 >= 0.0:
            for j in range(offsets[k_of_point], offsets[k_of_point + 1]):
                n_out = _clip(intervals[j, 0], intervals[j, 1], run0, run1, out, n_out)
        new_offsets[k_of_point + 1] = n_out
    return new_offsets, out[:n_out].copy()
