from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from silint.core import uv_cover
from silint.texture.charts import charts_of
from silint.texture.texels import across_seams, find_texels, sample_offsets
from tests.texture.shapes import ring, strip


def in_space(uvs):
    return np.pad(uvs, ((0, 0), (0, 0), (0, 1)))


def covered(uvs, size, samples=1, flat=None):
    """Texels of faces that share no edge: each is a chart."""
    n = len(uvs)
    welded = np.arange(3 * n).reshape(n, 3)
    normals = np.tile([0.0, 0.0, 1.0], (n, 3, 1))
    flat = np.tile([0.0, 0.0, 1.0], (n, 1)) if flat is None else flat
    charts = charts_of(uvs, welded, normals, flat, np.ones(n, bool))
    return find_texels(uvs, in_space(uvs), charts, flat, size, samples)


def nearest_by_sampling(triangle, x, y, n=400):
    """Distance from a point to a triangle, by very many of its points: never below the true one."""
    a, b = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    keep = a + b <= 1.0 + 1e-12
    a, b = a[keep], b[keep]
    points = np.stack([1 - a - b, a, b], axis=1) @ triangle
    return float(np.hypot(points[:, 0] - x, points[:, 1] - y).min()), points


coordinate = st.floats(0.0, 1.0, width=32)


@given(st.lists(coordinate, min_size=6, max_size=6))
def test_a_texel_is_covered_where_its_footprint_meets_the_triangle(values):
    size = 6
    uv = np.array(values).reshape(1, 3, 2)
    edge = uv[0, 1:] - uv[0, :1]
    if abs(edge[0, 0] * edge[1, 1] - edge[0, 1] * edge[1, 0]) < 1e-4:
        return
    texels = covered(uv, size)
    triangle = np.stack([uv[0, :, 0] * size, (1 - uv[0, :, 1]) * size], axis=1)
    has = np.zeros((size, size), bool)
    has.ravel()[texels.texel] = True
    for row in range(size):
        for column in range(size):
            distance, points = nearest_by_sampling(triangle, column + 0.5, row + 0.5, 120)
            beyond = np.maximum(np.abs(points[:, 0] - column - 0.5), np.abs(points[:, 1] - row - 0.5)).min()
            # Sampled points are up to 6 / 119 of a texel apart.
            if beyond <= 1.0:
                assert has[row, column]
            elif beyond > 1.1:
                assert not has[row, column]
            if has[row, column]:
                k = np.searchsorted(texels.texel, row * size + column)
                found = texels.weights[k] @ triangle
                assert (texels.weights[k] >= -1e-12).all() and texels.weights[k].sum() == pytest.approx(1)
                # The point is nearest up to the inset from the border.
                assert np.hypot(*(found - (column + 0.5, row + 0.5))) <= distance + 0.051


def test_slivers_points_and_whole_textures_are_covered():
    thin = np.array([[[0.05, 0.5], [0.95, 0.5 + 1e-7], [0.5, 0.5]]])
    assert len(covered(thin, 16).texel) >= 2 * 14  # a row on either side
    tiny = np.array([[[0.31, 0.31], [0.3101, 0.31], [0.31, 0.3101]]])
    assert 4 <= len(covered(tiny, 16).texel) <= 9
    whole = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]])
    assert len(covered(whole, 16).texel) == 256
    assert len(covered(whole, 1).texel) == 1


def test_overlaps_and_near_charts_are_counted():
    one = np.array([[[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]])
    assert covered(one, 32).overlapping == 0
    twice = covered(np.concatenate([one, one + 0.01]), 32)
    assert 0.7 * twice.inside < twice.overlapping < twice.inside
    # Faces that touch share an edge, not texels' centres.
    whole = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [[0.0, 0.0], [1.0, 1.0], [0.0, 1.0]]])
    apart = covered(whole, 32)
    assert apart.overlapping == 0 and apart.shared > 32
    far = np.array([[[0.0, 0.0], [0.4, 0.0], [0.4, 1.0]], [[0.6, 0.0], [1.0, 0.0], [1.0, 1.0]]])
    assert covered(far, 32).shared == 0
    gap = 1.5 / 32
    near = np.array(
        [
            [[0.0, 0.0], [0.5, 0.0], [0.5, 1.0]],
            [[0.5 + gap, 0.0], [1.0, 0.0], [0.5 + gap, 1.0]],
        ]
    )
    assert covered(near, 32).shared > 10


def strip_texels(uvs_of):
    vertices, faces, uvs = strip(uvs_of)
    flat = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    normals = np.repeat(flat[:, None], 3, axis=1)
    charts = charts_of(uvs, faces, normals, flat, np.ones(len(faces), bool))
    assert charts.n_charts == 1
    return find_texels(uvs, vertices[faces], charts, flat, 64, 1)


def test_a_slit_within_a_chart_is_counted():
    assert strip_texels(lambda x, y: (0.05 + 0.9 * x / 12, 0.4 + 0.075 * y)).shared == 0
    assert strip_texels(ring(4.0 / 64)).shared == 0
    # About 12 texels long, 2 or 3 wide.
    found = strip_texels(ring(0.5 / 64))
    assert 12 <= found.shared <= 60
    # Its rivals are faces of the two ends, squares 0 and 11.
    assert len(found.rivals) and {tuple(pair) for pair in np.sort(found.rivals % 12).tolist()} == {(0, 11)}


