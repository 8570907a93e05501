"""The options of `silint bake`, from the command line to the file."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import trimesh

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
    assert "4 vertices are new: those that faces or groups shared are split" in capfd.readouterr()[0]


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
    code = cli.run(["bake", *arguments, "-o", "out.ply"])
    out, err = capfd.readouterr()
    assert (code, out) == (2, "") and err.startswith("silint: error: ") and err.count("\n") == 1
    assert told in err
    assert sorted(here.iterdir()) == before
