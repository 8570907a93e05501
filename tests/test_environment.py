"""Environments: where a map's light comes from, how much there is, skies, and what is refused."""

from __future__ import annotations

import math
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

import silint
from silint import Environment, InputError, Visibility
from silint.core.integrands.light import vector_irradiance
from silint.core.runs import horizon_runs

# Sums of up to a million float64 terms, and closed forms of a few operations each.
SUM_ROUNDING = 1e-12

AXES = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def random_map(height: int = 8, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).exponential(size=(height, 2 * height, 3))


def spot(row: int, column: int, height: int = 32) -> np.ndarray:
    """Black but for one texel of each colour's own brightness."""
    radiance = np.zeros((height, 2 * height, 3))
    radiance[row, column] = (1, 2, 3)
    return radiance


def open_sky(env: Environment, normals: np.ndarray, isolines: int) -> np.ndarray:
    """Irradiance from the table over the whole hemispheres, (n, C)."""
    found = vector_irradiance(env.moment_table(isolines), *horizon_runs(normals, isolines))
    return np.einsum("nhci,ni->nc", found, normals)


# ----------------------------------------------------------------------------------------------- conventions


# With 32 rows, row 16 and column 32 begin at the middle of the map: the texel there lies just below and just
# to the right of +x. +z is a quarter of the width further right.
@pytest.mark.parametrize(
    ("row", "column", "axis"),
    [(16, 32, "+x"), (16, 48, "+z"), (16, 0, "-x"), (16, 16, "-z"), (0, 5, "+y"), (31, 9, "-y")],
)
@pytest.mark.parametrize("up", ["y", "z"])
def test_a_bright_texel_for_each_axis(row: int, column: int, axis: str, up: str) -> None:
    env = Environment.from_array(spot(row, column), up=up)
    towards = np.array(AXES[axis], dtype=float)
    if up == "z":
        # x stays, the map's y is the scene's z, and the map's z the scene's -y.
        towards = np.array([towards[0], -towards[2], towards[1]])
    # A normal that faces a small source gets all its light, but for the cosine across a texel.
    texel = np.pi / 32
    assert env.total()[0] > 0
    np.testing.assert_allclose(env.irradiance(towards[None])[0], env.total(), rtol=texel**2)
    assert (env.irradiance(-towards[None]) == 0).all()
    directions, radiance, omega = env.texels()
    lit = radiance[:, 0] > 0
    assert lit.sum() == 1
    assert directions[lit][0] @ towards > math.cos(texel)
    np.testing.assert_array_equal(env.radiance(directions[lit]), [[1, 2, 3]])
    assert omega.sum() == pytest.approx(4 * np.pi, rel=SUM_ROUNDING)
    # The table has it in the same place.
    sides = np.array(list(AXES.values()), dtype=float)
    np.testing.assert_allclose(open_sky(env, sides, 16)[sides @ towards > 0], [env.total()], rtol=texel**2)


@pytest.mark.parametrize("up", ["y", "z"])
def test_rotate_turns_counter_clockwise_about_up(up: str) -> None:
    # A spot at +x goes to -z about y, and to +y about z.
    env = Environment.from_array(spot(15, 32), up=up, rotate=90.0)
    axis = (0, 0, -1) if up == "y" else (0, 1, 0)
    w = env.texels().directions[env.texels().radiance[:, 0] > 0][0]
    assert w @ axis > math.cos(np.pi / 32)
    assert w[1 if up == "y" else 2] > 0  # row 15 lies above the horizon


def test_radiance_is_that_of_the_texel() -> None:
    radiance = random_map(16)
    w = units(500, 1)
    u, v = 0.5 + np.arctan2(w[:, 2], w[:, 0]) / (2 * np.pi), np.arccos(w[:, 1]) / np.pi
    expected = radiance[(v * 16).astype(int), (u * 32).astype(int)]
    np.testing.assert_array_equal(Environment.from_array(radiance).radiance(3.0 * w), expected)


@given(st.integers(0, 10_000))
def test_rotations(seed: int) -> None:
    turn = Rotation.random(random_state=seed).as_matrix()
    env = Environment.from_array(random_map(4, seed))
    turned = env.rotated(turn)
    w = units(20, seed)
    np.testing.assert_array_equal(turned.total(), env.total())
    # What is rounded on the way turns with the rest.
    np.testing.assert_allclose(turned.irradiance(w @ turn.T), env.irradiance(w), rtol=1e-9)
    centres = env.texels().directions
    np.testing.assert_array_equal(turned.radiance(centres @ turn.T), env.radiance(centres))
    back = turned.rotated(turn.T)
    np.testing.assert_allclose(back.rotation, np.eye(3), atol=1e-14)


