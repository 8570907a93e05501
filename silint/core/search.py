"""The search for edges: one traversal for a tile of shade points, a tight test for each point.

Four filters in float32 (see `lanes`), from coarse to fine:

    nodes of the tree against a tile        -> bundles near the tile
    edges of a bundle against the tile      -> candidates, copied side by side in *packets* of 16
    packets against a shade point           -> packets that may cross one of its lines
    edges of a packet against the point     -> edges to be decided in float64

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
    RADIUS,
    VERTEX_A,
    VERTEX_B,
)
from silint.core.contour import EDGES, NODES
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH, lowest
from silint.core.radial import ROUGHNESS, rough_azimuth

TILE = 32  # shade points that share a traversal

# A tile: centre and half width of its points and of its normals, and the slack of float32.
POINT, POINT_HALF, TILE_NORMAL, TILE_NORMAL_HALF, TILE_SLACK, N_TILE = 0, 3, 6, 9, 12, 13

# What the point filters read: p relative to the tile's centre, n, T, M, and slack, and sectors a radian.
P_POINT, P_NORMAL, P_T, P_M, P_SLACK, P_PER_RADIAN, N_POINT = 0, 3, 6, 9, 12, 13, 14

# A packet: centre and radius about its vertices, relative to the tile's centre, and what these may be off by.
PACKET_CENTRE, PACKET_RADIUS, PACKET_ERROR, N_PACKET = 0, 3, 4, 5
PACKET_BLOCK = N_PACKET * WIDTH
# A candidate: the fields of an edge relative to the tile's centre, and what its signed distances may be off
# by.
WRONG, N_CANDIDATE = N_EDGE_FIELDS, N_EDGE_FIELDS + 1
CANDIDATE_BLOCK = N_CANDIDATE * WIDTH

# float32 keeps sums of a few products of numbers below 1 to well within this.
_SLACK = 2.0**-20
# An int16 edge is off by half a step in each coordinate, of position and of normal.
_STEP = 0.52 / FULL_SCALE
# A packet that may reach more lines than this is not tested against them: most of its edges cross one.
FEW_LINES = 12
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
def edge_mask(candidates, packet, off, q, side):
    """Edges of a packet that may be contours above the horizon.

    Parameters
    ----------
    off : float
        What a vertex may be off by.
    side : (16,) int32, out
        1 where the point is certainly in front of the edge's first face and behind the (negated) second, -1
        for the contrary, 0 where float32 cannot tell.
    """
    base = np.uint64(packet) * np.uint64(CANDIDATE_BLOCK)
    px, py, pz = q[0], q[1], q[2]
    nx, ny, nz = q[3], q[4], q[5]
    horizon = nx * px + ny * py + nz * pz - off - q[12]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        f = candidates[j + _AX] * px + candidates[j + _AY] * py + candidates[j + _AZ] * pz
        g = candidates[j + _BX] * px + candidates[j + _BY] * py + candidates[j + _BZ] * pz
        f += candidates[j + _AO]
        g += candidates[j + _BO]
        w = candidates[j + _WRONG]
        f_front, f_back, g_front, g_back = f > w, f < -w, g > w, g < -w
        side[i] = np.int32(f_front & g_back) - np.int32(f_back & g_front)
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
def set_point(p, n, across, over, per_radian, tile_centre, q):
    """What the filters need to know of a shade point.

    Parameters
    ----------
    across, over : tuple of 3 float
        T and M of the frame.
    per_radian : float
        Sectors a radian.
    """
    size = 1.0
    for i in range(3):
        q[P_POINT + i], q[P_NORMAL + i] = p[i] - tile_centre[i], n[i]
        q[P_T + i], q[P_M + i] = across[i], over[i]
        size = max(size, abs(p[i]))
    q[P_SLACK] = _SLACK * size
    q[P_PER_RADIAN] = per_radian


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
    decoded = np.empty(CANDIDATE_BLOCK, np.float32)
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
            hits = tile_edge_mask(edges, child, x, y, z, radius, tile, decoded)
            while hits != 0:
                lane = lowest(hits)
                hits &= hits - 1
                if child * WIDTH + lane >= n_edges:
                    break
                if count < len(edge_ids):
                    edge_ids[count] = child * WIDTH + lane
                    _pack(decoded, lane, candidates, count)
                count += 1
    return count


@njit(**INNER)
def _pack(decoded, lane, candidates, slot):
    """Copy one edge to the candidates."""
    source = np.uint64(lane)
    target = np.uint64((slot // WIDTH) * CANDIDATE_BLOCK + slot % WIDTH)
    for field in range(np.uint64(0), np.uint64(CANDIDATE_BLOCK), _UW):
        candidates[target + field] = decoded[source + field]


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
def gather_tile(trees, tile, stack, begin, end, candidates, packets, edge_ids):
    """Candidates of a tile from both trees, in packets.

    Parameters
    ----------
    trees : pair of EdgeBundles
    begin, end : (2,) int64, out
        Which candidates are of which tree; the first of each is a multiple of 16.
    candidates, packets, edge_ids
        Scratch.

    Returns
    -------
    candidates, packets, edge_ids
        The same, or longer ones.
    """
    while True:
        n_candidates = 0
        for which in range(2):
            tree = trees[which]
            begin[which] = (n_candidates + WIDTH - 1) // WIDTH * WIDTH
            n_candidates = end[which] = gather_candidates(
                tree.nodes,
                tree.levels,
                tree.edges,
                len(tree.ends),
                tile,
                stack,
                candidates,
                edge_ids,
                begin[which],
            )
        if n_candidates <= len(edge_ids):
            break
        n_blocks = (n_candidates + n_candidates // 2) // (WIDTH * WIDTH) + 1
        candidates = np.empty(n_blocks * WIDTH * CANDIDATE_BLOCK, np.float32)
        packets = np.empty(n_blocks * PACKET_BLOCK, np.float32)
        edge_ids = np.empty(n_blocks * WIDTH * WIDTH, np.int32)
    for which in range(2):
        bound_packets(candidates, begin[which], end[which], packets)
    return candidates, packets, edge_ids


@njit(**INNER)
def find_edges(packets, candidates, edge_ids, first, last, q, reach, side, lines, ids, sides, tally):
    """Those of the candidates [first, last) that a shade point needs; first is a multiple of 16.

    Parameters
    ----------
    q : (N_POINT,) float32
        See `set_point`.
    reach, side : (32,) int32, (16,) int32
        Scratch.
    lines : (K, 2) float32
        Cosine and sine of radial lines; none for octahedral ones.
    ids, sides : int32
        Edges of the tree, and on which side of their faces the point is (`edge_mask`), with room for all
        candidates.

    Returns
    -------
    Their number.
    """
    n_ids = 0
    nodes, tested = 0, 0
    n_lines = len(lines)
    first_packet, last_packet = first // WIDTH, (last + WIDTH - 1) // WIDTH
    for block in range(first_packet // WIDTH, (last_packet + WIDTH - 1) // WIDTH):
        mask = packet_mask(packets, block, q, reach) if n_lines > 0 else octahedral_mask(packets, block, q)
        nodes += 1
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            packet = block * WIDTH + lane
            if packet < first_packet or packet >= last_packet:
                continue
            tested += WIDTH
            off = packets[block * PACKET_BLOCK + PACKET_ERROR * WIDTH + lane]
            # Of a fine mesh, few packets have an edge across a line at all.
            crossed = 0xFFFF
            if n_lines > 0 and reach[WIDTH + lane] <= FEW_LINES:
                crossed = 0
                for k in range(reach[lane], reach[lane] + reach[WIDTH + lane]):
                    k = k + n_lines if k < 0 else (k - n_lines if k >= n_lines else k)
                    crossed |= line_mask(candidates, packet, off, q, lines[k, 0], lines[k, 1])
                if crossed == 0:
                    continue
            hits = crossed & edge_mask(candidates, packet, off, q, side)
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
