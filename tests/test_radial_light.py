"""Irradiance along radial isolines: a sky in cells, and suns that a line of every point passes through."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from scenes import polyhedra
from scenes.clutter import clutter
from silint import Environment, InputError, Scene, SilhouetteIntegrator
from silint.core.integrands import radial_light
from silint.core.radial import NORMAL_IN_FRAME, line_table, set_frame, set_frames
from silint.validation import rotation_matrix

SUN = np.array([0.48, 0.6, 0.64])


def units(n: int, seed: int) -> np.ndarray:
    w = np.random.default_rng(seed).normal(size=(n, 3))
    rows: np.ndarray = w / np.linalg.norm(w, axis=1, keepdims=True)
    return rows


def smooth_light(w: np.ndarray) -> np.ndarray:
    x, y, z = w.T
    return np.stack([1.5 + x * y, 1 + 0.5 * z, 2 - z * z + 0.3 * x], axis=1)


def sun_alone(direction: np.ndarray, height: int = 512) -> Environment:
    """A sun of 0.5 degrees and nothing else, of irradiance 1."""
    sunny = Environment.cie_clear_sky(direction, 1.0, 1.0, sun_radius=0.5, up="z", height=height)
    sky = Environment.cie_clear_sky(direction, 1.0, up="z", height=height)
    only = np.maximum(sunny.texel_radiance - sky.texel_radiance, 0.0)
    return Environment.from_array(only, up="z")


@pytest.fixture(scope="module")
def scene() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*clutter(2, 1, seed=2)))


@pytest.fixture(scope="module")
def far() -> SilhouetteIntegrator:
    """Nothing to see from where it is asked."""
    return SilhouetteIntegrator(Scene([[0, 0, 0], [1e-3, 0, 0], [0, 1e-3, 0.0]], [[0, 1, 2]]))


@pytest.fixture(scope="module")
def question(scene: SilhouetteIntegrator) -> tuple[np.ndarray, np.ndarray]:
    p, n, valid = scene.scene.face_centers_normals()
    rows = np.flatnonzero(valid)[:: max(len(p) // 60, 1)][:60]
    return p[rows] + 1e-4 * n[rows], n[rows]


def wall() -> SilhouetteIntegrator:
    """A square 200 wide whose upper edge is y = 0, z = 1."""
    v = [[-100, 0, -1], [100, 0, -1], [100, 0, 1], [-100, 0, 1.0]]
    return SilhouetteIntegrator(Scene(v, [[0, 1, 2], [0, 2, 3]]))


# ---------------------------------------------------------------------------------------------- the frame


@pytest.mark.parametrize("n_lines", [4, 16, 50])
def test_a_line_passes_through_the_aim(n_lines: int) -> None:
    """To rounding, unless the aim is as close to the normal as the axis is off its line."""
    normals = np.concatenate([units(400, 0), SUN + 0.03 * units(400, 1)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames, plain = np.empty((2, len(normals), 3, 3))
    set_frames(normals, SUN, n_lines, frames)
    set_frames(normals, np.zeros(3), n_lines, plain)
    one = np.empty((3, 3))
    lines = line_table(n_lines)
    closest = np.deg2rad(2.1) * np.pi / n_lines
    for n, frame, unturned in zip(normals, frames, plain, strict=True):
        set_frame(n, one)
        np.testing.assert_array_equal(unturned, one)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)
        np.testing.assert_allclose(frame @ n, NORMAL_IN_FRAME, rtol=0, atol=1e-14)
        if n @ SUN <= 0.0:
            np.testing.assert_array_equal(frame, one)
            continue
        t, m, _ = frame @ SUN
        off = np.abs(t * lines[:, 1] - m * lines[:, 0]).min()
        assert off < (1e-12 if np.linalg.norm(n - SUN) > closest else closest)


def test_as_octahedral_isolines(scene: SilhouetteIntegrator, question: Any) -> None:
    """Two families on one smooth sky: 5e-3 at 64 lines, 1e-3 at 512 (both lines' and the tables')."""
    environment = Environment.from_function(smooth_light, 64)
    want = scene.irradiance(*question, environment, 512, method="octahedral")
    for k, tolerance in ((64, 5e-3), (512, 1e-3)):
        got = scene.irradiance(*question, environment, k, method="radial")
        assert np.sqrt(np.mean((got - want) ** 2)) < tolerance * want.mean()


# ---------------------------------------------------------------------------------------------- exact values


@pytest.mark.parametrize("radiance", [0.7, (1.0, 2.0, 0.25)])
@pytest.mark.parametrize("isolines", [4, 64])
def test_a_constant_environment_gives_pi_l_times_ambient_occlusion(
    scene: SilhouetteIntegrator, question: Any, radiance: Any, isolines: int
) -> None:
    got = scene.irradiance(*question, Environment.constant(radiance), isolines, method="radial")
    ao = scene.ambient_occlusion(*question, isolines, method="radial")
    np.testing.assert_allclose(got, np.pi * ao[:, None] * np.broadcast_to(radiance, 3), rtol=1e-12)


def test_an_almost_constant_map_does_so_through_its_cells(scene: SilhouetteIntegrator, question: Any) -> None:
    """One texel differs, by 1e-6: what is left is the table of the open sky, 2e-4."""
    texels = np.full((16, 32, 3), 2.0)
    texels[3, 5] += 2e-6
    got = scene.irradiance(*question, Environment.from_array(texels), 16, method="radial")
    ao = scene.ambient_occlusion(*question, 16, method="radial")
    np.testing.assert_allclose(got, 2.0 * np.pi * np.repeat(ao[:, None], 3, axis=1), rtol=5e-4)


def test_nothing_reaches_a_closed_room() -> None:
    vertices, faces = polyhedra.closed_room()
    room = SilhouetteIntegrator(Scene(vertices, faces))
    p = vertices.mean(axis=0)[None] + [[0.1, 0.05, -0.02]]
    for environment in (sun_alone(SUN, 64), Environment.from_function(smooth_light, 32)):
        result = room.irradiance(p, [[0.3, -0.5, 0.8]], environment, method="radial", full_output=True)
        assert result.value.max() == 0.0 and result.error_estimate.max() == 0.0


@pytest.mark.parametrize("isolines", [4, 32])
def test_open_sky_is_the_map_s_own_irradiance(far: SilhouetteIntegrator, isolines: int) -> None:
    """However few the lines: only the table of normals errs, by 5e-4 of the largest."""
    environment = Environment.from_function(smooth_light, 64)
    n = units(60, 0)
    got = far.irradiance(np.full((60, 3), 50.0), n, environment, isolines, method="radial")
    np.testing.assert_allclose(got, environment.irradiance(n), rtol=1e-3)


def test_a_gradient_sky_past_an_endless_wall() -> None:
    """A wall hides y > 0, z above 0: a quarter of the sky of a floor. L = 1 + z there:

    E = int_0^pi dphi int_0^(pi/2) (1 + cos) cos sin dtheta = pi (1/2 + 1/3).
    """
    v = np.array([[-1e5, 0, 0], [1e5, 0, 0], [1e5, 0, 1e5], [-1e5, 0, 1e5]])
    integrator = SilhouetteIntegrator(Scene(v, [[0, 1, 2], [0, 2, 3]]))
    sky = Environment.from_function(lambda w: 1.0 + np.maximum(w[:, 2], 0.0), 256)
    got = integrator.irradiance([[0.0, -1e-3, 0.0]], [[0.0, 0.0, 1.0]], sky, 128, method="radial")
    # Two of 128 lines lie half behind the wall: 1 / 128 of the half, less what the radiance there is.
    np.testing.assert_allclose(got, np.pi * 5.0 / 6.0, rtol=4e-3)


# ------------------------------------------------------------------------------------------------- suns


@pytest.mark.parametrize("isolines", [4, 16, 64])
def test_the_shadow_of_a_wall_lies_where_the_sun_puts_it(isolines: int) -> None:
    """The sun rises over the wall's edge where tan(elevation) = 1 / distance; half of it, by symmetry.

    The disc is 1 degree wide; lit and dark to rounding half a degree and a texel's blur off that.
    """
    elevation = np.deg2rad(35.0)
    sun = np.array([0.0, np.cos(elevation), np.sin(elevation)])
    environment = sun_alone(sun)
    angle = np.deg2rad(35.0 + np.array([-1.0, -0.6, 0.0, 0.6, 1.0]))
    p = np.stack([[0.3] * 5, -1.0 / np.tan(angle), [0.0] * 5], axis=1)
    got = wall().irradiance(p, np.tile([0.0, 0.0, 1.0], (5, 1)), environment, isolines, method="radial")
    share = got[:, 0] / np.sin(elevation)
    # The edge rises with the angle: points under a higher edge are in the dark.
    np.testing.assert_allclose(share, [1.0, 1.0, 0.5, 0.0, 0.0], rtol=0, atol=0.02)


def test_the_penumbra_is_that_of_a_disc() -> None:
    """Past an edge level with the horizon a share of the disc shows: the area beyond a chord."""
    elevation, radius = 35.0, 0.5
    sun = np.array([0.0, np.cos(np.deg2rad(elevation)), np.sin(np.deg2rad(elevation))])
    offset = np.linspace(-0.45, 0.45, 13)
    p = np.stack([0 * offset + 0.3, -1.0 / np.tan(np.deg2rad(elevation + offset)), 0 * offset], axis=1)
    n = np.tile([0.0, 0.0, 1.0], (13, 1))
    got = wall().irradiance(p, n, sun_alone(sun), 8, method="radial")[:, 0] / np.sin(np.deg2rad(elevation))
    x = offset / radius
    want = 0.5 - (x * np.sqrt(1 - x * x) + np.arcsin(x)) / np.pi
    # The sun is drawn in texels of 0.18 degrees.
    np.testing.assert_allclose(got, want, rtol=0, atol=0.04)


def test_two_suns_are_both_seen() -> None:
    a = np.array([0.0, np.cos(0.6), np.sin(0.6)])
    b = np.array([0.0, -np.cos(0.9), np.sin(0.9)])
    both = Environment.from_array(
        sun_alone(a, 512).texel_radiance + sun_alone(b, 512).texel_radiance / 2, up="z"
    )
    # Close behind the wall: the first sun is hidden, the second on the open side.
    got = wall().irradiance([[0.0, -0.1, 0.0]], [[0.0, 0.0, 1.0]], both, 16, method="radial")
    np.testing.assert_allclose(got[0], 0.5 * np.sin(0.9), rtol=0.01)


# ------------------------------------------------------------------------------------------- invariances


def test_turning_mesh_and_environment_together_changes_little(
    scene: SilhouetteIntegrator, question: Any
) -> None:
    p, n = question
    environment = Environment.from_array(
        Environment.from_function(smooth_light, 64).texel_radiance + 0.1 * sun_alone(SUN, 64).texel_radiance
    )
    rotation = rotation_matrix(((0.3, -0.8, 0.5), 77.0), "turn")
    moved = SilhouetteIntegrator(Scene(scene.scene.vertices @ rotation.T, scene.scene.faces))
    got = moved.irradiance(p @ rotation.T, n @ rotation.T, environment.rotated(rotation), 128, "radial")
    want = scene.irradiance(p, n, environment, 128, "radial")
    # The lines stay where the sun is, but turned about it where it is below the horizon: 128 lines' error.
    assert np.sqrt(np.mean((got - want) ** 2)) < 5e-3 * want.mean()


def test_values_depend_on_the_point_alone(scene: SilhouetteIntegrator, question: Any) -> None:
    p, n = question
    environment = sun_alone(SUN, 128)

    def ask(rows: Any) -> np.ndarray:
        found: np.ndarray = scene.irradiance(p[rows], n[rows], environment, 16, "radial")
        return found

    every = ask(slice(None))
    order = np.random.default_rng(1).permutation(len(p))
    np.testing.assert_array_equal(ask(order), every[order])
    for i in range(0, len(p), 17):
        np.testing.assert_array_equal(ask([i])[0], every[i])
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        np.testing.assert_array_equal(ask(slice(None)), every)
    finally:
        numba.set_num_threads(threads)


def test_the_unit_of_radiance_is_free(scene: SilhouetteIntegrator, question: Any) -> None:
    """Powers of two to the bit, beyond what float32 holds."""
    texels = Environment.from_function(smooth_light, 32).texel_radiance.astype(np.float64)
    want = scene.irradiance(*question, Environment.from_array(texels), 8, "radial")
    got = scene.irradiance(*question, Environment.from_array(np.ldexp(texels, 400)), 8, "radial")
    np.testing.assert_array_equal(np.ldexp(got, -400), want)


# ------------------------------------------------------------------------------------- estimate, interface


def test_the_estimate_holds_for_most_points(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = Environment.from_function(smooth_light, 64)
    want = scene.irradiance(*question, environment, 1024, "radial")
    for k in (16, 64):
        result = scene.irradiance(*question, environment, k, "radial", full_output=True)
        error = np.abs(result.value - want).max(axis=1)
        assert (error <= result.error_estimate).mean() > 0.85
        assert result.error_estimate.mean() < 20 * error.mean() + 2e-3 * want.mean()


def test_auto_takes_radial_isolines(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = Environment.from_function(smooth_light, 256)
    got = scene.irradiance(*question, environment, 16)
    np.testing.assert_array_equal(got, scene.irradiance(*question, environment, 16, method="radial"))
    assert (got != scene.irradiance(*question, environment, 16, method="octahedral")).any()
    # Texels of a coarse map are no discs.
    coarse = Environment.from_function(smooth_light, 32)
    got = scene.irradiance(*question, coarse, 16)
    np.testing.assert_array_equal(got, scene.irradiance(*question, coarse, 16, method="octahedral"))
    assert scene.explain("irradiance", environment=coarse).as_dict()["light table"]["built"]


def test_a_tolerance_takes_more_lines(scene: SilhouetteIntegrator, question: Any) -> None:
    environment = Environment.from_function(smooth_light, 32)
    result = scene.irradiance(*question, environment, method="radial", tolerance=0.02, full_output=True)
    assert result.diagnostics["above_tolerance"] == 0 and result.error_estimate.max() <= 0.02


def test_bad_methods_are_refused(scene: SilhouetteIntegrator, question: Any) -> None:
    with pytest.raises(InputError, match="method is 'exact'"):
        scene.irradiance(*question, sun_alone(SUN, 32), method="exact")


def test_levels_match_cells() -> None:
    """A level's texel is at most as large as a cell, and at least a quarter."""
    for k in (4, 8, 16, 24, 64, 256):
        cells = 2 * k * radial_light.cells_a_line(k)
        assert cells <= radial_light.texels_for(k) ** 2 < 4 * cells


