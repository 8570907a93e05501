from __future__ import annotations

import base64
import json
import logging
import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from silint.io import MESH_SUFFIXES, mesh_data, read_mesh
from silint.validation import InputError

# Vertices in no order that a reader would choose, with one that no face uses and two that coincide.
VERTICES = np.array(
    [[5, 0, 0], [-1, 0, 0], [0, 3, 0], [0, 0, 2], [9, 9, 9], [0, 0, 2], [0.5, 0.25, -4]], float
)
FACES = np.array([[3, 1, 2], [6, 0, 1], [2, 0, 5], [3, 0, 1]])


def refusal(path) -> str:
    with pytest.raises(InputError) as caught:
        read_mesh(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


def ply_text(vertices=VERTICES, faces=FACES, kind: str = "float") -> str:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property {kind} {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [" ".join(repr(float(x)) for x in v) for v in vertices]
    return head + "\n".join(rows + [f"3 {a} {b} {c}" for a, b, c in faces]) + "\n"


def obj_text(vertices=VERTICES, faces=FACES) -> str:
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    return "\n".join(rows + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]) + "\n"


def off_text() -> str:
    rows = [f"OFF\n{len(VERTICES)} {len(FACES)} 0"] + [f"{x} {y} {z}" for x, y, z in VERTICES]
    return "\n".join(rows + [f"3 {a} {b} {c}" for a, b, c in FACES]) + "\n"


def written(folder: Path, suffix: str) -> Path:
    """The mesh above as a file of some kind."""
    path = folder / f"shape{suffix}"
    mesh = trimesh.Trimesh(VERTICES, FACES, process=False)
    if suffix == ".ply":
        path.write_text(ply_text())
    elif suffix == ".obj":
        path.write_text(obj_text())
    elif suffix == ".off":
        path.write_text(off_text())
    elif suffix == ".gltf":
        for name, data in trimesh.Scene(mesh).export(file_type="gltf").items():
            (folder / name.replace("model.gltf", path.name)).write_bytes(data)
    else:
        mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_vertices_and_faces_come_back_in_file_order(tmp_path, suffix):
    mesh = read_mesh(written(tmp_path, suffix))
    assert mesh.vertices.dtype == np.float64 and mesh.faces.dtype == np.int64
    assert mesh.name == "shape"
    if suffix == ".stl":  # knows no shared vertices
        assert np.array_equal(mesh.vertices, VERTICES[FACES].reshape(-1, 3))
        assert np.array_equal(mesh.faces, np.arange(12).reshape(-1, 3))
    else:
        assert np.array_equal(mesh.vertices, VERTICES)
        assert np.array_equal(mesh.faces, FACES)
    assert mesh.normals is None
    assert mesh.float32_source


@pytest.mark.parametrize("suffix", [".OBJ", ".Ply"])
def test_suffixes_may_be_in_capitals(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text(obj_text() if suffix == ".OBJ" else ply_text())
    assert np.array_equal(read_mesh(str(path)).vertices, VERTICES)


def test_only_values_that_need_more_than_float32_count_as_float64(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(ply_text(VERTICES + 0.1, kind="double"))
    mesh = read_mesh(path)
    assert not mesh.float32_source
    assert np.array_equal(mesh.vertices, VERTICES + 0.1)


def test_texture_seams_and_images_change_nothing_in_a_ply(tmp_path):
    # trimesh would by default split and reorder vertices by their texture coordinates.
    text = (
        ply_text()
        .replace("comment", "")
        .replace("vertex_indices\n", "vertex_indices\nproperty list uchar float texcoord\n")
    )
    lines = [line + " 6 0 0 1 0 0 1" if line.startswith("3 ") else line for line in text.splitlines()]
    lines.insert(2, "comment TextureFile no-such-image.png")
    path = tmp_path / "a.ply"
    path.write_text("\n".join(lines) + "\n")
    assert np.array_equal(read_mesh(path).vertices, VERTICES)


def test_normals_of_a_ply_are_the_files_own(tmp_path):
    normals = np.arange(21.0).reshape(-1, 3)
    text = ply_text(np.hstack([VERTICES, normals]))
    path = tmp_path / "a.ply"
    path.write_text(
        text.replace(
            "property float z", "property float z\n" + "\n".join(f"property float n{a}" for a in "xyz")
        )
    )
    mesh = read_mesh(path)
    assert np.array_equal(mesh.normals, normals) and np.array_equal(mesh.vertices, VERTICES)


# ------------------------------------------------------------------------------------------ scene graphs


def test_a_scene_graph_is_flattened_with_its_transforms(tmp_path):
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    box = trimesh.Trimesh(box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    box.vertex_normals = np.repeat(box.face_normals, 3, axis=0)
    shear = np.array([[1, 0.5, 0, 10], [0, 2, 0, 0], [0, 0, 3, 0], [0, 0, 0, 1.0]])
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene = trimesh.Scene()
    for matrix in (np.eye(4), shear, mirror):
        scene.add_geometry(box, geom_name="box", transform=matrix)
    path = tmp_path / "three.glb"
    path.write_bytes(scene.export(file_type="glb", include_normals=True))
    mesh = read_mesh(path)
    assert mesh.vertices.shape == (108, 3) and mesh.faces.shape == (36, 3)
    # A turned float32 vertex fills a double, and is a float32 still.
    assert mesh.float32_source
    corners = mesh.vertices[mesh.faces]
    volumes = np.linalg.det(corners).reshape(3, 12).sum(axis=1) / 6.0
    assert np.allclose(mesh.vertices.max(axis=0), [11.5, 2.0, 3.0], rtol=1e-6)
    # Outward winding survives the mirror; 48 = 8 * det(shear).
    assert np.allclose(sorted(volumes), [8.0, 8.0, 48.0], rtol=1e-6)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    own = mesh.normals[mesh.faces]
    own /= np.linalg.norm(own, axis=2, keepdims=True)
    assert np.allclose(own, flat[:, None, :], atol=1e-6)


def test_trimesh_is_kept_quiet_and_its_logger_is_handed_back(tmp_path, monkeypatch, caplog):
    logger = logging.getLogger("trimesh")
    path, load, level = written(tmp_path, ".glb"), trimesh.load_scene, logger.level

    def chatty(*arguments, **options):
        logger.warning("something about textures")
        warnings.warn("something about NumPy", stacklevel=1)
        return load(*arguments, **options)

    monkeypatch.setattr(trimesh, "load_scene", chatty)
    read_mesh(path)
    assert caplog.records == [] and logger.level == level


def test_lines_and_points_beside_a_mesh_are_ignored():
    scene = trimesh.Scene([trimesh.creation.box(), trimesh.PointCloud([[0.0, 0.0, 9.0]])])
    assert len(mesh_data(scene).vertices) == 8


def test_normals_count_only_if_every_part_has_them():
    plain, smooth = trimesh.creation.box(), trimesh.creation.box()
    smooth.vertex_normals = smooth.vertices
    assert mesh_data(smooth).normals is not None
    assert mesh_data(trimesh.Scene([plain, smooth])).normals is None


def test_what_is_no_trimesh_is_refused():
    with pytest.raises(InputError, match="got dict"):
        mesh_data({})


# -------------------------------------------------------------------------------------------------- .obj


def read_obj_text(folder: Path, text: str):
    path = folder / "a.obj"
    path.write_text(text)
    return read_mesh(path)


def test_obj_ignores_materials_groups_and_texture_seams(tmp_path):
    text = (
        "mtllib no-such.mtl\n"
        + obj_text().replace("f 7 1 2", "usemtl b\no part\ng x\ns 1\nf 7/1 1/2 2/3")
        + "vt 0 0\n"
    )
    mesh = read_obj_text(tmp_path, text)
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, FACES)


def test_obj_relative_indices_count_from_where_they_stand(tmp_path):
    mesh = read_obj_text(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nf -4 -1 -2\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 3, 2]]


def test_obj_polygons_are_fans_and_colours_are_no_coordinates(tmp_path):
    text = (
        "v 0 0 0 1 0 0\nv 1 0 0 .5 .5 .5\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nf 1 2 3 4 5 # five\nf 1 2 \\\n 3 4\n"
    )
    mesh = read_obj_text(tmp_path, text.replace("\n", "\r\n"))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 2], [0, 2, 3]]
    assert mesh.vertices[4].tolist() == [-1, 0.5, 0]


