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
    from silint.bench.quantity import Quantity
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
    unit: float = 1.0
    """What errors are given in: values of this size make an error of 1."""

    @property
    def noise(self) -> float:
        """Root mean square of the standard errors, in `unit`."""
        return rms(self.standard_error) / self.unit

    def resolves(self, rmse: float) -> bool:
        """Whether an RMSE against this reference says something about what was compared with it."""
        return rmse >= RESOLVED * self.noise

    def as_dict(self) -> dict[str, Any]:
        """For the report."""
        return {
            "isolines": self.isolines,
            "rotations": self.rotations,
            "standard_error": self.noise,
            "unit": self.unit,
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
    quantity: Quantity,
    options: dict[str, Any],
    goal: float,
    folder: str | os.PathLike[str] | None,
    report: StageProgress,
) -> tuple[Reference, dict[str, Any]]:
    """A reference and Embree's verdict on it, computed once where there is a folder to keep them in.

    The file's name is a hash of everything that goes in, except the code: both are estimates with
    standard errors of their own, which a change of code does not make wrong.
    """
    described = {key: options.get(key) for key in ("seed", "reference_method")}
    described |= {**quantity.as_key(), "goal": goal}
    path = None
    if folder is not None:
        path = Path(folder) / f"{_digest(vertices, faces, points, normals, described)}.json"
        if path.is_file():
            kept = json.loads(path.read_text(encoding="utf-8"))
            value, error = np.array(kept["value"]), np.array(kept["standard_error"])
            found = Reference(value, error, kept["isolines"], kept["rotations"], quantity.unit(value))
            return found, kept["check"]
    truth = reference(vertices, faces, points, normals, quantity, options, report, goal)
    verdict = check(embree, truth, points, normals, quantity, options, report)
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
    quantity: Quantity,
    options: dict[str, Any],
    report: StageProgress,
    goal: float = 0.0,
) -> Reference:
    """Values and standard errors from silint in independent random orientations of everything.

    With a `goal` (relative where errors are), no more lines than seem to be needed for a standard error of
    that, and more turns where they fall short of it; without, the most lines, and as few turns as tell a
    spread.
    """
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

    rng = np.random.default_rng([options["seed"], 1])
    method = options.get("reference_method", "octahedral")
    values: list[FloatArray] = []
    isolines, unit, noise = 0, 1.0, np.inf
    while len(values) < _ROTATIONS or (len(values) < 2 * _ROTATIONS and 0 < goal * unit < noise):
        report("reference", len(values), max(_ROTATIONS, len(values) + 1))
        rotation = _random_rotation(rng)
        turned = SilhouetteIntegrator(Scene(vertices @ rotation.T, faces))
        p, n = points @ rotation.T, normals @ rotation.T
        query = partial(_turned_back, quantity, turned, p, n, rotation, method)
        if not isolines:
            isolines, first, unit = _enough_isolines(query, quantity, goal)
            values.append(first)
        else:
            values.append(query(isolines))
        if len(values) > 1:
            spread = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
            noise = rms(spread)
    report("reference", len(values), len(values))
    mean = np.mean(values, axis=0)
    return Reference(mean, spread, isolines, len(values), quantity.unit(mean))


def _turned_back(
    quantity: Quantity,
    integrator: Any,
    points: FloatArray,
    normals: FloatArray,
    rotation: FloatArray,
    method: str,
    isolines: int,
) -> FloatArray:
    """Values of a turned scene, under light that is turned along, in the frame of before."""
    value = quantity.turned(rotation).silhouettes(integrator, points, normals, isolines, method)
    return quantity.turned_back(value, rotation)


def _enough_isolines(
    query: Callable[[int], FloatArray], quantity: Quantity, goal: float
) -> tuple[int, FloatArray, float]:
    """Lines whose error, averaged over all turns, seems to be the goal; their values; the unit."""
    isolines, most = (quantity.most_isolines(k) for k in _GOAL_ISOLINES)
    if goal <= 0:
        isolines = quantity.most_isolines(_REFERENCE_ISOLINES)
    value = query(isolines)
    while 0 < goal and isolines < most:
        isolines *= 2
        coarser, value = value, query(isolines)
        # Errors fall as isolines^-1.5, so the change is the coarser one's error, by and large.
        if rms(value - coarser) / 2**1.5 <= goal * quantity.unit(value) * np.sqrt(_ROTATIONS):
            break
    return isolines, value, quantity.unit(value)


def check(
    embree: EmbreeQMC,
    truth: Reference,
    points: FloatArray,
    normals: FloatArray,
    quantity: Quantity,
    options: dict[str, Any],
    report: StageProgress,
) -> dict[str, Any]:
    """A reference against Embree with many scrambles, in units of their joint standard error."""
    from scipy.stats import t

    judge = quantity.rays(
        embree,
        points,
        normals,
        _CHECK_SAMPLES,
        opponent_seed(options["seed"]) + 1,
        _CHECK_SCRAMBLES,
        partial(report, "checking the reference"),
    )
    difference = truth.value - judge.value
    # Where all rays agree the spread is 0, but a share below one ray in all of them goes unseen.
    sigma = np.hypot(
        np.maximum(judge.standard_error, truth.unit / (judge.samples * judge.scrambles)),
        truth.standard_error,
    )
    score = np.abs(difference) / sigma
    # Components of one point share their rays and lines: taken as fully correlated.
    each = sigma.reshape(len(points), -1).mean(axis=1)
    worst = float(score.max())
    single = 2.0 * float(t.sf(worst, _CHECK_SCRAMBLES - 1))
    return {
        "rays": judge.samples * judge.scrambles,
        "scrambles": judge.scrambles,
        "points": len(points),
        "mean_difference": float(difference.mean()) / truth.unit,
        "mean_difference_error": float(np.sqrt((each**2).sum()) / len(points)) / truth.unit,
        "rms_sigma": rms(score),
        "max_sigma": worst,
        "p_value": float(-np.expm1(score.size * np.log1p(-min(single, 1 - 1e-16)))),
        "beyond_5_sigma": [
            {
                "point": points[at[0]].tolist(),
                "normal": normals[at[0]].tolist(),
                "silint": float(truth.value[tuple(at)]),
                "embree": float(judge.value[tuple(at)]),
                "sigma": float(score[tuple(at)]),
                **({"component": int(at[1])} if len(at) > 1 else {}),
            }
            for at in np.argwhere(score > 5)
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
