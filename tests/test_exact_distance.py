"""The exact mode within a distance: small circles where faces leave the ball about the shade point."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import t as student

from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import boxes, concatenate
from silint import Scene, SilhouetteIntegrator
from silint.reference import EmbreeQMC, embree_available
from tests import ball_oracle
from tests.exact_scenes import (
    ExactScene,
    Mesh,
    closed_form_scenes,
    integer_boxes,
    oracle_scenes,
    reduced_scenes,
    rotation,
    turned,
)

# Sums of a few hundred arcs, each good to some 1e-16, and a quadrature of 40 nodes over each of them.
ROUNDING = 1e-12
# What lifting points off their surfaces does, 2^-36 of the scene, where they touch what they see.
CONTACT = 1e-5
# The error of so many lines: below this in all scenes measured, but for points in contact.
LINES, ROUGH = 2048, 2e-4

ORIGIN, UP = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])


def soup(n: int, seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, size=(n, 1, 3)) + rng.normal(scale=0.5, size=(n, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3)


def turned_boxes(n: int, seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    parts = []
    for i in range(n):
        half = rng.uniform(0.1, 0.4, 3)
        vertices, faces = turned(boxes([-half], [half]), rotation(100 * seed + i))
        parts.append((vertices + rng.uniform(-0.8, 0.8, 3), faces))
    return concatenate(parts)


MESHES = {"soup": lambda: soup(8, 1), "more soup": lambda: soup(14, 2), "boxes": lambda: turned_boxes(4, 3)}


@cache
def integrator(name: str) -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*MESHES[name]()))


def anywhere(n: int, seed: int, size: float = 1.2) -> Mesh:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    return rng.uniform(-size, size, size=(n, 3)), normals / np.linalg.norm(normals, axis=1)[:, None]


def exact(sil: SilhouetteIntegrator, p: np.ndarray, n: np.ndarray, R: float | str) -> np.ndarray:
    """Ambient occlusion with both weightings, and the bent normal, without a point that is uncertain."""
    columns = []
    for weighting in ("cosine", "uniform"):
        found = sil.ambient_occlusion(
            p, n, weighting=weighting, method="exact", max_distance=R, full_output=True
        )
        assert found.diagnostics["uncertified_points"] == 0
        columns.append(found.value[:, None])
    columns.append(sil.bent_normals(p, n, method="exact", max_distance=R))
    return np.concatenate(columns, axis=1)


# ----------------------------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("R", [1.25, 2.0, 10.0])
@pytest.mark.parametrize("pieces", [1, 7])
def test_a_ceiling_hides_the_cap_that_is_near(R: float, pieces: int) -> None:
    """At height h it is nearer than R where cos(theta) > h / R, however it is cut into faces."""
    side = np.linspace(-100.0, 100.0, pieces + 1)
    x, y = np.meshgrid(side, side, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    corner = (np.arange(pieces)[:, None] * (pieces + 1) + np.arange(pieces)).ravel()
    a, b, c, d = corner, corner + 1, corner + pieces + 2, corner + pieces + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    sil = SilhouetteIntegrator(Scene(vertices, faces))
    found = exact(sil, ORIGIN + [0.3, 0.2, 0.0], UP, R)[0]
    q = 1 / R
    # int n.w w over the cap is pi (1 - q^3) 2/3; points are lifted by 2^-36 of 100.
    np.testing.assert_allclose(found, [q * q, q, 0, 0, 2 / 3 * q**3], rtol=0, atol=2e-8)


@pytest.mark.parametrize("R", [1.25, 2.0, 10.0])
def test_a_wall_hides_a_cap_about_the_horizon(R: float) -> None:
    """1 - (g - sin(g) cos(g)) / pi with cos(g) = d / R; half of a cap's solid angle."""
    vertices = np.array([[1, -50, 0], [1, -50, 50], [1, 50, 50], [1, 50, 0]], float)
    sil = SilhouetteIntegrator(Scene(vertices, [[0, 1, 2], [0, 2, 3]]))
    g = np.arccos(1 / R)
    found = exact(sil, ORIGIN, UP, R)[0]
    assert abs(found[0] - (1 - (g - np.sin(g) * np.cos(g)) / np.pi)) < 2e-9
    assert abs(found[1] - (1 - 0.5 * (1 - 1 / R))) < 2e-9


