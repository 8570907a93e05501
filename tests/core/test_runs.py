"""Runs above a horizon and what a second horizon leaves of intervals, against membership by definition."""

from __future__ import annotations

import numpy as np
import pytest

from silint.core.prefix_table import loop_points
from silint.core.runs import clip_intervals, horizon_runs

AXES = np.concatenate([np.eye(3), -np.eye(3)])


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def holds(offsets: np.ndarray, intervals: np.ndarray, line: int, v: np.ndarray) -> np.ndarray:
    """Whether loop coordinates lie in the intervals of a line."""
    inside = np.zeros(len(v), bool)
    for start, end in intervals[offsets[line] : offsets[line + 1]]:
        inside |= ((v >= start) & (v <= end)) | (v + 4 <= end)
    return inside


@pytest.mark.nojit
@pytest.mark.parametrize("isolines", [1, 2, 7, 8])
def test_runs_are_what_is_above_the_horizon(isolines: int) -> None:
    normals = np.concatenate([AXES, units(6), [(0, 2**-0.5, 2**-0.5), (2**-0.5, 0, -(2**-0.5))]])
    offsets, intervals = horizon_runs(normals, isolines)
    assert (np.diff(offsets) <= 1).all()  # one run, whatever the normal
    assert (intervals[:, 0] >= 0).all() and (intervals[:, 0] < 4).all()
    assert (intervals[:, 1] > intervals[:, 0]).all() and (np.diff(intervals) <= 4 + 1e-15).all()
    v = (np.arange(200) + 0.5) / 50
    for i, n in enumerate(normals):
        for k in range(isolines):
            height = loop_points(np.float64((2 * k + 1 - isolines) / isolines), v) @ n
            clear = np.abs(height) > 1e-12  # on the horizon itself either answer is right
            above = holds(offsets, intervals, i * isolines + k, v)
            np.testing.assert_array_equal(above[clear], (height > 0)[clear])


@pytest.mark.nojit
@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0), (1, 0, 0), (-0.3, 0.5, 0.2)])
def test_clipping_keeps_what_both_horizons_leave(up: tuple[float, float, float]) -> None:
    isolines = 5
    axis = np.array(up, np.float64) / np.linalg.norm(up)
    normals = np.concatenate([AXES, units(5, 2)])
    both_offsets, both = clip_intervals(*horizon_runs(normals, isolines), axis, isolines)
    assert (both[:, 0] >= 0).all() and (both[:, 0] < 4).all() and (both[:, 1] > both[:, 0]).all()
    v = (np.arange(200) + 0.5) / 50
    for i, n in enumerate(normals):
        for k in range(isolines):
            points = loop_points(np.float64((2 * k + 1 - isolines) / isolines), v)
            height = np.minimum(points @ n, points @ axis)
            clear = np.abs(height) > 1e-12
            inside = holds(both_offsets, both, i * isolines + k, v)
            np.testing.assert_array_equal(inside[clear], (height > 0)[clear])


def test_clipping_cuts_intervals_that_wrap() -> None:
    # One line at u = 0: the run of up = +z is [0, 2], that of an interval across v = 0 is cut at both.
    offsets, intervals = np.array([0, 2]), np.array([[3.5, 4.5], [1.5, 3.0]])
    new_offsets, new = clip_intervals(offsets, intervals, np.array([0.0, 0.0, 1.0]), 1)
    np.testing.assert_array_equal(new_offsets, [0, 2])
    np.testing.assert_array_equal(sorted(new.tolist()), [[0.0, 0.5], [1.5, 2.0]])
    # An interval of almost the whole loop meets a run twice.
    new_offsets, new = clip_intervals(np.array([0, 1]), np.array([[1.0, 4.75]]), np.array([0.0, 0.0, 1.0]), 1)
    np.testing.assert_array_equal(new_offsets, [0, 2])
    np.testing.assert_array_equal(sorted(new.tolist()), [[0.0, 0.75], [1.0, 2.0]])
