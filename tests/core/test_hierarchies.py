"""Hierarchies hold everything once, bound all of it, and find the contours that testing every edge finds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import scenes
from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate
from silint.core.contour import EDGES, N_TALLY, NODES, gather_contours, side_rounding
from silint.core.edge_hierarchy import (
    CENTRE,
    HALF,
    N_DUAL,
    N_POSITION,
    NORMAL,
    NORMAL_HALF,
    OFFSET,
    OFFSET_HALF,
    EdgeHierarchy,
    build_edge_hierarchies,
)
from silint.core.face_hierarchy import build_face_hierarchy
from silint.core.isolines import horizon_reach, start_corner
from silint.core.octahedral import N_ROWS, cross_edges
from silint.core.partition import DONE, LEAF_SIZE, balanced_order, next_in_preorder, node_range, tree_depth
from silint.core.topology import ULP, Topology, build_topology, edges_of
from silint.reference import brute_force

Mesh = tuple[np.ndarray, np.ndarray]

# Centre and half width of a box are each rounded once, like the coordinates' distance from the centre.
BOX_ROUNDING = 4 * ULP


def soup(n: int, seed: int = 0) -> Mesh:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-2, 2, size=(n, 1, 3))
    return (centres + rng.normal(scale=0.5, size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def tangle(n: int = 30, seed: int = 5) -> Mesh:
    """Any number of faces on an edge, wound anyhow."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, size=(9, 3)), np.array([rng.choice(9, 3, replace=False) for _ in range(n)])


def rewound(mesh: Mesh, seed: int = 0) -> Mesh:
    """Every third face turned over: inconsistent edges everywhere."""
    vertices, faces = mesh
    turned = np.random.default_rng(seed).random(len(faces)) < 1 / 3
    return vertices, np.where(turned[:, None], faces[:, ::-1], faces)


SCENES: dict[str, Callable[[], Mesh]] = {
    "triangle": polyhedra.triangle,
    "box": polyhedra.box,
    "fin": lambda: polyhedra.fin(5),
    "moebius strip": lambda: polyhedra.moebius_strip(12),
    "doubled box": lambda: concatenate([polyhedra.box(), polyhedra.box()]),
    "soup": lambda: soup(40),
    "tangle": tangle,
    "clutter": lambda: clutter(2, 2),
    "clutter, rewound": lambda: rewound(clutter(1, 2)),
    "leaves": lambda: foliage(1, 1),
}


def topology_of(name: str) -> Topology:
    vertices, faces = SCENES[name]() if name in SCENES else scenes.build(name)
    return build_topology(vertices, faces.astype(np.int32))[0]


# ------------------------------------------------------------------------------------------------ trees


