"""Texture coordinates for meshes that have none, by xatlas.

xatlas is compiled code that ends its whole process on a mesh that it does not like, so it has one of its own.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.io.unfinished import discarded_if_cut_off
from silint.validation import InputError

__all__ = ["repack", "unwrap"]

FloatArray = npt.NDArray[np.float64]


def unwrap(vertices: FloatArray, faces: npt.NDArray[np.int64], size: int) -> FloatArray:
    """Charts that do not overlap, packed into the unit square.

    Parameters
    ----------
    vertices : (V, 3) float64
        Welded by position: edges between vertices that merely coincide would become seams.
    faces : (F, 3) int
    size : int
        Side of the texture in texels, which sets the room between charts: about 4 texels, so that no
        bilinear lookup reads two charts, and less below 64.

    Returns
    -------
    (F, 3, 2) float64
        v upwards, no chart mirrored. Faces that xatlas leaves out (zero area, duplicates) have all corners in
        one point.

    Raises
    ------
    InputError
        xatlas is not installed, or fails.
    """
    # float32 and absolute thresholds inside: a mesh of unit size loses nothing.
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    scale = float(np.abs(vertices - middle).max()) or 1.0
    positions = ((vertices - middle) / scale).astype(np.float32)
    return _by_xatlas({"positions": positions}, faces, size)


def repack(uvs: FloatArray, charts: npt.NDArray[np.int32], size: int) -> FloatArray:
    """Charts turned, scaled by one factor, and moved apart, with the room between them that `unwrap` leaves.

    (xatlas then stretches each until its box has whole texels.)

    Parameters
    ----------
    uvs : (F, 3, 2) float64
        In the unit square.
    charts : (F,) int32
        Chart of each face, which need not be what `uvs` say: cut them here. Faces with -1 are left out and
        have all corners in one point.
    size : int
        Side of the texture in texels.

    Returns
    -------
    (F, 3, 2) float64

    Raises
    ------
    InputError
        As `unwrap`.
    """
    used = charts >= 0
    corners = np.concatenate([np.repeat(charts[used], 3)[:, None], uvs[used].reshape(-1, 2)], axis=1)
    rows, faces = np.unique(corners, axis=0, return_inverse=True)
    arrays = {"uvs": (size * rows[:, 1:]).astype(np.float32), "charts": charts[used].astype(np.uint32)}
    out = np.zeros_like(uvs)
    out[used] = _by_xatlas(arrays, faces.reshape(-1, 3), size)
    return out


def _by_xatlas(arrays: dict[str, npt.NDArray[Any]], faces: npt.NDArray[np.int64], size: int) -> FloatArray:
    """Texture coordinates (F, 3, 2) from what `xatlas_worker` makes of the arrays."""
    if importlib.util.find_spec("xatlas") is None:
        raise InputError(
            "unwrapping needs the package xatlas: pip install 'silint[texture]', or bring texture coordinates"
        )
    with tempfile.TemporaryDirectory(prefix="silint-unwrap-") as folder:
        source, target = (os.path.join(folder, name) for name in ("mesh.npz", "atlas.npz"))
        np.savez(
            source,
            faces=faces.astype(np.uint32),
            resolution=size,
            padding=min(4, max(1, size // 16)),
            **arrays,  # type: ignore[arg-type]  # the stubs take them for savez's own options
        )
        worker = Path(__file__).with_name("xatlas_worker.py")
        with discarded_if_cut_off(lambda: shutil.rmtree(folder, ignore_errors=True)):
            code, told = _run([sys.executable, str(worker), source, target])
        if code != 0 or not os.path.exists(target):
            lines = told.strip().splitlines()
            signal = f"signal {-code}" if code < 0 else f"code {code}"
            reason = lines[-1][:80] if lines and code > 0 else signal
            raise InputError(f"xatlas could not unwrap the mesh ({reason}); bring texture coordinates")
        with np.load(target) as data:
            corners, uvs, extent = data["faces"], data["uvs"].astype(np.float64), data["extent"]
            pages = int(data["pages"])
    if pages > 1 or corners.shape != faces.shape or not extent.all():
        raise InputError(
            f"xatlas made {pages} pages of {len(corners)} triangles; expected one of {len(faces)}"
        )
    # In texels of a square: the page need not be one, and its coordinates are in its own sides.
    placed = uvs * (extent / extent.max())
    out: FloatArray = np.clip(placed[corners], 0.0, 1.0)
    return out


def _run(command: list[str]) -> tuple[int, str]:
    """Exit code of a program and what it wrote to stderr; it goes when this process is cut off."""
    cut_off = False
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as process:

        def discard() -> None:
            nonlocal cut_off
            cut_off = True
            process.kill()

        try:
            with discarded_if_cut_off(discard):
                _, told = process.communicate()
        except BaseException:  # Ctrl-C in a program that uses silint
            process.kill()
            raise
    if cut_off:
        # Not a failure of xatlas, which would be told as one while the process ends.
        raise KeyboardInterrupt
    return process.returncode, told
