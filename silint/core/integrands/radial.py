"""Closed forms along radial isolines: what an interval of keys contributes.

On the half-plane phi about the axis A a direction is w = cos(theta) A + sin(theta) t with t = cos(phi) T +
sin(phi) M, and dw = sin(theta) dtheta dphi. With y = cot(theta), s = sin(theta) = 1 / sqrt(1 + y^2) and c =
cos(theta) = y s, integrals over theta are algebraic in s and c, but for the angle itself in the
cosine-weighted one, which is there only because A is not quite the normal.

Each value is the visible integral over that of the same lines above the same horizon, times the exact value
of an open hemisphere: an open sky is exactly open, a closed room exactly closed. Where lines end at a cone
n.w > cosine instead of at the horizon, the open cone takes its place. The lines are also summed in four
interleaved groups, whose spread tells how far a group of a quarter of the lines is off.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, PARALLEL
from silint.core.radial import (
    NORMAL_ALONG_AXIS,
    RadialIntervals,
    azimuth,
    in_frame,
    line_table,
    normal_table,
    set_frame,
)

UNIFORM, COSINE = 0, 1
GROUPS = 4

# The error of all lines per root mean square deviation of the groups from their mean: at a rate of
# lines^-1.5 a group of a quarter errs 8 times as much. Calibrated such that the estimate holds for 95 % of
# points (benchmarks/tolerance.py).
ERROR_OF_SPREAD = 0.5


@njit(**INNER)
def _primitive(y, nt, weighting):
    """Integral from the zenith down to key y: of n.w sin(theta) for COSINE, of sin(theta) for UNIFORM."""
    square = 1.0 / (1.0 + y * y)
    if weighting == UNIFORM:
        s = np.sqrt(square)
        return _one_minus_cosine(y, s)
    # The azimuth of (y, 1) is the angle whose cotangent is y.
    return 0.5 * (NORMAL_ALONG_AXIS * square + nt * (azimuth(y, 1.0) - y * square))


@njit(**INNER)
def _one_minus_cosine(y, s):
    """1 - cos(theta), without cancelling near the zenith."""
    return s * s / (1.0 + y * s) if y > 0.0 else 1.0 - y * s


@njit(**INNER)
def _between(y0, y1, nt, weighting):
    """Integral over the interval from key y0 down to y1."""
    lower = _primitive(y1, nt, weighting)
    return lower - _primitive(y0, nt, weighting) if y0 < np.inf else lower


@njit(**PARALLEL)
def radial_fraction(normal, counts, starts, intervals, weighting, out):
    """Visible share of the hemisphere, by groups of lines.

    Parameters
    ----------
    normal : (K, 2) float64
        See radial.normal_table.
    counts : (n, K) int32
    starts : (n,) int64
        First row of each point's intervals.
    intervals : (m, 2) float64
    weighting : int
        COSINE or UNIFORM.
    out : (n, GROUPS) float64, out
    """
    n_lines = len(normal)
    whole, to_horizon = np.zeros(GROUPS), np.empty(n_lines)
    for k in range(n_lines):
        to_horizon[k] = _primitive(normal[k, 1], normal[k, 0], weighting)
        whole[k % GROUPS] += to_horizon[k]
    for i in prange(len(counts)):
        row = starts[i]
        for g in range(GROUPS):
            out[i, g] = 0.0
        for k in range(n_lines):
            seen = 0.0
            for _ in range(counts[i, k]):
                y0, y1 = intervals[row, 0], intervals[row, 1]
                row += 1
                # Most intervals end at the horizon, which is the same for all points.
                seen += to_horizon[k] if y1 == normal[k, 1] else _primitive(y1, normal[k, 0], weighting)
                if y0 < np.inf:
                    seen -= _primitive(y0, normal[k, 0], weighting)
            out[i, k % GROUPS] += seen
        for g in range(GROUPS):
            out[i, g] /= whole[g]


@njit(**INNER)
def _clipped(y0, y1, nt, level, side):
    """The same where side * (y - level) > 0: the part of an interval above a second horizon."""
    if side > 0.0:
        y1 = max(y1, level)
    else:
        y0 = min(y0, level)
    return _between(y0, y1, nt, COSINE) if y0 > y1 else 0.0


@njit(**PARALLEL)
def radial_sky(lines, normal, normals, up, counts, starts, intervals, out):
    """Visible share of the sky above a second horizon, weighted with n.w, by groups of lines.

    Parameters
    ----------
    lines, normal : (K, 2) float64
        See radial.line_table and radial.normal_table.
    normals : (n, 3) float64
    up : (3,) float64
    counts, starts, intervals
        As for `radial_fraction`.
    out : (n, GROUPS + 1) float64, out
        The groups, and the share of all lines; 0 where a group has no sky.
    """
    for i in prange(len(counts)):
        frame = np.empty((3, 3))
        set_frame((normals[i, 0], normals[i, 1], normals[i, 2]), frame)
        ut, um, ua = in_frame(up[0], up[1], up[2], frame)
        side = 1.0 if ua >= 0.0 else -1.0
        seen, whole = np.zeros(GROUPS), np.zeros(GROUPS)
        row = starts[i]
        for k in range(len(lines)):
            level = -(ut * lines[k, 0] + um * lines[k, 1]) / ua  # infinite on an upright axis: all or nothing
            g = k % GROUPS
            whole[g] += _clipped(np.inf, normal[k, 1], normal[k, 0], level, side)
            for _ in range(counts[i, k]):
                seen[g] += _clipped(intervals[row, 0], intervals[row, 1], normal[k, 0], level, side)
                row += 1
        for g in range(GROUPS):
            out[i, g] = seen[g] / whole[g] if whole[g] > 0.0 else 0.0
        total = whole.sum()
        out[i, GROUPS] = seen.sum() / total if total > 0.0 else 0.0


@njit(**INNER)
def _bent_primitive(y, nt):
    """Integrals from the zenith down to key y of n.w w sin(theta): along the axis, and along t."""
    s = 1.0 / np.sqrt(1.0 + y * y)
    c = y * s
    rest = _one_minus_cosine(y, s)
    ccs = rest * (1.0 + c + c * c) / 3.0
    css = s * s * s / 3.0
    sss = rest * rest * (2.0 + c) / 3.0
    return NORMAL_ALONG_AXIS * ccs + nt * css, NORMAL_ALONG_AXIS * css + nt * sss


@njit(**PARALLEL)
def radial_bent(lines, normal, normals, counts, starts, intervals, out):
    """Sums over lines of the integral of n.w w, in the frame of each point: visible, by groups, and in all.

    Parameters
    ----------
    lines, normal, normals, counts, starts, intervals
        As for `radial_sky`.
    out : (n, GROUPS + 1, 3) float64, out
        World vectors: for each group, and in the last row that of an open hemisphere on the same lines; both
        times the number of lines.
    """
    for i in prange(len(counts)):
        frame = np.empty((3, 3))
        set_frame((normals[i, 0], normals[i, 1], normals[i, 2]), frame)
        local = np.zeros((GROUPS + 1, 3))
        row = starts[i]
        for k in range(len(lines)):
            c, s, nt = lines[k, 0], lines[k, 1], normal[k, 0]
            a, t = _bent_primitive(normal[k, 1], nt)
            local[GROUPS, 0] += t * c
            local[GROUPS, 1] += t * s
            local[GROUPS, 2] += a
            g = k % GROUPS
            for _ in range(counts[i, k]):
                a, t = _bent_primitive(intervals[row, 1], nt)
                if intervals[row, 0] < np.inf:
                    a0, t0 = _bent_primitive(intervals[row, 0], nt)
                    a, t = a - a0, t - t0
                local[g, 0] += t * c
                local[g, 1] += t * s
                local[g, 2] += a
                row += 1
        for g in range(GROUPS + 1):
            for j in range(3):
                out[i, g, j] = (
                    local[g, 0] * frame[0, j] + local[g, 1] * frame[1, j] + local[g, 2] * frame[2, j]
                )


def hemisphere_fraction(visible: RadialIntervals, weighting: str) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) dw for "cosine", (1/2pi) int V dw over the hemisphere for "uniform".

    Over a cone, of what an open cone has.

    Returns
    -------
    value, error_estimate : (n,) float64
    """
    lines = line_table(visible.counts.shape[1])
    groups = np.empty((len(visible.counts), GROUPS))
    kind = COSINE if weighting == "cosine" else UNIFORM
    table = normal_table(lines, visible.cone)
    radial_fraction(table, visible.counts, visible.starts, visible.intervals, kind, groups)
    return np.clip(groups.mean(axis=1), 0.0, 1.0), estimate_error(groups)


