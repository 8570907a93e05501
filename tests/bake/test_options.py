"""What each option of a bake does, against closed forms."""

from __future__ import annotations

import json
from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
import trimesh

import silint
from silint.bake import bake, bake_scene
from silint.io import read_values
from silint.io.glb import read_glb
from silint.validation import InputError

# A point is lifted by 2 ** -36 of the scene, or by 2 ** -18 where its file holds float32, before it looks.
LIFTED, LIFTED_FLOAT32 = 1e-10, 2e-5
UNIT = 0.1  # of lengths; no float32


def quarter(a: float, b: float) -> float:
    """What a rectangle a x b hides of the cosine-weighted hemisphere, one above the point below its corner.

    The form factor from a point to a parallel rectangle, with a and b in units of their distance.
    """
    p, q = np.sqrt(1 + a * a), np.sqrt(1 + b * b)
    return (a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2 * np.pi)


LID = 4 * quarter(1, 1)  # what the lid hides of the middle of the floor

GRID = [(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)]
QUADS = [(1, 2, 5, 4), (2, 3, 6, 5), (4, 5, 8, 7), (5, 6, 9, 8)]
MIDDLE = 4


def floor(z: float = 0.0, offset: int = 0) -> str:
    """A square of two by two, nine vertices, that looks up."""
    rows = [f"v {UNIT * x} {UNIT * y} {UNIT * z}" for x, y in GRID]
    rows += ["f " + " ".join(str(i + offset) for i in quad) for quad in QUADS]
    return "\n".join(rows) + "\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A floor, its lid, and both in one file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "floor.obj").write_text(floor())
    (tmp_path / "lid.obj").write_text(floor(1.0))
    (tmp_path / "both.obj").write_text("o floor\n" + floor() + "o lid\n" + floor(1.0, 9))
    return tmp_path


def ao(mesh: str, **options) -> np.ndarray:
    bake(mesh, "out.npz", **{"method": "exact", **options})
    return read_values("out.npz", options.get("quantity", "ao"))


# -------------------------------------------------------------------------------------------- what blocks


def test_occluders_block_and_are_not_baked(here):
    assert np.array_equal(ao("floor.obj"), np.ones(9))
    value = ao("floor.obj", occluders=["lid.obj"])
    assert value.shape == (9,) and value[MIDDLE] == pytest.approx(1 - LID, abs=LIFTED)
    # One alone needs no brackets, and a scene does as well as a file.
    assert np.array_equal(ao("floor.obj", occluders="lid.obj"), value)
    assert np.array_equal(ao("floor.obj", occluders=silint.load_scene("lid.obj")), value)
    # As if it stood in the file.
    assert np.array_equal(ao("both.obj")[:9], value)
    with np.load("out.npz") as data:
        assert "occluders" not in json.loads(str(data["metadata"]))


@pytest.mark.parametrize("suffix", [".npz", ".ply", ".glb"])
def test_outputs_hold_the_baked_mesh_alone(here, suffix):
    summary = bake("floor.obj", f"out{suffix}", occluders=["lid.obj", "both.obj"], isolines=8)
    assert summary["occluders"] == ["lid", "both"] and summary["n_faces"] == 8
    assert len(read_values(f"out{suffix}", "ao")) == 9
    if suffix != ".npz":
        assert len(trimesh.load_mesh(f"out{suffix}", process=False).faces) == 8


def test_several_occluders_add_up(here):
    (here / "half.obj").write_text("v 0 -.1 .1\nv .1 -.1 .1\nv .1 .1 .1\nv 0 .1 .1\nf 1 2 3 4\n")
    (here / "other.obj").write_text("v -.1 -.1 .1\nv 0 -.1 .1\nv 0 .1 .1\nv -.1 .1 .1\nf 1 2 3 4\n")
    assert ao("floor.obj", occluders=["half.obj"])[MIDDLE] == pytest.approx(1 - LID / 2, abs=LIFTED)
    value = ao("floor.obj", occluders=["half.obj", "other.obj"])[MIDDLE]
    assert value == pytest.approx(1 - LID, abs=LIFTED)


def test_an_occluder_that_touches_leaves_normals_alone(here):
    """It shares the corners of an edge, where smooth normals would otherwise lean."""
    (here / "wall.obj").write_text("v .1 -.1 0\nv .1 .1 0\nv .1 .1 1\nv .1 -.1 1\nf 1 2 3 4\n")
    baked, _, _ = bake_scene(silint.load_scene("floor.obj"), isolines=8, occluders="wall.obj")
    assert np.array_equal(baked.normals, np.tile([0.0, 0.0, 1.0], (9, 1)))


