"""The generators of scenes/: exact counts, determinism, closedness, orientation, what each one promises."""

from __future__ import annotations

import importlib
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

import scenes
from scenes import polyhedra
from scenes.__main__ import main
from scenes.clutter import clutter
from scenes.fence import WIRE, _wire_paths, fence
from scenes.foliage import foliage
from scenes.mesh import as_mesh, grid_faces, random_rotations, revolve, weld
from scenes.room import shell
from scenes.teapot import BODY, LID, patches, teapot, teapot_grid

MODULES = ("city", "clutter", "fence", "foliage", "mesh", "polyhedra", "room", "sampling", "teapot")
LARGE = 1_000_000
NAMES = [
    pytest.param(spec.name, marks=pytest.mark.slow if spec.triangles > LARGE else ())
    for spec in scenes.SCENES.values()
]
CLOSED = [
    pytest.param(spec.name, marks=pytest.mark.slow if spec.triangles > LARGE else ())
    for spec in scenes.SCENES.values()
    if spec.kind == "closed"
]


def edge_counts(faces):
    """How often every undirected edge is used, and by how much its two directions differ."""
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    low, high = directed.min(axis=1), directed.max(axis=1)
    _, inverse, count = np.unique(low * (faces.max() + 1) + high, return_inverse=True, return_counts=True)
    balance = np.bincount(inverse.reshape(-1), weights=np.where(directed[:, 0] == low, 1.0, -1.0))
    return count, balance


def is_closed(faces):
    """Every edge has two faces that run along it in opposite directions."""
    count, balance = edge_counts(faces)
    return bool((count == 2).all() and (balance == 0).all())


