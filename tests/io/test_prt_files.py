from __future__ import annotations

import hashlib
import json
import os
import shutil
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from silint.io import read_bounce, read_mesh, write_bytes
from silint.io import write as write_module
from silint.io.prt_files import (
    CONVENTIONS,
    TransferArrays,
    check_transfer_output,
    read_transfer,
    write_transfer,
)
from silint.validation import InputError

BALL = trimesh.creation.icosphere(1)
# One vertex that no face uses, and positions that need all of a double.
VERTICES = np.vstack([np.array(BALL.vertices) * 3.0 + 0.1, [[7.0, 7.0, 7.0]]])
FACES = np.array(BALL.faces)
DEGREES = (0, 2, 4, 16)
SUFFIXES = (".npz", ".ply", ".glb")
ARRAYS = ("vertices", "faces", "normals", "coefficients")


def transfer(max_degree: int = 2, per: str = "vertex", weighting: str = "cosine", **more) -> TransferArrays:
    """Random coefficients on a ball; the last row has no normal."""
    rng = np.random.default_rng(max_degree)
    n = len(VERTICES) if per == "vertex" else len(FACES)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[-1] = 0.0
    return TransferArrays(
        VERTICES,
        FACES,
        normals,
        rng.normal(size=(n, (max_degree + 1) ** 2)),
        per,
        max_degree,
        weighting,
        {"points": n - 1, "without_normal": 1},
        {"isolines": 64, "note": 'ä "quoted"\nline'},
        **more,
    )


def assert_same(a: TransferArrays, b: TransferArrays) -> None:
    for name in ARRAYS:
        x, y = getattr(a, name), getattr(b, name)
        assert x.dtype == y.dtype and np.array_equal(x, y), name
    for name in ("per", "max_degree", "weighting", "diagnostics", "metadata"):
        assert getattr(a, name) == getattr(b, name), name


def in_float32(array):
    return array.astype(np.float32).astype(np.float64)


# ------------------------------------------------------------------------------------------- round trips


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_transfer_comes_back_to_the_precision_of_its_format(tmp_path, suffix, degree, per, weighting):
    path, given = tmp_path / f"a{suffix}", transfer(degree, per, weighting)
    assert write_transfer(path, given) == (path,)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    expected = given
    if suffix != ".npz":
        expected = replace(expected, coefficients=in_float32(given.coefficients))
    if suffix == ".glb":
        normals = in_float32(given.normals)
        normals[-1] = (0.0, 0.0, 1.0)
        expected = replace(expected, vertices=in_float32(VERTICES), normals=normals)
        if per == "face":
            corners = np.arange(FACES.size).reshape(-1, 3)
            expected = replace(expected, vertices=in_float32(VERTICES)[FACES.ravel()], faces=corners)
    assert_same(read_transfer(path), expected)


def test_float32_positions_stay_float32_in_ply(tmp_path):
    given = replace(transfer(), vertices=in_float32(VERTICES), normals=in_float32(transfer().normals))
    write_transfer(tmp_path / "a.ply", given)
    assert b"property float x\n" in (tmp_path / "a.ply").read_bytes()
    assert_same(
        read_transfer(tmp_path / "a.ply"), replace(given, coefficients=in_float32(given.coefficients))
    )


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_file_says_what_its_numbers_are(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_transfer(path, transfer(4, weighting="uniform"))
    data = path.read_bytes()
    if suffix == ".npz":
        with np.load(path) as archive:
            header = json.loads(str(archive["metadata"]))
    elif suffix == ".ply":
        header = json.loads(data.split(b"comment silint ")[1].split(b"\n")[0])
    else:
        header = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])["meshes"][0]["extras"]
    assert header["silint_transfer"] == 1 and CONVENTIONS.items() <= header.items()
    assert (header["max_degree"], header["per"], header["weighting"]) == (4, "vertex", "uniform")
    assert header["condon_shortley"] is False and "over the hemisphere" in header["meaning"]
    assert header["metadata"]["isolines"] == 64 and header["diagnostics"]["without_normal"] == 1


# ----------------------------------------------------------------------------------------- other readers


