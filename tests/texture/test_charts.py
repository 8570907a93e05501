from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from silint import InputError
from silint.texture.charts import in_unit_square
from tests.texture.shapes import grid

SHEET = grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 4)


@given(st.integers(-5, 5), st.integers(-5, 5), st.floats(0.01, 1.0))
def test_charts_move_by_whole_squares(across, up, width):
    _, faces, uvs = SHEET
    # Two charts side by side in their squares, the second moved.
    both = np.concatenate([uvs * (0.4 * width, 1.0), uvs * (0.4 * width, 1.0) + (0.5 + across, up)])
    welded = np.concatenate([faces, faces + faces.max() + 1])
    found = in_unit_square(both, welded, 64)
    expected = both.copy()
    expected[len(faces) :] -= (across, up)
    np.testing.assert_allclose(found.uvs, expected, atol=1e-14)
    assert found.shifted == (len(faces) if across or up else 0) and found.clamped == 0


def test_a_chart_that_fills_its_square_stays_whole():
    """Faces of no width on the square's border belong to neither side by themselves."""
    _, faces, uvs = SHEET
    for shift in (0.0, 2.0, -1.0):
        found = in_unit_square(uvs + shift, faces, 4096)
        np.testing.assert_allclose(found.uvs, uvs, atol=1e-12)
        assert found.shifted == (len(faces) if shift else 0)
    thin = uvs * (1e-4, 1.0) + (1.0 - 1e-4, 0.0)
    assert np.array_equal(in_unit_square(thin, faces, 64).uvs, thin)
    np.testing.assert_allclose(in_unit_square(thin + 1.0, faces, 64).uvs, thin, atol=1e-12)


def test_a_chart_on_the_border_stays_there_whatever_others_do():
    _, faces, uvs = SHEET
    thin = uvs * (5e-4, 1.0) + (1.0 - 1e-4, 0.0)  # most of it beyond
    both = np.concatenate([thin, uvs * 0.9 + 7.0])
    found = in_unit_square(both, np.concatenate([faces, faces + faces.max() + 1]), 64)
    assert np.array_equal(found.uvs[: len(faces)], thin.clip(0.0, 1.0)) and found.shifted == len(faces)
    assert found.clamped == (thin[..., 0] > 1.0).sum()


@pytest.mark.parametrize(
    ("size", "beyond", "fine"),
    [
        (1, 0.9e-3, True),  # half a texel would be half the square
        (1, 1.1e-3, False),
        (1024, 0.45e-3, True),
        (1024, 0.55e-3, False),
        (8192, 6.5e-5, False),
        (8192, 0.9e-5, True),
    ],
)
def test_half_a_texel_is_clamped(size, beyond, fine):
    _, faces, uvs = SHEET
    stretched = uvs * (1.0 + beyond, 1.0 + beyond) - (0.0, beyond)
    if not fine:
        with pytest.raises(InputError, match="beyond the"):
            in_unit_square(stretched, faces, size)
        return
    found = in_unit_square(stretched, faces, size)
    assert np.array_equal(found.uvs, stretched.clip(0.0, 1.0)) and found.shifted == 0
    border = ((uvs[..., 0] == 1.0) | (uvs[..., 1] == 0.0)).sum()
    assert found.clamped == (border if beyond > 1e-5 else 0)


def test_charts_across_squares_and_no_numbers_are_refused():
    _, faces, uvs = SHEET
    with pytest.raises(InputError, match=r"span \[0.5, 1.5\] x \[0, 1\], beyond the \[0, 1\] of one texture"):
        in_unit_square(uvs + (0.5, 0.0), faces, 64)
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match="not finite"):
            in_unit_square(np.where(uvs == 1.0, bad, uvs), faces, 64)
