"""Counts broken on purpose: the checks notice, covering repairs, diagnostics count."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from scenes import polyhedra
from scenes.mesh import concatenate, moved
from silint import Scene, SilhouetteIntegrator, Visibility
from silint.core.bundles import N_EDGE_FIELDS, VERTEX_A
from silint.core.lanes import WIDTH
from silint.reference import brute_force

Mesh = tuple[np.ndarray, np.ndarray]
K = 32

# An interval's ends by the sweep and by covering differ by rounding only; see tests/test_oracle.py.
ROUNDING = 1e-9


def ball() -> Mesh:
    """In front of the point, wholly above its horizon; long edges, so that each crosses several isolines."""
    return moved(polyhedra.icosahedron(), (0.2, 0.1, 2.0))


def around() -> Mesh:
    """Solids that stand about the point and reach below its horizon, and an open sheet."""
    parts = [
        moved(polyhedra.icosahedron(), c) for c in ((2.0, 0.3, 0.4), (-1.0, 1.7, 0.1), (-0.6, -1.8, 1.0))
    ]
    return concatenate([*parts, moved(polyhedra.triangle(), (-0.2, 0.1, 0.5))])


MESHES = {"ball": ball, "around": around}
POINT, NORMAL = np.zeros((1, 3)), np.array([[0.1, 0.2, 1.0]])


def with_jump_turned_over(integrator: SilhouetteIntegrator, name: str, e: int) -> SilhouetteIntegrator:
    """The same integrator, but that one edge adds to the depth count what it should take away."""
    tree = getattr(integrator._finder.bundles, name)
    rows = slice(2 * e, 2 * e + 2) if name == "contour" else slice(tree.offsets[e], tree.offsets[e + 1])
    codes, edges = tree.codes.copy(), tree.edges.copy()
    codes[rows] = ~codes[rows]
    # The filter knows planes too, and on which side of them the point is.
    edges.reshape(-1, N_EDGE_FIELDS, WIDTH)[e // WIDTH, :VERTEX_A, e % WIDTH] *= -1
    broken = SilhouetteIntegrator(integrator.scene)
    broken._finder.bundles = integrator._finder.bundles._replace(
        **{name: tree._replace(codes=codes, edges=edges)}
    )
    return broken


def broken_integrators(integrator: SilhouetteIntegrator) -> Iterator[SilhouetteIntegrator]:
    """One for every contour edge that the point sees."""
    p, n = (a[0] for a in integrator._finder.shade_points(POINT, NORMAL))
    topology = integrator.scene.topology
    oracle = brute_force.contour_jumps(topology.vertices, topology.faces, p)
    np.testing.assert_array_equal(oracle.positions, topology.vertices)
    above = ((topology.vertices - p) @ n > 0.0)[oracle.edges].any(axis=1)
    for ends in oracle.edges[(oracle.jumps != 0) & above].tolist():
        for name in ("contour", "boundary"):
            tree = getattr(integrator._finder.bundles, name)
            for e in np.flatnonzero((tree.ends == ends).all(axis=1)).tolist():
                yield with_jump_turned_over(integrator, name, e)


def differing_lines(a: Visibility, b: Visibility) -> np.ndarray:
    return brute_force.interval_difference(a.offsets, a.intervals, b.offsets, b.intervals) > K * ROUNDING


@pytest.mark.parametrize("name", MESHES)
def test_nothing_falls_back_unless_it_is_broken(name: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*MESHES[name]()))
    assert integrator.visibility(POINT, NORMAL, K).diagnostics["fallback_isolines"] == 0


@pytest.mark.parametrize("name", MESHES)
def test_a_wrong_jump_is_noticed_wherever_it_shows(name: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*MESHES[name]()))
    sound = integrator.visibility(POINT, NORMAL, K)
    n_noticed = n_broken = 0
    for broken in broken_integrators(integrator):
        found = broken.visibility(POINT, NORMAL, K)
        noticed = found.diagnostics["fallback_isolines"]
        # Never is anything quietly wrong.
        assert noticed > 0 or not differing_lines(sound, found).any()
        assert noticed <= K
        n_noticed += noticed > 0
        n_broken += 1
    # Edges that fall between two isolines go unnoticed, and rightly.
    assert n_broken >= 6 and n_noticed > 0.5 * n_broken


@pytest.mark.parametrize("name", MESHES)
def test_covering_repairs_every_line_that_a_wrong_jump_spoils(name: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*MESHES[name]()))
    sound = integrator.visibility(POINT, NORMAL, K)
    for broken in broken_integrators(integrator):
        assert not differing_lines(sound, broken.visibility(POINT, NORMAL, K)).any()


def test_covering_all_lines_is_the_same_region() -> None:
    integrator = SilhouetteIntegrator(Scene(*around()))
    rng = np.random.default_rng(1)
    p, n = integrator._finder.shade_points(rng.uniform(-1, 1, (20, 3)), rng.normal(size=(20, 3)))
    ((sweep, rows),) = integrator._finder.octahedral(p, n, K, None)
    ((cover, same_rows),) = integrator._finder.octahedral(p, n, K, None, cover_all=True)
    np.testing.assert_array_equal(rows, same_rows)
    assert not differing_lines(sweep, cover).any()
    assert cover.diagnostics["edges_tested"] == 0 < sweep.diagnostics["edges_tested"]


@pytest.mark.parametrize("isolines", [2, 7])
def test_visible_intervals_are_sorted_and_apart(isolines: int) -> None:
    integrator = SilhouetteIntegrator(Scene(*around()))
    rng = np.random.default_rng(2)
    visible = integrator.visibility(rng.uniform(-1, 1, (30, 3)), rng.normal(size=(30, 3)), isolines)
    assert len(visible.offsets) == 30 * isolines + 1
    assert ((visible.intervals[:, 0] >= 0) & (visible.intervals[:, 0] < 4)).all()
    assert (visible.intervals[:, 1] > visible.intervals[:, 0]).all()
    for line in range(30 * isolines):
        rows = visible.intervals[visible.offsets[line] : visible.offsets[line + 1]]
        # In order along the run, which may go round past 4; neither overlapping nor touching.
        start = rows[:, 0] + 4 * (rows[:, 0] < rows[:1, 0])
        length = rows[:, 1] - rows[:, 0]
        assert (start[1:] > start[:-1] + length[:-1]).all()


def test_buffers_grow_until_everything_fits() -> None:
    """A comb of slats: more crossings, contours and intervals on a line than any buffer first holds."""
    slats = concatenate(
        [moved(polyhedra.box((6.0, 0.002, 1e-4)), (0.0, 0.004 * i - 1.0, 1.0)) for i in range(500)]
    )
    integrator = SilhouetteIntegrator(Scene(*slats))
    points = np.array([[0.0003, 0.0, 0.0], [0.5, 0.2, 0.0]])
    normals = np.array([[0.0, 1e-3, 1.0], [0.3, 0.0, 1.0]])
    visible = integrator.visibility(points, normals, 2)
    assert visible.diagnostics["contour_edges"] > 1024 and len(visible.intervals) > 64 * 2
    oracle = brute_force.visible_intervals(
        integrator.scene.topology.vertices,
        integrator.scene.topology.faces,
        *integrator._finder.shade_points(points, normals),
        2,
    )
    difference = brute_force.interval_difference(
        oracle.offsets, oracle.intervals, visible.offsets, visible.intervals
    )
    assert difference.max() < ROUNDING * 1000
