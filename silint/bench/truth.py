"""What errors are measured against, and whether that can be trusted."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.io import write_bytes

if TYPE_CHECKING:
    from silint.bench.quantity import Quantity
    from silint.reference import EmbreeQMC, ReferenceResult

__all__ = ["Reference", "check", "judged_reference", "opponent_seed", "reference", "relative_rms", "rms"]

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
# Where neither standard error comes within the first of a goal, Embree gets the second times as many rays.
_FAR, _MORE = 2.0, 4


@dataclass(frozen=True)
class Reference:
    """Values at some points, and their standard errors."""

    value: FloatArray
    standard_error: FloatArray
    isolines: int
    rotations: int
    unit: FloatArray = field(default_factory=lambda: np.array(1.0))
    """() or (channels,): what errors are given in; values of this size make an error of 1."""
    by: str = "silint"
    """Whose values these are, "silint" or "embree"; isolines and rotations are silint's in any case."""

    @property
    def noises(self) -> FloatArray:
        """Root mean square of the standard errors, in `unit`: (1,) or (channels,)."""
        return relative_rms(self.standard_error, self.unit)

    @property
    def noise(self) -> float:
        """The largest of `noises`."""
        return float(self.noises.max())

    def resolved(self, rmses: FloatArray) -> npt.NDArray[np.bool_]:
        """Which RMSEs, of all or of each channel, say something about what was compared with this."""
        return rmses >= RESOLVED * self.noises

    def as_dict(self) -> dict[str, Any]:
        """For the report."""
        return {
            "by": self.by,
            "isolines": self.isolines,
            "rotations": self.rotations,
            "standard_error": self.noise,
            "unit": self.unit.tolist(),
        }


def rms(x: FloatArray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def relative_rms(x: FloatArray, unit: FloatArray) -> FloatArray:
    """Root mean squares over the points, in units: (1,), or (channels,) where `unit` has as many."""
    if unit.ndim == 0:
        return np.array([rms(x) / float(unit)])
    out: FloatArray = np.sqrt(np.mean(np.square(x / unit), axis=0))
    return out


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
    """The surer of silint's and Embree's values, and what the two say of each other.

    Computed once where there is a folder to keep them in.

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
            by = kept.get("by", "silint")  # those kept before Embree could be one are silint's
            found = Reference(value, error, kept["isolines"], kept["rotations"], quantity.unit(value), by)
            return found, kept["check"]
    truth = reference(vertices, faces, points, normals, quantity, options, report, goal)
    judge = rays_of_check(embree, points, normals, quantity, options, report)
    unit = quantity.unit(judge.value)
    if 0 < _FAR * goal < min(truth.noise, float(relative_rms(judge.standard_error, unit).max())):
        judge = rays_of_check(embree, points, normals, quantity, options, report, _MORE * _CHECK_SAMPLES)
    verdict = check(truth, judge, points, normals)
    rays = replace(truth, value=judge.value, standard_error=judge.standard_error, unit=unit, by="embree")
    truth = min(truth, rays, key=lambda found: found.noise)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        numbers = {key: getattr(truth, key).tolist() for key in ("value", "standard_error", "unit")}
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
    isolines, unit, noise = 0, np.array(1.0), np.inf
    while len(values) < _ROTATIONS or (len(values) < 2 * _ROTATIONS and 0 < goal < noise):
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
            noise = float(relative_rms(spread, unit).max())
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
) -> tuple[int, FloatArray, FloatArray]:
    """Lines whose error, averaged over all turns, seems to be the goal; their values; the unit."""
    isolines, most = (quantity.most_isolines(k) for k in _GOAL_ISOLINES)
    if goal <= 0:
        isolines = quantity.most_isolines(_REFERENCE_ISOLINES)
    value = query(isolines)
    while 0 < goal and isolines < most:
        isolines *= 2
        coarser, value = value, query(isolines)
        # Errors fall as isolines^-1.5, so the change is the coarser one's error, by and large.
        change = relative_rms(value - coarser, quantity.unit(value)).max()
        if change / 2**1.5 <= goal * np.sqrt(_ROTATIONS):
            break
    return isolines, value, quantity.unit(value)


def rays_of_check(
    embree: EmbreeQMC,
    points: FloatArray,
    normals: FloatArray,
    quantity: Quantity,
    options: dict[str, Any],
    report: StageProgress,
    samples: int = _CHECK_SAMPLES,
) -> ReferenceResult:
    """Embree with many scrambles, and with another seed than the opponent."""
    return quantity.rays(
        embree,
        points,
        normals,
        samples,
        opponent_seed(options["seed"]) + 1,
        _CHECK_SCRAMBLES,
        partial(report, "checking the reference"),
    )


def check(
    truth: Reference, judge: ReferenceResult, points: FloatArray, normals: FloatArray
) -> dict[str, Any]:
    """Silint's reference against Embree with many scrambles, in units of their joint standard error."""
    from scipy.stats import t

    difference = truth.value - judge.value
    # Where all rays agree the spread is 0, but a share below one ray in all of them goes unseen.
    sigma = np.hypot(
        np.maximum(judge.standard_error, truth.unit / (judge.samples * judge.scrambles)),
        truth.standard_error,
    )
    score = np.abs(difference) / sigma
    # Components of one point share their rays and lines: taken as fully correlated.
    each = (sigma / truth.unit).reshape(len(points), -1).mean(axis=1)
    worst = float(score.max())
    single = 2.0 * float(t.sf(worst, judge.scrambles - 1))
    return {
        "rays": judge.samples * judge.scrambles,
        "scrambles": judge.scrambles,
        "points": len(points),
        "mean_difference": float((difference / truth.unit).mean()),
        "mean_difference_error": float(np.sqrt((each**2).sum()) / len(points)),
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
