"""Tables of an environment's light times harmonics, kept for as long as the environment is."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from silint.core.integrands import masked_light, octahedral_sh
from silint.core.integrands.masked_light import HarmonicLight
from silint.core.sh import moment_degree
from silint.environment import Environment
from silint.validation import InputError

FloatArray = npt.NDArray[np.float64]

_TABLES_KEPT = 2  # of each environment; they are large

_tables: WeakKeyDictionary[Environment, dict[tuple[int, int], HarmonicLight]] = WeakKeyDictionary()


def require_environment(environment: Any) -> Environment:
    """The argument itself, if it is one."""
    if not isinstance(environment, Environment):
        raise InputError(
            f"environment is a {type(environment).__name__}; expected a silint.Environment "
            "(Environment.from_file, .from_array, .constant, ...)"
        )
    return environment


def harmonic_table(environment: Environment, isolines: int, max_degree: int) -> HarmonicLight:
    """Prefix sums of L Y_lm of all degrees to `max_degree`; the latest few are kept."""
    # Threads may build a table twice, and then hold equal ones.
    kept = _tables.setdefault(environment, {})
    key = isolines, max_degree
    table = kept.get(key)
    if table is None:
        table = masked_light.harmonic_light(
            environment.texel_radiance, environment.rotation, isolines, max_degree
        )
        kept[key] = table
        for old in list(kept)[:-_TABLES_KEPT]:
            kept.pop(old, None)
    return table


def table_bytes(environment: Environment, isolines: int, max_degree: int) -> int:
    """Size of `harmonic_table`; a constant needs none but that of `sh_transfer`."""
    if environment.is_constant:
        return 0
    return masked_light.table_bytes(
        len(environment.texel_radiance), environment.channels, max_degree, isolines
    )


def most_isolines(environment: Environment, max_degree: int, weighting: str) -> int:
    """How many isolines, a power of two, memory is spent on for the tables."""
    most = octahedral_sh.most_isolines(max_degree, weighting)
    size = table_bytes(environment, 1, moment_degree(max_degree, weighting))
    if size:
        most = min(most, 1 << max((octahedral_sh.TABLE_BYTES // size).bit_length() - 1, 0))
    return most


def sh_lighting(
    normals: FloatArray,
    visible: tuple[npt.NDArray[np.int64], FloatArray],
    isolines: int,
    environment: Environment,
    max_degree: int,
    weighting: str,
) -> tuple[FloatArray, FloatArray]:
    """Masked light of points, (n, (L + 1)^2, 3), and its error estimate."""
    if environment.is_constant:
        transfer, error = octahedral_sh.sh_transfer(normals, visible, isolines, max_degree, weighting)
        radiance = environment.texel_radiance[0, 0].astype(np.float64)
        value, estimate = transfer[..., None] * radiance, error * radiance.max()
    else:
        table = harmonic_table(environment, isolines, moment_degree(max_degree, weighting))
        value, estimate = masked_light.sh_lighting(normals, visible, table, max_degree, weighting)
    return np.broadcast_to(value, (*value.shape[:2], 3)).copy(), estimate
