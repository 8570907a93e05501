"""Where edges leave the ball about a shade point: found once for an edge, and shared by all that meet there.

A vertex is inside the ball or not; an edge leaves it once between a vertex inside and one outside, and twice
or never between two that are outside. So the parts of edges in the ball and the arcs of faces on its sphere
close up, whatever rounding does to the places.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.contour import height
from silint.core.jit import INNER


class Hits(NamedTuple):
    """Edges that have been looked at, by their vertices."""

    slots: np.ndarray  # (a power of two,) int32: hash table of rows + 1, 0 where free
    ends: np.ndarray  # (rows, 2) int32: lower and upper vertex
    number: np.ndarray  # (rows,) int32: times that the edge passes through the sphere
    places: np.ndarray  # (2 rows, 4) float64: from the shade point, world axes; and how far along the edge


@njit(**INNER)
def new_hits(n_edges):
    """Room for so many edges."""
    size = 16
    while size < 2 * n_edges:
        size *= 2
    return Hits(
        np.zeros(size, np.int32),
        np.empty((n_edges, 2), np.int32),
        np.empty(n_edges, np.int32),
        np.empty((2 * n_edges, 4)),
    )


@njit(**INNER)
def is_inside(vertices, v, p, reach):
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    return x * x + y * y + z * z < reach * reach


@njit(**INNER)
def comes_inside(vertices, u, v, p, reach):
    """Whether a part of the edge from u to v > u lies inside the ball."""
    if is_inside(vertices, u, p, reach) or is_inside(vertices, v, p, reach):
        return True
    middle, half, rest, _, _ = _chord(vertices, u, v, p, reach)
    return rest > 0.0 and 0.0 < middle < 1.0 and middle - half < middle + half


@njit(**INNER)
def edge_row(hits, n_rows, u, v, vertices, p, reach):
    """The row of the edge from u to v > u, which is added if it is new; and the number of rows."""
    mask = len(hits.slots) - 1
    slot = (u * 73856093 ^ v * 19349663) & mask
    while hits.slots[slot] > 0:
        row = hits.slots[slot] - 1
        if hits.ends[row, 0] == u and hits.ends[row, 1] == v:
            return row, n_rows
        slot = (slot + 1) & mask
    hits.slots[slot] = n_rows + 1
    hits.ends[n_rows, 0], hits.ends[n_rows, 1] = u, v
    hits.number[n_rows] = _pass_sphere(vertices, u, v, p, reach, hits.places, 2 * n_rows)
    return n_rows, n_rows + 1


@njit(**INNER)
def _chord(vertices, u, v, p, reach):
    """Where the line of an edge passes through the sphere: at (middle -+ half) of the edge, if rest > 0."""
    x, y, z = vertices[u, 0] - p[0], vertices[u, 1] - p[1], vertices[u, 2] - p[2]
    ex = vertices[v, 0] - vertices[u, 0]
    ey = vertices[v, 1] - vertices[u, 1]
    ez = vertices[v, 2] - vertices[u, 2]
    # By the distance to the line: a difference of squared distances of its ends would lose it on long edges.
    square = ex * ex + ey * ey + ez * ez
    cx, cy, cz = y * ez - z * ey, z * ex - x * ez, x * ey - y * ex
    rest = square * reach * reach - (cx * cx + cy * cy + cz * cz)
    half = np.sqrt(rest if rest > 0.0 else 0.0) / square
    return -(x * ex + y * ey + z * ez) / square, half, rest, (x, y, z), (ex, ey, ez)


@njit(**INNER)
def _pass_sphere(vertices, u, v, p, reach, places, row):
    """Write where the edge from u to v passes through the sphere, in this order; how often it does."""
    u_inside, v_inside = is_inside(vertices, u, p, reach), is_inside(vertices, v, p, reach)
    if u_inside and v_inside:
        return 0
    middle, half, rest, start, along = _chord(vertices, u, v, p, reach)
    first, second = middle - half, middle + half
    if u_inside or v_inside:
        s = second if u_inside else first
        _put(places, row, start, along, min(max(s, 0.0), 1.0))
        return 1
    if not (rest > 0.0 and 0.0 < middle < 1.0 and first < second):
        return 0
    _put(places, row, start, along, max(first, 0.0))
    _put(places, row + 1, start, along, min(second, 1.0))
    return 2


@njit(**INNER)
def _put(places, row, start, along, s):
    places[row, 0] = start[0] + s * along[0]
    places[row, 1] = start[1] + s * along[1]
    places[row, 2] = start[2] + s * along[2]
    places[row, 3] = s


@njit(**INNER)
def _is_above(place, v, places, vertices, p, n):
    """Whether an end of an edge, a place on the sphere or a vertex, lies above the horizon."""
    if place < 0:
        return height(vertices, v, p, n) > 0.0
    return n[0] * places[place, 0] + n[1] * places[place, 1] + n[2] * places[place, 2] > 0.0


@njit(**INNER)
def clip_contours(contours, n_contours, hits, vertices, p, n, reach, cuts):
    """Keep those contour edges of which a part lies in the ball, which is one part, and above the horizon.

    Parameters
    ----------
    contours : (capacity, 3) int32, in and out
        See `contour.decide_contours`.
    hits : Hits, out
        Empty, with room for all of them.
    cuts : (capacity, 2) int32, out
        Rows of `hits.places` where the part begins and ends, -1 at the edge's own vertex.

    Returns
    -------
    n_contours, n_rows : int
        Of contours, and of edges in `hits`.
    """
    kept, n_rows = 0, 0
    for i in range(n_contours):
        a, b = contours[i, 0], contours[i, 1]
        if not comes_inside(vertices, a, b, p, reach):
            continue
        row, n_rows = edge_row(hits, n_rows, a, b, vertices, p, reach)
        number, a_inside = hits.number[row], is_inside(vertices, a, p, reach)
        start = -1 if a_inside else 2 * row
        end = 2 * row + number - 1 if number > int(not a_inside) else -1
        if not (
            _is_above(start, a, hits.places, vertices, p, n) or _is_above(end, b, hits.places, vertices, p, n)
        ):
            continue
        contours[kept, 0], contours[kept, 1], contours[kept, 2] = a, b, contours[i, 2]
        cuts[kept, 0], cuts[kept, 1] = start, end
        kept += 1
    return kept, n_rows