def test_npz_holds_plain_arrays_with_their_checksums(tmp_path):
    given = transfer()
    write_transfer(tmp_path / "a.npz", given)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        assert sorted(data) == sorted([*ARRAYS, "metadata", "checksums"])
        sums = json.loads(str(data["checksums"]))
        for name in ARRAYS:
            array = data[name]
            # As docs/prt_formats.md describes it.
            head = f"{array.dtype.str} {array.shape}".encode()
            assert sums[name] == hashlib.sha256(head + array.tobytes()).hexdigest()
        assert sums["metadata"] == hashlib.sha256(str(data["metadata"]).encode()).hexdigest()


@pytest.mark.parametrize("per", ["vertex", "face"])
def test_ply_in_other_hands(tmp_path, per):
    given = transfer(2, per)
    write_transfer(tmp_path / "a.ply", given)
    text = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")[0].decode("ascii")
    properties = [line.split()[-1] for line in text.splitlines() if line.startswith("property")]
    results = ["nx", "ny", "nz", *(f"sh_{i}" for i in range(9))]
    expected = ["x", "y", "z", *results, "vertex_indices"]
    assert properties == (expected if per == "vertex" else ["x", "y", "z", "vertex_indices", *results])
    assert text.count("property float sh_") == 9
    mesh = trimesh.load_mesh(tmp_path / "a.ply", process=False)
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.faces, FACES)
    data = mesh.metadata["_ply_raw"][per]["data"]
    for i in range(9):
        assert np.array_equal(np.ravel(data[f"sh_{i}"]), given.coefficients[:, i].astype(np.float32))
    # silint's own reader of meshes takes it too, with the normals.
    again = read_mesh(tmp_path / "a.ply")
    assert np.array_equal(again.vertices, VERTICES) and (again.normals is not None) == (per == "vertex")


@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize("degree", DEGREES)
def test_glb_follows_the_format(tmp_path, degree, per):
    given = transfer(degree, per)
    write_transfer(tmp_path / "a.glb", given)
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, length, n_json, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + n_json])
    n_bin, kind = struct.unpack_from("<I4s", data, 20 + n_json)
    assert kind == b"BIN\0" and 28 + n_json + n_bin == len(data) and n_json % 4 == n_bin % 4 == 0
    assert document["buffers"] == [{"byteLength": n_bin}]
    assert document["asset"]["version"] == "2.0"

    n_rows = len(VERTICES) if per == "vertex" else FACES.size
    n = (degree + 1) ** 2
    primitive = document["meshes"][0]["primitives"][0]
    names = [f"_SH{i}" for i in range((n + 3) // 4)]
    assert sorted(primitive["attributes"]) == sorted(["POSITION", "NORMAL", *names])
    arrays, ends = {}, [0]
    for name, index in [*primitive["attributes"].items(), ("indices", primitive["indices"])]:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        kind, code, width = {
            "POSITION": ("VEC3", 5126, 3),
            "NORMAL": ("VEC3", 5126, 3),
            "indices": ("SCALAR", 5125, 1),
        }.get(name, ("VEC4", 5126, 4))
        assert (accessor["type"], accessor["componentType"]) == (kind, code)
        assert accessor["count"] == (FACES.size if name == "indices" else n_rows)
        assert view["target"] == (34963 if name == "indices" else 34962)
        assert view["byteOffset"] % 4 == 0 and view["byteLength"] == 4 * width * accessor["count"]
        assert "byteStride" not in view and accessor.get("byteOffset", 0) == 0
        ends.append(view["byteOffset"] + view["byteLength"])
        part = data[28 + n_json :][view["byteOffset"] : ends[-1]]
        arrays[name] = np.frombuffer(part, "<u4" if name == "indices" else "<f4").reshape(-1, width)
    assert max(ends) == n_bin and len(set(ends)) == len(ends)

    assert all(np.isfinite(array).all() for array in arrays.values())
    assert np.allclose(np.linalg.norm(arrays["NORMAL"], axis=1), 1.0, atol=1e-6)
    bounds = document["accessors"][primitive["attributes"]["POSITION"]]
    assert np.array_equal(bounds["min"], arrays["POSITION"].min(axis=0))
    assert np.array_equal(bounds["max"], arrays["POSITION"].max(axis=0))
    assert arrays["indices"].max() < n_rows
    padded = np.hstack([arrays[name] for name in names])
    expected = given.coefficients.astype(np.float32)
    expected = expected if per == "vertex" else np.repeat(expected, 3, axis=0)
    assert np.array_equal(padded[:, :n], expected) and not padded[:, n:].any()

    mesh = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    corners = mesh.vertices[mesh.faces]
    assert np.array_equal(corners, in_float32(VERTICES)[FACES])
    assert np.array_equal(mesh.vertex_attributes["_SH0"], padded[:, :4])


@pytest.mark.slow
@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize("degree", DEGREES)
def test_khronos_validator_finds_nothing_in_glb(tmp_path, degree, per):
    write_transfer(tmp_path / "a.glb", transfer(degree, per))
    report = gltf_report(tmp_path / "a.glb")
    assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0, report["issues"]
    assert report["info"]["totalTriangleCount"] == len(FACES)
    # And it would have found something: a normal that is no unit vector.
    data = bytearray((tmp_path / "a.glb").read_bytes())
    n_json = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + n_json])
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    offset = 28 + n_json + document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    data[offset : offset + 4] = struct.pack("<f", 5.0)
    (tmp_path / "b.glb").write_bytes(data)
    assert gltf_report(tmp_path / "b.glb")["issues"]["numErrors"] > 0