def test_values_do_not_depend_on_company() -> None:
    env = Environment.from_array(random_map(4), up="z", rotate=20.0)
    n = units(33, 8)
    for integral in (env.irradiance, env.radiance):
        together = integral(n)
        np.testing.assert_array_equal(np.concatenate([integral(n[i : i + 1]) for i in range(33)]), together)
        np.testing.assert_array_equal(integral(n[::-1]), together[::-1])


def test_rotated_about_an_axis() -> None:
    env = Environment.from_array(random_map())
    axis = np.array([1.0, 2.0, -0.5])
    expected = Rotation.from_rotvec(math.radians(70) * axis / np.linalg.norm(axis)).as_matrix()
    np.testing.assert_allclose(env.rotated((axis, 70)).rotation, expected, atol=1e-15)
    np.testing.assert_array_equal(env.rotated(((0, 1, 0), 90)).rotation @ (1, 0, 0), (0, 0, -1))
    # A matrix in single precision is brought back to a rotation.
    found = env.rotated(expected.astype(np.float32)).rotation
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-15)
    assert env.rotated((axis, 70)).texel_radiance is env.texel_radiance


# ---------------------------------------------------------------------------------------------------- energy


@pytest.mark.parametrize("height", [1, 2, 5, 64])
@pytest.mark.parametrize("isolines", [1, 16])
def test_the_table_holds_all_light(height: int, isolines: int) -> None:
    env = Environment.from_array(random_map(height, height)).rotated(
        Rotation.random(random_state=1).as_matrix()
    )
    w, radiance, omega = env.texels()
    np.testing.assert_allclose(env.total(), omega @ radiance, rtol=SUM_ROUNDING)
    loops = Visibility(units(1), isolines, np.arange(isolines + 1), np.tile([0.0, 4.0], (isolines, 1)))
    light = env.moment_table(isolines)
    found = vector_irradiance(light, loops.offsets, loops.intervals).sum(axis=1)[0]
    # Centres of texels for their mean directions: the square of half a texel's diagonal, over 4.
    expected = np.einsum("m,mc,mi->ci", omega, radiance, w)
    np.testing.assert_allclose(found, expected, rtol=0, atol=(np.pi / height) ** 2 / 8 * env.total().max())
    assert light.kind == "texels" and light.channels == 3 and light.isolines == isolines


def test_irradiance_from_the_table_converges() -> None:
    env = Environment.from_array(random_map(32, 3))
    n = units(50, 2)
    exact = env.irradiance(n)
    # Lines end at the horizon where it crosses their middle, an error of order K^-2.
    errors = [np.abs(open_sky(env, n, k) / exact - 1).max() for k in (16, 64)]
    assert errors[0] < 3e-2
    assert errors[1] < errors[0] / 4


def test_a_sun_is_kept() -> None:
    """One texel of 1e5 times the median, 9/10 of the light, lost by neither total, table nor oracle."""
    radiance = np.ones((64, 128, 3), np.float32)
    radiance[20, 70] = 3e5
    env = Environment.from_array(radiance)
    omega = 2 * np.pi / 128 * (math.cos(20 * np.pi / 64) - math.cos(21 * np.pi / 64))
    expected = 4 * np.pi + omega * (3e5 - 1)
    np.testing.assert_allclose(env.total(), [expected] * 3, rtol=SUM_ROUNDING)
    sun = env.texels().directions[20 * 128 + 70]
    lit, dark = env.irradiance(np.stack([sun, -sun]))[:, 0]
    assert lit == pytest.approx(np.pi + omega * (3e5 - 1), rel=1e-3)
    # Away from the sun all is pi, but for what straddling texels are off.
    assert dark == pytest.approx(np.pi, rel=1e-4)
    assert open_sky(env, np.stack([sun, -sun]), 32)[0, 0] == pytest.approx(lit, rel=1e-2)
    assert open_sky(env, np.stack([sun, -sun]), 32)[1, 0] == pytest.approx(dark, rel=1e-2)


# ------------------------------------------------------------------------------------- channels and constants


