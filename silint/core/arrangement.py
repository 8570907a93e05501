"""The visible region's boundary, exactly: an angular sweep over the contour edges seen from a shade point.

A half-plane turns once about the axis A of the point's frame. The edges that it cuts form a list, from the
axis down; between two neighbours in it the depth count W is constant, and where W = 0 the point sees out.
Nothing happens to the list but

    an edge ends or starts      at a vertex, or where it dips under the horizon: the events, sorted
    two edges cross             between two events: where their order has changed

so all that is decided in floating point is the order of events by azimuth, and the order of the list at each
event, from one product and a sum an edge. Each order is taken as it is found, and what it implies follows
combinatorially: pairs whose order changed have crossed, once; W is summed along the list. The result is the
exact arrangement of arcs that differ from the given ones by rounding, whatever degeneracies there are, as in
Sugihara and Iri's topology-oriented approach; nothing has to be in general position, and no error grows.

An edge is part of the boundary where W = 0 on one side of it. (A depth count jumps by two or one across every
contour edge, so never on both.) Where the last region of the list is visible, so is the horizon below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.arc_edges import (
    ACROSS,
    ALONG,
    END,
    FROM,
    GAIN,
    HIGH,
    LOW,
    N_EDGE,
    N_STATE,
    NORMAL,
    OPEN,
    SIDE,
    START,
    STEEP,
    TO,
)
from silint.core.jit import INNER
from silint.core.radial import azimuth

# Negative W over less than this, in azimuth and in height, is rounding.
_NEGATIVE = 1e-9
# Sine of the angle between planes below which their intersection is looked for between events only.
_PARALLEL = 1e-6
# Stretches of the horizon are cut into pieces of at most this azimuth.
_HORIZON_PIECE = 1.4

# An arc as it is found: from and to, in the frame; its edge, -1 for the horizon; and its visible side.
_FROM, _TO, _EDGE, _ON, _N_ARC = 0, 3, 6, 7, 8


class Sweep(NamedTuple):
    """Scratch of the sweep, with room for so many edges at once."""

    edges: np.ndarray  # (capacity, N_EDGE) float64
    state: np.ndarray  # (capacity, N_STATE) int32
    key: np.ndarray  # (2 capacity,) float64: azimuths of events, see arc_edges.direct_edges
    code: np.ndarray  # (2 capacity,) int32
    tie: np.ndarray  # (2 capacity,) int32
    sorted_key: np.ndarray  # the same, sorted
    sorted_code: np.ndarray
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
    places: np.ndarray  # (pairs, 4) float64: azimuth and direction of their crossing
    arcs: np.ndarray  # (arcs, _N_ARC) float64


@njit(**INNER)
def new_sweep(capacity, pairs, arcs):
    """Room for so many edges above the horizon, and so many crossings between two events."""
    events = 2 * capacity
    return Sweep(
        np.empty((capacity, N_EDGE)),
        np.empty((capacity, N_STATE), np.int32),
        np.empty(events),
        np.empty(events, np.int32),
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
        np.empty((pairs, 4)),
        np.empty((arcs, _N_ARC)),
    )


@njit(**INNER)
def _sort_events(sweep, n):
    """Sort events by azimuth and vertex: into bins by azimuth, then by insertion."""
    key, code, tie, bins = sweep.key, sweep.code, sweep.tie, sweep.bins
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
        to_key[j], to_code[j], to_tie[j] = key[i], code[i], tie[i]
    for i in range(1, n):
        k, c, t = to_key[i], to_code[i], to_tie[i]
        j = i - 1
        while j >= 0 and (to_key[j] > k or (to_key[j] == k and to_tie[j] > t)):
            to_key[j + 1], to_code[j + 1], to_tie[j + 1] = to_key[j], to_code[j], to_tie[j]
            j -= 1
        to_key[j + 1], to_code[j + 1], to_tie[j + 1] = k, c, t


@njit(**INNER)
def _show(e, side, x, y, z, edges, state, arcs, n):
    """From (x, y, z) on, the visible region is on this side of edge e: ends its arc, begins another.

    Where there is no room, arcs are only counted.
    """
    # Without a branch: Numba would count references to the arrays wherever one leaves the function.
    old = state[e, SIDE]
    row = min(n, len(arcs) - 1)
    ox, oy, oz = edges[e, OPEN], edges[e, OPEN + 1], edges[e, OPEN + 2]
    arcs[row, _FROM], arcs[row, _FROM + 1], arcs[row, _FROM + 2] = ox, oy, oz
    arcs[row, _TO], arcs[row, _TO + 1], arcs[row, _TO + 2] = x, y, z
    arcs[row, _EDGE], arcs[row, _ON] = e, old
    turns = old != side
    state[e, SIDE] = side
    edges[e, OPEN] = x if turns else ox
    edges[e, OPEN + 1] = y if turns else oy
    edges[e, OPEN + 2] = z if turns else oz
    return n + int(turns & (old != 0) & ((x != ox) | (y != oy) | (z != oz)))


@njit(**INNER)
def place_arcs(arcs, n_arcs, edges, state, normal, frame, directions, ids, first):
    """Write arcs to rows from `first` on, in world axes and with the visible side on the left."""
    for i in range(n_arcs):
        row = first + i
        e, side = int(arcs[i, _EDGE]), arcs[i, _ON]
        if e < 0:
            x, y, z = normal
            ids[row, 0], ids[row, 1] = -1, -1
        else:
            x, y, z = side * edges[e, NORMAL], side * edges[e, NORMAL + 1], side * edges[e, NORMAL + 2]
            ids[row, 0], ids[row, 1] = (
                state[e, FROM if side > 0.0 else TO],
                state[e, TO if side > 0.0 else FROM],
            )
        a, b = (_FROM, _TO) if side > 0.0 else (_TO, _FROM)
        for k in range(3):
            f, g, h = frame[0, k], frame[1, k], frame[2, k]
            directions[row, k] = f * arcs[i, a] + g * arcs[i, a + 1] + h * arcs[i, a + 2]
            directions[row, 3 + k] = f * arcs[i, b] + g * arcs[i, b + 1] + h * arcs[i, b + 2]
            directions[row, 6 + k] = f * x + g * y + h * z


@njit(**INNER)
def _visible_side(above, gain):
    return 1 if above == 0 else (-1 if above + gain == 0 else 0)


@njit(**INNER)
def _show_horizon(key_a, key_b, t, m, u, v, normal, arcs, n):
    """Append the visible horizon between two azimuths, from above (t, m) to above (u, v), in pieces."""
    pieces = int((key_b - key_a) / _HORIZON_PIECE) + 1
    ax, ay, az = _on_horizon(t, m, normal)
    for i in range(1, pieces + 1):
        if i < pieces:
            phi = key_a + i * (key_b - key_a) / pieces
            u_i, v_i = np.cos(phi), np.sin(phi)
        else:
            u_i, v_i = u, v
        bx, by, bz = _on_horizon(u_i, v_i, normal)
        if ax != bx or ay != by or az != bz:
            if n < len(arcs):
                arcs[n, _FROM], arcs[n, _FROM + 1], arcs[n, _FROM + 2] = ax, ay, az
                arcs[n, _TO], arcs[n, _TO + 1], arcs[n, _TO + 2] = bx, by, bz
                arcs[n, _EDGE], arcs[n, _ON] = -1.0, 1.0
            n += 1
        ax, ay, az = bx, by, bz
    return n


@njit(**INNER)
def _on_horizon(t, m, normal):
    a = -(normal[0] * t + normal[1] * m) / normal[2]
    s = 1.0 / np.sqrt(t * t + m * m + a * a)
    return s * t, s * m, s * a


@njit(**INNER)
def _on_edge(e, t, m, edges):
    """Direction on edge e above (t, m)."""
    r = np.sqrt(t * t + m * m)
    a = edges[e, ALONG] * t + edges[e, ACROSS] * m
    a = a if a > edges[e, LOW] * r else edges[e, LOW] * r
    a = a if a < edges[e, HIGH] * r else edges[e, HIGH] * r
    s = 1.0 / np.sqrt(t * t + m * m + a * a)
    return s * t, s * m, s * a


@njit(**INNER)
def _crossing(e, f, key_0, key_1, t1, m1, edges):
    """Where two edges cross between two events.

    Returns azimuth, direction, and whether the direction is on both edges. Where their planes agree too well
    for that, it is above the second event.
    """
    x = edges[e, NORMAL + 1] * edges[f, NORMAL + 2] - edges[e, NORMAL + 2] * edges[f, NORMAL + 1]
    y = edges[e, NORMAL + 2] * edges[f, NORMAL] - edges[e, NORMAL] * edges[f, NORMAL + 2]
    z = edges[e, NORMAL] * edges[f, NORMAL + 1] - edges[e, NORMAL + 1] * edges[f, NORMAL]
    s = np.sqrt(x * x + y * y + z * z)
    if s > 0.0:
        along = (
            x * (edges[e, START] + edges[e, END])
            + y * (edges[e, START + 1] + edges[e, END + 1])
            + z * (edges[e, START + 2] + edges[e, END + 2])
        )
        r = 1.0 / s if along > 0.0 else -1.0 / s
        x, y, z = r * x, r * y, r * z
        key = azimuth(x, y)
        if s > _PARALLEL or key_0 <= key <= key_1:
            return key, x, y, z, s > 1e-14
    return key_1, t1, m1, 0.0, False


@njit(**INNER)
def _cross(i, x, y, z, exact, active, above, edges, state, arcs, n):
    """The edges at i and i + 1 of the list trade places at (x, y, z), or where each of them is above it."""
    e, f = active[i], active[i + 1]
    w = above[i]
    gain_e, gain_f = state[e, GAIN], state[f, GAIN]
    active[i], active[i + 1] = f, e
    above[i + 1] = w + gain_f
    side_f, side_e = _visible_side(w, gain_f), _visible_side(w + gain_f, gain_e)
    if state[e, SIDE] == side_e and state[f, SIDE] == side_f:
        return n
    if exact:
        n = _show(e, side_e, x, y, z, edges, state, arcs, n)
        return _show(f, side_f, x, y, z, edges, state, arcs, n)
    ex, ey, ez = _on_edge(e, x, y, edges)
    n = _show(e, side_e, ex, ey, ez, edges, state, arcs, n)
    fx, fy, fz = _on_edge(f, x, y, edges)
    return _show(f, side_f, fx, fy, fz, edges, state, arcs, n)


@njit(**INNER)
def _reorder(
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
):
    """Sort the list by falling value; pairs that trade places have crossed since the last event.

    Returns the number of arcs, and of crossings; -1 crossings where there is no room for them.
    """
    for i in range(n_active):
        copy[i] = active[i]
    crossings = 0
    for i in range(1, n_active):
        j = i
        while j > 0 and value[j - 1] < value[j]:
            if crossings == len(pairs):
                return n, -1
            pairs[crossings, 0], pairs[crossings, 1] = copy[j - 1], copy[j]
            crossings += 1
            copy[j - 1], copy[j] = copy[j], copy[j - 1]
            value[j - 1], value[j] = value[j], value[j - 1]
            along[j - 1], along[j] = along[j], along[j - 1]
            across[j - 1], across[j] = across[j], across[j - 1]
            j -= 1
    # Nearest first; of those, what are neighbours at the time. There always are some, so all pairs get done.
    for c in range(crossings):
        key, px, py, pz, exact = _crossing(pairs[c, 0], pairs[c, 1], key_0, key_1, x, y, edges)
        j = c
        e, f = pairs[c, 0], pairs[c, 1]
        while j > 0 and places[j - 1, 0] > key:
            for r in range(4):
                places[j, r] = places[j - 1, r]
            pairs[j, 0], pairs[j, 1] = pairs[j - 1, 0], pairs[j - 1, 1]
            j -= 1
        places[j, 0], places[j, 1], places[j, 2] = key, px, py
        places[j, 3] = pz if exact else np.nan
        pairs[j, 0], pairs[j, 1] = e, f
    left, first = crossings, 0
    while left > 0:
        done = False
        for c in range(first, crossings):
            e = pairs[c, 0]
            if e < 0:
                if c == first:
                    first += 1
                continue
            for i in range(n_active - 1):
                if active[i] == e:
                    break
            if active[i] != e or active[i + 1] != pairs[c, 1]:
                continue
            z = places[c, 3]
            px, py = places[c, 1], places[c, 2]
            n = _cross(i, px, py, z, z == z, active, above, edges, state, arcs, n)
            pairs[c, 0] = -1
            left -= 1
            done = True
            break
        if not done:
            break  # cannot be
    return n, crossings


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
        x, y, z = _on_edge(e, 1.0, 0.0, edges)
        n = _show(e, _visible_side(bottom, state[e, GAIN]), x, y, z, edges, state, arcs, n)
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
            n, crossings = _reorder(
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
            lowest = min(lowest, _lowest(above, n_active))
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
                    n = _show(e, 0, x, y, z, edges, state, arcs, n)
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
                n = _show(e, 0, x, y, z, edges, state, arcs, n)
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
            side = _visible_side(here, state[e, GAIN])
            here += state[e, GAIN]
            if k < position + begun:
                n = _show(e, side, x, y, z, edges, state, arcs, n)
            else:
                ex, ey, ez = _on_edge(e, x, y, edges)
                n = _show(e, side, ex, ey, ez, edges, state, arcs, n)
        bottom = w
        if n_active > 0:
            bottom = above[n_active - 1] + state[active[n_active - 1], GAIN]
        lowest = min(lowest, bottom)
        if (bottom == 0) != horizon:
            if horizon:
                n = _show_horizon(horizon_key, key_1, horizon_t, horizon_m, x, y, normal, arcs, n)
            horizon = not horizon
            horizon_key, horizon_t, horizon_m = key_1, x, y
        key_0, t0, m0 = key_1, x, y
        first = last

    if n_active > 0:
        _evaluate(along, across, n_active, 1.0, 0.0, value)
        for k in range(n_active):
            value[k] = _within(active[k], value[k], 1.0, edges)
        if _out_of_order(value, n_active):
            n, crossings = _reorder(
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
            x, y, z = _on_edge(e, 1.0, 0.0, edges)
            n = _show(e, 0, x, y, z, edges, state, arcs, n)
    if horizon:
        n = _show_horizon(horizon_key, 2.0 * np.pi, horizon_t, horizon_m, 1.0, 0.0, normal, arcs, n)
    return n, sound, all_crossings


@njit(**INNER)
def _lowest(above, n_active):
    least = 0
    for k in range(n_active):
        least = min(least, above[k])
    return least
