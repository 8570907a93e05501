"""The search for faces on the spheres about shade points: as `search` has it for edges.

    nodes of the tree against a tile        -> bundles near some sphere
    faces of a bundle against the tile      -> candidates, in packets of 16
    packets against a shade point           -> packets near its sphere that may reach a line
    faces of a packet against the point     -> faces to be decided in float64

What is dropped neither begins nor ends on a sphere on any line above the horizon.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.contour import EDGES, NODES
from silint.core.face_bundles import BLOCK, CENTRE, CORNER_BLOCK, HALF
from silint.core.face_view import B_SLACK, box_mask
from silint.core.filters import PACKET_BLOCK, PACKET_ERROR, PACKET_RADIUS, near_packet_mask, packet_mask
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH, lowest
from silint.core.radial import ROUGHNESS, rough_azimuth

# Squares of distances are off by this share at most, in float32.
_MARGIN = 1e-5

_UW = np.uint64(WIDTH)
_U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8 = (np.uint64(i * WIDTH) for i in range(1, 9))
_CX, _CY, _CZ = (np.uint64((CENTRE + i) * WIDTH) for i in range(3))
_HX, _HY, _HZ = (np.uint64((HALF + i) * WIDTH) for i in range(3))
_F = np.float32
_ZERO, _HALF, _TINY, _MANY = _F(0.0), _F(0.5), _F(1e-30), _F(1e6)


@njit(**FILTER)
def _shell_mask(nodes, block, tile, least):
    """Lanes of a block of boxes that may meet spheres about points of the tile, above their horizons."""
    base = np.uint64(block) * np.uint64(BLOCK)
    px, py, pz = tile[0], tile[1], tile[2]
    slack = tile[12]
    sx, sy, sz = tile[3] + slack, tile[4] + slack, tile[5] + slack
    nx, ny, nz = tile[6], tile[7], tile[8]
    ux, uy, uz = tile[9], tile[10], tile[11]
    anx, any_, anz = abs(nx) + ux, abs(ny) + uy, abs(nz) + uz
    most = tile[13]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = nodes[j + _CX] - px, nodes[j + _CY] - py, nodes[j + _CZ] - pz
        hx, hy, hz = nodes[j + _HX] + sx, nodes[j + _HY] + sy, nodes[j + _HZ] + sz
        ax, ay, az = abs(x), abs(y), abs(z)
        top = nx * x + ny * y + nz * z + ux * ax + uy * ay + uz * az + anx * hx + any_ * hy + anz * hz
        near_x, near_y, near_z = ax - hx, ay - hy, az - hz
        near_x, near_y = near_x if near_x > _ZERO else _ZERO, near_y if near_y > _ZERO else _ZERO
        near_z = near_z if near_z > _ZERO else _ZERO
        far_x, far_y, far_z = ax + hx, ay + hy, az + hz
        drop = (top < _ZERO) | (hx < _ZERO)
        drop = drop | (near_x * near_x + near_y * near_y + near_z * near_z > most)
        drop = drop | (far_x * far_x + far_y * far_y + far_z * far_z < least)
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def _tile_face_mask(corners, bundle, x, y, z, tile, least, decoded):
    """Faces of a bundle that may meet spheres about points of the tile, above their horizons.

    Writes all sixteen to `decoded` (CORNER_BLOCK,) float32, relative to the tile's centre (x, y, z).
    """
    base = np.uint64(bundle) * np.uint64(CORNER_BLOCK)
    slack, most = tile[12], tile[13]
    sx, sy, sz = tile[3] + slack, tile[4] + slack, tile[5] + slack
    nx, ny, nz = tile[6], tile[7], tile[8]
    ux, uy, uz = tile[9], tile[10], tile[11]
    lift = (abs(nx) + ux) * sx + (abs(ny) + uy) * sy + (abs(nz) + uz) * sz
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        ax, ay, az = _F(corners[j] - x), _F(corners[j + _U1] - y), _F(corners[j + _U2] - z)
        bx, by, bz = _F(corners[j + _U3] - x), _F(corners[j + _U4] - y), _F(corners[j + _U5] - z)
        cx, cy, cz = _F(corners[j + _U6] - x), _F(corners[j + _U7] - y), _F(corners[j + _U8] - z)
        decoded[i], decoded[i + _U1], decoded[i + _U2] = ax, ay, az
        decoded[i + _U3], decoded[i + _U4], decoded[i + _U5] = bx, by, bz
        decoded[i + _U6], decoded[i + _U7], decoded[i + _U8] = cx, cy, cz
        # How far all of the face lies to either side, the larger of both.
        low, high = ax if ax < bx else bx, ax if ax > bx else bx
        low, high = low if low < cx else cx, high if high > cx else cx
        dx = (low if low > -high else -high) - sx
        low, high = ay if ay < by else by, ay if ay > by else by
        low, high = low if low < cy else cy, high if high > cy else cy
        dy = (low if low > -high else -high) - sy
        low, high = az if az < bz else bz, az if az > bz else bz
        low, high = low if low < cz else cz, high if high > cz else cz
        dz = (low if low > -high else -high) - sz
        dx, dy, dz = dx if dx > _ZERO else _ZERO, dy if dy > _ZERO else _ZERO, dz if dz > _ZERO else _ZERO

        a = nx * ax + ny * ay + nz * az + ux * abs(ax) + uy * abs(ay) + uz * abs(az)
        b = nx * bx + ny * by + nz * bz + ux * abs(bx) + uy * abs(by) + uz * abs(bz)
        c = nx * cx + ny * cy + nz * cz + ux * abs(cx) + uy * abs(cy) + uz * abs(cz)
        drop = (a < -lift) & (b < -lift) & (c < -lift)
        ax, ay, az = abs(ax) + sx, abs(ay) + sy, abs(az) + sz
        bx, by, bz = abs(bx) + sx, abs(by) + sy, abs(bz) + sz
        cx, cy, cz = abs(cx) + sx, abs(cy) + sy, abs(cz) + sz
        a, b, c = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
        drop = drop | (dx * dx + dy * dy + dz * dz > most) | ((a < least) & (b < least) & (c < least))
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def _far_packet_mask(packets, block, q, least):
    """Lanes of a block of packets that are not all nearer than the root of `least`."""
    base = np.uint64(block) * np.uint64(PACKET_BLOCK)
    px, py, pz, slack = q[0], q[1], q[2], q[12]
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        x, y, z = packets[j] - px, packets[j + _UW] - py, packets[j + _U2] - pz
        farthest = np.sqrt(x * x + y * y + z * z) + packets[j + _U3] + slack
        mask |= np.uint32(not (farthest * farthest < least)) << np.uint32(i)
    return np.int64(mask)


@njit(**FILTER)
def _face_mask(corners, packet, p, q, least, most, seen, spans):
    """Faces of a packet that may meet the spheres of some lines, between the squares `least` and `most`.

    Corners, float32 or float64, are seen from p; all else about the point is in q (`search.set_point`).

    Writes to `seen` (32,) the squared distances between which each face lies, and to `spans` (32,) int32 the
    sectors between which its corners do.
    """
    base = np.uint64(packet) * np.uint64(CORNER_BLOCK)
    px, py, pz = p
    nx, ny, nz = q[3], q[4], q[5]
    tx, ty, tz = q[6], q[7], q[8]
    mx, my, mz = q[9], q[10], q[11]
    slack, per_radian = q[12], q[13]
    wrong, turn = _F(ROUGHNESS) * per_radian + _F(1e-3), _F(2.0) * slack * per_radian
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        ax, ay, az = _F(corners[j] - px), _F(corners[j + _U1] - py), _F(corners[j + _U2] - pz)
        bx, by, bz = _F(corners[j + _U3] - px), _F(corners[j + _U4] - py), _F(corners[j + _U5] - pz)
        cx, cy, cz = _F(corners[j + _U6] - px), _F(corners[j + _U7] - py), _F(corners[j + _U8] - pz)
        low, high = ax if ax < bx else bx, ax if ax > bx else bx
        low, high = low if low < cx else cx, high if high > cx else cx
        dx = (low if low > -high else -high) - slack
        low, high = ay if ay < by else by, ay if ay > by else by
        low, high = low if low < cy else cy, high if high > cy else cy
        dy = (low if low > -high else -high) - slack
        low, high = az if az < bz else bz, az if az > bz else bz
        low, high = low if low < cz else cz, high if high > cz else cz
        dz = (low if low > -high else -high) - slack
        dx, dy, dz = dx if dx > _ZERO else _ZERO, dy if dy > _ZERO else _ZERO, dz if dz > _ZERO else _ZERO
        near = dx * dx + dy * dy + dz * dz
        a, b, c = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
        far = a if a > b else b
        far = np.sqrt(far if far > c else c) + slack
        far = far * far
        a, b, c = nx * ax + ny * ay + nz * az, nx * bx + ny * by + nz * bz, nx * cx + ny * cy + nz * cz
        drop = (near > most) | (far < least) | ((a < -slack) & (b < -slack) & (c < -slack))

        # Sectors of the corners, and what each may be off by.
        t, m = tx * ax + ty * ay + tz * az, mx * ax + my * ay + mz * az
        off = wrong + turn / (np.sqrt(t * t + m * m) + _TINY)
        s = rough_azimuth(t, m) * per_radian + _HALF
        first, last = s - off, s + off
        t, m = tx * bx + ty * by + tz * bz, mx * bx + my * by + mz * bz
        off = wrong + turn / (np.sqrt(t * t + m * m) + _TINY)
        s = rough_azimuth(t, m) * per_radian + _HALF
        first, last = s - off if s - off < first else first, s + off if s + off > last else last
        t, m = tx * cx + ty * cy + tz * cz, mx * cx + my * cy + mz * cz
        off = wrong + turn / (np.sqrt(t * t + m * m) + _TINY)
        s = rough_azimuth(t, m) * per_radian + _HALF
        first, last = s - off if s - off < first else first, s + off if s + off > last else last
        first, last = first if first > -_MANY else -_MANY, last if last < _MANY else _MANY
        first, last = np.floor(first), np.floor(last)
        seen[i], seen[i + _U1] = near, far
        spans[i], spans[i + _U1] = np.int32(first), np.int32(last)
        drop = drop | (first == last)
        mask |= np.uint32(not drop) << np.uint32(i)
    return np.int64(mask)


class FaceSearch(NamedTuple):
    """Faces on the spheres about points of a tile, and scratch."""

    candidates: np.ndarray  # float32: CORNER_BLOCK a packet, relative to the tile's centre
    packets: np.ndarray  # float32: PACKET_BLOCK for 16 packets
    face_ids: np.ndarray  # int32: of the candidates
    n_faces: int  # candidates
    found: np.ndarray  # int32: faces for one point; as many as there are candidates
    stack: np.ndarray  # (depth * 16, 2) int64


@njit(**INNER)
def new_face_search(n_blocks, n_levels):
    """Room for so many blocks of packets, and a tree of so many levels."""
    return FaceSearch(
        np.empty(n_blocks * WIDTH * CORNER_BLOCK, np.float32),
        np.empty(n_blocks * PACKET_BLOCK, np.float32),
        np.empty(n_blocks * WIDTH * WIDTH, np.int32),
        0,
        np.empty(n_blocks * WIDTH * WIDTH, np.int32),
        np.empty((WIDTH * n_levels, 2), np.int64),
    )


@njit(**INNER)
def gather_faces(search, bundles, tile, reach, tally):
    """Faces that may meet spheres about points of a tile.

    Their order is that of the tree, whatever the tile.

    Parameters
    ----------
    search : FaceSearch
    bundles : FaceBundles
        With corners.
    tile : (N_TILE,) float32
        See `search.set_tile`, with the longest reach.
    reach : (K,) float64
    tally : (N_TALLY,) int64

    Returns
    -------
    FaceSearch
        The same, perhaps with longer arrays.
    """
    least = reach.min()
    least = _F(least * least * (1.0 - _MARGIN))
    while True:
        count = _gather(bundles, tile, least, search, tally)
        if count <= len(search.face_ids):
            break
        search = new_face_search((count + count // 2) // (WIDTH * WIDTH) + 1, len(bundles.levels))
    _bound_face_packets(search.candidates, count, search.packets)
    return FaceSearch(search.candidates, search.packets, search.face_ids, count, search.found, search.stack)


@njit(**INNER)
def _gather(bundles, tile, least, search, tally):
    """Write the candidates of a tile; there has to be room for more where their number exceeds it."""
    candidates, face_ids, stack = search.candidates, search.face_ids, search.stack
    order, levels = bundles.order, bundles.levels
    x, y, z = np.float64(tile[0]), np.float64(tile[1]), np.float64(tile[2])
    decoded = np.empty(CORNER_BLOCK, np.float32)
    top, count, blocks, tested = int(len(order) > 0), 0, 0, 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, number = stack[top, 0], stack[top, 1]
        if level < 0:
            tested += WIDTH
            mask = _tile_face_mask(bundles.corners, number, x, y, z, tile, least, decoded)
            while mask != 0:
                lane = lowest(mask)
                mask &= mask - 1
                if number * WIDTH + lane >= len(order):
                    break
                if count < len(face_ids):
                    face_ids[count] = order[number * WIDTH + lane]
                    target = (count // WIDTH) * CORNER_BLOCK + count % WIDTH
                    for field in range(0, CORNER_BLOCK, WIDTH):
                        candidates[target + field] = decoded[lane + field]
                count += 1
            continue
        blocks += 1
        mask = _shell_mask(bundles.nodes, levels[level] + number, tile, least)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            stack[top, 0], stack[top, 1] = level - 1, number * WIDTH + lane
            top += 1
    tally[NODES] += blocks
    tally[EDGES] += tested
    return count


@njit(**INNER)
def _bound_face_packets(candidates, count, packets):
    """Bound the candidates, packet by packet; what is left of the last packet repeats its first face."""
    for packet in range((count + WIDTH - 1) // WIDTH):
        base = packet * CORNER_BLOCK
        for lane in range(min(count - packet * WIDTH, WIDTH), WIDTH):
            for field in range(0, CORNER_BLOCK, WIDTH):
                candidates[base + lane + field] = candidates[base + field]
        target = (packet // WIDTH) * PACKET_BLOCK + packet % WIDTH
        for axis in range(3):
            low, high = _F(np.inf), _F(-np.inf)
            for corner in range(3):
                for lane in range(WIDTH):
                    x = candidates[base + (3 * corner + axis) * WIDTH + lane]
                    low, high = min(low, x), max(high, x)
            packets[target + axis * WIDTH] = _HALF * (low + high)
        square = _ZERO
        for corner in range(3):
            for lane in range(WIDTH):
                d = _ZERO
                for axis in range(3):
                    e = candidates[base + (3 * corner + axis) * WIDTH + lane] - packets[target + axis * WIDTH]
                    d += e * e
                square = max(square, d)
        packets[target + PACKET_RADIUS * WIDTH] = np.sqrt(square) * _F(1.0001)
        packets[target + PACKET_ERROR * WIDTH] = _ZERO


@njit(**INNER)
def find_faces(search, q, reach, seen, spans, tally):
    """Faces that may begin or end on the spheres about one point of the tile.

    Parameters
    ----------
    search : FaceSearch
        What `gather_faces` found.
    q : (N_POINT,) float32
        See `search.set_point`, with the longest reach.
    reach : (K,) float64
    seen, spans : (32,) float32, (32,) int32
        Scratch.
    tally : (N_TALLY,) int64

    Returns
    -------
    The number of them; they are written to `search.found`.
    """
    n_lines, found, n_found = len(reach), search.found, 0
    shortest, longest = reach.min(), reach.max()
    least = _F(shortest * shortest * (1.0 - _MARGIN))
    most = q[14] * q[14]
    n_packets = (search.n_faces + WIDTH - 1) // WIDTH
    n_blocks, tested = (n_packets + WIDTH - 1) // WIDTH, 0
    for block in range(n_blocks):
        mask = packet_mask(search.packets, block, q, spans)
        mask &= near_packet_mask(search.packets, block, q)
        mask &= _far_packet_mask(search.packets, block, q, least)
        while mask != 0:
            packet = block * WIDTH + lowest(mask)
            mask &= mask - 1
            if packet >= n_packets:
                break
            tested += WIDTH
            hits = _face_mask(search.candidates, packet, (q[0], q[1], q[2]), q, least, most, seen, spans)
            while hits != 0:
                lane = lowest(hits)
                hits &= hits - 1
                if packet * WIDTH + lane >= search.n_faces:
                    break
                first, last = spans[lane], spans[WIDTH + lane]
                if shortest < longest and not _straddles(
                    np.float64(seen[lane]), np.float64(seen[WIDTH + lane]), reach, first, last, n_lines
                ):
                    continue
                found[n_found] = search.face_ids[packet * WIDTH + lane]
                n_found += 1
    tally[NODES] += n_blocks
    tally[EDGES] += tested
    return n_found


@njit(**INNER)
def _straddles(near, far, reach, first, last, n_lines):
    """Whether a face may meet the sphere of a line between two sectors."""
    near, far = near * (1.0 - _MARGIN), far * (1.0 + _MARGIN)
    if 2 * (last - first) >= n_lines:
        # It may be the other way round, or about the axis.
        first, last = 0, n_lines
    for i in range(first, last):
        k = i + n_lines if i < 0 else (i if i < n_lines else i - n_lines)
        r = reach[k]
        if near < r * r and far > r * r:
            return True
    return False


@njit(**INNER)
def walk_faces(bundles, p, q, view, squares, stack, boxes, lines, seen, spans, found, tally):
    """Faces that may begin or end on the spheres of lines about one point, straight from the tree.

    A box is entered where some line that it reaches has a radius between its nearest and its farthest place.
    With a radius of its own for every line that is a small part of all that is near, which no tile shares.

    Parameters
    ----------
    bundles : FaceBundles
        With corners.
    p : tuple of 3 float
    q : (N_POINT,) float32
        See `search.set_point`, with the longest reach.
    view : (N_VIEW,) float32
        See `face_view.set_view`.
    squares : (2 K,) float32
        Of how far lines reach, twice over, so that a range that runs past the last needs no second thought.
    stack : (16 * depth, 2) int64
        Scratch, as are all that follow.
    boxes, lines : (N_SEEN * 16,) float32, (32,) int32
    seen, spans : (32,) float32, (32,) int32
    found : (capacity,) int32, out
    tally : (N_TALLY,) int64

    Returns
    -------
    The number of faces; those beyond the capacity are not written.
    """
    n_lines, n_found, blocks, tested = len(squares) // 2, 0, 0, 0
    order, nodes, levels = bundles.order, bundles.nodes, bundles.levels
    least, most = squares.min() * _F(1.0 - _MARGIN), q[14] * q[14]
    slack = view[B_SLACK]
    top = 1 if len(order) > 0 else 0
    stack[0, 0], stack[0, 1] = len(levels) - 2, 0
    while top > 0:
        top -= 1
        level, number = stack[top, 0], stack[top, 1]
        if level < 0:
            tested += WIDTH
            mask = _face_mask(bundles.corners, number, p, q, least, most, seen, spans)
            while mask != 0:
                lane = lowest(mask)
                mask &= mask - 1
                if number * WIDTH + lane >= len(order):
                    break
                first, count = spans[lane], spans[WIDTH + lane] - spans[lane]
                if 2 * count >= n_lines:
                    # It may be the other way round, or about the axis.
                    first, count = 0, n_lines
                first = first + n_lines if first < 0 else first
                if _some_between(seen[lane], seen[WIDTH + lane], squares, first, count):
                    if n_found < len(found):
                        found[n_found] = order[number * WIDTH + lane]
                    n_found += 1
            continue
        blocks += 1
        block = levels[level] + number
        mask = box_mask(nodes, block, view, n_lines, boxes, lines)
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            near, farthest = boxes[lane], _ZERO
            if near > most:
                continue
            for axis in range(3):
                j = block * BLOCK + axis * WIDTH + lane
                x = abs(nodes[j + CENTRE * WIDTH] - view[axis]) + nodes[j + HALF * WIDTH] + slack
                farthest += x * x
            if _some_between(near, farthest, squares, lines[lane], lines[WIDTH + lane]):
                stack[top, 0], stack[top, 1] = level - 1, number * WIDTH + lane
                top += 1
    tally[NODES] += blocks
    tally[EDGES] += tested
    return n_found


@njit(**INNER)
def _some_between(near, far, squares, first, count):
    """Whether one of `count` squares from the first on lies between two, up to rounding."""
    near, far = near * _F(1.0 - _MARGIN), far * _F(1.0 + _MARGIN)
    some = False
    for k in range(np.uint64(first), np.uint64(first + count)):
        some |= (near < squares[k]) & (far > squares[k])
    return some
