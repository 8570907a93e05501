"""The edges under the half-plane of the sweep, from the axis down."""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.arc_edges import ACROSS, ALONG, GAIN, HIGH, LOW, NARROW, NORMAL, ROUND
from silint.core.jit import INNER
from silint.core.small_circle import height_on

# Rows of whole numbers: the edge, W above it, what W gains across it; and scratch of arc_crossings: the edge
# before sorting, first and last place of each block that was permuted.
EDGE, ABOVE, STEP, WAS, BLOCK_FIRST, BLOCK_LAST, N_WHOLE = 0, 1, 2, 3, 4, 5, 6
# Rows of real numbers: cot(theta) at an event times the distance from the axis, and its coefficients.
VALUE, ALONG_T, ACROSS_M, N_REAL = 0, 1, 2, 3


@njit(**INNER)
def put(e, k, whole, real, circles, state):
    """Write edge e to place k."""
    whole[EDGE, k], whole[STEP, k] = e, state[e, GAIN]
    real[ALONG_T, k], real[ACROSS_M, k] = circles[e, ALONG], circles[e, ACROSS]


@njit(**INNER)
def move(i, k, whole, real):
    """Copy place i to place k."""
    whole[EDGE, k], whole[ABOVE, k], whole[STEP, k] = whole[EDGE, i], whole[ABOVE, i], whole[STEP, i]
    real[VALUE, k], real[ALONG_T, k], real[ACROSS_M, k] = real[VALUE, i], real[ALONG_T, i], real[ACROSS_M, i]


@njit(**INNER)
def place_of(e, n_active, whole):
    """The place of edge e, which is in the list."""
    place = 0
    for k in range(n_active):
        place += k * (whole[EDGE, k] == e)
    return place


@njit(**INNER)
def within(e, v, r, edges):
    """A value of edge e kept between its ends, if it is narrow."""
    low, high = edges[e, LOW] * r, edges[e, HIGH] * r
    v = v if v > low else low
    return v if v < high else high


@njit(**INNER)
def axis_of(e, edges):
    """The unit normal of the plane of edge e, to its left."""
    return edges[e, NORMAL], edges[e, NORMAL + 1], edges[e, NORMAL + 2]


@njit(**INNER)
def value_above(e, x, y, circles, edges, state, ball):
    """A value of edge e above (x, y)."""
    v = circles[e, ALONG] * x + circles[e, ACROSS] * y
    if ball is not None:
        if state[e, NARROW] == ROUND:
            v = height_on(axis_of(e, edges), ball.offsets[e], x, y)
    return within(e, v, np.sqrt(x * x + y * y), edges)


@njit(**INNER)
def in_order(n_active, x, y, place, z, real):
    """Whether the list is in order above (x, y), with the value z at one place."""
    wrong = 0
    for k in range(n_active - 1):
        u = real[ALONG_T, k] * x + real[ACROSS_M, k] * y
        v = real[ALONG_T, k + 1] * x + real[ACROSS_M, k + 1] * y
        wrong += int(u < v)
    # Without a branch, as in `boundary.show`.
    i, j = max(place - 1, 0), min(place + 1, n_active - 1)
    wrong += int((i < place) & (real[ALONG_T, i] * x + real[ACROSS_M, i] * y < z))
    wrong += int((j > place) & (z < real[ALONG_T, j] * x + real[ACROSS_M, j] * y))
    return wrong == 0


@njit(**INNER)
def evaluate(n_active, n_narrow, x, y, whole, real, edges, state, ball):
    """Values of the list above (x, y)."""
    for k in range(n_active):
        real[VALUE, k] = real[ALONG_T, k] * x + real[ACROSS_M, k] * y
    if n_narrow > 0:
        r = np.sqrt(x * x + y * y)
        for k in range(n_active):
            e = whole[EDGE, k]
            if state[e, NARROW] == 0:
                continue
            if ball is not None:
                if state[e, NARROW] == ROUND:
                    real[VALUE, k] = height_on(axis_of(e, edges), ball.offsets[e], x, y)
            real[VALUE, k] = within(e, real[VALUE, k], r, edges)


@njit(**INNER)
def out_of_order(n_active, real):
    """Whether values rise somewhere in the list."""
    bad = False
    for k in range(n_active - 1):
        bad |= real[VALUE, k] < real[VALUE, k + 1]
    return bad
