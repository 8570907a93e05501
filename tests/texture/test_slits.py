from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from silint.scene import load_scene
from silint.texture import surface
from silint.texture.charts import charts_of
from silint.texture.slits import cut_at_slits
from tests.texture.shapes import grid, obj_text, ring, strip


def flat_charts(faces, uvs):
    flat = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    return charts_of(uvs, faces, np.repeat(flat[:, None], 3, axis=1), flat, np.ones(len(faces), bool))


def n_connected(pieces, joined):
    """In how many parts the pieces fall."""
    inner = joined[pieces[joined[:, 0]] == pieces[joined[:, 1]]]
    graph = coo_matrix((np.ones(len(inner)), inner.T), (len(pieces), len(pieces)))
    return connected_components(graph, directed=False)[0]


def test_a_strip_is_cut_halfway():
    _, faces, uvs = strip(lambda x, y: (x / 20, y / 20), 12)
    charts = flat_charts(faces, uvs)
    pieces = cut_at_slits(charts, np.array([[0, 11]]), uvs)
    # Faces 0 to 11 are the lower halves of the squares, 12 to 23 the upper ones.
    first = [*range(6), *range(12, 18)]
    assert (pieces[first] == 0).all() and (np.delete(pieces, first) == 1).all()


def test_nothing_is_cut_without_rivals_in_one_chart():
    _, faces, uvs = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 2)
    uvs = uvs.copy()
    uvs[4:] += 2.0
    charts = flat_charts(faces, uvs)
    assert charts.n_charts == 2
    for rivals in (np.zeros((0, 2), int), np.array([[0, 7], [3, 3]])):
        assert np.array_equal(cut_at_slits(charts, rivals, uvs), charts.of_face)


@pytest.mark.parametrize("seed", range(5))
def test_rivals_are_apart_and_pieces_whole(seed):
    """On a sheet of 8 x 8 squares with holes in it, and rivals at random."""
    rng = np.random.default_rng(seed)
    _, faces, uvs = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 8)
    keep = rng.random(len(faces)) < 0.85
    faces, uvs = faces[keep], uvs[keep]
    if seed == 4:
        uvs = 0.0 * uvs + uvs[:, :1]  # all of a face in one point: steps of no length
        faces, uvs = faces[:9], np.repeat(uvs[:1], 9, axis=0)
    charts = flat_charts(faces, uvs)
    rivals = rng.integers(0, len(faces), (6, 2))
    pieces = cut_at_slits(charts, rivals, uvs)
    a, b = rivals[rivals[:, 0] != rivals[:, 1]].T
    assert (pieces[a] != pieces[b]).all()
    assert n_connected(pieces, charts.joined) == len(np.unique(pieces)) == pieces.max() + 1
    # No piece has faces of two charts, and those that lose nothing keep their numbers.
    assert len(np.unique(np.stack([pieces, charts.of_face], axis=1), axis=0)) == pieces.max() + 1


def test_an_unwrapped_ring_is_cut_and_has_no_slit_left(tmp_path, monkeypatch):
    pytest.importorskip("xatlas")
    vertices, faces, uvs = strip(ring(0.5 / 64))
    path = tmp_path / "strip.obj"
    path.write_text(obj_text(vertices, faces))
    monkeypatch.setattr(surface, "unwrap", lambda *of: uvs)
    scene = load_scene(path)

    def laid_out():
        return surface.surface_of(scene, path, "unwrap", surface.Layout(64))

    found = laid_out()
    assert found.charts.n_charts == 2 and found.texels.shared == 0
    # Shapes are kept, but for the scale and the stretch to whole texels, of some 40 here: lengths of edges in
    # the texture, each over that of the first.
    edges = [np.linalg.norm(np.roll(uv, -1, axis=1) - uv, axis=2) for uv in (uvs, found.corners.uvs)]
    np.testing.assert_allclose(edges[1] / edges[1][0, 0], edges[0] / edges[0][0, 0], rtol=0.05)
    # A packing that does not help is not taken.
    monkeypatch.setattr(surface, "repack", lambda charts, *of: charts)
    assert laid_out().charts.n_charts == 1
    monkeypatch.setattr(surface, "cut_at_slits", lambda charts, *of: charts.of_face)
    assert laid_out().texels.shared >= 12
