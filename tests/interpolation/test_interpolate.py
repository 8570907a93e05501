"""Interpolation between computed points, on functions that are known everywhere."""

from __future__ import annotations

import numpy as np
import pytest

import silint
from silint.interpolation import face_surfaces, interpolate, smooth_surfaces
from silint.validation import InputError

Z = np.array([0.0, 0.0, 1.0])


def plane(n=60, height=0.0, normal=Z):
    """n x n points of the unit square, and triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    points = np.stack([x.ravel(), y.ravel(), np.full(n * n, height)], axis=1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)])
    return points, np.broadcast_to(normal, points.shape), faces


def ball(n=16000):
    """Fibonacci points on the unit sphere, which are their own normals."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (1.0 + 5.0**0.5) * np.arange(n)
    r = np.sqrt(1.0 - z * z)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return points, points


class Counted:
    """A query that keeps what it was asked."""

    def __init__(self, function):
        self.function, self.asked = function, []

    def __call__(self, points, normals):
        self.asked.append(points)
        return self.function(points, normals)

    @property
    def n(self):
        return sum(len(points) for points in self.asked)


def wave(points, normals):
    return np.sin(3.0 * points[:, 0]) * np.cos(2.0 * points[:, 1]) + 0.3 * points[:, 2]


@pytest.mark.parametrize("points, normals", [plane()[:2], ball()], ids=["plane", "ball"])
@pytest.mark.parametrize("tolerance, most", [(0.03, 0.06), (0.01, 0.12)])
def test_smooth_functions_take_few_points(points, normals, tolerance, most):
    query = Counted(wave)
    found = interpolate(query, points, normals, tolerance)
    truth = wave(points, normals)
    assert found.computed.sum() == query.n == found.diagnostics["computed"] < most * len(points)
    assert np.array_equal(found.value[found.computed], truth[found.computed])
    assert 0.0 < found.held_back_error <= 0.5 * tolerance
    # Held-back points are as far from anchors as any, so that others are rarely much worse.
    assert np.abs(found.value - truth).max() < 1.5 * tolerance


def test_quadratic_functions_are_reproduced():
    points, normals, faces = plane()

    def query(p, n):
        return 0.2 + p[:, 0] - 0.5 * p[:, 1] + p[:, 0] * p[:, 1] - p[:, 1] ** 2

    found = interpolate(query, points, normals, 1e-3, faces=faces)
    # The ridge moves coefficients by some 1e-7 of their size; corners multiply it by at most 5.
    assert np.abs(found.value - query(points, normals)).max() < 1e-6
    # No more than at first: an anchor and a held-back point for each cluster of 29 to 57 points.
    assert found.diagnostics["rounds"] == 1
    assert found.diagnostics["computed"] <= 2 * found.diagnostics["held_back"] == 128


def test_steps_are_computed():
    points, normals, faces = plane(80)

    def query(p, n):
        return np.where(p[:, 0] + 0.3 * p[:, 1] < 0.6, 0.2, 0.9)

    found = interpolate(query, points, normals, 0.01, faces=faces)
    off = np.abs(found.value - query(points, normals)) > 0.01
    # Chance may leave a point beside the step to those on its wrong side; here there is none.
    assert not off.any()
    near = np.abs(points[:, 0] + 0.3 * points[:, 1] - 0.6) < 0.5 / 79
    assert found.computed[near].all() and found.computed.mean() < 0.5


@pytest.mark.parametrize("height", [0.01, 0.3])
def test_thin_walls_and_stacked_sheets_are_apart(height):
    below, _, faces = plane(40, 0.0)
    above = plane(40, height)[0]
    points = np.concatenate([below, above])
    both = np.concatenate([faces, faces + len(below)])

    def query(p, n):
        return np.where(p[:, 2] < 0.5 * height, 0.1, 0.8)

    # The two sides of a wall, told apart by their normals alone.
    normals = np.concatenate([np.broadcast_to(-Z, below.shape), np.broadcast_to(Z, above.shape)])
    found = interpolate(query, points, normals, 0.01)
    assert np.abs(found.value - query(points, normals)).max() < 1e-12
    assert found.diagnostics["rounds"] == 1
    # Two sheets that look the same way, told apart by their faces, or by numbers.
    normals = np.broadcast_to(Z, points.shape)
    sheet = np.repeat([7, 3], len(below))
    for how in ({"faces": both}, {"surfaces": sheet}):
        found = interpolate(query, points, normals, 0.01, **how)
        assert np.abs(found.value - query(points, normals)).max() < 1e-12
        assert found.diagnostics["rounds"] == 1


