"""The oracle for half-planes, where its answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import polyhedra
from scenes.mesh import moved
from silint.reference.half_planes import count_along, difference, visible_ranges

UP = np.array([0.0, 0.0, 1.0])


def turned(*phi: float) -> np.ndarray:
    return np.array([(np.cos(p), np.sin(p), 0.0) for p in phi])


def corners(mesh: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return mesh[0][mesh[1]]


def test_nothing_hides_nothing() -> None:
    (ranges,) = visible_ranges(np.zeros((0, 3, 3)), np.zeros(3), UP, UP, turned(0.3))
    np.testing.assert_allclose(ranges, [[0.0, np.pi / 2]], atol=1e-15)
    # The horizon of a tilted normal lies lower towards it, and higher behind.
    tilted = np.array([np.sin(0.2), 0.0, np.cos(0.2)])
    front, back = visible_ranges(np.zeros((0, 3, 3)), np.zeros(3), tilted, UP, turned(0.0, np.pi))
    np.testing.assert_allclose([front[0, 1], back[0, 1]], [np.pi / 2 + 0.2, np.pi / 2 - 0.2])


def test_a_wall_hides_up_to_its_top() -> None:
    wall = np.array([[(2, -50, 0), (2, 50, 0), (2, 50, 3)], [(2, -50, 0), (2, 50, 3), (2, -50, 3)]], float)
    for phi in (0.0, 0.4, -1.1):
        (ranges,) = visible_ranges(wall, np.zeros(3), UP, UP, turned(phi))
        np.testing.assert_allclose(ranges, [[0.0, np.arctan2(2 / np.cos(phi), 3)]], atol=1e-14)
    (behind,) = visible_ranges(wall, np.zeros(3), UP, UP, turned(np.pi))
    np.testing.assert_allclose(behind, [[0.0, np.pi / 2]])


def test_a_ceiling_hides_the_zenith_and_a_floor_the_nadir() -> None:
    ceiling = np.array([[(-1, -1, 1), (3, -1, 1), (-1, 3, 1)]], float)
    (ranges,) = visible_ranges(ceiling, np.zeros(3), UP, UP, turned(np.pi))
    np.testing.assert_allclose(ranges, [[np.pi / 4, np.pi / 2]])
    assert count_along(ceiling, np.zeros(3), UP) == 1
    floor = ceiling * [1, 1, -1]
    tilted = np.array([np.sin(-1.4), 0.0, np.cos(1.4)])  # looks down to the west
    (ranges,) = visible_ranges(floor, np.zeros(3), tilted, UP, turned(np.pi))
    np.testing.assert_allclose(ranges, [[0.0, 3 * np.pi / 4]])
    assert count_along(floor, np.zeros(3), UP) == 0


@pytest.mark.parametrize("mesh", [polyhedra.icosphere(1), polyhedra.box(), polyhedra.torus()])
def test_a_closed_surface_shows_nothing_between_its_faces(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    rng = np.random.default_rng(0)
    inside = np.array([1.0, 0.05, 0.02]) if len(mesh[1]) > 200 else np.array([0.05, 0.1, 0.02])
    for n in rng.normal(size=(10, 3)):
        n /= np.linalg.norm(n)
        t = np.cross(n, [0.3, 0.5, 0.8])
        t /= np.linalg.norm(t)
        for ranges in visible_ranges(corners(mesh), inside, n, n, np.stack([t, -t, np.cross(n, t)])):
            assert np.diff(ranges).sum() < 1e-12
        assert count_along(corners(mesh), inside, n) % 2 == 1


def test_a_ball_hides_its_angle() -> None:
    ball = corners(moved(polyhedra.icosphere(4), (0.0, 0.0, 3.0)))
    for ranges in visible_ranges(ball, np.zeros(3), UP, UP, turned(*np.arange(8.0))):
        assert ranges[0, 0] == pytest.approx(np.arcsin(1 / 3), abs=1e-3)
        assert len(ranges) == 1


def test_difference_measures_both_ways() -> None:
    a, b = np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([[0.5, 1.0], [2.0, 3.25]])
    assert difference(a, b) == difference(b, a) == 0.75
    assert difference(a, a) == 0.0
    assert difference(a, np.empty((0, 2))) == 2.0
    assert difference(np.empty((0, 2)), np.empty((0, 2))) == 0.0