def test_obj_smooth_normals_split_nothing(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 7 7 7\nv 1 1 0\nvn 0 0 1\nvn 0 1 0\nvn 1 0 0\n"
    mesh = read_obj_text(tmp_path, text + "f 1//1 2/9/2 3//3\nf 2//2 5//1 3//3\n")
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 4, 2]]
    # A vertex that no face uses has no normal.
    assert mesh.normals.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 1]]


def test_obj_hard_edges_split_vertices_in_file_order(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 0 -1 0\n"
    mesh = read_obj_text(tmp_path, text + "f 1//1 2//1 3//1\nf 1//2 2//2 4//2\n")
    assert mesh.vertices.tolist() == [[0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert mesh.faces.tolist() == [[0, 2, 4], [1, 3, 5]]
    assert mesh.normals.tolist() == [[0, 0, 1], [0, -1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, -1, 0]]


def test_obj_normals_count_only_if_every_corner_has_one(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n"
    assert read_obj_text(tmp_path, text).normals is not None
    assert read_obj_text(tmp_path, text + "f 1 2 3\n").normals is None
    assert read_obj_text(tmp_path, text + "f 1//1 2//1 3//2\n").normals is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "line 4 cannot be understood: 'f 1 2'"),
        ("v 0 0 0\nv 1 0 0\nv 0 1\nf 1 2 3\n", "line 3 cannot be understood"),
        ("v 0 0 zero\n", "line 1 cannot be understood"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3.5\n", "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 4, but there are 3"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "before the first"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "vertices must be finite.*row 1"),
        ("v 0 0 0\nv 1e999 0 0\nv 0 1 0\nf 1 2 3\n", "vertices must be finite.*row 1"),
    ],
)
def test_obj_lines_that_make_no_sense_are_named(tmp_path, text, told):
    path = tmp_path / "bad.obj"
    path.write_text(text)
    message = refusal(path)
    assert message.startswith(f"{path}: ") and re.search(told, message), message


# --------------------------------------------------------------------------------------------- bad files


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95])
def test_files_that_were_cut_short_are_refused(tmp_path, capfd, suffix, share):
    whole = written(tmp_path, suffix)
    cut = tmp_path / f"cut{suffix}"
    data = whole.read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    assert refusal(cut).startswith(f"{cut}: ")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("binary", [True, False])
