"""Visible regions as values: found once, integrated as often as wanted."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from silint import lighting
from silint.basis import Basis
from silint.core.integrands import fractions, light, octahedral_sh
from silint.core.jit import KERNEL_LOCK
from silint.environment import Environment
from silint.io import check_output, write_bytes
from silint.sh import MAX_DEGREE
from silint.validation import InputError, choice, positive_int, unit_vector

FloatArray = npt.NDArray[np.float64]
WEIGHTINGS = ("cosine", "uniform")
_SCHEMA = 1


class Result(NamedTuple):
    """A value with what is known about it."""

    value: FloatArray
    """What the plain call returns."""
    error_estimate: FloatArray
    """(n,) what the errors of 95 % of points are below, from how much groups of isolines differ. What no
    isoline meets it cannot see: with few isolines among small things fewer hold (docs/estimates.md)."""
    diagnostics: Mapping[str, int]
    """Counts over all points; see `SilhouetteIntegrator`."""


@dataclass(frozen=True)
class Visibility:
    """Visible intervals on the octahedral isolines of shade points.

    Phase one of the method: it knows no integrand, and everything here integrates without the scene.

    Attributes
    ----------
    normals : (n, 3) float64
        Unit normals; only what lies above their horizons is described.
    isolines : int
        K, the number of isolines.
    offsets : (n K + 1,) int64
        The intervals of isoline k of point i are rows ``offsets[i K + k]`` to ``offsets[i K + k + 1]``.
    intervals : (m, 2) float64
        Start in [0, 4) and end of each interval in the loop coordinate (silint.core.conventions); an end
        past 4 has gone round.
    """

    normals: FloatArray
    isolines: int
    offsets: npt.NDArray[np.int64]
    intervals: FloatArray
    method: str = "octahedral"
    diagnostics: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.normals)

    def ambient_occlusion(self, weighting: str = "cosine") -> FloatArray:
        """Open fraction of each hemisphere, (n,); see `SilhouetteIntegrator.ambient_occlusion`."""
        choice(weighting, "weighting", WEIGHTINGS)
        with KERNEL_LOCK:
            return fractions.hemisphere_fraction(self.normals, self._visible, self.isolines, weighting)[0]

    def bent_normals(self) -> FloatArray:
        """Mean unoccluded directions, (n, 3); see `SilhouetteIntegrator.bent_normals`."""
        with KERNEL_LOCK:
            return fractions.bent_normal(self.normals, self._visible, self.isolines)[0]

    def sky_view_factor(self, up: npt.ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
        """Fraction of the light of a uniform sky, (n,); see `SilhouetteIntegrator.sky_view_factor`."""
        axis = unit_vector(up, "up")
        with KERNEL_LOCK:
            return fractions.sky_view_factor(self.normals, self._visible, self.isolines, axis)[0]

    def sh_transfer(self, max_degree: int = 4, weighting: str = "cosine") -> FloatArray:
        """Spherical harmonics of what is visible, (n, (L + 1)^2); see `SilhouetteIntegrator.sh_transfer`."""
        choice(weighting, "weighting", WEIGHTINGS)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        check_table(self.isolines, octahedral_sh.most_isolines(degree, weighting))
        with KERNEL_LOCK:
            return octahedral_sh.sh_transfer(self.normals, self._visible, self.isolines, degree, weighting)[0]

    def irradiance(self, environment: Environment) -> FloatArray:
        """What arrives from an environment, (n, 3); see `SilhouetteIntegrator.irradiance`."""
        if not isinstance(environment, Environment):
            raise InputError(f"environment is a {type(environment).__name__}; expected a silint.Environment")
        return self._irradiance(environment)[0]

    def _irradiance(self, environment: Environment) -> tuple[FloatArray, FloatArray]:
        """The same, and its error estimate."""
        table = environment.moment_table(self.isolines)
        with KERNEL_LOCK:
            value, estimate = light.irradiance(self.normals, self._visible, table)
        return np.broadcast_to(value, (len(value), 3)).copy(), estimate

    def sh_lighting(
        self, environment: Environment, max_degree: int = 2, weighting: str = "uniform"
    ) -> FloatArray:
        """Masked light in harmonics, (n, (L + 1)^2, 3); see `SilhouetteIntegrator.sh_lighting`."""
        choice(weighting, "weighting", WEIGHTINGS)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        light = lighting.require_environment(environment)
        check_table(self.isolines, lighting.most_isolines(light, degree, weighting), "")
        with KERNEL_LOCK:
            return lighting.sh_lighting(self.normals, self._visible, self.isolines, light, degree, weighting)[
                0
            ]

    def integrate(self, basis: Any, weighting: str = "uniform") -> FloatArray:
        """int V f dw above each horizon, for any functions f; see `SilhouetteIntegrator.integrate`.

        Parameters
        ----------
        basis : callable, array_like (H, 2 H) or (H, 2 H, C), or PrefixTable
            A function of unit directions (m, 3) with values (m, C) or (m,), an equirectangular table, or a
            table from `prefix_table` with as many isolines. The first two are tabulated in every call.
        weighting : {"uniform", "cosine"}
            int V f dw, or (1/pi) int V max(n.w, 0) f dw.

        Returns
        -------
        (n, C) float64
            In units of f times steradians.
        """
        choice(weighting, "weighting", WEIGHTINGS)
        functions = Basis(basis, weighting)
        if functions.is_function:
            functions.table(self.isolines)  # before the lock is taken: who knows what a function does
        with KERNEL_LOCK:
            return functions.integrate(self.normals, self._visible, self.isolines)[0]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to a .npz file, whole or not at all."""
        target = check_output(path, (".npz",))
        arrays: dict[str, Any] = {
            "schema": np.int64(_SCHEMA),
            "normals": self.normals,
            "isolines": np.int64(self.isolines),
            "offsets": self.offsets,
            "intervals": self.intervals,
            "method": np.str_(self.method),
        }
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_bytes(target, buffer.getvalue())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Visibility:
        """Read what `save` wrote."""
        try:
            with open(path, "rb") as file, np.load(file) as data:
                if int(data["schema"]) != _SCHEMA:
                    raise InputError(f"{path}: schema {int(data['schema'])}; this silint reads {_SCHEMA}")
                return cls(
                    data["normals"],
                    int(data["isolines"]),
                    data["offsets"],
                    data["intervals"],
                    str(data["method"]),
                )
        except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: not a visibility file of silint") from None

    @property
    def _visible(self) -> tuple[npt.NDArray[np.int64], FloatArray]:
        return self.offsets, self.intervals


def check_table(
    isolines: int, most: int, way_out: str = ", or take method='radial', which needs no table"
) -> None:
    """Refuse a table of harmonics that memory may not hold."""
    if isolines > most:
        raise InputError(
            f"isolines is {isolines}; the table of so many harmonics is kept to {most} octahedral ones: "
            f"lower max_degree{way_out}"
        )


def in_rows(
    n: int,
    isolines: int,
    lengths: list[npt.NDArray[np.int64]],
    intervals: list[FloatArray],
    rows: list[npt.NDArray[np.int64]],
) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Offsets and intervals in the order of the points, from groups of points in any order."""
    counts = np.zeros((n, isolines), np.int64)
    for length, group in zip(lengths, rows, strict=True):
        counts[group] = length.reshape(-1, isolines)
    offsets = np.concatenate([[0], np.cumsum(counts.ravel())])
    ordered = np.empty((offsets[-1], 2))
    for length, found, group in zip(lengths, intervals, rows, strict=True):
        per_point = length.reshape(-1, isolines).sum(axis=1)
        before = np.cumsum(per_point) - per_point
        shift = offsets[group * isolines] - before
        ordered[np.repeat(shift, per_point) + np.arange(len(found))] = found
    return offsets, ordered
