"""Embree QMC under light and in harmonics: unbiased, with honest standard errors, and efficient."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.special
from scipy.spatial.transform import Rotation
from scipy.stats import t

from silint import Environment, Scene, SilhouetteIntegrator
from silint.reference import EmbreeQMC, embree_available
from silint.reference.light_rays import light_sampler, make_light_rays, texels_of
from silint.reference.sequence import point_bits, sobol_bits
from silint.reference.sh_sums import recurrence, sum_harmonics
from silint.validation import InputError

needs_embree = pytest.mark.skipif(not embree_available(), reason="no embreex for this platform")

SCRAMBLES = 64
TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()

# A wall that hides a good part of the sky from points around the origin; and next to nothing.
WALL = np.array([(1.0, -1, -2), (1, 3, -2), (1, 3, 1), (1, -1, 1)]), [[0, 1, 2], [0, 2, 3]]
NOTHING = np.array([(0.0, 0, -1e6), (1, 0, -1e6), (0, 1, -1e6)]), [[0, 1, 2]]

# The texel that is the sun; 5.6 degrees across.
SUN = 9, 40


def _smooth() -> Environment:
    def light(w: np.ndarray) -> np.ndarray:
        return np.stack([1.5 + w[:, 0], 1 + w[:, 1] ** 2, np.exp(w[:, 2])], axis=1)

    return Environment.from_function(light, 32).rotated(TURN)


def _sunny(radiance: float = 1e5) -> Environment:
    """A smooth map with one texel that much brighter than its median, of another colour."""
    texels = np.array(_smooth().texel_radiance)
    texels[SUN] = np.array([1.0, 0.9, 0.6]) * radiance
    return Environment.from_array(texels).rotated(TURN)


def _sunny_direction() -> np.ndarray:
    return _sunny().texels().directions.reshape(32, 64, 3)[SUN]


MAPS = {"smooth": _smooth, "sunny": _sunny, "constant": lambda: Environment.constant((0.5, 1, 2))}


def _sites(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 0.9, (n, 3)), rng.normal(size=(n, 3))


def _agrees(difference: np.ndarray, sigma: np.ndarray) -> bool:
    """Sidak: one false alarm in 10,000 over all numbers together, by Student's t of 63 degrees of freedom."""
    p = 1 - (1 - 1e-4) ** (1 / difference.size)
    return bool((np.abs(difference) / sigma).max() < t.isf(p / 2, SCRAMBLES - 1))


# -------------------------------------------------------------------------------------------- irradiance


@needs_embree
@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("sampling", ["mis", "cosine"])
def test_an_open_sky(name: str, sampling: str) -> None:
    if (name, sampling) == ("sunny", "cosine"):
        pytest.skip("few of the samples find the sun: their spread is no normal distribution")
    environment = MAPS[name]()
    points, normals = _sites(30)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    # A sun on the horizon is summed up by parts of its texel: 0.3 % off.
    rising = np.abs(normals @ _sunny_direction()) < 0.07
    points, normals = points[~rising], normals[~rising]
    found = EmbreeQMC(*NOTHING).irradiance(
        points, normals, environment, 512, scrambles=SCRAMBLES, sampling=sampling
    )
    exact = environment.irradiance(normals)
    # Where all samples count the same there is no spread, but sums of float32 numbers: 6e-8 each.
    sigma = np.maximum(found.standard_error, 1e-7 * exact)
    assert _agrees(found.value - exact, sigma)
    if sampling == "mis":  # precise enough to convict: 32768 samples of a stratified sequence
        assert (found.standard_error < 3e-3 * exact.mean()).all()


@needs_embree
@pytest.mark.parametrize("name", MAPS)
def test_past_a_wall(name: str) -> None:
    environment = MAPS[name]()
    points, normals = _sites(24)
    found = EmbreeQMC(*WALL).irradiance(points, normals, environment, 512, scrambles=SCRAMBLES)
    ours = SilhouetteIntegrator(Scene(*WALL)).irradiance(
        points, normals, environment, isolines=1024, method="octahedral", full_output=True
    )
    sigma = np.hypot(found.standard_error, ours.error_estimate[:, None])
    sigma = np.maximum(sigma, 1e-7 * np.abs(ours.value).max())
    assert _agrees(found.value - ours.value, sigma)
    assert (ours.value < 0.9 * environment.irradiance(normals)).any()  # the wall does something


