"""Contour edges seen from a shade point: where the depth count jumps.

The jump of an edge is summed over its faces, J = -sum o s, with o the direction of the face along the
edge and s the side on which the shade point lies; it is what the depth count gains across the edge from
its right to its left, seen from outside the sphere of directions. Every side is decided once per plane, so
jumps around a vertex cancel and contours close.
"""

from __future__ import annotations

from numba import njit

from silint.core.buffers import grow_rows
from silint.core.edge_hierarchy import CENTRE, HALF, N_POSITION, NORMAL, NORMAL_HALF, OFFSET, OFFSET_HALF
from silint.core.isolines import lies_between_lines
from silint.core.jit import INNER, KERNEL
from silint.core.partition import DONE, next_in_preorder, node_range
from silint.core.topology import ULP

# What a shade point's search counts.
NODES, EDGES, CONTOURS, CROSSINGS, SNAPPED, N_TALLY = 0, 1, 2, 3, 4, 5

UNCLEAR = 1 << 20  # not a jump


@njit(**KERNEL)
def height(vertices, v, p, n):
    """Height of a vertex above the horizon plane of (p, n). A vertex at p itself is seen along -n."""
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return -1.0
    return n[0] * x + n[1] * y + n[2] * z


@njit(**KERNEL)
def side_rounding(p):
    """Bound of the rounding of N.p + d for any unit N and |d| <= sqrt(3)."""
    return 8.0 * ULP * (1.0 + abs(p[0]) + abs(p[1]) + abs(p[2]))


@njit(**KERNEL)
def plane_side(planes, k, error, p, n):
    """Side of plane k on which p lies: +1 in front, -1 behind; +3 or -3 where rounding could not tell.

    Below the error the plane is taken to pass through p, and p to be pushed along its normal n; a plane
    that holds n too is decided by its own normal, so that all faces on it agree.
    """
    s = planes[k, 0] * p[0] + planes[k, 1] * p[1] + planes[k, 2] * p[2] + planes[k, 3]
    if s > error:
        return 1
    if s < -error:
        return -1
    s = planes[k, 0] * n[0] + planes[k, 1] * n[1] + planes[k, 2] * n[2]
    for i in range(3):
        if s == 0.0:
            s = planes[k, i]
    return 3 if s > 0.0 else -3


@njit(**KERNEL)
def face_side(geometry, f, p, n, rounding):
    """Side of a face on which p lies, as `plane_side`."""
    code = geometry.face_planes[f]
    k = max(code, ~code)
    side = plane_side(geometry.planes, k, geometry.plane_errors[k] + rounding, p, n)
    return side if code >= 0 else -side


@njit(**INNER)
def _clear_jump(planes, codes, first, decided, p):
    """Jump across an edge with two faces; UNCLEAR where a side is not beyond `decided`."""
    i, j = codes[first], codes[first + 1]
    k = max(i, ~i)
    s = planes[k, 0] * p[0] + planes[k, 1] * p[1] + planes[k, 2] * p[2] + planes[k, 3]
    k = max(j, ~j)
    t = planes[k, 0] * p[0] + planes[k, 1] * p[1] + planes[k, 2] * p[2] + planes[k, 3]
    if min(abs(s), abs(t)) <= decided:
        return UNCLEAR
    return (-1 if (s > 0.0) == (i >= 0) else 1) + (-1 if (t > 0.0) == (j >= 0) else 1)


@njit(**KERNEL)
def edge_jump(planes, plane_errors, codes, first, last, p, n, rounding):
    """Jump across an edge with the plane codes [first, last), and the number of sides that were snapped."""
    jump = 0
    snapped = 0
    for i in range(first, last):
        code = codes[i]
        k = max(code, ~code)
        side = plane_side(planes, k, plane_errors[k] + rounding, p, n)
        if side > 1:
            side -= 2
            snapped += 1
        elif side < -1:
            side += 2
            snapped += 1
        jump -= side if code >= 0 else -side
    return jump, snapped


