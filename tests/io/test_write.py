from __future__ import annotations

import json
import os
import stat
import struct

import numpy as np
import pytest
import trimesh

from silint.io import Baked, check_output, read_mesh, read_values, write_baked, write_bytes
from silint.io import write as write_module
from silint.io.glb import glb_bytes
from silint.io.unfinished import discard_unfinished
from silint.validation import InputError

BOX = trimesh.creation.box((1.0, 2.0, 3.0))
VERTICES = np.array(BOX.vertices) + 0.1  # needs all of a double
FACES = np.array(BOX.faces)
SUFFIXES = (".npz", ".ply", ".glb")


def baked(quantity: str = "ao", per: str = "vertex", vertices=VERTICES) -> Baked:
    points = vertices if per == "vertex" else vertices[FACES].mean(axis=1)
    rng = np.random.default_rng(1)
    value = rng.random((len(points), 3) if quantity == "bent" else len(points))
    normals = np.where(np.arange(len(points))[:, None] == 2, 0.0, [0.0, 0.6, 0.8])
    metadata = {"quantity": quantity, "per": per, "note": 'ä "quoted"\nline'}
    return Baked(quantity, per, value, points, normals, vertices, FACES, metadata)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize("quantity", ["ao", "sky", "bent"])
def test_values_come_back(tmp_path, suffix, per, quantity):
    path, result = tmp_path / f"out{suffix}", baked(quantity, per)
    write_baked(path, result)
    value = read_values(path, quantity)
    if suffix == ".glb":
        expected = result.value if per == "vertex" else np.repeat(result.value, 3, axis=0)
        assert np.array_equal(value, expected.astype(np.float32))
    else:
        assert np.array_equal(value, result.value)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with pytest.raises(InputError, match="holds no"):
        read_values(path, "ao" if quantity == "sky" else "sky")


def test_npz_holds_four_arrays(tmp_path):
    result = baked()
    write_baked(tmp_path / "a.npz", result)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        assert sorted(data) == ["metadata", "normals", "points", "value"]
        assert np.array_equal(data["points"], result.points)
        assert np.array_equal(data["normals"], result.normals)
        assert json.loads(str(data["metadata"])) == result.metadata


@pytest.mark.parametrize("per", ["vertex", "face"])
def test_ply_keeps_the_mesh_to_the_last_bit(tmp_path, per):
    write_baked(tmp_path / "a.ply", baked(per=per))
    mesh = read_mesh(tmp_path / "a.ply")
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, FACES)
    assert not mesh.float32_source


def test_ply_of_float32_vertices_stays_float32(tmp_path):
    vertices = VERTICES.astype(np.float32).astype(np.float64)
    write_baked(tmp_path / "a.ply", baked(vertices=vertices))
    assert b"property float x" in (tmp_path / "a.ply").read_bytes()
    mesh = read_mesh(tmp_path / "a.ply")
    assert np.array_equal(mesh.vertices, vertices) and mesh.float32_source


def test_ply_in_other_hands(tmp_path):
    result = baked()
    write_baked(tmp_path / "a.ply", result)
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    # Where io.write says that trimesh puts it.
    assert np.array_equal(mesh.metadata["_ply_raw"]["vertex"]["data"]["ao"], result.value)
    assert np.array_equal(mesh.visual.vertex_colors[:, 0], np.rint(255 * result.value))
    lines = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode("ascii").splitlines()
    comment = next(line for line in lines if line.startswith("comment silint "))
    assert json.loads(comment.removeprefix("comment silint ")) == result.metadata


def test_glb_follows_the_format(tmp_path):
    result = baked()
    write_baked(tmp_path / "a.glb", result)
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, length, n_json, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + n_json])
    n_bin, kind = struct.unpack_from("<I4s", data, 20 + n_json)
    assert kind == b"BIN\0" and 28 + n_json + n_bin == len(data) and n_json % 4 == n_bin % 4 == 0
    mesh = document["meshes"][0]
    assert mesh["extras"] == result.metadata
    attributes = mesh["primitives"][0]["attributes"]
    assert sorted(attributes) == ["COLOR_0", "NORMAL", "POSITION", "_AO"]
    binary = data[28 + n_json :]
    arrays = {}
    for name, index in attributes.items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays[name] = np.frombuffer(part, "<f4").reshape(len(VERTICES), -1)
        assert accessor["count"] == len(VERTICES) and view["byteOffset"] % 4 == 0
    # Linear grey, in full precision; every normal is of unit length, even where there is none.
    assert np.array_equal(arrays["COLOR_0"], np.repeat(arrays["_AO"], 3, axis=1))
    assert np.allclose(np.linalg.norm(arrays["NORMAL"], axis=1), 1.0, atol=1e-6)
    bounds = document["accessors"][attributes["POSITION"]]
    assert np.array_equal(bounds["min"], arrays["POSITION"].min(axis=0))
    assert np.array_equal(bounds["max"], arrays["POSITION"].max(axis=0))


