from __future__ import annotations

import numpy as np

from silint.texture.charts import charts_of
from silint.texture.seams import _PULL, equalised, jumps, seam_lookups
from silint.texture.texels import find_texels


def folded_strip():
    """Two triangles that share an edge, of one plane, apart in the texture."""
    uvs = np.array([[[0.1, 0.1], [0.4, 0.1], [0.4, 0.9]], [[0.6, 0.1], [0.95, 0.2], [0.6, 0.9]]])
    welded = np.array([[0, 1, 2], [1, 3, 2]])
    normals = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    return charts_of(uvs, welded, normals, normals[:, 0], np.ones(2, bool)), uvs


def layout(size):
    charts, uvs = folded_strip()
    flat, positions = np.tile([0.0, 0.0, 1.0], (2, 1)), np.pad(uvs, ((0, 0), (0, 0), (0, 1)))
    texels = find_texels(uvs, positions, charts, flat, size, 1)
    rows = np.full(size * size, -1)
    rows[texels.texel] = np.arange(len(texels.texel))
    return charts, texels, seam_lookups(charts.seams, rows, size)


def test_seams_pair_both_sides_of_an_edge():
    charts, _ = folded_strip()
    seams = charts.seams
    assert charts.n_charts == 2 and seams.n_sharp == 0
    np.testing.assert_array_equal(seams.left, [[[0.4, 0.1], [0.4, 0.9]]])
    np.testing.assert_array_equal(seams.right, [[[0.6, 0.1], [0.6, 0.9]]])
    assert charts.across.tolist() == [[-1, 1, -1], [-1, -1, 0]] and charts.hard.all()


def test_hard_edges_are_no_seams():
    uvs = folded_strip()[1]
    normals = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    normals[1] = (0.0, 0.6, 0.8)
    same = np.tile([0.0, 0.0, 1.0], (2, 3, 1))
    for bend, of_corners, sharp in ((0.0, normals, 1), (59.0, same, 0), (61.0, same, 1)):
        angle = np.radians(bend)
        flat = np.array([[0.0, 0.0, 1.0], [0.0, np.sin(angle), np.cos(angle)]])
        charts = charts_of(uvs, np.array([[0, 1, 2], [1, 3, 2]]), of_corners, flat, np.ones(2, bool))
        assert len(charts.seams.left) == 1 - sharp and charts.seams.n_sharp == sharp
        assert (charts.across == -1).all() == bool(sharp)


def test_lookups_are_bilinear():
    """A texture that is linear along v has no jump; a step between both sides has its own."""
    _, texels, lookups = layout(24)
    row, column = np.divmod(texels.texel, 24)
    linear = np.stack([row * 0.5 - 3.0, np.ones(len(row))], axis=1)
    np.testing.assert_allclose(jumps(lookups, linear), 0.0, atol=1e-12)
    step = (column > 11).astype(float)[:, None]
    np.testing.assert_allclose(jumps(lookups, step), 1.0, rtol=1e-12)


def test_equalised_values_are_the_least_squares_solution():
    _, texels, lookups = layout(24)
    rng = np.random.default_rng(5)
    values = rng.random((len(texels.texel), 2))
    out = equalised(lookups, values)
    d = lookups.difference.toarray()
    x0 = values[lookups.texels]
    expected = np.linalg.solve(d.T @ d + _PULL * np.eye(d.shape[1]), _PULL * x0)
    np.testing.assert_allclose(out[lookups.texels], expected, atol=1e-5)
    untouched = np.setdiff1d(np.arange(len(values)), lookups.texels)
    assert np.array_equal(out[untouched], values[untouched]) and len(untouched) > 10
    assert jumps(lookups, out).max() < 0.1 * jumps(lookups, values).max()
    same = np.full_like(values, 0.25)
    np.testing.assert_allclose(equalised(lookups, same), same, atol=1e-12)


def test_positive_values_stay_in_their_range():
    _, texels, lookups = layout(24)
    values = np.random.default_rng(1).integers(0, 2, (len(texels.texel), 2)).astype(float)
    free, kept = equalised(lookups, values), equalised(lookups, values, positive=True)
    assert free.min() < 0.0 or free.max() > 1.0
    assert kept.min() >= 0.0 and (kept.max(axis=0) <= values.max(axis=0)).all()
    # Cut off once, the two sides would part again.
    cut = np.clip(free, 0.0, values.max(axis=0))
    assert jumps(lookups, kept).max() < 0.5 * jumps(lookups, cut).max()


def test_an_edge_of_many_faces_is_no_seam():
    uvs = np.random.default_rng(0).random((3, 3, 2))
    welded = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    normals = np.tile([0.0, 0.0, 1.0], (3, 3, 1))
    charts = charts_of(uvs, welded, normals, normals[:, 0], np.ones(3, bool))
    assert charts.n_charts == 3 and len(charts.seams.left) == 0 and charts.seams.n_sharp == 0
