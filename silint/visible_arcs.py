"""Visible regions by their exact boundary: found once, integrated as often as wanted."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs as along_arcs
from silint.core.integrands import arcs_sh
from silint.core.jit import KERNEL_LOCK
from silint.io import check_output, write_bytes
from silint.sh import MAX_DEGREE, max_degree_of
from silint.validation import InputError, choice, positive_int, unit_vector
from silint.visibility import WEIGHTINGS, FloatArray

_SCHEMA = 1
_ARRAYS = ("points", "normals", "offsets", "directions", "edges", "certain")


@dataclass(frozen=True)
class VisibleArcs:
    """What shade points see, as the great circle arcs that bound it.

    Phase one of exact mode: it knows no integrand, and everything here integrates without the scene.

    Attributes
    ----------
    points, normals : (n, 3) float64
        Where the arcs are seen from: scaled to the unit of the integrator and lifted off the mesh; unit
        normals. Only what lies above their horizons is described.
    offsets : (n + 1,) int64
        The arcs of point i are rows ``offsets[i]`` to ``offsets[i + 1]``, in no particular order. A point
        without any sees nothing.
    directions : (m, 9) float64
        Unit start and end of each arc, and the unit normal of its plane. What is visible lies to its left,
        seen from outside the sphere, where that normal points. Every arc is shorter than pi.
    edges : (m, 2) int32
        Vertices of the scene from start to end, the first of each position; -1, -1 on the horizon.
    certain : (n,) bool
        False where the arcs contradict each other: do not trust these points.
    """

    points: FloatArray
    normals: FloatArray
    offsets: npt.NDArray[np.int64]
    directions: FloatArray
    edges: npt.NDArray[np.int32]
    certain: npt.NDArray[np.bool_]
    method: str = "exact"
    diagnostics: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.normals)

    @property
    def arcs(self) -> Arcs:
        """The same, as kernels take it."""
        return Arcs(
            self.points, self.normals, np.diff(self.offsets), self.offsets[:-1], self.directions, self.edges
        )

    def ambient_occlusion(self, weighting: str = "cosine") -> FloatArray:
        """Open fraction of each hemisphere, (n,); see `SilhouetteIntegrator.ambient_occlusion`."""
        choice(weighting, "weighting", WEIGHTINGS)
        with KERNEL_LOCK:
            return along_arcs.hemisphere_fraction(self.arcs, weighting)[0]

    def bent_normals(self) -> FloatArray:
        """Mean unoccluded directions, (n, 3); see `SilhouetteIntegrator.bent_normals`."""
        with KERNEL_LOCK:
            return along_arcs.bent_normal(self.arcs)[0]

    def sky_view_factor(self, up: npt.ArrayLike = (0.0, 0.0, 1.0)) -> FloatArray:
        """Fraction of the light of a uniform sky, (n,); see `SilhouetteIntegrator.sky_view_factor`."""
        axis = unit_vector(up, "up")
        with KERNEL_LOCK:
            return along_arcs.sky_view_factor(self.arcs, axis)[0]

    def vector_irradiance(self) -> FloatArray:
        """int V w dw over each hemisphere, (n, 3): the light vector of a white sky; pi n if it is open."""
        with KERNEL_LOCK:
            return along_arcs.vector_irradiance(self.arcs)

    def sh_transfer(self, max_degree: int = 4, weighting: str = "cosine") -> FloatArray:
        """Spherical harmonics of what is visible, (n, (L + 1)^2); see `SilhouetteIntegrator.sh_transfer`."""
        choice(weighting, "weighting", WEIGHTINGS)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        with KERNEL_LOCK:
            return arcs_sh.sh_transfer(self.arcs, degree, weighting)[0]

    def sh_irradiance(self, coefficients: npt.ArrayLike) -> FloatArray:
        """int L V max(n.w, 0) dw under an environment given by its harmonics, exactly: (n, C).

        Parameters
        ----------
        coefficients : array_like, shape ((L + 1)^2,) or ((L + 1)^2, C)
            Of its radiance; conventions of `silint.sh`.
        """
        degree = max_degree_of(coefficients, axis=0)
        light = np.asarray(coefficients, dtype=np.float64)
        if light.ndim > 2:
            raise InputError(f"coefficients has shape {light.shape}; expected ((L + 1)^2,) or ((L + 1)^2, C)")
        channels = np.ascontiguousarray(light.reshape(len(light), -1))
        with KERNEL_LOCK:
            return arcs_sh.sh_irradiance(self.arcs, channels, degree)[0]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to a .npz file, whole or not at all."""
        target = check_output(path, (".npz",))
        arrays: dict[str, Any] = {name: getattr(self, name) for name in _ARRAYS}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, schema=np.int64(_SCHEMA), method=np.str_(self.method), **arrays)
        write_bytes(target, buffer.getvalue())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> VisibleArcs:
        """Read what `save` wrote."""
        try:
            with open(path, "rb") as file, np.load(file) as data:
                if int(data["schema"]) != _SCHEMA or str(data["method"]) != "exact":
                    raise InputError(f"{path}: not arcs of schema {_SCHEMA}, which this silint reads")
                return cls(*(data[name] for name in _ARRAYS))
        except (OSError, KeyError, ValueError, EOFError, BadZipFile) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path}: not a file of visible arcs of silint") from None


Group = tuple[Arcs, npt.NDArray[np.bool_], npt.NDArray[np.int64]]  # arcs, certain, rows


def compact(arcs: Arcs, first_vertices: npt.NDArray[np.int32]) -> Arcs:
    """The arcs point after point without the gaps between blocks, along edges of the file's vertices.

    Parameters
    ----------
    first_vertices : (welded vertices,) int32
        The first of the file's vertices at each position.
    """
    before = np.cumsum(arcs.counts) - arcs.counts
    source = np.repeat(arcs.starts - before, arcs.counts) + np.arange(arcs.counts.sum())
    edges = arcs.edges[source]
    return arcs._replace(
        starts=before,
        directions=arcs.directions[source],
        edges=np.where(edges < 0, edges, first_vertices[edges]).astype(np.int32),
    )


def join(
    n: int, groups: list[Group]
) -> tuple[
    FloatArray,
    FloatArray,
    npt.NDArray[np.int64],
    FloatArray,
    npt.NDArray[np.int32],
    npt.NDArray[np.bool_],
]:
    """The arrays of `VisibleArcs`, in the order of the points, from compact groups of them in any order."""
    points, normals = np.empty((n, 3)), np.empty((n, 3))
    counts, certain = np.zeros(n, np.int64), np.zeros(n, bool)
    for arcs, sure, rows in groups:
        points[rows], normals[rows], counts[rows] = arcs.points, arcs.normals, arcs.counts
        certain[rows] = sure
    offsets = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])
    directions, edges = np.empty((offsets[-1], 9)), np.empty((offsets[-1], 2), np.int32)
    for arcs, _, rows in groups:
        target = np.repeat(offsets[rows] - arcs.starts, arcs.counts) + np.arange(len(arcs.edges))
        directions[target], edges[target] = arcs.directions, arcs.edges
    return points, normals, offsets, directions, edges, certain