@pytest.mark.parametrize("R", [0.9, 1.05, 1.2, 1.5])
def test_a_polygon_overhead_is_cut_by_a_circle(R: float) -> None:
    """A square of half width 1/2 at the height 1; the circle passes inside, through it, and outside."""
    vertices = np.array([[-0.5, -0.5, 1], [0.5, -0.5, 1], [0.5, 0.5, 1], [-0.5, 0.5, 1]])
    sil = SilhouetteIntegrator(Scene(vertices, [[0, 1, 2], [0, 2, 3]]))
    # Hidden is the part of the square within r of its centre: int dA / (pi (1 + x^2 + y^2)^2), in polar
    # coordinates over an eighth.
    r = np.sqrt(max(R * R - 1, 0.0))
    nodes, weights = np.polynomial.legendre.leggauss(60)
    kink = np.arccos(min(0.5 / r, 1.0)) if 0.5 < r else 0.0
    hidden = 0.0
    for low, high in ((0.0, min(kink, np.pi / 4)), (min(kink, np.pi / 4), np.pi / 4)):
        phi = low + 0.5 * (high - low) * (nodes + 1)
        rim = np.minimum(0.5 / np.cos(phi), r)
        hidden += 8 * 0.5 * (high - low) * (weights * 0.5 * rim**2 / (1 + rim**2)).sum() / np.pi
    found = sil.ambient_occlusion(ORIGIN, UP, method="exact", max_distance=R)[0]
    assert abs(found - (1 - hidden)) < 1e-9


