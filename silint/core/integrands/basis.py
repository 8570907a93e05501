"""Any functions of direction over visible intervals: their tables, and look-ups in them [NBMJ14 4].

"cosine" takes tables of f w, whose product with the normal is f (n.w), so that one table serves all normals.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from silint.core.integrands.fractions import Intervals
from silint.core.prefix_table import PrefixTable, build_prefix_table, integrate_intervals
from silint.core.texel_table import TexelTable, build_harmonic_table, build_texel_table, integrate_steps

_IN_FRONT = np.eye(3)


def function_table(
    function: Callable[[np.ndarray], np.ndarray], isolines: int, weighting: str
) -> PrefixTable:
    """Table of unit directions (m, 3) -> values (m, C); "cosine": column 3 c + axis is f_c w."""

    def moments(directions: np.ndarray) -> np.ndarray:
        values = function(directions)[:, :, None] * directions[:, None]
        return values.reshape(len(values), -1)

    return build_prefix_table(moments if weighting == "cosine" else function, isolines)


def texel_table(texels: np.ndarray, isolines: int, weighting: str) -> TexelTable:
    """Table of an equirectangular map (H, 2 H, C) in the frame of the scene, of any sign."""
    if weighting == "cosine":
        return build_texel_table(texels, _IN_FRONT, isolines)
    # Degree 0 is 1 / sqrt(4 pi).
    return build_harmonic_table(texels, _IN_FRONT, isolines, [np.array([[np.sqrt(4.0 * np.pi)]])])


def integrate(
    normals: np.ndarray,
    visible: Intervals,
    isolines: int,
    table: PrefixTable | TexelTable,
    weighting: str,
) -> tuple[np.ndarray, np.ndarray]:
    """int V f dw over the hemisphere of n for "uniform", (1/pi) int V max(n.w, 0) f dw for "cosine".

    Nothing is given back of what the isolines miss at the horizon: what f is there, nobody knows.

    Returns
    -------
    value : (n, C) float64
    error_estimate : (n,) float64
        The distance of what even and odd isolines say, all functions together.
    """
    if isinstance(table, PrefixTable):
        parts = integrate_intervals(table.values, table.nodes_per_quarter, *visible, isolines)
    else:
        parts = integrate_steps(table.values, table.cells_per_quarter, *visible, isolines)
    if weighting == "cosine":
        parts = np.einsum("nhci,ni->nhc", parts.reshape(len(parts), 2, -1, 3), normals) / np.pi
    difference = 2.0 * (parts[:, 0] - parts[:, 1])
    return parts.sum(axis=1), np.sqrt((difference**2).sum(axis=1))