@pytest.mark.nojit
@pytest.mark.parametrize("n", [0, 1, 6, 7, 12, 13, 97])
def test_leaves_share_out_the_items(n: int) -> None:
    depth = tree_depth(n)
    ranges = [node_range(n, depth, j) for j in range(1 << depth)]
    assert [i for first, last in ranges for i in range(first, last)] == list(range(n))
    assert max(last - first for first, last in ranges) <= LEAF_SIZE
    # No deeper than needed.
    assert depth == 0 or -(-n // (1 << (depth - 1))) > LEAF_SIZE


@pytest.mark.nojit
def test_preorder_visits_every_node_and_skips_subtrees() -> None:
    depth, first_leaf = 3, 7
    visited, node = [], 0
    while node != DONE:
        visited.append(node)
        node = 2 * node + 1 if node < first_leaf else next_in_preorder(node)
    assert visited == [0, 1, 3, 7, 8, 4, 9, 10, 2, 5, 11, 12, 6, 13, 14]
    assert len(visited) == 2 ** (depth + 1) - 1
    # What follows a node that is not entered is what follows its last leaf.
    assert [next_in_preorder(i) for i in (0, 1, 2, 3, 4, 5, 6)] == [DONE, 2, DONE, 4, 2, 6, DONE]


@pytest.mark.nojit
def test_balanced_order_splits_at_medians() -> None:
    rng = np.random.default_rng(0)
    keys = rng.random((50, 2)).astype(np.float32) * np.array([10, 1], np.float32)
    order, depth = balanced_order(keys.copy())
    assert sorted(order.tolist()) == list(range(50))
    # The first split is along the wider axis: all of the left half stays left of all of the right half.
    middle = node_range(50, 1, 0)[1]
    assert keys[order[:middle], 0].max() <= keys[order[middle:], 0].min()
    assert depth == tree_depth(50)
    # Equal keys are still shared out evenly.
    assert sorted(balanced_order(np.zeros((50, 2), np.float32))[0].tolist()) == list(range(50))


def nodes(n: int, depth: int) -> list[tuple[int, int, int]]:
    """(node, first, last) of every node of a tree over n items."""
    return [
        ((1 << level) - 1 + j, *node_range(n, level, j))
        for level in range(depth + 1)
        for j in range(1 << level)
    ]


@pytest.mark.parametrize("name", SCENES)
def test_every_face_stands_in_one_leaf_inside_its_boxes(name: str) -> None:
    topology = topology_of(name)
    tree = build_face_hierarchy(topology)
    assert sorted(tree.order.tolist()) == list(range(len(topology.faces)))
    for node, first, last in nodes(len(tree.order), tree.depth):
        corners = topology.vertices[topology.faces[tree.order[first:last]]].reshape(-1, 3)
        away = np.abs(corners - tree.boxes[node, :3])
        assert (away <= tree.boxes[node, 3:] + BOX_ROUNDING).all()


def dual_ends(topology: Topology, tree: EdgeHierarchy, e: int) -> np.ndarray:
    """The edge as a segment in dual space; contours are where its ends have values of opposite signs."""
    ends = []
    for i, code in enumerate(tree.planes[tree.offsets[e] : tree.offsets[e + 1]].tolist()):
        sign = 1 if code >= 0 else -1
        ends.append((-sign if i == 1 else sign) * topology.planes[max(code, ~code)])
    return np.array(ends)


@pytest.mark.parametrize("name", SCENES)
def test_every_edge_stands_in_one_leaf_inside_its_bounds(name: str) -> None:
    topology = topology_of(name)
    edges = edges_of(topology)
    contour, boundary, n_flat = build_edge_hierarchies(topology)
    assert len(contour.ends) + len(boundary.ends) + n_flat == len(edges.ends)
    held = np.concatenate([contour.ends, boundary.ends])
    assert len(np.unique(held, axis=0)) == len(held)
    number = {tuple(edge): e for e, edge in enumerate(edges.ends.tolist())}

    for tree, width in ((contour, N_DUAL), (boundary, N_POSITION)):
        degree = np.diff(tree.offsets)
        assert (degree == 2).all() if tree is contour else (degree != 2).all()
        assert tree.bounds.shape == (2 ** (tree.depth + 1) - 1, width)
        for e, edge in enumerate(tree.ends.tolist()):
            # The planes of an edge are those of its faces, the directions of both multiplied.
            faces = edges.faces[slice(*edges.offsets[number[tuple(edge)] : number[tuple(edge)] + 2])]
            planes = [
                topology.face_planes[f] if f >= 0 else ~topology.face_planes[~f] for f in faces.tolist()
            ]
            assert tree.planes[tree.offsets[e] : tree.offsets[e + 1]].tolist() == planes
        for node, first, last in nodes(len(tree.ends), tree.depth):
            row = tree.bounds[node]
            corners = topology.vertices[tree.ends[first:last]].reshape(-1, 3)
            assert (np.abs(corners - row[CENTRE : CENTRE + 3]) <= row[HALF : HALF + 3] + BOX_ROUNDING).all()
            if width == N_POSITION or first == last:
                continue
            dual = np.concatenate([dual_ends(topology, tree, e) for e in range(first, last)])
            away = np.abs(dual[:, :3] - row[NORMAL : NORMAL + 3])
            assert (away <= row[NORMAL_HALF : NORMAL_HALF + 3] + BOX_ROUNDING).all()
            offsets = dual[:, :3] @ row[CENTRE : CENTRE + 3] + dual[:, 3]
            # Three products and sums of numbers below 1 and a plane's offset below 2.
            assert (np.abs(offsets - row[OFFSET]) <= row[OFFSET_HALF] + 16 * ULP).all()


def test_flat_edges_are_contours_from_nowhere() -> None:
    # The twelve edges of a box, without the diagonals of its sides.
    contour, boundary, n_flat = build_edge_hierarchies(topology_of("box"))
    assert (len(contour.ends), len(boundary.ends), n_flat) == (12, 0, 6)
    # A sheet of two triangles keeps its outline, also if the two are wound against each other.
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    for second in ((0, 2, 3), (0, 3, 2)):
        topology = build_topology(square, np.array([(0, 1, 2), second], np.int32))[0]
        contour, boundary, n_flat = build_edge_hierarchies(topology)
        assert (len(contour.ends), len(boundary.ends), n_flat) == (0, 4, 1)
    # Two faces in one plane on the same side of their edge hide the same part twice: not flat, however wound.
    for second in ((0, 1, 2), (0, 2, 1)):
        topology = build_topology(square, np.array([(0, 1, 2), second], np.int32))[0]
        contour, boundary, n_flat = build_edge_hierarchies(topology)
        assert (len(contour.ends), len(boundary.ends), n_flat) == (3, 0, 0)


# -------------------------------------------------------------------------------------------- contours


def shade_points(topology: Topology, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """In space within and about the scene, and lifted off faces."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = rng.uniform(-1, 1, size=(n, 3))
    corners = topology.vertices[topology.faces[rng.integers(0, len(topology.faces), n)]]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    on_faces = np.linalg.norm(up, axis=1) > 0
    points[: n // 2] = corners.mean(axis=1)[: n // 2]
    half = np.arange(n) < n // 2
    normals[half & on_faces] = (up / np.linalg.norm(up, axis=1)[:, None])[half & on_faces]
    return points + 2.0**-36 * normals, normals


def gathered(
    topology: Topology, trees: tuple[EdgeHierarchy, EdgeHierarchy], p: np.ndarray, n: np.ndarray, n_lines: int
) -> tuple[dict[tuple[int, int], int], np.ndarray]:
    tally = np.zeros(N_TALLY, np.int64)
    corner = start_corner(tuple(n.tolist()))
    # Room for two rows only: the search has to stop, grow and go on.
    rows, count = np.empty((2 * LEAF_SIZE, 3), np.int32), 0
    for tree in trees:
        rows, count = gather_contours(
            topology, tree, tuple(p.tolist()), tuple(n.tolist()), corner, n_lines, rows, count, tally
        )
    found = {(a, b): jump for a, b, jump in rows[:count].tolist()}
    assert len(found) == count
    return found, tally


def every_edge_tested(topology: Topology, p: np.ndarray, n: np.ndarray) -> dict[tuple[int, int], int]:
    """Contour edges with an end above the horizon, from the oracle's exact sides."""
    oracle = brute_force.contour_jumps(topology.vertices, topology.faces, p)
    np.testing.assert_array_equal(oracle.positions, topology.vertices)
    np.testing.assert_array_equal(oracle.edges, edges_of(topology).ends)
    above = (topology.vertices - p) @ n > 0.0
    assert not oracle.edge_on.any()
    chosen = (oracle.jumps != 0) & above[oracle.edges].any(axis=1)
    return {
        (a, b): jump
        for (a, b), jump in zip(oracle.edges[chosen].tolist(), oracle.jumps[chosen].tolist(), strict=True)
    }


def is_decided(topology: Topology, p: np.ndarray) -> bool:
    """Whether rounding leaves no doubt on which side of any plane the point lies."""
    distance = np.abs(topology.planes[:, :3] @ p + topology.planes[:, 3])
    return bool((distance > topology.plane_errors + side_rounding(tuple(p.tolist()))).all())


def check_contours(topology: Topology, n_points: int, seed: int = 2) -> tuple[int, int]:
    """Compares all points; returns how many contours there were, and how many edges were tested."""
    trees = build_edge_hierarchies(topology)[:2]
    n_contours = n_tested = n_compared = 0
    for p, n in zip(*shade_points(topology, n_points, seed), strict=True):
        if not is_decided(topology, p):
            continue
        found, tally = gathered(topology, trees, p, n, 0)
        expected = every_edge_tested(topology, p, n)
        assert found == expected
        n_contours += len(found)
        n_tested += int(tally[EDGES])
        n_compared += 1
        assert tally[NODES] > 0
    assert n_compared >= n_points // 2
    return n_contours, n_tested


@pytest.mark.parametrize("name", SCENES)
def test_contours_are_those_of_testing_every_edge(name: str) -> None:
    n_contours, _ = check_contours(topology_of(name), 16)
    assert n_contours > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clutter_9k", "teapot", "room", "fence", "city"])
def test_contours_of_scenes(name: str) -> None:
    topology = topology_of(name)
    n_contours, n_tested = check_contours(topology, 60)
    assert n_contours <= n_tested < 0.5 * 60 * len(edges_of(topology).ends)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("n_lines", [1, 8, 33])
def test_edges_between_isolines_cross_nothing_that_is_swept(name: str, n_lines: int) -> None:
    """Skipping what lies between two isolines loses contours only that leave no trace in the ledger."""
    topology = topology_of(name)
    trees = build_edge_hierarchies(topology)[:2]
    for p, n in zip(*shade_points(topology, 12, 7), strict=True):
        every, _ = gathered(topology, trees, p, n, 0)
        some, _ = gathered(topology, trees, p, n, n_lines)
        assert some.items() <= every.items()
        lost = np.array([(*e, j) for e, j in every.items() if e not in some], np.int32).reshape(-1, 3)
        assert not crossed(topology, lost, p, n, n_lines).any()


def crossed(
    topology: Topology, contours: np.ndarray, p: np.ndarray, n: np.ndarray, n_lines: int
) -> np.ndarray:
    """The ledger of some contour edges: crossings of isolines, start curve and horizon."""
    p, n = tuple(p.tolist()), tuple(n.tolist())
    corner = start_corner(n)
    reach = np.array([horizon_reach(n, corner, k, n_lines) for k in range(n_lines)]).T.copy()
    ledger = np.zeros((N_ROWS, n_lines + 1), np.int32)
    capacity = 4 * n_lines * (len(contours) + 1)
    line, position, gain = np.empty(capacity, np.int32), np.empty(capacity), np.empty(capacity, np.int32)
    _, count = cross_edges(
        topology.vertices, contours, len(contours), p, n, corner, reach, ledger, line, position, gain, 0, 0
    )
    assert count == ledger[0].sum()
    return ledger


def test_the_search_is_worth_its_while() -> None:
    """At this size the trees are shallow: three quarters. The project's promise is 40 % at 31k triangles."""
    topology = topology_of("clutter")
    n_contours, n_tested = check_contours(topology, 16)
    assert n_contours < n_tested < 0.75 * 16 * len(edges_of(topology).ends)
