from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.image import imread

from silint.render import automatic_camera, render
from silint.validation import InputError

# A square in the plane x = 0, seen from +x.
SQUARE = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]], float)
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
FRONT = {"azimuth": 0.0, "elevation": 0.0}


def pixels(tmp_path, *arguments, **options) -> np.ndarray:
    """The picture as floats in [0, 1], (rows, columns, 3)."""
    path = tmp_path / "picture.png"
    render(*arguments, path, **{"width": 64, "height": 48, **options})
    return imread(path)[..., :3].astype(float)


def background(tmp_path, **options) -> np.ndarray:
    far = np.array([[0, 0, 0], [1e-9, 0, 0], [0, 0, 0]])  # no area: nothing to see
    return pixels(tmp_path, far, [[0, 1, 2]], np.ones(3), **options)


def test_the_picture_has_the_size_that_was_asked_for(tmp_path):
    assert pixels(tmp_path, SQUARE, HALVES, np.ones(4), width=50, height=20).shape == (20, 50, 3)


def test_the_mesh_fills_the_picture_and_touches_no_border(tmp_path):
    empty = background(tmp_path)
    for up in ((0, 0, 1), (0, 1, 0)):
        rng = np.random.default_rng(3)
        vertices = rng.normal(size=(40, 3)) * (1.0, 2.0, 5.0) * 1e6 + 1e7
        picture = pixels(tmp_path, vertices, rng.integers(0, 40, (60, 3)), np.ones(40), up=up)
        rows, columns = np.nonzero(np.abs(picture - empty).sum(axis=2) > 0.02)
        assert rows.min() >= 1 and columns.min() >= 1 and rows.max() <= 46 and columns.max() <= 62
        assert np.ptp(rows) > 0.8 * 48 or np.ptp(columns) > 0.8 * 64


def test_up_is_up_and_right_is_right(tmp_path):
    # From +x, y points to the right and z upwards.
    colors = np.where(SQUARE[:, 1:2] > 0, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    picture = pixels(tmp_path, SQUARE, HALVES, colors, **FRONT)
    assert picture[24, 45, 0] > picture[24, 45, 2] and picture[24, 19, 0] < picture[24, 19, 2]
    bright = pixels(tmp_path, SQUARE, HALVES, (SQUARE[:, 2] + 1.0) / 2.0, **FRONT)
    column = bright[6:42, 32].sum(axis=1)
    assert (np.diff(column) < 0).all()  # brightest on top, smoothly down


def test_nearer_things_hide_farther_ones_in_any_order(tmp_path):
    near = SQUARE + np.array([1.0, 0.0, 0.0])
    vertices, colors = np.vstack([SQUARE, near]), np.repeat([1.0, 0.0], 4)
    both = np.vstack([HALVES, HALVES + 4])
    pictures = [pixels(tmp_path, vertices, faces, colors, **FRONT) for faces in (both, both[::-1])]
    assert np.array_equal(*pictures)
    assert (pictures[0][24, 32] == 0.0).all()


def test_the_picture_depends_on_neither_winding_nor_position_nor_size(tmp_path):
    grey = np.array([0.2, 0.5, 0.7, 0.9])
    picture = pixels(tmp_path, SQUARE, HALVES, grey)
    assert np.array_equal(picture, pixels(tmp_path, SQUARE, HALVES[:, ::-1], grey))
    assert np.array_equal(picture, pixels(tmp_path, SQUARE * 2.0**40, HALVES, grey))
    assert np.abs(picture - pixels(tmp_path, SQUARE + 1000.0, HALVES, grey)).max() <= 1.01 / 255


def test_colours_of_faces_are_flat_and_grey_is_three_equal_channels(tmp_path):
    picture = pixels(tmp_path, SQUARE, HALVES, np.array([0.0, 1.0]), **FRONT)
    upper, lower = picture[14, 26], picture[34, 38]
    assert (lower == 0.0).all() and (upper > 0.5).all()
    grey, rgb = np.array([0.3, 0.4, 0.5, 0.6]), np.repeat([[0.3], [0.4], [0.5], [0.6]], 3, axis=1)
    assert np.array_equal(pixels(tmp_path, SQUARE, HALVES, grey), pixels(tmp_path, SQUARE, HALVES, rgb))


def test_unshaded_colours_are_shown_as_they_are(tmp_path):
    """Linear 0.2140 is half way up the sRGB curve; shading would take something off it."""
    colors = np.tile([0.21404, 0.0, 1.0], (4, 1))
    picture = pixels(tmp_path, SQUARE, HALVES, colors, shaded=False, **FRONT)
    np.testing.assert_allclose(picture[24, 32], [0.5, 0.0, 1.0], atol=1 / 255)
    assert picture[24, 32, 2] > pixels(tmp_path, SQUARE, HALVES, colors, **FRONT)[24, 32, 2]


def test_edges_are_smoothed(tmp_path):
    # A slanted edge between black and white, so that some pixels are cut.
    colors = np.array([0.0, 1.0])
    turned = SQUARE @ np.array([[1, 0, 0], [0, 0.96, 0.28], [0, -0.28, 0.96]])
    inside = pixels(tmp_path, turned, HALVES, colors, **FRONT)[16:32, 24:40, 1]
    levels = np.unique(np.round(inside, 2))
    assert len(levels[(levels > 0.1) & (levels < 0.9 * levels.max())]) >= 2


def test_a_camera_sees_every_vertex():
    vertices = np.random.default_rng(0).normal(size=(100, 3)) * (1, 10, 0.1)
    for up in np.eye(3):
        for azimuth in range(0, 360, 45):
            camera = automatic_camera(vertices, 4 / 3, up, azimuth, 30.0)
            offset = vertices - camera.position
            depth = offset @ camera.forward
            assert (depth > 0).all()
            x = offset @ camera.right / depth / (camera.half_height * 4 / 3)
            y = offset @ camera.up / depth / camera.half_height
            # As large as it goes: one of the two reaches the margin on both sides.
            assert max(np.ptp(x), np.ptp(y)) == pytest.approx(1.8, rel=1e-9)
            assert max(np.abs(x).max(), np.abs(y).max()) == pytest.approx(0.9, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"colors": np.ones(3)}, r"colors has shape \(3,\).*4 vertices or 2 faces"),
        ({"colors": np.ones((4, 4))}, r"colors has shape \(4, 4\)"),
        ({"normals": np.ones(3)}, r"normals has shape \(3,\)"),
        ({"normals": np.ones((2, 3))}, "normals has 2 rows"),
        ({"width": 0}, "width is 0"),
        ({"height": 1.5}, "height is 1.5"),
        ({"width": 10**6}, "width is 1000000"),
        ({"up": (0, 0, 0)}, "up is"),
        ({"faces": [[0, 1, 9]]}, "faces has indices"),
        ({"path": "picture.jpg"}, "unknown suffix '.jpg'; expected one of .png"),
        ({"path": "none/picture.png"}, "does not exist"),
    ],
)
def test_bad_input_is_refused_in_one_line(tmp_path, monkeypatch, change, told):
    monkeypatch.chdir(tmp_path)
    good = {"vertices": SQUARE, "faces": HALVES, "colors": np.ones(4), "path": "picture.png"}
    with pytest.raises(InputError) as caught:
        render(**{**good, **change})
    assert re.search(told, str(caught.value)) and "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []
