"""Tables of a map's light: what is kept, where it lies, and integrals over any intervals."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from silint.core import equirect, texel_scatter, texel_table
from silint.core.integrands.moments import moment_table
from silint.core.integrands.octahedral_sh import sh_table
from silint.core.prefix_table import integrate_intervals, loop_points
from silint.core.sh import harmonics
from silint.core.sh_rotation import rotation_blocks
from silint.core.texel_table import (
    TexelTable,
    build_harmonic_table,
    build_texel_table,
    cells_per_quarter,
    integrate_steps,
)

# Sums of up to a million float64 terms, and closed forms of a few operations each.
SUM_ROUNDING = 1e-12

NO_TURN = np.eye(3)


def random_rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def whole(table: TexelTable) -> np.ndarray:
    """Moments over the whole of each strip: (K, C, 3)."""
    return table.values[:, -1].reshape(len(table.values), -1, 3)


def sub_texels(radiance: np.ndarray, rotation: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (m, 3) and L w dw (m, C, 3) of a random point in each of parts x parts pieces of a texel.

    At random, so that edges that run along rows of pieces do not have all of them on one side.
    """
    height = parts * len(radiance)
    rng = np.random.default_rng(0)
    theta = np.pi * (np.arange(height)[:, None] + rng.random((height, 2 * height))) / height
    phi = np.pi * ((np.arange(2 * height) + rng.random((height, 2 * height))) / height - 1)
    w = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=-1)
    w = w.reshape(-1, 3) @ rotation.T
    fine = np.repeat(np.repeat(radiance, parts, axis=0), parts, axis=1).reshape(len(w), -1)
    omega = np.repeat(equirect.solid_angles(height), 2 * height)
    return w, fine[:, :, None] * w[:, None] * omega[:, None, None]