def test_constants() -> None:
    env = Environment.constant((1.0, 2.0, 0.5))
    assert env.is_constant and env.channels == 3
    np.testing.assert_array_equal(env.total(), 4 * np.pi * np.array([1.0, 2.0, 0.5]))
    np.testing.assert_array_equal(env.irradiance(units(3)), np.pi * np.array([[1.0, 2.0, 0.5]] * 3))
    np.testing.assert_array_equal(env.radiance(units(3)), [[1.0, 2.0, 0.5]] * 3)
    _, radiance, omega = env.texels()
    np.testing.assert_allclose(omega @ radiance, env.total(), rtol=SUM_ROUNDING)
    grey = Environment.constant(3)
    assert grey.channels == 1
    np.testing.assert_array_equal(grey.radiance([[1, 0, 0]]), [[3, 3, 3]])
    assert Environment.from_array(np.full((4, 8, 3), 7)).is_constant
    assert not Environment.from_array(random_map()).is_constant


@pytest.mark.parametrize("isolines", [4, 33])
def test_constant_light_is_ambient_occlusion(isolines: int) -> None:
    """The very sums behind ambient occlusion, times pi L: equal to rounding, not only to a tolerance."""
    n = units(5, 3)
    rng = np.random.default_rng(0)
    offsets, runs = horizon_runs(n, isolines)
    cut = runs.copy()
    cut[:, 1] -= rng.random(len(runs)) * (runs[:, 1] - runs[:, 0])
    light = Environment.constant((2.0, 1.0, 0.25)).moment_table(isolines)
    assert light.kind == "constant" and light.channels == 3
    seen = np.einsum("nhci,ni->nc", vector_irradiance(light, offsets, cut), n)
    whole = np.einsum("nhci,ni->nc", vector_irradiance(light, offsets, runs), n)
    ao = Visibility(n, isolines, offsets, cut).ambient_occlusion()
    np.testing.assert_allclose(seen / whole, np.tile(ao[:, None], 3), rtol=1e-14)
    np.testing.assert_allclose(whole[:, 0], 2 * whole[:, 1], rtol=1e-15)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, np.uint8, np.int64])
def test_any_dtype_and_layout(dtype: type) -> None:
    radiance = np.random.default_rng(4).integers(0, 9, (4, 8, 3)).astype(dtype)
    expected = Environment.from_array(radiance.astype(np.float64)).texel_radiance
    strided = np.asfortranarray(np.repeat(radiance, 2, axis=0))[::2]
    strided.setflags(write=False)
    for data in (radiance, strided, radiance.astype(radiance.dtype.newbyteorder()), radiance.tolist()):
        env = Environment.from_array(data)
        np.testing.assert_array_equal(env.texel_radiance, expected)
        assert not env.texel_radiance.flags.writeable
    radiance[:] = 0  # the caller's array is not held
    np.testing.assert_array_equal(Environment.from_array(strided).texel_radiance, expected)


def test_grey_maps_have_one_channel() -> None:
    grey = np.random.default_rng(5).random((4, 8))
    flat, one, three = (
        Environment.from_array(a) for a in (grey, grey[..., None], np.stack([grey] * 3, axis=-1))
    )
    assert flat.channels == one.channels == three.channels == 1
    for env in (flat, one):
        np.testing.assert_array_equal(env.texel_radiance, three.texel_radiance)
    assert three.moment_table(4).table.values.shape[2] == 3
    assert three.irradiance(units(2)).shape == (2, 3)
    assert three.texels().radiance.shape == (32, 1)
    colour = np.stack([grey] * 3, axis=-1)
    colour[0, 0, 0] += 1e-12
    assert Environment.from_array(colour).channels == 3


def test_immutable_and_cached() -> None:
    env = Environment.from_array(random_map(2))
    for array in (env.texel_radiance, env.rotation, env.moment_table(3).table.values):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        env.clamped = 3  # type: ignore[misc]
    assert env.moment_table(3) is env.moment_table(3)
    first = env.moment_table(3)
    for isolines in (4, 5, 6, 7):
        env.moment_table(isolines)
    assert env.moment_table(3) is not first  # made anew: only the latest are kept
    np.testing.assert_array_equal(env.moment_table(3).table.values, first.table.values)
    again = pickle.loads(pickle.dumps(env))
    np.testing.assert_array_equal(again.irradiance(units(2)), env.irradiance(units(2)))


