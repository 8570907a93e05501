"""Contour edges seen from a shade point: where the depth count jumps.

The jump of an edge is summed over its faces, J = -sum o s, with o the direction of the face along the
edge and s the side on which the shade point lies; it is what the depth count gains across the edge from
its right to its left, seen from outside the sphere of directions. Every side is decided once per plane, so
jumps around a vertex cancel and contours close.
"""

from __future__ import annotations

from numba import njit

from silint.core.jit import INNER, KERNEL
from silint.core.topology import ULP

# What a shade point's search counts; SPHERE is the work at the end of a distance.
NODES, EDGES, CONTOURS, CROSSINGS, SNAPPED, SPHERE, N_TALLY = 0, 1, 2, 3, 4, 5, 6


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
def decide_contours(
    vertices,
    planes,
    plane_errors,
    ends,
    offsets,
    codes,
    ids,
    sides,
    p,
    n,
    rounding,
    contours,
    count,
    tally,
):
    """Append those edges of a list that are contours and reach above the horizon of (p, n).

    Parameters
    ----------
    ends, offsets, codes
        Of an EdgeBundles.
    ids, sides
        Edges, and on which side of their faces p is where that is known (search.search_tile).
    contours : (capacity, 3) int32, out
        Rows: vertex, vertex, jump; with room for all.

    Returns
    -------
    The number of rows, those before included.
    """
    pairs = len(offsets) == 0
    for i in range(len(ids)):
        e = ids[i]
        a, b = ends[e, 0], ends[e, 1]
        if height(vertices, a, p, n) <= 0.0 and height(vertices, b, p, n) <= 0.0:
            continue
        if pairs and sides[i] != 0:
            jump, snapped = -2 * sides[i], 0
        else:
            first = 2 * e if pairs else offsets[e]
            last = first + 2 if pairs else offsets[e + 1]
            jump, snapped = edge_jump(planes, plane_errors, codes, first, last, p, n, rounding)
        if jump != 0:
            contours[count, 0], contours[count, 1], contours[count, 2] = a, b, jump
            count += 1
            tally[SNAPPED] += snapped
    return count
