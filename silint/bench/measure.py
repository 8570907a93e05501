"""Runs of both sides on one scene, their times and errors."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.bench import machine
from silint.bench.quantity import Quantity, quantity_of
from silint.bench.rows import EMBREE, LEVELS, channel_equal_error, equal_error, points_to_pay
from silint.bench.sites import SITES, shade_sites, spread
from silint.bench.truth import Reference, judged_reference, opponent_seed, relative_rms
from silint.core.jit import KERNEL_LOCK
from silint.core.visible import tile_order
from silint.validation import InputError, choice, positive_int

if TYPE_CHECKING:
    from silint.environment import Environment
    from silint.integrator import SilhouetteIntegrator
    from silint.reference import EmbreeQMC
    from silint.scene import Scene

__all__ = ["EMBREE", "ISOLINES", "LEVELS", "RAYS", "prepare_references", "run_bench", "supported_methods"]

FloatArray = npt.NDArray[np.float64]
# progress(stage, done, total)
StageProgress = Callable[[str, int, int], None]

SCHEMA = "silint-bench/4"
ISOLINES = (8, 16, 32, 64, 128, 256, 512)
RAYS = (64, 256, 1024, 4096, 16384, 65536)

# The first method's share of the time aimed at: it is timed on most points. The others share the rest.
_FIRST_SHARE = 0.5

# How many times more points a second look takes than the first.
_SECOND_LOOK = 8

# Neighbours that are timed together.
_RUN = 128

# Rays of Embree alone, a setting, and how often; the best counts, in Embree's favour.
_BARE_RAYS, _BARE_RUNS = 1 << 22, 3


class _Run(NamedTuple):
    """What one run returned."""

    value: FloatArray
    diagnostics: dict[str, int] = {}  # noqa: RUF012 (never written)
    rays: int = 0  # Embree's


@dataclass
class _Setting:
    """One method at one setting, and what was measured of it."""

    method: str
    setting: int
    run: Callable[[int, bool], _Run]  # n points; with diagnostics?
    most: int  # points that may be timed
    points: int = 0
    rounds: int = 0  # none: left out, there was no time for it
    prepare_seconds: float = 0.0
    seconds: list[float] = field(default_factory=list)
    value: FloatArray = field(default_factory=lambda: np.empty(0))
    diagnostics: dict[str, int] = field(default_factory=dict)
    rays: int = 0
    # Values of the points whose errors count, where others are timed.
    judged: Callable[[], FloatArray] | None = None

    def timed(self, n: int, look: bool = False) -> float:
        start = time.perf_counter()
        found = self.run(n, look)
        seconds = time.perf_counter() - start
        self.value, self.rays = found.value, found.rays
        if look:
            self.diagnostics = found.diagnostics
        return seconds


def run_bench(
    scenes: Sequence[Scene | str | os.PathLike[str]],
    *,
    methods: Sequence[str] = ("auto",),
    points: int = 2048,
    embree_points: int | None = None,
    error_points: int = 256,
    sites: str = "surface",
    isolines: Sequence[int] = ISOLINES,
    rays: Sequence[int] = RAYS,
    weighting: str = "cosine",
    quantity: str = "ao",
    environment: Environment | None = None,
    max_degree: int = 4,
    seed: int = 0,
    repeats: int = 3,
    seconds: float = 60.0,
    goal: float = 0.0,
    reference_method: str = "octahedral",
    references: str | os.PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> dict[str, Any]:
    """Measure error against run time on some scenes; see the package's docstring for how.

    Parameters
    ----------
    scenes : sequence of Scene or path
    methods : sequence of str
        Of silint; the first one is given most of the time. Those that this silint does not have are left
        out.
    points, embree_points : int
        Points timed, at most, of silint and of Embree (default: as many).
    error_points : int
        The first of them, which are compared with the reference.
    sites : {"surface", "vertices"}
        See `silint.bench.sites.shade_sites`.
    isolines, rays : sequences of int
        Settings of the two sides. Rays are powers of two.
    weighting : {"cosine", "uniform"}
    quantity : {"ao", "irradiance", "sh"}
        Ambient occlusion; irradiance from `environment`, whose errors are relative; or `sh_transfer` of
        degree `max_degree`, whose RMSE is over points and coefficients.
    environment : Environment
    max_degree : int
    seed : int
        Of points, rotations and rays.
    repeats : int
        Rounds, of which the median counts.
    seconds : float
        Aim for the time spent in rounds, a scene.
    goal : float
        Standard error that suffices for the reference; 0 for the best there is.
    reference_method : str
        The method of silint that the reference takes.
    references : path, optional
        A folder that keeps references from one run to the next.
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

    measured = quantity_of(quantity, weighting, environment, max_degree)
    choice(sites, "sites", SITES)
    error_points = positive_int(error_points, "error_points", minimum=2)
    points = positive_int(points, "points", minimum=error_points)
    if embree_points is None:
        embree_points = points
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
    if min(rays) < measured.fewest_rays:
        raise InputError(
            f"rays is {min(rays)}; irradiance takes {measured.fewest_rays} at least, one of the cosine and "
            "one of the light"
        )
    known = supported_methods(methods, measured)
    supported_methods([reference_method], measured)
    options = {
        "methods": known,
        "points": points,
        "embree_points": positive_int(embree_points, "embree_points", minimum=error_points),
        "error_points": error_points,
        "sites": sites,
        "isolines": sorted(set(isolines)),
        "rays": sorted(set(rays)),
        "weighting": weighting,
        **measured.as_options(),
        "seed": seed,
        "repeats": repeats,
        "seconds": seconds,
        "goal": goal,
        "reference_method": reference_method,
    }
    loaded = [as_scene(s) for s in scenes]
    about = machine.describe()
    results = [_bench_scene(scene, measured, options, references, progress) for scene in loaded]
    about["threading_layer"] = machine.describe()["threading_layer"]
    return {"schema": SCHEMA, **machine.versions(), "machine": about, "options": options, "scenes": results}


