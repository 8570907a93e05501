"""The visible region's boundary, exactly: an angular sweep over the contour edges seen from a shade point.

A half-plane turns once about the axis A of the point's frame. The edges that it cuts form a list, from the
axis down; between two neighbours in it the depth count W is constant, and where W = 0 the point sees out.
Nothing happens to the list but

    an edge ends or starts      at a vertex, or where it dips under the horizon: the events, sorted
    two edges cross             between two events: where their order has changed

so all that is decided in floating point is the order of events by azimuth, and the order of the list at each
event, from one product and a sum an edge. Each order is taken as it is found, and what it implies follows
combinatorially: pairs whose order changed have crossed, once; W is summed along the list. The result is the
exact arrangement of arcs that differ from the given ones by rounding, whatever degeneracies there are [SI92];
nothing has to be in general position, and no error grows.

An edge is part of the boundary where W = 0 on one side of it. (A depth count jumps by two or one across every
contour edge, so never on both.) Where the last region of the list is visible, so is the horizon below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.arc_crossings import crossed_twice, reorder
from silint.core.arc_edges import (
    ACROSS,
    ALONG,
    END,
    GAIN,
    N_CIRCLE,
    N_EDGE,
    N_STATE,
    NARROW,
    OPEN,
    ROUND,
    SIDE,
    START,
    STEEP,
)
from silint.core.arc_list import (
    ABOVE,
    ACROSS_M,
    ALONG_T,
    EDGE,
    N_REAL,
    N_WHOLE,
    STEP,
    VALUE,
    axis_of,
    evaluate,
    in_order,
    move,
    out_of_order,
    place_of,
    put,
    value_above,
)
from silint.core.boundary import N_ARC, on_edge, show, show_horizon, visible_side
from silint.core.jit import INNER
from silint.core.small_circle import slope_at

# Negative W over less than this, in azimuth and in height, is rounding.
_NEGATIVE = 1e-9


class Sweep(NamedTuple):
    """Scratch of the sweep, with room for so many edges at once."""

    edges: np.ndarray  # (capacity, N_EDGE) float64
    circles: np.ndarray  # (capacity, N_CIRCLE) float64
    state: np.ndarray  # (capacity, N_STATE) int32
    key: np.ndarray  # (2 capacity,) float64: azimuths of events, see arc_edges.direct_edges
    tie: np.ndarray  # (2 capacity,) int32
    places: np.ndarray  # (2 capacity, 4) float64: azimuth and direction of events, sorted
    codes: np.ndarray  # (2 capacity, 2) int32: twice the edge, and 1 more where it ends; tie
    bins: np.ndarray  # (2 capacity + 2,) int32
    whole: np.ndarray  # (N_WHOLE, capacity) int32: edges under the half-plane, see arc_list
    real: np.ndarray  # (N_REAL, capacity) float64
    pairs: np.ndarray  # (pairs, 2) int32: edges that cross, the upper one first
    spots: np.ndarray  # (pairs, 5) float64: azimuth and direction of their crossing, and the edge it is on
    arcs: np.ndarray  # (arcs, N_ARC) float64


@njit(**INNER)
def new_sweep(capacity, pairs, arcs):
    """Room for so many edges above the horizon, and so many crossings between two events."""
    events = 2 * capacity
    return Sweep(
        np.empty((capacity, N_EDGE)),
        np.empty((capacity, N_CIRCLE)),
        np.empty((capacity, N_STATE), np.int32),
        np.empty(events),
        np.empty(events, np.int32),
        np.empty((events, 4)),
        np.empty((events, 2), np.int32),
        np.empty(events + 2, np.int32),
        np.empty((N_WHOLE, capacity), np.int32),
        np.empty((N_REAL, capacity)),
        np.empty((pairs, 2), np.int32),
        np.empty((pairs, 5)),
        np.empty((arcs, N_ARC)),
    )


@njit(**INNER)
def _sort_events(sweep, n):
    """Sort events by azimuth and vertex: into bins by azimuth, then by insertion."""
    key, tie, bins, edges = sweep.key, sweep.tie, sweep.bins, sweep.edges
    at, code = sweep.places, sweep.codes
    per_radian = n / (2.0 * np.pi)
    for i in range(n + 2):
        bins[i] = 0
    for i in range(n):
        bins[int(key[i] * per_radian) + 1] += 1
    for i in range(n):
        bins[i + 1] += bins[i]
    for i in range(n):
        b = int(key[i] * per_radian)
        j = bins[b]
        bins[b] = j + 1
        e, axis = i >> 1, END if i & 1 else START
        at[j, 0], at[j, 1], at[j, 2], at[j, 3] = (
            key[i],
            edges[e, axis],
            edges[e, axis + 1],
            edges[e, axis + 2],
        )
        code[j, 0], code[j, 1] = i, tie[i]
    for i in range(1, n):
        k, c, t = at[i, 0], code[i, 0], code[i, 1]
        j = i - 1
        if at[j, 0] < k:
            continue
        x, y, z = at[i, 1], at[i, 2], at[i, 3]
        while j >= 0 and (at[j, 0] > k or (at[j, 0] == k and code[j, 1] > t)):
            for r in range(4):
                at[j + 1, r] = at[j, r]
            code[j + 1, 0], code[j + 1, 1] = code[j, 0], code[j, 1]
            j -= 1
        at[j + 1, 0], at[j + 1, 1], at[j + 1, 2], at[j + 1, 3] = k, x, y, z
        code[j + 1, 0], code[j + 1, 1] = c, t


@njit(**INNER)
def _slope(e, x, y, z, circles, edges, state, ball):
    if ball is not None:
        if state[e, NARROW] == ROUND:
            return slope_at(axis_of(e, edges), x, y, z)
    if state[e, NARROW] and edges[e, STEEP] != 0.0:
        return np.inf * edges[e, STEEP]
    return circles[e, ACROSS] * x - circles[e, ALONG] * y


@njit(**INNER)
def _negative(n_active, bottom, r, whole, real):
    """Whether W is negative somewhere, over more than rounding."""
    for k in range(1, n_active):
        over = real[VALUE, k - 1] - real[VALUE, k]
        if whole[ABOVE, k] < 0 and over > _NEGATIVE * (r + abs(real[VALUE, k])):
            return True
    return bottom < 0


@njit(**INNER)
def _lowest(n_active, bottom, whole):
    least = bottom
    for k in range(n_active):
        least = min(least, whole[ABOVE, k])
    return least


@njit(**INNER)
def _end_values(first, last, code, z, n_active, whole, real):
    """Give edges that end here their exact value; the first place of one, n_active if there is none."""
    position = n_active
    for i in range(first, last):
        if code[i, 0] & 1:
            k = place_of(code[i, 0] >> 1, n_active, whole)
            real[VALUE, k] = z
            position = min(position, k)
    return position


@njit(**INNER)
def _first_list(sweep, ball, n_edges):
    """Write the edges that the half-plane cuts at azimuth 0; their number, and that of narrow ones."""
    edges, circles, state = sweep.edges, sweep.circles, sweep.state
    whole, real, key = sweep.whole, sweep.real, sweep.key
    n_active, n_narrow = 0, 0
    for e in range(n_edges):
        if key[2 * e] > key[2 * e + 1]:
            v = value_above(e, 1.0, 0.0, circles, edges, state, ball)
            slope, k = _slope(e, 1.0, 0.0, v, circles, edges, state, ball), n_active
            while k > 0 and (
                real[VALUE, k - 1] < v
                or (
                    real[VALUE, k - 1] == v
                    and _slope(whole[EDGE, k - 1], 1.0, 0.0, v, circles, edges, state, ball) < slope
                )
            ):
                k -= 1
            for i in range(n_active, k, -1):
                move(i - 1, i, whole, real)
            put(e, k, whole, real, circles, state)
            real[VALUE, k] = v
            n_active += 1
            n_narrow += state[e, NARROW]
    return n_active, n_narrow


@njit(**INNER)
def _look_ahead(e, key_now, n_active, sweep, ball, n_stops):
    """Add stops between pairs of crossings of edge e with edges of the list; a great circle has one at most.

    Returns
    -------
    The number of stops, -1 where there is no room for them.
    """
    edges, state, whole, key, stops = sweep.edges, sweep.state, sweep.whole, sweep.key, ball.stops
    end = key[2 * e + 1] if key[2 * e + 1] > key_now else 2.0 * np.pi
    for k in range(n_active):
        f = whole[EDGE, k]
        if f == e or (state[e, NARROW] != ROUND and state[f, NARROW] != ROUND):
            continue
        other = key[2 * f + 1] if key[2 * f + 1] > key_now else 2.0 * np.pi
        stop = crossed_twice(e, f, key_now, min(end, other), edges, state, ball)
        if stop < 0.0:
            continue
        if n_stops == len(stops):
            return -1
        i = n_stops
        while i > 0 and stops[i - 1, 0] < stop:
            stops[i, 0], stops[i, 1], stops[i, 2] = stops[i - 1, 0], stops[i - 1, 1], stops[i - 1, 2]
            i -= 1
        stops[i, 0], stops[i, 1], stops[i, 2] = stop, np.cos(stop), np.sin(stop)
        n_stops += 1
    return n_stops


@njit(**INNER)
def sweep_arcs(sweep, ball, n_edges, n_closed, w, normal):
    """Append the boundary arcs of what a shade point sees.

    Parameters
    ----------
    sweep : Sweep
        With edges and events, from arc_edges.direct_edges.
    ball : Ball or None
        With a maximum distance: has arcs of small circles, from ball_arcs.cut_faces.
    n_closed : int
        Where edges have to balance, events have a tie below this: see `arc_edges.direct_edges`.
    w : int
        W at the axis.
    normal : tuple of 3 float
        In the frame.

    Returns
    -------
    n : int
        More than the capacity where there was no room.
    sound : int
        1; 0 where W contradicts itself; -1 where there was no room for crossings.
    crossings : int
    """
    edges, circles, state, whole, real = sweep.edges, sweep.circles, sweep.state, sweep.whole, sweep.real
    at, code = sweep.places, sweep.codes
    arcs, n_events, n = sweep.arcs, 2 * n_edges, 0
    _sort_events(sweep, n_events)
    n_active, n_narrow = _first_list(sweep, ball, n_edges)
    sound, all_crossings, bottom = 1, 0, w
    for k in range(n_active):
        e = whole[EDGE, k]
        whole[ABOVE, k] = bottom
        x, y, z = on_edge(e, 1.0, 0.0, circles, edges, state, ball)
        n = show(e, visible_side(bottom, whole[STEP, k]), x, y, z, edges, state, arcs, n)
        bottom += whole[STEP, k]
    lowest = bottom
    key_0, horizon_key, horizon_t, horizon_m = 0.0, 0.0, 1.0, 0.0
    horizon = bottom == 0

    first, n_stops = 0, 0
    if ball is not None:
        for k in range(n_active):
            n_stops = _look_ahead(whole[EDGE, k], 0.0, k, sweep, ball, n_stops)
            if n_stops < 0:
                return n, -1, 0
    while first < n_events or n_stops > 0:
        if ball is not None:
            stop = ball.stops[n_stops - 1, 0] if n_stops > 0 else np.inf
            if stop < (at[first, 0] if first < n_events else np.inf):
                n_stops -= 1
                x, y = ball.stops[n_stops, 1], ball.stops[n_stops, 2]
                evaluate(n_active, n_narrow, x, y, whole, real, edges, state, ball)
                n, crossings, low = reorder(sweep, ball, n_active, key_0, stop, x, y, n)
                if crossings < 0:
                    return n, -1, 0
                all_crossings += crossings
                lowest, key_0 = min(lowest, low), stop
                continue
        last = first + 1
        while last < n_events and at[last, 0] == at[first, 0] and code[last, 1] == code[first, 1]:
            last += 1
        key, x, y, z = at[first, 0], at[first, 1], at[first, 2], at[first, 3]
        # The usual vertex, where one edge follows another.
        usual, position = last - first == 2 and (code[first, 0] ^ code[first + 1, 0]) & 1 == 1, n_active
        e, f = code[first, 0] >> 1, code[last - 1, 0] >> 1
        if usual:
            e, f = (e, f) if code[first, 0] & 1 else (f, e)
            position = place_of(e, n_active, whole)
        if not usual or n_narrow > 0 or lowest < 0 or not in_order(n_active, x, y, position, z, real):
            evaluate(n_active, n_narrow, x, y, whole, real, edges, state, ball)
            position = _end_values(first, last, code, z, n_active, whole, real)
            if out_of_order(n_active, real):
                n, crossings, low = reorder(sweep, ball, n_active, key_0, key, x, y, n)
                if crossings < 0:
                    return n, -1, 0
                all_crossings += crossings
                position = _end_values(first, last, code, z, n_active, whole, real)
                lowest = min(lowest, low)
            if lowest < 0:
                r = np.sqrt(x * x + y * y)
                if key - key_0 > _NEGATIVE and _negative(n_active, bottom, r, whole, real):
                    sound = 0
                lowest = _lowest(n_active, bottom, whole)
        key_0, i_0, first = key, first, last

        if usual and state[e, GAIN] == state[f, GAIN]:
            side = state[e, SIDE]
            if side != 0:
                n = show(e, 0, x, y, z, edges, state, arcs, n)
                state[f, SIDE] = side
                edges[f, OPEN], edges[f, OPEN + 1], edges[f, OPEN + 2] = x, y, z
            whole[EDGE, position] = f
            real[ALONG_T, position], real[ACROSS_M, position] = circles[f, ALONG], circles[f, ACROSS]
            n_narrow += state[f, NARROW] - state[e, NARROW]
            if ball is not None:
                n_stops = _look_ahead(f, key, n_active, sweep, ball, n_stops)
                if n_stops < 0:
                    return n, -1, 0
            continue

        balance, ended, begun = 0, 0, 0
        for i in range(i_0, last):
            if code[i, 0] & 1:
                e = code[i, 0] >> 1
                n = show(e, 0, x, y, z, edges, state, arcs, n)
                balance += state[e, GAIN]
                n_narrow -= state[e, NARROW]
                k = place_of(e, n_active, whole)
                n_active -= 1
                for j in range(k, n_active):
                    move(j + 1, j, whole, real)
                ended += 1
        if ended == 0:
            position = 0
            for k in range(n_active):
                position += real[VALUE, k] > z
        for i in range(i_0, last):
            if not code[i, 0] & 1:
                e = code[i, 0] >> 1
                balance -= state[e, GAIN]
                n_narrow += state[e, NARROW]
                slope, k = _slope(e, x, y, z, circles, edges, state, ball), position + begun
                while k > position and (
                    _slope(whole[EDGE, k - 1], x, y, z, circles, edges, state, ball) < slope
                ):
                    k -= 1
                for j in range(n_active, k, -1):
                    move(j - 1, j, whole, real)
                put(e, k, whole, real, circles, state)
                n_active += 1
                begun += 1
        if ball is not None:
            for k in range(position, position + begun):
                n_stops = _look_ahead(whole[EDGE, k], key, n_active, sweep, ball, n_stops)
                if n_stops < 0:
                    return n, -1, 0
        if balance != 0 and code[i_0, 1] < n_closed:
            sound = 0

        here = w
        if position > 0:
            here = whole[ABOVE, position - 1] + whole[STEP, position - 1]
        for k in range(position, n_active):
            if k >= position + begun and whole[ABOVE, k] == here:
                break
            e, step = whole[EDGE, k], whole[STEP, k]
            whole[ABOVE, k] = here
            lowest = min(lowest, here)
            side = visible_side(here, step)
            here += step
            if k < position + begun:
                n = show(e, side, x, y, z, edges, state, arcs, n)
            else:
                ex, ey, ez = on_edge(e, x, y, circles, edges, state, ball)
                n = show(e, side, ex, ey, ez, edges, state, arcs, n)
        bottom = w
        if n_active > 0:
            bottom = whole[ABOVE, n_active - 1] + whole[STEP, n_active - 1]
        lowest = min(lowest, bottom)
        if (bottom == 0) != horizon:
            if horizon:
                n = show_horizon(horizon_key, key, horizon_t, horizon_m, x, y, normal, arcs, n)
            horizon, horizon_key, horizon_t, horizon_m = not horizon, key, x, y

    evaluate(n_active, 1, 1.0, 0.0, whole, real, edges, state, ball)
    if out_of_order(n_active, real):
        key = 2.0 * np.pi
        n, crossings, _ = reorder(sweep, ball, n_active, key_0, key, 1.0, 0.0, n)
        if crossings < 0:
            return n, -1, 0
        all_crossings += crossings
    for k in range(n_active):
        x, y, z = on_edge(whole[EDGE, k], 1.0, 0.0, circles, edges, state, ball)
        n = show(whole[EDGE, k], 0, x, y, z, edges, state, arcs, n)
    if horizon:
        n = show_horizon(horizon_key, 2.0 * np.pi, horizon_t, horizon_m, 1.0, 0.0, normal, arcs, n)
    return n, sound, all_crossings
