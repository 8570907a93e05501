"""The search for edges: one traversal for a tile of shade points, a tight test for each point.

Four filters in float32 (see `lanes`), from coarse to fine:

    nodes of the tree against a tile        -> bundles near the tile
    edges of a bundle against the tile      -> candidates, copied side by side in *packets* of 16
    packets against a shade point           -> packets that may cross one of its lines
    edges of a packet against the point     -> edges to be decided in float64

A filter says what may be dropped: no contour, below the horizon, or between two neighbouring lines. Comparisons
with NaN or infinity never drop. Errors of rounding and of 16 bit edges are part of every bound.
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
    RADIUS,
    VERTEX_A,
    VERTEX_B,
)
from silint.core.contour import EDGES, NODES
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH, lowest
from silint.core.radial import ROUGHNESS, rough_azimuth

# A tile: centre and half width of its points and of its normals, and the slack of float32.
POINT, POINT_HALF, TILE_NORMAL, TILE_NORMAL_HALF, TILE_SLACK, N_TILE = 0, 3, 6, 9, 12, 13

# What the point filters read: p relative to the tile's centre, n, T, M, and slack, sectors a radian, radians a sector.
P_POINT, P_NORMAL, P_T, P_M, P_SLACK, P_PER_RADIAN, P_RADIANS, N_POINT = 0, 3, 6, 9, 12, 13, 14, 15

# A packet: centre and radius about its vertices, relative to the tile's centre, and what these may be off by.
PACKET_CENTRE, PACKET_RADIUS, PACKET_ERROR, N_PACKET = 0, 3, 4, 5
PACKET_BLOCK = N_PACKET * WIDTH
# A candidate: the fields of an edge relative to the tile's centre, and what its signed distances may be off by.
WRONG, N_CANDIDATE = N_EDGE_FIELDS, N_EDGE_FIELDS + 1
CANDIDATE_BLOCK = N_CANDIDATE * WIDTH

# float32 keeps sums of a few products of numbers below 1 to well within this.
_SLACK = 2.0**-20
# An int16 edge is off by half a step in each coordinate, of position and of normal.
_STEP = 0.52 / FULL_SCALE

_UW, _U2, _U3 = np.uint64(WIDTH), np.uint64(2 * WIDTH), np.uint64(3 * WIDTH)
_F = np.float32
_ZERO, _HALF, _ONE, _SIXTH = _F(0.0), _F(0.5), _F(1.0), _F(1.0 / 6.0)

# Offsets of a node's fields within its block, unsigned.
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))
_NX, _NY, _NZ = (np.uint64((NORMAL + i) * WIDTH) for i in range(3))
_MX, _MY, _MZ = (np.uint64((NORMAL_HALF + i) * WIDTH) for i in range(3))
_R, _O, _OH = (np.uint64(i * WIDTH) for i in (RADIUS, OFFSET, OFFSET_HALF))
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
def tile_edge_mask(edges, bundle, x, y, z, radius, tile):
    """Edges of a bundle, with its centre at (x, y, z) from that of the tile, that some point may need."""
    base = np.uint64(bundle) * np.uint64(EDGE_BLOCK)
    sx, sy, sz = tile[3], tile[4], tile[5]
    nx, ny, nz = tile[6], tile[7], tile[8]
    ux, uy, uz = tile[9], tile[10], tile[11]
    unit = _F(1.0 / FULL_SCALE)
    scale = radius * unit
    undecided = _F(_STEP) * (abs(x) + abs(y) + abs(z) + sx + sy + sz + radius) + tile[12]
    rx, ry, rz = -x * unit, -y * unit, -z * unit
    vx, vy, vz = sx * unit, sy * unit, sz * unit
    # What the points' own places and normals may add to a vertex's height.
    lift = (
        (abs(nx) + ux) * sx + (abs(ny) + uy) * sy + (abs(nz) + uz) * sz + _F(2.0 * _STEP) * radius + tile[12]
    )
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        fx, fy, fz = _F(edges[j + _AX]), _F(edges[j + _AY]), _F(edges[j + _AZ])
        gx, gy, gz = _F(edges[j + _BX]), _F(edges[j + _BY]), _F(edges[j + _BZ])
        f = rx * fx + ry * fy + rz * fz + scale * edges[j + _AO]
        g = rx * gx + ry * gy + rz * gz + scale * edges[j + _BO]
        df = vx * abs(fx) + vy * abs(fy) + vz * abs(fz) + undecided
        dg = vx * abs(gx) + vy * abs(gy) + vz * abs(gz) + undecided
        same = ((f > df) & (g > dg)) | ((f < -df) & (g < -dg))
        ax, ay, az = x + scale * edges[j + _VX], y + scale * edges[j + _VY], z + scale * edges[j + _VZ]
        bx, by, bz = x + scale * edges[j + _WX], y + scale * edges[j + _WY], z + scale * edges[j + _WZ]
        a = nx * ax + ny * ay + nz * az + ux * abs(ax) + uy * abs(ay) + uz * abs(az)
        b = nx * bx + ny * by + nz * bz + ux * abs(bx) + uy * abs(by) + uz * abs(bz)
        drop = same | ((a < -lift) & (b < -lift))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def packet_mask(packets, block, q, lone, near):
    """Lanes of a block of packets that may reach a line above the horizon.

    Writes to `lone` (16,) the only line that a packet can reach, -1 where it may reach several, and to `near`
    (16,) how far it is from the axis, at least.
    """
    base = np.uint64(block) * np.uint64(PACKET_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    tx, ty, tz = q[6], q[7], q[8]
    mx, my, mz = q[9], q[10], q[11]
    slack, per_radian, radians = q[12], q[13], q[14]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = packets[j] - px, packets[j + _UW] - py, packets[j + _U2] - pz
        radius = packets[j + _U3] + slack
        t, m = tx * x + ty * y + tz * z, mx * x + my * y + mz * z
        s = rough_azimuth(t, m) * per_radian
        line = np.floor(s)
        d = abs(s - line - _HALF)
        far = (_ONE - d) * radians - _F(ROUGHNESS)
        far = far if far < _ONE else _ONE
        d = d * radians - _F(ROUGHNESS)
        rho = np.sqrt(t * t + m * m)
        near[i] = rho - radius
        drop = (nx * x + ny * y + nz * z < -radius) | (rho * (d - d * d * d * _SIXTH) > radius)
        lone[i] = line if rho * (far - far * far * far * _SIXTH) > radius else -_ONE
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def edge_mask(candidates, packet, near, off, q, side):
    """Edges of a packet that may be contours above the horizon and cross a line.

    Parameters
    ----------
    near : float
        Distance of the packet from the point's axis, at least.
    off : float
        What a vertex may be off by.
    side : (16,) int32, out
        1 where the point is certainly in front of the edge's first face and behind the (negated) second, -1
        for the contrary, 0 where float32 cannot tell.
    """
    base = np.uint64(packet) * np.uint64(CANDIDATE_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    tx, ty, tz = q[6], q[7], q[8]
    mx, my, mz = q[9], q[10], q[11]
    per_radian = q[13]
    off += q[12]
    wrong = (off / (near if near > off else off) + _F(ROUGHNESS)) * per_radian
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        f = (
            candidates[j + _AX] * px
            + candidates[j + _AY] * py
            + candidates[j + _AZ] * pz
            + candidates[j + _AO]
        )
        g = (
            candidates[j + _BX] * px
            + candidates[j + _BY] * py
            + candidates[j + _BZ] * pz
            + candidates[j + _BO]
        )
        w = candidates[j + _WRONG]
        f_front, f_back, g_front, g_back = f > w, f < -w, g > w, g < -w
        side[i] = np.int32(f_front & g_back) - np.int32(f_back & g_front)
        ax, ay, az = candidates[j + _VX] - px, candidates[j + _VY] - py, candidates[j + _VZ] - pz
        bx, by, bz = candidates[j + _WX] - px, candidates[j + _WY] - py, candidates[j + _WZ] - pz
        below = (nx * ax + ny * ay + nz * az < -off) & (nx * bx + ny * by + nz * bz < -off)
        s = rough_azimuth(tx * ax + ty * ay + tz * az, mx * ax + my * ay + mz * az) * per_radian + _HALF
        r = rough_azimuth(tx * bx + ty * by + tz * bz, mx * bx + my * by + mz * bz) * per_radian + _HALF
        low = s if s < r else r
        high = r if s < r else s
        between = high + wrong < np.floor(low - wrong) + _ONE
        drop = (f_front & g_front) | (f_back & g_back) | below | between
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def edge_line_mask(candidates, packet, off, q, cosine, sine, side):
    """The same, of a packet that can reach one line only."""
    base = np.uint64(packet) * np.uint64(CANDIDATE_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    off += q[12]
    # Normal of the half-plane.
    lx, ly, lz = q[9] * cosine - q[6] * sine, q[10] * cosine - q[7] * sine, q[11] * cosine - q[8] * sine
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        f = (
            candidates[j + _AX] * px
            + candidates[j + _AY] * py
            + candidates[j + _AZ] * pz
            + candidates[j + _AO]
        )
        g = (
            candidates[j + _BX] * px
            + candidates[j + _BY] * py
            + candidates[j + _BZ] * pz
            + candidates[j + _BO]
        )
        w = candidates[j + _WRONG]
        f_front, f_back, g_front, g_back = f > w, f < -w, g > w, g < -w
        side[i] = np.int32(f_front & g_back) - np.int32(f_back & g_front)
        ax, ay, az = candidates[j + _VX] - px, candidates[j + _VY] - py, candidates[j + _VZ] - pz
        bx, by, bz = candidates[j + _WX] - px, candidates[j + _WY] - py, candidates[j + _WZ] - pz
        below = (nx * ax + ny * ay + nz * az < -off) & (nx * bx + ny * by + nz * bz < -off)
        s, r = lx * ax + ly * ay + lz * az, lx * bx + ly * by + lz * bz
        beside = ((s > off) & (r > off)) | ((s < -off) & (r < -off))
        drop = (f_front & g_front) | (f_back & g_back) | below | beside
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**INNER)
def set_tile(points, normals, first, last, tile):
    """Bounds of the points [first, last) and of their normals."""
    size = 1.0
    for i in range(3):
        low, high = np.inf, -np.inf
        normal_low, normal_high = np.inf, -np.inf
        for j in range(first, last):
            low, high = min(low, points[j, i]), max(high, points[j, i])
            normal_low, normal_high = min(normal_low, normals[j, i]), max(normal_high, normals[j, i])
        size = max(size, abs(low), abs(high))
        tile[POINT + i] = 0.5 * (low + high)
        tile[POINT_HALF + i] = 0.5 * (high - low)
        tile[TILE_NORMAL + i] = 0.5 * (normal_low + normal_high)
        tile[TILE_NORMAL_HALF + i] = 0.5 * (normal_high - normal_low)
    tile[TILE_SLACK] = 4.0 * _SLACK * size


@njit(**INNER)
def set_point(p, n, frame, n_lines, tile_centre, q):
    """What the filters need to know of a shade point."""
    size = 1.0
    for i in range(3):
        q[P_POINT + i], q[P_NORMAL + i] = p[i] - tile_centre[i], n[i]
        q[P_T + i], q[P_M + i] = frame[0, i], frame[1, i]
        size = max(size, abs(p[i]))
    q[P_SLACK] = _SLACK * size
    q[P_PER_RADIAN] = n_lines / (2.0 * np.pi)
    q[P_RADIANS] = 2.0 * np.pi / n_lines


@njit(**INNER)
def gather_candidates(nodes, levels, edges, n_edges, tile, stack, candidates, edge_ids, count):
    """Append the edges that some point of a tile may need, in packets of 16.

    Their order is that of the tree, whatever the tile: what is found for a point does not depend on the
    others, nor does its order.

    Returns
    -------
    The number of candidates, those before included; there has to be room for more where it exceeds
    len(edge_ids).
    """
    if n_edges == 0:
        return count
    n_bundles = (n_edges + WIDTH - 1) // WIDTH
    top = 1
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        mask = tile_mask(nodes, levels[level] + block, tile)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            child = block * WIDTH + lane
            if level > 0:
                if levels[level - 1] + child < levels[level]:
                    stack[top, 0], stack[top, 1] = level - 1, child
                    top += 1
                continue
            if child >= n_bundles:
                continue
            base = (levels[0] + block) * BLOCK + lane
            x = nodes[base + CENTRE * WIDTH] - tile[0]
            y = nodes[base + (CENTRE + 1) * WIDTH] - tile[1]
            z = nodes[base + (CENTRE + 2) * WIDTH] - tile[2]
            radius = nodes[base + RADIUS * WIDTH]
            hits = tile_edge_mask(edges, child, x, y, z, radius, tile)
            while hits != 0:
                lane = lowest(hits)
                hits &= hits - 1
                if child * WIDTH + lane >= n_edges:
                    break
                if count < len(edge_ids):
                    edge_ids[count] = child * WIDTH + lane
                    _pack(edges, child, lane, x, y, z, radius, tile, candidates, count)
                count += 1
    return count


@njit(**INNER)
def _pack(edges, bundle, lane, x, y, z, radius, tile, candidates, slot):
    """Write one candidate, relative to the tile's centre."""
    source = bundle * EDGE_BLOCK + lane
    target = (slot // WIDTH) * CANDIDATE_BLOCK + slot % WIDTH
    unit = _F(1.0 / FULL_SCALE)
    scale = radius * unit
    for plane in (PLANE_A, PLANE_B):
        fx = edges[source + plane * WIDTH] * unit
        fy = edges[source + (plane + 1) * WIDTH] * unit
        fz = edges[source + (plane + 2) * WIDTH] * unit
        candidates[target + plane * WIDTH] = fx
        candidates[target + (plane + 1) * WIDTH] = fy
        candidates[target + (plane + 2) * WIDTH] = fz
        offset = scale * edges[source + (plane + 3) * WIDTH]
        candidates[target + (plane + 3) * WIDTH] = offset - (fx * x + fy * y + fz * z)
    for vertex in (VERTEX_A, VERTEX_B):
        candidates[target + vertex * WIDTH] = x + scale * edges[source + vertex * WIDTH]
        candidates[target + (vertex + 1) * WIDTH] = y + scale * edges[source + (vertex + 1) * WIDTH]
        candidates[target + (vertex + 2) * WIDTH] = z + scale * edges[source + (vertex + 2) * WIDTH]
    far = abs(x) + abs(y) + abs(z) + tile[3] + tile[4] + tile[5] + radius
    candidates[target + WRONG * WIDTH] = _F(_STEP) * far + tile[12]


@njit(**INNER)
def bound_packets(candidates, first, last, packets):
    """Bound the candidates [first, last), packet by packet; first is a multiple of 16.

    Empty lanes of the last packet and of the last block are made to be dropped.
    """
    for packet in range(first // WIDTH, (last + WIDTH - 1) // WIDTH):
        base = packet * CANDIDATE_BLOCK
        end = min(last - packet * WIDTH, WIDTH)
        for lane in range(end, WIDTH):
            for field in range(N_CANDIDATE):
                candidates[base + field * WIDTH + lane] = candidates[base + field * WIDTH]
        target = (packet // WIDTH) * PACKET_BLOCK + packet % WIDTH
        square, wrong = _F(0.0), _F(0.0)
        for lane in range(end):
            wrong = max(wrong, candidates[base + WRONG * WIDTH + lane])
        for axis in range(3):
            low, high = _F(np.inf), _F(-np.inf)
            for lane in range(WIDTH):
                a = candidates[base + (VERTEX_A + axis) * WIDTH + lane]
                b = candidates[base + (VERTEX_B + axis) * WIDTH + lane]
                low, high = min(low, a, b), max(high, a, b)
            packets[target + axis * WIDTH] = _F(0.5) * (low + high)
        for lane in range(WIDTH):
            for vertex in (VERTEX_A, VERTEX_B):
                d = _F(0.0)
                for axis in range(3):
                    e = candidates[base + (vertex + axis) * WIDTH + lane] - packets[target + axis * WIDTH]
                    d += e * e
                square = max(square, d)
        packets[target + PACKET_ERROR * WIDTH] = _F(2.0) * wrong
        packets[target + PACKET_RADIUS * WIDTH] = np.sqrt(square) * _F(1.0001) + _F(2.0) * wrong


@njit(**INNER)
def find_edges(packets, candidates, edge_ids, first, last, q, scratch, side, lines, ids, sides, n_ids, tally):
    """Append those of the candidates [first, last) that a shade point needs; first is a multiple of 16.

    Parameters
    ----------
    q : (N_POINT,) float32
        See `set_point`.
    scratch, side : (2, 16) float32, (16,) int32
    lines : (K, 2) float32
        Cosine and sine of the lines.
    ids, sides : int32
        Edges of the tree, and on which side of their faces the point is (`edge_mask`); with room for all candidates.
    """
    nodes, tested = 0, 0
    lone, near = scratch[0], scratch[1]
    n_lines = len(lines)
    first_packet, last_packet = first // WIDTH, (last + WIDTH - 1) // WIDTH
    for block in range(first_packet // WIDTH, (last_packet + WIDTH - 1) // WIDTH):
        mask = packet_mask(packets, block, q, lone, near)
        nodes += 1
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            packet = block * WIDTH + lane
            if packet < first_packet or packet >= last_packet:
                continue
            tested += WIDTH
            off = packets[block * PACKET_BLOCK + PACKET_ERROR * WIDTH + lane]
            k = int(lone[lane])
            if k < 0:
                hits = edge_mask(candidates, packet, near[lane], off, q, side)
            else:
                k = k if k < n_lines else 0
                hits = edge_line_mask(candidates, packet, off, q, lines[k, 0], lines[k, 1], side)
            while hits != 0:
                i = lowest(hits)
                hits &= hits - 1
                if packet * WIDTH + i < last:
                    ids[n_ids] = edge_ids[packet * WIDTH + i]
                    sides[n_ids] = side[i]
                    n_ids += 1
    tally[NODES] += nodes
    tally[EDGES] += tested
    return n_ids
