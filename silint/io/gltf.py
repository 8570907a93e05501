"""glTF 2.0 files as they are: the JSON document and its binary buffers, to be changed and written back.

`silint.io.read` flattens such a file into one mesh, and `silint.io.glb` writes a new one from scratch. This
is for what has to leave the rest of a file alone.
"""

from __future__ import annotations

import base64
import binascii
import copy
import io
import json
import struct
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from silint.io.read import _silence as silence
from silint.validation import InputError

__all__ = [
    "Gltf",
    "Part",
    "accessor_rows",
    "accessor_values",
    "binary_gltf",
    "component_type",
    "embedded",
    "gltf_parts",
    "read_gltf",
]

FloatArray = npt.NDArray[np.float64]

_TYPES: dict[int, np.dtype[Any]] = {
    5120: np.dtype("i1"),
    5121: np.dtype("u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MEDIA = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
    ".ktx2": "image/ktx2",
}
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_MAX_BYTES = 2**32 - 1
# What parts of a mesh are called on their way through trimesh.
_PART = "_SILINT_PART_"


class Gltf(NamedTuple):
    """A glTF file."""

    document: dict[str, Any]
    buffers: list[bytes]
    """What the document's ``buffers`` hold."""


class Part(NamedTuple):
    """Triangles of one primitive as one node of the scene shows them."""

    node: int
    mesh: int
    primitive: int
    """Row among those of the mesh."""
    faces: npt.NDArray[np.int64]
    """(F, 3) rows of the primitive's vertices, in the order that the file has."""
    mirrored: bool
    """Whether the node's transform turns faces over, so that `read_mesh` swaps their last two corners."""


def read_gltf(path: Path) -> Gltf:
    """A .glb or .gltf file with all of its buffers.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    Gltf

    Raises
    ------
    InputError
        It is damaged, or refers to a file that is not there.
    """
    data = path.read_bytes()
    try:
        document, rest = _chunks(data, path.suffix.lower())
        buffers = []
        for i, buffer in enumerate(document.get("buffers", ())):
            held = rest if "uri" not in buffer and i == 0 else _referred(path, buffer.get("uri", ""))
            if len(held) < buffer["byteLength"]:
                raise InputError(f"buffer {i} ends early")
            buffers.append(held[: buffer["byteLength"]])
    except (InputError, AttributeError, KeyError, TypeError, ValueError) as error:
        told = str(error) if isinstance(error, InputError) else "its JSON makes no sense"
        raise InputError(f"{path}: not a valid glTF file ({told})") from None
    return Gltf(document, buffers)


def component_type(accessor: dict[str, Any]) -> np.dtype[Any]:
    """Of the numbers in an accessor."""
    dtype = _TYPES.get(accessor["componentType"])
    if dtype is None:
        raise InputError(f"an accessor has components of type {accessor['componentType']}")
    return dtype


def accessor_rows(gltf: Gltf, index: int) -> npt.NDArray[np.uint8]:
    """The bytes (count, size of an element) of an accessor of scalars or vectors.

    Parameters
    ----------
    gltf : Gltf
    index : int

    Raises
    ------
    InputError
        It leaves its buffer, or holds matrices.
    """
    accessor = gltf.document["accessors"][index]
    size, count = _element_size(accessor), accessor["count"]
    # Without a view all is zero.
    rows = np.zeros((count, size), np.uint8)
    if "bufferView" in accessor:
        rows = _view_rows(gltf, accessor, count, size).copy()
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        places = component_type(sparse["indices"])
        found = _view_rows(gltf, sparse["indices"], sparse["count"], places.itemsize).copy().view(places)
        if (found >= count).any():
            raise InputError(f"accessor {index} has sparse values beyond its end")
        rows[found.ravel()] = _view_rows(gltf, sparse["values"], sparse["count"], size)
    return rows


def _view_rows(gltf: Gltf, part: dict[str, Any], count: int, size: int) -> npt.NDArray[np.uint8]:
    """Rows (count, size) of what an accessor, or a part of a sparse one, says of its bytes."""
    view = gltf.document["bufferViews"][part["bufferView"]]
    stride = view.get("byteStride", size)
    start = view.get("byteOffset", 0) + part.get("byteOffset", 0)
    buffer = np.frombuffer(gltf.buffers[view["buffer"]], np.uint8)
    if count < 1 or start + (count - 1) * stride + size > len(buffer):
        raise InputError("an accessor leaves its buffer")
    return np.lib.stride_tricks.as_strided(buffer[start:], (count, size), (stride, 1), writeable=False)


def accessor_values(gltf: Gltf, index: int) -> FloatArray:
    """The values (count, width) of an accessor, integers that stand for fractions as such.

    Parameters
    ----------
    gltf : Gltf
    index : int

    Raises
    ------
    InputError
        As `accessor_rows`.
    """
    accessor = gltf.document["accessors"][index]
    dtype = component_type(accessor)
    values = accessor_rows(gltf, index).view(dtype).astype(np.float64)
    if accessor.get("normalized") and dtype.kind in "iu":
        return np.asarray(np.maximum(values / np.iinfo(dtype).max, -1.0))
    return values


def gltf_parts(gltf: Gltf, path: Path) -> list[Part]:
    """The parts whose faces `read_mesh` joins, in its order.

    Parameters
    ----------
    gltf : Gltf
    path : pathlib.Path
        Where it has been read from.

    Returns
    -------
    list of Part
    """
    import trimesh

    # trimesh makes names of its own, and hands on attributes that begin with an underscore.
    document = copy.deepcopy(gltf.document)
    for i, node in enumerate(document.get("nodes", ())):
        node["name"] = f"silint {i}"
    for m, mesh in enumerate(document.get("meshes", ())):
        for p, primitive in enumerate(mesh["primitives"]):
            attributes = primitive["attributes"]
            for name in [name for name in attributes if name.startswith("_")]:
                del attributes[name]
            attributes[f"{_PART}{m}_{p}"] = attributes["POSITION"]
    node_of_name = {f"silint {i}": i for i in range(len(document.get("nodes", ())))}
    with silence():
        scene: Any = trimesh.load_scene(
            io.BytesIO(_with_document(path, document)),
            file_type=path.suffix.lower()[1:],
            resolver=trimesh.resolvers.FilePathResolver(str(path)),
            process=False,
            skip_materials=True,
        )
    parts = []
    for name in scene.graph.nodes_geometry:
        transform, key = scene.graph[name]
        shape = scene.geometry[key]
        if not isinstance(shape, trimesh.Trimesh) or not len(shape.faces):
            continue
        node = node_of_name.get(name)
        if node is None:
            node = node_of_name[scene.graph.transforms.parents[name]]
        label = next(a for a in shape.vertex_attributes if a.startswith(_PART))
        mesh_row, primitive_row = (int(word) for word in label[len(_PART) :].split("_"))
        mirrored = bool(np.linalg.det(np.asarray(transform, dtype=np.float64)[:3, :3]) < 0.0)
        parts.append(Part(node, mesh_row, primitive_row, np.asarray(shape.faces, dtype=np.int64), mirrored))
    return parts


def embedded(gltf: Gltf, path: Path) -> Gltf:
    """The same file with pictures that stand in other files inside.

    Parameters
    ----------
    gltf : Gltf
    path : pathlib.Path
        Where it has been read from.

    Raises
    ------
    InputError
        A picture is not there, or of a kind that glTF does not know.
    """
    document, buffers = copy.deepcopy(gltf.document), list(gltf.buffers)
    for image in document.get("images", ()):
        uri = image.get("uri", "data:")
        if uri.startswith("data:"):
            continue
        suffix = Path(unquote(uri)).suffix.lower()
        if suffix not in _MEDIA:
            raise InputError(f"{path}: refers to the picture {uri!r}; expected .png, .jpg, .webp or .ktx2")
        try:
            data = _referred(path, uri)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        document.setdefault("bufferViews", []).append(
            {"buffer": len(buffers), "byteOffset": 0, "byteLength": len(data)}
        )
        document.setdefault("buffers", []).append({"byteLength": len(data)})
        buffers.append(data)
        del image["uri"]
        image["bufferView"], image["mimeType"] = len(document["bufferViews"]) - 1, _MEDIA[suffix]
    return Gltf(document, buffers)


def binary_gltf(gltf: Gltf) -> bytes:
    """The bytes of a .glb, its buffers joined into one.

    Parameters
    ----------
    gltf : Gltf

    Raises
    ------
    InputError
        It would pass 4 GiB, the format's limit.
    """
    document = copy.deepcopy(gltf.document)
    padded = [data + b"\0" * (-len(data) % 4) for data in gltf.buffers]
    starts = np.concatenate([[0], np.cumsum([len(data) for data in padded])]).tolist()
    for view in document.get("bufferViews", ()):
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view["buffer"]]
        view["buffer"] = 0
    document["buffers"] = [{"byteLength": starts[-1]}]
    text = json.dumps(document, separators=(",", ":")).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + starts[-1]
    if total > _MAX_BYTES:
        raise InputError(f"the file would have {total} bytes, but .glb ends at 4 GiB; write .png")
    head = struct.pack("<4sIIII", b"glTF", 2, total, len(text), _JSON)
    return b"".join((head, text, struct.pack("<II", starts[-1], _BIN), *padded))


