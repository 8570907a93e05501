"""Functions of direction that a user brings, as callables or tables, checked and ready to integrate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.core.integrands import basis as kernels
from silint.core.prefix_table import NODES_PER_QUARTER, PrefixTable, build_prefix_table
from silint.core.texel_table import TexelTable, cells_per_quarter
from silint.radiance_map import MOST_ROWS
from silint.validation import InputError

FloatArray = npt.NDArray[np.float64]

_TABLE_BYTES = 1 << 30  # that a table may take
_EXPECTED = "expected a function of directions (m, 3), an equirectangular table (H, 2 H, C) or a PrefixTable"

# Where a function is tried: what it returns for them says how many channels there are.
_TRIED = np.concatenate([np.eye(3), -np.eye(3)])


class Basis:
    """C functions of direction, and their tables along octahedral isolines.

    Parameters
    ----------
    basis : callable, array_like (H, 2 H) or (H, 2 H, C), or PrefixTable
        See `SilhouetteIntegrator.integrate`.
    weighting : {"cosine", "uniform"}

    Attributes
    ----------
    channels : int
        C.
    isolines : int or None
        Of a PrefixTable; functions and texels are tabulated for any number.
    """

    isolines: int | None = None

    def __init__(self, basis: Any, weighting: str) -> None:
        self.weighting = weighting
        self._function: Callable[[FloatArray], FloatArray] | None = None
        self._texels: FloatArray | None = None
        self._tables: dict[int, PrefixTable | TexelTable] = {}
        if isinstance(basis, PrefixTable):
            if weighting == "cosine":
                raise InputError(
                    "weighting is 'cosine', for which a PrefixTable of the function alone does not do; "
                    "pass the function itself"
                )
            self.channels = int(basis.values.shape[-1])
            self.isolines = len(basis.values)
            self._tables[self.isolines] = basis
        elif callable(basis):
            self.channels = sample(basis, _TRIED, None).shape[1]
            self._function = lambda directions: sample(basis, directions, self.channels)
        else:
            self._texels = _texels(basis)
            self.channels = self._texels.shape[2]

    @property
    def is_function(self) -> bool:
        """Whether making a table calls back to the user."""
        return self._function is not None

    def check(self, isolines: int) -> None:
        """Refuse a number of isolines that there is no table for."""
        if self.isolines not in (None, isolines):
            raise InputError(f"table has {self.isolines} isolines; this visibility has {isolines}")
        if self.isolines is None and isolines > self.most_isolines:
            raise InputError(
                f"isolines is {isolines}; the table of {self.channels} functions is kept to "
                f"{self.most_isolines}: pass fewer functions at a time"
            )

    def table(self, isolines: int) -> PrefixTable | TexelTable:
        """Prefix sums along that many isolines: of f, or of f w for "cosine"."""
        found = self._tables.get(isolines)
        if found is None:
            self.check(isolines)
            if self._function is not None:
                found = kernels.function_table(self._function, isolines, self.weighting)
            elif self._texels is not None:
                found = kernels.texel_table(self._texels, isolines, self.weighting)
            assert found is not None
            self._tables = {isolines: found}
        return found

    def table_bytes(self, isolines: int) -> int:
        """Size of `table`."""
        columns = self.channels * (3 if self.weighting == "cosine" else 1)
        if self._texels is not None:
            return 8 * isolines * (4 * cells_per_quarter(len(self._texels)) + 1) * columns
        nodes = NODES_PER_QUARTER
        for known in self._tables.values():
            if isinstance(known, PrefixTable):
                nodes = known.nodes_per_quarter
        return 8 * isolines * (4 * nodes + 1) * 2 * columns

    @property
    def most_isolines(self) -> int:
        """How many isolines, a power of two, memory is spent on: 1 GiB."""
        return 1 << max((_TABLE_BYTES // self.table_bytes(1)).bit_length() - 1, 0)

    @property
    def described(self) -> str:
        """For a plan."""
        if self._texels is not None:
            return "{} x {} texels".format(*self._texels.shape[:2])
        return "a table brought along" if self._function is None else "a function"

    def integrate(
        self, normals: FloatArray, visible: tuple[npt.NDArray[np.int64], FloatArray], isolines: int
    ) -> tuple[FloatArray, FloatArray]:
        """Integrals over visible intervals, (n, C), and their error estimate, (n,)."""
        return kernels.integrate(normals, visible, isolines, self.table(isolines), self.weighting)


def sample(function: Callable[..., Any], directions: FloatArray, channels: int | None) -> FloatArray:
    """Values (m, C) of a user's function, or an InputError in one line."""
    m = len(directions)
    try:
        found = np.asarray(function(directions))
    except Exception as error:
        told = " ".join(str(error).split())
        raise InputError(f"function raised {type(error).__name__} for {m} directions: {told}") from error
    if found.shape[:1] != (m,) or found.ndim > 2 or found.size == 0:
        raise InputError(
            f"function returned shape {found.shape} for {m} directions; expected ({m},) or ({m}, C)"
        )
    if found.dtype.kind not in "biuf":
        raise InputError(f"function returned {found.dtype} values; expected real numbers")
    values: FloatArray = found.astype(np.float64).reshape(m, -1)
    if channels is not None and values.shape[1] != channels:
        raise InputError(f"function returned {values.shape[1]} columns, and {channels} for other directions")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        at = ", ".join(f"{x:.4g}" for x in directions[bad[0]])
        raise InputError(
            f"function returned NaN or infinity for {len(bad)} of {m} directions, the first ({at})"
        )
    return values


def prefix_table(
    function: Any, isolines: int = 64, nodes_per_quarter: int = NODES_PER_QUARTER
) -> PrefixTable:
    """Tabulate a function over the sphere for `Visibility.integrate`.

    Parameters
    ----------
    function : callable
        Unit directions (m, 3) -> values (m, C) or (m,). Smooth at the scale of a cell: features narrower
        than 2 / isolines or 1 / nodes_per_quarter of a quarter turn blur.
    isolines : int
        Of the visibility to integrate.
    nodes_per_quarter : int
        Nodes on each of the four sides of an isoline.

    Returns
    -------
    PrefixTable
        Its totals are the integrals over the whole sphere: a constant 1 sums to 4 pi to rounding.
    """
    channels: list[int] = []

    def columns(directions: FloatArray) -> FloatArray:
        values = sample(function, directions, channels[0] if channels else None)
        channels[:] = [values.shape[1]]
        return values

    return build_prefix_table(columns, isolines, nodes_per_quarter)


def _texels(table: Any) -> FloatArray:
    """An equirectangular table as (H, 2 H, C) float64."""
    try:
        array = np.asarray(table)
    except ValueError:  # rows of different lengths
        raise InputError(f"basis is a {type(table).__name__} of unequal rows; {_EXPECTED}") from None
    if array.dtype.kind not in "biuf" or array.ndim not in (2, 3):
        of = f" of shape {array.shape}, {array.dtype}" if array.ndim else ""
        raise InputError(f"basis is a {type(table).__name__}{of}; {_EXPECTED}")
    height, width = array.shape[:2]
    channels = array.size // max(height * width, 1)
    if width != 2 * height or not 0 < height <= MOST_ROWS or channels == 0:
        raise InputError(
            f"basis has shape {array.shape}; expected (H, 2 H) or (H, 2 H, C), twice as wide as high"
        )
    texels: FloatArray = array.astype(np.float64).reshape(height, width, channels)
    bad = int((~np.isfinite(texels)).any(axis=2).sum())
    if bad:
        raise InputError(f"basis has NaN or infinity in {bad} of {height * width} texels")
    return texels
