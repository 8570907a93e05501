"""Where contour edges cross octahedral isolines, the start curve and the horizon [NBMJ14 3.3].

Every vertex has one line index: the number of isolines below its u. An edge is cut where it changes octant
and at the horizon; each cut has one index too, owned by the edge. An edge crosses the isolines between the
indices of its ends, and crosses the start curve or the horizon between two isolines, whatever rounding does
to where exactly: so crossings of a closed contour cancel along any closed path, and counts cannot drift.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.contour import face_side, side_rounding
from silint.core.isolines import isoline_u, line_index, turn
from silint.core.jit import INNER, KERNEL

# A vertex at the shade point itself is seen along -n; its distance only has to be small.
AT_POINT = 2.0**-500

# The order of a cut at the very end of an edge; a cut that does not exist comes after it.
LAST = 1.7e308

# A plane closer to p than this many times its rounding shows a face whose outline is all rounding.
THIN = 8.0

# A plane whose normal has less than this along U holds the start curve but for rounding.
ALONG = 1e-9

# Sides of the start curve.
LEFT, RIGHT = 0, 1

# What the isolines of one shade point accumulate. Gains are changes of W towards larger u or t; those along
# the start curve and the horizon stand at k for what lies between isolines k - 1 and k.
CROSSED = 0  # crossings of isoline k
GAIN = 1  # sum of their gains
LEFT_GAIN = 2  # sum over those left of the start curve
START = 3  # gains along the start curve
HORIZON_LEFT = 4  # gains along the left branch of the horizon
HORIZON_RIGHT = 5  # gains along the right branch
DEPTH = 6  # W at the left end of isoline k
FAILED = 7  # 1 where the counts of isoline k contradict each other
N_ROWS = 8


@njit(**KERNEL)
def local(vertices, v, p, n, corner):
    """Direction from p to a vertex, along x, U and S, and its height above the horizon."""
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        x, y, z = -AT_POINT * n[0], -AT_POINT * n[1], -AT_POINT * n[2]
    up, side = turn(y, z, corner)
    return x, up, side, n[0] * x + n[1] * y + n[2] * z


@njit(**INNER)
def _curve_crossing(up_a, side_a, up_b, side_b):
    """+1 or -1 where the edge a-b crosses the start half-plane (side = 0, up >= 0), by the sign of dt.

    The same comparison as in `cross_edge`, so that start counts and crossings never disagree.
    """
    if (side_a >= 0.0) == (side_b >= 0.0):
        return 0
    above = up_a >= 0.0
    if above != (up_b >= 0.0) and abs(up_a) / abs(up_b) <= abs(side_a) / abs(side_b):
        above = not above
    if not above:
        return 0
    return 1 if side_b >= 0.0 else -1


@njit(**INNER)
def pole_count(geometry, face_ids, n_along, p, n, corner, pole):
    """Depth count W at a pole of the octahedron, +x or -x [start of the start curve].

    A face covers the pole on one side when its loop winds about the axis, and its side tells which of the
    two poles it is: no intersection is computed. `face_ids` holds the faces that the half-line from p to the
    pole may meet (along.faces_along), up to n_along.
    """
    rounding = side_rounding(p)
    count = 0
    for i in range(n_along):
        count += _covers_pole(geometry, face_ids[i], p, n, corner, pole, rounding)
    return count


@njit(**INNER)
def _covers_pole(geometry, f, p, n, corner, pole, rounding):
    """Depth count of one face at the pole.

    Along the start curve from this pole to the other the face's count changes by `walk`, and at both ends it
    is 0 or 1: if it changes, the face covers one of the poles.
    """
    winding = 0
    for i in range(3):
        a, b = geometry.faces[f, i], geometry.faces[f, (i + 1) % 3]
        _, up_a, side_a, _ = local(geometry.vertices, min(a, b), p, n, corner)
        _, up_b, side_b, _ = local(geometry.vertices, max(a, b), p, n, corner)
        crossing = _curve_crossing(up_a, side_a, up_b, side_b)
        winding += crossing if a < b else -crossing
    front = face_side(geometry, f, p, n, rounding) > 0
    walk = pole * winding if front else -pole * winding

    code = geometry.face_planes[f]
    k = max(code, ~code)
    planes = geometry.planes
    distance = planes[k, 0] * p[0] + planes[k, 1] * p[1] + planes[k, 2] * p[2] + planes[k, 3]
    if abs(distance) > THIN * (geometry.plane_errors[k] + rounding):
        # The plane meets the axis on one side of p. A vertex on the axis may make the loop turn the wrong way
        # round it; the walk then leaves a -1 in that one direction, and all others stay right.
        return -walk if pole * distance * planes[k, 0] < 0.0 else 0
    return _thin_covers_pole(geometry, f, p, n, corner, pole, walk, k, front, code >= 0)


@njit(**INNER)
def _thin_covers_pole(geometry, f, p, n, corner, pole, walk, k, front, along):
    """The same for a face whose plane passes through p but for rounding.

    It is seen edge-on, as a sliver whose turning sense means nothing, or, if p lies on the face itself, as a
    hemisphere, which may hold both poles or neither. Where its plane cuts the axis of the poles tells which.
    """
    planes = geometry.planes
    plane_up, plane_side_ = turn(planes[k, 1], planes[k, 2], corner)
    across_side = abs(plane_up) >= abs(plane_side_)  # the in-plane coordinate beside x is S, else U
    positive = negative = False
    first, first_x, second_x = 0, 0.0, 0.0
    n_crossings = 0
    highest, side_sign = -np.inf, 1.0
    for i in range(3):
        a, b = geometry.faces[f, i], geometry.faces[f, (i + 1) % 3]
        xa, up_a, side_a, _ = local(geometry.vertices, min(a, b), p, n, corner)
        xb, up_b, side_b, _ = local(geometry.vertices, max(a, b), p, n, corner)
        if up_a > highest:
            highest, side_sign = up_a, (1.0 if side_a >= 0.0 else -1.0)
        ta, tb = (side_a, side_b) if across_side else (up_a, up_b)
        if (ta >= 0.0) != (tb >= 0.0):
            x = xa * abs(tb) + xb * abs(ta)
            positive = positive or x > 0.0
            negative = negative or x < 0.0
        crossing = _curve_crossing(up_a, side_a, up_b, side_b)
        if crossing != 0:
            x = pole * (xa * abs(side_b) + xb * abs(side_a)) / (abs(side_a) + abs(side_b))
            gain = pole * (crossing if a < b else -crossing)
            if n_crossings == 0 or x > first_x:
                first, first_x, second_x = gain, x, first_x
            else:
                second_x = x
            n_crossings += 1
    on_face = positive and negative
    crosses_axis = abs(planes[k, 0]) < 0.5
    if walk != 0:
        if on_face or not crosses_axis:
            return 1 if walk < 0 else 0
        return -walk if positive == (pole > 0) else 0
    if not (on_face and crosses_axis):
        return 0
    if n_crossings == 2 and first_x != second_x:
        return 1 if (first < 0) == front else 0
    # The whole start curve lies on one side of the hemisphere's rim: that of U, or if the rim runs along it,
    # the side away from the rim's vertices there.
    height = plane_up if abs(plane_up) > ALONG else -side_sign * plane_side_
    return 1 if (height < 0.0) == (front == along) else 0


@njit(**KERNEL)
def cross_edges(
    vertices, contours, n_contours, p, n, corner, reach, ledger, line, position, gain, start, count
):
    """Record where contour edges cross isolines, start curve and horizon.

    Parameters
    ----------
    contours : (capacity, 3) int32
        Rows of `contour.decide_contours`.
    reach : (2, K) float64
        See `horizon_reach`: LEFT and RIGHT.
    ledger : (N_ROWS, K + 1) int32
        Added to; rows above.
    line, position, gain : (capacity,) int32, float64, int32
        Crossings: isoline, t, and the gain of W as t grows.
    start, count : int
        First contour to take, and crossings recorded before it.

    Returns
    -------
    next, count : int
        The contour to go on with when there is room again, n_contours at the end.
    """
    n_lines = reach.shape[1]
    for c in range(start, n_contours):
        if count + 4 * n_lines > len(line):
            return c, count
        count = _cross_edge(
            vertices,
            contours[c, 0],
            contours[c, 1],
            contours[c, 2],
            p,
            n,
            corner,
            reach,
            ledger,
            line,
            position,
            gain,
            count,
        )
    return n_contours, count


@njit(**INNER)
def _cross_edge(vertices, a, b, jump, p, n, corner, reach, ledger, line, position, gain, count):
    n_lines = reach.shape[1]
    ax, au, as_, ah = local(vertices, a, p, n, corner)
    bx, bu, bs, bh = local(vertices, b, p, n, corner)
    right, up = as_ >= 0.0, au >= 0.0
    same_octant = (ax >= 0.0) == (bx >= 0.0) and up == (bu >= 0.0) and right == (bs >= 0.0)

    u0, v0, w0, k0 = _project(ax, au, as_, n_lines)
    if same_octant and ah > 0.0 and bh > 0.0:
        u1, v1, w1, k1 = _project(bx, bu, bs, n_lines)
        return _cross_lines(
            u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, reach, ledger, line, position, gain, count
        )

    # Cuts at the coordinate planes and at the horizon, in order along the edge; U before S where they tie.
    # A cut is known by the ratio of the ends' distances from its plane and lies at |b| A + |a| B: both keep
    # their precision however close to an end the cut is.
    cut_x, cut_up, cut_side = np.inf, np.inf, np.inf
    if (ax >= 0.0) != (bx >= 0.0):
        cut_x = min(abs(ax) / abs(bx), LAST)
    if up != (bu >= 0.0):
        cut_up = min(abs(au) / abs(bu), LAST)
    if right != (bs >= 0.0):
        cut_side = min(abs(as_) / abs(bs), LAST)
    cut_horizon = np.inf
    if not (ah > 0.0 and bh > 0.0):
        cut_horizon = min(abs(ah) / abs(bh), LAST)
    hx, hu, hs = abs(bh) * ax + abs(ah) * bx, abs(bh) * au + abs(ah) * bu, abs(bh) * as_ + abs(ah) * bs

    visible = ah > 0.0
    while True:
        cut = min(cut_x, cut_up, cut_side)
        if cut_horizon <= cut and cut_horizon < np.inf:
            u1, v1, w1, k1 = _project(hx, hu, hs, n_lines)
            if visible:
                # Sink below the horizon.
                count = _cross_lines(
                    u0,
                    v0,
                    w0,
                    k0,
                    u1,
                    v1,
                    w1,
                    k1,
                    up,
                    right,
                    jump,
                    reach,
                    ledger,
                    line,
                    position,
                    gain,
                    count,
                )
                if right:
                    ledger[HORIZON_RIGHT, k1] += jump
                else:
                    ledger[HORIZON_LEFT, k1] -= jump
                return count
            # Rise above it.
            if right:
                ledger[HORIZON_RIGHT, k1] -= jump
            else:
                ledger[HORIZON_LEFT, k1] += jump
            u0, v0, w0, k0 = u1, v1, w1, k1
            visible, cut_horizon = True, np.inf
            continue
        if cut == np.inf:
            break
        if cut == cut_x:
            weight_a, weight_b, cut_x, axis = abs(bx), abs(ax), np.inf, 0
        elif cut == cut_up:
            weight_a, weight_b, cut_up, axis = abs(bu), abs(au), np.inf, 1
        else:
            weight_a, weight_b, cut_side, axis = abs(bs), abs(as_), np.inf, 2
        if visible:
            x = 0.0 if axis == 0 else weight_a * ax + weight_b * bx
            y = 0.0 if axis == 1 else weight_a * au + weight_b * bu
            z = 0.0 if axis == 2 else weight_a * as_ + weight_b * bs
            u1, v1, w1, k1 = _project(x, y, z, n_lines)
            count = _cross_lines(
                u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, reach, ledger, line, position, gain, count
            )
            if axis == 2 and up:
                ledger[START, k1] += -jump if right else jump
            u0, v0, w0, k0 = u1, v1, w1, k1
        if axis == 1:
            up = not up
        elif axis == 2:
            right = not right
    u1, v1, w1, k1 = _project(bx, bu, bs, n_lines)
    return _cross_lines(
        u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, reach, ledger, line, position, gain, count
    )


@njit(**INNER)
def _project(x, up, side, n_lines):
    """Octahedral coordinates (u, |U|, |S|) of a direction, and its line index."""
    l1 = abs(x) + abs(up) + abs(side)
    if l1 == 0.0:
        return 0.0, 0.5, 0.5, line_index(0.0, n_lines)
    u = x / l1
    return u, abs(up) / l1, abs(side) / l1, line_index(u, n_lines)


@njit(**INNER)
def _cross_lines(
    u0, up0, side0, k0, u1, up1, side1, k1, up, right, jump, reach, ledger, line, position, gain, count
):
    """Crossings of a piece of an edge within one octant, where it is straight."""
    if k0 == k1:
        return count
    n_lines = reach.shape[1]
    step = -jump if k1 > k0 else jump
    for k in range(min(k0, k1), max(k0, k1)):
        end = reach[RIGHT, k] if right else reach[LEFT, k]
        if end < 0.0:
            continue
        u = isoline_u(k, n_lines)
        f = min(max((u - u0) / (u1 - u0), 0.0), 1.0)
        part = side0 + (side1 - side0) * f if up else up0 + (up1 - up0) * f
        t = min(part / (1.0 - abs(u)), 1.0)
        if not up:
            t += 1.0
        t = min(t, end)
        line[count] = k
        gain[count] = step
        if right:
            position[count] = t
        else:
            position[count] = -t
            ledger[LEFT_GAIN, k] += step
        ledger[CROSSED, k] += 1
        ledger[GAIN, k] += step
        count += 1
    return count
