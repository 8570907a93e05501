"""The options of `silint bake`, from the command line to the file."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import trimesh
from PIL import Image

from silint import cli
from silint.io import read_values

FLOOR = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nf 1 2 3 4\n"
LID = "v -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A floor, its lid, both in one file, and a box."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "floor.obj").write_text(FLOOR)
    (tmp_path / "lid.obj").write_text(LID + "f 1 2 3 4\n")
    (tmp_path / "both.obj").write_text("o floor\n" + FLOOR + LID + "o lid\nf 5 6 7 8\n")
    trimesh.creation.box().export(tmp_path / "box.ply")
    return tmp_path


def bake(capfd, mesh: str, *arguments: str) -> tuple[np.ndarray, dict]:
    """Values and summary of a bake of eight isolines a point."""
    code = cli.run(["bake", mesh, "-o", "out.npz", "--isolines", "8", "--json", *arguments])
    out, err = capfd.readouterr()
    assert (code, err) == (0, "")
    summary = json.loads(out)
    return read_values("out.npz", summary["quantity"]), summary


def test_occluders(here, capfd):
    value, summary = bake(capfd, "floor.obj", "--occluder", "lid.obj", "--occluder", "box.ply")
    assert len(value) == 4 and (value < 1).all() and summary["occluders"] == ["lid", "box"]
    assert (bake(capfd, "floor.obj")[0] == 1).all()


def test_groups_and_objects_alone(here, capfd):
    value, summary = bake(capfd, "both.obj", "--group", "floor")
    assert len(value) == 4 and (value < 1).all() and summary["groups"] == ["floor"]
    value, _ = bake(capfd, "both.obj", "--group", "floor", "--group", "lid", "--self-only")
    assert np.array_equal(value, np.ones(8))


def test_normals(here, capfd):
    assert bake(capfd, "box.ply", "--normals", "flat")[1]["n_points"] == 36
    assert bake(capfd, "box.ply", "--normals", "smooth", "--per", "face")[1]["normals"] == "smooth"


def test_two_sides(here, capfd):
    value, _ = bake(capfd, "floor.obj", "--quantity", "sky", "--two-sided")
    np.testing.assert_allclose(value, 0.5, atol=1e-5)


def test_weighting(here, capfd):
    cosine, uniform = (
        bake(capfd, "both.obj", "--group", "floor", "--weighting", weighting)[0]
        for weighting in ("cosine", "uniform")
    )
    assert (cosine < uniform - 0.01).all()  # the lid stands high, where cosine weights are large


def test_limits(here, capfd):
    free, _ = bake(capfd, "both.obj", "--group", "floor")
    for arguments in (("0.5",), ("15%",), ("1.2",), ("1.2", "--falloff", "linear")):
        value, summary = bake(capfd, "both.obj", "--group", "floor", "--max-distance", *arguments)
        assert (value == 1).all() if arguments[0] != "1.2" else free.mean() + 0.1 < value.mean() < 1
    assert summary["falloff"] == "linear" and summary["max_distance"] == 1.2
    hard, _ = bake(capfd, "both.obj", "--group", "floor", "--max-distance", "1.2")
    assert hard.mean() < value.mean() - 0.05
    assert (bake(capfd, "both.obj", "--group", "floor", "--spread", "30")[0] < free).all()
    assert (bake(capfd, "both.obj", "--group", "floor", "--backfaces", "ignore")[0] == 1).all()
    assert (bake(capfd, "floor.obj", "--ground", "0.5")[0] == 0).all()
    value, summary = bake(capfd, "both.obj", "--ground", "auto", "--up", "0", "0", "-1", "--two-sided")
    assert summary["ground"] == [0.0, 0.0, -1.0, 1.0] and (value < 0.8).all()


# --------------------------------------------------------------------------------------------- textures


@pytest.fixture
def square(here):
    """Two units wide, one texel coordinate a unit, under the lid."""
    (here / "square.obj").write_text(
        "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    )
    return here


def texture(capfd, *arguments: str) -> tuple[np.ndarray, dict]:
    code = cli.run(["bake", "square.obj", "-o", "out.png", "--isolines", "16", "--json", *arguments])
    out, err = capfd.readouterr()
    assert (code, err) == (0, ""), err
    return np.asarray(Image.open("out.png")) / 255.0, json.loads(out)


def test_texture(square, capfd):
    image, summary = texture(capfd, "--texture", "16")
    assert image.shape[:2] == (16, 16) and (image == 1).all() and summary["uv"] == "file"
    assert summary["files"] == [{"path": "out.png", "bytes": (square / "out.png").stat().st_size}]
    hidden, summary = texture(capfd, "--texture", "16", "--occluder", "lid.obj")
    assert summary["occluders"] == ["lid"]
    middle = hidden[7:9, 7:9].mean()
    assert middle == pytest.approx(1 - 0.5541, abs=0.03)  # the lid's form factor; 16 isolines
    both, _ = texture(capfd, "--texture", "16", "--occluder", "lid.obj", "--two-sided")
    np.testing.assert_allclose(both, (1 + hidden) / 2, atol=1.01 / 255)
    assert texture(capfd, "--texture", "16", "--occluder", "lid.obj", "--max-distance", "0.9")[0].min() == 1
    assert texture(capfd, "--texture", "16", "--ground", "0.5")[0].max() == 0
    assert texture(capfd, "--texture", "16", "--occluder", "lid.obj", "--spread", "20")[0][8, 8] == 0


def test_what_becomes_of_the_source_is_told(square, capfd):
    def told(*arguments):
        assert cli.run(["bake", *arguments, "--texture", "16", "--isolines", "4"]) == 0
        return capfd.readouterr().out

    rows = (square / "square.obj").read_text().splitlines()
    (square / "square.obj").write_text("\n".join([*rows[:-1], "usemtl red", rows[-1]]))
    reason = "only .glb and .gltf are kept"
    assert f"left out of the source: materials; {reason}\n" in told("square.obj", "-o", "one.glb")
    kept = "the source is kept: 1 of its materials have the occlusion, by TEXCOORD_0; 1 had one before\n"
    assert kept in told("one.glb", "-o", "two.glb")
    two = trimesh.Scene({"a": trimesh.creation.box(), "b": trimesh.creation.icosphere(1)})
    two.export(square / "parts.glb")
    of_group = told("parts.glb", "-o", "two.glb", "--group", "a")
    assert "\n1 nodes of other groups stay without their meshes\n" in of_group
    left = "left out of the source: materials, textures, texture coordinates; bent is shown by"
    assert left in told("one.glb", "-o", "two.glb", "--quantity", "bent")
    assert "source" not in told("one.glb", "-o", "two.png")
    text = (square / "square.obj").read_text().replace("vt 1 ", "vt 1.01 ").replace("vt 0 ", "vt 0.5 ")
    (square / "square.obj").write_text(text.replace("vt 1.01 ", "vt 1.0005 "))
    assert "\n3 corners have coordinates beyond [0, 1] by half a texel or less" in told(
        "square.obj", "-o", "a.png"
    )
    (square / "square.obj").write_text(text.replace("vt 1.01 ", "vt 1.9 ").replace("vt 0.5 ", "vt 1.1 "))
    assert "\n2 faces have coordinates in other squares than [0, 1]" in told("square.obj", "-o", "a.png")


def test_texture_of_objects_alone(square, capfd):
    """The lid has the other half of the texture's width."""
    rows = ["o floor", *(square / "square.obj").read_text().replace("vt 1 ", "vt .5 ").splitlines()]
    rows += ["o lid", *LID.splitlines(), "vt .5 0", "vt 1 0", "vt 1 1", "vt .5 1", "f 5/5 6/6 7/7 8/8"]
    (square / "square.obj").write_text("\n".join(rows))
    image, _ = texture(capfd, "--texture", "16")
    assert (image[:, :7] < 1).all() and (image[:, 9:] == 1).all()
    alone, summary = texture(capfd, "--texture", "16", "--self-only")
    assert (alone == 1).all() and summary["self_only"]
    # Of other occluders each has its own share.
    both, _ = texture(capfd, "--texture", "16", "--self-only", "--occluder", "lid.obj")
    assert np.array_equal(both, image)


