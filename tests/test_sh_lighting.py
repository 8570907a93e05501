"""Light past a scene in spherical harmonics: closed forms, transfer, irradiance, rays, and what is built."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from scenes import polyhedra
from scenes.clutter import clutter
from silint import Environment, InputError, Scene, SilhouetteIntegrator, Visibility, lighting, sh
from silint.core.integrands import masked_light, octahedral_sh
from silint.core.integrands.light import vector_irradiance
from silint.core.texel_table import integrate_steps
from silint.reference import embree_available

SUN = np.array([0.48, 0.6, 0.64])
WEIGHTINGS = ("uniform", "cosine")


def light_of_degree_two(w: np.ndarray) -> np.ndarray:
    x, y, z = w.T
    return np.stack([1.5 + x * y, 1 + 0.5 * z, 2 - z * z + 0.3 * x], axis=1)


def sunny(height: int = 32) -> Environment:
    """A sun of a few texels, 1e4 times the sky, and a turn."""

    def light(w: np.ndarray) -> np.ndarray:
        sky = np.stack([1 + 0.2 * w[:, 1], np.ones(len(w)), 1.2 - 0.2 * w[:, 0]], axis=1)
        return np.where((w @ SUN > 0.99)[:, None], 1e4, sky)

    return Environment.from_function(light, height).rotated(((0.2, 0.9, -0.4), 50.0))


@pytest.fixture(scope="module")
def scene() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*clutter(2, 1, seed=2)))


@pytest.fixture(scope="module")
def question(scene: SilhouetteIntegrator) -> tuple[np.ndarray, np.ndarray]:
    p, n, valid = scene.scene.face_centers_normals()
    rows = np.flatnonzero(valid)[:: max(len(p) // 40, 1)][:40]
    return p[rows] + 1e-4 * n[rows], n[rows]


@pytest.fixture(scope="module")
def visible(scene: SilhouetteIntegrator, question: Any) -> Visibility:
    return scene.visibility(*question, isolines=64)


def irradiance_of_degree_one(c: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Degree 1 is (y, z, x) times sqrt(3 / 4 pi)."""
    return np.sqrt(4 * np.pi / 3) * np.einsum("nic,ni->nc", c[:, 1:4], normals[:, [1, 2, 0]])


