"""Where edges of the sweep cross: what has changed its order between two events, and whether it shows."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.arc_edges import END, GAIN, NARROW, NORMAL, ROUND, SIDE, START
from silint.core.arc_list import (
    ABOVE,
    ACROSS_M,
    ALONG_T,
    BLOCK_FIRST,
    BLOCK_LAST,
    EDGE,
    STEP,
    VALUE,
    WAS,
    axis_of,
)
from silint.core.boundary import on_edge, show, visible_side
from silint.core.jit import INNER
from silint.core.radial import azimuth
from silint.core.small_circle import circles_meet, onto_circle

# Sine of the angle between planes below which their intersection is looked for between events only.
_PARALLEL = 1e-6
# Crossings of circles this far outside of what lies between two events are taken for those at the event.
_NEAR_EVENT = 1e-6
# Edges with shorter chords are cut between their ends; others, which ends do not describe, by their planes.
_SHORT = 1.0


@njit(**INNER)
def _chord(e, edges):
    """Square of the chord from start to end of an edge."""
    x, y = edges[e, START] - edges[e, END], edges[e, START + 1] - edges[e, END + 1]
    z = edges[e, START + 2] - edges[e, END + 2]
    return x * x + y * y + z * z


@njit(**INNER)
def _crossing(e, f, key_0, key_1, t, m, circles, edges, state, ball):
    """Where two edges cross between two events, the second above (t, m).

    The shorter edge is cut by the plane of the longer: a short edge's plane may be known to a few digits
    only, its ends always are.

    Returns
    -------
    key : float
        Azimuth of the crossing.
    x, y, z : float
        Its direction.
    exact : int
        The edge that it lies on to rounding; it is that near to the other's plane.
    """
    if ball is not None:
        if state[e, NARROW] == ROUND or state[f, NARROW] == ROUND:
            return _circle_crossing(e, f, key_0, key_1, t, m, circles, edges, state, ball)
    chord_e, chord_f = _chord(e, edges), _chord(f, edges)
    g, h = (e, f) if chord_e <= chord_f else (f, e)
    chord = np.sqrt(min(chord_e, chord_f))
    a, b, c = edges[h, NORMAL], edges[h, NORMAL + 1], edges[h, NORMAL + 2]
    sx, sy, sz = edges[g, START], edges[g, START + 1], edges[g, START + 2]
    ex, ey, ez = edges[g, END], edges[g, END + 1], edges[g, END + 2]
    start, end = a * sx + b * sy + c * sz, a * ex + b * ey + c * ez
    if chord < _SHORT:
        # Between the ends, even where rounding puts both on one side.
        u, v = abs(end), abs(start)
        if start * end >= 0.0:
            u, v = (0.0, 1.0) if u < v else (1.0, 0.0)
        x, y, z = u * sx + v * ex, u * sy + v * ey, u * sz + v * ez
    else:
        i, j, k = edges[g, NORMAL], edges[g, NORMAL + 1], edges[g, NORMAL + 2]
        x, y, z = j * c - k * b, k * a - i * c, i * b - j * a
        side = 1.0 if x * (sx + ex) + y * (sy + ey) + z * (sz + ez) > 0.0 else -1.0
        x, y, z = side * x, side * y, side * z
    square = x * x + y * y + z * z
    s = 1.0 / np.sqrt(square) if square > 0.0 else 0.0
    x, y, z = s * x, s * y, s * z
    if chord >= _SHORT:
        x, y, z = _onto(g, x, y, z, edges, state, ball)
    key = azimuth(x, y)
    if not (abs(start - end) > _PARALLEL * chord or key_0 <= key <= key_1) or square == 0.0:
        # Planes that agree say nothing; the second event does.
        key, g = key_1, e
        x, y, z = on_edge(e, t, m, circles, edges, state, ball)
    return key, x, y, z, g


@njit(**INNER)
def circle_offset(e, state, ball):
    """c of the circle N.w = c of edge e."""
    return ball.offsets[e] if state[e, NARROW] == ROUND else 0.0


@njit(**INNER)
def _outside(key, key_0, key_1):
    """How far an azimuth lies outside of an interval."""
    return max(key_0 - key, key - key_1, 0.0)


@njit(**INNER)
def _circle_crossing(e, f, key_0, key_1, t, m, circles, edges, state, ball):
    """The same where at least one of both is an arc of a small circle."""
    c, d = circle_offset(e, state, ball), circle_offset(f, state, ball)
    meet, first, second = circles_meet(axis_of(e, edges), c, axis_of(f, edges), d)
    key, other = azimuth(first[0], first[1]), azimuth(second[0], second[1])
    if _outside(other, key_0, key_1) < _outside(key, key_0, key_1):
        key, first = other, second
    if meet and _outside(key, key_0, key_1) < _NEAR_EVENT:
        x, y, z = onto_circle(axis_of(e, edges), c, first[0], first[1], first[2])
        return min(max(key, key_0), key_1), x, y, z, e
    x, y, z = on_edge(e, t, m, circles, edges, state, ball)
    return key_1, x, y, z, e


@njit(**INNER)
def _misses(e, axis, c, edges):
    """Whether an edge lies on one side of the plane N.w = c: short arcs lie in the ball over their chord."""
    a, b, d = axis
    x = a * (edges[e, START] + edges[e, END]) + b * (edges[e, START + 1] + edges[e, END + 1])
    x += d * (edges[e, START + 2] + edges[e, END + 2]) - 2.0 * c
    return x * x > _chord(e, edges)


@njit(**INNER)
def crossed_twice(e, f, key_0, key_1, edges, state, ball):
    """An azimuth between two crossings of two edges within an interval; -1 where there are no two.

    Between events that are found in this way, no two edges cross twice.
    """
    c, d = circle_offset(e, state, ball), circle_offset(f, state, ball)
    axis, other = axis_of(e, edges), axis_of(f, edges)
    if _misses(e, other, d, edges) or _misses(f, axis, c, edges):
        return -1.0
    meet, first, second = circles_meet(axis, c, other, d)
    if not meet:
        return -1.0
    key = azimuth(first[0], first[1])
    if not key_0 < key < key_1:
        return -1.0
    again = azimuth(second[0], second[1])
    return 0.5 * (key + again) if key_0 < again < key_1 else -1.0


@njit(**INNER)
def _onto(e, x, y, z, edges, state, ball):
    """The direction on the plane of edge e that is nearest to (x, y, z)."""
    if ball is not None:
        return onto_circle(axis_of(e, edges), circle_offset(e, state, ball), x, y, z)
    a, b, c = edges[e, NORMAL], edges[e, NORMAL + 1], edges[e, NORMAL + 2]
    off = a * x + b * y + c * z
    x, y, z = x - off * a, y - off * b, z - off * c
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    return s * x, s * y, s * z


@njit(**INNER)
def _cross(i, x, y, z, exact, whole, edges, state, ball, arcs, n):
    """The edges at i and i + 1 of the list trade places at (x, y, z), which is exactly on one of them."""
    e, f, w = whole[EDGE, i], whole[EDGE, i + 1], whole[ABOVE, i]
    gain_e, gain_f = whole[STEP, i], whole[STEP, i + 1]
    whole[EDGE, i], whole[EDGE, i + 1] = f, e
    whole[STEP, i], whole[STEP, i + 1] = gain_f, gain_e
    whole[ABOVE, i + 1] = w + gain_f
    side_f, side_e = visible_side(w, gain_f), visible_side(w + gain_f, gain_e)
    if state[e, SIDE] == side_e and state[f, SIDE] == side_f:
        return n
    ox, oy, oz = _onto(f if exact == e else e, x, y, z, edges, state, ball)
    ex, ey, ez = (x, y, z) if exact == e else (ox, oy, oz)
    fx, fy, fz = (ox, oy, oz) if exact == e else (x, y, z)
    n = show(e, side_e, ex, ey, ez, edges, state, arcs, n)
    return show(f, side_f, fx, fy, fz, edges, state, arcs, n)


@njit(**INNER)
def _place_in(e, first, whole):
    """The place of an edge that is in the block from `first` on."""
    k = first
    while whole[EDGE, k] != e:
        k += 1
    return k


@njit(**INNER)
def _list_pairs(first, last, key_0, key_1, x, y, whole, pairs, places, circles, edges, state, ball):
    """The pairs of a block that have traded places, and where they cross, nearest first.

    Returns
    -------
    found : int
        -1 where there is no room for them.
    """
    found = 0
    for i in range(first + 1, last + 1):
        e = whole[WAS, i]
        rank = _place_in(e, first, whole)
        for j in range(first, i):
            f = whole[WAS, j]
            if _place_in(f, first, whole) < rank:
                continue
            if found == len(pairs):
                return -1
            key, px, py, pz, exact = _crossing(f, e, key_0, key_1, x, y, circles, edges, state, ball)
            c = found
            while c > 0 and places[c - 1, 0] > key:
                for r in range(5):
                    places[c, r] = places[c - 1, r]
                pairs[c, 0], pairs[c, 1] = pairs[c - 1, 0], pairs[c - 1, 1]
                c -= 1
            places[c, 0], places[c, 1], places[c, 2] = key, px, py
            places[c, 3], places[c, 4] = pz, exact
            pairs[c, 0], pairs[c, 1] = f, e
            found += 1
    return found


@njit(**INNER)
def _replay(found, first, last, whole, pairs, places, edges, state, ball, arcs, n):
    """Let the pairs of a block cross, from its old order on: the nearest of those that are neighbours.

    There always are some, so all get done.
    """
    for i in range(first, last + 1):
        whole[EDGE, i] = whole[WAS, i]
        whole[STEP, i] = state[whole[WAS, i], GAIN]
    left, start = found, 0
    while left > 0:
        done = False
        for c in range(start, found):
            e = pairs[c, 0]
            if e < 0:
                start += c == start
                continue
            i = _place_in(e, first, whole)
            if i == last or whole[EDGE, i + 1] != pairs[c, 1]:
                continue
            px, py, pz, exact = places[c, 1], places[c, 2], places[c, 3], int(places[c, 4])
            n = _cross(i, px, py, pz, exact, whole, edges, state, ball, arcs, n)
            pairs[c, 0] = -1
            left -= 1
            done = True
            break
        if not done:
            break  # cannot be
    return n


@njit(**INNER)
def _sort(whole, real, n_active):
    """Sort the list by falling value.

    Returns
    -------
    crossings : int
        Pairs that have traded places.
    blocks : int
        The smallest runs of the list that have been permuted within themselves.
    """
    for i in range(n_active):
        whole[WAS, i] = whole[EDGE, i]
    crossings, blocks = 0, 0
    for i in range(1, n_active):
        v = real[VALUE, i]
        if real[VALUE, i - 1] >= v:
            continue
        e, step, t, m = whole[EDGE, i], whole[STEP, i], real[ALONG_T, i], real[ACROSS_M, i]
        j = i
        while j > 0 and real[VALUE, j - 1] < v:
            real[VALUE, j] = real[VALUE, j - 1]
            real[ALONG_T, j], real[ACROSS_M, j] = real[ALONG_T, j - 1], real[ACROSS_M, j - 1]
            whole[EDGE, j], whole[STEP, j] = whole[EDGE, j - 1], whole[STEP, j - 1]
            j -= 1
        real[VALUE, j], real[ALONG_T, j], real[ACROSS_M, j] = v, t, m
        whole[EDGE, j], whole[STEP, j] = e, step
        crossings += i - j
        while blocks > 0 and whole[BLOCK_LAST, blocks - 1] >= j:
            blocks -= 1
            j = min(j, whole[BLOCK_FIRST, blocks])
        whole[BLOCK_FIRST, blocks], whole[BLOCK_LAST, blocks] = j, i
        blocks += 1
    return crossings, blocks


@njit(**INNER)
def reorder(sweep, ball, n_active, key_0, key_1, x, y, n):
    """Sort the list by falling value; pairs that trade places have crossed by now.

    Mostly all of them are hidden in whatever order they cross; then it does not matter where they do.

    Parameters
    ----------
    sweep : Sweep
        Whose list has values above (x, y).
    ball : Ball or None
    key_0, key_1 : float
        Azimuths of both events; the second is above (x, y).
    n : int
        Arcs so far.

    Returns
    -------
    n : int
        Arcs.
    crossings : int
        -1 where there is no room for them.
    lowest : int
        A bound of W from below, where it has changed.
    """
    circles, edges, state, arcs = sweep.circles, sweep.edges, sweep.state, sweep.arcs
    whole, real, pairs, places = sweep.whole, sweep.real, sweep.pairs, sweep.spots
    crossings, blocks = _sort(whole, real, n_active)
    lowest = 0
    for b in range(blocks):
        first, last = whole[BLOCK_FIRST, b], whole[BLOCK_LAST, b]
        w, least = whole[ABOVE, first], whole[ABOVE, first]
        for k in range(first, last + 1):
            least += min(whole[STEP, k], 0)
        shows = least <= 0
        if shows and last == first + 1:
            below = w + whole[STEP, first]
            shows = (
                state[whole[EDGE, first], SIDE] != visible_side(w, whole[STEP, first])
                or state[whole[EDGE, last], SIDE] != visible_side(below, whole[STEP, last])
            )  # fmt: skip
        if shows:
            found = _list_pairs(
                first, last, key_0, key_1, x, y, whole, pairs, places, circles, edges, state, ball
            )
            if found < 0:
                return n, -1, 0
            n = _replay(found, first, last, whole, pairs, places, edges, state, ball, arcs, n)
        else:
            for k in range(first, last):
                w += whole[STEP, k]
                whole[ABOVE, k + 1] = w
        for k in range(first, last + 1):
            lowest = min(lowest, whole[ABOVE, k])
    return n, crossings, lowest
