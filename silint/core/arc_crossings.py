"""Where edges of the sweep cross: pairs that trade places between two events, one after the other."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.arc_edges import END, GAIN, NORMAL, SIDE, START
from silint.core.boundary import on_edge, show, visible_side
from silint.core.jit import INNER
from silint.core.radial import azimuth

# Sine of the angle between planes below which their intersection is looked for between events only.
_PARALLEL = 1e-6
# Edges with shorter chords are cut between their ends; others, which ends do not describe, by their planes.
_SHORT = 1.0


@njit(**INNER)
def _chord(e, edges):
    """Square of the chord from start to end of an edge."""
    x, y = edges[e, START] - edges[e, END], edges[e, START + 1] - edges[e, END + 1]
    z = edges[e, START + 2] - edges[e, END + 2]
    return x * x + y * y + z * z


@njit(**INNER)
def _crossing(e, f, key_0, key_1, t, m, edges):
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
        x, y, z = _onto(g, x, y, z, edges)
    key = azimuth(x, y)
    if not (abs(start - end) > _PARALLEL * chord or key_0 <= key <= key_1) or square == 0.0:
        # Planes that agree say nothing; the second event does.
        key, g = key_1, e
        x, y, z = on_edge(e, t, m, edges)
    return key, x, y, z, g


@njit(**INNER)
def _onto(e, x, y, z, edges):
    """The direction on the plane of edge e that is nearest to (x, y, z)."""
    a, b, c = edges[e, NORMAL], edges[e, NORMAL + 1], edges[e, NORMAL + 2]
    off = a * x + b * y + c * z
    x, y, z = x - off * a, y - off * b, z - off * c
    s = 1.0 / np.sqrt(x * x + y * y + z * z)
    return s * x, s * y, s * z


@njit(**INNER)
def _cross(i, x, y, z, exact, active, above, edges, state, arcs, n):
    """The edges at i and i + 1 of the list trade places at (x, y, z), which is exactly on one of them."""
    e, f = active[i], active[i + 1]
    w = above[i]
    gain_e, gain_f = state[e, GAIN], state[f, GAIN]
    active[i], active[i + 1] = f, e
    above[i + 1] = w + gain_f
    side_f, side_e = visible_side(w, gain_f), visible_side(w + gain_f, gain_e)
    if state[e, SIDE] == side_e and state[f, SIDE] == side_f:
        return n
    ox, oy, oz = _onto(f if exact == e else e, x, y, z, edges)
    ex, ey, ez = (x, y, z) if exact == e else (ox, oy, oz)
    fx, fy, fz = (ox, oy, oz) if exact == e else (x, y, z)
    n = show(e, side_e, ex, ey, ez, edges, state, arcs, n)
    return show(f, side_f, fx, fy, fz, edges, state, arcs, n)


@njit(**INNER)
def _entangled(
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
    """Sort what is out of order in more than one place at a time; see `reorder`."""
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
            for r in range(5):
                places[j, r] = places[j - 1, r]
            pairs[j, 0], pairs[j, 1] = pairs[j - 1, 0], pairs[j - 1, 1]
            j -= 1
        places[j, 0], places[j, 1], places[j, 2] = key, px, py
        places[j, 3], places[j, 4] = pz, exact
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
            n = _cross(
                i,
                places[c, 1],
                places[c, 2],
                places[c, 3],
                int(places[c, 4]),
                active,
                above,
                edges,
                state,
                arcs,
                n,
            )
            pairs[c, 0] = -1
            left -= 1
            done = True
            break
        if not done:
            break  # cannot be
    return n, crossings


@njit(**INNER)
def _in_pairs(value, n_active):
    """Whether the list is sorted but for neighbours that trade places, each with one other only.

    Mostly so, and mostly both are hidden: then it does not matter where they cross.
    """
    last, i = np.inf, 0
    while i < n_active:
        swapped = i + 1 < n_active and value[i] < value[i + 1]
        if last < (value[i + 1] if swapped else value[i]):
            return False
        last = value[i]
        i += 2 if swapped else 1
    return True


@njit(**INNER)
def reorder(
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

    Parameters
    ----------
    key_0, key_1 : float
        Azimuths of both events; the second is above (x, y).
    active, above, value, along, across, copy, pairs, places, edges, state, arcs
        Those of the sweep.
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
    crossings, lowest = 0, 0
    if _in_pairs(value, n_active):
        for i in range(n_active - 1):
            if value[i] >= value[i + 1]:
                continue
            e, f = active[i], active[i + 1]
            w, gain_e, gain_f = above[i], state[e, GAIN], state[f, GAIN]
            side_f, side_e = visible_side(w, gain_f), visible_side(w + gain_f, gain_e)
            if state[e, SIDE] != side_e or state[f, SIDE] != side_f:
                _, px, py, pz, exact = _crossing(e, f, key_0, key_1, x, y, edges)
                n = _cross(i, px, py, pz, exact, active, above, edges, state, arcs, n)
            else:
                active[i], active[i + 1] = f, e
                above[i + 1] = w + gain_f
            lowest = min(lowest, above[i + 1])
            value[i], value[i + 1] = value[i + 1], value[i]
            along[i], along[i + 1] = along[i + 1], along[i]
            across[i], across[i + 1] = across[i + 1], across[i]
            crossings += 1
        return n, crossings, lowest
    n, crossings = _entangled(
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
    for i in range(n_active):
        lowest = min(lowest, above[i])
    return n, crossings, lowest
