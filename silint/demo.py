"""The packaged scene, baked, compared with Embree, and drawn: what `silint demo` does."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.bake import bake_scene
from silint.io import check_output, write_baked, write_bytes
from silint.validation import InputError

if TYPE_CHECKING:
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

__all__ = ["demo", "demo_scene"]

# progress(stage, done, total)
StageProgress = Callable[[str, int, int], None]

ISOLINES = (32, 64, 128)
RAYS = (256, 1024, 4096, 16384)

# Enough points for an error that does not depend on luck, few enough for a demo; and more to choose from,
# because about one face in eight of the scene is buried in another solid.
_SAMPLE, _CANDIDATES = 256, 320

# The reference's rays: 64 scrambles give standard errors that can be relied on.
_REFERENCE_RAYS, _REFERENCE_SCRAMBLES = 8192, 64

# The opponent and the reference must not draw the same numbers.
_OPPONENT_SEED, _REFERENCE_SEED = 1, 2


def demo_scene() -> Scene:
    """The packaged scene: a small round temple around a knot, 16,986 triangles, z up.

    Returns
    -------
    Scene
        Made by ``scenes/demo.py`` of the repository, which is where it comes from and how it is licensed.
    """
    from silint.scene import Scene

    with resources.files("silint").joinpath("data", "demo.npz").open("rb") as stream:
        data = np.load(stream)
        return Scene(data["vertices"], data["faces"], data["normals"], name="demo")


def demo(
    out: str | os.PathLike[str] = "silint-demo", progress: StageProgress | None = None
) -> dict[str, Any]:
    """Bake the packaged scene, compare with Embree QMC, draw a picture, and write all of it.

    Parameters
    ----------
    out : str or path-like
        A folder; made if its parent exists.
    progress : callable, optional
        Called with (stage, done, total) from time to time.

    Returns
    -------
    dict
        What stands in ``demo.json``: files, counts, seconds, and the ``comparison``: rows of method, setting,
        seconds and RMSE on the same points, ``resolved`` if the RMSE is at least four standard errors of the
        reference; None where embreex is not installed.

    Raises
    ------
    InputError
        The folder cannot be made or written to.
    """
    folder = _made_folder(out)
    files = {kind: check_output(folder / f"demo.{kind}", (f".{kind}",)) for kind in ("glb", "png", "json")}

    from silint.integrator import SilhouetteIntegrator
    from silint.reference import embree_available
    from silint.render import render

    def staged(stage: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(stage, done, total)

    preparing = staged("preparing (the first run compiles for up to a minute)")
    start = time.perf_counter()
    scene = demo_scene()
    # Compiling keeps one core busy; the reference's rays, which need no interpreter, have the others.
    comparison = _Comparison(scene, staged("comparing with Embree")) if embree_available() else None
    if preparing is not None:
        preparing(0, 1)
    integrator = SilhouetteIntegrator(scene)
    normals, _ = scene.vertex_normals()
    integrator.ambient_occlusion(scene.vertices[:1], normals[:1])
    if preparing is not None:
        preparing(1, 1)
    if comparison is not None:
        comparison.wait()  # or the times below would be those of half a machine
    ready = time.perf_counter()

    baked, without_normal, diagnostics = bake_scene(integrator, progress=staged("baking"))
    done = time.perf_counter()
    write_baked(files["glb"], baked)
    render(scene.vertices, scene.faces, baked.value, files["png"], normals=normals)
    summary = {
        **baked.metadata,
        "files": [str(Path(out) / file.name) for file in files.values()],
        "n_vertices": scene.n_vertices,
        "n_faces": scene.n_faces,
        "n_points": len(baked.value),
        "without_normal": without_normal,
        "seconds": {
            "prepare": ready - start,
            "bake": done - ready,
        },
        "diagnostics": diagnostics,
        "comparison": None if comparison is None else comparison.with_silint(integrator),
    }
    summary["seconds"]["total"] = time.perf_counter() - start
    write_bytes(files["json"], (json.dumps(summary, indent=2) + "\n").encode())
    return summary


def _made_folder(out: str | os.PathLike[str]) -> Path:
    folder = Path(out)
    try:
        folder.mkdir(exist_ok=True)
    except FileExistsError:
        raise InputError(f"{folder}: is a file; expected a folder") from None
    except FileNotFoundError:
        raise InputError(f"{folder}: its parent folder does not exist; create it first") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: cannot be made ({getattr(error, 'strerror', None) or error})") from None
    return folder


class _Comparison:
    """RMSE and time of both sides on the same displaced points, against many scrambles of Embree QMC.

    At face centres: a vertex on a hard edge lies in the planes of other faces, where rays in float32 find
    now one side and now the other. Points that see nothing are left out: both sides get them right, and
    they would flatter both.

    The reference is traced in the background from the start; `wait` for it before timing anything.
    """

    def __init__(self, scene: Scene, progress: Callable[[int, int], None] | None) -> None:
        from silint.reference import EmbreeQMC, embree_points

        centers, normals, valid = scene.face_centers_normals()
        rows = np.flatnonzero(valid)
        rows = rows[np.linspace(0, len(rows) - 1, _CANDIDATES).astype(np.int64)]
        self.normals = normals[rows]
        self.points = embree_points(scene.vertices, scene.faces, centers[rows], self.normals, rows)
        self.embree = EmbreeQMC(scene.vertices, scene.faces)
        self.embree.ambient_occlusion(self.points[:1], self.normals[:1], samples=RAYS[0])  # compiles
        trace = partial(
            self.embree.ambient_occlusion,
            self.points,
            self.normals,
            samples=_REFERENCE_RAYS,
            seed=_REFERENCE_SEED,
            scrambles=_REFERENCE_SCRAMBLES,
            progress=progress,
        )
        self.pool = ThreadPoolExecutor(1)
        self.future = self.pool.submit(trace)

    def wait(self) -> None:
        """Let the reference finish, and keep the points that see something."""
        self.reference = self.future.result()
        self.pool.shutdown()
        self.kept = np.flatnonzero(self.reference.value > 0.0)[:_SAMPLE]

    def with_silint(self, integrator: SilhouetteIntegrator) -> dict[str, Any]:
        """The rows of the table, timed now."""
        p, n, truth = self.points[self.kept], self.normals[self.kept], self.reference.value[self.kept]
        noise = float(np.sqrt(np.mean(self.reference.standard_error[self.kept] ** 2)))
        results = []
        for isolines in ISOLINES:
            seconds, found = _best_of_three(partial(integrator.ambient_occlusion, p, n, isolines=isolines))
            results.append(_row("silint", isolines, seconds, found - truth, noise))
        for rays in RAYS:
            ask = partial(self.embree.ambient_occlusion, p, n, samples=rays, seed=_OPPONENT_SEED)
            seconds, result = _best_of_three(ask)
            results.append(_row("embree", rays, seconds, result.value - truth, noise))
        return {
            "n_points": len(p),
            "threads": self.embree.threads,
            "reference": {
                "rays": _REFERENCE_RAYS * _REFERENCE_SCRAMBLES,
                "standard_error": noise,
            },
            "rows": results,
        }


def _row(
    method: str, setting: int, seconds: float, difference: npt.NDArray[np.float64], noise: float
) -> dict[str, Any]:
    rmse = float(np.sqrt(np.mean(difference**2)))
    return {
        "method": method,
        "isolines" if method == "silint" else "rays": setting,
        "seconds": seconds,
        "rmse": rmse,
        "max": float(np.abs(difference).max()),
        # Below four standard errors of the reference, most of the difference may be the reference's.
        "resolved": rmse >= 4.0 * noise,
    }


def _best_of_three(run: Callable[[], Any]) -> tuple[float, Any]:
    best, result = float("inf"), None
    for _ in range(3):
        start = time.perf_counter()
        result = run()
        best = min(best, time.perf_counter() - start)
    return best, result
