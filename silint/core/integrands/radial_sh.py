"""SH transfer along radial isolines, in closed form.

In a point's frame (T, M, A) the harmonics of the line phi_k are T_lm(theta) (sqrt(2) sin(m phi_k), 1, sqrt(2)
cos(m phi_k)), so that an interval of keys contributes J_lm = int T_lm sin(theta) dtheta times a constant of
the line. From the zenith down to theta, with c = cos(theta), s = sin(theta) and q, a, b of core.sh (T_lm =
q_l(c) s^m),

    J_lm = a_lm / (l + 1) * (s^2 T_(l-1)m + (l - 2) b_lm J_(l-2)m)                [Pau78], normalised
    J_mm = q_m S_m,   S_m = int sin^(m+1) = (m S_(m-2) - c s^m) / (m + 1),   S_0 = 1 - c,   S_(-1) = theta

All factors of J are below 1: rounding does not grow. Odd m are where the angle itself enters. The cosine
weight needs no other integral: n.w Y_lm are harmonics one degree further (core.sh.coupling), and the normal
is the same vector in the frame of every point. The sums are turned to the world's axes at the end.

What the lines miss of an open hemisphere is given back in the proportion that is open, which is the ratio of
the sums for degree 0: an open sky is exact, a closed room exactly 0, and degree 0 is ambient occlusion.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.integrands.radial import GROUPS
from silint.core.jit import INNER, KERNEL, PARALLEL
from silint.core.lanes import WIDTH
from silint.core.radial import (
    NORMAL_IN_FRAME,
    RadialIntervals,
    azimuth,
    line_table,
    normal_table,
    set_frame,
)
from silint.core.sh import Coupling, contract, coupling, moment_degree, open_hemisphere, recurrence
from silint.core.sh_rotation import exchange, rotate

# As radial.ERROR_OF_SPREAD, for the length of the error of all coefficients, which scatters less than that
# of a single number: such that the estimate holds for 95 % of points (benchmarks/estimates.py).
ERROR_OF_SPREAD = 0.4

# Points that a thread takes at a time: scratch is allocated for each such block.
_BLOCK = 64

# A key beyond this is the zenith to rounding; its square is still finite.
_ZENITH = 1e100

# A packet holds WIDTH ends of intervals, those of each group of lines in lanes of their own. Its fields: key,
# cos(phi), sin(phi), weight times cos(m phi) and sin(m phi); cos(theta), s^2, s, s^m, S_(m-2), S_(m-1); and
# T_(l-1)m, T_(l-2)m, J_(l-1)m, J_(l-2)m.
_SLOTS = WIDTH // GROUPS
_N_FIELDS = 15
_UW = np.uint64(WIDTH)
_KEY, _COS, _SIN, _REAL, _IMAG, _C, _SS, _S, _POWER, _S2, _S1, _T1, _T2, _J1, _J2 = (
    np.uint64(i * WIDTH) for i in range(_N_FIELDS)
)


class Opened(NamedTuple):
    """What is the same for all points, in the frame: lines down to the horizon, and an open hemisphere."""

    keys: np.ndarray  # (K,) float64: of the horizon
    moments: np.ndarray  # (K, (D + 1)^2) float64: what each whole line adds
    share: np.ndarray  # (GROUPS + 1,) float64: degree 0 of the transfer by each group of lines, and by all
    missed: np.ndarray  # (GROUPS + 1, (L + 1)^2) float64: exact less GROUPS times each group, and less all


@njit(**KERNEL)
def end_moments(y, cos_phi, sin_phi, weight, table, out):
    """Add weight * int Y_lm sin(theta) dtheta, from the zenith down to key y on a line.

    Parameters
    ----------
    y : float64
        A key, finite.
    cos_phi, sin_phi, weight : float64
    table : (D + 1, D + 1, 2) float64
        See sh.recurrence.
    out : ((D + 1)^2,) float64, in and out
        In the frame.
    """
    y = min(y, _ZENITH)
    r = np.sqrt(1.0 + y * y)
    s, c = 1.0 / r, y / r
    real, imaginary, power = weight, 0.0, 1.0
    before, sectoral = azimuth(y, 1.0), s * s / (1.0 + c) if c > 0.0 else 1.0 - c
    for m in range(len(table)):
        if m > 0:
            before, sectoral = sectoral, (m * before - c * power) / (m + 1)
        t1, t2 = table[m, m, 0] * power, 0.0
        j1, j2 = table[m, m, 0] * sectoral, 0.0
        for degree in range(m, len(table)):
            if degree > m:
                a, b = table[degree, m, 0], table[degree, m, 1]
                j1, j2 = a / (degree + 1) * (s * s * t1 + (degree - 2) * b * j2), j1
                t1, t2 = a * (c * t1 - b * t2), t1
            centre = degree * (degree + 1)
            out[centre + m] += real * j1
            if m > 0:
                out[centre - m] += imaginary * j1
        power *= s
        real, imaginary = cos_phi * real - sin_phi * imaginary, cos_phi * imaginary + sin_phi * real


@njit(**KERNEL)
def packet_moments(packet, table, sums):
    """`end_moments` of WIDTH ends at once.

    Parameters
    ----------
    packet : (_N_FIELDS * WIDTH,) float64
        Key, cosine and sine of the line, and weight in _REAL, which is 0 for lanes that hold no end.
    table : (D + 1, D + 1, 2) float64
    sums : ((D + 1) (D + 2) * WIDTH,) float64, in and out
        Pair l (l + 1) / 2 + m holds WIDTH sums for m and WIDTH for -m.
    """
    for i in range(_UW):
        y = packet[_KEY + i]
        r = np.sqrt(1.0 + y * y)
        s, c = 1.0 / r, y / r
        packet[_C + i], packet[_S + i], packet[_SS + i] = c, s, s * s
        packet[_IMAG + i], packet[_POWER + i] = 0.0, 1.0
        low = s * s / (1.0 + (c if c > 0.0 else 0.0))
        packet[_S2 + i], packet[_S1 + i] = azimuth(y, 1.0), low if c > 0.0 else 1.0 - c
    for m in range(len(table)):
        if m > 0:
            _next_order(packet, np.float64(m))
        first = table[m, m, 0]
        at = np.uint64(m * (m + 1) // 2 + m) * np.uint64(2 * WIDTH)
        for i in range(_UW):
            j = first * packet[_S1 + i]
            packet[_T1 + i], packet[_T2 + i] = first * packet[_POWER + i], 0.0
            packet[_J1 + i], packet[_J2 + i] = j, 0.0
            sums[at + i] += packet[_REAL + i] * j
            sums[at + _UW + i] += packet[_IMAG + i] * j
        for degree in range(m + 1, len(table)):
            a, b = table[degree, m, 0], table[degree, m, 1]
            at = np.uint64(degree * (degree + 1) // 2 + m) * np.uint64(2 * WIDTH)
            _next_degree(packet, a, b, a / (degree + 1), (degree - 2) * b, sums, at)


@njit(**INNER)
def _next_order(packet, m):
    """From m - 1 to m: powers of s, S_m, and multiples of phi."""
    scale = 1.0 / (m + 1.0)
    for i in range(_UW):
        power = packet[_POWER + i] * packet[_S + i]
        sectoral = (m * packet[_S2 + i] - packet[_C + i] * power) * scale
        packet[_POWER + i] = power
        packet[_S2 + i], packet[_S1 + i] = packet[_S1 + i], sectoral
        c, s, real, imaginary = packet[_COS + i], packet[_SIN + i], packet[_REAL + i], packet[_IMAG + i]
        packet[_REAL + i] = c * real - s * imaginary
        packet[_IMAG + i] = c * imaginary + s * real


@njit(**INNER)
def _next_degree(packet, a, b, a_over, b_times, sums, at):
    """From l - 1 to l."""
    for i in range(_UW):
        t, j1 = packet[_T1 + i], packet[_J1 + i]
        j = a_over * (packet[_SS + i] * t + b_times * packet[_J2 + i])
        packet[_J1 + i], packet[_J2 + i] = j, j1
        packet[_T1 + i], packet[_T2 + i] = a * (packet[_C + i] * t - b * packet[_T2 + i]), t
        sums[at + i] += packet[_REAL + i] * j
        sums[at + _UW + i] += packet[_IMAG + i] * j


@njit(**INNER)
def _push(packet, filled, group, y, cos_phi, sin_phi, weight, table, sums):
    """Put an end into a lane of its group; work the packet off if there is none left."""
    if filled[group] == _SLOTS:
        packet_moments(packet, table, sums)
        _clear(packet, filled)
    lane = np.uint64(group * _SLOTS + filled[group])
    filled[group] += 1
    packet[_KEY + lane] = min(y, _ZENITH)
    packet[_COS + lane], packet[_SIN + lane], packet[_REAL + lane] = cos_phi, sin_phi, weight


@njit(**INNER)
def _clear(packet, filled):
    packet[:] = 0.0
    filled[:] = 0


@njit(**INNER)
def _gather(lines, opened, counts, first, intervals, weight, table, scratch, groups):
    """Moments of a point's intervals by groups of lines, in the frame."""
    packet, filled, sums = scratch
    groups[:] = 0.0
    sums[:] = 0.0
    _clear(packet, filled)
    pushed = False
    row = first
    n_moments = groups.shape[1]
    for k in range(len(lines)):
        g = k % GROUPS
        c, s = lines[k, 0], lines[k, 1]
        for _ in range(counts[k]):
            y0, y1 = intervals[row, 0], intervals[row, 1]
            row += 1
            # Most intervals end at the horizon, which is the same for all points.
            if y1 == opened.keys[k]:
                for j in range(n_moments):
                    groups[g, j] += opened.moments[k, j]
            else:
                _push(packet, filled, g, y1, c, s, weight, table, sums)
                pushed = True
            if y0 < np.inf:
                _push(packet, filled, g, y0, c, s, -weight, table, sums)
                pushed = True
    if pushed:
        packet_moments(packet, table, sums)
        _add_lanes(sums, len(table), groups)