def test_texels_that_hold_an_edge_have_several_samples():
    # A fold along u = 0.5: of the texels in the middle, those in the two columns beside it if it is sharp.
    uvs = np.array([[[0.0, 0.0], [0.52, 0.0], [0.52, 1.0]], [[0.52, 0.0], [1.0, 0.5], [0.52, 1.0]]])
    welded = np.array([[0, 1, 2], [1, 3, 2]])
    normals = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    counts = []
    for bend in (0.0, 14.0, 16.0):
        angle = np.radians(bend)
        flat = np.array([[0.0, 0.0, 1.0], [np.sin(angle), 0.0, np.cos(angle)]])
        charts = charts_of(uvs, welded, normals, flat, np.ones(2, bool))
        assert charts.n_charts == 1 and len(charts.borders) == 4
        texels = find_texels(uvs, in_space(uvs), charts, flat, 32, 4)
        assert (np.diff(texels.offsets) == 4).sum() == texels.mixed
        counts.append(texels.mixed)
        one = find_texels(uvs, in_space(uvs), charts, flat, 32, 1)
        assert one.mixed == 0 and np.array_equal(one.texel, texels.texel)
    assert counts[0] == counts[1] and counts[2] - counts[0] == pytest.approx(30, abs=3)


def test_means_are_those_of_each_texel_alone():
    uvs = np.array([[[0.1, 0.1], [0.9, 0.2], [0.3, 0.9]]])
    texels = covered(uvs, 16, 4)
    values = np.random.default_rng(0).normal(size=(len(texels.sample_face), 2))
    means = texels.means(values)
    for k in (0, 7, len(texels.texel) - 1):
        expected = values[texels.offsets[k] : texels.offsets[k + 1]].mean(axis=0)
        np.testing.assert_allclose(means[k], expected, rtol=1e-15)


@pytest.mark.parametrize("n", [1, 2, 4, 7, 64])
def test_samples_stay_in_their_texel_and_average_to_its_centre(n):
    offsets = sample_offsets(n)
    assert offsets.shape == (n, 2) and (np.abs(offsets) <= 0.5).all()
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=1e-15)
    assert len(np.unique(offsets[:, 0])) == len(np.unique(offsets[:, 1])) == n


def test_a_point_on_an_edge_is_moved_off_it():
    corners = np.array([[[0.0, 0.0], [8.0, 0.0], [0.0, 8.0]]])
    positions = np.array([[-1.0, 4.0], [2.0, 2.0]])
    weights = np.empty((2, 3))
    for hard in (True, False):
        edges = np.array([[False, False, hard]])
        uv_cover.locate(corners, edges, np.zeros(2, np.int32), positions, 0.05, weights)
        assert (weights[0].min() > 1e-3) == hard
        np.testing.assert_allclose(weights[0] @ corners[0], (0.0, 4.0), atol=0.05)
    np.testing.assert_allclose(weights[1] @ corners[0], (2.0, 2.0), atol=1e-14)


def test_order_of_faces_and_degenerate_ones_change_no_coverage():
    rng = np.random.default_rng(3)
    uvs = rng.random((20, 3, 2)) * 0.15 + rng.random((20, 1, 2)) * 0.8
    a, b = covered(uvs, 64), covered(uvs[::-1], 64)
    assert np.array_equal(a.texel, b.texel)
    assert (a.inside, a.overlapping, a.shared) == (b.inside, b.overlapping, b.shared)


def test_beyond_a_seam_texels_take_the_other_side_but_for_those_on_a_fold():
    """Two faces folded along x = 0, y > 0, and a third beyond the seam of the first, in its plane."""
    vertices = np.array([(-1, 0, 0), (0, 0, 0), (0, 1, 0), (0.7, 0, 0.7), (-0.5, -1, 0)], float)
    faces = np.array([[0, 1, 2], [1, 3, 2], [1, 0, 4]])
    size = 64
    # The vertex on the fold just above the centre of a texel, the third face far away in the texture.
    place = np.array([(-24, 0), (0, 0), (0, 24), (24, 0), (-12, -20)]) / size + (32.6 / size, 1 - 32.4 / size)
    uvs = place[faces]
    uvs[2] += (0.2, -0.15)
    flat = np.array([(0, 0, 1), (-np.sqrt(0.5), 0, np.sqrt(0.5)), (0, 0, 1)])
    normals = np.tile([0.0, 0.0, 1.0], (3, 3, 1))
    charts = charts_of(uvs, faces, normals, flat, np.ones(3, bool))
    assert charts.n_charts == 2 and len(charts.seams.left) == 1
    texels = find_texels(uvs, vertices[faces], charts, flat, size, 4)
    moved = across_seams(texels, charts, vertices[faces], uvs, size)
    several = np.repeat(np.diff(texels.offsets) > 1, np.diff(texels.offsets))
    on_fold = np.searchsorted(texels.texel, 32 * size + 32)
    assert np.diff(texels.offsets)[on_fold] == 4 and on_fold in texels.outside
    assert np.array_equal(moved.sample_face[several], texels.sample_face[several])
    # Those below the first face lie on the third.
    below = (texels.texel // size == 32) & (texels.texel % size < 31) & (texels.texel % size > 9)
    assert (moved.sample_face[moved.offsets[:-1][below]] == 2).all() and below.sum() == 21
