from __future__ import annotations

import numpy as np
import pytest
import trimesh

from silint.io.ply import ply_bytes, position_type, read_ply

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.1]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def plate() -> bytes:
    vertex = [(axis, "double", VERTICES[:, i]) for i, axis in enumerate("xyz")]
    vertex += [("small", "uchar", np.arange(4)), ("half", "float", np.arange(4) / 3)]
    return ply_bytes(vertex, FACES, [("whole", "int", [7, -8]), ("real", "double", [0.1, 0.2])], ["a b", "c"])


def test_what_is_written_comes_back():
    ply = read_ply(plate())
    assert ply.comments == ["a b", "c"]
    assert ply.vertex.dtype.names == ("x", "y", "z", "small", "half")
    assert all(np.array_equal(ply.vertex[axis], VERTICES[:, i]) for i, axis in enumerate("xyz"))
    assert np.array_equal(ply.vertex["small"], np.arange(4))
    assert np.array_equal(ply.vertex["half"], (np.arange(4) / 3).astype(np.float32))
    assert np.array_equal(ply.face["index"], FACES)
    assert np.array_equal(ply.face["whole"], [7, -8]) and np.array_equal(ply.face["real"], [0.1, 0.2])


def test_others_read_the_same():
    mesh = trimesh.load_mesh(trimesh.util.wrap_as_stream(plate()), file_type="ply", process=False)
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, FACES)
    assert np.array_equal(np.ravel(mesh.metadata["_ply_raw"]["face"]["data"]["real"]), [0.1, 0.2])


@pytest.mark.parametrize(
    ("vertices", "kind"),
    [([[1.5, 2.0, 3.0]], "float"), ([[0.1, 0.0, 0.0]], "double"), ([[1e39] * 3], "double")],
)
def test_positions_are_as_narrow_as_keeps_every_bit(vertices, kind):
    assert position_type(np.array(vertices)) == kind


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: data.replace(b"end_header", b"end_headed"),
        lambda data: data.replace(b"little", b"big"),
        lambda data: data.replace(b"property int whole", b"property list uchar int whole"),
        lambda data: data.replace(b"element face", b"element edge"),
        lambda data: data.replace(b"vertex 4", b"vertex -4"),
        lambda data: data.replace(b"\x03\x00\x00\x00\x00\x01", b"\x04\x00\x00\x00\x00\x01"),
    ],
)
def test_what_is_no_such_file_is_refused(damage):
    assert damage(plate()) != plate()
    with pytest.raises((ValueError, LookupError)):
        read_ply(damage(plate()))
