"""Functions that a user brings: against closed forms, quadrature and transfer, and what is refused."""

from __future__ import annotations

import doctest
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import silint
from scenes import polyhedra
from scenes.mesh import concatenate, moved
from silint import InputError, Scene, SilhouetteIntegrator, Visibility, sh, tabulated
from silint.basis import Basis, sample
from silint.core.equirect import solid_angles, texel_centres
from silint.core.integrands import octahedral_sh
from silint.core.runs import horizon_runs
from silint.core.sh import open_hemisphere

K = 64
UP = np.array([[0.0, 0.0, 1.0]])
AXES = np.array([[1, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]]) / np.sqrt(3.0)


def gaussians(w: np.ndarray) -> np.ndarray:
    return np.exp(6.0 * (w @ AXES.T - 1.0))


@pytest.fixture(scope="module")
def integrator() -> SilhouetteIntegrator:
    parts = [moved(polyhedra.icosphere(1), (0.4, 0.2, 2.0)), moved(polyhedra.box(), (-1.3, 0.6, 0.9))]
    return SilhouetteIntegrator(Scene(*concatenate(parts)))


@pytest.fixture(scope="module")
def shade() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(-0.4, 0.4, (30, 3)), rng.normal(size=(30, 3)) * 0.5 + [0.0, 0.0, 1.0]


@pytest.fixture(scope="module")
def visible(integrator: SilhouetteIntegrator, shade: Any) -> Visibility:
    return integrator.visibility(*shade, K)


def disc(cosine: float, n: int = 400) -> SilhouetteIntegrator:
    """A disc that hides all within an angle of +z from the origin."""
    phi = 2 * np.pi * np.arange(n) / n
    sine = np.sqrt(1 - cosine * cosine)
    ring = np.stack([sine * np.cos(phi), sine * np.sin(phi), np.full(n, cosine)], axis=1)
    faces = [[0, i + 1, (i + 1) % n + 1] for i in range(n)]
    return SilhouetteIntegrator(Scene(np.concatenate([[[0, 0, cosine]], ring]), faces))


# ------------------------------------------------------------------------------------------------- values


@pytest.mark.parametrize(("weighting", "power"), [("uniform", 0), ("cosine", 1)])
def test_a_phong_lobe_past_a_disc(weighting: str, power: int) -> None:
    """2 pi int_0^c z^s dz for s = 8, with a further z / pi for "cosine"."""
    c, s = 0.8, 8 + power
    expected = 2 * np.pi * c ** (s + 1) / (s + 1) / (np.pi if power else 1)
    found = disc(c).integrate(np.zeros((1, 3)), UP, lambda w: np.maximum(w[:, 2], 0) ** 8, 512, weighting)
    assert found.shape == (1, 1)
    # Lines follow the rim as isolines^-1.5: 1e-4 of the lobe at 512.
    np.testing.assert_allclose(found, expected, rtol=5e-4)


def test_spherical_gaussians_against_quadrature(integrator: SilhouetteIntegrator, shade: Any) -> None:
    """A grid of 32768 directions, each seen or not by its ray against all triangles."""
    vertices, faces = integrator.scene.vertices, integrator.scene.faces
    height = 128
    w = texel_centres(height, 0, height).reshape(-1, 3)
    solid = np.repeat(solid_angles(height), 2 * height)
    p, n = shade[0][:3], shade[1][:3] / np.linalg.norm(shade[1][:3], axis=1)[:, None]
    expected = np.zeros((3, 4))
    for i in range(3):
        up = w[w @ n[i] > 0]
        free = np.ones(len(up), bool)
        for a, b, c in vertices[faces] - p[i]:
            # Inside the cone of the three sides, on the corners' side.
            sides = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)]) * np.sign(
                np.dot(np.cross(a, b), c)
            )
            free &= ~((up @ sides.T > 0).all(axis=1))
        expected[i] = (gaussians(up) * solid[w @ n[i] > 0][:, None] * (up @ n[i] / np.pi)[:, None])[free].sum(
            0
        )
    found = integrator.integrate(p, n, gaussians, 512, weighting="cosine")
    # Grid points along the silhouettes fall on either side: 6e-4 sr each, at random.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("weighting", ["uniform", "cosine"])
def test_harmonics_are_transfer_before_anything_is_given_back(visible: Visibility, weighting: str) -> None:
    found = visible.integrate(lambda w: sh.evaluate(w, 3), weighting)
    open_sky = Visibility(visible.normals, K, *horizon_runs(visible.normals, K))
    whole = open_sky.integrate(lambda w: sh.evaluate(w, 3), weighting)
    exact = open_hemisphere(visible.normals, 3, weighting)
    # Transfer's own tables have fewer nodes: below 1e-6.
    np.testing.assert_allclose(
        found + (found[:, :1] / whole[:, :1]) * (exact - whole),
        visible.sh_transfer(3, weighting),
        rtol=0,
        atol=1e-6,
    )
    # And all that is given back is of the order of isolines^-2.
    np.testing.assert_allclose(found, visible.sh_transfer(3, weighting), rtol=0, atol=5e-3)


