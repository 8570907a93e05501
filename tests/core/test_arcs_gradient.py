"""Derivatives by arcs, against quadrature over what hides the rest, differentiated by an imaginary step."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.hand_arcs import box, make_arcs, oracle_gradient, polygon
from silint.core.integrands import arcs_gradient, arcs_sh_gradient
from silint.core.sh import open_hemisphere

CLOSED = {"cosine": 0, "uniform": 1, "vector": 2, "bent": 3}
QUANTITIES = [*CLOSED, "sh cosine", "sh uniform"]
DEGREE = 4

# Rounding, of arcs by hand and of quadrature; values and derivatives of these scenes are of the order of 1.
ROUNDING = 3e-14


def gradient(arcs, vertices, quantity, max_degree=DEGREE, factor=1.0):
    if quantity in CLOSED:
        return arcs_gradient.gradient(arcs, vertices, CLOSED[quantity], factor)
    return arcs_sh_gradient.gradient(arcs, vertices, max_degree, quantity.split()[1], factor)


def pullback(arcs, vertices, quantity, cotangents, max_degree=DEGREE, factor=1.0):
    out = np.zeros_like(vertices)
    if quantity in CLOSED:
        return out, arcs_gradient.pullback(arcs, vertices, CLOSED[quantity], factor, cotangents, out)
    weighting = quantity.split()[1]
    return out, arcs_sh_gradient.pullback(arcs, vertices, max_degree, weighting, factor, cotangents, out)


def cotangents_like(value):
    """Numbers without a pattern."""
    return np.cos(1.7 * np.arange(value.size) + 0.4).reshape(value.shape)


def box_corners(low, high):
    return np.array([[(low, high)[b >> a & 1][a] for a in range(3)] for b in range(8)], float)


TRIANGLE = np.array([[-1.0, -0.5, 1.1], [1.2, -0.6, 0.9], [0.1, 1.0, 1.3]])
QUAD = np.array([[-2.5, -0.9, -0.7], [-2.5, 1.1, -0.7], [-2.1, 1.0, 1.2], [-2.1, -0.8, 1.2]])
BLOCK = box_corners((0.6, -0.7, 0.8), (1.5, 0.4, 1.6))
TOWER = box_corners((1.1, 0.3, -1.0), (2.1, 1.4, 1.3))

SCENES = {
    "a triangle overhead": (TRIANGLE, [polygon([0, 1, 2])]),
    "a triangle through the horizon": (TRIANGLE + [0.5, 1.6, -1.0], [polygon([0, 1, 2])]),
    "a wall with its foot below the horizon": (QUAD, [polygon([0, 1, 2, 3])]),
    "a box overhead": (BLOCK, [box(range(8))]),
    "a tower": (TOWER, [box(range(8))]),
    "a triangle and two towers": (
        np.concatenate([TRIANGLE, TOWER + [1.0, 0.0, 0.0], QUAD]),
        [polygon([0, 1, 2]), box(range(3, 11)), polygon([11, 12, 13, 14])],
    ),
}
POINT, NORMAL = np.array([0.1, 0.05, 0.2]), np.array([0.12, -0.17, 1.0]) / np.sqrt(1.0433)


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("scene", SCENES)
def test_all_derivatives_are_those_of_the_value(scene, quantity):
    vertices, hulls = SCENES[scene]
    arcs = make_arcs(POINT[None], NORMAL[None], vertices, hulls)
    value, by_point, by_normal, singular = gradient(arcs, vertices, quantity)
    expected = oracle_gradient(quantity, POINT, NORMAL, vertices, hulls, DEGREE)
    np.testing.assert_allclose(value[0], expected[0], rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(by_point[0], expected[1], rtol=0.0, atol=ROUNDING)
    np.testing.assert_allclose(by_normal[0], expected[2], rtol=0.0, atol=ROUNDING)
    for component in range(value.shape[1]):
        cotangents = np.zeros_like(value)
        cotangents[0, component] = 1.0
        found, _ = pullback(arcs, vertices, quantity, cotangents)
        np.testing.assert_allclose(found, expected[3][..., component], rtol=0.0, atol=ROUNDING)
    assert singular == 0


def test_arcs_by_hand_are_the_whole_boundary():
    """The plainest check of the fixture: a closed boundary integrates N dalpha to twice the vector area, and
    ends join: every direction where an arc ends, one begins.
    """
    for vertices, hulls in SCENES.values():
        arcs = make_arcs(POINT[None], NORMAL[None], vertices, hulls)
        starts, ends = arcs.directions[:, :3], arcs.directions[:, 3:6]
        gaps = np.linalg.norm(starts[:, None] - ends[None], axis=2).min(axis=1)
        assert gaps.max() < 1e-14


@settings(max_examples=25)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9),
    st.lists(st.floats(-0.6, 0.6), min_size=2, max_size=2),
    st.sampled_from(["cosine", "uniform"]),
)
def test_nothing_changes_when_all_is_moved_turned_or_scaled(numbers, tilt, quantity):
    """AO is invariant, so derivatives by points, vertices and normals have to balance: their sum (moves), the
    sum of x . dF/dx (scales), and of x times dF/dx and n times dF/dn (turns).
    """
    triangle = TRIANGLE + 0.35 * np.reshape(numbers, (3, 3)) + [0.3, 0.1, 0.2]
    vertices, hulls = np.concatenate([triangle, QUAD]), [polygon([0, 1, 2]), polygon([3, 4, 5, 6])]
    points = np.array([POINT, [-0.2, 0.3, 0.05]])
    normals = np.array([[*tilt, 1.0], [0.05, -0.1, 1.0]])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    arcs = make_arcs(points, normals, vertices, hulls)
    value, by_point, by_normal, _ = gradient(arcs, vertices, quantity)
    weights = np.array([[1.0], [-0.6]])
    by_point, by_normal = (weights * g[..., 0] for g in (by_point, by_normal))
    by_vertex, _ = pullback(arcs, vertices, quantity, weights)
    assert 0.0 < value.min()
    assert value.max() < 1.0
    np.testing.assert_allclose(by_vertex.sum(axis=0), -by_point.sum(axis=0), atol=1e-14)
    assert abs((by_vertex * vertices).sum() + (by_point * points).sum()) < 1e-14
    torque = np.cross(vertices, by_vertex).sum(axis=0) + np.cross(points, by_point).sum(axis=0)
    np.testing.assert_allclose(torque + np.cross(normals, by_normal).sum(axis=0), 0.0, atol=1e-14)
    np.testing.assert_allclose((by_normal * normals).sum(axis=1), 0.0, atol=1e-15)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_arcs_in_pieces_add_up(quantity):
    vertices, hulls = SCENES["a triangle and two towers"]
    whole, pieces = (make_arcs(POINT[None], NORMAL[None], vertices, hulls, cuts) for cuts in (1, 7))
    for a, b in zip(gradient(whole, vertices, quantity), gradient(pieces, vertices, quantity), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=ROUNDING)
    cotangents = cotangents_like(gradient(whole, vertices, quantity)[0])
    found = [pullback(arcs, vertices, quantity, cotangents)[0] for arcs in (whole, pieces)]
    np.testing.assert_allclose(*found, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("distance", [1e-5, 1e-2])
@pytest.mark.parametrize("quantity", ["cosine", "vector"])
def test_arcs_near_pi(quantity, distance):
    """A long wall close by: its top edge spans all but the last of a half circle."""
    reach = 1e3
    top, foot = 0.5 * distance, -0.5
    wall = np.array(
        [[distance, y, z] for y, z in ((reach, foot), (reach, top), (-reach, top), (-reach, foot))]
    )
    p, n = np.zeros(3), np.array([0.0, 0.0, 1.0])
    arcs = make_arcs(p[None], n[None], wall, [polygon([0, 1, 2, 3])])
    _, by_point, _, _ = gradient(arcs, wall, quantity)
    # Of an infinite wall of angular height psi = atan(top / x) everything is plain: AO is (1 + cos(psi)) / 2,
    # and the vector irradiance along y vanishes. Ends subtract of the order of distance / reach squared.
    x, z = distance, top
    r = np.hypot(x, z)
    if quantity == "cosine":
        expected = 0.5 * np.array([-(z**2), 0.0, x * z]) / r**3
        found = by_point[0, :, 0]
    else:
        expected = 0.5 * np.pi * np.array([-(z**2), 0.0, x * z]) / r**3
        found = by_point[0, :, 2]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=3.0 * (distance / reach) / r + 1e-9 / distance)
    # Rounding may make the ends opposite: then they have no middle, and N alone tells the arc from others.
    top_edge = np.flatnonzero((arcs.directions[:, :3] * arcs.directions[:, 3:6]).sum(axis=1) < -0.99)
    arcs.directions[top_edge, :6] = np.outer(np.sign(arcs.directions[top_edge, 1]), [0, 1, 0, 0, -1, 0])
    _, opposite, _, _ = gradient(arcs, wall, quantity)
    assert len(top_edge) == 1
    np.testing.assert_allclose(
        opposite, by_point, rtol=0.0, atol=3.0 * (distance / reach) / r + 1e-9 / distance
    )


@pytest.mark.parametrize("back", [0.0, 1e-12, 1e-3])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_arcs_of_no_length_and_swapped_ones(quantity, back):
    """An arc that runs too far, and one with the same normal that takes that back."""
    vertices, hulls = SCENES["a triangle overhead"]
    arcs = make_arcs(POINT[None], NORMAL[None], vertices, hulls)
    directions = np.concatenate([arcs.directions, arcs.directions[:1]])
    b, normal = directions[0, 3:6].copy(), directions[0, 6:9]
    beyond = np.cos(back) * b + np.sin(back) * np.cross(normal, b)
    directions[0, 3:6], directions[-1, :3], directions[-1, 3:6] = beyond, beyond, b
    edges = np.concatenate([arcs.edges, arcs.edges[:1]])
    longer = arcs._replace(counts=arcs.counts + 1, directions=directions, edges=edges)
    whole, also = (gradient(a, vertices, quantity) for a in (arcs, longer))
    for one, other in zip(whole, also, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=ROUNDING)
    c = np.ones_like(whole[0])
    found = [pullback(a, vertices, quantity, c)[0] for a in (arcs, longer)]
    np.testing.assert_allclose(*found, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("size", [1e-2, 1e-4, 1e-6])
def test_short_arcs_keep_their_precision(size):
    """A far speck against the leading order: it hides n.w / pi of its solid angle."""
    centre = np.array([0.4, -0.3, 1.2])
    speck = centre + size * np.array([[-1.0, -0.5, 0.1], [1.2, -0.6, -0.1], [0.1, 1.0, 0.3]])
    p, n = np.zeros(3), np.array([0.0, 0.0, 1.0])
    arcs = make_arcs(p[None], n[None], speck, [polygon([0, 1, 2])])
    _, by_point, _, _ = gradient(arcs, speck, "cosine")
    by_vertex, _ = pullback(arcs, speck, "cosine", np.ones((1, 1)))
    _, expected, _, by_vertices = oracle_gradient("cosine", p, n, speck, [polygon([0, 1, 2])])
    # Unit directions of the ends of an arc are good to 1e-16 of a radian, of `size` radians.
    tolerance = 20.0 * 2.0**-53 / size
    np.testing.assert_allclose(
        by_vertex, by_vertices[..., 0], rtol=0.0, atol=tolerance * abs(by_vertices).max()
    )
    # Contributions of the outline to the derivative by p cancel to another power of its size.
    scale = abs(by_vertices).max()
    np.testing.assert_allclose(by_point[0, :, 0], expected[:, 0], rtol=0.0, atol=tolerance * scale)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_an_open_sky(quantity):
    arcs = make_arcs(POINT[None], NORMAL[None], TRIANGLE, [])
    value, by_point, by_normal, _ = gradient(arcs, TRIANGLE, quantity)
    _, _, expected, _ = oracle_gradient(quantity, POINT, NORMAL, TRIANGLE, [], DEGREE)
    assert (by_point == 0.0).all()
    np.testing.assert_allclose(by_normal[0], expected, rtol=0.0, atol=1e-15 * 20)
    if quantity.startswith("sh"):
        expected_value = open_hemisphere(NORMAL[None], DEGREE, quantity.split()[1])
        np.testing.assert_allclose(value, expected_value, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_where_nothing_is_visible_nothing_changes(quantity):
    empty = make_arcs(POINT[None], NORMAL[None], TRIANGLE, [])._replace(counts=np.zeros(1, np.int64))
    value, by_point, by_normal, singular = gradient(empty, TRIANGLE, quantity)
    assert not value.any()
    assert not by_point.any()
    assert not by_normal.any()
    assert singular == 0
    assert not pullback(empty, TRIANGLE, quantity, np.ones_like(value))[0].any()


def test_degree_16():
    vertices, hulls = SCENES["a triangle overhead"]
    arcs = make_arcs(POINT[None], NORMAL[None], vertices, hulls)
    value, by_point, by_normal, _ = arcs_sh_gradient.gradient(arcs, vertices, 16, "cosine", 1.0)
    expected = oracle_gradient("sh cosine", POINT, NORMAL, vertices, hulls, 16)
    # Fixed quadrature resolves degree 16 over these triangles to that.
    for found, reference in zip((value, by_point, by_normal), expected, strict=False):
        np.testing.assert_allclose(found[0], reference, rtol=0.0, atol=1e-12)
    low = arcs_sh_gradient.gradient(arcs, vertices, 4, "cosine", 1.0)
    np.testing.assert_allclose(value[:, :25], low[0], rtol=0.0, atol=1e-15 * 20)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_an_edge_through_the_point_is_left_out_and_counted(quantity):
    vertices, hulls = SCENES["a triangle overhead"]
    arcs = make_arcs(POINT[None], NORMAL[None], vertices, hulls)
    on_edge = vertices.copy()
    on_edge[0], on_edge[1] = POINT - [1.0, 0.3, 0.0], POINT + [2.0, 0.6, 0.0]  # up to rounding
    value, by_point, by_normal, singular = gradient(arcs, on_edge, quantity)
    by_vertex, also = pullback(arcs, on_edge, quantity, np.ones_like(value))
    assert (singular, also) == (1, 1)
    for array in (value, by_point, by_normal, by_vertex):
        assert np.isfinite(array).all()


def many_points(n=64):
    generator = np.random.default_rng(5)
    points = POINT + generator.uniform(-0.15, 0.15, (n, 3))
    normals = NORMAL + generator.uniform(-0.15, 0.15, (n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    vertices, hulls = SCENES["a triangle and two towers"]
    return make_arcs(points, normals, vertices, hulls, 2), vertices


@pytest.fixture
def threads():
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread only")
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_the_same_bits_for_any_number_of_threads(quantity, threads):
    arcs, vertices = many_points()
    found = []
    for n in (1, 2):
        threads(n)
        forward = gradient(arcs, vertices, quantity)[:3]
        found.append((*forward, pullback(arcs, vertices, quantity, cotangents_like(forward[0]))[0]))
    for one, two in zip(*found, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_points_do_not_depend_on_each_other(quantity):
    """Any order, and rows of arcs that belong to no point: bit for bit."""
    arcs, vertices = many_points(40)
    order = np.random.default_rng(1).permutation(40)
    padded = arcs._replace(
        points=arcs.points[order],
        normals=arcs.normals[order],
        counts=arcs.counts[order],
        starts=arcs.starts[order] + 3,
        directions=np.concatenate([np.full((3, 9), np.nan), arcs.directions]),
        edges=np.concatenate([np.full((3, 2), 2**30, np.int32), arcs.edges]),
    )
    whole, shuffled = gradient(arcs, vertices, quantity)[:3], gradient(padded, vertices, quantity)[:3]
    for a, b in zip(whole, shuffled, strict=True):
        np.testing.assert_array_equal(a[order], b)
    cotangents = cotangents_like(whole[0])
    # A sum over points depends on their order, by rounding.
    one, other = (
        pullback(a, vertices, quantity, c)[0] for a, c in ((arcs, cotangents), (padded, cotangents[order]))
    )
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-13)


def test_pullback_sums_over_points():
    arcs, vertices = many_points(5)
    total = pullback(arcs, vertices, "cosine", np.ones((5, 1)))[0]
    alone = [pullback(arcs, vertices, "cosine", np.eye(5)[:, [i]])[0] for i in range(5)]
    np.testing.assert_allclose(total, sum(alone), rtol=0.0, atol=1e-14)
    assert min(np.abs(a).max() for a in alone) > 0.01