def test_glb_of_faces_unshares_the_vertices(tmp_path):
    write_baked(tmp_path / "a.glb", baked(per="face"))
    mesh = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    assert np.array_equal(mesh.faces, np.arange(36).reshape(-1, 3))
    assert np.allclose(mesh.vertices, VERTICES[FACES].reshape(-1, 3), atol=1e-6)


def test_glb_ends_where_float32_ends():
    with pytest.raises(InputError, match=r"3\.4e38"):
        glb_bytes(VERTICES * 1e39, FACES, VERTICES, {}, {})


# -------------------------------------------------------------------------------------- whole or nothing


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a.xyzzy", r"unknown suffix '.xyzzy'; expected one of .npz .ply .glb"),
        ("a.obj", "unknown suffix '.obj'"),
        ("a", "unknown suffix ''"),
        ("none/a.npz", "'.*none' does not exist"),
        ("folder.npz", "is a folder"),
        ("file/a.npz", "does not exist"),
        ("protected.npz", "write-protected"),
        ("zero\0.npz", "null byte"),
        ("x" * 300 + ".npz", "File name too long"),
    ],
)
def test_places_where_nothing_can_be_written(tmp_path, monkeypatch, name, told):
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "protected.npz").write_text("old")
    # Permission bits mean nothing to root, who runs many a CI.
    monkeypatch.setattr(os, "access", lambda path, mode: "protected" not in str(path))
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=told) as caught:
        check_output(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert sorted(tmp_path.iterdir()) == before


def test_a_read_only_folder_is_refused_before_anything_is_computed(tmp_path, monkeypatch):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o555)
    if os.access(folder, os.W_OK):  # root
        real = write_module.Path.open

        def refuse(self, mode="r", *rest, **options):
            if "x" in mode and self.parent == folder:
                raise PermissionError(13, "Permission denied")
            return real(self, mode, *rest, **options)

        monkeypatch.setattr(write_module.Path, "open", refuse)
    with pytest.raises(InputError, match=r"a\.npz: its folder cannot be written to \(Permission denied\)"):
        check_output(folder / "a.npz")
    folder.chmod(0o755)
    assert list(folder.iterdir()) == []


def test_what_is_no_path_is_refused():
    with pytest.raises(InputError, match="output path is a int"):
        check_output(3)


@pytest.mark.parametrize(
    "failure", [OSError(28, "No space left on device"), KeyboardInterrupt(), MemoryError()]
)
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, failure):
    path = tmp_path / "a.npz"
    write_bytes(path, b"old")

    def fail(*_):
        raise failure

    monkeypatch.setattr(write_module.os, "replace", fail)
    with pytest.raises(InputError if isinstance(failure, OSError) else type(failure)) as caught:
        write_bytes(path, b"new")
    if isinstance(failure, OSError):
        assert str(caught.value) == f"{path}: cannot be written (No space left on device)"
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_unfinished_files_can_be_discarded(tmp_path, monkeypatch):
    seen = []

    def interrupted(temporary, target):
        seen.append(temporary.exists())
        discard_unfinished()
        seen.append(temporary.exists())
        raise KeyboardInterrupt

    monkeypatch.setattr(write_module.os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_bytes(tmp_path / "a.npz", b"new")
    assert seen == [True, False] and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="permission bits and links are POSIX's")
def test_files_get_usual_permissions_and_links_are_followed(tmp_path):
    old = os.umask(0o022)
    try:
        (tmp_path / "real").mkdir()
        (tmp_path / "link.npz").symlink_to(tmp_path / "real" / "a.npz")
        write_bytes(tmp_path / "link.npz", b"x")
    finally:
        os.umask(old)
    assert (tmp_path / "link.npz").is_symlink()
    assert stat.S_IMODE((tmp_path / "real" / "a.npz").stat().st_mode) == 0o644


def test_reading_values_from_what_has_none(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"nonsense")
    (tmp_path / "a.glb").write_bytes(b"nonsense")
    BOX.export(tmp_path / "a.ply")
    for suffix in SUFFIXES:
        with pytest.raises(InputError, match=f"a{suffix}: holds no 'ao'"):
            read_values(tmp_path / f"a{suffix}", "ao")
    with pytest.raises(InputError, match="cannot be read"):
        read_values(tmp_path / "none.npz", "ao")