# ------------------------------------------------------------------------------------------------- the oracle


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("R", [0.4, 0.8, 1.5])
def test_the_oracle_agrees(name: str, R: float) -> None:
    sil, (p, n) = integrator(name), anywhere(6, 4)
    vertices, faces = MESHES[name]()
    lifted = np.ldexp(sil._finder.shade_points(p, n)[0], sil.scene.welding.exponent)
    expected = [ball_oracle.integrals(vertices, faces, x, y, R) for x, y in zip(lifted, n, strict=True)]
    np.testing.assert_allclose(exact(sil, p, n, R), expected, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("share", [0.0, 1e-15, -1e-15, 1e-14, 1e-13, 1e-12, -1e-12, 1e-10])
def test_a_circle_that_all_but_touches_the_edges_of_a_square(share: float) -> None:
    """Edges that leave the ball twice in one place hide slivers of the disc, not all of it."""
    vertices = np.array([[-0.5, -0.5, 1], [0.5, -0.5, 1], [0.5, 0.5, 1], [-0.5, 0.5, 1]])
    sil = SilhouetteIntegrator(Scene(vertices, [[0, 1, 2], [0, 2, 3]]))
    x, y, z = np.ldexp(sil._finder.shade_points(ORIGIN, UP)[0], sil.scene.welding.exponent)[0]
    h = 1.0 - z
    assert x == y == 0.0
    square = 0.25 * (1.0 + share)
    found = exact(sil, ORIGIN, UP, float(np.sqrt(h * h + square)))[0]
    q = h / np.sqrt(h * h + 0.25)
    np.testing.assert_allclose(found, [q * q, q, 0, 0, 2 / 3 * q**3], rtol=0, atol=2e-9)


@pytest.mark.parametrize("share", [1e-15, 1e-14, 1e-13, 1e-12])
@pytest.mark.parametrize("inside", [True, False])
def test_a_circle_that_all_but_touches_one_edge(share: float, inside: bool) -> None:
    """The ball leaves a face twice through one edge: all of its disc but a sliver is hidden, or a sliver."""
    far = -40.0 if inside else 40.0
    vertices = np.array([[-30.0, 0.5, 1], [30.0, 0.5, 1], [0.0, far, 1]])
    sil = SilhouetteIntegrator(Scene(vertices, [[0, 1, 2]]))
    h = 1.0 - np.ldexp(sil._finder.shade_points(ORIGIN, UP)[0], sil.scene.welding.exponent)[0, 2]
    found = exact(sil, ORIGIN, UP, float(np.sqrt(h * h + 0.25 * (1.0 + share))))[0]
    q = h / np.sqrt(h * h + 0.25) if inside else 1.0
    np.testing.assert_allclose(found, [q * q, q, 0, 0, 2 / 3 * q**3], rtol=0, atol=2e-9)


@pytest.mark.parametrize("turn", [0.6, 0.8, 1.0, 1.2, 2.5, 4.0])
def test_an_edge_crosses_a_circle_twice_between_two_events(turn: float) -> None:
    """A wall cuts a sliver off the disc in which a ceiling is near; neither begins or ends there."""
    c, s = np.cos(turn), np.sin(turn)
    wall = np.array([[-0.7, 0.65, 0.1], [0.7, 0.65, 0.1], [0.7, 0.65, 0.9], [-0.7, 0.65, 0.9]])
    wall = wall @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    ceiling = np.array([[-9, -9, 1], [9, -9, 1], [9, 9, 1], [-9, 9, 1]], float)
    vertices = np.concatenate([wall, ceiling])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    sil = SilhouetteIntegrator(Scene(vertices, faces))
    p = np.array([[0.011, -0.007, 0.003]])
    lifted = np.ldexp(sil._finder.shade_points(p, UP)[0], sil.scene.welding.exponent)
    expected = ball_oracle.integrals(vertices, faces, lifted[0], UP[0], 1.25)
    np.testing.assert_allclose(exact(sil, p, UP, 1.25)[0], expected, rtol=0, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_the_oracle_agrees_on_many(seed: int) -> None:
    for mesh in (soup(12, seed), turned_boxes(5, seed)):
        sil, (p, n) = SilhouetteIntegrator(Scene(*mesh)), anywhere(10, seed)
        lifted = np.ldexp(sil._finder.shade_points(p, n)[0], sil.scene.welding.exponent)
        for R in (0.3, 0.6, 1.0, 2.0):
            expected = [ball_oracle.integrals(*mesh, x, y, R) for x, y in zip(lifted, n, strict=True)]
            np.testing.assert_allclose(exact(sil, p, n, R), expected, rtol=0, atol=1e-9)


# -------------------------------------------------------------------------------- nothing in general position


@pytest.mark.parametrize(
    "s", (*closed_form_scenes(), *oracle_scenes(3), *reduced_scenes()), ids=lambda s: s.name
)
def test_lines_agree_where_everything_touches(s: ExactScene) -> None:
    sil = SilhouetteIntegrator(Scene(*s.mesh))
    p, n = s.points[:40], s.normals[:40]
    for share in (0.06, 0.25):
        R = share * sil.scene.extent
        found = sil.ambient_occlusion(p, n, method="exact", max_distance=R, full_output=True)
        lines = sil.ambient_occlusion(p, n, LINES, max_distance=R)
        assert np.abs(found.value - lines).max() < ROUGH
        assert found.error_estimate.max() < 10 * CONTACT
        assert found.diagnostics["uncertified_points"] <= 0.02 * len(p)


@settings(max_examples=25, deadline=None)
@given(integer_boxes(), st.sampled_from([1.0, 1.5, 2.0, 3.0]))
def test_integer_boxes_and_integer_distances(scene: tuple[Mesh, np.ndarray, np.ndarray], R: float) -> None:
    """Spheres that touch edges and faces, and pass through vertices."""
    mesh, p, n = scene
    sil = SilhouetteIntegrator(Scene(*mesh))
    found = sil.ambient_occlusion(p, n, method="exact", max_distance=R, full_output=True)
    lines = sil.ambient_occlusion(p, n, LINES, max_distance=R)
    assert np.abs(found.value - lines).max() < ROUGH + CONTACT


# ----------------------------------------------------------------------------------------------- whole scenes


@cache
def large(name: str) -> SilhouetteIntegrator:
    return SilhouetteIntegrator(
        Scene(*{"clutter": lambda: clutter(3, 2), "leaves": lambda: foliage(1, 1)}[name]())
    )


def rows(sil: SilhouetteIntegrator, n: int) -> Mesh:
    p, normals, valid = sil.scene.face_centers_normals()
    chosen = np.random.default_rng(0).choice(np.flatnonzero(valid), n, replace=False)
    return p[chosen], normals[chosen]


@pytest.mark.parametrize("name", ["clutter", "leaves"])
def test_more_distance_hides_more(name: str) -> None:
    sil = large(name)
    p, n = rows(sil, 100)
    last = np.ones(len(p))
    for percent in (0.5, 2, 5, 10, 30):
        found = sil.ambient_occlusion(p, n, method="exact", max_distance=f"{percent}%", full_output=True)
        assert found.diagnostics["uncertified_points"] == 0
        assert (found.value <= last + ROUNDING).all()
        last = found.value
        lines = sil.ambient_occlusion(p, n, 512, max_distance=f"{percent}%", full_output=True)
        assert np.abs(found.value - lines.value).max() < 1e-3
    free = sil.ambient_occlusion(p, n, method="exact")
    assert (free <= last + ROUNDING).all()


@pytest.mark.parametrize("name", ["clutter", "leaves"])
def test_beyond_the_scene_every_bit_is_that_of_no_limit(name: str) -> None:
    sil = large(name)
    p, n = rows(sil, 30)
    for query in (sil.ambient_occlusion, sil.bent_normals):
        free = query(p, n, method="exact", full_output=True)
        for R in (2.0 * sil.scene.extent, "200%", 1e300):
            found = query(p, n, method="exact", max_distance=R, full_output=True)
            assert (found.value == free.value).all()
            assert (found.error_estimate == free.error_estimate).all()


def test_the_limit_of_a_large_distance_is_none() -> None:
    """A ball that holds all that is seen, but not the whole scene: served as limited."""
    sil = large("clutter")
    p, n = rows(sil, 50)
    found = sil.ambient_occlusion(p, n, method="exact", max_distance=0.9 * sil.scene.extent)
    np.testing.assert_allclose(found, sil.ambient_occlusion(p, n, method="exact"), rtol=0, atol=5e-3)


def test_no_value_depends_on_company_order_threads_or_unit() -> None:
    sil = large("clutter")
    p, n = rows(sil, 70)
    whole = exact(sil, p, n, "8%")
    order = np.random.default_rng(1).permutation(len(p))
    assert (exact(sil, p[order], n[order], "8%") == whole[order]).all()
    assert (exact(sil, p[:3], n[:3], "8%") == whole[:3]).all()
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert (exact(sil, p, n, "8%") == whole).all()
    finally:
        numba.set_num_threads(threads)
    larger = SilhouetteIntegrator(Scene(4.0 * sil.scene.vertices, sil.scene.faces))
    assert (exact(larger, 4.0 * p, n, "8%") == whole).all()


@pytest.mark.parametrize("percent", [2, 8, 25])
def test_rays_that_end_agree(percent: float) -> None:
    if not embree_available():
        pytest.skip("no embreex here")
    vertices, faces = clutter(3, 2)
    # The coordinates of float32 that Embree has, and points far enough from faces for it.
    sil = SilhouetteIntegrator(Scene(np.asarray(vertices, np.float32).astype(np.float64), faces))
    p, n = rows(sil, 150)
    p = p + 1e-4 * sil.scene.extent * n
    R = percent / 100 * float(np.linalg.norm(np.ptp(sil.scene.vertices, axis=0)))
    found = sil.ambient_occlusion(p, n, method="exact", max_distance=R)
    embree = EmbreeQMC(sil.scene.vertices, sil.scene.faces)
    rays = embree.ambient_occlusion(p, n, 512, scrambles=32, max_distance=R)
    known = rays.standard_error > 0
    z = (found - rays.value)[known] / rays.standard_error[known]
    # What one of all points passes in a thousand runs.
    assert np.abs(z).max() < student.isf(0.5e-3 / len(p), 31)
    assert np.sqrt((z**2).mean()) < 1.3
    # All rays of a point agree: what it sees otherwise is too small for 16384 rays.
    assert np.abs((found - rays.value)[~known]).max(initial=0.0) < 1e-3
    assert known.sum() > 50
