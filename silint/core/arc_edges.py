"""Contour edges of a shade point on the sphere of directions: clipped, directed, ready for the sweep.

In the frame (T, M, A) of `radial` an edge is a great circle arc with cot(theta) = along cos(phi) + across
sin(phi). It is cut off at the horizon of the normal, and directed so that it runs towards rising azimuth.
Azimuths are keys: one number for each vertex, the same in all of its edges, and every question of direction
is answered from them. So the arcs close up wherever edges do, whatever rounding did to the keys.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER
from silint.core.lanes import WIDTH
from silint.core.radial import AT_POINT, azimuth, in_frame

# An edge of the sweep: unit normal, start and end; where the visible arc began that is being followed; what
# cot(theta) stays between; and +-1 where it has no slope.
NORMAL, START, END, OPEN, LOW, HIGH, STEEP, N_EDGE = 0, 3, 6, 9, 12, 13, 14, 15
# What is read of all edges in the order of azimuth has arrays of its own, which caches hold. Coefficients of
# cot(theta):
ALONG, ACROSS, N_CIRCLE = 0, 1, 2
# What the depth count gains across it, away from the axis; its vertices; the visible side (+1 towards the
# axis, -1 away from it, 0 neither); whether it is kept between LOW and HIGH, or even lies on a small circle,
# which is ROUND.
GAIN, FROM, TO, SIDE, NARROW, N_STATE = 0, 1, 2, 3, 4, 5
ROUND = 2

# Fields of 16 lanes. Both ends and the edge from the shade point; then the clipped ends, the normal, along
# and across, azimuths of the clipped ends and of the whole edge's, N_A, cot(theta) of the clipped ends, and
# heights of the whole edge's.
_A, _B, _E, _AC, _BC, _N, _CIRCLE, _KEY, _WHOLE, _TURN, _COT = 0, 3, 6, 9, 12, 15, 18, 20, 22, 24, 25
_HEIGHT, N_LANE_FIELDS = 27, 29

# Edges narrower than this in azimuth are kept between their ends: their slope is all rounding.
_NARROW = 1e-6
# Half a turn within this is told by the sign of N_A.
_HALF_TURN = 1e-9
# Sine below which an edge passes through the shade point; square of what a unit vector has across an edge
# below which it counts as along it.
_THROUGH, _ALONG_NORMAL = 4e-16, 1e-30

_UW = np.uint64(WIDTH)
_U = tuple(np.uint64(i * WIDTH) for i in range(N_LANE_FIELDS))
(
    _U0, _U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8, _U9, _U10, _U11, _U12, _U13, _U14, _U15, _U16, _U17, _U18,
    _U19, _U20, _U21, _U22, _U23, _U24, _U25, _U26, _U27, _U28,
) = _U  # fmt: skip


@njit(**INNER)
def half_turn(key_a, key_b):
    """Whether azimuths alone do not tell which way an arc between them runs."""
    return abs(abs(key_b - key_a) - np.pi) < _HALF_TURN


@njit(**INNER)
def turns_left(key_a, key_b, turn):
    """Whether an arc from a to b, shorter than pi, runs towards rising azimuth."""
    d = key_b - key_a
    if half_turn(key_a, key_b):
        return turn > 0.0
    return 0.0 <= d < np.pi or d < -np.pi


@njit(**INNER)
def is_narrow(key_a, key_b):
    """Whether an edge between two azimuths is kept between its ends."""
    return abs(key_b - key_a) < _NARROW or abs(key_b - key_a) > 2.0 * np.pi - _NARROW


@njit(**INNER)
def runs_left(left, key_a, key_b, tie_a, tie_b):
    """Whether what is left of an edge above the horizon runs towards rising azimuth, as all of it does.

    It may be so short that its azimuths say the contrary.
    """
    d = key_b - key_a if left else key_a - key_b
    if -0.5 * np.pi < d < 0.0 or d > 1.5 * np.pi:
        left = not left
    return tie_a < tie_b if key_a == key_b else left


@njit(**INNER)
def passes_through(ax, ay, az, ex, ey, ez, n):
    """Where an edge that passes through the shade point is seen midway: (0, 0, 0) for all others.

    The point is thought to be pushed along its normal, then along x and y, as `contour.plane_side` decides
    the sides of faces; the edge passes on the other side.

    Parameters
    ----------
    ax, ay, az : float
        One end from the shade point.
    ex, ey, ez : float
        From there to the other end.
    """
    square = ex * ex + ey * ey + ez * ez
    x, y, z = ay * ez - az * ey, az * ex - ax * ez, ax * ey - ay * ex
    between = -(ax * ex + ay * ey + az * ez)
    off = x * x + y * y + z * z > _THROUGH * _THROUGH * square * (ax * ax + ay * ay + az * az)
    if off or between <= 0.0 or between >= square:
        return 0.0, 0.0, 0.0
    s = 1.0 / np.sqrt(square)
    ex, ey, ez = s * ex, s * ey, s * ez
    along = n[0] * ex + n[1] * ey + n[2] * ez
    x, y, z = along * ex - n[0], along * ey - n[1], along * ez - n[2]
    if x * x + y * y + z * z < _ALONG_NORMAL:
        x, y, z = ex * ex - 1.0, ex * ey, ex * ez
        if x * x + y * y + z * z < _ALONG_NORMAL:
            x, y, z = ey * ex, ey * ey - 1.0, ey * ez
    return x, y, z


@njit(**INNER)
def _bend(lanes, i, frame, n):
    """Let lane i, whose ends are seen half a turn apart, pass where `passes_through` says."""
    ax, ay, az = lanes[i], lanes[i + WIDTH], lanes[i + 2 * WIDTH]
    bx, by, bz = lanes[i + _B * WIDTH], lanes[i + (_B + 1) * WIDTH], lanes[i + (_B + 2) * WIDTH]
    ex, ey, ez = lanes[i + _E * WIDTH], lanes[i + (_E + 1) * WIDTH], lanes[i + (_E + 2) * WIDTH]
    dx, dy, dz = passes_through(ax, ay, az, ex, ey, ez, n)
    if dx == 0.0 and dy == 0.0 and dz == 0.0:
        return
    x, y, z = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    nt, nm, turn = in_frame(x, y, z, frame)
    s = 1.0 / np.sqrt(nt * nt + nm * nm + turn * turn)
    for axis, v in ((0, nt), (1, nm), (2, turn)):
        lanes[(_N + axis) * WIDTH + i] = s * v
    lanes[_CIRCLE * WIDTH + i], lanes[(_CIRCLE + 1) * WIDTH + i] = -nt / turn, -nm / turn
    lanes[_TURN * WIDTH + i] = turn
    # From the upper end to the horizon.
    a_up, b_up = lanes[_HEIGHT * WIDTH + i], lanes[(_HEIGHT + 1) * WIDTH + i]
    k = (n[0] * dx + n[1] * dy + n[2] * dz) / max(a_up, b_up)
    ux, uy, uz = (ax, ay, az) if a_up > b_up else (bx, by, bz)
    t, m, a = in_frame(dx - k * ux, dy - k * uy, dz - k * uz, frame)
    s = 1.0 / np.sqrt(t * t + m * m + a * a)
    out, which = (_BC, 1) if a_up > b_up else (_AC, 0)
    lanes[out * WIDTH + i], lanes[(out + 1) * WIDTH + i], lanes[(out + 2) * WIDTH + i] = s * t, s * m, s * a
    lanes[(_KEY + which) * WIDTH + i] = azimuth(t, m)
    lanes[(_COT + which) * WIDTH + i] = a / np.sqrt(t * t + m * m)


@njit(**INNER)
def _project(lanes, frame, n):
    """Fields from _AC on, of 16 edges."""
    f00, f01, f02 = frame[0, 0], frame[0, 1], frame[0, 2]
    f10, f11, f12 = frame[1, 0], frame[1, 1], frame[1, 2]
    f20, f21, f22 = frame[2, 0], frame[2, 1], frame[2, 2]
    n0, n1, n2 = n
    for i in range(_UW):
        x, y, z = lanes[i], lanes[i + _U1], lanes[i + _U2]
        at, am, aa = f00 * x + f01 * y + f02 * z, f10 * x + f11 * y + f12 * z, f20 * x + f21 * y + f22 * z
        a_height = n0 * x + n1 * y + n2 * z
        x, y, z = lanes[i + _U3], lanes[i + _U4], lanes[i + _U5]
        bt, bm, ba = f00 * x + f01 * y + f02 * z, f10 * x + f11 * y + f12 * z, f20 * x + f21 * y + f22 * z
        b_height = n0 * x + n1 * y + n2 * z
        x, y, z = lanes[i + _U6], lanes[i + _U7], lanes[i + _U8]
        et, em, ea = f00 * x + f01 * y + f02 * z, f10 * x + f11 * y + f12 * z, f20 * x + f21 * y + f22 * z
        key_a, key_b = azimuth(at, am), azimuth(bt, bm)

        # As ratios of heights: differences of a and b would lose everything next to the shade point.
        wa, wb = abs(a_height), abs(b_height)
        ht, hm, ha = wa * bt + wb * at, wa * bm + wb * am, wa * ba + wb * aa
        a_out, b_out = not (a_height > 0.0), not (b_height > 0.0)
        nt, nm, turn = am * ea - aa * em, aa * et - at * ea, at * em - am * et
        at, am, aa = ht if a_out else at, hm if a_out else am, ha if a_out else aa
        bt, bm, ba = ht if b_out else bt, hm if b_out else bm, ha if b_out else ba

        s = 1.0 / np.sqrt(at * at + am * am + aa * aa)
        lanes[i + _U9], lanes[i + _U10], lanes[i + _U11] = s * at, s * am, s * aa
        s = 1.0 / np.sqrt(bt * bt + bm * bm + ba * ba)
        lanes[i + _U12], lanes[i + _U13], lanes[i + _U14] = s * bt, s * bm, s * ba
        # An edge that points at p has no plane, and no length.
        square = nt * nt + nm * nm + turn * turn
        s = 1.0 / np.sqrt(square) if square > 0.0 else 0.0
        lanes[i + _U15], lanes[i + _U16], lanes[i + _U17] = s * nt, s * nm, s * turn
        s = -1.0 / turn
        lanes[i + _U18], lanes[i + _U19] = s * nt, s * nm
        key = azimuth(ht, hm)
        lanes[i + _U20], lanes[i + _U21] = key if a_out else key_a, key if b_out else key_b
        lanes[i + _U22], lanes[i + _U23] = key_a, key_b
        lanes[i + _U24] = turn
        lanes[i + _U25] = aa / np.sqrt(at * at + am * am)
        lanes[i + _U26] = ba / np.sqrt(bt * bt + bm * bm)
        lanes[i + _U27], lanes[i + _U28] = a_height, b_height


@njit(**INNER)
def _cut_lane(lanes, i, cuts, e, places):
    """Let lane i be what a ball leaves of contour edge e."""
    start, end = cuts[e, 0], cuts[e, 1]
    if start < 0 and end < 0:
        return
    s = places[end, 3] if end >= 0 else 1.0
    s -= places[start, 3] if start >= 0 else 0.0
    for axis in range(3):
        lanes[axis * WIDTH + i] = places[start, axis] if start >= 0 else lanes[axis * WIDTH + i]
        lanes[(_B + axis) * WIDTH + i] = places[end, axis] if end >= 0 else lanes[(_B + axis) * WIDTH + i]
        lanes[(_E + axis) * WIDTH + i] *= s


@njit(**INNER)
def direct_edges(
    vertices, contours, n_contours, ball, n_closed, p, n, frame, lanes, edges, circles, state, key, tie
):
    """Edges of the sweep and its events, from contour edges.

    Parameters
    ----------
    contours : (capacity, 3) int32
        See `contour.decide_contours`.
    ball : Ball or None
        Of which edges have parts within: see `ball_hits.clip_contours`.
    n_closed : int
        Numbers below this stand for places where edges follow each other: vertices, and ends in a ball.
    lanes : (N_LANE_FIELDS * 16,) float64
        Scratch.
    edges, circles, state : (capacity, N_EDGE), (capacity, N_CIRCLE) float64, (capacity, N_STATE) int32, out
    key, tie : (2 capacity,) float64, int32, out
        Events: edge e starts at 2 e and ends at 2 e + 1. Their azimuth, and the vertex there, or a number of
        its own on the horizon.
    """
    n_vertices = len(vertices)
    for first in range(0, n_contours, WIDTH):
        number = min(WIDTH, n_contours - first)
        for i in range(number):
            a, b = contours[first + i, 0], contours[first + i, 1]
            for axis in range(3):
                lanes[axis * WIDTH + i] = vertices[a, axis] - p[axis]
                lanes[(_B + axis) * WIDTH + i] = vertices[b, axis] - p[axis]
                lanes[(_E + axis) * WIDTH + i] = vertices[b, axis] - vertices[a, axis]
            if ball is not None:
                _cut_lane(lanes, i, ball.cuts, first + i, ball.hits.places)
            # A vertex at the shade point is seen along -n.
            for end in (_A, _B):
                j = end * WIDTH + i
                if lanes[j] == 0.0 and lanes[j + WIDTH] == 0.0 and lanes[j + 2 * WIDTH] == 0.0:
                    for axis in range(3):
                        lanes[j + axis * WIDTH] = -AT_POINT * n[axis]
        _project(lanes, frame, n)
        for i in range(number):
            e = first + i
            a, b, jump = contours[e, 0], contours[e, 1], contours[e, 2]
            if half_turn(lanes[_WHOLE * WIDTH + i], lanes[(_WHOLE + 1) * WIDTH + i]):
                _bend(lanes, i, frame, n)
            key_a, key_b = lanes[_KEY * WIDTH + i], lanes[(_KEY + 1) * WIDTH + i]
            whole_a, whole_b = lanes[_WHOLE * WIDTH + i], lanes[(_WHOLE + 1) * WIDTH + i]
            tie_a, tie_b = np.int64(a), np.int64(b)
            if ball is not None:
                tie_a = tie_a if ball.cuts[e, 0] < 0 else np.int64(n_vertices + ball.cuts[e, 0])
                tie_b = tie_b if ball.cuts[e, 1] < 0 else np.int64(n_vertices + ball.cuts[e, 1])
            tie_a = tie_a if lanes[_HEIGHT * WIDTH + i] > 0.0 else np.int64(n_closed + e)
            tie_b = tie_b if lanes[(_HEIGHT + 1) * WIDTH + i] > 0.0 else np.int64(n_closed + e)
            left = turns_left(whole_a, whole_b, lanes[_TURN * WIDTH + i])
            left = runs_left(left, key_a, key_b, tie_a, tie_b)
            sign = 1.0 if left else -1.0
            start, end = (_AC, _BC) if left else (_BC, _AC)
            for axis in range(3):
                edges[e, NORMAL + axis] = sign * lanes[(_N + axis) * WIDTH + i]
                edges[e, START + axis] = lanes[(start + axis) * WIDTH + i]
                edges[e, END + axis] = lanes[(end + axis) * WIDTH + i]
            _straighten(e, edges)
            circles[e, ALONG], circles[e, ACROSS] = (
                lanes[_CIRCLE * WIDTH + i],
                lanes[(_CIRCLE + 1) * WIDTH + i],
            )
            edges[e, LOW], edges[e, HIGH], edges[e, STEEP] = -np.inf, np.inf, 0.0
            narrow = is_narrow(key_a, key_b)
            if narrow:
                cot_a, cot_b = lanes[_COT * WIDTH + i], lanes[(_COT + 1) * WIDTH + i]
                edges[e, LOW], edges[e, HIGH] = min(cot_a, cot_b), max(cot_a, cot_b)
                if not (abs(circles[e, ALONG]) + abs(circles[e, ACROSS]) < np.inf):
                    circles[e, ALONG], circles[e, ACROSS] = 0.0, 0.0
                    edges[e, STEEP] = 1.0 if (cot_b > cot_a) == left else -1.0
            state[e, GAIN] = -jump if left else jump
            state[e, FROM], state[e, TO] = (a, b) if left else (b, a)
            state[e, SIDE], state[e, NARROW] = 0, narrow
            key[2 * e], key[2 * e + 1] = (key_a, key_b) if left else (key_b, key_a)
            tie[2 * e], tie[2 * e + 1] = (tie_a, tie_b) if left else (tie_b, tie_a)


@njit(**INNER)
def _straighten(e, edges):
    """Make the normal of an edge perpendicular to its start; zero where nothing is known of it.

    The normal of an edge that subtends d is off by rounding / d, in all directions.
    """
    a, b, c = edges[e, START], edges[e, START + 1], edges[e, START + 2]
    x, y, z = edges[e, NORMAL], edges[e, NORMAL + 1], edges[e, NORMAL + 2]
    off = a * x + b * y + c * z
    x, y, z = x - off * a, y - off * b, z - off * c
    square = x * x + y * y + z * z
    s = 1.0 / np.sqrt(square) if square > 0.5 else 0.0
    edges[e, NORMAL], edges[e, NORMAL + 1], edges[e, NORMAL + 2] = s * x, s * y, s * z
