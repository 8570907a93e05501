"""Covering and sweeping radial isolines find the same intervals, and what is open is what rays see."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate, moved
from silint.core.bundles import build_edge_bundles
from silint.core.contour import N_TALLY
from silint.core.face_bundles import BLOCK, CORNER_BLOCK, FaceBundles, build_face_bundles
from silint.core.jit import each_block
from silint.core.lanes import WIDTH
from silint.core.partition import aligned_box_order
from silint.core.radial import line_table, normal_table, set_frame
from silint.core.radial_cover import N_VIEW, box_mask, covered_radial_intervals, set_view
from silint.core.radial_sweep import TILE, radial_intervals
from silint.core.topology import Topology, build_topology

Mesh = tuple[np.ndarray, np.ndarray]
# Intervals on each line of each point, and their ends one after the other.
Found = tuple[np.ndarray, np.ndarray]
K = 16


def soup(n: int = 60, seed: int = 0) -> Mesh:
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-2, 2, size=(n, 1, 3))
    return (centres + rng.normal(scale=0.5, size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def tangle(n: int = 30, seed: int = 5) -> Mesh:
    """Any number of faces on an edge, wound anyhow."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, size=(9, 3)), np.array([rng.choice(9, 3, replace=False) for _ in range(n)])


SCENES: dict[str, Callable[[], Mesh]] = {
    "triangle": polyhedra.triangle,
    "closed room": polyhedra.closed_room,
    "fin": lambda: polyhedra.fin(5),
    "moebius strip": lambda: polyhedra.moebius_strip(12),
    "torus": polyhedra.torus,
    "soup": soup,
    "tangle": tangle,
    "clutter": lambda: clutter(2, 2),
    "leaves": lambda: foliage(1, 1),
}


def topology_of(mesh: Mesh) -> Topology:
    return build_topology(mesh[0], mesh[1].astype(np.int32))[0]


def no_faces() -> FaceBundles:
    return build_face_bundles(topology_of((np.eye(3), np.zeros((0, 3), np.int64))))


