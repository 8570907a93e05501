"""Irradiance: light from an environment past a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from scenes import polyhedra
from scenes.clutter import clutter
from silint import Environment, InputError, Scene, SilhouetteIntegrator
from silint.reference import embree_available
from silint.validation import rotation_matrix

FAMILY = "octahedral"  # radial isolines: test_radial_light.py
SUN = np.array([0.48, 0.6, 0.64])


def turned(vertices: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return vertices @ rotation.T


def smooth_light(w: np.ndarray) -> np.ndarray:
    """Polynomials of the second degree, positive; each channel its own."""
    x, y, z = w.T
    return np.stack([1.5 + x * y, 1 + 0.5 * z, 2 - z * z + 0.3 * x], axis=1)


def sunny(height: int = 64) -> Environment:
    """A sun of a few texels, 1e4 times the sky."""

    def light(w: np.ndarray) -> np.ndarray:
        sky = np.stack([1 + 0.2 * w[:, 1], np.ones(len(w)), 1.2 - 0.2 * w[:, 0]], axis=1)
        return np.where((w @ SUN > 0.995)[:, None], 1e4, sky)

    return Environment.from_function(light, height)


@pytest.fixture(scope="module")
def scene() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*clutter(2, 1, seed=2)))


@pytest.fixture(scope="module")
def question(scene: SilhouetteIntegrator) -> tuple[np.ndarray, np.ndarray]:
    p, n, valid = scene.scene.face_centers_normals()
    rows = np.flatnonzero(valid)[:: max(len(p) // 60, 1)][:60]
    return p[rows] + 1e-4 * n[rows], n[rows]


@pytest.mark.parametrize("radiance", [0.7, (1.0, 2.0, 0.25)])
@pytest.mark.parametrize("isolines", [7, 64])
def test_a_constant_environment_gives_pi_l_times_ambient_occlusion(
    scene: SilhouetteIntegrator, question: Any, radiance: Any, isolines: int
) -> None:
    got = scene.irradiance(*question, Environment.constant(radiance), isolines, FAMILY)
    ao = scene.ambient_occlusion(*question, isolines=isolines, method=FAMILY)
    want = np.pi * ao[:, None] * np.broadcast_to(radiance, 3)
    np.testing.assert_allclose(got, want, rtol=1e-12, atol=1e-14)


def test_nothing_reaches_a_closed_room() -> None:
    vertices, faces = polyhedra.closed_room()
    room = SilhouetteIntegrator(Scene(vertices, faces))
    p = vertices.mean(axis=0)[None] + [[0.1, 0.05, -0.02]]
    assert room.irradiance(p, [[0.3, -0.5, 0.8]], sunny(), method=FAMILY).max() == 0.0


def test_open_sky_is_the_map_s_own_irradiance() -> None:
    """Without occluders only the horizon's strips err, as isolines^-2: 2e-4 at 64, 16 times less at 256."""
    far = SilhouetteIntegrator(Scene([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0.0]], [[0, 1, 2]]))
    environment = Environment.from_function(smooth_light, 64)
    rng = np.random.default_rng(0)
    n = rng.normal(size=(40, 3))
    p = np.full((40, 3), 50.0)
    want = environment.irradiance(n)
    for isolines, tolerance in ((64, 1e-3), (256, 1e-4)):
        got = far.irradiance(p, n, environment, isolines, FAMILY)
        assert np.abs(got / want - 1.0).max() < tolerance


