"""Scenes: what is kept of a file, what is derived, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import silint
from scenes import polyhedra
from scenes.mesh import concatenate, moved
from silint import InputError, Scene, SilhouetteIntegrator

ROUNDING = 1e-14  # a few operations on unit vectors


def refusal(function, *arguments, **options) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert message and "\n" not in message
    return message


# ------------------------------------------------------------------------------------------ what is kept


def test_a_scene_keeps_the_files_own_arrays() -> None:
    # Two triangles of a file that repeats its corners, for the sake of normals or of texture seams.
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    faces = np.array([(0, 1, 2), (3, 4, 5)])
    scene = Scene(vertices, faces, name="quad")
    np.testing.assert_array_equal(scene.vertices, vertices)
    np.testing.assert_array_equal(scene.faces, faces)
    assert scene.vertices.dtype == np.float64 and scene.faces.dtype == np.int32
    assert (scene.n_vertices, scene.n_faces, scene.normals) == (6, 2, None)
    assert repr(scene) == "<silint.Scene 'quad': 2 triangles, 6 vertices>"
    # Connected all the same.
    assert scene.defects["welded_vertices"] == 2 and scene.defects["boundary_edges"] == 4


def test_a_scene_is_immutable_and_its_own() -> None:
    vertices, faces = polyhedra.box()
    scene = Scene(vertices, faces, normals=vertices, groups=["all"], face_groups=np.zeros(len(faces), int))
    assert scene.groups == ("all",) and scene.face_groups.dtype == np.int32
    for array in (scene.vertices, scene.faces, scene.normals, scene.face_groups):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    vertices[0] = faces[0] = 0  # the caller's arrays stay the caller's
    assert scene.vertices[0].any() and scene.faces[0].any()
    scene.defects["boundary_edges"] = 99
    assert scene.defects["boundary_edges"] == 0


@pytest.mark.parametrize(("dtype", "float32"), [(np.float64, False), (np.float32, True), (np.float16, True)])
def test_scenes_remember_what_their_coordinates_are_worth(dtype: type, float32: bool) -> None:
    vertices, faces = polyhedra.box()
    assert Scene(vertices.astype(dtype), faces).float32_source is float32
    assert Scene(vertices.tolist(), faces.tolist()).float32_source is False


def test_extent_is_that_of_the_faces() -> None:
    vertices, faces = polyhedra.box((1.0, 2.0, 3.0))
    assert Scene(vertices, faces).extent == 3.0
    assert Scene([*vertices, (100.0, 0.0, 0.0)], faces).extent == 3.0


def test_from_trimesh_applies_transforms() -> None:
    mesh = trimesh.creation.box()
    scene = Scene.from_trimesh(mesh)
    np.testing.assert_array_equal(scene.vertices, mesh.vertices)
    np.testing.assert_array_equal(scene.faces, mesh.faces)
    graph = trimesh.Scene()
    for x in (0.0, 5.0):
        graph.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    both = Scene.from_trimesh(graph)
    assert both.n_faces == 24 and both.extent == 6.0


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb", ".off"])
def test_load_scene_reads_any_mesh_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh{suffix}"
    mesh = trimesh.Trimesh(*polyhedra.icosphere(1), process=False)
    mesh.export(path)
    scene = silint.load_scene(path)
    assert scene.n_faces == 80 and scene.name
    # STL repeats every corner; positions weld all the same.
    assert not any(v for k, v in scene.defects.items() if k != "welded_vertices")
    assert len(scene.topology.vertices) == 42
    assert scene.extent == pytest.approx(mesh.extents.max(), rel=1e-6)


# ---------------------------------------------------------------------------------------------- normals


def test_vertex_normals_are_weighted_by_angle() -> None:
    # A corner of a box has three faces at right angles, some of them cut in two: diagonals do not count.
    scene = Scene(*polyhedra.box())
    normals, valid = scene.vertex_normals()
    assert valid.all()
    np.testing.assert_allclose(normals, scene.vertices / 3**0.5, rtol=0, atol=ROUNDING)


def test_vertices_at_one_place_share_their_normal() -> None:
    vertices, faces = polyhedra.icosphere(1)
    split = Scene(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))
    whole = Scene(vertices, faces)
    np.testing.assert_allclose(
        split.vertex_normals()[0], whole.vertex_normals()[0][faces.ravel()], rtol=0, atol=ROUNDING
    )
    np.testing.assert_allclose(
        whole.vertex_normals()[0], vertices, rtol=0, atol=0.02
    )  # of a sphere: outwards


def test_the_files_own_normals_come_first() -> None:
    vertices, faces = polyhedra.box()
    own = np.tile([0.0, 3.0, 4.0], (8, 1))
    own[0], own[1], own[2] = 0.0, np.nan, 1e-300
    normals, valid = Scene(vertices, faces, own).vertex_normals()
    assert valid.all()
    np.testing.assert_allclose(normals[3:], [[0.0, 0.6, 0.8]] * 5, rtol=0, atol=ROUNDING)
    # Missing ones are replaced; a tiny one is a direction like any other.
    derived = Scene(vertices, faces).vertex_normals()[0]
    np.testing.assert_array_equal(normals[:2], derived[:2])
    np.testing.assert_allclose(normals[2], 3**-0.5, rtol=0, atol=ROUNDING)


def test_vertices_without_a_normal_say_so() -> None:
    # Of no face; of a face without area; and between two faces back to back.
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 5, 5), (3, 0, 0), (4, 0, 0), (6, 0, 0)]
    normals, valid = Scene(vertices, [(0, 1, 2), (0, 2, 1), (4, 5, 6)]).vertex_normals()
    assert not valid.any()
    np.testing.assert_array_equal(normals, [[0.0, 0.0, 1.0]] * 7)
    assert np.isfinite(Scene(vertices, [(0, 1, 2), (4, 5, 6)]).vertex_normals()[0]).all()


def test_an_unused_vertex_where_others_meet_has_no_normal() -> None:
    vertices, faces = polyhedra.box()
    _, valid = Scene([*vertices, vertices[0]], faces).vertex_normals()
    assert valid.tolist() == [True] * 8 + [False]


def test_smooth_normals_on_request() -> None:
    vertices, faces = polyhedra.box()
    own = np.tile([0.0, 0.0, 2.0], (8, 1))
    own[1], own[2] = 0.0, np.nan
    scene = Scene(vertices, faces, own)
    assert scene.own_normals.tolist() == [True, False, False, True, True, True, True, True]
    smooth = Scene(vertices, faces).vertex_normals()[0]
    np.testing.assert_array_equal(scene.vertex_normals(smooth=True)[0], smooth)
    assert not np.array_equal(scene.vertex_normals()[0], smooth)
    assert not Scene(vertices, faces).own_normals.any()


def test_face_centers_and_normals() -> None:
    vertices = [(0, 0, 0), (3, 0, 0), (0, 3, 0), (6, 0, 0)]
    centers, normals, valid = Scene(
        vertices, [(0, 1, 2), (0, 2, 1), (0, 1, 3), (0, 1, 1)]
    ).face_centers_normals()
    assert valid.tolist() == [True, True, False, False]
    np.testing.assert_allclose(centers, [(1, 1, 0), (1, 1, 0), (3, 0, 0), (2, 0, 0)], rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(normals, [(0, 0, 1), (0, 0, -1), (0, 0, 1), (0, 0, 1)])


@pytest.mark.parametrize("exponent", [-300, 400])
def test_normals_have_no_unit(exponent: int) -> None:
    vertices, faces = polyhedra.icosahedron()
    a, b = Scene(vertices, faces), Scene(np.ldexp(vertices, exponent), faces)
    np.testing.assert_array_equal(a.vertex_normals()[0], b.vertex_normals()[0])
    np.testing.assert_array_equal(a.face_centers_normals()[1], b.face_centers_normals()[1])


# --------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("vertices", "faces", "told"),
    [
        (np.zeros((0, 3)), [(0, 1, 2)], "vertices is empty"),
        (np.zeros((3, 3)), np.zeros((0, 3), int), "faces is empty"),
        (np.zeros((3, 2)), [(0, 1, 2)], "vertices has shape (3, 2)"),
        (np.full((3, 3), np.nan), [(0, 1, 2)], "vertices must be finite"),
        (np.full((3, 3), np.inf), [(0, 1, 2)], "vertices must be finite"),
        (np.eye(3), [(0, 1, 3)], "faces has indices outside 0..2"),
        (np.eye(3), [(0, 1, -1)], "faces has indices outside 0..2"),
        (np.eye(3), [(0, 1, 2, 0)], "split polygons into triangles"),
        (np.eye(3), [(0.0, 1.0, 2.0)], "faces has dtype float64"),
    ],
)
def test_what_is_no_mesh(vertices: object, faces: object, told: str) -> None:
    assert told in refusal(Scene, vertices, faces)


def test_normals_of_the_wrong_shape() -> None:
    assert "normals has shape (1, 3); expected (8, 3)" in refusal(
        Scene, *polyhedra.box(), normals=[[0, 0, 1]]
    )


@pytest.mark.parametrize("normals", [[["a", "b", "c"]] * 8, [[0, 0, 1], [0, 0]], None])
def test_normals_that_are_no_numbers(normals: object) -> None:
    if normals is not None:
        assert "normals" in refusal(Scene, *polyhedra.box(), normals=normals)
    else:
        assert Scene(*polyhedra.box(), normals=None).normals is None


@pytest.mark.parametrize(
    ("groups", "face_groups", "told"),
    [
        (["a"], None, "groups and face_groups belong together"),
        ([], [0, 0], "groups and face_groups belong together"),
        (["a"], [0], "face_groups is int64 of shape (1,); expected integers, shape (2,)"),
        (["a"], [0.0, 0.0], "face_groups is float64 of shape (2,)"),
        (["a"], [0, 1], "face_groups has values outside 0..0: 0 to 1"),
        (["a", "b"], [-1, 1], "face_groups has values outside 0..1: -1 to 1"),
        (["a"], ["x", "y"], "face_groups"),
    ],
)
def test_groups_that_do_not_fit(groups: list[str], face_groups: object, told: str) -> None:
    faces = [(0, 1, 2), (2, 1, 0)]
    assert told in refusal(Scene, np.eye(3), faces, groups=groups, face_groups=face_groups)


def test_files_that_are_no_scene(tmp_path: Path) -> None:
    assert "missing.obj" in refusal(silint.load_scene, tmp_path / "missing.obj")
    nonsense = tmp_path / "nonsense.ply"
    nonsense.write_text("this is no mesh")
    assert "nonsense.ply" in refusal(silint.load_scene, nonsense)


# ------------------------------------------------------------------------------- any triangles will do


def test_every_defect_in_one_scene_still_integrates() -> None:
    """The value is that of the sound parts; counts tell the rest."""
    ball = moved(polyhedra.icosphere(1), (0.3, 0.2, 2.0))
    vertices, faces = ball
    n = len(vertices)
    vertices = np.concatenate([vertices, vertices[:2], [[7, 7, 7]], [[0, 5, -5], [1, 5, -5], [2, 5, -5]]])
    faces = np.concatenate(
        [
            faces,
            faces[:3],  # again
            faces[3:6, ::-1],  # again, from behind
            [[n + 3, n + 4, n + 5], [0, 0, 1], [0, n, 5]],  # without area
        ]
    )
    scene = Scene(vertices, faces)
    defects = scene.defects
    assert defects["duplicate_faces"] == 6 and defects["zero_area_faces"] == 3
    assert defects["unreferenced_vertices"] == 2 and defects["welded_vertices"] == 2
    assert defects["boundary_edges"] == 3 and defects["non_manifold_edges"] > 0
    points, normals = np.zeros((4, 3)), np.array([(0, 0, 1), (1, 0, 1), (0, -1, 0.3), (0.2, 0.1, -0.5)])
    found = SilhouetteIntegrator(scene).ambient_occlusion(points, normals)
    sound = SilhouetteIntegrator(Scene(*ball)).ambient_occlusion(points, normals)
    np.testing.assert_allclose(found, sound, rtol=0, atol=1e-9)


def test_scenes_are_compared_by_what_they_hide_not_by_how() -> None:
    """Two solids that interpenetrate are their union."""
    a, b = polyhedra.box((2.0, 1.0, 1.0)), moved(polyhedra.box((2.0, 1.0, 1.0)), (1.0, 0.0, 0.0))
    union = moved(polyhedra.box((3.0, 1.0, 1.0)), (0.5, 0.0, 0.0))
    rng = np.random.default_rng(2)
    points, normals = rng.uniform(-3, 3, (60, 3)), rng.normal(size=(60, 3))
    both = SilhouetteIntegrator(Scene(*concatenate([a, b]))).ambient_occlusion(points, normals, 16)
    one = SilhouetteIntegrator(Scene(*union)).ambient_occlusion(points, normals, 16)
    np.testing.assert_allclose(both, one, rtol=0, atol=1e-9)
