"""Prefix sums of an environment map's light along the octahedral isolines [NBMJ14 4].

F[k](v) is the integral of L w dw over strip k and the loop coordinates [0, v]. Between knots 1/M of a quarter
apart it is linear: light is spread evenly over a cell. As in prefix_table.py a column stands for the whole
width of its strip, so that totals are those of the sphere.

Texels are scattered into the cells, not sampled by them, so that no light is lost however small its source:
each is cut in parts, and every part brings its exact integral of w, dealt out to the cells that it overlaps.
(Parts that go whole to the cell of their centre fall on one side of a strip's edge, a row of texels at once:
intervals of an even map of 256 rows were off by 4e-4 sr, and are by 2e-5.) HDR maps hold suns 1e5 times the
median: sums are in float64, and the prefix sums are compensated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.equirect import bands, row_moments
from silint.core.jit import INNER, KERNEL, PARALLEL

# Parts of a texel, each way: about this many across the shorter side of the cell that they go to, ...
_PARTS_PER_CELL = 1.0
# ... but enough that none carries more than this share of all light, ...
_LARGEST_SHARE = 1e-6
# ... and at most this many. Where the isolines shrink to the poles +x and -x, cells are smaller than parts.
_MOST_PARTS = 128

_FEWEST_CELLS, _MOST_CELLS = 64, 1024


class TexelTable(NamedTuple):
    """Prefix sums of the first moments of C channels along K isolines."""

    values: np.ndarray  # (K, 4 M + 1, 3 C) float64: F at knot j, v = j / M; column 3 c + axis
    cells_per_quarter: int  # M


def cells_per_quarter(height: int) -> int:
    """Cells about as wide as the texels of a map of that many rows, within bounds."""
    return min(max((height + 1) // 2, _FEWEST_CELLS), _MOST_CELLS)


def build_texel_table(
    radiance: np.ndarray, rotation: np.ndarray, isolines: int, quarter: int = 0
) -> TexelTable:
    """Tabulate the light of a map.

    Parameters
    ----------
    radiance : (H, 2 H, C) float
        Not negative, finite.
    rotation : (3, 3) float64
        From the frame of the map to that of the isolines.
    isolines : int
        K.
    quarter : int
        M, the cells on each of the four sides of an isoline; 0 to take them from the map's height.
    """
    height, _, n_channels = radiance.shape
    m = quarter or cells_per_quarter(height)
    values = np.zeros((isolines, 4 * m + 1, 3 * n_channels))
    theta = np.pi * (np.arange(height) + 0.5) / height
    # All light, but for the factors that all texels share.
    total = float((np.sin(theta) * radiance.sum(axis=(1, 2), dtype=np.float64)).sum())
    rotation = np.array(rotation, order="C")  # one layout, and writable, for all
    for first, band in bands(radiance, 1 << 14):
        _scatter_rows(band, first, height, total, rotation, m, values)
    _accumulate(values)
    values.setflags(write=False)
    return TexelTable(values, m)


@njit(**KERNEL)
def octahedral(x, y, z):
    """Octahedral u of a direction of any length, and its loop coordinate as quarter and rest."""
    side = abs(y) + abs(z)
    if y > 0.0:
        quarter, f = (0, z) if z >= 0.0 else (3, y)
    elif z > 0.0:
        quarter, f = 1, -y
    else:
        quarter, f = (2, -z) if y < 0.0 else (3, y)
    return x / (abs(x) + side), quarter, f / side if side > 0.0 else 0.0


@njit(**KERNEL)
def _scatter_rows(band, first_row, height, total, rotation, m, values):
    """Add the moments of rows of a map to their cells: cell j of strip k at values[k, j + 1]."""
    n_rows, width, n_channels = band.shape
    n_lines = len(values)
    h = np.pi / height
    for r in range(n_rows):
        theta = np.pi * (first_row + r + 0.5) / height
        sine, cosine = np.sin(theta), np.cos(theta)
        for c in range(width):
            light = 0.0
            for channel in range(n_channels):
                light += band[r, c, channel]
            if light == 0.0:
                continue
            phi = np.pi * ((c + 0.5) / height - 1.0)
            x, y, z = _turned(rotation, sine * np.cos(phi), cosine, sine * np.sin(phi))
            # The shorter side of the cell in radians; isolines shrink with their distance from a pole.
            ring = max(1.0 - abs(octahedral(x, y, z)[0]), 1.0 / n_lines)
            cell = min(2.0 / n_lines, np.sqrt(2.0) * ring / m)
            wanted = np.sqrt(light * sine / (total * _LARGEST_SHARE))
            rows = _parts(max(_PARTS_PER_CELL * h / cell, wanted))
            columns = _parts(max(_PARTS_PER_CELL * h * sine / cell, wanted))
            _scatter_texel(band[r, c], theta, phi, h, rows, columns, rotation, m, values)


@njit(**INNER)
def _parts(wanted):
    return int(np.ceil(min(max(wanted, 1.0), _MOST_PARTS)))


@njit(**INNER)
def _turned(rotation, x, y, z):
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@njit(**INNER)
def _scatter_texel(radiance, theta, phi, h, rows, columns, rotation, m, values):
    height, width = h / rows, h / columns
    chord = 2.0 * np.sin(0.5 * width)
    for j in range(columns):
        p = phi - 0.5 * h + (j + 0.5) * width
        cos_phi, sin_phi = np.cos(p), np.sin(p)
        for i in range(rows):
            t = theta - 0.5 * h + (i + 0.5) * height
            sine, cosine = np.sin(t), np.cos(t)
            a, b = row_moments(t, height)
            moment = _turned(rotation, a * chord * cos_phi, b * width, a * chord * sin_phi)
            centre = _turned(rotation, sine * cos_phi, cosine, sine * sin_phi)
            # Half its side downwards, and to the right.
            e, f = 0.5 * height, 0.5 * width * sine
            down = _turned(rotation, e * cosine * cos_phi, -e * sine, e * cosine * sin_phi)
            right = _turned(rotation, -f * sin_phi, 0.0, f * cos_phi)
            low, high, first, last = _footprint(centre, down, right, len(values), m)
            _spread(radiance, moment, low, high, first, last, m, values)


@njit(**INNER)
def _footprint(centre, down, right, n_lines, m):
    """Where a part lies: from low to high in strips, from first to last in cells.

    A box about its centre, as wide in u and in v as gives it the variance that the part has there, to first
    order.
    """
    x, y, z = centre
    u, quarter, f = octahedral(x, y, z)
    side = abs(y) + abs(z)
    du = np.hypot(_slope_u(centre, down), _slope_u(centre, right))
    # dv = (y dz - z dy) / side^2: at a pole, all of the loop.
    dv = np.hypot(y * down[2] - z * down[1], y * right[2] - z * right[1])
    dv = 2.0 if dv >= 2.0 * side * side else dv / (side * side)
    strip, cell = 0.5 * (u + 1.0) * n_lines, (quarter + f) * m
    return strip - 0.5 * n_lines * du, strip + 0.5 * n_lines * du, cell - m * dv, cell + m * dv


@njit(**INNER)
def _slope_u(centre, move):
    """How octahedral u grows along a move."""
    x, y, z = centre
    side = abs(y) + abs(z)
    side_move = np.copysign(1.0, y) * move[1] + np.copysign(1.0, z) * move[2]
    return (move[0] * side - x * side_move) / (abs(x) + side) ** 2


@njit(**INNER)
def _spread(radiance, moment, low, high, first, last, m, values):
    """Deal L times a moment out to cells by the share of the box in each; shares sum to 1."""
    n_lines = len(values)
    k0 = min(max(int(np.floor(low)), 0), n_lines - 1)
    k1 = min(max(int(np.floor(high)), 0), n_lines - 1)
    j0, j1 = int(np.floor(first)), int(np.floor(last))
    rest_u = 1.0
    for k in range(k0, k1 + 1):
        share_u = rest_u if k == k1 else (k + 1 - (low if k == k0 else k)) / (high - low)
        rest_u -= share_u
        rest_v = 1.0
        for j in range(j0, j1 + 1):
            share_v = rest_v if j == j1 else (j + 1 - (first if j == j0 else j)) / (last - first)
            rest_v -= share_v
            cell = j % (4 * m)
            for channel in range(len(radiance)):
                light = radiance[channel] * share_u * share_v
                for axis in range(3):
                    values[k, cell + 1, 3 * channel + axis] += light * moment[axis]


@njit(**KERNEL)
def _accumulate(values):
    """Sums of cells to prefix sums, in place, compensated [Neu74]."""
    n_lines, n_knots, n_columns = values.shape
    for k in range(n_lines):
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
    (n, 2, 3 C) float64
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
