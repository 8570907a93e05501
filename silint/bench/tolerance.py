"""Does ``tolerance=`` keep its word? The share of points whose error is within it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from silint.reference import EmbreeQMC

__all__ = ["Calibration", "calibrate"]

FloatArray = npt.NDArray[np.float64]

# Where silint with a tolerance and its reference differ by more, Embree decides: scrambles and rays of each.
_SCRAMBLES, _SAMPLES = 64, 2048
# Standard errors of Embree within which an answer agrees with it.
_SIGMAS = 4.0


@dataclass(frozen=True)
class Calibration:
    """What came of one tolerance on some points.

    Attributes
    ----------
    tolerance : float
    within : float
        Share of points no further from the reference than the tolerance.
    exonerated : float
        Share of points further away, where Embree sides with the answer and against the reference.
    largest : float
        Largest distance from the reference.
    us_per_point : float
    """

    tolerance: float
    within: float
    exonerated: float
    largest: float
    us_per_point: float


def calibrate(
    query: Callable[[float], FloatArray],
    reference: FloatArray,
    embree: EmbreeQMC,
    points: FloatArray,
    normals: FloatArray,
    tolerance: float,
    seed: int = 0,
) -> Calibration:
    """Ask once with a tolerance, and compare with the reference and, where they differ, with Embree.

    Parameters
    ----------
    query : callable
        Values of all points with that tolerance.
    reference : (n,)
        Values with many isolines.
    embree : EmbreeQMC
        Of the same mesh.
    points, normals : (n, 3)
    tolerance : float
    seed : int
        Of Embree's rays.
    """
    start = time.perf_counter()
    value = query(tolerance)
    seconds = time.perf_counter() - start
    error = np.abs(value - reference)
    beyond = np.flatnonzero(error > tolerance)
    exonerated = 0
    if len(beyond):
        judge = embree.ambient_occlusion(
            points[beyond], normals[beyond], _SAMPLES, seed, scrambles=_SCRAMBLES
        )
        # All rays may agree; a share below one ray in all of them goes unseen.
        noise = _SIGMAS * np.maximum(judge.standard_error, 1.0 / (_SAMPLES * _SCRAMBLES))
        answer_is_right = np.abs(value[beyond] - judge.value) <= tolerance
        reference_is_wrong = np.abs(reference[beyond] - judge.value) > noise
        exonerated = int((answer_is_right & reference_is_wrong).sum())
    n = len(reference)
    return Calibration(
        tolerance, 1.0 - len(beyond) / n, exonerated / n, float(error.max()), 1e6 * seconds / n
    )
