"""Trees without pointers: the one builder behind all hierarchies, and behind tiles of shade points.

Items are put in an order in which every aligned run of 16 * 2^i of them belongs together. Sixteen items make a
bundle, sixteen bundles a node of the next level, and so on: node j of a level holds the items from j * size on.
Every level is partitioned in parallel.
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
