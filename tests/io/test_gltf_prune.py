from __future__ import annotations

import copy

import numpy as np
import pytest

from silint.io.gltf import Gltf, accessor_values, binary_gltf, read_gltf
from silint.io.gltf_prune import pruned
from tests.io.gltf_files import File, Read

POINTS = np.arange(9.0).reshape(3, 3)


def asset(tmp_path):
    """Two meshes with a material each, an animation, a skin, and an accessor and a texture without use."""
    file = File()
    unused = file.accessor([1.0, 2.0])
    textures = [file.image(f"picture {i}".encode()) for i in range(3)]
    file.document["samplers"] = [{"wrapS": 33071}, {"wrapS": 33648}]
    file.document["textures"][1]["sampler"] = 1
    file.document["materials"] = [
        {"emissiveTexture": {"index": textures[0]}},
        {"extensions": {"KHR_materials_sheen": {"sheenColorTexture": {"index": textures[1]}}}},
    ]
    file.document["extensionsUsed"] = ["KHR_materials_sheen"]
    for k in range(2):
        attributes = {"POSITION": file.positions(POINTS + k), "_ROW": file.accessor([k, k, k])}
        target = {"POSITION": file.positions(POINTS * 10 + k)}
        indices = file.accessor([0, 1, 2], "u1")
        file.mesh({"attributes": attributes, "indices": indices, "material": k, "targets": [target]})
        file.node(mesh=k)
    times, turns = file.accessor([0.0, 1.0]), file.accessor(POINTS[:2])
    file.document["animations"] = [{"samplers": [{"input": times, "output": turns}], "channels": []}]
    file.document["skins"] = [{"joints": [0], "inverseBindMatrices": file.accessor(np.eye(4).reshape(1, 16))}]
    gltf = read_gltf(file.write(tmp_path / "source.glb"))
    return gltf, unused


def test_what_lost_its_use_is_gone_and_all_else_says_the_same(tmp_path):
    source, _ = asset(tmp_path)
    document = copy.deepcopy(source.document)
    del document["nodes"][0]["mesh"]
    (tmp_path / "out.glb").write_bytes(binary_gltf(pruned(Gltf(document, source.buffers), source)))
    read = Read(tmp_path / "out.glb")
    d = read.document
    counts = {kind: len(d[kind]) for kind in ("meshes", "materials", "textures", "images", "samplers")}
    # The second mesh with its own, and texture and sampler that had no use before.
    assert counts == {"meshes": 1, "materials": 1, "textures": 2, "images": 2, "samplers": 2}
    assert d["nodes"][1]["mesh"] == 0
    (primitive,) = d["meshes"][0]["primitives"]
    assert np.array_equal(read.values(primitive["attributes"]["POSITION"]), POINTS + 1)
    assert np.array_equal(read.values(primitive["targets"][0]["POSITION"]), POINTS * 10 + 1)
    assert read.values(primitive["attributes"]["_ROW"]).tolist() == [[1.0]] * 3
    assert read.values(primitive["indices"]).ravel().tolist() == [0, 1, 2]
    sheen = d["materials"][primitive["material"]]["extensions"]["KHR_materials_sheen"]["sheenColorTexture"]
    texture = d["textures"][sheen["index"]]
    assert d["samplers"][texture["sampler"]] == {"wrapS": 33648}
    assert read.bytes(d["images"][texture["source"]]["bufferView"]) == b"picture 1"
    assert read.values(0).ravel().tolist() == [1.0, 2.0]
    sampler = d["animations"][0]["samplers"][0]
    assert read.values(sampler["input"]).ravel().tolist() == [0.0, 1.0]
    assert np.array_equal(read.values(sampler["output"]), POINTS[:2])
    assert read.values(d["skins"][0]["inverseBindMatrices"]).ravel().tolist() == np.eye(4).ravel().tolist()
    assert len(read.binary) < len(source.buffers[0])


def test_nothing_changes_where_all_is_in_use(tmp_path):
    source, _ = asset(tmp_path)
    out = pruned(source, source)
    for kind in ("meshes", "materials", "textures", "images", "samplers", "animations", "nodes"):
        assert out.document[kind] == source.document[kind]
    for i in range(len(source.document["accessors"])):
        if source.document["accessors"][i]["type"] != "MAT4":
            assert np.array_equal(accessor_values(out, i), accessor_values(source, i))


@pytest.mark.parametrize("name", ["KHR_materials_variants", "EXT_mesh_gpu_instancing", "MY_extension"])
def test_extensions_that_may_refer_to_anything_keep_all(tmp_path, name):
    source, _ = asset(tmp_path)
    document = copy.deepcopy(source.document)
    del document["nodes"][0]["mesh"]
    document["extensionsUsed"].append(name)
    gltf = Gltf(document, source.buffers)
    assert pruned(gltf, source) is gltf


def test_views_that_overlap_or_begin_anywhere_keep_their_bytes(tmp_path):
    source, unused = asset(tmp_path)
    document = copy.deepcopy(source.document)
    # An accessor three bytes into a view that begins one byte before a multiple of four.
    view = document["accessors"][unused]["bufferView"]
    start = len(source.buffers[0])
    document["bufferViews"][view] |= {"byteOffset": start + 3, "byteLength": 9}
    document["accessors"][unused]["byteOffset"] = 1
    gltf = Gltf(document, [source.buffers[0] + b"\0\0\0\0" + np.array([5.0, 6.0], "<f4").tobytes()])
    (tmp_path / "out.glb").write_bytes(binary_gltf(pruned(gltf, gltf)))
    read = Read(tmp_path / "out.glb")  # which looks at the alignment
    assert read.values(unused).ravel().tolist() == [5.0, 6.0]
    everything = {"buffer": 0, "byteOffset": 0, "byteLength": len(gltf.buffers[0])}
    document["bufferViews"] += [everything, dict(everything)]
    assert pruned(gltf, gltf).buffers == gltf.buffers
