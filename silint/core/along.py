"""Faces that a half-line from the shade point may meet: what start counts are counted from.

Two filters in float32, 16 lanes at a time (see `lanes`): boxes of the tree, then faces of a bundle. They
drop what certainly stays clear of the half-line; the rest is decided by whoever asks.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.face_bundles import BLOCK, CENTRE, CORNER_BLOCK, FULL_SCALE, HALF
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH, lowest

# What the filters read: the point, the frame's rows T, M, A, and the slack of float32.
A_POINT, A_FRAME, A_SLACK, N_AXIS = 0, 3, 12, 13

_SLACK = 2.0**-20
# An int16 corner is off by half a step in each coordinate.
_STEP = 1.04 / FULL_SCALE

_UW = np.uint64(WIDTH)
_F = np.float32
_ZERO = _F(0.0)
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))
_U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8 = (np.uint64(i * WIDTH) for i in range(1, 9))


@njit(**INNER)
def set_axis(p, across, over, along, axis):
    """What the filters need to know of a shade point.

    Parameters
    ----------
    across, over, along : tuple of 3 float
        An orthonormal frame whose last vector is the direction of the half-line.
    """
    size = 1.0
    for i in range(3):
        axis[A_POINT + i] = p[i]
        size = max(size, abs(p[i]))
        axis[A_FRAME + i], axis[A_FRAME + 3 + i], axis[A_FRAME + 6 + i] = across[i], over[i], along[i]
    axis[A_SLACK] = _SLACK * size


@njit(**FILTER)
def axis_mask(nodes, block, axis):
    """Lanes of a block of boxes that the half-line from the point along its axis may meet."""
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = axis[0], axis[1], axis[2]
    tx, ty, tz = axis[3], axis[4], axis[5]
    mx, my, mz = axis[6], axis[7], axis[8]
    ax, ay, az = axis[9], axis[10], axis[11]
    slack = axis[12]
    atx, aty, atz, amx, amy, amz = abs(tx), abs(ty), abs(tz), abs(mx), abs(my), abs(mz)
    aax, aay, aaz = abs(ax), abs(ay), abs(az)
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = nodes[j + _CX] - px, nodes[j + _CY] - py, nodes[j + _CZ] - pz
        hx, hy, hz = nodes[j + _HX], nodes[j + _HY], nodes[j + _HZ]
        across = abs(tx * x + ty * y + tz * z) - (atx * hx + aty * hy + atz * hz)
        over = abs(mx * x + my * y + mz * z) - (amx * hx + amy * hy + amz * hz)
        along = ax * x + ay * y + az * z + (aax * hx + aay * hy + aaz * hz)
        drop = (across > slack) | (over > slack) | (along < -slack) | (hx < _ZERO)
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def corner_mask(corners, bundle, x, y, z, widest, axis):
    """Faces of a bundle, with its centre at (x, y, z) from the point, that the half-line may meet."""
    base = np.uint64(bundle) * np.uint64(CORNER_BLOCK)
    tx, ty, tz = axis[3], axis[4], axis[5]
    mx, my, mz = axis[6], axis[7], axis[8]
    t0, m0 = tx * x + ty * y + tz * z, mx * x + my * y + mz * z
    off = _F(_STEP) * widest + axis[12]
    scale = widest * _F(1.0 / FULL_SCALE)
    tx, ty, tz, mx, my, mz = tx * scale, ty * scale, tz * scale, mx * scale, my * scale, mz * scale
    t_high, t_low, m_high, m_low = off - t0, -off - t0, off - m0, -off - m0
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        ax, ay, az = _F(corners[j]), _F(corners[j + _U1]), _F(corners[j + _U2])
        t, m = tx * ax + ty * ay + tz * az, mx * ax + my * ay + mz * az
        ax, ay, az = _F(corners[j + _U3]), _F(corners[j + _U4]), _F(corners[j + _U5])
        u, n = tx * ax + ty * ay + tz * az, mx * ax + my * ay + mz * az
        ax, ay, az = _F(corners[j + _U6]), _F(corners[j + _U7]), _F(corners[j + _U8])
        v, o = tx * ax + ty * ay + tz * az, mx * ax + my * ay + mz * az
        drop = ((t > t_high) & (u > t_high) & (v > t_high)) | ((t < t_low) & (u < t_low) & (v < t_low))
        drop |= ((m > m_high) & (n > m_high) & (o > m_high)) | ((m < m_low) & (n < m_low) & (o < m_low))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**INNER)
def faces_along(order, coarse, nodes, levels, axis, stack, face_ids):
    """Faces that the half-line from a shade point may meet.

    Parameters
    ----------
    order, coarse, nodes, levels
        A FaceBundles'.
    axis : (N_AXIS,) float32
        See `set_axis`.
    stack : (depth, 2) int64
        Scratch.
    face_ids : (capacity,) int32, out

    Returns
    -------
    Their number; there has to be room for more where it exceeds the capacity.
    """
    n_faces = len(order)
    count = 0
    top = 1 if n_faces > 0 else 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        mask = axis_mask(nodes, levels[level] + block, axis)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            child = block * WIDTH + lane
            if level > 0:
                if levels[level - 1] + child < levels[level]:
                    stack[top, 0], stack[top, 1] = level - 1, child
                    top += 1
                continue
            base = (levels[0] + block) * BLOCK + lane
            hits = corner_mask(
                coarse,
                child,
                nodes[base] - axis[0],
                nodes[base + WIDTH] - axis[1],
                nodes[base + 2 * WIDTH] - axis[2],
                max(nodes[base + 3 * WIDTH], nodes[base + 4 * WIDTH], nodes[base + 5 * WIDTH]),
                axis,
            )
            while hits != 0:
                i = child * WIDTH + lowest(hits)
                hits &= hits - 1
                if i < n_faces:
                    if count < len(face_ids):
                        face_ids[count] = order[i]
                    count += 1
    return count
