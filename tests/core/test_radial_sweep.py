"""Start counts, contradictions and buffers of the radial sweep. Its intervals: tests/test_oracle.py."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numba import njit

from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate, moved
from silint import Scene, SilhouetteIntegrator
from silint.core import radial_sweep
from silint.core.along import N_AXIS, faces_along, set_axis
from silint.core.contour import side_rounding
from silint.core.radial import line_table, set_frame
from silint.core.visible import find_radial
from silint.core.zenith import zenith_count
from silint.reference import half_planes

Mesh = tuple[np.ndarray, np.ndarray]


@njit(cache=True, error_model="numpy")
def zenith_counts(geometry, faces, points, frames, normals, n_lines, w, n_found):
    stack, axis = np.empty((256, 2), np.int64), np.empty(N_AXIS, np.float32)
    face_ids = np.empty(len(faces.order), np.int32)
    for i in range(len(points)):
        p, n = (points[i, 0], points[i, 1], points[i, 2]), (normals[i, 0], normals[i, 1], normals[i, 2])
        f = frames[i]
        set_axis(
            p, (f[0, 0], f[0, 1], f[0, 2]), (f[1, 0], f[1, 1], f[1, 2]), (f[2, 0], f[2, 1], f[2, 2]), axis
        )
        n_found[i] = faces_along(faces.order, faces.coarse, faces.nodes, faces.levels, axis, stack, face_ids)
        w[i] = zenith_count(geometry, face_ids, n_found[i], p, n, f, n_lines, side_rounding(p))


@njit(error_model="numpy")
def sweep_line(keys, gains, end, w, out):
    radial_sweep._sort_line(keys, gains, 0, len(keys))
    return radial_sweep._sweep_line(keys, gains, 0, len(keys), end, w, out, 0)


def sweeping(mesh: Mesh) -> SilhouetteIntegrator:
    """An integrator that sweeps, also where covering would be cheaper."""
    integrator = SilhouetteIntegrator(Scene(*mesh))
    integrator._finder._cover = False
    return integrator


def soup() -> Mesh:
    rng = np.random.default_rng(0)
    centres = rng.uniform(-1, 1, size=(200, 1, 3))
    return (centres + rng.normal(scale=0.4, size=(200, 3, 3))).reshape(-1, 3), np.arange(600).reshape(-1, 3)


SCENES: dict[str, Callable[[], Mesh]] = {
    "room": polyhedra.closed_room,
    "balls": lambda: concatenate([moved(polyhedra.icosphere(2), (0.0, 0.0, z)) for z in (0.0, 0.4, 3.0)]),
    "moebius strip": lambda: polyhedra.moebius_strip(12),
    "fin": lambda: polyhedra.fin(5),
    "soup": soup,
    "clutter": lambda: clutter(2, 1),
    "leaves": lambda: foliage(1, 1),
    "doubled": lambda: concatenate([polyhedra.box(), polyhedra.box()]),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_start_count_is_the_number_of_faces_over_the_point(name: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*SCENES[name]()))
    topology = integrator._finder.geometry
    rng = np.random.default_rng(1)
    n_points = 150
    normals = rng.normal(size=(n_points, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = rng.uniform(-1, 1, (n_points, 3))
    # Towards the middle of some face, so that something is met.
    corners = topology.vertices[topology.faces]
    frames = np.empty((n_points, 3, 3))
    for i in range(n_points):
        set_frame(normals[i], frames[i])
    to_face = np.arange(0, n_points, 2)
    away = corners[rng.integers(0, len(corners), len(to_face))].mean(axis=1)
    points[to_face] = away - rng.uniform(0.1, 1.0, (len(to_face), 1)) * frames[to_face, 2]
    expected = [half_planes.count_along(corners, points[i], frames[i, 2]) for i in range(n_points)]
    for n_lines in (4, 64):
        w, n_found = np.empty(n_points, np.int64), np.empty(n_points, np.int64)
        zenith_counts(topology, integrator._finder.bundles.face, points, frames, normals, n_lines, w, n_found)
        np.testing.assert_array_equal(w, expected)
        assert (n_found >= w).all()
    assert 0 < np.mean(expected) and max(expected) > 0
    # Filters leave little to be decided.
    assert n_found.mean() < max(8.0, 0.2 * len(corners)) + np.mean(expected)


@pytest.mark.parametrize("name", SCENES)
def test_nothing_contradicts_itself(name: str) -> None:
    mesh = SCENES[name]()
    integrator = sweeping(mesh)
    rng = np.random.default_rng(2)
    centres, normals, valid = integrator.scene.face_centers_normals()
    some = rng.choice(np.flatnonzero(valid), 60)
    points = np.concatenate([centres[some], mesh[0][rng.integers(0, len(mesh[0]), 60)]])
    directions = np.concatenate([normals[some], rng.normal(size=(60, 3))])
    for k in (4, 30):
        told = integrator.ambient_occlusion(
            points, directions, k, method="radial", full_output=True
        ).diagnostics
        assert told["fallback_isolines"] == 0


# ------------------------------------------------------------------------------------------ single lines


def swept(keys: list[float], gains: list[int], end: float, w: int) -> tuple[list[list[float]], bool]:
    out = np.empty((len(keys) + 1, 2))
    n, sound = sweep_line(np.array(keys, float), np.array(gains, np.int32), end, w, out)
    return out[:n].tolist(), sound


def test_what_is_visible_on_a_line() -> None:
    inf = np.inf
    assert swept([], [], -0.5, 0) == ([[inf, -0.5]], True)
    assert swept([], [], -0.5, 1) == ([], True)
    # Hidden from 2 down to 1, in any order.
    assert swept([2.0, 1.0], [1, -1], 0.0, 0) == ([[inf, 2.0], [1.0, 0.0]], True)
    assert swept([1.0, 2.0], [-1, 1], 0.0, 0) == ([[inf, 2.0], [1.0, 0.0]], True)
    # The zenith is hidden, twice over; what cancels in one place splits nothing.
    assert swept([3.0, 2.0, 2.0, 1.0], [-2, 2, -2, 2], 0.0, 2) == ([[3.0, 1.0]], True)
    # Gone below 0: over a length, over rounding, and near the zenith, where keys are far apart for nothing.
    assert swept([2.0, 1.0], [-1, 1], 0.0, 0) == ([[inf, 2.0], [1.0, 0.0]], False)
    assert swept([1.0 + 1e-12, 1.0], [-1, 1], 0.0, 0)[1]
    assert swept([1e9 + 1e6, 1e9], [-1, 1], 0.0, 0)[1]
    assert not swept([1e6 + 1e5, 1e6], [-1, 1], 0.0, 0)[1]


def test_many_crossings_on_a_line_are_sorted_as_few_are() -> None:
    rng = np.random.default_rng(3)
    for n in (5, 31, 32, 33, 500):
        keys = np.sort(rng.normal(size=2 * n))
        gains = np.tile([-1, 1], n)  # rising: the lower end of each hidden part, then the upper one
        order = rng.permutation(2 * n)
        expected = np.concatenate([[np.inf], keys[::-1], [-50.0]]).reshape(-1, 2).tolist()
        assert swept(keys[order].tolist(), gains[order].tolist(), -50.0, 0) == (expected, True)


# ---------------------------------------------------------------------------------------------- buffers


def test_buffers_grow_until_everything_fits() -> None:
    """A comb of slats overhead: more crossings, faces and intervals on a line than any buffer first holds."""
    slats = concatenate(
        [moved(polyhedra.box((6.0, 0.002, 1e-4)), (0.0, 0.004 * i - 1.0, 1.0)) for i in range(500)]
    )
    stacked = concatenate(
        [slats, *(moved(polyhedra.rectangle(0.5, 0.5), (0.0, 0.0, 2.0 + 0.01 * i)) for i in range(150))]
    )
    integrator = sweeping(stacked)
    topology = integrator.scene.topology
    points = np.array([[0.0003, 0.0, 0.0], [0.5, 0.2, 0.0]])
    normals = np.array([[0.0, 1e-3, 1.0], [0.3, 0.0, 1.0]])
    p, n = integrator._finder.shade_points(points, normals)
    ((found, totals, rows),) = integrator._finder.radial(p, n, 4, None)
    assert totals["fallback_isolines"] == 0
    assert totals["crossings"] > 4 * 16 * 4 and found.counts.max() > 100
    for i, row in enumerate(rows.tolist()):
        frame = np.empty((3, 3))
        set_frame(n[row], frame)
        expected = half_planes.visible_ranges(
            topology.vertices[topology.faces], p[row], n[row], frame[2], line_table(4) @ frame[:2]
        )
        first = found.starts[i]
        for k in range(4):
            keys = found.intervals[first : first + found.counts[i, k]]
            first += found.counts[i, k]
            assert half_planes.difference(np.arctan2(1.0, keys), expected[k]) < 1e-9 * (2 + len(keys))


def test_a_finder_asks_again_with_more_room() -> None:
    """More intervals than a block of points has room for."""
    leaves = sweeping(foliage(1, 2))
    rng = np.random.default_rng(4)
    low, high = leaves.scene.vertices.min(axis=0), leaves.scene.vertices.max(axis=0)
    p, n = leaves._finder.shade_points(low + (high - low) * rng.random((40, 3)), rng.normal(size=(40, 3)))
    needed = find_radial(leaves._finder.geometry, leaves._finder.bundles, p, n, 16, 32, 8, False)
    assert isinstance(needed, int) and needed > 8
    again = find_radial(leaves._finder.geometry, leaves._finder.bundles, p, n, 16, 32, needed, False)
    assert not isinstance(again, int)
    assert needed in (again.visible.counts[:32].sum(), again.visible.counts[32:].sum())
