"""What a benchmark measures: a quantity as either side computes it, how it turns, the unit of errors."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.validation import InputError, choice, positive_int

if TYPE_CHECKING:
    from collections.abc import Callable

    from silint.environment import Environment
    from silint.integrator import SilhouetteIntegrator
    from silint.reference import EmbreeQMC, ReferenceResult

__all__ = ["QUANTITIES", "Quantity", "quantity_of"]

FloatArray = npt.NDArray[np.float64]

QUANTITIES = ("ao", "irradiance", "sh")


@dataclass(frozen=True)
class Quantity:
    """Ambient occlusion (n,), irradiance (n, 3), or transfer in spherical harmonics (n, (L + 1)^2)."""

    name: str = "ao"
    weighting: str = "cosine"
    environment: Environment | None = None  # of irradiance
    max_degree: int = 4  # of sh

    def silhouettes(
        self,
        integrator: SilhouetteIntegrator,
        points: FloatArray,
        normals: FloatArray,
        isolines: int,
        method: str,
        full_output: bool = False,
    ) -> Any:
        """Silint's values, or its Result."""
        if self.environment is not None:
            return integrator.irradiance(
                points, normals, self.environment, isolines, method, full_output=full_output
            )
        if self.name == "sh":
            return integrator.sh_transfer(
                points, normals, self.max_degree, isolines, self.weighting, method, full_output=full_output
            )
        return integrator.ambient_occlusion(
            points, normals, isolines, self.weighting, method, full_output=full_output
        )

    def rays(
        self,
        embree: EmbreeQMC,
        points: FloatArray,
        normals: FloatArray,
        samples: int,
        seed: int,
        scrambles: int = 1,
        progress: Callable[[int, int], None] | None = None,
    ) -> ReferenceResult:
        """Embree's values."""
        if self.environment is not None:
            return embree.irradiance(points, normals, self.environment, samples, seed, scrambles, progress)
        if self.name == "sh":
            return embree.sh_transfer(
                points, normals, self.max_degree, samples, seed, self.weighting, scrambles, progress
            )
        return embree.ambient_occlusion(points, normals, samples, seed, self.weighting, scrambles, progress)

    @property
    def fewest_rays(self) -> int:
        """Rays that Embree takes at least: one of the cosine, and one of what light there is to aim at."""
        return 1 if self.environment is None or self.environment.is_constant else 2

    def most_isolines(self, isolines: int) -> int:
        """That many, or as many as memory is spent on for tables."""
        return isolines if self.environment is None else min(isolines, self.environment.most_isolines)

    def separate(self) -> Quantity:
        """The same, with tables of its own: an environment keeps a few, not those of every setting."""
        if self.environment is None:
            return self
        return replace(self, environment=self.environment.rotated(np.eye(3)))

    def turned(self, rotation: FloatArray) -> Quantity:
        """The same where everything is turned."""
        if self.environment is None:
            return self
        return replace(self, environment=self.environment.rotated(rotation))

    def turned_back(self, values: FloatArray, rotation: FloatArray) -> FloatArray:
        """Values where everything is turned, as they are where nothing is: harmonics turn along."""
        if self.name != "sh":
            return values
        from silint.sh import rotate

        return rotate(values, rotation.T)

    def unit(self, reference: FloatArray) -> FloatArray:
        """What errors are given in: each channel's mean irradiance (3,), else 1, of shape ()."""
        mean = reference.mean(axis=0) if self.name == "irradiance" else np.array(1.0)
        return np.where(mean > 0.0, mean, 1.0)

    def as_options(self) -> dict[str, Any]:
        """For the report."""
        environment = None if self.environment is None else self.environment.name
        return {"quantity": self.name, "environment": environment, "max_degree": self.max_degree}

    def as_key(self) -> dict[str, Any]:
        """What tells one reference from another: nothing for ambient occlusion but its weighting."""
        key: dict[str, Any] = {"weighting": self.weighting}
        if self.name == "sh":
            key |= {"quantity": self.name, "max_degree": self.max_degree}
        if self.environment is not None:
            texels, rotation = self.environment.texel_radiance, self.environment.rotation
            light = hashlib.sha256(f"{texels.dtype} {texels.shape}".encode())
            light.update(np.ascontiguousarray(texels).tobytes() + np.ascontiguousarray(rotation).tobytes())
            key |= {"quantity": self.name, "environment": light.hexdigest()}
        return key


def quantity_of(name: str, weighting: str, environment: Environment | None, max_degree: int) -> Quantity:
    """A quantity from the options of a benchmark, checked."""
    from silint.environment import Environment
    from silint.sh import MAX_DEGREE

    choice(name, "quantity", QUANTITIES)
    choice(weighting, "weighting", ("cosine", "uniform"))
    max_degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
    if name == "irradiance":
        if not isinstance(environment, Environment):
            raise InputError(
                f"environment is {'missing' if environment is None else f'a {type(environment).__name__}'}; "
                "irradiance comes from a silint.Environment (on the command line, --envmap MAP)"
            )
        if weighting != "cosine":
            raise InputError("weighting is 'uniform'; irradiance has the cosine")
    elif environment is not None:
        raise InputError(f"environment is given, but {name} has no light; ask for quantity irradiance")
    return Quantity(name, weighting, environment, max_degree)
