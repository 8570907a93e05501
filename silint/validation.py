"""Array-likes to the exact dtype and layout that the kernels trust, or one line that says what is wrong.

Everything that a user hands to silint passes here once, at the boundary; nothing below checks again.
Each message names the argument, what it was, and what was expected, in a single line, so that the
command line can print it as it stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt

__all__ = [
    "InputError",
    "choice",
    "colour",
    "finite_array",
    "finite_number",
    "mesh_arrays",
    "normal_rows",
    "normals_array",
    "points_array",
    "positive_int",
    "positive_number",
    "rotation_about",
    "rotation_matrix",
    "row_numbers",
    "unit_vector",
]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

# Half-edge numbers (3 f + k) and vertex numbers are int32 in the kernels, which halves the traffic of a
# traversal, so both 3 F and V must stay below 2^31.
MAX_VERTICES = 2**31 - 1
MAX_FACES = (2**31 - 1) // 3

# How far from a rotation a matrix may be: what rounding to float32 and chains of products leave.
_ROTATION_ERROR = 1e-5

# How many offending rows a message lists before it says "...".
_ROWS_SHOWN = 5


class InputError(ValueError):
    """Something that the caller passed cannot be used; the message is one line that says what and why."""


def points_array(points: npt.ArrayLike, name: str = "points") -> tuple[FloatArray, bool]:
    """Positions as the kernels want them.

    Parameters
    ----------
    points : array_like, shape (n, 3)
        Finite real numbers of any dtype and layout; n = 0 is allowed. A bare ``(3,)`` is refused, because
        ``[[x, y, z]]`` costs its writer two characters and leaves no doubt about the shape of the result.
    name : str
        What error messages call the argument.

    Returns
    -------
    points : ndarray of float64, shape (n, 3), C-contiguous
        The caller's own array where it already is one; it is never written to.
    came_as_float32 : bool
        Whether the values carry float32 precision or less (float32, float16), which sets how far a
        shade point is lifted off its surface. Integers and lists are exact: False.

    Raises
    ------
    InputError
        Not numbers, not (n, 3), or rows with NaN or infinity, which are listed.
    """
    array = _rows_of_three(points, name)
    came_as_float32 = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    out = _as_float64(array)
    _require_finite_rows(out, name)
    return out, came_as_float32


def normals_array(normals: npt.ArrayLike, n: int, name: str = "normals", first_row: int = 0) -> FloatArray:
    """Unit normals, one for each of `n` points.

    Parameters
    ----------
    normals : array_like, shape (n, 3)
        Any lengths but zero, from the smallest subnormal to the largest double.
    n : int
        The number of points that they belong to.
    name : str
        What error messages call the argument.
    first_row : int
        What error messages call the first row.

    Returns
    -------
    ndarray of float64, shape (n, 3), C-contiguous
        Of length 1 to rounding. Scaling a row by a power of two does not change a bit of it.

    Raises
    ------
    InputError
        Wrong shape, or rows that are zero or not finite, which are listed.
    """
    out = _as_float64(normal_rows(normals, n, name))
    _require_finite_rows(out, name, first_row)
    zero = np.flatnonzero(~out.any(axis=1))
    if zero.size:
        raise InputError(f"{name} must not be zero; {_rows_text(zero + first_row)}")
    return _normalised(out)


def normal_rows(normals: npt.ArrayLike, n: int, name: str = "normals") -> npt.NDArray[Any]:
    """The rows of `normals_array` as they are: shape and dtype are checked, values are not."""
    array = _rows_of_three(normals, name)
    if array.shape[0] != n:
        raise InputError(
            f"{name} has {array.shape[0]} rows, but there are {n} points; pass one normal for each point"
        )
    return array


def unit_vector(v: npt.ArrayLike, name: str) -> FloatArray:
    """One direction of unit length.

    Parameters
    ----------
    v : array_like, shape (3,)
        Finite and not zero; its length does not matter.
    name : str
        What error messages call the argument.

    Returns
    -------
    ndarray of float64, shape (3,)

    Raises
    ------
    InputError
        Wrong shape, not numbers, zero, or not finite.
    """
    array = _numeric(v, name, "three numbers")
    if array.shape != (3,):
        raise InputError(f"{name} has shape {array.shape}; expected three numbers, shape (3,)")
    out = _as_float64(array)
    if not np.isfinite(out).all() or not out.any():
        raise InputError(f"{name} is {_short(out.tolist())}; expected a finite direction that is not zero")
    return cast(FloatArray, _normalised(out[None, :])[0])


def mesh_arrays(vertices: npt.ArrayLike, faces: npt.ArrayLike) -> tuple[FloatArray, IntArray, bool]:
    """A triangle mesh as the kernels want it.

    Only what makes a mesh meaningless is refused. Open borders, fans of many faces on an edge, mixed
    winding, duplicate and zero-area faces, vertices that no face uses: all of these are meshes, and are
    counted by the scene instead.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
        Finite positions, V >= 1.
    faces : array_like of int, shape (F, 3)
        Rows of `vertices`, F >= 1. Floats that are whole numbers are not taken for indices.

    Returns
    -------
    vertices : ndarray of float64, shape (V, 3), C-contiguous
    faces : ndarray of int32, shape (F, 3), C-contiguous
    came_as_float32 : bool
        See `points_array`.

    Raises
    ------
    InputError
        Empty, wrong shapes, NaN or infinite vertices, indices that are not integers or out of range, or
        more than 2^31 vertices or face corners.
    """
    positions = _rows_of_three(vertices, "vertices")
    if positions.shape[0] == 0:
        raise InputError("vertices is empty; a scene needs at least one triangle")
    triangles = _numeric(faces, "faces", "integer vertex indices, shape (F, 3)")
    if triangles.size == 0:
        raise InputError("faces is empty; a scene needs at least one triangle")
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        hint = "; split polygons into triangles" if triangles.ndim == 2 and triangles.shape[1] > 3 else ""
        raise InputError(
            f"faces has shape {triangles.shape}; expected (F, 3), three vertex indices a triangle{hint}"
        )
    if triangles.dtype.kind not in "iu":
        raise InputError(f"faces has dtype {triangles.dtype}; expected integer vertex indices, shape (F, 3)")
    if positions.shape[0] > MAX_VERTICES:
        raise InputError(
            f"vertices has {positions.shape[0]} rows; at most {MAX_VERTICES} fit the 32-bit indices"
        )
    if triangles.shape[0] > MAX_FACES:
        raise InputError(
            f"faces has {triangles.shape[0]} rows; at most {MAX_FACES} fit the 32-bit edge numbers"
        )

    came_as_float32 = positions.dtype.kind == "f" and positions.dtype.itemsize <= 4
    out = _as_float64(positions)
    _require_finite_rows(out, "vertices")

    outside = (triangles < 0) | (triangles >= out.shape[0])
    if outside.any():
        rows = np.flatnonzero(outside.any(axis=1))
        first = [int(i) for i in triangles[rows[0]]]
        raise InputError(
            f"faces has indices outside 0..{out.shape[0] - 1} (there are {out.shape[0]} vertices); "
            f"{_rows_text(rows)}, the first of them {first}"
        )
    return out, np.ascontiguousarray(triangles, dtype=np.int32), came_as_float32


def row_numbers(values: npt.ArrayLike, name: str, n: int, rows: int) -> IntArray:
    """Whole numbers from 0 to below `rows`, shape (n,), as int32."""
    array = _numeric(values, name, f"integers, shape ({n},)")
    if array.dtype.kind not in "iu" or array.shape != (n,):
        raise InputError(f"{name} is {array.dtype} of shape {array.shape}; expected integers, shape ({n},)")
    if n and not (0 <= array.min() and array.max() < rows):
        raise InputError(f"{name} has values outside 0..{rows - 1}: {array.min()} to {array.max()}")
    return np.ascontiguousarray(array, dtype=np.int32)


def positive_int(value: Any, name: str, minimum: int = 1, maximum: int | None = None) -> int:
    """A whole number in [minimum, maximum].

    Parameters
    ----------
    value : int
        Python or NumPy integer. A bool is not a number here, and 64.0 is not an integer: both are far
        more often a mistake than meant.
    name : str
        What error messages call the argument.
    minimum, maximum : int
        Inclusive bounds; no upper one if `maximum` is None.

    Returns
    -------
    int

    Raises
    ------
    InputError
        Not an integer, or outside the bounds.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    expected = f"at least {minimum}" if maximum is None else f"{minimum} to {maximum}"
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise InputError(f"{name} is {_short(value)}; expected an integer, {expected}")
    number = int(value)
    if number < minimum or (maximum is not None and number > maximum):
        raise InputError(f"{name} is {number}; expected an integer, {expected}")
    return number


