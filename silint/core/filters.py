"""The filters of the search for edges: loops over sixteen lanes in float32 (see `lanes`).

A filter says what may be dropped: no contour, below the horizon, or between two neighbouring lines.
Comparisons with NaN or infinity never drop. Errors of rounding and of 16 bit edges are part of every bound.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.bundles import (
    BLOCK,
    CENTRE,
    EDGE_BLOCK,
    FULL_SCALE,
    HALF,
    N_EDGE_FIELDS,
    NORMAL,
    NORMAL_HALF,
    OFFSET,
    OFFSET_HALF,
    PLANE_A,
    PLANE_B,
    VERTEX_A,
    VERTEX_B,
)
from silint.core.jit import FILTER
from silint.core.lanes import WIDTH
from silint.core.radial import ROUGHNESS, rough_azimuth

# A packet: centre and radius about its vertices, relative to the tile's centre, and what these may be off by.
PACKET_CENTRE, PACKET_RADIUS, PACKET_ERROR, N_PACKET = 0, 3, 4, 5
PACKET_BLOCK = N_PACKET * WIDTH
# A candidate: the fields of an edge relative to the tile's centre, and what its signed distances may be off
# by.
WRONG, N_CANDIDATE = N_EDGE_FIELDS, N_EDGE_FIELDS + 1
CANDIDATE_BLOCK = N_CANDIDATE * WIDTH

# An int16 edge is off by half a step in each coordinate, of position and of normal.
_STEP = 0.52 / FULL_SCALE
# Error of an octahedral u.
_U_ERROR = 4e-6

_UW, _U2, _U3 = np.uint64(WIDTH), np.uint64(2 * WIDTH), np.uint64(3 * WIDTH)
_F = np.float32
_ZERO, _HALF, _ONE, _TINY, _MANY = _F(0.0), _F(0.5), _F(1.0), _F(1e-30), _F(1e6)
_ASIN = _F(0.5 * np.pi - 1.0)

# Offsets of a node's fields within its block, unsigned.
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))
_NX, _NY, _NZ = (np.uint64((NORMAL + i) * WIDTH) for i in range(3))
_MX, _MY, _MZ = (np.uint64((NORMAL_HALF + i) * WIDTH) for i in range(3))
_O, _OH = (np.uint64(i * WIDTH) for i in (OFFSET, OFFSET_HALF))
# And of an edge's.
_AX, _AY, _AZ, _AO = (np.uint64((PLANE_A + i) * WIDTH) for i in range(4))
_BX, _BY, _BZ, _BO = (np.uint64((PLANE_B + i) * WIDTH) for i in range(4))
_VX, _VY, _VZ = (np.uint64((VERTEX_A + i) * WIDTH) for i in range(3))
_WX, _WY, _WZ = (np.uint64((VERTEX_B + i) * WIDTH) for i in range(3))
_WRONG = np.uint64(WRONG * WIDTH)


@njit(**FILTER)
def tile_mask(nodes, block, tile):
    """Lanes of a block of nodes that may hold a contour edge above the horizon of a point of the tile."""
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = tile[0], tile[1], tile[2]
    sx, sy, sz = tile[3], tile[4], tile[5]
    nx, ny, nz = tile[6], tile[7], tile[8]
    ux, uy, uz = tile[9], tile[10], tile[11]
    slack = tile[12]
    anx, any_, anz = abs(nx) + ux, abs(ny) + uy, abs(nz) + uz
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = nodes[j + _CX] - px, nodes[j + _CY] - py, nodes[j + _CZ] - pz
        ax, ay, az = abs(x), abs(y), abs(z)
        top = nx * x + ny * y + nz * z + ux * ax + uy * ay + uz * az
        top += anx * (nodes[j + _HX] + sx) + any_ * (nodes[j + _HY] + sy) + anz * (nodes[j + _HZ] + sz)
        fx, fy, fz = nodes[j + _NX], nodes[j + _NY], nodes[j + _NZ]
        middle = abs(nodes[j + _O] - (fx * x + fy * y + fz * z))
        width = nodes[j + _OH] + abs(fx) * sx + abs(fy) * sy + abs(fz) * sz
        width += nodes[j + _MX] * (ax + sx) + nodes[j + _MY] * (ay + sy) + nodes[j + _MZ] * (az + sz)
        drop = (top < -slack) | (middle > width + slack)
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def near_mask(nodes, block, tile):
    """Lanes of a block of nodes whose boxes come within reach of a point of the tile."""
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = tile[0], tile[1], tile[2]
    sx, sy, sz = tile[3] + tile[12], tile[4] + tile[12], tile[5] + tile[12]
    square = tile[13]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x = abs(nodes[j + _CX] - px) - (nodes[j + _HX] + sx)
        y = abs(nodes[j + _CY] - py) - (nodes[j + _HY] + sy)
        z = abs(nodes[j + _CZ] - pz) - (nodes[j + _HZ] + sz)
        x, y, z = x if x > _ZERO else _ZERO, y if y > _ZERO else _ZERO, z if z > _ZERO else _ZERO
        mask |= np.uint32(not (x * x + y * y + z * z > square)) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def near_edge_mask(edges, first, x, y, z, sx, sy, sz, square):
    """Of 16 candidates from `first` on, those whose boxes come nearer than the root of `square` to a box.

    The box has the centre (x, y, z) and half widths that hold what vertices are off by.
    """
    base = np.uint64(first)
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        ax, ay, az = edges[j + _VX] - x, edges[j + _VY] - y, edges[j + _VZ] - z
        bx, by, bz = edges[j + _WX] - x, edges[j + _WY] - y, edges[j + _WZ] - z
        # How far all of the edge lies to either side, the larger of both.
        low, high = ax if ax < bx else bx, -ax if -ax < -bx else -bx
        x0 = (low if low > high else high) - sx
        low, high = ay if ay < by else by, -ay if -ay < -by else -by
        y0 = (low if low > high else high) - sy
        low, high = az if az < bz else bz, -az if -az < -bz else -bz
        z0 = (low if low > high else high) - sz
        x0, y0, z0 = x0 if x0 > _ZERO else _ZERO, y0 if y0 > _ZERO else _ZERO, z0 if z0 > _ZERO else _ZERO
        mask |= np.uint32(not (x0 * x0 + y0 * y0 + z0 * z0 > square)) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def near_packet_mask(packets, block, q):
    """Lanes of a block of packets that come within reach of a shade point."""
    base = np.uint64(block) * np.uint64(PACKET_BLOCK)
    px, py, pz, slack, reach = q[0], q[1], q[2], q[12], q[14]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = packets[j] - px, packets[j + _UW] - py, packets[j + _U2] - pz
        most = packets[j + _U3] + slack + reach
        mask |= np.uint32(not (x * x + y * y + z * z > most * most)) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def tile_edge_mask(edges, bundle, x, y, z, radius, tile, decoded):
    """Edges of a bundle, with its centre at (x, y, z) from that of the tile, that some point may need.

    Writes all sixteen to `decoded` (CANDIDATE_BLOCK,), relative to the tile's centre.
    """
    base = np.uint64(bundle) * np.uint64(EDGE_BLOCK)
    sx, sy, sz = tile[3], tile[4], tile[5]
    nx, ny, nz = tile[6], tile[7], tile[8]
    ux, uy, uz = tile[9], tile[10], tile[11]
    unit = _F(1.0 / FULL_SCALE)
    scale = radius * unit
    wrong = _F(_STEP) * (abs(x) + abs(y) + abs(z) + sx + sy + sz + radius) + tile[12]
    # What the points' own places and normals may add to a vertex's height.
    lift = (abs(nx) + ux) * sx + (abs(ny) + uy) * sy + (abs(nz) + uz) * sz + _F(2.0) * wrong
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        fx, fy, fz = unit * edges[j + _AX], unit * edges[j + _AY], unit * edges[j + _AZ]
        gx, gy, gz = unit * edges[j + _BX], unit * edges[j + _BY], unit * edges[j + _BZ]
        f = scale * edges[j + _AO] - (fx * x + fy * y + fz * z)
        g = scale * edges[j + _BO] - (gx * x + gy * y + gz * z)
        df = sx * abs(fx) + sy * abs(fy) + sz * abs(fz) + wrong
        dg = sx * abs(gx) + sy * abs(gy) + sz * abs(gz) + wrong
        same = ((f > df) & (g > dg)) | ((f < -df) & (g < -dg))
        ax, ay, az = x + scale * edges[j + _VX], y + scale * edges[j + _VY], z + scale * edges[j + _VZ]
        bx, by, bz = x + scale * edges[j + _WX], y + scale * edges[j + _WY], z + scale * edges[j + _WZ]
        a = nx * ax + ny * ay + nz * az + ux * abs(ax) + uy * abs(ay) + uz * abs(az)
        b = nx * bx + ny * by + nz * bz + ux * abs(bx) + uy * abs(by) + uz * abs(bz)
        drop = same | ((a < -lift) & (b < -lift))
        mask |= np.uint32(not drop) << np.uint32(i)
        decoded[i + _AX], decoded[i + _AY], decoded[i + _AZ], decoded[i + _AO] = fx, fy, fz, f
        decoded[i + _BX], decoded[i + _BY], decoded[i + _BZ], decoded[i + _BO] = gx, gy, gz, g
        decoded[i + _VX], decoded[i + _VY], decoded[i + _VZ] = ax, ay, az
        decoded[i + _WX], decoded[i + _WY], decoded[i + _WZ] = bx, by, bz
        decoded[i + _WRONG] = wrong
    return np.int64(mask)


@njit(**FILTER)
def packet_mask(packets, block, q, reach):
    """Lanes of a block of packets that may reach a line above the horizon.

    Writes to `reach` (32,) the first line (perhaps below 0) that each packet may reach, and their number.
    """
    base = np.uint64(block) * np.uint64(PACKET_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    tx, ty, tz = q[6], q[7], q[8]
    mx, my, mz = q[9], q[10], q[11]
    slack, per_radian = q[12], q[13]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = packets[j] - px, packets[j + _UW] - py, packets[j + _U2] - pz
        radius = packets[j + _U3] + slack
        t, m = tx * x + ty * y + tz * z, mx * x + my * y + mz * z
        # The packet spans an angle of asin(e) <= e + (pi / 2 - 1) e^3 about its azimuth.
        rho = np.sqrt(t * t + m * m)
        e = radius / (rho + _TINY)
        wide = not (e < _ONE)
        half = (e + _ASIN * e * e * e + _F(ROUGHNESS)) * per_radian
        middle = rough_azimuth(t, m) * per_radian - _HALF
        first = np.ceil(middle - half)
        number = np.floor(middle + half) - first + _ONE
        reach[i] = np.int32(_ZERO if wide else first)
        reach[i + _UW] = np.int32(_MANY if wide else number)
        drop = (nx * x + ny * y + nz * z < -radius) | ((number < _ONE) & (not wide))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def octahedral_mask(packets, block, q):
    """Lanes of a block of packets that may reach an octahedral isoline, the start curve or the horizon.

    Here T and M are the axes U and S of `isolines`, and sectors a radian are half the number of lines.
    """
    base = np.uint64(block) * np.uint64(PACKET_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    tx, ty, tz = q[6], q[7], q[8]
    mx, my, mz = q[9], q[10], q[11]
    slack, half_lines = q[12], q[13]
    wrong = _F(_U_ERROR) * half_lines
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = packets[j] - px, packets[j + _UW] - py, packets[j + _U2] - pz
        radius = packets[j + _U3] + slack
        up, side = tx * x + ty * y + tz * z, mx * x + my * y + mz * z
        height = nx * x + ny * y + nz * z
        # u = x / (|x| + s) grows with x, and with s towards 0.
        au, as_ = abs(up), abs(side)
        least = (au - radius if au > radius else _ZERO) + (as_ - radius if as_ > radius else _ZERO)
        most = au + as_ + radius + radius
        low, high = x - radius, x + radius
        u_low = low / (low + most if low > _ZERO else least - low)
        u_high = high / (high + least if high > _ZERO else most - high)
        k_low = np.ceil((u_low + _ONE) * half_lines - _HALF - wrong)
        k_high = np.ceil((u_high + _ONE) * half_lines - _HALF + wrong)
        on_curve = (as_ <= radius) & (up >= -radius)
        drop = (height < -radius) | ((k_low == k_high) & (height > radius) & (not on_curve))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def edge_mask(candidates, packet, off, q, side, row):
    """Edges of a packet that may be contours above the horizon.

    Parameters
    ----------
    off : float
        What a vertex may be off by.
    side : (16 * rows,) int32, out
        Row `row`: 1 where the point is certainly in front of the edge's first face and behind the (negated)
        second, -1 for the contrary, 0 where float32 cannot tell.
    """
    base = np.uint64(packet) * np.uint64(CANDIDATE_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    horizon = nx * px + ny * py + nz * pz - off - q[12]
    to = np.uint64(row) * _UW
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        f = candidates[j + _AX] * px + candidates[j + _AY] * py + candidates[j + _AZ] * pz
        g = candidates[j + _BX] * px + candidates[j + _BY] * py + candidates[j + _BZ] * pz
        f += candidates[j + _AO]
        g += candidates[j + _BO]
        w = candidates[j + _WRONG]
        f_front, f_back, g_front, g_back = f > w, f < -w, g > w, g < -w
        side[to + i] = np.int32(f_front & g_back) - np.int32(f_back & g_front)
        a = nx * candidates[j + _VX] + ny * candidates[j + _VY] + nz * candidates[j + _VZ]
        b = nx * candidates[j + _WX] + ny * candidates[j + _WY] + nz * candidates[j + _WZ]
        drop = (f_front & g_front) | (f_back & g_back) | ((a < horizon) & (b < horizon))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def line_mask(candidates, packet, off, q, cosine, sine):
    """Edges of a packet away from the axis that may cross one line."""
    base = np.uint64(packet) * np.uint64(CANDIDATE_BLOCK)
    off += q[12]
    # Normal of the half-plane.
    lx, ly, lz = q[9] * cosine - q[6] * sine, q[10] * cosine - q[7] * sine, q[11] * cosine - q[8] * sine
    middle = lx * q[0] + ly * q[1] + lz * q[2]
    left, right = middle + off, middle - off
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        a = lx * candidates[j + _VX] + ly * candidates[j + _VY] + lz * candidates[j + _VZ]
        b = lx * candidates[j + _WX] + ly * candidates[j + _WY] + lz * candidates[j + _WZ]
        drop = ((a > left) & (b > left)) | ((a < right) & (b < right))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)
