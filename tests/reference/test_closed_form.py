"""Closed forms against each other, against quadrature, and against the brute-force lines."""

from __future__ import annotations

import math

import numpy as np
import pytest

from silint.reference import brute_force, closed_form
from silint.reference.analytic_scenes import AnalyticScene, analytic_scenes

SCENES = analytic_scenes()
ROUNDING = 1e-12  # double precision, some tens of operations


def _unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


def _turn(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(("left", "right"), [(-1.0, 2.0), (0.0, 3.0), (0.5, 0.9), (-4.0, -1.0)])
def test_standing_rectangle_is_lamberts_polygon(left: float, right: float) -> None:
    corners = [(left, 0.7, 0), (right, 0.7, 0), (right, 0.7, 1.3), (left, 0.7, 1.3)]
    howell = closed_form.standing_rectangle(0.7, 1.3, left, right)
    np.testing.assert_allclose(howell, closed_form.polygon(corners, np.zeros(3), UP), atol=ROUNDING)


def test_infinite_wall_is_the_limit_of_long_ones() -> None:
    wide = closed_form.standing_rectangle(0.7, 1.3, -1e7, 1e7)
    # What is missing at the ends subtends an angle of order 1e-7, and its share has one more factor of it.
    np.testing.assert_allclose(wide, closed_form.infinite_wall(0.7, 1.3), atol=1e-6)
    assert closed_form.infinite_wall(1.0, 1.0).uniform == pytest.approx(0.25)
    assert closed_form.infinite_wall(1.0, 1e9).cosine == pytest.approx(0.5)


@pytest.mark.parametrize("sides", [(-1, 2, -3, 1), (0.5, 2, 1, 3), (-2, -1, -1, 4)])
def test_parallel_rectangle_is_lamberts_polygon(sides: tuple[float, float, float, float]) -> None:
    x0, x1, y0, y1 = sides
    corners = [(x0, y0, 0.8), (x1, y0, 0.8), (x1, y1, 0.8), (x0, y1, 0.8)]
    howell = closed_form.parallel_rectangle(0.8, *sides)
    np.testing.assert_allclose(howell, closed_form.polygon(corners, np.zeros(3), UP), atol=ROUNDING)


@pytest.mark.parametrize("offset", [0.0, 0.3, 0.999, 1.001, 2.5])
def test_disc_is_the_limit_of_polygons(offset: float) -> None:
    t = 2 * np.pi * np.arange(2000) / 2000
    inner = np.column_stack([np.cos(t), np.sin(t), np.full_like(t, 0.6)])
    outer = inner / [math.cos(math.pi / 2000), math.cos(math.pi / 2000), 1]
    low = closed_form.polygon(inner + np.array([offset, 0, 0]), np.zeros(3), UP)
    high = closed_form.polygon(outer + np.array([offset, 0, 0]), np.zeros(3), UP)
    disc = closed_form.parallel_disc(0.6, 1.0, offset)
    for below, value, above in zip(low, disc, high, strict=True):
        assert below < value < above
        assert above - below < 5e-6


def test_polygon_fills_the_hemisphere_and_adds_up() -> None:
    huge = np.array([(-1, -1, 1e-9), (1, -1, 1e-9), (1, 1, 1e-9), (-1, 1, 1e-9)])
    np.testing.assert_allclose(closed_form.polygon(huge, np.zeros(3), UP), (1, 1), atol=1e-8)
    concave = np.array([(0, 0, 1), (2, 0, 1), (2, 2, 1), (1, 0.5, 1)]) + np.array([-0.7, 0.1, 0])
    # Cut at its reflex corner.
    parts = [closed_form.polygon(concave[list(i)], np.zeros(3), UP) for i in ((0, 1, 3), (1, 2, 3))]
    np.testing.assert_allclose(
        closed_form.polygon(concave, np.zeros(3), UP), parts[0] + parts[1], atol=ROUNDING
    )
    flipped = closed_form.polygon(concave[::-1], np.zeros(3), UP)
    np.testing.assert_allclose(closed_form.polygon(concave, np.zeros(3), UP), flipped, atol=ROUNDING)


def test_polygon_clips_at_the_horizon() -> None:
    corners = np.array([(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)])
    # By symmetry, clipping a wall that reaches as far down as up leaves the standing wall.
    standing = closed_form.standing_rectangle(1.0, 1.0, -1.0, 1.0)
    np.testing.assert_allclose(closed_form.polygon(corners, np.zeros(3), UP), standing, atol=ROUNDING)
    assert closed_form.polygon(corners - [0, 0, 1], np.zeros(3), UP) == (0, 0)


def _sphere_by_quadrature(alpha: float, theta: float) -> tuple[float, float]:
    """Midpoints over the cap's angle from its axis, exact arcs above the horizon in azimuth."""
    n = 200_000
    gamma = alpha * (np.arange(n) + 0.5) / n
    limit = -np.cos(gamma) * np.cos(theta) / (np.sin(gamma) * np.sin(theta))
    psi = np.arccos(np.clip(limit, -1, 1))
    height = 2 * (psi * np.cos(gamma) * np.cos(theta) + np.sin(psi) * np.sin(gamma) * np.sin(theta))
    scale = alpha / n * np.sin(gamma)
    return float((scale * height).sum() / np.pi), float((scale * 2 * psi).sum() / (2 * np.pi))


@pytest.mark.parametrize("theta", [0.2, 1.0, 1.2, 1.5, math.pi / 2, 1.8, 2.1])
def test_sphere_is_its_cap(theta: float) -> None:
    alpha = 0.6
    center = 3.0 * np.array([math.sin(theta), 0, math.cos(theta)])
    found = closed_form.sphere(center, 3.0 * math.sin(alpha), np.zeros(3), UP)
    # At the kink where arcs begin to be cut, the midpoint rule errs by n^-3/2 = 1e-8.
    np.testing.assert_allclose(found, _sphere_by_quadrature(alpha, theta), atol=1e-7)


def test_sphere_is_continuous_where_the_horizon_touches_it() -> None:
    for theta in (math.pi / 2 - 0.6, math.pi / 2 + 0.6):
        near = [
            closed_form.sphere((math.sin(t), 0, math.cos(t)), math.sin(0.6), np.zeros(3), UP)
            for t in (theta - 1e-6, theta + 1e-6)
        ]
        np.testing.assert_allclose(near[0], near[1], atol=3e-6)


def test_convex_polyhedron_between_two_spheres() -> None:
    scene = next(s for s in SCENES if s.name == "icosphere outside/aligned")
    corners = scene.vertices[scene.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inner = (corners[:, 0] * normal).sum(axis=1) / np.linalg.norm(normal, axis=1)
    for p, n in zip(scene.points, scene.normals, strict=True):
        solid = closed_form.convex_polyhedron(scene.vertices, p, n)
        low = closed_form.sphere(np.zeros(3), float(inner.min()), p, n)
        high = closed_form.sphere(np.zeros(3), 1.0, p, n)
        assert all(a <= b <= c for a, b, c in zip(low, solid, high, strict=True))


def test_formulas_turn_with_the_scene() -> None:
    rotation = _turn(3)
    corners = np.array([(-0.7, -0.4, 1.0), (1.1, -0.6, 0.7), (0.2, 0.9, 1.3)])
    n = _unit(0.3, 0.1, 0.9)
    turned = closed_form.polygon(corners @ rotation.T + 5, np.full(3, 5.0), rotation @ n)
    np.testing.assert_allclose(turned, closed_form.polygon(corners, np.zeros(3), n), atol=ROUNDING)


def test_formulas_refuse_points_inside() -> None:
    with pytest.raises(ValueError, match="need outside"):
        closed_form.sphere((0, 0, 0), 2.0, (0.5, 0, 0), UP)
    with pytest.raises(ValueError, match="not outside"):
        closed_form.convex_polyhedron(np.vstack([np.eye(3), -np.eye(3)]), (0.1, 0, 0), UP)


def test_scenes_are_a_wide_choice() -> None:
    assert len({s.name for s in SCENES}) == len(SCENES) >= 24
    values = np.concatenate([s.cosine for s in SCENES])
    assert (values == 0).any() and (values == 1).any() and ((values > 0.1) & (values < 0.9)).sum() > 50
    for s in SCENES:
        np.testing.assert_allclose(np.linalg.norm(s.normals, axis=1), 1, atol=1e-15)
        assert s.note


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_brute_force_reaches_the_formula(scene: AnalyticScene) -> None:
    points = brute_force.shade_points(scene.vertices, scene.points, scene.normals)
    for weighting in ("cosine", "uniform"):
        exact = getattr(scene, weighting)
        mesh = (scene.vertices, scene.faces, points, scene.normals)
        errors = [np.abs(brute_force.ambient_occlusion(*mesh, k, weighting) - exact) for k in (64, 512)]
        # The project's promise for 512 lines; and at 64, a line's strip is an eighth of a radian at most,
        # of which an edge that runs along it can be misplaced by half: an error of some 1e-3.
        assert errors[0].max() < 5e-3
        assert errors[1].max() < 1e-4
        # What is wholly open or closed is so without error.
        decided = (exact == 0) | (exact == 1)
        assert errors[0][decided].max(initial=0) == 0