def _variance(environment: Environment, mesh: tuple[np.ndarray, object], sampling: str) -> float:
    points, normals = _sites(48)
    found = EmbreeQMC(*mesh).irradiance(
        points, normals, environment, 256, scrambles=SCRAMBLES, sampling=sampling
    )
    return float((found.standard_error**2).sum())


@needs_embree
def test_aiming_at_a_sun_pays() -> None:
    assert 10 * _variance(_sunny(), WALL, "mis") < _variance(_sunny(), WALL, "cosine")


@needs_embree
@pytest.mark.parametrize("name", ["smooth", "constant"])
def test_aiming_costs_little_under_an_even_sky(name: str) -> None:
    # Half of the samples: at most twice the error; estimates of variance by 48 x 64 samples are good to 5 %.
    environment = MAPS[name]()
    assert _variance(environment, WALL, "mis") < 4.2 * _variance(environment, WALL, "cosine")


@needs_embree
def test_a_constant_sky_is_ambient_occlusion() -> None:
    points, normals = _sites(10)
    qmc = EmbreeQMC(*WALL)
    light = qmc.irradiance(points, normals, Environment.constant(2.0), 256, scrambles=3)
    share = qmc.ambient_occlusion(points, normals, 256, scrambles=3)
    assert light.rays == share.rays
    np.testing.assert_allclose(light.value, 2 * np.pi * share.value[:, None].repeat(3, axis=1), rtol=1e-6)


@needs_embree
@pytest.mark.parametrize("name", MAPS)
def test_values_depend_on_nothing_but_the_point(name: str) -> None:
    environment = MAPS[name]()
    points, normals = _sites(40)
    qmc = EmbreeQMC(*WALL)
    whole = qmc.irradiance(points, normals, environment, 256, scrambles=3)
    order = np.random.default_rng(1).permutation(40)
    shuffled = qmc.irradiance(points[order], normals[order], environment, 256, scrambles=3)
    np.testing.assert_array_equal(shuffled.value, whole.value[order])
    np.testing.assert_array_equal(shuffled.standard_error, whole.standard_error[order])
    for threads, batch in ((1, 1 << 16), (3, 512)):
        alone = EmbreeQMC(*WALL, threads=threads, batch=batch).irradiance(
            points[7:8], normals[7:8], environment, 256, scrambles=3
        )
        np.testing.assert_array_equal(alone.value[0], whole.value[7])
    other = qmc.irradiance(points, normals, environment, 256, seed=1, scrambles=3)
    assert (other.value != whole.value).any()


@needs_embree
def test_tables_are_those_of_the_environment_at_hand() -> None:
    points, normals = _sites(5)
    qmc = EmbreeQMC(*NOTHING)
    for environment in (_smooth(), Environment.constant(1.0), _smooth(), _smooth().rotated(TURN)):
        found = qmc.irradiance(points, normals, environment, 4096)
        # Twice the rays of 2 %: another map or another turn is off by a tenth.
        np.testing.assert_allclose(found.value, environment.irradiance(normals), rtol=0.02)
        fresh = EmbreeQMC(*NOTHING).irradiance(points, normals, environment, 4096)
        np.testing.assert_array_equal(found.value, fresh.value)


@needs_embree
def test_rays_below_the_horizon_are_not_traced() -> None:
    points, normals = np.zeros((1, 3)), np.array([[0.0, 0, 1]])
    texels = np.full((16, 32), 1e-6)
    texels[0] = 1.0  # all light at the top of the map
    up, down = (Environment.from_array(texels, "z").rotated(((1, 0, 0), a)) for a in (0, 180))
    qmc = EmbreeQMC(*NOTHING)
    reported: list[tuple[int, int]] = []
    above = qmc.irradiance(points, normals, up, 128, progress=lambda *done: reported.append(done))
    assert above.rays == 128 and reported[-1] == (128, 128)
    below = qmc.irradiance(points, normals, down, 128, progress=lambda *done: reported.append(done))
    assert below.rays == 64 and reported[-1] == (128, 128)
    assert qmc.bare_rays_per_second(points, normals, 128, environment=down) > 0
    none = np.zeros((0, 3))
    assert qmc.irradiance(none, none, up, 64).value.shape == (0, 3)