def gltf_report(path):
    """What npm's gltf-validator says; it has no command of its own, so node is told where npx put it."""
    npx = shutil.which("npx")
    if npx is None:
        pytest.skip("there is no npx, hence no gltf-validator")
    script = path.with_suffix(".js")
    script.write_text(
        "const path = require('path');\n"
        "const bins = process.env.PATH.split(path.delimiter).filter(d => d.endsWith('.bin'));\n"
        "const places = bins.map(d => path.dirname(path.dirname(d)));\n"
        "const validator = require(require.resolve('gltf-validator', {paths: places}));\n"
        "const data = new Uint8Array(require('fs').readFileSync(process.argv[2]));\n"
        "validator.validateBytes(data).then(r => console.log(JSON.stringify(r)));\n"
    )
    command = [npx, "--yes", "--prefer-offline", "--package", "gltf-validator", "--", "node"]
    done = subprocess.run(
        [*command, str(script), str(path)], capture_output=True, text=True, timeout=120, cwd=path.parent
    )
    if done.returncode:
        pytest.skip(f"npx cannot run gltf-validator here: {done.stderr.strip().splitlines()[-1:]}")
    return json.loads(done.stdout)


# ------------------------------------------------------------------------------------------- computePRT


@pytest.mark.parametrize("made", [False, True], ids=["new folder", "folder that is there"])
def test_a_folder_gets_what_compute_prt_writes(tmp_path, made):
    folder, given = tmp_path / "rp_dennis_posed_004_OBJ", transfer()
    if made:
        (folder / "bounce").mkdir(parents=True)
        (folder / "bounce" / "face.npy").write_bytes(b"old")
        (folder / "bounce" / "bounce1.txt").write_bytes(b"somebody else's")
    files = write_transfer(folder, given)
    assert files == (folder / "bounce" / "bounce0.txt", folder / "bounce" / "face.npy")
    assert len(list(folder.rglob("*"))) == (4 if made else 3)
    # As the pipelines read them.
    values, faces = np.loadtxt(files[0]), np.load(files[1])
    assert faces.dtype == np.int64 and np.array_equal(faces, FACES)
    # Eight decimals.
    assert values.shape == (len(VERTICES), 9)
    assert np.abs(values - np.pi * given.coefficients).max() <= 0.5e-8 * (1 + 1e-6)
    first = files[0].read_text().splitlines()[0]
    assert first == " ".join(f"{np.pi * x:.8f}" for x in given.coefficients[0])
    coefficients, read_faces = read_bounce(folder)
    assert np.abs(coefficients - given.coefficients).max() <= 0.5e-8 / np.pi * (1 + 1e-6)
    assert np.array_equal(read_faces, FACES) and read_faces.dtype == np.int32


