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

from silint.core.arc_crossings import reorder
from silint.core.arc_edges import (
    ACROSS,
    ALONG,
    END,
    GAIN,
    HIGH,
    LOW,
    N_EDGE,
    N_STATE,
    OPEN,
    SIDE,
    START,
    STEEP,
)
from silint.core.boundary import N_ARC, on_edge, show, show_horizon, visible_side
from silint.core.jit import INNER

# Negative W over less than this, in azimuth and in height, is rounding.
_NEGATIVE = 1e-9


class Sweep(NamedTuple):
    """Scratch of the sweep, with room for so many edges at once."""

    edges: np.ndarray  # (capacity, N_EDGE) float64
    state: np.ndarray  # (capacity, N_STATE) int32
    key: np.ndarray  # (2 capacity,) float64: azimuths of events, see arc_edges.direct_edges
    tie: np.ndarray  # (2 capacity,) int32
    sorted_key: np.ndarray  # the same, sorted
    sorted_code: np.ndarray  # which event: twice the edge, and 1 more where it ends
    sorted_tie: np.ndarray
    bins: np.ndarray  # (2 capacity + 2,) int32
    active: np.ndarray  # (capacity,) int32: edges under the half-plane, from the axis down
    above: np.ndarray  # (capacity,) int32: W above each
    along: np.ndarray  # (capacity,) float64: of each, side by side for vector code
    across: np.ndarray
    value: (
        np.ndarray
    )  # (capacity,) float64: cot(theta) of each at the event, times its distance from the axis
    copy: np.ndarray  # (capacity,) int32: of the list, where edges cross
    pairs: np.ndarray  # (pairs, 2) int32: edges that cross, the upper one first
    places: np.ndarray  # (pairs, 5) float64: azimuth and direction of their crossing, and the edge it is on
    arcs: np.ndarray  # (arcs, N_ARC) float64


@njit(**INNER)
def new_sweep(capacity, pairs, arcs):
    """Room for so many edges above the horizon, and so many crossings between two events."""
    events = 2 * capacity
    return Sweep(
        np.empty((capacity, N_EDGE)),
        np.empty((capacity, N_STATE), np.int32),
        np.empty(events),
        np.empty(events, np.int32),
        np.empty(events),
        np.empty(events, np.int32),
        np.empty(events, np.int32),
        np.empty(events + 2, np.int32),
        np.empty(capacity, np.int32),
        np.empty(capacity, np.int32),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity, np.int32),
        np.empty((pairs, 2), np.int32),
        np.empty((pairs, 5)),
        np.empty((arcs, N_ARC)),
    )


@njit(**INNER)
def _sort_events(sweep, n):
    """Sort events by azimuth and vertex: into bins by azimuth, then by insertion."""
    key, tie, bins = sweep.key, sweep.tie, sweep.bins
    to_key, to_code, to_tie = sweep.sorted_key, sweep.sorted_code, sweep.sorted_tie
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
        to_key[j], to_code[j], to_tie[j] = key[i], i, tie[i]
    for i in range(1, n):
        k, c, t = to_key[i], to_code[i], to_tie[i]
        j = i - 1
        while j >= 0 and (to_key[j] > k or (to_key[j] == k and to_tie[j] > t)):
            to_key[j + 1], to_code[j + 1], to_tie[j + 1] = to_key[j], to_code[j], to_tie[j]
            j -= 1
        to_key[j + 1], to_code[j + 1], to_tie[j + 1] = k, c, t


@njit(**INNER)
def _insert(e, place, n_active, active, above, value, along, across, edges):
    """Put edge e into the list."""
    for k in range(n_active, place, -1):
        active[k], above[k], value[k] = active[k - 1], above[k - 1], value[k - 1]
        along[k], across[k] = along[k - 1], across[k - 1]
    active[place], along[place], across[place] = e, edges[e, ALONG], edges[e, ACROSS]


@njit(**INNER)
def _remove(place, n_active, active, above, value, along, across):
    for k in range(place, n_active - 1):
        active[k], above[k], value[k] = active[k + 1], above[k + 1], value[k + 1]
        along[k], across[k] = along[k + 1], across[k + 1]


@njit(**INNER)
def _place_of(e, n_active, active):
    for k in range(n_active):
        if active[k] == e:
            return k
    return 0  # cannot be


