"""The integrator's interface: what it takes, refuses, reports and plans."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import scenes
import silint
import silint.finder
from scenes import polyhedra
from scenes.clutter import clutter
from scenes.mesh import concatenate, moved
from silint import InputError, Result, Scene, SilhouetteIntegrator
from silint.core.integrands import fractions, moments
from silint.core.search import TILE
from silint.core.topology import edges_of

QUERIES = ("ambient_occlusion", "sky_view_factor", "bent_normals")
METHODS = ("octahedral", "radial")
K = 8


def ball_and_sheet() -> tuple[np.ndarray, np.ndarray]:
    return concatenate(
        [moved(polyhedra.icosahedron(), (0.3, 0.2, 2.0)), moved(polyhedra.fin(3), (-1.0, 0.5, 0.5))]
    )


@pytest.fixture(scope="module")
def integrator() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*ball_and_sheet()))


@pytest.fixture(scope="module")
def shade() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(-1, 1, (20, 3)), rng.normal(size=(20, 3)) + [0.0, 0.0, 1.0]


def refusal(function: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """The message of the InputError that a call must raise; always a single line."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert message and "\n" not in message
    return message


# ---------------------------------------------------------------------------------------------- inputs


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("query", QUERIES)
def test_any_layout_of_points_will_do(
    integrator: SilhouetteIntegrator, shade: tuple, query: str, method: str
) -> None:
    points, normals = shade
    ask = getattr(integrator, query)
    expected = ask(points, normals, isolines=K, method=method)
    frozen_points, frozen_normals = points.copy(), normals.copy()
    frozen_points.setflags(write=False)
    frozen_normals.setflags(write=False)
    wide = np.zeros((40, 6))
    wide[::2, ::2] = points
    for p, n in (
        (points.tolist(), normals.tolist()),
        (tuple(map(tuple, points)), normals),
        (frozen_points, frozen_normals),
        (wide[::2, ::2], np.asfortranarray(normals)),
        (points.astype(">f8"), normals[::-1].copy()[::-1]),
        (points.astype(np.longdouble), normals),
        (points, 7.0 * normals),  # lengths of normals mean nothing; 7 times is rounded
    ):
        np.testing.assert_allclose(ask(p, n, isolines=K, method=method), expected, rtol=0, atol=1e-13)
    # What was handed in is as it was.
    np.testing.assert_array_equal(points, frozen_points)
    np.testing.assert_array_equal(normals, frozen_normals)


@pytest.mark.parametrize("method", METHODS)
def test_float32_points_are_lifted_further(
    integrator: SilhouetteIntegrator, shade: tuple, method: str
) -> None:
    points, normals = shade
    rounded = points.astype(np.float32)
    ask = integrator.ambient_occlusion
    # 2^-18 of the scene, which moves an outline seen from its own size away by 4e-6 of the view.
    np.testing.assert_allclose(
        ask(rounded, normals, K, method=method),
        ask(rounded.astype(np.float64), normals, K, method=method),
        rtol=0,
        atol=1e-4,
    )
    # On a face that came as float32 a point may lie behind it by 1e-7: it must not see the inside.
    vertices, faces = polyhedra.icosphere(2)
    for v, p in ((np.float32, np.float64), (np.float64, np.float32), (np.float32, np.float32)):
        scene = Scene(vertices.astype(v), faces)
        centers, face_normals, _ = scene.face_centers_normals()
        value = SilhouetteIntegrator(scene).ambient_occlusion(
            centers.astype(p), face_normals, K, method=method
        )
        np.testing.assert_array_equal(value, 1.0)


def test_integers_are_points_as_good_as_any(integrator: SilhouetteIntegrator) -> None:
    ask = integrator.ambient_occlusion
    np.testing.assert_array_equal(ask([[0, 0, 0]], [[0, 0, 1]]), ask([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]))


@pytest.mark.parametrize("query", QUERIES)
def test_no_points_no_values(integrator: SilhouetteIntegrator, query: str) -> None:
    ask = getattr(integrator, query)
    shape = (0, 3) if query == "bent_normals" else (0,)
    for empty in ([], np.zeros((0, 3)), np.zeros((0, 3), np.float32)):
        assert ask(empty, empty).shape == shape
    result = ask([], [], full_output=True)
    assert result.diagnostics["points"] == 0 and len(result.error_estimate) == 0
    assert ask([], [], progress=lambda *_: pytest.fail("nothing to report")).shape == shape


