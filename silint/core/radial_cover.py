"""Covering radial isolines: the second way to the visible intervals of `radial_sweep`.

    boxes before what is open -> bundles of 16 faces -> keys of their edges -> cuts -> what is left is visible

Every line starts open from the zenith to the horizon. A tree of faces is walked from near to far, and only
where a line is still open: work goes with what is in front, whatever lies behind it. No contours, no depth
count, no start: any soup of triangles. And faces that are told apart: those seen from their back may be
left out, and of every face what is farther than a line reaches, with all boxes beyond that.

An edge has the same sectors and keys, bit for bit, as in `crossings`, from whichever face it is seen. So
faces hide up to their common edge exactly, nothing shows between them, and what is left does not depend on
the order in which they are taken. Boxes only say what may be skipped: float32, rounded outwards.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.buffers import grow_rows
from silint.core.contour import CROSSINGS, EDGES, NODES, SPHERE, side_rounding
from silint.core.cuts import (
    FULL,
    N_KEYS,
    N_SPANS,
    ROOM,
    faces_away,
    farthest_corners,
    hide_cuts,
    keep_near,
    list_cuts,
    list_round_cuts,
    meets_near,
    meets_open,
    project_faces,
)
from silint.core.face_bundles import CORNER_BLOCK
from silint.core.face_view import N_SEEN, N_VIEW, box_mask, set_view
from silint.core.jit import BLOCK, INNER
from silint.core.lanes import WIDTH, lowest


@njit(**INNER)
def _still_wanted(opened, n_open, tops, bottoms, squares, reach, stride, first, count, low, high, square):
    """True where something may hide a part of a line that is open and reaches so far."""
    if reach is None:
        return meets_open(opened, n_open, tops, bottoms, stride, first, count, low, high)
    return meets_near(opened, n_open, tops, bottoms, squares, stride, first, count, low, high, square)


@njit(**INNER)
def _cover(
    vertices,
    faces,
    face_planes,
    planes,
    plane_errors,
    order,
    nodes,
    levels,
    corners,
    p,
    n,
    frame,
    lines,
    view,
    stack,
    stack_keys,
    seen,
    ranges,
    keys,
    spans,
    cuts,
    cut_lines,
    opened,
    n_open,
    tops,
    bottoms,
    reach,
    one_sided,
    squares,
    corner_distances,
    tally,
):
    """Take what the faces hide from the open intervals of a point. False where a line has no room left.

    `reach` (K,) is None for no limit; `squares` (2 K,) are those of it, rounded up to float32, twice over,
    and `corner_distances` (16,) is scratch.
    """
    n_lines = len(n_open)
    stride = len(opened) // n_lines
    n_bundles = len(corners) // CORNER_BLOCK
    rounding = side_rounding(p)
    left = n_lines
    blocks, bundles, crossings, clipped = 0, 0, 0, 0
    if reach is not None:
        most, all_near = squares.max(), reach.min() ** 2
    else:
        most = np.float32(np.inf)
    top = 1 if n_bundles > 0 else 0
    # A row is a node: level (-1 a bundle), number, first line, lines; distance, lowest and highest key.
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = len(levels) - 2, 0, 0, n_lines
    stack_keys[0, 0], stack_keys[0, 1], stack_keys[0, 2] = 0.0, -np.inf, np.inf
    while top > 0 and left > 0:
        top -= 1
        level, number = stack[top, 0], stack[top, 1]
        first, count = stack[top, 2], stack[top, 3]
        low, high = stack_keys[top, 1], stack_keys[top, 2]
        # What was open when the node was put here may be hidden by now.
        if not _still_wanted(
            opened,
            n_open,
            tops,
            bottoms,
            squares,
            reach,
            stride,
            first,
            count,
            low,
            high,
            stack_keys[top, 0],
        ):
            continue
        if level < 0:
            bundles += 1
            n_cuts = np.int64(0)  # a literal would compile what follows twice
            mask = project_faces(corners, number, p, n, frame, n_lines, keys, spans)
            if reach is not None and mask != 0:
                farthest_corners(corners, number, p[0], p[1], p[2], corner_distances)
            while mask != 0:
                i = lowest(mask)
                mask &= mask - 1
                f = order[number * WIDTH + i]
                if one_sided and faces_away(face_planes, planes, plane_errors, f, p, n, rounding):
                    continue
                before = n_cuts
                winding = spans[3 * WIDTH + i]
                if winding == 0:
                    n_cuts = list_cuts(keys, spans, i, lines, tops, bottoms, cuts, cut_lines, n_cuts)
                else:
                    n_cuts = list_round_cuts(
                        vertices,
                        faces,
                        face_planes,
                        planes,
                        plane_errors,
                        f,
                        p,
                        n,
                        frame,
                        lines,
                        rounding,
                        winding,
                        cuts,
                        cut_lines,
                        n_cuts,
                    )
                if reach is not None and corner_distances[i] * (1.0 + 1e-9) >= all_near:
                    clipped += 1
                    n_cuts = keep_near(
                        face_planes,
                        planes,
                        plane_errors,
                        f,
                        p,
                        frame,
                        lines,
                        reach,
                        corner_distances[i],
                        rounding,
                        cuts,
                        cut_lines,
                        before,
                        n_cuts,
                    )
            crossings += int(n_cuts)
            closed = hide_cuts(cuts, cut_lines, n_cuts, opened, n_open, tops, bottoms, stride)
            if closed == FULL:
                return False
            left -= closed
            continue
        blocks += 1
        mask = box_mask(nodes, levels[level] + number, view, n_lines, seen, ranges)
        bottom = top
        while mask != 0:
            i = lowest(mask)
            mask &= mask - 1
            first, count = ranges[i], ranges[WIDTH + i]
            low, high = seen[WIDTH + i], seen[2 * WIDTH + i]
            if seen[i] >= most:
                continue
            if not _still_wanted(
                opened, n_open, tops, bottoms, squares, reach, stride, first, count, low, high, seen[i]
            ):
                continue
            # The nearest on top.
            distance = seen[i]
            at = top
            while at > bottom and stack_keys[at - 1, 0] < distance:
                for j in range(4):
                    stack[at, j] = stack[at - 1, j]
                for j in range(3):
                    stack_keys[at, j] = stack_keys[at - 1, j]
                at -= 1
            stack[at, 0], stack[at, 1] = level - 1, number * WIDTH + i
            stack[at, 2], stack[at, 3] = first, count
            stack_keys[at, 0], stack_keys[at, 1], stack_keys[at, 2] = distance, low, high
            top += 1
    tally[NODES] += blocks
    tally[EDGES] += bundles * WIDTH
    tally[CROSSINGS] += crossings
    tally[SPHERE] += clipped
    return True


@njit(**BLOCK)
def covered_radial_intervals(
    geometry,
    bundles,
    points,
    normals,
    frames,
    lines,
    horizon,
    reach,
    one_sided,
    per_block,
    counts,
    starts,
    intervals,
    needed,
    tally,
    block,
):
    """Visible intervals of a block of shade points on radial isolines, by covering.

    Parameters
    ----------
    geometry : Topology
    bundles : FaceBundles
        With corners.
    points, normals : (n, 3) float64
        As for `radial_sweep.radial_intervals`, in any order.
    frames : (n, 3, 3) float64
        Rows T, M, A of each; see `radial.set_frames`.
    lines, horizon : (K, 2), (K,) float64
        See `radial.line_table` and `radial.normal_table`.
    reach : (K,) float64 or None
        Nothing blocks a line from this distance on: see `caps.reach_table`. None for no limit, and what a
        limit takes is not compiled.
    one_sided : bool
        Whether faces seen from their back block nothing.
    per_block : int
        Points of a block.
    counts : (n, K) int32, out
        Intervals on each line.
    starts : (n,) int64, out
        First row of each point's intervals within its block.
    intervals : (blocks, capacity, 2) float64, out
        Keys of start and end, from the zenith down, tightly packed within a block.
    needed : (blocks,) int64, out
        Intervals of each block; a block that needs more than the capacity is left unwritten.
    tally : (n, N_TALLY) int64, zero, out
        NODES are blocks of 16 boxes, EDGES are faces here, CROSSINGS are faces on open lines, SPHERE are
        faces that reach out.
    block : int
        Which block of the points.
    """
    first, last = block * per_block, min((block + 1) * per_block, len(points))
    n_lines = len(lines)
    squares, corner_distances = np.empty(2 * n_lines, np.float32), np.empty(WIDTH)
    if reach is not None:
        for k in range(2 * n_lines):
            r = reach[k % n_lines]
            # Boxes have a margin of their own; only the square is rounded here.
            squares[k] = min(r * r * (1.0 + 1e-5) + 1e-37, 1e38)
    view = np.empty(N_VIEW, np.float32)
    stack = np.empty((WIDTH * len(bundles.levels), 4), np.int32)
    stack_keys = np.empty((WIDTH * len(bundles.levels), N_SEEN), np.float32)
    seen, ranges = np.empty(N_SEEN * WIDTH, np.float32), np.empty(2 * WIDTH, np.int32)
    keys, spans = np.empty(N_KEYS * WIDTH), np.empty(N_SPANS * WIDTH, np.int32)
    cuts, cut_lines = np.empty(2 * (WIDTH * n_lines + 1)), np.empty(WIDTH * n_lines + 1, np.int32)
    # Lines twice over, so that a range that runs past the last needs no second thought.
    twice = np.empty((2 * n_lines, 2))
    for k in range(2 * n_lines):
        twice[k, 0], twice[k, 1] = lines[k % n_lines, 0], lines[k % n_lines, 1]
    tops, bottoms = np.empty(2 * n_lines), np.empty(2 * n_lines)
    n_open, opened = np.empty(n_lines, np.int32), np.empty(ROOM * n_lines)
    found = np.empty((2 * (last - first) * n_lines, 2))
    n_found = 0
    for i in range(first, last):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        frame = frames[i]
        set_view(p, n, frame, n_lines, view)
        while True:
            stride = len(opened) // n_lines
            for k in range(n_lines):
                n_open[k] = 1
                opened[k * stride], opened[k * stride + 1] = np.inf, horizon[k]
                tops[k], tops[k + n_lines] = np.inf, np.inf
                bottoms[k], bottoms[k + n_lines] = horizon[k], horizon[k]
            if _cover(
                geometry.vertices,
                geometry.faces,
                geometry.face_planes,
                geometry.planes,
                geometry.plane_errors,
                bundles.order,
                bundles.nodes,
                bundles.levels,
                bundles.corners,
                p,
                n,
                frame,
                twice,
                view,
                stack,
                stack_keys,
                seen,
                ranges,
                keys,
                spans,
                cuts,
                cut_lines,
                opened,
                n_open,
                tops,
                bottoms,
                reach,
                one_sided,
                squares,
                corner_distances,
                tally[i],
            ):
                break
            opened = np.empty(2 * len(opened))
        total = 0
        for k in range(n_lines):
            counts[i, k] = n_open[k]
            total += n_open[k]
        if n_found + total > len(found):
            found = grow_rows(found, 2 * len(found) + total)
        starts[i] = n_found
        for k in range(n_lines):
            for j in range(k * stride, k * stride + 2 * n_open[k], 2):
                found[n_found, 0], found[n_found, 1] = opened[j], opened[j + 1]
                n_found += 1
    needed[block] = n_found
    if n_found <= intervals.shape[1]:
        for j in range(n_found):
            intervals[block, j, 0], intervals[block, j, 1] = found[j, 0], found[j, 1]