def test_names() -> None:
    assert repr(Environment.constant(1)) == "Environment('constant', constant, 1 channel)"
    assert repr(Environment.from_array(random_map(4))) == "Environment('array', 4 x 8 texels, 3 channels)"
    assert silint.Environment is Environment


# -------------------------------------------------------------------------------------------------- clamping


def test_what_is_not_light_is_clamped_counted_and_said() -> None:
    radiance = np.ones((4, 8, 3))
    radiance[0, 0] = (-1, 2, np.nan)
    radiance[1, 1] = (np.inf, 1, 5)
    radiance[2, 2, 0] = -np.inf
    radiance[3, 3, 0] = -0.0
    with pytest.warns(UserWarning, match="3 of 32 texels had negative, NaN or infinite"):
        env = Environment.from_array(radiance)
    assert env.clamped == 3
    np.testing.assert_array_equal(env.texel_radiance[[0, 1, 2], [0, 1, 2]], [(0, 2, 0), (5, 1, 5), (0, 1, 1)])
    assert env.rotated(np.eye(3)).clamped == 3
    assert Environment.from_array(random_map()).clamped == 0


def test_the_largest_floats_do_not_overflow() -> None:
    radiance = np.full((4, 8), np.finfo(np.float32).max, np.float32)
    radiance[0] = 0
    env = Environment.from_array(radiance)
    assert np.isfinite(env.total()).all()
    assert np.isfinite(env.moment_table(4).table.values).all()


# ------------------------------------------------------------------------------------------------------ skies


@pytest.mark.parametrize("up", ["y", "z"])
def test_cie_overcast(up: str) -> None:
    env = Environment.cie_overcast(zenith=(3.0, 3.0, 6.0), up=up)
    zenith = np.array([0.0, 1, 0] if up == "y" else [0.0, 0, 1])
    # [MS42]: the zenith is three times as bright as the horizon; E = 7/9 pi L on level ground, and on a wall
    # (pi/4 + 2/3) 2/3 L. Centres of 256 rows stand for their texels: errors of (pi / 256)^2 / 24.
    level = 0.5 * np.pi / 256
    np.testing.assert_allclose(env.radiance(zenith[None])[0], [3, 3, 6], rtol=1e-4)
    low = env.radiance([[1.0, *(zenith[1:] * level)]])[0]
    np.testing.assert_allclose(low, np.array([1, 1, 2]) * (1 + 2 * math.sin(level)), rtol=1e-4)
    np.testing.assert_array_equal(env.radiance(-zenith[None]), [[0, 0, 0]])
    np.testing.assert_allclose(
        env.irradiance(zenith[None])[0], 7 / 9 * np.pi * np.array([3, 3, 6]), rtol=1e-5
    )
    wall = (np.pi / 4 + 2 / 3) * 2 / 3
    np.testing.assert_allclose(env.irradiance([[1, 0, 0]])[0], wall * np.array([3, 3, 6]), rtol=5e-5)


def test_ground() -> None:
    env = Environment.cie_overcast(ground_albedo=(0.5, 0.25, 0.0))
    # Radiosity over pi: albedo times 7/9 pi, over pi; seen from below, pi times that.
    expected = 7 / 9 * np.array([0.5, 0.25, 0.0])
    np.testing.assert_allclose(env.radiance([[0.3, -0.1, 0.2]])[0], expected, rtol=1e-5)
    np.testing.assert_allclose(env.irradiance([[0, -1, 0]])[0], np.pi * expected, rtol=1e-5)


def clear_sky_1973(chi: np.ndarray, zenith_angle: np.ndarray, sun_zenith: float) -> np.ndarray:
    """CIE clear sky of 1973 [Kittler 1967], with its rounded 0.91."""

    def glow(angle: np.ndarray | float) -> np.ndarray:
        return 0.91 + 10 * np.exp(-3 * angle) + 0.45 * np.cos(angle) ** 2

    return glow(chi) * (1 - np.exp(-0.32 / np.cos(zenith_angle))) / (glow(sun_zenith) * (1 - np.exp(-0.32)))


