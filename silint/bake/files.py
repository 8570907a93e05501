"""From a mesh file to a file with a value for each of its vertices or faces."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from silint import __version__
from silint.bake.options import BakeOptions, Progress
from silint.bake.targets import Targets, targets
from silint.io import LUMINANCE, TONE_CURVE, Baked, check_output, write_baked
from silint.validation import InputError, unit_vector

if TYPE_CHECKING:
    from silint.bake.integrate import Integrals
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

__all__ = ["bake", "bake_scene", "check_unread", "load_and_build", "peak_memory", "same_file"]

_MEANINGS = {
    "ao": "ambient occlusion: visible fraction of the hemisphere; 1 = open, 0 = closed",
    "sky": "sky view factor: (1/pi) int V max(n.w,0) [up.w > 0] dw; 1 = open and level, 0 = closed",
    "bent": "bent normal: (1/pi) int V max(n.w,0) w dw; its length says how open",
    "irradiance": "int L V max(n.w,0) dw, linear Rec. 709: radiance of the environment times steradians",
}
_TWO_SIDED = "; mean of both sides, of n and -n"


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
    check_unread(output, mesh_path, asked.occluders, environment=asked.environment)
    from silint.scene import load_scene

    asked = asked.with_light()
    began = time.perf_counter()
    scene = load_scene(mesh_path)
    baked, found, integrals, loaded = _bake(scene, asked, progress, os.fspath(mesh_path))
    integrated = time.perf_counter()
    write_baked(output, baked)
    written = time.perf_counter()

    told = baked.value
    if quantity == "bent":
        told = np.linalg.norm(told, axis=1)
    elif quantity == "irradiance":
        told = told @ LUMINANCE
    return {
        "mesh": os.fspath(mesh_path),
        "output": os.fspath(output),
        **baked.metadata,
        "n_vertices": scene.n_vertices,
        "n_faces": scene.n_faces,
        "n_points": len(baked.value),
        "without_normal": int(np.count_nonzero(~found.sites.valid)),
        "computed_normals": found.computed_normals,
        "split_vertices": found.split_vertices,
        "mean": float(told.mean()),
        "min": float(told.min()),
        "max": float(told.max()),
        "open": asked.open_value,
        "files": [{"path": os.fspath(output), "bytes": os.path.getsize(output)}],
        "seconds": {
            "load": loaded - began,
            "build": integrals.build_seconds,
            "integrate": integrated - loaded - integrals.build_seconds,
            "write": written - integrated,
        },
        "peak_memory_bytes": peak_memory(),
        **({"interpolation": integrals.interpolation} if integrals.interpolation is not None else {}),
        "diagnostics": integrals.diagnostics,
    }


def bake_scene(
    source: SilhouetteIntegrator | Scene,
    quantity: str = "ao",
    per: str = "vertex",
    progress: Progress | None = None,
    **options: Any,
) -> tuple[Baked, int, dict[str, Any]]:
    """As `bake`, of a scene in memory, and without writing anything.

    Parameters
    ----------
    source : SilhouetteIntegrator or Scene
        Whose vertices or faces are wanted. An integrator serves as it is unless something else blocks:
        occluders, or groups by themselves.
    quantity, per, progress, **options
        As in `bake`.

    Returns
    -------
    baked : Baked
        A row for each vertex or face. Where there is no normal (a vertex without faces, a face without area)
        ambient occlusion and sky are 1, bent normal and irradiance 0.
    without_normal : int
        How many such rows there are.
    diagnostics : dict
        The integrators' own counts.
    """
    from silint.scene import as_scene

    scene = as_scene(getattr(source, "scene", source))
    asked = BakeOptions(quantity, per, **options).with_light()
    baked, found, integrals, _ = _bake(source, asked, progress, scene.name or "the scene")
    return baked, int(np.count_nonzero(~found.sites.valid)), integrals.diagnostics


def _bake(
    source: SilhouetteIntegrator | Scene, asked: BakeOptions, progress: Progress | None, label: str
) -> tuple[Baked, Targets, Integrals, float]:
    """The result with all that is known of it, and when all files had been read."""
    from silint.bake.integrate import integrate
    from silint.scene import as_scene

    scene = as_scene(getattr(source, "scene", source))
    found = targets(scene, asked, label)
    occluders = [as_scene(occluder) for occluder in asked.occluders]
    limits = asked.limits(scene, occluders)
    loaded = time.perf_counter()
    integrals = integrate(source, occluders, found.sites, asked, limits, progress)
    light: Any = asked.environment
    metadata = {
        "software": f"silint {__version__}",
        "quantity": asked.quantity,
        "meaning": _meaning(asked),
        "per": asked.per,
        "isolines": integrals.diagnostics["isolines"],
        **({"tolerance": asked.tolerance} if asked.tolerance is not None else {}),
        "method": asked.method,
        "weighting": asked.weighting if asked.quantity == "ao" else "cosine",
        **({"up": [float(x) for x in unit_vector(asked.up, "up")]} if asked.quantity == "sky" else {}),
        **({"environment": light.name, "colours": TONE_CURVE} if light is not None else {}),
        "normals": found.normals_from,
        **({"two_sided": True} if asked.two_sided else {}),
        **({"occluders": [occluder.name for occluder in occluders]} if occluders else {}),
        **({"self_only": True} if asked.self_only else {}),
        **({"groups": list(asked.groups)} if asked.groups else {}),
        **({"interpolate": asked.interpolate} if asked.interpolate is not None else {}),
        **limits,
    }
    baked = Baked(
        asked.quantity,
        asked.per,
        integrals.value,
        found.sites.points,
        found.sites.normals,
        found.vertices,
        found.faces,
        metadata,
    )
    return baked, found, integrals, loaded


def _meaning(asked: BakeOptions) -> str:
    told = _MEANINGS[asked.quantity]
    if asked.quantity == "bent" and asked.open_value is not None:
        told += f" ({asked.open_value:.4g} = fully)"
    return told + (_TWO_SIDED if asked.two_sided else "")


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


def check_unread(
    output: str | os.PathLike[str],
    mesh_path: str | os.PathLike[str],
    occluders: Iterable[Any] = (),
    **others: Any,
) -> None:
    """Make sure that the result replaces none of the files that it is made from.

    Parameters
    ----------
    output, mesh_path : path
    occluders : iterable
        Those that are paths are looked at.
    **others
        Other files by the names of their options, if they are paths.
    """
    told = "; give the result another name"
    if same_file(mesh_path, output):
        raise InputError(f"{output}: is the mesh itself{told}")
    if any(same_file(occluder, output) for occluder in occluders):
        raise InputError(f"{output}: is one of the occluders{told}")
    for name, path in others.items():
        if same_file(path, output):
            raise InputError(f"{output}: is the {name.replace('_', ' ')}{told}")


def same_file(a: str | os.PathLike[str], b: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to one existing file."""
    try:
        return os.path.samefile(a, b)
    except (OSError, TypeError, ValueError):
        return False