@njit(**INNER)
def _slope(e, x, y, edges):
    if edges[e, STEEP] != 0.0:
        return np.inf * edges[e, STEEP]
    return edges[e, ACROSS] * x - edges[e, ALONG] * y


@njit(**INNER)
def _within(e, v, r, edges):
    """A value of edge e kept between its ends, if it is narrow."""
    low, high = edges[e, LOW] * r, edges[e, HIGH] * r
    v = v if v > low else low
    return v if v < high else high


@njit(**INNER)
def _evaluate(along, across, n_active, x, y, value):
    """Values of the list above (x, y)."""
    for k in range(n_active):
        value[k] = along[k] * x + across[k] * y


@njit(**INNER)
def _out_of_order(value, n_active):
    bad = False
    for k in range(n_active - 1):
        bad |= value[k] < value[k + 1]
    return bad


@njit(**INNER)
def _negative(n_active, bottom, r, above, value):
    """Whether W is negative somewhere, over more than rounding."""
    for k in range(1, n_active):
        if above[k] < 0 and value[k - 1] - value[k] > _NEGATIVE * (r + abs(value[k])):
            return True
    return bottom < 0


@njit(**INNER)
def sweep_arcs(sweep, n_edges, n_vertices, w, normal):
    """Append the boundary arcs of what a shade point sees.

    Parameters
    ----------
    sweep : Sweep
        With edges and events, from arc_edges.direct_edges.
    n_vertices : int
        Events with a tie below this are at vertices of the mesh, where edges have to balance.
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
    edges, state = sweep.edges, sweep.state
    active, above, value, along, across = sweep.active, sweep.above, sweep.value, sweep.along, sweep.across
    copy, pairs, places = sweep.copy, sweep.pairs, sweep.places
    key, code, tie = sweep.sorted_key, sweep.sorted_code, sweep.sorted_tie
    start_key, arcs, n = sweep.key, sweep.arcs, 0
    n_events = 2 * n_edges
    _sort_events(sweep, n_events)

    n_active, n_narrow, sound, all_crossings = 0, 0, 1, 0
    for e in range(n_edges):
        if start_key[2 * e] > start_key[2 * e + 1]:
            v = _within(e, edges[e, ALONG], 1.0, edges)
            slope, k = _slope(e, 1.0, 0.0, edges), n_active
            while k > 0 and (
                value[k - 1] < v or (value[k - 1] == v and _slope(active[k - 1], 1.0, 0.0, edges) < slope)
            ):
                k -= 1
            _insert(e, k, n_active, active, above, value, along, across, edges)
            value[k] = v
            n_active += 1
            n_narrow += edges[e, LOW] > -np.inf
    bottom = w
    for k in range(n_active):
        e = active[k]
        above[k] = bottom
        x, y, z = on_edge(e, 1.0, 0.0, edges)
        n = show(e, visible_side(bottom, state[e, GAIN]), x, y, z, edges, state, arcs, n)
        bottom += state[e, GAIN]
    lowest = bottom
    key_0, t0, m0 = 0.0, 1.0, 0.0
    horizon_key, horizon_t, horizon_m = key_0, t0, m0
    horizon = bottom == 0

    first = 0
    while first < n_events:
        last = first + 1
        while last < n_events and key[last] == key[first] and tie[last] == tie[first]:
            last += 1
        key_1, e = key[first], code[first] >> 1
        at = END if code[first] & 1 else START
        x, y, z = edges[e, at], edges[e, at + 1], edges[e, at + 2]
        _evaluate(along, across, n_active, x, y, value)
        if n_narrow > 0:
            r = np.sqrt(x * x + y * y)
            for k in range(n_active):
                value[k] = _within(active[k], value[k], r, edges)
        position = n_active
        for i in range(first, last):
            if code[i] & 1:
                k = _place_of(code[i] >> 1, n_active, active)
                value[k] = z
                position = min(position, k)
        if _out_of_order(value, n_active):
            n, crossings, low = reorder(
                n_active,
                key_0,
                key_1,
                x,
                y,
                active,
                above,
                value,
                along,
                across,
                copy,
                pairs,
                places,
                edges,
                state,
                arcs,
                n,
            )
            if crossings < 0:
                return n, -1, 0
            all_crossings += crossings
            position = n_active
            for i in range(first, last):
                if code[i] & 1:
                    position = min(position, _place_of(code[i] >> 1, n_active, active))
            lowest = min(lowest, low)
        if lowest < 0:
            if key_1 - key_0 > _NEGATIVE and _negative(
                n_active, bottom, np.sqrt(x * x + y * y), above, value
            ):
                sound = 0
            lowest = min(bottom, _lowest(above, n_active))

        if last - first == 2 and (code[first] ^ code[first + 1]) & 1:
            # The usual vertex, where one edge follows another: it takes its place.
            i = first if code[first] & 1 else first + 1
            e, f = code[i] >> 1, code[2 * first + 1 - i] >> 1
            if state[e, GAIN] == state[f, GAIN]:
                side = state[e, SIDE]
                if side != 0:
                    n = show(e, 0, x, y, z, edges, state, arcs, n)
                    state[f, SIDE] = side
                    edges[f, OPEN], edges[f, OPEN + 1], edges[f, OPEN + 2] = x, y, z
                active[position], along[position], across[position] = f, edges[f, ALONG], edges[f, ACROSS]
                n_narrow += int(edges[f, LOW] > -np.inf) - int(edges[e, LOW] > -np.inf)
                key_0, t0, m0 = key_1, x, y
                first = last
                continue

        balance, ended = 0, 0
        for i in range(first, last):
            if code[i] & 1:
                e = code[i] >> 1
                k = _place_of(e, n_active, active)
                n = show(e, 0, x, y, z, edges, state, arcs, n)
                balance += state[e, GAIN]
                n_narrow -= edges[e, LOW] > -np.inf
                _remove(k, n_active, active, above, value, along, across)
                n_active -= 1
                ended += 1
        if ended == 0:
            position = 0
            for k in range(n_active):
                position += value[k] > z
        begun = 0
        for i in range(first, last):
            if not code[i] & 1:
                e = code[i] >> 1
                balance -= state[e, GAIN]
                n_narrow += edges[e, LOW] > -np.inf
                slope, k = _slope(e, x, y, edges), position + begun
                while k > position and _slope(active[k - 1], x, y, edges) < slope:
                    k -= 1
                _insert(e, k, n_active, active, above, value, along, across, edges)
                n_active += 1
                begun += 1
        if balance != 0 and tie[first] < n_vertices:
            sound = 0

        here = w
        if position > 0:
            here = above[position - 1] + state[active[position - 1], GAIN]
        for k in range(position, n_active):
            e = active[k]
            if k >= position + begun and above[k] == here:
                break
            above[k] = here
            lowest = min(lowest, here)
            side = visible_side(here, state[e, GAIN])
            here += state[e, GAIN]
            if k < position + begun:
                n = show(e, side, x, y, z, edges, state, arcs, n)
            else:
                ex, ey, ez = on_edge(e, x, y, edges)
                n = show(e, side, ex, ey, ez, edges, state, arcs, n)
        bottom = w
        if n_active > 0:
            bottom = above[n_active - 1] + state[active[n_active - 1], GAIN]
        lowest = min(lowest, bottom)
        if (bottom == 0) != horizon:
            if horizon:
                n = show_horizon(horizon_key, key_1, horizon_t, horizon_m, x, y, normal, arcs, n)
            horizon = not horizon
            horizon_key, horizon_t, horizon_m = key_1, x, y
        key_0, t0, m0 = key_1, x, y
        first = last

    if n_active > 0:
        _evaluate(along, across, n_active, 1.0, 0.0, value)
        for k in range(n_active):
            value[k] = _within(active[k], value[k], 1.0, edges)
        if _out_of_order(value, n_active):
            n, crossings, low = reorder(
                n_active,
                key_0,
                2.0 * np.pi,
                1.0,
                0.0,
                active,
                above,
                value,
                along,
                across,
                copy,
                pairs,
                places,
                edges,
                state,
                arcs,
                n,
            )
            if crossings < 0:
                return n, -1, 0
            all_crossings += crossings
        for k in range(n_active):
            e = active[k]
            x, y, z = on_edge(e, 1.0, 0.0, edges)
            n = show(e, 0, x, y, z, edges, state, arcs, n)
    if horizon:
        n = show_horizon(horizon_key, 2.0 * np.pi, horizon_t, horizon_m, 1.0, 0.0, normal, arcs, n)
    return n, sound, all_crossings


@njit(**INNER)
def _lowest(above, n_active):
    least = 0
    for k in range(n_active):
        least = min(least, above[k])
    return least
