"""Bakes that compute some of their points and predict the others."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from PIL import Image

import silint.bake.integrate as integrate
from silint import cli
from silint.bake import bake, bake_scene
from silint.io import read_values
from silint.scene import load_scene
from silint.texture import bake_texture
from silint.validation import InputError
from tests.texture.shapes import box, obj_text

TOLERANCE = 0.02


@pytest.fixture
def dear(monkeypatch):
    """Points that take so long that predicting always pays."""
    monkeypatch.setattr(integrate, "_seconds_a_site", lambda counts, sides: 1.0)


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """A dense floor below a ball, in two objects."""
    t = np.linspace(-1, 1, 48)
    x, y = np.meshgrid(t, t)
    a = (np.arange(47)[:, None] * 48 + np.arange(47)).ravel()
    floor = [f"v {p!r} {q!r} 0" for p, q in zip(x.ravel().tolist(), y.ravel().tolist(), strict=True)]
    rows = ["o floor", *floor, *(f"f {i + 1} {i + 2} {i + 50} {i + 49}" for i in a)]
    ball = trimesh.creation.icosphere(1, 0.4)
    rows += ["o ball", *(f"v {p!r} {q!r} {r!r}" for p, q, r in (ball.vertices + (0.1, 0, 0.6)).tolist())]
    rows += [f"f {i} {j} {k}" for i, j, k in (ball.faces + 48 * 48 + 1).tolist()]
    path = tmp_path_factory.mktemp("mesh") / "dense.obj"
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"per": "face"},
        {"normals": "flat"},
        {"two_sided": True},
        {"self_only": True},
        {"quantity": "bent"},
        {"groups": ["floor"], "max_distance": 0.5},
    ],
    ids=lambda options: "-".join(map(str, options.values())),
)
def test_vertices_and_faces(mesh, dear, options):
    scene = load_scene(mesh)
    full, *_ = bake_scene(scene, isolines=16, **options)
    told = []
    found, *_ = bake_scene(
        scene, isolines=16, interpolate=TOLERANCE, progress=lambda *x: told.append(x), **options
    )
    # Held-back points are within half of it, and others farther off by chance; twice is never seen here.
    assert np.abs(found.value - full.value).max() < 2.0 * TOLERANCE
    assert found.metadata["interpolate"] == TOLERANCE and "interpolate" not in full.metadata
    assert (found.value == full.value).any() and (found.value != full.value).any()
    assert told[-1][0] == told[-1][1]


def test_summary_tells_what_was_computed(mesh, tmp_path, dear):
    summary = bake(mesh, tmp_path / "out.npz", isolines=16, interpolate=TOLERANCE)
    told = summary["interpolation"]
    assert told["points"] == summary["n_points"] == 48 * 48 + 42
    assert told["computed"] == summary["diagnostics"]["points"] < 0.5 * told["points"]
    assert 0 < told["held_back"] < told["computed"] and 0 < told["held_back_error"] <= TOLERANCE
    assert json.loads(json.dumps(summary)) == summary
    assert "interpolation" not in bake(mesh, tmp_path / "out.npz", isolines=16)


def test_texture(mesh, tmp_path, dear):
    path = tmp_path / "box.obj"
    vertices, faces, uvs = box()
    path.write_text(obj_text(vertices, faces, uvs))
    images = []
    for options in ({}, {"interpolate": TOLERANCE}):
        summary = bake_texture(path, tmp_path / "out.png", 192, isolines=16, **options)
        images.append(np.asarray(Image.open(tmp_path / "out.png")).astype(float) / 255.0)
    assert summary["interpolation"]["computed"] < 0.4 * summary["n_points"]
    assert summary["interpolation"]["held_back_error"] <= TOLERANCE
    off = np.abs(images[0] - images[1])
    assert off.max() < 3.0 * TOLERANCE and off.mean() < 0.2 * TOLERANCE


@pytest.mark.parametrize("value", [0.0, -0.1, float("nan"), float("inf"), "fine"])
def test_tolerance_is_checked_before_anything_is_read(value):
    with pytest.raises(InputError, match=r"interpolate is .*; expected"):
        bake("nowhere.obj", "out.npz", interpolate=value)
    with pytest.raises(InputError, match=r"interpolate is .*; expected"):
        bake_texture("nowhere.obj", "out.png", 16, interpolate=value)


def test_command_line(mesh, tmp_path, capfd, monkeypatch, dear):
    monkeypatch.chdir(tmp_path)
    command = ["bake", str(mesh), "-o", "out.npz", "--isolines", "16"]
    assert cli.run([*command, "--interpolate", "0.02"]) == 0
    out, err = capfd.readouterr()
    assert err == "" and " of 2,346 points; held-back error at most 0.0" in out
    value = read_values("out.npz", "ao")
    assert cli.run([*command, "--interpolate", "0.02", "--per", "face", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["interpolation"]["computed"] < 2000
    assert len(value) == 2346
    assert cli.run([*command, "--interpolate", "0"]) == 2
    assert capfd.readouterr().err == "silint: error: interpolate is 0.0; expected a finite number above 0\n"
    assert cli.run([*command[:3], "out.npz", "--quantity", "sh", "--interpolate", "0.1"]) == 2
    assert "--interpolate is not for quantity 'sh'" in capfd.readouterr().err


@pytest.mark.parametrize("options", [{}, {"self_only": True}, {"two_sided": True}], ids=str)
def test_cheap_points_are_computed(mesh, options):
    """A floor below a ball costs some microseconds a point, fewer than a prediction."""
    scene = load_scene(mesh)
    full, _, plain = bake_scene(scene, isolines=8, **options)
    found, _, counts = bake_scene(scene, isolines=8, interpolate=TOLERANCE, **options)
    assert np.array_equal(found.value, full.value)
    assert counts["points"] == plain["points"]


def test_the_command_line_says_that_it_did_not_pay(mesh, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.run(["bake", str(mesh), "-o", "out.npz", "--isolines", "8", "--interpolate", "0.02"]) == 0
    assert "computed all points: to predict some would have cost more" in capfd.readouterr().out


def test_costs_are_those_of_the_way_that_points_are_served():
    counts = {
        "points": 4,
        "covered_points": 0,
        "exact_points": 0,
        "nodes_visited": 8,
        "edges_tested": 4000,
        "contour_edges": 400,
        "crossings": 40,
    }
    swept = (1000 * 6 + 100 * 40 + 10 * 52) * 1e-9
    assert integrate._seconds_a_site(counts, 1) == pytest.approx(swept)
    assert integrate._seconds_a_site(counts, 2) == pytest.approx(2 * swept)
    assert integrate._seconds_a_site(counts | {"exact_points": 4}, 1) == pytest.approx(4 * swept)
    covered = (2 * 59 + 1000 * 27 + 10 * 30) * 1e-9
    assert integrate._seconds_a_site(counts | {"covered_points": 4}, 1) == pytest.approx(covered)
    half = integrate._seconds_a_site(counts | {"covered_points": 2}, 1)
    assert half == pytest.approx(0.5 * (swept + covered))
    assert integrate._seconds_a_site(dict.fromkeys(counts, 0), 1) == 0.0