def compute_prt_by_sampling(normals, n_samples):
    """Nine numbers a normal under an open sky, and their standard errors, the pipelines' way.

    Uniform directions with x and y negated against the angles of the harmonics, which carry the
    Condon-Shortley phase of scipy's associated Legendre functions; a mean over 4 pi, no 1 / pi.
    """
    from math import factorial

    from scipy.special import lpmv

    rng = np.random.default_rng(7)
    theta, phi = np.arccos(1.0 - 2.0 * rng.random(n_samples)), 2.0 * np.pi * rng.random(n_samples)
    sine = np.sin(theta)
    directions = np.stack([-sine * np.cos(phi), -sine * np.sin(phi), np.cos(theta)], axis=1)
    columns = []
    for degree in range(3):
        for order in range(-degree, degree + 1):
            m = abs(order)
            size = (2 * degree + 1) / (4 * np.pi) * factorial(degree - m) / factorial(degree + m)
            turn = {0: 1.0, 1: np.cos(m * phi), -1: np.sin(m * phi)}[np.sign(order)]
            columns.append(np.sqrt((2.0 if m else 1.0) * size) * turn * lpmv(m, degree, np.cos(theta)))
    cosine = np.maximum(directions @ normals.T, 0.0)
    terms = 4.0 * np.pi * cosine[:, :, None] * np.stack(columns, axis=1)[:, None, :]
    return terms.mean(axis=0), terms.std(axis=0) / np.sqrt(n_samples)


def open_sky(normals):
    """(1/pi) int max(n.w,0) Y dw to degree 2: the harmonics of n times 1, 2/3, 1/4."""
    x, y, z = normals.T
    a, b, c = np.sqrt(1 / (4 * np.pi)), np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi))
    degree0, degree1 = [np.full(len(x), a)], [b * y, b * z, b * x]
    degree2 = [x * y, y * z, (3 * z * z - 1) / np.sqrt(12), x * z, (x * x - y * y) / 2]
    return np.stack([*degree0, *(2 / 3 * v for v in degree1), *(c / 4 * v for v in degree2)], axis=1)


def test_signs_order_and_scale_are_those_of_compute_prt(tmp_path):
    normals = np.array(BALL.vertices)
    write_transfer(tmp_path / "ball", TransferArrays(normals, FACES, normals, open_sky(normals)))
    values = np.loadtxt(tmp_path / "ball" / "bounce" / "bounce0.txt")
    mean, error = compute_prt_by_sampling(normals, 4096)
    # 378 numbers: one of them passes 4.5 standard errors in one run out of 400; this run's seed is fixed.
    assert (np.abs(values - mean) / error).max() < 4.5
    # And the errors are small enough to tell a wrong sign (20 of them) or a missing pi (7), of every column.
    assert (np.abs(values).max(axis=0) > 10 * error.mean(axis=0)).all()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"max_degree": 3}, "this is degree 3, per vertex, cosine"),
        ({"per": "face"}, "this is degree 2, per face, cosine"),
        ({"weighting": "uniform"}, "this is degree 2, per vertex, uniform"),
    ],
)
def test_a_folder_takes_one_kind_of_transfer(tmp_path, options, told):
    with pytest.raises(InputError, match="takes degree 2, per vertex, cosine") as caught:
        check_transfer_output(tmp_path / "out", **options)
    assert told in str(caught.value)
    with pytest.raises(InputError, match="takes degree 2"):
        write_transfer(tmp_path / "out", transfer(**options))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("bounce0.txt", None, "cannot be read"),
        ("face.npy", None, "cannot be read"),
        ("bounce0.txt", b"", r"shape \(0, 1\)|shape \(0,|expected 9"),
        ("bounce0.txt", b"1 2 3\n4 5 6\n", "expected 9 finite numbers"),
        ("bounce0.txt", b"1 2 3 4 5 6 7 8 nan\n", "expected 9 finite numbers"),
        ("bounce0.txt", b"a b\n", "damaged"),
        ("bounce0.txt", b"1 2 3 4 5 6 7 8 9\n", "indices outside 0..0"),
        ("face.npy", b"nonsense", "damaged"),
        ("face.npy", b"", "damaged"),
    ],
)
def test_bounce_files_that_are_none(tmp_path, name, content, told):
    write_transfer(tmp_path / "out", transfer())
    file = tmp_path / "out" / "bounce" / name
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=told) as caught:
        read_bounce(tmp_path / "out")
    assert "bounce" in str(caught.value) and "\n" not in str(caught.value)