@pytest.mark.parametrize("elevation", [5.0, 30.0, 60.0, 90.0])
def test_cie_clear_sky(elevation: float) -> None:
    e = math.radians(elevation)
    sun = np.array([0.6 * math.cos(e), 0.8 * math.cos(e), math.sin(e)])
    env = Environment.cie_clear_sky(5.0 * sun, zenith=2.0, up="z", height=128)
    w = units(200, 7)
    w[:, 2] = np.abs(w[:, 2])
    centre = env.texels().directions[np.argmax(env.texels().directions @ w.T, axis=0)]
    centre = centre[centre[:, 2] > 0]
    chi = np.arccos(np.clip(centre @ sun, -1, 1))
    expected = 2.0 * clear_sky_1973(chi, np.arccos(centre[:, 2]), np.pi / 2 - e)
    # Type 12 has 1 - 10 exp(-3 pi / 2) = 0.9102 where the older standard rounds to 0.91.
    np.testing.assert_allclose(env.radiance(centre)[:, 0], expected, rtol=3e-4)
    # The texel beside the zenith, where exp(-3 chi) changes by at most 3 times half of pi / 128.
    np.testing.assert_allclose(env.radiance([[0, 0, 1]]), 2.0, rtol=4e-2)

    theta = (np.arange(500)[:, None] + 0.5) * (np.pi / 1000)
    phi = (np.arange(1000) + 0.5) * (np.pi / 500)
    towards = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], axis=-1
    )
    chi = np.arccos(np.clip(towards @ sun, -1, 1))
    luminance = clear_sky_1973(chi, theta, np.pi / 2 - e)
    level = (luminance * np.cos(theta) * np.sin(theta)).sum() * (np.pi / 1000) * (np.pi / 500)
    np.testing.assert_allclose(env.irradiance([[0, 0, 1]]), 2.0 * level, rtol=5e-4)


@pytest.mark.parametrize("height", [32, 512])
@pytest.mark.parametrize("radius", [0.2666, 5.0])
def test_the_sun_has_its_irradiance_at_any_resolution(height: int, radius: float) -> None:
    direction = units(1, 9)[0]
    direction[1] = abs(direction[1]) + 0.2
    direction /= np.linalg.norm(direction)
    irradiance = np.array([30.0, 20.0, 10.0])
    sky = Environment.cie_clear_sky(direction, height=height)
    env = Environment.cie_clear_sky(direction, sun_irradiance=irradiance, sun_radius=radius, height=height)
    faced = env.irradiance(direction[None]) - sky.irradiance(direction[None])
    np.testing.assert_allclose(faced[0], irradiance, rtol=1e-9)
    ground = Environment.cie_clear_sky(direction, sun_irradiance=irradiance, ground_albedo=0.5, height=height)
    np.testing.assert_allclose(
        ground.radiance([[0, -1, 0]])[0], 0.5 / np.pi * ground.irradiance([[0, 1, 0]])[0], rtol=2e-3
    )
    # E = pi sin^2(radius) L for a disc of even radiance; texels at its rim hold a part.
    if radius == 5.0 and height == 512:
        expected = irradiance / (np.pi * math.sin(math.radians(radius)) ** 2)
        found = env.radiance(direction[None]) - sky.radiance(direction[None])
        np.testing.assert_allclose(found[0], expected, rtol=2e-2)  # 160 samples a texel
        outside = direction + math.tan(math.radians(6)) * np.cross(direction, [1, 0, 0])
        np.testing.assert_array_equal(env.radiance(outside[None]), sky.radiance(outside[None]))


def test_from_function() -> None:
    env = Environment.from_function(lambda w: np.stack([w[:, 0] + 1, w[:, 1] ** 2, 0 * w[:, 2]], axis=1), 64)
    # int (x + 1) dw = 4 pi, int y^2 dw = 4 pi / 3; midpoints of texels of pi / 64.
    np.testing.assert_allclose(env.total(), [4 * np.pi, 4 * np.pi / 3, 0], rtol=1e-3)
    # int (x + 1) max(n.w, 0) dw = pi + 2/3 pi n.x
    np.testing.assert_allclose(env.irradiance([[1, 0, 0]])[0, 0], np.pi * 5 / 3, rtol=1e-3)
    assert Environment.from_function(lambda w: w[:, 0] + 2, 8).channels == 1
    assert Environment.from_function(lambda w: w[:, :1] + 2, 8).channels == 1


# ------------------------------------------------------------------------------------------------------ files


