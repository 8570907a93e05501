"""What errors are measured against, and whether that can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from silint.reference import EmbreeQMC

__all__ = ["ERROR_POINTS", "Reference", "check", "opponent_seed", "reference", "rms"]

FloatArray = npt.NDArray[np.float64]
StageProgress = Callable[[str, int, int], None]

# Points whose errors count.
ERROR_POINTS = 256

# Standard errors of the reference that an RMSE must reach to be given as a number.
_RESOLVED = 4.0

_REFERENCE_ISOLINES = 1024
_ROTATIONS = 6
_CHECK_SCRAMBLES = 64
_CHECK_SAMPLES = 2048


@dataclass(frozen=True)
class Reference:
    """Values at the first ERROR_POINTS points, and their standard errors."""

    value: FloatArray
    standard_error: FloatArray
    isolines: int
    rotations: int

    def resolves(self, rmse: float) -> bool:
        """Whether an RMSE against this reference says something about what was compared with it."""
        return rmse >= _RESOLVED * rms(self.standard_error)

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


def reference(
    vertices: FloatArray,
    faces: npt.NDArray[np.int32],
    points: FloatArray,
    normals: FloatArray,
    options: dict[str, Any],
    rng: np.random.Generator,
    report: StageProgress,
) -> Reference:
    """Values and standard errors from silint in independent random orientations of everything."""
    from silint.integrator import SilhouetteIntegrator
    from silint.scene import Scene

    p, n = points[:ERROR_POINTS], normals[:ERROR_POINTS]
    values = []
    for r in range(_ROTATIONS):
        report("reference", r, _ROTATIONS)
        rotation = _random_rotation(rng)
        turned = SilhouetteIntegrator(Scene(vertices @ rotation.T, faces))
        values.append(
            turned.ambient_occlusion(
                p @ rotation.T, n @ rotation.T, isolines=_REFERENCE_ISOLINES, weighting=options["weighting"]
            )
        )
    report("reference", _ROTATIONS, _ROTATIONS)
    spread = np.std(values, axis=0, ddof=1) / np.sqrt(_ROTATIONS)
    return Reference(np.mean(values, axis=0), spread, _REFERENCE_ISOLINES, _ROTATIONS)


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

    p, n = points[:ERROR_POINTS], normals[:ERROR_POINTS]
    judge = embree.ambient_occlusion(
        p,
        n,
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
        "points": len(p),
        "mean_difference": float(difference.mean()),
        "mean_difference_error": float(np.sqrt((sigma**2).sum()) / len(p)),
        "rms_sigma": rms(score),
        "max_sigma": worst,
        "p_value": float(-np.expm1(len(p) * np.log1p(-min(single, 1 - 1e-16)))),
        "beyond_5_sigma": [
            {
                "point": p[i].tolist(),
                "normal": n[i].tolist(),
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
