"""silint.sh as users call it: identities, other conventions, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.special
from scipy.spatial.transform import Rotation

import silint
from silint import InputError, sh

ROUNDING = 1e-12
R = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def some(max_degree: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(5).normal(size=(*shape, (max_degree + 1) ** 2))


def refusal(function: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    message = str(caught.value)
    assert message and "\n" not in message
    return message


def test_it_is_reached_from_the_package() -> None:
    assert silint.sh is sh and "sh" in dir(silint)
    assert set(sh.__all__) <= set(dir(sh))


def test_evaluate_takes_any_length_of_direction() -> None:
    w = units(5)
    found = sh.evaluate((7.0 * w).tolist(), 3)
    assert found.shape == (5, 16)
    np.testing.assert_allclose(found, sh.evaluate(w, 3), rtol=0, atol=1e-15)
    np.testing.assert_allclose(found[:, 1:4], np.sqrt(3 / (4 * np.pi)) * w[:, [1, 2, 0]], rtol=0, atol=1e-15)
    assert sh.evaluate(np.zeros((0, 3)), 2).shape == (0, 9)


def test_project_finds_what_a_function_was_made_of() -> None:
    x = some(6)
    found = sh.project(lambda w: sh.evaluate(w, 6) @ x, 6)
    np.testing.assert_allclose(found, x, rtol=0, atol=ROUNDING)
    # Cut at a lower degree, and in channels.
    channels = sh.project(lambda w: sh.evaluate(w, 6) @ np.stack([x, 2 * x], axis=1), 3, exact_degree=9)
    np.testing.assert_allclose(channels, np.stack([x, 2 * x], axis=1)[:16], rtol=0, atol=ROUNDING)


def test_project_of_a_kink_converges() -> None:
    exact = sh.convolve(sh.evaluate([[0.6, 0.0, 0.8]], 8), sh.cosine_lobe(8))[0]
    error = [
        np.abs(sh.project(lambda w: np.maximum(w @ [0.6, 0.0, 0.8], 0.0), 8, exact_degree=d) - exact).max()
        for d in (30, 480)
    ]
    # The rule meets a kink: an error of second order in its spacing, 16 times finer.
    assert error[1] < error[0] / 64 and error[1] < 1e-4


def test_project_samples() -> None:
    x, w = some(4), units(200)
    values = sh.evaluate(w, 4) @ x
    np.testing.assert_allclose(sh.project_samples(3 * w, values, 4), x, rtol=0, atol=ROUNDING)
    two = sh.project_samples(w, np.stack([values, -values], axis=1), 4)
    np.testing.assert_allclose(two, np.stack([x, -x], axis=1), rtol=0, atol=ROUNDING)
    # With weights: a sum.
    weights = np.random.default_rng(0).random(200)
    found = sh.project_samples(w, values, 2, weights)
    np.testing.assert_allclose(found, sh.evaluate(w, 2).T @ (weights * values), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("max_degree", [0, 2, 16])
def test_rotate_is_projecting_the_rotated_function(max_degree: int) -> None:
    x = some(max_degree)
    expected = sh.project(lambda w: sh.evaluate(w @ R, max_degree) @ x, max_degree)
    np.testing.assert_allclose(sh.rotate(x, R), expected, rtol=0, atol=1e-10)
    # A delta at w goes to R w.
    w = units(4, 1)
    turned = sh.rotate(sh.evaluate(w, max_degree), R)
    np.testing.assert_allclose(turned, sh.evaluate(w @ R.T, max_degree), rtol=0, atol=ROUNDING)


def test_rotation_blocks_are_what_rotate_does() -> None:
    x = some(5)
    found = [block @ x[d**2 : (d + 1) ** 2] for d, block in enumerate(sh.rotation_blocks(R, 5))]
    np.testing.assert_allclose(np.concatenate(found), sh.rotate(x, R), rtol=0, atol=1e-14)


def test_a_rotation_kept_in_float32_will_do() -> None:
    x = some(8)
    found = sh.rotate(x, R.astype(np.float32))
    np.testing.assert_allclose(found, sh.rotate(x, R), rtol=0, atol=1e-5)
    # Its angles are taken, which make a rotation: nothing is gained or lost.
    assert np.isclose(np.linalg.norm(found), np.linalg.norm(x), rtol=1e-13)


def test_a_turn_may_be_given_by_axis_and_degrees() -> None:
    quarter = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_array_equal(sh.rotate(some(3), ((0, 0, 2), 90.0)), sh.rotate(some(3), quarter))


def test_convolution_is_the_integral() -> None:
    """Radiance to irradiance: int L(w) max(n.w, 0) dw, by quadrature about n."""
    x, n = some(5), units(3, 2)
    found = np.einsum("ni,i->n", sh.evaluate(n, 5), sh.convolve(x, sh.cosine_lobe(5)))
    z, weight = np.polynomial.legendre.leggauss(12)
    z, weight = 0.5 * (z + 1), 0.5 * weight
    phi = 2 * np.pi * np.arange(16) / 16
    s = np.sqrt(1 - z * z)
    local = np.stack([np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(16))], axis=-1)
    for axis, value in zip(n, found, strict=True):
        frame = Rotation.align_vectors([axis], [[0, 0, 1]])[0].as_matrix()
        radiance = sh.evaluate(local.reshape(-1, 3) @ frame.T, 5) @ x
        expected = (np.repeat(weight * z, 16) * radiance).sum() * 2 * np.pi / 16
        assert np.isclose(value, expected, rtol=0, atol=ROUNDING)


def test_the_cosine_lobe_is_the_published_one() -> None:
    expected = np.pi * np.array([1, 2 / 3, 1 / 4, 0, -1 / 24, 0, 1 / 64])
    np.testing.assert_allclose(sh.cosine_lobe(6), expected, rtol=0, atol=1e-15)


def test_windows() -> None:
    x = np.ones(25)
    lanczos, hanning = sh.window(x, "lanczos", 4), sh.window(x, "hanning", 4.0)
    at = [0, 2, 6, 12, 20]  # m = 0 of each degree
    t = np.pi * np.arange(1, 4) / 4
    np.testing.assert_allclose(lanczos[at], [1, *np.sin(t) / t, 0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(hanning[at], [1, *(0.5 + 0.5 * np.cos(t)), 0], rtol=0, atol=1e-15)
    assert not lanczos[16:].any() and not hanning[16:].any()
    # The same factor for all m of a degree, so that windowing and rotating commute.
    y = some(4)
    both = sh.rotate(sh.window(y, "lanczos", 5), R)
    np.testing.assert_allclose(both, sh.window(sh.rotate(y, R), "lanczos", 5), rtol=0, atol=ROUNDING)


def test_convert_to_what_directx_and_scipy_have() -> None:
    w = units(6, 3)
    theirs = sh.convert(sh.evaluate(w, 3), "silint", "condon-shortley")
    # DirectX: (-y, z, -x) times sqrt(3 / 4 pi).
    expected = np.sqrt(3 / (4 * np.pi)) * w[:, [1, 2, 0]] * [-1, 1, -1]
    np.testing.assert_allclose(theirs[:, 1:4], expected, rtol=0, atol=1e-15)
    theta, phi = np.arccos(w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    for m in range(-3, 4):
        if hasattr(scipy.special, "sph_harm_y"):
            y = scipy.special.sph_harm_y(3, abs(m), theta, phi)
        else:
            y = scipy.special.sph_harm(abs(m), 3, phi, theta)
        part = y.real if m == 0 else np.sqrt(2) * (y.imag if m < 0 else y.real)
        np.testing.assert_allclose(theirs[:, 12 + m], part, rtol=0, atol=1e-14)
    back = sh.convert(theirs, "condon-shortley", "silint")
    assert (back == sh.evaluate(w, 3)).all()
    assert (sh.convert(theirs, "silint", "silint") == theirs).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda x, axis: sh.rotate(x, R, axis=axis),
        lambda x, axis: sh.convolve(x, sh.cosine_lobe(3), axis=axis),
        lambda x, axis: sh.window(x, "hanning", 4, axis=axis),
        lambda x, axis: sh.convert(x, "silint", "condon-shortley", axis=axis),
    ],
    ids=["rotate", "convolve", "window", "convert"],
)
def test_any_axis_and_shape(change: Callable[[np.ndarray, int], np.ndarray]) -> None:
    x = some(3, 4, 2)
    before = x.copy()
    expected = np.array([[change(v, -1) for v in row] for row in x])
    assert (change(x, -1) == expected).all()
    assert (change(x, 2) == expected).all()
    assert (change(np.moveaxis(x, -1, 0), 0) == np.moveaxis(expected, -1, 0)).all()
    assert (change(np.swapaxes(x, 1, 2), -2) == np.swapaxes(expected, 1, 2)).all()
    assert (x == before).all()
    assert change(np.zeros((0, 16)), -1).shape == (0, 16)
    assert sh.max_degree_of(np.swapaxes(x, 1, 2), axis=1) == 3


def test_what_is_refused() -> None:
    assert "max_degree is 17" in refusal(sh.evaluate, [[0, 0, 1]], 17)
    assert "max_degree is -1" in refusal(sh.cosine_lobe, -1)
    assert "max_degree is 2.0" in refusal(sh.project, len, 2.0)
    assert "directions must not be zero; row 1" in refusal(sh.evaluate, [[0, 0, 1], [0, 0, 0]], 2)
    assert "directions has shape (2,)" in refusal(sh.evaluate, [0, 1], 2)
    assert "length 10 on axis -1" in refusal(sh.rotate, np.zeros(10), R)
    assert "length 0" in refusal(sh.max_degree_of, np.zeros((3, 0)))
    assert "degree 17" in refusal(sh.convert, np.zeros(324), "silint", "silint")
    assert "axis is 1" in refusal(sh.rotate, np.zeros(9), R, axis=1)
    assert "axis is 0.0" in refusal(sh.rotate, np.zeros(9), R, axis=0.0)
    assert "dtype complex128" in refusal(sh.rotate, np.zeros(9, complex), R)
    assert "not a rectangular array" in refusal(sh.rotate, [[1], [1, 2]], R)
    assert "must be finite; 2 of" in refusal(sh.rotate, [np.nan, 0, 0, np.inf], R)
    assert "rotation has shape (2, 2)" in refusal(sh.rotate, np.zeros(9), np.eye(2))
    assert "not orthonormal" in refusal(sh.rotate, np.zeros(9), 1.001 * np.eye(3))
    assert "reflection" in refusal(sh.rotate, np.zeros(9), np.diag([1.0, 1.0, -1.0]))
    assert "rotation has shape (3,)" in refusal(sh.rotation_blocks, [0, 0, 1], 2)
    assert "max_degree is 17" in refusal(sh.rotation_blocks, R, 17)
    assert "zonal has shape (2,)" in refusal(sh.convolve, np.zeros(9), [1.0, 2.0])
    assert "kind is 'box'" in refusal(sh.window, np.zeros(9), "box", 2)
    assert "width is 0" in refusal(sh.window, np.zeros(9), "lanczos", 0)
    assert "source is 'dx'" in refusal(sh.convert, np.zeros(9), "dx", "silint")
    assert "target is 'dx'" in refusal(sh.convert, np.zeros(9), "silint", "dx")
    assert "exact_degree is 3" in refusal(sh.project, lambda w: w, 2, exact_degree=3)
    assert "function returned values" in refusal(sh.project, lambda w: w[1:], 2)
    assert "values have shape (3,)" in refusal(sh.project_samples, units(4), np.zeros(3), 0)
    assert "weights has shape (1,)" in refusal(sh.project_samples, units(4), np.zeros(4), 0, [1.0])
    assert "directions determine 4 of the 9" in refusal(sh.project_samples, units(4), np.zeros(4), 2)
