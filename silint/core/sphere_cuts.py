"""Where the sphere about a shade point within which faces count cuts them: crossings of radial lines.

The faces within the sphere are a surface that ends at it. On a line, a face covers what lies between two of
its edges. An end within the line's reach is a crossing of that edge, which `crossings` records once for all
of its faces; where it lies beyond, the face begins or ends on the sphere instead, on its own. Which of the
two is decided from the edge alone: so the depth count closes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.caps import cap_on_line, crosses_near, meets_axis_near, plane_towards
from silint.core.contour import SPHERE
from silint.core.cuts import N_KEYS, N_SPANS, farthest_corners, project_faces
from silint.core.face_bundles import BLOCK, CENTRE, HALF
from silint.core.face_view import box_mask
from silint.core.jit import INNER
from silint.core.lanes import WIDTH, lowest
from silint.core.radial import edge_circle, in_frame, local_vertex, sector, span
from silint.core.zenith import covers_zenith


@njit(**INNER)
def _straddles(nodes, base, p, near, reach, least, most, first, count):
    """Whether a box has both less and more than the reach of one of `count` lines, from its squared near.

    `least` and `most` are the squares of the shortest and the longest reach.
    """
    far = 0.0
    for axis in range(3):
        x = abs(np.float64(nodes[base + (CENTRE + axis) * WIDTH]) - p[axis])
        x += np.float64(nodes[base + (HALF + axis) * WIDTH])
        far += x * x
    # Bounds of float32, with a margin of their rounding.
    near, far = near * (1.0 - 1e-5), far * (1.0 + 1e-5)
    if near >= most or far <= least:
        return False
    if least == most:
        return True
    n_lines = len(reach)
    for i in range(first, first + count):
        r = reach[i if i < n_lines else i - n_lines]
        if near < r * r and far > r * r:
            return True
    return False


@njit(**INNER)
def _reaches_out(farthest, reach, first, count):
    """Whether a face, by the squared distance of its farthest corner, passes the reach of its lines."""
    farthest *= 1.0 + 1e-9
    n_lines = len(reach)
    for i in range(first, first + count):
        r = reach[i if i < n_lines else i - n_lines]
        if farthest > r * r:
            return True
    return False


@njit(**INNER)
def cross_sphere(
    geometry,
    bundles,
    p,
    n,
    frame,
    lines,
    horizon,
    reach,
    rounding,
    view,
    stack,
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
    bundles : FaceBundles
        With corners.
    view : (N_VIEW,) float32
        See `face_view.set_view`.
    stack : (depth * 16, 2) int32
    scratch : tuple
        For `face_view.box_mask` and for a face; see `new_scratch`.
    count, key, gain, capacity
        As for `crossings.cross_edges`.

    Returns
    -------
    False where a line has no room left.
    """
    n_lines = len(lines)
    seen, ranges, keys, spans, farthest, found, first_key, first_near = scratch
    least, most = reach.min(), reach.max()
    least, most = least * least, most * most
    top = 1 if len(bundles.order) > 0 else 0
    stack[0, 0], stack[0, 1] = len(bundles.levels) - 2, 0
    work = 0
    while top > 0:
        top -= 1
        level, number = stack[top, 0], stack[top, 1]
        work += 1
        if level < 0:
            mask = project_faces(bundles.corners, number, p, n, frame, n_lines, keys, spans)
            if mask != 0:
                farthest_corners(bundles.corners, number, p[0], p[1], p[2], farthest)
            while mask != 0:
                lane = lowest(mask)
                i = number * WIDTH + lane
                mask &= mask - 1
                if not _reaches_out(farthest[lane], reach, spans[lane], spans[WIDTH + lane]):
                    continue
                cut = _cross_face(
                    geometry.vertices,
                    geometry.faces,
                    geometry.face_planes,
                    geometry.planes,
                    geometry.plane_errors,
                    bundles.order[i],
                    p,
                    n,
                    frame,
                    lines,
                    horizon,
                    reach,
                    rounding,
                    found,
                    first_key,
                    first_near,
                    count,
                    key,
                    gain,
                    capacity,
                )
                if cut < 0:
                    return False
                work += cut
            continue
        block = bundles.levels[level] + number
        mask = box_mask(bundles.nodes, block, view, n_lines, seen, ranges)
        while mask != 0:
            i = lowest(mask)
            mask &= mask - 1
            base = block * BLOCK + i
            near = np.float64(seen[i])
            if _straddles(bundles.nodes, base, p, near, reach, least, most, ranges[i], ranges[WIDTH + i]):
                stack[top, 0], stack[top, 1] = level - 1, number * WIDTH + i
                top += 1
    tally[SPHERE] += work
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
    found,
    first_key,
    first_near,
    count,
    key,
    gain,
    capacity,
):
    """The same for a face: -1 where a line has no room left, else 1 if it comes near."""
    n_lines = len(lines)
    height, toward = plane_towards(face_planes, planes, f, p, frame)
    if height > reach.max():
        return 0
    winding = 0
    for i in range(3):
        u, v = faces[f, i], faces[f, (i + 1) % 3]
        ahead = u < v
        u, v = min(u, v), max(u, v)
        at, am, aa, a_height = local_vertex(vertices, u, p, n, frame)
        bt, bm, _, b_height = local_vertex(vertices, v, p, n, frame)
        et, em, ea = in_frame(
            vertices[v, 0] - vertices[u, 0],
            vertices[v, 1] - vertices[u, 1],
            vertices[v, 2] - vertices[u, 2],
            frame,
        )
        along, across, turn = edge_circle(at, am, aa, et, em, ea)
        first, steps, left = span(sector(at, am, n_lines), sector(bt, bm, n_lines), turn, n_lines)
        winding += steps if left == ahead else -steps
        above = a_height > 0.0 or b_height > 0.0
        for j in range(first, first + steps):
            k = j if j < n_lines else j - n_lines
            y = along * lines[k, 0] + across * lines[k, 1]
            y = y if above and y > -np.inf else -np.inf
            near = crosses_near((at, am, aa), (et, em, ea), lines[k, 0], lines[k, 1], reach[k])
            if found[k] == 0:
                found[k], first_key[k], first_near[k] = 1, y, near
                continue
            found[k] = 0
            if near and first_near[k]:
                continue
            if y > first_key[k]:
                high, high_near, low, low_near = y, near, first_key[k], first_near[k]
            else:
                high, high_near, low, low_near = first_key[k], first_near[k], y, near
            ends = high, high_near, low, low_near
            if not _cross_segment(ends, height, toward, lines, horizon, reach, k, count, key, gain, capacity):
                found[:] = 0
                return -1
    if winding != 0:
        up = covers_zenith(
            vertices, faces, face_planes, planes, plane_errors, f, p, n, frame, n_lines, rounding
        )
        for k in range(n_lines):
            if found[k] == 0:
                continue
            found[k] = 0
            high, high_near, low, low_near = first_key[k], first_near[k], -np.inf, False
            if up:
                high, low, low_near = np.inf, first_key[k], first_near[k]
                high_near = meets_axis_near(height, toward[2], reach[k])
            if high_near and low_near:
                continue
            ends = high, high_near, low, low_near
            if not _cross_segment(ends, height, toward, lines, horizon, reach, k, count, key, gain, capacity):
                found[:] = 0
                return -1
    return 1


@njit(**INNER)
def _cross_segment(ends, height, toward, lines, horizon, reach, k, count, key, gain, capacity):
    """Where what a face covers of line k, from `high` down to `low`, begins and ends on the sphere."""
    high, high_near, low, low_near = ends
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
def new_scratch(n_seen, n_lines):
    """What `cross_sphere` writes to."""
    return (
        np.empty(n_seen * WIDTH, np.float32),
        np.empty(2 * WIDTH, np.int32),
        np.empty(N_KEYS * WIDTH),
        np.empty(N_SPANS * WIDTH, np.int32),
        np.empty(WIDTH),
        np.zeros(n_lines, np.int8),
        np.empty(n_lines),
        np.empty(n_lines, np.bool_),
    )
