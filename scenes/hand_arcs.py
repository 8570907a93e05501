"""Convex occluders: their outlines as boundary arcs, made by hand, and an oracle that knows no arcs.

Written for silint. Occluders must not overlap as seen from a point; they may be cut by its horizon.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from silint.core.arcs_types import Arcs
from silint.core.sh import evaluate, hemisphere_zonal, recurrence

Q = 32  # nodes of the oracle's quadrature along each side of a triangle


class Hull(NamedTuple):
    """A convex occluder: triangles of a closed polytope, or one planar polygon seen from either side."""

    corners: np.ndarray  # rows of the vertices
    faces: np.ndarray  # (F, 3) into corners; outward for a solid
    solid: bool


def polygon(corners):
    return Hull(np.asarray(corners), np.array([(0, i, i + 1) for i in range(1, len(corners) - 1)]), False)


def box(corners):
    """Corners by bits: x of bit 0, y of bit 1, z of bit 2. Its faces stay planar only while it is a box."""
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return Hull(
        np.asarray(corners), np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]), True
    )


# ------------------------------------------------------------------------------------------- arcs by hand


def _seen(hull, vertices, p):
    """Triangles that cover the occluder's projection once, as rows of the vertices."""
    faces = hull.corners[hull.faces]
    if not hull.solid:
        return faces
    a, b, c = (np.real(vertices)[faces[:, i]] - np.real(p) for i in range(3))
    return faces[(a * np.cross(b, c)).sum(axis=1) < 0.0]


def _outline(hull, vertices, p):
    """Edges of the projection, each with the occluder on its right as seen from outside the sphere."""
    directed = {}
    for a, b, c in _seen(hull, vertices, p):
        for i, j in ((a, b), (b, c), (c, a)):
            if directed.pop((j, i), None) is None:
                directed[i, j] = True
    centre = vertices[hull.corners].mean(axis=0) - p
    edges = []
    for a, b in directed:
        normal = np.cross(vertices[a] - p, vertices[b] - p)
        edges.append((b, a) if normal @ centre > 0.0 else (a, b))
    return edges


def make_arcs(points, normals, vertices, hulls, cuts=1):
    """The boundary of what is seen past convex occluders that do not overlap as seen from any point.

    `cuts` cuts every arc in as many.
    """
    rows, edges, counts = [], [], []
    for p, n in zip(points, normals, strict=True):
        n = n / np.linalg.norm(n)
        before = len(rows)
        hidden = []
        for hull in hulls:
            exits = {}
            for a, b in _outline(hull, vertices, p):
                x, y = vertices[a] - p, vertices[b] - p
                hx, hy = x @ n, y @ n
                if max(hx, hy) <= 0.0:
                    continue
                normal = np.cross(x, y) / np.linalg.norm(np.cross(x, y))
                crossing = (x * hy - y * hx) / (hy - hx) if min(hx, hy) < 0.0 else None
                if hx < 0.0:
                    x = exits["up"] = crossing
                if hy < 0.0:
                    y = exits["down"] = crossing
                rows += _cut(x, y, normal, cuts)
                edges += [(a, b)] * cuts
            if exits:
                # Clockwise: the outline comes up where what it hides of the horizon begins.
                hidden.append((exits["up"], exits["down"]))
        t = np.cross(n, [0.31, -0.52, 0.8])
        t /= np.linalg.norm(t)
        m = np.cross(n, t)
        azimuths = sorted(tuple(np.arctan2(w @ m, w @ t) % (2 * np.pi) for w in pair) for pair in hidden)
        for lo, hi in _open_stretches(azimuths):
            pieces = int(np.ceil((hi - lo) / (0.5 * np.pi)))
            for x, y in zip(
                *(np.linspace(lo, hi, pieces + 1)[s] for s in (slice(-1), slice(1, None))), strict=True
            ):
                rows += _cut(*(np.cos(v) * t + np.sin(v) * m for v in (x, y)), n, 1)
                edges.append((-1, -1))
        counts.append(len(rows) - before)
    counts = np.array(counts, np.int64)
    unit = normals / np.linalg.norm(normals, axis=1)[:, None]
    return Arcs(
        np.ascontiguousarray(points, float),
        unit,
        counts,
        np.cumsum(counts) - counts,
        np.array(rows).reshape(-1, 9),
        np.array(edges, np.int32).reshape(-1, 2),
    )


def _cut(x, y, normal, cuts):
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    angle = np.arctan2(np.linalg.norm(np.cross(x, y)), x @ y)
    turns = np.linspace(0.0, angle, cuts + 1)
    ends = [np.cos(a) * x + np.sin(a) * np.cross(normal, x) for a in turns[:-1]] + [y]
    return [np.concatenate([a, b, normal]) for a, b in pairwise(ends)]


