"""Prefix sums along the isolines: any function, integrated over any interval by two look-ups [NBMJ14 4].

F[k](v) is the integral over strip k and the loop coordinates [0, v], in solid angle. A column stands for the
whole width of its strip, so the totals are those of the sphere and not of K lines (which miss 4 pi by 1.3e-4
at K = 64). Nodes carry F and its derivative and are joined by cubic Hermite pieces. Sums are in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, PARALLEL

NODES_PER_QUARTER = 256

# Gauss-Legendre panels no wider than this make the integral over a strip exact to rounding for functions as
# smooth as the octahedral map itself.
_PANEL_WIDTH = 1.0 / 32.0


class PrefixTable(NamedTuple):
    """Prefix sums of C functions along K isolines."""

    values: np.ndarray  # (K, 4 M + 1, 2, C) float64: F and dF/dv at node j, v = j / M
    nodes_per_quarter: int  # M


def build_prefix_table(
    function: Callable[[np.ndarray], np.ndarray], isolines: int, nodes_per_quarter: int = NODES_PER_QUARTER
) -> PrefixTable:
    """Tabulate a function over the sphere.

    Parameters
    ----------
    function : callable
        Unit directions (m, 3) -> values (m, C).
    isolines : int
        K.
    nodes_per_quarter : int
        Resolution along the isolines.
    """
    m = nodes_per_quarter
    gauss_x, gauss_w = np.polynomial.legendre.leggauss(3)
    nodes = np.arange(4 * m + 1) / m
    inner = ((np.arange(4 * m)[:, None] + 0.5 + 0.5 * gauss_x) / m).ravel()
    values = np.empty(0)
    for k in range(isolines):
        us, weights = _strip_rule(k, isolines)
        at_nodes = _integrate_across(function, us, weights, nodes)
        cells = _integrate_across(function, us, weights, inner)
        if k == 0:
            values = np.zeros((isolines, 4 * m + 1, 2, at_nodes.shape[1]))
        values[k, :, 1] = at_nodes
        cells = np.tensordot(gauss_w / (2 * m), cells.reshape(4 * m, 3, -1), axes=(0, 1))
        np.cumsum(cells, axis=0, out=values[k, 1:, 0])
    return PrefixTable(values, m)


def _strip_rule(k: int, isolines: int) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature nodes and weights across strip k, split where the map folds at u = 0."""
    low, high = (2 * k - isolines) / isolines, (2 * k + 2 - isolines) / isolines
    gauss_x, gauss_w = np.polynomial.legendre.leggauss(5)
    us, weights = [], []
    for a, b in [(low, high)] if low * high >= 0.0 else [(low, 0.0), (0.0, high)]:
        panels = int(np.ceil((b - a) / _PANEL_WIDTH))
        half = 0.5 * (b - a) / panels
        centres = a + half * (2 * np.arange(panels) + 1)
        us.append((centres[:, None] + half * gauss_x).ravel())
        weights.append(np.tile(half * gauss_w, panels))
    return np.concatenate(us), np.concatenate(weights)


def _integrate_across(function, us, weights, vs) -> np.ndarray:
    """Integral of the function over u, per unit of v, at each of vs: (len(vs), C)."""
    points = loop_points(us[:, None], vs[None, :])
    r = np.linalg.norm(points, axis=-1)
    measure = weights[:, None] * (1.0 - np.abs(us[:, None])) / r**3
    sampled = np.asarray(function((points / r[..., None]).reshape(-1, 3)), dtype=np.float64)
    return np.einsum("uv,uvc->vc", measure, sampled.reshape(*r.shape, -1))


def loop_points(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points of the octahedron for octahedral u and loop coordinate v (conventions); (..., 3)."""
    u, v = np.broadcast_arrays(u, v)
    quarter = np.floor(v).astype(np.int64) % 4
    f = v - np.floor(v)
    y = np.choose(quarter, [1.0 - f, -f, f - 1.0, f])
    z = np.choose(quarter, [f, 1.0 - f, -f, f - 1.0])
    r = 1.0 - np.abs(u)
    return np.stack([u, r * y, r * z], axis=-1)


@njit(**INNER)
def _add_prefix(values, m, k, v, sign, out):
    """Add sign * F[k](v), 0 <= v < 8, to out (C,)."""
    n_channels = values.shape[3]
    if v >= 4.0:
        v -= 4.0
        for c in range(n_channels):
            out[c] += sign * values[k, 4 * m, 0, c]
    x = v * m
    j = min(int(x), 4 * m - 1)
    t = x - j
    h = 1.0 / m
    # Cubic Hermite basis.
    s = 1.0 - t
    f1 = t * t * (3.0 - 2.0 * t)
    g0, g1 = h * t * s * s, -h * t * t * s
    for c in range(n_channels):
        a, b = values[k, j, 0, c], values[k, j + 1, 0, c]
        out[c] += sign * (a + f1 * (b - a) + g0 * values[k, j, 1, c] + g1 * values[k, j + 1, 1, c])


@njit(**PARALLEL)
def integrate_intervals(values, m, offsets, intervals, n_lines):
    """Integrals over intervals, even and odd isolines apart.

    Parameters
    ----------
    values, m
        A PrefixTable's.
    offsets : (n K + 1,) int64
        Where the intervals of each isoline of each point begin.
    intervals : (m, 2) float64

    Returns
    -------
    (n, 2, C) float64
    """
    n = (len(offsets) - 1) // n_lines
    out = np.zeros((n, 2, values.shape[3]))
    for i in prange(n):
        for k in range(n_lines):
            for j in range(offsets[i * n_lines + k], offsets[i * n_lines + k + 1]):
                _add_prefix(values, m, k, intervals[j, 1], 1.0, out[i, k % 2])
                _add_prefix(values, m, k, intervals[j, 0], -1.0, out[i, k % 2])
    return out