def positive_number(value: Any, name: str) -> float:
    """A finite number above 0, or one line that says what it was."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is {_short(value)}; expected a number above 0") from None
    if isinstance(value, bool | np.bool_) or not 0.0 < number < float("inf"):
        raise InputError(f"{name} is {_short(value)}; expected a finite number above 0")
    return number


def finite_number(value: Any, name: str) -> float:
    """A finite number, or one line that says what it was."""
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, bool | np.bool_) or not math.isfinite(number):
        raise InputError(f"{name} is {_short(value)}; expected a finite number")
    return number


def colour(value: npt.ArrayLike, name: str) -> FloatArray:
    """Red, green and blue (3,), finite and not negative, from one number or three."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (ValueError, TypeError):
        array = np.empty(0)
    if array.shape not in ((), (1,), (3,)) or not (np.isfinite(array) & (array >= 0.0)).all():
        raise InputError(f"{name} is {_short(value)}; expected one number or three, finite, none below 0")
    return np.array(np.broadcast_to(array, (3,)))


def rotation_matrix(value: Any, name: str) -> FloatArray:
    """A rotation from its matrix, or from a tuple (axis, degrees).

    Parameters
    ----------
    value : (3, 3) array_like, or tuple of (3,) array_like and float
        A matrix may be off by the rounding of float32: the nearest rotation is taken.
    name : str
        What error messages call the argument.

    Returns
    -------
    ndarray of float64, shape (3, 3)

    Raises
    ------
    InputError
        Another shape, not orthonormal, or a reflection.
    """
    if isinstance(value, tuple) and len(value) == 2:
        return rotation_about(unit_vector(value[0], f"{name} axis"), finite_number(value[1], f"{name} angle"))
    expected = "a (3, 3) matrix, or (axis, degrees)"
    array = _numeric(value, name, expected)
    if array.shape != (3, 3):
        raise InputError(f"{name} has shape {array.shape}; expected {expected}")
    matrix = _as_float64(array)
    if not np.isfinite(matrix).all() or np.abs(matrix @ matrix.T - np.eye(3)).max() > _ROTATION_ERROR:
        raise InputError(f"{name} is not orthonormal; expected the matrix of a rotation")
    if np.linalg.det(matrix) < 0.0:
        raise InputError(f"{name} is a reflection, of determinant -1; expected the matrix of a rotation")
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def rotation_about(axis: FloatArray, degrees: float) -> FloatArray:
    """Matrix (3, 3) of a turn counter-clockwise about a unit axis [Rodrigues]; exact for quarter turns."""
    s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    if degrees % 90.0 == 0.0:
        s, c = float(round(s)), float(round(c))
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return c * np.eye(3) + s * cross + (1.0 - c) * np.outer(axis, axis)


