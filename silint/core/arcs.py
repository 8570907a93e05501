"""Exact phase one: tiles of shade points to the boundary arcs of what they see.

    bundles near the tile -> edges of the point -> contours -> arcs of the sphere -> W from the axis -> sweep

The search is that of the isolines, without their lines: every contour edge above the horizon matters. A
point whose depth counts contradict each other is done once more in another frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.along import N_AXIS, faces_along, set_axis
from silint.core.arc_edges import N_LANE_FIELDS, direct_edges, half_turn, passes_through, turns_left
from silint.core.arrangement import new_sweep, sweep_arcs
from silint.core.ball import ball_of, clip_to_ball, closed_places, near_faces, with_room
from silint.core.ball_arcs import cut_faces, face_circle
from silint.core.boundary import place_arcs
from silint.core.contour import CONTOURS, CROSSINGS, decide_contours, plane_side, side_rounding
from silint.core.jit import BLOCK, INNER
from silint.core.lanes import WIDTH
from silint.core.radial import azimuth, in_frame, local_vertex, set_frame
from silint.core.search import N_POINT, N_TILE, TILE, new_search, search_tile, set_point, set_tile


def _second_rotation() -> np.ndarray:
    """Of the second frame in the first: turned by 2 about the axis, then tilted by 0.3."""
    c, s = np.cos(2.0), np.sin(2.0)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    c, s = np.cos(0.3), np.sin(0.3)
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    rows: np.ndarray = tilt @ turn
    return rows


_R = tuple(tuple(float(x) for x in row) for row in _second_rotation())
# Lines so dense that no edge lies between two of them (filters.octahedral_mask).
_EVERYWHERE = 1e6
# Room to begin with: for edges, and for crossings between two events.
_CAPACITY, _PAIRS = 1024, 64


@njit(**INNER)
def _turn_frame(frame):
    """Put the second frame in place of the first."""
    for axis in range(3):
        t, m, a = frame[0, axis], frame[1, axis], frame[2, axis]
        frame[0, axis] = _R[0][0] * t + _R[0][1] * m + _R[0][2] * a
        frame[1, axis] = _R[1][0] * t + _R[1][1] * m + _R[1][2] * a
        frame[2, axis] = _R[2][0] * t + _R[2][1] * m + _R[2][2] * a


@njit(**INNER)
def axis_count(geometry, face_ids, n_along, p, n, frame, rounding, ball):
    """W along the axis of the frame: the faces that wind round it and leave the depth count as edges say.

    Within a ball, those that the axis meets in it. With the azimuths and directions of arc_edges, so that
    this count and the sweep cannot disagree.
    """
    vertices, faces, face_planes = geometry.vertices, geometry.faces, geometry.face_planes
    planes, plane_errors = geometry.planes, geometry.plane_errors
    count = 0
    for i in range(n_along):
        f = face_ids[i]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        at, am, _, _ = local_vertex(vertices, a, p, n, frame)
        bt, bm, _, _ = local_vertex(vertices, b, p, n, frame)
        ct, cm, _, _ = local_vertex(vertices, c, p, n, frame)
        # Clearly beside the axis.
        if (
            min(at, bt, ct) > rounding
            or max(at, bt, ct) < -rounding
            or min(am, bm, cm) > rounding
            or max(am, bm, cm) < -rounding
        ):
            continue
        key_a, key_b, key_c = azimuth(at, am), azimuth(bt, bm), azimuth(ct, cm)
        winding = _passes_start(vertices, a, b, at, am, bt, bm, key_a, key_b, p, n, frame)
        winding += _passes_start(vertices, b, c, bt, bm, ct, cm, key_b, key_c, p, n, frame)
        winding += _passes_start(vertices, c, a, ct, cm, at, am, key_c, key_a, p, n, frame)
        if winding == 0:
            continue
        if ball is not None:
            _, axis, cosine = face_circle(
                face_planes, planes, plane_errors, f, p, n, frame, rounding, ball.reach
            )
            if not axis[2] > cosine:
                continue
        code = face_planes[f]
        k = max(code, ~code)
        side = plane_side(planes, k, plane_errors[k] + rounding, p, n)
        count += (winding < 0) == ((side > 0) == (code >= 0))
    return count


@njit(**INNER)
def _passes_start(vertices, a, b, at, am, bt, bm, key_a, key_b, p, n, frame):
    """+1 where the arc from a to b passes azimuth 0 to the left, -1 to the right, else 0."""
    if a > b:
        return -_passes_start_up(vertices, b, a, bt, bm, key_b, key_a, p, n, frame)
    return _passes_start_up(vertices, a, b, at, am, key_a, key_b, p, n, frame)


@njit(**INNER)
def _passes_start_up(vertices, a, b, at, am, key_a, key_b, p, n, frame):
    ex, ey, ez = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    et, em, _ = in_frame(ex, ey, ez, frame)
    turn = at * em - am * et
    if half_turn(key_a, key_b):
        x, y, z = vertices[a, 0] - p[0], vertices[a, 1] - p[1], vertices[a, 2] - p[2]
        x, y, z = passes_through(x, y, z, ex, ey, ez, n)
        if x != 0.0 or y != 0.0 or z != 0.0:
            dt, dm, _ = in_frame(x, y, z, frame)
            turn = at * dm - am * dt
    if turns_left(key_a, key_b, turn):
        return 1 if key_b < key_a else 0
    return -1 if key_a < key_b else 0


class Scratch(NamedTuple):
    """Of the search for what lies along an axis, and of directing edges."""

    axis: np.ndarray  # (N_AXIS,) float32
    stack: np.ndarray  # (256, 2) int64
    face_ids: np.ndarray  # int32
    lanes: np.ndarray  # (N_LANE_FIELDS * WIDTH,) float64


@njit(**INNER)
def _new_scratch(n_faces):
    """Room for so many faces along an axis."""
    return Scratch(
        np.empty(N_AXIS, np.float32),
        np.empty((256, 2), np.int64),
        np.empty(n_faces, np.int32),
        np.empty(N_LANE_FIELDS * WIDTH),
    )


@njit(**INNER)
def _along_axis(faces, p, frame, scratch):
    """Faces that the axis of a frame may meet: their number, and the scratch, perhaps a longer one."""
    across, over = (frame[0, 0], frame[0, 1], frame[0, 2]), (frame[1, 0], frame[1, 1], frame[1, 2])
    while True:
        set_axis(p, across, over, (frame[2, 0], frame[2, 1], frame[2, 2]), scratch.axis)
        n_along = faces_along(
            faces.order,
            faces.coarse,
            faces.nodes,
            faces.levels,
            scratch.axis,
            scratch.stack,
            scratch.face_ids,
        )
        if n_along <= len(scratch.face_ids):
            return n_along, scratch
        scratch = _new_scratch(2 * n_along)


@njit(**INNER)
def _sweep_point(
    geometry, faces, contours, n_contours, p, n, rounding, frame, scratch, sweep, ball, n_faces, n_rows
):
    """Boundary arcs of a point, in the first frame that does not contradict itself.

    Parameters
    ----------
    contours : (n_contours or more, 3) int32
    frame : (3, 3) float64, out
        In which the arcs stand.
    scratch : Scratch
    sweep : Sweep
        With room for the contours.
    ball : Ball or None
        With n_faces faces and n_rows edges, see `ball.clip_to_ball`.

    Returns
    -------
    sweep, ball, scratch
        Perhaps with longer arrays.
    n_arcs : int
        Of sweep.arcs.
    crossings : int
    which : int
        1 for the first frame, 2 for the second, 0 where both contradict themselves.
    """
    # Two names, since Numba leaves out what a ball needs only where an argument that stays None says so.
    room, n_closed, which = ball, np.int64(len(geometry.vertices)), 1
    if ball is not None:
        n_closed = np.int64(closed_places(len(geometry.vertices), ball, n_faces))
    set_frame(n, frame)
    while True:
        n_along, scratch = _along_axis(faces, p, frame, scratch)
        w = axis_count(geometry, scratch.face_ids, n_along, p, n, frame, rounding, room)
        n_edges, n_pairs, n_arcs = n_contours, len(sweep.pairs), len(sweep.arcs)
        if ball is not None:
            n_edges, n_rows = cut_faces(
                geometry, room, n_faces, n_rows, p, n, frame, rounding, sweep, n_edges
            )
            if n_edges > len(sweep.edges):
                sweep, room = new_sweep(2 * n_edges, n_pairs, n_arcs), with_room(room, 2 * n_edges, n_pairs)
                continue
        direct_edges(
            geometry.vertices,
            contours,
            n_contours,
            room,
            n_closed,
            p,
            n,
            frame,
            scratch.lanes,
            sweep.edges,
            sweep.circles,
            sweep.state,
            sweep.key,
            sweep.tie,
        )
        seen = in_frame(n[0], n[1], n[2], frame)
        found, sound, crossings = sweep_arcs(sweep, room, n_edges, n_closed, w, seen)
        if sound < 0 or found > n_arcs:
            # Once more, with more room.
            n_pairs = 4 * n_pairs if sound < 0 else n_pairs
            sweep = new_sweep(len(sweep.edges), n_pairs, max(2 * found, n_arcs))
            if ball is not None:
                room = with_room(room, len(sweep.edges), n_pairs)
        elif sound == 0 and which == 1:
            which = 2
            _turn_frame(frame)
        else:
            return sweep, room, scratch, found, crossings, which if sound > 0 else 0


@njit(**BLOCK)
def boundary_arcs(
    geometry,
    contour,
    boundary,
    faces,
    points,
    normals,
    reach,
    per_block,
    counts,
    starts,
    frames,
    all_directions,
    all_edges,
    needed,
    tally,
    block,
):
    """Boundary arcs of what a block of shade points see.

    Parameters
    ----------
    geometry : Topology
    contour, boundary : EdgeBundles
        Of ordinary edges, and of all others.
    faces : FaceBundles
    points, normals : (n, 3) float64
        In scaled units and already displaced, in tile order; unit normals.
    reach : float or None
        Nothing blocks from this distance on. Faces have to have their corners then.
    per_block : int
        Points of a block, a multiple of TILE.
    counts, starts : (n,) int64, out
        Arcs of each point, and the first row of them within its block.
    frames : (n,) int8, out
        1, 2 where the first contradicted itself, 0 where the second did too.
    all_directions, all_edges : (blocks, capacity, 9 or 10) float64, (blocks, capacity, 2) int32, out
        See Arcs, 10 with a reach; tightly packed within a block.
    needed : (blocks,) int64, out
        Arcs of each block, or a little more; where that exceeds the capacity, not all of them are written.
    tally : (n, N_TALLY) int64, zero, out
    block : int
    """
    first, last = block * per_block, min((block + 1) * per_block, len(points))
    directions, ids, trees = all_directions[block], all_edges[block], (contour, boundary)
    frame, tile = np.empty((3, 3)), np.empty(N_TILE, np.float32)
    q, no_lines = np.empty((TILE, N_POINT), np.float32), np.empty((0, 2), np.float32)
    # Not literals, for which everything would be compiled again.
    search, scratch, n_found = new_search(8, 2048), _new_scratch(np.int64(64)), np.int64(0)
    contours = np.empty((_CAPACITY, 3), np.int32)
    sweep = new_sweep(np.int64(_CAPACITY), np.int64(_PAIRS), np.int64(2 * _CAPACITY))
    ball = ball_of(reach, len(faces.levels), np.int64(_CAPACITY), np.int64(_PAIRS))
    n_faces, n_rows, farthest = np.int64(0), np.int64(0), np.inf
    if reach is not None:
        farthest = reach

    for tile_first in range(first, last, TILE):
        tile_last = min(tile_first + TILE, last)
        n_points = tile_last - tile_first
        set_tile(points, normals, tile_first, tile_last, tile, farthest)
        for i in range(tile_first, tile_last):
            p = points[i, 0], points[i, 1], points[i, 2]
            n = normals[i, 0], normals[i, 1], normals[i, 2]
            set_frame(n, frame)
            across, over = (frame[0, 0], frame[0, 1], frame[0, 2]), (frame[1, 0], frame[1, 1], frame[1, 2])
            set_point(p, n, across, over, _EVERYWHERE, tile, q[i - tile_first], farthest)
        search = search_tile(search, trees, tile, q[:n_points], no_lines, tally[tile_first:tile_last], reach)
        if reach is not None:
            ball = near_faces(ball, faces, tile, q[:n_points], tally[tile_first])
        for i in range(tile_first, tile_last):
            p = points[i, 0], points[i, 1], points[i, 2]
            n = normals[i, 0], normals[i, 1], normals[i, 2]
            rounding = side_rounding(p)
            edge_ids, sides, ends = search.ids[i - tile_first], search.sides[i - tile_first], search.ends
            most = ends[i - tile_first, 2]
            if most > len(contours):
                contours = np.empty((2 * most, 3), np.int32)
            if most > len(sweep.edges):
                n_pairs = len(sweep.pairs)
                sweep = new_sweep(2 * most, n_pairs, len(sweep.arcs))
                if reach is not None:
                    ball = with_room(ball, 2 * most, n_pairs)
            n_contours = np.int64(0)
            for which in range(2):
                tree = trees[which]
                lo, hi = ends[i - tile_first, which], ends[i - tile_first, which + 1]
                n_contours = decide_contours(
                    geometry.vertices,
                    geometry.planes,
                    geometry.plane_errors,
                    tree.ends,
                    tree.offsets,
                    tree.codes,
                    edge_ids[lo:hi],
                    sides[lo:hi],
                    p,
                    n,
                    rounding,
                    contours,
                    n_contours,
                    tally[i],
                )
            if reach is not None:
                ball, n_contours, n_rows, n_faces = clip_to_ball(
                    ball, geometry.vertices, p, n, contours, n_contours, q[i - tile_first], tally[i]
                )
            tally[i, CONTOURS] += n_contours
            sweep, ball, scratch, n_arcs, crossings, frames[i] = _sweep_point(
                geometry,
                faces,
                contours,
                n_contours,
                p,
                n,
                rounding,
                frame,
                scratch,
                sweep,
                ball,
                n_faces,
                n_rows,
            )
            tally[i, CROSSINGS] += crossings
            end, seen = n_found + n_arcs, in_frame(n[0], n[1], n[2], frame)
            if end <= len(directions):
                end = place_arcs(
                    sweep.arcs,
                    n_arcs,
                    sweep.edges,
                    sweep.state,
                    ball,
                    seen,
                    frame,
                    directions,
                    ids,
                    n_found,
                )
            counts[i], starts[i] = end - n_found, n_found
            n_found = end
    needed[block] = n_found