def volumes(vertices, faces):
    """Signed volume of every connected component, taken about one of its own vertices."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices),) * 2)
    n, label = connected_components(graph, directed=False)
    origin = vertices[np.unique(label, return_index=True)[1]][label]
    a, b, c = (vertices[faces[:, k]] - origin[faces[:, 0]] for k in range(3))
    return np.bincount(
        label[faces[:, 0]], weights=np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0, minlength=n
    )


def areas(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


# ------------------------------------------------------------------------------------------- all of them


@pytest.mark.parametrize("name", NAMES)
def test_scene_is_what_the_table_says(name):
    spec = scenes.SCENES[name]
    vertices, faces = scenes.build(name)
    assert len(faces) == spec.triangles
    assert (vertices.dtype, faces.dtype) == (np.float64, np.int32)
    assert vertices.flags.c_contiguous and faces.flags.c_contiguous
    assert np.isfinite(vertices).all()
    assert np.array_equal(np.unique(faces), np.arange(len(vertices)))  # in range, and no vertex is left over
    assert (areas(vertices, faces) > 0).all()
    again = scenes.build(name)
    assert np.array_equal(vertices, again[0]) and np.array_equal(faces, again[1])


@pytest.mark.parametrize("name", CLOSED)
def test_closed_scenes_consist_of_outward_solids(name):
    vertices, faces = scenes.build(name)
    assert is_closed(faces)
    assert (volumes(vertices, faces) > 0).all()


@pytest.mark.parametrize(
    "spec", [s for s in scenes.SCENES.values() if s.kind == "open" and s.triangles < LARGE]
)
def test_open_scenes_have_boundary_edges(spec):
    count, _ = edge_counts(spec.function()[1])
    assert (count == 1).any()


@pytest.mark.parametrize("module", MODULES)
def test_provenance_is_stated(module):
    assert "Provenance:" in (importlib.import_module(f"scenes.{module}").__doc__ or "")


def test_registry_keys_and_kinds():
    assert all(name == spec.name for name, spec in scenes.SCENES.items())
    assert {spec.kind for spec in scenes.SCENES.values()} == {"closed", "open", "foliage", "interior"}
    with pytest.raises(ValueError, match=r"no scene is called 'nonsense': choose one of tetrahedron, box"):
        scenes.build("nonsense")


# -------------------------------------------------------------------------------------------- polyhedra


@pytest.mark.parametrize(
    ("solid", "volume"),
    [
        # Volumes of the regular solids inscribed in the unit sphere (a: edge length).
        (polyhedra.tetrahedron, 8 * 3**0.5 / 27),
        (polyhedra.octahedron, 4 / 3),
        (polyhedra.icosahedron, (5 / 12) * (3 + 5**0.5) * (4 / (10 + 2 * 5**0.5) ** 0.5) ** 3),
        (polyhedra.dodecahedron, (15 + 7 * 5**0.5) / 4 * (4 / (3**0.5 + 15**0.5)) ** 3),
        (polyhedra.box, 8.0),
        (polyhedra.convex_polyhedron, None),
    ],
)
def test_convex_solids_are_their_own_hull(solid, volume):
    vertices, faces = solid()
    hull = ConvexHull(vertices)
    assert len(hull.vertices) == len(vertices)
    expected = hull.volume if volume is None else volume
    # A few dozen products of numbers near one: 1e-14 leaves room for their rounding only.
    assert volumes(vertices, faces).sum() == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("subdivisions", [0, 1, 4])
def test_icosphere(subdivisions):
    vertices, faces = polyhedra.icosphere(subdivisions)
    assert len(faces) == 20 * 4**subdivisions
    assert is_closed(faces)
    assert np.abs(np.linalg.norm(vertices, axis=1) - 1).max() < 1e-15  # normalised: 2 ulp


def test_closed_room_faces_inwards():
    vertices, faces = polyhedra.closed_room((4.0, 6.0, 3.0))
    assert is_closed(faces)
    assert volumes(vertices, faces) == pytest.approx([-72.0], rel=1e-15)


def test_sheets_face_where_they_say():
    for mesh, expected in (
        (polyhedra.triangle(), (0, 0, 1)),
        (polyhedra.rectangle(2.0, 3.0, 4, 5), (0, 0, 1)),
        (polyhedra.disc(), (0, 0, 1)),
        (polyhedra.wall(), (0, -1, 0)),
    ):
        _, normals = scenes.shade_points(*mesh, n=20)
        assert np.array_equal(normals, np.broadcast_to(expected, (20, 3)))
    vertices, faces = polyhedra.rectangle(2.0, 3.0, 4, 5)
    assert len(faces) == 40
    assert areas(vertices, faces).sum() == pytest.approx(6.0, rel=1e-14)


def test_defective_fixtures_have_their_defects():
    count, balance = edge_counts(polyhedra.fin(4)[1])
    assert sorted(count) == [1] * 8 + [4]
    assert np.abs(balance).max() == 4

    # One boundary loop; and no choice of windings balances every inner edge, so some edge is left unbalanced.
    count, balance = edge_counts(polyhedra.moebius_strip(10)[1])
    assert (count == 1).sum() == 20
    assert (np.abs(balance[count == 2]) == 2).sum() == 1

    vertices, faces = polyhedra.hourglass()
    assert is_closed(faces)
    assert len(vertices) == 7 and np.bincount(faces.ravel()).max() == 6


# ----------------------------------------------------------------------------------- stated triangle counts


def test_count_formulas():
    assert len(clutter(3, 1)[1]) == 3 * (48 * 4 + 12) + 12
    assert len(fence(wires=3, bends=4, fences=2)[1]) == 2 * (3 * (10 * 11 + 6) + 116) + 12
    assert len(foliage(trees=2, leaves_per_twig=3)[1]) == 2 * (120 * 3 * 2 + 157 * 30) + 12
    assert len(teapot_grid(2, 1, 2)[1]) == 2 * (64 * 4 - 16) + 12
    assert len(polyhedra.torus(major_slices=7, minor_slices=5)[1]) == 2 * 7 * 5
    assert len(polyhedra.capsule(slices=6, rings=8)[1]) == 2 * 6 * 8
    assert len(polyhedra.spherical_cap(30.0, 9, 4)[1]) == 9 * 7


def test_seeds_matter():
    assert not np.array_equal(clutter(3, 1, seed=0)[0], clutter(3, 1, seed=1)[0])


# ----------------------------------------------------------------------------------------------- teapot


@pytest.mark.parametrize("n", [2, 5, 10])
def test_teapot_count_and_seams(n):
    _, faces = teapot(n)
    assert len(faces) == 64 * n**2 - 8 * n
    count, balance = edge_counts(faces)
    # All seams are welded. What is left: the rims of lid and body, 4n edges each, and 2n at each end of the
    # handle and of the spout.
    assert (count == 1).sum() == 16 * n
    assert (count <= 2).all() and (balance[count == 2] == 0).all()


def test_teapot_is_newells():
    control = patches()
    assert control.shape == (32, 4, 4, 3)
    distinct = np.unique(control.reshape(-1, 3) + 0.0, axis=0)
    # Newell lists 306 control points with repetitions; this is their extent.
    assert distinct.min(axis=0) == pytest.approx([-3.0, -2.0, 0.0])
    assert distinct.max(axis=0) == pytest.approx([3.525, 2.0, 3.15])

    vertices, _ = teapot(8)
    rows = set(map(tuple, vertices))
    # The corners of a patch are control points; known ones: knob, rim, widest ring, handle, spout's tip.
    for corner in (
        (0, 0, 3.15),
        (1.4, 0, 2.4),
        (0, 2, 0.9),
        (-3, 0, 1.8),
        (-2, 0, 0.9),
        (3.3, 0, 2.4),
        (0, 0, 0),
    ):
        assert corner in rows
    # Mirror symmetry in y = 0, bit for bit.
    assert rows == {(x, -y + 0.0, z) for x, y, z in rows}
    # Points are exact rationals rounded once, so a coarse tessellation is a subset of every multiple of it.
    assert set(map(tuple, teapot(4)[0])) < rows


@pytest.mark.parametrize("subdivisions", [0, 201])
def test_teapot_refuses_what_would_overflow(subdivisions):
    with pytest.raises(ValueError, match="subdivisions must be between 1 and 200"):
        teapot(subdivisions)


def test_teapot_data():
    rows = np.array([row for row in BODY + LID if row[1] != 0.45])
    # Newell's quarter circles have arms of 0.56 radii (only the knob's 0.45 is 0.5625 of 0.8).
    assert rows[:, 1] == pytest.approx(0.56 * rows[:, 0], abs=1e-15)
    # Area of another 10 x 10 tessellation of the 32 patches, a .obj file with six decimals, whose
    # vertices lie within 8e-7 of ours. Such rounding changes the area by about 1e-7 of it.
    assert areas(*teapot(10)).sum() == pytest.approx(52.6607956, rel=1e-7)


def test_teapot_parts_face_outwards():
    vertices, faces = teapot(10)
    centre = vertices[faces].mean(axis=1)
    normal = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radius = np.hypot(centre[:, 0], centre[:, 1])
    belly = (np.abs(centre[:, 2] - 1.0) < 0.3) & (radius < 2.0) & (np.abs(centre[:, 0]) < 1.5)
    assert (np.einsum("fi,fi->f", normal[belly, :2], centre[belly, :2]) > 0).all()
    assert (normal[centre[:, 2] > 3.1, 2] > 0).all()  # top of the knob
    # Flanks of handle and spout (whose lip, above z = 2.3, turns inwards as it should).
    for part in (centre[:, 0] < -2.1, (centre[:, 0] > 2.4) & (centre[:, 2] < 2.3)):
        flank = part & (np.abs(normal[:, 1]) > 0.9)
        assert flank.sum() > 40 and (normal[flank, 1] * centre[flank, 1] > 0).all()
    assert (normal[centre[:, 0] < -2.95, 0] < 0).all()  # the handle's outer curve


# -------------------------------------------------------------------------------------- the other scenes


def test_foliage_is_mostly_boundary():
    vertices, faces = scenes.build("foliage")
    count, _ = edge_counts(faces)
    assert (count == 1).mean() > 0.7
    leaves = faces[-96_012:-12]  # 48,000 leaves of two triangles, then the slab
    assert (edge_counts(leaves)[0] == 1).mean() == 0.8
    assert vertices[leaves, 2].min() > 0  # none in the ground


def test_fence_wires_are_linked_without_touching():
    paths = _wire_paths(2, 24)
    t = np.linspace(0.0, 1.0, 50)[:, None]
    dense = [(p[:-1, None] * (1 - t) + p[1:, None] * t).reshape(-1, 3) for p in paths]
    distance, _ = cKDTree(dense[0]).query(dense[1])
    # A tube lies within one radius of its path.
    assert distance.min() > 2.2 * WIRE
    # Linked: at a common bend wire 0 reaches further right than wire 1 reaches left ...
    assert dense[0][:, 0].max() > dense[1][:, 0].min()
    # ... and from below the bend to above it they exchange front and back.
    bend = 3 * np.argmax(paths[0, 1::3, 0]) + 1
    below, above = (paths[0, bend + k, 1] - paths[1, bend + k, 1] for k in (-1, 1))
    assert below * above < 0


def test_city_stands_on_its_slab_and_in_itself():
    vertices, _ = scenes.build("city")
    corners = vertices.reshape(-1, 8, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)
    ground, houses = low[-1], low[:-1]
    assert (ground[2], high[-1, 2]) == (-2.0, 0.0)
    on_slab = houses[:, 2] == 0
    # Upper tiers stand exactly on a roof; heights are whole storeys.
    assert 1000 < on_slab.sum() < len(houses)
    assert np.isin(houses[~on_slab, 2], high[:-1, 2]).all()
    assert (high[:-1, 2] % 3.5 == 0).all()
    # Party walls: many lower tiers begin in the very plane where their neighbour ends.
    ends = {(x, y) for x, y in zip(high[:-1][on_slab, 0], low[:-1][on_slab, 1], strict=True)}
    assert sum((x, y) in ends for x, y in low[:-1][on_slab, :2]) > 300


def test_room_shell_is_a_closed_solid_with_a_window():
    x, y, z = (-0.2, 0.0, 5.0, 5.2), (-0.2, 0.0, 1.2, 2.8, 4.0, 4.2), (-0.2, 0.0, 0.9, 2.1, 2.6, 2.8)
    solid = np.ones((3, 5, 5), dtype=bool)
    solid[1, 1:4, 1:4] = solid[2, 2, 2] = False
    vertices, faces = shell(x, y, z, solid)
    assert is_closed(faces)
    expected = 5.4 * 4.4 * 3.0 - 5.0 * 4.0 * 2.6 - 0.2 * 1.6 * 1.2
    assert volumes(vertices, faces) == pytest.approx([expected], rel=1e-13)
    # The room begins with it, and everything else is inside.
    room = scenes.build("room")[0]
    assert np.array_equal(room[: len(vertices)], vertices)
    rest = room[len(vertices) :]
    assert (rest >= (0, 0, 0)).all() and (rest <= (5, 4, 2.6)).all()


# ------------------------------------------------------------------------------------------------ tools


def test_weld_joins_only_equal_positions():
    tiny = np.nextafter(1.0, 2.0)
    vertices = [(0, 0, 0), (1, -0.0, 0), (0, 1, 0), (-0.0, 0, 0), (tiny, 0, 0), (0, 1, 0), (0, 1, 0)]
    welded, faces = weld(as_mesh(vertices, [(0, 1, 2), (3, 4, 5), (1, 5, 6)]))
    assert len(welded) == 4 and not np.signbit(welded).any()  # -0 is 0, and one ulp is a difference
    assert len(faces) == 2  # the collapsed one is gone


def test_revolve_makes_poles():
    vertices, faces = revolve([(0.0, 1.0), (1.0, 0.0), (0.0, -1.0)], 5)
    assert (len(vertices), len(faces)) == (7, 10)
    assert is_closed(faces) and (volumes(vertices, faces) > 0).all()


def test_grid_faces_wrap_to_a_torus():
    faces = grid_faces(3, 4, wrap_rows=True, wrap_columns=True)
    assert len(faces) == 24 and is_closed(faces)


def test_random_rotations_are_rotations():
    turns = random_rotations(np.random.default_rng(3), 50)
    assert np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() < 1e-14
    assert np.abs(np.linalg.det(turns) - 1).max() < 1e-14


# ---------------------------------------------------------------------------------------------- sampling


def test_shade_points_lie_on_the_surface():
    vertices, faces = polyhedra.box((2.0, 4.0, 6.0))
    points, normals = scenes.shade_points(vertices, faces, 500, seed=5)
    assert points.shape == normals.shape == (500, 3)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(500), rel=1e-15)
    # The plane of the face with normal n is n . x = half the box's size along n.
    assert np.einsum("ni,ni->n", points, normals) == pytest.approx(np.abs(normals) @ (1, 2, 3), rel=1e-14)
    assert (np.abs(points) <= (1 + 1e-15, 2 + 2e-15, 3 + 3e-15)).all()
    lifted, same = scenes.shade_points(vertices, faces, 500, seed=5, lift=0.25)
    assert np.array_equal(lifted, points + 0.25 * normals) and np.array_equal(same, normals)
    assert not np.array_equal(points, scenes.shade_points(vertices, faces, 500, seed=6)[0])


def test_shade_points_are_uniform_by_area_and_skip_empty_faces():
    # Areas 3, 0, 1, 0; a point's face shows in its z.
    vertices = np.array(
        [(0, 0, 0), (3, 0, 0), (0, 2, 0), (0, 0, 1), (1, 0, 1), (0, 2, 1), (2, 0, 1)], dtype=float
    )
    faces = np.array([(0, 1, 2), (3, 4, 6), (3, 4, 5), (3, 3, 5)], dtype=np.int32)
    n = 20_000
    points, normals = scenes.shade_points(vertices, faces, n, seed=2)
    assert np.isfinite(points).all() and np.array_equal(normals, np.broadcast_to((0, 0, 1), (n, 3)))
    # Binomial with p = 1/4 (seed fixed: the test is not flaky, five standard deviations say what is odd).
    assert abs((points[:, 2] == 1).mean() - 0.25) < 5 * (0.25 * 0.75 / n) ** 0.5
    large = points[points[:, 2] == 0]
    # The mean is the centroid; a coordinate's variance in a triangle of that width w is w^2 / 18.
    assert np.abs(large[:, :2].mean(axis=0) - (1, 2 / 3)).max() < 5 * (9 / 18 / len(large)) ** 0.5


# ------------------------------------------------------------------------------------------ command line


def test_command_writes_exact_ply(tmp_path, capsys):
    import trimesh

    main(["teapot", "icosphere", "-o", str(tmp_path)])
    assert "6,320 triangles" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["icosphere.ply", "teapot.ply"]
    for name in ("teapot", "icosphere"):
        loaded = trimesh.load_mesh(tmp_path / f"{name}.ply", process=False)
        vertices, faces = scenes.build(name)
        assert np.array_equal(loaded.vertices, vertices) and np.array_equal(loaded.faces, faces)


def test_command_lists_everything(checkout):
    done = subprocess.run(
        [sys.executable, "-m", "scenes", "--list"], cwd=checkout, capture_output=True, text=True, check=True
    )
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(scenes.SCENES)
    assert "2,460,012" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name at least one scene"),
        (["box", "bux"], "no scene is called bux"),
        (["box", "-o", "{tmp}/none"], "is not a folder: create it first"),
        (["box", "-o", "{tmp}/taken"], "cannot write"),
    ],
)
def test_command_errors_are_one_line(tmp_path, capsys, arguments, message):
    (tmp_path / "taken" / "box.ply").mkdir(parents=True)
    with pytest.raises(SystemExit) as stop:
        main([a.format(tmp=tmp_path) for a in arguments])
    assert stop.value.code == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert [p.name for p in (tmp_path / "taken").iterdir()] == ["box.ply"]
