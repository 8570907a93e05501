"""Filters of what lies within a distance: against every edge and every face, one by one, in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from scenes.clutter import clutter
from silint.core import filters, search
from silint.core.contour import N_TALLY
from silint.core.face_bundles import FaceBundles, build_face_bundles
from silint.core.face_view import N_SEEN, N_VIEW, set_view
from silint.core.lanes import WIDTH
from silint.core.radial import set_frame
from silint.core.sphere_search import find_faces, gather_faces, new_face_search, walk_faces
from silint.core.topology import Topology, build_topology

LINES = 16

_U, _V = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 1, 17))
BARYCENTRIC = np.stack([1 - _U - _V, _U, _V], axis=-1)[_U + _V <= 1]


@njit(cache=True, error_model="numpy")
def faces_on_spheres(faces, points, normals, frames, reach, walked, ids, counts, tally):
    """What is found for the points of one tile. Room for few candidates only: it has to grow."""
    n = len(points)
    tile, q = np.empty(search.N_TILE, np.float32), np.empty((n, search.N_POINT), np.float32)
    search.set_tile(points, normals, 0, n, tile, reach.max())
    found = gather_faces(new_face_search(1, len(faces.levels)), faces, tile, reach, tally[0])
    view, stack = np.empty(N_VIEW, np.float32), np.empty((WIDTH * len(faces.levels), 2), np.int64)
    squares = np.concatenate((reach, reach)).astype(np.float32) ** 2
    boxes, lines = np.empty(N_SEEN * WIDTH, np.float32), np.empty(2 * WIDTH, np.int32)
    seen, spans = np.empty(2 * WIDTH, np.float32), np.empty(2 * WIDTH, np.int32)
    for i in range(n):
        p, normal = (points[i, 0], points[i, 1], points[i, 2]), (normals[i, 0], normals[i, 1], normals[i, 2])
        t = frames[i, 0, 0], frames[i, 0, 1], frames[i, 0, 2]
        m = frames[i, 1, 0], frames[i, 1, 1], frames[i, 1, 2]
        search.set_point(p, normal, t, m, len(reach) / (2 * np.pi), tile, q[i], reach.max())
        if walked:
            set_view(p, normal, frames[i], len(reach), view)
            few = ids[i, : len(ids[i]) // 2]  # what does not fit is counted
            counts[i] = walk_faces(
                faces, p, q[i], view, squares, stack, boxes, lines, seen, spans, few, tally[i]
            )
            if counts[i] > len(few):
                walk_faces(faces, p, q[i], view, squares, stack, boxes, lines, seen, spans, ids[i], tally[i])
        else:
            counts[i] = find_faces(found, q[i], reach, seen, spans, tally[i])
            ids[i, : counts[i]] = found.found[: counts[i]]


@njit(cache=True, error_model="numpy")
def call_near_mask(nodes, block, tile):
    return filters.near_mask(nodes, block[0], tile)


@njit(cache=True, error_model="numpy")
def call_near_edge_mask(edges, box):
    return filters.near_edge_mask(edges, 0, box[0], box[1], box[2], box[3], box[4], box[5], box[6])


@njit(cache=True, error_model="numpy")
def call_near_packet_mask(packets, block, q):
    return filters.near_packet_mask(packets, block[0], q)


def scene(name: str) -> tuple[Topology, FaceBundles]:
    if name == "clutter":
        vertices, faces = clutter(2, 1)
    else:
        rng = np.random.default_rng(3)
        vertices, faces = rng.uniform(-1, 1, (900, 3)), np.arange(900).reshape(-1, 3)
    topology = build_topology(np.asarray(vertices, np.float64) / np.abs(vertices).max(), faces)[0]
    return topology, build_face_bundles(topology)


def sectors(t: np.ndarray, m: np.ndarray) -> np.ndarray:
    return np.floor(np.arctan2(m, t) % (2 * np.pi) * LINES / (2 * np.pi) + 0.5).astype(int) % LINES


def wanted(
    topology: Topology, p: np.ndarray, n: np.ndarray, frame: np.ndarray, reach: np.ndarray, boxes: bool
) -> set[int]:
    """Faces with a corner above the horizon, that meet the sphere of a line between two of their corners.

    Or, with `boxes`, those whose boxes come near: all that the filter can know.
    """
    corners = topology.vertices[topology.faces] - p
    if boxes:
        gap = np.maximum(np.maximum(corners.min(axis=1), -corners.max(axis=1)), 0.0)
        near = np.linalg.norm(gap, axis=1)
    else:
        near = np.linalg.norm(BARYCENTRIC @ corners, axis=2).min(axis=1)  # of many points of each face
    far = np.linalg.norm(corners, axis=2).max(axis=1)
    above = (corners @ n).max(axis=1) > 0
    s = sectors(corners @ frame[0], corners @ frame[1])
    found = set()
    for f in np.flatnonzero(above & (near < reach.max()) & (far > reach.min())):
        # Where its corners leave the widest gap, the face is not, unless it lies about the axis.
        turns = np.sort(s[f])
        gaps = np.diff(turns, append=turns[0] + LINES)
        i = int(gaps.argmax())
        n_lines = LINES - gaps[i] if 2 * gaps[i] > LINES else LINES
        lines = (turns[(i + 1) % 3] + np.arange(n_lines)) % LINES
        r = reach[lines]
        if ((near[f] < r) & (far[f] > r)).any():
            found.add(int(f))
    return found


@pytest.mark.parametrize("name", ["clutter", "soup"])
@pytest.mark.parametrize("R", [0.02, 0.2, 0.7])
@pytest.mark.parametrize("falling", [False, True])
@pytest.mark.parametrize("walked", [False, True])
def test_every_face_on_a_sphere_is_found(name: str, R: float, falling: bool, walked: bool) -> None:
    topology, faces = scene(name)
    rng = np.random.default_rng(1)
    reach = R * ((0.5 + 0.618034 * np.arange(LINES)) % 1.0) if falling else np.full(LINES, R)
    n_needed = n_wanted = n_found = 0
    for size, spread in ((1, 0.0), (7, 0.01), (search.TILE, 0.3)):
        for _ in range(4):
            points = topology.vertices[rng.integers(len(topology.vertices))] + spread * rng.uniform(
                -1, 1, (size, 3)
            )
            normals = rng.normal(size=3) + spread * rng.normal(size=(size, 3))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            frames = np.empty((size, 3, 3))
            for i in range(size):
                set_frame(normals[i], frames[i])
            ids, counts = np.empty((size, len(topology.faces)), np.int32), np.zeros(size, np.int64)
            tally = np.zeros((size, N_TALLY), np.int64)
            faces_on_spheres(faces, points, normals, frames, reach, walked, ids, counts, tally)
            for i in range(size):
                found = ids[i, : counts[i]].tolist()
                assert len(set(found)) == len(found)
                given = topology, points[i], normals[i], frames[i], reach
                needed = wanted(*given, boxes=False)
                assert needed <= set(found)
                n_needed, n_wanted = n_needed + len(needed), n_wanted + len(wanted(*given, boxes=True))
                n_found += len(found)
    assert n_needed > 0
    # What is kept in vain: float32, rough azimuths, and, where lines differ, spans over the first of them.
    assert n_found < (1.6 if falling else 1.05) * n_wanted + 20


def test_what_is_near_a_tile_is_kept() -> None:
    rng = np.random.default_rng(2)
    kept_boxes = kept_edges = kept_packets = 0
    for _ in range(50):
        tile = np.zeros(search.N_TILE, np.float32)
        tile[:3], tile[3:6] = rng.uniform(-1, 1, 3), rng.uniform(0, 0.2, 3)
        R = rng.uniform(0.01, 0.6)
        tile[search.TILE_REACH] = R * R
        boxes = np.concatenate([rng.uniform(-1, 1, (3, WIDTH)), rng.uniform(0, 0.2, (3, WIDTH))])
        nodes = np.zeros((15, WIDTH), np.float32)
        nodes[:6] = boxes
        gap = np.abs(nodes[:3] - tile[:3, None]) - nodes[3:6] - tile[3:6, None]
        near = np.linalg.norm(np.maximum(gap, 0), axis=0)
        mask = call_near_mask(nodes.ravel(), np.zeros(1, np.int64), tile)
        kept = mask >> np.arange(WIDTH) & 1 == 1
        assert kept[near < R * (1 - 1e-5)].all() and not kept[near > R * (1 + 1e-5)].any()
        kept_boxes += int(kept.sum())

        edges = np.zeros((filters.N_CANDIDATE, WIDTH), np.float32)
        edges[8:14] = rng.uniform(-1, 1, (6, WIDTH))
        box = np.array([*tile[:6], R * R], np.float32)
        low, high = np.minimum(edges[8:11], edges[11:14]), np.maximum(edges[8:11], edges[11:14])
        gap = np.maximum(low - tile[:3, None], tile[:3, None] - high) - tile[3:6, None]
        near = np.linalg.norm(np.maximum(gap, 0), axis=0)
        kept = call_near_edge_mask(edges.ravel(), box) >> np.arange(WIDTH) & 1 == 1
        assert kept[near < R * (1 - 1e-5)].all() and not kept[near > R * (1 + 1e-5)].any()
        kept_edges += int(kept.sum())

        packets, q = np.zeros((filters.N_PACKET, WIDTH), np.float32), np.zeros(search.N_POINT, np.float32)
        packets[:3], packets[3] = rng.uniform(-1, 1, (3, WIDTH)), rng.uniform(0, 0.2, WIDTH)
        q[:3], q[search.P_REACH] = tile[:3], R
        near = np.linalg.norm(packets[:3] - q[:3, None], axis=0) - packets[3]
        kept = call_near_packet_mask(packets.ravel(), np.zeros(1, np.int64), q) >> np.arange(WIDTH) & 1 == 1
        assert kept[near < R * (1 - 1e-5)].all() and not kept[near > R * (1 + 1e-5)].any()
        kept_packets += int(kept.sum())
    assert min(kept_boxes, kept_edges, kept_packets) > 20
