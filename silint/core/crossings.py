"""Where edges cross radial isolines, decided in float64, 16 edges at a time.

Fetch the vertices and sides of 16 edges, put them in the frame in one loop over the lanes that compilers
turn into vector code, then record the crossings one by one. All is in the order of the edges, and without
contracted products: a crossing has the same bits wherever it is computed (radial.edge_circle,
radial.sector).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.caps import crosses_near
from silint.core.contour import CONTOURS, SNAPPED, edge_jump
from silint.core.jit import INNER
from silint.core.lanes import WIDTH
from silint.core.radial import AT_POINT, azimuth, in_frame

# Fields of 16 lanes: the ends from the shade point, the edge, and what comes of them: A and B of the key.
N_LANE_FIELDS = 11
# The jump; first line, number of lines, and whether W falls by the jump or rises.
N_SPAN_FIELDS = 4

_UW = np.uint64(WIDTH)
_U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8, _U9, _U10 = (np.uint64(i * WIDTH) for i in range(1, 11))


@njit(**INNER)
def _project(lanes, spans, n, frame, n_lines):
    """Spans of lines and coefficients of keys of 16 edges; edges below the horizon span nothing."""
    f00, f01, f02 = frame[0, 0], frame[0, 1], frame[0, 2]
    f10, f11, f12 = frame[1, 0], frame[1, 1], frame[1, 2]
    f20, f21, f22 = frame[2, 0], frame[2, 1], frame[2, 2]
    n0, n1, n2 = n
    per_radian = n_lines / (2.0 * np.pi)
    n_lines = np.int32(n_lines)
    zero = np.int32(0)
    for i in range(_UW):
        ax, ay, az = lanes[i], lanes[i + _U1], lanes[i + _U2]
        bx, by, bz = lanes[i + _U3], lanes[i + _U4], lanes[i + _U5]
        ex, ey, ez = lanes[i + _U6], lanes[i + _U7], lanes[i + _U8]
        at, am, aa = (
            f00 * ax + f01 * ay + f02 * az,
            f10 * ax + f11 * ay + f12 * az,
            f20 * ax + f21 * ay + f22 * az,
        )
        bt, bm = f00 * bx + f01 * by + f02 * bz, f10 * bx + f11 * by + f12 * bz
        et, em, ea = (
            f00 * ex + f01 * ey + f02 * ez,
            f10 * ex + f11 * ey + f12 * ez,
            f20 * ex + f21 * ey + f22 * ez,
        )
        above = (n0 * ax + n1 * ay + n2 * az > 0.0) | (n0 * bx + n1 * by + n2 * bz > 0.0)

        # Sectors, as radial.sector.
        sector_a = np.int32(azimuth(at, am) * per_radian + 0.5)
        sector_a = sector_a if sector_a < n_lines else zero
        sector_b = np.int32(azimuth(bt, bm) * per_radian + 0.5)
        sector_b = sector_b if sector_b < n_lines else zero

        # The great circle (radial.edge_circle) and the lines it crosses the short way (radial.span).
        turn = at * em - am * et
        scale = -1.0 / turn
        lanes[i + _U9] = (am * ea - aa * em) * scale
        lanes[i + _U10] = (aa * et - at * ea) * scale
        steps = sector_b - sector_a
        steps = steps + n_lines if steps < zero else steps
        left = (steps + steps < n_lines) | ((steps + steps == n_lines) & (turn > 0.0))
        first = sector_a if left else sector_b
        steps = steps if left else n_lines - steps
        jump = spans[i]
        spans[i + _U1] = first
        spans[i + _U2] = steps if above & (sector_a != sector_b) else zero
        spans[i + _U3] = -jump if left else jump


@njit(**INNER)
def _fetch(
    vertices,
    planes,
    plane_errors,
    ends,
    offsets,
    codes,
    ids,
    sides,
    first,
    last,
    p,
    n,
    rounding,
    lanes,
    spans,
):
    """Vertices and jumps of up to 16 edges. Returns the number of sides that were snapped."""
    snapped = 0
    pairs = len(offsets) == 0
    for i in range(last - first):
        e = ids[first + i]
        a, b = ends[e, 0], ends[e, 1]
        ax, ay, az = vertices[a, 0] - p[0], vertices[a, 1] - p[1], vertices[a, 2] - p[2]
        bx, by, bz = vertices[b, 0] - p[0], vertices[b, 1] - p[1], vertices[b, 2] - p[2]
        # A vertex at the shade point is seen along -n.
        if ax == 0.0 and ay == 0.0 and az == 0.0:
            ax, ay, az = -AT_POINT * n[0], -AT_POINT * n[1], -AT_POINT * n[2]
        if bx == 0.0 and by == 0.0 and bz == 0.0:
            bx, by, bz = -AT_POINT * n[0], -AT_POINT * n[1], -AT_POINT * n[2]
        lanes[i], lanes[WIDTH + i], lanes[2 * WIDTH + i] = ax, ay, az
        lanes[3 * WIDTH + i], lanes[4 * WIDTH + i], lanes[5 * WIDTH + i] = bx, by, bz
        lanes[6 * WIDTH + i] = vertices[b, 0] - vertices[a, 0]
        lanes[7 * WIDTH + i] = vertices[b, 1] - vertices[a, 1]
        lanes[8 * WIDTH + i] = vertices[b, 2] - vertices[a, 2]
        if pairs and sides[first + i] != 0:
            spans[i] = -2 * sides[first + i]
            continue
        start = 2 * e if pairs else offsets[e]
        jump, more = edge_jump(
            planes, plane_errors, codes, start, start + 2 if pairs else offsets[e + 1], p, n, rounding
        )
        snapped += more
        spans[i] = jump
    return snapped


@njit(**INNER)
def cross_edges(
    vertices,
    planes,
    plane_errors,
    ends,
    offsets,
    codes,
    ids,
    sides,
    first,
    last,
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
    tally,
):
    """Record where the edges ids[first:last] cross lines above the horizon.

    Parameters
    ----------
    horizon : (K,) float64
        Key of the horizon on each line.
    reach : (K,) float64 or None
        What lies farther on a line does not count; None for no limit.
    lanes, spans : (N_LANE_FIELDS * 16,) float64, (N_SPAN_FIELDS * 16,) int32
        Scratch.
    count : (K,) int32
        Crossings of each line, added to.
    key, gain : (K * capacity,) float64, int32
        Crossings of line k from k * capacity on: key, and the gain of W as the key falls.

    Returns
    -------
    False where a line has no room left.
    """
    n_lines = len(lines)
    contours, snapped = 0, 0
    for chunk in range(first, last, WIDTH):
        end = min(chunk + WIDTH, last)
        snapped += _fetch(
            vertices,
            planes,
            plane_errors,
            ends,
            offsets,
            codes,
            ids,
            sides,
            chunk,
            end,
            p,
            n,
            rounding,
            lanes,
            spans,
        )
        _project(lanes, spans, n, frame, n_lines)
        for i in range(end - chunk):
            step = spans[3 * WIDTH + i]
            steps = spans[2 * WIDTH + i]
            if step == 0 or steps == 0:
                continue
            contours += 1
            along, across = lanes[9 * WIDTH + i], lanes[10 * WIDTH + i]
            k = spans[WIDTH + i]
            if reach is not None:
                start = in_frame(lanes[i], lanes[WIDTH + i], lanes[2 * WIDTH + i], frame)
                chord = in_frame(lanes[6 * WIDTH + i], lanes[7 * WIDTH + i], lanes[8 * WIDTH + i], frame)
            for _ in range(steps):
                y = along * lines[k, 0] + across * lines[k, 1]
                counts = y > horizon[k]
                if reach is not None:
                    counts = counts and crosses_near(start, chord, lines[k, 0], lines[k, 1], reach[k])
                if counts:
                    c = count[k]
                    if c == capacity:
                        return False
                    key[k * capacity + c] = y
                    gain[k * capacity + c] = step
                    count[k] = c + 1
                k = k + 1 if k + 1 < n_lines else 0
    tally[CONTOURS] += contours
    tally[SNAPPED] += snapped
    return True
