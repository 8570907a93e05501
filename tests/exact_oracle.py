"""The oracle for the exact mode: the boundary of what a point sees, from every edge against every face.

Nothing here is shared with silint.core: no contour, no sweep, no sign of a plane, no hierarchy. Every edge of
the mesh, contour or not, is looked at on both of its sides. On the great circle of an edge a face hides a
range of angle: it lies in the cone of the face's corners, three half-spaces. Directions a hair to the left of
the edge and a hair to its right are in the same half-spaces as the edge itself, save those whose bounding
circle runs along it, where the hair decides. What is visible on just one side is boundary; it needs neither
crossings nor depth counts, and where rounding misplaces the end of a range, it does so by as much as it
rounds. Edges that lie on each other as seen (abutting boxes, faces that exist twice) count once.

Where two circles cross is computed from their unit normals, by the same operations on either edge, so that
what one arc loses by rounding its neighbour gains. Those normals are taken in double-double arithmetic: the
point's bits are exact, and an edge 1e-11 away from it is seen as well as any.

All points are shade points: displaced already, normals of unit length, in units in which coordinates are
around 1 (the units of a `Scene`'s topology).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

__all__ = [
    "Arcs",
    "ambient_occlusion",
    "arcs_of",
    "bent_normals",
    "closure",
    "harmonics",
    "sh_transfer",
    "solid_angle",
    "uniform",
    "vector_irradiance",
]

# Two edges whose directions differ by less than this are taken to run along each other. Coordinates round to
# 1e-16 and edges are seldom shorter than 1e-3 as seen.
ALONG = 1e-12
# Arcs are cut into pieces of at most this length, so that an angle has one place on a piece.
LONGEST = 0.8


class Arcs(NamedTuple):
    """The boundary of the visible region, in the layout of the exact mode; see `arcs_of`."""

    points: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3)
    counts: np.ndarray  # (n,)
    starts: np.ndarray  # (n,)
    directions: np.ndarray  # (m, 9): unit start, unit end, unit inner normal; the visible side on the left
    edges: np.ndarray  # (m, 2): vertices, in lexicographic order of positions; -1, -1 on the horizon


def welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal positions become one vertex, in lexicographic order; faces that lose a corner are left out."""
    positions, inverse = np.unique(np.asarray(vertices, np.float64) + 0.0, axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[np.asarray(faces, np.int64)]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return np.ascontiguousarray(positions), np.ascontiguousarray(triangles[whole])


def arcs_of(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray) -> Arcs:
    """The boundary of what each point sees above its horizon.

    Parameters
    ----------
    vertices : (V, 3) float64
    faces : (F, 3) int
    points, normals : (n, 3) float64
        Shade points as they are to be seen from, and unit normals.
    """
    positions, triangles = welded(vertices, faces)
    sides = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    face_edges = np.ascontiguousarray(inverse.reshape(-1).reshape(3, -1).T)
    # +1 where a face runs from the lower vertex to the higher.
    runs = np.where(triangles < np.roll(triangles, -1, axis=1), 1.0, -1.0)
    directions, owners, counts = [], [], []
    for p, n in zip(points, normals, strict=True):
        d, e = _boundary(positions, triangles, edges, face_edges, runs, p, n)
        directions.append(d)
        owners.append(e)
        counts.append(len(d))
    total = np.array(counts, np.int64)
    return Arcs(
        np.array(points),
        np.array(normals),
        total,
        np.cumsum(total) - total,
        np.concatenate([*directions, np.empty((0, 9))]),
        np.concatenate([*owners, np.empty((0, 2), np.int32)]),
    )


# ------------------------------------------------------------------------------------ double-double numbers


@njit(cache=True)
def _difference(a, b):
    s = a - b
    t = s - a
    return s, (a - (s - t)) - (b + t)


@njit(cache=True)
def _product(a, b):
    """Dekker's exact product."""
    p = a * b
    t = 134217729.0 * a
    ah = t - (t - a)
    al = a - ah
    t = 134217729.0 * b
    bh = t - (t - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@njit(cache=True)
def _times(ah, al, bh, bl):
    p, e = _product(ah, bh)
    e += ah * bl + al * bh
    s = p + e
    return s, e - (s - p)


@njit(cache=True)
def _minus(ah, al, bh, bl):
    s, e = _difference(ah, bh)
    e += al - bl
    t = s + e
    return t, e - (t - s)


@njit(cache=True)
def _exact_cross(a, b, out):
    """a x b of vectors of double-double numbers (3, 2)."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        ph, pl = _times(a[i, 0], a[i, 1], b[j, 0], b[j, 1])
        qh, ql = _times(a[j, 0], a[j, 1], b[i, 0], b[i, 1])
        out[k, 0], out[k, 1] = _minus(ph, pl, qh, ql)


# ---------------------------------------------------------------------------------------------- one point


@njit(cache=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _normalise(v):
    """In place; False where it is zero. Safe for any magnitude."""
    size = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if size == 0.0:
        return False
    x, y, z = v[0] / size, v[1] / size, v[2] / size
    length = np.sqrt(x * x + y * y + z * z)
    v[0], v[1], v[2] = x / length, y / length, z / length
    return True


@njit(cache=True)
def _look(positions, edges, p, relative, directions, normals, middles):
    """Vertices and edges as seen from p: directions, normals a x b of edges (lower vertex first), middles.

    Directions are zero for a vertex at p, normals for an edge seen end on.
    """
    for v in range(len(positions)):
        for k in range(3):
            relative[v, k, 0], relative[v, k, 1] = _difference(positions[v, k], p[k])
            directions[v, k] = relative[v, k, 0]
        _normalise(directions[v])
    cross, y = np.empty((3, 2)), np.empty(3)
    for e in range(len(edges)):
        a, b = relative[edges[e, 0]], relative[edges[e, 1]]
        _exact_cross(a, b, cross)
        size_a = abs(a[0, 0]) + abs(a[1, 0]) + abs(a[2, 0])
        size_b = abs(b[0, 0]) + abs(b[1, 0]) + abs(b[2, 0])
        for k in range(3):
            normals[e, k] = cross[k, 0] + cross[k, 1]
        size = max(abs(normals[e, 0]), abs(normals[e, 1]), abs(normals[e, 2]))
        if not size > 1e-29 * size_a * size_b or not _normalise(normals[e]):
            normals[e, :] = 0.0
        a, b = directions[edges[e, 0]], directions[edges[e, 1]]
        _cross(normals[e], a, y)
        half = 0.5 * np.arctan2(_dot(b, y), _dot(b, a))
        for k in range(3):
            middles[e, k] = np.cos(half) * a[k] + np.sin(half) * y[k]


@njit(cache=True)
def _turns(triangles, face_edges, runs, relative, normals, turn):
    """For each face's edges the sign that makes s N.w >= 0 its cone; 0 for faces seen edge-on."""
    cross = np.empty((3, 2))
    for f in range(len(triangles)):
        a, b, c = relative[triangles[f, 0]], relative[triangles[f, 1]], relative[triangles[f, 2]]
        _exact_cross(a, b, cross)
        det, low, size = 0.0, 0.0, 1.0
        for k in range(3):
            h, m = _times(cross[k, 0], cross[k, 1], c[k, 0], c[k, 1])
            det, low = _minus(det, low, -h, -m)
        for x in (a, b, c):
            size *= abs(x[0, 0]) + abs(x[1, 0]) + abs(x[2, 0])
        s = 0.0
        if abs(det) > 1e-28 * size:
            s = 1.0 if det > 0.0 else -1.0
        for k in range(3):
            e = face_edges[f, k]
            if normals[e, 0] == 0.0 and normals[e, 1] == 0.0 and normals[e, 2] == 0.0:
                s = 0.0
        for k in range(3):
            turn[f, k] = s * runs[f, k]


@njit(cache=True)
def _where(x, a, y, start, end):
    """Angle of the crossing +-x on a piece of the circle a cos t + y sin t."""
    t = np.arctan2(_dot(x, y), _dot(x, a))
    t -= np.pi * np.round((t - 0.5 * (start + end)) / np.pi)
    return min(max(t, start), end)


@njit(cache=True)
def _visible(hidden, m, start, end, out):
    """What the union of m ranges leaves of [start, end]; returns how many ranges."""
    order = np.argsort(hidden[:m, 0])
    found, reached = 0, start
    for j in range(m + 1):
        low = hidden[order[j], 0] if j < m else end
        if low > reached:
            out[found, 0], out[found, 1] = reached, low
            found += 1
        if j < m:
            reached = max(reached, hidden[order[j], 1])
    return found


@njit(cache=True)
def _inside(ranges, m, t):
    for i in range(m):
        if ranges[i, 0] < t < ranges[i, 1]:
            return True
    return False


@njit(cache=True)
def _pieces(edges, directions, normals, n, frames, ends, owner):
    """Everything that may be boundary, in pieces: first the horizon, then all edges that reach above it.

    frames (m, 3, 3): a, y, N; directions of a piece are a cos t + y sin t for t in ends (m, 2).
    """
    m = 0
    across = np.zeros(3)
    across[np.argmin(np.abs(n))] = 1.0
    side = np.empty(3)
    _cross(n, across, side)
    _normalise(side)
    for i in range(8):
        frames[m, 0] = side
        _cross(n, side, frames[m, 1])
        frames[m, 2] = n
        ends[m, 0], ends[m, 1] = i * np.pi / 4 - np.pi, (i + 1) * np.pi / 4 - np.pi
        owner[m] = -1
        m += 1
    for e in range(len(edges)):
        a, b, normal = directions[edges[e, 0]], directions[edges[e, 1]], normals[e]
        if _dot(normal, normal) == 0.0:
            continue
        if _dot(a, n) <= 0.0 and _dot(b, n) <= 0.0:
            continue
        y = np.empty(3)
        _cross(normal, a, y)
        _normalise(y)
        angle = np.arctan2(_dot(b, y), _dot(b, a))
        if not angle > 0.0:
            continue
        k = int(np.ceil(angle / LONGEST))
        for i in range(k):
            frames[m, 0], frames[m, 1], frames[m, 2] = a, y, normal
            ends[m, 0], ends[m, 1] = angle * (i / k), angle * ((i + 1) / k)
            owner[m] = e
            m += 1
    return m


@njit(cache=True)
def _boundary(positions, triangles, edges, face_edges, runs, p, n):
    relative = np.empty((len(positions), 3, 2))
    directions = np.empty((len(positions), 3))
    normals = np.empty((len(edges), 3))
    turn = np.empty((len(triangles), 3))
    middles = np.empty((len(edges), 3))
    _look(positions, edges, p, relative, directions, normals, middles)
    _turns(triangles, face_edges, runs, relative, normals, turn)
    capacity = 8 + 4 * len(edges)
    frames, ends, owner = np.empty((capacity, 3, 3)), np.empty((capacity, 2)), np.empty(capacity, np.int64)
    n_pieces = _pieces(edges, directions, normals, n, frames, ends, owner)
    tips = np.empty((n_pieces, 2, 3))
    for i in range(n_pieces):
        for j in range(2):
            for k in range(3):
                tips[i, j, k] = np.cos(ends[i, j]) * frames[i, 0, k] + np.sin(ends[i, j]) * frames[i, 1, k]

    height = np.empty(len(positions))
    left, right = np.empty((len(triangles) + 4, 2)), np.empty((len(triangles) + 4, 2))
    seen_left, seen_right = np.empty((len(triangles) + 8, 2)), np.empty((len(triangles) + 8, 2))
    twice = np.empty((n_pieces, 2))
    cuts = np.empty(4 * len(triangles) + 2 * n_pieces + 16)
    x = np.empty(3)
    room = 64
    out, out_edges, n_out = np.empty((room, 9)), np.empty((room, 2), np.int32), 0
    last_owner = -2
    for i in range(n_pieces):
        a, y, normal = frames[i, 0], frames[i, 1], frames[i, 2]
        start, end, e = ends[i, 0], ends[i, 1], owner[i]
        va, vb = (edges[e, 0], edges[e, 1]) if e >= 0 else (-1, -1)
        whole = e < 0 or (start == 0.0 and (i + 1 == n_pieces or owner[i + 1] != e))
        if e != last_owner:
            for v in range(len(positions)):
                height[v] = 0.0 if v == va or v == vb else _dot(normal, directions[v])
            last_owner = e
        n_left = n_right = 0
        if e < 0:
            right[0, 0], right[0, 1] = start, end
            n_right = 1
        else:
            # Below the horizon.
            h0, h1 = _dot(tips[i, 0], n), _dot(tips[i, 1], n)
            if max(abs(h0), abs(h1)) < ALONG or (h0 <= 0.0 and h1 <= 0.0):
                continue
            if h0 < 0.0 or h1 < 0.0:
                _cross(normal, n, x)
                t = _where(x, a, y, start, end)
                left[0, 0], left[0, 1] = (start, t) if h0 < 0.0 else (t, end)
                right[0] = left[0]
                n_left = n_right = 1

        # The ranges that faces hide.
        for f in range(len(triangles)):
            if turn[f, 0] == 0.0:
                continue
            g0, g1, g2 = height[triangles[f, 0]], height[triangles[f, 1]], height[triangles[f, 2]]
            if min(g0, g1, g2) > ALONG or max(g0, g1, g2) < -ALONG:
                continue
            low, high = start, end
            hides_left = hides_right = True
            for k in range(3):
                v, w = triangles[f, k], triangles[f, (k + 1) % 3]
                other, s = face_edges[f, k], turn[f, k]
                c = normals[other]
                h0, h1 = s * _dot(c, tips[i, 0]), s * _dot(c, tips[i, 1])
                # A corner that the two edges share is on both circles.
                if (va == v or va == w) and start == 0.0:
                    h0 = 0.0
                if (vb == v or vb == w) and (whole or i + 1 == n_pieces or owner[i + 1] != e):
                    h1 = 0.0
                if (
                    other == e
                    or max(abs(h0), abs(h1)) < ALONG
                    or (
                        # Not its ends alone: those of an edge that all but passes through p are opposite.
                        max(abs(height[v]), abs(height[w])) < ALONG
                        and abs(_dot(normal, middles[other])) < ALONG
                    )
                ):
                    if s * _dot(c, normal) > 0.0:
                        hides_right = False
                    else:
                        hides_left = False
                    if not hides_left and not hides_right:
                        break
                    continue
                if h0 >= 0.0 and h1 >= 0.0:
                    continue
                if h0 <= 0.0 and h1 <= 0.0:
                    high = low
                    break
                # The same operations whichever of the two edges is cut by the other.
                _cross(normal, c, x)
                t = _where(x, a, y, start, end)
                if h0 < 0.0:
                    low = max(low, t)
                else:
                    high = min(high, t)
                if low >= high:
                    break
            if low < high:
                if hides_left:
                    left[n_left, 0], left[n_left, 1] = low, high
                    n_left += 1
                if hides_right:
                    right[n_right, 0], right[n_right, 1] = low, high
                    n_right += 1
        m_left = _visible(left, n_left, start, end, seen_left)
        m_right = _visible(right, n_right, start, end, seen_right)
        if m_left == 0 and m_right == 0:
            continue

        # What lies on an earlier piece is its business.
        n_twice = 0
        for j in range(i):
            if owner[j] == e:
                continue
            if not (
                max(abs(_dot(normal, tips[j, 0])), abs(_dot(normal, tips[j, 1]))) < ALONG
                or max(abs(_dot(frames[j, 2], tips[i, 0])), abs(_dot(frames[j, 2], tips[i, 1]))) < ALONG
            ):
                continue
            middle = 0.5 * (start + end)
            t0 = np.arctan2(_dot(tips[j, 0], y), _dot(tips[j, 0], a))
            t1 = np.arctan2(_dot(tips[j, 1], y), _dot(tips[j, 1], a))
            t0 -= 2 * np.pi * np.round((t0 - middle) / (2 * np.pi))
            t1 -= 2 * np.pi * np.round((t1 - middle) / (2 * np.pi))
            low, high = max(min(t0, t1), start), min(max(t0, t1), end)
            if low < high and abs(t0 - t1) < 2 * LONGEST:
                twice[n_twice, 0], twice[n_twice, 1] = low, high
                n_twice += 1

        m = 0
        for ranges, count in ((seen_left, m_left), (seen_right, m_right), (twice, n_twice)):
            for j in range(count):
                cuts[m], cuts[m + 1] = ranges[j, 0], ranges[j, 1]
                m += 2
        ordered = np.sort(cuts[:m])
        before, begin = 0, 0.0
        for j in range(m):
            sign = 0
            if j + 1 < m:
                t = 0.5 * (ordered[j] + ordered[j + 1])
                if not _inside(twice, n_twice, t):
                    sign = int(_inside(seen_left, m_left, t)) - int(_inside(seen_right, m_right, t))
                if ordered[j] == ordered[j + 1]:
                    sign = before
            if sign == before:
                continue
            if before != 0:
                if n_out == room:
                    room *= 2
                    grown, grown_edges = np.empty((room, 9)), np.empty((room, 2), np.int32)
                    grown[:n_out], grown_edges[:n_out] = out[:n_out], out_edges[:n_out]
                    out, out_edges = grown, grown_edges
                first, last = (begin, ordered[j]) if before > 0 else (ordered[j], begin)
                for k in range(3):
                    out[n_out, k] = np.cos(first) * a[k] + np.sin(first) * y[k]
                    out[n_out, 3 + k] = np.cos(last) * a[k] + np.sin(last) * y[k]
                    out[n_out, 6 + k] = before * normal[k]
                out_edges[n_out, 0], out_edges[n_out, 1] = (va, vb) if before > 0 else (vb, va)
                n_out += 1
            before, begin = sign, ordered[j]
    return out[:n_out].copy(), out_edges[:n_out].copy()


# ---------------------------------------------------------------------------------------------- integrals


def _split(arcs: Arcs) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Start, end, inner normal and length of each arc, and the row of its point."""
    a, b, inner = arcs.directions[:, :3], arcs.directions[:, 3:6], arcs.directions[:, 6:]
    y = np.cross(inner, a)
    angle = np.arctan2((b * y).sum(axis=1), (b * a).sum(axis=1))
    rows = np.repeat(np.arange(len(arcs.counts)), arcs.counts)
    # Arcs of each point may stand anywhere.
    order = np.concatenate(
        [np.arange(s, s + c) for s, c in zip(arcs.starts, arcs.counts, strict=True)] or [np.empty(0, int)]
    ).astype(int)
    return a[order], b[order], inner[order], angle[order], rows


def _sum(values: np.ndarray, rows: np.ndarray, n: int) -> np.ndarray:
    out = np.zeros((n, *values.shape[1:]))
    np.add.at(out, rows, values)
    return out


def vector_irradiance(arcs: Arcs) -> np.ndarray:
    """int V w dw (n, 3): half the sum of lengths times inner normals [Lambert 1760]."""
    _, _, inner, angle, rows = _split(arcs)
    return _sum(0.5 * angle[:, None] * inner, rows, len(arcs.counts))


def ambient_occlusion(arcs: Arcs) -> np.ndarray:
    """(1/pi) int V n.w dw (n,)."""
    return (vector_irradiance(arcs) * arcs.normals).sum(axis=1) / np.pi


def solid_angle(arcs: Arcs) -> np.ndarray:
    """int V dw (n,): signed triangles between n and each arc [Van Oosterom and Strackee 1983]."""
    a, b, inner, angle, rows = _split(arcs)
    n = arcs.normals[rows]
    # det(n, a, b) = n.(a x b), with a x b = sin(angle) N.
    det = np.sin(angle) * (n * inner).sum(axis=1)
    denominator = 1.0 + (n * a).sum(axis=1) + (n * b).sum(axis=1) + np.cos(angle)
    return _sum(2.0 * np.arctan2(det, denominator), rows, len(arcs.counts))


def uniform(arcs: Arcs) -> np.ndarray:
    """(1/2pi) int V dw (n,)."""
    return solid_angle(arcs) / (2 * np.pi)


def closure(arcs: Arcs) -> np.ndarray:
    """|sum of (b - a)| for each point: 0 where the arcs are closed loops, which the boundary is."""
    a, b, _, _, rows = _split(arcs)
    return np.linalg.norm(_sum(b - a, rows, len(arcs.counts)), axis=1)


def bent_normals(arcs: Arcs) -> np.ndarray:
    """(1/pi) int V n.w w dw (n, 3).

    n.w w_k - n_k / 3 is a harmonic of degree 2: over a region it integrates to 1/6 of the integral of
    N.grad = N.n w_k + N_k n.w along the boundary. The rest is a third of the solid angle.
    """
    a, _, inner, angle, rows = _split(arcs)
    n = arcs.normals[rows]
    along = np.sin(angle)[:, None] * a + 2.0 * np.sin(0.5 * angle)[:, None] ** 2 * np.cross(inner, a)
    terms = (inner * n).sum(axis=1)[:, None] * along + inner * (along * n).sum(axis=1)[:, None]
    total = _sum(terms / 6.0, rows, len(arcs.counts)) + solid_angle(arcs)[:, None] * arcs.normals / 3.0
    return total / np.pi


def harmonics(w: np.ndarray, degree: int) -> np.ndarray:
    """Y_lm as solid harmonics (..., (L + 1)^2) of directions (..., 3), real or complex: polynomials.

    Orthonormal, no Condon-Shortley phase, index l (l + 1) + m.
    """
    from math import factorial

    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    r2 = x * x + y * y + z * z
    out = np.empty((*w.shape[:-1], (degree + 1) ** 2), w.dtype)
    c, s = np.ones_like(x), np.zeros_like(x)  # r^m sin^m times cos and sin of m phi
    start = 1.0
    for m in range(degree + 1):
        if m > 0:
            c, s = x * c - y * s, x * s + y * c
            start *= 2 * m - 1
        older, old = np.zeros_like(x), np.full_like(x, start)
        for degree_l in range(m, degree + 1):
            if degree_l > m:
                older, old = (
                    old,
                    ((2 * degree_l - 1) * z * old - (degree_l + m - 1) * r2 * older) / (degree_l - m),
                )
            norm = np.sqrt(
                (2 * degree_l + 1) / (4 * np.pi) * factorial(degree_l - m) / factorial(degree_l + m)
            )
            centre = degree_l * (degree_l + 1)
            if m == 0:
                out[..., centre] = norm * old
            else:
                out[..., centre + m] = np.sqrt(2) * norm * old * c
                out[..., centre - m] = np.sqrt(2) * norm * old * s
    return out


def _sh_of_visibility(arcs: Arcs, degree: int) -> np.ndarray:
    """int V Y_lm dw: by the divergence theorem 1/(l (l + 1)) of the integral of N.grad Y_lm on the boundary."""
    nodes, weights = np.polynomial.legendre.leggauss(degree + 12)  # arcs are at most pi / 2 long
    a, _, inner, angle, rows = _split(arcs)
    t = 0.5 * angle[:, None] * (1.0 + nodes)
    w = np.cos(t)[..., None] * a[:, None] + np.sin(t)[..., None] * np.cross(inner, a)[:, None]
    step = 1e-30
    slope = harmonics(w + 1j * step * inner[:, None], degree).imag / step
    along = 0.5 * angle[:, None] * (weights[None, :, None] * slope).sum(axis=1)
    index = np.arange((degree + 1) ** 2)
    l_of = np.floor(np.sqrt(index + 0.5))
    along /= np.maximum(l_of * (l_of + 1), 1)
    total = _sum(along, rows, len(arcs.counts))
    total[:, 0] = solid_angle(arcs) / np.sqrt(4 * np.pi)
    return total


def sh_transfer(arcs: Arcs, degree: int, weighting: str) -> np.ndarray:
    """int V Y_lm dw ("uniform") or (1/pi) int V n.w Y_lm dw ("cosine"), (n, (L + 1)^2)."""
    if weighting == "uniform":
        return _sh_of_visibility(arcs, degree)
    seen = _sh_of_visibility(arcs, degree + 1)
    # n.w Y_lm has degree L + 1; its coefficients by a rule that is exact for degree 2 L + 2.
    z, weight = np.polynomial.legendre.leggauss(degree + 2)
    phi = 2 * np.pi * np.arange(2 * degree + 4) / (2 * degree + 4)
    r = np.sqrt(1 - z * z)[:, None]
    w = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z[:, None]), axis=-1).reshape(-1, 3)
    weight = np.repeat(weight * 2 * np.pi / len(phi), len(phi))
    basis = harmonics(w, degree + 1)
    low = basis[:, : (degree + 1) ** 2]
    product = np.einsum("q,qk,qi,qj->kij", weight, w, low, basis)
    return np.einsum("nk,kij,nj->ni", arcs.normals, product, seen) / np.pi