def test_an_occluder_of_float32_counts_for_contact():
    """A float64 mesh on a float32 floor: what touches is lifted as far as the coarser of the two asks."""
    from silint.bake.integrate import blocking_scene

    vertices, faces = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]) + 0.1, [[0, 1, 2]]
    double, single = silint.Scene(vertices, faces), silint.Scene(vertices.astype(np.float32), faces)
    assert blocking_scene([double, single]).float32_source
    assert not blocking_scene([double, double]).float32_source


def test_objects_alone(here):
    assert ao("both.obj")[MIDDLE] == pytest.approx(1 - LID, abs=LIFTED)
    assert np.array_equal(ao("both.obj", self_only=True), np.ones(18))
    # Occluders still block; the lid's own underside is of no account to the lid, which looks up.
    value = ao("both.obj", self_only=True, occluders="lid.obj")
    assert value[MIDDLE] == pytest.approx(1 - LID, abs=LIFTED)


@pytest.mark.parametrize("per", ["vertex", "face"])
def test_self_only_is_a_bake_of_each_object(here, per):
    ball = trimesh.creation.icosphere(1, 0.06)
    rows = ["o ball", *(f"v {x!r} {y!r} {z!r}" for x, y, z in (ball.vertices + (0, 0, 0.03)).tolist())]
    rows += [f"f {a} {b} {c}" for a, b, c in (ball.faces + 1).tolist()]
    (here / "ball.obj").write_text("\n".join(rows))
    (here / "two.obj").write_text("\n".join(rows) + "\no floor\n" + floor(0.0, len(ball.vertices)))
    value = ao("two.obj", self_only=True, per=per, method="auto", isolines=16)
    alone = [ao(name, per=per, method="auto", isolines=16) for name in ("ball.obj", "floor.obj")]
    assert np.array_equal(value, np.concatenate(alone))
    assert np.abs(value - ao("two.obj", per=per, method="auto", isolines=16)).max() > 0.1


def test_vertices_that_objects_share_become_one_for_each(here):
    """A floor and a wall on a common edge, whose smooth normal is their bisector."""
    (here / "corner.obj").write_text(
        "v 0 -9 0\nv 0 9 0\nv 9 9 0\nv 9 -9 0\nv 0 -9 9\nv 0 9 9\nv 5 5 5\n"
        "g floor\nf 1 4 3 2\ng wall\nf 1 2 6 5\n"
    )
    summary = bake("corner.obj", "out.npz", self_only=True, method="exact")
    assert summary["split_vertices"] == 2 and summary["n_points"] == 9
    assert summary["without_normal"] == 1  # the vertex that no face uses stays, too
    with np.load("out.npz") as data:
        points, normals, value = data["points"], data["normals"], data["value"]
    # Of the file, in its order: two on the edge twice, once on the floor and once on the wall.
    assert np.array_equal(points[:4], [[0, -9, 0], [0, -9, 0], [0, 9, 0], [0, 9, 0]])
    np.testing.assert_allclose(normals[0], normals[1])  # smooth, across both
    assert np.count_nonzero(value < 1) == 4 and np.allclose(value[:4], value[0])
    # Each alone reaches 45 degrees into the bisector's hemisphere: a lune of (1 - cos 45) / 2, of which the
    # ends of the edge have half.
    assert value[0] == pytest.approx(1 - (1 - np.sqrt(0.5)) / 4, abs=LIFTED_FLOAT32)
    assert bake("corner.obj", "out.npz", per="face", self_only=True)["split_vertices"] == 0


# ------------------------------------------------------------------------------------------------- groups


def test_groups_are_baked_alone_and_blocked_by_all(here):
    value = ao("both.obj", groups=["floor"])
    assert value.shape == (9,) and value[MIDDLE] == pytest.approx(1 - LID, abs=LIFTED)
    assert np.array_equal(ao("both.obj", groups="lid"), np.ones(9))
    with np.load("out.npz") as data:
        assert (data["points"][:, 2] == UNIT).all()
        assert json.loads(str(data["metadata"]))["groups"] == ["lid"]
    assert np.array_equal(ao("both.obj", groups=["floor"], self_only=True), np.ones(9))
    assert ao("both.obj", groups=["lid", "floor"], per="face").shape == (16,)
    bake("both.obj", "out.ply", groups=["floor"], isolines=8)
    assert len(trimesh.load_mesh("out.ply", process=False).faces) == 8