@needs_embree
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"environment": "sky.hdr"}, "environment is a str"),
        ({"samples": 1}, "samples is 1"),
        ({"samples": 100}, "pass 128"),
        ({"sampling": "light"}, "sampling is 'light'"),
        ({"scrambles": 0}, "scrambles is 0"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_bad_options_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        EmbreeQMC(*WALL).irradiance(*_sites(1), **{"environment": _smooth(), **options})
    assert "\n" not in str(caught.value)


# --------------------------------------------------------------------------------------------- light's rays


@pytest.mark.parametrize("height", [1, 32, 100])
def test_directions_lead_to_texels(height: int) -> None:
    light = light_sampler(np.random.default_rng(0).uniform(0.1, 1, (height, 2 * height, 1)), TURN)
    rows, columns = len(light.column_cdf), light.column_cdf.shape[1] - 1
    assert rows % height == 0 and columns == 2 * rows >= 128
    w = np.random.default_rng(1).normal(size=(5000, 3))
    w = np.concatenate([w / np.linalg.norm(w, axis=1)[:, None], [TURN[:, 1], -TURN[:, 1]]])
    found = np.empty(len(w), np.int32)
    texels_of(w.astype(np.float32), light, found)
    m = w @ TURN
    row = np.arccos(np.clip(m[:, 1], -1, 1)) / np.pi * rows
    column = (0.5 + np.arctan2(m[:, 2], m[:, 0]) / (2 * np.pi)) * columns
    # float32 directions: within 1e-6 of an angle of the border, either side is right.
    clear = np.minimum(row % 1, 1 - row % 1) > 1e-4
    clear &= np.minimum(column % 1, 1 - column % 1) * np.sin(row * np.pi / rows) > 1e-4
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(found[clear], (row.astype(int) * columns + column.astype(int))[clear])
    assert ((found >= 0) & (found < rows * columns)).all()


@pytest.mark.parametrize("environment", [_smooth(), _sunny(100.0)], ids=["smooth", "sunny"])
def test_light_is_sampled_by_its_density(environment: Environment) -> None:
    light = light_sampler(environment.texel_radiance, environment.rotation)
    rows, columns = len(light.column_cdf), light.column_cdf.shape[1] - 1
    q = light.texels[:, 3].astype(np.float64).reshape(rows, columns)
    y = np.cos(np.pi * np.arange(rows + 1) / rows)
    p = q * ((y[:-1] - y[1:]) * 2 * np.pi / columns)[:, None]
    assert p.sum() == pytest.approx(1, abs=1e-6)
    n = 1 << 14
    origins, normals = np.zeros((2, 3), np.float32), np.array([[0.6, 0.0, 0.8], [-0.6, 0, -0.8]])
    o, d = np.empty((2 * n, 3), np.float32), np.empty((2 * n, 3), np.float32)
    aimed, counts = np.empty(2 * n, np.int32), np.empty(2, np.int64)
    first, second = sobol_bits(n, 0, 0)
    # The same shifts for both: one point's rays are those that the other, its back to it, leaves out.
    shifts = np.repeat(point_bits(origins[:1], normals[:1], 0, 0), 2, axis=0)
    m = make_light_rays(origins, normals, first, second, shifts, light, o, d, aimed, counts)
    assert m == counts.sum() == n
    assert (d[: counts[0]] @ normals[0] > -1e-6).all() and (d[counts[0] : n] @ normals[1] > -1e-6).all()
    np.testing.assert_allclose(np.linalg.norm(d[:n], axis=1), 1, atol=1e-6)
    led = np.empty(n, np.int32)
    texels_of(d[:n], light, led)
    assert (led == aimed[:n]).mean() > 0.999  # but for float32 at borders
    # Blocks of 8 x 8 texels get their share: a stratified set is off by less than a random one's 1 sigma.
    share = np.bincount(aimed[:n], minlength=rows * columns).reshape(rows // 8, 8, columns // 8, 8) / n
    expected = p.reshape(rows // 8, 8, columns // 8, 8).sum(axis=(1, 3))
    off = np.abs(share.sum(axis=(1, 3)) - expected)
    assert (off < 4 / n + np.sqrt(expected * abs(1 - expected) / n)).all()
    # And within texels, evenly in y, which is in solid angle.
    height = (d[:n].astype(np.float64) @ environment.rotation)[:, 1]
    row = aimed[:n] // columns
    along = (height - y[row]) / (y[row + 1] - y[row])
    assert along.mean() == pytest.approx(0.5, abs=0.02)
    assert (along**2).mean() == pytest.approx(1 / 3, abs=0.02)


def test_an_even_map_has_nothing_to_aim_at() -> None:
    assert not light_sampler(np.full((8, 16, 3), 0.1), np.eye(3)).importance
    texels = np.full((8, 16, 3), 0.1)
    texels[3, 4] = 0.2
    light = light_sampler(texels, np.eye(3))
    assert light.importance
    assert not light_sampler(texels, np.eye(3), importance=False).importance
    assert np.count_nonzero(light.texels[:, 3]) == (64 // 8) ** 2


# --------------------------------------------------------------------------------------------- harmonics


def _scipy_harmonics(w: np.ndarray, max_degree: int) -> np.ndarray:
    """Real ones without the Condon-Shortley phase, from SciPy's complex ones with it."""
    theta, phi = np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])
    columns = []
    for degree in range(max_degree + 1):
        for m in range(-degree, degree + 1):
            if hasattr(scipy.special, "sph_harm_y"):
                y = scipy.special.sph_harm_y(degree, abs(m), theta, phi)
            else:  # before SciPy 1.15
                y = scipy.special.sph_harm(abs(m), degree, phi, theta)
            columns.append((y.imag if m < 0 else y.real) * (np.sqrt(2.0) * (-1) ** m if m else 1.0))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("degree", [0, 1, 4, 16])
def test_harmonics_are_scipys(degree: int) -> None:
    rng = np.random.default_rng(degree)
    w = rng.normal(size=(2 * 53, 3))
    w = (w / np.linalg.norm(w, axis=1)[:, None]).astype(np.float32)
    w[:3] = np.eye(3)
    hits = np.where(rng.random(106) < 0.7, -1, 5).astype(np.int32)
    hits[:3] = -1
    out = np.empty((2, (degree + 1) ** 2))
    sum_harmonics(hits, w, recurrence(degree), out)
    exact = w.astype(np.float64)
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    y = _scipy_harmonics(exact, degree) * (hits < 0)[:, None]
    # float32 directions are no unit vectors to 6e-8, times degree and value, times 53 rays.
    np.testing.assert_allclose(out, [y[:53].sum(axis=0), y[53:].sum(axis=0)], atol=3e-5)


@needs_embree
@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_transfer_past_a_wall(weighting: str) -> None:
    points, normals = _sites(12)
    found = EmbreeQMC(*WALL).sh_transfer(points, normals, 4, 512, weighting=weighting, scrambles=SCRAMBLES)
    ours = SilhouetteIntegrator(Scene(*WALL)).sh_transfer(
        points, normals, 4, isolines=512, weighting=weighting, method="octahedral", full_output=True
    )
    assert found.value.shape == found.standard_error.shape == (12, 25)
    # A share of one ray in all, and what our lines leave; coefficients of order one.
    sigma = np.hypot(found.standard_error, ours.error_estimate[:, None]) + 1 / (512 * SCRAMBLES)
    assert _agrees(found.value - ours.value, sigma)
    open_sky = EmbreeQMC(*NOTHING).sh_transfer(points, normals, 0, 64, weighting=weighting)
    whole = (1 if weighting == "cosine" else 2 * np.pi) / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(open_sky.value, whole, rtol=1e-12)


@needs_embree
def test_transfer_alone_and_in_company() -> None:
    points, normals = _sites(40)
    whole = EmbreeQMC(*WALL).sh_transfer(points, normals, 3, 256, scrambles=2)
    alone = EmbreeQMC(*WALL, threads=1, batch=256).sh_transfer(points[7:8], normals[7:8], 3, 256, scrambles=2)
    np.testing.assert_array_equal(alone.value[0], whole.value[7])
    np.testing.assert_array_equal(alone.standard_error[0], whole.standard_error[7])
    for options, message in (({"max_degree": 17}, "max_degree is 17"), ({"weighting": "area"}, "'area'")):
        with pytest.raises(InputError, match=message):
            EmbreeQMC(*WALL).sh_transfer(points, normals, **options)
