"""Texels to the triangles that they belong to, in the plane of a texture.

Coordinates are in texels, x to the right and y down from the upper left corner: texel (row, column) is the
square about (column + 1/2, row + 1/2). Its *footprint* is the square of twice the side about the same centre,
which holds every place whose bilinear lookup reads the texel. Whether a square and a triangle meet is decided
by separating axes, borders included [AM01], so that no triangle is too thin to be seen.

A texel whose footprint meets a triangle is *covered*: it belongs to the point of all triangles that is
nearest to its centre, the first one of equals. All loops run in the order of the triangles: nothing depends
on threads.

References
----------
AM01
    Akenine-Möller 2001, Fast 3D triangle-box overlap testing: here in the plane.
Ericson05
    Ericson 2005, Real-time collision detection, 5.1.5: the point of a triangle that is nearest to a point.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER, KERNEL

# A centre counts as inside two triangles at once only where both hold it by more than this, in barycentric
# coordinates: along a shared edge rounding may let both have it.
INSIDE = 1e-6


@njit(**INNER)
def _meets(ax, ay, bx, by, cx, cy, x, y, half):
    """Whether a triangle (or a segment, given as one) meets the square of half-width `half` about (x, y)."""
    if min(ax, bx, cx) > x + half or max(ax, bx, cx) < x - half:
        return False
    if min(ay, by, cy) > y + half or max(ay, by, cy) < y - half:
        return False
    for side in range(3):
        nx, ny = (by - ay, ax - bx) if side == 0 else (cy - by, bx - cx) if side == 1 else (ay - cy, cx - ax)
        a, b, c = nx * (ax - x) + ny * (ay - y), nx * (bx - x) + ny * (by - y), nx * (cx - x) + ny * (cy - y)
        reach = half * (abs(nx) + abs(ny))
        if min(a, b, c) > reach or max(a, b, c) < -reach:
            return False
    return True


@njit(**INNER)
def _on_segment(ax, ay, bx, by, x, y):
    """Parameter in [0, 1] of the nearest point of a segment, and the squared distance from it."""
    dx, dy = bx - ax, by - ay
    length = dx * dx + dy * dy
    t = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / length)) if length > 0.0 else 0.0
    ex, ey = ax + t * dx - x, ay + t * dy - y
    return t, ex * ex + ey * ey


@njit(**INNER)
def _nearest(ax, ay, bx, by, cx, cy, x, y):
    """Barycentric coordinates of the nearest point of a triangle, and its squared distance [Ericson05]."""
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area != 0.0:
        a = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
        b = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
        c = 1.0 - a - b
        if a >= 0.0 and b >= 0.0 and c >= 0.0:
            return a, b, c, 0.0
    t, best = _on_segment(ax, ay, bx, by, x, y)
    a, b, c = 1.0 - t, t, 0.0
    t, distance = _on_segment(bx, by, cx, cy, x, y)
    if distance < best:
        a, b, c, best = 0.0, 1.0 - t, t, distance
    t, distance = _on_segment(cx, cy, ax, ay, x, y)
    if distance < best:
        a, b, c, best = t, 0.0, 1.0 - t, distance
    return a, b, c, best


@njit(**INNER)
def _span(low, high, half, size):
    """The texels whose squares of some half-width may meet an interval: first, and one past the last."""
    first = int(max(0.0, np.floor(low - 0.5 - half)))
    return first, min(size, int(np.floor(high - 0.5 + half)) + 1)


@njit(**KERNEL)
def cover(corners, first, last, owner, distance, held):
    """Give texels to triangles first to last - 1.

    Parameters
    ----------
    corners : (F, 3, 2) float64
    first, last : int
    owner : (size, size) int32, in and out
        The triangle of each texel, -1 without.
    distance : (size, size) float64, in and out
        Squared, from the texel's centre to its point; infinite without.
    held : (size, size) uint8, in and out
        In how many triangles the centre lies, up to 255.
    """
    size = len(owner)
    for f in range(first, last):
        (ax, ay), (bx, by), (cx, cy) = corners[f, 0], corners[f, 1], corners[f, 2]
        top, bottom = _span(min(ay, by, cy), max(ay, by, cy), 1.0, size)
        left, right = _span(min(ax, bx, cx), max(ax, bx, cx), 1.0, size)
        for row in range(top, bottom):
            for column in range(left, right):
                x, y = column + 0.5, row + 0.5
                if not _meets(ax, ay, bx, by, cx, cy, x, y, 1.0):
                    continue
                a, b, c, d = _nearest(ax, ay, bx, by, cx, cy, x, y)
                if d == 0.0 and min(a, b, c) > INSIDE and held[row, column] < 255:
                    held[row, column] += 1
                if d < distance[row, column]:
                    owner[row, column], distance[row, column] = f, d


@njit(**INNER)
def _apart(corners, places, f, g, x, y):
    """Distance in space between the points of two triangles that are nearest to a place of the texture."""
    p, q = corners[f], corners[g]
    a, b, c, _ = _nearest(p[0, 0], p[0, 1], p[1, 0], p[1, 1], p[2, 0], p[2, 1], x, y)
    i, j, k, _ = _nearest(q[0, 0], q[0, 1], q[1, 0], q[1, 1], q[2, 0], q[2, 1], x, y)
    square = 0.0
    for axis in range(3):
        d = a * places[f, 0, axis] + b * places[f, 1, axis] + c * places[f, 2, axis]
        d -= i * places[g, 0, axis] + j * places[g, 1, axis] + k * places[g, 2, axis]
        square += d * d
    return np.sqrt(square)


@njit(**KERNEL)
def mark(corners, places, reach, chart, normals, cosine, first, last, owner, mixed, rival):
    """Find texels that need several samples, and those that several parts of the mesh compete for.

    Parameters
    ----------
    corners : (F, 3, 2) float64
    places : (F, 3, 3) float64
        The corners in space.
    reach : (F,) float64
        How far apart in space two points of a face's neighbourhood can be that are in one footprint.
    chart : (F,) int32
    normals : (F, 3) float64
        Unit normals of the faces, or zero.
    cosine : float
        Faces that meet one texel at an angle of a smaller cosine make it a mixed one.
    first, last : int
    owner : (size, size) int32
        What `cover` has found.
    mixed : (size, size) bool, in and out
    rival : (size, size) int32, in and out
        The last triangle that shares the texel's footprint and is of a chart that the texel does not belong
        to, or, across a narrow slit, of a part of its own that is somewhere else on the mesh; -1 without.
    """
    size = len(owner)
    for f in range(first, last):
        (ax, ay), (bx, by), (cx, cy) = corners[f, 0], corners[f, 1], corners[f, 2]
        top, bottom = _span(min(ay, by, cy), max(ay, by, cy), 1.0, size)
        left, right = _span(min(ax, bx, cx), max(ax, bx, cx), 1.0, size)
        for row in range(top, bottom):
            for column in range(left, right):
                g = owner[row, column]
                x, y = column + 0.5, row + 0.5
                if f == g or g < 0 or not _meets(ax, ay, bx, by, cx, cy, x, y, 1.0):
                    continue
                if chart[f] != chart[g] or _apart(corners, places, f, g, x, y) > max(reach[f], reach[g]):
                    rival[row, column] = f
                elif _meets(ax, ay, bx, by, cx, cy, x, y, 0.5):
                    n, m = normals[f], normals[g]
                    if n[0] * m[0] + n[1] * m[1] + n[2] * m[2] < cosine:
                        mixed[row, column] = True


@njit(**KERNEL)
def mark_borders(segments, chart, first, last, border_chart, owner, distance, mixed):
    """Mark texels whose centre lies in a chart and whose square meets the border of that chart.

    Parameters
    ----------
    segments : (B, 2, 2) float64
    chart : (F,) int32
        Of the triangles.
    first, last : int
        Segments.
    border_chart : (B,) int32
    owner, distance, mixed : (size, size)
        As in `mark`.
    """
    size = len(owner)
    for s in range(first, last):
        (ax, ay), (bx, by) = segments[s, 0], segments[s, 1]
        top, bottom = _span(min(ay, by), max(ay, by), 0.5, size)
        left, right = _span(min(ax, bx), max(ax, bx), 0.5, size)
        for row in range(top, bottom):
            for column in range(left, right):
                g = owner[row, column]
                if g < 0 or distance[row, column] > 0.0 or chart[g] != border_chart[s]:
                    continue
                if _meets(ax, ay, bx, by, bx, by, column + 0.5, row + 0.5, 0.5):
                    mixed[row, column] = True


@njit(**KERNEL)
def cover_samples(corners, chart, offsets, first, last, owner, slot, sample_owner, sample_distance):
    """Find the triangle of every sample of the mixed texels: the nearest of the chart of the texel itself.

    Parameters
    ----------
    corners : (F, 3, 2) float64
    chart : (F,) int32
    offsets : (S, 2) float64
        From a texel's centre.
    first, last : int
    owner : (size, size) int32
    slot : (size, size) int32
        Row of the next two, -1 for texels that are not mixed.
    sample_owner : (M, S) int32, in and out
    sample_distance : (M, S) float64, in and out
    """
    size = len(owner)
    for f in range(first, last):
        (ax, ay), (bx, by), (cx, cy) = corners[f, 0], corners[f, 1], corners[f, 2]
        top, bottom = _span(min(ay, by, cy), max(ay, by, cy), 1.0, size)
        left, right = _span(min(ax, bx, cx), max(ax, bx, cx), 1.0, size)
        for row in range(top, bottom):
            for column in range(left, right):
                k = slot[row, column]
                if k < 0 or chart[f] != chart[owner[row, column]]:
                    continue
                x, y = column + 0.5, row + 0.5
                if not _meets(ax, ay, bx, by, cx, cy, x, y, 1.0):
                    continue
                for s in range(len(offsets)):
                    d = _nearest(ax, ay, bx, by, cx, cy, x + offsets[s, 0], y + offsets[s, 1])[3]
                    if d < sample_distance[k, s]:
                        sample_owner[k, s], sample_distance[k, s] = f, d


@njit(**KERNEL)
def locate(corners, hard, faces, positions, inset, out):
    """Barycentric coordinates of the nearest point of a given triangle.

    Parameters
    ----------
    corners : (F, 3, 2) float64
    hard : (F, 3) bool
        Edges, by the corner that they start from, on which no point may lie: exactly on an edge at which the
        surface bends, the face beyond it would decide what the point sees.
    faces : (m,) int32
    positions : (m, 2) float64
    inset : float
        How far points on or right beside such an edge are moved towards the triangle's middle, in texels.
    out : (m, 3) float64, out
    """
    for i in range(len(faces)):
        t = corners[faces[i]]
        x, y = positions[i]
        a, b, c, _ = _nearest(t[0, 0], t[0, 1], t[1, 0], t[1, 1], t[2, 0], t[2, 1], x, y)
        edges = hard[faces[i]]
        if (c < 1e-3 and edges[0]) or (a < 1e-3 and edges[1]) or (b < 1e-3 and edges[2]):
            dx = a * t[0, 0] + b * t[1, 0] + c * t[2, 0] - (t[0, 0] + t[1, 0] + t[2, 0]) / 3.0
            dy = a * t[0, 1] + b * t[1, 1] + c * t[2, 1] - (t[0, 1] + t[1, 1] + t[2, 1]) / 3.0
            reach = np.sqrt(dx * dx + dy * dy)
            move = min(0.25, inset / reach) if reach > 0.0 else 0.0
            a, b, c = a + move * (1.0 / 3.0 - a), b + move * (1.0 / 3.0 - b), c + move * (1.0 / 3.0 - c)
        out[i, 0], out[i, 1], out[i, 2] = a, b, c
