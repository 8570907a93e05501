from __future__ import annotations

import numpy as np
import pytest
import trimesh

from silint.io import read_mesh
from silint.io.uvs import read_uvs

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UVS = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.25], [0.0, 0.25]])
OBJ = "\n".join(
    [f"v {x} {y} {z}" for x, y, z in VERTICES] + [f"vt {u} {v}" for u, v in UVS] + ["f 1/1 2/2 3/3 4/4", ""]
)


def uvs_of(path):
    return read_uvs(path, len(read_mesh(path).faces))


def test_obj_polygons_are_fans_and_indices_relative(tmp_path):
    path = tmp_path / "square.obj"
    path.write_text(OBJ)
    assert np.array_equal(uvs_of(path), UVS[FACES])
    path.write_text(OBJ.replace("f 1/1 2/2 3/3 4/4", "f -4/-4 -3/-3/ 3/-2 \\\n 4/4 # the last"))
    assert np.array_equal(uvs_of(path), UVS[FACES])
    path.write_text(OBJ.replace("\n", "\r\n") + "f 1/1 2/2 3/3\r\n")
    assert np.array_equal(uvs_of(path), UVS[[*FACES, FACES[0]]])


@pytest.mark.parametrize(
    "line", ["f 1/1 2/2 3", "f 1//1 2//1 3//1", "f 1/1 2/2 3/9", "f 1/-9 2/2 3/3", "f 1 2 3"]
)
def test_obj_with_a_corner_without_one_has_none(tmp_path, line):
    path = tmp_path / "square.obj"
    path.write_text(OBJ + line + "\n")
    assert uvs_of(path) is None


def test_one_coordinate_stands_for_two(tmp_path):
    path = tmp_path / "line.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25\nvt 0.5 0.5 0.1\nf 1/1 2/2 3/1\n")
    assert uvs_of(path).tolist() == [[[0.25, 0.0], [0.5, 0.5], [0.25, 0.0]]]


def textured():
    visual = trimesh.visual.TextureVisuals(uv=UVS.copy())
    return trimesh.Trimesh(VERTICES, FACES, visual=visual, process=False)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_gltf_instances_have_those_of_their_mesh(tmp_path, suffix):
    scene = trimesh.Scene()
    scene.add_geometry(textured(), node_name="a", geom_name="square")
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene.graph.update(frame_to="b", matrix=mirrored, geometry="square")
    path = tmp_path / f"two{suffix}"
    if suffix == ".glb":
        scene.export(path)
    else:
        for name, data in scene.export(file_type="gltf").items():
            (tmp_path / name.replace("model.gltf", path.name)).write_bytes(data)
    data, uvs = read_mesh(path), uvs_of(path)
    # Texture coordinates are those of the positions, mirrored or not: x = +-2 u, y = 4 v.
    places = data.vertices[data.faces]
    np.testing.assert_allclose(np.abs(places[..., 0]), 2 * uvs[..., 0], atol=1e-6)
    np.testing.assert_allclose(places[..., 1], 4 * uvs[..., 1], atol=1e-6)


def test_gltf_without_material_or_without_coordinates(tmp_path):
    from silint.io.glb import glb_bytes

    path = tmp_path / "plain.glb"
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    path.write_bytes(glb_bytes(VERTICES, FACES, normals, {"TEXCOORD_0": UVS * (1, -1) + (0, 1)}, {}))
    np.testing.assert_allclose(uvs_of(path), UVS[FACES], atol=1e-7)
    path.write_bytes(glb_bytes(VERTICES, FACES, normals, {}, {}))
    assert uvs_of(path) is None


def ply(vertex, face="list uchar int vertex_indices", vertex_names=(), face_rows=None):
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertex)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", *vertex_names)]
    head += [f"element face {len(FACES)}", *(f"property {p}" for p in face.split("; ")), "end_header"]
    rows = [" ".join(map(str, row)) for row in vertex]
    rows += face_rows or [f"3 {a} {b} {c}" for a, b, c in FACES]
    return "\n".join([*head, *rows]) + "\n"


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_ply_vertices(tmp_path, names):
    path = tmp_path / "square.ply"
    path.write_text(ply(np.c_[VERTICES, UVS], vertex_names=names))
    np.testing.assert_allclose(uvs_of(path), UVS[FACES])


def test_ply_corners(tmp_path):
    path = tmp_path / "square.ply"
    own = np.random.default_rng(0).random((2, 6)).round(4)
    rows = [f"3 {a} {b} {c} 6 " + " ".join(map(str, row)) for (a, b, c), row in zip(FACES, own, strict=True)]
    face = "list uchar int vertex_indices; list uchar float texcoord"
    path.write_text(ply(VERTICES, face, face_rows=rows))
    np.testing.assert_allclose(uvs_of(path), own.reshape(2, 3, 2), atol=1e-6)


def test_formats_without_any(tmp_path):
    for suffix in (".stl", ".off", ".ply"):
        path = tmp_path / f"plain{suffix}"
        trimesh.Trimesh(VERTICES, FACES, process=False).export(path)
        assert uvs_of(path) is None
