"""Phase one: visible intervals on the isolines of shade points, by sweeping the depth count.

    contour edges -> crossings -> sort each isoline -> W from its value on the start curve -> W = 0 is visible

Every isoline is checked: W may not be negative over more than rounding, and its values at the two ends must
agree with W walked along the horizon from the neighbouring isoline. A point with one that fails is left to
`cover`.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.along import N_AXIS, faces_along, set_axis
from silint.core.buffers import grow, grow_rows, sort_pairs
from silint.core.contour import CONTOURS, CROSSINGS, decide_contours, side_rounding
from silint.core.isolines import horizon_reach, start_corner, to_loop
from silint.core.jit import INNER, PARALLEL
from silint.core.octahedral import (
    CROSSED,
    DEPTH,
    FAILED,
    GAIN,
    HORIZON_LEFT,
    HORIZON_RIGHT,
    LEFT,
    LEFT_GAIN,
    N_ROWS,
    RIGHT,
    START,
    cross_edges,
    pole_count,
)
from silint.core.search import N_POINT, N_TILE, TILE, new_search, search_tile, set_point, set_tile

# Negative W over less than this (of a quarter loop) is rounding: two crossings in the wrong order.
NEGATIVE_LENGTH = 1e-9

CONTRADICTED = -1  # in place of a number of intervals


@njit(**INNER)
def _left_depths(ledger, pole, at_pole):
    """W at the left end of every isoline: from the pole along the start curve, then down to the horizon."""
    n_lines = ledger.shape[1] - 1
    w = at_pole
    for i in range(n_lines):
        if pole < 0:
            k = i
            w += ledger[START, k]
        else:
            k = n_lines - 1 - i
            w -= ledger[START, k + 1]
        ledger[DEPTH, k] = w - ledger[LEFT_GAIN, k]


@njit(**INNER)
def _check_horizon(reach, ledger):
    """Mark isolines whose depth counts at the horizon disagree with W walked along the horizon.

    The horizon has a left and a right branch over u. They meet where isolines end to be above the horizon
    altogether (beyond, both ends of an isoline are one point) and where isolines end to rise above it at all.
    """
    n_lines = reach.shape[1]
    for k in range(n_lines):
        if reach[LEFT, k] < 0.0:
            continue
        left, right = ledger[DEPTH, k], ledger[DEPTH, k] + ledger[GAIN, k]
        if not _is_partial(reach, k):
            if left != right:
                ledger[FAILED, k] = 1
            continue
        if not _is_partial(reach, k - 1):
            if left - ledger[HORIZON_LEFT, k] != right - ledger[HORIZON_RIGHT, k]:
                ledger[FAILED, k] = 1
        left += ledger[HORIZON_LEFT, k + 1]
        right += ledger[HORIZON_RIGHT, k + 1]
        if _is_partial(reach, k + 1):
            next_left = ledger[DEPTH, k + 1]
            if left != next_left or right != next_left + ledger[GAIN, k + 1]:
                ledger[FAILED, k] = ledger[FAILED, k + 1] = 1
        elif left != right:
            ledger[FAILED, k] = 1


@njit(**INNER)
def _is_partial(reach, k):
    """True where isoline k exists and crosses the horizon."""
    if k < 0 or k >= reach.shape[1] or reach[LEFT, k] < 0.0:
        return False
    return reach[LEFT, k] < 2.0 or reach[RIGHT, k] < 2.0


@njit(**INNER)
def _sweep_line(position, gain, lo, hi, left, right, w, out, n_out):
    """Append the visible intervals of one isoline, in t, from its sorted crossings and W at its left end.

    Returns the number of rows written so far, and whether W stayed non-negative.
    """
    sound = True
    first = n_out
    t = -left
    for i in range(lo, hi + 1):
        end = position[i] if i < hi else right
        if end > t:
            if w == 0:
                if n_out > first and out[n_out - 1, 1] == t:
                    out[n_out - 1, 1] = end  # crossings that cancel in one place split nothing
                else:
                    out[n_out, 0], out[n_out, 1] = t, end
                    n_out += 1
            elif w < 0 and end - t > NEGATIVE_LENGTH:
                sound = False
            t = end
        if i < hi:
            w += gain[i]
    return n_out, sound


@njit(**INNER)
def _bucket(ledger, line, position, gain, n_crossings, offsets, sorted_position, sorted_gain):
    """Counting sort of the crossings by isoline."""
    n_lines = len(offsets) - 1
    offsets[0] = 0
    for k in range(n_lines):
        offsets[k + 1] = offsets[k] + ledger[CROSSED, k]
    for c in range(n_crossings):
        k = line[c]
        ledger[CROSSED, k] -= 1
        slot = offsets[k] + ledger[CROSSED, k]
        sorted_position[slot], sorted_gain[slot] = position[c], gain[c]


@njit(**INNER)
def _axes(corner):
    """World directions of U and S (`isolines.turn`)."""
    if corner == 0:
        return (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    if corner == 1:
        return (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
    if corner == 2:
        return (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)
    return (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)


@njit(**INNER)
def _sweep_tile(geometry, trees, faces, points, normals, first, last, counts, tally):
    """Visible intervals of the points [first, last), in one list; rows are loop coordinates."""
    n_lines = counts.shape[1]
    reach = np.empty((2, n_lines))
    ledger = np.empty((N_ROWS, n_lines + 1), np.int32)
    offsets = np.empty(n_lines + 1, np.int64)
    tile, axis = np.empty(N_TILE, np.float32), np.empty(N_AXIS, np.float32)
    q, no_lines = np.empty((TILE, N_POINT), np.float32), np.empty((0, 2), np.float32)
    stack = np.empty((256, 2), np.int64)
    face_ids = np.empty(64, np.int32)
    capacity = 8 * n_lines
    line, position, gain = np.empty(capacity, np.int32), np.empty(capacity), np.empty(capacity, np.int32)
    sorted_position, sorted_gain = np.empty(capacity), np.empty(capacity, np.int32)
    found = np.empty((8 * n_lines, 2))
    n_found = 0

    set_tile(points, normals, first, last, tile)
    for i in range(first, last):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        up_axis, side_axis = _axes(start_corner(n))
        set_point(p, n, up_axis, side_axis, 0.5 * n_lines, tile, q[i - first])
    search = search_tile(new_search(8, 2048), trees, tile, q[: last - first], no_lines, tally[first:last])
    most = 0
    for i in range(last - first):
        most = max(most, search.ends[i, 2])
    contours = np.empty((most, 3), np.int32)

    for i in range(first, last):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        corner = start_corner(n)
        _reset(reach, ledger, n, corner)

        # Cross the contour edges with the isolines.
        rounding = side_rounding(p)
        n_contours = 0
        for which in range(2):
            tree = trees[which]
            begin, end = search.ends[i - first, which], search.ends[i - first, which + 1]
            n_contours = decide_contours(
                geometry.vertices,
                geometry.planes,
                geometry.plane_errors,
                tree.ends,
                tree.offsets,
                tree.codes,
                search.ids[i - first, begin:end],
                search.sides[i - first, begin:end],
                p,
                n,
                rounding,
                contours,
                n_contours,
                tally[i],
            )
        n_crossings = 0
        c = 0
        while c < n_contours:
            c, n_crossings = cross_edges(
                geometry.vertices,
                contours,
                n_contours,
                p,
                n,
                corner,
                reach,
                ledger,
                line,
                position,
                gain,
                c,
                n_crossings,
            )
            if c < n_contours:
                capacity = 2 * len(line)
                line, position, gain = grow(line, capacity), grow(position, capacity), grow(gain, capacity)
        tally[i, CONTOURS] += n_contours
        tally[i, CROSSINGS] += n_crossings

        # Depth counts at the ends of every isoline, and whether they agree.
        pole = 1 if n[0] >= 0.0 else -1
        set_axis(p, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (float(pole), 0.0, 0.0), axis)
        while True:
            n_along = faces_along(faces.order, faces.coarse, faces.nodes, faces.levels, axis, stack, face_ids)
            if n_along <= len(face_ids):
                break
            face_ids = np.empty(2 * n_along, np.int32)
        _left_depths(ledger, pole, pole_count(geometry, face_ids, n_along, p, n, corner, pole))
        _check_horizon(reach, ledger)

        # Sort the crossings of each isoline, and sweep.
        if len(sorted_position) < len(position):
            sorted_position, sorted_gain = np.empty(len(position)), np.empty(len(position), np.int32)
        _bucket(ledger, line, position, gain, n_crossings, offsets, sorted_position, sorted_gain)
        if n_found + n_crossings + n_lines > len(found):
            found = grow_rows(found, 2 * len(found) + n_crossings + n_lines)
        n_found = _sweep_lines(
            sorted_position, sorted_gain, offsets, reach, ledger, corner, found, n_found, counts, i
        )
    return found, n_found


@njit(**INNER)
def _reset(reach, ledger, n, corner):
    n_lines = reach.shape[1]
    for k in range(n_lines):
        reach[LEFT, k], reach[RIGHT, k] = horizon_reach(n, corner, k, n_lines)
    for row in range(N_ROWS):
        for k in range(n_lines + 1):
            ledger[row, k] = 0


@njit(**INNER)
def _sweep_lines(position, gain, offsets, reach, ledger, corner, found, n_found, counts, i):
    """Append the visible intervals of all isolines of point i, and count them.

    One isoline that contradicts itself or its neighbour condemns all of the point: a jump that was missed
    shifts the counts of every isoline beyond it, which then agree with one another.
    """
    before = n_found
    sound = True
    for k in range(reach.shape[1]):
        counts[i, k] = 0
        if reach[LEFT, k] < 0.0 or not sound:
            continue
        sort_pairs(position, gain, offsets[k], offsets[k + 1])
        first = n_found
        n_found, sound = _sweep_line(
            position,
            gain,
            offsets[k],
            offsets[k + 1],
            reach[LEFT, k],
            reach[RIGHT, k],
            ledger[DEPTH, k],
            found,
            n_found,
        )
        sound = sound and ledger[FAILED, k] == 0
        counts[i, k] = n_found - first
        to_loop(found, first, n_found, corner)
    if sound:
        return n_found
    for k in range(reach.shape[1]):
        counts[i, k] = CONTRADICTED if reach[LEFT, k] >= 0.0 else 0
    return before


@njit(**PARALLEL)
def visible_intervals(geometry, contour, boundary, faces, points, normals, counts, intervals, needed, tally):
    """Visible intervals of many shade points.

    Parameters
    ----------
    geometry : Topology
    contour, boundary : EdgeBundles
        Of ordinary edges, and of all others.
    faces : FaceBundles
    points, normals : (n, 3) float64
        In scaled units and already displaced; unit normals. Neighbours in the array should be neighbours in
        space, and alike in normal.
    counts : (n, K) int32, out
        Intervals on each isoline; CONTRADICTED, and none, where it has to be covered instead.
    intervals : (tiles, capacity, 2) float64, out
        Loop coordinates, tile by tile of TILE points, tightly packed within a tile.
    needed : (tiles,) int64, out
        Intervals of each tile; a tile that needs more than the capacity is left unwritten.
    tally : (n, N_TALLY) int64, zero, out
    """
    n = len(points)
    for block in prange(len(intervals)):
        first, last = block * TILE, min((block + 1) * TILE, n)
        found, n_found = _sweep_tile(
            geometry, (contour, boundary), faces, points, normals, first, last, counts, tally
        )
        needed[block] = n_found
        if n_found <= intervals.shape[1]:
            for j in range(n_found):
                intervals[block, j, 0], intervals[block, j, 1] = found[j, 0], found[j, 1]
