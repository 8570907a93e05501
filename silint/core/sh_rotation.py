"""Rotation of real spherical harmonics, by turns about z and one fixed matrix [PH07].

A rotation is Rz(a) Ry(b) Rz(c). A turn about z mixes only m and -m, by cos(m a) and sin(m a). A turn about y
is a turn about z between two exchanges of the axes y and z, and what an exchange does to the harmonics is a
constant, symmetric, orthogonal matrix, of which parity leaves a quarter. No step amplifies rounding, and no
matrix has to be made for a rotation.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import KERNEL, PARALLEL
from silint.core.sh import harmonics, sphere_rule

# Entries of the exchange matrix that are zero by parity come out of quadrature below this.
_ZERO = 1e-14


class Exchange(NamedTuple):
    """The matrix that exchanges y and z, sparse: f(x, z, y) from f(x, y, z)."""

    offsets: np.ndarray  # ((L + 1)^2 + 1,) int64
    columns: np.ndarray  # (t,) int64
    weights: np.ndarray  # (t,) float64


@lru_cache(maxsize=32)
def exchange(max_degree: int) -> Exchange:
    """The exchange matrix up to a degree, by quadrature that is exact for it."""
    directions, weights = sphere_rule(2 * max_degree)
    here = harmonics(directions, max_degree)
    there = harmonics(np.ascontiguousarray(directions[:, [0, 2, 1]]), max_degree)
    offsets, columns, values = [0], [], []
    for degree in range(max_degree + 1):
        block = slice(degree**2, (degree + 1) ** 2)
        matrix = there[:, block].T @ (weights[:, None] * here[:, block])
        for row in matrix:
            used = np.flatnonzero(np.abs(row) > _ZERO)
            columns.append(used + degree**2)
            values.append(row[used])
            offsets.append(offsets[-1] + len(used))
    found = Exchange(np.array(offsets), np.concatenate(columns), np.concatenate(values))
    for array in found:
        array.setflags(write=False)
    return found


@njit(**KERNEL)
def _exchanged(offsets, columns, weights, x, out):
    for row in range(len(x)):
        total = 0.0
        for term in range(offsets[row], offsets[row + 1]):
            total += weights[term] * x[columns[term]]
        out[row] = total


@njit(**KERNEL)
def _turn(c, s, n_degrees, x):
    """Turn x about z in place by the angle whose cosine and sine are given."""
    cm, sm = 1.0, 0.0
    for m in range(1, n_degrees):
        cm, sm = c * cm - s * sm, s * cm + c * sm
        for degree in range(m, n_degrees):
            centre = degree * (degree + 1)
            even, odd = x[centre + m], x[centre - m]
            x[centre + m] = cm * even - sm * odd
            x[centre - m] = sm * even + cm * odd


@njit(**KERNEL)
def _unit(c, s):
    # What is so small that its square loses digits is 0 to rounding, in entries of a rotation.
    r = np.sqrt(c * c + s * s)
    return (c / r, s / r) if r > 1e-100 else (1.0, 0.0)


@njit(**KERNEL)
def rotate(rotation, n_degrees, offsets, columns, weights, x, scratch):
    """Coefficients of f(R^-1 w) from those of f(w), in place.

    Parameters
    ----------
    rotation : (3, 3) float64
        R, orthonormal with determinant 1.
    n_degrees : int
        L + 1.
    offsets, columns, weights
        An Exchange's.
    x : ((L + 1)^2,) float64, in and out
    scratch : ((L + 1)^2,) float64
    """
    # R z lies at azimuth a and at b from z. What is left of the rotation, Ry(b) Rz(c), has sin(c), cos(c), 0
    # for its second row: well-determined however small b is, and whatever a was then taken to be.
    ca, sa = _unit(rotation[0, 2], rotation[1, 2])
    cb, sb = _unit(rotation[2, 2], ca * rotation[0, 2] + sa * rotation[1, 2])
    cc, sc = _unit(ca * rotation[1, 1] - sa * rotation[0, 1], ca * rotation[1, 0] - sa * rotation[0, 0])
    _turn(cc, sc, n_degrees, x)
    _exchanged(offsets, columns, weights, x, scratch)
    _turn(cb, -sb, n_degrees, scratch)
    _exchanged(offsets, columns, weights, scratch, x)
    _turn(ca, sa, n_degrees, x)


@njit(**PARALLEL)
def rotate_many(rotation, n_degrees, offsets, columns, weights, x):
    """`rotate` each row of x (n, (L + 1)^2) in place."""
    for i in prange(len(x)):
        rotate(rotation, n_degrees, offsets, columns, weights, x[i], np.empty(x.shape[1]))


def rotation_blocks(rotation: np.ndarray, max_degree: int) -> list[np.ndarray]:
    """Matrices (2 l + 1, 2 l + 1), one a degree, that take coefficients of f(w) to those of f(R^-1 w)."""
    columns = np.eye((max_degree + 1) ** 2)
    rotate_many(rotation, max_degree + 1, *exchange(max_degree), columns)
    blocks = [slice(l * l, (l + 1) ** 2) for l in range(max_degree + 1)]  # noqa: E741
    return [columns[block, block].T.copy() for block in blocks]