def test_nodes_of_gltf_are_groups(here):
    scene = trimesh.Scene()
    square = trimesh.load_mesh("floor.obj")
    scene.add_geometry(square, node_name="ground", geom_name="square")
    lift = trimesh.transformations.translation_matrix((0, 0, UNIT))
    scene.add_geometry(square, node_name="roof", geom_name="square", transform=lift)
    (here / "room.glb").write_bytes(scene.export(file_type="glb"))
    assert sorted(silint.load_scene("room.glb").groups) == ["ground", "roof"]
    bake("room.glb", "out.glb", groups=["ground"], method="exact")
    mesh = read_glb((here / "out.glb").read_bytes())
    middle = np.flatnonzero((mesh.attributes["POSITION"] == 0).all(axis=1))
    assert len(mesh.faces) == 8 and len(middle) == 1
    assert mesh.attributes["_AO"][middle[0]] == pytest.approx(1 - LID, abs=LIFTED_FLOAT32)
    assert bake("room.glb", "out.glb", self_only=True, isolines=8)["min"] == 1.0


def test_formats_without_groups_are_one(here):
    trimesh.load_mesh("both.obj").export("both.ply")
    whole = ao("both.ply")
    assert whole.min() < 0.6
    assert np.array_equal(ao("both.ply", self_only=True), whole)


# ------------------------------------------------------------------------------------------------ normals


@pytest.fixture
def box(here):
    """A cube whose file says that everything looks up, but for one corner of which it says nothing."""
    box = trimesh.creation.box([UNIT] * 3)
    rows = [f"v {x} {y} {z}" for x, y, z in box.vertices.tolist()]
    (here / "plain.obj").write_text("\n".join(rows + [f"f {a} {b} {c}" for a, b, c in box.faces + 1]))
    rows += ["vn 0 0 1", "vn 0 0 0"]
    last = len(box.vertices)
    faces = [" ".join(f"{i}//{2 if i == last else 1}" for i in face) for face in box.faces + 1]
    (here / "up.obj").write_text("\n".join(rows + [f"f {face}" for face in faces]))
    return box


def test_normals_of_a_box(box):
    """At its corners sky view factors are (1 + n_z) / 2 less what the box itself hides."""
    top = box.vertices[:, 2] > 0
    smooth = np.where(top, (1 + 3**-0.5) / 2, (1 - 3**-0.5) / 2)
    up = np.where(top, 1.0, 0.75)  # at the bottom the box fills one of four quadrants
    up[-1] = smooth[-1]
    for mesh, normals, expected in (
        ("up.obj", "auto", up),
        ("up.obj", "file", up),
        ("up.obj", "smooth", smooth),
        ("plain.obj", "auto", smooth),
        ("plain.obj", "smooth", smooth),
    ):
        summary = bake(mesh, "out.npz", "sky", method="exact", normals=normals)
        np.testing.assert_allclose(read_values("out.npz", "sky"), expected, rtol=0, atol=LIFTED)
        assert summary["normals"] == ("file" if expected is up else "smooth")
        assert summary["computed_normals"] == (1 if expected is up else 0)


@pytest.mark.parametrize("mesh", ["up.obj", "plain.obj"])
def test_flat_normals_split_vertices(box, mesh):
    summary = bake(mesh, "out.npz", "sky", method="exact", normals="flat")
    assert summary["n_points"] == 36 and summary["split_vertices"] == 28
    expected = (1 + np.repeat(box.face_normals[:, 2], 3)) / 2
    np.testing.assert_allclose(read_values("out.npz", "sky"), expected, rtol=0, atol=LIFTED)
    bake(mesh, "out.ply", "sky", normals="flat", isolines=8)
    again = trimesh.load_mesh("out.ply", process=False)
    assert np.array_equal(again.triangles, trimesh.load_mesh("plain.obj", process=False).triangles)


def test_normals_of_faces(box):
    up = np.tile([0.0, 0.0, 1.0], (12, 1))
    has_corner = (box.faces == 7).any(axis=1)
    corners = box.vertices / np.linalg.norm(box.vertices, axis=1, keepdims=True)
    mean = corners[box.faces].sum(axis=1)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    for mesh, normals, expected in (
        ("up.obj", "auto", box.face_normals),
        ("up.obj", "flat", box.face_normals),
        ("up.obj", "smooth", mean),
        ("plain.obj", "smooth", mean),
        ("up.obj", "file", up),
    ):
        baked, _, _ = bake_scene(silint.load_scene(mesh), "sky", "face", isolines=8, normals=normals)
        rows = ~has_corner if normals == "file" else slice(None)
        np.testing.assert_allclose(baked.normals[rows], expected[rows], rtol=0, atol=LIFTED)
        np.testing.assert_allclose(np.linalg.norm(baked.normals, axis=1), 1.0)


# ---------------------------------------------------------------------------------------------- two sides