def test_textures_of_groups_may_overlap(square, capfd):
    """Each object has the whole texture, as they come from a modeller."""
    rows = ["o floor", *(square / "square.obj").read_text().splitlines()]
    rows += ["o lid", *LID.splitlines(), "f 5/1 6/2 7/3 8/4"]
    (square / "square.obj").write_text("\n".join(rows))
    assert cli.run(["bake", "square.obj", "-o", "out.png", "--texture", "16", "--uv", "file"]) == 2
    assert "belong to two or more faces" in capfd.readouterr()[1]
    floor, summary = texture(capfd, "--texture", "16", "--uv", "file", "--group", "floor")
    assert (floor < 1).all() and summary["groups"] == ["floor"] and summary["texels"]["covered"] == 256
    assert (texture(capfd, "--texture", "16", "--uv", "file", "--group", "lid")[0] == 1).all()
    alone, _ = texture(capfd, "--texture", "16", "--uv", "file", "--group", "floor", "--self-only")
    assert (alone == 1).all()
    assert cli.run(["bake", "square.obj", "-o", "out.glb", "--texture", "8", "--group", "lid"]) == 0
    capfd.readouterr()
    again = trimesh.load_mesh("out.glb", process=False)
    assert len(again.faces) == 2 and (again.vertices[:, 2] == 1).all()


