"""Phase one on radial isolines: visible intervals of tiles of shade points, by sweeping the depth count.

    bundles near the tile -> edges of the point -> crossings with half-planes -> W from the zenith -> W = 0

A tile is a run of neighbouring points that share the traversal of the trees. What a point sees depends on the
point alone: the frame on its normal, and the order of its crossings on the order of edges in the tree.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.along import N_AXIS, faces_along, set_axis
from silint.core.buffers import SHORT, grow_rows, sort_pairs
from silint.core.contour import CONTOURS, CROSSINGS, SNAPPED, side_rounding
from silint.core.crossings import N_LANE_FIELDS, N_SPAN_FIELDS, cross_edges
from silint.core.face_view import N_SEEN, N_VIEW, set_view
from silint.core.jit import BLOCK, INNER
from silint.core.lanes import WIDTH
from silint.core.search import N_POINT, N_TILE, TILE, new_search, search_tile, set_point, set_tile
from silint.core.sphere_cuts import cross_sphere, new_scratch
from silint.core.sphere_search import walk_faces
from silint.core.zenith import near_zenith_counts, zenith_count

# Negative W over less than this difference of theta is rounding: two crossings in the wrong order.
NEGATIVE_LENGTH = 1e-9

CONTRADICTED = -1  # in place of a number of intervals


@njit(**INNER)
def _sort_line(key, gain, lo, hi):
    """Sort by rising key."""
    if hi - lo > SHORT:
        sort_pairs(key, gain, lo, hi)
        return
    for i in range(lo + 1, hi):
        k, g = key[i], gain[i]
        j = i - 1
        while j >= lo and key[j] > k:
            key[j + 1], gain[j + 1] = key[j], gain[j]
            j -= 1
        key[j + 1], gain[j + 1] = k, g


@njit(**INNER)
def _sweep_line(key, gain, lo, hi, end, w, out, n_out):
    """Append the visible intervals of one line, from its crossings in rising order and W at the zenith.

    Returns the number of rows written so far, and whether W stayed non-negative.
    """
    sound = True
    first = n_out
    y = np.inf
    for i in range(hi - 1, lo - 2, -1):
        stop = key[i] if i >= lo else end
        if stop < y:
            if w == 0:
                if n_out > first and out[n_out - 1, 1] == y:
                    out[n_out - 1, 1] = stop  # crossings that cancel in one place split nothing
                else:
                    out[n_out, 0], out[n_out, 1] = y, stop
                    n_out += 1
            elif w < 0 and y - stop > NEGATIVE_LENGTH * (1.0 + y * y):
                sound = False
            y = stop
        if i >= lo:
            w += gain[i]
    return n_out, sound


@njit(**INNER)
def _sweep_lines(key, gain, capacity, count, horizon, at_zenith, found, n_found, counts, i):
    """Append the visible intervals of all lines of point i, and count them.

    `at_zenith` (K,) is W there. A line that contradicts itself condemns all of the point: counts are shared.
    """
    before = n_found
    sound = True
    n_lines = len(horizon)
    for k in range(n_lines):
        c, w = count[k], at_zenith[k]
        lo = k * capacity
        if c == 0 or (c == 1 and w + gain[lo] >= 0 and key[lo] < np.inf):
            # Most lines: open down to the only crossing, or from it, or nowhere.
            y = key[lo] if c == 1 else horizon[k]
            after = w + gain[lo] if c == 1 else w
            opens, closes = w == 0, c == 1 and after == 0
            if opens or closes:
                found[n_found, 0] = np.inf if opens else y
                found[n_found, 1] = horizon[k] if closes else y
            n_found += opens or closes
            counts[i, k] = opens or closes
            continue
        _sort_line(key, gain, lo, lo + c)
        first = n_found
        n_found, line_sound = _sweep_line(key, gain, lo, lo + c, horizon[k], w, found, n_found)
        sound = sound and line_sound
        counts[i, k] = n_found - first
    if sound:
        return n_found
    for k in range(n_lines):
        counts[i, k] = CONTRADICTED
    return before


@njit(**BLOCK)
def radial_intervals(
    geometry,
    contour,
    boundary,
    faces,
    points,
    normals,
    frames,
    lines,
    horizon,
    reach,
    per_block,
    counts,
    starts,
    intervals,
    needed,
    tally,
    block,
):
    """Visible intervals of a block of shade points on radial isolines.

    Parameters
    ----------
    geometry : Topology
    contour, boundary : EdgeBundles
        Of ordinary edges, and of all others.
    faces : FaceBundles
    points, normals : (n, 3) float64
        In scaled units and already displaced; unit normals. Neighbours in the array should be neighbours in
        space, and alike in normal.
    frames : (n, 3, 3) float64
        Rows T, M, A of each; see `radial.set_frames`.
    lines, horizon : (K, 2), (K,) float64
        See `radial.line_table` and `radial.normal_table`.
    reach : (K,) float64 or None
        Nothing blocks a line from this distance on: see `caps.reach_table`. Faces have to have their corners
        then. None for no limit, and what a limit takes is not compiled.
    per_block : int
        Points of a block, a multiple of TILE.
    counts : (n, K) int32, out
        Intervals on each line; CONTRADICTED, and none, where it has to be covered instead.
    starts : (n,) int64, out
        First row of each point's intervals within its block.
    intervals : (blocks, capacity, 2) float64, out
        Keys of start and end, from the zenith down, tightly packed within a block.
    needed : (blocks,) int64, out
        Intervals of each block; a block that needs more than the capacity is left unwritten.
    tally : (n, N_TALLY) int64, zero, out
    block : int
        Which block of the points.
    """
    first, last = block * per_block, min((block + 1) * per_block, len(points))
    trees = contour, boundary
    n_lines = len(lines)
    tile, axis = np.empty(N_TILE, np.float32), np.empty(N_AXIS, np.float32)
    q, narrow = np.empty((TILE, N_POINT), np.float32), lines.astype(np.float32)
    search = new_search(8, 2048)
    stack, face_ids = np.empty((256, 2), np.int64), np.empty(64, np.int32)
    lanes, spans = np.empty(N_LANE_FIELDS * WIDTH), np.empty(N_SPAN_FIELDS * WIDTH, np.int32)
    # Not literals, for which everything would be compiled again.
    capacity, n_found = np.int64(16), np.int64(0)
    count = np.empty(n_lines, np.int32)
    key, gain = np.empty(n_lines * capacity), np.empty(n_lines * capacity, np.int32)
    found = np.empty((4 * TILE * n_lines, 2))
    at_zenith, farthest = np.empty(n_lines, np.int32), np.inf
    n_passes = 2
    if reach is not None:
        n_passes, farthest = 3, reach.max()
        scratch, view = new_scratch(n_lines), np.empty(N_VIEW, np.float32)
        walk, near_ids = np.empty((WIDTH * len(faces.levels), 2), np.int64), np.empty(256, np.int32)
        squares = np.empty(2 * n_lines, np.float32)
        for k in range(2 * n_lines):
            squares[k] = reach[k % n_lines] ** 2
        boxes, box_lines = np.empty(N_SEEN * WIDTH, np.float32), np.empty(2 * WIDTH, np.int32)
        shell, sectors = np.empty(2 * WIDTH, np.float32), np.empty(2 * WIDTH, np.int32)

    for tile_first in range(first, last, TILE):
        tile_last = min(tile_first + TILE, last)
        set_tile(points, normals, tile_first, tile_last, tile, farthest)
        for i in range(tile_first, tile_last):
            p = points[i, 0], points[i, 1], points[i, 2]
            n = normals[i, 0], normals[i, 1], normals[i, 2]
            frame = frames[i]
            across, over = (frame[0, 0], frame[0, 1], frame[0, 2]), (frame[1, 0], frame[1, 1], frame[1, 2])
            set_point(p, n, across, over, n_lines / (2.0 * np.pi), tile, q[i - tile_first], farthest)
        search = search_tile(
            search, trees, tile, q[: tile_last - tile_first], narrow, tally[tile_first:tile_last], reach
        )

        for i in range(tile_first, tile_last):
            p = points[i, 0], points[i, 1], points[i, 2]
            n = normals[i, 0], normals[i, 1], normals[i, 2]
            frame = frames[i]
            across, over = (frame[0, 0], frame[0, 1], frame[0, 2]), (frame[1, 0], frame[1, 1], frame[1, 2])
            rounding = side_rounding(p)
            ids, sides, ends = search.ids[i - tile_first], search.sides[i - tile_first], search.ends
            for k in range(n_lines):
                count[k] = 0
            if reach is not None:
                set_view(p, n, frame, n_lines, view)
                while True:
                    n_faces = walk_faces(
                        faces,
                        p,
                        q[i - tile_first],
                        view,
                        squares,
                        walk,
                        boxes,
                        box_lines,
                        shell,
                        sectors,
                        near_ids,
                        tally[i],
                    )
                    if n_faces <= len(near_ids):
                        break
                    near_ids = np.empty(2 * n_faces, np.int32)
            which = 0
            # Edges of both trees, and then the faces that reach out of the sphere.
            while which < n_passes:
                tree = trees[which % 2]
                if reach is not None and which == 2:
                    fits = cross_sphere(
                        geometry,
                        near_ids,
                        n_faces,
                        p,
                        n,
                        frame,
                        lines,
                        horizon,
                        reach,
                        rounding,
                        scratch,
                        count,
                        key,
                        gain,
                        capacity,
                        tally[i],
                    )
                else:
                    fits = cross_edges(
                        geometry.vertices,
                        geometry.planes,
                        geometry.plane_errors,
                        tree.ends,
                        tree.offsets,
                        tree.codes,
                        ids,
                        sides,
                        ends[i - tile_first, which],
                        ends[i - tile_first, which + 1],
                        p,
                        n,
                        frame,
                        lines,
                        horizon,
                        reach,
                        rounding,
                        lanes,
                        spans,
                        count,
                        key,
                        gain,
                        capacity,
                        tally[i],
                    )
                which += 1
                if not fits:
                    # Once more, with more room.
                    capacity *= 2
                    key, gain = np.empty(n_lines * capacity), np.empty(n_lines * capacity, np.int32)
                    tally[i, CONTOURS], tally[i, SNAPPED] = 0, 0
                    for k in range(n_lines):
                        count[k] = 0
                    which = 0
            set_axis(p, across, over, (frame[2, 0], frame[2, 1], frame[2, 2]), axis)
            n_along = 0
            while True:
                n_along = faces_along(
                    faces.order, faces.coarse, faces.nodes, faces.levels, axis, stack, face_ids
                )
                if n_along <= len(face_ids):
                    break
                face_ids = np.empty(2 * n_along, np.int32)
            if reach is None:
                at_zenith[:] = zenith_count(geometry, face_ids, n_along, p, n, frame, n_lines, rounding)
            else:
                near_zenith_counts(geometry, face_ids, n_along, p, n, frame, reach, rounding, at_zenith)
            crossings = 0
            for k in range(n_lines):
                crossings += count[k]
            tally[i, CROSSINGS] += crossings
            if n_found + crossings + n_lines > len(found):
                found = grow_rows(found, 2 * len(found) + crossings + n_lines)
            starts[i] = n_found
            n_found = _sweep_lines(key, gain, capacity, count, horizon, at_zenith, found, n_found, counts, i)
    needed[block] = n_found
    if n_found <= intervals.shape[1]:
        for j in range(n_found):
            intervals[block, j, 0], intervals[block, j, 1] = found[j, 0], found[j, 1]
