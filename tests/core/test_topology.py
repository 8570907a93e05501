"""Topology: every defect on a mesh small enough to check by hand, and invariants on any mesh at all."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import scenes
from scenes import polyhedra
from scenes.mesh import concatenate, flipped
from silint.core.topology import ULP, Edges, Topology, Welding, build_topology, edges_of

CLEAN = {
    "boundary_edges": 0,
    "non_manifold_edges": 0,
    "inconsistent_edges": 0,
    "duplicate_faces": 0,
    "zero_area_faces": 0,
    "unreferenced_vertices": 0,
    "welded_vertices": 0,
}
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def build(vertices: object, faces: object) -> tuple[Topology, Welding, dict[str, int]]:
    v = np.array(vertices, np.float64).reshape(-1, 3)
    f = np.array(faces, np.int32).reshape(-1, 3)
    built = build_topology(v, f)
    check_invariants(built[0])
    return built


def half_edges(edges: Edges) -> list[tuple[int, int, int]]:
    """(face, from, to) of everything that the edges list."""
    found = []
    for e, (a, b) in enumerate(edges.ends.tolist()):
        for code in edges.faces[edges.offsets[e] : edges.offsets[e + 1]].tolist():
            found.append((code, a, b) if code >= 0 else (~code, b, a))
    return found


def check_invariants(topology: Topology) -> None:
    vertices, faces = topology.vertices, topology.faces
    # Distinct positions in lexicographic order: no edge's direction depends on the file.
    assert [tuple(v) for v in vertices] == sorted({tuple(v) for v in vertices})
    # Edges run upwards, each is listed once, in order; every side of every face stands under exactly one.
    edges = edges_of(topology)
    assert (edges.ends[:, 0] < edges.ends[:, 1]).all()
    np.testing.assert_array_equal(np.unique(edges.ends, axis=0), edges.ends)
    assert (np.diff(edges.offsets) >= 1).all()
    expected = [(f, v[i], v[(i + 1) % 3]) for f, v in enumerate(faces.tolist()) for i in range(3)]
    assert sorted(half_edges(edges)) == sorted(expected)

    # Planes: unit normals (a square root and a division: within 2 ulp), each used.
    planes = topology.planes
    np.testing.assert_allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0, rtol=0, atol=4 * ULP)
    codes = topology.face_planes
    k = np.maximum(codes, ~codes)
    assert sorted(set(k.tolist())) == list(range(len(planes)))
    for f, corners in enumerate(faces):
        # In exact arithmetic: the stored bound has to hold for the stored numbers as they are.
        n = [Fraction(float(x)) for x in planes[k[f]]]
        for v in corners:
            x = [Fraction(float(c)) for c in vertices[v]]
            distance = abs(sum(a * b for a, b in zip(n, x, strict=False)) + n[3])
            assert distance <= Fraction(float(topology.plane_errors[k[f]]))
        # The code's sign is the winding's. Where the area is all rounding, either will do.
        a, b, c = vertices[corners]
        area = np.cross(b - a, c - a)
        along = float(planes[k[f], :3] @ area) * (1 if codes[f] >= 0 else -1)
        assert along > 0 or np.linalg.norm(area) < 1e-12


@pytest.mark.nojit
def test_a_box_has_six_planes_and_no_defect() -> None:
    topology, welding, defects = build(*polyhedra.box())
    assert defects == CLEAN
    assert (len(topology.vertices), len(edges_of(topology).ends), len(topology.planes)) == (8, 18, 6)
    # Half edges of 1: the scale is the power of two that brings the largest coordinate to 1/2.
    assert welding.exponent == 1
    assert np.abs(topology.vertices).max() == 0.5


@pytest.mark.nojit
def test_a_single_triangle_is_all_boundary() -> None:
    topology, _, defects = build(*polyhedra.triangle())
    assert defects == CLEAN | {"boundary_edges": 3}
    assert edges_of(topology).offsets.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(("sheets", "non_manifold"), [(2, 0), (3, 1), (5, 1)])
def test_fin(sheets: int, non_manifold: int) -> None:
    """Sheets around one edge, all wound alike along it."""
    topology, _, defects = build(*polyhedra.fin(sheets))
    alike = 1 if sheets == 2 else 0  # two faces that run the same way along their edge
    assert defects == CLEAN | {
        "boundary_edges": 2 * sheets,
        "non_manifold_edges": non_manifold,
        "inconsistent_edges": alike,
    }
    assert np.diff(edges_of(topology).offsets).max() == sheets


def test_a_fan_of_many_blades_in_any_order() -> None:
    # All sides but the rim's lie at one vertex, the lowest of all.
    angle = np.linspace(0.0, 1.0, 401)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(50 * angle)], axis=1)
    blades = np.array([(0, j + 1, j + 2) for j in range(400)])
    blades = blades[np.random.default_rng(8).permutation(len(blades))]
    _, _, defects = build(np.concatenate([[(-1.0, 0.0, 0.0)], rim]), blades)
    assert defects == CLEAN | {"boundary_edges": 402}


def test_a_bowtie_vertex_is_no_defect_of_edges() -> None:
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (-1, 0, 0), (-1, -1, 0)]
    topology, _, defects = build(vertices, [(0, 1, 2), (0, 3, 4)])
    assert defects == CLEAN | {"boundary_edges": 6}
    # In one plane, but connected by no edge: the search for flat regions does not jump.
    assert len(topology.planes) == 2
    assert build(*polyhedra.hourglass())[2] == CLEAN


def test_inconsistent_winding_is_counted_edge_by_edge() -> None:
    assert build(SQUARE, [(0, 1, 2), (0, 2, 3)])[2] == CLEAN | {"boundary_edges": 4}
    twisted, _, defects = build(SQUARE, [(0, 1, 2), (0, 3, 2)])
    assert defects == CLEAN | {"boundary_edges": 4, "inconsistent_edges": 1}
    # One plane, and the second face on its back.
    assert len(twisted.planes) == 1
    assert sorted(twisted.face_planes.tolist()) == [-1, 0]
    # A Moebius strip can be wound consistently everywhere but at one place.
    assert build(*polyhedra.moebius_strip())[2]["inconsistent_edges"] == 1


@pytest.mark.parametrize(
    ("again", "inconsistent"),
    [((0, 1, 2), 3), ((1, 2, 0), 3), ((0, 2, 1), 0)],
    ids=["same", "rotated", "opposite"],
)
def test_duplicate_face(again: tuple[int, int, int], inconsistent: int) -> None:
    topology, _, defects = build(SQUARE[:3], [(0, 1, 2), again])
    assert defects == CLEAN | {"duplicate_faces": 1, "inconsistent_edges": inconsistent}
    assert len(topology.planes) == 1


def test_each_further_copy_of_a_face_counts() -> None:
    assert build(SQUARE[:3], [(0, 1, 2)] * 4)[2]["duplicate_faces"] == 3
    box = polyhedra.box()
    assert build(*concatenate([box, box]))[2] == CLEAN | {
        "non_manifold_edges": 18,
        "duplicate_faces": 12,
        "welded_vertices": 8,
    }
    assert build(*concatenate([box, flipped(box)]))[2]["duplicate_faces"] == 12
    # Faces that share an edge, but not their third vertex, are no duplicates.
    assert build(*polyhedra.fin(5))[2]["duplicate_faces"] == 0


def test_zero_area_faces() -> None:
    # Three distinct points of a line keep their face, which connects its neighbours.
    topology, welding, defects = build([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)])
    assert defects == CLEAN | {"boundary_edges": 3, "zero_area_faces": 1}
    assert len(topology.faces) == 1
    # Two equal corners, by index or by position, leave no triangle.
    vertices = [*SQUARE, (1, 0, 0)]
    topology, welding, defects = build(vertices, [(0, 0, 1), (1, 2, 4), (0, 1, 2)])
    assert defects == CLEAN | {
        "boundary_edges": 3,
        "zero_area_faces": 2,
        "welded_vertices": 1,
        "unreferenced_vertices": 1,
    }
    assert welding.face_map.tolist() == [2]


def test_a_face_as_thin_as_doubles_allow_has_a_unit_normal() -> None:
    tiny = 2.0**-540  # its square underflows
    topology, _, _ = build([(0, 0, 0), (tiny, 0, 0), (0, tiny, 0), (1, 1, 1)], [(0, 1, 2), (0, 1, 3)])
    # Found by the invariants of `build`; and it is the right one.
    k = topology.face_planes[0]
    assert abs(topology.planes[max(k, ~k), 2]) == 1.0


def test_vertices_are_welded_by_position_only() -> None:
    vertices = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, -0.0), (-0.0, 1, 0), (5, 5, 5)]
    _, welding, defects = build(vertices, [(0, 1, 2), (5, 4, 3)])
    assert defects == CLEAN | {"boundary_edges": 4, "welded_vertices": 2, "unreferenced_vertices": 1}
    assert welding.vertex_map[4] == welding.vertex_map[1] and welding.vertex_map[5] == welding.vertex_map[2]
    # One ulp apart is apart.
    nearly = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (np.nextafter(1, 2), 0, 0), (0, 1, 0)]
    assert build(nearly, [(0, 1, 2), (5, 4, 3)])[2]["boundary_edges"] == 6


def test_flat_regions_share_a_plane() -> None:
    topology, _, _ = build(*polyhedra.rectangle(1.0, 1.0, 5, 4))
    assert len(topology.planes) == 1
    vertices, faces = polyhedra.rectangle(1.0, 1.0, 5, 4)
    angle = 0.7
    turned = vertices @ np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    # Rounded to the grid of doubles its vertices stray by less than the 4 ulp that still count as flat.
    assert len(build(turned, faces)[0].planes) == 1
    assert len(build(*polyhedra.dodecahedron())[0].planes) == 12


def test_a_gently_curved_strip_does_not_chain_into_one_plane() -> None:
    # z = x^2 / 2^32 at x = j / 1024: exact. A quad's far edge lies 2^-51 off its neighbour's plane, which is
    # within the tolerance of 4 ulp (2^-50); the strip as a whole bends by 2^-34.
    x = np.arange(512) / 1024
    z = x * x / 2**32
    vertices = np.concatenate([np.stack([x, y + 0 * x, z], axis=1) for y in (0.0, 1 / 1024)])
    quads = [(j, j + 1, j + 513, j + 512) for j in range(511)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    topology, _, _ = build(vertices, faces)
    assert 1 < len(topology.planes) < 511
    # Each vertex within the tolerance of its region's own seed (8 units of 2^-53), and 4 units of rounding.
    assert topology.plane_errors.max() <= 12 * ULP


@pytest.mark.parametrize("exponent", [-900, -300, -20, 3, 400, 1000])
def test_powers_of_two_change_nothing_but_the_exponent(exponent: int) -> None:
    vertices, faces = polyhedra.torus(major_slices=8, minor_slices=6)
    base, welding, defects = build_topology(vertices, faces)
    scaled, scaled_welding, scaled_defects = build_topology(np.ldexp(vertices, exponent), faces)
    assert scaled_defects == defects
    assert scaled_welding.exponent == welding.exponent + exponent
    for a, b in zip(base, scaled, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_order_of_the_file_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    vertices, faces = polyhedra.capsule(slices=8, rings=6)
    moved = rng.permutation(len(vertices))
    back = np.argsort(moved)
    shuffled = back[faces][rng.permutation(len(faces))]
    base, _, _ = build_topology(vertices, faces)
    other, welding, _ = build_topology(vertices[moved], shuffled.astype(np.int32))
    np.testing.assert_array_equal(base.vertices, other.vertices)
    np.testing.assert_array_equal(edges_of(base).ends, edges_of(other).ends)
    np.testing.assert_array_equal(
        np.ldexp(other.vertices, welding.exponent)[welding.vertex_map], vertices[moved]
    )


# ------------------------------------------------------------------------------------- any mesh at all


@st.composite
def meshes(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Few faces over few points of a coarse grid: every defect, alone and combined, comes up often."""
    n = draw(st.integers(3, 7))
    grid = st.integers(-2, 2)
    vertices = draw(st.lists(st.tuples(grid, grid, grid), min_size=n, max_size=n))
    index = st.integers(0, n - 1)
    faces = draw(st.lists(st.tuples(index, index, index), min_size=1, max_size=10))
    return np.array(vertices, np.float64), np.array(faces, np.int32)