@njit(**INNER)
def _add_lanes(sums, n_degrees, groups):
    """Add the lanes of each group to its moments."""
    for degree in range(n_degrees):
        for m in range(-degree, degree + 1):
            pair = degree * (degree + 1) // 2 + abs(m)
            base = (2 * pair + (1 if m < 0 else 0)) * WIDTH
            for g in range(GROUPS):
                total = 0.0
                for slot in range(_SLOTS):
                    total += sums[base + g * _SLOTS + slot]
                groups[g, degree * (degree + 1) + m] += total


@njit(**KERNEL)
def _transfer(groups, terms, normal, out):
    """Moments of groups of lines to their transfer (rows of out), and its sum over them in the last row."""
    n_coefficients = out.shape[1]
    out[GROUPS] = 0.0
    for g in range(GROUPS):
        if len(terms.offsets) > 0:
            contract(terms.offsets, terms.columns, terms.axes, terms.weights, normal, groups[g], out[g])
        else:
            # An array assignment would compile its error message too: 2 s.
            for j in range(n_coefficients):
                out[g, j] = groups[g, j]
        for j in range(n_coefficients):
            out[GROUPS, j] += out[g, j]


@njit(**INNER)
def _spread(transfer, opened):
    """Sum over groups of the squared distance of each, scaled to all lines, from the last row."""
    total = 0.0
    for g in range(GROUPS):
        share = transfer[g, 0] / opened.share[g]
        for j in range(transfer.shape[1]):
            off = GROUPS * transfer[g, j] + share * opened.missed[g, j] - transfer[GROUPS, j]
            total += off * off
    return total


