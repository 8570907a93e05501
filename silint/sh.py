"""Spherical harmonics as silint uses them: evaluate, project, rotate, convolve, window, convert.

Convention
    Real and orthonormal over the sphere: int Y_lm Y_l'm' dw is 1 for equal indices and 0 for others. No
    Condon-Shortley phase: degree 1 is (y, z, x) times sqrt(3 / 4 pi). Coefficient (l, m) stands at index
    l (l + 1) + m; a maximum degree L makes (L + 1)^2 coefficients.

Arrays
    Coefficients are arrays of any shape whose axis `axis` has length (L + 1)^2, by default the last:
    (n, (L + 1)^2) of n points, or with ``axis=-2`` (n, (L + 1)^2, 3) of n points in three channels. Results
    have the same shape.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.core import sh_rotation
from silint.core.jit import KERNEL_LOCK
from silint.core.sh import degrees, harmonics, hemisphere_zonal, sphere_rule
from silint.validation import (
    InputError,
    choice,
    normals_array,
    points_array,
    positive_int,
    positive_number,
    rotation_matrix,
)

__all__ = [
    "CONVENTIONS",
    "MAX_DEGREE",
    "convert",
    "convolve",
    "cosine_lobe",
    "evaluate",
    "max_degree_of",
    "project",
    "project_samples",
    "rotate",
    "rotation_blocks",
    "window",
]

FloatArray = npt.NDArray[np.float64]
Rotation = npt.ArrayLike | tuple[npt.ArrayLike, float]

MAX_DEGREE = 16
"""Highest degree that is offered: 289 coefficients."""

CONVENTIONS = ("silint", "condon-shortley")


def evaluate(directions: npt.ArrayLike, max_degree: int) -> FloatArray:
    """All Y_lm of directions.

    Parameters
    ----------
    directions : array_like, shape (n, 3)
        Of any length but zero.
    max_degree : int
        0 to 16.

    Returns
    -------
    (n, (L + 1)^2) float64
    """
    degree = _degree(max_degree)
    rows, _ = points_array(directions, "directions")
    return _harmonics(normals_array(rows, len(rows), "directions"), degree)


def project(
    function: Callable[[FloatArray], Any], max_degree: int, exact_degree: int | None = None
) -> FloatArray:
    """Coefficients int f Y_lm dw of a function over the sphere, by quadrature.

    Parameters
    ----------
    function : callable
        Unit directions (m, 3) -> values (m,) or (m, C).
    max_degree : int
        L, 0 to 16.
    exact_degree : int, optional
        The rule integrates polynomials up to this degree: exact for an f that is one of degree
        ``exact_degree - max_degree``. By default 2 L + 64; what jumps needs more. It calls f in
        (exact_degree + 1) (exact_degree / 2 + 1) directions.

    Returns
    -------
    ((L + 1)^2,) or ((L + 1)^2, C) float64
    """
    degree = _degree(max_degree)
    exact = 2 * degree + 64 if exact_degree is None else exact_degree
    exact = positive_int(exact, "exact_degree", 2 * degree, 4096)
    directions, weights = sphere_rule(exact)
    values = _sample_values(function(directions), len(directions), "function returned values; they")
    return _weighted_sum(_harmonics(directions, degree), weights, values)


def project_samples(
    directions: npt.ArrayLike,
    values: npt.ArrayLike,
    max_degree: int,
    weights: npt.ArrayLike | None = None,
) -> FloatArray:
    """Coefficients of a function that is known in some directions.

    Parameters
    ----------
    directions : array_like, shape (n, 3)
        Of any length but zero.
    values : array_like, shape (n,) or (n, C)
    max_degree : int
        L, 0 to 16.
    weights : array_like, shape (n,), optional
        Solid angles, which sum to 4 pi where the samples cover the sphere: sum w f Y_lm. By default the
        coefficients are fitted by least squares, which asks for (L + 1)^2 samples at least, well spread.

    Returns
    -------
    ((L + 1)^2,) or ((L + 1)^2, C) float64
    """
    degree = _degree(max_degree)
    rows, _ = points_array(directions, "directions")
    basis = _harmonics(normals_array(rows, len(rows), "directions"), degree)
    known = _sample_values(values, len(rows), "values")
    if weights is not None:
        solid_angle = _real(weights, "weights")
        if solid_angle.shape != (len(rows),):
            raise InputError(
                f"weights has shape {solid_angle.shape}; expected one for each of {len(rows)} directions"
            )
        return _weighted_sum(basis, solid_angle, known)
    fitted, _, rank, _ = np.linalg.lstsq(basis, known, rcond=None)
    if rank < basis.shape[1]:
        raise InputError(
            f"directions determine {rank} of the {basis.shape[1]} coefficients of degree {degree}; "
            "pass more of them, better spread, or a lower max_degree"
        )
    return np.asarray(fitted, dtype=np.float64)


def rotate(coefficients: npt.ArrayLike, rotation: Rotation, axis: int = -1) -> FloatArray:
    """Coefficients of the rotated function: f(R^-1 w), which carries what f has at w to R w.

    Parameters
    ----------
    coefficients : array_like
        See the module.
    rotation : array_like, shape (3, 3), or tuple (axis, degrees)
        R, orthonormal with determinant +1, or a turn counter-clockwise about an axis.
    axis : int

    Returns
    -------
    ndarray of float64, same shape
    """
    moved, degree = _last(coefficients, axis)
    rows = moved.reshape(-1, moved.shape[-1]).copy()
    turn = np.ascontiguousarray(rotation_matrix(rotation, "rotation"))
    with KERNEL_LOCK:
        sh_rotation.rotate_many(turn, degree + 1, *sh_rotation.exchange(degree), rows)
    return np.moveaxis(rows.reshape(moved.shape), -1, axis)


def rotation_blocks(rotation: Rotation, max_degree: int) -> list[FloatArray]:
    """What `rotate` does, as matrices: a rotation mixes only coefficients of one degree.

    Parameters
    ----------
    rotation : array_like, shape (3, 3), or tuple (axis, degrees)
        As for `rotate`.
    max_degree : int
        L, 0 to 16.

    Returns
    -------
    list of (2 l + 1, 2 l + 1) float64, for l = 0 .. L
        Orthogonal; the new coefficients of a degree are its matrix times the old ones.
    """
    turn = np.ascontiguousarray(rotation_matrix(rotation, "rotation"))
    degree = _degree(max_degree)
    with KERNEL_LOCK:
        return sh_rotation.rotation_blocks(turn, degree)


def convolve(coefficients: npt.ArrayLike, zonal: npt.ArrayLike, axis: int = -1) -> FloatArray:
    """Coefficients of n -> int f(w) h(n.w) dw, for a function h of the angle alone.

    Parameters
    ----------
    coefficients : array_like
        See the module.
    zonal : array_like, shape (L + 1,) or longer
        A_l = 2 pi int h(z) P_l(z) dz by degree [RH01], as from `cosine_lobe`.
    axis : int

    Returns
    -------
    ndarray of float64, same shape
    """
    moved, degree = _last(coefficients, axis)
    factors = _real(zonal, "zonal")
    if factors.ndim != 1 or len(factors) <= degree:
        raise InputError(
            f"zonal has shape {factors.shape}; expected {degree + 1} numbers, one a degree from 0 to {degree}"
        )
    return np.moveaxis(moved * factors[degrees(degree)], -1, axis)


def cosine_lobe(max_degree: int) -> FloatArray:
    """A_l of max(n.w, 0) for `convolve`: pi, 2 pi / 3, pi / 4, 0, ...; radiance becomes irradiance [RH01].

    Returns
    -------
    (L + 1,) float64
    """
    return np.pi * hemisphere_zonal(_degree(max_degree), "cosine")


def window(coefficients: npt.ArrayLike, kind: str, width: float, axis: int = -1) -> FloatArray:
    """Fade out high degrees, against ringing [Slo08].

    Parameters
    ----------
    coefficients : array_like
        See the module.
    kind : {"lanczos", "hanning"}
        sin(pi l / w) / (pi l / w), or (1 + cos(pi l / w)) / 2.
    width : float
        w, the degree from which on nothing is left; larger is weaker. L + 1 touches every degree and
        removes none.
    axis : int

    Returns
    -------
    ndarray of float64, same shape
    """
    choice(kind, "kind", ("lanczos", "hanning"))
    cut = positive_number(width, "width")
    moved, degree = _last(coefficients, axis)
    x = np.minimum(np.arange(degree + 1) / cut, 1.0)
    factors = np.sinc(x) if kind == "lanczos" else 0.5 * (1.0 + np.cos(np.pi * x))
    factors[x >= 1.0] = 0.0
    return np.moveaxis(moved * factors[degrees(degree)], -1, axis)


def convert(coefficients: npt.ArrayLike, source: str, target: str, axis: int = -1) -> FloatArray:
    """Coefficients from one convention to another.

    Parameters
    ----------
    coefficients : array_like
        See the module; order l (l + 1) + m in either.
    source, target : {"silint", "condon-shortley"}
        "condon-shortley" multiplies odd m by -1: DirectX's SHMath and PRT, and real harmonics made of
        SciPy's: sqrt(2) Im Y_l^|m| for m < 0, Y_l^0, and sqrt(2) Re Y_l^m for m > 0. "silint" is that of
        three.js.
    axis : int

    Returns
    -------
    ndarray of float64, same shape
    """
    choice(source, "source", CONVENTIONS)
    choice(target, "target", CONVENTIONS)
    moved, degree = _last(coefficients, axis)
    # The sign is its own inverse: both directions are the same, and nothing happens from one to itself.
    l = degrees(degree)  # noqa: E741
    m = np.arange(len(l)) - l * (l + 1)
    sign = np.where(m % 2 == 1, -1.0, 1.0) if source != target else np.ones(len(l))
    return np.moveaxis(moved * sign, -1, axis)


def max_degree_of(coefficients: npt.ArrayLike, axis: int = -1) -> int:
    """L of an array of coefficients, from the length (L + 1)^2 of its axis."""
    return _last(coefficients, axis)[1]


def _harmonics(directions: FloatArray, degree: int) -> FloatArray:
    with KERNEL_LOCK:
        return harmonics(directions, degree)


# ------------------------------------------------------------------------------------------------ checking


def _degree(max_degree: Any) -> int:
    return positive_int(max_degree, "max_degree", 0, MAX_DEGREE)


def _real(data: Any, name: str) -> FloatArray:
    """Finite real numbers of any shape."""
    try:
        array = np.asarray(data)
    except (ValueError, TypeError):  # ragged rows
        raise InputError(f"{name} is not a rectangular array of numbers") from None
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} has dtype {array.dtype}; expected real numbers")
    out = array.astype(np.float64)
    if not np.isfinite(out).all():
        raise InputError(f"{name} must be finite; {int((~np.isfinite(out)).sum())} of its numbers are not")
    return out


def _last(coefficients: npt.ArrayLike, axis: int) -> tuple[FloatArray, int]:
    """Coefficients with their axis moved to the end, and their maximum degree."""
    array = _real(coefficients, "coefficients")
    if isinstance(axis, bool) or not isinstance(axis, int) or not -array.ndim <= axis < array.ndim:
        raise InputError(f"axis is {axis!r}; expected one of the {array.ndim} axes of coefficients")
    length = array.shape[axis]
    degree = math.isqrt(length) - 1
    if length == 0 or (degree + 1) ** 2 != length:
        raise InputError(
            f"coefficients has length {length} on axis {axis}; expected a square, (max_degree + 1)^2"
        )
    if degree > MAX_DEGREE:
        raise InputError(
            f"coefficients has length {length} on axis {axis}, degree {degree}; degrees go to {MAX_DEGREE}"
        )
    return np.moveaxis(array, axis, -1), degree


def _sample_values(values: Any, n: int, name: str) -> FloatArray:
    array = _real(values, name)
    if array.ndim not in (1, 2) or len(array) != n:
        raise InputError(
            f"{name} have shape {array.shape}; expected ({n},) or ({n}, C), a row for each direction"
        )
    return array


def _weighted_sum(basis: FloatArray, weights: FloatArray, values: FloatArray) -> FloatArray:
    weighted = (values.T * weights).T
    total: FloatArray = basis.T @ weighted
    return total
