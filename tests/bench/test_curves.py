"""Equal-error times: interpolated between settings, bounded beyond them."""

from __future__ import annotations

import math

import pytest

from silint.bench.curves import Bounded, pays_after, power_law, speedup, time_at_error


def test_between_settings_on_logarithms() -> None:
    times, errors = [1.0, 100.0], [1e-2, 1e-4]
    found = time_at_error(times, errors, 1e-3)
    assert found is not None
    assert found.bound == "" and found.value == pytest.approx(10.0)
    assert time_at_error(times, errors, 1e-4) == Bounded(100.0, "")


def test_never_beyond_them() -> None:
    times, errors = [1.0, 100.0], [1e-2, 1e-4]
    assert time_at_error(times, errors, 9e-5) == Bounded(100.0, ">")
    assert time_at_error(times, errors, 2e-2) == Bounded(1.0, "<")
    assert time_at_error([], [], 1e-3) is None


def test_the_cheapest_of_several_ways() -> None:
    # The second setting is slower than the third, and no better than needed.
    found = time_at_error([1.0, 30.0, 10.0], [1e-1, 1e-2, 1e-3], 5e-3)
    assert found == Bounded(10.0, "")
    # Errors need not fall: the first crossing counts.
    found = time_at_error([1.0, 10.0, 100.0, 1000.0], [1e-1, 1e-3, 1e-1, 1e-4], 1e-2)
    assert found is not None
    assert found.value == pytest.approx(10**0.5)


def test_no_error_at_all_is_below_every_level() -> None:
    assert time_at_error([1.0, 10.0], [1e-2, 0.0], 1e-9) == Bounded(10.0, "")


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        (Bounded(2.0, ""), Bounded(6.0, ""), Bounded(3.0, "")),
        (Bounded(2.0, ""), Bounded(6.0, ">"), Bounded(3.0, ">")),
        (Bounded(2.0, "<"), Bounded(6.0, ""), Bounded(3.0, ">")),
        (Bounded(2.0, "<"), Bounded(6.0, ">"), Bounded(3.0, ">")),
        (Bounded(2.0, ">"), Bounded(6.0, ""), Bounded(3.0, "<")),
        (Bounded(2.0, ""), Bounded(6.0, "<"), Bounded(3.0, "<")),
        (Bounded(2.0, "<"), Bounded(6.0, "<"), None),
        (Bounded(2.0, ">"), Bounded(6.0, ">"), None),
        (None, Bounded(6.0, ""), None),
    ],
)
def test_speedup_keeps_what_the_bounds_allow(
    ours: Bounded | None, theirs: Bounded | None, expected: Bounded | None
) -> None:
    assert speedup(ours, theirs) == expected


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        (Bounded(20.0, ""), Bounded(120.0, ""), Bounded(20_000.0, "")),
        (Bounded(20.0, ""), Bounded(120.0, ">"), Bounded(20_000.0, "<")),
        (Bounded(20.0, ">"), Bounded(120.0, ""), Bounded(20_000.0, ">")),
        (Bounded(120.0, ""), Bounded(20.0, ""), Bounded(math.inf, "")),
        (Bounded(120.0, ""), Bounded(20.0, ">"), None),
        (Bounded(20.0, "<"), Bounded(120.0, "<"), None),
        (None, Bounded(120.0, ""), None),
    ],
)
def test_building_pays(ours: Bounded | None, theirs: Bounded | None, expected: Bounded | None) -> None:
    """Two seconds of building against 100 us saved a point."""
    assert pays_after(2.0, ours, theirs) == expected


def test_a_power_law_is_found_again() -> None:
    sizes = [9e3, 3e4, 2e6]
    assert power_law(sizes, [5.0 * n**0.4 for n in sizes]) == pytest.approx((5.0, 0.4))