@njit(**INNER)
def _node_misses(bounds, node, p, n, rounding):
    """True where no edge of the node can be a contour that reaches above the horizon."""
    x, y, z = p[0] - bounds[node, CENTRE], p[1] - bounds[node, CENTRE + 1], p[2] - bounds[node, CENTRE + 2]
    top = (
        abs(n[0]) * bounds[node, HALF]
        + abs(n[1]) * bounds[node, HALF + 1]
        + abs(n[2]) * bounds[node, HALF + 2]
    )
    if n[0] * x + n[1] * y + n[2] * z > top + rounding:
        return True
    if bounds.shape[1] == N_POSITION:
        return False
    middle = bounds[node, NORMAL] * x + bounds[node, NORMAL + 1] * y + bounds[node, NORMAL + 2] * z
    width = abs(x) * bounds[node, NORMAL_HALF] + abs(y) * bounds[node, NORMAL_HALF + 1]
    width += abs(z) * bounds[node, NORMAL_HALF + 2] + bounds[node, OFFSET_HALF]
    return abs(middle + bounds[node, OFFSET]) > width + rounding


@njit(**KERNEL)
def gather_contours(geometry, tree, p, n, corner, n_lines, contours, count, tally):
    """Append the contour edges of one hierarchy that reach above the horizon of (p, n).

    Parameters
    ----------
    corner, n_lines : int
        Where the isolines are (core.octahedral): nodes that lie between two of them, and neither on the start
        curve nor on the horizon, are skipped. With n_lines = 0 nothing is.
    contours : (capacity, 3) int32
        Rows: vertex, vertex, jump. Grown, never capped.
    tally : (N_TALLY,) int64
        Counters, added to.

    Returns
    -------
    contours, count
    """
    node = 0 if len(tree.ends) > 0 else DONE
    while node != DONE:
        # The search itself never grows the buffer: an array that changes inside a hot loop makes Numba count
        # references there, which cost 8 times the loop.
        node, count = _search(
            geometry.vertices,
            geometry.planes,
            geometry.plane_errors,
            tree.ends,
            tree.offsets,
            tree.planes,
            tree.bounds,
            tree.depth,
            tree.largest_error,
            node,
            p,
            n,
            corner,
            n_lines,
            contours,
            count,
            tally,
        )
        if node != DONE:
            contours = grow_rows(contours, 2 * len(contours))
    return contours, count


@njit(**INNER)
def _search(
    vertices,
    planes,
    plane_errors,
    ends,
    offsets,
    codes,
    bounds,
    depth,
    largest_error,
    node,
    p,
    n,
    corner,
    n_lines,
    contours,
    count,
    tally,
):
    """Search in preorder from a node on.

    Returns DONE, or the leaf at which the buffer was full, and the count.
    """
    n_edges = len(ends)
    rounding = side_rounding(p)
    node_rounding = 4.0 * rounding  # bounds and test are each rounded once more than a side
    decided = largest_error + rounding
    first_leaf = (1 << depth) - 1
    nodes, edges, snapped_sides = 0, 0, 0
    while True:
        nodes += 1
        if not _node_misses(bounds, node, p, n, node_rounding) and (
            n_lines == 0 or not lies_between_lines(bounds, node, p, n, corner, n_lines, node_rounding)
        ):
            if node < first_leaf:
                node = 2 * node + 1
                continue
            first, last = node_range(n_edges, depth, node - first_leaf)
            if count + last - first > len(contours):
                break
            edges += last - first
            for e in range(first, last):
                jump, snapped = UNCLEAR, 0
                if offsets[e + 1] - offsets[e] == 2:
                    jump = _clear_jump(planes, codes, offsets[e], decided, p)
                if jump == UNCLEAR:
                    jump, snapped = edge_jump(
                        planes, plane_errors, codes, offsets[e], offsets[e + 1], p, n, rounding
                    )
                if jump == 0:
                    continue
                a, b = ends[e, 0], ends[e, 1]
                if height(vertices, a, p, n) > 0.0 or height(vertices, b, p, n) > 0.0:
                    contours[count, 0], contours[count, 1], contours[count, 2] = a, b, jump
                    count += 1
                    snapped_sides += snapped
        node = next_in_preorder(node)
        if node == DONE:
            break
    tally[NODES] += nodes
    tally[EDGES] += edges
    tally[SNAPPED] += snapped_sides
    return node, count