# ----------------------------------------------------------------------------------------- bad transfers


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"coefficients": np.zeros((43, 16))}, r"coefficients has shape \(43, 16\); expected \(43, 9\)"),
        ({"max_degree": 3}, r"coefficients has shape \(43, 9\); expected \(43, 16\)"),
        ({"max_degree": 17}, "max_degree is 17; expected an integer, 0 to 16"),
        ({"max_degree": 2.0}, "max_degree is 2.0"),
        ({"coefficients": np.full((43, 9), np.nan)}, "coefficients must be finite"),
        ({"coefficients": "none"}, "coefficients has dtype"),
        ({"per": "face"}, r"normals has shape \(43, 3\); expected \(80, 3\): one a face"),
        ({"per": "edge"}, "per is 'edge'"),
        ({"weighting": "none"}, "weighting is 'none'"),
        ({"normals": np.full((43, 3), 1.0)}, "normals has a length of 1.732 in row 0; expected 1 or 0"),
        ({"normals": np.full((43, 3), np.inf)}, "normals must be finite"),
        ({"vertices": np.zeros((0, 3))}, "vertices"),
        ({"vertices": VERTICES[:10]}, "faces has indices outside 0..9"),
        ({"faces": np.zeros((0, 3), int)}, "faces"),
        ({"faces": FACES + 10}, "faces has indices outside 0..42"),
    ],
)
def test_a_transfer_that_does_not_fit_itself_is_refused(change, told):
    with pytest.raises(InputError, match=told) as caught:
        replace(transfer(), **change)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("metadata", [{"x": np.nan}, {"x": np.arange(3)}, {"x": object()}])
def test_metadata_that_json_cannot_hold_is_refused(tmp_path, suffix, metadata):
    with pytest.raises(InputError, match="what JSON cannot"):
        write_transfer(tmp_path / f"a{suffix}", replace(transfer(), metadata=metadata))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_numbers_beyond_float32_are_refused_where_they_would_become_infinite(tmp_path, suffix):
    large = replace(transfer(), coefficients=transfer().coefficients * 1e39)
    with pytest.raises(InputError, match=r"3\.4e38"):
        write_transfer(tmp_path / f"a{suffix}", large)
    assert list(tmp_path.iterdir()) == []
    write_transfer(tmp_path / "a.npz", large)
    assert_same(read_transfer(tmp_path / "a.npz"), large)


# --------------------------------------------------------------------------------------- damaged files


def rewritten(path, **changes):
    """An .npz with some arrays replaced, and the rest, checksums among them, as it was."""
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **{**arrays, **changes})


@pytest.mark.parametrize("name", [*ARRAYS, "metadata"])
def test_a_tampered_npz_is_refused(tmp_path, name):
    path, given = tmp_path / "a.npz", transfer()
    write_transfer(path, given)
    rewritten(path)
    assert_same(read_transfer(path), given)
    with np.load(path) as archive:
        array = archive[name]
    if name == "metadata":
        array = np.array(str(array).replace('"isolines": 64', '"isolines": 65'))
    elif name == "faces":
        array = array[:, [1, 2, 0]]
    else:
        array = array.copy()
        array[0, 0] = np.nextafter(array[0, 0], 9.0)
    rewritten(path, **{name: array})
    with pytest.raises(InputError, match=f"checksum of {name} does not fit"):
        read_transfer(path)


def test_checksums_tell_shapes_apart(tmp_path):
    write_transfer(tmp_path / "a.npz", transfer())
    rewritten(tmp_path / "a.npz", coefficients=transfer().coefficients.reshape(9, 43))
    with pytest.raises(InputError, match="checksum of coefficients"):
        read_transfer(tmp_path / "a.npz")


