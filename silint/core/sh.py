"""Real spherical harmonics: evaluation, products with the direction, and what a hemisphere is in them.

Y_lm with l = 0 .. L and m = -l .. l stands at index l (l + 1) + m. They are orthonormal over the sphere and
carry no Condon-Shortley phase: degree 1 is +y, +z, +x times sqrt(3 / 4 pi). With phi the azimuth about z,

    Y_lm = q_l^|m|(z) * (sqrt(2) sin(|m| phi), 1, sqrt(2) cos(m phi)) sin(theta)^|m|   for m < 0, = 0, > 0,

where the last factor is the imaginary or real part of (x + i y)^|m|, a polynomial, and q another: nothing
is singular at the poles [Slo13]. q follows from recurrences in l whose terms are normalised, so that
nothing under- or overflows and rounding does not grow [HF02].
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import KERNEL, PARALLEL


def index(degree: int, m: int) -> int:
    """Position of Y_lm among the coefficients."""
    return degree * (degree + 1) + m


@lru_cache(maxsize=32)
def recurrence(max_degree: int) -> np.ndarray:
    """Coefficients of the recurrence in l.

    Returns
    -------
    (L + 1, L + 1, 2) float64
        At [l, m] with l > m: a and b of q_l = a (z q_(l-1) - b q_(l-2)). At [m, m, 0]: q_m, which is a
        constant; for m > 0 it holds the factor sqrt(2).
    """
    table = np.zeros((max_degree + 1, max_degree + 1, 2))
    sectoral = np.sqrt(1.0 / (4.0 * np.pi))
    for m in range(max_degree + 1):
        if m > 0:
            sectoral *= np.sqrt((2 * m + 1) / (2 * m)) * (np.sqrt(2.0) if m == 1 else 1.0)
        table[m, m, 0] = sectoral
        for degree in range(m + 1, max_degree + 1):
            before = (degree - 1) ** 2
            table[degree, m, 0] = np.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
            table[degree, m, 1] = np.sqrt((before - m**2) / (4 * before - 1)) if degree > 1 else 0.0
    table.setflags(write=False)
    return table


@njit(**KERNEL)
def evaluate(x, y, z, table, out):
    """Write all Y_lm of a unit direction to out ((L + 1)^2,); table is that of `recurrence`."""
    n = len(table)
    # (x + i y)^m
    real, imaginary = 1.0, 0.0
    for m in range(n):
        q, before = table[m, m, 0], 0.0
        for degree in range(m, n):
            if degree > m:
                q, before = table[degree, m, 0] * (z * q - table[degree, m, 1] * before), q
            centre = degree * (degree + 1)
            out[centre - m] = q * imaginary
            out[centre + m] = q * real  # after the line above: for m = 0 they are the same
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real


@njit(**PARALLEL)
def evaluate_many(directions, table, out):
    """Y_lm of unit directions (n, 3) to out (n, (L + 1)^2)."""
    for i in prange(len(directions)):
        evaluate(directions[i, 0], directions[i, 1], directions[i, 2], table, out[i])


def harmonics(directions: np.ndarray, max_degree: int) -> np.ndarray:
    """Y_lm of unit directions (n, 3) float64: (n, (L + 1)^2)."""
    out = np.empty((len(directions), (max_degree + 1) ** 2))
    evaluate_many(directions, recurrence(max_degree), out)
    return out


def sphere_rule(exact_degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (m, 3) and weights (m,) that integrate all polynomials up to a degree over the sphere.

    Gauss-Legendre in z times the trapezoidal rule in azimuth; the weights sum to 4 pi.
    """
    z, weight = np.polynomial.legendre.leggauss(exact_degree // 2 + 1)
    n_phi = exact_degree + 1
    phi = 2.0 * np.pi * (np.arange(n_phi) + 0.5) / n_phi
    s = np.sqrt(1.0 - z * z)[:, None]
    grid = np.broadcast_arrays(s * np.cos(phi), s * np.sin(phi), z[:, None])
    return np.stack(grid, axis=-1).reshape(-1, 3), np.repeat(weight * (2.0 * np.pi / n_phi), n_phi)


# ------------------------------------------------------------------------------ products with the direction


class Coupling(NamedTuple):
    """w_i Y_lm in harmonics of degree l - 1 and l + 1: rows of terms, as a sparse matrix is stored."""

    offsets: np.ndarray  # ((L + 1)^2 + 1,) int64: first term of each Y_lm
    columns: np.ndarray  # (t,) int64: harmonic of the term, up to degree L + 1
    axes: np.ndarray  # (t,) int64: i
    weights: np.ndarray  # (t,) float64


@lru_cache(maxsize=32)
def coupling(max_degree: int) -> Coupling:
    """The product of a direction's components with each harmonic up to a degree.

    From the recurrences of associated Legendre functions in l and in m [DLMF 14.10], normalised: with T_lm
    the part of Y_lm that depends on theta, without sqrt(2),

        cos(theta) T_lm = u(l + 1, m) T_(l+1)m + u(l, m) T_(l-1)m,   u(l, m)^2 = (l^2 - m^2) / (4 l^2 - 1)
        sin(theta) T_lm = v(l, m) T_(l+1)(m+1) - v(l - 1, -m - 1) T_(l-1)(m+1)
                        = v(l - 1, m - 1) T_(l-1)(m-1) - v(l, -m) T_(l+1)(m-1),
        v(l, m)^2 = (l + m + 1) (l + m + 2) / ((2 l + 1) (2 l + 3)).
    """
    rows = [_product(degree, m) for degree in range(max_degree + 1) for m in range(-degree, degree + 1)]
    flat = [term for row in rows for term in row]
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64)
    columns, axes = (np.array([term[j] for term in flat], np.int64) for j in (0, 1))
    found = Coupling(offsets, columns, axes, np.array([term[2] for term in flat]))
    for array in found:
        array.setflags(write=False)
    return found


