"""Octahedral u-isolines [NBMJ14 3.3; PH03]: where contour edges cross them.

Each isoline is a diamond. Seen from a shade point with normal n, the diamonds' corners on the axis U among
+-y, +-z nearest to n lie highest; the half circle through them, from -x over U to +x, is the *start curve*.
A position on a diamond is t in [-2, 2]: 0 on the start curve, growing counter-clockwise about +x through the
side corner (t = 1) to the lowest (t = 2), and downwards (t < 0) the other way round. The part of a diamond
above the horizon is one run (-left, right) about t = 0, or nothing.

Every vertex has one line index: the number of isolines below its u. An edge is cut where it changes octant
and at the horizon; each cut has one index too, owned by the edge. An edge crosses the isolines between the
indices of its ends, and crosses the start curve or the horizon between two isolines, whatever rounding does to
where exactly: so crossings of a closed contour cancel along any closed path, and counts cannot drift.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from silint.core.contour import plane_side, side_rounding
from silint.core.partition import node_range

# A vertex at the shade point itself is seen along -n; its distance only has to be small.
AT_POINT = 2.0**-500


@njit(cache=True)
def isoline_u(k, n_lines):
    """Position of isoline k."""
    return (2 * k + 1 - n_lines) / n_lines


@njit(cache=True)
def line_index(u, n_lines):
    """Number of isolines below u."""
    return min(max(int(math.ceil(0.5 * (u + 1.0) * n_lines - 0.5)), 0), n_lines)


@njit(cache=True)
def start_corner(n):
    """Loop coordinate (0, 1, 2 or 3) of the axis U: the corner of every diamond that lies highest over n."""
    if abs(n[1]) >= abs(n[2]):
        return 0 if n[1] >= 0.0 else 2
    return 1 if n[2] >= 0.0 else 3


@njit(cache=True)
def turn(y, z, corner):
    """Coordinates along U and along the side axis S, the next corner counter-clockwise."""
    if corner == 0:
        return y, z
    if corner == 1:
        return z, -y
    if corner == 2:
        return -y, -z
    return -z, y


@njit(cache=True)
def local(vertices, v, p, n, corner):
    """Direction from p to a vertex, along x, U and S, and its height above the horizon."""
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        x, y, z = -AT_POINT * n[0], -AT_POINT * n[1], -AT_POINT * n[2]
    up, side = turn(y, z, corner)
    return x, up, side, n[0] * x + n[1] * y + n[2] * z


@njit(cache=True)
def horizon_reach(n, corner, k, n_lines):
    """How far isoline k runs above the horizon, to the left and to the right of t = 0; (-1, -1) if it does not."""
    up, side = turn(n[1], n[2], corner)
    u = isoline_u(k, n_lines)
    r = 1.0 - abs(u)
    top, bottom = u * n[0] + r * up, u * n[0] - r * up
    if top <= 0.0:
        return -1.0, -1.0
    right = u * n[0] + r * side
    left = u * n[0] - r * side
    return _reach(top, left, bottom), _reach(top, right, bottom)


@njit(cache=True)
def _reach(top, side, bottom):
    """Where a run that starts at height `top` and falls over `side` to `bottom` meets the horizon."""
    if side <= 0.0:
        return top / (top - side)
    if bottom < 0.0:
        return 1.0 + side / (side - bottom)
    return 2.0


@njit(cache=True)
def _curve_crossing(up_a, side_a, up_b, side_b):
    """+1 or -1 where the edge a-b crosses the start half-plane (side = 0, up >= 0), by the sign of dt; else 0.

    The same comparison as in `cross_edge`, so that start counts and crossings never disagree.
    """
    if (side_a >= 0.0) == (side_b >= 0.0):
        return 0
    above = up_a >= 0.0
    if above != (up_b >= 0.0) and up_a / (up_a - up_b) <= side_a / (side_a - side_b):
        above = not above
    if not above:
        return 0
    return 1 if side_b >= 0.0 else -1


@njit(cache=True)
def pole_count(geometry, tree, p, n, corner):
    """Depth count W at the pole of the octahedron above the horizon, +x or -x [start of the start curve].

    A face covers the pole on one side when its loop winds about the axis, and its side tells which of the
    two poles it is: no intersection is computed.
    """
    pole = 1 if n[0] >= 0.0 else -1
    slack = side_rounding(p)
    n_faces = len(tree.order)
    count = 0
    node, level = 0, 0
    while True:
        box = tree.boxes[node]
        inside = (
            abs(box[1] - p[1]) <= box[4] + slack
            and abs(box[2] - p[2]) <= box[5] + slack
            and pole * (box[0] - p[0]) + box[3] >= -slack
        )
        if inside and level < tree.depth:
            node = 2 * node + 1
            level += 1
            continue
        if inside:
            first, last = node_range(n_faces, level, node + 1 - (1 << level))
            for i in range(first, last):
                count += _covers_pole(geometry, tree.order[i], p, n, corner, pole, slack)
        while node > 0 and node % 2 == 0:
            node = (node - 1) >> 1
            level -= 1
        if node == 0:
            return count
        node += 1


@njit(cache=True)
def _covers_pole(geometry, f, p, n, corner, pole, rounding):
    winding = 0
    for i in range(3):
        a, b = geometry.faces[f, i], geometry.faces[f, (i + 1) % 3]
        lower, upper = min(a, b), max(a, b)
        _, up_a, side_a, _ = local(geometry.vertices, lower, p, n, corner)
        _, up_b, side_b, _ = local(geometry.vertices, upper, p, n, corner)
        crossing = _curve_crossing(up_a, side_a, up_b, side_b)
        winding += crossing if a < b else -crossing
    if winding == 0:
        return 0
    code = geometry.face_planes[f]
    k = max(code, ~code)
    side = plane_side(geometry.planes[k], geometry.plane_errors[k] + rounding, p, n)
    front = (side > 0) == (code >= 0)
    # In front of a face its vertices turn clockwise about the directions that it covers, seen from outside.
    return 1 if (winding > 0) == (front == (pole < 0)) else 0


@njit(cache=True)
def cross_edge(geometry, contour, p, n, corner, lines, crossings, count):
    """Record where one contour edge crosses isolines, start curve and horizon.

    Parameters
    ----------
    contour : (3,) int32
        Vertex, vertex, jump.
    lines : Lines
        Added to.
    crossings : tuple of (capacity,) line int32, t float64, jump int32
        Must hold 4 K more than `count`; jump is the gain of W as t grows.

    Returns
    -------
    count
    """
    n_lines = len(lines.left)
    ax, au, as_, ah = local(geometry.vertices, contour[0], p, n, corner)
    bx, bu, bs, bh = local(geometry.vertices, contour[1], p, n, corner)
    jump = contour[2]
    right, up = as_ >= 0.0, au >= 0.0
    same_octant = (ax >= 0.0) == (bx >= 0.0) and up == (bu >= 0.0) and right == (bs >= 0.0)

    u0, v0, w0, k0 = _project(ax, au, as_, n_lines)
    if same_octant and ah > 0.0 and bh > 0.0:
        u1, v1, w1, k1 = _project(bx, bu, bs, n_lines)
        return _cross_lines(u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, lines, crossings, count)

    # Cuts at the coordinate planes, in order along the edge; U before S where they tie.
    c0, c1, c2 = 2.0, 2.0, 2.0
    if (ax >= 0.0) != (bx >= 0.0):
        c0 = ax / (ax - bx)
    if up != (bu >= 0.0):
        c1 = au / (au - bu)
    if right != (bs >= 0.0):
        c2 = as_ / (as_ - bs)
    horizon = 2.0 if ah > 0.0 and bh > 0.0 else ah / (ah - bh)
    dx, du, ds = bx - ax, bu - au, bs - as_

    visible = ah > 0.0
    entered = visible
    while True:
        t = min(c0, c1, c2)
        if not entered and horizon <= t:
            # Rise above the horizon.
            u0, v0, w0, k0 = _project(ax + horizon * dx, au + horizon * du, as_ + horizon * ds, n_lines)
            if right:
                lines.horizon_right[k0] -= jump
            else:
                lines.horizon_left[k0] += jump
            visible = entered = True
        if visible and not bh > 0.0 and horizon <= t:
            # Sink below it.
            u1, v1, w1, k1 = _project(ax + horizon * dx, au + horizon * du, as_ + horizon * ds, n_lines)
            count = _cross_lines(u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, lines, crossings, count)
            if right:
                lines.horizon_right[k1] += jump
            else:
                lines.horizon_left[k1] -= jump
            return count
        if t > 1.0:
            break
        x, y, z = ax + t * dx, au + t * du, as_ + t * ds
        if c0 == t:
            axis, x, c0 = 0, 0.0, 2.0
        elif c1 == t:
            axis, y, c1 = 1, 0.0, 2.0
        else:
            axis, z, c2 = 2, 0.0, 2.0
        if visible:
            u1, v1, w1, k1 = _project(x, y, z, n_lines)
            count = _cross_lines(u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, lines, crossings, count)
            if axis == 2 and up:
                lines.start[k1] += -jump if right else jump
            u0, v0, w0, k0 = u1, v1, w1, k1
        if axis == 1:
            up = not up
        elif axis == 2:
            right = not right
    u1, v1, w1, k1 = _project(bx, bu, bs, n_lines)
    return _cross_lines(u0, v0, w0, k0, u1, v1, w1, k1, up, right, jump, lines, crossings, count)


@njit(cache=True)
def _project(x, up, side, n_lines):
    """Octahedral coordinates (u, |U|, |S|) of a direction, and its line index."""
    l1 = abs(x) + abs(up) + abs(side)
    if l1 == 0.0:
        return 0.0, 0.5, 0.5, line_index(0.0, n_lines)
    u = x / l1
    return u, abs(up) / l1, abs(side) / l1, line_index(u, n_lines)


@njit(cache=True)
def _cross_lines(u0, up0, side0, k0, u1, up1, side1, k1, up, right, jump, lines, crossings, count):
    """Crossings of a piece of an edge within one octant: straight, so t is a ratio of linear functions of u."""
    if k0 == k1:
        return count
    line, position, gain = crossings
    n_lines = len(lines.left)
    step = -jump if k1 > k0 else jump
    for k in range(min(k0, k1), max(k0, k1)):
        reach = lines.right[k] if right else lines.left[k]
        if reach < 0.0:
            continue
        u = isoline_u(k, n_lines)
        f = min(max((u - u0) / (u1 - u0), 0.0), 1.0)
        part = side0 + (side1 - side0) * f if up else up0 + (up1 - up0) * f
        t = min(part / (1.0 - abs(u)), 1.0)
        if not up:
            t += 1.0
        t = min(t, reach)
        line[count] = k
        gain[count] = step
        if right:
            position[count] = t
        else:
            position[count] = -t
            lines.left_gain[k] += step
        lines.crossings[k] += 1
        lines.gain[k] += step
        count += 1
    return count
