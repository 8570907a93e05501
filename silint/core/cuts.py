"""What faces hide of radial isolines: cuts, and the open intervals that they leave.

The faces of a bundle are put in the frame 16 at a time, each cut is an interval of keys on one line, and cuts
are taken from the line's list of open intervals. Keys have the bits that `crossings` gives them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.caps import cap_on_line, plane_towards
from silint.core.contour import plane_side
from silint.core.face_bundles import CORNER_BLOCK
from silint.core.jit import FILTER, INNER
from silint.core.lanes import WIDTH
from silint.core.radial import (
    AT_POINT,
    azimuth,
    edge_circle,
    in_frame,
    local_vertex,
    sector,
    span,
)

# Where the faces of a bundle are seen. A and B of three edges: the long one, which spans all lines of the
# face, then the two short ones.
N_KEYS = 6
# First line, number of lines, those of the first short edge; 0, or how often the edges wind round the axis.
N_SPANS = 4

# Room for the ends of a line's open intervals at first; what says that there is too little.
ROOM, FULL = 16, -1

_UW = np.uint64(WIDTH)
_U1, _U2, _U3, _U4, _U5, _U6, _U7, _U8 = (np.uint64(i * WIDTH) for i in range(1, 9))


@njit(**INNER)
def project_faces(corners, bundle, p, n, frame, n_lines, keys, spans):
    """Spans of lines and coefficients of keys of 16 faces, as `crossings` has them edge by edge.

    Returns the set of faces that reach a line above the horizon.
    """
    base = np.uint64(bundle) * np.uint64(CORNER_BLOCK)
    f00, f01, f02 = frame[0, 0], frame[0, 1], frame[0, 2]
    f10, f11, f12 = frame[1, 0], frame[1, 1], frame[1, 2]
    f20, f21, f22 = frame[2, 0], frame[2, 1], frame[2, 2]
    p0, p1, p2 = p
    n0, n1, n2 = n
    m0, m1, m2 = -AT_POINT * n0, -AT_POINT * n1, -AT_POINT * n2
    per_radian = n_lines / (2.0 * np.pi)
    n_lines = np.int32(n_lines)
    zero = np.int32(0)
    mask = np.uint32(0)
    for i in range(_UW):
        j = base + i
        ax, ay, az = corners[j], corners[j + _U1], corners[j + _U2]
        bx, by, bz = corners[j + _U3], corners[j + _U4], corners[j + _U5]
        cx, cy, cz = corners[j + _U6], corners[j + _U7], corners[j + _U8]
        ux, uy, uz = bx - ax, by - ay, bz - az  # a to b
        vx, vy, vz = cx - bx, cy - by, cz - bz  # b to c
        wx, wy, wz = cx - ax, cy - ay, cz - az  # a to c
        ax, ay, az = ax - p0, ay - p1, az - p2
        bx, by, bz = bx - p0, by - p1, bz - p2
        cx, cy, cz = cx - p0, cy - p1, cz - p2
        # A vertex at the shade point is seen along -n.
        at = (ax == 0.0) & (ay == 0.0) & (az == 0.0)
        ax, ay, az = m0 if at else ax, m1 if at else ay, m2 if at else az
        at = (bx == 0.0) & (by == 0.0) & (bz == 0.0)
        bx, by, bz = m0 if at else bx, m1 if at else by, m2 if at else bz
        at = (cx == 0.0) & (cy == 0.0) & (cz == 0.0)
        cx, cy, cz = m0 if at else cx, m1 if at else cy, m2 if at else cz
        a_above = n0 * ax + n1 * ay + n2 * az > 0.0
        b_above = n0 * bx + n1 * by + n2 * bz > 0.0
        c_above = n0 * cx + n1 * cy + n2 * cz > 0.0

        at, am = f00 * ax + f01 * ay + f02 * az, f10 * ax + f11 * ay + f12 * az
        bt, bm = f00 * bx + f01 * by + f02 * bz, f10 * bx + f11 * by + f12 * bz
        ct, cm = f00 * cx + f01 * cy + f02 * cz, f10 * cx + f11 * cy + f12 * cz
        aa, ba = f20 * ax + f21 * ay + f22 * az, f20 * bx + f21 * by + f22 * bz
        sector_a = np.int32(azimuth(at, am) * per_radian + 0.5)
        sector_a = sector_a if sector_a < n_lines else zero
        sector_b = np.int32(azimuth(bt, bm) * per_radian + 0.5)
        sector_b = sector_b if sector_b < n_lines else zero
        sector_c = np.int32(azimuth(ct, cm) * per_radian + 0.5)
        sector_c = sector_c if sector_c < n_lines else zero

        # Great circles (radial.edge_circle).
        ut, um, ua = (
            f00 * ux + f01 * uy + f02 * uz,
            f10 * ux + f11 * uy + f12 * uz,
            f20 * ux + f21 * uy + f22 * uz,
        )
        turn_u = at * um - am * ut
        scale = -1.0 / turn_u
        u_along, u_across = (am * ua - aa * um) * scale, (aa * ut - at * ua) * scale
        vt, vm, va = (
            f00 * vx + f01 * vy + f02 * vz,
            f10 * vx + f11 * vy + f12 * vz,
            f20 * vx + f21 * vy + f22 * vz,
        )
        turn_v = bt * vm - bm * vt
        scale = -1.0 / turn_v
        v_along, v_across = (bm * va - ba * vm) * scale, (ba * vt - bt * va) * scale
        wt, wm, wa = (
            f00 * wx + f01 * wy + f02 * wz,
            f10 * wx + f11 * wy + f12 * wz,
            f20 * wx + f21 * wy + f22 * wz,
        )
        turn_w = at * wm - am * wt
        scale = -1.0 / turn_w
        w_along, w_across = (am * wa - aa * wm) * scale, (aa * wt - at * wa) * scale
        # What does not rise above the horizon ends at the horizon.
        u_along = u_along if a_above | b_above else np.nan
        v_along = v_along if b_above | c_above else np.nan
        w_along = w_along if a_above | c_above else np.nan

        # Lines crossed the short way (radial.span), negative to the right.
        u = sector_b - sector_a
        u = u + n_lines if u < zero else u
        u = u if (u + u < n_lines) | ((u + u == n_lines) & (turn_u > 0.0)) else u - n_lines
        v = sector_c - sector_b
        v = v + n_lines if v < zero else v
        v = v if (v + v < n_lines) | ((v + v == n_lines) & (turn_v > 0.0)) else v - n_lines
        w = sector_c - sector_a
        w = w + n_lines if w < zero else w
        w = w if (w + w < n_lines) | ((w + w == n_lines) & (turn_w > 0.0)) else w - n_lines

        # The edge that spans most, and the way round by the other two in rising order of lines.
        abs_u, abs_v, abs_w = abs(u), abs(v), abs(w)
        u_long = (abs_u >= abs_v) & (abs_u > abs_w)
        v_long = (abs_v > abs_u) & (abs_v > abs_w)
        left = (u if u_long else (v if v_long else w)) >= zero
        keys[i] = u_along if u_long else (v_along if v_long else w_along)
        keys[i + _U1] = u_across if u_long else (v_across if v_long else w_across)
        # a to b by w and v, b to c by u and w, a to c by u and v; to the right from the far end.
        one_along = w_along if u_long else u_along
        one_across = w_across if u_long else u_across
        one_count = abs_w if u_long else abs_u
        two_along = w_along if v_long else v_along
        two_across = w_across if v_long else v_across
        two_count = abs_w if v_long else abs_v
        keys[i + _U2] = one_along if left else two_along
        keys[i + _U3] = one_across if left else two_across
        keys[i + _U4] = two_along if left else one_along
        keys[i + _U5] = two_across if left else one_across
        from_left = sector_b if v_long else sector_a
        from_right = sector_b if u_long else sector_c
        count = abs_u if u_long else (abs_v if v_long else abs_w)
        spans[i] = from_left if left else from_right
        spans[i + _U1] = count
        spans[i + _U2] = one_count if left else two_count
        spans[i + _U3] = u + v - w
        hit = (a_above | b_above | c_above) & (count > zero)
        mask |= np.uint32(hit) << np.uint32(i)
    return np.int64(mask)


@njit(**INNER)
def meets_open(opened, n_open, tops, bottoms, stride, first, count, low, high):
    """True where one of `count` lines has an open interval that meets the keys from low to high."""
    near = False
    for k in range(np.uint64(first), np.uint64(first + count)):
        near |= (tops[k] > low) & (bottoms[k] < high)
    if not near:
        return False
    n_lines = len(n_open)
    for i in range(first, first + count):
        if tops[i] > low and bottoms[i] < high:
            k = i if i < n_lines else i - n_lines
            for j in range(k * stride, k * stride + 2 * n_open[k], 2):
                if opened[j + 1] < high:
                    if opened[j] > low:
                        return True
                    break
    return False


@njit(**INNER)
def meets_near(opened, n_open, tops, bottoms, squares, stride, first, count, low, high, square):
    """As `meets_open`, on lines that reach as far as what is at this squared distance.

    `squares` (2 K,) are those of how far lines reach, float32 and rounded up, twice over.
    """
    near = False
    for k in range(np.uint64(first), np.uint64(first + count)):
        near |= (tops[k] > low) & (bottoms[k] < high) & (square < squares[k])
    if not near:
        return False
    n_lines = len(n_open)
    for i in range(first, first + count):
        if tops[i] > low and bottoms[i] < high and square < squares[i]:
            k = i if i < n_lines else i - n_lines
            for j in range(k * stride, k * stride + 2 * n_open[k], 2):
                if opened[j + 1] < high:
                    if opened[j] > low:
                        return True
                    break
    return False


@njit(**INNER)
def list_cuts(keys, spans, i, lines, tops, bottoms, cuts, cut_lines, n_cuts):
    """Append what face i of a bundle hides on lines that are open there; returns the number of cuts.

    Without a branch but for the loop: what is not wanted is written over by the next.
    """
    n_lines = len(lines) // 2
    along, across = keys[i], keys[WIDTH + i]
    along_1, across_1 = keys[2 * WIDTH + i], keys[3 * WIDTH + i]
    along_2, across_2 = keys[4 * WIDTH + i], keys[5 * WIDTH + i]
    first = spans[i]
    turn_at = first + spans[2 * WIDTH + i]
    for k in range(first, first + spans[WIDTH + i]):
        c, s = lines[k, 0], lines[k, 1]
        y = along * c + across * s
        z = (along_1 if k < turn_at else along_2) * c + (across_1 if k < turn_at else across_2) * s
        # NaN lies below the horizon.
        y = y if y > -np.inf else -np.inf
        z = z if z > -np.inf else -np.inf
        low = y if y < z else z
        high = z if y < z else y
        cut_lines[n_cuts] = k if k < n_lines else k - n_lines
        cuts[2 * n_cuts], cuts[2 * n_cuts + 1] = high, low
        n_cuts += int((low < tops[k]) & (high > bottoms[k]) & (low < high))
    return n_cuts


@njit(**INNER)
def list_round_cuts(
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
):
    """The same for a face that lies at the zenith or at the nadir: it hides one end of every line."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    # `winding` runs through the corners in rising order; see zenith.zenith_count.
    if int(a > b) + int(b > c) + int(c > a) == 2:
        winding = -winding
    code = face_planes[f]
    plane = max(code, ~code)
    in_front = (plane_side(planes, plane, plane_errors[plane] + rounding, p, n) > 0) == (code >= 0)
    up = (winding < 0) == in_front
    n_lines = len(lines) // 2
    for i in range(3):
        u, v = faces[f, i], faces[f, (i + 1) % 3]
        u, v = min(u, v), max(u, v)
        at, am, aa, a_height = local_vertex(vertices, u, p, n, frame)
        bt, bm, _, b_height = local_vertex(vertices, v, p, n, frame)
        et, em, ea = in_frame(
            vertices[v, 0] - vertices[u, 0],
            vertices[v, 1] - vertices[u, 1],
            vertices[v, 2] - vertices[u, 2],
            frame,
        )
        along, across, turn = edge_circle(at, am, aa, et, em, ea)
        first, count, _ = span(sector(at, am, n_lines), sector(bt, bm, n_lines), turn, n_lines)
        above = a_height > 0.0 or b_height > 0.0
        for k in range(first, first + count):
            y = along * lines[k, 0] + across * lines[k, 1]
            y = y if above and y > -np.inf else -np.inf
            cut_lines[n_cuts] = k if k < n_lines else k - n_lines
            cuts[2 * n_cuts], cuts[2 * n_cuts + 1] = np.inf if up else y, y if up else -np.inf
            n_cuts += 1
    return n_cuts


