from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

import silint
from silint import InputError
from silint.texture import bake_texture
from tests.io.gltf_files import File, Read
from tests.texture.shapes import box, grid

PNG = io.BytesIO()
Image.fromarray(np.full((4, 4, 3), (200, 30, 30), np.uint8)).save(PNG, "png")
PNG = PNG.getvalue()
PLAIN = {"emptied": 0, "variants": False}


def indexed(vertices, faces, uvs):
    """Vertices that have one coordinate each, v down."""
    rows = np.concatenate([vertices[faces].reshape(-1, 3), uvs.reshape(-1, 2) * (1, -1) + (0, 1)], axis=1)
    rows, index = np.unique(rows, axis=0, return_inverse=True)
    return rows[:, :3], rows[:, 3:], index.ravel()


def two_boxes(overlapping=True):
    """A box twice, one of them mirrored and beside the other, over a floor without a material.

    Or alone. The two have eight vertices, with coordinates by which opposite sides lie on one another.
    """
    file = File()
    vertices, faces, uvs = box(floor=False)
    if overlapping:
        uvs = vertices[faces][..., :2]
    positions, uv, index = indexed(vertices, faces, uvs)
    n = len(positions)
    base = file.image(PNG)
    file.document["materials"] = [
        {"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": base}}, "alphaMode": "MASK"},
        {"name": "spare", "occlusionTexture": {"index": base, "strength": 0.5}},
    ]
    uint = np.arange(n) % 200
    primitive = {
        "attributes": {
            "POSITION": file.positions(positions),
            "TEXCOORD_0": file.accessor(np.rint(65535 * uv), "u2", normalized=True),
            "COLOR_0": file.accessor(np.stack([uint, uint, uint], axis=1), "u1", 4, normalized=True),
            "_ID": file.accessor(np.arange(n, dtype=float)),
        },
        "indices": file.accessor(index, "u2"),
        "material": 0,
        "targets": [{"POSITION": file.positions(0.1 * positions), "NORMAL": file.accessor(positions)}],
    }
    # One target is sparse, as Blender writes them.
    normal = file.document["accessors"][primitive["targets"][0]["NORMAL"]]
    normal["sparse"] = {
        "count": 1,
        "indices": {"bufferView": file.view(b"\3\0\0\0"), "componentType": 5125},
        "values": {"bufferView": file.view(np.full(3, 7.0, "<f4").tobytes())},
    }
    moved = positions.copy()
    moved[3] = 7.0
    file.moved = moved
    half = len(index) // 2 // 3 * 3
    second = json.loads(json.dumps(primitive))
    primitive["indices"] = file.accessor(index[:half], "u2")
    second["indices"], second["material"] = file.accessor(index[half:], "u1"), 1
    mesh = file.mesh(primitive, second, weights=[0.0], name="box")
    file.node(mesh=mesh, name="left", extras={"kept": [1]})
    if overlapping:
        file.node(mesh=mesh, name="right", scale=[-1.0, 1.0, 1.0], translation=[3.0, 0.0, 0.0])
    floor, _, _ = grid((-3.0, -3.0, -0.25), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0))
    flat = {"POSITION": file.positions(floor[[0, 1, 2, 3]])}
    file.node(mesh=file.mesh({"attributes": flat, "mode": 5}), name="floor")  # a strip, without indices
    return file


def world(node, points):
    scale, translation = np.array(node.get("scale", (1, 1, 1))), np.array(node.get("translation", (0, 0, 0)))
    return points * scale + translation


def triangles(read, primitive):
    n = len(read.values(primitive["attributes"]["POSITION"]))
    index = read.values(primitive["indices"]).ravel() if "indices" in primitive else np.arange(n)
    if primitive.get("mode", 4) == 5:
        assert n == 4
        index = index[[0, 1, 2, 2, 1, 3]]
    return index.reshape(-1, 3).astype(int)


def occlusion(read, primitive):
    """The picture and the coordinates that a viewer takes."""
    document = read.document
    info = document["materials"][primitive["material"]]["occlusionTexture"]
    texture = document["textures"][info["index"]]
    assert document["samplers"][texture["sampler"]]["wrapS"] == 33071
    image = document["images"][texture["source"]]
    with Image.open(io.BytesIO(read.bytes(image["bufferView"]))) as picture:
        pixels = np.array(picture) / 255.0
    uv = read.values(primitive["attributes"][f"TEXCOORD_{info.get('texCoord', 0)}"])
    return pixels, uv / (65535.0 if uv.dtype == np.uint16 else 1.0)