@pytest.mark.parametrize("query", [*QUERIES, "visibility"])
@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"points": [1.0, 2.0, 3.0]}, r"points has shape (3,); expected (n, 3): write [[x, y, z]]"),
        ({"points": [[1.0, 2.0]]}, "points has shape (1, 2); expected (n, 3)"),
        ({"points": [[np.nan, 0, 0]]}, "points must be finite; NaN or infinity in row 0"),
        ({"points": [["a", "b", "c"]]}, "points has dtype <U1"),
        ({"points": [[1e300, 0, 0]]}, "points row 0 lies more than 1e100 scene extents away"),
        ({"normals": [[0, 0, 0]]}, "normals must not be zero; row 0"),
        ({"normals": [[0, np.inf, 1]]}, "normals must be finite"),
        ({"normals": [[0, 0, 1]] * 2}, "normals has 2 rows, but there are 1 points"),
        ({"isolines": 0}, "isolines is 0; expected an integer, 1 to"),
        ({"isolines": 64.0}, "isolines is 64.0; expected an integer"),
        ({"isolines": True}, "isolines is True; expected an integer"),
        ({"isolines": 10**9}, "isolines is 1000000000; expected an integer, 1 to"),
        ({"method": "magic"}, "method is 'magic'; expected one of 'auto', 'octahedral'"),
        ({"method": None}, "method is None; expected one of"),
    ],
)
def test_what_cannot_be_asked(integrator: SilhouetteIntegrator, query: str, options: dict, told: str) -> None:
    request = {"points": [[0.0, 0.0, 0.0]], "normals": [[0.0, 0.0, 1.0]]} | options
    assert told in refusal(getattr(integrator, query), **request)


def test_options_of_single_queries(integrator: SilhouetteIntegrator) -> None:
    one = [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]
    assert "weighting is 'flat'; expected one of 'cosine', 'uniform'" == refusal(
        integrator.ambient_occlusion, *one, weighting="flat"
    )
    assert "up is" in refusal(integrator.sky_view_factor, *one, up=(0, 0, 0))
    assert "up has shape (2,)" in refusal(integrator.sky_view_factor, *one, up=(0, 1))
    assert "request is 'everything'" in refusal(integrator.explain, "everything")
    assert "weighting is 'flat'" in refusal(integrator.explain, "ambient_occlusion", weighting="flat")
    assert "isolines is 0" in refusal(integrator.explain, "ambient_occlusion", isolines=0)


def test_scenes_come_as_scenes_paths_and_trimesh_objects(tmp_path: Path) -> None:
    vertices, faces = ball_and_sheet()
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    path = tmp_path / "mesh.ply"
    mesh.export(path)
    graph = trimesh.Scene()
    graph.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([0, 0, 1]))
    one = [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]
    expected = SilhouetteIntegrator(Scene(vertices, faces)).ambient_occlusion(*one)
    # A PLY holds float32: vertices move by 1e-7, and points are lifted by 4e-6.
    for source, atol in ((mesh, 0.0), (path, 1e-4), (str(path), 1e-4)):
        np.testing.assert_allclose(
            SilhouetteIntegrator(source).ambient_occlusion(*one), expected, rtol=0, atol=atol
        )
        np.testing.assert_allclose(silint.ambient_occlusion(source, *one), expected, rtol=0, atol=atol)
    lifted = SilhouetteIntegrator(graph).ambient_occlusion([[0.0, 0.0, 1.0]], one[1])
    np.testing.assert_allclose(lifted, expected, rtol=0, atol=1e-9)
    assert "scene is a int" in refusal(SilhouetteIntegrator, 3)
    assert "nowhere.ply" in refusal(SilhouetteIntegrator, tmp_path / "nowhere.ply")


# -------------------------------------------------------------------------------------------- one-shot