# -------------------------------------------------------------------------------- constants and open skies


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("radiance", [0.7, (1.0, 2.0, 0.25)])
def test_a_constant_environment_gives_its_radiance_times_transfer(
    scene: SilhouetteIntegrator, question: Any, weighting: str, radiance: Any
) -> None:
    found = scene.sh_lighting(*question, Environment.constant(radiance), 3, 32, weighting)
    transfer = scene.sh_transfer(*question, 3, 32, weighting, method="octahedral")
    expected = transfer[:, :, None] * np.broadcast_to(radiance, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_a_map_of_one_radiance_nearly_does(visible: Visibility, weighting: str) -> None:
    """By tables of texels, as any map: their cells are linear where those of transfer are cubic."""
    degree = 2 + (weighting == "cosine")
    light = masked_light.harmonic_light(np.full((64, 128, 2), (1.0, 3.0)), np.eye(3), 64, degree)
    found, _ = masked_light.sh_lighting(visible.normals, visible._visible, light, 2, weighting)
    expected = visible.sh_transfer(2, weighting)[:, :, None] * [1.0, 3.0]
    # Two ends on each of some 40 lines, off by 1e-5 to 1e-4 either way: 1.8e-4 was measured.
    np.testing.assert_allclose(found / [1.0, 3.0], expected / [1.0, 3.0], rtol=0, atol=4e-4)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_an_open_half_space(weighting: str) -> None:
    """Against quadrature of the hemisphere; the lines' ends at the horizon err by isolines^-2."""
    far = SilhouetteIntegrator(Scene([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0.0]], [[0, 1, 2]]))
    normals = np.random.default_rng(0).normal(size=(12, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    z, dz = np.polynomial.legendre.leggauss(24)
    z, dz = 0.5 * (z + 1), 0.5 * dz
    phi = 2 * np.pi * np.arange(32) / 32
    s = np.sqrt(1 - z * z)
    local = np.stack([np.outer(s, np.cos(phi)), np.outer(s, np.sin(phi)), np.outer(z, np.ones(32))], axis=-1)
    weight = np.outer(dz * (z / np.pi if weighting == "cosine" else 1), np.full(32, 2 * np.pi / 32)).ravel()
    expected = []
    for n in normals:
        frame = np.linalg.svd(n[None])[2]
        w = local.reshape(-1, 3) @ np.stack([frame[1], frame[2], n])
        expected.append(np.einsum("m,my,mc->yc", weight, sh.evaluate(w, 3), light_of_degree_two(w)))
    environment = Environment.from_function(light_of_degree_two, 128)
    for isolines, tolerance in ((64, 2e-3), (256, 2e-4)):
        found = far.sh_lighting(np.full((12, 3), 50.0), normals, environment, 3, isolines, weighting)
        assert np.abs(found - expected).max() < tolerance * (1 if weighting == "cosine" else np.pi)


def test_nothing_reaches_a_closed_room() -> None:
    vertices, faces = polyhedra.closed_room()
    room = SilhouetteIntegrator(Scene(vertices, faces))
    p = vertices.mean(axis=0)[None] + [[0.1, 0.05, -0.02]]
    assert not room.sh_lighting(p, [[0.3, -0.5, 0.8]], sunny()).any()


# ----------------------------------------------------------------------------------------------- irradiance


def test_degree_zero_of_the_cosine_is_irradiance(scene: SilhouetteIntegrator, question: Any) -> None:
    for environment in (sunny(), Environment.constant(2.0)):
        found = scene.sh_lighting(*question, environment, 0, 32, "cosine")
        expected = scene.irradiance(*question, environment, 32, "octahedral")
        # The open hemisphere, which both compare with, comes from tables with other nodes: 2e-7 was measured.
        np.testing.assert_allclose(np.pi * np.sqrt(4 * np.pi) * found[:, 0], expected, rtol=1e-6)


def test_degree_one_is_vector_irradiance(visible: Visibility) -> None:
    """The same sums over the same intervals [NBMJ14 A], to rounding; before anything is given back."""
    environment = sunny()
    table = lighting.harmonic_table(environment, 64, 2)
    y = integrate_steps(table.table.values, table.table.cells_per_quarter, *visible._visible, 64)
    expected = vector_irradiance(environment.moment_table(64), *visible._visible)
    found = y.reshape(-1, 2, 3, 9)[..., [3, 1, 2]] * np.sqrt(4 * np.pi / 3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_degree_one_gives_irradiance_with_all_its_shadows(scene: SilhouetteIntegrator, question: Any) -> None:
    """What lines miss at the horizon, isolines^-2 of an even sky, is given back in two ways."""
    environment, normals = Environment.from_function(light_of_degree_two, 64), question[1]
    for isolines, tolerance in ((64, 2e-3), (256, 2e-4)):
        c = scene.sh_lighting(*question, environment, 1, isolines)
        expected = scene.irradiance(*question, environment, isolines, "octahedral")
        difference = irradiance_of_degree_one(c, normals) - expected
        assert np.abs(difference).max() < tolerance * expected.mean()


def test_convolved_with_a_clamped_cosine_it_nears_irradiance(
    scene: SilhouetteIntegrator, question: Any
) -> None:
    """The clamped cosine has all degrees, those above 1 for what lies below the horizon: dark here."""
    environment, normals = Environment.from_function(light_of_degree_two, 64), question[1]
    expected = scene.irradiance(*question, environment, 64, "octahedral")
    c = scene.sh_lighting(*question, environment, 10, 64)
    errors = []
    for degree in (2, 4, 10):
        some = c[:, : (degree + 1) ** 2]
        lit = sh.convolve(some, sh.cosine_lobe(degree), axis=1)
        at = np.einsum("nyc,ny->nc", lit, sh.evaluate(normals, degree))
        errors.append(np.sqrt(np.mean((at - expected) ** 2)) / expected.mean())
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    assert errors[2] < 1e-2


# ----------------------------------------------------------------------------------------------------- rays


@pytest.mark.skipif(not embree_available(), reason="the oracle casts rays")
@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("environment", [Environment.from_function(light_of_degree_two, 32), sunny(32)])
def test_against_rays_to_every_part_of_every_texel(
    scene: SilhouetteIntegrator, question: Any, environment: Environment, weighting: str
) -> None:
    """6 x 6 places in each texel, harmonics evaluated there; tables and intervals have no part in it."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    p, n = question[0][::5], question[1][::5]
    height = 32 * 6
    theta = (np.arange(height) + 0.5) * np.pi / height
    phi = (np.arange(2 * height) + 0.5) * np.pi / height - np.pi
    s = np.sin(theta)[:, None]
    w = np.stack([s * np.cos(phi), np.cos(theta)[:, None] + 0 * phi, s * np.sin(phi)], axis=-1).reshape(-1, 3)
    light = np.repeat(np.repeat(environment.texel_radiance, 6, axis=0), 6, axis=1).reshape(len(w), -1)
    w = w @ environment.rotation.T
    solid = np.repeat(np.sin(theta) * (np.pi / height) ** 2, 2 * height)
    y = sh.evaluate(w, 3)
    rays = EmbreeScene(robust=True)
    TriangleMesh(rays, scene.scene.vertices.astype(np.float32), scene.scene.faces.astype(np.int32))
    expected = np.empty((len(p), 16, 3))
    for i in range(len(p)):
        up = np.flatnonzero(w @ n[i] > 0)
        origins = np.broadcast_to(p[i], (len(up), 3)).astype(np.float32)
        up = up[rays.run(origins, w[up].astype(np.float32), query="OCCLUDED") < 0]
        weight = solid[up] * (w[up] @ n[i] / np.pi if weighting == "cosine" else 1)
        expected[i] = (y[up] * weight[:, None]).T @ light[up]
    found = scene.sh_lighting(p, n, environment, 3, 512, weighting)
    # Parts of texels that a silhouette crosses, as in test_irradiance.py; they count more without a cosine,
    # and those of a sun of some texels most of all.
    scale = expected[:, 0].mean()
    tolerance = 3e-3 if environment.texel_radiance.max() < 10 else 3e-2
    assert np.sqrt(np.mean((found - expected) ** 2)) < tolerance * scale


# --------------------------------------------------------------------------------------- values, bits, bytes


def test_a_value_does_not_depend_on_company_threads_or_where_it_is_asked(
    scene: SilhouetteIntegrator, question: Any
) -> None:
    p, n = question
    environment = sunny()
    together = scene.sh_lighting(p, n, environment, isolines=16)
    assert together.shape == (len(p), 9, 3) and together.dtype == np.float64
    order = np.random.default_rng(1).permutation(len(p))
    np.testing.assert_array_equal(
        scene.sh_lighting(p[order], n[order], environment, isolines=16), together[order]
    )
    np.testing.assert_array_equal(scene.sh_lighting(p[3:4], n[3:4], environment, isolines=16), together[3:4])
    kept = scene.visibility(p, n, 16)
    np.testing.assert_array_equal(kept.sh_lighting(environment), together)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        np.testing.assert_array_equal(kept.sh_lighting(sunny()), together)
    finally:
        numba.set_num_threads(threads)
    assert scene.sh_lighting(np.zeros((0, 3)), np.zeros((0, 3)), environment).shape == (0, 9, 3)


def test_lower_degrees_are_the_first_of_more(visible: Visibility) -> None:
    environment = sunny()
    for weighting in WEIGHTINGS:
        more = visible.sh_lighting(environment, 3, weighting)
        # What is given back comes from tables with other nodes: below 1e-6.
        np.testing.assert_allclose(
            visible.sh_lighting(environment, 1, weighting), more[:, :4], rtol=0, atol=1e-6 * more.max()
        )


def test_grey_light_costs_one_channel(visible: Visibility) -> None:
    grey = Environment.from_function(lambda w: 1.0 + 0.5 * w[:, 1], 64)
    colours = Environment.from_array(np.repeat(grey.texel_radiance, 3, axis=2) * [1.0, 1.0, 1.001])
    assert lighting.table_bytes(grey, 64, 2) * 3 == lighting.table_bytes(colours, 64, 2)
    found, expected = visible.sh_lighting(grey), visible.sh_lighting(colours)
    assert found.shape == expected.shape == (40, 9, 3)
    np.testing.assert_allclose(found[..., 0], expected[..., 0], rtol=0, atol=1e-12 * expected.max())
    np.testing.assert_array_equal(found[..., 0], found[..., 2])


def test_tables_are_kept_and_let_go(visible: Visibility) -> None:
    environment = sunny()
    first = lighting.harmonic_table(environment, 8, 1)
    assert lighting.harmonic_table(environment, 8, 1) is first
    for degree in (2, 3):
        lighting.harmonic_table(environment, 8, degree)
    assert lighting.harmonic_table(environment, 8, 1) is not first
    before = len(lighting._tables)
    del environment
    assert len(lighting._tables) == before - 1


def test_tolerance_and_full_output(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = Environment.from_function(light_of_degree_two, 64)
    found = scene.sh_lighting(*question, environment, tolerance=0.05, full_output=True)
    assert found.value.shape == (len(question[0]), 9, 3)
    assert found.error_estimate.max() <= 0.05 and found.diagnostics["above_tolerance"] == 0
    best = scene.sh_lighting(*question, environment, isolines=512)
    error = np.sqrt(((found.value - best) ** 2).sum(axis=1)).max(axis=1)
    assert (error <= 0.05).mean() >= 0.95


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_what_is_explained_is_built(scene: SilhouetteIntegrator, weighting: str) -> None:
    degree = 3 + (weighting == "cosine")
    environment = sunny()
    plan = scene.explain("sh_lighting", 32, weighting, max_degree=3, environment=environment)
    assert str(plan).startswith("sh_lighting, 32 octahedral isolines")
    parts = plan.as_dict()
    scene.sh_lighting([[0, 0, 9.0]], [[0, 0, 1.0]], environment, 3, 32, weighting)
    (table,) = (t for (k, _), t in lighting._tables[environment].items() if k == 32)
    light = parts["light table"]
    assert light["built"] and light["bytes"] == table.table.values.nbytes
    assert f"{3 * (degree + 1) ** 2} columns, 3 channels" in light["reason"]
    assert f"degrees 0 to {degree}" in light["reason"] and table.max_degree == degree
    assert parts["harmonics table"]["bytes"] == octahedral_sh.sh_table(degree, 32).values.nbytes
    assert not parts["basis table"]["built"] and not parts["first moment table"]["built"]


def test_what_is_explained_without_a_map(scene: SilhouetteIntegrator) -> None:
    unknown = scene.explain("sh_lighting").as_dict()
    assert (
        unknown["light table"]["built"]
        and "9 harmonics of degrees 0 to 2" in unknown["light table"]["reason"]
    )
    constant = scene.explain("sh_lighting", environment=Environment.constant(1.0)).as_dict()
    assert not constant["light table"]["built"] and constant["harmonics table"]["built"]
    environment = Environment.constant((1.0, 2.0, 3.0))
    scene.sh_lighting([[0, 0, 9.0]], [[0, 0, 1.0]], environment)
    assert environment not in lighting._tables


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"environment": np.ones((4, 8, 3))}, "environment is a ndarray; expected a silint.Environment"),
        ({"method": "radial"}, "method is 'radial'"),
        ({"weighting": "flat"}, "weighting is 'flat'"),
        ({"max_degree": 17}, "max_degree is 17"),
        ({"isolines": 0}, "isolines is 0"),
        ({"isolines": 16, "tolerance": 1e-2}, "isolines and tolerance given"),
        (
            {"environment": sunny(), "max_degree": 16, "isolines": 4096},
            "is kept to 256 octahedral ones: lower",
        ),
    ],
)
def test_refusals(scene: SilhouetteIntegrator, question: Any, options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as caught:
        scene.sh_lighting(*question, **{"environment": Environment.constant(1.0), **options})
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_refusals_of_kept_visibility(visible: Visibility) -> None:
    for arguments, told in (
        ((3.0,), "environment is a float"),
        ((sunny(), -1), "max_degree is -1"),
        ((sunny(), 2, "sine"), "weighting is 'sine'"),
    ):
        with pytest.raises(InputError) as caught:
            visible.sh_lighting(*arguments)
        assert told in str(caught.value) and "\n" not in str(caught.value)
