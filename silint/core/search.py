"""The search for edges: one traversal for a tile of shade points, a tight test for each point.

Four filters in float32 (see `filters`), from coarse to fine:

    nodes of the tree against a tile        -> bundles near the tile
    edges of a bundle against the tile      -> candidates, copied side by side in *packets* of 16
    packets against a shade point           -> packets that may cross one of its lines
    edges of a packet against the point     -> edges to be decided in float64
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.bundles import BLOCK, CENTRE, RADIUS, VERTEX_A, VERTEX_B
from silint.core.contour import EDGES, NODES
from silint.core.filters import (
    CANDIDATE_BLOCK,
    N_CANDIDATE,
    PACKET_BLOCK,
    PACKET_ERROR,
    PACKET_RADIUS,
    WRONG,
    edge_mask,
    line_mask,
    octahedral_mask,
    packet_mask,
    tile_edge_mask,
    tile_mask,
)
from silint.core.jit import INNER
from silint.core.lanes import WIDTH, lowest

TILE = 32  # shade points that share a traversal

# A tile: centre and half width of its points and of its normals, and the slack of float32.
POINT, POINT_HALF, TILE_NORMAL, TILE_NORMAL_HALF, TILE_SLACK, N_TILE = 0, 3, 6, 9, 12, 13

# What the point filters read: p relative to the tile's centre, n, T, M, and slack, and sectors a radian.
P_POINT, P_NORMAL, P_T, P_M, P_SLACK, P_PER_RADIAN, N_POINT = 0, 3, 6, 9, 12, 13, 14

# What a search holds of each packet that it still considers: the packet, the lines that it may reach, and
# the edges that are left of it. Packets are taken some blocks at a time.
_PACKET, _FIRST_LINE, _LINES, _EDGES, _N_WORK = 0, 1, 2, 3, 4
_BLOCKS_AT_ONCE = 4
N_WORK = _BLOCKS_AT_ONCE * WIDTH * _N_WORK
N_SIDES = _BLOCKS_AT_ONCE * WIDTH * WIDTH

# float32 keeps sums of a few products of numbers below 1 to well within this.
_SLACK = 2.0**-20
# A packet that may reach more lines than this is not tested against them: most of its edges cross one.
FEW_LINES = 12

_UW = np.uint64(WIDTH)
_F = np.float32


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
def find_edges(packets, candidates, edge_ids, first, last, q, reach, work, side, lines, ids, sides, tally):
    """Those of the candidates [first, last) that a shade point needs; first is a multiple of 16.

    Every filter runs over what the one before has left, without a branch on what it finds: so one test does
    not have to wait for the other (26 -> 18 us a point on a scan, against asking packet by packet).

    Parameters
    ----------
    q : (N_POINT,) float32
        See `set_point`.
    reach, work, side : (32,) int32, (N_WORK,) int32, (N_SIDES,) int32
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
    n_ids, blocks, tested = 0, 0, 0
    n_lines = len(lines)
    first_packet, last_packet = first // WIDTH, (last + WIDTH - 1) // WIDTH
    last_block = (last_packet + WIDTH - 1) // WIDTH
    for chunk in range(first_packet // WIDTH, last_block, _BLOCKS_AT_ONCE):
        # Packets that may reach a line.
        n = 0
        for block in range(chunk, min(chunk + _BLOCKS_AT_ONCE, last_block)):
            mask = (
                packet_mask(packets, block, q, reach) if n_lines > 0 else octahedral_mask(packets, block, q)
            )
            blocks += 1
            while mask != 0:
                lane = lowest(mask)
                mask &= mask - 1
                packet = block * WIDTH + lane
                work[n + _PACKET] = packet
                work[n + _FIRST_LINE] = reach[lane]
                work[n + _LINES] = reach[WIDTH + lane]
                n += _N_WORK if first_packet <= packet < last_packet else 0
        tested += n // _N_WORK * WIDTH
        # Of these, packets with edges that may be contours.
        n_left = 0
        for i in range(0, n, _N_WORK):
            packet = work[i + _PACKET]
            off = packets[(packet >> 4) * PACKET_BLOCK + PACKET_ERROR * WIDTH + (packet & 15)]
            hits = edge_mask(candidates, packet, off, q, side, n_left // _N_WORK)
            work[n_left + _PACKET] = packet
            work[n_left + _FIRST_LINE] = work[i + _FIRST_LINE]
            work[n_left + _LINES] = work[i + _LINES]
            work[n_left + _EDGES] = hits
            n_left += _N_WORK if hits != 0 else 0
        # Of a fine mesh, few edges cross a line at all.
        for i in range(0, n_left if n_lines > 0 else 0, _N_WORK):
            if work[i + _LINES] > FEW_LINES:
                continue
            packet, k = work[i + _PACKET], work[i + _FIRST_LINE]
            k = k + n_lines if k < 0 else k
            off = packets[(packet >> 4) * PACKET_BLOCK + PACKET_ERROR * WIDTH + (packet & 15)]
            crossed = 0
            for _ in range(work[i + _LINES]):
                k = k - n_lines if k >= n_lines else k
                crossed |= line_mask(candidates, packet, off, q, lines[k, 0], lines[k, 1])
                k += 1
            work[i + _EDGES] &= crossed
        for i in range(0, n_left, _N_WORK):
            hits = np.int64(work[i + _EDGES])
            slot, row = np.int64(work[i + _PACKET]) * WIDTH, i // _N_WORK * WIDTH
            while hits != 0:
                lane = lowest(hits)
                hits &= hits - 1
                if slot + lane < last:
                    ids[n_ids] = edge_ids[slot + lane]
                    sides[n_ids] = side[row + lane]
                    n_ids += 1
    tally[NODES] += blocks
    tally[EDGES] += tested
    return n_ids
