"""Where faces leave the ball about a shade point: small circle arcs for the sweep.

What a face covers within the ball is its triangle and a disc in common: a region whose boundary runs along
edges inside the ball and along arcs of the circle. Round the triangle, edges leave and enter the ball by
turns (`ball_hits`); wherever one leaves it, an arc leads to where the next one enters. An arc is cut into
pieces of rising azimuth, and where it dips under the horizon.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.arc_edges import (
    ACROSS,
    ALONG,
    END,
    FROM,
    GAIN,
    HIGH,
    LOW,
    NARROW,
    NORMAL,
    ROUND,
    SIDE,
    START,
    STEEP,
    TO,
    is_narrow,
    runs_left,
)
from silint.core.ball import ENDS_OF_FACE, MOST_ENDS, N_END, closed_places
from silint.core.ball_hits import comes_inside, edge_row, is_inside
from silint.core.contour import plane_side
from silint.core.jit import INNER
from silint.core.radial import azimuth, in_frame
from silint.core.small_circle import angle_on, circle_about, cross, direction_on, dot, height_on

# Ends of pieces: direction, azimuth, angle about the circle's axis, tie, and whether above the horizon.
_X, _Y, _Z, _KEY, _ANGLE, _TIE, _UP = range(N_END)
# What stands for the vertices of an edge on a small circle: this, and the face.
ON_SPHERE = -2

_TWO_PI = 2.0 * np.pi
_LONGEST = 2.0  # of a piece about its axis: short enough for its ends to tell its length
_CLOSE = 1e-6  # turns closer to none or to a whole one are told by sides


@njit(**INNER)
def face_circle(face_planes, planes, plane_errors, f, p, n, frame, rounding, reach):
    """The side of face f on which p lies, the unit normal towards its plane in the frame, and c."""
    code = face_planes[f]
    k = max(code, ~code)
    side = plane_side(planes, k, plane_errors[k] + rounding, p, n)
    sign = 1.0 if side > 0 else -1.0
    x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
    d = sign * (x * p[0] + y * p[1] + z * p[2] + planes[k, 3])
    c = max(d, 0.0) / reach
    axis = in_frame(-sign * x, -sign * y, -sign * z, frame)
    return (side > 0) == (code >= 0), axis, c if c < 1.0 else 1.0


@njit(**INNER)
def _wrap(angle):
    """An angle of at most a few turns in [0, 2 pi)."""
    while angle < 0.0:
        angle += _TWO_PI
    while angle >= _TWO_PI:
        angle -= _TWO_PI
    return angle


@njit(**INNER)
def _set_end(ends, i, w, angle, tie, up):
    ends[i, _X], ends[i, _Y], ends[i, _Z], ends[i, _KEY] = w[0], w[1], w[2], azimuth(w[0], w[1])
    ends[i, _ANGLE], ends[i, _TIE], ends[i, _UP] = angle, tie, 1.0 if up else 0.0


@njit(**INNER)
def _add_end(ends, n_ends, w, circle, begin, turn, tie, normal):
    """Insert a direction among the ends of an arc, if it lies on it; ends stay sorted by angle."""
    angle = _wrap(angle_on(circle, w) - begin)
    if not 0.0 < angle < turn:
        return n_ends
    i = n_ends
    while ends[i - 1, _ANGLE] > angle:
        for k in range(N_END):
            ends[i, k] = ends[i - 1, k]
        i -= 1
    _set_end(ends, i, w, angle, tie, dot(w, normal) > 0.0)
    return n_ends + 1


@njit(**INNER)
def _add_turns(ends, n_ends, circle, begin, turn, tie, normal):
    """Ends where azimuth turns back on the circle; or four of them, if it goes round."""
    axis, c = circle.axis, circle.c
    if abs(axis[2]) < c:
        # Where the half-plane touches the circle: |(B, N_A)| = c.
        across = np.sqrt(axis[0] * axis[0] + axis[1] * axis[1])
        b = np.sqrt((c - axis[2]) * (c + axis[2]))
        k = b / across if b < across else 1.0
        rest = np.sqrt((1.0 - k) * (1.0 + k))
        for i in range(2):
            s = rest if i == 0 else -rest
            x, y = (k * axis[0] - s * axis[1]) / across, (k * axis[1] + s * axis[0]) / across
            w = b * x / c, b * y / c, axis[2] / c
            n_ends = _add_end(ends, n_ends, w, circle, begin, turn, tie + i, normal)
        return n_ends
    sign = 1.0 if axis[2] > 0.0 else -1.0
    up = sign * axis[0], sign * axis[1], sign * axis[2]
    for i in range(4):
        x, y = 1.0 if i < 2 else -1.0, 1.0 if i % 2 == 0 else -1.0
        a = height_on(up, sign * c, x, y)
        s = 1.0 / np.sqrt(2.0 + a * a)
        n_ends = _add_end(ends, n_ends, (s * x, s * y, s * a), circle, begin, turn, tie + i, normal)
    return n_ends


@njit(**INNER)
def _cut_long(ends, n_ends, circle, begin, tie, normal):
    """Cut pieces that are longer than _LONGEST about their axis; the number of ends and the next tie."""
    i = 0
    while i + 1 < n_ends:
        length = ends[i + 1, _ANGLE] - ends[i, _ANGLE]
        parts = int(length / _LONGEST) + 1
        for _ in range(1, parts):
            angle = ends[i, _ANGLE] + length / parts
            for j in range(n_ends, i + 1, -1):
                for k in range(N_END):
                    ends[j, k] = ends[j - 1, k]
            w = direction_on(circle, begin + angle)
            i += 1
            _set_end(ends, i, w, angle, tie, dot(w, normal) > 0.0)
            n_ends += 1
            tie += 1
        i += 1
    return n_ends, tie


@njit(**INNER)
def _emit(ends, i, j, circle, begin, f, offsets, sweep, count):
    """Append the piece from end i to end j, with the axis on its left, as edge `count`."""
    if count >= len(sweep.edges):
        return count + 1
    edges, circles, state, key, tie = sweep.edges, sweep.circles, sweep.state, sweep.key, sweep.tie
    w = direction_on(circle, begin + 0.5 * (ends[i, _ANGLE] + ends[j, _ANGLE]))
    t, m, _ = cross(circle.axis, w)
    key_i, key_j = ends[i, _KEY], ends[j, _KEY]
    tie_i, tie_j = int(ends[i, _TIE]), int(ends[j, _TIE])
    left = runs_left(w[0] * m - w[1] * t > 0.0, key_i, key_j, tie_i, tie_j)
    sign, a, b = (1.0, i, j) if left else (-1.0, j, i)
    x, y, z = circle.axis
    edges[count, NORMAL], edges[count, NORMAL + 1], edges[count, NORMAL + 2] = sign * x, sign * y, sign * z
    offsets[count] = sign * circle.c
    for k in range(3):
        edges[count, START + k], edges[count, END + k] = ends[a, k], ends[b, k]
    circles[count, ALONG], circles[count, ACROSS] = 0.0, 0.0
    edges[count, LOW], edges[count, HIGH], edges[count, STEEP] = -np.inf, np.inf, 0.0
    if is_narrow(key_i, key_j):
        cot_i, cot_j, cot = _cot(ends[i]), _cot(ends[j]), w[2] / np.sqrt(w[0] * w[0] + w[1] * w[1])
        edges[count, LOW], edges[count, HIGH] = min(cot_i, cot_j, cot), max(cot_i, cot_j, cot)
    # The face is on the left, towards the axis of the frame, if the piece runs as it did.
    state[count, GAIN] = -1 if left else 1
    state[count, FROM], state[count, TO] = ON_SPHERE, f
    state[count, SIDE], state[count, NARROW] = 0, ROUND
    key[2 * count], key[2 * count + 1] = ends[a, _KEY], ends[b, _KEY]
    tie[2 * count], tie[2 * count + 1] = int(ends[a, _TIE]), int(ends[b, _TIE])
    return count + 1


@njit(**INNER)
def _cot(end):
    """cot(theta) at an end."""
    return end[_Z] / np.sqrt(end[_X] * end[_X] + end[_Y] * end[_Y])


@njit(**INNER)
def _put_horizon(ends, row, circle, begin, angle, tie):
    """Write where an arc meets the horizon, as an end."""
    _set_end(ends, row, direction_on(circle, begin + angle), angle, tie, False)


@njit(**INNER)
def _emit_above(ends, i, circle, begin, normal, f, n_closed, offsets, sweep, count):
    """Append what of the piece from end i to end i + 1 lies above the horizon.

    On the circle n.w = level + swing cos(angle - top), which falls through 0 at top + half and rises through
    it at top - half. Whether the ends lie above is known, and the same for all that meets there.
    """
    # Not literals, for which everything would be compiled again.
    i, j, spare, other = np.int64(i), np.int64(i + 1), np.int64(MOST_ENDS), np.int64(MOST_ENDS + 1)
    up_i, up_j = ends[i, _UP] > 0.0, ends[j, _UP] > 0.0
    c, u, v = circle.c, dot(circle.first, normal), dot(circle.second, normal)
    level = c * dot(circle.axis, normal)
    swing = np.sqrt((1.0 - c) * (1.0 + c) * (u * u + v * v))
    half = np.arccos(min(max(-level / swing, -1.0), 1.0)) if swing > 0.0 else 0.0
    before, length = ends[i, _ANGLE], ends[j, _ANGLE] - ends[i, _ANGLE]
    top = azimuth(u, v) - begin - before
    falls, rises = _wrap(top + half), _wrap(top - half)
    if up_i == up_j:
        crosses = abs(level) < swing and falls < length and rises < length and (falls < rises) == up_i
        if not crosses:
            return _emit(ends, i, j, circle, begin, f, offsets, sweep, count) if up_i else count
    elif up_i and falls > length:
        falls = length if falls - length < _TWO_PI - falls else 0.0
    elif up_j and rises > length:
        rises = length if rises - length < _TWO_PI - rises else 0.0
    if up_i:
        _put_horizon(ends, spare, circle, begin, before + falls, n_closed + count)
        count = _emit(ends, i, spare, circle, begin, f, offsets, sweep, count)
    if up_j:
        _put_horizon(ends, spare, circle, begin, before + rises, n_closed + count)
        count = _emit(ends, spare, j, circle, begin, f, offsets, sweep, count)
    if not up_i and not up_j:
        _put_horizon(ends, spare, circle, begin, before + rises, n_closed + count)
        _put_horizon(ends, other, circle, begin, before + falls, n_closed + count)
        count = _emit(ends, spare, other, circle, begin, f, offsets, sweep, count)
    return count


@njit(**INNER)
def _walk_round(faces, f, p, vertices, reach, hits, n_rows, around):
    """Hits round face f in the order of its vertices, with 1 where the edge enters the ball there.

    Returns
    -------
    number : int
        Of hits; 0 where no edge comes inside the ball, -1 where all of the face lies there.
    n_rows : int
    """
    inside, touched = 0, False
    for i in range(3):
        a, b = faces[f, i], faces[f, (i + 1) % 3]
        inside += is_inside(vertices, a, p, reach)
        touched = touched or comes_inside(vertices, min(a, b), max(a, b), p, reach)
    if inside == 3 or not touched:
        return -1 if inside == 3 else 0, n_rows
    number = 0
    entering = not is_inside(vertices, faces[f, 0], p, reach)
    for i in range(3):
        a, b = faces[f, i], faces[f, (i + 1) % 3]
        row, n_rows = edge_row(hits, n_rows, min(a, b), max(a, b), vertices, p, reach)
        for j in range(hits.number[row]):
            k = j if a < b else hits.number[row] - 1 - j
            around[number, 0], around[number, 1] = 2 * row + k, entering
            entering = not entering
            number += 1
    return number, n_rows


@njit(**INNER)
def _turn_between(start, end, angle_start, angle_end, axis, places, frame):
    """Angle of an arc about its axis, from one hit to another, in [0, 2 pi]."""
    turn = _wrap(angle_end - angle_start)
    if _CLOSE < turn < _TWO_PI - _CLOSE:
        return turn
    if start >> 1 != end >> 1:
        return turn if turn < np.pi else 0.0  # next to a corner of the face, just outside the ball
    # Of one edge, which hides a sliver of the disc or all of it but a sliver: by the side of its centre.
    x = places[start, 0] - places[end, 0]
    y = places[start, 1] - places[end, 1]
    z = places[start, 2] - places[end, 2]
    along = in_frame(x, y, z, frame)
    here = in_frame(places[end, 0], places[end, 1], places[end, 2], frame)
    whole = dot(axis, cross(here, along)) > 0.0
    if whole:
        return turn if turn > np.pi else _TWO_PI
    return turn if turn < np.pi else 0.0


@njit(**INNER)
def _holds(faces, f, axis, p, vertices, frame):
    """Whether the foot of the shade point on the plane of a face lies in the face."""
    signs = 0
    for i in range(3):
        a, b = faces[f, i], faces[f, (i + 1) % 3]
        u = in_frame(vertices[a, 0] - p[0], vertices[a, 1] - p[1], vertices[a, 2] - p[2], frame)
        v = in_frame(vertices[b, 0] - p[0], vertices[b, 1] - p[1], vertices[b, 2] - p[2], frame)
        signs += 1 if dot(axis, cross(u, v)) > 0.0 else -1
    return abs(signs) == 3


@njit(**INNER)
def cut_faces(geometry, ball, n_faces, n_rows, p, n, frame, rounding, sweep, count):
    """Append the small circle arcs of faces to the edges of a sweep.

    Parameters
    ----------
    ball : Ball
        With n_faces faces that may leave it, n_rows edges, and room for those of all faces.
    sweep : Sweep, out
    count : int
        Edges so far.

    Returns
    -------
    count : int
        Edges; where it exceeds the capacity, not all of them were written.
    n_rows : int
    """
    faces, vertices = geometry.faces, geometry.vertices
    hits, reach, around, ends = ball.hits, ball.reach, ball.around, ball.ends
    normal = in_frame(n[0], n[1], n[2], frame)
    n_vertices = len(vertices)
    n_hits = n_vertices + 2 * len(hits.ends)
    n_closed = closed_places(n_vertices, ball, n_faces)
    for i in range(n_faces):
        f = ball.faces.found[i]
        number, n_rows = _walk_round(faces, f, p, vertices, reach, hits, n_rows, around)
        if number < 0:
            continue
        front, axis, c = face_circle(
            geometry.face_planes, geometry.planes, geometry.plane_errors, f, p, n, frame, rounding, reach
        )
        if number == 0 and (c >= 1.0 or not _holds(faces, f, axis, p, vertices, frame)):
            continue
        circle, tie = circle_about(axis, c), n_hits + ENDS_OF_FACE * i
        spare = tie + 4  # after those of `_add_turns`
        if number == 0:
            w = direction_on(circle, 0.0)
            _set_end(ends, 0, w, 0.0, spare, dot(w, normal) > 0.0)
            _set_end(ends, 1, w, _TWO_PI, spare, dot(w, normal) > 0.0)
            count, spare = _place(
                ends, circle, 0.0, normal, f, tie, spare + 1, n_closed, ball.offsets, sweep, count
            )
            continue
        for j in range(number):
            if around[j, 1] != 0:
                continue
            # From where an edge leaves the ball to where the next one enters; the other way round, seen from
            # the front. The face is on the left then.
            start, end = around[j, 0], around[(j + 1) % number, 0]
            if front:
                start, end = end, start
            begin = _put_hit(ends, 0, start, n_vertices, circle, hits.places, n, frame)
            turn = _put_hit(ends, 1, end, n_vertices, circle, hits.places, n, frame)
            turn = _turn_between(start, end, begin, turn, axis, hits.places, frame)
            ends[0, _ANGLE], ends[1, _ANGLE] = 0.0, turn
            count, spare = _place(
                ends, circle, begin, normal, f, tie, spare, n_closed, ball.offsets, sweep, count
            )
    return count, n_rows


@njit(**INNER)
def _put_hit(ends, row, hit, n_vertices, circle, places, n, frame):
    """Write where an edge leaves the ball as an end; its angle on the circle.

    Azimuth and height are those that `arc_edges` finds for the edge, bit for bit.
    """
    x, y, z = places[hit, 0], places[hit, 1], places[hit, 2]
    w = in_frame(x, y, z, frame)
    s = 1.0 / np.sqrt(dot(w, w))
    up = n[0] * x + n[1] * y + n[2] * z > 0.0
    _set_end(ends, row, (s * w[0], s * w[1], s * w[2]), 0.0, n_vertices + hit, up)
    ends[row, _KEY] = azimuth(w[0], w[1])
    return angle_on(circle, w)


@njit(**INNER)
def _place(ends, circle, begin, normal, f, tie, spare, n_closed, offsets, sweep, count):
    """Append the arc between the first two ends, in pieces; the number of edges and the next spare tie."""
    n_ends = _add_turns(ends, 2, circle, begin, ends[1, _ANGLE], tie, normal)
    n_ends, spare = _cut_long(ends, n_ends, circle, begin, spare, normal)
    for i in range(n_ends - 1):
        count = _emit_above(ends, i, circle, begin, normal, f, n_closed, offsets, sweep, count)
    return count, spare
