"""The search for edges: one traversal for a tile of shade points, a tight test for each point.

Four filters in float32 (see `filters`), from coarse to fine:

    nodes of the tree against a tile        -> bundles near the tile
    edges of a bundle against the tile      -> candidates, copied side by side in *packets* of 16
    packets against a shade point           -> packets that may cross one of its lines
    edges of a packet against the point     -> edges to be decided in float64
"""

from __future__ import annotations

from typing import NamedTuple

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
    near_edge_mask,
    near_mask,
    near_packet_mask,
    octahedral_mask,
    packet_mask,
    tile_edge_mask,
    tile_mask,
)
from silint.core.jit import INNER
from silint.core.lanes import WIDTH, lowest

TILE = 32  # shade points that share a traversal

# A tile: centre and half width of its points and of its normals, the slack of float32, and the square of the
# distance beyond which nothing is looked for.
POINT, POINT_HALF, TILE_NORMAL, TILE_NORMAL_HALF, TILE_SLACK, TILE_REACH, N_TILE = 0, 3, 6, 9, 12, 13, 14

# What the point filters read: p relative to the tile's centre, n, T, M, slack, sectors a radian, and the
# distance.
P_POINT, P_NORMAL, P_T, P_M, P_SLACK, P_PER_RADIAN, P_REACH, N_POINT = 0, 3, 6, 9, 12, 13, 14, 15

# What a search holds of each packet that it still considers: the packet, the lines that it may reach, and
# the edges that are left of it. Packets are taken some blocks at a time.
_PACKET, _FIRST_LINE, _LINES, _EDGES, _N_ROW = 0, 1, 2, 3, 4
_BLOCKS_AT_ONCE = 4
_REACHED = _BLOCKS_AT_ONCE * WIDTH * _N_ROW  # behind the rows, lines that packets of a block may reach
N_WORK = _REACHED + 2 * WIDTH
N_SIDES = _BLOCKS_AT_ONCE * WIDTH * WIDTH

# float32 keeps sums of a few products of numbers below 1 to well within this.
_SLACK = 2.0**-20
# Distances, of float32, are taken larger by a share of them, and such that their squares are above 0.
_REACH_MARGIN, _LEAST_SQUARE = 1e-5, 1e-36
# A packet that may reach more lines than this is not tested against them: most of its edges cross one.
FEW_LINES = 12

_UW = np.uint64(WIDTH)
_F = np.float32


@njit(**INNER)
def set_tile(points, normals, first, last, tile, reach=np.inf):
    """Bounds of the points [first, last) and of their normals; nothing is needed from `reach` on."""
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
    tile[TILE_REACH] = (reach * (1.0 + _REACH_MARGIN)) ** 2 + _LEAST_SQUARE


@njit(**INNER)
def set_point(p, n, across, over, per_radian, tile, q, reach=np.inf):
    """What the filters need to know of a shade point.

    Parameters
    ----------
    across, over : tuple of 3 float
        T and M of the frame.
    per_radian : float
        Sectors a radian.
    reach : float
        The distance from which on nothing is needed.
    """
    size = 1.0
    for i in range(3):
        q[P_POINT + i], q[P_NORMAL + i] = p[i] - tile[POINT + i], n[i]
        q[P_T + i], q[P_M + i] = across[i], over[i]
        size = max(size, abs(p[i]))
    q[P_SLACK] = _SLACK * size
    q[P_PER_RADIAN] = per_radian
    q[P_REACH] = reach * (1.0 + _REACH_MARGIN) + np.sqrt(_LEAST_SQUARE)


@njit(**INNER)
def _gather_candidates(tree, tile, stack, candidates, edge_ids, count, tally, reach):
    """Append the edges that some point of a tile may need, in packets of 16.

    Their order is that of the tree, whatever the tile: what is found for a point does not depend on the
    others, nor does its order.

    Returns
    -------
    The number of candidates, those before included; there has to be room for more where it exceeds
    len(edge_ids).
    """
    nodes, levels, edges, n_edges = tree.nodes, tree.levels, tree.edges, len(tree.ends)
    if n_edges == 0:
        return count
    n_bundles = (n_edges + WIDTH - 1) // WIDTH
    decoded = np.empty(CANDIDATE_BLOCK, np.float32)
    top, blocks, tested = 1, 0, 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, block = stack[top, 0], stack[top, 1]
        mask = np.int64(-1)
        if reach is not None:
            mask = near_mask(nodes, levels[level] + block, tile)
        if mask != 0:
            mask &= tile_mask(nodes, levels[level] + block, tile)
        blocks += 1
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
            tested += WIDTH
            if reach is not None and hits != 0:
                off = tile[TILE_SLACK] + _F(2.0) * decoded[WRONG * WIDTH]
                sx, sy, sz = tile[POINT_HALF], tile[POINT_HALF + 1], tile[POINT_HALF + 2]
                first, zero = np.int64(0), _F(0.0)  # a literal would compile the filter twice
                hits &= near_edge_mask(
                    decoded, first, zero, zero, zero, sx + off, sy + off, sz + off, tile[TILE_REACH]
                )
            while hits != 0:
                lane = lowest(hits)
                hits &= hits - 1
                if child * WIDTH + lane >= n_edges:
                    break
                if count < len(edge_ids):
                    edge_ids[count] = child * WIDTH + lane
                    _pack(decoded, lane, candidates, count)
                count += 1
    tally[NODES] += blocks
    tally[EDGES] += tested
    return count


