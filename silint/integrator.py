"""The integrator: hierarchies built once, integrals over what any number of points can see."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from silint.core.integrands import arcs as along_arcs
from silint.core.integrands import arcs_ball, arcs_cone, arcs_sh, fractions, octahedral_sh, radial, radial_sh
from silint.core.radial import NO_AIM
from silint.derivatives import DerivativeQueries
from silint.environment import Environment
from silint.evaluate import MAX_ISOLINES, METHODS, Integrand, evaluate
from silint.explain import memory, request_plan, scene_plan
from silint.finder import Progress, VisibleFinder, add_counts, diagnose
from silint.limits import EXACT_LIMITS, NO_LIMITS, Limits, refuse_limits
from silint.plan import Plan
from silint.scene import as_scene
from silint.sh import MAX_DEGREE
from silint.tabulated import TabulatedQueries
from silint.validation import (
    InputError,
    choice,
    positive_int,
    unit_vector,
)
from silint.visibility import WEIGHTINGS, Visibility, in_rows
from silint.visible_arcs import VisibleArcs, compact, join


class SilhouetteIntegrator(TabulatedQueries, DerivativeQueries):
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
    exact_points, second_frames, uncertified_points
        Points served by boundary arcs, those of them that took a second try, and points whose arcs
        contradicted each other twice: 1024 radial isolines stand in for them, with their error estimate.
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
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
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
        method : {"auto", "octahedral", "radial", "exact"}
            The family of isolines: half-planes through each point's own normal are cheaper, those of the
            global octahedral map serve any function of direction. "auto" takes radial ones. "exact" takes no
            lines at all: it integrates along the arcs that bound what is visible, right to rounding, in about
            the time of 500 to 1000 lines.
        tolerance : float, optional
            In place of isolines: take as many as each point needs for its own error estimate to be below
            this. Points that 4096 do not bring there are counted as ``above_tolerance``.
        full_output : bool
            Return a `Result` instead of the values.
        progress : callable, optional
            Called with the numbers of points done and in all.
        max_distance, falloff, spread, backfaces, ground
            What counts: see `silint.Limits`. method="exact" knows a distance without falloff, or a spread.

        Returns
        -------
        (n,) float64, or Result

        Raises
        ------
        silint.InputError
            Wrong shapes, NaN, zero normals or unknown options, in one line.
        """
        choice(weighting, "weighting", WEIGHTINGS)
        limits = Limits(max_distance, falloff, spread, backfaces, ground)

        integrand = Integrand(
            (),
            lambda v: fractions.hemisphere_fraction(
                v.normals, (v.offsets, v.intervals), v.isolines, weighting
            ),
            lambda v: radial.hemisphere_fraction(v, weighting),
            lambda a: (
                arcs_cone.cone_fraction(a, weighting, limits.cone)
                if limits.cone
                else arcs_ball.hemisphere_fraction(a, weighting)
            ),
            has_spread=True,
            exact_limits=EXACT_LIMITS["ambient_occlusion"],
        )
        return self._integrate(
            integrand, points, normals, isolines, method, tolerance, full_output, progress, limits=limits
        )

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
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) [up.w > 0] dw: the share of a uniform sky's light that arrives.

        1 for an open horizontal surface, 1/2 for an open vertical wall.

        Parameters
        ----------
        up : array_like, shape (3,)
            Where the sky is.
        max_distance, falloff, spread, backfaces, ground
            See `silint.Limits`; with a spread it is a share of what an open cone has of n.w.

        Returns
        -------
        (n,) float64, or Result
        """
        axis = unit_vector(up, "up")
        limits = Limits(max_distance, falloff, spread, backfaces, ground)

        integrand = Integrand(
            (),
            lambda v: fractions.sky_view_factor(v.normals, (v.offsets, v.intervals), v.isolines, axis),
            lambda v: radial.sky_view_factor(v, axis),
            lambda a: along_arcs.sky_view_factor(a, axis),
            has_spread=True,
        )
        return self._integrate(
            integrand, points, normals, isolines, method, tolerance, full_output, progress, limits=limits
        )

    def bent_normals(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None = None,
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) w dw: where the open part of the sky lies, and how much there is.

        Under an open sky it is 2/3 n; zero where nothing is visible.

        Parameters
        ----------
        max_distance, falloff, spread, backfaces, ground
            See `silint.Limits`; with a spread it is over what an open cone has of (1/pi) n.w, sin^2(spread).

        Returns
        -------
        (n, 3) float64, or Result
        """
        limits = Limits(max_distance, falloff, spread, backfaces, ground)

        integrand = Integrand(
            (3,),
            lambda v: fractions.bent_normal(v.normals, (v.offsets, v.intervals), v.isolines),
            radial.bent_normal,
            arcs_ball.bent_normal,
            has_spread=True,
            exact_limits=EXACT_LIMITS["bent_normals"],
        )
        return self._integrate(
            integrand, points, normals, isolines, method, tolerance, full_output, progress, limits=limits
        )

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
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
    ) -> Any:
        """Visibility in spherical harmonics: what an environment's coefficients are to be multiplied with.

        The sum of products with the coefficients of an environment's radiance is the irradiance over pi
        that arrives from it ("cosine"). Conventions: `silint.sh`; axes are the world's.

        Parameters
        ----------
        max_degree : int
            L, 0 to 16.
        isolines : int, optional
            64 by default. Fewer than 2 L radial ones would alias: 2 L are taken then, and the diagnostics
            and `explain` say so. (Octahedral ones do not: their tables integrate the harmonics over strips.)
        weighting : {"cosine", "uniform"}
            (1/pi) int V max(n.w, 0) Y_lm dw, or int V Y_lm dw over the hemisphere of n.
        tolerance : float, optional
            Of the square root of the summed squares of all coefficients' errors, as is the estimate.
        max_distance, falloff, spread, backfaces, ground
            See `silint.Limits`; a spread below 90 is refused, as these are no fractions of a cone.

        Returns
        -------
        (n, (L + 1)^2) float64, or Result
        """
        choice(weighting, "weighting", WEIGHTINGS)
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        limits = Limits(max_distance, falloff, spread, backfaces, ground)
        integrand = Integrand(
            ((degree + 1) ** 2,),
            lambda v: octahedral_sh.sh_transfer(
                v.normals, (v.offsets, v.intervals), v.isolines, degree, weighting
            ),
            lambda v: radial_sh.sh_transfer(v, degree, weighting),
            lambda a: arcs_sh.sh_transfer(a, degree, weighting),
            min(octahedral_sh.most_isolines(degree, weighting), MAX_ISOLINES),
            max_degree=degree,
        )
        return self._integrate(
            integrand, points, normals, isolines, method, tolerance, full_output, progress, limits=limits
        )

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
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
    ) -> Any:
        """int L V max(n.w, 0) dw: what arrives from an environment, past the scene [NBMJ14 eq. 8].

        Parameters
        ----------
        environment : Environment
            Prepared once and kept.
        method : {"auto", "octahedral", "radial"}
            Radial isolines sum the map in cells; small bright sources are taken out of it, and a line of each
            point passes through the brightest, so that the edge of its shadow is exact. They are 2 to 4 times
            cheaper, and end at an error of about 5e-4: tables, and suns taken for discs. Octahedral isolines
            sum every texel, each in a strip of the sky 2 / isolines wide: where a sun is half hidden, few
            show as bands. "auto" takes radial ones for maps of 256 rows and more.
        tolerance : float, optional
            In units of irradiance, of the channel that needs it most.
        max_distance, falloff, spread, backfaces, ground
            See `silint.Limits`: what is too far away, or seen from its back, lets light through. A spread
            below 90 is refused.

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
        choice(method, "method", ("auto", "octahedral", "radial"))
        limits = Limits(max_distance, falloff, spread, backfaces, ground)
        if method == "auto" and not (environment.suits_radial or limits):
            method = "octahedral"
        octahedral = method == "octahedral"
        most = min(environment.most_isolines, MAX_ISOLINES) if octahedral else MAX_ISOLINES
        if tolerance is None:
            positive_int(64 if isolines is None else isolines, "isolines", 1, most)
        integrand = Integrand(
            (3,),
            lambda v: v._irradiance(environment),
            environment.radial_irradiance,
            None,
            most,
            aim=NO_AIM if octahedral else environment.aim,
        )
        return self._integrate(
            integrand, points, normals, isolines, method, tolerance, full_output, progress, limits=limits
        )

    def visibility(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None = None,
        method: str = "octahedral",
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """The visible regions themselves, to be integrated as often as wanted.

        Parameters
        ----------
        isolines : int, optional
            Octahedral ones, by default 64.
        method : {"auto", "octahedral", "exact"}
            Intervals on lines, which serve any function of direction, or the exact boundary as arcs.

        Returns
        -------
        Visibility, or VisibleArcs
            About 100 bytes an isoline and point; about 90 bytes an arc.

        Raises
        ------
        silint.InputError
            Among others for limits (`silint.Limits`), which are options of single integrals.
        """
        refuse_limits("visibility", limits, "or ask ambient_occlusion and its like, which know them")
        choice(method, "method", ("auto", "octahedral", "exact"))
        if method == "exact":
            return self._visible_arcs(points, normals, isolines, progress)
        lines = max(positive_int(64 if isolines is None else isolines, "isolines", 1, MAX_ISOLINES), 2)
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

    def _visible_arcs(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int | None,
        progress: Progress | None,
    ) -> VisibleArcs:
        if isolines is not None:
            raise InputError("isolines given with method='exact', which takes no lines: leave it out")
        p, n = self._finder.shade_points(points, normals)
        totals, groups = diagnose(None, 0, 0, 0), []
        for arcs, certain, counts, rows in self._finder.arcs(p, n, progress):
            groups.append((compact(arcs, self.scene.first_vertices), certain, rows))
            add_counts(totals, counts)
        return VisibleArcs(*join(len(p), groups), diagnostics=totals)

    # ------------------------------------------------------------------ what is built, and why

    @property
    def plan(self) -> Plan:
        """What the scene needs, whatever will be asked of it."""
        return scene_plan(self.scene, self._finder)

    def explain(
        self,
        request: str,
        isolines: int = 64,
        weighting: str | None = None,
        method: str = "auto",
        max_degree: int | None = None,
        environment: Environment | None = None,
        basis: Any = None,
        *,
        max_distance: float | str | None = None,
        falloff: str = "none",
        spread: float = 90.0,
        backfaces: str = "block",
        ground: npt.ArrayLike | None = None,
    ) -> Plan:
        """What a request builds and runs beyond the scene's plan, and what it leaves out.

        Parameters
        ----------
        request : str
            "ambient_occlusion", "sky_view_factor", "bent_normals", "sh_transfer", "irradiance", "visibility",
            "sh_lighting" or "integrate".
        isolines, weighting, method, max_degree, environment, basis
            As in the request, with its defaults.
        max_distance, falloff, spread, backfaces, ground
            See `silint.Limits`: as in the request, which is refused if it knows none.
        """
        choice(method, "method", METHODS)
        k = positive_int(isolines, "isolines", 1, MAX_ISOLINES)
        limits = Limits(max_distance, falloff, spread, backfaces, ground)
        return request_plan(
            self._finder, request, k, weighting, method, max_degree, environment, basis, limits
        )

    @property
    def memory(self) -> dict[str, int]:
        """Bytes of topology and hierarchies, by part."""
        return memory(self._finder)

    def _integrate(self, integrand: Integrand, *request: Any, limits: Limits = NO_LIMITS) -> Any:
        return evaluate(self._finder, integrand, *request, limits=limits)

    def __repr__(self) -> str:
        return f"<silint.SilhouetteIntegrator of {self.scene!r}>"
