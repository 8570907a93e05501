"""The boundary of the gradients: units, shapes, the file's vertices, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import polyhedra
from scenes.hand_arcs import make_arcs, oracle, oracle_gradient, polygon
from scenes.mesh import concatenate, moved
from silint import InputError, Scene, SilhouetteIntegrator, finder
from silint.gradients import QUANTITIES, Integrand, differentiate, file_vertices, integrand, pull_back

# In an arbitrary unit, far from the scaled scene's: a triangle and a leaning wall, whose two faces hold their
# common corners twice, and a vertex that no face uses, on top of one that faces use.
CORNERS = 50.0 * np.array(
    [[-1.0, -0.5, 1.1], [1.2, -0.6, 0.9], [0.1, 1.0, 1.3], *[[-2.5, y, z] for y, z in ((-1, -1), (1, -1))]]
    + [[-2.1, 1.0, 1.2], [-2.1, -0.8, 1.2]]
)
TO_CORNER = np.array([0, 1, 2, 3, 4, 5, 3, 5, 6, 5])
FILE = CORNERS[TO_CORNER]
FACES = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
SCENE = Scene(FILE, FACES)
POINTS = np.array([[5.0, 2.5, 10.0], [-4.0, 9.0, 3.0]])
NORMALS = np.array([[0.3, -0.2, 2.0], [0.0, 0.02, 0.1]])
LENGTHS = np.linalg.norm(NORMALS, axis=1)

# Rounding, relative to the size of what is compared.
ROUNDING = 1e-13


def hulls(welded):
    return [polygon(welded[[0, 1, 2]]), polygon(welded[[3, 4, 5, 8]])]


def arcs_of(scene=SCENE):
    welding, topology = scene.welding, scene.topology
    points = np.ldexp(POINTS, -welding.exponent)
    return make_arcs(points, NORMALS, topology.vertices, hulls(welding.vertex_map))


def pulled_back(arcs, what, cotangents):
    out = np.zeros_like(SCENE.topology.vertices)
    assert pull_back(arcs, SCENE, what, cotangents.reshape(len(cotangents), -1), out) == 0
    return out


def oracle_name(what: Integrand) -> str:
    return {
        "ambient_occlusion": what.weighting,
        "vector_irradiance": "vector",
        "bent_normals": "bent",
        "sh_transfer": f"sh {what.weighting}",
    }[what.quantity]


REQUESTS = [integrand(q, max_degree=2) for q in QUANTITIES] + [
    integrand("ambient_occlusion", "uniform"),
    integrand("sh_transfer", "uniform", 3),
]


@pytest.mark.parametrize("what", REQUESTS, ids=oracle_name)
def test_derivatives_are_in_the_units_of_the_file(what):
    arcs = arcs_of()
    gradient, singular = differentiate(arcs, SCENE, what, LENGTHS)
    assert singular == 0
    assert gradient.value.shape == (2, *what.components)
    assert gradient.points.shape == gradient.normals.shape == (2, 3, *what.components)
    cotangents = np.cos(np.arange(gradient.value.size) + 0.3).reshape(gradient.value.shape)
    by_corner = 0.0
    for i in range(2):
        unit = NORMALS[i] / LENGTHS[i]
        expected = oracle_gradient(
            oracle_name(what), POINTS[i], unit, CORNERS, hulls(TO_CORNER), what.max_degree
        )
        found = gradient.value[i], gradient.points[i] * 50.0, gradient.normals[i] * LENGTHS[i]
        for ours, theirs in zip(found, (expected[0], expected[1] * 50.0, expected[2]), strict=True):
            np.testing.assert_allclose(ours.reshape(theirs.shape), theirs, rtol=0.0, atol=ROUNDING)
        by_corner = by_corner + expected[3] @ cotangents[i].reshape(-1)
    found = file_vertices(pulled_back(arcs, what, cotangents), SCENE)
    # Corners 3 and 5 come twice among the faces' vertices; row 9 is used by none.
    share = np.array([1, 1, 1, 2, 1, 2, 2, 2, 1, np.inf])[:, None]
    expected = by_corner[TO_CORNER] / share
    np.testing.assert_allclose(50.0 * found, 50.0 * expected, rtol=0.0, atol=ROUNDING)


def test_moving_all_copies_of_a_corner_together():
    """What the division among copies is for: a central difference of the value by one parameter."""
    what, arcs = integrand(), arcs_of()
    welded = pulled_back(arcs, what, np.ones(2))
    moved = np.zeros_like(FILE)
    moved[(FILE == CORNERS[5]).all(axis=1)] = [0.0, 0.6, 0.8]
    derivative = (file_vertices(welded, SCENE) * moved).sum()
    h = 1e-3

    def total(step):
        corners = CORNERS.copy()
        corners[5] += step * np.array([0.0, 0.6, 0.8])
        values = [
            oracle("cosine", *at, corners, hulls(TO_CORNER)) for at in zip(POINTS, NORMALS, strict=True)
        ]
        return np.sum(values)

    there, back = total(h), total(-h)
    assert abs(derivative) > 1e-4
    # Rounding over 2 h, and h squared.
    assert abs(derivative - (there - back) / (2.0 * h)) < 1e-11


def test_normals_are_unit_unless_said_otherwise():
    arcs = arcs_of()
    unit, passed = (differentiate(arcs, SCENE, integrand(), lengths)[0] for lengths in (None, LENGTHS))
    np.testing.assert_array_equal(unit.normals / LENGTHS[:, None], passed.normals)
    np.testing.assert_array_equal(unit.points, passed.points)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"quantity": "sky_view_factor"}, "quantity is 'sky_view_factor'"),
        ({"weighting": "square"}, "weighting is 'square'"),
        ({"quantity": "bent_normals", "weighting": "uniform"}, "bent_normals knows no weighting"),
        ({"quantity": "sh_transfer", "max_degree": 17}, "max_degree is 17"),
    ],
)
def test_what_cannot_be_differentiated_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        integrand(**options)


@pytest.mark.parametrize(
    ("what", "cotangents", "message"),
    [
        (integrand(), np.ones(3), r"cotangents has shape \(3,\); expected \(2,\)"),
        (integrand(), np.ones((2, 1)), r"cotangents has shape \(2, 1\); expected \(2,\)"),
        (integrand("bent_normals"), np.ones(2), r"cotangents has shape \(2,\); expected \(2, 3\)"),
        (integrand(), [1.0, np.nan], "cotangents"),
        (integrand(), ["a", "b"], "cotangents"),
    ],
)
def test_cotangents_are_checked(what, cotangents, message):
    with pytest.raises(InputError, match=message) as error:
        SilhouetteIntegrator(SCENE).pullback(POINTS, NORMALS, cotangents, what.quantity)
    assert "\n" not in str(error.value)


# ------------------------------------------------------------------------------------- both phases together


@pytest.mark.parametrize("what", REQUESTS, ids=oracle_name)
def test_the_integrator_has_the_derivatives_of_its_own_arcs(what):
    """Phase one finds the hand-made arcs, up to cuts and order."""
    sil, by_hand = SilhouetteIntegrator(SCENE), arcs_of()
    expected, _ = differentiate(by_hand, SCENE, what, LENGTHS)
    found, counts = sil.gradient(POINTS, NORMALS, *what, full_output=True)
    assert counts["singular_arcs"] == counts["uncertified_points"] == 0
    assert counts["exact_points"] == 2
    # Points are lifted by 2^-36 of the scene.
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-9)
    cotangents = np.cos(np.arange(expected.value.size) + 0.3).reshape(expected.value.shape)
    np.testing.assert_allclose(
        sil.pullback(POINTS, NORMALS, cotangents, *what),
        file_vertices(pulled_back(by_hand, what, cotangents), SCENE),
        rtol=0.0,
        atol=1e-9,
    )


@pytest.fixture(scope="module")
def crowd():
    """Overlapping occluders at random, and points among them: vertices, faces, points, normals."""
    generator = np.random.default_rng(11)
    vertices, faces = concatenate(
        [
            moved(polyhedra.box(0.4 * generator.uniform(0.5, 1.5, 3)), p)
            for p in generator.uniform(-1, 1, (14, 3))
        ]
    )
    shear = np.eye(3) + 0.2 * generator.normal(size=(3, 3))
    normals = generator.normal(size=(12, 3))
    return vertices @ shear, faces, generator.uniform(-1.2, 1.2, (12, 3)), normals


@pytest.mark.parametrize("quantity", ["ambient_occlusion", "sh_transfer"])
def test_central_differences_of_exact_values(crowd, quantity):
    """By points, by normals, and by vertices that overlap, cross and hide each other."""
    vertices, faces, points, normals = crowd
    h, options = 1e-6, {"quantity": quantity, "max_degree": 2}
    sil = SilhouetteIntegrator(Scene(vertices, faces))
    found = sil.gradient(points, normals, **options)
    assert 0 < np.count_nonzero(found.value.reshape(12, -1).any(axis=1))
    generator = np.random.default_rng(3)
    dp, dn, dv = (generator.normal(size=a.shape) for a in (points, normals, vertices))
    cotangents = generator.normal(size=found.value.shape)

    def values(step_p=0.0, step_n=0.0, step_v=0.0):
        moved_scene = sil if step_v == 0.0 else SilhouetteIntegrator(Scene(vertices + step_v * dv, faces))
        return moved_scene.gradient(points + step_p * dp, normals + step_n * dn, **options).value

    def difference(which):
        return (values(**{which: h}) - values(**{which: -h})) / (2.0 * h)

    # The rounding of values over 2 h is 1e-10; the rest is curvature where an edge passes close by.
    by_points = np.einsum("ij,ij...->i...", dp, found.points)
    np.testing.assert_allclose(difference("step_p"), by_points, rtol=1e-7, atol=1e-8)
    by_normals = np.einsum("ij,ij...->i...", dn, found.normals)
    np.testing.assert_allclose(difference("step_n"), by_normals, rtol=1e-7, atol=1e-8)
    by_vertices = (sil.pullback(points, normals, cotangents, **options) * dv).sum()
    assert abs((difference("step_v") * cotangents).sum() - by_vertices) < 1e-7 * max(1.0, abs(by_vertices))


def test_groups_of_points_do_not_matter(crowd, monkeypatch):
    """Groups follow the clock; sums over points must not."""
    vertices, faces, points, normals = crowd
    sil = SilhouetteIntegrator(Scene(vertices, faces))
    many = np.tile(points, (40, 1)) + 0.01 * np.random.default_rng(2).normal(size=(480, 3))
    facing, cotangents = np.tile(normals, (40, 1)), np.cos(np.arange(480.0))
    whole = sil.pullback(many, facing, cotangents)
    forward = sil.ambient_occlusion_gradient(many, facing)
    monkeypatch.setattr(finder, "_PER_BLOCK", 64)
    monkeypatch.setattr(finder, "_next_size", lambda *_: 64)
    np.testing.assert_array_equal(sil.pullback(many, facing, cotangents), whole)
    for one, other in zip(sil.ambient_occlusion_gradient(many, facing), forward, strict=True):
        np.testing.assert_array_equal(one, other)
