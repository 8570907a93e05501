"""Where the sphere about a shade point within which faces count cuts them: crossings of radial lines.

The faces within the sphere are a surface that ends at it. On a line, a face covers what lies between two of
its edges. An end within the line's reach is a crossing of that edge, which `crossings` records once for all
of its faces; where it lies beyond, the face begins or ends on the sphere instead, on its own. Which of the
two is decided from the edge alone: so the depth count closes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.caps import cap_on_line, crossing, is_near, meets_axis_near, plane_towards
from silint.core.contour import SPHERE
from silint.core.jit import INNER
from silint.core.radial import edge_circle, in_frame, local_vertex, sector, span
from silint.core.zenith import covers_zenith


@njit(**INNER)
def cross_sphere(
    geometry,
    face_ids,
    n_faces,
    p,
    n,
    frame,
    lines,
    horizon,
    reach,
    rounding,
    scratch,
    count,
    key,
    gain,
    capacity,
    tally,
):
    """Record where faces begin and end on the spheres of lines.

    Parameters
    ----------
    face_ids : (n_faces or more,) int32
        Those of `sphere_search.find_faces`: all that may. More of them change nothing.
    scratch : tuple
        See `new_scratch`.
    count, key, gain, capacity
        As for `crossings.cross_edges`.

    Returns
    -------
    False where a line has no room left.
    """
    for i in range(n_faces):
        if not _cross_face(
            geometry.vertices,
            geometry.faces,
            geometry.face_planes,
            geometry.planes,
            geometry.plane_errors,
            face_ids[i],
            p,
            n,
            frame,
            lines,
            horizon,
            reach,
            rounding,
            scratch,
            count,
            key,
            gain,
            capacity,
        ):
            return False
    tally[SPHERE] += n_faces
    return True


@njit(**INNER)
def _cross_face(
    vertices,
    faces,
    face_planes,
    planes,
    plane_errors,
    f,
    p,
    n,
    frame,
    lines,
    horizon,
    reach,
    rounding,
    scratch,
    count,
    key,
    gain,
    capacity,
):
    """The same for a face."""
    n_lines = len(lines)
    corners, sectors, found, firsts = scratch
    for i in range(3):
        t, m, a, height = local_vertex(vertices, faces[f, i], p, n, frame)
        corners[i, 0], corners[i, 1], corners[i, 2], corners[i, 3] = t, m, a, height
        sectors[i] = sector(t, m, n_lines)
    if sectors[0] == sectors[1] and sectors[0] == sectors[2]:
        return True
    height, toward = plane_towards(face_planes, planes, f, p, frame)
    if height > reach.max():
        return True
    winding = 0
    for i in range(3):
        j = i + 1 if i < 2 else 0
        ahead = faces[f, i] < faces[f, j]
        lower, upper = (i, j) if ahead else (j, i)
        u, v = faces[f, lower], faces[f, upper]
        at, am, aa = corners[lower, 0], corners[lower, 1], corners[lower, 2]
        et, em, ea = in_frame(
            vertices[v, 0] - vertices[u, 0],
            vertices[v, 1] - vertices[u, 1],
            vertices[v, 2] - vertices[u, 2],
            frame,
        )
        along, across, turn = edge_circle(at, am, aa, et, em, ea)
        first, steps, left = span(sectors[lower], sectors[upper], turn, n_lines)
        winding += steps if left == ahead else -steps
        above = corners[lower, 3] > 0.0 or corners[upper, 3] > 0.0
        for line in range(first, first + steps):
            k = line if line < n_lines else line - n_lines
            y = along * lines[k, 0] + across * lines[k, 1]
            y = y if above and y > -np.inf else -np.inf
            t, m, z = crossing((at, am, aa), (et, em, ea), lines[k, 0], lines[k, 1])
            near, t = is_near(t, m, z, reach[k]), t * lines[k, 0] + m * lines[k, 1]
            if found[k] == 0:
                found[k] = 1
                firsts[k, 0], firsts[k, 1], firsts[k, 2], firsts[k, 3] = y, t, z, near
                continue
            found[k] = 0
            one, other = (y, t, z, near), (firsts[k, 0], firsts[k, 1], firsts[k, 2], firsts[k, 3] != 0.0)
            high, low = (one, other) if y > firsts[k, 0] else (other, one)
            if not _cross_segment(
                high, low, height, toward, lines, horizon, reach, k, count, key, gain, capacity
            ):
                found[:] = 0
                return False
    if winding != 0:
        up = covers_zenith(
            vertices, faces, face_planes, planes, plane_errors, f, p, n, frame, n_lines, rounding
        )
        for k in range(n_lines):
            if found[k] == 0:
                continue
            found[k] = 0
            high = firsts[k, 0], firsts[k, 1], firsts[k, 2], firsts[k, 3] != 0.0
            # The other end lies where the plane meets the axis, at the nadir or at the zenith.
            low = -np.inf, 0.0, height / toward[2], False
            if up:
                at_zenith = meets_axis_near(height, toward[2], reach[k])
                high, low = (np.inf, 0.0, height / toward[2], at_zenith), high
            if not _cross_segment(
                high, low, height, toward, lines, horizon, reach, k, count, key, gain, capacity
            ):
                found[:] = 0
                return False
    return True


@njit(**INNER)
def _comes_near(t, a, u, b, reach):
    """Whether the segment from (t, a) to (u, b), in the half-plane of a line, comes near the shade point."""
    x, y = u - t, b - a
    s = -(t * x + a * y) / (x * x + y * y)
    s = s if s > 0.0 else 0.0
    s = s if s < 1.0 else 1.0
    return is_near(t + s * x, 0.0, a + s * y, reach)


@njit(**INNER)
def _cross_segment(high, low, height, toward, lines, horizon, reach, k, count, key, gain, capacity):
    """Where what a face covers of line k, between two ends, begins and ends on the sphere.

    An end is its key, where it lies in the half-plane, and whether that is near.
    """
    high, high_t, high_a, high_near = high
    low, low_t, low_a, low_near = low
    if high_near and low_near:
        return True
    # Where no part of a face is near, by points of its edges, it has no say: nothing depends on which of such
    # faces are looked at.
    if not high_near and not low_near and not _comes_near(high_t, high_a, low_t, low_a, reach[k]):
        return True
    t = toward[0] * lines[k, 0] + toward[1] * lines[k, 1]
    start, end = cap_on_line(toward[2], t, height / reach[k])
    if not high_near and not low_near and min(high, start) <= max(low, end):
        return True
    c = count[k]
    if c + 2 > capacity:
        return False
    if not high_near:
        start = min(max(start, low), high)
        if start > horizon[k]:
            key[k * capacity + c], gain[k * capacity + c] = start, 1
            c += 1
    if not low_near:
        end = min(max(end, low), high)
        if end > horizon[k]:
            key[k * capacity + c], gain[k * capacity + c] = end, -1
            c += 1
    count[k] = c
    return True


@njit(**INNER)
def new_scratch(n_lines):
    """What `cross_sphere` writes to."""
    return np.empty((3, 4)), np.empty(3, np.int32), np.zeros(n_lines, np.int8), np.empty((n_lines, 4))