def check_what_is_seen(path, source, names):
    """Lookups at places within the faces of an output, against the integrator there."""
    read = Read(path)
    integrator = silint.SilhouetteIntegrator(source)
    shown = [node for node in read.document["nodes"] if "mesh" in node]
    assert [node["name"] for node in shown] == names
    for node in shown:
        for primitive in read.document["meshes"][node["mesh"]]["primitives"]:
            faces = triangles(read, primitive)
            pixels, uv = occlusion(read, primitive)
            corners = world(node, read.values(primitive["attributes"]["POSITION"])[faces])
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normals *= np.sign(np.prod(node.get("scale", (1, 1, 1))))
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            for weights in ((0.4, 0.3, 0.3), (0.2, 0.2, 0.6)):
                points = np.einsum("i,fij->fj", weights, corners)
                expected = integrator.ambient_occlusion(points, normals, isolines=64)
                at = np.einsum("i,fij->fj", weights, uv[faces]) * len(pixels) - 0.5
                i, j = at.astype(int).T
                fx, fy = (at - (np.stack([i, j], axis=1))).T
                rows = [
                    pixels[j + b, i + a] * abs(1 - a - fx) * abs(1 - b - fy) for a in (0, 1) for b in (0, 1)
                ]
                # A step of 8 bits, and the change over half a texel.
                np.testing.assert_allclose(sum(rows), expected, atol=0.02)
    return read


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_source_keeps_all_and_gets_the_occlusion(tmp_path, suffix):
    pytest.importorskip("xatlas")
    file = two_boxes()
    path = file.write(tmp_path / f"boxes{suffix}")
    summary = bake_texture(path, tmp_path / "out.glb", 128, isolines=64)
    assert summary["uv"] == "unwrapped" and "left_out" not in summary
    # The boxes lie on one another in their own coordinates; the floor has none before.
    assert summary["asset"] == {"materials": 3, "replaced": 1, "texcoord": [0, 1], **PLAIN}
    read = check_what_is_seen(tmp_path / "out.glb", path, ["left", "right", "floor"])
    d, old = read.document, file.document
    assert d["asset"]["generator"] == "by hand" and d["asset"]["extras"]["silint"]["quantity"] == "ao"
    assert d["nodes"][0]["extras"] == {"kept": [1]} and d["nodes"][1]["scale"] == [-1.0, 1.0, 1.0]
    red, spare, white = d["materials"]
    assert red == {**old["materials"][0], "occlusionTexture": {"index": 1, "texCoord": 1}}
    assert spare == {"name": "spare", "occlusionTexture": {"index": 1, "texCoord": 1}}
    assert white["occlusionTexture"] == {"index": 1}
    assert read.bytes(d["images"][0]["bufferView"]) == PNG
    # Whatever else a vertex has went with it.
    before = Read(file.write(tmp_path / "plain.glb"))
    for node in d["nodes"][:2]:
        mesh = d["meshes"][node["mesh"]]
        assert mesh["weights"] == [0.0] and mesh["name"] == "box"
        for primitive, source in zip(mesh["primitives"], old["meshes"][0]["primitives"], strict=True):
            rows = read.values(primitive["attributes"]["_ID"]).ravel().astype(int)
            for name in ("POSITION", "TEXCOORD_0", "COLOR_0"):
                values = before.values(source["attributes"][name])
                assert np.array_equal(read.values(primitive["attributes"][name]), values[rows])
            target, values = (
                primitive["targets"][0]["POSITION"],
                before.values(source["targets"][0]["POSITION"]),
            )
            assert np.array_equal(read.values(target), values[rows])
            assert np.array_equal(read.values(primitive["targets"][0]["NORMAL"]), file.moved[rows])
            colors = d["accessors"][primitive["attributes"]["COLOR_0"]]
            assert colors["normalized"] and d["bufferViews"][colors["bufferView"]]["byteStride"] == 4
            assert np.array_equal(rows[triangles(read, primitive)], triangles(before, source))


def test_a_second_bake_takes_the_coordinates_of_the_first(tmp_path):
    pytest.importorskip("xatlas")
    path = two_boxes().write(tmp_path / "boxes.glb")
    bake_texture(path, tmp_path / "one.glb", 64, isolines=8)
    summary = bake_texture(tmp_path / "one.glb", tmp_path / "two.glb", 128, isolines=64)
    assert summary["uv"] == "file" and summary["asset"] == {
        "materials": 3,
        "replaced": 3,
        "texcoord": [0, 1],
        **PLAIN,
    }
    one, two = Read(tmp_path / "one.glb").document, Read(tmp_path / "two.glb").document
    assert [len(two[kind]) for kind in ("meshes", "materials", "textures", "images", "accessors")] == [
        len(one[kind]) for kind in ("meshes", "materials", "textures", "images", "accessors")
    ]
    check_what_is_seen(tmp_path / "two.glb", path, ["left", "right", "floor"])


def test_coordinates_that_fit_are_used_as_they_are(tmp_path):
    file = two_boxes(overlapping=False)
    del file.document["nodes"][-1], file.document["scenes"][0]["nodes"][-1]
    path = file.write(tmp_path / "box.glb")
    summary = bake_texture(path, tmp_path / "out.glb", 128, isolines=64)
    assert summary["uv"] == "file"
    assert summary["asset"] == {"materials": 2, "replaced": 1, "texcoord": [0], **PLAIN}
    read = check_what_is_seen(tmp_path / "out.glb", path, ["left"])
    assert read.document["meshes"] == file.document["meshes"]


