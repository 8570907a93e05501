"""What errors are measured against, and whether that can be trusted."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.io import write_bytes

if TYPE_CHECKING:
    from silint.reference import EmbreeQMC

__all__ = ["Reference", "check", "judged_reference", "opponent_seed", "reference", "rms"]

FloatArray = npt.NDArray[np.float64]
StageProgress = Callable[[str, int, int], None]

# Standard errors of the reference that an RMSE must reach to be given as a number.
RESOLVED = 4.0

# Lines of a reference as it is, and the fewest and the most where there is a goal for its standard error.
_REFERENCE_ISOLINES = 1024
_GOAL_ISOLINES = (128, 2048)
_ROTATIONS = 6
_CHECK_SCRAMBLES = 64
_CHECK_SAMPLES = 2048


@dataclass(frozen=True)
class Reference:
    """Values at some points, and their standard errors."""

    value: FloatArray
    standard_error: FloatArray
    isolines: int
    rotations: int

    def resolves(self, rmse: float) -> bool:
        """Whether an RMSE against this reference says something about what was compared with it."""
        return rmse >= RESOLVED * rms(self.standard_error)

    def as_dict(self) -> dict[str, Any]:
        """For the report."""
        return {
            "isolines": self.isolines,
            "rotations": self.rotations,
            "standard_error": rms(self.standard_error),
        }


def rms(x: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def opponent_seed(seed: int) -> int:
    """Embree's seed as the opponent; `check` uses another, so that nothing is compared with itself."""
    return 2 * seed


def judged_reference(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    embree: EmbreeQMC,
    options: dict[str, Any],
    goal: float,
    folder: str | os.PathLike[str] | None,
    report: StageProgress,
) -> tuple[Reference, dict[str, Any]]:
    """A reference and Embree's verdict on it, computed once where there is a folder to keep them in.

    The file's name is a hash of everything that goes in, except the code: both are estimates with
    standard errors of their own, which a change of code does not make wrong.
    """
    described = {key: options.get(key) for key in ("weighting", "seed", "reference_method")} | {"goal": goal}
    path = None
    if folder is not None:
        path = Path(folder) / f"{_digest(vertices, faces, points, normals, described)}.json"
        if path.is_file():
            kept = json.loads(path.read_text(encoding="utf-8"))
            value, error = np.array(kept["value"]), np.array(kept["standard_error"])
            return Reference(value, error, kept["isolines"], kept["rotations"]), kept["check"]
    truth = reference(vertices, faces, points, normals, options, report, goal)
    verdict = check(embree, truth, points, normals, options, report)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        numbers = {key: getattr(truth, key).tolist() for key in ("value", "standard_error")}
        write_bytes(path, json.dumps({**asdict(truth), **numbers, "check": verdict}).encode())
    return truth, verdict


def _digest(*parts: Any) -> str:
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype} {part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        else:
            digest.update(json.dumps(part, sort_keys=True).encode())
    return digest.hexdigest()[:24]


def reference(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    options: dict[str, Any],
    report: StageProgress,
    goal: float = 0.0,
) -> Reference:
    """Values and standard errors from silint in independent random orientations of everything.

    With a `goal`, no more lines than seem to be needed for a standard error of that, and more turns where
    they fall short of it; without, the most lines, and as few turns as tell a spread.
    """
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

    rng = np.random.default_rng([options["seed"], 1])
    method = options.get("reference_method", "octahedral")
    values: list[FloatArray] = []
    isolines = 0
    spread = np.full(len(points), np.inf)
    while len(values) < _ROTATIONS or (len(values) < 2 * _ROTATIONS and 0 < goal < rms(spread)):
        report("reference", len(values), max(_ROTATIONS, len(values) + 1))
        rotation = _random_rotation(rng)
        turned = SilhouetteIntegrator(Scene(vertices @ rotation.T, faces))
        p, n = points @ rotation.T, normals @ rotation.T

        def query(k: int, turned: Any = turned, p: FloatArray = p, n: FloatArray = n) -> FloatArray:
            value: FloatArray = turned.ambient_occlusion(
                p, n, isolines=k, weighting=options["weighting"], method=method
            )
            return value

        if not isolines:
            isolines, first = _enough_isolines(query, goal)
            values.append(first)
        else:
            values.append(query(isolines))
        if len(values) > 1:
            spread = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
    report("reference", len(values), len(values))
    return Reference(np.mean(values, axis=0), spread, isolines, len(values))


def _enough_isolines(query: Callable[[int], FloatArray], goal: float) -> tuple[int, FloatArray]:
    """Lines whose error, averaged over all turns, seems to be the goal, and the values that they give."""
    if goal <= 0:
        return _REFERENCE_ISOLINES, query(_REFERENCE_ISOLINES)
    isolines, most = _GOAL_ISOLINES
    value = query(isolines)
    while isolines < most:
        isolines *= 2
        coarser, value = value, query(isolines)
        # Errors fall as isolines^-1.5, so the change is the coarser one's error, by and large.
        if rms(value - coarser) / 2**1.5 <= goal * np.sqrt(_ROTATIONS):
            break
    return isolines, value


def check(
    embree: EmbreeQMC,
    truth: Reference,
    points: FloatArray,
    normals: FloatArray,
    options: dict[str, Any],
    report: StageProgress,
) -> dict[str, Any]:
    """A reference against Embree with many scrambles, in units of their joint standard error."""
    from scipy.stats import t

    judge = embree.ambient_occlusion(
        points,
        normals,
        _CHECK_SAMPLES,
        seed=opponent_seed(options["seed"]) + 1,
        weighting=options["weighting"],
        scrambles=_CHECK_SCRAMBLES,
        progress=partial(report, "checking the reference"),
    )
    difference = truth.value - judge.value
    # Where all rays agree the spread is 0, but a share below one ray in all of them goes unseen.
    sigma = np.hypot(
        np.maximum(judge.standard_error, 1.0 / (judge.samples * judge.scrambles)), truth.standard_error
    )
    score = np.abs(difference) / sigma
    worst = float(score.max())
    single = 2.0 * float(t.sf(worst, _CHECK_SCRAMBLES - 1))
    return {
        "rays": judge.samples * judge.scrambles,
        "scrambles": judge.scrambles,
        "points": len(points),
        "mean_difference": float(difference.mean()),
        "mean_difference_error": float(np.sqrt((sigma**2).sum()) / len(points)),
        "rms_sigma": rms(score),
        "max_sigma": worst,
        "p_value": float(-np.expm1(len(points) * np.log1p(-min(single, 1 - 1e-16)))),
        "beyond_5_sigma": [
            {
                "point": points[i].tolist(),
                "normal": normals[i].tolist(),
                "silint": float(truth.value[i]),
                "embree": float(judge.value[i]),
                "sigma": float(score[i]),
            }
            for i in np.flatnonzero(score > 5)
        ],
    }


def _random_rotation(rng: np.random.Generator) -> FloatArray:
    """Uniform over all rotations, from a quaternion [Shoemake 1992]."""
    q = rng.normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
