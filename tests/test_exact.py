"""The exact mode: values right to rounding, from the boundary of what a point sees.

The first part tests the oracle, the second what the integrator does with method="exact".
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import assume, given, settings

from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import boxes, concatenate
from silint import Scene, SilhouetteIntegrator
from silint.reference.analytic_scenes import AnalyticScene, analytic_scenes
from silint.validation import InputError
from tests import exact_oracle as oracle
from tests.exact_scenes import (
    CONTACT,
    EXACT,
    ExactScene,
    Mesh,
    closed_form_scenes,
    contact_rows,
    integer_boxes,
    oracle_scenes,
    radial_ao,
    random_rows,
    reduced_scenes,
    rotation,
    scene,
)

FORMULAS = closed_form_scenes()
ORACLES = [*oracle_scenes(6), *reduced_scenes()]


# A value is a sum of a few hundred arcs, each good to some 1e-16.
ROUNDING = 1e-12


def lifted(s: SilhouetteIntegrator, p: np.ndarray, n: np.ndarray) -> oracle.Arcs:
    """What the oracle sees from the integrator's shade points, in its units."""
    return oracle.arcs_of(s.scene.topology.vertices, s.scene.topology.faces, *s._finder.shade_points(p, n))


@cache
def of_oracle(name: str) -> oracle.Arcs:
    found = next(s for s in (*FORMULAS, *ORACLES) if s.name == name)
    return lifted(SilhouetteIntegrator(Scene(*found.mesh)), found.points, found.normals)


def expected(s: ExactScene) -> np.ndarray:
    """Cosine and uniform AO by the scene's formula, (n, 2)."""
    built = Scene(*s.mesh)
    p, n = SilhouetteIntegrator(built)._finder.shade_points(s.points, s.normals)
    rows = [s.formula(x, y) for x, y in zip(np.ldexp(p, built.welding.exponent), n, strict=True)]
    return 1.0 - np.array([(h.cosine, h.uniform) for h in rows])


# ------------------------------------------------------------------------------------------------ the oracle


