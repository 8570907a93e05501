"""The sweeps and the covering against brute force: points of every kind, scenes with every defect.

The oracles test every face against every line and share no code with silint.core. They are handed the lifted
points that the kernels see, in the units in which they see them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import scenes
from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate, flipped, moved
from silint import Scene, SilhouetteIntegrator, Visibility
from silint.core.face_bundles import with_corners
from silint.core.radial import line_table, set_frame
from silint.core.topology import edges_of
from silint.reference import brute_force, half_planes

Mesh = tuple[np.ndarray, np.ndarray]
Points = tuple[np.ndarray, np.ndarray]

# Tolerances on the ends of intervals, in the loop coordinate, and on ambient occlusion. An end is a ratio of
# differences of products, each rounded a few times (1e-16), which edges seen nearly end on magnify; and
# intervals shorter than the first tolerance may be found by one side alone. The second is the issue's.
ROUNDING = (1e-9, 1e-9)
# A point on an edge, lifted by 2^-36 in a direction that is not square to the edge, sees it from 1.5e-11 or
# less, and coordinates rounded to 1e-16 leave 1e-5 or more of the direction in which it runs. What such edges
# add to and take from the view is a part of that, on few lines.
ILL_CONDITIONED = dict.fromkeys(("edge, any normal", "vertex, any normal"), (1e-4, 1e-6))


# ---------------------------------------------------------------------------------------------- points


def units(rng: np.random.Generator, n: int) -> np.ndarray:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def kinds_of_points(mesh: Mesh, n: int, seed: int = 0) -> Iterator[tuple[str, Points]]:
    """Shade points of every kind that a mesh can be asked about."""
    rng = np.random.default_rng(seed)
    vertices, faces = mesh
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    f = rng.choice(len(faces), n, p=area / area.sum())
    a, b, c = corners[f].transpose(1, 0, 2)
    normal = normal[f] / area[f, None]
    along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    tangent = np.cross(normal, along)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    extent = (high - low).max()
    weights = rng.dirichlet([1, 1, 1], n)
    on_face = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
    t = rng.random((n, 1))
    on_edge = a + t * (b - a)
    in_box = low + (high - low) * rng.random((n, 3))
    axes = np.eye(3)[rng.integers(0, 3, n)] * rng.choice([-1.0, 1.0], (n, 1))
    in_plane = a + extent * (rng.normal(size=(n, 1)) * along + rng.normal(size=(n, 1)) * tangent)

    yield "face", (on_face, normal)
    yield "back of a face", (on_face, -normal)
    yield "face, normal within it", (on_face, tangent)
    yield "edge", (on_edge, normal)
    yield "edge, any normal", (on_edge, units(rng, n))
    yield "vertex", (a, normal)
    yield "vertex, any normal", (a, units(rng, n))
    yield "space", (in_box, units(rng, n))
    yield "space, normal along an axis", (in_box, axes)
    yield "under a face", (on_face - 1e-4 * extent * normal, normal)
    yield "far", (units(rng, n) * extent * rng.choice([1e1, 1e3, 1e6], (n, 1)), units(rng, n))
    yield "plane of a face, normal within it", (in_plane, tangent)
    yield "plane of a face", (in_plane, normal)


KINDS = [kind for kind, _ in kinds_of_points(polyhedra.box(), 1)]


# -------------------------------------------------------------------------------------------- comparing


def seen(integrator: SilhouetteIntegrator, p: np.ndarray, n: np.ndarray, k: int, cover: bool) -> Visibility:
    """Visible intervals of points that are lifted already, by sweeping or by covering."""
    lines: list[np.ndarray] = [np.empty((0, 2))] * (len(p) * k)
    for visible, rows in integrator._finder.octahedral(p, n, k, None, cover):
        parts = np.split(visible.intervals, visible.offsets[1:-1])
        for j, row in enumerate(rows.tolist()):
            lines[row * k : (row + 1) * k] = parts[j * k : (j + 1) * k]
    offsets = np.concatenate([[0], np.cumsum([len(line) for line in lines])])
    return Visibility(n, k, offsets, np.concatenate(lines))


def runs_along_an_edge(p: np.ndarray, ends: np.ndarray, k: int, n_lines: int) -> bool:
    """Whether isoline k runs along an edge, or in the plane of a face through p: it sees both sides or none.

    Such a line has no answer: a hair further along x, or back, it has one or the other.
    """
    u = (2 * k + 1) / n_lines - 1
    r = 1 - abs(u)
    corners = np.array([(u, r, 0), (u, 0, r), (u, -r, 0), (u, 0, -r)])
    line = np.cross(corners, np.roll(corners, -1, axis=0))
    line /= np.linalg.norm(line, axis=1)[:, None]
    a, b = ends[:, 0] - p, ends[:, 1] - p
    edge = np.cross(a, b)
    length = np.linalg.norm(edge, axis=1)
    distinct = length > 1e-9 * np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)  # else seen end on
    edge = edge[distinct] / length[distinct, None]
    return bool((np.linalg.norm(np.cross(edge[:, None], line), axis=-1) < 1e-9).any())


def check_against_oracle(mesh: Mesh, points: Points, kind: str, lines: tuple[int, ...]) -> None:
    integrator = SilhouetteIntegrator(Scene(*mesh))
    topology = integrator.scene.topology
    soup = topology.vertices, topology.faces
    edges = topology.vertices[edges_of(topology).ends]
    p, n = integrator._finder.shade_points(*points)
    v_rounding, ao_rounding = ILL_CONDITIONED.get(kind, ROUNDING)
    for k in lines:
        oracle = brute_force.visible_intervals(*soup, p, n, k)
        # The strips reach below the horizon, where n.w < 0, so a ratio of sums can leave [0, 1]. A single
        # line, at u = 0, sees nothing of a hemisphere about x: 0 / 0.
        ao = None if k == 1 else np.clip(brute_force.ambient_occlusion(*soup, p, n, k), 0.0, 1.0)
        for cover in (False, True):
            found = seen(integrator, p, n, k, cover)
            where = f"{kind}, {k} isolines, {'cover' if cover else 'sweep'}"
            difference = brute_force.interval_difference(
                oracle.offsets, oracle.intervals, found.offsets, found.intervals
            )
            ends = 2 + 2 * (np.diff(oracle.offsets) + np.diff(found.offsets))
            decided = np.ones(len(p), bool)
            for line in np.flatnonzero(difference > v_rounding * ends):
                i = line // k
                assert runs_along_an_edge(p[i], edges, line % k, k), (
                    f"{where}: point {i} {points[0][i].tolist()}, normal {points[1][i].tolist()}, {line % k}"
                )
                decided[i] = False
            if ao is not None:
                np.testing.assert_allclose(
                    found.ambient_occlusion()[decided], ao[decided], rtol=0, atol=ao_rounding, err_msg=where
                )


def rounding_of_theta(corners: np.ndarray, edges: np.ndarray, p: np.ndarray) -> float:
    """How well theta is known: the direction of an edge close by is lost when coordinates turn into a frame.

    Nothing is known where p lies in an edge or within a face, and a rule says on which side of it.
    """
    a, b, c = corners.transpose(1, 0, 2) - p
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    inside = [(np.cross(u, v) * normal).sum(axis=1) >= -1e-9 for u, v in ((a, b), (b, c), (c, a))]
    within = np.all(inside, axis=0) & (area > 0) & (np.abs((a * normal).sum(axis=1)) <= 1e-15 * area)
    if within.any():
        return np.inf
    a, b = edges.transpose(1, 0, 2) - p
    t = np.clip(-(a * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)[:, None]
    near = np.linalg.norm(a + t * (b - a), axis=1).min()
    return max(1e-9, 4e-15 / near) if near > 0 else np.inf


def check_half_planes(mesh: Mesh, points: Points, kind: str, lines: tuple[int, ...]) -> None:
    """Visible intervals on radial isolines, in theta, by sweeping and by covering."""
    integrator = SilhouetteIntegrator(Scene(*mesh))
    topology = integrator.scene.topology
    corners = topology.vertices[topology.faces]
    p, n = integrator._finder.shade_points(*points)
    edges = topology.vertices[edges_of(topology).ends]
    rounding = [rounding_of_theta(corners, edges, x) for x in p]
    frame = np.empty((3, 3))
    finder = integrator._finder
    finder.bundles = finder.bundles._replace(face=with_corners(finder.bundles.face, topology))
    for k, cover in product(lines, (False, True)):
        directions = line_table(k)
        finder._cover = cover
        for found, told, rows in finder.radial(p, n, k, None):
            assert told["fallback_isolines"] == 0
            assert told["covered_points" if cover else "swept_points"] == len(rows)
            for row, start, counts in zip(rows.tolist(), found.starts, found.counts, strict=True):
                set_frame(n[row], frame)
                expected = half_planes.visible_ranges(
                    corners, p[row], n[row], frame[2], directions @ frame[:2]
                )
                parts = np.split(found.intervals[start : start + counts.sum()], np.cumsum(counts)[:-1])
                for line, keys in enumerate(parts):
                    # From the zenith down, neither overlapping nor touching.
                    assert (keys[:, 0] > keys[:, 1]).all() and (keys[1:, 0] < keys[:-1, 1]).all()
                    difference = half_planes.difference(np.arctan2(1.0, keys), expected[line])
                    assert difference <= rounding[row] * (2 + 2 * (len(keys) + len(expected[line]))), (
                        f"{kind}, {k} lines, {'cover' if cover else 'sweep'}: line {line}, "
                        f"point {row} {points[0][row].tolist()}, normal {points[1][row].tolist()}"
                    )


# ----------------------------------------------------------------------------------------------- scenes


def soup(n: int = 40, seed: int = 4) -> Mesh:
    """Triangles at random that pass through each other: all edges are boundaries."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-2, 2, size=(n, 1, 3))
    return (centres + rng.normal(scale=0.5, size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def tangle(n: int = 30, seed: int = 5) -> Mesh:
    """Triangles at random over few vertices: edges of any number of faces, wound anyhow.

    No triangle twice: on a sheet with two opposite fronts a point whose normal lies within the sheet is
    neither before nor behind it.
    """
    rng = np.random.default_rng(seed)
    triples = [tuple(rng.choice(9, 3, replace=False)) for _ in range(n)]
    return rng.uniform(-1, 1, size=(9, 3)), np.array(list({frozenset(t): t for t in triples}.values()))


def doubled() -> Mesh:
    """A box, the same box again, and once more inside out; with a face of no area."""
    box = polyhedra.box((1.0, 2.0, 3.0))
    vertices, faces = concatenate([box, box, flipped(box)])
    return vertices, np.concatenate([faces, [[0, 1, 1], [0, 3, 8]]])


def touching() -> Mesh:
    """Two boxes that share a wall, and a slab below them: faces on faces, edges in faces, T junctions."""
    return concatenate(
        [
            moved(polyhedra.box((1.0, 1.0, 1.0)), (0.0, 0.0, 0.5)),
            moved(polyhedra.box((1.0, 2.0, 0.5)), (1.0, 0.0, 0.25)),
            moved(polyhedra.box((6.0, 6.0, 0.25)), (0.0, 0.0, -0.125)),
        ]
    )


SCENES: dict[str, Callable[[], Mesh]] = {
    "triangle": polyhedra.triangle,
    "box": polyhedra.box,
    "octahedron": polyhedra.octahedron,
    "hourglass": polyhedra.hourglass,
    "room": polyhedra.closed_room,
    "wall and floor": polyhedra.wall_and_floor,
    "fin": lambda: polyhedra.fin(5),
    "moebius strip": lambda: polyhedra.moebius_strip(12),
    "torus": lambda: polyhedra.torus(major_slices=12, minor_slices=8),
    "doubled": doubled,
    "touching": touching,
    "soup": soup,
    "tangle": tangle,
    "clutter": lambda: clutter(1, 1),
}

WIDE = ["clutter_9k", "teapot", "room", "icosphere", "dodecahedron", "convex_polyhedron", "spherical_cap"]


@pytest.mark.parametrize("name", SCENES)
def test_every_kind_of_point_sees_what_brute_force_sees(name: str) -> None:
    mesh = SCENES[name]()
    for kind, points in kinds_of_points(mesh, 6):
        # An odd number of isolines has one at u = 0, the plane where the map folds and edges of boxes lie.
        check_against_oracle(mesh, points, kind, (1, 2, 7, 24))


@pytest.mark.parametrize("name", SCENES)
def test_every_kind_of_point_sees_along_half_planes_what_brute_force_sees(name: str) -> None:
    mesh = SCENES[name]()
    for kind, points in kinds_of_points(mesh, 6):
        check_half_planes(mesh, points, kind, (4, 6, 26))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", [*SCENES, *WIDE, "foliage"])
def test_two_hundred_points_of_every_kind(name: str, kind: str) -> None:
    if name in SCENES:
        mesh = SCENES[name]()
    else:
        mesh = foliage(1, 8) if name == "foliage" else scenes.build(name)
    for some_kind, points in kinds_of_points(mesh, 200, seed=1):
        if some_kind == kind:
            check_against_oracle(mesh, points, kind, (7, 32))
            check_half_planes(mesh, tuple(a[:40] for a in points), kind, (4, 32))


# ------------------------------------------------------------------------------------- exact statements


@pytest.mark.parametrize("name", ["box", "octahedron", "hourglass", "torus", "doubled"])
@pytest.mark.parametrize("isolines", [1, 2, 7, 64])
def test_inside_a_solid_nothing_is_visible(name: str, isolines: int) -> None:
    """Exactly nothing: for points in the depth of a solid, and close under its faces, edges and vertices."""
    mesh = SCENES[name]()
    vertices, faces = mesh
    if name == "doubled":
        faces = faces[:24]
    rng = np.random.default_rng(3)
    centroids = vertices[faces].mean(axis=1)
    normal = np.cross(
        vertices[faces][:, 1] - vertices[faces][:, 0], vertices[faces][:, 2] - vertices[faces][:, 0]
    )
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    points = np.concatenate([centroids - depth * normal for depth in (1e-6, 1e-3, 0.05)])
    integrator = SilhouetteIntegrator(Scene(*mesh))
    for normals in (units(rng, len(points)), np.tile(normal, (3, 1))):
        visible = integrator.visibility(points, normals, isolines)
        assert len(visible.intervals) == 0
        assert visible.diagnostics["buried"] == len(points)
    for method in ("octahedral", "radial"):
        result = integrator.ambient_occlusion(
            points, np.tile(normal, (3, 1)), isolines, method=method, full_output=True
        )
        assert not result.value.any() and result.diagnostics["buried"] == len(points)
        assert result.diagnostics["fallback_isolines"] == 0


@pytest.mark.parametrize("method", ["octahedral", "radial"])
def test_far_outside_the_scene_is_a_speck(method: str) -> None:
    """A hundred million extents away a solid subtends 1e-16 of the sky: the value is open to rounding."""
    integrator = SilhouetteIntegrator(Scene(*polyhedra.box()))
    rng = np.random.default_rng(6)
    towards = units(rng, 20)
    result = integrator.ambient_occlusion(-1e8 * towards, towards, method=method, full_output=True)
    np.testing.assert_allclose(
        result.value, 1.0, rtol=0, atol=1e-7
    )  # a line that meets it loses 1e-8 of its length
    assert result.diagnostics["fallback_isolines"] == 0


@pytest.mark.parametrize("method", ["octahedral", "radial"])
@pytest.mark.parametrize("extents", [1e6, 1e15, 1e30, 1e90])
def test_further_away_than_float32_can_count_is_open(extents: float, method: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*clutter(1, 1)))
    rng = np.random.default_rng(7)
    away = units(rng, 40)
    result = integrator.ambient_occlusion(extents * away, units(rng, 40), 16, method=method, full_output=True)
    # A line that happens to meet the scene loses 1 / extents of its length.
    np.testing.assert_allclose(result.value, 1.0, rtol=0, atol=10 / extents + 1e-15)
    assert result.diagnostics["fallback_isolines"] == 0


# ------------------------------------------------------------------------------------- any scene at all


@st.composite
def small_scenes(draw: st.DrawFn) -> tuple[Mesh, Points]:
    """A few triangles between points of a coarse grid, seen from points of the grid and between them."""
    n = draw(st.integers(3, 8))
    grid = st.integers(-3, 3)
    vertices = np.array(draw(st.lists(st.tuples(grid, grid, grid), min_size=n, max_size=n)), np.float64)
    index = st.integers(0, n - 1)
    faces = np.array(draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=12)), np.int32)
    corners = np.unique(vertices, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    assume((corners != np.roll(corners, 1, axis=1)).all(axis=1).any())  # a scene without a triangle: below
    half = st.integers(-7, 7)
    points = np.array(draw(st.lists(st.tuples(half, half, half), min_size=3, max_size=3)), np.float64) / 2
    normal = st.tuples(grid, grid, grid).filter(any)
    normals = np.array(draw(st.lists(normal, min_size=3, max_size=3)), np.float64)
    return (vertices, faces), (points, normals)


def check_sweep_against_cover(mesh: Mesh, points: Points) -> None:
    """Points of a grid lie on edges and vertices often: the tolerance is that of ill-conditioned kinds."""
    integrator = SilhouetteIntegrator(Scene(*mesh))
    p, n = integrator._finder.shade_points(*points)
    for k in (7, 16):
        sweep, cover = (seen(integrator, p, n, k, way).ambient_occlusion() for way in (False, True))
        np.testing.assert_allclose(sweep, cover, rtol=0, atol=1e-6)


@settings(max_examples=50)
@given(small_scenes())
def test_two_ways_agree_on_any_scene(scene: tuple[Mesh, Points]) -> None:
    check_sweep_against_cover(*scene)


@pytest.mark.slow
@settings(max_examples=5000)
@given(small_scenes())
def test_two_ways_agree_on_very_many_scenes(scene: tuple[Mesh, Points]) -> None:
    check_sweep_against_cover(*scene)


def test_a_scene_of_nothing_but_degenerate_faces_is_open() -> None:
    integrator = SilhouetteIntegrator(Scene([(0, 0, 0), (1, 0, 0), (1, 0, 0)], [(0, 0, 1), (0, 1, 2)]))
    for method in ("octahedral", "radial"):
        assert integrator.ambient_occlusion([(0, 0, 0)], [(0, 0, 1)], method=method).tolist() == [1.0]