def _product(degree: int, m: int) -> list[tuple[int, int, float]]:
    """Terms (harmonic, axis, weight) of x, y, z times Y_lm; those of weight 0 are left out."""
    terms = [
        (index(other, m), 2, _along(max(degree, other), m))
        for other in (degree - 1, degree + 1)
        if other >= abs(m)
    ]
    # Products of a sine or cosine of |m| phi with cos(phi) and sin(phi) are half the sum and half the
    # difference of those of (|m| + 1) phi and (|m| - 1) phi; y exchanges sines and cosines.
    is_sine = m < 0
    for step in (1, -1):
        order = abs(m) + step
        for other in (degree - 1, degree + 1):
            if not 0 <= order <= other:
                continue
            # sqrt(2) stands before every harmonic but those with m = 0.
            half = np.sqrt(0.5) if m == 0 or order == 0 else 0.5
            size = float(half * _across(degree, abs(m), other, step))
            if is_sine:
                terms.append((index(other, order), 1, -step * size))
            else:
                terms.append((index(other, order), 0, size))
            if order > 0:  # there is no sin(0 phi)
                terms.append((index(other, -order), 0 if is_sine else 1, size if is_sine else step * size))
    return [term for term in terms if term[2] != 0.0]


def _along(degree: int, m: int) -> float:
    """u(l, m) of `coupling`."""
    return float(np.sqrt((degree**2 - m**2) / (4 * degree**2 - 1)))


def _across(degree: int, m: int, other: int, step: int) -> float:
    """Coefficient of T_(other)(m + step) in sin(theta) T_lm."""
    low = min(degree, other)
    rising = other > degree
    # v(l, m), v(l - 1, -m - 1), v(l - 1, m - 1) and v(l, -m)
    order = step * m if rising else -step * m - 1
    size = np.sqrt((low + order + 1) * (low + order + 2) / ((2 * low + 1) * (2 * low + 3)))
    return float(size if rising == (step > 0) else -size)


def moment_degree(max_degree: int, weighting: str) -> int:
    """Degree of the unweighted harmonics that a transfer up to some degree is made of."""
    return max_degree + 1 if weighting == "cosine" else max_degree


@njit(**KERNEL)
def contract(offsets, columns, axes, weights, n, moments, out):
    """Integrals of (n.w) Y_lm from those of Y_lm one degree further.

    Parameters
    ----------
    offsets, columns, axes, weights
        A Coupling's.
    n : (3,) float64
        In the axes of the harmonics.
    moments : ((L + 2)^2,) float64
    out : ((L + 1)^2,) float64, out
    """
    for row in range(len(out)):
        total = 0.0
        for term in range(offsets[row], offsets[row + 1]):
            total += weights[term] * n[axes[term]] * moments[columns[term]]
        out[row] = total


# --------------------------------------------------------------------------------------------- hemispheres


@lru_cache(maxsize=32)
def hemisphere_zonal(max_degree: int, weighting: str) -> np.ndarray:
    """What an open hemisphere about n transfers, per Y_lm(n): (L + 1,) float64.

    2 pi int_0^1 P_l(z) dz for "uniform"; 2 int_0^1 z P_l(z) dz for "cosine", a clamped cosine over pi
    [RH01]. By Funk and Hecke these are the integrals over the hemisphere, divided by Y_lm(n).
    """
    # P_l(0), and with it int_0^1 P_l = (P_(l-1)(0) - P_(l+1)(0)) / (2 l + 1).
    at_zero = np.zeros(max_degree + 4)
    at_zero[0] = 1.0
    for degree in range(2, max_degree + 4):
        at_zero[degree] = -(degree - 1) / degree * at_zero[degree - 2]
    half = np.ones(max_degree + 2)
    for degree in range(1, max_degree + 2):
        half[degree] = (at_zero[degree - 1] - at_zero[degree + 1]) / (2 * degree + 1)
    if weighting == "uniform":
        zonal: np.ndarray = 2.0 * np.pi * half[: max_degree + 1]
    else:
        zonal = np.empty(max_degree + 1)
        for degree in range(max_degree + 1):
            below = degree * half[degree - 1] if degree else 0.0
            zonal[degree] = 2.0 * ((degree + 1) * half[degree + 1] + below) / (2 * degree + 1)
    zonal.setflags(write=False)
    return zonal


def degrees(max_degree: int) -> np.ndarray:
    """Degree l of each coefficient: ((L + 1)^2,) int64."""
    l = np.arange(max_degree + 1)  # noqa: E741
    return np.repeat(l, 2 * l + 1)


def open_hemisphere(normals: np.ndarray, max_degree: int, weighting: str) -> np.ndarray:
    """SH transfer where nothing is hidden, in closed form: (n, 3) -> (n, (L + 1)^2)."""
    zonal = hemisphere_zonal(max_degree, weighting)[degrees(max_degree)]
    return harmonics(normals, max_degree) * zonal
