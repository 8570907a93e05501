"""From a mesh file to a file with a value for each of its vertices or faces."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint import __version__
from silint.bake.options import BakeOptions, Progress
from silint.io import LUMINANCE, TONE_CURVE, Baked, check_output, write_baked
from silint.validation import InputError, unit_vector

if TYPE_CHECKING:
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

__all__ = ["bake", "bake_scene", "load_and_build", "peak_memory", "same_file", "sites"]

_MEANINGS = {
    "ao": "ambient occlusion: visible fraction of the hemisphere; 1 = open, 0 = closed",
    "sky": "sky view factor: (1/pi) int V max(n.w,0) [up.w > 0] dw; 1 = open and level, 0 = closed",
    "bent": "bent normal: (1/pi) int V max(n.w,0) w dw; its length says how open (2/3 = fully)",
    "irradiance": "int L V max(n.w,0) dw, linear Rec. 709: radiance of the environment times steradians",
}


def bake(
    mesh_path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    quantity: str = "ao",
    per: str = "vertex",
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Integrate over what each vertex or face of a mesh file sees, and write the results.

    Parameters
    ----------
    mesh_path : str or path-like
        Any mesh that `silint.load_scene` reads.
    output : str or path-like
        A .npz, .ply or .glb file; see `silint.io.write` for what stands in each.
    quantity : {"ao", "sky", "bent", "irradiance"}
    per : {"vertex", "face"}
    progress : callable, optional
        Called with (points done, points in all) from time to time.
    **options
        The others of `BakeOptions`.

    Returns
    -------
    dict
        What `silint bake --json` prints: counts, seconds, statistics, diagnostics.

    Raises
    ------
    InputError
        An option, the mesh file or the place of the output is no good, in one line. The output is
        checked before anything is computed, and nothing is left half-written.
    """
    asked = BakeOptions(quantity, per, **options)
    check_output(output)
    light = asked.light()
    if same_file(mesh_path, output):
        raise InputError(f"{output}: is the mesh itself; give the result another name")

    integrator, seconds = load_and_build(mesh_path)
    began = time.perf_counter()
    baked, no_normal, diagnostics = _bake(integrator, replace(asked, environment=light), progress)
    integrated = time.perf_counter()
    write_baked(output, baked)
    seconds |= {"integrate": integrated - began, "write": time.perf_counter() - integrated}

    told = baked.value
    if quantity == "bent":
        told = np.linalg.norm(told, axis=1)
    elif quantity == "irradiance":
        told = told @ LUMINANCE
    return {
        "mesh": os.fspath(mesh_path),
        "output": os.fspath(output),
        **baked.metadata,
        "n_vertices": integrator.scene.n_vertices,
        "n_faces": integrator.scene.n_faces,
        "n_points": len(baked.value),
        "without_normal": no_normal,
        "mean": float(told.mean()),
        "min": float(told.min()),
        "max": float(told.max()),
        "seconds": seconds,
        "peak_memory_bytes": peak_memory(),
        "diagnostics": diagnostics,
    }


def bake_scene(
    integrator: SilhouetteIntegrator,
    quantity: str = "ao",
    per: str = "vertex",
    progress: Progress | None = None,
    **options: Any,
) -> tuple[Baked, int, dict[str, Any]]:
    """As `bake`, of a scene in memory, and without writing anything.

    Parameters
    ----------
    integrator : SilhouetteIntegrator
        Of the scene whose vertices or faces are wanted.
    quantity, per, progress, **options
        As in `bake`.

    Returns
    -------
    baked : Baked
        A row for each vertex or face of the scene. Where there is no normal (a vertex without faces, a face
        without area) ambient occlusion and sky are 1, bent normal and irradiance 0.
    without_normal : int
        How many such rows there are.
    diagnostics : dict
        The integrator's own counts.
    """
    return _bake(integrator, BakeOptions(quantity, per, **options), progress)


def _bake(
    integrator: SilhouetteIntegrator, asked: BakeOptions, progress: Progress | None
) -> tuple[Baked, int, dict[str, Any]]:
    light, quantity, per = asked.light(), asked.quantity, asked.per
    scene = integrator.scene
    points, normals, valid = sites(scene, per)
    options: dict[str, Any] = {
        "isolines": asked.isolines,
        "method": asked.method,
        "tolerance": asked.tolerance,
        "progress": progress,
    }
    if quantity == "ao":
        options["weighting"] = asked.weighting
    elif quantity == "sky":
        options["up"] = asked.up
    elif quantity == "irradiance":
        options["environment"] = light
    queries: dict[str, Callable[..., Any]] = {
        "ao": integrator.ambient_occlusion,
        "sky": integrator.sky_view_factor,
        "bent": integrator.bent_normals,
        "irradiance": integrator.irradiance,
    }
    result = queries[quantity](points[valid], normals[valid], full_output=True, **options)
    value = np.full((len(points), *result.value.shape[1:]), 1.0 if quantity in ("ao", "sky") else 0.0)
    value[valid] = result.value
    metadata = {
        "software": f"silint {__version__}",
        "quantity": quantity,
        "meaning": _MEANINGS[quantity],
        "per": per,
        "isolines": result.diagnostics["isolines"],
        **({"tolerance": asked.tolerance} if asked.tolerance is not None else {}),
        "method": asked.method,
        "weighting": asked.weighting if quantity == "ao" else "cosine",
        **({"up": [float(x) for x in unit_vector(asked.up, "up")]} if quantity == "sky" else {}),
        **({"environment": light.name, "colours": TONE_CURVE} if light is not None else {}),
    }
    baked = Baked(quantity, per, value, points, normals, scene.vertices, scene.faces, metadata)
    return baked, int(np.count_nonzero(~valid)), dict(result.diagnostics)


def sites(
    scene: Scene, per: str
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Points, normals (zero where there is none), and where there is one, of a mesh's vertices or faces."""
    if per == "face":
        points, normals, valid = scene.face_centers_normals()
    else:
        normals, valid = scene.vertex_normals()
        points = scene.vertices
    return points, np.where(valid[:, None], normals, 0.0), valid


def load_and_build(mesh_path: str | os.PathLike[str]) -> tuple[SilhouetteIntegrator, dict[str, float]]:
    """An integrator for a mesh file, and the seconds that it took, by step."""
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import load_scene

    start = time.perf_counter()
    scene = load_scene(mesh_path)
    loaded = time.perf_counter()
    integrator = SilhouetteIntegrator(scene)
    return integrator, {"load": loaded - start, "build": time.perf_counter() - loaded}


def peak_memory() -> int | None:
    """The most memory that this process has held, where the system tells."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def same_file(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to one existing file."""
    try:
        return os.path.samefile(a, b)
    except (OSError, TypeError, ValueError):
        return False
