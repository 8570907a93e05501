"""Ambient occlusion, sky fractions and bent normals from integrals over visible intervals.

Each value is the visible integral over the integral of the same isolines above the same horizon, times the
exact value of an open hemisphere. An open sky is then exactly open and a closed room exactly closed, at any
number of isolines.
"""

from __future__ import annotations

import numpy as np

from silint.core.integrands.moments import moment_table, second_moment_matrix
from silint.core.prefix_table import integrate_intervals
from silint.core.runs import clip_intervals, horizon_runs

Intervals = tuple[np.ndarray, np.ndarray]  # offsets (n K + 1,), loop coordinates (m, 2)


def hemisphere_fraction(
    normals: np.ndarray, visible: Intervals, isolines: int, weighting: str
) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) dw for "cosine", (1/2pi) int V dw over the hemisphere for "uniform".

    Returns
    -------
    value, error_estimate : (n,) float64
    """
    order = 1 if weighting == "cosine" else 0
    seen = _project(normals, _moments(order, visible, isolines))
    total = _project(normals, _moments(order, horizon_runs(normals, isolines), isolines))
    return _ratio(seen, total)


def sky_view_factor(
    normals: np.ndarray, visible: Intervals, isolines: int, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) [up.w > 0] dw, whose open value is (1 + n.up) / 2."""
    seen, total = (
        _project(normals, _moments(1, clip_intervals(*intervals, up, isolines), isolines))
        for intervals in (visible, horizon_runs(normals, isolines))
    )
    value, estimate = _ratio(seen, total)
    open_value = 0.5 * (1.0 + normals @ up)
    return value * open_value, estimate * open_value


def bent_normal(normals: np.ndarray, visible: Intervals, isolines: int) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) w dw: (n, 3), 2/3 n under an open sky; the estimate is that of its length."""
    runs = horizon_runs(normals, isolines)
    seen, total = (
        np.einsum("nhij,nj->nhi", second_moment_matrix(_moments(2, intervals, isolines)), normals)
        for intervals in (visible, runs)
    )
    # What the isolines miss of an open hemisphere is given back in the proportion that is open.
    fraction, _ = hemisphere_fraction(normals, visible, isolines, "cosine")
    missed = (2.0 / 3.0) * np.pi * normals - total.sum(axis=1)
    value = (seen.sum(axis=1) + fraction[:, None] * missed) / np.pi
    estimate = 2.0 * np.linalg.norm(seen[:, 0] - seen[:, 1], axis=1) / np.pi
    return value, np.minimum(estimate, 1.0)


def _moments(order: int, intervals: Intervals, isolines: int) -> np.ndarray:
    """Moments over intervals, even and odd isolines apart: (n, 2, C)."""
    table = moment_table(order, isolines)
    return integrate_intervals(table.values, table.nodes_per_quarter, *intervals, isolines)


def _project(normals: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """First moments along the normal; zeroth moments as they are."""
    return moments[..., 0] if moments.shape[-1] == 1 else np.einsum("nhi,ni->nh", moments, normals)


def _ratio(seen: np.ndarray, total: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Visible part of the total; the estimate is the difference between even and odd isolines."""
    whole = total.sum(axis=1)
    value = np.divide(seen.sum(axis=1), whole, out=np.zeros(len(seen)), where=whole > 0.0)
    halves = np.divide(seen, total, out=np.zeros_like(seen), where=total > 0.0)
    estimate = np.abs(halves[:, 0] - halves[:, 1])
    estimate[(total <= 0.0).any(axis=1) & (whole > 0.0)] = 1.0  # one half alone says nothing
    return np.clip(value, 0.0, 1.0), np.minimum(estimate, 1.0)
