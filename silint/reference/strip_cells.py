"""Integrals over cells of the octahedral map, a strip of u times an interval of v, by spherical geometry.

Within one octant the map is flat, so a cell is a spherical polygon of four arcs (three at the poles
u = +-1): Lambert's formula gives the integral of w over it, and its angles its area. Neither has anything
in common with the tables that silint/core sums up.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

__all__ = ["first_moments", "second_moments"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Gauss-Legendre nodes along u and along v for second moments, for which no elementary formula is at hand. The
# integrand is analytic, with its poles no nearer to a cell of full size than (1 + i)/2 to [0, 1]: rounding
# is all that these leave.
_NODES = 24


def first_moments(
    offsets: IntArray, intervals: FloatArray, isolines: int, normals: FloatArray, moment: int
) -> FloatArray:
    """Sum over all cells of the integral of n.w (moment 1) or of 1 (moment 0), in solid angle: shape (n,)."""
    return _first_moments(offsets, intervals, isolines, np.ascontiguousarray(normals), moment)


def second_moments(
    offsets: IntArray, intervals: FloatArray, isolines: int, normals: FloatArray
) -> FloatArray:
    """Sum over all cells of the integral of (n.w) w, in solid angle: shape (n, 3)."""
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return _second_moments(offsets, intervals, isolines, np.ascontiguousarray(normals), nodes, weights)


@njit(cache=True)
def _direction(u, q, f, out):
    """The point of the octahedron at u, and at fraction f of quarter q."""
    side = 1.0 - abs(u)
    near, far = side * (1.0 - f), side * f
    out[0] = u
    if q == 0:
        out[1], out[2] = near, far
    elif q == 1:
        out[1], out[2] = -far, near
    elif q == 2:
        out[1], out[2] = -near, -far
    else:
        out[1], out[2] = far, -near


@njit(cache=True)
def _piece(part, q, u0, u1, v0, v1):
    """A cell cut at u = 0 (part 0: below, 1: above) and to quarter q: u0, u1, f0, f1; empty if u0 >= u1."""
    a, b = (u0, min(u1, 0.0)) if part == 0 else (max(u0, 0.0), u1)
    f0, f1 = max(v0 - q, 0.0), min(v1 - q, 1.0)
    if f0 >= f1:
        b = a
    return a, b, f0, f1


@njit(cache=True)
def _lambert(a, b, n):
    """Half the angle from a to b, times n along the unit normal of their plane [Lambert 1760]."""
    x = a[1] * b[2] - a[2] * b[1]
    y = a[2] * b[0] - a[0] * b[2]
    z = a[0] * b[1] - a[1] * b[0]
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0
    angle = math.atan2(length, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return 0.5 * angle * (x * n[0] + y * n[1] + z * n[2]) / length


@njit(cache=True)
def _triangle_area(a, b, c):
    """Solid angle of a triangle [Van Oosterom & Strackee 1983]."""
    la = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    lb = math.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
    lc = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    det = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    ab = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    bc = b[0] * c[0] + b[1] * c[1] + b[2] * c[2]
    ca = c[0] * a[0] + c[1] * a[1] + c[2] * a[2]
    return 2.0 * math.atan2(abs(det), la * lb * lc + ab * lc + bc * la + ca * lb)


@njit(cache=True)
def _first_moments(offsets, intervals, isolines, normals, moment):
    out = np.zeros(len(normals))
    for i in range(len(normals)):
        total = 0.0
        c = np.empty((4, 3))
        for k in range(isolines):
            u0, u1 = -1.0 + 2.0 * k / isolines, -1.0 + 2.0 * (k + 1) / isolines
            for j in range(offsets[i * isolines + k], offsets[i * isolines + k + 1]):
                for part in range(2):
                    for q in range(4):
                        a, b, f0, f1 = _piece(part, q, u0, u1, intervals[j, 0], intervals[j, 1])
                        if a >= b:
                            continue
                        # Counter-clockwise as seen from outside: v turns about +x, so u must come last.
                        _direction(a, q, f0, c[0])
                        _direction(a, q, f1, c[1])
                        _direction(b, q, f1, c[2])
                        _direction(b, q, f0, c[3])
                        if moment == 0:
                            total += _triangle_area(c[0], c[1], c[2]) + _triangle_area(c[0], c[2], c[3])
                        else:
                            for e in range(4):
                                total += _lambert(c[e], c[(e + 1) % 4], normals[i])
        out[i] = total
    return out


@njit(cache=True)
def _second_moments(offsets, intervals, isolines, normals, nodes, weights):
    out = np.zeros((len(normals), 3))
    for i in range(len(normals)):
        w = np.empty(3)
        for k in range(isolines):
            u0, u1 = -1.0 + 2.0 * k / isolines, -1.0 + 2.0 * (k + 1) / isolines
            for j in range(offsets[i * isolines + k], offsets[i * isolines + k + 1]):
                for part in range(2):
                    for q in range(4):
                        a, b, f0, f1 = _piece(part, q, u0, u1, intervals[j, 0], intervals[j, 1])
                        if a >= b:
                            continue
                        for s in range(len(nodes)):
                            u = 0.5 * (a + b) + 0.5 * (b - a) * nodes[s]
                            for t in range(len(nodes)):
                                f = 0.5 * (f0 + f1) + 0.5 * (f1 - f0) * nodes[t]
                                _direction(u, q, f, w)
                                r2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
                                # dw = (1 - |u|) du df / r^3, and the integrand has w / r twice.
                                weight = 0.25 * (b - a) * (f1 - f0) * weights[s] * weights[t] * (1.0 - abs(u))
                                nw = normals[i, 0] * w[0] + normals[i, 1] * w[1] + normals[i, 2] * w[2]
                                weight *= nw / (r2 * r2 * math.sqrt(r2))
                                for axis in range(3):
                                    out[i, axis] += weight * w[axis]
    return out
