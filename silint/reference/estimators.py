"""What Embree QMC estimates: how rays are made, and what is added up of those that got through."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from silint.reference import light_rays, rays, sh_sums
from silint.validation import InputError

__all__ = ["Estimator", "Harmonics", "Light", "OpenDirections", "OpenShare", "RayBuffers", "sampler_of"]

FloatArray = npt.NDArray[np.float64]
Bits = npt.NDArray[np.int32]


class RayBuffers:
    """Room for a batch of rays; one for each thread, filled anew for every batch."""

    def __init__(self, points: int, rays_each: int) -> None:
        m = points * rays_each
        self.origins = np.empty((m, 3), np.float32)
        self.directions = np.empty((m, 3), np.float32)
        self.texels = np.empty(m, np.int32)
        self.counts = np.empty(points, np.int64)


class Estimator(Protocol):
    """Sums over rays. A scramble divides its samples evenly among `streams` independent sets."""

    streams: int
    columns: tuple[int, ...]
    """Shape of a point's sums."""

    def make(
        self,
        stream: int,
        origins: npt.NDArray[np.float32],
        normals: FloatArray,
        samples: tuple[Bits, Bits],
        shifts: Bits,
        to: RayBuffers,
    ) -> int:
        """Write the rays of some points; how many they are."""

    def add(self, stream: int, hits: npt.NDArray[Any], normals: FloatArray, of: RayBuffers, out: Any) -> None:
        """Write each point's sums, from what `make` wrote and what its rays met (negative: nothing)."""


class _Hemisphere:
    """Rays over the hemisphere of the normal, by the cosine or evenly; as many for each point."""

    streams = 1

    def __init__(self, uniform: bool, columns: tuple[int, ...]) -> None:
        self.uniform, self.columns = uniform, columns

    def make(
        self,
        stream: int,
        origins: npt.NDArray[np.float32],
        normals: FloatArray,
        samples: tuple[Bits, Bits],
        shifts: Bits,
        to: RayBuffers,
    ) -> int:
        """Write rays; see `Estimator`."""
        m = len(origins) * len(samples[0])
        rays.make_rays(origins, normals, *samples, shifts, self.uniform, to.origins[:m], to.directions[:m])
        return m


class OpenShare(_Hemisphere):
    """How many rays met nothing."""

    def __init__(self, uniform: bool) -> None:
        super().__init__(uniform, ())

    def add(self, stream: int, hits: npt.NDArray[Any], normals: FloatArray, of: RayBuffers, out: Any) -> None:
        """Write sums; see `Estimator`."""
        rays.count_open(hits, out)


class OpenDirections(_Hemisphere):
    """Sums of w (3 columns) and of [up.w > 0], over cosine-distributed rays that met nothing."""

    def __init__(self, up: FloatArray) -> None:
        super().__init__(False, (4,))
        self.up = up

    def add(self, stream: int, hits: npt.NDArray[Any], normals: FloatArray, of: RayBuffers, out: Any) -> None:
        """Write sums; see `Estimator`."""
        rays.sum_open(hits, of.directions[: len(hits)], self.up, out)


class Harmonics(_Hemisphere):
    """Sums of all Y up to a degree, over rays that met nothing."""

    def __init__(self, uniform: bool, max_degree: int) -> None:
        super().__init__(uniform, ((max_degree + 1) ** 2,))
        self.factors = sh_sums.recurrence(max_degree)

    def add(self, stream: int, hits: npt.NDArray[Any], normals: FloatArray, of: RayBuffers, out: Any) -> None:
        """Write sums; see `Estimator`."""
        sh_sums.sum_harmonics(hits, of.directions[: len(hits)], self.factors, out)


class Light(_Hemisphere):
    """Irradiance over `scale`, by rays that follow the cosine and, where there is any, bright light."""

    def __init__(self, light: light_rays.LightSampler) -> None:
        super().__init__(False, (3,))
        self.light = light
        self.streams = 2 if light.importance else 1

    def make(
        self,
        stream: int,
        origins: npt.NDArray[np.float32],
        normals: FloatArray,
        samples: tuple[Bits, Bits],
        shifts: Bits,
        to: RayBuffers,
    ) -> int:
        """Write rays; see `Estimator`."""
        if stream == 0:
            to.counts[: len(origins)] = len(samples[0])
            return super().make(stream, origins, normals, samples, shifts, to)
        return int(
            light_rays.make_light_rays(
                origins,
                normals,
                *samples,
                shifts,
                self.light,
                to.origins,
                to.directions,
                to.texels,
                to.counts,
            )
        )

    def add(self, stream: int, hits: npt.NDArray[Any], normals: FloatArray, of: RayBuffers, out: Any) -> None:
        """Write sums; see `Estimator`."""
        directions, texels = of.directions[: len(hits)], of.texels[: len(hits)]
        if stream == 0:
            light_rays.texels_of(directions, self.light, texels)
        light_rays.add_light(hits, directions, texels, of.counts, normals, self.light, out)


def sampler_of(environment: Any, importance: bool) -> light_rays.LightSampler:
    """Tables of anything with `texel_radiance` (H, 2 H, C) and `rotation` (3, 3), as a silint.Environment."""
    try:
        texels, rotation = environment.texel_radiance, environment.rotation
    except AttributeError:
        raise InputError(
            f"environment is a {type(environment).__name__}; expected a silint.Environment "
            "(Environment.from_file, .from_array, .constant, ...)"
        ) from None
    return light_rays.light_sampler(texels, rotation, importance)