def test_creases_are_not_crossed():
    # A ridge of two slopes: one mesh, two normals along the ridge.
    points, _, faces = plane(40)
    left = points.copy()
    right = points + (1.0, 0.0, 0.0)
    left[:, 2], right[:, 2] = left[:, 0], 2.0 - right[:, 0]
    normals = np.repeat([(-1.0, 0.0, 1.0), (1.0, 0.0, 1.0)], len(points), axis=0) / np.sqrt(2.0)
    p = np.concatenate([left, right])
    surface = smooth_surfaces(p, normals, np.concatenate([faces, faces + len(points)]))
    assert len(np.unique(surface)) == 2

    def query(q, n):
        return np.where(n[:, 0] < 0.0, 0.4, 0.6) + 0.1 * q[:, 1]

    found = interpolate(query, p, normals, 0.01, surfaces=surface)
    assert np.abs(found.value - query(p, normals)).max() < 1e-6  # the ridge of the fit
    assert found.diagnostics["rounds"] == 1


def test_smooth_surfaces_join_seams_and_end_at_creases():
    square = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    points = np.concatenate([square, square + (1.0, 0, 0)])
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]

    def number(turned):
        normals = np.broadcast_to(Z, points.shape).copy()
        normals[4:] = (np.sin(turned), 0.0, np.cos(turned))
        return len(np.unique(smooth_surfaces(points, normals, faces)))

    assert number(0.0) == number(np.radians(0.9)) == 1
    assert number(np.radians(1.1)) == 2
    # Along an edge normals may turn by 30 degrees.
    normals = np.array([Z, Z, Z, (np.sin(0.5), 0.0, np.cos(0.5))])
    assert smooth_surfaces(square, normals, [[0, 1, 2], [0, 2, 3]]).max() == 0
    normals[3] = (np.sin(0.6), 0.0, np.cos(0.6))
    assert smooth_surfaces(square, normals, [[0, 1, 2], [0, 2, 3]]).max() == 1


def test_face_surfaces_end_where_normals_of_corners_differ():
    faces = np.array([[0, 1, 2], [2, 1, 3], [4, 5, 6]])
    normals = np.broadcast_to(Z, (3, 3, 3)).copy()
    assert face_surfaces(faces, normals).tolist() == [0, 0, 1]
    normals[1, 0] = (1.0, 0.0, 0.0)  # one end of the shared edge
    assert face_surfaces(faces, normals).tolist() == [0, 1, 2]


@pytest.mark.parametrize("components", [(), (3,)])
def test_order_of_the_points_and_threads_change_nothing(components):
    numba = pytest.importorskip("numba")
    rng = np.random.default_rng(3)
    points, normals = ball(4000)
    points = np.round(points, 2)  # many ties
    surface = np.where(points[:, 2] > 0.2, 5, 2)

    def query(p, n):
        value = np.sin(2.0 * p[:, 0]) + np.abs(p[:, 1])
        return value if not components else np.stack([value, -value, 0.5 * p[:, 2]], axis=1)

    first = interpolate(query, points, normals, 0.05, surfaces=surface)
    assert first.value.shape == (4000, *components) and 0 < first.computed.sum() < 3000
    for _ in range(3):
        order = rng.permutation(len(points))
        again = interpolate(query, points[order], normals[order], 0.05, surfaces=surface[order])
        assert np.array_equal(again.value, first.value[order])
        assert np.array_equal(again.computed, first.computed[order])
        assert again.diagnostics == first.diagnostics and again.held_back_error == first.held_back_error
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert np.array_equal(interpolate(query, points, normals, 0.05, surfaces=surface).value, first.value)
    finally:
        numba.set_num_threads(threads)


def rough(points, normals):
    return np.sin(1e4 * points[:, 0]) * np.sin(3e4 * points[:, 1])


@pytest.mark.parametrize(
    "function, cost, spares",
    [(wave, 1.0, True), (wave, 1e-9, False), (rough, 1.0, False), (rough, 1e-9, False)],
    ids=["smooth and dear", "smooth and cheap", "rough and dear", "rough and cheap"],
)
@pytest.mark.parametrize("points, normals", [plane()[:2], ball()], ids=["plane", "ball"])
def test_where_it_does_not_pay_all_points_are_computed(points, normals, function, cost, spares):
    query, told = Counted(function), []
    found = interpolate(
        query, points, normals, 0.03, cost=lambda: cost, progress=lambda *done: told.append(done)
    )
    # Every point once, whatever is decided.
    assert query.n == found.computed.sum() == found.diagnostics["computed"]
    assert told[-1] == (len(points),) * 2 and told == sorted(told)
    truth = function(points, normals)
    assert np.array_equal(found.value[found.computed], truth[found.computed])
    if spares:
        assert found.computed.mean() < 0.2 and np.abs(found.value - truth).max() < 0.045
        assert found.diagnostics["rounds"] > 0
    else:
        assert found.computed.all() and found.held_back_error == 0.0 and found.diagnostics["rounds"] == 0


def test_few_points_are_computed_whatever_they_cost():
    points, normals, _ = plane(22)
    assert interpolate(wave, points, normals, 0.03, cost=lambda: 1.0).computed.all()


