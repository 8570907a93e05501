"""What can be asked of a bake."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy.typing as npt

from silint.validation import InputError, choice, positive_int, positive_number, unit_vector

if TYPE_CHECKING:
    from silint.environment import Environment

__all__ = ["PER", "QUANTITIES", "WEIGHTINGS", "BakeOptions", "Progress"]

QUANTITIES = ("ao", "sky", "bent", "irradiance")
PER = ("vertex", "face")
WEIGHTINGS = ("cosine", "uniform")

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class BakeOptions:
    """The options of `bake` and `bake_scene`, checked when made.

    Parameters
    ----------
    quantity : {"ao", "sky", "bent", "irradiance"}
        Ambient occlusion, sky view factor, or bent normals: 1 = open, 0 = closed. Or what arrives from an
        environment.
    per : {"vertex", "face"}
        At the file's own vertices with their normals, or at the faces' centres.
    isolines : int, optional
        Lines for each point, by default 64; the error falls as their number grows.
    method : {"auto", "octahedral", "radial", "exact"}
        "exact" integrates along boundary arcs, without lines.
    weighting : {"cosine", "uniform"}
        Of ambient occlusion; the other quantities are cosine-weighted by definition.
    up : array_like, shape (3,)
        Where the sky is, for "sky".
    tolerance : float, optional
        In place of isolines: take as many as every point needs to be this accurate.
    environment : Environment or path, optional
        For "irradiance": a map (.hdr, .exr, ...), with its +y up.

    Raises
    ------
    InputError
        One of them is no good, in one line.
    """

    quantity: str = "ao"
    per: str = "vertex"
    isolines: int | None = None
    method: str = "auto"
    weighting: str = "cosine"
    up: npt.ArrayLike = (0.0, 0.0, 1.0)
    tolerance: float | None = None
    environment: Environment | str | os.PathLike[str] | None = None

    def __post_init__(self) -> None:
        choice(self.quantity, "quantity", QUANTITIES)
        choice(self.per, "per", PER)
        if self.isolines is not None:
            positive_int(self.isolines, "isolines")
        if self.tolerance is not None:
            positive_number(self.tolerance, "tolerance")
        from silint.evaluate import METHODS  # and numba with it

        choice(self.method, "method", METHODS)
        choice(self.weighting, "weighting", WEIGHTINGS)
        unit_vector(self.up, "up")
        if self.quantity == "irradiance" and self.environment is None:
            raise InputError("quantity 'irradiance' needs an environment: a map (.hdr, .exr), or Environment")
        if self.quantity != "irradiance" and self.environment is not None:
            raise InputError(
                f"environment given; only quantity 'irradiance' has one, this is {self.quantity!r}"
            )

    def light(self) -> Environment | None:
        """The environment of an irradiance, read from its file if need be."""
        if self.environment is None:
            return None
        from silint.environment import Environment

        given = self.environment
        return given if isinstance(given, Environment) else Environment.from_file(given)
