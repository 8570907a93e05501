"""Closed forms over what is visible within a distance, from boundary arcs of which some lie on small circles.

Where a face leaves the ball about the shade point, the boundary runs along the circle N.w = c, with the
visible side and N on its left. With D its angle about N, from a to b, and rho^2 = 1 - c^2:

    1/2 int w x dw = 1/2 (rho^2 D N + c N x (b - a))
    int_V dw       : what an arc adds to the triangle (n, a, b) is the segment between circle and chord,
                     D (1 - c) - 2 arctan2((1 - c) sin(D), 1 + c + (1 - c) cos(D)): a sector less a triangle
    int_V w w^T dw : 1/3 (int_V dw) 1 + 1/6 sum int (w m^T + m w^T) ds, m = (N - c w) / rho

which are those of `arcs` for c = 0, and their limits for polygons of great circle arcs.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs as along_arcs
from silint.core.integrands.arcs import angle, arc, arc_length, error_of_gap, triangle
from silint.core.jit import INNER, PARALLEL
from silint.core.small_circle import cross, dot


@njit(**INNER)
def _turn(a, normal, chord, c):
    """Angle of an arc about the axis of its circle, and rho^2."""
    square = (1.0 - c) * (1.0 + c)
    return angle(dot(normal, cross(a, chord)), square - 0.5 * dot(chord, chord)), square


@njit(**INNER)
def _flux(a, normal, chord, c, n):
    """n . (1/2 int w x dw) along an arc."""
    if c == 0.0:
        return 0.5 * arc_length(a, normal, chord) * dot(n, normal)
    turn, square = _turn(a, normal, chord, c)
    return 0.5 * (square * turn * dot(n, normal) + c * dot(n, cross(normal, chord)))


@njit(**INNER)
def _solid(a, normal, chord, c, n):
    """Signed solid angle between n and an arc."""
    if c == 0.0:
        solid, _ = triangle(a, normal, chord, n)
        return solid
    turn, _ = _turn(a, normal, chord, c)
    over = dot(n, cross(a, chord))
    solid = 2.0 * angle(over, 2.0 - 0.5 * dot(chord, chord) + 2.0 * dot(a, n) + dot(chord, n))
    # About the end of the axis that is nearer to the circle.
    near = abs(c)
    sine, cosine = np.sin(turn), np.cos(turn)
    segment = turn * (1.0 - near) - 2.0 * angle((1.0 - near) * sine, 1.0 + near + (1.0 - near) * cosine)
    return solid + (segment if c > 0.0 else -segment)


@njit(**INNER)
def _moment(a, normal, chord, c, n):
    """n . int (w m^T + m w^T) ds along an arc."""
    if c == 0.0:
        _, w = triangle(a, normal, chord, n)
        wn, nn = dot(w, n), dot(normal, n)
        return normal[0] * wn + w[0] * nn, normal[1] * wn + w[1] * nn, normal[2] * wn + w[2] * nn
    turn, square = _turn(a, normal, chord, c)
    rho = np.sqrt(square)
    nn = dot(normal, n)
    # u from the axis to the middle of the arc, v along the arc there.
    x, y, z = 2.0 * a[0] + chord[0], 2.0 * a[1] + chord[1], 2.0 * a[2] + chord[2]
    d = x * normal[0] + y * normal[1] + z * normal[2]
    x, y, z = x - d * normal[0], y - d * normal[1], z - d * normal[2]
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    u = x / length, y / length, z / length
    v = cross(normal, u)
    half = 2.0 * np.sin(0.5 * turn)  # int cos over the arc
    even, odd = 0.5 * (turn + np.sin(turn)), 0.5 * (turn - np.sin(turn))  # int cos^2, int sin^2
    un, vn = dot(u, n), dot(v, n)
    # int w dD = c D N + rho half u, and int w (w.n) dD, by components along N, u and v.
    along_n, along_u = c * turn, rho * half
    wn = along_n * nn + along_u * un
    square_n = c * c * nn * turn + c * rho * half * un
    square_u = c * rho * half * nn + square * even * un
    square_v = square * odd * vn
    # ds = rho dD, so that ds m = (N - c w) dD.
    on_n = along_n * nn + wn - 2.0 * c * square_n
    on_u = along_u * nn - 2.0 * c * square_u
    on_v = -2.0 * c * square_v
    return (
        on_n * normal[0] + on_u * u[0] + on_v * v[0],
        on_n * normal[1] + on_u * u[1] + on_v * v[1],
        on_n * normal[2] + on_u * u[2] + on_v * v[2],
    )


@njit(**PARALLEL)
def sum_within(normals, counts, starts, directions, uniform, out):
    """int_V n.w dw, or the solid angle int_V dw, of each point: out (n,)."""
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        total = 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            c = directions[row, 9]
            total += _solid(a, normal, chord, c, n) if uniform else _flux(a, normal, chord, c, n)
        out[i] = total


@njit(**PARALLEL)
def sum_moments_within(normals, counts, starts, directions, out):
    """int_V (n.w) w dw of each point: out (n, 3)."""
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        total, x, y, z = 0.0, 0.0, 0.0, 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            c = directions[row, 9]
            total += _solid(a, normal, chord, c, n)
            u, v, w = _moment(a, normal, chord, c, n)
            x, y, z = x + u, y + v, z + w
        out[i, 0] = total / 3.0 * n[0] + x / 6.0
        out[i, 1] = total / 3.0 * n[1] + y / 6.0
        out[i, 2] = total / 3.0 * n[2] + z / 6.0


def _has_circles(arcs: Arcs) -> bool:
    return arcs.directions.shape[1] > 9


def hemisphere_fraction(arcs: Arcs, weighting: str) -> tuple[np.ndarray, np.ndarray]:
    """As `arcs.hemisphere_fraction`, within a distance too."""
    if not _has_circles(arcs):
        return along_arcs.hemisphere_fraction(arcs, weighting)
    uniform = weighting == "uniform"
    value = np.empty(len(arcs.counts))
    sum_within(arcs.normals, arcs.counts, arcs.starts, arcs.directions, uniform, value)
    return along_arcs.as_fraction(value / (2.0 * np.pi if uniform else np.pi), np.ones(len(value)), arcs)


def bent_normal(arcs: Arcs) -> tuple[np.ndarray, np.ndarray]:
    """As `arcs.bent_normal`, within a distance too."""
    if not _has_circles(arcs):
        return along_arcs.bent_normal(arcs)
    value = np.empty((len(arcs.counts), 3))
    sum_moments_within(arcs.normals, arcs.counts, arcs.starts, arcs.directions, value)
    value /= np.pi
    whole = along_arcs.is_open(arcs)
    value[whole] = (2.0 / 3.0) * arcs.normals[whole]
    return value, error_of_gap(arcs)