def _open_stretches(hidden):
    """What intervals of azimuth, from..to counter-clockwise, leave open of a circle."""
    if not hidden:
        return [(0.0, 2 * np.pi)]
    following = hidden[1:] + hidden[:1]
    return [(hi, hi + (nxt - hi) % (2 * np.pi)) for (_, hi), (nxt, _) in zip(hidden, following, strict=True)]


# ------------------------------------------------------------------------------------------------ the oracle


def harmonics(w, max_degree):
    """Y_lm of directions (m, 3), real or complex: (m, (L + 1)^2)."""
    out = np.empty(((max_degree + 1) ** 2, len(w)), w.dtype)
    evaluate.py_func(w[:, 0], w[:, 1], w[:, 2], recurrence(max_degree), out)
    return out.T


def integrands(quantity, n, max_degree=3):
    """f(w) of a quantity, (m, 3) -> (m, C), and its integral over the whole hemisphere of n.

    n has to be of unit length, and may be complex.
    """
    one = np.ones(1, n.dtype)
    open_sh = [harmonics(n[None], max_degree)[0]]
    repeat = np.repeat(np.arange(max_degree + 1), 2 * np.arange(max_degree + 1) + 1)
    weighting = quantity.split()[-1]
    if quantity.startswith("sh"):
        whole = open_sh[0] * hemisphere_zonal(max_degree, weighting)[repeat]
        if weighting == "uniform":
            return (lambda w: harmonics(w, max_degree)), whole
        return (lambda w: harmonics(w, max_degree) * (w @ n)[:, None] / np.pi), whole
    return {
        "cosine": (lambda w: (w @ n)[:, None] / np.pi, one),
        "uniform": (lambda w: np.ones((len(w), 1)) / (2.0 * np.pi), one),
        "vector": (lambda w: w, np.pi * n),
        "bent": (lambda w: w * (w @ n)[:, None] / np.pi, 2.0 / 3.0 * n),
    }[quantity]


def oracle(quantity, p, n, vertices, hulls, max_degree=3):
    """F by quadrature over the faces of what hides the rest: (C,).

    Analytic in p, n and vertices, so that an imaginary step of 1e-30 gives derivatives without rounding of
    differences [Squire and Trapp 1998].
    """
    n = n / np.sqrt((n * n).sum())
    f, value = integrands(quantity, n, max_degree)
    x, weight = np.polynomial.legendre.leggauss(Q)
    u, v = np.meshgrid(0.5 * (x + 1.0), 0.5 * (x + 1.0), indexing="ij")
    weights = np.outer(weight, weight) * 0.25 * u
    for hull in hulls:
        for triangle in _seen(hull, vertices, p):
            clipped = _above(vertices[triangle] - p, n)
            for i in range(1, len(clipped) - 1):
                a, b, c = clipped[0], clipped[i], clipped[i + 1]
                at = (a + u[..., None] * (b - a) + (u * v)[..., None] * (c - b)).reshape(-1, 3)
                r = np.sqrt((at * at).sum(axis=1))
                volume = np.dot(a, np.cross(b, c))
                sign = 1.0 if np.real(volume) > 0.0 else -1.0
                value = value - (f(at / r[:, None]) * (sign * volume * weights.ravel() / r**3)[:, None]).sum(
                    axis=0
                )
    return value


def _above(corners, n):
    """The part of a polygon in front of the plane through the origin [Sutherland and Hodgman 1974]."""
    out, height = [], corners @ n
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        if height[i].real > 0.0:
            out.append(corners[i])
        if (height[i].real > 0.0) != (height[j].real > 0.0):
            out.append((corners[i] * height[j] - corners[j] * height[i]) / (height[j] - height[i]))
    return out


def oracle_gradient(quantity, p, n, vertices, hulls, max_degree=3):
    """Value (C,), derivatives in p and n (3, C), and in vertices (V, 3, C)."""
    step = 1e-30

    def derivative(shape, evaluate_at):
        columns = []
        for k in range(np.prod(shape)):
            h = np.zeros(shape, complex)
            h.flat[k] = 1j * step
            columns.append(np.imag(evaluate_at(h)) / step)
        return np.array(columns).reshape(*shape, -1)

    def at(dp=0.0, dn=0.0, dv=0.0):
        return oracle(quantity, p + dp, n + dn, vertices + dv, hulls, max_degree)

    return (
        np.real(at()),
        derivative((3,), lambda h: at(dp=h)),
        derivative((3,), lambda h: at(dn=h)),
        derivative(vertices.shape, lambda h: at(dv=h)),
    )
