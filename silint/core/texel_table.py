"""Prefix sums of an environment map's light along the octahedral isolines [NBMJ14 4].

F[k](v) is the integral of L w dw, or of L Y_lm dw, over strip k and the loop coordinates [0, v]. Between
knots 1/M of a quarter apart it is linear: light is spread evenly over a cell. As in prefix_table.py a column
stands for the whole width of its strip, so that totals are those of the sphere. texel_scatter.py says how
texels come into cells.

HDR maps hold suns 1e5 times the median: sums are in float64, and the prefix sums are compensated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numba import njit, prange

from silint.core import texel_scatter
from silint.core.jit import INNER, PARALLEL
from silint.core.sh import recurrence

_FEWEST_CELLS, _MOST_CELLS = 64, 1024

# Texels that a call into the kernels takes: 0.1 s or so for a fine map.
_TEXELS_AT_ONCE = 1 << 16


class TexelTable(NamedTuple):
    """Prefix sums of B functions of direction times the light of C channels, along K isolines."""

    values: np.ndarray  # (K, 4 M + 1, B C) float64: F at knot j, v = j / M; column B c + b
    cells_per_quarter: int  # M


def cells_per_quarter(height: int) -> int:
    """Cells about as wide as the texels of a map of that many rows, within bounds."""
    return min(max((height + 1) // 2, _FEWEST_CELLS), _MOST_CELLS)


def build_texel_table(
    radiance: np.ndarray, rotation: np.ndarray, isolines: int, quarter: int = 0
) -> TexelTable:
    """Tabulate the first moments x, y, z of the light of a map.

    Parameters
    ----------
    radiance : (H, 2 H, C) float
        Finite.
    rotation : (3, 3) float64
        From the frame of the map to that of the isolines.
    isolines : int
        K.
    quarter : int
        M, the cells on each of the four sides of an isoline; 0 to take them from the map's height.
    """
    # Degree 1 is y, z, x of the frame of its harmonics.
    turn = (rotation @ texel_scatter.POLAR.T)[:, [1, 2, 0]] / np.sqrt(3.0 / (4.0 * np.pi))
    return build_harmonic_table(radiance, rotation, isolines, [turn], 1, quarter)


def build_harmonic_table(
    radiance: np.ndarray,
    rotation: np.ndarray,
    isolines: int,
    blocks: Sequence[np.ndarray],
    first_degree: int = 0,
    quarter: int = 0,
) -> TexelTable:
    """Tabulate harmonics times the light of a map.

    Parameters
    ----------
    radiance, rotation, isolines, quarter
        As for `build_texel_table`.
    blocks : sequence of (2 l + 1, 2 l + 1) float64, for l = first_degree .. L
        What each degree is multiplied with: those of the rotation by ``rotation @ POLAR.T`` for harmonics in
        the frame of the isolines.
    """
    height, width, n_channels = radiance.shape
    m = quarter or cells_per_quarter(height)
    n_degrees = first_degree + len(blocks)
    values = np.zeros((isolines, 4 * m + 1, n_channels * (n_degrees**2 - first_degree**2)))
    rotation = np.array(rotation, order="C")  # one layout, and writable, for all
    rule = texel_scatter.rule(first_degree, recurrence(n_degrees - 1), height)
    theta = np.pi * (np.arange(height) + 0.5) / height
    # All light, but for the factors that all texels share.
    total = float((np.sin(theta) * np.abs(radiance).sum(axis=(1, 2), dtype=np.float64)).sum())
    # Rows from all over the map at a time: strips, and with them threads, have equal shares of these.
    step = -(-height * width // _TEXELS_AT_ONCE)
    for first in range(min(step, height)):
        rows = np.arange(first, height, step)
        band = np.array(radiance[rows], dtype=np.float64, order="C")
        strips, parts = np.empty((2, len(rows), width, 2), np.int32)
        texel_scatter.plan_texels(band, rows, height, total, rotation, m, isolines, strips, parts)
        n_threads = min(numba.get_num_threads(), isolines)
        borders = texel_scatter.fair_shares(strips, parts, isolines, n_threads)
        texel_scatter.scatter_texels(band, rows, height, strips, parts, borders, rotation, m, *rule, values)
    _turn_degrees(values, first_degree, _padded(blocks))
    _accumulate(values)
    values.setflags(write=False)
    return TexelTable(values, m)


def _padded(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Blocks in one array, each at the corner of its matrix."""
    size = len(blocks[-1])
    out = np.zeros((len(blocks), size, size))
    for matrix, block in zip(out, blocks, strict=True):
        matrix[: len(block), : len(block)] = block
    return out


@njit(**PARALLEL)
def _turn_degrees(values, first_degree, blocks):
    """Multiply the harmonics of each degree with its block, in place."""
    n_lines, n_knots, n_columns = values.shape
    n_harmonics = (first_degree + len(blocks)) ** 2 - first_degree**2
    for k in prange(n_lines):
        turned = np.empty(blocks.shape[1])
        for j in range(n_knots):
            for channel in range(n_columns // n_harmonics):
                start = channel * n_harmonics
                for i in range(len(blocks)):
                    size = 2 * (first_degree + i) + 1
                    for row in range(size):
                        total = 0.0
                        for column in range(size):
                            total += blocks[i, row, column] * values[k, j, start + column]
                        turned[row] = total
                    for row in range(size):
                        values[k, j, start + row] = turned[row]
                    start += size


@njit(**PARALLEL)
def _accumulate(values):
    """Sums of cells to prefix sums, in place, compensated [Neu74]."""
    n_lines, n_knots, n_columns = values.shape
    for k in prange(n_lines):
        for column in range(n_columns):
            total, lost = 0.0, 0.0
            for j in range(1, n_knots):
                term = values[k, j, column]
                new = total + term
                if abs(total) >= abs(term):
                    lost += (total - new) + term
                else:
                    lost += (term - new) + total
                total = new
                values[k, j, column] = total + lost


@njit(**INNER)
def _knot(v, m):
    """Knot below 0 <= v < 8 on the loop of length 4, how far beyond it in cells, and whether v wraps."""
    wraps = v >= 4.0
    x = (v - 4.0 if wraps else v) * m
    j = min(int(x), 4 * m - 1)
    return j, x - j, wraps


@njit(**PARALLEL)
def integrate_steps(values, m, offsets, intervals, n_lines):
    """Integrals over intervals, even and odd isolines apart.

    Parameters
    ----------
    values, m
        A TexelTable's.
    offsets : (n K + 1,) int64
        Where the intervals of each isoline of each point begin.
    intervals : (m, 2) float64

    Returns
    -------
    (n, 2, B C) float64
    """
    n = (len(offsets) - 1) // n_lines
    n_columns = values.shape[2]
    out = np.zeros((n, 2, n_columns))
    for i in prange(n):
        for k in range(n_lines):
            for row in range(offsets[i * n_lines + k], offsets[i * n_lines + k + 1]):
                j0, t0, wraps0 = _knot(intervals[row, 0], m)
                j1, t1, wraps1 = _knot(intervals[row, 1], m)
                turns = (1.0 if wraps1 else 0.0) - (1.0 if wraps0 else 0.0)
                for c in range(n_columns):
                    a0, a1 = values[k, j0, c], values[k, j1, c]
                    f0 = a0 + t0 * (values[k, j0 + 1, c] - a0)
                    f1 = a1 + t1 * (values[k, j1 + 1, c] - a1)
                    out[i, k % 2, c] += (f1 - f0) + turns * values[k, 4 * m, c]
    return out