def octahedral(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u and loop coordinate of directions, from the conventions and nothing else."""
    point = w / np.abs(w).sum(axis=1)[:, None]
    u, y, z = point.T
    side = np.abs(y) + np.abs(z)
    y, z = y / side, z / side
    v = np.select([(y > 0) & (z >= 0), (y <= 0) & (z > 0), (y < 0) & (z <= 0)], [z, 1 - y, 2 - z], 3 + y)
    return u, v


def integrate(table: TexelTable, lines: np.ndarray, intervals: np.ndarray) -> np.ndarray:
    """Integral over one interval on one line each, as if they were points: (n, C, 3)."""
    n_lines = len(table.values)
    counts = np.zeros((len(lines), n_lines), np.int64)
    counts[np.arange(len(lines)), lines] = 1
    offsets = np.concatenate([[0], np.cumsum(counts)])
    found = integrate_steps(table.values, table.cells_per_quarter, offsets, intervals, n_lines)
    return found.sum(axis=1).reshape(len(lines), -1, 3)


@pytest.mark.nojit
def test_octahedral_coordinates_are_those_of_the_loop() -> None:
    rng = np.random.default_rng(0)
    for u, v in rng.random((100, 2)) * (2, 4) - (1, 0):
        found, quarter, f = texel_scatter.octahedral(*(3.0 * loop_points(np.array(u), np.array(v))))
        np.testing.assert_allclose([found, quarter + f], [u, v], rtol=0, atol=1e-15 / (1 - abs(u)))
    # The corners at +y, +z, -y, -z begin quarters 0 to 3; at the poles any place on the loop will do.
    corners = [
        texel_scatter.octahedral(0.0, y, z) for y, z in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]
    ]
    assert corners == [(0.0, 0, 0.0), (0.0, 1, 0.0), (0.0, 2, 0.0), (0.0, 3, 0.0)]
    assert [texel_scatter.octahedral(x, 0.0, -0.0)[::2] for x in (2.0, -2.0)] == [(1.0, 0.0), (-1.0, 0.0)]


def texel_directions(height: int, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes of every texel, (H, 12, 2 H, 12, 3), and their weights in solid angle."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    h = np.pi / height
    theta = (h * (np.arange(height)[:, None] + 0.5 + 0.5 * nodes)).ravel()[:, None]
    phi = (h * (np.arange(2 * height)[:, None] + 0.5 + 0.5 * nodes) - np.pi).ravel()
    s = np.sin(theta)
    w = np.stack([s * np.cos(phi), np.cos(theta) * np.ones_like(phi), s * np.sin(phi)], axis=-1) @ rotation.T
    solid = (0.5 * h) ** 2 * np.outer((s.reshape(height, 12) * weights).ravel(), np.tile(weights, 2 * height))
    shape = height, 12, 2 * height, 12
    return w.reshape(*shape, 3), solid.reshape(shape)


def harmonic_table(
    radiance: np.ndarray, rotation: np.ndarray, n_lines: int, degree: int, quarter: int = 0
) -> TexelTable:
    blocks = rotation_blocks(np.ascontiguousarray(rotation @ texel_scatter.POLAR.T), degree)
    return build_harmonic_table(radiance, rotation, n_lines, blocks, 0, quarter)


# Gauss nodes resolve degree 17 in texels of 12 rows, not in a map of one.
@pytest.mark.parametrize(("height", "degree"), [(2, 0), (2, 2), (12, 17), (31, 3)])
def test_harmonics_of_the_sphere_are_kept(height: int, degree: int) -> None:
    """Of light of both signs: the whole table against quadrature in the frame of the isolines."""
    rng = np.random.default_rng(height)
    radiance = rng.normal(size=(height, 2 * height, 2)) ** 3
    rotation = random_rotation(height)
    w, solid = texel_directions(height, rotation)
    y = harmonics(w.reshape(-1, 3), degree).reshape(*solid.shape, -1)
    expected = np.einsum("aibj,aibjy,abc->cy", solid, y, radiance)
    found = harmonic_table(radiance, rotation, 5, degree).values[:, -1].sum(axis=0).reshape(2, -1)
    atol = SUM_ROUNDING * np.abs(radiance).mean() * 4 * np.pi
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def test_degree_one_is_the_first_moments() -> None:
    """On any interval: both deal the same parts out to the same cells."""
    rng = np.random.default_rng(4)
    radiance, rotation = rng.random((16, 32, 3)) ** 4, random_rotation(4)
    moments = build_texel_table(radiance, rotation, 9).values.reshape(9, -1, 3, 3)
    y = harmonic_table(radiance, rotation, 9, 2).values.reshape(9, -1, 3, 9)
    expected = moments[..., [1, 2, 0]] * np.sqrt(3 / (4 * np.pi))
    np.testing.assert_allclose(y[..., 1:4], expected, rtol=0, atol=SUM_ROUNDING)


def test_an_even_map_is_the_smooth_table_of_harmonics() -> None:
    rng = np.random.default_rng(6)
    n_lines, n, degree = 16, 400, 4
    table = harmonic_table(np.ones((64, 128, 1)), random_rotation(6), n_lines, degree)
    start = rng.random(n) * 4
    intervals = np.stack([start, start + 4 * rng.random(n)], axis=1)
    lines = rng.integers(0, n_lines, n)
    counts = np.zeros((n, n_lines), np.int64)
    counts[np.arange(n), lines] = 1
    offsets = np.concatenate([[0], np.cumsum(counts)])
    smooth = sh_table(degree, n_lines)
    expected = integrate_intervals(smooth.values, smooth.nodes_per_quarter, offsets, intervals, n_lines)
    found = integrate_steps(table.values, table.cells_per_quarter, offsets, intervals, n_lines)
    # As for first moments, in test_an_even_map_is_the_smooth_table: 1e-4 of 0.8 sr; |Y_lm| is below 1.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4)


@pytest.mark.parametrize("height", [1, 2, 8, 40])
@pytest.mark.parametrize("n_lines", [2, 33])
def test_it_does_not_matter_who_owns_which_strips(
    height: int, n_lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever owns all of them looks at all texels; for who owns one, the plan says which to look at."""
    radiance = np.random.default_rng(height).random((height, 2 * height, 2)) ** 8
    rotation = random_rotation(n_lines)
    owned = [np.array([0, n_lines]), np.arange(n_lines + 1), np.array([0, 1, 1, n_lines])]
    tables = []
    for borders in owned:
        monkeypatch.setattr(texel_scatter, "fair_shares", lambda *_, b=borders: b)
        tables.append(build_texel_table(radiance, rotation, n_lines, 16).values)
    np.testing.assert_array_equal(tables[0], tables[1])
    np.testing.assert_array_equal(tables[0], tables[2])


def test_shares_cover_all_strips_and_are_fair() -> None:
    rng = np.random.default_rng(0)
    strips = np.sort(rng.integers(0, 40, (50, 60, 2)), axis=-1)
    parts = rng.integers(1, 4, (50, 60, 2))
    for n_shares in (1, 2, 7, 40):
        borders = texel_scatter.fair_shares(strips, parts, 40, n_shares)
        assert len(borders) == n_shares + 1 and borders[0] == 0 and borders[-1] == 40
        assert (np.diff(borders) >= 0).all()
    at = texel_scatter.fair_shares(strips, parts, 40, 2)[1]
    below = parts.prod(axis=-1)[strips.sum(axis=-1) // 2 < at].sum()
    assert 0.4 < below / parts.prod(axis=-1).sum() < 0.6
    # Black maps have none.
    assert texel_scatter.fair_shares(strips * 0 - [0, 1], parts * 0, 40, 3)[-1] == 40


def test_tables_have_the_same_bits_for_any_number_of_threads() -> None:
    radiance, rotation = np.random.default_rng(1).random((40, 80, 3)) ** 8, random_rotation(1)
    threads = numba.get_num_threads()
    try:
        found = []
        for n in (1, threads):
            numba.set_num_threads(n)
            found.append(harmonic_table(radiance, rotation, 17, 2).values)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(found[0], found[1])


@pytest.mark.parametrize(("height", "n_lines"), [(1, 4), (2, 3), (8, 1), (8, 64), (31, 16), (64, 9)])
@pytest.mark.parametrize("seed", [0, 1])
def test_moments_of_the_sphere_are_kept(height: int, n_lines: int, seed: int) -> None:
    """The whole table against Gauss quadrature of every texel."""
    rng = np.random.default_rng(seed)
    radiance = rng.exponential(size=(height, 2 * height, 3)) ** 3
    rotation = random_rotation(seed)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    h = np.pi / height
    theta = (h * (np.arange(height)[:, None] + 0.5 + 0.5 * nodes)).ravel()
    phi = (h * (np.arange(2 * height)[:, None] + 0.5 + 0.5 * nodes) - np.pi).ravel()
    s = np.sin(theta)[:, None]
    w = np.stack([s * np.cos(phi), np.cos(theta)[:, None] * np.ones_like(phi), s * np.sin(phi)])
    w = (w * s).reshape(3, height, 12, 2 * height, 12)
    texels = (0.5 * h) ** 2 * np.einsum("aricj,i,j->arc", w, weights, weights)
    expected = np.einsum("arc,rcx,ba->xb", texels, radiance, rotation)
    found = whole(build_texel_table(radiance, rotation, n_lines)).sum(axis=0)
    np.testing.assert_allclose(found, expected, rtol=0, atol=SUM_ROUNDING * radiance.mean() * 4 * np.pi)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_strips_and_random_intervals(seed: int, dtype: type) -> None:
    """Against points in the texels, classified by where they lie."""
    rng = np.random.default_rng(seed)
    height, n_lines, n = 12, 8, 40
    radiance = rng.random((height, 2 * height, 2)).astype(dtype)
    rotation = random_rotation(seed)
    table = build_texel_table(radiance, rotation, n_lines)
    w, moments = sub_texels(radiance.astype(np.float64), rotation, 24)
    u, v = octahedral(w)
    strip = np.minimum(((u + 1) * 0.5 * n_lines).astype(int), n_lines - 1)
    start = rng.random(n) * 4
    end = start + 4 * rng.random(n)
    lines = rng.integers(0, n_lines, n)
    expected = np.array(
        [
            moments[(strip == k) & ((v - a) % 4 < b - a)].sum(axis=0)
            for k, a, b in zip(lines, start, end, strict=True)
        ]
    )
    # A random point stands for up to 1e-4 sr. Some 300 of them, along the edges of an interval, lie on either
    # side at random: a deviation of 2.2e-4 to 2.8e-4 was measured. Five of these.
    found = integrate(table, lines, np.stack([start, end], axis=1))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1.5e-3)
    by_strip = np.array([moments[strip == k].sum(axis=0) for k in range(n_lines)])
    np.testing.assert_allclose(whole(table), by_strip, rtol=0, atol=1.5e-3)


@pytest.mark.parametrize("height", [4, 64])
def test_an_even_map_is_the_smooth_table(height: int) -> None:
    """Cells are covered evenly: a map of ones against the moments of the direction, on any interval."""
    rng = np.random.default_rng(height)
    n_lines, n = 16, 400
    table = build_texel_table(np.ones((height, 2 * height, 1)), random_rotation(height), n_lines)
    start = rng.random(n) * 4
    intervals = np.stack([start, start + 4 * rng.random(n)], axis=1)
    lines = rng.integers(0, n_lines, n)
    smooth = moment_table(1, n_lines)
    counts = np.zeros((n, n_lines), np.int64)
    counts[np.arange(n), lines] = 1
    offsets = np.concatenate([[0], np.cumsum(counts)])
    expected = integrate_intervals(smooth.values, smooth.nodes_per_quarter, offsets, intervals, n_lines)
    found = integrate(table, lines, intervals)[:, 0]
    # Parts are about a cell wide, and their share of a strip is right to first order: 1e-4 was measured, of
    # strips of 0.8 sr, and 4e-4 where parts went whole to one strip or the other.
    np.testing.assert_allclose(found, expected.sum(axis=1), rtol=0, atol=2e-4)


@pytest.mark.parametrize("seed", range(4))
def test_a_single_texel_is_all_there(seed: int) -> None:
    """Black but for one texel: all of it within its own bounds, and nothing elsewhere, to the last bit."""
    rng = np.random.default_rng(seed)
    height, n_lines = 32, 16
    row, column = rng.integers(0, (height, 2 * height))
    radiance = np.zeros((height, 2 * height, 1), np.float32)
    radiance[row, column] = 3e4
    rotation = random_rotation(seed)
    table = build_texel_table(radiance, rotation, n_lines)
    w, moments = sub_texels(radiance, rotation, 8)
    lit = moments.any(axis=(1, 2))
    u, v = octahedral(w[lit])
    centre = v[0]
    reach = (v - centre + 2) % 4 - 2
    # A cell and a texel's part to each side of what the points cover.
    low, high = centre + reach.min() - 0.1, centre + reach.max() + 0.1
    ks = np.arange(n_lines)
    inside = np.tile([low % 4, low % 4 + high - low], (n_lines, 1))
    outside = np.tile([high % 4, high % 4 + 4 - (high - low)], (n_lines, 1))
    total = whole(table).sum(axis=0)
    np.testing.assert_allclose(integrate(table, ks, inside).sum(axis=0), total, rtol=SUM_ROUNDING)
    assert (np.abs(integrate(table, ks, outside)) <= 1e-15 * np.abs(total).max()).all()
    # Strips that no point of it lies in, but for neighbours, hold nothing at all.
    strip = (u + 1) * 0.5 * n_lines
    away = (ks < strip.min() - 1.2) | (ks > strip.max() + 0.2)
    assert away.any()
    assert not table.values[away].any()
    # Each strip its share: 1/64 of a texel along its edge, and the points of the oracle 1/8.
    np.testing.assert_allclose(
        whole(table),
        [moments[lit][np.floor(strip) == k].sum(axis=0) for k in ks],
        atol=0.08 * np.abs(total).max(),
    )


def test_a_sun_hides_nothing() -> None:
    """A sun 1e5 times the median, through whose strip the sky beside it still comes out right."""
    height, n_lines = 64, 8
    rng = np.random.default_rng(5)
    sky = 0.5 + rng.random((height, 2 * height, 1))
    sun = np.zeros_like(sky)
    sun[25, 40] = 1e5
    rotation = random_rotation(5)
    with_sun = build_texel_table(sky + sun, rotation, n_lines)
    without = build_texel_table(sky, rotation, n_lines)
    w, moments = sub_texels(sun, rotation, 4)
    (_, v) = octahedral(w[moments.any(axis=(1, 2))])
    high = v.max() + 0.15
    ks = np.arange(n_lines)
    # From behind the sun once round to just before it, wrapping past 4.
    beside = np.tile([high % 4, high % 4 + 3.6], (n_lines, 1))
    found, expected = integrate(with_sun, ks, beside), integrate(without, ks, beside)
    # Both scatter the sky, in parts of which both sides differ: see test_strips_and_random_intervals.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4)
    all_light = whole(with_sun).sum(axis=0)
    sun_only = whole(build_texel_table(sun, rotation, n_lines)).sum(axis=0)
    np.testing.assert_allclose(
        all_light, sun_only + whole(without).sum(axis=0), rtol=SUM_ROUNDING, atol=SUM_ROUNDING
    )


@pytest.mark.nojit
def test_prefix_sums_are_compensated() -> None:
    """What a large cell swallows comes out again when it is gone: plain sums would lose every 1."""
    values = np.zeros((1, 12, 1))
    values[0, 1:, 0] = [1.0, 1e17, *[1.0] * 7, -1e17, 1.0]
    texel_table._accumulate(values)
    np.testing.assert_array_equal(values[0, [0, 1, -2, -1], 0], [0, 1, 8, 9])


def test_steps_are_linear_between_knots() -> None:
    rng = np.random.default_rng(8)
    m, n_lines = 4, 3
    values = np.zeros((n_lines, 4 * m + 1, 2))
    values[:, 1:] = np.cumsum(rng.random((n_lines, 4 * m, 2)), axis=1)
    values.setflags(write=False)
    start = rng.random(50) * 4
    end = start + 4 * rng.random(50)
    lines = rng.integers(0, n_lines, 50)
    offsets = np.concatenate([[0], np.cumsum(lines[:, None] == np.arange(n_lines))])
    found = integrate_steps(values, m, offsets, np.stack([start, end], axis=1), n_lines)

    def prefix(k: int, c: int, v: float) -> float:
        turns, rest = divmod(v, 4.0)
        return turns * values[k, -1, c] + np.interp(rest * m, np.arange(4 * m + 1), values[k, :, c])

    for i, k in enumerate(lines):
        expected = [prefix(k, c, end[i]) - prefix(k, c, start[i]) for c in range(2)]
        np.testing.assert_allclose(found[i, k % 2], expected, rtol=0, atol=1e-13)
        assert not found[i, 1 - k % 2].any()


def test_points_do_not_depend_on_company_or_threads() -> None:
    rng = np.random.default_rng(9)
    table = build_texel_table(rng.random((8, 16, 3)), NO_TURN, 5)
    n = 64
    start = rng.random(n * 5) * 4
    intervals = np.stack([start, start + rng.random(n * 5)], axis=1)
    offsets = np.arange(n * 5 + 1)

    def run(i: np.ndarray) -> np.ndarray:
        rows = (5 * i[:, None] + np.arange(5)).ravel()
        return integrate_steps(
            table.values, table.cells_per_quarter, offsets[: len(rows) + 1], intervals[rows], 5
        )

    together = run(np.arange(n))
    order = rng.permutation(n)
    np.testing.assert_array_equal(run(order), together[order])
    np.testing.assert_array_equal(run(np.array([17])), together[[17]])
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        np.testing.assert_array_equal(run(np.arange(n)), together)
    finally:
        numba.set_num_threads(threads)


@pytest.mark.nojit
def test_cells_follow_the_height_within_bounds() -> None:
    assert [cells_per_quarter(h) for h in (1, 128, 511, 512, 2048, 16384)] == [64, 64, 256, 256, 1024, 1024]


def test_a_table_is_the_same_every_time() -> None:
    radiance = np.random.default_rng(2).random((9, 18, 1))
    a, b = (build_texel_table(radiance, random_rotation(1), 6, quarter=32) for _ in range(2))
    assert a.values.shape == (6, 129, 3) and a.cells_per_quarter == 32
    np.testing.assert_array_equal(a.values, b.values)
