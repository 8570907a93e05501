"""Textures to files.

==========  ========================================================================================
``.png``    8 or 16 bits. ao and sky: grey, the value itself (no sRGB curve). bent: the unit direction d as
            (d + 1) / 2, as normal maps have it. irradiance: `TONE_CURVE`, sRGB-encoded
``.exr``    float32, the values themselves: channel Y for ao and sky, R G B for the rest (bent normals
            keep their length), and ``coverage``: 1 where a texel has a value of its own, 0 in padding
``.glb``    the mesh with its texture coordinates, and the picture of ``.png`` inside: ao and sky as
            ``occlusionTexture`` (its red channel) of the materials of a glTF source, which is kept whole,
            or of a white one; the rest as ``baseColorTexture`` of an unlit one, so that viewers show the
            colours themselves
==========  ========================================================================================

The metadata stands in the text chunk or attribute ``silint``, in .glb in the ``extras`` of the mesh,
or of ``asset`` where a source is kept.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.io import LUMINANCE, write_bytes
from silint.io.glb import glb_bytes
from silint.io.png import png16_bytes
from silint.io.unfinished import discarded_if_cut_off
from silint.validation import InputError

__all__ = ["DEPTHS", "SUFFIXES", "Corners", "check_packages", "picture", "write_texture"]

FloatArray = npt.NDArray[np.float64]

SUFFIXES = (".png", ".exr", ".glb")
DEPTHS = (8, 16)


class Corners(NamedTuple):
    """A mesh by the corners of its faces."""

    positions: FloatArray
    """(F, 3, 3)"""
    vertices: npt.NDArray[np.int64]
    """(F, 3) rows of the file's vertices."""
    normals: FloatArray
    """(F, 3, 3)"""
    uvs: FloatArray
    """(F, 3, 2), v upwards"""


def check_packages(suffix: str) -> None:
    """One line, before anything is computed, if a package for such files is missing."""
    if suffix == ".exr":
        try:
            import OpenEXR  # noqa: F401
        except ImportError:
            raise InputError(
                "writing .exr needs the OpenEXR package: pip install 'silint[exr]', or write .png"
            ) from None


def picture(
    quantity: str, values: FloatArray, mean: float, depth: int = 8
) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
    """What 8 or 16 bits show (see the module's head).

    Parameters
    ----------
    quantity : {"ao", "sky", "bent", "irradiance"}
    values : (H, W, C) float64
        C is 1 or 3.
    mean : float
        Mean luminance of the covered texels, for irradiance.
    depth : {8, 16}
        Bits a channel.

    Returns
    -------
    (H, W) or (H, W, 3) uint8 or uint16
    """
    if quantity == "bent":
        length = np.linalg.norm(values, axis=2, keepdims=True)
        shown = 0.5 + 0.5 * np.divide(values, length, out=np.zeros_like(values), where=length > 0.0)
    elif quantity == "irradiance":
        linear = -np.expm1(-values / mean) if mean > 0.0 else np.zeros_like(values)
        shown = np.where(
            linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
        )
    else:
        shown = values[..., 0]
    levels: FloatArray = np.rint((2**depth - 1) * np.clip(shown, 0.0, 1.0))
    return levels.astype(np.uint8) if depth == 8 else levels.astype(np.uint16)


def write_texture(
    target: Path,
    quantity: str,
    values: FloatArray,
    coverage: npt.NDArray[np.bool_],
    mesh: Corners,
    metadata: dict[str, Any],
    kept: Callable[[bytes], bytes] | None = None,
    depth: int = 8,
) -> None:
    """Write a texture in the format that the suffix names.

    Parameters
    ----------
    target : pathlib.Path
    quantity : str
    values : (H, W, C) float64
        The top row first.
    coverage : (H, W) bool
    mesh : Corners
        For .glb.
    metadata : dict
        Anything that JSON can hold.
    kept : callable, optional
        From a .png to the .glb that shall hold it, in place of one made anew of `mesh`.
    depth : {8, 16}
        Bits a channel of .png.

    Raises
    ------
    InputError
        The file system refuses, or the mesh does not fit the format.
    """
    suffix = target.suffix.lower()
    if suffix == ".exr":
        write_bytes(target, _exr_bytes(values, coverage, metadata))
        return
    mean = float((values[coverage] @ LUMINANCE).mean()) if quantity == "irradiance" else 1.0
    png = _png_bytes(picture(quantity, values, mean, depth), metadata)
    if suffix == ".glb":
        png = kept(png) if kept is not None else _glb_bytes(quantity, png, mesh, metadata)
    write_bytes(target, png)


def _png_bytes(pixels: npt.NDArray[np.uint8] | npt.NDArray[np.uint16], metadata: dict[str, Any]) -> bytes:
    if pixels.dtype == np.uint16:
        return png16_bytes(pixels.astype(np.uint16, copy=False), "silint", json.dumps(metadata))
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    info.add_text("silint", json.dumps(metadata))
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "png", pnginfo=info)
    return buffer.getvalue()


def _exr_bytes(values: FloatArray, coverage: npt.NDArray[np.bool_], metadata: dict[str, Any]) -> bytes:
    import OpenEXR

    names = ("Y",) if values.shape[2] == 1 else ("R", "G", "B")
    channels = {name: np.ascontiguousarray(values[..., i], np.float32) for i, name in enumerate(names)}
    channels["coverage"] = coverage.astype(np.float32)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "silint": json.dumps(metadata),
    }
    # The package writes to paths only.
    with (
        tempfile.TemporaryDirectory(prefix="silint-exr-") as folder,
        discarded_if_cut_off(lambda: shutil.rmtree(folder, ignore_errors=True)),
    ):
        path = os.path.join(folder, "texture.exr")
        with OpenEXR.File(header, channels) as file:
            file.write(path)
        return Path(path).read_bytes()


def _glb_bytes(quantity: str, png: bytes, mesh: Corners, metadata: dict[str, Any]) -> bytes:
    rows = np.concatenate(
        [mesh.vertices.reshape(-1, 1), mesh.uvs.reshape(-1, 2), mesh.normals.reshape(-1, 3)], axis=1
    )
    _, first, faces = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    uvs = mesh.uvs.reshape(-1, 2)[first] * (1.0, -1.0) + (0.0, 1.0)  # glTF's v points down
    rough: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    material: dict[str, Any] = {"pbrMetallicRoughness": rough, "doubleSided": True}
    if quantity in ("ao", "sky"):
        material["occlusionTexture"] = {"index": 0}
    else:
        rough["baseColorTexture"] = {"index": 0}
        material["extensions"] = {"KHR_materials_unlit": {}}
    return glb_bytes(
        mesh.positions.reshape(-1, 3)[first],
        faces.reshape(-1, 3),
        mesh.normals.reshape(-1, 3)[first],
        {"TEXCOORD_0": uvs},
        metadata,
        image=png,
        material=material,
    )
