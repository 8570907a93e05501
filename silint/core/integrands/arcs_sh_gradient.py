"""Derivatives of SH transfer by arcs: f of `arcs_gradient`, which derives them, is Y_lm or n.w Y_lm / pi.

An arc's moments are polynomials in w, integrated by Gauss-Legendre with as many nodes as its length and the
degree ask for: to rounding. What needs integrals over the inside (values, and what n.w adds to dF/dn) takes
them from integrals along arcs too. With w Y_lm = P + Q, of degrees l + 1 and l - 1 (`sh.coupling`), the
gradient of Y_lm on the sphere is (l + 1) Q - l P, so by the divergence theorem

    int Y_lm dw = 1 / (l (l + 1)) sum over arcs of N.int ((l + 1) Q - l P) dalpha,    l > 0;

degree 0 is the solid angle. So one tensor a point, sum of N_i int Y_lm dalpha, holds everything.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.integrands.arcs_gradient import arc_frame, edge_in_frame, scatter, triangle
from silint.core.jit import INNER, PARALLEL
from silint.core.sh import contract, coupling, evaluate, recurrence
from silint.core.small_circle import dot

# Error of the rule on exp(i x) over an interval, per its length.
_RULE_ERROR = 1e-15
_MOST_NODES = 40


@lru_cache(maxsize=1)
def gauss_rules() -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre rules on [-1, 1] of 1 .. 40 nodes, and how fast an oscillation each of them integrates.

    Returns
    -------
    rules : (41, 40, 2) float64
        Nodes and weights of the rule with q nodes in row q.
    reach : (41,) float64
        Largest z for which the rule integrates cos(z x) to 1e-15, from its error term 2^(2q+1) (q!)^4 /
        ((2q+1) ((2q)!)^3) z^(2q). A trigonometric polynomial of degree D over an arc theta has z = D theta
        / 2.
    """
    rules, reach = np.zeros((_MOST_NODES + 1, _MOST_NODES, 2)), np.zeros(_MOST_NODES + 1)
    log_factorial = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, 2 * _MOST_NODES + 1)))])
    for q in range(1, _MOST_NODES + 1):
        rules[q, :q, 0], rules[q, :q, 1] = np.polynomial.legendre.leggauss(q)
        constant = (
            (2 * q + 1) * np.log(2.0)
            + 4.0 * log_factorial[q]
            - np.log(2 * q + 1)
            - 3.0 * log_factorial[2 * q]
        )
        reach[q] = np.exp((np.log(_RULE_ERROR) - constant) / (2 * q))
    rules.setflags(write=False)
    reach.setflags(write=False)
    return rules, reach


@njit(**INNER)
def _n_nodes(reach, degree, s, c):
    """Nodes for a trigonometric polynomial along an arc."""
    z = degree * np.arctan2(abs(s), c)
    q = 1
    while q < len(reach) - 1 and reach[q] < z:
        q += 1
    return q


@njit(**INNER)
def _along(e1, e2, cosine, sine):
    return (
        e1[0] * cosine + e2[0] * sine,
        e1[1] * cosine + e2[1] * sine,
        e1[2] * cosine + e2[2] * sine,
    )


@njit(**INNER)
def _from_arcs(sums, solid_angle, offsets, columns, axes, weights, out):
    """int Y_lm dw up to the degree of `out` from the tensor of sums over arcs (3, coefficients)."""
    out[0] = solid_angle * 0.28209479177387814  # Y_00
    degree = 1
    while degree * degree < len(out):
        for row in range(degree * degree, (degree + 1) * (degree + 1)):
            total = 0.0
            for term in range(offsets[row], offsets[row + 1]):
                column = columns[term]
                share = degree + 1.0 if column < degree * degree else -float(degree)
                total += share * weights[term] * sums[axes[term], column]
            out[row] = total / (degree * (degree + 1.0))
        degree += 1


