"""Start counts of radial isolines: the surfaces that the axis of a shade point meets.

A face covers the zenith or the nadir when its edges' signed spans wind once round the axis. On every line its
crossings then add up to -1 or +1, with the very sides and sectors that the sweep counts with: -1 is a
surface that lies at the zenith and ends along the line. No intersection is computed, and counts and crossings
cannot disagree.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.contour import face_side
from silint.core.face_bundles import BLOCK, CENTRE, HALF
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH, lowest
from silint.core.radial import edge_circle, in_frame, local_vertex, sector, set_frame, span

# An axis tile: centre and half width of the points; two directions across the mean axis, and that axis; the
# spread of the axes about it; the slack of float32.
A_POINT, A_HALF, A_ACROSS, A_OVER, A_AXIS, A_SPREAD, A_SLACK, N_AXIS = 0, 3, 6, 9, 12, 15, 16, 17

_SLACK = 2.0**-20

_UW = np.uint64(WIDTH)
_ZERO = np.float32(0.0)
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))


@njit(**INNER)
def set_axis_tile(points, normals, first, last, frame, axes):
    """Bounds of the half-lines from the points [first, last) along their axes."""
    size = 1.0
    for i in range(3):
        low, high = np.inf, -np.inf
        for j in range(first, last):
            low, high = min(low, points[j, i]), max(high, points[j, i])
        size = max(size, abs(low), abs(high))
        axes[A_POINT + i], axes[A_HALF + i] = 0.5 * (low + high), 0.5 * (high - low)
    # The frame of the mean normal; the first point's where they cancel.
    x, y, z = 0.0, 0.0, 0.0
    for j in range(first, last):
        x, y, z = x + normals[j, 0], y + normals[j, 1], z + normals[j, 2]
    length = np.sqrt(x * x + y * y + z * z)
    if length < 0.1:
        x, y, z, length = normals[first, 0], normals[first, 1], normals[first, 2], 1.0
    set_frame((x / length, y / length, z / length), frame)
    for row in range(3):
        for i in range(3):
            axes[A_ACROSS + 3 * row + i] = frame[row, i]
    ax, ay, az = frame[2, 0], frame[2, 1], frame[2, 2]
    spread = 0.0
    for j in range(first, last):
        set_frame((normals[j, 0], normals[j, 1], normals[j, 2]), frame)
        spread = max(spread, (frame[2, 0] - ax) ** 2 + (frame[2, 1] - ay) ** 2 + (frame[2, 2] - az) ** 2)
    axes[A_SPREAD] = np.sqrt(spread) * 1.0001 + 1e-6
    axes[A_SLACK] = 4.0 * _SLACK * size


@njit(**INNER)
def set_axis(p, frame, axes):
    """The same for a single point."""
    size = 1.0
    for i in range(3):
        axes[A_POINT + i], axes[A_HALF + i] = p[i], 0.0
        size = max(size, abs(p[i]))
        for row in range(3):
            axes[A_ACROSS + 3 * row + i] = frame[row, i]
    axes[A_SPREAD] = 1e-6
    axes[A_SLACK] = _SLACK * size


@njit(**FILTER)
def axis_mask(nodes, block, axes):
    """Lanes of a block of boxes that one of the half-lines may meet."""
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = axes[0], axes[1], axes[2]
    sx, sy, sz = axes[3], axes[4], axes[5]
    tx, ty, tz = axes[6], axes[7], axes[8]
    mx, my, mz = axes[9], axes[10], axes[11]
    ax, ay, az = axes[12], axes[13], axes[14]
    spread, slack = axes[15], axes[16]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = nodes[j + _CX] - px, nodes[j + _CY] - py, nodes[j + _CZ] - pz
        hx, hy, hz = nodes[j + _HX] + sx, nodes[j + _HY] + sy, nodes[j + _HZ] + sz
        reach = slack + spread * (abs(x) + abs(y) + abs(z) + hx + hy + hz)
        across = abs(tx * x + ty * y + tz * z) - (abs(tx) * hx + abs(ty) * hy + abs(tz) * hz)
        over = abs(mx * x + my * y + mz * z) - (abs(mx) * hx + abs(my) * hy + abs(mz) * hz)
        along = ax * x + ay * y + az * z + abs(ax) * hx + abs(ay) * hy + abs(az) * hz
        drop = (across > reach) | (over > reach) | (along < -reach) | (hx < _ZERO)
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**INNER)
def gather_faces(nodes, levels, n_bundles, axes, stack, near, near_bundle):
    """Bundles that the half-lines may meet, field by field in blocks of 16, as search.gather_bundles."""
    count = 0
    top = 1 if n_bundles > 0 else 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        mask = axis_mask(nodes, levels[level] + block, axes)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            child = block * WIDTH + lane
            if level > 0:
                if levels[level - 1] + child < levels[level]:
                    stack[top, 0], stack[top, 1] = level - 1, child
                    top += 1
            elif child < n_bundles:
                if count < len(near_bundle):
                    near_bundle[count] = child
                    source = (levels[0] + block) * BLOCK + lane
                    target = (count // WIDTH) * BLOCK + count % WIDTH
                    for field in range(0, BLOCK, WIDTH):
                        near[target + field] = nodes[source + field]
                count += 1
    return count


@njit(**INNER)
def zenith_count(geometry, tree, near, near_bundle, n_near, axes, p, n, frame, n_lines, rounding):
    """W at the zenith of a shade point."""
    n_faces = len(tree.order)
    count = 0
    for block in range((n_near + WIDTH - 1) // WIDTH):
        mask = axis_mask(near, block, axes)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            if block * WIDTH + lane >= n_near:
                break
            bundle = near_bundle[block * WIDTH + lane]
            for i in range(bundle * WIDTH, min((bundle + 1) * WIDTH, n_faces)):
                count += _covers_zenith(geometry, tree.order[i], p, n, frame, n_lines, rounding)
    return count


@njit(**INNER)
def _covers_zenith(geometry, f, p, n, frame, n_lines, rounding):
    """1 where a face winds round the axis and leaves the depth count as lines run down, else 0."""
    a, b, c = geometry.faces[f, 0], geometry.faces[f, 1], geometry.faces[f, 2]
    at, am, _, _ = local_vertex(geometry.vertices, a, p, n, frame)
    bt, bm, _, _ = local_vertex(geometry.vertices, b, p, n, frame)
    ct, cm, _, _ = local_vertex(geometry.vertices, c, p, n, frame)
    # Clearly beside the axis.
    if (
        min(at, bt, ct) > rounding
        or max(at, bt, ct) < -rounding
        or min(am, bm, cm) > rounding
        or max(am, bm, cm) < -rounding
    ):
        return 0
    winding = 0
    for i in range(3):
        u, v = geometry.faces[f, i], geometry.faces[f, (i + 1) % 3]
        steps = _signed_span(geometry.vertices, min(u, v), max(u, v), p, n, frame, n_lines)
        winding += steps if u < v else -steps
    if winding == 0:
        return 0
    front = face_side(geometry, f, p, n, rounding) > 0
    return 1 if (winding < 0) == front else 0


@njit(**INNER)
def _signed_span(vertices, a, b, p, n, frame, n_lines):
    at, am, aa, _ = local_vertex(vertices, a, p, n, frame)
    bt, bm, _, _ = local_vertex(vertices, b, p, n, frame)
    et, em, ea = in_frame(
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
        frame,
    )
    _, _, turn = edge_circle(at, am, aa, et, em, ea)
    _, steps, left = span(sector(at, am, n_lines), sector(bt, bm, n_lines), turn, n_lines)
    return steps if left else -steps
