from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh

import silint
from silint import cli
from silint.io import read_values


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty working folder with a box in it."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box().export(tmp_path / "box.ply")
    return tmp_path


def run(capfd, *arguments: str) -> tuple[int, str, str]:
    code = cli.run(list(arguments))
    out, err = capfd.readouterr()
    return code, out, err


def refusal(capfd, *arguments: str) -> str:
    """The single line on stderr of a command that must end with exit code 2."""
    before = sorted(os.listdir())
    code, out, err = run(capfd, *arguments)
    assert (code, out) == (2, ""), (code, out, err)
    assert err.startswith("silint: error: ") and err.endswith("\n") and err.count("\n") == 1, err
    assert sorted(os.listdir()) == before
    return err


def spawn(*arguments: str, **options) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "silint.cli", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


# ------------------------------------------------------------------------------------------ that it works


def test_version_and_help(capfd):
    assert run(capfd, "--version") == (0, f"silint {silint.__version__}\n", "")
    for arguments in ((), ("--help",)):
        code, out, err = run(capfd, *arguments)
        assert code == 0 and err == ""
        for command in ("demo", "bake", "prt", "bench", "info"):
            assert re.search(rf"^\W*{command}\b", out, re.MULTILINE)


def test_help_needs_no_compiler_and_no_mesh_library():
    code = (
        "import sys; from silint import cli; cli.run(['bake', '--help']); "
        "print(sorted({'numba', 'trimesh', 'scipy', 'matplotlib', 'embreex'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_bake_writes_the_file_and_says_so(here, capfd):
    code, out, err = run(capfd, "bake", "box.ply", "-o", "out.npz", "--isolines", "8")
    assert (code, err) == (0, "")
    assert "ao at 8 vertices" in out and "integrated 8 points in" in out
    assert out.splitlines()[-1] == f"wrote out.npz ({os.path.getsize('out.npz'):,} bytes)"
    # At the corner of a convex solid, its mean normal's hemisphere is open.
    assert np.array_equal(read_values("out.npz", "ao"), np.ones(8))


def test_bake_tells_json_and_nothing_else(here, capfd):
    code, out, err = run(
        capfd, "bake", "box.ply", "-o", "out.glb", "--quantity", "sky", "--up", "0", "1", "0",
        "--per", "face", "--isolines", "8", "--json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    summary = json.loads(out)
    assert summary["output"] == "out.glb" and summary["up"] == [0.0, 1.0, 0.0]
    assert summary["n_points"] == 12 and summary["without_normal"] == 0
    # Of an open box's faces, two look at the sky, two away from it, and eight see half of it.
    assert summary["mean"] == pytest.approx(0.5, abs=1e-3)
    assert set(summary["seconds"]) == {"load", "build", "integrate", "write"}


def test_bake_irradiance_from_a_map(here, capfd):
    texel = bytes([128, 128, 128, 129])
    (here / "sky.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + texel * 32)
    code, out, err = run(
        capfd, "bake", "box.ply", "-o", "lit.ply", "--quantity", "irradiance", "--envmap", "sky.hdr",
        "--envmap-up", "z", "--envmap-rotate", "30", "--isolines", "8",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "luminance of radiance x sr" in out
    np.testing.assert_allclose(read_values("lit.ply", "irradiance"), np.pi, rtol=0.01)


def test_bake_harmonics_as_prt_does(here, capfd):
    code, _, err = run(capfd, "bake", "box.ply", "-o", "sh.npz", "--quantity", "sh", "--isolines", "8")
    assert (code, err) == (0, "")
    assert silint.Transfer.load("sh.npz").coefficients.shape == (8, 9)


def test_info(here, capfd):
    code, out, err = run(capfd, "info", "box.ply", "--json")
    assert (code, err) == (0, "")
    told = json.loads(out)
    assert told["n_faces"] == 12 and told["n_vertices"] == 8
    assert told["bounds"] == [[-0.5] * 3, [0.5] * 3]
    assert told["defects"]["boundary_edges"] == 0
    assert told["bytes_per_triangle"] == pytest.approx(sum(told["memory"].values()) / 12)
    assert all(set(part) >= {"built", "reason"} for part in told["plan"].values())
    code, out, err = run(capfd, "info", "box.ply")
    assert (code, err) == (0, "")
    assert "box.ply: 12 triangles, 8 vertices (float32)" in out
    for word in ("boundary edges", "non manifold edges", "bytes a triangle", "contour hierarchy", "plan"):
        assert word in out


def test_info_names_groups(here, capfd):
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    lines = "".join(f"o part{i}\n" + "f 1 2 3\n" * (i + 1) for i in range(10))
    (here / "parts.obj").write_text(triangle + lines)
    told = run(capfd, "info", "parts.obj", "--json")[1]
    assert json.loads(told)["groups"] == {f"part{i}": i + 1 for i in range(10)}
    assert "groups   part0, part1," in run(capfd, "info", "parts.obj")[1]
    assert "part7 and 2 more (--json has all)" in run(capfd, "info", "parts.obj")[1]
    assert "groups" not in run(capfd, "info", "box.ply")[1]


# -------------------------------------------------------------------------------------------- bad input

BAKE = ("bake", "box.ply", "-o", "out.ply")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("bake", "none.obj", "-o", "out.ply"), "none.obj: no such file"),
        (("info", "none.obj"), "none.obj: no such file"),
        (("info", "."), "is a folder"),
        (("info", "box.xyzzy"), "no such file"),
        (("bake", "box.ply", "-o", "out.xyzzy"), "out.xyzzy: unknown suffix"),
        (("bake", "box.ply", "-o", "none/out.ply"), "'none' does not exist"),
        (("bake", "box.ply", "-o", "box.ply"), "is the mesh itself"),
        ((*BAKE, "--isolines", "0"), "isolines is 0"),
        ((*BAKE, "--isolines", "-3"), "isolines is -3"),
        ((*BAKE, "--isolines", "many"), "--isolines"),
        ((*BAKE, "--quantity", "shine"), "quantity is 'shine'; expected one of"),
        ((*BAKE, "--quantity", "irradiance"), "needs an environment"),
        ((*BAKE, "--envmap", "none.hdr"), "none.hdr"),
        ((*BAKE, "--quantity", "irradiance", "--envmap", "box.ply"), "box.ply"),
        ((*BAKE, "--per", "edge"), "per is 'edge'"),
        ((*BAKE, "--method", "guess"), "method is 'guess'"),
        ((*BAKE, "--weighting", "heavy"), "weighting is 'heavy'"),
        ((*BAKE, "--up", "0", "0", "0"), "up is"),
        ((*BAKE, "--up", "0", "0"), "--up"),
        ((*BAKE, "--frobnicate"), "--frobnicate"),
        (("bake", "box.ply"), "--output"),
        (("bake",), "MESH"),
        (("frobnicate",), "frobnicate"),
        (("bench", "none.obj"), "none.obj: no such file"),
        (("bench", "box.ply", "--json", "report.txt"), "report.txt: unknown suffix"),
        (("bench", "box.ply", "--isolines", "8,x"), "isolines is '8,x'"),
        (("bench", "box.ply", "--quantity", "irradiance"), "--envmap MAP"),
        (
            ("bench", "box.ply", "--quantity", "irradiance", "--envmap", "none.hdr"),
            "none.hdr: cannot be read",
        ),
        (("bench", "box.ply", "--quantity", "sh", "--max-degree", "99"), "max_degree is 99"),
        (("demo", "--out", "box.ply"), "box.ply: is a file; expected a folder"),
        (("demo", "--out", "none/demo"), "parent folder does not exist"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else None,
)
def test_mistakes_end_in_one_line_and_exit_code_2(here, capfd, arguments, told):
    assert told in refusal(capfd, *arguments)


BOX = trimesh.creation.box()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("empty.obj", b"", "is empty"),
        ("text.ply", b"this is no mesh\n" * 10, "not a valid .ply file"),
        ("cut.glb", BOX.export(file_type="glb")[:-40], "cut short"),
        ("cut.stl", BOX.export(file_type="stl")[:-40], "cut short"),
        ("cut.ply", BOX.export(file_type="ply")[:-40], "cut short"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
        ("range.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 4, but there are 3"),
        ("nan.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "must be finite"),
        ("inf.off", b"OFF\n3 1 0\n0 0 0\n1 0 inf\n0 1 0\n3 0 1 2\n", "must be finite"),
    ],
)
def test_files_that_cannot_be_used_end_in_one_line_that_names_them(here, capfd, name, content, told):
    (here / name).write_bytes(content)
    for arguments in (("info", name), ("bake", name, "-o", "out.ply")):
        message = refusal(capfd, *arguments)
        assert message.startswith(f"silint: error: {name}: ") and told in message, message


def test_bugs_are_told_in_one_line_too(here, capfd, monkeypatch):
    from silint import scene

    monkeypatch.delenv("SILINT_DEBUG", raising=False)
    monkeypatch.setattr(scene, "load_scene", lambda path: [][0])
    code, out, err = run(capfd, "info", "box.ply")
    assert (code, out) == (1, "") and err.count("\n") == 1
    assert "internal error" in err and "IndexError" in err


# --------------------------------------------------------------------------------------- as a process


def test_a_reader_that_has_gone_is_no_error_to_shout_about(here):
    process = spawn("info", "box.ply", cwd=here)
    process.stdout.close()  # as `| head` does
    with process.stderr:
        assert process.stderr.read() == ""
    process.wait()


@pytest.mark.skipif(os.name != "posix", reason="sends POSIX signals")
@pytest.mark.parametrize("seconds", [0.6, 2.0])
def test_ctrl_c_ends_at_once_and_leaves_nothing(here, seconds):
    # Large enough to be busy for longer than that: reading, building, compiling or integrating.
    rng = np.random.default_rng(0)
    faces = rng.integers(0, 30000, (60000, 3))
    trimesh.Trimesh(rng.random((30000, 3)), faces, process=False).export(here / "soup.ply")
    process = spawn("bake", "soup.ply", "-o", "out.ply", cwd=here)
    time.sleep(seconds)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    start = time.monotonic()
    _, err = process.communicate(timeout=30)
    # The promise is a second; ten times that, for machines that are busy with other tests.
    assert time.monotonic() - start < 10.0
    assert process.returncode == 130
    assert err == "silint: interrupted, nothing is left half-written\n"
    assert sorted(p.name for p in here.iterdir()) == ["box.ply", "soup.ply"]


# ------------------------------------------------------------------------------------------------- demo


def test_the_packaged_scene_is_what_its_generator_makes():
    from silint.demo import demo_scene

    scene = demo_scene()
    assert scene.n_faces == 16986 and scene.float32_source
    assert scene.normals is not None and scene.name == "demo"
    closed = ("boundary_edges", "non_manifold_edges", "inconsistent_edges", "zero_area_faces")
    assert all(scene.defects[name] == 0 for name in closed)
    generator = pytest.importorskip("scenes.demo")
    vertices, faces, normals = generator.demo()
    assert np.array_equal(scene.faces, faces)
    # Sines and cosines differ by an ulp between platforms, on either side of a float32's rounding.
    assert np.abs(scene.vertices - vertices).max() < 1e-6
    assert np.abs(scene.normals - normals).max() < 1e-4


def test_without_embreex_the_demo_says_so(capsys):
    cli.demo._print_comparison(None)
    assert "embreex is not installed" in capsys.readouterr().out


@pytest.mark.slow
def test_demo_writes_what_it_says(here):
    process = spawn("demo", cwd=here)
    out, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (0, "")
    assert [line for line in out.splitlines() if line.startswith("wrote")] == [
        f"wrote {os.path.join('silint-demo', f'demo.{kind}')}" for kind in ("glb", "png", "json")
    ]
    folder = here / "silint-demo"
    assert sorted(p.name for p in folder.iterdir()) == ["demo.glb", "demo.json", "demo.png"]
    told = json.loads((folder / "demo.json").read_text())
    assert told["n_faces"] == 16986 and len(read_values(folder / "demo.glb", "ao")) == told["n_points"]
    if told["comparison"] is not None:
        errors = {(row.get("isolines"), row.get("rays")): row["rmse"] for row in told["comparison"]["rows"]}
        assert errors[64, None] < 2e-3 and errors[None, 4096] < 4e-3