def test_texture_of_bent_normals(square, capfd):
    for arguments, expected in ((("tangent",), (0.5, 0.5, 1)), (("world",), (0.5, 0.5, 1))):
        image, summary = texture(capfd, "--texture", "8", "--quantity", "bent", "--space", *arguments)
        np.testing.assert_allclose(image[4, 4], expected, atol=2 / 255)
        assert summary["space"] == arguments[0]
    # A normal map that leans to +y, in either convention of its green channel.
    leaning = np.tile(np.uint8([[[128, 192, 238]]]), (4, 4, 1))
    Image.fromarray(leaning).save("lean.png")
    for green, sign in (("up", 1), ("down", -1)):
        image, summary = texture(
            capfd, "--texture", "8", "--quantity", "sky", "--normal-map", "lean.png", "--green", green,
            "--up", "0", str(sign), "0",
        )  # fmt: skip
        # (1/pi) int (y sin 30 + z cos 30) dw over y, z > 0, as the square hides what is below it.
        assert image[4, 4] == pytest.approx((0.5 + np.sqrt(0.75)) / 2, abs=0.01)
        assert summary["normal_map"] == "lean.png"


def test_texture_layout(square, capfd):
    _, summary = texture(capfd, "--texture", "8", "--samples", "1", "--padding", "0", "--uv", "file")
    assert summary["n_points"] == summary["texels"]["covered"] == 64
    (square / "half.obj").write_text((square / "square.obj").read_text().replace("vt 1 ", "vt .5 "))
    for padding, black in ((["--padding", "0"], True), ([], False)):
        code = cli.run(["bake", "half.obj", "-o", "half.png", "--texture", "16", "--ground", "1", *padding])
        assert code == 0
        # Open is 1, and so is the background; under the ground everything is 0.
        assert (np.asarray(Image.open("half.png"))[:, -1] != 0).all() == black
    capfd.readouterr()


def test_the_summary_of_a_texture(square, capfd):
    assert cli.run(["bake", "square.obj", "-o", "out.glb", "--texture", "8", "--isolines", "8"]) == 0
    out, err = capfd.readouterr()
    lines = out.splitlines()
    assert err == "" and lines[0].startswith("ao at 64 texels: mean 1.0000")
    assert lines[1].startswith("8 x 8 texels in 1 charts")
    assert lines[-1] == f"wrote out.glb ({(square / 'out.glb').stat().st_size:,} bytes)"


# -------------------------------------------------------------------------------------------- the terminal


def test_the_summary_tells_what_happened_in_plain_words(here, capfd):
    """A box inside another sees nothing; vertices without faces have no normal; nothing else is told."""
    inner, outer = trimesh.creation.box([1, 1, 1]), trimesh.creation.box([3, 3, 3])
    rows = [f"v {x} {y} {z}" for x, y, z in [*inner.vertices, *outer.vertices, (9, 9, 9)]]
    rows += [f"f {a} {b} {c}" for a, b, c in [*(inner.faces + 1), *(outer.faces + 9)]]
    (here / "nested.obj").write_text("\n".join(rows))
    assert cli.run(["bake", "nested.obj", "-o", "out.ply", "--isolines", "8"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[0].startswith("ao at 17 vertices: mean ")
    assert lines[1] == "1 vertices have no normal and got 1"
    assert lines[2] == "8 of 16 points see nothing: inside something, or shut in"
    assert re.fullmatch(
        r"read [\d.]+ s, built [\d.]+ s, integrated 16 points in [\d.]+ s "
        r"\([\d,]+ points/s\) with 8 isolines",
        lines[3],
    )
    assert re.fullmatch(r"at most [\d,]+ MiB of memory", lines[4])
    assert lines[5:] == [f"wrote out.ply ({(here / 'out.ply').stat().st_size:,} bytes)"]
    assert cli.run(["bake", "both.obj", "-o", "out.ply", "--normals", "flat", "--isolines", "8"]) == 0
    assert "4 vertices are new, where faces or groups shared one" in capfd.readouterr()[0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), r"length of bent at 4 vertices: mean 0\.6667, .*; 0\.6667 is open, 0 is closed"),
        # 2/3 (1 - cos^3 60) / sin^2 60
        (("--spread", "60"), r"length of bent at 4 vertices: mean 0\.7778, .*; 0\.7778 is open, 0 is closed"),
        (("--two-sided",), r"length of bent at 4 vertices: mean 0\.0000, .*; 0 is closed"),
    ],
)
def test_the_summary_of_bent_normals_says_how_long_open_ones_are(here, capfd, arguments, told):
    assert cli.run(["bake", "floor.obj", "-o", "out.npz", "--quantity", "bent", *arguments]) == 0
    assert re.fullmatch(told, capfd.readouterr()[0].splitlines()[0])