def test_two_sides(here):
    """Under its lid the floor sees 1 - LID from above and everything from below."""
    value = ao("floor.obj", occluders="lid.obj", two_sided=True)
    assert value[MIDDLE] == pytest.approx(1 - LID / 2, abs=LIFTED)
    assert ao("floor.obj", quantity="sky", two_sided=True)[MIDDLE] == pytest.approx(0.5, abs=LIFTED)
    # What is open above and below cancels: no side is better than the other.
    assert np.abs(ao("floor.obj", quantity="bent", two_sided=True)).max() < LIFTED
    with np.load("out.npz") as data:
        metadata = json.loads(str(data["metadata"]))
    assert metadata["two_sided"] and "both sides" in metadata["meaning"]


def test_progress_of_many_queries_is_one(here):
    calls = []
    bake(
        "both.obj", "out.npz", isolines=8, self_only=True, two_sided=True,
        progress=lambda *call: calls.append(call),
    )  # fmt: skip
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert calls[-1] == (18, 18) and len(Counter(total for _, total in calls)) == 1


# ------------------------------------------------------------------------------------------------- limits

# As far as this the lid is seen from the middle of the floor in a disc, which touches the square's edges and
# reaches 45 degrees from the normal.
R = np.sqrt(2) * UNIT
DISC = {
    "none": 0.5,  # sin^2
    "linear": 0.5 - (np.sqrt(2) - 1),  # int (1 - UNIT / (R cos t)) 2 cos t sin t dt
    "quadratic": 0.5 - np.log(2) / 2,
}
# 64 isolines at a straight edge through the normal: measured 3.0e-3; at a disc's rim less.
LINES = 4e-3


def limited(mesh: str, **options) -> float:
    return ao(mesh, method="auto", isolines=64, **options)[MIDDLE]


@pytest.mark.parametrize("falloff", DISC)
def test_distance_and_falloff(here, falloff):
    value = limited("both.obj", max_distance=R, falloff=falloff)
    assert value == pytest.approx(1 - DISC[falloff], abs=LINES)
    assert limited("both.obj", max_distance=0.9 * UNIT, falloff=falloff) == 1.0


def test_percents_are_of_the_file_whatever_is_baked_and_blocks(here):
    # The diagonal of both is 3 units, that of the floor sqrt(8).
    for mesh, percent, options in (
        ("both.obj", 100 * R / (3 * UNIT), {}),
        ("both.obj", 100 * R / (3 * UNIT), {"groups": "floor"}),
        ("both.obj", 100 * R / (3 * UNIT), {"self_only": True, "occluders": "lid.obj"}),
        ("floor.obj", 50.0, {"occluders": "lid.obj"}),
    ):
        value = limited(mesh, max_distance=f"{percent}%", **options)
        assert value == pytest.approx(0.5, abs=LINES)
        with np.load("out.npz") as data:
            metadata = json.loads(str(data["metadata"]))
        assert metadata["max_distance"] == pytest.approx(R) and metadata["falloff"] == "none"


def test_spread_and_backfaces(here):
    """A cone of 45 degrees ends where the lid does; and it is the lid's back that the floor sees."""
    assert limited("both.obj", spread=45.0) == pytest.approx(0.0, abs=LIFTED)
    assert limited("both.obj", backfaces="ignore") == 1.0
    assert limited("both.obj") == pytest.approx(1 - LID, abs=LINES)


def test_ground(here):
    """A wall over an infinite ground sees half; what is under ground, nothing."""
    vertical = "\n".join(f"v 0 {UNIT * x} {UNIT * z}" for x, z in GRID)
    quads = "\n".join("f " + " ".join(map(str, quad)) for quad in QUADS)
    (here / "wall.obj").write_text(f"{vertical}\n{quads}\n")

    def wall(**options):
        return ao("wall.obj", method="auto", isolines=64, **options)

    np.testing.assert_allclose(wall(ground=-0.2), 0.5, atol=LINES)
    np.testing.assert_allclose(wall(ground="auto"), 0.5, atol=LINES)
    np.testing.assert_allclose(wall(ground=0), [0.0] * 3 + [0.5] * 6, atol=LINES)
    np.testing.assert_allclose(wall(ground=(0, 0, 2, 0)), [0.0] * 3 + [0.5] * 6, atol=LINES)
    for height in (np.float32(0.25), np.uint8(1), np.array(0.25), Fraction(1, 4)):
        np.testing.assert_array_equal(wall(ground=height), wall(ground=float(height)))
    # Along another axis, and below everything that there is.
    np.testing.assert_allclose(wall(ground=0, up=(0, 1, 0)), [0.0, 0.5, 0.5] * 3, atol=LINES)
    (here / "deep.obj").write_text("v 5 0 -.7\nv 6 0 -.7\nv 5 1 -.7\nf 1 2 3\n")
    for options, height in (({}, -UNIT), ({"occluders": "deep.obj"}, -0.7), ({"up": (0, 0, -1)}, -UNIT)):
        wall(ground="auto", **options)
        with np.load("out.npz") as data:
            plane = json.loads(str(data["metadata"]))["ground"]
        assert plane == pytest.approx([0, 0, options.get("up", (0, 0, 1))[2], -height])


