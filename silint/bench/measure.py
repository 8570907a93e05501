"""Runs of both sides on one scene, their times and errors."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.bench.curves import speedup, time_at_error
from silint.bench.truth import ERROR_POINTS, Reference, check, opponent_seed, reference, rms
from silint.validation import InputError, choice, positive_int

if TYPE_CHECKING:
    from silint.integrator import SilhouetteIntegrator
    from silint.reference import EmbreeQMC
    from silint.scene import Scene

__all__ = ["LEVELS", "run_bench"]

FloatArray = npt.NDArray[np.float64]
# progress(stage, done, total)
StageProgress = Callable[[str, int, int], None]

SCHEMA = "silint-bench/1"
ISOLINES = (8, 16, 32, 64, 128, 256, 512)
RAYS = (64, 256, 1024, 4096, 16384, 65536)
LEVELS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)


@dataclass
class _Setting:
    """One method at one setting, and what was measured of it."""

    method: str
    setting: int
    run: Callable[[int], FloatArray]  # values of the first n points
    points: int = 0
    rounds: int = 0
    prepare_seconds: float = 0.0
    seconds: list[float] = field(default_factory=list)
    value: FloatArray | None = None

    def timed(self, n: int) -> float:
        start = time.perf_counter()
        self.value = self.run(n)[:ERROR_POINTS]
        return time.perf_counter() - start


def run_bench(
    scenes: Sequence[Scene | str | os.PathLike[str]],
    *,
    points: int = 2048,
    isolines: Sequence[int] = ISOLINES,
    rays: Sequence[int] = RAYS,
    weighting: str = "cosine",
    seed: int = 0,
    repeats: int = 3,
    seconds: float = 60.0,
    progress: StageProgress | None = None,
) -> dict[str, Any]:
    """Measure error against run time on some scenes; see the package's docstring for how.

    Parameters
    ----------
    scenes : sequence of Scene or path
    points : int
        Points timed, at most; the first 256 of them are compared with the reference.
    isolines, rays : sequences of int
        Settings of the two sides. Rays are powers of two.
    weighting : {"cosine", "uniform"}
    seed : int
        Of points, rotations and rays.
    repeats : int
        Rounds, of which the median counts.
    seconds : float
        Aim for the time spent in rounds, a scene.
    progress : callable, optional
        Called with (stage, done, total).

    Returns
    -------
    dict
        The report, as the package's docstring describes it.

    Raises
    ------
    InputError
        Bad options, unreadable scenes, or no embreex.
    """
    from silint.scene import as_scene

    choice(weighting, "weighting", ("cosine", "uniform"))
    points = positive_int(points, "points", minimum=ERROR_POINTS)
    repeats = positive_int(repeats, "repeats")
    seed = positive_int(seed, "seed", minimum=0)
    if not seconds > 0:
        raise InputError(f"seconds is {seconds}; expected a positive time to spend on a scene")
    for name, settings in (("isolines", isolines), ("rays", rays)):
        if not settings:
            raise InputError(f"{name} is empty; expected one setting at least")
        for value in settings:
            positive_int(value, name)
    bad = [r for r in rays if r & (r - 1)]
    if bad:
        raise InputError(f"rays must be powers of two, as Sobol sequences are; {bad[0]} is not one")
    options = {
        "points": points,
        "isolines": sorted(set(isolines)),
        "rays": sorted(set(rays)),
        "weighting": weighting,
        "seed": seed,
        "repeats": repeats,
        "seconds": seconds,
        "error_points": ERROR_POINTS,
    }
    loaded = [as_scene(s) for s in scenes]
    load = _load_average()
    results = [_bench_scene(scene, options, progress) for scene in loaded]
    return {
        "schema": SCHEMA,
        **{name: importlib.metadata.version(name) for name in ("numpy", "numba", "embreex")},
        "silint": _version(),
        "machine": {
            "processor": _processor(),
            "threads": _threads(),
            "threading_layer": _threading_layer(),
            "load_average": load,
        },
        "options": options,
        "scenes": results,
    }


def _bench_scene(scene: Scene, options: dict[str, Any], progress: StageProgress | None) -> dict[str, Any]:
    from silint.integrator import SilhouetteIntegrator
    from silint.reference import EmbreeQMC, embree_points
    from silint.scene import Scene

    name = scene.name or f"{scene.n_faces} triangles"

    def report(stage: str, done: int, total: int) -> None:
        if progress is not None:
            progress(f"{name}: {stage}", done, total)

    report("building", 0, 1)
    SilhouetteIntegrator(Scene(np.eye(3), [[0, 1, 2]]))  # compiles
    # Float32 numbers in double precision: the vertices that both sides can have.
    vertices = scene.vertices.astype(np.float32).astype(np.float64)
    rng = np.random.default_rng(options["seed"])
    points, normals, face_ids = _area_samples(vertices, scene.faces, options["points"], rng)
    points = embree_points(vertices, scene.faces, points, normals, face_ids)
    start = time.perf_counter()
    integrator = SilhouetteIntegrator(Scene(vertices, scene.faces))
    middle = time.perf_counter()
    embree = EmbreeQMC(vertices, scene.faces, threads=_threads())
    end = time.perf_counter()
    report("building", 1, 1)

    settings = _settings(integrator, embree, points, normals, options)
    _warm_up(settings, partial(report, "warming up"))
    _run_rounds(settings, options, len(points), partial(report, "timing"))

    truth = reference(vertices, scene.faces, points, normals, options, rng, report)
    verdict = check(embree, truth, points, normals, options, report)
    rows = [_row(s, truth) for s in settings]
    report("bare Embree", 0, 1)
    for setting, row in zip(settings, rows, strict=True):
        if setting.method == "embree":
            n = setting.points
            row["rays_per_second"] = setting.setting * n / row["seconds"]
            row["bare_rays_per_second"] = embree.bare_rays_per_second(
                points[:n], normals[:n], setting.setting, opponent_seed(options["seed"])
            )
    report("bare Embree", 1, 1)
    return {
        "name": name,
        "n_faces": scene.n_faces,
        "n_vertices": scene.n_vertices,
        "build_seconds": {"silint": middle - start, "embree": end - middle},
        "reference": truth.as_dict(),
        "check": verdict,
        "rows": rows,
        "equal_error": _equal_error(rows),
    }


def _settings(
    integrator: SilhouetteIntegrator,
    embree: EmbreeQMC,
    points: FloatArray,
    normals: FloatArray,
    options: dict[str, Any],
) -> list[_Setting]:
    """All settings of both sides in turns, cheap ones first."""
    weighting, seed = options["weighting"], opponent_seed(options["seed"])

    def silhouettes(k: int, n: int) -> FloatArray:
        value: FloatArray = integrator.ambient_occlusion(
            points[:n], normals[:n], isolines=k, weighting=weighting
        )
        return value

    def monte_carlo(k: int, n: int) -> FloatArray:
        return embree.ambient_occlusion(points[:n], normals[:n], k, seed, weighting).value

    ours = [_Setting("silint", k, partial(silhouettes, k)) for k in options["isolines"]]
    theirs = [_Setting("embree", k, partial(monte_carlo, k)) for k in options["rays"]]
    longer, shorter = (ours, theirs) if len(ours) >= len(theirs) else (theirs, ours)
    merged = []
    for i, setting in enumerate(longer):
        merged.append(setting)
        merged += shorter[i : i + 1]
    return merged


def _warm_up(settings: list[_Setting], report: Callable[[int, int], None]) -> None:
    """Compile, then let every setting build what it needs once: tables, Sobol sets."""
    report(0, len(settings))
    for method in ("silint", "embree"):
        next(s for s in settings if s.method == method).timed(1)
    for i, setting in enumerate(settings):
        setting.prepare_seconds = setting.timed(1)
        report(i + 1, len(settings))


def _run_rounds(
    settings: list[_Setting], options: dict[str, Any], n_points: int, report: Callable[[int, int], None]
) -> None:
    """Time everything in turns; a first pass over few points tells how many points and rounds to afford."""
    share = options["seconds"] / len(settings)
    passes = options["repeats"] + 1
    for i, setting in enumerate(settings):
        report(i, passes * len(settings))
        once = setting.timed(ERROR_POINTS)
        setting.rounds = int(np.clip(share / once, 1, options["repeats"]))
        setting.points = int(np.clip(ERROR_POINTS * share / (setting.rounds * once), ERROR_POINTS, n_points))
        if setting.rounds == 1:
            setting.points, setting.seconds = ERROR_POINTS, [once]
    for r in range(options["repeats"]):
        for i, setting in enumerate(settings):
            report((r + 1) * len(settings) + i, passes * len(settings))
            if 1 < setting.rounds and r < setting.rounds:
                setting.seconds.append(setting.timed(setting.points))
    report(1, 1)


def _row(setting: _Setting, truth: Reference) -> dict[str, Any]:
    assert setting.value is not None
    difference = setting.value - truth.value
    rmse = rms(difference)
    seconds = statistics.median(setting.seconds)
    n = setting.points
    row: dict[str, Any] = {
        "method": setting.method,
        "setting": setting.setting,
        "points": n,
        "rounds": setting.rounds,
        "seconds": seconds,
        "us_per_point": 1e6 * seconds / n,
        "rmse": rmse,
        "max_error": float(np.abs(difference).max()),
        "resolved": truth.resolves(rmse),
    }
    if setting.method == "silint":
        row["prepare_seconds"] = setting.prepare_seconds
    return row


def _equal_error(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    curves = {}
    for method in ("silint", "embree"):
        # An RMSE that the reference's noise may have made is no point of a curve.
        known = [r for r in rows if r["method"] == method and r["resolved"]]
        curves[method] = ([r["us_per_point"] for r in known], [r["rmse"] for r in known])
    out = []
    for level in LEVELS:
        ours, theirs = (time_at_error(*curves[method], level) for method in ("silint", "embree"))
        ratio = speedup(ours, theirs)
        out.append(
            {
                "rmse": level,
                "silint": ours and {"us_per_point": ours.value, "bound": ours.bound},
                "embree": theirs and {"us_per_point": theirs.value, "bound": theirs.bound},
                "speedup": ratio and {"value": ratio.value, "bound": ratio.bound},
            }
        )
    return out


# ------------------------------------------------------------------------------------------------- helpers


def _area_samples(
    vertices: FloatArray, faces: npt.NDArray[np.int32], n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Points uniform in area on the front of the faces, with their normals and faces."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    if not area.sum() > 0:
        raise InputError("no face has any area; there is nowhere to put points")
    face_ids = rng.choice(len(faces), size=n, p=area / area.sum())
    # Reflected at the diagonal, the unit square covers the triangle evenly.
    st = rng.random((n, 2))
    st = np.where(st.sum(axis=1, keepdims=True) > 1, 1 - st, st)
    a, b, c = (corners[face_ids, k] for k in range(3))
    points = a + st[:, :1] * (b - a) + st[:, 1:] * (c - a)
    return points, cross[face_ids] / area[face_ids, None], face_ids


def _threads() -> int:
    import numba

    return int(numba.get_num_threads())


def _threading_layer() -> str:
    import numba

    return str(numba.threading_layer())  # type: ignore[attr-defined]


def _load_average() -> float | None:
    """Processes that wanted a core during the last minute, before anything was measured."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _version() -> str:
    from silint import __version__

    return __version__


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            for line in stream:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
