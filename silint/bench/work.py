"""How much work a point takes, counted and not timed: what a regression guard can compare anywhere."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from silint.integrator import SilhouetteIntegrator
from silint.validation import FloatArray

__all__ = ["COUNTED", "work"]

COUNTED = ("nodes_visited", "edges_tested", "contour_edges", "crossings")


def work(
    integrator: SilhouetteIntegrator,
    points: FloatArray,
    normals: FloatArray,
    isolines: int,
    methods: Iterable[str],
) -> dict[str, dict[str, float]]:
    """Means over some points of what the diagnostics count, for each method."""
    out = {}
    for method in methods:
        result: Any = integrator.ambient_occlusion(points, normals, isolines, method=method, full_output=True)
        out[method] = {name: result.diagnostics[name] / len(points) for name in COUNTED}
    return out