def test_an_stl_that_was_cut_short_is_told_from_an_empty_one(tmp_path, binary):
    path = tmp_path / "a.stl"
    mesh = trimesh.creation.box()
    data = mesh.export(file_type="stl" if binary else "stl_ascii")
    path.write_bytes(data if binary else data.encode())
    assert len(read_mesh(path).faces) == 12
    path.write_bytes(path.read_bytes()[:-60])
    assert "cut short" in refusal(path)


def test_a_binary_stl_may_begin_like_a_text_one(tmp_path):
    path = tmp_path / "a.stl"
    data = trimesh.creation.box().export(file_type="stl")
    path.write_bytes(b"solid by some exporter".ljust(80, b" ") + data[80:])
    assert len(read_mesh(path).faces) == 12


def test_a_binary_ply_that_was_cut_short(tmp_path):
    path = tmp_path / "a.ply"
    data = trimesh.creation.box().export(file_type="ply")
    path.write_bytes(data[:-5])
    assert "cut short" in refusal(path)


def test_a_text_ply_with_fewer_rows_than_announced(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text("\n".join(ply_text().splitlines()[:-1]) + "\n")
    assert re.search("announces 4 rows of 'face' but has 3", refusal(path))


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
@pytest.mark.parametrize(
    "content", [b"", b"hello world\n" * 20, bytes(range(256)) * 8], ids=["empty", "text", "bytes"]
)
def test_files_that_are_no_meshes_are_refused(tmp_path, capfd, suffix, content):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    assert refusal(path).startswith(f"{path}: ")
    assert capfd.readouterr() == ("", "")


def test_a_gltf_whose_data_file_is_missing(tmp_path):
    path = written(tmp_path, ".gltf")
    for other in tmp_path.glob("*.bin"):
        other.unlink()
    assert re.search(r"shape\.gltf: cannot be read", refusal(path))


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_points_without_faces_are_no_mesh(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    trimesh.PointCloud(VERTICES).export(path)
    assert "no triangles" in refusal(path)


@pytest.mark.parametrize("index", [-1, 7, 2**31 - 1])
def test_indices_out_of_range_are_refused(tmp_path, index):
    path = tmp_path / "a.ply"
    path.write_text(ply_text(faces=[*FACES, (0, 1, index)]))
    assert re.search(r"a\.ply: faces has indices outside 0\.\.6.*row 4", refusal(path))


def test_vertices_that_are_not_finite_are_refused(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(ply_text().replace("9.0 9.0 9.0", "9.0 nan inf"))
    assert re.search(r"a\.ply: vertices must be finite.*row 4", refusal(path))


def test_paths_that_lead_to_no_mesh(tmp_path):
    assert refusal(tmp_path / "none.obj") == f"{tmp_path / 'none.obj'}: no such file"
    assert "is a folder" in refusal(tmp_path)
    (tmp_path / "a.xyzzy").write_text("x")
    message = refusal(tmp_path / "a.xyzzy")
    assert "unknown suffix '.xyzzy'" in message and ".obj .ply .stl .glb .gltf .off" in message
    (tmp_path / "plain").write_text("x")
    assert "unknown suffix ''" in refusal(tmp_path / "plain")
    assert "expected a string or a path" in refusal(3)
    assert "no such file" in refusal("zero\0byte.obj")
    assert len(refusal("x" * 5000 + ".obj")) < 200


# ------------------------------------------------------------------------------------------------ groups

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.mark.parametrize(
    ("lines", "groups", "of_face"),
    [
        ("f 1 2 3\nf 1 2 3\n", (), None),
        ("o a\nf 1 2 3\no b\nf 1 2 3\nf 1 2 3\n", ("a", "b"), [0, 1, 1]),
        ("g a\nf 1 2 3\ng b c\nf 1 2 3\n", ("a", "b c"), [0, 1]),
        # Objects count where there are any, whatever groups they are made of.
        ("o car\ng wheel\nf 1 2 3\ng body\nf 1 2 3\no road\nf 1 2 3\n", ("car", "road"), [0, 0, 1]),
        # What stands before the first, a name that comes again, one without faces, and one without a name.
        ("f 1 2 3\no a\nf 1 2 3\no b\no c\nf 1 2 3\no a\nf 1 2 3\n", ("default", "a", "c"), [0, 1, 2, 1]),
        ("o\nf 1 2 3\n", ("default",), [0]),
        # A polygon's triangles stay together.
        ("v 1 1 0\no a\nf 1 2 4 3\no b\nf 1 2 3\n", ("a", "b"), [0, 0, 1]),
    ],
)
def test_obj_groups(tmp_path, lines, groups, of_face):
    mesh = read_obj_text(tmp_path, TRIANGLE + lines)
    assert mesh.groups == groups
    if of_face is None:
        assert mesh.face_groups is None
    else:
        assert mesh.face_groups.dtype == np.int32 and mesh.face_groups.tolist() == of_face


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_obj_names_may_be_of_any_encoding(tmp_path, encoding):
    (tmp_path / "a.obj").write_bytes((TRIANGLE + "o Gl\u00fchlampe\nf 1 2 3\n").encode(encoding))
    assert read_mesh(tmp_path / "a.obj").groups == ("Gl\u00fchlampe",)


def gltf_document(nodes: list[dict]) -> dict:
    """Two meshes, of one triangle and of two, each with a material of its own."""
    data = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    primitive = {"attributes": {"POSITION": 0}}
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "materials": [{"name": "red"}, {"name": "blue"}],
        "meshes": [
            {"primitives": [{**primitive, "material": 0}]},
            {"primitives": [{**primitive, "material": 0}, {**primitive, "material": 1}]},
        ],
        "nodes": nodes,
        "scenes": [{"nodes": [i for i in range(len(nodes)) if i != 2]}],
        "scene": 0,
    }


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
def test_gltf_nodes_are_groups_whatever_they_are_made_of(tmp_path, suffix):
    nodes = [
        {"name": "car", "mesh": 1},
        {"name": "bike", "mesh": 0, "children": [2]},
        {"name": "bike_wheels", "mesh": 0},  # a child that is called as trimesh calls parts
        {"mesh": 0},
    ]
    text = json.dumps(gltf_document(nodes)).encode()
    if suffix == ".glb":
        text += b" " * (-len(text) % 4)
        head = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text), len(text), 0x4E4F534A)
        text = head + text
    path = tmp_path / f"a{suffix}"
    path.write_bytes(text)
    mesh = read_mesh(path)
    counts = dict(zip(mesh.groups, np.bincount(mesh.face_groups).tolist(), strict=True))
    assert counts == {"car": 2, "bike": 1, "bike_wheels": 1, "3": 1}


def test_other_formats_have_no_groups(tmp_path):
    for suffix in (".ply", ".stl", ".off"):
        mesh = read_mesh(written(tmp_path, suffix))
        assert mesh.groups == () and mesh.face_groups is None
    box = trimesh.creation.box()
    assert mesh_data(box).groups == ()
    scene = trimesh.Scene({"a": box, "b": box})
    assert len(mesh_data(scene).groups) == 2 and len(mesh_data(scene).face_groups) == 24
