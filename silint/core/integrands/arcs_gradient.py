r"""Derivatives of integrals over what a point sees, from the arcs that bound it: closed forms.

F = int f(w, n) dw over the visible part Omega of the hemisphere of n. By Reynolds' transport theorem F
changes with f inside, and with the speed at which the boundary moves outwards. An arc lies in the plane with
inner normal N; where N turns by dN, a boundary direction w moves outwards by w.dN. The plane passes through p
and an edge from A to B, whose point in direction w is x = p + r w. N.(x - p) = 0 stays true, so w.dN = -N.dx
/ r for a displacement dx of that point relative to p. With t its place on the edge, x = (1 - t) A + t B:

    dF/dp =  sum over arcs of N int f / r dalpha
    dF/dA = -sum over arcs of N int f (1 - t) / r dalpha,    dF/dB = -sum over arcs of N int f t / r dalpha.

(1 - t) / r and t / r are linear in w: they are its coordinates in the basis A - p, B - p of the plane. So all
three are coordinates of one vector an arc and integrand, the *moment* int f(w) w dalpha. Where one edge
passes behind another, the ends of arcs move too, which is of second order.

The horizon does not move with p nor with vertices. It moves with n, N = n there, and then dF/dn = int f w
dalpha over its visible stretches: the same moment, and nothing where f holds the factor n.w. What f itself
changes by is an integral over Omega, by arcs again (`_interior`). n stands for a free vector that is
normalised, so dF/dn is tangential.

In the frame e1, e2 of an arc, with e1 at its middle and e2 = N x e1, w = e1 cos(x) + e2 sin(x), odd powers of
sin(x) integrate to zero, and moments need half the arc's sine s, and its angle for even degrees.

Derivatives are one-sided where the boundary changes its edges: a vertex of one edge seen on another, an edge
seen end-on, a face seen edge-on, p on a surface that is not tangent to the horizon.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.jit import INNER, KERNEL, PARALLEL
from silint.core.small_circle import cross, dot

# Integrands f, with the number of their components.
COSINE, UNIFORM, VECTOR, BENT = 0, 1, 2, 3
COMPONENTS = (1, 1, 3, 3)

# An edge closer to a point than this, in scaled units, passes through it as far as rounding can tell.
_THROUGH = 2.0**-50

# theta - sin(theta) cancels for short arcs; below this sine of half an arc a series is exact to 2e-15.
_SHORT = 0.04


@njit(**INNER)
def arc_frame(directions, k):
    """Middle e1 of an arc, direction of travel e2 there, N, and sine and cosine of half the angle.

    The sine is negative where rounding swapped the ends: what the arc adds cancels what its neighbours have
    too much.
    """
    a = directions[k, 0], directions[k, 1], directions[k, 2]
    b = directions[k, 3], directions[k, 4], directions[k, 5]
    normal = directions[k, 6], directions[k, 7], directions[k, 8]
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    u, v, w = a[0] + b[0], a[1] + b[1], a[2] + b[2]
    s, c = 0.5 * np.sqrt(x * x + y * y + z * z), 0.5 * np.sqrt(u * u + v * v + w * w)
    # The difference of the ends of a short arc is mostly rounding, as is the sum of those of one near pi.
    if c >= s:
        scale = 0.5 / c
        e1 = u * scale, v * scale, w * scale
        e2 = cross(normal, e1)
        if x * e2[0] + y * e2[1] + z * e2[2] < 0.0:
            s = -s
    else:
        scale = 0.5 / s
        e2 = x * scale, y * scale, z * scale
        e1 = cross(e2, normal)
    return e1, e2, normal, s, c


@njit(**INNER)
def angles(s, c):
    """The angle theta of an arc, and theta - sin(theta)."""
    sine = 2.0 * s * c
    if s < _SHORT:
        q = s * s
        excess = s * q * (4.0 / 3.0 + q * (0.4 + q * (3.0 / 14.0 + q * (5.0 / 36.0 + q * (35.0 / 352.0)))))
        return sine + excess, excess
    theta = 2.0 * np.arctan2(s, c)
    return theta, theta - sine


@njit(**INNER)
def edge_in_frame(vertices, edges, k, p, e1, e2):
    """A - p and B - A in the arc's frame, and twice the area of the triangle p, A, B: 0 for an edge that
    passes through p.
    """
    i, j = edges[k, 0], edges[k, 1]
    a = vertices[i, 0] - p[0], vertices[i, 1] - p[1], vertices[i, 2] - p[2]
    d = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1], vertices[j, 2] - vertices[i, 2]
    a1, a2, d1, d2 = dot(a, e1), dot(a, e2), dot(d, e1), dot(d, e2)
    area = a1 * d2 - a2 * d1
    return a1, a2, d1, d2, area if area > _THROUGH * np.sqrt(d1 * d1 + d2 * d2) else 0.0


@njit(**INNER)
def triangle(n, e1, normal, s, c):
    """Signed solid angle of the triangle n, a, b [Van Oosterom and Strackee 1983]."""
    # 1 + a.b = 2 c^2, and n.a + n.b = 2 c n.e1; a factor 2 c is common to both arguments.
    return 2.0 * np.arctan2(s * dot(n, normal), c + dot(n, e1))


@njit(**INNER)
def _moments(quantity, n, e1, e2, s, theta, excess, out):
    """Moments int f(w) w dalpha of an arc, along e1 and e2: (components, 2)."""
    cos2, sin2 = theta - 0.5 * excess, 0.5 * excess  # integrals of cos^2 and sin^2
    if quantity == COSINE:
        out[0, 0], out[0, 1] = dot(n, e1) * cos2 / np.pi, dot(n, e2) * sin2 / np.pi
    elif quantity == UNIFORM:
        out[0, 0], out[0, 1] = s / np.pi, 0.0
    elif quantity == VECTOR:
        for i in range(3):
            out[i, 0], out[i, 1] = e1[i] * cos2, e2[i] * sin2
    else:
        mixed = 2.0 * s * s * s / (3.0 * np.pi)  # cos sin^2
        cos3 = 2.0 * s / np.pi - mixed
        n1, n2 = dot(n, e1), dot(n, e2)
        for i in range(3):
            out[i, 0] = n1 * e1[i] * cos3 + n2 * e2[i] * mixed
            out[i, 1] = (n1 * e2[i] + n2 * e1[i]) * mixed


@njit(**INNER)
def _add_interior(quantity, n, e1, normal, s, c, theta, total):
    """Add an arc's share of the integrals over Omega that value and dF/dn need: `total` (10,).

    [0:3] int w dw, half of theta N an arc [Lam60]; [3] the solid angle; [4:10] the trace-free part of int
    w_i w_j dw, a third of the symmetric part of N_i int w_j dalpha: the divergence theorem on a harmonic of
    degree 2, whose surface Laplacian is -6 times itself. Order xx, yy, zz, xy, yz, zx.
    """
    if quantity == COSINE or quantity == VECTOR:
        for i in range(3):
            total[i] += 0.5 * theta * normal[i]
        return
    total[3] += triangle(n, e1, normal, s, c)
    if quantity == BENT:
        along = 2.0 * s / 3.0
        for i in range(3):
            j = (i + 1) % 3
            total[4 + i] += along * normal[i] * e1[i]
            total[7 + i] += 0.5 * along * (normal[i] * e1[j] + normal[j] * e1[i])


@njit(**INNER)
def _interior(quantity, n, total, value, by_normal):
    """Value of F, and what f itself adds to dF/dn, from the sums of `_add_interior`."""
    if quantity == COSINE:
        value[0] = (n[0] * total[0] + n[1] * total[1] + n[2] * total[2]) / np.pi
        for j in range(3):
            by_normal[j, 0] += total[j] / np.pi - value[0] * n[j]
    elif quantity == UNIFORM:
        value[0] = total[3] / (2.0 * np.pi)
    elif quantity == VECTOR:
        for i in range(3):
            value[i] = total[i]
    else:
        for i in range(3):
            before = (i + 2) % 3
            after = (i + 1) % 3
            product = (total[3] / 3.0 + total[4 + i]) * n[i] + total[7 + i] * n[after]
            value[i] = (product + total[7 + before] * n[before]) / np.pi
        for i in range(3):
            for j in range(3):
                if i == j:
                    entry = total[3] / 3.0 + total[4 + i]
                elif j == (i + 1) % 3:
                    entry = total[7 + i]
                else:
                    entry = total[7 + j]
                by_normal[j, i] += entry / np.pi - value[i] * n[j]


@njit(**PARALLEL)
def differentiate_arcs(
    points,
    normals,
    counts,
    starts,
    directions,
    edges,
    vertices,
    quantity,
    factor,
    value,
    by_point,
    by_normal,
    singular,
):
    """Value and derivatives of F at each point.

    Parameters
    ----------
    points, normals, counts, starts, directions, edges
        Those of Arcs.
    vertices : (V, 3) float64
        In the units of the points.
    quantity : int
        COSINE: (1/pi) int n.w dw. UNIFORM: (1/2 pi) int dw. VECTOR: int w dw, the vector irradiance. BENT:
        (1/pi) int n.w w dw. All over the visible part of the hemisphere.
    factor : float
        Derivatives in p are multiplied with it: units of the vertices to the caller's.
    value : (n, C) float64, out
    by_point, by_normal : (n, 3, C) float64, zero, out
    singular : (n,) int64, out
        Arcs on edges that pass through the point, which are left out: F has no derivative there.
    """
    for i in prange(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        n_components = value.shape[1]
        moments, total = np.empty((n_components, 2)), np.zeros(10)
        left_out = 0
        for k in range(starts[i], starts[i] + counts[i]):
            e1, e2, normal, s, c = arc_frame(directions, k)
            theta, excess = angles(s, c)
            _add_interior(quantity, n, e1, normal, s, c, theta, total)
            if edges[k, 0] < 0:
                if quantity == UNIFORM or quantity == VECTOR:
                    _moments(quantity, n, e1, e2, s, theta, excess, moments)
                    for m in range(n_components):
                        for j in range(3):
                            by_normal[i, j, m] += moments[m, 0] * e1[j] + moments[m, 1] * e2[j]
                continue
            _, _, d1, d2, area = edge_in_frame(vertices, edges, k, p, e1, e2)
            if area == 0.0:
                left_out += 1
                continue
            _moments(quantity, n, e1, e2, s, theta, excess, moments)
            scale = factor / area
            for m in range(n_components):
                over_r = (moments[m, 0] * d2 - moments[m, 1] * d1) * scale
                for j in range(3):
                    by_point[i, j, m] += over_r * normal[j]
        _interior(quantity, n, total, value[i], by_normal[i])
        singular[i] = left_out


@njit(**PARALLEL)
def pull_back_arcs(
    points,
    normals,
    counts,
    starts,
    directions,
    edges,
    vertices,
    quantity,
    factor,
    cotangents,
    shares,
    singular,
):
    """What each arc adds to the derivative of sum(cotangents * F) by the two ends of its edge.

    Parameters
    ----------
    points, normals, counts, starts, directions, edges, vertices, quantity, factor, singular
        As in `differentiate_arcs`.
    cotangents : (n, C) float64
    shares : (m, 2) float64, out
        Along N, for A and B; see `scatter`.
    """
    for i in prange(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        n_components = cotangents.shape[1]
        moments = np.empty((n_components, 2))
        left_out = 0
        for k in range(starts[i], starts[i] + counts[i]):
            shares[k, 0], shares[k, 1] = 0.0, 0.0
            if edges[k, 0] < 0:
                continue
            e1, e2, _, s, c = arc_frame(directions, k)
            a1, a2, d1, d2, area = edge_in_frame(vertices, edges, k, p, e1, e2)
            if area == 0.0:
                left_out += 1
                continue
            theta, excess = angles(s, c)
            _moments(quantity, n, e1, e2, s, theta, excess, moments)
            m1, m2 = 0.0, 0.0
            for m in range(n_components):
                m1 += cotangents[i, m] * moments[m, 0]
                m2 += cotangents[i, m] * moments[m, 1]
            scale = factor / area
            shares[k, 0] = -(m1 * (a2 + d2) - m2 * (a1 + d1)) * scale
            shares[k, 1] = -(a1 * m2 - a2 * m1) * scale
        singular[i] = left_out


@njit(**KERNEL)
def scatter(counts, starts, directions, edges, shares, out):
    """Add every arc's shares, along its normal, to the two vertices of its edge: out (V, 3) float64.

    One thread, in the order of points and arcs: the sum does not depend on the number of threads.
    """
    for i in range(len(counts)):
        for k in range(starts[i], starts[i] + counts[i]):
            a, b = edges[k, 0], edges[k, 1]
            if a < 0:
                continue
            for j in range(3):
                out[a, j] += shares[k, 0] * directions[k, 6 + j]
                out[b, j] += shares[k, 1] * directions[k, 6 + j]


def gradient(
    arcs: Arcs, vertices: np.ndarray, quantity: int, factor: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Value (n, C), dF/dp and dF/dn (n, 3, C), and how many arcs had to be left out.

    Parameters
    ----------
    arcs : Arcs
    vertices : (V, 3) float64
        Those that the arcs' edges name, in the units of the arcs' points.
    quantity : int
        COSINE, UNIFORM, VECTOR or BENT.
    factor : float
        Scaled units in one of the caller's.
    """
    n, n_components = len(arcs.points), COMPONENTS[quantity]
    value, singular = np.empty((n, n_components)), np.empty(n, np.int64)
    by_point, by_normal = np.zeros((n, 3, n_components)), np.zeros((n, 3, n_components))
    differentiate_arcs(*arcs, vertices, quantity, factor, value, by_point, by_normal, singular)
    return value, by_point, by_normal, int(singular.sum())


def pullback(
    arcs: Arcs, vertices: np.ndarray, quantity: int, factor: float, cotangents: np.ndarray, out: np.ndarray
) -> int:
    """Add the derivative of sum(cotangents * F) by all vertices to `out`; returns how many arcs had to be
    left out.

    Parameters
    ----------
    arcs, vertices, quantity, factor
        As in `gradient`.
    cotangents : (n, C) float64
    out : (V, 3) float64, out
        Whatever groups the points come in, it gets the same bits.
    """
    shares, singular = np.empty((len(arcs.edges), 2)), np.empty(len(arcs.points), np.int64)
    pull_back_arcs(*arcs, vertices, quantity, factor, cotangents, shares, singular)
    scatter(arcs.counts, arcs.starts, arcs.directions, arcs.edges, shares, out)
    return int(singular.sum())
