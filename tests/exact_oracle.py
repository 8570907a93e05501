"""The oracle for the exact mode: the boundary of what a point sees, from every edge against every face.

Nothing here is shared with silint.core: no contour, no sweep, no sign of a plane, no hierarchy. Every edge of
the mesh, contour or not, is looked at on both of its sides. On the great circle of an edge a face hides a
range of angle: it lies in the cone of the face's corners, three half-spaces. Directions a hair to the left of
the edge and a hair to its right are in the same half-spaces as the edge itself, save those whose bounding
circle runs along it, where the hair decides. What is visible on just one side is boundary; it needs neither
crossings nor depth counts, and where rounding misplaces the end of a range, it does so by as much as it
rounds. Edges that lie on each other as seen (abutting boxes, faces that exist twice) count once.

Circles and where they cross are taken in double-double arithmetic, 1e-31 of the coordinates as given: an edge
1e-11 away from the point is seen as well as any, and circles that all but coincide cross where they do. That
what it finds closes up to rounding (`closure`) is a check on each value.

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

# Sine of the angle between circles below which they are one: the rounding of double-double normals.
ALONG = 1e-26
# What is further than this from a circle in double precision is off it in any.
FILTER = 1e-13
# Arcs are cut into pieces of at most this length.
LONGEST = 1.5


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
def _look(positions, edges, p, relative, directions, exact_normals, normals, seen):
    """Vertices and edges as seen from p: directions, and unit normals a x b of edges (lower vertex first).

    Directions are zero for a vertex at p; an edge seen end on is not `seen`.
    """
    for v in range(len(positions)):
        for k in range(3):
            relative[v, k, 0], relative[v, k, 1] = _difference(positions[v, k], p[k])
            directions[v, k] = relative[v, k, 0]
        _normalise(directions[v])
    for e in range(len(edges)):
        a, b, cross = relative[edges[e, 0]], relative[edges[e, 1]], exact_normals[e]
        _exact_cross(a, b, cross)
        length = np.sqrt(cross[0, 0] ** 2 + cross[1, 0] ** 2 + cross[2, 0] ** 2)
        size = 1.0
        for x in (a, b):
            size *= abs(x[0, 0]) + abs(x[1, 0]) + abs(x[2, 0])
        seen[e] = length > 1e-29 * size
        if not seen[e]:
            continue
        for k in range(3):
            cross[k, 0], cross[k, 1] = _times(cross[k, 0], cross[k, 1], 1.0 / length, 0.0)
            normals[e, k] = cross[k, 0]
        _normalise(normals[e])


@njit(cache=True)
def _turns(triangles, face_edges, runs, relative, seen, turn):
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
            if not seen[face_edges[f, k]]:
                s = 0.0
        for k in range(3):
            turn[f, k] = s * runs[f, k]


@njit(cache=True)
def _entry(circle, other, s, a, y, cross):
    """Angle, on the circle a cos t + y sin t, at which it enters the half-space s other.w >= 0; and whether
    it does: it may run along its bounding circle.
    """
    _exact_cross(other, circle, cross)
    x0, x1, x2 = s * cross[0, 0], s * cross[1, 0], s * cross[2, 0]
    if max(abs(x0), abs(x1), abs(x2)) < ALONG:
        return 0.0, False
    return np.arctan2(x0 * y[0] + x1 * y[1] + x2 * y[2], x0 * a[0] + x1 * a[1] + x2 * a[2]), True


@njit(cache=True)
def _near(t, middle):
    """t give or take whole turns, next to the middle."""
    return t - 2 * np.pi * np.round((t - middle) / (2 * np.pi))


@njit(cache=True)
def _add(ranges, n, low, high, start, end):
    """Append what of [low, high] lies in [start, end], whatever turn it is on; returns how many there are."""
    for i in range(-2, 3):
        u, v = max(low + i * 2 * np.pi, start), min(high + i * 2 * np.pi, end)
        if u < v:
            ranges[n, 0], ranges[n, 1] = u, v
            n += 1
    return n


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
def _along_earlier(circle, normal, a, y, start, end, e, edges, directions, exact_normals, normals, seen, out):
    """Ranges of an edge that lie on edges before it, as seen; returns how many."""
    n = 0
    cross = np.empty((3, 2))
    for j in range(e):
        if not seen[j]:
            continue
        c, d = directions[edges[j, 0]], directions[edges[j, 1]]
        if abs(_dot(normal, c)) > FILTER or abs(_dot(normal, d)) > FILTER:
            continue
        if _entry(circle, exact_normals[j], 1.0, a, y, cross)[1]:
            continue
        low, high = np.arctan2(_dot(c, y), _dot(c, a)), np.arctan2(_dot(d, y), _dot(d, a))
        if _dot(normal, normals[j]) < 0.0:
            low, high = high, low
        high = low + (high - low) % (2 * np.pi)
        n = _add(out, n, low, high, start, end)
    return n


@njit(cache=True)
def _boundary(positions, triangles, edges, face_edges, runs, p, n):
    relative, directions = np.empty((len(positions), 3, 2)), np.empty((len(positions), 3))
    exact_normals, normals = np.empty((len(edges), 3, 2)), np.empty((len(edges), 3))
    seen, turn = np.empty(len(edges), np.bool_), np.empty((len(triangles), 3))
    _look(positions, edges, p, relative, directions, exact_normals, normals, seen)
    _turns(triangles, face_edges, runs, relative, seen, turn)
    horizon = np.zeros((3, 2))
    horizon[:, 0] = n

    height = np.empty(len(positions))
    left, right = np.empty((2 * len(triangles) + 4, 2)), np.empty((2 * len(triangles) + 4, 2))
    open_left, open_right = np.empty((2 * len(triangles) + 8, 2)), np.empty((2 * len(triangles) + 8, 2))
    twice = np.empty((2 * len(edges) + 2, 2))
    cuts = np.empty(8 * len(triangles) + 4 * len(edges) + 32)
    a, y, normal, cross = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 2))
    room, n_out = 64, 0
    out, out_edges = np.empty((room, 9)), np.empty((room, 2), np.int32)
    for e in range(-1, len(edges)):
        # The circle: the horizon, or an edge's.
        n_left = n_right = 0
        va = vb = -1
        if e < 0:
            circle = horizon
            normal[:] = n
            across = np.zeros(3)
            across[np.argmin(np.abs(n))] = 1.0
            _cross(n, across, a)
            _normalise(a)
            _cross(n, a, y)
            start, end = -np.pi, np.pi
            right[0, 0], right[0, 1] = start, end
            n_right = 1
        else:
            va, vb = edges[e, 0], edges[e, 1]
            b = directions[vb]
            if not seen[e] or (_dot(directions[va], n) < -FILTER and _dot(b, n) < -FILTER):
                continue
            circle = exact_normals[e]
            normal[:] = normals[e]
            a[:] = directions[va]
            _cross(normal, a, y)
            _normalise(y)
            start, end = 0.0, np.arctan2(_dot(b, y), _dot(b, a))
            # What is below the horizon is hidden; an edge along it is the horizon's business.
            low, cuts_it = _entry(circle, horizon, -1.0, a, y, cross)
            if not cuts_it:
                continue
            n_left = _add(left, 0, low, low + np.pi, start, end)
            n_right = _add(right, 0, low, low + np.pi, start, end)
        for v in range(len(positions)):
            height[v] = 0.0 if v == va or v == vb else _dot(normal, directions[v])

        # The ranges that faces hide.
        for f in range(len(triangles)):
            if turn[f, 0] == 0.0:
                continue
            g0, g1, g2 = height[triangles[f, 0]], height[triangles[f, 1]], height[triangles[f, 2]]
            if min(g0, g1, g2) > FILTER or max(g0, g1, g2) < -FILTER:
                continue
            if e >= 0:
                misses = False
                for k in range(3):
                    c, s = normals[face_edges[f, k]], turn[f, k]
                    misses |= s * _dot(c, a) < -FILTER and s * _dot(c, b) < -FILTER
                if misses:
                    continue
            low, high = 0.0, 7.0  # all of the circle
            hides_left = hides_right = True
            for k in range(3):
                other, s = face_edges[f, k], turn[f, k]
                t, cuts_it = 0.0, False
                if other != e:
                    t, cuts_it = _entry(circle, exact_normals[other], s, a, y, cross)
                if not cuts_it:
                    # A hair to the left of the circle is inside, or a hair to the right.
                    if s * _dot(normals[other], normal) > 0.0:
                        hides_right = False
                    else:
                        hides_left = False
                elif high - low > 6.0:
                    low, high = t, t + np.pi
                else:
                    t = _near(t + 0.5 * np.pi, 0.5 * (low + high)) - 0.5 * np.pi
                    low, high = max(low, t), min(high, t + np.pi)
            if low < high:
                if hides_left:
                    n_left = _add(left, n_left, low, high, start, end)
                if hides_right:
                    n_right = _add(right, n_right, low, high, start, end)
        m_left = _visible(left, n_left, start, end, open_left)
        m_right = _visible(right, n_right, start, end, open_right)
        if m_left == 0 and m_right == 0:
            continue
        n_twice = _along_earlier(
            circle, normal, a, y, start, end, e, edges, directions, exact_normals, normals, seen, twice
        )

        # Visible on one side.
        m = 0
        for ranges, count in ((open_left, m_left), (open_right, m_right), (twice, n_twice)):
            for j in range(count):
                cuts[m], cuts[m + 1] = ranges[j, 0], ranges[j, 1]
                m += 2
        ordered = np.sort(cuts[:m])
        for j in range(m - 1):
            t = 0.5 * (ordered[j] + ordered[j + 1])
            if ordered[j] == ordered[j + 1] or _inside(twice, n_twice, t):
                continue
            side = int(_inside(open_left, m_left, t)) - int(_inside(open_right, m_right, t))
            if side == 0:
                continue
            parts = int(np.ceil((ordered[j + 1] - ordered[j]) / LONGEST))
            if n_out + parts > room:
                room = 2 * (n_out + parts)
                grown, grown_edges = np.empty((room, 9)), np.empty((room, 2), np.int32)
                grown[:n_out], grown_edges[:n_out] = out[:n_out], out_edges[:n_out]
                out, out_edges = grown, grown_edges
            for i in range(parts):
                first = ordered[j] + (ordered[j + 1] - ordered[j]) * (i / parts)
                last = ordered[j] + (ordered[j + 1] - ordered[j]) * ((i + 1) / parts)
                if side < 0:
                    first, last = last, first
                for k in range(3):
                    out[n_out, k] = np.cos(first) * a[k] + np.sin(first) * y[k]
                    out[n_out, 3 + k] = np.cos(last) * a[k] + np.sin(last) * y[k]
                    out[n_out, 6 + k] = side * normal[k]
                out_edges[n_out, 0], out_edges[n_out, 1] = (va, vb) if side > 0 else (vb, va)
                n_out += 1
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
    """int V Y_lm dw: 1/(l (l + 1)) of the integral of N.grad Y_lm along the boundary [divergence theorem]."""
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