@pytest.mark.parametrize("weighting", ["uniform", "cosine"])
def test_a_table_of_texels_is_the_function_that_it_samples(visible: Visibility, weighting: str) -> None:
    """Of both signs and as many channels as wanted."""
    height = 256
    centres = texel_centres(height, 0, height)

    def function(w: np.ndarray) -> np.ndarray:
        return np.column_stack([w[:, 0] * w[:, 1], gaussians(w), -w[:, 2]])

    table = function(centres.reshape(-1, 3)).reshape(height, 2 * height, -1)
    found = visible.integrate(table, weighting)
    assert found.shape == (30, 6)
    # Texels are even within: (1 / 256)^2 of a function's curvature, and at the ends of lines 1e-4.
    np.testing.assert_allclose(found, visible.integrate(function, weighting), rtol=0, atol=5e-4)
    # Alone, its texels are cut in other parts, whose footprints are right to first order: 1e-5.
    one = visible.integrate(table[..., 0].tolist(), weighting)
    np.testing.assert_allclose(one, found[:, :1], rtol=0, atol=5e-5)


def test_a_table_of_ones_is_the_solid_angle(visible: Visibility) -> None:
    ones = visible.integrate(np.ones((2, 4)))[:, 0]
    open_sky = Visibility(visible.normals, K, *horizon_runs(visible.normals, K))
    whole = open_sky.integrate(lambda w: np.ones(len(w)))[:, 0]
    np.testing.assert_allclose(ones / whole, visible.ambient_occlusion("uniform"), rtol=0, atol=1e-3)


def test_black_tables_are_nothing(visible: Visibility) -> None:
    assert not visible.integrate(np.zeros((4, 8, 2)), "cosine").any()


# ------------------------------------------------------------------------------- where and how it is asked


def test_one_value_however_it_is_asked(
    integrator: SilhouetteIntegrator, shade: Any, visible: Visibility
) -> None:
    expected = visible.integrate(gaussians)
    np.testing.assert_array_equal(integrator.integrate(*shade, gaussians), expected)
    table = silint.prefix_table(gaussians, K)
    np.testing.assert_array_equal(integrator.integrate(*shade, table), expected)
    np.testing.assert_array_equal(visible.integrate(table), expected)
    order = np.random.default_rng(0).permutation(30)
    np.testing.assert_array_equal(
        integrator.integrate(shade[0][order], shade[1][order], gaussians), expected[order]
    )
    np.testing.assert_array_equal(
        integrator.integrate(*shade, silint.prefix_table(gaussians, 16, 32), 16),
        integrator.integrate(*shade, silint.prefix_table(gaussians, 16, 32)),
    )
    assert integrator.integrate(np.zeros((0, 3)), np.zeros((0, 3)), gaussians).shape == (0, 4)


def test_full_output_and_tolerance(integrator: SilhouetteIntegrator, shade: Any) -> None:
    steps: list[int] = []
    found = integrator.integrate(
        *shade, gaussians, tolerance=0.02, full_output=True, progress=lambda done, _: steps.append(done)
    )
    assert found.error_estimate.max() <= 0.02 and found.diagnostics["above_tolerance"] == 0
    best = integrator.integrate(*shade, gaussians, 512)
    error = np.sqrt(((found.value - best) ** 2).sum(axis=1))
    assert (error <= 0.02).mean() >= 0.95
    assert steps[-1] == 30


def test_a_function_may_itself_ask_silint(integrator: SilhouetteIntegrator) -> None:
    def function(w: np.ndarray) -> Any:
        return integrator.ambient_occlusion(
            w[:2], w[:2] + [0, 0, 3.0], 8, method="octahedral"
        ).sum() * np.ones(len(w))

    options: dict[str, Any]
    for options in ({"isolines": 4}, {"tolerance": 100.0}):
        assert np.isfinite(integrator.integrate([[0, 0, 0]], UP, function, **options)).all()


@pytest.mark.parametrize(
    ("basis", "weighting", "told"),
    [
        (gaussians, "uniform", "4 columns for 4 of a function: f"),
        (gaussians, "cosine", "12 columns for 4 of a function: f w"),
        (np.ones((96, 192)), "uniform", "1 column for 1 of 96 x 192 texels: f"),
        (np.ones((3, 6, 2)), "cosine", "6 columns for 2 of 3 x 6 texels: f w"),
        (silint.prefix_table(gaussians, 16, 32), "uniform", "4 columns for 4 of a table brought along"),
    ],
)
def test_what_is_explained_is_built(
    integrator: SilhouetteIntegrator, basis: Any, weighting: str, told: str
) -> None:
    parts = integrator.explain("integrate", 16, weighting, basis=basis).as_dict()
    assert parts["basis table"]["built"] and told in parts["basis table"]["reason"]
    assert parts["basis table"]["bytes"] == Basis(basis, weighting).table(16).values.nbytes
    others = {name for name, part in parts.items() if part["built"] and name.endswith("table")}
    assert others == {"basis table"}