def test_by_default_every_vertex_of_the_file_in_order() -> None:
    vertices, faces = ball_and_sheet()
    vertices = np.concatenate([vertices, [[9.0, 9.0, 9.0], [8.0, 8.0, 8.0]]])  # in no face
    scene = Scene(vertices, faces)
    result = silint.ambient_occlusion(scene, isolines=K, full_output=True)
    assert result.value.shape == result.error_estimate.shape == (len(vertices),)
    # Points without a normal count as open, and are counted.
    normals, valid = scene.vertex_normals()
    assert not valid[-2:].any()
    # On the fin's spine the normals of three sheets at 120 degrees cancel too.
    assert result.diagnostics["without_normal"] == (~valid).sum() == 4
    assert (result.value[~valid] == 1.0).all()
    assert result.diagnostics["points"] == valid.sum()
    expected = SilhouetteIntegrator(scene).ambient_occlusion(vertices[valid], normals[valid], K)
    np.testing.assert_array_equal(result.value[valid], expected)
    np.testing.assert_array_equal(silint.ambient_occlusion(scene, isolines=K), result.value)
    assert 0.0 < result.value.min() < 0.9


def test_one_shot_options_are_the_integrators(shade: tuple) -> None:
    scene = Scene(*ball_and_sheet())
    points, normals = shade
    found = silint.ambient_occlusion(scene, points, normals, isolines=K, weighting="uniform")
    expected = SilhouetteIntegrator(scene).ambient_occlusion(points, normals, K, "uniform")
    np.testing.assert_array_equal(found, expected)
    assert "normals is None" in refusal(silint.ambient_occlusion, scene, points)
    assert "normals given without points" in refusal(silint.ambient_occlusion, scene, normals=normals)
    assert "isolines is -1" in refusal(silint.ambient_occlusion, scene, isolines=-1)


# ----------------------------------------------------------------------------------------- full output


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("query", QUERIES)
def test_full_output(integrator: SilhouetteIntegrator, shade: tuple, query: str, method: str) -> None:
    ask = getattr(integrator, query)
    plain = ask(*shade, isolines=K, method=method)
    result = ask(*shade, isolines=K, method=method, full_output=True)
    assert isinstance(result, Result)
    np.testing.assert_array_equal(result.value, plain)
    assert result.error_estimate.shape == (20,)
    assert ((result.error_estimate >= 0) & (result.error_estimate <= 1)).all()
    assert set(result.diagnostics) == {
        "points",
        "isolines",
        "buried",
        "swept_points",
        "covered_points",
        "exact_points",
        "second_frames",
        "uncertified_points",
        "fallback_isolines",
        "snapped_sides",
        "nodes_visited",
        "edges_tested",
        "contour_edges",
        "crossings",
    }
    told = result.diagnostics
    assert (told["points"], told["isolines"], told["fallback_isolines"]) == (20, K, 0)
    assert 0 < told["contour_edges"] <= told["edges_tested"]
    assert told["nodes_visited"] > 0 and told["crossings"] > 0


@pytest.mark.parametrize("method", METHODS)
def test_diagnostics_count_what_happened(method: str) -> None:
    box = SilhouetteIntegrator(Scene(*polyhedra.box()))
    inside, outside = [0.1, 0.2, 0.3], [3.0, 0.2, 0.3]
    result = box.ambient_occlusion(
        [inside, outside, inside], [[-1, 0, 0]] * 3, K, method=method, full_output=True
    )
    assert result.diagnostics["buried"] == 2
    assert result.value[0] == result.value[2] == 0.0 < result.value[1]
    assert result.diagnostics["snapped_sides"] == 0
    # In the plane of the top, which is a contour's face: a rule decides its side.
    result = box.ambient_occlusion([[3.0, 0.2, 1.0]], [[-1, 0, 0]], K, method=method, full_output=True)
    assert result.diagnostics["snapped_sides"] > 0


@pytest.mark.parametrize("method", METHODS)
def test_the_error_estimate_bounds_the_error(method: str) -> None:
    """From the differences of interleaved groups of lines: larger than the error, nearly always."""
    integrator = SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(2), (0.3, 0.2, 1.5))))
    rng = np.random.default_rng(1)
    points, normals = (
        rng.uniform(-0.8, 0.8, (200, 3)) * [1, 1, 0.3],
        rng.normal(size=(200, 3)) * 0.5 + [0, 0, 1],
    )
    fine = integrator.ambient_occlusion(points, normals, 1024, method="octahedral")
    for k in (16, 64):
        result = integrator.ambient_occlusion(points, normals, k, method=method, full_output=True)
        error = np.abs(result.value - fine)
        # Radial lines are judged by four groups, of four lines each at 16.
        assert (error <= result.error_estimate).mean() > (0.85 if method == "radial" and k == 16 else 0.9)
        assert np.sqrt((error**2).mean()) < np.sqrt((result.error_estimate**2).mean()) < 0.2


