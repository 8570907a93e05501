"""What a sampled reference returns: values, how sure it is of them, and what they took."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["ReferenceResult", "combined"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceResult:
    """What Embree QMC found, how sure it is, and how fast it was.

    Attributes
    ----------
    value : ndarray of float64, shape (n,), (n, 3) or (n, C)
        Mean over all scrambles.
    standard_error : ndarray of float64, same shape
        Of `value`, point by point, from the spread of the independent scrambles; NaN with a single one.
    samples : int
        Samples a point in each scramble: rays, but for those towards a light below the point's horizon.
    scrambles : int
        Independent scrambles; a point took ``samples * scrambles`` samples.
    rays : int
        Rays in all.
    seconds : float
        Wall time of making the rays, tracing and counting them.
    threads : int
        Threads that did it.
    """

    value: FloatArray
    standard_error: FloatArray
    samples: int
    scrambles: int
    rays: int
    seconds: float
    threads: int

    @property
    def rays_per_second(self) -> float:
        """Rays in all over wall time."""
        return self.rays / self.seconds if self.seconds > 0 else float("nan")


def combined(per_scramble: FloatArray, **info: Any) -> ReferenceResult:
    """Mean and standard error of estimates (R, n, ...), one a scramble; `info` is the rest of a result."""
    # Scrambles last and contiguous: NumPy then sums each point's the same way for one point as for many.
    estimates = np.ascontiguousarray(np.moveaxis(per_scramble, 0, -1))
    scrambles = info["scrambles"]
    value = estimates.mean(axis=-1)
    if scrambles > 1:
        error = estimates.std(axis=-1, ddof=1) / np.sqrt(scrambles)
    else:
        error = np.full_like(value, np.nan)
    return ReferenceResult(value=value, standard_error=error, **info)
