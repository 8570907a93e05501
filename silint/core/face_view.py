"""Boxes of faces as a shade point sees them: which lines they reach, from which key to which, how far away.

Bounds in float32, rounded outwards: they say what may be skipped.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.face_bundles import BLOCK, CENTRE, HALF
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH
from silint.core.radial import ROUGHNESS, rough_azimuth

# What the box filter reads: p, n, T, M, A, slack, lines a radian.
B_POINT, B_NORMAL, B_T, B_M, B_AXIS, B_SLACK, B_PER_RADIAN, N_VIEW = 0, 3, 6, 9, 12, 15, 16, 17

# float32 keeps sums of a few products of numbers below 1 to well within this.
_SLACK = 2.0**-19
# Bounds of keys are off by this, relative to 1 + |key|.
_KEY_ERROR = 1e-5

# Where boxes are seen: squared distance, lowest and highest key.
N_SEEN = 3
_F = np.float32
_ZERO, _ONE, _HALF_LINE = _F(0.0), _F(1.0), _F(0.5)
_TINY = _F(1e-30)

_UW = np.uint64(WIDTH)
_U1, _U2 = np.uint64(WIDTH), np.uint64(2 * WIDTH)
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))


@njit(**INNER)
def set_view(p, n, frame, n_lines, view):
    """Write what `box_mask` reads."""
    for i in range(3):
        view[B_POINT + i], view[B_NORMAL + i] = p[i], n[i]
        view[B_T + i], view[B_M + i], view[B_AXIS + i] = frame[0, i], frame[1, i], frame[2, i]
    view[B_SLACK] = _SLACK * max(1.0, abs(p[0]), abs(p[1]), abs(p[2]))
    view[B_PER_RADIAN] = n_lines / (2.0 * np.pi)


@njit(**FILTER)
def box_mask(nodes, block, view, n_lines, seen, ranges):
    """Lanes of a block of boxes that reach a line above the horizon.

    Writes to `seen` (3 * 16,) squared distance, lowest and highest key, and to `ranges` (2 * 16,) int32 the
    first line and the number of lines.
    """
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = view[0], view[1], view[2]
    nx, ny, nz = view[3], view[4], view[5]
    tx, ty, tz = view[6], view[7], view[8]
    mx, my, mz = view[9], view[10], view[11]
    ax, ay, az = view[12], view[13], view[14]
    slack, per_radian = view[15], view[16]
    lines = np.int32(n_lines)
    none = np.int32(0)
    wrong = _F(ROUGHNESS) * per_radian + _F(1e-3)
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = nodes[j + _CX] - px, nodes[j + _CY] - py, nodes[j + _CZ] - pz
        hx, hy, hz = nodes[j + _HX] + slack, nodes[j + _HY] + slack, nodes[j + _HZ] + slack
        drop = nx * x + ny * y + nz * z + abs(nx) * hx + abs(ny) * hy + abs(nz) * hz < _ZERO
        drop = drop | (hx < _ZERO)

        # The box along its own azimuth, across it, and along the axis.
        t, m, a = tx * x + ty * y + tz * z, mx * x + my * y + mz * z, ax * x + ay * y + az * z
        rho = np.sqrt(t * t + m * m)
        ct, cm = t / (rho + _TINY), m / (rho + _TINY)
        along = abs(ct * tx + cm * mx) * hx + abs(ct * ty + cm * my) * hy + abs(ct * tz + cm * mz) * hz
        across = abs(ct * mx - cm * tx) * hx + abs(ct * my - cm * ty) * hy + abs(ct * mz - cm * tz) * hz
        over = abs(ax) * hx + abs(ay) * hy + abs(az) * hz
        radius = np.sqrt(hx * hx + hy * hy + hz * hz)

        # Keys of a rectangle about it in the half-plane of a line.
        near = rho - along
        inside = near < _TINY
        near = _TINY if inside else near
        far = rho + along
        far = np.sqrt(far * far + across * across)
        far = rho + radius if rho + radius < far else far
        top, bottom = a + over, a - over
        high = top / (near if top > _ZERO else far)
        low = bottom / (far if bottom > _ZERO else near)

        # Keys of a ball about it.
        distance = rho * rho + a * a
        square = distance - radius * radius
        away = np.sqrt(square if square > _ZERO else _ZERO)
        side = rho * away - a * radius
        ball = (a * away + rho * radius) / (side if side > _TINY else _ONE)
        high = ball if (square > _ZERO) & (side > _F(1e-6)) & (ball < high) else high
        side = rho * away + a * radius
        ball = (a * away - rho * radius) / (side if side > _TINY else _ONE)
        low = ball if (square > _ZERO) & (side > _F(1e-6)) & (ball > low) else low

        # Azimuths.
        spread = rough_azimuth(near, across)
        square = rho * rho - radius * radius
        tangent = np.sqrt(square if square > _ZERO else _ZERO)
        ball = rough_azimuth(tangent, radius)
        spread = ball if (square > _ZERO) & (ball < spread) else spread
        spread = spread * per_radian + wrong
        middle = rough_azimuth(t, m) * per_radian + _HALF_LINE
        first = np.floor(middle - spread)
        count = np.int32(np.floor(middle + spread) - first)
        first = np.int32(first)
        first = first + lines if first < none else first
        first = first - lines if first >= lines else first
        whole = inside | (count > lines)
        ranges[i] = none if whole else first
        ranges[i + _UW] = lines if whole else count

        # Where the box comes nearest.
        x, y, z = abs(x) - hx, abs(y) - hy, abs(z) - hz
        x, y, z = x if x > _ZERO else _ZERO, y if y > _ZERO else _ZERO, z if z > _ZERO else _ZERO
        seen[i] = x * x + y * y + z * z
        seen[i + _U1] = low - _F(_KEY_ERROR) * (_ONE + abs(low))
        seen[i + _U2] = high + _F(_KEY_ERROR) * (_ONE + abs(high))
        # A box centred on the axis has no azimuth, and none of its own width.
        drop = drop | ((count <= none) & (not inside))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)
