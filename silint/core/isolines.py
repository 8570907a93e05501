"""Where the octahedral isolines run, seen from a shade point with a normal [NBMJ14 3.3; PH03].

Each isoline is a diamond. Its corners on the axis U among +-y, +-z nearest to the normal n lie highest; the
half circle through them, from -x over U to +x, is the *start curve*. A position on a diamond is t in
[-2, 2]: 0 on the start curve, growing counter-clockwise about +x through the side corner (t = 1) to the
lowest (t = 2), and downwards (t < 0) the other way round. The part of a diamond above the horizon is one
run (-left, right) about t = 0, or nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER, KERNEL


@njit(**KERNEL)
def isoline_u(k, n_lines):
    """Position of isoline k."""
    return (2 * k + 1 - n_lines) / n_lines


@njit(**KERNEL)
def line_index(u, n_lines):
    """Number of isolines below u."""
    return min(max(int(np.ceil(0.5 * (u + 1.0) * n_lines - 0.5)), 0), n_lines)


@njit(**KERNEL)
def start_corner(n):
    """Loop coordinate (0, 1, 2 or 3) of the axis U: the corner of every diamond that lies highest over n."""
    if abs(n[1]) >= abs(n[2]):
        return 0 if n[1] >= 0.0 else 2
    return 1 if n[2] >= 0.0 else 3


@njit(**KERNEL)
def turn(y, z, corner):
    """Coordinates along U and along the side axis S, the next corner counter-clockwise."""
    if corner == 0:
        return y, z
    if corner == 1:
        return z, -y
    if corner == 2:
        return -y, -z
    return -z, y


@njit(**KERNEL)
def horizon_reach(n, corner, k, n_lines):
    """How far isoline k runs above the horizon, left and right of t = 0; (-1, -1) if it does not."""
    up, side = turn(n[1], n[2], corner)
    u = isoline_u(k, n_lines)
    r = 1.0 - abs(u)
    top, bottom = u * n[0] + r * up, u * n[0] - r * up
    if top <= 0.0:
        return -1.0, -1.0
    right = u * n[0] + r * side
    left = u * n[0] - r * side
    return _reach(top, left, bottom), _reach(top, right, bottom)


@njit(**INNER)
def _reach(top, side, bottom):
    """Where a run that starts at height `top` and falls over `side` to `bottom` meets the horizon."""
    if side <= 0.0:
        return top / (top - side)
    if bottom < 0.0:
        return 1.0 + side / (side - bottom)
    return 2.0


@njit(**KERNEL)
def to_loop(intervals, first, last, corner):
    """From positions t to loop coordinates, in place: starts in [0, 4), ends perhaps past 4."""
    for j in range(first, last):
        t0, t1 = intervals[j, 0], intervals[j, 1]
        start = corner + t0
        if start < 0.0:
            start += 4.0
        elif start >= 4.0:
            start -= 4.0
        intervals[j, 0], intervals[j, 1] = start, start + (t1 - t0)
