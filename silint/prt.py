"""Precomputed radiance transfer: what distant light does to each vertex or face, as SH coefficients.

Radiance that leaves a diffuse surface is linear in the light, so that with both in spherical harmonics
lighting is a dot product [Sloan, Kautz, Snyder 2002]: visibility is found once, and light may turn and change
ever after.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint import __version__
from silint.bake import PER, WEIGHTINGS, load_and_build, peak_memory, same_file, sites
from silint.io.prt_files import (
    MAX_DEGREE,
    TransferArrays,
    check_transfer_output,
    read_transfer,
    write_transfer,
)
from silint.validation import InputError, choice, finite_array, positive_int

if TYPE_CHECKING:
    from pathlib import Path

    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

__all__ = ["Transfer", "prt", "prt_file"]

Progress = Callable[[int, int], None]
FloatArray = npt.NDArray[np.float64]

_BLOCK = 4096  # rows of a product at a time: at degree 16 they fill 10 MB


@dataclass(frozen=True, eq=False)
class Transfer(TransferArrays):
    """SH transfer at the vertices or faces of a mesh; see `TransferArrays` for its attributes."""

    def shade(self, lighting: npt.ArrayLike) -> FloatArray:
        """Light every vertex or face.

        Parameters
        ----------
        lighting : array_like, shape (C,) or (C, 3)
            C = (max_degree + 1)^2 coefficients of the distant radiance L(w) = sum L_i Y_i(w), grey or in
            three channels, in the basis and axes of the transfer. A sun in direction d that brings the
            irradiance E to a plane facing it has L_i = E Y_i(d).

        Returns
        -------
        (n,) or (n, 3) float64
            sum_i T_i L_i, in the unit of the lighting. With weighting "cosine" the radiance that leaves a
            white diffuse surface, B = (1/pi) int V L max(n.w,0) dw: times the albedo, of any other; times
            pi, the irradiance. With "uniform" int V L dw over the hemisphere, unweighted. Band-limited
            light may ring: values can be a little below 0.

        Raises
        ------
        InputError
            Another number of coefficients, or NaN.
        """
        n = self.coefficients.shape[1]
        light = finite_array(
            lighting, "lighting", [(n,), (n, 3)], f"coefficients of degree {self.max_degree}"
        )
        channels = light.reshape(n, -1).T
        out = np.empty((len(self), len(channels)))
        # Not by BLAS, which sums in another order for another number of rows or threads.
        for start in range(0, len(self), _BLOCK):
            rows = slice(start, start + _BLOCK)
            for k, channel in enumerate(channels):
                out[rows, k] = (self.coefficients[rows] * channel).sum(axis=1)
        return out if light.ndim == 2 else out[:, 0]

    def openness(self) -> FloatArray:
        """Ambient occlusion, (n,): the coefficient of degree 0 as a fraction; 1 is open, 0 is closed.

        Also 0 where there is no normal.
        """
        # Y_00 = 1 / sqrt(4 pi); the open hemisphere has T_0 = Y_00 (cosine) or 2 pi Y_00 (uniform).
        whole = 1.0 if self.weighting == "cosine" else 2.0 * np.pi
        fraction: FloatArray = self.coefficients[:, 0] * (np.sqrt(4.0 * np.pi) / whole)
        return fraction

    def save(self, path: str | os.PathLike[str]) -> tuple[Path, ...]:
        """Write to a .npz, .ply or .glb file, or to a folder; `silint.io.prt_files` says what stands in each.

        Returns
        -------
        tuple of pathlib.Path
            The files that were written, each whole or not at all.
        """
        return write_transfer(path, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Transfer:
        """Read a file that `save` wrote; see `silint.io.prt_files.read_transfer` for its precision."""
        return cls(**vars(read_transfer(path)))

    def __repr__(self) -> str:
        return (
            f"<silint.Transfer of degree {self.max_degree} at {len(self):,} "
            f"{'vertices' if self.per == 'vertex' else 'faces'}, {self.weighting}>"
        )


def prt(
    source: Scene | SilhouetteIntegrator | str | os.PathLike[str] | Any,
    max_degree: int = 2,
    per: str = "vertex",
    isolines: int = 64,
    weighting: str = "cosine",
    method: str = "auto",
    progress: Progress | None = None,
) -> Transfer:
    """SH transfer of every vertex or face of a mesh.

    Parameters
    ----------
    source : SilhouetteIntegrator, Scene, path, or trimesh object
    max_degree : int
        0 to 16; (max_degree + 1)^2 coefficients. 2 holds what diffuse surfaces make of light, short of
        shadows [Ramamoorthi, Hanrahan 2001]; the edges of shadows want more.
    per : {"vertex", "face"}
        At the file's own vertices with their normals, or at the faces' centres.
    isolines : int
        Lines for each point; the error falls as their number grows.
    weighting : {"cosine", "uniform"}
        (1/pi) int V max(n.w,0) Y dw, or int V Y dw over the hemisphere of n.
    method : {"auto", "octahedral", "radial"}
    progress : callable, optional
        Called with (points done, points in all) from time to time.

    Returns
    -------
    Transfer
        Vertices without a normal (no face uses them) and faces without area get 0 and are counted as
        ``without_normal`` in its diagnostics.

    Raises
    ------
    InputError
        An option or the source is no good, in one line.
    """
    _check_options(max_degree, per, isolines, weighting, method)
    from silint.integrator import SilhouetteIntegrator
    from silint.one_shot import at_valid_points

    integrator: Any = source if isinstance(source, SilhouetteIntegrator) else SilhouetteIntegrator(source)
    scene: Scene = integrator.scene
    points, normals, valid = sites(scene, per)
    result = at_valid_points(
        integrator.sh_transfer,
        points,
        normals,
        valid,
        0.0,
        max_degree=max_degree,
        isolines=isolines,
        weighting=weighting,
        method=method,
        full_output=True,
        progress=progress,
    )
    diagnostics = {name: int(count) for name, count in result.diagnostics.items()}
    metadata = {
        "software": f"silint {__version__}",
        "mesh": scene.name,
        "isolines": diagnostics["isolines"],
        "method": method,
    }
    return Transfer(
        scene.vertices,
        scene.faces,
        normals,
        result.value,
        per,
        max_degree,
        weighting,
        diagnostics,
        metadata,
    )


def prt_file(
    mesh_path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    max_degree: int = 2,
    per: str = "vertex",
    isolines: int = 64,
    weighting: str = "cosine",
    method: str = "auto",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """As `prt`, from a mesh file to a file.

    Parameters
    ----------
    mesh_path : str or path-like
        Any mesh that `silint.load_scene` reads.
    output : str or path-like
        A .npz, .ply or .glb file or a folder; see `silint.io.prt_files`.
    max_degree, per, isolines, weighting, method, progress
        As in `prt`.

    Returns
    -------
    dict
        What `silint prt --json` prints: counts, seconds, openness, files with their sizes, diagnostics.

    Raises
    ------
    InputError
        An option, the mesh file or the place of the output is no good, in one line. The output is
        checked before anything is computed, and nothing is left half-written.
    """
    _check_options(max_degree, per, isolines, weighting, method)
    check_transfer_output(output, max_degree, per, weighting)
    if same_file(mesh_path, output):
        raise InputError(f"{output}: is the mesh itself; give the result another name")

    integrator, seconds = load_and_build(mesh_path)
    began = time.perf_counter()
    transfer = prt(integrator, max_degree, per, isolines, weighting, method, progress)
    integrated = time.perf_counter()
    files = transfer.save(output)
    seconds |= {"integrate": integrated - began, "write": time.perf_counter() - integrated}

    openness = transfer.openness()[transfer.normals.any(axis=1)]
    return {
        "mesh": os.fspath(mesh_path),
        "output": os.fspath(output),
        "max_degree": transfer.max_degree,
        "n_coefficients": transfer.coefficients.shape[1],
        "per": per,
        "weighting": weighting,
        **{name: transfer.metadata[name] for name in ("isolines", "method")},
        "n_vertices": integrator.scene.n_vertices,
        "n_faces": integrator.scene.n_faces,
        "n_points": len(transfer),
        "without_normal": transfer.diagnostics["without_normal"],
        # Of those that have a normal; a mesh of needles may have none.
        "openness": {
            "mean": float(openness.mean()) if openness.size else 0.0,
            "min": float(openness.min(initial=1.0)),
            "max": float(openness.max(initial=0.0)),
        },
        "files": [{"path": os.fspath(file), "bytes": file.stat().st_size} for file in files],
        "seconds": seconds,
        "peak_memory_bytes": peak_memory(),
        "diagnostics": dict(transfer.diagnostics),
    }


def _check_options(max_degree: int, per: str, isolines: int, weighting: str, method: str) -> None:
    from silint.evaluate import MAX_ISOLINES, METHODS

    positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
    choice(per, "per", PER)
    positive_int(isolines, "isolines", 1, MAX_ISOLINES)
    choice(weighting, "weighting", WEIGHTINGS)
    choice(method, "method", METHODS)