@njit(**INNER)
def faces_away(face_planes, planes, plane_errors, f, p, n, rounding):
    """True where p sees a face from its back."""
    code = face_planes[f]
    k = max(code, ~code)
    return (plane_side(planes, k, plane_errors[k] + rounding, p, n) > 0) != (code >= 0)


@njit(**FILTER)
def farthest_corners(corners, bundle, x, y, z, farthest):
    """Squared distance from a point of the farthest corner of each of 16 faces, to rounding."""
    base = np.uint64(bundle) * np.uint64(CORNER_BLOCK)
    for i in range(_UW):
        j = base + i
        ax, ay, az = corners[j] - x, corners[j + _U1] - y, corners[j + _U2] - z
        bx, by, bz = corners[j + _U3] - x, corners[j + _U4] - y, corners[j + _U5] - z
        cx, cy, cz = corners[j + _U6] - x, corners[j + _U7] - y, corners[j + _U8] - z
        a, b, c = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
        a = b if b > a else a
        farthest[i] = c if c > a else a


@njit(**INNER)
def keep_near(
    face_planes,
    planes,
    plane_errors,
    f,
    p,
    frame,
    lines,
    reach,
    farthest,
    rounding,
    cuts,
    cut_lines,
    first,
    end,
):
    """Narrow the cuts [first, end) of a face to where it is within the reach (K,) of their lines.

    `farthest` is the squared distance of its farthest corner. Returns where the cuts end now.
    """
    farthest *= 1.0 + 1e-9
    within = True
    for c in range(first, end):
        r = reach[cut_lines[c]]
        within = within and farthest < r * r
    if within:
        return end
    height, (t, m, a) = plane_towards(face_planes, planes, f, p, frame)
    code = face_planes[f]
    if height <= plane_errors[max(code, ~code)] + rounding:
        return end  # seen from its edge, if at all
    n_cuts = first
    for c in range(first, end):
        line = cut_lines[c]
        high, low = cuts[2 * c], cuts[2 * c + 1]
        r = reach[line]
        if farthest >= r * r:
            start, stop = cap_on_line(a, t * lines[line, 0] + m * lines[line, 1], height / r)
            high, low = min(high, start), max(low, stop)
        cut_lines[n_cuts] = line
        cuts[2 * n_cuts], cuts[2 * n_cuts + 1] = high, low
        n_cuts += int(low < high)
    return n_cuts