def test_files(tmp_path: Path) -> None:
    rgbe = np.random.default_rng(6).integers(1, 256, (4, 8, 4), dtype=np.uint8)
    rgbe[..., 3] = 128
    data = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + rgbe.tobytes()
    file = tmp_path / "sky.hdr"
    file.write_bytes(data)
    env = Environment.from_file(file, up="z", rotate=30.0)
    assert env.name == "sky.hdr" and env.texel_radiance.dtype == np.float32
    np.testing.assert_array_equal(env.texel_radiance, rgbe[..., :3] / 256.0)
    expected = Environment.from_array(env.texel_radiance, up="z", rotate=30.0)
    np.testing.assert_array_equal(env.rotation, expected.rotation)
    Image.fromarray(rgbe[..., :3]).save(tmp_path / "sky.png")
    with pytest.warns(UserWarning, match="images of this kind end at white"):
        env = Environment.from_file(str(tmp_path / "sky.png"))
    assert env.texel_radiance.max() <= 1


def test_files_that_are_no_maps(tmp_path: Path) -> None:
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
    for name, data, message in (
        (
            "square.hdr",
            head + b"-Y 2 +X 2\n" + bytes([9] * 16),
            "image is 2 x 2 texels; expected an equirect",
        ),
        ("black.hdr", head + b"-Y 1 +X 2\n" + bytes(8), "image has no texel with a finite radiance above 0"),
        ("cut.hdr", head + b"-Y 1 +X 2\n" + bytes(7), "cut short"),
        ("sky.tga", b"", "unknown suffix '.tga'"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError) as caught:
            Environment.from_file(tmp_path / name)
        assert str(caught.value).startswith(f"{tmp_path / name}: ")
        assert message in str(caught.value) and "\n" not in str(caught.value)


# --------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (np.ones((4, 4, 3)), r"radiance is 4 x 4 texels; expected an equirectangular map, twice as wide"),
        (np.ones((8, 4, 3)), "radiance is 4 x 8 texels"),
        (np.ones((4, 8, 4)), "radiance has 4 channels, shape .4, 8, 4.; expected .*leave alpha out"),
        (np.ones((4, 8, 5)), "radiance has 5 channels"),
        (np.ones((0, 0, 3)), "radiance has shape .0, 0, 3."),
        (np.ones(8), "radiance has shape .8,."),
        (np.ones((1, 4, 8, 3)), "radiance has shape .1, 4, 8, 3."),
        (np.zeros((4, 8, 3)), "radiance has no texel with a finite radiance above 0"),
        (np.full((4, 8), np.nan), "radiance has no texel"),
        (np.full((4, 8), -1.0), "radiance has no texel"),
        (np.full((4, 8), np.inf), "radiance has no texel"),
        (np.ones((4, 8), complex), "radiance has dtype complex128"),
        (np.ones((4, 8), bool), "radiance has dtype bool"),
        ([[1, 2], [3]], "radiance is not a rectangular array"),
        ("sky.hdr", "radiance has dtype"),
        (np.broadcast_to(np.float32(1), (40000, 80000)), "radiance has 40000 rows; at most 32768"),
    ],
)
def test_arrays_that_are_no_maps(data: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        Environment.from_array(data)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


MAP = Environment.from_array(np.ones((2, 4)) + np.arange(4))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Environment.from_array(np.ones((2, 4)), up="x"), "up is 'x'; expected one of 'y', 'z'"),
        (lambda: Environment.from_array(np.ones((2, 4)), rotate=math.inf), "rotate is inf"),
        (lambda: Environment.from_array(np.ones((2, 4)), rotate="north"), "rotate is 'north'"),  # type: ignore[arg-type]
        (lambda: Environment.constant(0.0), "radiance is 0"),
        (lambda: Environment.constant((1, -1, 1)), "radiance is .1, -1, 1.; expected one number or three"),
        (lambda: Environment.constant((1, 2)), "expected one number or three"),
        (lambda: Environment.constant(np.nan), "expected one number or three"),
        (lambda: Environment.constant("red"), "radiance is 'red'"),
        (lambda: Environment.from_function(lambda w: np.ones((3, 3)), 4), "function returned shape .3, 3."),
        (lambda: Environment.from_function(lambda w: np.zeros(len(w)), 4), "function has no texel"),
        (lambda: Environment.from_function(lambda w: np.ones(len(w)), 0), "height is 0"),
        (lambda: Environment.cie_overcast(zenith=0), "zenith is 0"),
        (lambda: Environment.cie_overcast(height=7), "height is 7; expected an even"),
        (lambda: Environment.cie_overcast(ground_albedo=1.5), "ground_albedo is .1.5, 1.5, 1.5."),
        (lambda: Environment.cie_overcast(up="x"), "up is 'x'"),
        (lambda: Environment.cie_clear_sky((0, -1, 0)), "sun_direction lies below the horizon"),
        (lambda: Environment.cie_clear_sky((0, 1, -0.1), up="z"), "below the horizon; expected z"),
        (lambda: Environment.cie_clear_sky((0, 0, 0)), "sun_direction is"),
        (lambda: Environment.cie_clear_sky((0, 1, 0), sun_radius=0), "sun_radius is 0"),
        (lambda: Environment.cie_clear_sky((0, 1, 0), sun_radius=60), "sun_radius is 60 degrees"),
        (lambda: Environment.cie_clear_sky((0, 1, 0), sun_irradiance=-1), "sun_irradiance is -1"),
        (lambda: Environment.cie_clear_sky((0, 1, 0), zenith=0), "zenith is 0 and there is no sun"),
        (lambda: MAP.rotated(np.eye(4)), "rotation has shape .4, 4."),
        (lambda: MAP.rotated(np.diag([1, 1, -1])), "rotation is a reflection"),
        (lambda: MAP.rotated(2 * np.eye(3)), "rotation is not orthonormal"),
        (lambda: MAP.rotated(np.full((3, 3), np.nan)), "rotation is not orthonormal"),
        (lambda: MAP.rotated(((0, 0, 0), 3)), "rotation axis is"),
        (lambda: MAP.rotated(((0, 0, 1), None)), "rotation angle is None"),
        (lambda: MAP.rotated("up"), "rotation has dtype"),
        (lambda: MAP.radiance([1, 0, 0]), r"directions has shape \(3,\); expected \(n, 3\)"),
        (lambda: MAP.radiance([[0, 0, 0]]), "directions must not be zero; row 0"),
        (lambda: MAP.radiance(3), "directions has shape"),
        (lambda: MAP.radiance([[1], [2, 3]]), "directions is not a rectangular array"),
        (lambda: MAP.irradiance([[np.nan, 0, 0]]), "normals must be finite"),
        (lambda: MAP.irradiance(np.ones((2, 2))), "normals has shape .2, 2."),
        (lambda: MAP.moment_table(0), "isolines is 0"),
        (lambda: MAP.moment_table(2.5), "isolines is 2.5"),
    ],
)
def test_refusals(call: object, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()  # type: ignore[operator]
    assert "\n" not in str(caught.value)


def test_no_directions_at_all() -> None:
    assert MAP.radiance([]).shape == MAP.irradiance(np.empty((0, 3))).shape == (0, 3)


def test_harmonics_of_constant_and_smooth_light() -> None:
    """Texels' centres stand for texels: 128 rows are off by 1e-4."""
    constant = Environment.constant((1.0, 2.0, 3.0)).sh(4)
    assert constant.shape == (25, 3)
    np.testing.assert_allclose(constant[0], np.sqrt(4 * np.pi) * np.array([1, 2, 3]), rtol=1e-15)
    assert not constant[1:].any()
    tilted = Environment.from_function(lambda w: 2.0 + w[:, 2], 128).sh(2)
    want = np.zeros(9)
    want[0], want[2] = 2.0 * np.sqrt(4 * np.pi), np.sqrt(4 * np.pi / 3)
    np.testing.assert_allclose(tilted, np.repeat(want[:, None], 3, axis=1), atol=2e-4 * want[0])


def test_harmonics_turn_with_the_environment() -> None:
    light = Environment.from_function(lambda w: 1.5 + w[:, 0] * w[:, 1] + 0.2 * w[:, 2], 128)
    rotation = Rotation.from_rotvec([0.4, 0.8, -0.2]).as_matrix()
    got, want = light.rotated(rotation).sh(4), silint.sh.rotate(light.sh(4), rotation, axis=0)
    np.testing.assert_allclose(got, want, atol=1e-12)


@pytest.mark.parametrize("degree", [-1, 17, 2.5])
def test_degrees_out_of_range(degree: float) -> None:
    with pytest.raises(InputError, match="max_degree is"):
        Environment.constant().sh(degree)  # type: ignore[arg-type]
