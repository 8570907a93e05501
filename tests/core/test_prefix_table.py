"""Prefix tables: totals of the sphere, any interval, and functions whose integral is known."""

from __future__ import annotations

import numpy as np
import pytest

import silint
from silint import InputError, Visibility
from silint.core.prefix_table import build_prefix_table, integrate_intervals, loop_points
from silint.core.runs import horizon_runs
from silint.reference import strip_cells

# Sums of some thousand terms of one sign in double precision.
SUM_ROUNDING = 1e-13


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def loops(isolines: int, n: int = 1, start: float = 0.0) -> Visibility:
    """All of the sphere as one interval a line, from anywhere on the loop."""
    intervals = np.tile([start, start + 4.0], (n * isolines, 1))
    return Visibility(units(n), isolines, np.arange(n * isolines + 1), intervals)


@pytest.mark.nojit
@pytest.mark.parametrize("isolines", [1, 2, 3, 8, 33])
@pytest.mark.parametrize("start", [0.0, 0.37, 3.999])
def test_a_constant_over_the_sphere_is_four_pi(isolines: int, start: float) -> None:
    # Three Gauss points in each of 64 cells a quarter: their error, of order 64^-6, is below rounding.
    table = silint.prefix_table(lambda w: np.ones(len(w)), isolines, nodes_per_quarter=64)
    np.testing.assert_allclose(
        loops(isolines, start=start).integrate(table), 4 * np.pi, rtol=SUM_ROUNDING, atol=0
    )


@pytest.mark.nojit
def test_moments_over_the_sphere() -> None:
    # w integrates to 0 and w w^T to 4 pi / 3, on the lines' strips too, which fill the sphere.
    table = silint.prefix_table(lambda w: np.column_stack([w, w**2, w[:, :1] * w[:, 1:2]]), 7, 64)
    found = loops(7).integrate(table)[0]
    np.testing.assert_allclose(
        found, [0, 0, 0, *[4 * np.pi / 3] * 3, 0], rtol=0, atol=4 * np.pi * SUM_ROUNDING
    )


@pytest.mark.parametrize("isolines", [1, 4, 9, 64])
def test_prefix_sums_of_a_linear_function_at_any_place(isolines: int) -> None:
    """Against the cells' closed form [Lambert], for intervals that begin and end anywhere and wrap."""
    rng = np.random.default_rng(3)
    n = 6
    normals = units(n, 1)
    intervals = rng.random((n * isolines, 1)) * 4
    intervals = np.concatenate([intervals, intervals + rng.random((n * isolines, 1)) * 4], axis=1)
    offsets = np.arange(n * isolines + 1)
    visible = Visibility(normals, isolines, offsets, intervals)
    # The oracle cuts intervals where they wrap.
    wraps = intervals[:, 1] > 4
    pieces = np.stack([intervals, np.zeros_like(intervals)], axis=1)
    pieces[wraps, 1] = np.stack([0 * intervals[wraps, 1], intervals[wraps, 1] - 4], axis=1)
    pieces[wraps, 0, 1] = 4
    keep = np.stack([np.ones_like(wraps), wraps], axis=1)
    cut_offsets = np.concatenate([[0], np.cumsum(keep.sum(axis=1))])
    for moment, function in ((0, lambda w: np.ones((len(w), 1))), (1, lambda w: w)):
        found = visible.integrate(silint.prefix_table(function, isolines))
        found = found[:, 0] if moment == 0 else (found * normals).sum(axis=1)
        exact = strip_cells.first_moments(cut_offsets, pieces[keep], isolines, normals, moment)
        # Cubic pieces between 256 nodes a quarter: h^4 / 384 times a fourth derivative below 1e3.
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_intervals_add_up() -> None:
    rng = np.random.default_rng(4)
    table = build_prefix_table(lambda w: np.column_stack([np.exp(w[:, 0]), w[:, 1] ** 3]), 5, 32)
    a, b, c = np.sort(rng.random((3, 10)) * 4, axis=0)
    lines = np.arange(10) % 5

    def integral(start: np.ndarray, end: np.ndarray) -> np.ndarray:
        out = []
        for k, s, e in zip(lines, start, end, strict=True):
            offsets = np.where(np.arange(6) > k, 1, 0)
            out.append(integrate_intervals(table.values, 32, offsets, np.array([[s, e]]), 5)[0].sum(axis=0))
        return np.array(out)

    np.testing.assert_allclose(integral(a, b) + integral(b, c), integral(a, c), rtol=0, atol=SUM_ROUNDING)
    # Once round from anywhere is once round from 0.
    np.testing.assert_allclose(integral(a, a + 4), integral(0 * a, 0 * a + 4), rtol=0, atol=SUM_ROUNDING)


def test_even_and_odd_isolines_are_kept_apart() -> None:
    table = build_prefix_table(lambda w: np.ones((len(w), 1)), 4, 16)
    offsets = np.array([0, 1, 1, 1, 2])  # lines 0 and 3
    halves = integrate_intervals(table.values, 16, offsets, np.array([[0.0, 4.0], [0.0, 4.0]]), 4)[0, :, 0]
    # Lines 0 and 3 are mirror images, and one is even and one odd.
    assert halves[0] == pytest.approx(halves[1], rel=SUM_ROUNDING)
    assert 0 < halves[0] < 2 * np.pi


@pytest.mark.nojit
def test_loop_points_follow_the_conventions() -> None:
    found = loop_points(np.full(5, 0.25), np.array([0, 1, 2, 3, 0.5]))
    np.testing.assert_array_equal(
        found,
        [(0.25, 0.75, 0), (0.25, 0, 0.75), (0.25, -0.75, 0), (0.25, 0, -0.75), (0.25, 0.375, 0.375)],
    )
    assert (np.abs(loop_points(np.linspace(-1, 1, 7)[:, None], np.linspace(0, 4, 9))).sum(axis=-1) == 1).all()


def test_the_open_hemisphere_of_any_function() -> None:
    # exp(w.a) above the horizon n = a: 2 pi int_0^1 exp(t) dt. The lines end at the horizon, which they
    # follow as well as their number allows: midpoints of strips, an error of order K^-2.
    n = units(4, 5)
    errors = []
    for isolines in (32, 128):
        visible = Visibility(n, isolines, *horizon_runs(n, isolines))
        found = visible.integrate(lambda w: np.exp(w @ n.T))
        errors.append(np.abs(np.diag(found) - 2 * np.pi * (np.e - 1)).max())
    assert errors[0] < 2e-2
    assert errors[1] < errors[0] / 6


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (lambda w: np.ones(len(w) + 1), "function returned shape"),
        (lambda w: np.ones((len(w), 2, 2)), "function returned shape"),
        (3.0, "basis is a float"),
    ],
)
def test_functions_that_cannot_be_tabulated(bad: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        loops(4).integrate(bad)
    assert "\n" not in str(caught.value)


def test_a_table_of_other_isolines_is_refused() -> None:
    with pytest.raises(InputError, match="table has 8 isolines; this visibility has 4"):
        loops(4).integrate(silint.prefix_table(lambda w: w, 8, 4))