def test_a_group_alone_leaves_the_others_without_a_mesh(tmp_path):
    pytest.importorskip("xatlas")
    file = two_boxes()
    # The floor shows one of the materials too.
    file.document["meshes"][1]["primitives"][0]["material"] = 0
    path = file.write(tmp_path / "boxes.glb")
    summary = bake_texture(path, tmp_path / "out.glb", 128, isolines=64, groups=["right"])
    expected = {"materials": 2, "replaced": 1, "texcoord": [1], "emptied": 2, "variants": False}
    assert summary["asset"] == expected
    read = check_what_is_seen(tmp_path / "out.glb", path, ["right"])
    d = read.document
    # The floor and its material are in no use any longer.
    assert len(d["nodes"]) == 3 and len(d["meshes"]) == 1
    assert [(m["name"], "occlusionTexture" in m) for m in d["materials"]] == [("spare", True), ("red", True)]
    assert sum(view["byteLength"] for view in d["bufferViews"]) > len(read.binary) - 4 * len(d["bufferViews"])


def test_meshes_of_other_scenes_are_left_alone(tmp_path):
    pytest.importorskip("xatlas")
    file = two_boxes()
    file.document["nodes"].append({"mesh": 0, "name": "elsewhere"})
    file.document["scenes"].append({"nodes": [3]})
    path = file.write(tmp_path / "boxes.glb")
    summary = bake_texture(path, tmp_path / "out.glb", 64, isolines=8)
    assert summary["asset"] == {"materials": 3, "replaced": 1, "texcoord": [0, 1], **PLAIN}
    d = Read(tmp_path / "out.glb").document
    assert d["nodes"][3] == file.document["nodes"][3] and d["meshes"][0] == file.document["meshes"][0]
    assert d["materials"][:2] == file.document["materials"]
    assert len({node["mesh"] for node in d["nodes"]}) == 4


def test_pictures_beside_a_file_go_into_the_output(tmp_path):
    file = two_boxes(overlapping=False)
    del file.document["nodes"][-1], file.document["scenes"][0]["nodes"][-1]
    file.document["images"] = [{"uri": "sub%20folder/red.PNG"}]
    path = file.write(tmp_path / "box.gltf")
    out = tmp_path / "elsewhere.glb"
    with pytest.raises(InputError, match=r"box.gltf: refers to 'sub%20folder/red.PNG', which cannot be read"):
        bake_texture(path, out, 16, isolines=4)
    assert not out.exists()
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "red.PNG").write_bytes(PNG)
    bake_texture(path, out, 16, isolines=4)
    read = Read(out)
    image = read.document["images"][0]
    assert "uri" not in image and image["mimeType"] == "image/png" and read.bytes(image["bufferView"]) == PNG
    file.document["images"] = [{"uri": "red.tga"}]
    file.write(path)
    with pytest.raises(InputError, match=r"refers to the picture 'red.tga'; expected \.png"):
        bake_texture(path, out, 16, isolines=4)


def test_what_is_left_out_is_named(tmp_path):
    file = two_boxes(overlapping=False)
    path = file.write(tmp_path / "box.glb")
    out = tmp_path / "out.glb"
    summary = bake_texture(path, out, 16, "bent", isolines=4)
    names = ["materials", "textures", "vertex colors", "texture coordinates", "morph targets", "nodes"]
    assert summary["left_out"] == names and "bent" in summary["left_out_reason"] and "asset" not in summary
    summary = bake_texture(path, out, 16, isolines=4)
    assert "left_out" not in summary and len(Read(out).document["materials"]) == 3
    file.document["extensionsUsed"] = ["KHR_materials_variants"]
    assert bake_texture(file.write(path), out, 16, isolines=4)["asset"]["variants"] is True
    # trimesh leaves compressed parts at zero, but warns; a name alone does for what is tested here.
    file.document["extensionsUsed"] = ["EXT_meshopt_compression"]
    summary = bake_texture(file.write(path), out, 16, isolines=4)
    assert summary["left_out"] == names
    assert summary["left_out_reason"] == "it is compressed by EXT_meshopt_compression"
    assert len(Read(out).document["materials"]) == 1
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n{}f 1/1 2/2 3/3\n"
    for extra, left in (("usemtl red\n", ["materials"]), ("", None)):
        obj = tmp_path / "mesh.obj"
        obj.write_text(text.format(extra))
        assert bake_texture(obj, out, 16, isolines=4).get("left_out") == left
        assert "left_out" not in bake_texture(obj, tmp_path / "out.png", 16, isolines=4)
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    header += (
        "property float u\nproperty float v\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
    )
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ply = tmp_path / "mesh.ply"
    ply.write_text(header + "0 0 0 0 0 9 9 9\n1 0 0 1 0 9 9 9\n0 1 0 0 1 9 9 9\n3 0 1 2\n")
    assert bake_texture(ply, out, 16, isolines=4)["left_out"] == ["vertex colors"]
