"""The integrator: hierarchies built once, integrals over what any number of points can see."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core.integrands import fractions, octahedral_sh, radial, radial_sh
from silint.core.radial import NO_AIM, RadialIntervals
from silint.environment import Environment
from silint.explain import REQUESTS, memory, octahedral_plan, radial_plan, scene_plan
from silint.finder import KERNEL_LOCK, Progress, VisibleFinder, add_counts, diagnose
from silint.plan import Plan
from silint.scene import as_scene
from silint.sh import MAX_DEGREE
from silint.validation import (
    InputError,
    choice,
    positive_int,
    positive_number,
    unit_vector,
)
from silint.visibility import WEIGHTINGS, FloatArray, Result, Visibility, check_table, in_rows

METHODS = ("auto", "octahedral", "radial")
MAX_ISOLINES = 4096

# Lines that a query with a tolerance starts with; doubled for the points that need it.
_FIRST_ISOLINES = 32

_MOST_STEPS = 12  # doublings, from any number of lines to MAX_ISOLINES at least

# The error falls as lines ** -_RATE.
_RATE = 1.5

Found = tuple[FloatArray, FloatArray]  # value, error estimate


class _Integrand(NamedTuple):
    """Phase two of a query, for either family of isolines."""

    shape: tuple[int, ...]
    octahedral: Callable[[Visibility], Found]
    radial: Callable[[RadialIntervals], Found] | None  # None: no closed form along a line
    most_octahedral: int = MAX_ISOLINES  # for the size of its table; a power of two
    aim: FloatArray = NO_AIM  # a direction that a radial line of every point is to pass through


class SilhouetteIntegrator:
    """Integrals over what points can see of a scene, from the silhouettes seen by them [NBMJ14].

    Built once for a scene; every query is a function of its arguments alone, and one integrator may serve
    many threads. A point's value does not depend on the other points, their order, or the number of threads.

    Parameters
    ----------
    scene : Scene, path, or trimesh object

    Notes
    -----
    All queries take `points` and `normals` of shape (n, 3). Normals need not be of unit length. Points may
    lie anywhere: in space, on faces, edges or vertices of the mesh (they then see what lies in front of
    them, along their normal), inside solids (they see nothing).

    With ``full_output=True`` a query returns a `Result`, whose diagnostics count, over all points:

    points, isolines
        The size of the request.
    buried
        Points that see nothing at all.
    swept_points, covered_points
        Which way they were served: by sweeping the depth count, or by covering lines with faces.
    fallback_isolines
        Isolines whose depth counts contradicted each other and that were computed again by covering.
    snapped_sides
        Sides of contour edges' faces that rounding could not tell and a rule decided.
    edges_tested, nodes_visited, contour_edges, crossings
        Work done by the search and the sweep.
    """

    def __init__(self, scene: Any) -> None:
        self.scene = as_scene(scene)
        self._finder = VisibleFinder(self.scene)

    # ------------------------------------------------------------------ queries

    def ambient_occlusion(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None = None,
        weighting: str = "cosine",
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """Open fraction of the hemisphere over each point: 1 is open, 0 is closed.

        Parameters
        ----------
        points, normals : array_like, shape (n, 3)
        isolines : int, optional
            Lines for each point, 1 to 4096, by default 64. The error falls about as isolines ** -1.5. Radial
            isolines come in even numbers from 4 on, others are rounded up.
        weighting : {"cosine", "uniform"}
            (1/pi) int V max(n.w, 0) dw, or (1/2pi) int V dw over the hemisphere of n.
        method : {"auto", "octahedral", "radial"}
            The family of isolines: half-planes through each point's own normal are cheaper, those of the
            global octahedral map serve any function of direction. "auto" takes radial ones.
        tolerance : float, optional
            In place of isolines: take as many as each point needs for its own error estimate to be below
            this. Points that 4096 do not bring there are counted as ``above_tolerance``.
        full_output : bool
            Return a `Result` instead of the values.
        progress : callable, optional
            Called with the numbers of points done and in all.

        Returns
        -------
        (n,) float64, or Result

        Raises
        ------
        silint.InputError
            Wrong shapes, NaN, zero normals or unknown options, in one line.
        """
        choice(weighting, "weighting", WEIGHTINGS)

        integrand = _Integrand(
            (),
            lambda v: fractions.hemisphere_fraction(
                v.normals, (v.offsets, v.intervals), v.isolines, weighting
            ),
            lambda v: radial.hemisphere_fraction(v, weighting),
        )
        return self._integrate(integrand, points, normals, isolines, method, tolerance, full_output, progress)

    def sky_view_factor(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 0.0, 1.0),
        isolines: int | None = None,
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) [up.w > 0] dw: the share of a uniform sky's light that arrives.

        1 for an open horizontal surface, 1/2 for an open vertical wall.

        Parameters
        ----------
        up : array_like, shape (3,)
            Where the sky is.

        Returns
        -------
        (n,) float64, or Result
        """
        axis = unit_vector(up, "up")

        integrand = _Integrand(
            (),
            lambda v: fractions.sky_view_factor(v.normals, (v.offsets, v.intervals), v.isolines, axis),
            lambda v: radial.sky_view_factor(v, axis),
        )
        return self._integrate(integrand, points, normals, isolines, method, tolerance, full_output, progress)

    def bent_normals(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None = None,
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) w dw: where the open part of the sky lies, and how much there is.

        Under an open sky it is 2/3 n; zero where nothing is visible.

        Returns
        -------
        (n, 3) float64, or Result
        """
        integrand = _Integrand(
            (3,),
            lambda v: fractions.bent_normal(v.normals, (v.offsets, v.intervals), v.isolines),
            radial.bent_normal,
        )
        return self._integrate(integrand, points, normals, isolines, method, tolerance, full_output, progress)

    def sh_transfer(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        max_degree: int = 4,
        isolines: int | None = None,
        weighting: str = "cosine",
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """Visibility in spherical harmonics: what an environment's coefficients are to be multiplied with.

        The sum of products with the coefficients of an environment's radiance is the irradiance over pi
        that arrives from it ("cosine"). Conventions: `silint.sh`; axes are the world's.

        Parameters
        ----------
        max_degree : int
            L, 0 to 16. K lines resolve degrees well below K / 2.
        weighting : {"cosine", "uniform"}
            (1/pi) int V max(n.w, 0) Y_lm dw, or int V Y_lm dw over the hemisphere of n.
        tolerance : float, optional
            Of the square root of the summed squares of all coefficients' errors, as is the estimate.

        Returns
        -------
        (n, (L + 1)^2) float64, or Result
        """
        choice(weighting, "weighting", WEIGHTINGS)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        integrand = _Integrand(
            ((degree + 1) ** 2,),
            lambda v: octahedral_sh.sh_transfer(
                v.normals, (v.offsets, v.intervals), v.isolines, degree, weighting
            ),
            lambda v: radial_sh.sh_transfer(v, degree, weighting),
            min(octahedral_sh.most_isolines(degree, weighting), MAX_ISOLINES),
        )
        return self._integrate(integrand, points, normals, isolines, method, tolerance, full_output, progress)

    def irradiance(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        environment: Environment,
        isolines: int | None = None,
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """int L V max(n.w, 0) dw: what arrives from an environment, past the scene [NBMJ14 eq. 8].

        Parameters
        ----------
        environment : Environment
            Prepared once and kept.
        method : {"auto", "octahedral", "radial"}
            Radial isolines sum the map in cells; small bright sources are taken out of it, and a line of each
            point passes through the brightest, so that the edge of its shadow is exact. They are 2 to 4 times
            cheaper, and tables end their error at 5e-4. Octahedral isolines sum every texel, each in a strip
            of the sky 2 / isolines wide: where a sun is half hidden, few show as bands. "auto" takes radial.
        tolerance : float, optional
            In units of irradiance, of the channel that needs it most.

        Returns
        -------
        (n, 3) float64, or Result
            In units of the environment's radiance times steradians: pi L under an open constant sky.
        """
        if not isinstance(environment, Environment):
            raise InputError(
                f"environment is a {type(environment).__name__}; expected a silint.Environment "
                "(Environment.from_file, .from_array, .constant, ...)"
            )
        choice(method, "method", METHODS)
        octahedral = method == "octahedral"
        most = min(environment.most_isolines, MAX_ISOLINES) if octahedral else MAX_ISOLINES
        if tolerance is None:
            positive_int(64 if isolines is None else isolines, "isolines", 1, most)
        integrand = _Integrand(
            (3,),
            lambda v: v._irradiance(environment),
            environment.radial_irradiance,
            most,
            NO_AIM if octahedral else environment.aim,
        )
        return self._integrate(integrand, points, normals, isolines, method, tolerance, full_output, progress)

    def visibility(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int = 64,
        method: str = "octahedral",
        progress: Progress | None = None,
    ) -> Visibility:
        """The visible intervals themselves, to be integrated as often as wanted.

        Returns
        -------
        Visibility
            About 100 bytes an isoline and point.
        """
        choice(method, "method", ("auto", "octahedral"))
        lines = _at_least_two(isolines)
        p, n = self._finder.shade_points(points, normals)
        totals = diagnose(None, 0, 0, lines)
        lengths, intervals, rows = [], [], []
        for visible, group in self._finder.octahedral(p, n, lines, progress):
            lengths.append(np.diff(visible.offsets))
            intervals.append(visible.intervals)
            rows.append(group)
            add_counts(totals, visible.diagnostics)
        offsets, found = in_rows(len(p), lines, lengths, intervals, rows)
        return Visibility(n, lines, offsets, found, diagnostics=totals)

    # ------------------------------------------------------------------ what is built, and why

    @property
    def plan(self) -> Plan:
        """What the scene needs, whatever will be asked of it."""
        return scene_plan(self.scene, self._finder)

    def explain(
        self,
        request: str,
        isolines: int = 64,
        weighting: str = "cosine",
        method: str = "auto",
        max_degree: int = 4,
        environment: Environment | None = None,
    ) -> Plan:
        """What a request builds and runs beyond the scene's plan, and what it leaves out.

        Parameters
        ----------
        request : str
            "ambient_occlusion", "sky_view_factor", "bent_normals", "sh_transfer", "irradiance" or
            "visibility".
        isolines, weighting, method, max_degree, environment
            As in the request.
        """
        choice(request, "request", REQUESTS)
        choice(weighting, "weighting", WEIGHTINGS)
        choice(method, "method", METHODS)
        k = positive_int(isolines, "isolines", 1, MAX_ISOLINES)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        if method == "octahedral" or request == "visibility":
            return octahedral_plan(self._finder, request, k, weighting, degree, environment)
        return radial_plan(self._finder, request, k, weighting, degree, environment)

    @property
    def memory(self) -> dict[str, int]:
        """Bytes of topology and hierarchies, by part."""
        return memory(self._finder)

    def __repr__(self) -> str:
        return f"<silint.SilhouetteIntegrator of {self.scene!r}>"

    # ------------------------------------------------------------------ how

    def _integrate(
        self,
        integrand: _Integrand,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None,
        method: str,
        tolerance: float | None,
        full_output: bool,
        progress: Progress | None,
    ) -> Any:
        """Both phases, group by group, so that memory does not grow with the points."""
        choice(method, "method", METHODS)
        if tolerance is None:
            lines = positive_int(64 if isolines is None else isolines, "isolines", 1, MAX_ISOLINES)
            if method == "octahedral":
                check_table(lines, integrand.most_octahedral)
        elif isolines is None:
            tolerance, lines = positive_number(tolerance, "tolerance"), _FIRST_ISOLINES
        else:
            raise InputError("isolines and tolerance given; a tolerance takes as many isolines as it needs")
        n_points, chunks = self._finder.shade_point_chunks(points, normals)
        value, estimate = np.empty((n_points, *integrand.shape)), np.empty(n_points)
        totals = diagnose(None, 0, 0, 0)
        if tolerance is not None:
            totals["above_tolerance"] = 0
        for chunk, p, n in chunks:
            report = _part_of(progress, chunk, n_points)
            part = value[chunk], estimate[chunk]
            if tolerance is None:
                self._run(integrand, method, p, n, np.arange(len(p)), lines, *part, totals, report)
            else:
                self._refine(integrand, method, p, n, tolerance, *part, totals, report)
        return Result(value, estimate, totals) if full_output else value

    def _refine(
        self,
        integrand: _Integrand,
        method: str,
        p: FloatArray,
        n: FloatArray,
        tolerance: float,
        value: FloatArray,
        estimate: FloatArray,
        totals: dict[str, int],
        progress: Progress | None,
    ) -> None:
        """Double the lines of every point, more than once where its estimate asks for it, until it is met."""
        most = integrand.most_octahedral if method == "octahedral" else MAX_ISOLINES
        lines = np.full(len(p), _FIRST_ISOLINES)
        k = _FIRST_ISOLINES
        while k <= most:
            rows = np.flatnonzero(lines == k)
            if len(rows):
                counts = diagnose(None, 0, 0, 0)
                # Progress is that of the first pass; what a few points need beyond it is not known.
                report = progress if k == _FIRST_ISOLINES else None
                self._run(integrand, method, p[rows], n[rows], rows, k, value, estimate, counts, report)
                above = rows[estimate[rows] > tolerance]
                steps = np.ceil(np.log2(estimate[above] / tolerance) / _RATE).clip(1, _MOST_STEPS)
                lines[above] = k * 2 ** steps.astype(int)
                if k < most:
                    lines[above] = np.minimum(lines[above], most)
                if k > _FIRST_ISOLINES:
                    counts["points"] = 0  # counted once
                add_counts(totals, counts)
            k *= 2
        totals["above_tolerance"] += int((lines > most).sum())

    def _run(
        self,
        integrand: _Integrand,
        method: str,
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
        if method == "octahedral" or integrand.radial is None:
            for visible, part in self._finder.octahedral(p, n, max(isolines, 2), progress):
                with KERNEL_LOCK:
                    value[rows[part]], estimate[rows[part]] = integrand.octahedral(visible)
                add_counts(totals, visible.diagnostics)
            return
        even = max(isolines + isolines % 2, 4)
        for found, counts, group in self._finder.radial(p, n, even, progress, integrand.aim):
            with KERNEL_LOCK:
                value[rows[group]], estimate[rows[group]] = integrand.radial(found)
            add_counts(totals, counts)


def _part_of(progress: Progress | None, chunk: slice, total: int) -> Progress | None:
    """Progress of a chunk as that of all points."""
    if progress is None:
        return None
    return lambda done, _: progress(chunk.start + done, total)


def _at_least_two(isolines: int) -> int:
    """A single isoline, at u = 0, meets no hemisphere of a normal along x."""
    return max(positive_int(isolines, "isolines", 1, MAX_ISOLINES), 2)