def supported_methods(methods: Iterable[str], quantity: Quantity | None = None) -> list[str]:
    """Those that this silint has, tried on the packaged scene; which also compiles them.

    Raises
    ------
    InputError
        None is left.
    """
    from silint.demo import demo_scene
    from silint.integrator import SilhouetteIntegrator

    integrator = SilhouetteIntegrator(demo_scene())
    points, normals = integrator.scene.vertices[:1], np.array([[0.0, 0.0, 1.0]])
    asked = (quantity or Quantity()).separate()
    known, refused = [], ""
    for method in dict.fromkeys(methods):
        try:
            asked.silhouettes(integrator, points, normals, 2, method)
        except InputError as error:
            refused = str(error)
        else:
            known.append(method)
    if not known:
        raise InputError(f"methods has none that can be measured: {refused or 'it is empty'}")
    return known


def prepare_references(
    scene: Scene,
    references: str | os.PathLike[str],
    options: dict[str, Any],
    progress: StageProgress | None = None,
) -> None:
    """Compute what `run_bench` with these options will want to read from its folder of references."""
    from silint.reference import EmbreeQMC

    asked = quantity_of(
        options.get("quantity", "ao"),
        options["weighting"],
        options.get("environment"),
        options.get("max_degree", 4),
    )
    vertices, points, normals = _question(scene, options)
    embree = EmbreeQMC(vertices, scene.faces, threads=machine.n_threads())
    report = partial(_report, scene, progress)
    _truth(scene, asked, vertices, points, normals, embree, options, references, report)


