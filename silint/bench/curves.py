"""Equal-error times from measured curves: interpolated on log-log axes, never extrapolated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["Bounded", "pays_after", "power_law", "speedup", "time_at_error"]


class Bounded(NamedTuple):
    """A number, or what is known of it."""

    value: float
    bound: str
    """"" if it is `value`, "<" if it is less, ">" if it is more."""

    def __str__(self) -> str:
        return f"{self.bound}{self.value:.3g}"


def time_at_error(times: Sequence[float], errors: Sequence[float], level: float) -> Bounded | None:
    """The least time at which a curve of settings, cheap to expensive, is as good as `level`.

    Parameters
    ----------
    times, errors : sequences of float
        One of each for each setting, in the order of the settings, times positive.
    level : float
        Error wanted, positive.

    Returns
    -------
    Bounded or None
        Interpolated between neighbouring settings; ``<`` the time of the first setting if that is better
        already, ``>`` that of the last if none is as good. None for an empty curve.
    """
    if not times:
        return None
    candidates = [
        Bounded(t, "" if i else "<") for i, (t, e) in enumerate(zip(times, errors, strict=True)) if e <= level
    ]
    for i in range(1, len(times)):
        (t0, e0), (t1, e1) = (times[i - 1], errors[i - 1]), (times[i], errors[i])
        # An error of exactly 0 is below any level, at the setting itself.
        if e0 > level >= e1 > 0 or e1 > level >= e0 > 0:
            s = math.log(level / e0) / math.log(e1 / e0)
            candidates.append(Bounded(t0 * (t1 / t0) ** s, ""))
    if not candidates:
        return Bounded(max(times), ">")
    return min(candidates)


def speedup(ours: Bounded | None, theirs: Bounded | None) -> Bounded | None:
    """How many times faster `ours` is, or None where the bounds leave it open."""
    bound = _advantage(ours, theirs)
    if ours is None or theirs is None or bound is None:
        return None
    return Bounded(theirs.value / ours.value, bound)


def pays_after(build_seconds: float, ours: Bounded | None, theirs: Bounded | None) -> Bounded | None:
    """Points after which building is earned back by `ours`, in microseconds a point, over `theirs`.

    Infinite if ours is no faster; None where the bounds leave it open.
    """
    bound = _advantage(ours, theirs)
    if ours is None or theirs is None or bound is None:
        return None
    saved = theirs.value - ours.value
    if saved <= 0:
        return None if bound == ">" else Bounded(math.inf, "")
    return Bounded(1e6 * build_seconds / saved, {">": "<", "<": ">", "": ""}[bound])


def _advantage(ours: Bounded | None, theirs: Bounded | None) -> str | None:
    """The bound on whatever grows with theirs and falls with ours; None where theirs and ours disagree."""
    if ours is None or theirs is None:
        return None
    signs = {{">": "<", "<": ">", "": ""}[ours.bound], theirs.bound} - {""}
    if len(signs) > 1:
        return None
    return signs.pop() if signs else ""


def power_law(sizes: Sequence[float], times: Sequence[float]) -> tuple[float, float]:
    """Factor and exponent of the least-squares line through some points on log-log axes."""
    x, y = [math.log(s) for s in sizes], [math.log(t) for t in times]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    exponent = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    exponent /= sum((a - mean_x) ** 2 for a in x)
    return math.exp(mean_y - exponent * mean_x), exponent