def sky_view_factor(visible: RadialIntervals, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) [up.w > 0] dw, whose open value is (1 + n.up) / 2.

    Over a cone, of what an open cone has: the open value is the cone's share that lies above up's horizon.
    """
    lines = line_table(visible.counts.shape[1])
    shares = np.empty((len(visible.counts), GROUPS + 1))
    radial_sky(
        lines,
        normal_table(lines, visible.cone),
        visible.normals,
        up,
        visible.counts,
        visible.starts,
        visible.intervals,
        shares,
    )
    open_value = _open_sky(visible.normals @ up, visible.cone)
    return np.clip(shares[:, GROUPS], 0.0, 1.0) * open_value, estimate_error(shares[:, :GROUPS]) * open_value


def _open_sky(cosine: np.ndarray, cone: float) -> np.ndarray:
    """Share of an open cone's n.w above a second horizon, from the cosine n.up (n,).

    Half the contour integral of sin^2(theta) dphi about n: along the cone's circle, and where it leaves the
    sky along the great circle of the horizon.
    """
    if cone == 0.0:
        return np.asarray(0.5 * (1.0 + cosine))
    c = np.clip(cosine, -1.0, 1.0)
    s = np.sqrt(1.0 - c * c)
    sine = np.sqrt(1.0 - cone * cone)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.arccos(np.clip(-(cone * c) / (sine * s), -1.0, 1.0))
        half = np.arccos(np.clip(cone / s, -1.0, 1.0))
    share = (sine * sine * turn + c * half) / (np.pi * sine * sine)
    return np.where(s <= cone, c > 0.0, share)


def bent_normal(visible: RadialIntervals) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) w dw: (n, 3), 2/3 n under an open sky; the estimate is that of its length.

    Over a cone it is divided by sin^2 of the cone, which is what an open cone has of (1/pi) n.w.
    """
    n_lines = visible.counts.shape[1]
    lines = line_table(n_lines)
    sums = np.empty((len(visible.counts), GROUPS + 1, 3))
    table = normal_table(lines, visible.cone)
    radial_bent(lines, table, visible.normals, visible.counts, visible.starts, visible.intervals, sums)
    sums *= 2.0 / n_lines / (1.0 - visible.cone * visible.cone)  # 2 pi / K a line, over pi
    # What the lines miss of an open hemisphere is given back in the proportion that is open.
    fraction, _ = hemisphere_fraction(visible, "cosine")
    open_length = (2.0 / 3.0) * (1.0 + visible.cone + visible.cone**2) / (1.0 + visible.cone)
    missed = open_length * visible.normals - sums[:, GROUPS]
    value = sums[:, :GROUPS].sum(axis=1) + fraction[:, None] * missed
    spread = np.linalg.norm(GROUPS * sums[:, :GROUPS] - value[:, None], axis=2)
    return value, np.minimum(ERROR_OF_SPREAD * np.sqrt((spread**2).mean(axis=1)), 1.0)


def estimate_error(groups: np.ndarray) -> np.ndarray:
    """Error of the mean of interleaved groups of lines, from their spread: (n, GROUPS) -> (n,)."""
    spread = groups - groups.mean(axis=1, keepdims=True)
    estimate: np.ndarray = ERROR_OF_SPREAD * np.sqrt((spread**2).mean(axis=1))
    return np.minimum(estimate, 1.0)
