"""A writer of binary glTF 2.0 for one mesh with vertex attributes, and a reader of what it wrote.

trimesh writes colours with 8 bits, which shows as bands in a dark corner; here they are float32.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

__all__ = ["CLAMPED", "ROUGH", "GlbMesh", "glb_bytes", "glb_values", "read_glb"]

_MAGIC, _JSON_CHUNK, _BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
_FLOAT, _UINT32 = 5126, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_WIDTHS = {name: width for width, name in _TYPES.items()}
_MAX_BYTES = 2**32 - 1
ROUGH = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
# Mip levels between, nothing repeated: what lies at one edge of a bake has nothing to do with the other.
CLAMPED = {"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}


def glb_bytes(
    vertices: npt.NDArray[np.float64],
    faces: npt.NDArray[np.integer[Any]],
    normals: npt.NDArray[np.float64],
    attributes: Mapping[str, npt.NDArray[np.float64]],
    extras: Mapping[str, Any],
    image: bytes | None = None,
    material: Mapping[str, Any] | None = None,
) -> bytes:
    """One mesh as the bytes of a .glb file.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        Rounded to float32, the only precision that glTF has.
    faces : ndarray of int, shape (F, 3)
    normals : ndarray, shape (V, 3)
        Unit, or zero where there is none: glTF wants a unit vector there too, and gets +z.
    attributes : mapping of str to ndarray, shape (V,), (V, 3) or (V, 4)
        By their glTF names; custom ones begin with ``_``.
    extras : mapping
        Metadata of the mesh, as JSON.
    image : bytes, optional
        A .png: texture 0, which lookups beyond its edges do not repeat.
    material : mapping, optional
        In place of a rough, white, two-sided one; as JSON. Extensions that it names are declared.

    Returns
    -------
    bytes

    Raises
    ------
    InputError
        A position is beyond float32, or the file would pass 4 GiB, the format's limit.
    """
    with np.errstate(over="ignore"):
        positions = np.ascontiguousarray(vertices, dtype="<f4")
    if not np.isfinite(positions).all():
        raise InputError("vertices reach beyond 3.4e38, the end of .glb's float32; write .ply or .npz")
    unit = np.array(normals, dtype="<f4")
    unit[~unit.any(axis=1)] = (0.0, 0.0, 1.0)
    # Rounding to float32 leaves lengths off by up to 1e-7, well inside what validators allow.

    blocks: list[bytes] = []
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []

    def add(array: npt.NDArray[Any], component: int, target: int, **more: Any) -> int:
        width = 1 if array.ndim == 1 else array.shape[1]
        offset = sum(len(block) for block in blocks)
        blocks.append(array.tobytes())  # every component is 4 bytes wide, so every block stays aligned
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(blocks[-1]), "target": target})
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": component,
                "count": len(array),
                "type": _TYPES[width],
                **more,
            }
        )
        return len(accessors) - 1

    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    indices = add(np.ascontiguousarray(faces, dtype="<u4").ravel(), _UINT32, _ELEMENT_ARRAY_BUFFER)
    primitive = {
        "POSITION": add(positions, _FLOAT, _ARRAY_BUFFER, **bounds),
        "NORMAL": add(unit, _FLOAT, _ARRAY_BUFFER),
    }
    for name, values in attributes.items():
        primitive[name] = add(np.ascontiguousarray(values, dtype="<f4"), _FLOAT, _ARRAY_BUFFER)

    more: dict[str, Any] = {}
    if image is not None:
        offset = sum(len(block) for block in blocks)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(image)})
        blocks.append(image + b"\0" * (-len(image) % 4))
        more["images"] = [{"bufferView": len(views) - 1, "mimeType": "image/png"}]
        more["samplers"] = [CLAMPED]
        more["textures"] = [{"source": 0, "sampler": 0}]
    # glTF's default material is a metal, which shows vertex colours as dark mirrors.
    shown = dict(material or {"pbrMetallicRoughness": ROUGH, "doubleSided": True})
    if "extensions" in shown:
        more["extensionsUsed"] = sorted(shown["extensions"])

    binary = b"".join(blocks)
    document = {
        "asset": {"version": "2.0", "generator": "silint"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [{"attributes": primitive, "indices": indices, "material": 0}],
                "extras": dict(extras),
            }
        ],
        "materials": [shown],
        **more,
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    if total > _MAX_BYTES:
        raise InputError(f"the file would have {total} bytes, but .glb ends at 4 GiB; write .ply or .npz")
    return b"".join(
        (
            struct.pack("<III", _MAGIC, 2, total),
            struct.pack("<II", len(text), _JSON_CHUNK),
            text,
            struct.pack("<II", len(binary), _BIN_CHUNK),
            binary,
        )
    )


class GlbMesh(NamedTuple):
    """The first mesh of a file."""

    attributes: dict[str, npt.NDArray[np.float32]]
    """By their glTF names, (V,) or (V, k); those of other types than float32 are left out."""
    faces: npt.NDArray[np.uint32]
    """(F, 3)."""
    extras: dict[str, Any]
    """Metadata of the mesh."""


def read_glb(data: bytes) -> GlbMesh:
    """Read what `glb_bytes` wrote.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    GlbMesh

    Raises
    ------
    KeyError, IndexError, TypeError, ValueError
        Not such a file, or cut short.
    """
    if len(data) < 28 or struct.unpack_from("<I", data)[0] != _MAGIC:
        raise ValueError("not a .glb file")
    n_text = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + n_text])
    binary = data[28 + n_text :]
    mesh = document["meshes"][0]
    primitive = mesh["primitives"][0]

    def array(index: int, dtype: str) -> npt.NDArray[Any]:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = _WIDTHS[accessor["type"]]
        rows: npt.NDArray[Any] = np.ndarray(
            (accessor["count"], width),
            dtype,
            binary,
            view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
            (view.get("byteStride", 4 * width), 4),
        )
        return rows[:, 0] if width == 1 else rows

    if document["accessors"][primitive["indices"]]["componentType"] != _UINT32:
        raise ValueError("indices are not uint32")
    attributes = {
        name: array(index, "<f4")
        for name, index in primitive["attributes"].items()
        if document["accessors"][index]["componentType"] == _FLOAT
    }
    faces = array(primitive["indices"], "<u4").reshape(-1, 3)
    return GlbMesh(attributes, faces, mesh.get("extras", {}))


def glb_values(data: bytes, name: str) -> npt.NDArray[np.float64]:
    """A float32 vertex attribute of the first mesh of a .glb that `glb_bytes` made.

    Parameters
    ----------
    data : bytes
    name : str
        For instance ``_AO``.

    Returns
    -------
    ndarray of float64, shape (V,) or (V, 3)

    Raises
    ------
    KeyError, IndexError, TypeError, ValueError
        It is not there, or this is no such file.
    """
    return read_glb(data).attributes[name].astype(np.float64)