def test_what_is_explained_without_functions(integrator: SilhouetteIntegrator) -> None:
    parts = integrator.explain("integrate").as_dict()
    assert parts["basis table"]["built"] and "1 column for each function: f" in parts["basis table"]["reason"]
    parts = integrator.explain("integrate", weighting="cosine").as_dict()
    assert "3 columns for each function: f w" in parts["basis table"]["reason"]
    assert not integrator.explain("irradiance", method="octahedral").as_dict()["basis table"]["built"]


def test_examples_run() -> None:
    assert doctest.testmod(tabulated).failed == 0 and doctest.testmod(tabulated).attempted >= 8


# ----------------------------------------------------------------------------------------------- refusals


def fails(w: np.ndarray) -> np.ndarray:
    raise RuntimeError("two\nlines")


def partly_nan(w: np.ndarray) -> np.ndarray:
    return np.where(w[:, 0] > 0.5, np.nan, 1.0)


def sometimes_wide(w: np.ndarray) -> np.ndarray:
    return np.ones((len(w), 1 if len(w) == 6 else 2))


@pytest.mark.parametrize(
    ("basis", "told"),
    [
        (fails, "function raised RuntimeError for 6 directions: two lines"),
        (partly_nan, "function returned NaN or infinity for 1 of 6 directions, the first (1, 0, 0)"),
        (lambda w: np.full(len(w), np.inf), "function returned NaN or infinity for 6 of 6"),
        (
            lambda w: np.ones(len(w) + 1),
            "function returned shape (7,) for 6 directions; expected (6,) or (6, C)",
        ),
        (lambda w: np.ones((len(w), 2, 2)), "function returned shape (6, 2, 2)"),
        (lambda w: np.ones((len(w), 0)), "function returned shape (6, 0)"),
        (lambda w: 1.0, "function returned shape ()"),
        (lambda w: w[:, 0] * 1j, "function returned complex128 values; expected real numbers"),
        (lambda w: None, "function returned shape ()"),
        (sometimes_wide, "function returned 2 columns, and 1 for other directions"),
        ("sky", "basis is a str"),
        (None, "basis is a NoneType"),
        (3.0, "basis is a float"),
        ([[1.0, 2.0], [1.0]], "basis is a list of unequal rows"),
        (np.ones(8), "basis is a ndarray of shape (8,), float64"),
        (np.ones((4, 4)), "basis has shape (4, 4); expected (H, 2 H) or (H, 2 H, C), twice as wide"),
        (np.ones((4, 8, 0)), "basis has shape (4, 8, 0)"),
        (np.full((2, 4), np.nan), "basis has NaN or infinity in 8 of 8 texels"),
        (np.ones((2, 4), complex), "complex128"),
    ],
)
def test_what_cannot_be_integrated(
    integrator: SilhouetteIntegrator, visible: Visibility, basis: Any, told: str
) -> None:
    refusals: list[Callable[[], Any]] = [
        lambda: visible.integrate(basis),
        lambda: integrator.integrate([[0, 0, 0]], UP, basis),
    ]
    for refused in refusals:
        with pytest.raises(InputError) as caught:
            refused()
        assert told in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"weighting": "flat"}, "weighting is 'flat'"),
        ({"method": "radial"}, "method is 'radial'"),
        ({"isolines": 0}, "isolines is 0"),
        ({"isolines": 8}, "table has 16 isolines; this visibility has 8"),
        (
            {"weighting": "cosine"},
            "a PrefixTable of the function alone does not do; pass the function itself",
        ),
        (
            {"tolerance": 0.1},
            "tolerance needs tables for other isolines; pass the function, not a PrefixTable",
        ),
        ({"basis": gaussians, "isolines": 8, "tolerance": 0.1}, "isolines and tolerance given"),
        (
            {"basis": lambda w: np.ones((len(w), 9000)), "isolines": 64},
            "isolines is 64; the table of 9000 functions is kept to 4: pass fewer functions at a time",
        ),
    ],
)
def test_options_that_do_not_go(integrator: SilhouetteIntegrator, options: dict[str, Any], told: str) -> None:
    table = silint.prefix_table(lambda w: w[:, 0], 16, 16)
    with pytest.raises(InputError) as caught:
        integrator.integrate([[0, 0, 0]], UP, **{"basis": table, **options})
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_a_stop_is_no_fault_of_the_function() -> None:
    def stopped(w: np.ndarray) -> np.ndarray:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample(stopped, AXES, None)


def test_transfer_s_tables_are_not_touched(visible: Visibility) -> None:
    """The table of a function is its own: bits of transfer stay."""
    before = visible.sh_transfer(2)
    visible.integrate(lambda w: 5.0 * sh.evaluate(w, 2))
    np.testing.assert_array_equal(visible.sh_transfer(2), before)
    assert not octahedral_sh.sh_table(3, K).values.flags.writeable
