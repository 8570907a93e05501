from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from silint.validation import (
    InputError,
    choice,
    colour,
    finite_array,
    finite_number,
    mesh_arrays,
    normals_array,
    points_array,
    positive_int,
    rotation_about,
    rotation_matrix,
    unit_vector,
)

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def refusal(function, *arguments, **options) -> str:
    """The message of the InputError that a call must raise; always a single line."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message and message
    return message


# ----------------------------------------------------------------------------------------------- points


@pytest.mark.parametrize(
    ("given", "is_float32"),
    [
        (TRIANGLE, False),
        (np.array(TRIANGLE), False),
        (np.array(TRIANGLE, np.float32), True),
        (np.array(TRIANGLE, np.float16), True),
        (np.array(TRIANGLE, np.int16), False),
        (np.array(TRIANGLE, ">f8"), False),
        (np.array(TRIANGLE, np.longdouble), False),
        (np.asfortranarray(TRIANGLE), False),
        (np.zeros((6, 6))[::2, ::2] + TRIANGLE, False),
        (np.repeat(TRIANGLE, 2, axis=1)[:, ::2], False),
        (np.zeros((0, 3)), False),
        ([], False),
    ],
    ids=lambda x: None if isinstance(x, bool) else f"{getattr(x, 'dtype', 'list')}",
)
def test_points_of_any_dtype_and_layout_become_contiguous_float64(given, is_float32):
    points, came_as_float32 = points_array(given)
    assert points.dtype == np.float64 and points.dtype.isnative
    assert points.flags.c_contiguous and points.flags.aligned
    assert points.shape == (np.size(given) // 3, 3)
    assert np.array_equal(points, np.reshape(np.asarray(given, np.float64), (-1, 3)))
    assert came_as_float32 is is_float32


def test_a_read_only_array_is_taken_as_it_is():
    given = np.array(TRIANGLE)
    given.setflags(write=False)
    points, _ = points_array(given)
    assert np.shares_memory(points, given)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([1.0, 2.0, 3.0], r"here has shape \(3,\); expected \(n, 3\): write \[\[x, y, z\]\]"),
        (5.0, r"shape \(\)"),
        ([[1.0, 2.0]], r"shape \(1, 2\); expected \(n, 3\)"),
        (np.zeros((2, 3, 1)), r"shape \(2, 3, 1\)"),
        ([[1.0, 2.0], [3.0]], "not a rectangular array"),
        ([["a", "b", "c"]], "real numbers"),
        ([[1j, 0, 0]], "complex"),
        ([[True, False, True]], "bool"),
        (None, "object"),
        ([[0, 0, 0], [0, np.nan, 0]], r"finite.*row 1$"),
        (np.full((9, 3), np.inf), r"rows 0, 1, 2, 3, 4, \.\.\. \(9 in all\)"),
    ],
)
def test_points_that_are_none_are_refused_in_one_line(given, told):
    message = refusal(points_array, given, "here")
    assert message.startswith("here ") and re.search(told, message), message


# ---------------------------------------------------------------------------------------------- normals


@given(
    st.lists(
        st.floats(-1.0, 1.0, width=32).filter(lambda x: x == 0.0 or abs(x) > 1e-3), min_size=3, max_size=3
    )
    .filter(any)
    .map(np.array),
    st.integers(-1000, 1000),
)
def test_normals_are_unit_and_do_not_depend_on_their_scale(vector, exponent):
    scaled = np.ldexp(vector, exponent)
    unit = normals_array([vector], 1)
    # Three roundings of a square, a root and a quotient: within 4 ulp of 1.
    assert abs(np.linalg.norm(unit) - 1.0) <= 4 * np.finfo(float).eps
    assert np.allclose(np.cross(unit[0], vector), 0.0, atol=1e-15)
    assert np.array_equal(normals_array([scaled], 1), unit)


def test_the_largest_and_the_smallest_normals_there_are():
    tiny, huge = 5e-324, 1.7e308
    unit = normals_array([[0, tiny, 0], [huge, huge, huge], [-tiny, 0, tiny]], 3)
    s2, s3 = 0.5**0.5, 3.0**-0.5
    assert np.allclose(unit, [[0, 1, 0], [s3, s3, s3], [-s2, 0, s2]], rtol=1e-15, atol=0)


@pytest.mark.parametrize(
    ("given", "n", "told"),
    [
        ([[0, 0, 1]], 2, "has 1 rows, but there are 2 points"),
        ([[0, 0, 0]], 1, "must not be zero; row 0"),
        ([[0, 0, 1], [0, -0.0, 0], [1, 0, 0], [0, 0, 0]], 4, "zero; rows 1, 3"),
        ([[0, 0, np.inf]], 1, "finite.*row 0"),
        ([[0, np.nan, 1]], 1, "finite.*row 0"),
        ([0, 0, 1], 1, r"shape \(3,\)"),
    ],
)
def test_normals_that_have_no_direction_are_refused(given, n, told):
    message = refusal(normals_array, given, n)
    assert message.startswith("normals ") and re.search(told, message), message


def test_unit_vector():
    assert np.array_equal(unit_vector([0, 0, 5], "up"), [0, 0, 1])
    assert np.allclose(unit_vector((3e300, 4e300, 0), "up"), [0.6, 0.8, 0.0], rtol=1e-15)
    for bad in ([0, 0, 0], [1, 2], [[0, 0, 1]], [np.nan, 0, 1], "z", None, [1, 2, "x"]):
        assert refusal(unit_vector, bad, "up").startswith("up ")


# ------------------------------------------------------------------------------------------------- mesh


def test_a_mesh_becomes_float64_and_int32():
    vertices, faces, came_as_float32 = mesh_arrays(
        np.array(TRIANGLE, np.float32), np.array([[0, 1, 2]], np.uint64)
    )
    assert vertices.dtype == np.float64 and vertices.flags.c_contiguous
    assert faces.dtype == np.int32 and faces.flags.c_contiguous and faces.tolist() == [[0, 1, 2]]
    assert came_as_float32
    assert not mesh_arrays(TRIANGLE, [[0, 1, 2]])[2]


def test_defects_are_not_errors():
    mesh_arrays([*TRIANGLE, [9, 9, 9]], [[0, 1, 2], [0, 1, 2], [2, 1, 0], [1, 1, 1]])


@pytest.mark.parametrize(
    ("vertices", "faces", "told"),
    [
        ([], [[0, 1, 2]], "vertices is empty"),
        (np.zeros((0, 3)), np.zeros((0, 3), int), "vertices is empty"),
        (TRIANGLE, [], "faces is empty"),
        (TRIANGLE, np.zeros((0, 3), int), "faces is empty"),
        (TRIANGLE, [0, 1, 2], r"faces has shape \(3,\); expected \(F, 3\)"),
        (TRIANGLE, [[0, 1, 2, 0]], "split polygons into triangles"),
        (TRIANGLE, [[0.0, 1.0, 2.0]], "float64; expected integer"),
        (TRIANGLE, [[0, 1, 3]], r"outside 0\.\.2 \(there are 3 vertices\); row 0.*\[0, 1, 3\]"),
        (TRIANGLE, [[0, 1, 2], [0, -1, 2]], r"row 1, the first of them \[0, -1, 2\]"),
        (TRIANGLE, np.array([[0, 1, 2**63]], np.uint64), r"outside 0\.\.2"),
        (TRIANGLE, [[0, 1], [2]], "not a rectangular"),
        (TRIANGLE, [[True, False, True]], "bool"),
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], "vertices must be finite.*row 1"),
        ([[0, 0, 0], [1, 0, 0], [0, -np.inf, 0]], [[0, 1, 2]], "vertices must be finite.*row 2"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], r"vertices has shape \(3, 2\)"),
    ],
)
def test_what_is_no_mesh_is_refused(vertices, faces, told):
    message = refusal(mesh_arrays, vertices, faces)
    assert re.search(told, message), message


def test_more_faces_than_32_bits_can_count_are_refused():
    # A broadcast array: as many rows, and no memory.
    faces = np.broadcast_to(np.array([0, 1, 2]), (2**31 // 3 + 1, 3))
    assert "at most" in refusal(mesh_arrays, TRIANGLE, faces)
    vertices = np.broadcast_to(np.array([0.0, 1.0, 2.0]), (2**31, 3))
    assert "at most" in refusal(mesh_arrays, vertices, [[0, 1, 2]])


# ----------------------------------------------------------------------------------------- small things


def test_positive_int():
    assert positive_int(64, "isolines") == 64
    assert type(positive_int(np.int32(7), "isolines")) is int
    assert positive_int(np.array(7), "isolines") == 7
    assert positive_int(0, "seed", minimum=0) == 0
    for bad in (0, -1, 1.0, "8", None, True, np.True_, np.array([4]), 2**70):
        assert refusal(positive_int, bad, "isolines", maximum=65536).startswith("isolines is ")
    assert refusal(positive_int, 9, "n", 1, 8) == "n is 9; expected an integer, 1 to 8"


def test_choice():
    assert choice("auto", "method", ("auto", "exact")) == "auto"
    assert refusal(choice, "best", "method", ("auto", "exact")) == (
        "method is 'best'; expected one of 'auto', 'exact'"
    )
    for bad in (None, 3, ["auto"], np.array("auto"), "x" * 1000, "a\nb"):
        assert len(refusal(choice, bad, "method", ("auto", "exact"))) < 150


def test_finite_number():
    assert finite_number("1e3", "rotate") == finite_number(np.float32(1000), "rotate") == 1000.0
    for bad in (None, "north", np.nan, -np.inf, True, [1, 2]):
        assert refusal(finite_number, bad, "rotate").startswith("rotate is ")


def test_colour():
    for value in (2, [2.0], np.float32([2, 2, 2])):
        found = colour(value, "zenith")
        assert found.dtype == np.float64 and found.tolist() == [2.0, 2.0, 2.0]
    for bad in (-1, [1, 2], [[1, 2, 3]], [1, np.nan, 1], np.inf, None, "red", [[1], [2, 3]]):
        assert "zenith is" in refusal(colour, bad, "zenith")


@pytest.mark.parametrize("axis", range(3))
def test_rotations_turn_counter_clockwise(axis):
    e = np.eye(3)
    quarter = rotation_about(e[axis], 90.0)
    np.testing.assert_array_equal(quarter @ e[(axis + 1) % 3], e[(axis + 2) % 3])
    np.testing.assert_array_equal(rotation_about(e[axis], -90.0), quarter.T)
    np.testing.assert_array_equal(rotation_about(e[axis], 720.0), e)
    third = rotation_about(e[axis], 30.0)
    np.testing.assert_allclose(third @ third @ third, quarter, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(rotation_matrix((3.0 * e[axis], 30.0), "turn"), third)
    np.testing.assert_allclose(rotation_matrix(third.astype(np.float32), "turn"), third, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (np.ones((3, 4)), "turn has shape (3, 4); expected a (3, 3) matrix, or (axis, degrees)"),
        (np.ones((3, 3)), "turn is not orthonormal"),
        (np.full((3, 3), np.inf), "turn is not orthonormal"),
        (-np.eye(3), "turn is a reflection"),
        ([[1], [2, 3]], "turn is not a rectangular array"),
        (((0, 0), 30.0), "turn axis has shape (2,)"),
        (((0, 0, 1), "far"), "turn angle is 'far'"),
    ],
)
def test_what_is_no_rotation_is_refused(given, told):
    assert refusal(rotation_matrix, given, "turn").startswith(told)


def test_an_input_error_is_a_value_error():
    assert issubclass(InputError, ValueError)


# ------------------------------------------------------------------------------------------ finite_array


def test_finite_arrays_keep_what_fits_and_convert_the_rest():
    given = np.arange(6.0).reshape(2, 3)
    assert finite_array(given, "x", [(2, 3)], "rows") is given
    for other in (given.astype(np.float32), given.astype(int), given.T.copy().T, given.tolist()):
        out = finite_array(other, "x", [(6,), (2, 3)], "rows")
        assert out.dtype == np.float64 and out.flags.c_contiguous and np.array_equal(out, given)
    assert finite_array([], "x", [(0,)], "rows").shape == (0,)
    assert finite_array(np.zeros((0, 3)), "x", [(0, 3)], "rows").shape == (0, 3)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (np.zeros((3, 2)), r"x has shape \(3, 2\); expected \(6,\) or \(2, 3\): rows"),
        (np.zeros(7), r"x has shape \(7,\)"),
        (1.0, r"x has shape \(\)"),
        ([[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]], "x must be finite; NaN or infinity in row 1"),
        (np.full(6, np.inf), "x must be finite; NaN or infinity in rows 0, 1"),
        # A signalling NaN, which must not warn on its way either.
        (np.frombuffer(b"\x01\x00\x80\x7f" * 6, "<f4"), "x must be finite"),
        ([[1.0], [2.0, 3.0]], "x is not a rectangular array"),
        (["a"] * 6, "x has dtype"),
        (np.zeros(6, complex), "x has complex numbers"),
        (np.zeros(6, bool), "x has dtype bool"),
    ],
)
def test_what_is_no_finite_array_of_that_shape_is_refused(data, told):
    with pytest.raises(InputError, match=told) as caught:
        finite_array(data, "x", [(6,), (2, 3)], "rows")
    assert "\n" not in str(caught.value)
