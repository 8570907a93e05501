"""Queries of an integrator for exact derivatives."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from silint import gradients
from silint.finder import Progress, VisibleFinder
from silint.limits import refuse_limits

__all__ = ["DerivativeQueries"]

_INSTEAD_OF_LIMITS = "or take differences of ambient_occlusion, which knows them"


class DerivativeQueries:
    """The part of `SilhouetteIntegrator` that differentiates.

    What counts is the whole scene: `silint.Limits` may be given as keywords with their defaults alone, and
    are refused otherwise.
    """

    _finder: VisibleFinder

    def ambient_occlusion_gradient(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        weighting: str = "cosine",
        full_output: bool = False,
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """Exact ambient occlusion, and its derivatives by the points and their normals (docs/exact.md).

        Returns
        -------
        Gradient
            ``value`` (n,), ``points`` (n, 3) per unit of length, ``normals`` (n, 3) of the normals as passed.
            NaN at ``uncertified_points``. With `full_output` a tuple of it and the diagnostics.
        """
        refuse_limits("ambient_occlusion_gradient", limits, _INSTEAD_OF_LIMITS)
        return self.gradient(points, normals, "ambient_occlusion", weighting, 4, full_output, progress)

    def gradient(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        quantity: str = "ambient_occlusion",
        weighting: str = "cosine",
        max_degree: int = 4,
        full_output: bool = False,
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """The same for any quantity that has derivatives: their components come last, (n, C) and (n, 3, C).

        Parameters
        ----------
        quantity : {"ambient_occlusion", "bent_normals", "sh_transfer", "vector_irradiance"}
            The last is int V w dw over the hemisphere of n.
        weighting : {"cosine", "uniform"}
            Of ambient occlusion and SH transfer.
        max_degree : int
            Of SH transfer.
        """
        refuse_limits("gradient", limits, _INSTEAD_OF_LIMITS)
        what = gradients.integrand(quantity, weighting, max_degree)
        found = gradients.gradient(self._finder, what, points, normals, progress)
        return found if full_output else found[0]

    def pullback(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        cotangents: npt.ArrayLike,
        quantity: str = "ambient_occlusion",
        weighting: str = "cosine",
        max_degree: int = 4,
        full_output: bool = False,
        progress: Progress | None = None,
        **limits: Any,
    ) -> Any:
        """Derivative of sum(cotangents * value) by the file's vertices, exactly (docs/exact.md).

        For a loss of the values, cotangents are its derivatives by each of them; this is the vector-Jacobian
        product of reverse differentiation.

        Parameters
        ----------
        cotangents : array_like
            Shaped as the values: (n,) or (n, C).
        quantity, weighting, max_degree
            As in `gradient`.

        Returns
        -------
        (V, 3) float64
            A corner that k of the file's vertices share has its derivative divided among them: what moves
            them together gets the true derivative from the sum. With `full_output` a tuple of it and the
            diagnostics.
        """
        refuse_limits("pullback", limits, _INSTEAD_OF_LIMITS)
        what = gradients.integrand(quantity, weighting, max_degree)
        found = gradients.pullback(self._finder, what, points, normals, cotangents, progress)
        return found if full_output else found[0]
