"""Both phases of a query: shade points in groups, from what is visible to values with error estimates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core.arcs_types import Arcs
from silint.core.caps import LINES_OF_FALLOFF, NO_FALLOFF, UNLIMITED, LineLimits
from silint.core.integrands import radial_sh
from silint.core.jit import KERNEL_LOCK
from silint.core.radial import NO_AIM, RadialIntervals
from silint.finder import Progress, VisibleFinder, add_counts, diagnose
from silint.limits import LEAST_RADIAL_SPREAD, NO_LIMITS, Limits
from silint.validation import InputError, choice, positive_int, positive_number
from silint.visibility import FloatArray, Result, Visibility, check_table

METHODS = ("auto", "octahedral", "radial", "exact")
MAX_ISOLINES = 4096

# Lines that a query with a tolerance starts with; doubled for the points that need it.
_FIRST_ISOLINES = 32

# Points that need more lines than this for their tolerance take arcs, about where they cost the same; but not
# in scenes that are covered, where very many surfaces lie behind each other.
_ARCS_BEYOND = 512
# Lines in place of arcs that contradict each other.
_INSTEAD_OF_ARCS = 1024

_MOST_STEPS = 12  # doublings, from any number of lines to MAX_ISOLINES at least

# The cosine of a cone that is too narrow for lines.
_NARROW = float(np.cos(np.radians(LEAST_RADIAL_SPREAD)))

# The error falls as lines ** -_RATE.
_RATE = 1.5

Found = tuple[FloatArray, FloatArray]  # value, error estimate


class Integrand(NamedTuple):
    """Phase two of a query, for either family of isolines and for boundary arcs."""

    shape: tuple[int, ...]
    octahedral: Callable[[Visibility], Found]
    radial: Callable[[RadialIntervals], Found] | None  # None: no closed form along a line
    exact: Callable[[Arcs], Found] | None = None  # None: no closed form along an arc
    most_octahedral: int = MAX_ISOLINES  # for the size of its table; a power of two
    max_degree: int = 0  # of harmonics, for which few lines alias
    aim: FloatArray = NO_AIM  # a direction that a radial line of every point is to pass through
    prepare: Callable[[int], Any] | None = (
        None  # builds the table for some isolines, before any lock is taken
    )
    has_spread: bool = False  # a fraction of a cone, or of the hemisphere
    exact_limits: tuple[str, ...] = ()  # those that are known along arcs, one at a time


def evaluate(
    finder: VisibleFinder,
    integrand: Integrand,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    isolines: int | None,
    method: str,
    tolerance: float | None,
    full_output: bool,
    progress: Progress | None,
    *,
    limits: Limits = NO_LIMITS,
) -> Any:
    """Both phases, group by group, so that memory does not grow with the points."""
    choice(method, "method", METHODS)
    method = limits.method_for(method, integrand.exact_limits, integrand.has_spread)
    if method == "exact":
        if integrand.exact is None:
            raise InputError("method is 'exact'; there is no closed form along arcs for this request")
        if isolines is not None:
            raise InputError("isolines given with method='exact', which takes no lines: leave it out")
        if tolerance is not None:
            tolerance = positive_number(tolerance, "tolerance")
        lines = 0
    elif tolerance is None:
        lines = positive_int(64 if isolines is None else isolines, "isolines", 1, MAX_ISOLINES)
        if method == "octahedral":
            check_table(lines, integrand.most_octahedral)
    elif isolines is None:
        tolerance, lines = positive_number(tolerance, "tolerance"), _FIRST_ISOLINES
    else:
        raise InputError("isolines and tolerance given; a tolerance takes as many isolines as it needs")
    within = finder.line_limits(limits) if limits else UNLIMITED
    n_points, chunks = finder.shade_point_chunks(points, normals)
    value, estimate = np.empty((n_points, *integrand.shape)), np.empty(n_points)
    totals = diagnose(None, 0, 0, 0)
    if tolerance is not None:
        totals["above_tolerance"] = 0
    for chunk, p, n in chunks:
        report = _part_of(progress, chunk, n_points)
        part = value[chunk], estimate[chunk]
        if tolerance is None or method == "exact":
            _run(finder, integrand, method, within, p, n, np.arange(len(p)), lines, *part, totals, report)
        else:
            _refine(finder, integrand, method, within, p, n, tolerance, *part, totals, report)
    if tolerance is not None and method == "exact":
        totals["above_tolerance"] = int((estimate > tolerance).sum())
    return Result(value, estimate, totals) if full_output else value


def _refine(
    finder: VisibleFinder,
    integrand: Integrand,
    method: str,
    limits: LineLimits,
    p: FloatArray,
    n: FloatArray,
    tolerance: float,
    value: FloatArray,
    estimate: FloatArray,
    totals: dict[str, int],
    progress: Progress | None,
) -> None:
    """Double the lines of every point, more than once where its estimate asks for it, until it is met.

    Points that need very many take arcs instead.
    """
    most = integrand.most_octahedral if method == "octahedral" else MAX_ISOLINES
    if limits.falloff != NO_FALLOFF:
        most = MAX_ISOLINES // LINES_OF_FALLOFF
    lines = np.full(len(p), _FIRST_ISOLINES)
    k = _FIRST_ISOLINES
    while k <= most:
        rows = np.flatnonzero(lines == k)
        if method == "auto" and integrand.exact is not None and k > _ARCS_BEYOND and not finder.cover:
            rows, k = np.flatnonzero(lines > _ARCS_BEYOND), most
            counts = diagnose(None, 0, 0, 0)
            _run_exact(finder, integrand, limits, p[rows], n[rows], rows, value, estimate, counts, None)
            add_counts(totals, {**counts, "points": 0, "buried": 0})
            lines[rows] = np.where(estimate[rows] > tolerance, 2 * most, most)
        elif len(rows):
            counts = diagnose(None, 0, 0, 0)
            # Progress is that of the first pass; what a few points need beyond it is not known.
            report = progress if k == _FIRST_ISOLINES else None
            _run(
                finder, integrand, method, limits, p[rows], n[rows], rows, k, value, estimate, counts, report
            )
            above = rows[estimate[rows] > tolerance]
            steps = np.ceil(np.log2(estimate[above] / tolerance) / _RATE).clip(1, _MOST_STEPS)
            lines[above] = k * 2 ** steps.astype(int)
            if k < most:
                lines[above] = np.minimum(lines[above], most)
            if k > _FIRST_ISOLINES:
                counts["points"] = counts["buried"] = 0  # counted once
            add_counts(totals, counts)
        k *= 2
    totals["above_tolerance"] += int((lines > most).sum())


def _run(
    finder: VisibleFinder,
    integrand: Integrand,
    method: str,
    limits: LineLimits,
    p: FloatArray,
    n: FloatArray,
    rows: npt.NDArray[Any],
    isolines: int,
    value: FloatArray,
    estimate: FloatArray,
    totals: dict[str, int],
    progress: Progress | None,
) -> None:
    """Write value and estimate of some rows, and add what was counted."""
    if method == "exact":
        _run_exact(finder, integrand, limits, p, n, rows, value, estimate, totals, progress)
        return
    if integrand.prepare is not None:
        integrand.prepare(max(isolines, 2))
    if method == "octahedral" or integrand.radial is None:
        for visible, part in finder.octahedral(p, n, max(isolines, 2), progress):
            with KERNEL_LOCK:
                value[rows[part]], estimate[rows[part]] = integrand.octahedral(visible)
            add_counts(totals, visible.diagnostics)
        return
    even = radial_sh.enough_lines(isolines, integrand.max_degree)
    lines = even if limits.falloff == NO_FALLOFF else LINES_OF_FALLOFF * even
    for found, counts, group in finder.radial(p, n, lines, progress, integrand.aim, limits):
        with KERNEL_LOCK:
            value[rows[group]], estimate[rows[group]] = integrand.radial(found)
        add_counts(totals, counts)


def _run_exact(
    finder: VisibleFinder,
    integrand: Integrand,
    limits: LineLimits,
    p: FloatArray,
    n: FloatArray,
    rows: npt.NDArray[Any],
    value: FloatArray,
    estimate: FloatArray,
    totals: dict[str, int],
    progress: Progress | None,
) -> None:
    """The same by boundary arcs; points without a certificate take lines."""
    assert integrand.exact is not None
    failed = []
    for arcs, certain, counts, group in finder.arcs(p, n, progress, limits):
        with KERNEL_LOCK:
            value[rows[group]], estimate[rows[group]] = integrand.exact(arcs)
        failed.append(group[~certain])
        add_counts(totals, counts)
    again = np.concatenate(failed) if failed else np.zeros(0, np.int64)
    if len(again) and limits.cone > _NARROW:
        estimate[rows[again]] = 1.0  # lines cannot stand in
    elif len(again):
        counts = diagnose(None, 0, 0, 0)
        _run(
            finder,
            integrand,
            "radial",
            limits,
            p[again],
            n[again],
            rows[again],
            _INSTEAD_OF_ARCS,
            value,
            estimate,
            counts,
            None,
        )
        add_counts(totals, {**counts, "points": 0, "buried": 0})


def _part_of(progress: Progress | None, chunk: slice, total: int) -> Progress | None:
    """Progress of a chunk as that of all points."""
    if progress is None:
        return None
    return lambda done, _: progress(chunk.start + done, total)
