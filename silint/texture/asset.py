"""Occlusion added to a glTF asset that keeps all else: materials, textures, nodes, skins, animations.

Every material of a baked primitive gets the new picture as its ``occlusionTexture``. Where the bake's
coordinates are a set of the primitive's own, that is read. Else the primitive gets another set, the first
whose number is free, and a vertex that has several coordinates in it becomes several, with all of its other
attributes and morph targets.
"""

from __future__ import annotations

import copy
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.io.glb import CLAMPED, ROUGH
from silint.io.gltf import (
    Gltf,
    Part,
    accessor_rows,
    accessor_values,
    binary_gltf,
    component_type,
    embedded,
    gltf_parts,
    read_gltf,
)
from silint.io.gltf_prune import pruned

__all__ = ["Asset", "left_out", "open_asset", "with_occlusion"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Coordinates that differ by less are the same: less than a hundredth of a texel at 8192.
_SAME = 1e-6
_FLOAT, _UINT32 = 5126, 5125
_TRIANGLES = 4
_COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


class Asset(NamedTuple):
    """A glTF file, and which part of it each face of the mesh belongs to."""

    gltf: Gltf
    parts: list[Part]


def open_asset(path: Path, faces: npt.NDArray[np.integer[Any]]) -> Asset | str:
    """The file that a mesh was read from, or why it cannot be kept.

    Parameters
    ----------
    path : pathlib.Path
        A .glb or .gltf file.
    faces : (F, 3) int
        As `silint.io.read_mesh` has them.

    Raises
    ------
    InputError
        It refers to pictures that are not there.
    """
    gltf = read_gltf(path)
    used = [name for name in _COMPRESSED if name in gltf.document.get("extensionsUsed", ())]
    if used:
        return f"it is compressed by {used[0]}"
    parts = gltf_parts(gltf, path)
    expected, start = [], 0
    for part in parts:
        corners = part.faces[:, [0, 2, 1]] if part.mirrored else part.faces
        expected.append(corners + start)
        start += _n_vertices(gltf.document, _primitive(gltf.document, part))
    if not np.array_equal(np.concatenate(expected), faces):
        return "its faces could not be told apart"
    return Asset(embedded(gltf, path), parts)


def left_out(path: Path) -> list[str]:
    """What a mesh file has that is in no .glb made anew of its triangles."""
    suffix = path.suffix.lower()
    if suffix == ".obj":
        return ["materials"] if re.search(rb"^\s*usemtl\b", path.read_bytes(), re.MULTILINE) else []
    if suffix == ".ply":
        header = path.read_bytes().partition(b"end_header")[0]
        return ["vertex colors"] if re.search(rb"^property \w+ red\s*$", header, re.MULTILINE) else []
    if suffix not in (".glb", ".gltf"):
        return []
    document = read_gltf(path).document
    primitives = [p for mesh in document.get("meshes", ()) for p in mesh["primitives"]]
    attributes = {name for primitive in primitives for name in primitive["attributes"]}
    there = {
        "materials": document.get("materials"),
        "textures": document.get("textures"),
        "vertex colors": any(name.startswith("COLOR_") for name in attributes),
        "texture coordinates": any(name.startswith("TEXCOORD_") for name in attributes),
        "morph targets": any("targets" in primitive for primitive in primitives),
        "skins": document.get("skins"),
        "animations": document.get("animations"),
        "cameras": document.get("cameras"),
        "lights": document.get("extensions", {}).get("KHR_lights_punctual"),
        "nodes": len(document.get("nodes", ())) > 1,
    }
    return [name for name, has in there.items() if has]


def with_occlusion(
    asset: Asset, uvs: FloatArray, chosen: npt.NDArray[np.bool_], png: bytes, metadata: dict[str, Any]
) -> tuple[bytes, dict[str, Any]]:
    """The asset with a picture as the occlusion of its materials, as a .glb.

    Parameters
    ----------
    asset : Asset
    uvs : (F, 3, 2) float64
        The picture's coordinates, v upwards.
    chosen : (F,) bool
        Faces that were baked. Nodes without any show no mesh in the result.
    png : bytes
    metadata : dict
        Goes into the extras of ``asset``, as ``silint``.

    Returns
    -------
    data : bytes
    told : dict
        ``materials``, how many now have it; ``replaced``, how many had one before; ``texcoord``, the sets of
        coordinates that it reads; ``emptied``, how many nodes lost their mesh; ``variants``, whether there
        are variants of materials (KHR_materials_variants), which stay without it.
    """
    gltf = Gltf(copy.deepcopy(asset.gltf.document), list(asset.gltf.buffers))
    document = gltf.document
    texture = _add_texture(gltf, png)
    down = uvs * (1.0, -1.0) + (0.0, 1.0)  # glTF's v points down
    edited: dict[int, list[tuple[Part, FloatArray]]] = {}
    emptied = set()
    start = 0
    for part in asset.parts:
        rows = slice(start, start + len(part.faces))
        start = rows.stop
        if not chosen[rows].any():
            for key in ("mesh", "skin", "weights"):
                document["nodes"][part.node].pop(key, None)
            emptied.add(part.node)
            continue
        corners = down[rows]
        edited.setdefault(part.node, []).append((part, corners[:, [0, 2, 1]] if part.mirrored else corners))
    # Primitives by identity: their materials are given out when all have their coordinates.
    wanted: list[tuple[dict[str, Any], int]] = []
    for node, parts in _own_meshes(document, edited).items():
        mesh = document["meshes"][document["nodes"][node]["mesh"]]
        for part, corners in parts:
            primitive = mesh["primitives"][part.primitive]
            wanted.append((primitive, _add_coordinates(gltf, primitive, part.faces, corners)))
    told = _give_materials(document, wanted, texture)
    told["emptied"] = len(emptied)
    told["variants"] = "KHR_materials_variants" in document.get("extensionsUsed", ())
    extras = document.setdefault("asset", {"version": "2.0"}).setdefault("extras", {})
    if not isinstance(extras, dict):
        document["asset"]["extras"] = extras = {"extras": extras}
    extras["silint"] = metadata
    return binary_gltf(pruned(gltf, asset.gltf)), told


def _own_meshes(
    document: dict[str, Any], edited: dict[int, list[tuple[Part, FloatArray]]]
) -> dict[int, list[tuple[Part, FloatArray]]]:
    """The nodes whose meshes are to be edited, such that no other node has a mesh of theirs.

    A mesh of several nodes is copied, as each has a place of its own in the picture; but if they all have the
    same place, the first stands for all.
    """
    users: dict[int, list[int]] = {}
    for i, node in enumerate(document["nodes"]):
        if "mesh" in node:
            users.setdefault(node["mesh"], []).append(i)
    out = {}
    for mesh, nodes in users.items():
        ours = [node for node in nodes if node in edited]
        if not ours:
            continue
        out[ours[0]] = edited[ours[0]]
        first = [corners for _, corners in edited[ours[0]]]
        alike = all(
            all(np.array_equal(a, b) for a, (_, b) in zip(first, edited[node], strict=True)) for node in ours
        )
        if alike and len(ours) == len(nodes):
            continue
        pristine = document["meshes"][mesh]
        for node in ours if len(ours) < len(nodes) else ours[1:]:
            document["meshes"].append(copy.deepcopy(pristine))
            document["nodes"][node]["mesh"] = len(document["meshes"]) - 1
            out[node] = edited[node]
    return out


def _add_coordinates(gltf: Gltf, primitive: dict[str, Any], faces: IntArray, corners: FloatArray) -> int:
    """Give a primitive coordinates (F, 3, 2), v down, of its faces; the number of the set that holds them."""
    attributes = primitive["attributes"]
    document = gltf.document
    number = 0
    while f"TEXCOORD_{number}" in attributes:
        own = accessor_values(gltf, attributes[f"TEXCOORD_{number}"])[faces]
        if np.abs(own - corners).max() <= _SAME:
            return number
        number += 1
    pairs = np.concatenate(
        [faces.reshape(-1, 1).astype(np.float64), corners.reshape(-1, 2).astype(np.float32)], axis=1
    )
    _, first, inverse = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    rows, values = pairs[first, 0].astype(np.int64), pairs[first, 1:].astype("<f4")
    if len(np.unique(rows)) == len(rows):
        # One for each vertex: nothing else has to change.
        of_vertex = np.zeros((_n_vertices(document, primitive), 2), "<f4")
        of_vertex[rows] = values
        attributes[f"TEXCOORD_{number}"] = _add_accessor(
            gltf, of_vertex.tobytes(), _FLOAT, "VEC2", len(of_vertex)
        )
        return number
    copies: dict[int, int] = {}
    for group in (attributes, *primitive.get("targets", ())):
        for name, accessor in group.items():
            if accessor not in copies:
                copies[accessor] = _add_rows(gltf, accessor, rows)
            group[name] = copies[accessor]
    attributes[f"TEXCOORD_{number}"] = _add_accessor(gltf, values.tobytes(), _FLOAT, "VEC2", len(values))
    indices = inverse.ravel().astype("<u4")
    primitive["indices"] = _add_accessor(
        gltf, indices.tobytes(), _UINT32, "SCALAR", len(indices), target=34963
    )
    primitive["mode"] = _TRIANGLES
    return number


def _give_materials(
    document: dict[str, Any], wanted: list[tuple[dict[str, Any], int]], texture: int
) -> dict[str, Any]:
    """Give primitives materials with the occlusion, each on the set of coordinates that it has."""
    materials = document.setdefault("materials", [])
    ours = {id(primitive) for primitive, _ in wanted}
    # A material that other primitives have too is copied.
    taken = {
        primitive.get("material")
        for mesh in document["meshes"]
        for primitive in mesh["primitives"]
        if id(primitive) not in ours
    }
    given: dict[tuple[int | None, int], int] = {}
    pristine = copy.deepcopy(materials)
    replaced = 0
    for primitive, number in wanted:
        source = primitive.get("material")
        key = (source, number)
        if key not in given:
            if source is None:
                material: dict[str, Any] = {"pbrMetallicRoughness": dict(ROUGH), "doubleSided": True}
            else:
                material = copy.deepcopy(pristine[source])
            replaced += "occlusionTexture" in material
            material["occlusionTexture"] = {"index": texture, **({"texCoord": number} if number else {})}
            if source is None or source in taken:
                materials.append(material)
                given[key] = len(materials) - 1
            else:
                materials[source] = material
                given[key] = source
                taken.add(source)
        primitive["material"] = given[key]
    return {
        "materials": len(given),
        "replaced": replaced,
        "texcoord": sorted({number for _, number in wanted}),
    }


def _add_texture(gltf: Gltf, png: bytes) -> int:
    document = gltf.document
    new = {
        "images": {"bufferView": _add_view(gltf, png), "mimeType": "image/png", "name": "occlusion"},
        "samplers": dict(CLAMPED),
    }
    rows = {}
    for key, item in new.items():
        document.setdefault(key, []).append(item)
        rows[key] = len(document[key]) - 1
    document.setdefault("textures", []).append({"source": rows["images"], "sampler": rows["samplers"]})
    return len(document["textures"]) - 1


def _add_rows(gltf: Gltf, index: int, rows: IntArray) -> int:
    """An accessor of some of the elements of another."""
    old = gltf.document["accessors"][index]
    elements = accessor_rows(gltf, index)[rows]
    size = elements.shape[1]
    stride = size + -size % 4  # as vertex attributes have to be aligned
    data = np.zeros((len(rows), stride), np.uint8)
    data[:, :size] = elements
    more = {key: old[key] for key in ("normalized", "name", "extras") if key in old}
    if "min" in old:
        values = elements.view(component_type(old))
        more["min"], more["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
    return _add_accessor(
        gltf,
        data.tobytes(),
        old["componentType"],
        old["type"],
        len(rows),
        stride if stride > size else 0,
        **more,
    )


def _add_accessor(
    gltf: Gltf,
    data: bytes,
    component: int,
    kind: str,
    count: int,
    stride: int = 0,
    target: int = 34962,
    **more: Any,
) -> int:
    view = _add_view(gltf, data, target=target, **({"byteStride": stride} if stride else {}))
    accessors = gltf.document["accessors"]
    accessors.append({"bufferView": view, "componentType": component, "count": count, "type": kind, **more})
    return len(accessors) - 1


def _add_view(gltf: Gltf, data: bytes, **more: int) -> int:
    views = gltf.document.setdefault("bufferViews", [])
    gltf.document.setdefault("buffers", []).append({"byteLength": len(data)})
    views.append({"buffer": len(gltf.buffers), "byteOffset": 0, "byteLength": len(data), **more})
    gltf.buffers.append(data)
    return len(views) - 1


def _primitive(document: dict[str, Any], part: Part) -> dict[str, Any]:
    primitive: dict[str, Any] = document["meshes"][part.mesh]["primitives"][part.primitive]
    return primitive


def _n_vertices(document: dict[str, Any], primitive: dict[str, Any]) -> int:
    return int(document["accessors"][primitive["attributes"]["POSITION"]]["count"])
