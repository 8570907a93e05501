"""What a change of a glTF document has left without use, taken out."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

from silint.io.gltf import Gltf

__all__ = ["pruned"]

# Kinds of items, each before those that its own items refer to.
_KINDS = ("meshes", "materials", "textures", "images", "samplers", "accessors", "bufferViews")

# Extensions that refer to items by no other keys than `_references` knows; others might by any.
_KNOWN = (
    *("KHR_texture_transform", "KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif"),
    *("KHR_mesh_quantization", "KHR_lights_punctual"),
)


def pruned(gltf: Gltf, source: Gltf) -> Gltf:
    """A file without what its source used and it does not: vertices that were split, a picture replaced.

    What nothing in the source refers to stays, and all does if there are extensions that may refer to
    anything.

    Parameters
    ----------
    gltf : Gltf
        The source with items changed or appended.
    source : Gltf

    Returns
    -------
    Gltf
    """
    for name in gltf.document.get("extensionsUsed", ()):
        if name not in _KNOWN and not (
            name.startswith("KHR_materials_") and name != "KHR_materials_variants"
        ):
            return gltf
    document = copy.deepcopy(gltf.document)
    for kind in _KINDS:
        before = {item[key] for item, key in _references(source.document, kind)}
        now = [*_references(document, kind)]
        unused = before - {item[key] for item, key in now}
        kept = [i for i in range(len(document.get(kind, ()))) if i not in unused]
        row = {old: new for new, old in enumerate(kept)}
        for item, key in now:
            item[key] = row[item[key]]
        if kind in document:
            document[kind] = [document[kind][i] for i in kept]
            if not kept:
                del document[kind]
    return _packed(Gltf(document, gltf.buffers))


def _references(document: dict[str, Any], kind: str) -> Iterator[tuple[dict[str, Any], str]]:
    """Every place that holds the number of an item of a kind, as a dictionary and a key."""
    primitives = [p for mesh in document.get("meshes", ()) for p in mesh["primitives"]]
    places: list[tuple[dict[str, Any], str]] = []
    if kind == "meshes":
        places = [(node, "mesh") for node in document.get("nodes", ())]
    elif kind == "materials":
        places = [(primitive, "material") for primitive in primitives]
    elif kind == "textures":
        places = [(info, "index") for info in _texture_infos(document.get("materials", ()))]
    elif kind in ("images", "samplers"):
        textures = document.get("textures", [])
        extended = [e for texture in textures for e in texture.get("extensions", {}).values()]
        key = "source" if kind == "images" else "sampler"
        places = [(item, key) for item in textures + extended]
    elif kind == "accessors":
        groups = [g for p in primitives for g in (p["attributes"], *p.get("targets", ()))]
        places = [(group, name) for group in groups for name in group]
        places += [(primitive, "indices") for primitive in primitives]
        places += [(skin, "inverseBindMatrices") for skin in document.get("skins", ())]
        samplers = [s for animation in document.get("animations", ()) for s in animation["samplers"]]
        places += [(sampler, key) for sampler in samplers for key in ("input", "output")]
    else:
        accessors = document.get("accessors", [])
        sparse = [a["sparse"][key] for a in accessors if "sparse" in a for key in ("indices", "values")]
        places = [(item, "bufferView") for item in [*accessors, *sparse, *document.get("images", ())]]
    return ((item, key) for item, key in places if key in item)


def _texture_infos(item: Any) -> Iterator[dict[str, Any]]:
    """All ``...Texture`` of materials and of their extensions."""
    if isinstance(item, dict):
        for key, value in item.items():
            if key.endswith("Texture") and isinstance(value, dict):
                yield value
            elif key != "extras":
                yield from _texture_infos(value)
    elif isinstance(item, list | tuple):
        for value in item:
            yield from _texture_infos(value)


def _packed(gltf: Gltf) -> Gltf:
    """A buffer for each view, unless views overlap so much that this takes more room."""
    views = gltf.document.get("bufferViews", [])
    if sum(view["byteLength"] for view in views) > sum(len(data) for data in gltf.buffers):
        return gltf
    buffers = []
    for view in views:
        start = view.get("byteOffset", 0)
        # Accessors may make up for a view that begins between multiples of four.
        lead = start % 4
        buffers.append(b"\0" * lead + gltf.buffers[view["buffer"]][start : start + view["byteLength"]])
        view["buffer"], view["byteOffset"] = len(buffers) - 1, lead
    gltf.document["buffers"] = [{"byteLength": len(data)} for data in buffers]
    return Gltf(gltf.document, buffers)
