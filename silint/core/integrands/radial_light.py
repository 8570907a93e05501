"""Light of an environment along radial isolines: a sky in cells, and small bright sources one by one.

A line is cut into M cells of equal projected solid angle, so that where a key lies among them is its share of
the line's whole in closed form (that of ambient occlusion), and L is one number in each, of a map as blurred
as the cell is wide (`sky_map`): irradiance is the sum over intervals of the lengths that cells have in them.
What the lines miss of an open hemisphere, which is tabulated, is given back in the proportion that is open:
under a constant environment that is pi L times the ambient occlusion of the same lines, a closed room is
exactly dark, and the error of few lines is halved.

A sun is far smaller than a cell and may hold most of the light. Such sources are left out of the map; what
an interval along the line through a source hides of its disc is known in closed form, too. The frame may be
turned such that the brightest lies on a line (`radial.set_frames`); others are seen from the two lines next
to them.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.integrands.radial import ERROR_OF_SPREAD, GROUPS
from silint.core.jit import INNER, PARALLEL
from silint.core.radial import (
    NORMAL_ALONG_AXIS,
    RadialIntervals,
    azimuth,
    in_frame,
    line_table,
    normal_table,
    set_frames,
)
from silint.core.sky_map import interpolate_open, unfolded

MOST_CELLS = 64

# Of the irradiance without occluders, that of the tables: at most, over 300 normals under two maps of 512
# rows that the sun is low or high in.
TABLE_ERROR = 5e-4

# Points that a thread takes at a time: scratch is allocated for each such block.
_BLOCK = 64


class Cells(NamedTuple):
    """Lines in cells of equal projected solid angle, the same for all points in their frames."""

    directions: np.ndarray  # (K, 3, M) float32: to the middle of each, in the frame
    whole: np.ndarray  # (K,) float64: int n.w dw of each line's part of an open hemisphere; they sum to pi
    normal: np.ndarray  # (K, 2) float64: see radial.normal_table
    share: np.ndarray  # (K,) float64: cells over the integral of n.w sin(theta) down to the horizon


class Sources(NamedTuple):
    """Small discs of light, the brightest first; all arrays read-only."""

    directions: np.ndarray  # (s, 3) float64, unit
    radius: np.ndarray  # (s,) float64, radians
    flux: np.ndarray  # (s, 3) float64: int L dw


class Sky(NamedTuple):
    """What radial lines need of an environment; all arrays read-only."""

    aim: np.ndarray  # (3,) float64: the direction that a line of each point passes through, 0 for none
    to_map: np.ndarray  # (3, 3) float64: from the frame of the scene to that of the map
    texels: np.ndarray  # (N^2, 4) float32: see sky_map.spread_level; without sources
    open: np.ndarray  # see sky_map.open_irradiance; without sources


def cells_a_line(n_lines: int) -> int:
    """M: cells are about as high as wide half-way to the horizon."""
    return min(max(n_lines // 2, 4), MOST_CELLS)


def texels_for(n_lines: int) -> int:
    """Texels each way of an octahedral level whose texels are about as large as cells, a power of two."""
    return 1 << ((2 * n_lines * cells_a_line(n_lines) - 1).bit_length() + 1) // 2


@lru_cache(maxsize=16)
def line_cells(n_lines: int) -> Cells:
    """Cells of K lines."""
    lines, n_cells = line_table(n_lines), cells_a_line(n_lines)
    normal = normal_table(lines)
    nt = normal[:, :1]

    def measure(theta: np.ndarray) -> np.ndarray:
        sine, cosine = np.sin(theta), np.cos(theta)
        return 0.5 * (NORMAL_ALONG_AXIS * sine * sine + nt * (theta - sine * cosine))

    horizon = np.arctan2(1.0, normal[:, 1:])
    whole = measure(horizon)
    wanted = whole * (np.arange(n_cells) + 0.5) / n_cells
    low, high = np.zeros_like(wanted), np.broadcast_to(horizon, wanted.shape)
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = measure(middle) < wanted
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    sine, cosine = np.sin(low), np.cos(low)
    directions = np.stack([sine * lines[:, :1], sine * lines[:, 1:], cosine], axis=1)
    cells = Cells(
        directions.astype(np.float32), np.pi * whole[:, 0] / whole.sum(), normal, n_cells / whole[:, 0]
    )
    for array in cells:
        array.setflags(write=False)
    return cells


@njit(**INNER)
def _place(y, nt, share):
    """Cells from the zenith down to key y: a real number; see radial._primitive."""
    square = 1.0 / (1.0 + y * y)
    return 0.5 * share * (NORMAL_ALONG_AXIS * square + nt * (azimuth(y, 1.0) - y * square))


@njit(**INNER)
def _find_texels(directions, k, turn, size, at):
    """Texels of the cells of line k."""
    n_cells = np.uint64(directions.shape[2])
    xx, xy, xz = turn[0, 0], turn[0, 1], turn[0, 2]
    yx, yy, yz = turn[1, 0], turn[1, 1], turn[1, 2]
    zx, zy, zz = turn[2, 0], turn[2, 1], turn[2, 2]
    one, half, last = np.float32(1.0), np.float32(0.5 * size), np.int32(size - 1)
    row_length = np.int32(size)
    xs, ys, zs = directions[k, 0], directions[k, 1], directions[k, 2]
    for j in range(n_cells):
        x, y, z = xs[j], ys[j], zs[j]
        u, v = unfolded(
            xx * x + xy * y + xz * z,
            yx * x + yy * y + yz * z,
            zx * x + zy * y + zz * z,
        )
        column, row = np.int32((u + one) * half), np.int32((v + one) * half)
        column = column if column < last else last
        row = row if row < last else last
        at[j] = row * row_length + column


@njit(**INNER)
def _disc(x):
    """Part of a disc of radius 1 on the side of smaller x of a chord at x."""
    if x <= -1.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi


@njit(**INNER)
def _seen_disc(theta, radius, intervals, first, count):
    """Visible part of a disc about theta on a line, from its intervals."""
    seen = 0.0
    for row in range(first, first + count):
        y0, y1 = intervals[row, 0], intervals[row, 1]
        seen += _disc((azimuth(y1, 1.0) - theta) / radius)
        if y0 < np.inf:
            seen -= _disc((azimuth(y0, 1.0) - theta) / radius)
    return seen


@njit(**INNER)
def _seen_chord(theta, half, intervals, first, count):
    """Visible part of a stretch of a line, `half` to either side of theta, from its intervals."""
    seen = 0.0
    for row in range(first, first + count):
        y0, y1 = intervals[row, 0], intervals[row, 1]
        seen += min(max((azimuth(y1, 1.0) - theta) / half, -1.0), 1.0)
        seen -= min(max((azimuth(y0, 1.0) - theta) / half, -1.0), 1.0) if y0 < np.inf else -1.0
    return 0.5 * seen


@njit(**INNER)
def _seen_in_strips(cosine, sine, place, radius, counts, rows, intervals):
    """Visible part of a disc that several lines cross: of each line's strip what its chord sees.

    Parameters
    ----------
    cosine, sine : float
        Of the angle between the axis and the middle of the disc.
    place : float
        Azimuth of its middle, in lines.
    """
    n_lines = len(counts)
    step = 2.0 * np.pi / n_lines
    reach = np.arcsin(np.sin(radius) / sine) / step
    seen = 0.0
    for k in range(int(np.ceil(place - reach - 0.5)), int(np.floor(place + reach + 0.5)) + 1):
        left = max(np.arcsin(sine * np.sin((k - 0.5 - place) * step)), -radius)
        right = min(np.arcsin(sine * np.sin((k + 0.5 - place) * step)), radius)
        area = _disc(right / radius) - _disc(left / radius)
        if area <= 0.0:
            continue
        theta = azimuth(cosine, sine * np.cos((k - place) * step))
        line = (k + n_lines) % n_lines
        half = 0.5 * np.pi * area * radius * radius / (right - left)
        seen += area * _seen_chord(theta, half, intervals, rows[line], counts[line])
    return seen


@njit(**INNER)
def _add_sources(frame, normal, sources, counts, first, intervals, rows, out):
    """Irradiance from sources (3,), and in a fourth place the doubt about it.

    Where lines are denser than a disc is wide, each counts for its strip of the disc: then more lines mean
    more accuracy without end. A wider spacing sees the disc from the line through it, or from two beside it.
    """
    for c in range(4):
        out[c] = 0.0
    n_lines = len(counts)
    for k in range(n_lines):
        rows[k] = first
        first += counts[k]
    aimed = sources.directions[0] if len(sources.radius) > 0 else normal
    for s in range(len(sources.radius)):
        x, y, z = sources.directions[s, 0], sources.directions[s, 1], sources.directions[s, 2]
        cosine, radius = normal[0] * x + normal[1] * y + normal[2] * z, sources.radius[s]
        if cosine <= 0.0:
            continue
        t, m, a = in_frame(x, y, z, frame)
        sine = np.hypot(t, m)
        theta = azimuth(a, sine)
        place = azimuth(t, m) * (n_lines / (2.0 * np.pi)) - 0.5
        # On a line, or as close to it as can be.
        on_line = x == aimed[0] and y == aimed[1] and z == aimed[2]
        below = int(np.floor(place + 0.5)) if on_line else int(np.floor(place))
        part = 0.0 if on_line else place - below
        seen = _look(theta, radius, counts, rows, intervals, below)
        other = _look(theta, radius, counts, rows, intervals, below + 1)
        before = _look(theta, radius, counts, rows, intervals, below - 1) if on_line else seen
        # Half the spacing of lines over the radius of the disc.
        spacing = sine * np.sin(np.pi / n_lines) / np.sin(radius)
        if spacing < 1.0 and sine > 2.0 * np.sin(radius):
            visible = _seen_in_strips(a, sine, place, radius, counts, rows, intervals)
        else:
            visible = seen if on_line else seen + part * (other - seen)
        # What neighbouring lines see otherwise may begin on the disc.
        doubt = max(abs(other - seen), abs(before - seen)) / max(spacing, 1.0)
        if on_line:
            doubt = max(0.5 * doubt, min(visible, 1.0 - visible) * min(spacing, 1.0))
        largest = 0.0
        for c in range(3):
            light = sources.flux[s, c] * cosine
            out[c] += light * visible
            largest = max(largest, light)
        out[3] += largest * doubt


@njit(**INNER)
def _look(theta, radius, counts, rows, intervals, k):
    """Visible part of a disc about theta as one line sees it."""
    line = (k + len(counts)) % len(counts)
    return _seen_disc(theta, radius, intervals, rows[line], counts[line])


@njit(**INNER)
def _add_sky(cells, turn, texels, size, counts, first, intervals, at, prefix, groups):
    """Sums over lines, by groups: light of three channels that is seen, and in all; n.w seen and in all."""
    n_lines, n_cells = len(counts), cells.directions.shape[2]
    _clear(groups)
    row = first
    for k in range(n_lines):
        nt, horizon, share = cells.normal[k, 0], cells.normal[k, 1], cells.share[k]
        _find_texels(cells.directions, k, turn, size, at)
        red, green, blue = 0.0, 0.0, 0.0
        for j in range(n_cells):
            red += texels[at[j], 0]
            green += texels[at[j], 1]
            blue += texels[at[j], 2]
            prefix[j + 1, 0], prefix[j + 1, 1], prefix[j + 1, 2] = red, green, blue
        seen, seen_red, seen_green, seen_blue = 0.0, 0.0, 0.0, 0.0
        for _ in range(counts[k]):
            y0, y1 = intervals[row, 0], intervals[row, 1]
            row += 1
            if y1 > horizon:
                x = _place(y1, nt, share)
                j = min(int(x), n_cells - 1)
                f = x - j
                seen += x
                seen_red += prefix[j, 0] + f * (prefix[j + 1, 0] - prefix[j, 0])
                seen_green += prefix[j, 1] + f * (prefix[j + 1, 1] - prefix[j, 1])
                seen_blue += prefix[j, 2] + f * (prefix[j + 1, 2] - prefix[j, 2])
            else:
                seen += n_cells
                seen_red += red
                seen_green += green
                seen_blue += blue
            if y0 < np.inf:
                x = _place(y0, nt, share)
                j = min(int(x), n_cells - 1)
                f = x - j
                seen -= x
                seen_red -= prefix[j, 0] + f * (prefix[j + 1, 0] - prefix[j, 0])
                seen_green -= prefix[j, 1] + f * (prefix[j + 1, 1] - prefix[j, 1])
                seen_blue -= prefix[j, 2] + f * (prefix[j + 1, 2] - prefix[j, 2])
        weight = cells.whole[k] / n_cells
        g = k % GROUPS
        groups[g, 0] += weight * seen_red
        groups[g, 1] += weight * seen_green
        groups[g, 2] += weight * seen_blue
        groups[g, 3] += weight * red
        groups[g, 4] += weight * green
        groups[g, 5] += weight * blue
        groups[g, 6] += weight * seen
        groups[g, 7] += cells.whole[k]


@njit(**INNER)
def _clear(groups):
    for i in range(groups.shape[0]):
        for j in range(groups.shape[1]):
            groups[i, j] = 0.0


@njit(**PARALLEL)
def radial_light(cells, sky, sources, frames, visible, value, estimate):
    """Irradiance of each point.

    Parameters
    ----------
    cells : Cells
    sky : Sky
    sources : Sources
        In the frame of the scene.
    frames : (n, 3, 3) float64
        Rows T, M, A of each point.
    visible : RadialIntervals
    value : (n, 3) float64, out
    estimate : (n,) float64, out
        Of the error of the channel that is worst.
    """
    n, n_cells, size = len(value), cells.directions.shape[2], int(np.sqrt(len(sky.texels)) + 0.5)
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        turn, at = np.empty((3, 3), np.float32), np.empty(n_cells, np.int32)
        prefix, groups = np.zeros((n_cells + 1, 4)), np.empty((GROUPS, 8))
        whole, sun, rows = np.empty(3), np.empty(4), np.empty(len(cells.whole), np.int64)
        for i in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            first, counts, normal, frame = visible.starts[i], visible.counts[i], visible.normals[i], frames[i]
            for a in range(3):
                for b in range(3):
                    turn[a, b] = (
                        sky.to_map[a, 0] * frame[b, 0]
                        + sky.to_map[a, 1] * frame[b, 1]
                        + sky.to_map[a, 2] * frame[b, 2]
                    )
            x, y, z = in_frame(normal[0], normal[1], normal[2], sky.to_map)
            interpolate_open(sky.open, x, y, z, whole)
            _add_sky(cells, turn, sky.texels, size, counts, first, visible.intervals, at, prefix, groups)
            _add_sources(frame, normal, sources, counts, first, visible.intervals, rows, sun)
            worst = 0.0
            seen, of_all = 0.0, 0.0
            for g in range(GROUPS):
                seen += groups[g, 6]
                of_all += groups[g, 7]
            for c in range(3):
                light, lines = 0.0, 0.0
                for g in range(GROUPS):
                    light += groups[g, c]
                    lines += groups[g, 3 + c]
                # What the lines miss of an open hemisphere is given back in the proportion that is open.
                light += seen / of_all * (whole[c] - lines)
                spread = 0.0
                for g in range(GROUPS):
                    off = GROUPS * groups[g, c] - light
                    off += groups[g, 6] / groups[g, 7] * (whole[c] - GROUPS * groups[g, 3 + c])
                    spread += off * off
                worst = max(worst, spread)
                value[i, c] = max(light + sun[c], 0.0)
            tables = TABLE_ERROR * seen / of_all * max(whole[0], whole[1], whole[2])
            estimate[i] = ERROR_OF_SPREAD * np.sqrt(worst / GROUPS) + sun[3] + tables


def irradiance(visible: RadialIntervals, sky: Sky, sources: Sources) -> tuple[np.ndarray, np.ndarray]:
    """int L V max(n.w, 0) dw, for intervals on lines that were aimed at `sky.aim`.

    Returns
    -------
    value : (n, 3) float64
    error_estimate : (n,) float64
        Of the channel that is worst.
    """
    n, n_lines = visible.counts.shape
    frames = np.empty((n, 3, 3))
    set_frames(visible.normals, sky.aim, n_lines, frames)
    value, estimate = np.empty((n, 3)), np.empty(n)
    radial_light(line_cells(n_lines), sky, sources, frames, visible, value, estimate)
    return value, estimate