def _element_size(accessor: dict[str, Any]) -> int:
    """Bytes of an element."""
    width = _WIDTHS.get(accessor["type"])
    if width is None:
        raise InputError(f"an accessor holds {accessor['type']}; expected scalars or vectors")
    return component_type(accessor).itemsize * width


def _chunks(data: bytes, suffix: str) -> tuple[dict[str, Any], bytes]:
    """The document, and the binary chunk of a .glb."""
    if suffix != ".glb":
        return json.loads(data), b""
    length = int.from_bytes(data[12:16], "little")
    start = 20 + length
    size = int.from_bytes(data[start : start + 4], "little")
    return json.loads(data[20:start]), data[start + 8 : start + 8 + size]


def _with_document(path: Path, document: dict[str, Any]) -> bytes:
    """A file with another document in the place of its own."""
    text = json.dumps(document).encode("ascii")
    if path.suffix.lower() != ".glb":
        return text
    data = path.read_bytes()
    rest = data[20 + int.from_bytes(data[12:16], "little") :]
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), _JSON) + text + rest


def _referred(path: Path, uri: str) -> bytes:
    """What a URI of a glTF file stands for."""
    if uri.startswith("data:"):
        try:
            return base64.b64decode(uri.partition(",")[2], validate=True)
        except (binascii.Error, ValueError):
            raise InputError("holds a data URI that is not base64") from None
    try:
        return (path.parent / unquote(uri)).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "no such file"
        raise InputError(f"refers to {uri[:80]!r}, which cannot be read ({reason})") from None