@njit(**PARALLEL)
def radial_transfer(lines, opened, table, terms, normal, turn, visible, value, estimate):
    """SH transfer of each point.

    Parameters
    ----------
    lines : (K, 2) float64
        See radial.line_table.
    opened : Opened
    table : (D + 1, D + 1, 2) float64
        See sh.recurrence.
    terms : Coupling
        Of degree D - 1; empty where the moments themselves, of degree D, are asked for.
    normal : (3,) float64
        Over pi, in the frame.
    turn : Exchange
    visible : RadialIntervals
    value : (n, (L + 1)^2) float64, out
    estimate : (n,) float64, out
        Of the length of the error of all coefficients together.
    """
    n, n_coefficients = value.shape
    n_degrees = int(np.sqrt(n_coefficients) + 0.5)
    weight = 2.0 * np.pi / len(lines)
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        packet, filled = np.empty(_N_FIELDS * WIDTH), np.empty(GROUPS, np.int64)
        sums = np.empty(len(table) * (len(table) + 1) * WIDTH)
        groups, transfer = np.empty((GROUPS, len(table) ** 2)), np.empty((GROUPS + 1, n_coefficients))
        frame, other = np.empty((3, 3)), np.empty(n_coefficients)
        for i in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            first = visible.starts[i]
            _gather(
                lines,
                opened,
                visible.counts[i],
                first,
                visible.intervals,
                weight,
                table,
                (packet, filled, sums),
                groups,
            )
            _transfer(groups, terms, normal, transfer)
            share = transfer[GROUPS, 0] / opened.share[GROUPS]
            for j in range(n_coefficients):
                transfer[GROUPS, j] += share * opened.missed[GROUPS, j]
            estimate[i] = ERROR_OF_SPREAD * np.sqrt(_spread(transfer, opened) / GROUPS)
            for j in range(n_coefficients):
                value[i, j] = transfer[GROUPS, j]
            set_frame((visible.normals[i, 0], visible.normals[i, 1], visible.normals[i, 2]), frame)
            # The rows of the frame are what its axes are in the world.
            rotate(frame.T, n_degrees, turn.offsets, turn.columns, turn.weights, value[i], other)