def with_header(path, **changes):
    """The same file with another header (and, of .npz, its checksum)."""
    if path.suffix == ".npz":
        with np.load(path) as archive:
            text, sums = str(archive["metadata"]), json.loads(str(archive["checksums"]))
        text = json.dumps({**json.loads(text), **changes})
        sums["metadata"] = hashlib.sha256(text.encode()).hexdigest()
        rewritten(path, metadata=np.array(text), checksums=np.array(json.dumps(sums)))
        return
    data = path.read_bytes()
    if path.suffix == ".ply":
        head, rest = data.split(b"comment silint ", 1)
        text, rest = rest.split(b"\n", 1)
        text = json.dumps({**json.loads(text), **changes}).encode()
        path.write_bytes(head + b"comment silint " + text + b"\n" + rest)
        return
    n_json = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + n_json])
    document["meshes"][0]["extras"].update(changes)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    path.write_bytes(data[:12] + struct.pack("<I", len(text)) + data[16:20] + text + data[20 + n_json :])


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"silint_transfer": 2}, "schema 2; this silint reads up to 1"),
        ({"condon_shortley": True}, "condon_shortley is True; this silint reads False"),
        ({"index": "l (l + 1) - m"}, "index is"),
        ({"max_degree": 3}, "coefficients has shape|not a transfer file"),
        ({"per": "face"}, "normals has shape|not a transfer file"),
        ({"weighting": "none"}, "weighting is 'none'"),
    ],
)
def test_a_header_that_says_something_else_is_believed_or_refused(tmp_path, suffix, change, told):
    path = tmp_path / f"a{suffix}"
    write_transfer(path, transfer())
    with_header(path)
    read_transfer(path)
    with_header(path, **change)
    with pytest.raises(InputError, match=told) as caught:
        read_transfer(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"nonsense", b"ply\n", b"glTF" + bytes(40), "mesh", "half"])
def test_files_that_are_none_of_ours(tmp_path, suffix, content):
    path = tmp_path / f"a{suffix}"
    if content == "half":
        write_transfer(path, transfer())
        content = path.read_bytes()[: path.stat().st_size // 2]
    elif content == "mesh":
        content = BALL.export(file_type="ply" if suffix == ".ply" else "glb")
    path.write_bytes(content)
    with pytest.raises(InputError, match="not a transfer file that silint wrote, or damaged"):
        read_transfer(path)


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    folder = tmp_path_factory.mktemp("intact")
    for suffix in SUFFIXES:
        write_transfer(folder / f"a{suffix}", transfer(0))
    return folder


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=150)
@given(share=st.floats(0.0, 1.0), bit=st.integers(0, 7), cut=st.booleans())
def test_damage_is_an_input_error_or_harmless(intact, suffix, share, bit, cut):
    data = bytearray((intact / f"a{suffix}").read_bytes())
    place = min(int(share * len(data)), len(data) - 1)
    if cut:
        del data[place:]
    else:
        data[place] ^= 1 << bit
    path = intact / f"damaged{suffix}"
    path.write_bytes(data)
    try:
        found = read_transfer(path)
    except InputError as error:
        assert "\n" not in str(error)
        return
    if suffix == ".npz":  # what its checksums are for: a flipped bit can only have hit padding
        assert_same(found, transfer(0))


def test_an_npz_that_says_it_is_encrypted(intact):
    # Found by flipping bits: zipfile answers with a RuntimeError.
    data = bytearray((intact / "a.npz").read_bytes())
    data[data.rindex(b"PK\x01\x02") + 8] |= 1
    (intact / "damaged.npz").write_bytes(data)
    with pytest.raises(InputError, match="or damaged"):
        read_transfer(intact / "damaged.npz")


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
@pytest.mark.parametrize("bad", [b"\x01\x00\x80\x7f", b"\x00\x00\x80\x7f"], ids=["signalling NaN", "inf"])
def test_numbers_that_are_not_finite_are_refused_without_a_warning(intact, suffix, bad):
    value = transfer(0).coefficients.astype("<f4")[0].tobytes()
    data = (intact / f"a{suffix}").read_bytes()
    assert data.count(value) == 1
    (intact / f"damaged{suffix}").write_bytes(data.replace(value, bad))
    with pytest.raises(InputError, match="coefficients must be finite; NaN or infinity in row 0"):
        read_transfer(intact / f"damaged{suffix}")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("none.npz", "cannot be read"),
        ("a.obj", "unknown suffix '.obj'; expected one of .npz .ply .glb"),
        ("folder", "is a folder, whose bounce0.txt has no vertices"),
    ],
)
def test_paths_that_cannot_be_read(tmp_path, name, told):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=told):
        read_transfer(tmp_path / name)
    with pytest.raises(InputError, match="path is a int"):
        read_transfer(3)