def ball_over_nothing() -> tuple[SilhouetteIntegrator, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    integrator = SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(2), (0.3, 0.2, 1.5))))
    return integrator, rng.uniform(-1, 1, (150, 3)) * [1, 1, 0.2], rng.normal(size=(150, 3)) * 0.5 + [0, 0, 1]


def clutter_on_its_own() -> tuple[SilhouetteIntegrator, np.ndarray, np.ndarray]:
    mesh = clutter(1, 2)
    return SilhouetteIntegrator(Scene(*mesh)), *scenes.shade_points(*mesh, 150, seed=4)


@pytest.mark.parametrize("scene", [ball_over_nothing, clutter_on_its_own])
@pytest.mark.parametrize("method", METHODS)
def test_a_tolerance_is_met(scene: Callable, method: str) -> None:
    integrator, points, normals = scene()
    other = METHODS[1 - METHODS.index(method)]
    fine = integrator.ambient_occlusion(points, normals, 2048, method=other)
    most = 0
    for tolerance in (0.02, 0.004):
        result = integrator.ambient_occlusion(
            points, normals, tolerance=tolerance, method=method, full_output=True
        )
        told = result.diagnostics
        assert told["points"] == len(points)
        assert told["above_tolerance"] == (result.error_estimate > tolerance).sum() == 0
        error = np.abs(result.value - fine)
        assert (error <= tolerance).mean() >= 0.95
        # More lines for less error, and for the points that need them only.
        assert most < told["isolines"] <= 4096
        most = told["isolines"]
        alone = integrator.ambient_occlusion(points[:3], normals[:3], tolerance=tolerance, method=method)
        np.testing.assert_array_equal(alone, result.value[:3])


def test_what_no_number_of_lines_reaches_is_counted(integrator: SilhouetteIntegrator, shade: tuple) -> None:
    points, normals = shade[0][:3], shade[1][:3]
    result = integrator.ambient_occlusion(
        points, normals, tolerance=1e-300, method="radial", full_output=True
    )
    n_above = int((result.error_estimate > 1e-300).sum())
    assert result.diagnostics["above_tolerance"] == n_above > 0
    assert result.diagnostics["isolines"] == 4096
    np.testing.assert_array_equal(result.value, integrator.ambient_occlusion(points, normals, 4096))


