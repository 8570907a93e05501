"""Growing and sorting the kernels' scratch arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from silint.core.buffers import SHORT, grow, sort_pairs


@pytest.mark.nojit
def test_grow_keeps_what_was_there() -> None:
    grown = grow(np.arange(3.0), 7)
    assert len(grown) == 7 and grown.dtype == np.float64
    np.testing.assert_array_equal(grown[:3], [0, 1, 2])


def check_sorted(keys: np.ndarray, first: int, last: int) -> None:
    key, value = keys.copy(), np.arange(len(keys), dtype=np.float64)
    sort_pairs(key, value, first, last)
    np.testing.assert_array_equal(key[first:last], np.sort(keys[first:last]))
    # Values travel with their keys, and nothing beyond the range moves.
    np.testing.assert_array_equal(keys[value.astype(int)], key)
    assert sorted(value[first:last].tolist()) == list(range(first, last))
    assert value[:first].tolist() == list(range(first))


@pytest.mark.parametrize("n", [0, 1, 2, SHORT, SHORT + 1, 1000, 5000])
@pytest.mark.parametrize("order", ["random", "sorted", "reversed", "equal", "two values", "organ pipe"])
def test_sort_pairs(n: int, order: str) -> None:
    keys = {
        "random": np.random.default_rng(n).random(n),
        "sorted": np.arange(n, dtype=np.float64),
        "reversed": np.arange(n, dtype=np.float64)[::-1].copy(),
        "equal": np.full(n, 0.5),
        "two values": (np.arange(n) % 2).astype(np.float64),
        "organ pipe": np.minimum(np.arange(n), np.arange(n)[::-1]).astype(np.float64),
    }[order]
    check_sorted(keys, 0, n)
    check_sorted(keys, n // 3, n - n // 5)


@settings(max_examples=50)
@given(st.lists(st.floats(allow_nan=False), max_size=80))
def test_sort_pairs_of_any_keys(keys: list[float]) -> None:
    check_sorted(np.array(keys, np.float64), 0, len(keys))