def choice(value: Any, name: str, allowed: Sequence[str]) -> str:
    """One of a few words.

    Parameters
    ----------
    value : str
    name : str
        What error messages call the argument.
    allowed : sequence of str
        In the order in which the message lists them.

    Returns
    -------
    str

    Raises
    ------
    InputError
        Anything else.
    """
    if not isinstance(value, str) or value not in allowed:
        words = ", ".join(repr(word) for word in allowed)
        raise InputError(f"{name} is {_short(value)}; expected one of {words}")
    return value


def finite_array(
    data: npt.ArrayLike, name: str, shapes: Sequence[tuple[int, ...]], meaning: str
) -> FloatArray:
    """Finite real numbers of one of a few shapes, in one dimension or two.

    Parameters
    ----------
    data : array_like
        Of any real dtype and layout.
    name : str
        What error messages call the argument.
    shapes : sequence of tuples of int
        Those that are allowed.
    meaning : str
        What rows and columns are, for error messages.

    Returns
    -------
    ndarray of float64, C-contiguous
        The caller's own array where it already is one.

    Raises
    ------
    InputError
        Not numbers, another shape, or NaN or infinity, whose rows are listed.
    """
    expected = f"{' or '.join(str(shape) for shape in shapes)}: {meaning}"
    array = _numeric(data, name, expected)
    if array.shape not in shapes:
        raise InputError(f"{name} has shape {array.shape}; expected {expected}")
    out = _as_float64(array)
    _require_finite_rows(out if out.ndim == 2 else out[:, None], name)
    return out


