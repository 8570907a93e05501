from __future__ import annotations

import json

import numpy as np
import pytest

from silint import InputError
from silint.io import read_mesh
from silint.io.gltf import (
    Gltf,
    accessor_rows,
    accessor_values,
    binary_gltf,
    gltf_parts,
    read_gltf,
)
from tests.io.gltf_files import File, Read

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)


def small():
    """A triangle of three nodes: one has a mesh of two primitives and of lines, one is mirrored."""
    file = File()
    one = {"attributes": {"POSITION": file.positions(TRIANGLE)}}
    two = {
        "attributes": {"POSITION": file.positions(TRIANGLE + 2), "_OWN": file.accessor(np.ones(3))},
        "indices": file.accessor([2, 1, 0], "u1"),
    }
    lines = {"attributes": {"POSITION": file.positions(TRIANGLE)}, "mode": 1}
    pair, single = file.mesh(one, lines, two, name="same"), file.mesh(one, name="same")
    file.node(mesh=single, name="world")
    file.node(mesh=pair, name="same", scale=[1, 1, -1])
    file.node(name="empty")
    file.node(mesh=single, name="same")
    return file


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_parts_are_those_that_a_mesh_is_made_of(tmp_path, suffix):
    path = small().write(tmp_path / f"a{suffix}")
    gltf = read_gltf(path)
    parts, mesh = gltf_parts(gltf, path), read_mesh(path)
    assert sorted(part[:3] for part in parts) == [(0, 1, 0), (1, 0, 0), (1, 0, 2), (3, 1, 0)]
    assert [part.mirrored for part in parts] == [part.node == 1 for part in parts]
    corners = []
    for part in parts:
        primitive = gltf.document["meshes"][part.mesh]["primitives"][part.primitive]
        rows = part.faces[:, [0, 2, 1]] if part.mirrored else part.faces
        scale = (1, 1, -1) if part.mirrored else (1, 1, 1)
        corners.append(accessor_values(gltf, primitive["attributes"]["POSITION"])[rows] * scale)
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], np.concatenate(corners))
    # Nothing was changed on the way, and what is written says the same.
    assert gltf.document["nodes"][1]["name"] == "same"
    (tmp_path / "b.glb").write_bytes(binary_gltf(gltf))
    again = Read(tmp_path / "b.glb").document
    assert again["meshes"] == gltf.document["meshes"] and again["nodes"] == gltf.document["nodes"]
    assert np.array_equal(read_mesh(tmp_path / "b.glb").vertices, mesh.vertices)


@pytest.mark.parametrize(
    ("dtype", "values", "expected"),
    [
        ("u1", [0, 51, 255], [0.0, 0.2, 1.0]),
        ("i1", [-128, -127, 127], [-1.0, -1.0, 1.0]),
        ("u2", [0, 13107, 65535], [0.0, 0.2, 1.0]),
        ("f4", [0.5, -3.0, 2.0], [0.5, -3.0, 2.0]),
    ],
)
@pytest.mark.parametrize("stride", [0, 12])
def test_integers_may_stand_for_fractions(tmp_path, dtype, values, expected, stride):
    file = File()
    file.accessor([7.0])
    index = file.accessor(
        np.repeat(np.array(values)[:, None], 2, axis=1), dtype, stride, normalized=dtype != "f4"
    )
    gltf = read_gltf(file.write(tmp_path / "a.gltf"))
    np.testing.assert_allclose(
        accessor_values(gltf, index), np.repeat(np.c_[expected], 2, axis=1), rtol=1e-15
    )
    del gltf.document["accessors"][index]["normalized"]
    assert np.array_equal(accessor_values(gltf, index)[:, 0], values)
    assert accessor_rows(gltf, index).dtype == np.uint8


def test_buffers_of_many_kinds_become_one(tmp_path):
    file = small()
    path = file.write(tmp_path / "a.gltf")
    document = json.loads(path.read_text())
    (tmp_path / "second part.bin").write_bytes(b"abcde")
    document["buffers"].append({"byteLength": 5, "uri": "second%20part.bin"})
    document["bufferViews"].append({"buffer": 1, "byteOffset": 1, "byteLength": 3})
    path.write_text(json.dumps(document))
    gltf = read_gltf(path)
    assert gltf.buffers == [file.data, b"abcde"]
    (tmp_path / "b.glb").write_bytes(binary_gltf(gltf))
    read = Read(tmp_path / "b.glb")
    assert read.binary[: len(file.data)] == file.data
    view = read.document["bufferViews"][-1]
    assert read.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] == b"bcd"


def test_bad_files_are_told_in_one_line(tmp_path):
    def told(document, words):
        path = tmp_path / "bad.gltf"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        with pytest.raises(InputError, match=words) as caught:
            read_gltf(path)
        assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)

    told("{", "its JSON makes no sense")
    told("[]", "its JSON makes no sense")
    told({"buffers": [{"uri": "data:,"}]}, "its JSON makes no sense")  # no length
    told({"buffers": [{"byteLength": 9, "uri": "data:;base64,AAAA"}]}, "buffer 0 ends early")
    told({"buffers": [{"byteLength": 9, "uri": "data:;base64,A?"}]}, "data URI that is not base64")
    told({"buffers": [{"byteLength": 9, "uri": "no.bin"}]}, "refers to 'no.bin', which cannot be read")


def test_sparse_accessors_have_their_values(tmp_path):
    file = File()
    dense = np.arange(15.0).reshape(5, 3)
    for base in (True, False):
        index = file.accessor(dense)
        accessor = file.document["accessors"][index]
        if not base:
            del accessor["bufferView"]
        accessor["sparse"] = {
            "count": 2,
            "indices": {"bufferView": file.view(np.array([9, 1, 4], "<u2").tobytes()), "componentType": 5123},
            "values": {"bufferView": file.view(np.full((2, 3), -1, "<f4").tobytes())},
        }
        accessor["sparse"]["indices"]["byteOffset"] = 2
        expected = dense * base
        expected[[1, 4]] = -1.0
        gltf = read_gltf(file.write(tmp_path / "a.glb"))
        assert np.array_equal(accessor_values(gltf, index), expected)
    accessor["sparse"]["indices"]["byteOffset"] = 0
    with pytest.raises(InputError, match=f"accessor {index} has sparse values beyond its end"):
        accessor_rows(read_gltf(file.write(tmp_path / "a.glb")), index)
    del accessor["sparse"]
    assert not accessor_rows(read_gltf(file.write(tmp_path / "a.glb")), index).any()


def test_accessors_that_hold_nothing_of_use(tmp_path):
    view, buffer = {"buffer": 0, "byteLength": 8}, bytes(8)
    good = {"bufferView": 0, "componentType": 5126, "count": 2, "type": "SCALAR"}
    for change, words in [
        ({"count": 3}, "leaves its buffer"),
        ({"count": 0}, "leaves its buffer"),
        ({"byteOffset": 4}, "leaves its buffer"),
        ({"type": "MAT4"}, "expected scalars or vectors"),
        ({"componentType": 5130}, "components of type 5130"),
    ]:
        gltf = Gltf({"accessors": [good | change], "bufferViews": [view]}, [buffer])
        with pytest.raises(InputError, match=words):
            accessor_rows(gltf, 0)
    gltf = Gltf({"accessors": [good], "bufferViews": [view]}, [buffer])
    assert accessor_rows(gltf, 0).shape == (2, 4)