def count_defects(vertices: np.ndarray, faces: np.ndarray) -> dict[str, int]:
    """The definitions, word by word."""
    position = {v: tuple(vertices[v]) for v in range(len(vertices))}
    triangles = [tuple(position[v] for v in f) for f in faces.tolist()]
    whole = [t for t in triangles if len(set(t)) == 3]
    sides = Counter(frozenset((t[i], t[(i + 1) % 3])) for t in whole for i in range(3))
    directed = Counter((t[i], t[(i + 1) % 3]) for t in whole for i in range(3))
    area = [np.cross(np.subtract(t[1], t[0]), np.subtract(t[2], t[0])).any() for t in triangles]
    return {
        "boundary_edges": sum(c == 1 for c in sides.values()),
        "non_manifold_edges": sum(c > 2 for c in sides.values()),
        "inconsistent_edges": sum(c == 2 and sides[frozenset(s)] == 2 for s, c in directed.items()),
        "duplicate_faces": len(whole) - len({frozenset(t) for t in whole}),
        "zero_area_faces": sum(not a for a in area),
        "unreferenced_vertices": len(vertices) - len(set(faces.ravel().tolist())),
        "welded_vertices": len(vertices) - len(set(position.values())),
    }


def check_any(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    _, welding, defects = build(*mesh)
    assert defects == count_defects(*mesh)
    assert len(welding.face_map) == len(np.unique(welding.face_map))


@settings(max_examples=60)
@given(meshes())
def test_defects_of_any_mesh(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    check_any(mesh)


@pytest.mark.slow
@settings(max_examples=2000)
@given(meshes())
def test_defects_of_very_many_meshes(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    check_any(mesh)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clutter_9k", "teapot", "room", "city"])
def test_invariants_of_scenes(name: str) -> None:
    build(*scenes.build(name))