@njit(**INNER)
def hide_cuts(cuts, cut_lines, n_cuts, opened, n_open, tops, bottoms, stride):
    """Take cuts from the open intervals of lines, which run from the zenith down.

    Returns how many lines have nothing left; FULL where there is no room to split an interval.
    """
    n_lines = len(n_open)
    closed = 0
    for c in range(n_cuts):
        k, high, low = cut_lines[c], cuts[2 * c], cuts[2 * c + 1]
        if not (tops[k] > low and bottoms[k] < high):
            continue
        first = k * stride
        end = first + 2 * n_open[k]
        # The first interval that reaches below the cut's start.
        at = first
        for _ in range(n_open[k]):
            if opened[at + 1] < high:
                break
            at += 2
        if opened[at] <= low:
            continue
        if opened[at] > high:
            if opened[at + 1] < low:
                if end == first + stride:
                    closed = FULL
                    break
                for i in range(end - 1, at, -1):
                    opened[i + 2] = opened[i]
                opened[at + 1], opened[at + 2] = high, low
                n_open[k] += 1
                continue
            opened[at + 1] = high
            at += 2
        # Those that the cut swallows, and the one that it shortens from above.
        rest = at
        for _ in range((end - at) // 2):
            if opened[rest + 1] < low:
                break
            rest += 2
        if rest < end and opened[rest] > low:
            opened[rest] = low
        for i in range(end - rest):
            opened[at + i] = opened[rest + i]
        end -= rest - at
        n_open[k] = (end - first) // 2
        top, bottom = -np.inf, np.inf
        if end > first:
            top, bottom = opened[first], opened[end - 1]
        else:
            closed += 1
        tops[k], tops[k + n_lines], bottoms[k], bottoms[k + n_lines] = top, top, bottom, bottom
    return closed