@njit(**INNER)
def _pack(decoded, lane, candidates, slot):
    """Copy one edge to the candidates."""
    source = np.uint64(lane)
    target = np.uint64((slot // WIDTH) * CANDIDATE_BLOCK + slot % WIDTH)
    for field in range(np.uint64(0), np.uint64(CANDIDATE_BLOCK), _UW):
        candidates[target + field] = decoded[source + field]


@njit(**INNER)
def _bound_packets(candidates, first, last, packets):
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


class Search(NamedTuple):
    """What a search found for the points of a tile, and its scratch."""

    ids: np.ndarray  # (TILE, capacity) int32: edges for each point, of the first tree and then of the second
    sides: np.ndarray  # (TILE, capacity) int32: on which side of their faces the point is (`edge_mask`)
    ends: np.ndarray  # (TILE, 3) int64: where the edges of the trees begin and end in these
    candidates: np.ndarray  # float32: CANDIDATE_BLOCK a packet
    packets: np.ndarray  # float32: PACKET_BLOCK for 16 packets
    edge_ids: np.ndarray  # int32: of the candidates
    work: np.ndarray  # (N_WORK,) int32
    side: np.ndarray  # (N_SIDES,) int32
    stack: np.ndarray  # (depth, 2) int64


@njit(**INNER)
def new_search(n_blocks, capacity):
    """Room for so many blocks of packets, and edges for each point; a search makes more as it needs it."""
    return Search(
        np.empty((TILE, capacity), np.int32),
        np.empty((TILE, capacity), np.int32),
        np.zeros((TILE, 3), np.int64),
        np.empty(n_blocks * WIDTH * CANDIDATE_BLOCK, np.float32),
        np.zeros(n_blocks * PACKET_BLOCK, np.float32),
        np.empty(n_blocks * WIDTH * WIDTH, np.int32),
        np.empty(N_WORK, np.int32),
        np.empty(N_SIDES, np.int32),
        np.empty((256, 2), np.int64),
    )


@njit(**INNER)
def search_tile(search, trees, tile, q, lines, tally, reach=None):
    """Edges of two trees that the points of a tile need.

    Parameters
    ----------
    search : Search
    trees : pair of EdgeBundles
    tile : (N_TILE,) float32
        See `set_tile`.
    q : (n, N_POINT) float32
        Its points, see `set_point`.
    lines : (K, 2) float32
        Cosine and sine of radial lines; none for octahedral ones.
    tally : (n, N_TALLY) int64
        Added to; what is done once for the tile counts for its first point.
    reach : optional
        None where nothing limits how far edges count: then filters of distances are not even compiled. Its
        value is not looked at; tile and points hold the distance.

    Returns
    -------
    Search
        The same, perhaps with longer arrays.
    """
    candidates, packets, edge_ids = search.candidates, search.packets, search.edge_ids
    ids, sides = search.ids, search.sides
    # The candidates of the second tree begin with a packet of their own.
    zero = np.int64(0)  # a literal would compile what follows twice
    while True:
        middle = _gather_candidates(trees[0], tile, search.stack, candidates, edge_ids, zero, tally[0], reach)
        second = (middle + WIDTH - 1) // WIDTH * WIDTH
        last = _gather_candidates(trees[1], tile, search.stack, candidates, edge_ids, second, tally[0], reach)
        if last <= len(edge_ids):
            break
        n_blocks = (last + last // 2) // (WIDTH * WIDTH) + 1
        candidates = np.empty(n_blocks * WIDTH * CANDIDATE_BLOCK, np.float32)
        packets = np.empty(n_blocks * PACKET_BLOCK, np.float32)
        edge_ids = np.empty(n_blocks * WIDTH * WIDTH, np.int32)
    _bound_packets(candidates, zero, middle, packets)
    _bound_packets(candidates, second, last, packets)
    for which in range(2):
        first, end = (second, last) if which > 0 else (zero, middle)
        ids, sides = _find_edges(
            packets,
            candidates,
            edge_ids,
            first,
            end,
            q,
            lines,
            search.work,
            search.side,
            ids,
            sides,
            search.ends,
            which,
            tally,
            reach,
        )
    return Search(
        ids, sides, search.ends, candidates, packets, edge_ids, search.work, search.side, search.stack
    )


@njit(**INNER)
def _find_edges(
    packets, candidates, edge_ids, first, last, q, lines, work, side, ids, sides, ends, which, tally, reach
):
    """Those of the candidates [first, last) that each shade point of a tile needs.

    A chunk of packets at a time is tested for all points, while it is in the nearest cache (2.9x for 2M
    triangles). For one point every filter runs over what the one before has left, without a branch on what it
    finds: so no test has to wait for another (36 -> 28 us a point on a scan).

    Appended to ids and sides, of which longer ones are returned where they are needed.
    """
    first_packet, last_packet = first // WIDTH, (last + WIDTH - 1) // WIDTH
    last_block = (last_packet + WIDTH - 1) // WIDTH
    for i in range(len(q)):
        ends[i, which + 1] = ends[i, which]
    for chunk in range(first_packet // WIDTH, last_block, _BLOCKS_AT_ONCE):
        chunk_end = min(chunk + _BLOCKS_AT_ONCE, last_block)
        for i in range(len(q)):
            if ends[i, which + 1] + N_SIDES > ids.shape[1]:
                ids, sides = _longer_rows(ids), _longer_rows(sides)
            tested = _reaching_packets(
                packets, chunk, chunk_end, first_packet, last_packet, q[i], lines, work, reach
            )
            left = _contour_packets(packets, candidates, q[i], tested, work, side)
            if len(lines) > 0:
                _cross_lines(packets, candidates, q[i], lines, left, work)
            n_ids = _record(edge_ids, last, left, work, side, ids[i], sides[i], ends[i, which + 1])
            ends[i, which + 1] = n_ids
            tally[i, NODES] += chunk_end - chunk
            tally[i, EDGES] += tested * WIDTH
    return ids, sides


@njit(**INNER)
def _longer_rows(array):
    longer = np.empty((len(array), 2 * array.shape[1]), array.dtype)
    for i in range(len(array)):  # not by slices, whose checks of shapes take 3 s to compile
        for j in range(array.shape[1]):
            longer[i, j] = array[i, j]
    return longer


@njit(**INNER)
def _reaching_packets(packets, first_block, last_block, first_packet, last_packet, q, lines, work, reach):
    """Packets of some blocks that may reach a line: rows of `work`, and their number."""
    reached = work[_REACHED:]
    n = 0
    for block in range(first_block, last_block):
        if len(lines) > 0:
            mask = packet_mask(packets, block, q, reached)
        else:
            mask = octahedral_mask(packets, block, q)
        if reach is not None:
            mask &= near_packet_mask(packets, block, q)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            packet = block * WIDTH + lane
            row = n * _N_ROW
            work[row + _PACKET] = packet
            work[row + _FIRST_LINE], work[row + _LINES] = reached[lane], reached[WIDTH + lane]
            n += first_packet <= packet < last_packet
    return n


@njit(**INNER)
def _contour_packets(packets, candidates, q, n, work, side):
    """Of n packets, those with edges that may be contours above the horizon, and their number."""
    left = np.int64(0)  # a literal would compile the filter twice
    for i in range(n):
        row, to = i * _N_ROW, left * _N_ROW
        packet = work[row + _PACKET]
        off = _error(packets, packet)
        hits = edge_mask(candidates, packet, off, q, side, left)
        work[to + _EDGES] = hits
        work[to + _PACKET] = packet
        work[to + _FIRST_LINE], work[to + _LINES] = work[row + _FIRST_LINE], work[row + _LINES]
        left += hits != 0
    return left


@njit(**INNER)
def _cross_lines(packets, candidates, q, lines, n, work):
    """Drop edges of n packets that cross no line: nearly all, of a fine mesh."""
    n_lines = len(lines)
    for i in range(n):
        row = i * _N_ROW
        if work[row + _LINES] > FEW_LINES:
            continue
        packet, k = work[row + _PACKET], work[row + _FIRST_LINE]
        off = _error(packets, packet)
        k = k + n_lines if k < 0 else k
        crossed = 0
        for _ in range(work[row + _LINES]):
            k = k - n_lines if k >= n_lines else k
            crossed |= line_mask(candidates, packet, off, q, lines[k, 0], lines[k, 1])
            k += 1
        work[row + _EDGES] &= crossed


@njit(**INNER)
def _error(packets, packet):
    """What a vertex of a packet may be off by."""
    return packets[(packet >> 4) * PACKET_BLOCK + PACKET_ERROR * WIDTH + (packet & 15)]


@njit(**INNER)
def _record(edge_ids, last, n, work, side, ids, sides, n_ids):
    """Append what is left of n packets; returns the number of edges."""
    for i in range(n):
        row = i * _N_ROW
        slot = np.int64(work[row + _PACKET]) * WIDTH
        hits = np.int64(work[row + _EDGES])
        while hits != 0:
            lane = lowest(hits)
            hits &= hits - 1
            if slot + lane < last:
                ids[n_ids], sides[n_ids] = edge_ids[slot + lane], side[i * WIDTH + lane]
                n_ids += 1
    return n_ids
