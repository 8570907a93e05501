"""Light through visible intervals: the tables behind irradiance from an environment.

The integral of L w dw does not depend on the normal (the horizon is part of visibility [NBMJ14 4]), so one
table serves every shade point; its product with n is irradiance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from silint.core.integrands.moments import moment_table
from silint.core.prefix_table import PrefixTable, integrate_intervals
from silint.core.runs import horizon_runs
from silint.core.texel_table import TexelTable, build_texel_table, integrate_steps

Intervals = tuple[np.ndarray, np.ndarray]  # offsets (n K + 1,), loop coordinates (m, 2)


class LightTable(NamedTuple):
    """Prefix sums of the first moments of light along K isolines."""

    kind: str
    """"constant": moments of the direction, to be multiplied with `radiance`; "texels": with L inside."""
    table: PrefixTable | TexelTable
    """Of 3 columns (x, y, z) if constant, else of 3 C: column 3 c + axis belongs to channel c."""
    radiance: np.ndarray
    """(C,) float64: the radiance of a constant environment; ones for texels."""
    isolines: int
    """K."""

    @property
    def channels(self) -> int:
        """C."""
        return len(self.radiance)


def constant_light(radiance: np.ndarray, isolines: int) -> LightTable:
    """Light of one radiance (C,) from everywhere: the smooth table that ambient occlusion is summed with.

    Irradiance is then pi L times the ambient occlusion of the same isolines.
    """
    return LightTable("constant", moment_table(1, isolines), radiance, isolines)


def texel_light(radiance: np.ndarray, rotation: np.ndarray, isolines: int) -> LightTable:
    """Light of a map (H, 2 H, C) whose frame is turned by `rotation` to that of the isolines."""
    table = build_texel_table(radiance, rotation, isolines)
    return LightTable("texels", table, np.ones(radiance.shape[2]), isolines)


def vector_irradiance(light: LightTable, offsets: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """int L w dw over intervals, even and odd isolines apart.

    Parameters
    ----------
    light : LightTable
    offsets : (n K + 1,) int64
        Where the intervals of each isoline of each point begin.
    intervals : (m, 2) float64
        Start in [0, 4) and end, at most 4 further on, in the loop coordinate.

    Returns
    -------
    (n, 2, C, 3) float64
        Its product with n, summed over the halves, is irradiance where the intervals end at the horizon.
    """
    table = light.table
    if isinstance(table, PrefixTable):
        moments = integrate_intervals(
            table.values, table.nodes_per_quarter, offsets, intervals, light.isolines
        )
        return moments[:, :, None, :] * light.radiance[:, None]
    moments = integrate_steps(table.values, table.cells_per_quarter, offsets, intervals, light.isolines)
    return moments.reshape(len(moments), 2, light.channels, 3)


def irradiance(normals: np.ndarray, visible: Intervals, light: LightTable) -> tuple[np.ndarray, np.ndarray]:
    """int L V max(n.w, 0) dw [NBMJ14 8].

    What the isolines miss of an open hemisphere under a uniform sky is given back in proportion, as in
    ambient occlusion: a constant environment gives pi L times the ambient occlusion of the same isolines.

    Returns
    -------
    value : (n, C) float64
    error_estimate : (n,) float64
        From the difference between even and odd isolines, of the channel in which it is largest.
    """
    uniform = constant_light(np.ones(1), light.isolines)
    seen = np.einsum("nhci,ni->nhc", vector_irradiance(light, *visible), normals)
    horizon = vector_irradiance(uniform, *horizon_runs(normals, light.isolines))
    whole = np.einsum("nhci,ni->nh", horizon, normals)
    value = seen.sum(axis=1) * _share(whole.sum(axis=1))[:, None]
    halves = seen * _share(whole)[..., None]
    # As it is: it holds for 88 to 99 % of points (docs/estimates.md), half of it for 81 to 99 %. A sun that
    # all lines see, but that lies in the strips of one half, makes the halves differ and the sum no worse.
    estimate = np.abs(halves[:, 0] - halves[:, 1]).max(axis=1, initial=0.0)
    # Isolines of which one half meets no hemisphere say nothing about their error.
    alone = (whole <= 0.0).any(axis=1)
    estimate[alone] = np.maximum(estimate, np.abs(value).max(axis=1, initial=0.0))[alone]
    return np.maximum(value, 0.0), estimate


def _share(whole: np.ndarray) -> np.ndarray:
    """pi over what isolines make of it; 0 where they meet no hemisphere."""
    return np.divide(np.pi, whole, out=np.zeros_like(whole), where=whole > 0.0)
