"""The two files that pipelines of digital humans (PIFu, ICON, PaMIR) expect from their ``computePRT``.

``bounce/bounce0.txt`` has a line for each vertex, nine numbers ``%.8f``: int V max(n.w,0) Y dw to degree 2,
without the 1/pi of `silint.SilhouetteIntegrator.sh_transfer`. Theirs is a Monte Carlo sum with a
Condon-Shortley phase over directions whose x and y are negated; the two cancel, and signs and order are
silint's own. ``bounce/face.npy`` has the triangles, int64 (F, 3), that index those lines.
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.io.write import check_output, write_together
from silint.validation import InputError, mesh_arrays

__all__ = ["check_bounce_output", "read_bounce", "write_bounce"]

_FILES = ("bounce0.txt", "face.npy")


def check_bounce_output(folder: str | os.PathLike[str]) -> Path:
    """Make sure, before any computing, that ``bounce/`` can be written in a folder.

    Parameters
    ----------
    folder : str or path-like
        Itself and ``bounce`` in it need not exist yet, its parent has to.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    InputError
        It cannot, in one line that names the path.
    """
    place = Path(folder)
    try:
        place.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass  # told below
    except (OSError, ValueError) as error:  # a name that is too long, a null byte
        raise InputError(f"{place}: cannot be made ({getattr(error, 'strerror', None) or error})") from None
    # What is not there yet is made when it is written; that it can be shows one level higher.
    for level in (place / "bounce", place, place.parent):
        if os.path.isdir(level):
            for name in _FILES:
                check_output(level / name, (Path(name).suffix,))
            return place
        if os.path.lexists(level):
            raise InputError(f"{level}: is a file; expected a folder")
    raise InputError(f"{place}: its parent folder does not exist; create it first")


def write_bounce(
    folder: str | os.PathLike[str],
    coefficients: npt.NDArray[np.float64],
    faces: npt.NDArray[np.integer[Any]],
) -> tuple[Path, ...]:
    """Write both files, and make the folders where they are not.

    Parameters
    ----------
    folder : str or path-like
        The one that gets ``bounce/``.
    coefficients : (V, 9) float64
        Cosine-weighted SH transfer of degree 2.
    faces : (F, 3) int

    Returns
    -------
    tuple of pathlib.Path
        The two files.

    Raises
    ------
    InputError
        The file system refuses; nothing is left behind.
    """
    table, index = io.BytesIO(), io.BytesIO()
    np.savetxt(table, np.pi * coefficients, fmt="%.8f")
    np.save(index, faces.astype("<i8"))
    place = Path(folder)
    files = tuple(place / "bounce" / name for name in _FILES)
    made: list[Path] = []
    try:
        for level in (place, place / "bounce"):
            if not os.path.isdir(level):
                os.mkdir(level)
                made.append(level)
        write_together([(files[0], table.getvalue()), (files[1], index.getvalue())])
    except BaseException as error:  # Ctrl-C too
        for level in reversed(made):
            with contextlib.suppress(OSError):
                level.rmdir()
        if isinstance(error, OSError):
            raise InputError(f"{place}: cannot be made ({error.strerror or error})") from None
        raise
    return files


def read_bounce(
    folder: str | os.PathLike[str],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Read both files, by whomever they were written.

    Parameters
    ----------
    folder : str or path-like
        The one that holds ``bounce/``.

    Returns
    -------
    coefficients : (V, 9) float64
        Cosine-weighted SH transfer of degree 2 as silint has it: the file's numbers over pi.
    faces : (F, 3) int32
        Rows of `coefficients`.

    Raises
    ------
    InputError
        A file is missing, or is not what its name says.
    """
    table, index = (Path(folder) / "bounce" / name for name in _FILES)
    file = table
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of an empty file, which the shape tells
            values = np.loadtxt(table, dtype=np.float64, ndmin=2)
        file = index
        faces = np.load(index, allow_pickle=False)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror or error})") from None
    except (ValueError, EOFError):
        raise InputError(f"{file}: damaged, or something else than its name says") from None
    if values.ndim != 2 or values.shape[1] != 9 or not np.isfinite(values).all():
        raise InputError(f"{table}: shape {values.shape}; expected 9 finite numbers on every line")
    try:
        # Vertices are not in these files, but every index has to name one.
        checked = mesh_arrays(np.zeros((len(values), 3)), faces)[1]
    except InputError as error:
        raise InputError(f"{index}: {error}") from None
    return values / np.pi, checked
