"""Phase one: visible intervals on the isolines of shade points, by sweeping the depth count.

    contour edges -> crossings -> sort each isoline -> W from its value on the start curve -> W = 0 is visible

Every isoline is checked: W may not be negative over more than rounding, and its values at the two ends must
agree with W walked along the horizon from the neighbouring isoline. One that fails is computed again by
covering, which shares no step with the sweep but the shade point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.buffers import grow, sort_pairs
from silint.core.contour import CONTOURS, CROSSINGS, FALLBACK, N_TALLY, gather_contours
from silint.core.cover import cover_line
from silint.core.octahedral import cross_edge, horizon_reach, pole_count, start_corner
from silint.core.topology import Topology

BLOCK = 16  # shade points that share scratch memory

# An interval of negative W shorter than this (of a quarter loop) is rounding: two crossings in the wrong order.
NEGATIVE_LENGTH = 1e-9


class Lines(NamedTuple):
    """What the isolines of one shade point accumulate; a gain is a change of W towards larger u or t."""

    left: np.ndarray  # (K,) float64 reach above the horizon to the left of the start curve, -1 for none
    right: np.ndarray  # (K,) float64 and to the right
    crossings: np.ndarray  # (K,) int32 how many
    gain: np.ndarray  # (K,) int32 sum of gains over the whole isoline
    left_gain: np.ndarray  # (K,) int32 and over the part left of the start curve
    start: np.ndarray  # (K + 1,) int32 gains along the start curve between isolines k - 1 and k
    horizon_left: np.ndarray  # (K + 1,) int32 along the left branch of the horizon, likewise
    horizon_right: np.ndarray  # (K + 1,) int32 along the right branch
    depth: np.ndarray  # (K,) int32 W at the left end of the isoline
    failed: np.ndarray  # (K,) bool: the isoline's counts contradict each other


@njit(cache=True, error_model="numpy")
def _new_lines(n_lines):
    return Lines(
        np.empty(n_lines),
        np.empty(n_lines),
        np.empty(n_lines, np.int32),
        np.empty(n_lines, np.int32),
        np.empty(n_lines, np.int32),
        np.empty(n_lines + 1, np.int32),
        np.empty(n_lines + 1, np.int32),
        np.empty(n_lines + 1, np.int32),
        np.empty(n_lines, np.int32),
        np.empty(n_lines, np.bool_),
    )


@njit(cache=True, error_model="numpy")
def _reset(lines, n, corner):
    n_lines = len(lines.left)
    for k in range(n_lines):
        lines.left[k], lines.right[k] = horizon_reach(n, corner, k, n_lines)
    lines.crossings[:] = 0
    lines.gain[:] = 0
    lines.left_gain[:] = 0
    lines.start[:] = 0
    lines.horizon_left[:] = 0
    lines.horizon_right[:] = 0
    lines.failed[:] = False


@njit(cache=True, error_model="numpy")
def _left_depths(lines, pole, at_pole):
    """W at the left end of every isoline: from the pole along the start curve, then down to the horizon."""
    n_lines = len(lines.left)
    w = at_pole
    for i in range(n_lines):
        if pole < 0:
            k = i
            w += lines.start[k]
        else:
            k = n_lines - 1 - i
            w -= lines.start[k + 1]
        lines.depth[k] = w - lines.left_gain[k]


@njit(cache=True, error_model="numpy")
def _check_horizon(lines):
    """Mark isolines whose depth counts at the horizon disagree with W walked along the horizon.

    The horizon has a left and a right branch over u. They meet where isolines end to be above the horizon
    altogether (beyond, both ends of an isoline are one point) and where isolines end to rise above it at all.
    """
    n_lines = len(lines.left)
    for k in range(n_lines):
        if lines.left[k] < 0.0:
            continue
        left, right = lines.depth[k], lines.depth[k] + lines.gain[k]
        if lines.left[k] == 2.0 and lines.right[k] == 2.0:
            if left != right:
                lines.failed[k] = True
            continue
        if not _is_partial(lines, k - 1):
            if left - lines.horizon_left[k] != right - lines.horizon_right[k]:
                lines.failed[k] = True
        left += lines.horizon_left[k + 1]
        right += lines.horizon_right[k + 1]
        if _is_partial(lines, k + 1):
            next_left = lines.depth[k + 1]
            if left != next_left or right != next_left + lines.gain[k + 1]:
                lines.failed[k] = lines.failed[k + 1] = True
        elif left != right:
            lines.failed[k] = True


@njit(cache=True, error_model="numpy")
def _is_partial(lines, k):
    """True where isoline k exists and crosses the horizon."""
    if k < 0 or k >= len(lines.left) or lines.left[k] < 0.0:
        return False
    return lines.left[k] < 2.0 or lines.right[k] < 2.0


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _sweep_block(
    geometry, contour_tree, boundary_tree, face_tree, points, normals, first, last, cover_all, counts, tally
):
    """Visible intervals of the points [first, last), in one list; rows are loop coordinates."""
    n_lines = counts.shape[1]
    lines = _new_lines(n_lines)
    offsets = np.empty(n_lines + 1, np.int64)
    contours = np.empty((1024, 3), np.int32)
    capacity = 8 * n_lines
    line, position, gain = np.empty(capacity, np.int32), np.empty(capacity), np.empty(capacity, np.int32)
    sorted_position, sorted_gain = np.empty(capacity), np.empty(capacity, np.int32)
    found = np.empty((8 * n_lines, 2))
    n_found = 0

    for i in range(first, last):
        p, n, my_tally = points[i], normals[i], tally[i]
        corner = start_corner(n)
        _reset(lines, n, corner)
        n_crossings = 0
        if not cover_all:
            # Find the contour edges and cross them with the isolines.
            contours, n_contours = gather_contours(geometry, contour_tree, p, n, contours, 0, my_tally)
            contours, n_contours = gather_contours(geometry, boundary_tree, p, n, contours, n_contours, my_tally)
            for c in range(n_contours):
                if n_crossings + 4 * n_lines > len(line):
                    capacity = 2 * len(line)
                    line, position, gain = grow(line, capacity), grow(position, capacity), grow(gain, capacity)
                n_crossings = cross_edge(
                    geometry, contours[c], p, n, corner, lines, (line, position, gain), n_crossings
                )
            my_tally[CONTOURS] += n_contours
            my_tally[CROSSINGS] += n_crossings

            # Depth counts at the ends of every isoline, and whether they agree.
            pole = 1 if n[0] >= 0.0 else -1
            _left_depths(lines, pole, pole_count(geometry, face_tree, p, n, corner))
            _check_horizon(lines)

            # Bring the crossings of each isoline together.
            if len(sorted_position) < len(position):
                sorted_position, sorted_gain = np.empty(len(position)), np.empty(len(position), np.int32)
            offsets[0] = 0
            for k in range(n_lines):
                offsets[k + 1] = offsets[k] + lines.crossings[k]
            for c in range(n_crossings):
                k = line[c]
                lines.crossings[k] -= 1
                slot = offsets[k] + lines.crossings[k]
                sorted_position[slot], sorted_gain[slot] = position[c], gain[c]

        for k in range(n_lines):
            before = n_found
            if lines.left[k] >= 0.0:
                if n_found + n_crossings + 1 > len(found):
                    grown = np.empty((2 * len(found) + n_crossings, 2))
                    grown[:n_found] = found[:n_found]
                    found = grown
                sound = not (cover_all or lines.failed[k])
                if sound:
                    sort_pairs(sorted_position, sorted_gain, offsets[k], offsets[k + 1])
                    n_found, sound = _sweep_line(
                        sorted_position,
                        sorted_gain,
                        offsets[k],
                        offsets[k + 1],
                        lines.left[k],
                        lines.right[k],
                        lines.depth[k],
                        found,
                        n_found,
                    )
                if not sound:
                    my_tally[FALLBACK] += not cover_all
                    found, n_found = cover_line(
                        geometry, face_tree, p, n, corner, k, n_lines, lines.left[k], lines.right[k], found, before
                    )
            counts[i, k] = n_found - before
            for j in range(before, n_found):
                # From t to the loop coordinate; an interval may run past 4.
                t0, t1 = found[j, 0], found[j, 1]
                start = corner + t0
                start = start + 4.0 if start < 0.0 else (start - 4.0 if start >= 4.0 else start)
                found[j, 0], found[j, 1] = start, start + (t1 - t0)
    return found, n_found


@njit(cache=True, parallel=True, error_model="numpy")
def visible_intervals(
    geometry,
    contour_tree,
    boundary_tree,
    face_tree,
    points,
    normals,
    cover_all,
    counts,
    intervals,
    needed,
    tally,
):
    """Visible intervals of many shade points.

    Parameters
    ----------
    geometry : Topology
    contour_tree, boundary_tree : EdgeHierarchy
        Of ordinary edges, and of all others.
    face_tree : FaceHierarchy
    points, normals : (n, 3) float64
        In scaled units and already displaced; unit normals.
    cover_all : bool
        Cover every isoline instead of sweeping: the independent second way.
    counts : (n, K) int32, out
        Intervals on each isoline.
    intervals : (blocks, capacity, 2) float64, out
        Loop coordinates, block by block of BLOCK points, tightly packed within a block.
    needed : (blocks,) int64, out
        Intervals of each block; a block that needs more than the capacity is left unwritten.
    tally : (n, N_TALLY) int64, zero, out
    """
    n = len(points)
    for block in prange(len(intervals)):
        first, last = block * BLOCK, min((block + 1) * BLOCK, n)
        found, n_found = _sweep_block(
            geometry, contour_tree, boundary_tree, face_tree, points, normals, first, last, cover_all, counts, tally
        )
        needed[block] = n_found
        if n_found <= intervals.shape[1]:
            intervals[block, :n_found] = found[:n_found]


@njit(cache=True, parallel=True, error_model="numpy")
def pack_intervals(block_intervals, needed, block_starts, out):
    """Close the gaps between blocks."""
    for block in prange(len(needed)):
        start = block_starts[block]
        out[start : start + needed[block]] = block_intervals[block, : needed[block]]