def _numeric(data: npt.ArrayLike, name: str, expected: str) -> npt.NDArray[Any]:
    """`data` as an array of real numbers of whatever dtype, or an InputError."""
    try:
        array = np.asarray(data)
    except (ValueError, TypeError):  # ragged rows
        raise InputError(f"{name} is not a rectangular array of numbers; expected {expected}") from None
    if array.dtype.kind not in "iuf":
        # An empty list becomes float64 by itself; bool, complex, str and object are never coordinates.
        kind = "complex numbers" if array.dtype.kind == "c" else f"dtype {array.dtype}"
        raise InputError(f"{name} has {kind}, shape {array.shape}; expected real numbers: {expected}")
    return array


def _rows_of_three(data: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    array = _numeric(data, name, "shape (n, 3)")
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim == 1 and array.shape == (3,):
        raise InputError(f"{name} has shape (3,); expected (n, 3): write [[x, y, z]] for a single row")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name} has shape {array.shape}; expected (n, 3)")
    return array


def _as_float64(array: npt.NDArray[Any]) -> FloatArray:
    """C-contiguous, aligned, native float64: the one layout that the kernels are compiled for."""
    # Long doubles beyond the range become inf, signalling NaNs quiet ones, and both are refused as such.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.require(array, dtype=np.float64, requirements=["C", "A"])


def _require_finite_rows(array: FloatArray, name: str, first_row: int = 0) -> None:
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise InputError(f"{name} must be finite; NaN or infinity in {_rows_text(bad + first_row)}")


def _normalised(vectors: FloatArray) -> FloatArray:
    """Rows of finite, non-zero `vectors` at unit length, without overflow or underflow.

    Each row is first scaled by the power of two of its largest component, which is exact, so that squares
    neither overflow nor vanish: rows of 1e300 and of 1e-320 come out as those of 1.
    """
    largest = np.abs(vectors).max(axis=1)
    _, exponent = np.frexp(largest)
    # In two steps: 2^1074, which lifts the smallest subnormal, is itself beyond a double.
    half = -exponent // 2
    scaled = np.ldexp(np.ldexp(vectors, half[:, None]), (-exponent - half)[:, None])
    length = np.sqrt((scaled * scaled).sum(axis=1))
    return np.ascontiguousarray(scaled / length[:, None])


def _rows_text(rows: npt.NDArray[np.intp]) -> str:
    """``row 7`` or ``rows 0, 1, 2, 3, 4, ... (12 in all)``."""
    if rows.size == 1:
        return f"row {rows[0]}"
    shown = ", ".join(str(i) for i in rows[:_ROWS_SHOWN])
    return f"rows {shown}" if rows.size <= _ROWS_SHOWN else f"rows {shown}, ... ({rows.size} in all)"


def _short(value: Any) -> str:
    """A value as a message shows it: one line, never long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
