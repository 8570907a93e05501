"""From errors and times of settings to times at equal errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from silint.bench.curves import Bounded, pays_after, speedup, time_at_error

__all__ = ["EMBREE", "LEVELS", "channel_equal_error", "equal_error", "points_to_pay"]

EMBREE = "embree"
LEVELS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)

# The error at which building is weighed against Embree's time.
PAYS_AT = 1e-3


def equal_error(rows: list[dict[str, Any]], methods: list[str]) -> list[dict[str, Any]]:
    """Times, speed-ups and costs of a report's rows at each of LEVELS."""
    curves = {}
    for method in [*methods, EMBREE]:
        # An RMSE that the reference's noise may have made is no point of a curve.
        known = [r for r in rows if r["method"] == method and r["resolved"]]
        curves[method] = ([r["us_per_point"] for r in known], [r["rmse"] for r in known])
    out = []
    for level in LEVELS:
        times = {method: time_at_error(*curve, level) for method, curve in curves.items()}
        first = times[methods[0]]
        out.append(
            {
                "rmse": level,
                "times": {method: _as_dict(t) for method, t in times.items()},
                "speedups": {method: _as_dict(speedup(times[method], times[EMBREE])) for method in methods},
                "costs": {method: _as_dict(speedup(first, times[method])) for method in methods[1:]},
            }
        )
    return out


def channel_equal_error(rows: list[dict[str, Any]], methods: list[str]) -> list[list[dict[str, Any]]] | None:
    """What `equal_error` finds of each channel's errors; None where rows have no channels."""
    if not rows or "channels" not in rows[0]:
        return None
    n = len(rows[0]["channels"])
    return [equal_error([{**row, **row["channels"][c]} for row in rows], methods) for c in range(n)]


def points_to_pay(
    build_seconds: dict[str, float], found: list[dict[str, Any]], methods: list[str]
) -> dict[str, Any]:
    """Points after which each method's building is earned back, from what `equal_error` found."""
    times = next(row["times"] for row in found if row["rmse"] == PAYS_AT)
    known = {method: t and Bounded(**t) for method, t in times.items()}
    out = {}
    for method in methods:
        after = pays_after(build_seconds[method], known[method], known[EMBREE])
        # JSON has no infinity.
        out[method] = _as_dict(after) if after is None or np.isfinite(after.value) else "never"
    return out


def _as_dict(number: Bounded | None) -> dict[str, Any] | None:
    return None if number is None else number._asdict()
