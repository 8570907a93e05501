"""Moments of the direction: the tables behind sky fractions, ambient occlusion and bent normals.

They do not depend on the normal, so one table serves every shade point.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from silint.core.prefix_table import PrefixTable, build_prefix_table

# Rows and columns of the six distinct second moments.
_SECOND = ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])

_FUNCTIONS = {
    0: lambda w: np.ones((len(w), 1)),
    1: lambda w: w,
    2: lambda w: w[:, _SECOND[0]] * w[:, _SECOND[1]],
}


@lru_cache(maxsize=24)
def moment_table(order: int, isolines: int) -> PrefixTable:
    """Prefix sums of 1 (order 0), of w (order 1: 3 channels), of w w^T (order 2: 6 channels)."""
    table = build_prefix_table(_FUNCTIONS[order], isolines)
    table.values.setflags(write=False)
    return table


def second_moment_matrix(channels: np.ndarray) -> np.ndarray:
    """The symmetric matrices (..., 3, 3) behind channels (..., 6) of order 2."""
    matrix = np.empty((*channels.shape[:-1], 3, 3))
    matrix[..., _SECOND[0], _SECOND[1]] = channels
    matrix[..., _SECOND[1], _SECOND[0]] = channels
    return matrix