def test_what_is_built_and_left_out(scene: SilhouetteIntegrator) -> None:
    def parts(request: str = "irradiance", **options: Any) -> dict[str, dict[str, Any]]:
        return scene.explain(request, **options).as_dict()

    lit, grey, open_ = (
        parts(environment=e)
        for e in (sun_alone(SUN, 512), Environment.constant(1.0), Environment.cie_overcast(height=256))
    )
    assert lit["sky in cells"]["built"] and lit["sky in cells"]["bytes"] > 1 << 20
    assert lit["small sources"]["built"] and "discs" in lit["small sources"]["reason"]
    assert not grey["sky in cells"]["built"] and not grey["small sources"]["built"]
    assert open_["sky in cells"]["built"] and not open_["small sources"]["built"]
    assert parts()["sky in cells"]["built"]
    assert not parts("ambient_occlusion")["sky in cells"]["built"]


def test_turned_environments_share_what_is_made_of_the_map() -> None:
    environment = sun_alone(SUN, 512)
    turned = environment.rotated(((0, 0, 1), 90.0))
    assert turned._radial_sky is environment._radial_sky
    np.testing.assert_allclose(turned.aim, np.array([-SUN[1], SUN[0], SUN[2]]), rtol=0, atol=3e-3)


def test_dense_lines_resolve_a_sun() -> None:
    """An edge upright before the sun: only lines that cross the disc can tell how much of it is hidden."""
    radius, elevation = np.deg2rad(1.0), np.deg2rad(45.0)
    texels = np.zeros((1024, 2048, 3))
    w = np.array([0.0, np.sin(elevation), np.cos(elevation)])  # +y up, as maps are
    v, u = np.mgrid[0:1024, 0:2048]
    theta, phi = np.pi * (v + 0.5) / 1024, 2.0 * np.pi * ((u + 0.5) / 2048 - 0.5)
    directions = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=2)
    texels[directions @ w > np.cos(radius)] = 1e4
    sky = Environment.from_array(texels)
    # A wall in a plane through the point's normal, which hides x > 0.6 of the sun's half width.
    x = 0.6 * np.tan(radius) / np.sin(elevation)
    wall = Scene(
        np.array([[x, -1.0, 1.0], [5.0, -1.0, 1.0], [5.0, 5.0, 1.0], [x, 5.0, 1.0]]), [[0, 1, 2], [0, 2, 3]]
    )
    sil = SilhouetteIntegrator(wall)
    p, n = [[0.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]
    open_sky = sky.irradiance([[0.0, 1.0, 0.0]])[0, 0]
    # The part of a disc on the side of a chord at 0.6 of its radius.
    expected = 0.5 + (0.6 * 0.8 + np.arcsin(0.6)) / np.pi
    # Of 64 lines one meets the disc, and sees all of it; of 2048 some 16, each a strip of it.
    for isolines, tolerance in ((64, 0.2), (2048, 0.03)):
        result = sil.irradiance(p, n, sky, isolines=isolines, method="radial", full_output=True)
        assert abs(result.value[0, 0] / open_sky - expected) < tolerance
        assert result.error_estimate[0] > 0.5 * abs(result.value[0, 0] - expected * open_sky)