@njit(**PARALLEL)
def differentiate_sh(
    points,
    normals,
    counts,
    starts,
    directions,
    edges,
    vertices,
    cosine,
    factor,
    rules,
    reach,
    table,
    offsets,
    columns,
    axes,
    weights,
    value,
    by_point,
    by_normal,
    singular,
):
    """SH transfer and its derivatives at each point.

    Parameters
    ----------
    points, normals, counts, starts, directions, edges, vertices, factor, singular
        As in `arcs_gradient.differentiate_arcs`.
    cosine : bool
        (1/pi) int n.w Y_lm dw, or int Y_lm dw, over the visible part of the hemisphere.
    rules, reach
        Those of `gauss_rules`.
    table
        That of `sh.recurrence`, for degree L + 1, or L + 2 for a cosine.
    offsets, columns, axes, weights
        Those of `sh.coupling`, for a degree less.
    value : (n, C) float64, out
    by_point, by_normal : (n, 3, C) float64, zero, out
    """
    n_values, top = value.shape[1], len(table) - 1
    for i in prange(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        y, along = np.empty((top + 1) ** 2), np.empty((top + 1) ** 2)
        over_r, sums = np.empty(n_values), np.zeros((3, (top + 1) ** 2))
        solid_angle, left_out = 0.0, 0
        for k in range(starts[i], starts[i] + counts[i]):
            e1, e2, normal, s, c = arc_frame(directions, k)
            solid_angle += triangle(n, e1, normal, s, c)
            on_horizon = edges[k, 0] < 0
            d1, d2, scale = 0.0, 0.0, 0.0
            if not on_horizon:
                _, _, d1, d2, area = edge_in_frame(vertices, edges, k, p, e1, e2)
                if area > 0.0:
                    scale = factor / area
                else:
                    left_out += 1
            for m in range(len(along)):
                along[m] = 0.0
            for m in range(n_values):
                over_r[m] = 0.0
            half = np.arctan2(s, c)
            q = _n_nodes(reach, top, s, c)
            for node in range(q):
                x, weight = half * rules[q, node, 0], half * rules[q, node, 1]
                cx, sx = np.cos(x), np.sin(x)
                w = _along(e1, e2, cx, sx)
                evaluate(w[0], w[1], w[2], table, y)
                for m in range(len(along)):
                    along[m] += weight * y[m]
                if on_horizon:
                    if not cosine:
                        for j in range(3):
                            for m in range(n_values):
                                by_normal[i, j, m] += weight * w[j] * y[m]
                    continue
                share = weight * (cx * d2 - sx * d1) * scale
                if cosine:
                    share *= dot(n, w) / np.pi
                for m in range(n_values):
                    over_r[m] += share * y[m]
            for j in range(3):
                for m in range(len(along)):
                    sums[j, m] += normal[j] * along[m]
                for m in range(n_values):
                    by_point[i, j, m] += normal[j] * over_r[m]
        singular[i] = left_out
        inside = np.empty(top * top)
        _from_arcs(sums, solid_angle, offsets, columns, axes, weights, inside)
        if not cosine:
            for m in range(n_values):
                value[i, m] = inside[m]
            continue
        axis, component = np.zeros(3), np.empty(n_values)
        for j in range(3):
            axis[j] = 1.0 / np.pi
            contract(offsets, columns, axes, weights, axis, inside, component)
            axis[j] = 0.0
            for m in range(n_values):
                by_normal[i, j, m] = component[m]
        for m in range(n_values):
            value[i, m] = n[0] * by_normal[i, 0, m] + n[1] * by_normal[i, 1, m] + n[2] * by_normal[i, 2, m]
            for j in range(3):
                by_normal[i, j, m] -= n[j] * value[i, m]


@njit(**PARALLEL)
def pull_back_sh(
    points,
    normals,
    counts,
    starts,
    directions,
    edges,
    vertices,
    cosine,
    factor,
    rules,
    reach,
    table,
    cotangents,
    shares,
    singular,
):
    """As `arcs_gradient.pull_back_arcs`; table is that of `sh.recurrence` for degree L."""
    degree = len(table) - 1
    for i in prange(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        y = np.empty(cotangents.shape[1])
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
            # The moment int g w dalpha, of what the cotangents make of all coefficients.
            m1, m2 = 0.0, 0.0
            half = np.arctan2(s, c)
            q = _n_nodes(reach, degree + 2, s, c)
            for node in range(q):
                x, weight = half * rules[q, node, 0], half * rules[q, node, 1]
                cx, sx = np.cos(x), np.sin(x)
                w = _along(e1, e2, cx, sx)
                evaluate(w[0], w[1], w[2], table, y)
                g = 0.0
                for m in range(len(y)):
                    g += cotangents[i, m] * y[m]
                g *= weight
                if cosine:
                    g *= dot(n, w) / np.pi
                m1 += g * cx
                m2 += g * sx
            scale = factor / area
            shares[k, 0] = -(m1 * (a2 + d2) - m2 * (a1 + d1)) * scale
            shares[k, 1] = -(a1 * m2 - a2 * m1) * scale
        singular[i] = left_out


def gradient(
    arcs: Arcs, vertices: np.ndarray, max_degree: int, weighting: str, factor: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """SH transfer (n, C), its derivatives in p and n (n, 3, C), and how many arcs had to be left out.

    Parameters
    ----------
    arcs, vertices, factor
        As in `arcs_gradient.gradient`.
    max_degree : int
        L; C = (L + 1)^2.
    weighting : {"cosine", "uniform"}
    """
    n, n_values, cosine = len(arcs.points), (max_degree + 1) ** 2, weighting == "cosine"
    top = max_degree + 1 + int(cosine)
    value, singular = np.empty((n, n_values)), np.empty(n, np.int64)
    by_point, by_normal = np.zeros((n, 3, n_values)), np.zeros((n, 3, n_values))
    differentiate_sh(
        *arcs,
        vertices,
        cosine,
        factor,
        *gauss_rules(),
        recurrence(top),
        *coupling(top - 1),
        value,
        by_point,
        by_normal,
        singular,
    )
    return value, by_point, by_normal, int(singular.sum())


def pullback(
    arcs: Arcs,
    vertices: np.ndarray,
    max_degree: int,
    weighting: str,
    factor: float,
    cotangents: np.ndarray,
    out: np.ndarray,
) -> int:
    """Add the derivative of sum(cotangents * transfer) by all vertices to `out` (V, 3); returns how many arcs
    had to be left out.
    """
    shares, singular = np.empty((len(arcs.edges), 2)), np.empty(len(arcs.points), np.int64)
    pull_back_sh(
        *arcs,
        vertices,
        weighting == "cosine",
        factor,
        *gauss_rules(),
        recurrence(max_degree),
        cotangents,
        shares,
        singular,
    )
    scatter(arcs.counts, arcs.starts, arcs.directions, arcs.edges, shares, out)
    return int(singular.sum())
