"""Trees without pointers: the one builder behind all hierarchies, and behind tiles of shade points.

Items are put in an order in which every aligned run of 16 * 2^i of them belongs together. Sixteen items make
a bundle, sixteen bundles a node of the next level, and so on: node j of a level holds the items from j *
size on. Every level is partitioned in parallel.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, PARALLEL
from silint.core.lanes import WIDTH


@njit(**INNER)
def _select(keys, items, lo, hi, k, axis):
    """Rearrange [lo, hi) so that item k has its sorted place along axis (Hoare's quickselect)."""
    width = keys.shape[1]
    while hi - lo > 1:
        a, b, c = keys[lo, axis], keys[(lo + hi) >> 1, axis], keys[hi - 1, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = lo, hi - 1
        while i <= j:
            while keys[i, axis] < pivot:
                i += 1
            while keys[j, axis] > pivot:
                j -= 1
            if i <= j:
                for d in range(width):
                    keys[i, d], keys[j, d] = keys[j, d], keys[i, d]
                items[i], items[j] = items[j], items[i]
                i += 1
                j -= 1
        if k <= j:
            hi = j + 1
        elif k >= i:
            lo = i
        else:
            return


@njit(**PARALLEL)
def _split_aligned(keys, items, size):
    """Split every run of `size` items in halves, along the axis in which its keys spread the most."""
    n, width = keys.shape
    for j in prange((n + size - 1) // size):
        lo, hi = j * size, min((j + 1) * size, n)
        middle = lo + size // 2
        if middle >= hi:
            continue
        best, spread = 0, -1.0
        for d in range(width):
            low, high = np.inf, -np.inf
            for i in range(lo, hi):
                low = min(low, keys[i, d])
                high = max(high, keys[i, d])
            if high - low > spread:
                best, spread = d, high - low
        _select(keys, items, lo, hi, middle, best)


def aligned_order(keys: np.ndarray, leaf: int = WIDTH) -> np.ndarray:
    """Order of items such that every aligned run of leaf * 2**i of them belongs together.

    Runs are full but for the last, so that a tree of any width over them needs no pointers.

    Parameters
    ----------
    keys : (n, d) float32
        What to keep together; overwritten.
    """
    items = np.arange(len(keys), dtype=np.int32)
    size = leaf
    while size < len(keys):
        size *= 2
    while size > leaf:
        _split_aligned(keys, items, size)
        size //= 2
    return items


# Columns of the sort keys of boxes: lowest corner, highest corner, centre, diameter.
_LOW, _HIGH, _N_KEYS = 0, 3, 10


@njit(**INNER)
def _nth(values, k):
    """The value that would stand at k if they were sorted; reorders them (Hoare's quickselect)."""
    lo, hi = 0, len(values)
    while hi - lo > 1:
        a, b, c = values[lo], values[(lo + hi) >> 1], values[hi - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = lo, hi - 1
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            hi = j + 1
        elif k >= i:
            lo = i
        else:
            break
    return values[k]


@njit(**INNER)
def _half_cost(keys, lo, hi, column, pivot, sign):
    """Surface area of the box about the items whose key is not beyond a pivot, times two."""
    x0, y0, z0 = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    x1, y1, z1 = -x0, -y0, -z0
    for i in range(lo, hi):
        if sign * (keys[i, column] - pivot) <= 0.0:
            x0, x1 = min(x0, keys[i, _LOW]), max(x1, keys[i, _HIGH])
            y0, y1 = min(y0, keys[i, _LOW + 1]), max(y1, keys[i, _HIGH + 1])
            z0, z1 = min(z0, keys[i, _LOW + 2]), max(z1, keys[i, _HIGH + 2])
    x, y, z = np.float64(x1) - x0, np.float64(y1) - y0, np.float64(z1) - z0
    return x * y + y * z + z * x


@njit(**PARALLEL)
def _cost_splits(keys, size, costs):
    """What splitting every run of `size` boxes in halves would cost, by every key.

    The area of a half's box is the chance that it is met, and the work then goes with what is in it. Boxes
    whose key is that of the middle one count on both sides.
    """
    n = len(keys)
    for task in prange(costs.size):
        j, column = task // _N_KEYS, task % _N_KEYS
        lo, hi = j * size, min((j + 1) * size, n)
        middle = lo + size // 2
        if middle >= hi:
            continue
        values = np.empty(hi - lo, np.float32)
        for i in range(lo, hi):
            values[i - lo] = keys[i, column]
        pivot = _nth(values, middle - lo)
        costs[j, column] = _half_cost(keys, lo, hi, column, pivot, 1.0) * (middle - lo) + _half_cost(
            keys, lo, hi, column, pivot, -1.0
        ) * (hi - middle)


@njit(**PARALLEL)
def _split_cheapest(keys, items, size, costs):
    """Split every run of `size` boxes in halves, by its cheapest key."""
    n = len(keys)
    for j in prange(len(costs)):
        lo, hi = j * size, min((j + 1) * size, n)
        middle = lo + size // 2
        if middle >= hi:
            continue
        best = 0
        for column in range(_N_KEYS):
            if costs[j, column] < costs[j, best]:
                best = column
        _select(keys, items, lo, hi, middle, best)


def aligned_box_order(low: np.ndarray, high: np.ndarray, leaf: int = WIDTH) -> np.ndarray:
    """As `aligned_order`, for boxes: every split is the one of least surface area among several keys.

    Parameters
    ----------
    low, high : (n, 3) float32
        Corners.
    """
    diameter = np.sqrt(((high - low) ** 2).sum(axis=1, keepdims=True))
    keys = np.concatenate([low, high, 0.5 * (low + high), diameter], axis=1)
    items = np.arange(len(keys), dtype=np.int32)
    size = leaf
    while size < len(keys):
        size *= 2
    while size > leaf:
        costs = np.zeros((-(-len(keys) // size), _N_KEYS))
        _cost_splits(keys, size, costs)
        _split_cheapest(keys, items, size, costs)
        size //= 2
    return items


def level_blocks(n_items: int) -> tuple[np.ndarray, list[int]]:
    """First block of each level, bundles first, and how many items a node of the level holds."""
    levels, sizes, size = [0], [], WIDTH
    while True:
        n_nodes = -(-n_items // size)
        levels.append(levels[-1] + max(-(-n_nodes // WIDTH), 1))
        sizes.append(size)
        if n_nodes <= WIDTH:
            return np.array(levels, np.int64), sizes
        size *= WIDTH