def _report(scene: Scene, progress: StageProgress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(f"{_name(scene)}: {stage}", done, total)


def _name(scene: Scene) -> str:
    return scene.name or f"{scene.n_faces} triangles"


def _question(scene: Scene, options: dict[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Vertices that both sides can have (float32 numbers in double precision), points, and normals."""
    from silint.scene import Scene

    vertices = scene.vertices.astype(np.float32).astype(np.float64)
    rng = np.random.default_rng(options["seed"])
    rounded = Scene(vertices, scene.faces, scene.normals)
    return vertices, *shade_sites(rounded, options["sites"], options["points"], rng)


def _truth(
    scene: Scene,
    quantity: Quantity,
    vertices: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    embree: EmbreeQMC,
    options: dict[str, Any],
    references: str | os.PathLike[str] | None,
    report: StageProgress,
) -> tuple[Reference, dict[str, Any]]:
    m = options["error_points"]
    site = vertices, scene.faces, points[:m], normals[:m]
    return judged_reference(*site, embree, quantity, options, options["goal"], references, report)


def _bench_scene(
    scene: Scene,
    quantity: Quantity,
    options: dict[str, Any],
    references: str | os.PathLike[str] | None,
    progress: StageProgress | None,
) -> dict[str, Any]:
    from silint.integrator import SilhouetteIntegrator
    from silint.reference import EmbreeQMC
    from silint.scene import Scene

    report = partial(_report, scene, progress)
    report("building", 0, 1)
    vertices, points, normals = _question(scene, options)
    start = time.perf_counter()
    integrator = SilhouetteIntegrator(Scene(vertices, scene.faces))
    middle = time.perf_counter()
    embree = EmbreeQMC(vertices, scene.faces, threads=machine.n_threads())
    end = time.perf_counter()
    report("building", 1, 1)
    # What a method builds when it is first asked counts as building.
    build_seconds = {EMBREE: end - middle}
    for method in options["methods"]:
        began = time.perf_counter()
        quantity.separate().silhouettes(integrator, points[:1], normals[:1], 2, method)
        build_seconds[method] = middle - start + time.perf_counter() - began

    settings = _settings(integrator, embree, quantity, points, normals, options)
    _warm_up(settings, partial(report, "warming up"))
    _run_rounds(settings, options, partial(report, "timing"))
    settings = [s for s in settings if s.rounds]

    truth, verdict = _truth(scene, quantity, vertices, points, normals, embree, options, references, report)
    rows = [_row(s, truth) for s in settings]
    report("bare Embree", 0, 1)
    for setting, row in zip(settings, rows, strict=True):
        if setting.method == EMBREE:
            n = setting.points
            row["rays_per_second"] = setting.rays / row["seconds"]
            seed = opponent_seed(options["seed"])
            row["bare_rays_per_second"] = max(
                embree.bare_rays_per_second(
                    points[:n], normals[:n], setting.setting, seed, _BARE_RAYS, quantity.environment
                )
                for _ in range(_BARE_RUNS)
            )
    report("bare Embree", 1, 1)
    at_equal_error = equal_error(rows, options["methods"])
    return {
        "name": _name(scene),
        "n_faces": scene.n_faces,
        "n_vertices": scene.n_vertices,
        "points": len(points),
        "memory": integrator.memory,
        "build_seconds": build_seconds,
        "pays_after": points_to_pay(build_seconds, at_equal_error, options["methods"]),
        "reference": truth.as_dict(),
        "check": verdict,
        "rows": rows,
        "equal_error": at_equal_error,
        "channels": channel_equal_error(rows, options["methods"]),
    }


def _settings(
    integrator: SilhouetteIntegrator,
    embree: EmbreeQMC,
    quantity: Quantity,
    points: FloatArray,
    normals: FloatArray,
    options: dict[str, Any],
) -> list[_Setting]:
    """All settings of both sides in turns, cheap ones first."""
    seed = opponent_seed(options["seed"])
    rows = in_company(points, normals)
    m = options["error_points"]

    def silhouettes(asked: Quantity, method: str, k: int, n: int, look: bool) -> _Run:
        result = asked.silhouettes(
            integrator, points[rows[:n]], normals[rows[:n]], k, method, full_output=look
        )
        return _Run(result.value, dict(result.diagnostics)) if look else _Run(result)

    def judged(asked: Quantity, method: str, k: int) -> FloatArray:
        value: FloatArray = asked.silhouettes(integrator, points[:m], normals[:m], k, method)
        return value

    def monte_carlo(k: int, n: int, look: bool) -> _Run:
        found = quantity.rays(embree, points[:n], normals[:n], k, seed)
        return _Run(found.value, rays=found.rays)

    def ours(method: str, k: int) -> _Setting:
        asked = quantity.separate()
        return _Setting(
            method,
            k,
            partial(silhouettes, asked, method, k),
            len(points),
            judged=partial(judged, asked, method, k),
        )

    most = min(options["embree_points"], len(points))
    columns = [[ours(method, k) for k in options["isolines"]] for method in options["methods"]]
    columns.append([_Setting(EMBREE, k, partial(monte_carlo, k), most) for k in options["rays"]])
    longest = max(len(column) for column in columns)
    return [column[i] for i in range(longest) for column in columns if i < len(column)]


def in_company(points: FloatArray, normals: FloatArray) -> npt.NDArray[np.intp]:
    """Runs of neighbours, spread over all: some of the points cost as much each as they do among all.

    Points that are asked for together share work with their neighbours; a few picked far apart would not.
    """
    with KERNEL_LOCK:
        order = tile_order(points, normals)
    runs = [order[i : i + _RUN] for i in range(0, len(order), _RUN)]
    return np.concatenate([runs[i] for i in spread(len(runs))]).astype(np.intp)


def _warm_up(settings: list[_Setting], report: Callable[[int, int], None]) -> None:
    """Compile, then let every setting build what it needs once: tables, Sobol sets."""
    report(0, len(settings))
    for method in {s.method: None for s in settings}:
        next(s for s in settings if s.method == method).timed(1)
    for i, setting in enumerate(settings):
        setting.prepare_seconds = setting.timed(1)
        report(i + 1, len(settings))


def _run_rounds(
    settings: list[_Setting], options: dict[str, Any], report: Callable[[int, int], None]
) -> None:
    """Time everything in turns; a first pass over few points tells how many points and rounds to afford."""
    methods = list(dict.fromkeys(s.method for s in settings))
    shares = [_FIRST_SHARE, *([(1 - _FIRST_SHARE) / (len(methods) - 1)] * (len(methods) - 1))]
    left = dict(zip(methods, (options["seconds"] * share for share in shares), strict=True))
    waiting = {method: sum(s.method == method for s in settings) for method in methods}
    once = dict.fromkeys(methods, 0.0)
    passes = options["repeats"] + 1
    for i, setting in enumerate(settings):
        report(i, passes * len(settings))
        method = setting.method
        # No look at a setting when already the one before, which is cheaper, takes more than what is left.
        if once[method] <= left[method]:
            # What cheap settings leave of their method's time goes to the expensive ones.
            once[method], spent = _afford(setting, left[method] / waiting[method], options)
            left[method] = max(left[method] - spent, 0.0)
        waiting[method] -= 1
    for r in range(options["repeats"]):
        for i, setting in enumerate(settings):
            report((r + 1) * len(settings) + i, passes * len(settings))
            if 1 < setting.rounds and r < setting.rounds:
                setting.seconds.append(setting.timed(setting.points))
    report(1, 1)


def _afford(setting: _Setting, share: float, options: dict[str, Any]) -> tuple[float, float]:
    """Decide on a setting's points and rounds; the times of a first look and of everything."""
    fewest = n = min(int(options["error_points"]), setting.most)
    first = once = looked = setting.timed(n, look=True)
    setting.rounds = int(np.clip(share / once, 1, options["repeats"]))
    if setting.rounds == 1:
        setting.points, setting.seconds = n, [once]
        return first, first
    a_round = share / setting.rounds
    if setting.method != EMBREE and a_round > _SECOND_LOOK * once and setting.most > _SECOND_LOOK * n:
        # Points in company share work, so that the few of the first look cost more each.
        n *= _SECOND_LOOK
        once = setting.timed(n, look=True)
        looked += once
    setting.points = int(np.clip(n * a_round / once, fewest, setting.most))
    return first, looked + setting.rounds * setting.points * once / n


def _row(setting: _Setting, truth: Reference) -> dict[str, Any]:
    value = setting.value[: len(truth.value)] if setting.judged is None else setting.judged()
    difference = value - truth.value
    rmses = relative_rms(difference, truth.unit)
    resolved = truth.resolved(rmses)
    worst = int(rmses.argmax())
    seconds = statistics.median(setting.seconds)
    n = setting.points
    row: dict[str, Any] = {
        "method": setting.method,
        "setting": setting.setting,
        "points": n,
        "rounds": setting.rounds,
        "seconds": seconds,
        "us_per_point": 1e6 * seconds / n,
        "rmse": float(rmses[worst]),
        "max_error": float(np.abs(difference / truth.unit).max()),
        "resolved": bool(resolved[worst]),
    }
    if len(rmses) > 1:
        row["channels"] = [
            {"rmse": float(e), "resolved": bool(r)} for e, r in zip(rmses, resolved, strict=True)
        ]
    if setting.method != EMBREE:
        row |= {"prepare_seconds": setting.prepare_seconds, "diagnostics": setting.diagnostics}
    return row
