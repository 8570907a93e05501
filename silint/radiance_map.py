"""Arrays that hold an equirectangular map: their shape, and what in them is no radiance."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

__all__ = ["MOST_ROWS", "Texels", "clamped_radiance", "map_array"]

FloatArray = npt.NDArray[np.float64]
MOST_ROWS = 1 << 15


class Texels(NamedTuple):
    """A map as a list of small lights."""

    directions: FloatArray
    """(m, 3) unit, to the centres of the texels, in the frame of the scene."""
    radiance: FloatArray
    """(m, C)."""
    solid_angle: FloatArray
    """(m,) exact, in steradians; they sum to 4 pi."""


def map_array(data: npt.ArrayLike, argument: str) -> npt.NDArray[Any]:
    """`data` as a new (H, 2 H, 1 or 3) array of float32 or float64."""
    expected = "expected (H, 2 H, 3) or (H, 2 H)"
    try:
        array = np.asarray(data)
    except (ValueError, TypeError):  # ragged rows
        raise InputError(f"{argument} is not a rectangular array of numbers; {expected}") from None
    if array.dtype.kind not in "iuf":
        raise InputError(f"{argument} has dtype {array.dtype}; expected real numbers, (H, 2 H, 3)")
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.size == 0:
        raise InputError(f"{argument} has shape {np.shape(data)}; {expected}")
    height, width, channels = array.shape
    if channels not in (1, 3):
        hint = "; leave alpha out" if channels in (2, 4) else ""
        raise InputError(f"{argument} has {channels} channels, shape {array.shape}; {expected}{hint}")
    if width != 2 * height:
        raise InputError(
            f"{argument} is {width} x {height} texels; expected an equirectangular map, twice as wide as high"
        )
    if height > MOST_ROWS:
        raise InputError(f"{argument} has {height} rows; at most {MOST_ROWS} are supported")
    small = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    with np.errstate(over="ignore"):  # long double beyond the range becomes inf
        return np.array(array, dtype=np.float32 if small else np.float64, order="C")


def clamped_radiance(texels: npt.NDArray[Any], argument: str) -> tuple[npt.NDArray[Any], int]:
    """Make all radiances finite and not negative, in place; also how many texels that changed."""
    too_small = ~(texels >= 0.0)
    infinite = texels == np.inf
    clamped = int((too_small | infinite).any(axis=2).sum())
    texels[too_small] = 0.0
    texels[infinite] = 0.0
    largest = texels.max()
    if largest == 0.0:
        raise InputError(f"{argument} has no texel with a finite radiance above 0; expected some light")
    texels[infinite] = largest
    return texels, clamped
