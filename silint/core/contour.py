"""Contour edges seen from a shade point: where the depth count jumps.

The jump of an edge is summed over its faces, J = -sum o s, with o the direction of the face along the
edge and s the side on which the shade point lies; it is what the depth count gains across the edge from
its right to its left, seen from outside the sphere of directions. Every side is decided once per plane, so
jumps around a vertex cancel and contours close.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.edge_hierarchy import CENTRE, HALF, NORMAL, NORMAL_HALF, OFFSET, OFFSET_HALF
from silint.core.partition import node_range
from silint.core.topology import ULP

# What a shade point's search counts.
NODES, EDGES, CONTOURS, CROSSINGS, SNAPPED, FALLBACK, N_TALLY = 0, 1, 2, 3, 4, 5, 6


@njit(cache=True, error_model="numpy")
def height(vertices, v, p, n):
    """Height of a vertex above the horizon plane of (p, n). A vertex at p itself is seen along -n."""
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return -1.0
    return n[0] * x + n[1] * y + n[2] * z


@njit(cache=True, error_model="numpy")
def side_rounding(p):
    """Bound of the rounding of N.p + d for any unit N and |d| <= sqrt(3)."""
    return 8.0 * ULP * (1.0 + abs(p[0]) + abs(p[1]) + abs(p[2]))


@njit(cache=True, error_model="numpy")
def plane_side(plane, error, p, n):
    """Side of the plane on which p lies: +1 in front, -1 behind; +3 or -3 where rounding could not tell.

    Below the error the plane is taken to pass through p, and p to be pushed along its normal n; a plane
    that holds n too is decided by its own normal, so that all faces on it agree.
    """
    s = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3]
    if s > error:
        return 1
    if s < -error:
        return -1
    s = plane[0] * n[0] + plane[1] * n[1] + plane[2] * n[2]
    for i in range(3):
        if s == 0.0:
            s = plane[i]
    return 3 if s > 0.0 else -3


@njit(cache=True, error_model="numpy")
def face_side(geometry, f, p, n, rounding):
    """Side of a face on which p lies, as `plane_side`."""
    code = geometry.face_planes[f]
    k = max(code, ~code)
    side = plane_side(geometry.planes[k], geometry.plane_errors[k] + rounding, p, n)
    return side if code >= 0 else -side


@njit(cache=True, error_model="numpy")
def edge_jump(planes, plane_errors, codes, first, last, p, n, rounding):
    """Jump of the depth count across an edge with the plane codes [first, last); and how many sides were snapped."""
    jump = 0
    snapped = 0
    for i in range(first, last):
        code = codes[i]
        k = max(code, ~code)
        side = plane_side(planes[k], plane_errors[k] + rounding, p, n)
        if side > 1:
            side -= 2
            snapped += 1
        elif side < -1:
            side += 2
            snapped += 1
        jump -= side if code >= 0 else -side
    return jump, snapped


@njit(cache=True, error_model="numpy")
def _node_misses(row, p, n, rounding):
    """True where no edge of the node can be a contour that reaches above the horizon."""
    x, y, z = p[0] - row[CENTRE], p[1] - row[CENTRE + 1], p[2] - row[CENTRE + 2]
    top = abs(n[0]) * row[HALF] + abs(n[1]) * row[HALF + 1] + abs(n[2]) * row[HALF + 2]
    if n[0] * x + n[1] * y + n[2] * z > top + rounding:
        return True
    middle = row[NORMAL] * x + row[NORMAL + 1] * y + row[NORMAL + 2] * z + row[OFFSET]
    width = abs(x) * row[NORMAL_HALF] + abs(y) * row[NORMAL_HALF + 1] + abs(z) * row[NORMAL_HALF + 2]
    return abs(middle) > width + row[OFFSET_HALF] + rounding


@njit(cache=True, error_model="numpy")
def gather_contours(geometry, tree, p, n, contours, count, tally):
    """Append the contour edges of one hierarchy that reach above the horizon of (p, n).

    Parameters
    ----------
    contours : (capacity, 3) int32
        Rows: vertex, vertex, jump. Grown, never capped.
    tally : (N_TALLY,) int64
        Counters, added to.

    Returns
    -------
    contours, count
    """
    n_edges = len(tree.ends)
    if n_edges == 0:
        return contours, count
    vertices, planes, plane_errors = geometry.vertices, geometry.planes, geometry.plane_errors
    rounding = side_rounding(p)
    node_rounding = 4.0 * rounding  # bounds and test are each rounded once more than a side
    last_level = tree.depth
    node, level = 0, 0
    while True:
        tally[NODES] += 1
        descend = not _node_misses(tree.bounds[node], p, n, node_rounding)
        if descend and level < last_level:
            node = 2 * node + 1
            level += 1
            continue
        if descend:
            first, last = node_range(n_edges, level, node + 1 - (1 << level))
            tally[EDGES] += last - first
            for e in range(first, last):
                jump, snapped = edge_jump(
                    planes, plane_errors, tree.planes, tree.offsets[e], tree.offsets[e + 1], p, n, rounding
                )
                if jump == 0:
                    continue
                a, b = tree.ends[e, 0], tree.ends[e, 1]
                if height(vertices, a, p, n) > 0.0 or height(vertices, b, p, n) > 0.0:
                    if count == len(contours):
                        grown = np.empty((2 * count, 3), dtype=np.int32)
                        grown[:count] = contours
                        contours = grown
                    contours[count, 0], contours[count, 1], contours[count, 2] = a, b, jump
                    count += 1
                    tally[SNAPPED] += snapped
        # Next node in preorder: climb while this is a right child (even index), then step right.
        while node > 0 and node % 2 == 0:
            node = (node - 1) >> 1
            level -= 1
        if node == 0:
            return contours, count
        node += 1
