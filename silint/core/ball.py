"""What lies within a maximum distance of a shade point: its edges, and the faces that leave the ball."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload

from silint.core.ball_hits import Hits, clip_contours, new_hits
from silint.core.jit import INNER
from silint.core.lanes import WIDTH
from silint.core.search import P_PER_RADIAN
from silint.core.sphere_search import FaceSearch, find_faces, gather_faces, new_face_search

# Ends of one arc at most: its own, four where azimuth turns back or is cut, and those of long pieces. Two
# more are scratch.
MOST_ENDS, N_END = 12, 7
# Numbers for ends that are neither hits nor on the horizon, for each face: three arcs have no more.
ENDS_OF_FACE = 3 * MOST_ENDS

# Sectors a radian, so narrow that by the roughness of azimuths alone nothing lies between two lines; but few
# enough for float32.
_EVERY_SECTOR = 1e5


class Ball(NamedTuple):
    """The ball about a shade point, and scratch; with room for so many edges of a sweep."""

    reach: float
    reaches: np.ndarray  # (1,) float64: the same
    faces: FaceSearch  # faces that may leave it
    shell: np.ndarray  # (32,) float32, scratch of the search
    sectors: np.ndarray  # (32,) int32
    hits: Hits  # where edges leave it
    cuts: np.ndarray  # (capacity, 2) int32: what of contour edges lies within, see `ball_hits.clip_contours`
    offsets: np.ndarray  # (capacity,) float64: c of those edges of the sweep that are ROUND
    stops: (
        np.ndarray
    )  # (pairs, 3) float64: azimuth, its cosine and sine, at which the sweep looks at its order
    around: np.ndarray  # (6, 2) int64: hits round a face, and whether the edge enters the ball there
    ends: np.ndarray  # (MOST_ENDS + 2, N_END) float64: of an arc


@njit(**INNER)
def _ball(reach, faces, hits, capacity, pairs):
    reaches = np.empty(1)
    reaches[0] = reach
    return Ball(
        reach,
        reaches,
        faces,
        np.empty(2 * WIDTH, np.float32),
        np.empty(2 * WIDTH, np.int32),
        hits,
        np.empty((capacity, 2), np.int32),
        np.empty(capacity),
        np.empty((pairs, 3)),
        np.empty((6, 2), np.int64),
        np.empty((MOST_ENDS + 2, N_END)),
    )


@njit(**INNER)
def _new_ball(reach, n_levels, capacity, pairs):
    return _ball(reach, new_face_search(np.int64(1), n_levels), new_hits(256), capacity, pairs)


def ball_of(reach, n_levels, capacity, pairs):
    """A ball with so much room, and a tree of faces with so many levels; None for no `reach`.

    An overload, so that what only a ball needs is not even compiled without one.
    """
    return None if reach is None else _new_ball(reach, n_levels, capacity, pairs)


@overload(ball_of)
def _ball_of(reach, n_levels, capacity, pairs):
    if isinstance(reach, types.NoneType):
        return lambda reach, n_levels, capacity, pairs: None
    return lambda reach, n_levels, capacity, pairs: _new_ball(reach, n_levels, capacity, pairs)


@njit(**INNER)
def with_room(ball, capacity, pairs):
    """The same ball with room for more edges and stops of a sweep; what it holds of edges is kept."""
    wider = _ball(ball.reach, ball.faces, ball.hits, capacity, pairs)
    for i in range(min(len(ball.cuts), capacity)):
        wider.cuts[i, 0], wider.cuts[i, 1] = ball.cuts[i, 0], ball.cuts[i, 1]
    return wider


@njit(**INNER)
def near_faces(ball, bundles, tile, q, tally):
    """The ball with the faces that may leave it about any point of a tile; see `sphere_search`."""
    for i in range(len(q)):
        q[i, P_PER_RADIAN] = _EVERY_SECTOR
    faces = gather_faces(ball.faces, bundles, tile, ball.reaches, tally)
    return _with(ball, faces, ball.hits)


@njit(**INNER)
def _with(ball, faces, hits):
    return Ball(
        ball.reach,
        ball.reaches,
        faces,
        ball.shell,
        ball.sectors,
        hits,
        ball.cuts,
        ball.offsets,
        ball.stops,
        ball.around,
        ball.ends,
    )


@njit(**INNER)
def clip_to_ball(ball, vertices, p, n, contours, n_contours, q, tally):
    """Leave of the contour edges of a point what lies within the ball.

    Returns
    -------
    ball : Ball
        Perhaps with longer arrays.
    n_contours : int
        Edges that are left.
    n_rows : int
        Edges in `ball.hits`, which has room for those of all faces.
    n_faces : int
        Faces that may leave the ball, in `ball.faces.found`.
    """
    n_faces = find_faces(ball.faces, q, ball.reaches, ball.shell, ball.sectors, tally)
    hits = ball.hits
    if len(hits.ends) < 3 * n_faces + n_contours:
        hits = new_hits(2 * (3 * n_faces + n_contours))
    else:
        hits.slots[:] = 0
    n_contours, n_rows = clip_contours(contours, n_contours, hits, vertices, p, n, ball.reach, ball.cuts)
    return _with(ball, ball.faces, hits), n_contours, n_rows, n_faces


@njit(**INNER)
def closed_places(n_vertices, ball, n_faces):
    """Numbers of places where edges follow each other: vertices, hits, and ends of pieces of arcs."""
    return n_vertices + 2 * len(ball.hits.ends) + ENDS_OF_FACE * n_faces