def test_cost_is_asked_for_when_some_are_computed_and_order_does_not_matter():
    points, normals = ball(4000)
    surface = np.where(points[:, 2] > 0.2, 5, 2)
    query = Counted(wave)

    def cost():
        assert 100 < query.n < 400
        return 1.0

    first = interpolate(query, points, normals, 0.03, surfaces=surface, cost=cost)
    order = np.random.default_rng(1).permutation(len(points))
    again = interpolate(wave, points[order], normals[order], 0.03, surfaces=surface[order], cost=lambda: 1.0)
    assert np.array_equal(again.value, first.value[order]) and 0 < first.computed.sum() < 2000
    assert again.diagnostics == first.diagnostics


def test_the_worst_component_counts():
    points, normals, _ = plane()

    def query(p, n):
        return np.stack([np.zeros(len(p)), wave(p, n), np.ones(len(p))], axis=1)

    found = interpolate(query, points, normals, 0.01)
    assert np.abs(found.value - query(points, normals)).max() < 0.015
    assert found.diagnostics["computed"] == interpolate(wave, points, normals, 0.01).diagnostics["computed"]


def test_points_that_repeat_are_computed_once():
    points, normals, _ = plane(20)
    query = Counted(wave)
    found = interpolate(query, np.repeat(points, 3, axis=0), np.repeat(normals, 3, axis=0), 1e-9)
    assert np.array_equal(found.value, np.repeat(wave(points, normals), 3))
    assert query.n == found.diagnostics["distinct"] == 400 and found.computed.all()
    assert found.held_back_error == 0.0  # nothing was predicted


def test_predictions_stay_within_bounds():
    points, normals, _ = plane()

    def query(p, n):
        return np.minimum(1.0, 1.3 - 0.6 * p[:, 0] + 0.1 * np.sin(6 * p[:, 1]))

    assert interpolate(query, points, normals, 0.05).value.max() > 1.0
    assert interpolate(query, points, normals, 0.05, bounds=(0.0, 1.0)).value.max() == 1.0


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_few_points(n):
    points, normals = ball(100)
    found = interpolate(wave, points[:n], normals[:n], 0.1)
    assert found.value.shape == found.computed.shape == (n,)
    assert np.array_equal(found.value[found.computed], wave(points[:n], normals[:n])[found.computed])


def test_progress_ends_at_the_number_of_points():
    points, normals, _ = plane(30)
    told = []
    interpolate(wave, points, normals, 0.001, progress=lambda done, n: told.append((done, n)))
    assert told[-1] == (900, 900) and [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"tolerance": 0.0}, "tolerance is 0.0; expected"),
        ({"tolerance": -1}, "tolerance is -1; expected"),
        ({"tolerance": np.nan}, "tolerance is nan; expected"),
        ({"tolerance": "fine"}, "tolerance is 'fine'; expected"),
        ({"normals": np.zeros((9, 3))}, "normals must not be zero"),
        ({"points": np.full((9, 3), np.nan)}, "points"),
        ({"faces": [[0, 1]]}, r"faces has shape \(1, 2\); expected"),
        ({"faces": [[0, 1, 9]]}, "faces has values outside 0..8"),
        ({"surfaces": [0, 1]}, "surfaces is int64 of shape"),
        ({"surfaces": np.zeros(9, int), "faces": [[0, 1, 2]]}, "faces and surfaces given"),
        ({"query": lambda p, n: np.zeros((len(p) + 1, 2))}, "query returned shape"),
        ({"query": lambda p, n: 1.0}, "query returned shape"),
    ],
)
def test_bad_input_is_told_in_one_line(options, message):
    points, normals, _ = plane(3)
    request = {"query": wave, "points": points, "normals": normals, "tolerance": 0.1, **options}
    with pytest.raises(InputError, match=message) as error:
        interpolate(**request)
    assert "\n" not in str(error.value)


def test_real_occlusion_below_a_ball():
    import trimesh

    points, normals, faces = plane(64)
    above = trimesh.creation.icosphere(2, 0.2)
    vertices = np.concatenate([points, above.vertices + (0.4, 0.5, 0.25)])
    integrator = silint.SilhouetteIntegrator(
        silint.Scene(vertices, np.concatenate([faces, above.faces + len(points)]))
    )
    tolerance = 0.01
    truth = integrator.ambient_occlusion(points, normals)
    found = interpolate(integrator.ambient_occlusion, points, normals, tolerance, faces=faces)
    assert np.array_equal(found.value[found.computed], truth[found.computed])
    assert found.held_back_error <= tolerance and found.computed.mean() < 0.3
    assert np.abs(found.value - truth).max() < 2.0 * tolerance
    bent = interpolate(integrator.bent_normals, points, normals, tolerance, faces=faces)
    assert np.abs(bent.value - integrator.bent_normals(points, normals)).max() < 2.0 * tolerance