@pytest.mark.parametrize("s", FORMULAS, ids=lambda s: s.name)
def test_the_oracle_knows_the_formulas(s: ExactScene) -> None:
    arcs = of_oracle(s.name)
    values = np.column_stack([oracle.ambient_occlusion(arcs), oracle.uniform(arcs)])
    np.testing.assert_allclose(values, expected(s), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("s", (*FORMULAS, *ORACLES), ids=lambda s: s.name)
def test_its_arcs_are_closed_and_wound_about_what_is_visible(s: ExactScene) -> None:
    arcs = of_oracle(s.name)
    assert oracle.closure(arcs).max() < 1e-13
    a, b, inner = arcs.directions[:, :3], arcs.directions[:, 3:6], arcs.directions[:, 6:]
    np.testing.assert_allclose(np.linalg.norm(a, axis=1), 1, atol=1e-15)
    assert np.abs((a * inner).sum(axis=1)).max(initial=0) < 1e-15
    assert np.abs((b * inner).sum(axis=1)).max(initial=0) < 1e-15
    turn = (np.cross(a, b) * inner).sum(axis=1)
    assert turn.min(initial=1) > -1e-15
    area = oracle.uniform(arcs)
    assert area.min() > -ROUNDING and area.max() < 1 + ROUNDING


@pytest.mark.parametrize("s", analytic_scenes(), ids=lambda s: s.name)
def test_the_oracle_knows_the_analytic_scenes(s: AnalyticScene) -> None:
    """To the lift of the shade points, 1e-11 of the scene; at the foot of walls, to what rounding leaves."""
    arcs = lifted(SilhouetteIntegrator(Scene(s.vertices, s.faces)), s.points, s.normals)
    tolerance = CONTACT if s.name == "foot of walls/turned" else 1e-9
    np.testing.assert_allclose(oracle.ambient_occlusion(arcs), s.cosine, rtol=0, atol=tolerance)
    np.testing.assert_allclose(oracle.uniform(arcs), s.uniform, rtol=0, atol=tolerance)


@pytest.mark.parametrize("s", ORACLES, ids=lambda s: s.name)
def test_the_oracle_agrees_with_half_planes(s: ExactScene) -> None:
    """512 half-planes, two points a scene; each upright edge that all of them miss costs a part of one."""
    built = SilhouetteIntegrator(Scene(*s.mesh))
    topology = built.scene.topology
    arcs = of_oracle(s.name)
    values = np.column_stack([oracle.ambient_occlusion(arcs), oracle.uniform(arcs)])
    for i in range(min(2, len(arcs.points))):
        line = radial_ao(topology.vertices, topology.faces, arcs.points[i], arcs.normals[i], 512)
        np.testing.assert_allclose(values[i], line, rtol=0, atol=2e-3)


def test_half_planes_converge_to_the_oracle() -> None:
    mesh = clutter(1, 1)
    s = scene("clutter", mesh, random_rows(mesh, 4, 2))
    built = SilhouetteIntegrator(Scene(*mesh))
    topology, arcs = built.scene.topology, lifted(built, s.points, s.normals)
    errors = []
    for lines in (64, 512, 4096):
        found = [
            radial_ao(topology.vertices, topology.faces, p, n, lines)[0]
            for p, n in zip(arcs.points, arcs.normals, strict=True)
        ]
        errors.append(np.abs(np.array(found) - oracle.ambient_occlusion(arcs)).max())
    # As lines ** -1.5.
    assert errors[1] < errors[0] / 8 and errors[2] < errors[1] / 8 and errors[2] < 1e-5


def test_the_oracle_counts_a_mesh_that_exists_twice_once() -> None:
    s = next(s for s in ORACLES if s.name == "blocks")
    once, twice = (
        lifted(SilhouetteIntegrator(Scene(*mesh)), s.points, s.normals)
        for mesh in (s.mesh, concatenate([s.mesh, s.mesh]))
    )
    np.testing.assert_allclose(
        oracle.ambient_occlusion(twice), oracle.ambient_occlusion(once), rtol=0, atol=ROUNDING
    )


def test_the_oracles_integrals_agree_with_each_other_and_an_open_sky() -> None:
    normals = np.array([(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
    far = np.full((2, 3), 50.0)
    mesh = polyhedra.box()
    sky = oracle.arcs_of(*mesh, far * normals, normals)
    np.testing.assert_allclose(oracle.bent_normals(sky), 2 / 3 * normals, rtol=0, atol=1e-14)
    np.testing.assert_allclose(oracle.sh_transfer(sky, 2, "uniform")[:, 0], np.sqrt(np.pi), atol=1e-14)
    s = next(s for s in ORACLES if s.name == "blocks, any point")
    arcs = of_oracle(s.name)
    first = np.sqrt(3 / (4 * np.pi))
    # Degree 1 of V is the vector irradiance, and of V n.w the bent normal.
    for transfer, vectors in (
        (oracle.sh_transfer(arcs, 1, "uniform"), oracle.vector_irradiance(arcs)),
        (oracle.sh_transfer(arcs, 1, "cosine"), oracle.bent_normals(arcs)),
    ):
        np.testing.assert_allclose(transfer[:, [3, 1, 2]], first * vectors, rtol=0, atol=1e-13)


# -------------------------------------------------------------------------------------------- the exact mode


Query = Callable[[SilhouetteIntegrator, np.ndarray, np.ndarray], np.ndarray]
QUERIES: dict[str, tuple[Query, Callable[[oracle.Arcs], np.ndarray]]] = {
    "cosine": (lambda s, p, n: s.ambient_occlusion(p, n, method="exact"), oracle.ambient_occlusion),
    "uniform": (
        lambda s, p, n: s.ambient_occlusion(p, n, weighting="uniform", method="exact"),
        oracle.uniform,
    ),
    "bent normals": (lambda s, p, n: s.bent_normals(p, n, method="exact"), oracle.bent_normals),
    "sh, cosine": (
        lambda s, p, n: s.sh_transfer(p, n, max_degree=3, method="exact"),
        lambda a: oracle.sh_transfer(a, 3, "cosine"),
    ),
    "sh, uniform": (
        lambda s, p, n: s.sh_transfer(p, n, max_degree=3, weighting="uniform", method="exact"),
        lambda a: oracle.sh_transfer(a, 3, "uniform"),
    ),
}


def ao(mesh: Mesh, p: np.ndarray, n: np.ndarray) -> np.ndarray:
    return SilhouetteIntegrator(Scene(*mesh)).ambient_occlusion(p, n, method="exact")


@pytest.mark.parametrize("s", FORMULAS, ids=lambda s: s.name)
def test_formulas(s: ExactScene) -> None:
    built = SilhouetteIntegrator(Scene(*s.mesh))
    found = np.column_stack(
        [
            built.ambient_occlusion(s.points, s.normals, weighting=w, method="exact")
            for w in ("cosine", "uniform")
        ]
    )
    tolerance = CONTACT if s.tolerance == CONTACT else ROUNDING
    np.testing.assert_allclose(found, expected(s), rtol=0, atol=tolerance)


@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("s", (*FORMULAS, *ORACLES), ids=lambda s: s.name)
def test_the_oracle(s: ExactScene, query: str) -> None:
    ask, integrate = QUERIES[query]
    found = ask(SilhouetteIntegrator(Scene(*s.mesh)), s.points, s.normals)
    # An edge that all but passes through p has a direction known to 1e-5: harmonics tell, AO hardly does.
    tolerance = 10 * CONTACT if s.tolerance == CONTACT and query.startswith("sh") else s.tolerance
    np.testing.assert_allclose(found, integrate(of_oracle(s.name)), rtol=0, atol=tolerance)


@pytest.mark.parametrize("s", ORACLES, ids=lambda s: s.name)
def test_arcs_of_a_visibility(s: ExactScene) -> None:
    """Closed, in the layout agreed, and by themselves enough for everything."""
    visible = SilhouetteIntegrator(Scene(*s.mesh)).visibility(s.points, s.normals, method="exact")
    arcs = oracle.Arcs(*visible.arcs)
    assert oracle.closure(arcs).max() < max(s.tolerance, EXACT)
    np.testing.assert_allclose(
        oracle.ambient_occlusion(arcs),
        oracle.ambient_occlusion(of_oracle(s.name)),
        rtol=0,
        atol=s.tolerance,
    )
    a, b, inner = arcs.directions[:, :3], arcs.directions[:, 3:6], arcs.directions[:, 6:]
    for v in (a, b, inner):
        np.testing.assert_allclose(np.linalg.norm(v, axis=1), 1.0, rtol=0, atol=1e-14)
    # On the circle of the edge: phase two takes lengths from the ends and areas from the normal.
    if s.tolerance != CONTACT:
        assert np.abs((a * inner).sum(axis=1)).max(initial=0) < 1e-13
        assert np.abs((b * inner).sum(axis=1)).max(initial=0) < 1e-13
    assert (np.cross(a, b) * inner).sum(axis=1).min(initial=0) > -1e-13
    horizon = arcs.edges[:, 0] < 0
    rows = np.repeat(np.arange(len(arcs.counts)), arcs.counts)
    order = np.concatenate(
        [np.arange(i, i + c) for i, c in zip(arcs.starts, arcs.counts, strict=True)]
    ).astype(int)
    up = arcs.normals[rows][np.argsort(order)] if len(order) == len(a) else None
    if up is not None:
        np.testing.assert_allclose(inner[horizon], up[horizon], rtol=0, atol=1e-15)
        assert (a * up).sum(axis=1).min(initial=0) > -1e-10


@pytest.mark.parametrize("name", ["blocks", "blocks, any point", "soup", "slivers", "integer tangle"])
def test_a_mesh_that_exists_twice_counts_once(name: str) -> None:
    s = next(s for s in ORACLES if s.name == name)
    once = ao(s.mesh, s.points, s.normals)
    np.testing.assert_allclose(
        ao(concatenate([s.mesh, s.mesh]), s.points, s.normals), once, rtol=0, atol=ROUNDING
    )


@pytest.mark.parametrize("name", ["blocks, any point", "soup", "tangle", "moebius strip", "slivers"])
def test_a_rotation_changes_nothing(name: str) -> None:
    s = next(s for s in ORACLES if s.name == name)
    values = [
        ao((s.mesh[0] @ r.T, s.mesh[1]), s.points @ r.T, s.normals @ r.T)
        for r in (np.eye(3), rotation(1), rotation(2))
    ]
    # Close to a triangle's plane the rounding of its turned corners is magnified; the oracle's values move by
    # as much (7e-12 in the tangle).
    assert np.ptp(values, axis=0).max() < (1e-10 if name in ("slivers", "tangle") else ROUNDING)


@pytest.fixture
def threads() -> Callable[[int], None]:
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.mark.parametrize("query", QUERIES)
def test_neither_order_nor_threads_change_a_bit(query: str, threads: Callable[[int], None]) -> None:
    mesh = clutter(1, 1)
    s = scene("clutter", mesh, [*random_rows(mesh, 40, 3), *contact_rows(mesh, 40, 4)])
    built = SilhouetteIntegrator(Scene(*mesh))
    ask = QUERIES[query][0]
    together = ask(built, s.points, s.normals)
    order = np.random.default_rng(1).permutation(len(s.points))
    np.testing.assert_array_equal(ask(built, s.points[order], s.normals[order]), together[order])
    np.testing.assert_array_equal(ask(built, s.points[7:8], s.normals[7:8])[0], together[7])
    for count in range(1, min(numba.config.NUMBA_NUM_THREADS, 2) + 1):
        threads(count)
        np.testing.assert_array_equal(ask(built, s.points, s.normals), together)


def test_failed_certificates_are_counted() -> None:
    mesh = clutter(1, 1)
    s = scene("clutter", mesh, random_rows(mesh, 20, 3))
    result = SilhouetteIntegrator(Scene(*mesh)).ambient_occlusion(
        s.points, s.normals, method="exact", full_output=True
    )
    counts = {k: v for k, v in result.diagnostics.items() if "certif" in k or "sound" in k}
    assert counts and not any(counts.values())
    assert result.diagnostics["points"] == 20
    assert not np.asarray(result.error_estimate).max() > 1e-9


@pytest.mark.parametrize("method", ["radial", "octahedral"])
def test_isolines_converge_to_it(method: str) -> None:
    mesh = clutter(1, 1)
    s = scene("clutter", mesh, random_rows(mesh, 30, 5))
    built = SilhouetteIntegrator(Scene(*mesh))
    exact = built.ambient_occlusion(s.points, s.normals, method="exact")
    errors = [
        np.abs(built.ambient_occlusion(s.points, s.normals, k, method=method) - exact).max()
        for k in (64, 1024)
    ]
    assert errors[1] < errors[0] / 16 and errors[1] < 1e-4


def check_boxes(mesh: Mesh, points: np.ndarray, normals: np.ndarray) -> None:
    """Against the oracle, where points are off all boxes; and under turns about each axis."""
    built = SilhouetteIntegrator(Scene(*mesh))
    found = built.ambient_occlusion(points, normals, method="exact")
    assert np.isfinite(found).all() and found.min() > -1e-9 and found.max() < 1 + 1e-9
    low, high = mesh[0].reshape(-1, 8, 3).min(axis=1), mesh[0].reshape(-1, 8, 3).max(axis=1)
    free = ~((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2).any(axis=1)
    assume(free.any())
    points, normals, found = points[free], normals[free], found[free]
    arcs = lifted(built, points, normals)
    np.testing.assert_allclose(found, oracle.ambient_occlusion(arcs), rtol=0, atol=EXACT)
    uniform = built.ambient_occlusion(points, normals, weighting="uniform", method="exact")
    np.testing.assert_allclose(uniform, oracle.uniform(arcs), rtol=0, atol=EXACT)
    # Quarter turns: the same bits of coordinates elsewhere, other frames.
    for turn in (np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]):
        turned = ao((mesh[0] @ turn.T, mesh[1]), points @ turn.T, normals @ turn.T)
        np.testing.assert_allclose(turned, found, rtol=0, atol=EXACT)


@settings(max_examples=60)
@given(integer_boxes())
def test_any_boxes(drawn: tuple[Mesh, np.ndarray, np.ndarray]) -> None:
    check_boxes(*drawn)


@pytest.mark.slow
@settings(max_examples=10_000)
@given(integer_boxes())
def test_very_many_boxes(drawn: tuple[Mesh, np.ndarray, np.ndarray]) -> None:
    check_boxes(*drawn)


# SILINT_ORACLE_POINTS=1000 takes about an hour on two cores.
@pytest.mark.slow
@pytest.mark.parametrize(
    "s", oracle_scenes(int(os.environ.get("SILINT_ORACLE_POINTS", "30"))), ids=lambda s: s.name
)
def test_many_points(s: ExactScene) -> None:
    built = SilhouetteIntegrator(Scene(*s.mesh))
    arcs = lifted(built, s.points, s.normals)
    for query in ("cosine", "uniform", "bent normals"):
        ask, integrate = QUERIES[query]
        np.testing.assert_allclose(
            ask(built, s.points, s.normals), integrate(arcs), rtol=0, atol=s.tolerance, err_msg=query
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clutter", "leaves"])
def test_larger_scenes(name: str) -> None:
    mesh = clutter(3, 2) if name == "clutter" else foliage(1, 1)
    s = scene(name, mesh, [*random_rows(mesh, 60, 3), *contact_rows(mesh, 60, 4)])
    built = SilhouetteIntegrator(Scene(*mesh))
    np.testing.assert_allclose(
        built.ambient_occlusion(s.points, s.normals, method="exact"),
        oracle.ambient_occlusion(lifted(built, s.points, s.normals)),
        rtol=0,
        atol=EXACT,
    )


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("crossed", [False, True])
def test_edges_that_pass_through_the_point(axis: int, crossed: bool) -> None:
    """Two boxes share an edge that a point lies on, with its normal along it: seen half a turn long, at once.

    Nudges off both cancel. The point is pushed into one of the quadrants by the rule for sides.
    """
    quadrants = ((0, 1), (1, 0)) if crossed else ((0, 0), (1, 1))
    corners = [np.insert(np.array(q, float) - 1.0, axis, 0.0) for q in quadrants]
    mesh = boxes(corners, np.array(corners) + 1.0)
    points = np.insert(np.zeros((4, 2)), axis, [0.25, 0.25, 0.5, 0.7], axis=1)
    normals = np.outer([-1.0, 1.0, 1.0, 1.0], np.eye(3)[axis])
    built = SilhouetteIntegrator(Scene(*mesh))
    found = built.ambient_occlusion(points, normals, method="exact", full_output=True)
    assert found.diagnostics["uncertified_points"] == 0
    lines = built.ambient_occlusion(points, normals, 1024)
    np.testing.assert_allclose(found.value, lines, rtol=0, atol=1e-5)
    assert set(np.round(found.value, 13)) <= {0.0, 0.25}


def test_it_takes_no_lines() -> None:
    """An option that would do nothing is refused."""
    mesh = polyhedra.box()
    s = scene("box", mesh, random_rows(mesh, 5, 1))
    built = SilhouetteIntegrator(Scene(*mesh))
    for query in (built.ambient_occlusion, built.visibility):
        with pytest.raises(InputError, match="isolines given with method='exact'"):
            query(s.points, s.normals, isolines=8, method="exact")