# -------------------------------------------------------------------------------------- whole or nothing


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a.obj", r"unknown suffix '.obj'; expected one of .npz .ply .glb, or a folder"),
        ("a.5", "unknown suffix '.5'"),
        ("none/a.npz", "does not exist"),
        ("none/a", "parent folder does not exist"),
        ("folder.npz", "is a folder; expected the name of a file"),
        ("file", "file: is a file; expected a folder"),
        ("file/", "file: is a file; expected a folder"),
        ("filed", "bounce: is a file; expected a folder"),
        ("protected", "face.npy: the file is write-protected"),
        ("zero\0", "null byte"),
        ("zero\0.npz", "null byte"),
        ("x" * 300, "File name too long"),
    ],
)
def test_places_where_nothing_can_be_written(tmp_path, monkeypatch, name, told):
    (tmp_path / "folder.npz").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "filed").mkdir()
    (tmp_path / "filed" / "bounce").write_text("")
    (tmp_path / "protected" / "bounce").mkdir(parents=True)
    (tmp_path / "protected" / "bounce" / "face.npy").write_text("old")
    # Permission bits mean nothing to root, who runs many a CI.
    monkeypatch.setattr(os, "access", lambda path, mode: "protected" not in str(path))
    before = sorted(tmp_path.rglob("*"))
    path = os.path.join(tmp_path, name)
    for attempt in (lambda: check_transfer_output(path), lambda: write_transfer(path, transfer())):
        with pytest.raises(InputError, match=told) as caught:
            attempt()
        assert "\n" not in str(caught.value)
    assert sorted(tmp_path.rglob("*")) == before


def test_what_is_no_path_is_refused():
    with pytest.raises(InputError, match="output path is a int"):
        check_transfer_output(3)


@pytest.mark.parametrize("name", ["new", "new.npz", "there"])
def test_a_folder_that_cannot_be_written_to_is_refused_before_anything_is_computed(
    tmp_path, monkeypatch, name
):
    (tmp_path / "there").mkdir()

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(write_module.Path, "open", refuse)
    with pytest.raises(InputError, match=r"cannot be written to \(Permission denied\)"):
        check_transfer_output(tmp_path / name)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("made", [False, True], ids=["new folder", "folder that is there"])
def test_a_folder_that_fails_half_way_keeps_what_it_had(tmp_path, monkeypatch, failure, made):
    folder = tmp_path / "out"
    if made:
        write_transfer(folder, transfer())
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    real = write_module.Path.open

    def fail(self, mode="r", *rest, **options):
        if "x" in mode and "face.npy" in self.name and stage:
            raise failure
        return real(self, mode, *rest, **options)

    stage = []
    monkeypatch.setattr(write_module.Path, "open", fail)
    check_transfer_output(folder)
    other = replace(transfer(), coefficients=-transfer().coefficients)
    from silint.io import bounce

    # The check passes; the second of the two files does not.
    monkeypatch.setattr(bounce, "write_together", lambda c: (stage.append(1), write_module.write_together(c)))
    with pytest.raises(InputError if isinstance(failure, OSError) else KeyboardInterrupt):
        write_transfer(folder, other)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before
    assert folder.exists() == made


def test_files_that_belong_together_are_complete_before_one_is_renamed(tmp_path, monkeypatch):
    for name in "ab":
        write_bytes(tmp_path / name, b"old")
    seen = []
    real = os.replace

    def watch(temporary, target):
        seen.append(len(list(tmp_path.iterdir())))
        real(temporary, target)

    monkeypatch.setattr(write_module.os, "replace", watch)
    write_module.write_together([(tmp_path / "a", b"A"), (tmp_path / "b", b"B")])
    assert seen == [4, 3]
    assert [(tmp_path / name).read_bytes() for name in "ab"] == [b"A", b"B"]
