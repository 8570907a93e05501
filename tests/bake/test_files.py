from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest
import trimesh

import silint
from silint import Environment
from silint.bake import bake, bake_scene
from silint.io import LUMINANCE, TONE_CURVE, read_mesh, read_values
from silint.io.glb import read_glb
from silint.validation import InputError


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A ball over a floor, as a file with an unused vertex and a face without area."""
    path = tmp_path_factory.mktemp("bake")
    ball = trimesh.creation.icosphere(1, 0.5)
    floor = np.array([[-2, -2, -0.6], [2, -2, -0.6], [2, 2, -0.6], [-2, 2, -0.6], [7, 7, 7]], float)
    vertices = np.vstack([ball.vertices, floor])
    n = len(ball.vertices)
    faces = np.vstack([ball.faces, [[n, n + 1, n + 2], [n, n + 2, n + 3], [n, n + 1, n + 1]]])
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    rows += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (path / "scene.obj").write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize(
    ("quantity", "query"),
    [("ao", "ambient_occlusion"), ("sky", "sky_view_factor"), ("bent", "bent_normals")],
)
def test_a_baked_file_holds_what_the_integrator_says(folder, per, quantity, query):
    out = folder / f"{quantity}-{per}.npz"
    summary = bake(folder / "scene.obj", out, quantity, per, isolines=16)
    value = read_values(out, quantity)
    scene = silint.load_scene(folder / "scene.obj")
    if per == "vertex":
        points, (normals, valid) = scene.vertices, scene.vertex_normals()
    else:
        points, normals, valid = scene.face_centers_normals()
    integrator = silint.SilhouetteIntegrator(scene)
    expected = getattr(integrator, query)(points[valid], normals[valid], isolines=16)
    assert np.array_equal(value[valid], expected)
    # The vertex that no face uses, and the face without area.
    assert summary["without_normal"] == 1 and np.flatnonzero(~valid).size == 1
    assert (value[~valid] == (0.0 if quantity == "bent" else 1.0)).all()
    assert summary["n_points"] == len(points)
    with np.load(out) as data:
        assert np.array_equal(data["points"], points)
        metadata = json.loads(str(data["metadata"]))
    assert metadata["isolines"] == 16 and metadata["per"] == per
    json.dumps(summary)


@pytest.mark.parametrize("per", ["vertex", "face"])
@pytest.mark.parametrize("suffix", [".npz", ".ply", ".glb"])
def test_irradiance_is_baked_beside_its_colours(folder, per, suffix):
    """Raw values in every format; colours by the curve that the metadata states."""
    light = Environment.from_function(
        lambda w: np.stack([2 + w[:, 1], 1 + 0 * w[:, 0], 3 - w[:, 2]], axis=1), 16
    )
    out = folder / f"light-{per}{suffix}"
    summary = bake(folder / "scene.obj", out, "irradiance", per, isolines=16, environment=light)
    integrator = silint.SilhouetteIntegrator(folder / "scene.obj")
    baked, without, _ = bake_scene(integrator, "irradiance", per, isolines=16, environment=light)
    assert without == 1 and (baked.value[~baked.normals.any(axis=1)] == 0.0).all()
    luminance = baked.value @ LUMINANCE
    assert summary["mean"] == pytest.approx(luminance.mean())
    assert summary["colours"] == TONE_CURVE
    value = read_values(out, "irradiance")
    want = np.repeat(baked.value, 3, axis=0) if (per, suffix) == ("face", ".glb") else baked.value
    np.testing.assert_allclose(value, want, rtol=1e-6 if suffix == ".glb" else 0)
    if suffix == ".glb":
        colours = read_glb(out.read_bytes()).attributes["COLOR_0"]
        np.testing.assert_allclose(colours, 1.0 - np.exp(-want / luminance.mean()), atol=1e-6)


def test_a_map_file_lights_a_bake(folder):
    """An .hdr of one grey: pi L times ambient occlusion, in all three channels."""
    sky = folder / "grey.hdr"
    texel = bytes([128, 128, 128, 129])  # 2^(129 - 128) * 128 / 256 = 1
    sky.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + texel * 32)
    bake(
        folder / "scene.obj",
        folder / "lit.npz",
        "irradiance",
        isolines=16,
        method="octahedral",
        environment=sky,
    )
    bake(folder / "scene.obj", folder / "open.npz", "ao", isolines=16, method="octahedral")
    lit, ao = read_values(folder / "lit.npz", "irradiance"), read_values(folder / "open.npz", "ao")
    used = lit.any(axis=1) | (ao < 1.0)
    level = lit[used] / (np.pi * ao[used, None])
    np.testing.assert_allclose(level, level[0, 0], rtol=1e-12)
    assert level[0, 0] == pytest.approx(1.0, rel=0.01)  # RGBE holds the middle of its step or its end


def test_options_reach_the_integrator(folder):
    integrator = silint.SilhouetteIntegrator(folder / "scene.obj")
    uniform = bake_scene(integrator, isolines=16, weighting="uniform")[0].value
    cosine = bake_scene(integrator, isolines=16)[0].value
    assert np.abs(uniform - cosine).max() > 0.01
    below = bake_scene(integrator, "sky", isolines=16, up=(0, 0, -1))[0].value
    above = bake_scene(integrator, "sky", isolines=16)[0].value
    # The floor looks up: all of its sky is above.
    assert (below[-5:-1] == 0.0).all() and (above[-5:-1] > 0.5).all()


def test_progress_ends_at_the_number_of_points(folder):
    calls = []
    bake(folder / "scene.obj", folder / "progress.ply", isolines=8, progress=lambda *c: calls.append(c))
    assert calls and calls[-1][0] == calls[-1][1] == 46  # 42 of the ball, 4 of the floor
    assert all(a[0] <= b[0] for a, b in pairwise(calls))


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_a_baked_mesh_can_be_read_and_baked_again(folder, suffix):
    first, second = folder / f"first{suffix}", folder / f"second{suffix}"
    bake(folder / "scene.obj", first, isolines=8)
    summary = bake(first, second, isolines=8)
    assert summary["n_vertices"] == 47
    # The baked file brings its normals, so the second bake differs by their rounding alone (float32 in
    # .glb, and silhouettes of so coarse a ball may jump over an isoline).
    a, b = read_values(first, "ao"), read_values(second, "ao")
    assert np.abs(a - b).max() < (1e-9 if suffix == ".ply" else 1e-2)
    assert np.abs(read_mesh(second).vertices - read_mesh(folder / "scene.obj").vertices).max() < 1e-6


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"quantity": "sh"}, "quantity is 'sh'; expected one of 'ao', 'sky', 'bent', 'irradiance'"),
        ({"quantity": "irradiance"}, "quantity 'irradiance' needs an environment"),
        ({"environment": "sky.hdr"}, "environment given; only quantity 'irradiance' has one"),
        ({"quantity": "irradiance", "environment": "no such.hdr"}, "no such.hdr"),
        ({"per": "edge"}, "per is 'edge'"),
        ({"isolines": 0}, "isolines is 0"),
        ({"isolines": 8.0}, "isolines is 8.0"),
        ({"method": "rays"}, "method is 'rays'"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"tolerance": 1e-3, "isolines": 8}, "isolines and tolerance given"),
        ({"weighting": "none"}, "weighting is 'none'"),
        ({"up": (0, 0, 0)}, "up is"),
        ({"output": "out.obj"}, "out.obj: unknown suffix"),
        ({"output": "none/out.ply"}, "does not exist"),
        ({"mesh_path": "none.obj"}, "none.obj: no such file"),
        ({"mesh_path": "same.ply", "output": "same.ply"}, "is the mesh itself"),
    ],
)
def test_bad_input_is_refused_before_anything_is_computed(folder, monkeypatch, options, told):
    monkeypatch.chdir(folder)
    (folder / "same.ply").write_bytes(trimesh.creation.box().export(file_type="ply"))
    before = sorted(folder.iterdir())
    with pytest.raises(InputError) as caught:
        bake(**{"mesh_path": "scene.obj", "output": "out.ply", **options})
    assert told in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(folder.iterdir()) == before