def test_points_that_need_many_lines_take_arcs(integrator: SilhouetteIntegrator, shade: tuple) -> None:
    result = integrator.ambient_occlusion(*shade, tolerance=1e-9, full_output=True)
    told = result.diagnostics
    assert told["points"] == len(shade[0]) and 0 < told["exact_points"] <= told["points"]
    assert told["above_tolerance"] == 0 and result.error_estimate.max() <= 1e-9
    exact = integrator.ambient_occlusion(*shade, method="exact")
    np.testing.assert_allclose(result.value, exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("query", QUERIES)
def test_every_query_takes_a_tolerance(integrator: SilhouetteIntegrator, shade: tuple, query: str) -> None:
    result = getattr(integrator, query)(*shade, tolerance=0.05, full_output=True)
    assert (result.error_estimate <= 0.05).all() and result.diagnostics["above_tolerance"] == 0
    assert getattr(integrator, query)([], [], tolerance=0.05).shape[0] == 0


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("tolerance", [0, -1, 0.0, -0.5, np.nan, np.inf, "x", True, [0.1]])
def test_what_is_no_tolerance(integrator: SilhouetteIntegrator, query: str, tolerance: Any) -> None:
    told = refusal(getattr(integrator, query), [[0, 0, 0]], [[0, 0, 1]], tolerance=tolerance)
    assert told.startswith("tolerance is ")


@pytest.mark.parametrize("query", QUERIES)
def test_lines_and_a_tolerance_are_two_ways_to_say_one_thing(
    integrator: SilhouetteIntegrator, query: str
) -> None:
    ask = getattr(integrator, query)
    told = refusal(ask, [[0, 0, 0]], [[0, 0, 1]], isolines=64, tolerance=0.01)
    assert "isolines" in told and "tolerance" in told


def test_radial_lines_come_in_even_numbers(integrator: SilhouetteIntegrator, shade: tuple) -> None:
    def ask(k: int) -> np.ndarray:
        return integrator.ambient_occlusion(*shade, k, method="radial")

    for odd, even in ((1, 4), (2, 4), (3, 4), (5, 6), (31, 32)):
        np.testing.assert_array_equal(ask(odd), ask(even))
    assert (ask(4) != ask(6)).any()


def test_radial_lines_are_the_default(integrator: SilhouetteIntegrator, shade: tuple) -> None:
    for query in QUERIES:
        ask = getattr(integrator, query)
        radial = ask(*shade, isolines=K, method="radial")
        np.testing.assert_array_equal(ask(*shade, isolines=K), radial)
        assert (ask(*shade, isolines=K, method="octahedral") != radial).any()
    assert "method is 'radial'" in refusal(integrator.visibility, *shade, method="radial")


@pytest.mark.parametrize("method", METHODS)
def test_progress_is_reported(
    integrator: SilhouetteIntegrator, method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(silint.finder, "_PER_BLOCK", TILE)
    points, normals = np.zeros((300, 3)), np.tile([0.0, 0.0, 1.0], (300, 1))
    seen: list[tuple[int, int]] = []
    integrator.ambient_occlusion(
        points, normals, K, method=method, progress=lambda done, total: seen.append((done, total))
    )
    assert {total for _, total in seen} == {300}
    done = [d for d, _ in seen]
    assert done == sorted(done) and done[-1] == 300 and len(done) > 1


@pytest.mark.parametrize("method", METHODS)
def test_a_progress_callback_may_stop_the_work(integrator: SilhouetteIntegrator, method: str) -> None:
    class StopError(Exception):
        pass

    def stop(done: int, total: int) -> None:
        raise StopError

    points, normals = np.zeros((300, 3)), np.tile([0.0, 0.0, 1.0], (300, 1))
    with pytest.raises(StopError):
        integrator.ambient_occlusion(points, normals, K, method=method, progress=stop)
    # No lock is left behind.
    assert integrator.ambient_occlusion(points[:1], normals[:1], K).shape == (1,)


def test_one_integrator_serves_many_threads(integrator: SilhouetteIntegrator, shade: tuple) -> None:
    points, normals = (np.tile(a, (20, 1)) for a in shade)
    jobs = [(query, k, method) for query in QUERIES for k in (5, 8) for method in METHODS] * 2

    def ask(job: tuple[str, int, str]) -> np.ndarray:
        return getattr(integrator, job[0])(points, normals, isolines=job[1], method=job[2])

    expected = {job: ask(job) for job in set(jobs)}
    with ThreadPoolExecutor(2) as pool:
        for job, found in zip(jobs, pool.map(ask, jobs), strict=True):
            np.testing.assert_array_equal(found, expected[job])


# -------------------------------------------------------------------------------------- plan and memory


def test_the_plan_of_a_closed_mesh_leaves_the_boundary_hierarchy_out() -> None:
    plan = SilhouetteIntegrator(Scene(*polyhedra.icosphere(1))).plan
    parts = plan.as_dict()
    assert not parts["boundary hierarchy"]["built"]
    assert parts["boundary hierarchy"]["reason"] == "closed mesh: every edge has two faces"
    assert parts["boundary hierarchy"]["bytes"] == 0
    assert parts["contour hierarchy"]["built"] and "120 edges" in parts["contour hierarchy"]["reason"]
    text = str(plan)
    assert text.startswith("scene: 80 triangles")
    assert all(name in text and part["reason"] in text for name, part in parts.items())


def test_the_plan_of_an_open_mesh_says_what_is_needed(integrator: SilhouetteIntegrator) -> None:
    parts = integrator.plan.as_dict()
    assert parts["boundary hierarchy"]["built"] and "7 edges" in parts["boundary hierarchy"]["reason"]
    sheet = SilhouetteIntegrator(Scene(*polyhedra.triangle())).plan.as_dict()
    assert not sheet["contour hierarchy"]["built"]
    assert sheet["contour hierarchy"]["reason"] == "no edge has two faces"


def test_the_plans_bytes_are_those_of_the_arrays(integrator: SilhouetteIntegrator) -> None:
    parts = integrator.plan.as_dict()
    held = {name: size for name, size in integrator.memory.items() if size}
    assert {name: part["bytes"] for name, part in parts.items() if part["bytes"]} == held
    topology = integrator.scene.topology
    assert integrator.memory["topology"] == sum(array.nbytes for array in topology)
    assert integrator.plan.n_bytes == sum(integrator.memory.values())


REQUESTS = [
    ("ambient_occlusion", "cosine", {1}),
    ("ambient_occlusion", "uniform", {0}),
    ("sky_view_factor", "cosine", {1}),
    ("bent_normals", "cosine", {1, 2}),
    ("visibility", "cosine", set()),
]


@pytest.mark.parametrize(("request_name", "weighting", "orders"), REQUESTS)
def test_a_request_builds_the_tables_that_it_explains(
    integrator: SilhouetteIntegrator,
    monkeypatch: pytest.MonkeyPatch,
    request_name: str,
    weighting: str,
    orders: set[int],
) -> None:
    names = {0: "solid angle table", 1: "first moment table", 2: "second moment table"}
    built: set[int] = set()

    def counted(order: int, isolines: int) -> object:
        assert isolines == K
        built.add(order)
        return moments.moment_table(order, isolines)

    monkeypatch.setattr(fractions, "moment_table", counted)
    plan = integrator.explain(request_name, isolines=K, weighting=weighting, method="octahedral")
    parts = plan.as_dict()
    explained = {order for order, name in names.items() if parts[name]["built"]}
    options: dict[str, Any] = {"weighting": weighting} if request_name == "ambient_occlusion" else {}
    getattr(integrator, request_name)(
        [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], isolines=K, method="octahedral", **options
    )
    assert built == explained == orders
    for order, name in names.items():
        size = moments.moment_table(order, K).values.nbytes if order in orders else 0
        assert parts[name]["bytes"] == size
        if order not in orders:
            assert parts[name]["reason"] == f"{request_name} does not need it"
    assert parts["second horizon"]["built"] == (request_name == "sky_view_factor")
    assert parts["boundary search"]["built"] and parts["sweep"]["built"] and not parts["cover"]["built"]
    assert str(plan).startswith(f"{request_name}, {K} octahedral isolines")


def test_explain_knows_closed_meshes() -> None:
    parts = SilhouetteIntegrator(Scene(*polyhedra.box())).explain("ambient_occlusion").as_dict()
    assert not parts["boundary search"]["built"]
    assert parts["boundary search"]["reason"] == "closed mesh: no boundary edges"


# Leaves share no vertices, and have 2.3 edges a triangle where a closed mesh has 1.5.
@pytest.mark.parametrize(("name", "most"), [("clutter_31k", 200), ("foliage", 250)])
def test_hierarchies_and_topology_are_small(name: str, most: int) -> None:
    integrator = SilhouetteIntegrator(Scene(*scenes.build(name)))
    per_triangle = integrator.plan.n_bytes / integrator.scene.n_faces
    assert 100 < per_triangle <= most


def test_a_radial_request_builds_no_table(
    integrator: SilhouetteIntegrator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fractions, "moment_table", lambda *_: pytest.fail("a table was built"))
    for request_name in ("ambient_occlusion", "sky_view_factor", "bent_normals"):
        plan = integrator.explain(request_name, isolines=K)
        parts = plan.as_dict()
        assert not parts["tables"]["built"]
        assert parts["sweep"]["built"] != parts["cover"]["built"]
        result = getattr(integrator, request_name)(
            [[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], isolines=K, full_output=True
        )
        # Served the way that was explained.
        served = "covered_points" if parts["cover"]["built"] else "swept_points"
        assert result.diagnostics[served] == 1
        assert str(plan).startswith(f"{request_name}, {max(K + K % 2, 4)} radial isolines")


@pytest.mark.slow
def test_the_search_tests_less_than_40_percent_of_the_edges() -> None:
    vertices, faces = scenes.build("clutter_31k")
    integrator = SilhouetteIntegrator(Scene(vertices, faces))
    p, n = scenes.shade_points(vertices, faces, 256, seed=1)
    told = integrator.ambient_occlusion(p, n, 64, full_output=True).diagnostics
    assert told["edges_tested"] < 0.4 * 256 * len(edges_of(integrator.scene.topology).ends)
    assert told["fallback_isolines"] == 0


def test_an_integrator_names_its_scene(integrator: SilhouetteIntegrator) -> None:
    assert repr(integrator) == "<silint.SilhouetteIntegrator of <silint.Scene: 23 triangles, 17 vertices>>"
