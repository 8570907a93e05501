"""Covering: the second way to the visible intervals of one isoline.

Every face hides an interval of the isoline; what no face hides is visible. No contours, no depth count, no
start: any soup of triangles. Within an octant an isoline is the straight segment between two corners of its
diamond, and a face hides the part where three linear functions (the planes through the shade point and the
face's edges) have the sign that its side says. Edges are taken with their lower vertex first, so that two
faces cut the isoline at their common edge in bit-identical places and nothing shows between them.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.buffers import grow, grow_rows, sort_pairs
from silint.core.contour import face_side, side_rounding
from silint.core.face_bundles import BLOCK, CENTRE, HALF
from silint.core.isolines import horizon_reach, isoline_u, start_corner, to_loop, turn
from silint.core.jit import INNER, PARALLEL
from silint.core.lanes import WIDTH
from silint.core.octahedral import local

COVER_BLOCK = 16  # isolines that share scratch memory


@njit(**INNER)
def _corner(u, i):
    """Corner i of the diamond of u as (x, U, S): 0 the highest, then counter-clockwise."""
    r = 1.0 - abs(u)
    if i == 0 or i == 4:
        return u, r, 0.0
    if i == 1:
        return u, 0.0, r
    if i == 2:
        return u, -r, 0.0
    return u, 0.0, -r


@njit(**INNER)
def _cut(geometry, a, b, p, n, corner, c0, c1):
    """Signed distances of the two ends of a segment of the isoline from the plane through p and a-b."""
    ax, au, as_, _ = local(geometry.vertices, a, p, n, corner)
    bx, bu, bs, _ = local(geometry.vertices, b, p, n, corner)
    x, y, z = au * bs - as_ * bu, as_ * bx - ax * bs, ax * bu - au * bx
    d0, d1 = x * c0[0] + y * c0[1] + z * c0[2], x * c1[0] + y * c1[1] + z * c1[2]
    if d0 == 0.0 and d1 == 0.0:
        return x, x  # a segment in the plane counts as a little further along x, as line indices have it
    return d0, d1


@njit(**INNER)
def _hidden_part(geometry, f, p, n, corner, c0, c1, front):
    """The part [lo, hi] of the segment from corner c0 to c1 that a face hides; lo > hi for none."""
    lo, hi = 0.0, 1.0
    for i in range(3):
        a, b = geometry.faces[f, i], geometry.faces[f, (i + 1) % 3]
        d0, d1 = _cut(geometry, min(a, b), max(a, b), p, n, corner, c0, c1)
        # In front of a face, what it hides lies to the right of its edges.
        if (a < b) == front:
            d0, d1 = -d0, -d1
        if d0 < 0.0 and d1 < 0.0:
            return 1.0, 0.0
        if d0 < 0.0:
            lo = max(lo, d0 / (d0 - d1))
        elif d1 < 0.0:
            hi = min(hi, d0 / (d0 - d1))
    return lo, hi


@njit(**INNER)
def _node_misses(nodes, base, p, n, corner, segments, slack):
    """True where a box lies below the horizon, or away from the planes of all four segments."""
    x = nodes[base + CENTRE * WIDTH] - p[0]
    y = nodes[base + (CENTRE + 1) * WIDTH] - p[1]
    z = nodes[base + (CENTRE + 2) * WIDTH] - p[2]
    hx, hy, hz = (
        nodes[base + HALF * WIDTH],
        nodes[base + (HALF + 1) * WIDTH],
        nodes[base + (HALF + 2) * WIDTH],
    )
    if n[0] * x + n[1] * y + n[2] * z + abs(n[0]) * hx + abs(n[1]) * hy + abs(n[2]) * hz < -slack:
        return True
    up, side = turn(y, z, corner)
    half_up, half_side = (hy, hz) if corner % 2 == 0 else (hz, hy)
    for i in range(4):
        a, b, c = segments[i, 0], segments[i, 1], segments[i, 2]
        if abs(a * x + b * up + c * side) <= abs(a) * hx + abs(b) * half_up + abs(c) * half_side + slack:
            return False
    return True


@njit(**INNER)
def _cover_line(geometry, tree, p, n, corner, k, n_lines, left, right, out, n_out):
    """Append the visible intervals of isoline k, in t, between its ends at the horizon.

    Parameters
    ----------
    tree : FaceBundles
    left, right : float
        Reach of the isoline above the horizon (octahedral.horizon_reach).
    out : (capacity, 2) float64
        Rows before n_out are kept; grown where needed.

    Returns
    -------
    out, n_out
    """
    u = isoline_u(k, n_lines)
    rounding = side_rounding(p)
    slack = 4.0 * rounding
    segments = np.empty((4, 3))
    for i in range(4):
        c0, c1 = _corner(u, i), _corner(u, i + 1)
        segments[i, 0] = c0[1] * c1[2] - c0[2] * c1[1]
        segments[i, 1] = c0[2] * c1[0] - c0[0] * c1[2]
        segments[i, 2] = c0[0] * c1[1] - c0[1] * c1[0]

    # Collect what each face hides.
    lows, highs = np.empty(64), np.empty(64)
    n_hidden = 0
    stack = np.empty((256, 2), np.int64)
    top = 1 if len(tree.order) > 0 else 0
    stack[0, 0], stack[0, 1] = len(tree.levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        for lane in range(WIDTH):
            child = block * WIDTH + lane
            if child * WIDTH ** (level + 1) >= len(tree.order):
                break
            base = (tree.levels[level] + block) * BLOCK + lane
            if _node_misses(tree.nodes, base, p, n, corner, segments, slack):
                continue
            if level > 0:
                stack[top, 0], stack[top, 1] = level - 1, child
                top += 1
                continue
            for j in range(child * WIDTH, min((child + 1) * WIDTH, len(tree.order))):
                f = tree.order[j]
                front = face_side(geometry, f, p, n, rounding) > 0
                for i in range(4):
                    c0, c1 = _corner(u, i), _corner(u, i + 1)
                    lo, hi = _hidden_part(geometry, f, p, n, corner, c0, c1, front)
                    if lo <= hi:
                        if n_hidden == len(lows):
                            lows, highs = grow(lows, 2 * n_hidden), grow(highs, 2 * n_hidden)
                        start = i if i < 2 else i - 4
                        lows[n_hidden], highs[n_hidden] = start + lo, start + hi
                        n_hidden += 1

    # What lies between them is visible.
    sort_pairs(lows, highs, 0, n_hidden)
    if n_out + n_hidden + 1 > len(out):
        out = grow_rows(out, 2 * len(out) + n_hidden)
    t = -left
    for j in range(n_hidden + 1):
        end = min(lows[j], right) if j < n_hidden else right
        if end > t:
            out[n_out, 0], out[n_out, 1] = t, end
            n_out += 1
        if j < n_hidden:
            t = max(t, highs[j])
    return out, n_out


@njit(**INNER)
def _cover_block(geometry, tree, points, normals, lines, first, last, n_lines, counts):
    found = np.empty((64, 2))
    n_found = 0
    for j in range(first, last):
        i, k = lines[j, 0], lines[j, 1]
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        corner = start_corner(n)
        left, right = horizon_reach(n, corner, k, n_lines)
        before = n_found
        if left >= 0.0:
            found, n_found = _cover_line(geometry, tree, p, n, corner, k, n_lines, left, right, found, before)
            to_loop(found, before, n_found, corner)
        counts[j] = n_found - before
    return found[:n_found].copy()


@njit(**PARALLEL)
def covered_intervals(geometry, tree, points, normals, lines, n_lines, counts, intervals, needed):
    """Visible intervals of single isolines, by covering.

    Parameters
    ----------
    geometry : Topology
    tree : FaceBundles
    points, normals : (n, 3) float64
        As for `sweep.visible_intervals`.
    lines : (m, 2) int64
        Point and isoline.
    n_lines : int
        K.
    counts : (m,) int64, out
        Intervals on each.
    intervals : (blocks, capacity, 2) float64, out
        Loop coordinates, tightly packed within each block of COVER_BLOCK lines.
    needed : (blocks,) int64, out
        Intervals of each block; a block that needs more than the capacity is left unwritten.
    """
    m = len(lines)
    for block in prange(len(intervals)):
        first, last = block * COVER_BLOCK, min((block + 1) * COVER_BLOCK, m)
        found = _cover_block(geometry, tree, points, normals, lines, first, last, n_lines, counts)
        needed[block] = len(found)
        if len(found) <= intervals.shape[1]:
            for j in range(len(found)):
                intervals[block, j, 0], intervals[block, j, 1] = found[j, 0], found[j, 1]