def test_limits_of_other_quantities(here):
    value = ao("both.obj", method="auto", isolines=64, quantity="sky", max_distance=R)[MIDDLE]
    assert value == pytest.approx(0.5, abs=LINES)
    bent = ao("both.obj", method="auto", isolines=64, quantity="bent", max_distance=R)[MIDDLE]
    # 2/3 n less the disc's: int_0^45 2 cos^2 t sin t dt = 2/3 (1 - cos^3 45).
    np.testing.assert_allclose(bent, [0, 0, 2 / 3 * np.sqrt(0.5) ** 3], atol=LINES)


# ---------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"groups": ["wall"]}, "both.obj: has no group 'wall'; it has 'floor', 'lid'"),
        ({"groups": ["floor", "Lid"]}, "both.obj: has no group 'Lid'"),
        ({"groups": [3]}, "groups holds a int"),
        ({"mesh_path": "floor.obj", "groups": "floor"}, "floor.obj: has no groups, so no 'floor'"),
        ({"occluders": ["none.obj"]}, "none.obj: no such file"),
        ({"occluders": ["both.obj", 3]}, "scene is a int"),
        ({"occluders": ["old.ply"], "output": "old.ply"}, "old.ply: is one of the occluders"),
        ({"normals": "file"}, "both.obj: has no normals of its own"),
        ({"max_distance": "far"}, "max_distance is 'far'; expected"),
        ({"max_distance": 0.0}, "max_distance is 0.0"),
        ({"falloff": "linear"}, "falloff is 'linear' without max_distance"),
        ({"spread": 91.0}, "spread is 91.0"),
        ({"quantity": "bent", "weighting": "uniform"}, "weighting 'uniform' given; only quantity 'ao'"),
        ({"up": (0, 1, 0)}, "up given; only quantity 'sky'"),
        ({"quantity": "irradiance", "environment": "none.hdr", "spread": 45}, "'irradiance' has none"),
        ({"backfaces": "cull"}, "backfaces is 'cull'"),
        ({"ground": "low"}, "ground is 'low'; expected a height, 'auto', or a plane's four numbers"),
        ({"ground": np.nan}, "ground is nan"),
        ({"ground": (0, 0, 1)}, "ground has shape (3,)"),
        ({"ground": 0, "method": "exact"}, "ground given with method='exact'"),
        ({"max_distance": 1, "method": "octahedral"}, "max_distance given with method='octahedral'"),
        ({"normals": "hard"}, "normals is 'hard'; expected one of 'auto', 'file', 'smooth', 'flat'"),
    ],
)
def test_bad_options_are_refused_in_one_line(here, options, told):
    (here / "old.ply").write_bytes(trimesh.creation.box().export(file_type="ply"))
    before = sorted(here.iterdir())
    with pytest.raises(InputError) as caught:
        bake(**{"mesh_path": "both.obj", "output": "out.ply", **options})
    assert told in str(caught.value) and "\n" not in str(caught.value)
    assert sorted(here.iterdir()) == before


def test_options_are_checked_before_files_are_read(here):
    with pytest.raises(InputError, match="ground given with method='exact'"):
        bake("none.obj", "out.ply", ground=0, method="exact")
    with pytest.raises(InputError, match=r"^none.obj: no such file"):
        bake("none.obj", "out.ply", ground=0)


def test_of_many_groups_a_few_are_listed(here):
    text = "".join(f"o part{i}\n{floor(i, 9 * i)}" for i in range(10))
    (here / "many.obj").write_text(text)
    with pytest.raises(InputError, match=r"it has 'part0', .*'part5' and 4 more$"):
        bake("many.obj", "out.ply", groups="part10")


def test_a_scene_of_needles_has_nothing_to_integrate(here):
    (here / "needle.obj").write_text("o a\nv 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    for options in ({}, {"self_only": True}, {"per": "face"}, {"normals": "flat"}):
        summary = bake("needle.obj", "out.npz", isolines=8, **options)
        assert summary["without_normal"] == summary["n_points"] and summary["min"] == 1.0
