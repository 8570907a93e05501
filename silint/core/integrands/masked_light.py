"""Light past the scene in spherical harmonics: int L V Y dw over the hemisphere [NBMJ14 4].

One table of L Y_lm serves all normals, as for transfer: n.w Y_lm are harmonics one degree further. Degree 1
is vector irradiance [NBMJ14 A]; its product with the normal is irradiance with all its frequencies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from silint.core.integrands.fractions import Intervals
from silint.core.integrands.octahedral_sh import masked_transfer
from silint.core.sh import moment_degree
from silint.core.sh_rotation import rotation_blocks
from silint.core.texel_scatter import POLAR
from silint.core.texel_table import TexelTable, build_harmonic_table, cells_per_quarter, integrate_steps


class HarmonicLight(NamedTuple):
    """Prefix sums of harmonics times the light of C channels along K isolines."""

    table: TexelTable
    """Column (M + 1)^2 c + l (l + 1) + m belongs to channel c."""
    max_degree: int
    """M, of the harmonics in the table."""
    channels: int
    isolines: int


def harmonic_light(
    radiance: np.ndarray, rotation: np.ndarray, isolines: int, max_degree: int
) -> HarmonicLight:
    """Light of a map (H, 2 H, C) whose frame is turned by `rotation` to that of the isolines."""
    blocks = rotation_blocks(np.ascontiguousarray(rotation @ POLAR.T), max_degree)
    table = build_harmonic_table(radiance, rotation, isolines, blocks)
    return HarmonicLight(table, max_degree, radiance.shape[2], isolines)


def table_bytes(height: int, n_channels: int, max_degree: int, isolines: int) -> int:
    """Size of the table of a map of so many rows."""
    return 8 * isolines * (4 * cells_per_quarter(height) + 1) * n_channels * (max_degree + 1) ** 2


def sh_lighting(
    normals: np.ndarray, visible: Intervals, light: HarmonicLight, max_degree: int, weighting: str
) -> tuple[np.ndarray, np.ndarray]:
    """int L V Y dw over the hemisphere of n for "uniform", (1/pi) int L V max(n.w, 0) Y dw for "cosine".

    Returns
    -------
    value : (n, (L + 1)^2, C) float64
    error_estimate : (n,) float64
        The distance of what even and odd isolines say, all coefficients of a channel together, of the channel
        in which it is largest.
    """
    table, columns = light.table, (moment_degree(max_degree, weighting) + 1) ** 2

    def moments(intervals: Intervals) -> np.ndarray:
        found = integrate_steps(table.values, table.cells_per_quarter, *intervals, light.isolines)
        return found.reshape(len(found), 2, light.channels, -1)[..., :columns]

    return masked_transfer(normals, visible, light.isolines, max_degree, weighting, moments, light.channels)