@pytest.mark.skipif(not embree_available(), reason="the oracle casts rays")
@pytest.mark.parametrize("environment", [Environment.from_function(smooth_light, 32), sunny(32)])
def test_against_rays_to_every_part_of_every_texel(
    scene: SilhouetteIntegrator, question: Any, environment: Environment
) -> None:
    """The oracle samples 8 x 8 places in each of the texels; nothing but the map is shared."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    p, n = question[0][::4], question[1][::4]
    height, parts = 32, 8
    v = (np.arange(height * parts) + 0.5) / (height * parts)
    u = (np.arange(2 * height * parts) + 0.5) / (2 * height * parts)
    phi, theta = 2 * np.pi * (u - 0.5), np.pi * v
    w = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.cos(phi),
            np.cos(theta)[:, None] * np.ones_like(phi),
            np.sin(theta)[:, None] * np.sin(phi),
        ),
        axis=-1,
    ).reshape(-1, 3)
    solid = np.repeat(np.sin(theta) * (np.pi / (height * parts)) ** 2, len(u))
    light = environment.radiance(w) * solid[:, None]
    rays = EmbreeScene(robust=True)
    vertices = scene.scene.vertices.astype(np.float32)
    TriangleMesh(rays, vertices, scene.scene.faces.astype(np.int32))
    want = np.empty((len(p), 3))
    for i in range(len(p)):
        up = w @ n[i] > 0
        origins = np.broadcast_to(p[i], w[up].shape).astype(np.float32)
        hit = rays.run(origins, w[up].astype(np.float32), query="OCCLUDED") >= 0
        want[i] = ((w[up] @ n[i])[:, None] * light[up])[~hit].sum(axis=0)
    got = scene.irradiance(p, n, environment, 512, FAMILY)
    # Texels' parts that a silhouette crosses: a thousandth of the light, as 256 x 512 samples have it; a sun
    # of eight texels counts for much more where a silhouette crosses it.
    scale = want.mean()
    assert np.sqrt(np.mean((got - want) ** 2)) < (2e-3 if light.max() < 1 else 2e-2) * scale


def test_turning_mesh_and_environment_together_changes_nothing(
    scene: SilhouetteIntegrator, question: Any
) -> None:
    """But for the isolines, which stay: 64 of them err by 1e-3 or so."""
    p, n = question
    environment = Environment.from_function(smooth_light, 64)
    rotation = rotation_matrix(((0.3, -0.8, 0.5), 77.0), "turn")
    moved = SilhouetteIntegrator(Scene(turned(scene.scene.vertices, rotation), scene.scene.faces))
    got = moved.irradiance(
        turned(p, rotation), turned(n, rotation), environment.rotated(rotation), 256, FAMILY
    )
    want = scene.irradiance(p, n, environment, 256, FAMILY)
    assert np.sqrt(np.mean((got - want) ** 2)) < 2e-3 * want.mean()


def test_value_is_the_same_alone_and_in_company(scene: SilhouetteIntegrator, question: Any) -> None:
    p, n = question
    environment = sunny()
    together = scene.irradiance(p, n, environment, 16, FAMILY)
    order = np.random.default_rng(1).permutation(len(p))
    np.testing.assert_array_equal(
        scene.irradiance(p[order], n[order], environment, 16, FAMILY), together[order]
    )
    np.testing.assert_array_equal(scene.irradiance(p[3:4], n[3:4], environment, 16, FAMILY), together[3:4])


def test_grey_light_costs_one_channel_and_gives_three_columns(
    scene: SilhouetteIntegrator, question: Any
) -> None:
    grey = Environment.from_function(lambda w: 1.0 + 0.5 * w[:, 1], 64)
    colours = Environment.from_array(np.repeat(grey.texel_radiance, 3, axis=2) * [1.0, 1.0, 1.0 + 1e-3])
    assert (grey.channels, colours.channels) == (1, 3)
    assert grey.moment_table(16).table.values.shape[-1] == 3
    assert colours.moment_table(16).table.values.shape[-1] == 9
    got, want = (
        scene.irradiance(*question, grey, 16, FAMILY),
        scene.irradiance(*question, colours, 16, FAMILY),
    )
    assert got.shape == want.shape == (len(question[0]), 3)
    np.testing.assert_allclose(got[:, 0], want[:, 0], rtol=1e-12)
    np.testing.assert_array_equal(got[:, 0], got[:, 2])


def test_the_same_from_kept_visibility(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = sunny()
    kept = scene.visibility(*question, isolines=32)
    direct = scene.irradiance(*question, environment, 32, FAMILY)
    np.testing.assert_array_equal(kept.irradiance(environment), direct)
    # Relit without looking at the scene again.
    other = environment.rotated(((0, 1, 0), 90.0))
    np.testing.assert_array_equal(kept.irradiance(other), scene.irradiance(*question, other, 32, FAMILY))


def test_tolerance_and_full_output(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = Environment.from_function(smooth_light, 64)
    found = scene.irradiance(*question, environment, method=FAMILY, tolerance=0.02, full_output=True)
    assert found.value.shape == (len(question[0]), 3)
    assert found.error_estimate.max() <= 0.02
    assert found.diagnostics["above_tolerance"] == 0
    best = scene.irradiance(*question, environment, 1024, FAMILY)
    assert (np.abs(found.value - best).max(axis=1) <= 0.02).mean() >= 0.95


@pytest.mark.parametrize("environment", [Environment.from_function(smooth_light, 32), sunny(32)])
def test_estimates_hold(scene: SilhouetteIntegrator, question: Any, environment: Environment) -> None:
    """For 95 % of points, as for all integrands: measured 96 and 99 %; 180 numbers scatter by 1.6 %.

    Half of it holds for 88 and 94 %.
    """
    truth = scene.irradiance(*question, environment, 1024)
    held = []
    for k in (32, 64, 128):
        found = scene.irradiance(*question, environment, k, full_output=True)
        held.append(np.abs(found.value - truth).max(axis=1) <= found.error_estimate + 1e-9 * truth.max())
    assert np.mean(held) >= 0.945


def test_what_is_built_and_left_out(scene: SilhouetteIntegrator) -> None:
    parts = {
        name: scene.explain("irradiance", method=FAMILY, environment=environment).as_dict()["light table"]
        for name, environment in (("sun", sunny()), ("constant", Environment.constant(2.0)), ("none", None))
    }
    assert parts["sun"]["built"] and "9 columns" in parts["sun"]["reason"]
    assert parts["sun"]["bytes"] == sunny().moment_table(64).table.values.nbytes
    assert not parts["constant"]["built"]
    assert parts["none"]["built"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"environment": np.ones((4, 8, 3))}, "environment is a ndarray; expected a silint.Environment"),
        ({"method": "magic"}, "method is 'magic'"),
        ({"isolines": 0}, "isolines is 0"),
        ({"isolines": 16, "tolerance": 1e-2}, "isolines and tolerance given"),
    ],
)
def test_refusals(scene: SilhouetteIntegrator, question: Any, options: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told.replace("(", r"\(")) as caught:
        scene.irradiance(*question, **{"environment": Environment.constant(1.0), **options})
    assert "\n" not in str(caught.value)


def test_transfer_times_harmonics_is_irradiance_over_pi(scene: SilhouetteIntegrator, question: Any) -> None:
    """Light of degree 2 is all in 9 numbers; both sides err by 512 isolines."""
    light = Environment.from_function(smooth_light, 128)
    transfer = scene.sh_transfer(*question, max_degree=2, isolines=512)
    direct = scene.irradiance(*question, light, 512, FAMILY)
    difference = np.pi * transfer @ light.sh(2) - direct
    assert np.sqrt(np.mean(difference**2)) < 1e-3 * direct.mean()