def shade_points(n: int, seed: int) -> Mesh:
    """Anywhere in the scaled scene, turned anyhow."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    return rng.uniform(-0.6, 0.6, size=(n, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def gathered(run: Callable[..., None], n: int, n_lines: int, per_block: int, capacity: int = 64) -> Found:
    """What an entry kernel finds, with buffers that grow."""
    while True:
        counts, starts = np.empty((n, n_lines), np.int32), np.empty(n, np.int64)
        n_blocks = -(-n // per_block)
        intervals, needed = np.empty((n_blocks, capacity, 2)), np.zeros(n_blocks, np.int64)
        run(per_block, counts, starts, intervals, needed, np.zeros((n, N_TALLY), np.int64))
        if needed.max() <= capacity:
            break
        capacity = int(needed.max())
    rows = [intervals[i // per_block, starts[i] : starts[i] + max(counts[i].sum(), 0)] for i in range(n)]
    return counts, np.concatenate(rows)


def tables(n_lines: int) -> tuple[np.ndarray, np.ndarray]:
    lines = line_table(n_lines)
    return lines, np.ascontiguousarray(normal_table(lines)[:, 1])


def frames(n: np.ndarray) -> np.ndarray:
    found = np.empty((len(n), 3, 3))
    for row, frame in zip(n, found, strict=True):
        set_frame(row, frame)
    return found


def cover(
    topology: Topology, faces: FaceBundles, p: np.ndarray, n: np.ndarray, n_lines: int = K, per_block: int = 8
) -> Found:
    given = topology, faces, p, n, frames(n), *tables(n_lines), None, False

    def run(*blocks: object) -> None:
        each_block(covered_radial_intervals, -(-len(p) // per_block), *given, *blocks)

    return gathered(run, len(p), n_lines, per_block)


def sweep(topology: Topology, faces: FaceBundles, p: np.ndarray, n: np.ndarray, n_lines: int = K) -> Found:
    contour, boundary, _ = build_edge_bundles(topology)
    given = topology, contour, boundary, faces, p, n, frames(n), *tables(n_lines), None

    def run(*blocks: object) -> None:
        each_block(radial_intervals, -(-len(p) // TILE), *given, *blocks)

    return gathered(run, len(p), n_lines, TILE)


def assert_equal(a: Found, b: Found) -> None:
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])


# ------------------------------------------------------------------------------------------ the sweep's


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("n_lines", [4, 64])
def test_the_same_intervals_as_the_sweep(name: str, n_lines: int) -> None:
    """To the last bit, points in general position."""
    topology = topology_of(SCENES[name]())
    faces = build_face_bundles(topology)
    p, n = shade_points(100, seed=n_lines)
    covered, swept = cover(topology, faces, p, n, n_lines), sweep(topology, faces, p, n, n_lines)
    assert (swept[0] >= 0).all()
    assert_equal(covered, swept)


def test_intervals_run_from_the_zenith_down_and_do_not_touch() -> None:
    topology = topology_of(soup())
    counts, intervals = cover(topology, build_face_bundles(topology), *shade_points(50, seed=1))
    assert counts.max() > 3
    assert (intervals[:, 0] > intervals[:, 1]).all()
    same_line = np.ones(len(intervals) + 1, bool)
    same_line[np.concatenate([[0], np.cumsum(counts)])] = False
    assert (intervals[1:, 0] < intervals[:-1, 1])[same_line[1:-1]].all()


# ------------------------------------------------------------------------------------------------ rays


def is_hit(topology: Topology, p: np.ndarray, w: np.ndarray) -> bool:
    """Whether a ray meets a face, by signs of volumes."""
    a, b, c = (topology.vertices[topology.faces[:, i]] - p for i in range(3))
    sides = np.stack([np.cross(u, v) @ w for u, v in ((a, b), (b, c), (c, a))])
    normal = np.cross(b - a, c - a)
    ahead = np.einsum("fi,fi->f", normal, a) * (normal @ w) > 0
    return bool((((sides > 0).all(axis=0) | (sides < 0).all(axis=0)) & ahead).any())


def assert_rays_agree(topology: Topology, p: np.ndarray, n: np.ndarray) -> None:
    """A ray through the middle of every interval, and one midway between intervals."""
    lines = line_table(K)
    counts, intervals = cover(topology, build_face_bundles(topology), p, n)
    frame, row = np.empty((3, 3)), 0
    for i in range(len(p)):
        set_frame(n[i], frame)
        for k in range(K):
            # Angles from the axis, from the zenith down; the last is the horizon's.
            ends = np.arctan2(1.0, intervals[row : row + counts[i, k]].ravel())
            row += counts[i, k]
            across = lines[k, 0] * frame[0] + lines[k, 1] * frame[1]
            horizon = np.arctan2(1.0, -(n[i] @ across) / (n[i] @ frame[2]))
            ends = np.concatenate([[0.0], ends, [horizon]])
            for j in range(len(ends) - 1):
                if ends[j + 1] - ends[j] > 1e-6:
                    theta = 0.5 * (ends[j] + ends[j + 1])
                    w = np.cos(theta) * frame[2] + np.sin(theta) * across
                    assert is_hit(topology, p[i], w) == (j % 2 == 0)


@pytest.mark.parametrize("name", ["fin", "soup", "tangle"])
def test_rays_see_what_is_open(name: str) -> None:
    assert_rays_agree(topology_of(SCENES[name]()), *shade_points(10, seed=3))


@pytest.mark.parametrize("turned_over", [False, True])
@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
@pytest.mark.parametrize("at_zenith", [True, False])
def test_faces_that_wind_round_the_axis(
    at_zenith: bool, order: tuple[int, int, int], turned_over: bool
) -> None:
    """At the zenith, or at the nadir and rising above the horizon on one side, however they are wound."""
    vertices = np.array(
        [[-0.5, -0.6, 0.4], [0.7, -0.2, 0.4], [-0.1, 0.9, 1.6]]
        if at_zenith
        else [[-0.5, -0.3, -1.0], [0.7, -0.2, -1.0], [-0.1, 2.0, 1.0]]
    )
    topology = topology_of((vertices, np.array([order[::-1] if turned_over else order])))
    p, n = np.array([[0.01, 0.02, 0.03]]), np.array([[0.1, 0.0, np.sqrt(0.99)]])
    counts, intervals = cover(topology, build_face_bundles(topology), p, n)
    assert (counts == 1).all()
    assert np.isinf(intervals[:, 0]).all() != at_zenith
    # At the nadir, some lines end before the horizon.
    whole = cover(topology, no_faces(), p, n)[1]
    assert at_zenith or 0 < (intervals[:, 1] > whole[:, 1]).sum() < K
    assert_rays_agree(topology, p, n)


# ----------------------------------------------------------------------------------------------- leaks


@pytest.mark.parametrize("name", ["icosphere", "torus", "convex_polyhedron", "dodecahedron"])
def test_nothing_shows_through_a_closed_mesh(name: str) -> None:
    vertices, faces = getattr(polyhedra, name)()
    topology = topology_of((vertices, faces))
    corners = topology.vertices[topology.faces]
    rng = np.random.default_rng(4)
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    f = rng.integers(len(corners), size=200)
    weights = rng.dirichlet(np.ones(3), size=200)
    p = np.einsum("ic,icx->ix", weights, corners[f]) - 5e-3 * np.ptp(topology.vertices) * outward[f]
    n = np.where(rng.random(200)[:, None] < 0.5, outward[f], -outward[f])
    counts, intervals = cover(topology, build_face_bundles(topology), p, n, n_lines=64)
    assert counts.sum() == len(intervals) == 0


# ------------------------------------------------------------------------------------ order and buffers


def test_a_point_does_not_depend_on_others() -> None:
    topology = topology_of(clutter(2, 2))
    faces = build_face_bundles(topology)
    p, n = shade_points(40, seed=6)
    together = cover(topology, faces, p, n, per_block=16)
    assert_equal(cover(topology, faces, p, n, per_block=1), together)
    alone = [cover(topology, faces, p[i : i + 1], n[i : i + 1]) for i in reversed(range(len(p)))][::-1]
    assert_equal((np.concatenate([a[0] for a in alone]), np.concatenate([a[1] for a in alone])), together)


def test_the_order_of_faces_does_not_matter() -> None:
    vertices, faces = soup()
    topology = topology_of((vertices, faces))
    shuffled = topology_of((vertices, np.random.default_rng(7).permutation(faces)))
    p, n = shade_points(40, seed=8)
    assert_equal(
        cover(topology, build_face_bundles(topology), p, n),
        cover(shuffled, build_face_bundles(shuffled), p, n),
    )


def test_lists_grow_until_everything_fits() -> None:
    """A comb of slats: more open intervals on a line than there is room for at first."""
    slats = concatenate(
        [moved(polyhedra.box((6.0, 0.002, 1e-4)), (0.0, 0.006 * i - 1.0, 1.0)) for i in range(300)]
    )
    topology = topology_of(slats)
    faces = build_face_bundles(topology)
    p = np.array([[0.0003, 0.0, 0.0], [0.1, 0.05, 0.0], [0.0, 0.02, 0.01]])
    n = np.array([[0.0, 1e-3, 1.0], [0.3, 0.0, 1.0], [0.0, -0.5, 1.0]])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    covered = cover(topology, faces, p, n)
    assert covered[0].max() > 100
    assert_equal(covered, sweep(topology, faces, p, n))


def test_nothing_hides_nothing() -> None:
    counts, intervals = cover(topology_of(soup()), no_faces(), *shade_points(2, seed=9))
    assert (counts == 1).all() and np.isinf(intervals[:, 0]).all()


# --------------------------------------------------------------------------------------------- bundles


@pytest.mark.parametrize("n", [0, 1, 16, 17, 1000])
def test_boxes_are_ordered_once_each(n: int) -> None:
    low = np.random.default_rng(n).uniform(size=(n, 3)).astype(np.float32)
    np.testing.assert_array_equal(np.sort(aligned_box_order(low, low + np.float32(0.1))), np.arange(n))


def test_small_boxes_are_kept_from_large_ones() -> None:
    """Sixteen walls among pebbles make one bundle."""
    rng = np.random.default_rng(0)
    centres = rng.uniform(size=(64, 3))
    half = np.where(np.arange(64) % 4 == 0, 1.0, 0.01)[:, None]
    order = aligned_box_order((centres - half).astype(np.float32), (centres + half).astype(np.float32))
    assert len({tuple(sorted(set(bundle % 4))) == (0,) for bundle in order.reshape(4, WIDTH)}) == 2
    assert sum((bundle % 4 == 0).all() for bundle in order.reshape(4, WIDTH)) == 1


@njit(error_model="numpy")
def seen_boxes(nodes, n_blocks, p, n, frame, n_lines, view, masks, seen, ranges):
    """box_mask for all blocks: kernels of the core cannot be called from Python."""
    set_view((p[0], p[1], p[2]), (n[0], n[1], n[2]), frame, n_lines, view)
    for block in range(n_blocks):
        masks[block] = box_mask(nodes, block, view, n_lines, seen[block], ranges[block])


@pytest.mark.parametrize("n_lines", [4, 64, 1000])
def test_boxes_bound_all_that_is_in_them(n_lines: int) -> None:
    """The filter drops what lies below the horizon or between two lines; else it bounds sectors and keys."""
    topology = topology_of(concatenate([clutter(2, 2), soup()]))
    faces = build_face_bundles(topology)
    n_bundles = len(faces.corners) // CORNER_BLOCK
    n_blocks = int(faces.levels[1])
    assert len(faces.nodes) == faces.levels[-1] * BLOCK and n_blocks == -(-n_bundles // WIDTH)
    masks = np.empty(n_blocks, np.int64)
    seen, ranges = np.empty((n_blocks, 3 * WIDTH), np.float32), np.empty((n_blocks, 2 * WIDTH), np.int32)
    frame = np.empty((3, 3))
    for p, n in zip(*shade_points(30, seed=n_lines), strict=True):
        set_frame(n, frame)
        seen_boxes(
            faces.nodes, n_blocks, p, n, frame, n_lines, np.empty(N_VIEW, np.float32), masks, seen, ranges
        )
        for bundle in range(n_bundles):
            block, lane = divmod(bundle, WIDTH)
            own = faces.order[bundle * WIDTH : (bundle + 1) * WIDTH]
            x = (topology.vertices[topology.faces[own]] - p).reshape(-1, 3)
            t, m, a = frame @ x.T
            sectors = (np.arctan2(m, t) % (2 * np.pi) * (n_lines / (2 * np.pi)) + 0.5).astype(int) % n_lines
            if not masks[block] >> lane & 1:
                assert (x @ n <= 0).all() or (sectors == sectors[0]).all()
                continue
            low, high = seen[block, WIDTH + lane], seen[block, 2 * WIDTH + lane]
            first, count = ranges[block, lane], ranges[block, WIDTH + lane]
            key = a / np.hypot(t, m)
            assert low <= key.min() and key.max() <= high
            # Sector s lies before line s.
            assert ((sectors - first) % n_lines <= count).all() or count == n_lines


def test_a_box_centred_on_the_point_is_seen_all_round() -> None:
    """Its azimuth is that of nothing: such a bundle was left out."""
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])], np.int32)
    topology = topology_of((corners + 3.0, faces))
    normals = np.stack([np.eye(3)[0], np.eye(3)[2], np.ones(3) / np.sqrt(3.0)])
    centre = np.tile(topology.vertices.mean(axis=0), (3, 1))
    counts, _ = cover(topology, build_face_bundles(topology), centre, normals)
    assert counts.sum() == 0
