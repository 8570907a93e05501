"""Queries of any function of direction: prefix tables along the octahedral isolines."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from silint import lighting
from silint.basis import Basis
from silint.environment import Environment
from silint.evaluate import MAX_ISOLINES, Integrand
from silint.finder import Progress
from silint.limits import refuse_limits
from silint.sh import MAX_DEGREE
from silint.validation import InputError, choice, positive_int
from silint.visibility import WEIGHTINGS, check_table

_INSTEAD_OF_LIMITS = "or ask for irradiance or sh_transfer, which know them"


class TabulatedQueries:
    """The part of `SilhouetteIntegrator` whose integrands have no closed form along a line.

    Limits (`silint.Limits`) are refused: they are options of radial lines.
    """

    def sh_lighting(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        environment: Environment,
        max_degree: int = 2,
        isolines: int | None = None,
        weighting: str = "uniform",
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """The light that arrives past the scene, in spherical harmonics [NBMJ14 4].

        Masked before it is projected, so that no frequency of a shadow is lost to what a few coefficients can
        hold: with "uniform" weighting those of degree 1 are vector irradiance, and sqrt(4 pi / 3) times their
        product with (n_y, n_z, n_x) is irradiance itself [NBMJ14 A]; with "cosine" weighting pi sqrt(4 pi)
        times that of degree 0 is. Glossy lobes take more degrees, by the lobe's bandwidth [RH02].
        Conventions: `silint.sh`; axes are the world's.

        Parameters
        ----------
        environment : Environment
            Tabulated once for a number of isolines and a degree, and kept; one table serves all normals.
        max_degree : int
            L, 0 to 16.
        weighting : {"uniform", "cosine"}
            int L V Y_lm dw over the hemisphere of n, or (1/pi) int L V max(n.w, 0) Y_lm dw. A constant
            environment gives its radiance times `sh_transfer`.
        method : {"auto", "octahedral"}
            Light from any direction has no closed form along radial isolines.
        tolerance : float, optional
            Of the square root of the summed squares of all coefficients' errors, of the channel that needs it
            most.

        Returns
        -------
        (n, (L + 1)^2, 3) float64, or Result
            In units of radiance times steradians ("uniform") or of radiance ("cosine").
        """
        refuse_limits("sh_lighting", limits, _INSTEAD_OF_LIMITS)
        choice(weighting, "weighting", WEIGHTINGS)
        choice(method, "method", ("auto", "octahedral"))
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        light = lighting.require_environment(environment)
        most = min(lighting.most_isolines(light, degree, weighting), MAX_ISOLINES)
        if tolerance is None:
            check_table(
                positive_int(64 if isolines is None else isolines, "isolines", 1, MAX_ISOLINES), most, ""
            )

        integrand = Integrand(
            ((degree + 1) ** 2, 3),
            lambda v: lighting.sh_lighting(v.normals, v._visible, v.isolines, light, degree, weighting),
            None,
            None,
            most,
        )
        return self._integrate(
            integrand, points, normals, isolines, "octahedral", tolerance, full_output, progress
        )

    def integrate(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        basis: Any,
        isolines: int | None = None,
        weighting: str = "uniform",
        method: str = "auto",
        tolerance: float | None = None,
        full_output: bool = False,
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """Integrals of any functions of direction over what each point sees.

        Parameters
        ----------
        basis : callable, array_like (H, 2 H) or (H, 2 H, C), or PrefixTable
            A function of unit directions (m, 3) with values (m, C) or (m,), smooth at the scale of a cell:
            2 / isolines across the isolines, 1 / 256 of a quarter turn along them. Or an equirectangular
            table of any sign in the frame of the scene, +y up (`silint.Environment` says how it lies),
            whose texels count whole. Or what `prefix_table` returned, for its number of isolines.
        weighting : {"uniform", "cosine"}
            int V f dw over the hemisphere of n, or (1/pi) int V max(n.w, 0) f dw.
        method : {"auto", "octahedral"}
        tolerance : float, optional
            Of the square root of the summed squares of all functions' errors. Tabulates f again for every
            number of isolines that is tried.

        Returns
        -------
        (n, C) float64, or Result
            Of an open hemisphere K lines miss some K ** -2, which is given back in `sh_transfer` but cannot
            be for functions that nothing is known of.

        Raises
        ------
        silint.InputError
            In one line: f fails, or returns NaN or another shape.

        Examples
        --------
        Four spherical Gaussians, and the Phong lobe of an exponent about a direction of reflection:

        >>> import numpy as np, silint
        >>> scene = silint.Scene([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]])
        >>> sil = silint.SilhouetteIntegrator(scene)
        >>> axes = np.array([[1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) / np.sqrt(3.0)
        >>> gaussians = sil.integrate(
        ...     [[0, 0, 0]], [[0, 0, 1]], lambda w: np.exp(8.0 * (w @ axes.T - 1.0)), weighting="cosine"
        ... )
        >>> gaussians.shape
        (1, 4)
        >>> reflected = np.array([0.6, 0.0, 0.8])
        >>> lobe = sil.integrate([[0, 0, 0]], [[0, 0, 1]], lambda w: np.maximum(w @ reflected, 0.0) ** 20)
        >>> bool(0.0 < lobe[0, 0] < 2.0 * np.pi / 21)
        True
        """
        refuse_limits("integrate", limits, _INSTEAD_OF_LIMITS)
        choice(weighting, "weighting", WEIGHTINGS)
        choice(method, "method", ("auto", "octahedral"))
        functions = Basis(basis, weighting)
        if functions.isolines is not None and tolerance is not None:
            raise InputError(
                "tolerance needs tables for other isolines; pass the function, not a PrefixTable"
            )
        if tolerance is None:
            isolines = (functions.isolines or 64) if isolines is None else isolines
            functions.check(max(positive_int(isolines, "isolines", 1, MAX_ISOLINES), 2))
        integrand = Integrand(
            (functions.channels,),
            lambda v: functions.integrate(v.normals, v._visible, v.isolines),
            None,
            None,
            min(functions.most_isolines, MAX_ISOLINES),
            prepare=functions.table if functions.is_function else None,
        )
        return self._integrate(
            integrand, points, normals, isolines, "octahedral", tolerance, full_output, progress
        )

    def _integrate(self, integrand: Integrand, *request: Any) -> Any:
        raise NotImplementedError
