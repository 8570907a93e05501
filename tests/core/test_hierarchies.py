"""Bundles hold everything once and bound all of it; the search finds what testing every edge finds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

import scenes
from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate
from silint.core import bundles, face_bundles
from silint.core.bundles import EdgeBundles, build_edge_bundles
from silint.core.contour import EDGES, N_TALLY, NODES, decide_contours, side_rounding
from silint.core.crossings import N_LANE_FIELDS, N_SPAN_FIELDS
from silint.core.crossings import cross_edges as cross_radial_lines
from silint.core.face_bundles import build_face_bundles
from silint.core.isolines import horizon_reach, start_corner
from silint.core.lanes import WIDTH
from silint.core.octahedral import N_ROWS, cross_edges
from silint.core.partition import aligned_order, level_blocks
from silint.core.radial import line_table, normal_table, set_frame
from silint.core.search import N_POINT, N_TILE, TILE, new_search, search_tile, set_point, set_tile
from silint.core.sweep import _axes
from silint.core.topology import ULP, Topology, build_topology, edges_of
from silint.reference import brute_force

Mesh = tuple[np.ndarray, np.ndarray]

# Bounds are rounded outwards to float32; what is compared with them is rounded in float64.
ROUNDING = 8 * ULP
# An integer of 16 bits is off by half a step; a centre and a radius are numbers in float32.
STEP = 0.51 / bundles.FULL_SCALE


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
@pytest.mark.parametrize("n", [0, 1, 16, 17, 256, 257, 4097])
def test_every_level_has_a_node_for_every_item(n: int) -> None:
    levels, sizes = level_blocks(n)
    assert sizes == [WIDTH ** (i + 1) for i in range(len(sizes))]
    n_nodes = [-(-n // size) for size in sizes]
    assert np.diff(levels).tolist() == [max(-(-m // WIDTH), 1) for m in n_nodes]
    # The top is one block, and no level above another is without need.
    assert n_nodes[-1] <= WIDTH and all(m > WIDTH for m in n_nodes[:-1])
    # Node j of a level is the parent of the block j of the level below.
    assert all(low == -(-below // WIDTH) for low, below in zip(n_nodes[1:], n_nodes[:-1], strict=True))


@pytest.mark.nojit
@pytest.mark.parametrize("n", [0, 1, 16, 50, 97, 300])
def test_aligned_runs_belong_together(n: int) -> None:
    rng = np.random.default_rng(0)
    keys = rng.random((n, 2)).astype(np.float32) * np.array([10, 1], np.float32)
    order = aligned_order(keys.copy())
    assert sorted(order.tolist()) == list(range(n))
    size = WIDTH
    while 2 * size < 2 * n:
        # Every run of twice the size is split along the axis in which it is the widest.
        for first in range(0, n, 2 * size):
            run = keys[order[first : first + 2 * size]]
            left, right = run[:size], run[size:]
            axis = int(np.argmax(np.ptp(run, axis=0)))
            assert len(right) == 0 or left[:, axis].max() <= right[:, axis].min()
        size *= 2


@pytest.mark.nojit
def test_equal_keys_are_shared_out_all_the_same() -> None:
    assert sorted(aligned_order(np.zeros((50, 2), np.float32)).tolist()) == list(range(50))
    spread = np.repeat(np.arange(4, dtype=np.float32), 16)[:, None]
    order = aligned_order(np.random.default_rng(0).permuted(spread))
    assert sorted(order.tolist()) == list(range(64))


def nodes(n: int) -> list[tuple[int, int, int, int]]:
    """(block, lane, first, last) of every lane of every block of a tree over n items; empty ones included."""
    levels, sizes = level_blocks(n)
    return [
        (int(levels[level]) + block, lane, min(first, n), min(first + size, n))
        for level, size in enumerate(sizes)
        for block in range(int(levels[level + 1] - levels[level]))
        for lane in range(WIDTH)
        for first in [(block * WIDTH + lane) * size]
    ]


def fields(array: np.ndarray, n_fields: int, block: int, lane: int) -> np.ndarray:
    """All fields of one lane, in float64."""
    return array.reshape(-1, n_fields, WIDTH)[block, :, lane].astype(np.float64)


@pytest.mark.parametrize("name", SCENES)
def test_every_face_stands_in_one_bundle_inside_its_boxes(name: str) -> None:
    topology = topology_of(name)
    tree = build_face_bundles(topology)
    n = len(topology.faces)
    assert sorted(tree.order.tolist()) == list(range(n))
    np.testing.assert_array_equal(tree.levels, level_blocks(n)[0])
    held = np.zeros(n, int)
    for block, lane, first, last in nodes(n):
        node = fields(tree.nodes, face_bundles.N_FIELDS, block, lane)
        centre, half = node[:3], node[3:]
        if first == last:
            assert (half < -1e20).all()  # met by nothing
            continue
        corners = topology.vertices[topology.faces[tree.order[first:last]]].reshape(-1, 3)
        away = np.abs(corners - centre).max(axis=0)
        assert (away <= half + ROUNDING).all()
        assert (half <= away + 4e-6).all()  # and no looser than float32 makes them
        if block < tree.levels[1]:
            held[first:last] += 1
            bundle = block * WIDTH + lane
            assert (first, last) == (bundle * WIDTH, min((bundle + 1) * WIDTH, n))
            for i in range(first, last):
                packed = fields(tree.coarse, 9, bundle, i - first).reshape(3, 3)
                found = centre + packed * (half.max() / face_bundles.FULL_SCALE)
                exact = topology.vertices[topology.faces[tree.order[i]]]
                assert np.abs(found - exact).max() <= STEP * half.max() + ROUNDING
                # And as they are, in rising order.
                held_exactly = tree.corners.reshape(-1, 9, WIDTH)[bundle, :, i - first].reshape(3, 3)
                rising = topology.vertices[np.sort(topology.faces[tree.order[i]])]
                np.testing.assert_array_equal(held_exactly, rising)
    assert (held == 1).all()


def oriented_planes(topology: Topology, codes: np.ndarray) -> np.ndarray:
    """The two planes of an ordinary edge, the second negated: no contour where both agree in sign."""
    sign = np.where(codes < 0, -1.0, 1.0) * np.array([1.0, -1.0])
    return sign[:, None] * topology.planes[np.where(codes < 0, ~codes, codes)]


@pytest.mark.parametrize("name", SCENES)
def test_every_edge_stands_in_one_bundle_inside_its_bounds(name: str) -> None:
    topology = topology_of(name)
    edges = edges_of(topology)
    contour, boundary, n_flat = build_edge_bundles(topology)
    assert len(contour.ends) + len(boundary.ends) + n_flat == len(edges.ends)
    held = np.concatenate([contour.ends, boundary.ends])
    assert len(np.unique(held, axis=0)) == len(held)
    number = {tuple(edge): e for e, edge in enumerate(edges.ends.tolist())}

    for tree in (contour, boundary):
        pairs = tree is contour
        n = len(tree.ends)
        assert len(tree.offsets) == (0 if pairs else n + 1)
        offsets = 2 * np.arange(n + 1) if pairs else tree.offsets
        assert pairs or (np.diff(offsets) != 2).all()
        np.testing.assert_array_equal(tree.levels, level_blocks(n)[0])
        for e, edge in enumerate(tree.ends.tolist()):
            # The planes of an edge are those of its faces, the directions of both multiplied.
            faces = edges.faces[slice(*edges.offsets[number[tuple(edge)] : number[tuple(edge)] + 2])]
            planes = [
                topology.face_planes[f] if f >= 0 else ~topology.face_planes[~f] for f in faces.tolist()
            ]
            assert tree.codes[offsets[e] : offsets[e + 1]].tolist() == planes
        in_bundles = np.zeros(n, int)
        for block, lane, first, last in nodes(n):
            node = fields(tree.nodes, bundles.N_FIELDS, block, lane)
            if first == last:
                assert (node[bundles.HALF : bundles.HALF + 3] < -1e20).all()  # below every horizon
                continue
            check_edge_node(topology, tree, node, first, last, pairs)
            if block < tree.levels[1]:
                in_bundles[first:last] += 1
                bundle = block * WIDTH + lane
                assert (first, last) == (bundle * WIDTH, min((bundle + 1) * WIDTH, n))
                for e in range(first, last):
                    check_packed_edge(topology, tree, node, bundle, e, pairs)
        assert (in_bundles == 1).all()


def check_edge_node(
    topology: Topology, tree: EdgeBundles, node: np.ndarray, first: int, last: int, pairs: bool
) -> None:
    centre = node[bundles.CENTRE : bundles.CENTRE + 3]
    half = node[bundles.HALF : bundles.HALF + 3]
    corners = topology.vertices[tree.ends[first:last]].reshape(-1, 3)
    away = np.abs(corners - centre).max(axis=0)
    assert (away <= half + ROUNDING).all() and (half <= away + 4e-6).all()
    radius = np.linalg.norm(corners - centre, axis=1).max()
    assert radius <= node[bundles.RADIUS] + ROUNDING <= radius + 4e-6
    if not pairs:
        # Sides that always differ, wherever the point is.
        assert not node[bundles.NORMAL : bundles.OFFSET_HALF].any() and node[bundles.OFFSET_HALF] > 1e20
        return
    planes = np.concatenate(
        [oriented_planes(topology, tree.codes[2 * e : 2 * e + 2]) for e in range(first, last)]
    )
    spread = np.abs(planes[:, :3] - node[bundles.NORMAL : bundles.NORMAL + 3]).max(axis=0)
    assert (spread <= node[bundles.NORMAL_HALF : bundles.NORMAL_HALF + 3] + ROUNDING).all()
    assert (node[bundles.NORMAL_HALF : bundles.NORMAL_HALF + 3] <= spread + 4e-6).all()
    # At the centre: three products and sums of numbers below 1 and a plane's offset below 2; and on either
    # side of it the plane's own error, within which a face's side is not trusted.
    codes = tree.codes[2 * first : 2 * last]
    error = topology.plane_errors[np.where(codes < 0, ~codes, codes)].max()
    offset = np.abs(planes[:, :3] @ centre + planes[:, 3] - node[bundles.OFFSET]).max()
    assert offset + error <= node[bundles.OFFSET_HALF] + 16 * ULP <= offset + error + 4e-6


def check_packed_edge(
    topology: Topology, tree: EdgeBundles, node: np.ndarray, bundle: int, e: int, pairs: bool
) -> None:
    packed = fields(tree.edges, bundles.N_EDGE_FIELDS, bundle, e % WIDTH) / bundles.FULL_SCALE
    centre, radius = node[bundles.CENTRE : bundles.CENTRE + 3], node[bundles.RADIUS]
    for k, field in enumerate((bundles.VERTEX_A, bundles.VERTEX_B)):
        found = centre + radius * packed[field : field + 3]
        assert np.abs(found - topology.vertices[tree.ends[e, k]]).max() <= STEP * radius + ROUNDING
    planes = packed[
        [*range(bundles.PLANE_A, bundles.PLANE_A + 4), *range(bundles.PLANE_B, bundles.PLANE_B + 4)]
    ]
    planes = planes.reshape(2, 4)
    if not pairs:
        assert planes.tolist() == [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -1.0]]
        return
    exact = oriented_planes(topology, tree.codes[2 * e : 2 * e + 2])
    assert np.abs(planes[:, :3] - exact[:, :3]).max() <= STEP
    offsets = exact[:, :3] @ centre + exact[:, 3]
    assert np.abs(radius * planes[:, 3] - offsets).max() <= STEP * radius + 16 * ULP


def test_flat_edges_are_contours_from_nowhere() -> None:
    # The twelve edges of a box, without the diagonals of its sides.
    contour, boundary, n_flat = build_edge_bundles(topology_of("box"))
    assert (len(contour.ends), len(boundary.ends), n_flat) == (12, 0, 6)
    # A sheet of two triangles keeps its outline, also if the two are wound against each other.
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    for second in ((0, 2, 3), (0, 3, 2)):
        topology = build_topology(square, np.array([(0, 1, 2), second], np.int32))[0]
        contour, boundary, n_flat = build_edge_bundles(topology)
        assert (len(contour.ends), len(boundary.ends), n_flat) == (0, 4, 1)
    # Two faces in one plane on the same side of their edge hide the same part twice: not flat, however wound.
    for second in ((0, 1, 2), (0, 2, 1)):
        topology = build_topology(square, np.array([(0, 1, 2), second], np.int32))[0]
        contour, boundary, n_flat = build_edge_bundles(topology)
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


@njit(cache=True, error_model="numpy")
def search(
    geometry, trees, points, normals, across, over, per_radian, lines, ids, sides, counts, rows, tally
):
    """What the search finds for the points of one tile: edges of each tree, and those that are contours.

    Room for few candidates only: the search has to stop, grow and go on.
    """
    tile, q = np.empty(N_TILE, np.float32), np.empty((len(points), N_POINT), np.float32)
    set_tile(points, normals, 0, len(points), tile)
    for i in range(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        t, m = (across[i, 0], across[i, 1], across[i, 2]), (over[i, 0], over[i, 1], over[i, 2])
        set_point(p, n, t, m, per_radian, tile, q[i])
    found = search_tile(new_search(1, 1024), trees, tile, q, lines, tally)
    for i in range(len(points)):
        p = points[i, 0], points[i, 1], points[i, 2]
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        n_rows = 0
        for which in range(2):
            tree = trees[which]
            first, last = found.ends[i, which], found.ends[i, which + 1]
            counts[i, which] = last - first
            ids[i, which, : last - first] = found.ids[i, first:last]
            sides[i, which, : last - first] = found.sides[i, first:last]
            n_rows = decide_contours(
                geometry.vertices,
                geometry.planes,
                geometry.plane_errors,
                tree.ends,
                tree.offsets,
                tree.codes,
                found.ids[i, first:last],
                found.sides[i, first:last],
                p,
                n,
                side_rounding(p),
                rows[i],
                n_rows,
                tally[i],
            )
        counts[i, 2] = n_rows


Trees = tuple[EdgeBundles, EdgeBundles]
Found = list[tuple[list[list[int]], dict[tuple[int, int], int], np.ndarray]]

EVERY_LINE = np.nan  # lines so close that nothing lies between them: no comparison drops


def searched(
    topology: Topology, trees: Trees, points: np.ndarray, normals: np.ndarray, family: str, n_lines: float
) -> Found:
    """For each point of a tile: edges of both trees, contours among them (ends: jump), and the tally."""
    n, n_edges = len(points), len(edges_of(topology).ends)
    across, over = np.empty((n, 3)), np.empty((n, 3))
    if family == "radial":
        lines, per_radian = line_table(int(n_lines)).astype(np.float32), n_lines / (2 * np.pi)
        for i in range(n):
            frame = np.empty((3, 3))
            set_frame(normals[i], frame)
            across[i], over[i] = frame[0], frame[1]
    else:
        lines, per_radian = np.empty((0, 2), np.float32), 0.5 * n_lines
        for i in range(n):
            across[i], over[i] = _axes.py_func(start_corner(tuple(normals[i].tolist())))
    ids, sides = np.empty((n, 2, n_edges), np.int32), np.empty((n, 2, n_edges), np.int32)
    counts, rows = np.zeros((n, 3), np.int64), np.empty((n, n_edges, 3), np.int32)
    tally = np.zeros((n, N_TALLY), np.int64)
    search(topology, trees, points, normals, across, over, per_radian, lines, ids, sides, counts, rows, tally)
    result = []
    for i in range(n):
        edges = [ids[i, which, : counts[i, which]].tolist() for which in range(2)]
        assert all(len(set(e)) == len(e) for e in edges)
        contours = {(a, b): jump for a, b, jump in rows[i, : counts[i, 2]].tolist()}
        assert len(contours) == counts[i, 2]
        result.append((edges, contours, tally[i]))
    return result


def tiles(n: int, sizes: tuple[int, ...] = (1, 5, TILE)) -> list[slice]:
    """Points in tiles of some sizes, over and over: alone in a tile, and with many that are anywhere."""
    found, first = [], 0
    while first < n:
        size = sizes[len(found) % len(sizes)]
        found.append(slice(first, min(first + size, n)))
        first += size
    return found


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
    trees = build_edge_bundles(topology)[:2]
    points, normals = shade_points(topology, n_points, seed)
    n_contours = n_tested = n_compared = 0
    for tile in tiles(n_points):
        result = searched(topology, trees, points[tile], normals[tile], "octahedral", EVERY_LINE)
        for p, n, (_, found, tally) in zip(points[tile], normals[tile], result, strict=True):
            n_tested += int(tally[EDGES])
            n_contours += len(found)
            assert tally[NODES] > 0
            if is_decided(topology, p):
                assert found == every_edge_tested(topology, p, n)
                n_compared += 1
    assert n_compared >= n_points // 2
    return n_contours, n_tested


@pytest.mark.parametrize("name", SCENES)
def test_contours_are_those_of_testing_every_edge(name: str) -> None:
    n_contours, _ = check_contours(topology_of(name), 16)
    assert n_contours > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clutter_9k", "teapot", "room", "fence", "city"])
def test_contours_of_scenes(name: str) -> None:
    check_contours(topology_of(name), 60)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("n_lines", [4, 8, 34])
@pytest.mark.parametrize("family", ["octahedral", "radial"])
def test_edges_between_isolines_cross_nothing_that_is_swept(family: str, name: str, n_lines: int) -> None:
    """Skipping what lies between two isolines loses contours only that leave no trace."""
    topology = topology_of(name)
    trees = build_edge_bundles(topology)[:2]
    numbers = [{tuple(ends): e for e, ends in enumerate(tree.ends.tolist())} for tree in trees]
    points, normals = shade_points(topology, 12, 7)
    n_lost = 0
    for tile in tiles(12):
        every = searched(topology, trees, points[tile], normals[tile], "octahedral", EVERY_LINE)
        some = searched(topology, trees, points[tile], normals[tile], family, n_lines)
        for p, n, (_, all_contours, _), (edges, contours, _) in zip(
            points[tile], normals[tile], every, some, strict=True
        ):
            assert contours.items() <= all_contours.items()
            lost = {ends: jump for ends, jump in all_contours.items() if ends not in contours}
            n_lost += len(lost)
            if family == "octahedral":
                rows = np.array([(*ends, jump) for ends, jump in lost.items()], np.int32).reshape(-1, 3)
                assert not crossed(topology, rows, p, n, n_lines).any()
                continue
            for which in range(2):
                ids = [numbers[which][ends] for ends in lost if ends in numbers[which]]
                assert not set(ids) & set(edges[which])
                assert crossed_radially(topology, trees[which], ids, p, n, n_lines) == 0
    # At few lines there are many edges between two.
    assert n_lost > 0 or n_lines > 8 or len(edges_of(topology).ends) < 16 * WIDTH


@njit(cache=True, error_model="numpy")
def cross_radially(geometry, tree, ids, p, n, frame, lines, horizon, count, key, gain, tally):
    lanes, spans = np.empty(N_LANE_FIELDS * WIDTH), np.empty(N_SPAN_FIELDS * WIDTH, np.int32)
    sides = np.zeros(len(ids), np.int32)  # to be decided
    return cross_radial_lines(
        geometry.vertices,
        geometry.planes,
        geometry.plane_errors,
        tree.ends,
        tree.offsets,
        tree.codes,
        ids,
        sides,
        0,
        len(ids),
        p,
        n,
        frame,
        lines,
        horizon,
        None,
        side_rounding(p),
        lanes,
        spans,
        count,
        key,
        gain,
        len(key) // len(lines),
        tally,
    )


def crossed_radially(
    topology: Topology, tree: EdgeBundles, ids: list[int], p: np.ndarray, n: np.ndarray, n_lines: int
) -> int:
    """How many crossings of radial lines above the horizon some edges have."""
    lines, frame = line_table(n_lines), np.empty((3, 3))
    set_frame(n, frame)
    count, tally = np.zeros(n_lines, np.int32), np.zeros(N_TALLY, np.int64)
    key, gain = np.empty(n_lines * (len(ids) + 1)), np.empty(n_lines * (len(ids) + 1), np.int32)
    fits = cross_radially(
        topology,
        tree,
        np.array(ids, np.int32),
        tuple(p.tolist()),
        tuple(n.tolist()),
        frame,
        lines,
        np.ascontiguousarray(normal_table(lines)[:, 1]),
        count,
        key,
        gain,
        tally,
    )
    assert fits
    return int(count.sum())


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
    """At this size the trees are shallow, and points at random share little."""
    topology = topology_of("clutter")
    trees = build_edge_bundles(topology)[:2]
    points, normals = shade_points(topology, 16, 2)
    n_tested = n_contours = 0
    for i in range(16):
        tile = slice(i, i + 1)
        ((_, contours, tally),) = searched(
            topology, trees, points[tile], normals[tile], "octahedral", EVERY_LINE
        )
        n_tested += int(tally[EDGES])
        n_contours += len(contours)
    assert n_contours < n_tested < 0.75 * 16 * len(edges_of(topology).ends)