def test_progress_shows_rate_and_time_left(capfd, monkeypatch):
    from rich.console import Console

    from silint.cli import output

    monkeypatch.setattr(Console, "is_terminal", True)
    monkeypatch.setenv("COLUMNS", "120")
    with output.progress_bar("points") as bar:
        update = output.stage(bar, "baking")
        for done in range(0, 60, 10):
            update(done, 100)
        bar.refresh()
        text = "".join(segment.text for segment in bar.console.render(bar.get_renderable()))
    assert "baking" in text and re.search(r"[\d,]+ points/s +\S+ left", text), text


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("both.obj", "--group", "wall"), "both.obj: has no group 'wall'; it has 'floor', 'lid'"),
        (("box.ply", "--group", "wall"), "box.ply: has no groups"),
        (("both.obj", "--occluder", "none.obj"), "none.obj: no such file"),
        (("both.obj", "--normals", "file"), "both.obj: has no normals of its own"),
        (("both.obj", "--texture", "0"), "texture is 0; expected an integer, 1 to 8192"),
        (("both.obj", "--quantity", "shine"), "'irradiance', 'sh'"),
        (("both.obj", "--envmap-up", "z"), "--envmap-up needs --envmap MAP"),
        (("both.obj", "--envmap-rotate", "5"), "--envmap-rotate needs --envmap MAP"),
        (("both.obj", "--quantity", "sh", "--envmap-up", "z"), "--envmap-up"),
        (("both.obj", "--envmap", "map.hdr", "--envmap-up", "x"), "envmap_up is 'x'; expected"),
        (("both.obj", "--envmap", "map.hdr", "--envmap-rotate", "nan"), "envmap_rotate is nan"),
        (("both.obj", "--max-distance", "1_0"), "max_distance is '1_0'"),
        (("both.obj", "--spread", "3", "--ground", "0"), "take a wider one, or leave ground out"),
        (("both.obj", "--texture", "8", "--uv", "file"), "both.obj"),
        (("both.obj", "--texture", "8", "--uv", "new"), "uv is 'new'"),
        (("both.obj", "--texture", "8", "--per", "face"), "--per is not for --texture"),
        (("both.obj", "--texture", "8", "--group", "wall"), "both.obj: has no group 'wall'"),
        (("both.obj", "--texture", "8", "--normals", "file"), "both.obj: has no normals of its own"),
        (("both.obj", "--texture", "8", "--quantity", "sh"), "--texture is not for quantity 'sh'"),
        (("both.obj", "--texture", "8", "--space", "moon"), "space is 'moon'"),
        (("both.obj", "--texture", "8", "--depth", "9"), "depth is 9; expected 8 or 16"),
        (("both.obj", "--depth", "16"), "--depth needs --texture N"),
        (("both.obj", "--uv", "file"), "--uv needs --texture N"),
        (("both.obj", "--normal-map", "map.png"), "--normal-map needs --texture N"),
        (("both.obj", "--max-distance", "x"), "max_distance is 'x'; expected"),
        (("both.obj", "--falloff", "linear"), "falloff is 'linear' without max_distance"),
        (("both.obj", "--spread", "0"), "spread is 0.0"),
        (("both.obj", "--ground", "x"), "ground is 'x'; expected a height, 'auto'"),
        (("both.obj", "--normals", "round"), "normals is 'round'"),
        (("both.obj", "--quantity", "sh", "--occluder", "lid.obj"), "--occluder is not for quantity 'sh'"),
        (("both.obj", "--quantity", "sh", "--self-only"), "--self-only is not for quantity 'sh'"),
        (("both.obj", "--quantity", "sh", "--tolerance", "1e-3"), "--tolerance is not for quantity 'sh'"),
    ],
)
def test_mistakes_end_in_one_line(here, capfd, arguments, told):
    before = sorted(here.iterdir())
    suffix = ".glb" if "--texture" in arguments else ".ply"
    code = cli.run(["bake", *arguments, "-o", f"out{suffix}"])
    out, err = capfd.readouterr()
    assert (code, out) == (2, "") and err.startswith("silint: error: ") and err.count("\n") == 1
    assert told in err
    assert sorted(here.iterdir()) == before


def test_no_result_replaces_what_it_is_made_from(square, capfd):
    Image.new("RGB", (4, 2), (128, 128, 255)).save("map.png")
    before = (square / "map.png").read_bytes()
    arguments = ["bake", "square.obj", "-o", "map.png", "--texture", "8"]
    for more, told in (
        (["--normal-map", "map.png"], "map.png: is the normal map; give the result another name"),
        (["--quantity", "irradiance", "--envmap", "map.png"], "map.png: is the envmap; give"),
    ):
        assert cli.run([*arguments, *more]) == 2
        assert told in capfd.readouterr()[1] and (square / "map.png").read_bytes() == before
