"""Boundary arcs as a sweep finds them: where they begin, where they end, and how they are handed on."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.arc_edges import FROM, NARROW, NORMAL, OPEN, ROUND, SIDE, TO
from silint.core.arc_list import value_above
from silint.core.jit import INNER

# An arc as it is found: from and to, in the frame; its edge, -1 for the horizon; and its visible side.
_FROM, _TO, _EDGE, _ON, N_ARC = 0, 3, 6, 7, 8
# Stretches of the horizon are cut into pieces of at most this azimuth.
_HORIZON_PIECE = 1.4


@njit(**INNER)
def visible_side(above, gain):
    return 1 if above == 0 else (-1 if above + gain == 0 else 0)


@njit(**INNER)
def show(e, side, x, y, z, edges, state, arcs, n):
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
def on_edge(e, t, m, circles, edges, state, ball):
    """Direction on edge e above (t, m)."""
    a = value_above(e, t, m, circles, edges, state, ball)
    s = 1.0 / np.sqrt(t * t + m * m + a * a)
    return s * t, s * m, s * a


@njit(**INNER)
def _on_horizon(t, m, normal):
    a = -(normal[0] * t + normal[1] * m) / normal[2]
    s = 1.0 / np.sqrt(t * t + m * m + a * a)
    return s * t, s * m, s * a


@njit(**INNER)
def show_horizon(key_a, key_b, t, m, u, v, normal, arcs, n):
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
def place_arcs(arcs, n_arcs, edges, state, ball, normal, frame, directions, ids, row):
    """Write arcs to rows from `row` on, in world axes and with the visible side on the left.

    Where there may be small circles, their c follows the normal.

    Those of edges seen end on, which have no plane and no length, are left out. Returns the row after the
    last.
    """
    for i in range(n_arcs):
        e, side = int(arcs[i, _EDGE]), arcs[i, _ON]
        x, y, z = normal
        v_from, v_to = np.int32(-1), np.int32(-1)
        if e >= 0:
            x, y, z = side * edges[e, NORMAL], side * edges[e, NORMAL + 1], side * edges[e, NORMAL + 2]
            v_from, v_to = state[e, FROM], state[e, TO]
        if x == 0.0 and y == 0.0 and z == 0.0:
            continue
        a, b = (_FROM, _TO) if side > 0.0 else (_TO, _FROM)
        ids[row, 0], ids[row, 1] = (v_from, v_to) if side > 0.0 else (v_to, v_from)
        for k in range(3):
            f, g, h = frame[0, k], frame[1, k], frame[2, k]
            directions[row, k] = f * arcs[i, a] + g * arcs[i, a + 1] + h * arcs[i, a + 2]
            directions[row, 3 + k] = f * arcs[i, b] + g * arcs[i, b + 1] + h * arcs[i, b + 2]
            directions[row, 6 + k] = f * x + g * y + h * z
        if ball is not None:
            directions[row, 9] = side * ball.offsets[e] if e >= 0 and state[e, NARROW] == ROUND else 0.0
        row += 1
    return row