@lru_cache(maxsize=32)
def _opened(n_lines: int, max_degree: int, weighting: str) -> Opened:
    """Whole lines and the open hemisphere, in the frame of any point."""
    lines = line_table(n_lines)
    keys = np.ascontiguousarray(normal_table(lines)[:, 1])
    table = recurrence(moment_degree(max_degree, weighting))
    moments = np.zeros((n_lines, len(table) ** 2))
    groups = np.zeros((GROUPS, len(table) ** 2))
    for k in range(n_lines):
        end_moments(keys[k], *lines[k], 2.0 * np.pi / n_lines, table, moments[k])
        groups[k % GROUPS] += moments[k]
    transfer = np.empty((GROUPS + 1, (max_degree + 1) ** 2))
    _transfer(groups, _terms(max_degree, weighting), _NORMAL, transfer)
    exact = open_hemisphere(np.array([NORMAL_IN_FRAME]), max_degree, weighting)
    missed = exact - np.array([GROUPS] * GROUPS + [1])[:, None] * transfer
    return Opened(keys, moments, np.ascontiguousarray(transfer[:, 0]), missed)


_NORMAL = np.array(NORMAL_IN_FRAME) / np.pi
_NO_TERMS = Coupling(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
for _array in _NO_TERMS:
    _array.setflags(write=False)  # as those of `coupling`: one specialisation


def _terms(max_degree: int, weighting: str) -> Coupling:
    return coupling(max_degree) if weighting == "cosine" else _NO_TERMS


def enough_lines(isolines: int, max_degree: int = 0) -> int:
    """Radial lines for a request: even, 4 at least, and no fewer than 2 L.

    Fewer than 2 L half-planes take the harmonics of highest m for those of lower m: measured on a scene of 9k
    triangles, the RMSE of all coefficients at K = 8 and 16 is 4e-3 and 1.6e-3 for L = 4 and 8e-3 and 3e-3
    for L = 16, which from K = 32 on errs no more than L = 4.
    """
    return max(isolines + isolines % 2, 4, 2 * max_degree)


def sh_transfer(visible: RadialIntervals, max_degree: int, weighting: str) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) Y dw for "cosine", int V Y dw over the hemisphere of n for "uniform".

    Parameters
    ----------
    visible : RadialIntervals
    max_degree : int
        L. Lines see nothing of m >= K and take it for something else; see `enough_lines`.
    weighting : {"cosine", "uniform"}

    Returns
    -------
    value : (n, (L + 1)^2) float64
        In the axes of the world; conventions of core.sh.
    error_estimate : (n,) float64
        Of the square root of the sum of the squared errors of all coefficients.
    """
    n, n_lines = visible.counts.shape
    value, estimate = np.empty((n, (max_degree + 1) ** 2)), np.empty(n)
    radial_transfer(
        line_table(n_lines),
        _opened(n_lines, max_degree, weighting),
        recurrence(moment_degree(max_degree, weighting)),
        _terms(max_degree, weighting),
        _NORMAL,
        exchange(max_degree),
        visible,
        value,
        estimate,
    )
    return value, estimate
