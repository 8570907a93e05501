"""SH transfer over the visible region from its boundary arcs, in closed form.

A harmonic of degree l > 0 is -1 / (l (l + 1)) times its own Laplacian, so that its integral over V is a sum
over boundary arcs of N.grad Y. Zonal harmonics P_l(d.w) about a few *lobes* d are integrated instead: along
an arc they are polynomials in z = d.w, a sinusoid, whose integrals follow one another. With h = N.d, S =
-dz/ds, [.] the difference between the ends, B_l = int P_l ds and G_l = h int P_l' ds,

    int_V P_l(d.w) dw = 1 / (l (l + 1)) sum G_l
    G_l = G_(l-2) + (2 l - 1) h B_(l-1)
    B_l = ((2 l - 1) ([S P_(l-1)] - h G_(l-1)) + (l - 1)^2 B_(l-2)) / l^2,   B_0 = s,   G_0 = 0

(by parts, with Bonnet's recurrence; docs/exact.md; of the structure of [WR18]). P_l at the two ends is
carried as mean and difference, so that an arc errs by rounding times its length. All factors but those of G
are below 1, and those of G are outdone by l (l + 1): rounding does not grow.

By the addition theorem 2 l + 1 lobes in general position determine a degree; more of them, in multiples of
the vector width, do it better and cost nothing. Degree 0 is the solid angle. The cosine weight needs no other
integral: n.w Y_lm are harmonics one degree further (core.sh.coupling).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.integrands.arcs import arc, arc_length, closure_gap, is_open, rounding, triangle
from silint.core.jit import INNER, PARALLEL
from silint.core.lanes import WIDTH
from silint.core.sh import Coupling, contract, coupling, harmonics, moment_degree, open_hemisphere
from silint.core.small_circle import cross

# Lobes come in packets of this many lanes: eight are unrolled by the compiler and stay scalar.
_UL = np.uint64(WIDTH)

# Points that a thread takes at a time: scratch is allocated for each such block.
_BLOCK = 64

# Fields of a packet: x, y, z of the lobe; h; mean and difference of z and of S at the ends; P_(l-1) and
# P_(l-2), means and then differences; B_(l-1), B_(l-2), G_(l-1), G_(l-2).
_N_FIELDS = 16
_X, _Y, _AXIAL, _H, _Z, _DZ, _S, _DS, _P1, _P2, _Q1, _Q2, _B1, _B2, _G1, _G2 = (
    np.uint64(i * WIDTH) for i in range(_N_FIELDS)
)

# Sets of lobes that are tried: spirals on a hemisphere (-d serves as well as d) with these turns and offsets.
_TURNS = ((5.0**0.5 - 1.0) / 2.0, 2.0**0.5 - 1.0, 3.0**0.5 - 1.0)
_OFFSETS = 11


class Lobes(NamedTuple):
    """Axes of zonal harmonics, and the way from their integrals to all harmonics up to a degree D."""

    axes: np.ndarray  # (3 J,) float64: x of WIDTH lobes, their y, their z; of the next WIDTH; ...
    matrix: np.ndarray  # ((D + 1)^2, J) float64: rows of degree l are applied to sums of G_l
    condition: float  # the largest of any degree's matrix


@lru_cache(maxsize=32)
def lobes(max_degree: int) -> Lobes:
    """The best conditioned of a few dozen spirals."""
    n = -(-(2 * max_degree + 1) // WIDTH) * WIDTH
    best, least = np.empty((0, 3)), np.inf
    for turn in _TURNS:
        for offset in np.linspace(0.0, 1.0, _OFFSETS):
            axes = _spiral(n, turn, offset)
            y = harmonics(axes, max_degree)
            worst = max(np.linalg.cond(y[:, rows]) for rows in _degrees(max_degree))
            if worst < 0.999 * least:  # no ties that rounding decides
                best, least = axes, worst
    y = harmonics(best, max_degree)
    matrix = np.zeros(((max_degree + 1) ** 2, n))
    for degree, rows in enumerate(_degrees(max_degree)):
        if degree > 0:
            # int P_l(d.w) = 4 pi / (2 l + 1) sum over m of Y_lm(d) int Y_lm
            scale = (2 * degree + 1) / (4.0 * np.pi) / (degree * (degree + 1))
            matrix[rows] = scale * np.linalg.pinv(y[:, rows])
    packets = best.reshape(-1, WIDTH, 3).transpose(0, 2, 1)
    found = Lobes(np.ascontiguousarray(packets).ravel(), matrix, float(least))
    found.axes.setflags(write=False)
    found.matrix.setflags(write=False)
    return found


def _spiral(n: int, turn: float, offset: float) -> np.ndarray:
    """Directions spread over the upper hemisphere: (n, 3) float64."""
    i = np.arange(n)
    z = (i + offset) / n
    s, phi = np.sqrt(1.0 - z * z), 2.0 * np.pi * turn * i
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=1)


def _degrees(max_degree: int) -> list[slice]:
    """Coefficients of each degree."""
    return [slice(degree**2, (degree + 1) ** 2) for degree in range(max_degree + 1)]


@lru_cache(maxsize=32)
def _steps(max_degree: int) -> np.ndarray:
    """Factors of the recurrences at degree l: (D + 1, 5) float64, row 0 unused.

    2 l - 1; (2 l - 1) / l^2 and (l - 1)^2 / l^2 of B; (2 l - 1) / l and (l - 1) / l of P.
    """
    l = np.arange(max_degree + 1.0)  # noqa: E741
    l[0] = 1.0
    factors = [2 * l - 1, (2 * l - 1) / l**2, ((l - 1) / l) ** 2, (2 * l - 1) / l, (l - 1) / l]
    table = np.stack(factors, axis=1)
    table.setflags(write=False)
    return table


@njit(**INNER)
def _sum_arcs(n, first, count, directions, axes, steps, packet, sums):
    """Solid angle of a point's region, and its sums of G_l for all lobes: sums ((D + 1) * J,).

    The loops over lanes stand here, and not in functions of their own, because handing them arrays costs
    more than what they do.
    """
    for j in range(len(sums)):
        sums[j] = 0.0
    n_lobes = np.uint64(len(axes) // 3)
    solid = 0.0
    for group in range(n_lobes // _UL):
        base = group * np.uint64(3 * WIDTH)
        for i in range(np.uint64(3 * WIDTH)):
            packet[i] = axes[base + i]
        for row in range(first, first + count):
            a, normal, chord = arc(directions, row)
            length = arc_length(a, normal, chord)
            if group == 0:
                solid += triangle(a, normal, chord, n)[0]
            c = cross(chord, normal)
            mean = a[0] + 0.5 * chord[0], a[1] + 0.5 * chord[1], a[2] + 0.5 * chord[2]
            slope = cross(mean, normal)  # -dz/ds = -(N x w).d
            for i in range(_UL):
                x, y, z = packet[_X + i], packet[_Y + i], packet[_AXIAL + i]
                packet[_H + i] = normal[0] * x + normal[1] * y + normal[2] * z
                packet[_Z + i] = mean[0] * x + mean[1] * y + mean[2] * z
                packet[_DZ + i] = chord[0] * x + chord[1] * y + chord[2] * z
                packet[_S + i] = slope[0] * x + slope[1] * y + slope[2] * z
                packet[_DS + i] = c[0] * x + c[1] * y + c[2] * z
                packet[_P1 + i], packet[_P2 + i], packet[_Q1 + i], packet[_Q2 + i] = 1.0, 0.0, 0.0, 0.0
                packet[_B1 + i], packet[_B2 + i], packet[_G1 + i], packet[_G2 + i] = length, 0.0, 0.0, 0.0
            for degree in range(1, len(steps)):
                at = np.uint64(degree) * n_lobes + group * _UL
                k0, k1, k2 = steps[degree, 0], steps[degree, 1], steps[degree, 2]
                k3, k4 = steps[degree, 3], steps[degree, 4]
                for i in range(_UL):
                    h, p, q = packet[_H + i], packet[_P1 + i], packet[_Q1 + i]
                    b, g = packet[_B1 + i], packet[_G1 + i]
                    ends = packet[_S + i] * q + packet[_DS + i] * p
                    g_next = packet[_G2 + i] + k0 * (h * b)
                    packet[_B1 + i] = k1 * (ends - h * g) + k2 * packet[_B2 + i]
                    packet[_B2 + i] = b
                    packet[_G1 + i], packet[_G2 + i] = g_next, g
                    sums[at + i] += g_next
                    z, dz = packet[_Z + i], packet[_DZ + i]
                    packet[_P1 + i] = k3 * (z * p + 0.25 * (dz * q)) - k4 * packet[_P2 + i]
                    packet[_Q1 + i] = k3 * (z * q + dz * p) - k4 * packet[_Q2 + i]
                    packet[_P2 + i], packet[_Q2 + i] = p, q
    return solid


@njit(**INNER)
def _moments(solid, sums, n_degrees, matrix, out):
    """int_V Y_lm of all degrees."""
    n_lobes = matrix.shape[1]
    out[0] = np.sqrt(0.25 / np.pi) * solid
    for degree in range(1, n_degrees):
        for row in range(degree * degree, (degree + 1) * (degree + 1)):
            total = 0.0
            for j in range(n_lobes):
                total += matrix[row, j] * sums[degree * n_lobes + j]
            out[row] = total


@njit(**PARALLEL)
def arc_transfer(normals, counts, starts, directions, axes, matrix, steps, terms, value):
    """SH transfer of each point.

    Parameters
    ----------
    normals, counts, starts, directions
        Of Arcs.
    axes, matrix
        Of Lobes, of degree D.
    steps : (D + 1, 5) float64
        See _steps.
    terms : Coupling
        Of degree D - 1; empty where the moments themselves, of degree D, are asked for.
    value : (n, (L + 1)^2) float64, out
    """
    n_points = len(counts)
    n_degrees = len(steps)
    for block in prange((n_points + _BLOCK - 1) // _BLOCK):
        packet = np.empty(_N_FIELDS * WIDTH)
        sums = np.empty(n_degrees * matrix.shape[1])
        moments, over_pi = np.empty(n_degrees * n_degrees), np.empty(3)
        for i in range(block * _BLOCK, min(n_points, (block + 1) * _BLOCK)):
            n = normals[i, 0], normals[i, 1], normals[i, 2]
            total = _sum_arcs(n, starts[i], counts[i], directions, axes, steps, packet, sums)
            _moments(total, sums, n_degrees, matrix, moments)
            if len(terms.offsets) > 0:
                for j in range(3):
                    over_pi[j] = n[j] / np.pi
                contract(terms.offsets, terms.columns, terms.axes, terms.weights, over_pi, moments, value[i])
            else:
                for j in range(value.shape[1]):
                    value[i, j] = moments[j]


@njit(**PARALLEL)
def light(transfer, coefficients, out):
    """pi times transfer (n, K) times coefficients (K, C): out (n, C), each row by itself."""
    for i in prange(len(transfer)):
        for c in range(coefficients.shape[1]):
            total = 0.0
            for j in range(transfer.shape[1]):
                total += transfer[i, j] * coefficients[j, c]
            out[i, c] = np.pi * total


_NO_TERMS = Coupling(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
for _array in _NO_TERMS:
    _array.setflags(write=False)  # as those of `coupling`: one specialisation


def sh_transfer(arcs: Arcs, max_degree: int, weighting: str) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) Y dw for "cosine", int V Y dw over the hemisphere of n for "uniform".

    Parameters
    ----------
    arcs : Arcs
    max_degree : int
        L.
    weighting : {"cosine", "uniform"}

    Returns
    -------
    value : (n, (L + 1)^2) float64
        In the axes of the world; conventions of core.sh.
    error_estimate : (n,) float64
        Of the square root of the sum of the squared errors of all coefficients.
    """
    degree = moment_degree(max_degree, weighting)
    set_of_lobes = lobes(degree)
    value = np.empty((len(arcs.counts), (max_degree + 1) ** 2))
    terms = coupling(max_degree) if weighting == "cosine" else _NO_TERMS
    arc_transfer(
        arcs.normals,
        arcs.counts,
        arcs.starts,
        arcs.directions,
        set_of_lobes.axes,
        set_of_lobes.matrix,
        _steps(degree),
        terms,
        value,
    )
    whole = is_open(arcs)
    value[whole] = open_hemisphere(np.ascontiguousarray(arcs.normals[whole]), max_degree, weighting)
    # An arc of length s adds less than s to the length of all coefficients, and s is at most pi / 2 chords;
    # uniform coefficients are up to 2 pi long.
    rounded = 2.0 * np.pi * set_of_lobes.condition * rounding(arcs)
    return value, rounded + 0.5 * np.pi * closure_gap(arcs)


def sh_irradiance(arcs: Arcs, coefficients: np.ndarray, max_degree: int) -> tuple[np.ndarray, np.ndarray]:
    """int_V L(w) max(n.w, 0) dw of an environment that is a sum of harmonics: no approximation at all.

    Parameters
    ----------
    arcs : Arcs
    coefficients : ((L + 1)^2, C) float64
        Of the radiance, in C channels.
    max_degree : int
        L.

    Returns
    -------
    value : (n, C) float64
    error_estimate : (n,) float64
        Of the channel in which it is largest.
    """
    transfer, estimate = sh_transfer(arcs, max_degree, "cosine")
    out = np.empty((len(transfer), coefficients.shape[1]))
    light(transfer, coefficients, out)
    strongest = np.sqrt((coefficients**2).sum(axis=0)).max(initial=0.0)
    return out, np.pi * strongest * estimate
