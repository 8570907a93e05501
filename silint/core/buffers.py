"""Growing and sorting flat scratch arrays inside kernels."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER, KERNEL

SHORT = 24  # runs that insertion sorts faster


@njit(**KERNEL)
def grow(array, capacity):
    """A longer copy of a 1D array; what lies beyond its old end is not set."""
    grown = np.empty(capacity, array.dtype)
    for i in range(len(array)):
        grown[i] = array[i]
    return grown


@njit(**KERNEL)
def grow_rows(array, capacity):
    """A longer copy of a 2D array; rows beyond its old end are not set."""
    grown = np.empty((capacity, array.shape[1]), array.dtype)
    for i in range(len(array)):
        for j in range(array.shape[1]):
            grown[i, j] = array[i, j]
    return grown


@njit(**INNER)
def _insertion_sort(key, value, lo, hi):
    for i in range(lo + 1, hi):
        k, v = key[i], value[i]
        j = i - 1
        while j >= lo and key[j] > k:
            key[j + 1], value[j + 1] = key[j], value[j]
            j -= 1
        key[j + 1], value[j + 1] = k, v


@njit(**KERNEL)
def sort_pairs(key, value, lo, hi):
    """Sort [lo, hi) of two arrays by the first: quicksort down to short runs, then insertion."""
    if hi - lo <= SHORT:
        _insertion_sort(key, value, lo, hi)
        return
    stack = np.empty(128, np.int64)
    stack[0], stack[1], top = lo, hi, 2
    while top > 0:
        top -= 2
        first, last = stack[top], stack[top + 1]
        while last - first > SHORT:
            a, b, c = key[first], key[(first + last) >> 1], key[last - 1]
            pivot = max(min(a, b), min(max(a, b), c))
            i, j = first, last - 1
            while i <= j:
                while key[i] < pivot:
                    i += 1
                while key[j] > pivot:
                    j -= 1
                if i <= j:
                    key[i], key[j] = key[j], key[i]
                    value[i], value[j] = value[j], value[i]
                    i += 1
                    j -= 1
            # Keep the larger part for later, so that the stack stays logarithmic.
            if j + 1 - first < last - i:
                stack[top], stack[top + 1] = i, last
                last = j + 1
            else:
                stack[top], stack[top + 1] = first, j + 1
                first = i
            top += 2
        _insertion_sort(key, value, first, last)
