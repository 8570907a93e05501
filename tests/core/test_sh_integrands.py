"""SH transfer over given intervals: lines against quadrature, packets against single ends, both families."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from silint.core import sh, sh_rotation
from silint.core.integrands import octahedral_sh, radial, radial_sh
from silint.core.integrands.radial_sh import GROUPS, end_moments, packet_moments
from silint.core.lanes import WIDTH
from silint.core.prefix_table import loop_points
from silint.core.radial import RadialIntervals, line_table, normal_table, set_frame
from silint.core.runs import horizon_runs

ROUNDING = 1e-13
WEIGHTINGS = ("cosine", "uniform")
KEYS = (-30.0, -1.0, -0.2, 0.0, 1e-9, 0.3, 1.0, 20.0, 1e4, 1e9, 1e80, 1e120, 1e300)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def units(n: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


# ------------------------------------------------------------------------------------------- one interval


def by_quadrature(y: float, phi: float, max_degree: int) -> np.ndarray:
    theta = 0.5 * np.arctan2(1.0, y) * (NODES + 1)
    s = np.sin(theta)
    w = np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)], axis=1)
    return (0.5 * np.arctan2(1.0, y) * WEIGHTS * s) @ sh.harmonics(w, max_degree)


@pytest.mark.parametrize("y", KEYS)
@pytest.mark.parametrize("max_degree", [0, 1, 5, 17])
def test_an_end_is_the_integral_from_the_zenith(y: float, max_degree: int) -> None:
    for phi in (0.0, 0.7, 3.9):
        found = np.zeros((max_degree + 1) ** 2)
        end_moments(y, np.cos(phi), np.sin(phi), 1.5, sh.recurrence(max_degree), found)
        expected = 1.5 * by_quadrature(y, phi, max_degree)
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)


@pytest.mark.nojit
@pytest.mark.parametrize("max_degree", [0, 1, 5, 17])
def test_a_packet_is_its_ends(max_degree: int) -> None:
    rng = np.random.default_rng(0)
    table = sh.recurrence(max_degree)
    y = np.array([*KEYS[:-2], *rng.normal(size=WIDTH)])[:WIDTH]
    phi, weight = rng.uniform(0, 7, WIDTH), rng.normal(size=WIDTH)
    weight[3] = 0.0  # a lane without an end
    packet = np.zeros(radial_sh._N_FIELDS * WIDTH)
    packet[:WIDTH], packet[WIDTH : 2 * WIDTH], packet[2 * WIDTH : 3 * WIDTH] = y, np.cos(phi), np.sin(phi)
    packet[3 * WIDTH : 4 * WIDTH] = weight
    sums = np.zeros((max_degree + 1) * (max_degree + 2) * WIDTH)
    packet_moments(packet, table, sums)
    pairs = sums.reshape(-1, 2, WIDTH)
    for lane in range(WIDTH):
        expected = np.zeros((max_degree + 1) ** 2)
        end_moments(y[lane], np.cos(phi[lane]), np.sin(phi[lane]), weight[lane], table, expected)
        for degree in range(max_degree + 1):
            for m in range(-degree, degree + 1):
                found = pairs[degree * (degree + 1) // 2 + abs(m), int(m < 0), lane]
                assert abs(found - expected[degree * (degree + 1) + m]) < 1e-14


# ---------------------------------------------------------------------------------------------- one point


def some_intervals(n: int, n_lines: int, seed: int, most: int = 4) -> RadialIntervals:
    """Any intervals above the horizons: none on some lines, the whole of others, slivers, touching ends."""
    rng = np.random.default_rng(seed)
    keys = normal_table(line_table(n_lines))[:, 1]
    horizon = np.arctan2(1.0, keys)
    counts, rows = np.zeros((n, n_lines), np.int32), []
    for i in range(n):
        for k in range(n_lines):
            counts[i, k] = rng.integers(0, most)
            theta = np.sort(rng.uniform(0, horizon[k], 2 * counts[i, k]))
            if counts[i, k] and rng.random() < 0.3:
                theta[0] = 0.0
            if counts[i, k] and rng.random() < 0.2:
                theta[0] = max(theta[1] - 1e-9, 0.0)
            with np.errstate(divide="ignore"):
                found = np.where(theta == 0, np.inf, 1 / np.tan(theta)).reshape(-1, 2)
            if counts[i, k] and rng.random() < 0.3:
                found[-1, 1] = keys[k]
            rows.append(found)
    starts = np.concatenate([[0], np.cumsum(counts.sum(axis=1))[:-1]])
    return RadialIntervals(units(n, seed), counts, starts, np.concatenate(rows))


def lines_by_quadrature(
    visible: RadialIntervals, max_degree: int, weighting: str, whole: bool = False
) -> np.ndarray:
    """Sums over lines of int f Y sin(theta) dtheta 2 pi / K in world axes: (n, GROUPS, (L + 1)^2)."""
    n, n_lines = visible.counts.shape
    lines = line_table(n_lines)
    horizon = np.arctan2(1.0, normal_table(lines)[:, 1])
    out = np.zeros((n, GROUPS, (max_degree + 1) ** 2))
    for i, normal in enumerate(visible.normals):
        frame = np.empty((3, 3))
        set_frame(normal, frame)
        row = visible.starts[i]
        for k in range(n_lines):
            parts = np.arctan2(1.0, visible.intervals[row : row + visible.counts[i, k]])
            row += visible.counts[i, k]
            for low, high in [(0.0, horizon[k])] if whole else parts:
                theta = 0.5 * (low + high) + 0.5 * (high - low) * NODES
                t = lines[k] @ frame[:2]
                w = np.cos(theta)[:, None] * frame[2] + np.sin(theta)[:, None] * t
                weight = 0.5 * (high - low) * WEIGHTS * np.sin(theta) * 2 * np.pi / n_lines
                if weighting == "cosine":
                    weight = weight * (w @ normal) / np.pi
                out[i, k % GROUPS] += weight @ sh.harmonics(w, max_degree)
    return out


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize(("max_degree", "n_lines"), [(0, 4), (1, 6), (4, 12), (16, 8)])
def test_points_are_those_of_quadrature(max_degree: int, n_lines: int, weighting: str) -> None:
    visible = some_intervals(8, n_lines, max_degree)
    seen = lines_by_quadrature(visible, max_degree, weighting)
    whole = lines_by_quadrature(visible, max_degree, weighting, whole=True)
    exact = sh.open_hemisphere(visible.normals, max_degree, weighting)

    def value_of(seen: np.ndarray, whole: np.ndarray) -> np.ndarray:
        return seen + seen[:, :1] / whole[:, :1] * (exact - whole)

    expected = value_of(seen.sum(axis=1), whole.sum(axis=1))
    value, estimate = radial_sh.sh_transfer(visible, max_degree, weighting)
    # Sums of some dozens of terms of order 1, turned.
    np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12)
    groups = np.stack([value_of(GROUPS * seen[:, g], GROUPS * whole[:, g]) - expected for g in range(GROUPS)])
    spread = radial_sh.ERROR_OF_SPREAD * np.sqrt((groups**2).sum(axis=2).mean(axis=0))
    np.testing.assert_allclose(estimate, spread, rtol=0, atol=1e-12)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_degree_0_is_the_fraction(weighting: str) -> None:
    visible = some_intervals(30, 64, 3)
    value, _ = radial_sh.sh_transfer(visible, 2, weighting)
    fraction, _ = radial.hemisphere_fraction(visible, weighting)
    total = 1.0 if weighting == "cosine" else 2 * np.pi
    # At 64 lines its groups integrate the open hemisphere alike.
    np.testing.assert_allclose(value[:, 0] * np.sqrt(4 * np.pi), total * fraction, rtol=0, atol=1e-12)


def test_degree_1_of_radial_is_the_bent_normal() -> None:
    """Degree 1 holds (y, z, x), and with cosine weights it is the bent normal."""
    visible = some_intervals(10, 64, 4)
    value, _ = radial_sh.sh_transfer(visible, 1, "cosine")
    bent, _ = radial.bent_normal(visible)
    found = value[:, [3, 1, 2]] / np.sqrt(3 / (4 * np.pi))
    np.testing.assert_allclose(found, bent, rtol=0, atol=1e-12)


def all_open(n: int, n_lines: int, seed: int) -> RadialIntervals:
    keys = normal_table(line_table(n_lines))[:, 1]
    rows = np.tile(np.stack([np.full(n_lines, np.inf), keys], axis=1), (n, 1))
    return RadialIntervals(units(n, seed), np.ones((n, n_lines), np.int32), np.arange(n) * n_lines, rows)


@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("max_degree", [0, 4, 16])
@pytest.mark.parametrize("n_lines", [4, 10])
def test_open_and_closed_are_exact(n_lines: int, max_degree: int, weighting: str) -> None:
    """However few the lines, even where they cannot tell one m from another."""
    visible = all_open(40, n_lines, 5)
    exact = sh.open_hemisphere(visible.normals, max_degree, weighting)
    value, estimate = radial_sh.sh_transfer(visible, max_degree, weighting)
    np.testing.assert_allclose(value, exact, rtol=0, atol=1e-12)
    assert (estimate < 1e-12).all()
    runs = horizon_runs(visible.normals, n_lines)
    value, estimate = octahedral_sh.sh_transfer(visible.normals, runs, n_lines, max_degree, weighting)
    np.testing.assert_allclose(value, exact, rtol=0, atol=1e-12)
    assert (estimate < 1e-11).all()
    # Nothing visible.
    nothing = RadialIntervals(
        visible.normals, np.zeros_like(visible.counts), np.zeros(40, np.int64), np.empty((0, 2))
    )
    none = np.zeros(40 * n_lines + 1, np.int64), np.empty((0, 2))
    for value, estimate in (
        radial_sh.sh_transfer(nothing, max_degree, weighting),
        octahedral_sh.sh_transfer(visible.normals, none, n_lines, max_degree, weighting),
    ):
        assert not value.any() and not estimate.any()


def test_alone_as_in_company() -> None:
    """The same bits, wherever a point's block begins and whatever stood in the scratch before."""
    visible = some_intervals(150, 16, 6)
    for max_degree, weighting in ((4, "cosine"), (3, "uniform")):
        value, estimate = radial_sh.sh_transfer(visible, max_degree, weighting)
        for i in (0, 1, 63, 64, 149):
            rows = slice(visible.starts[i], visible.starts[i] + visible.counts[i].sum())
            alone = RadialIntervals(
                visible.normals[i : i + 1],
                visible.counts[i : i + 1],
                np.zeros(1, np.int64),
                visible.intervals[rows].copy(),
            )
            one, its_estimate = radial_sh.sh_transfer(alone, max_degree, weighting)
            assert (one[0] == value[i]).all() and its_estimate[0] == estimate[i]


# ---------------------------------------------------------------------------------------------- octahedral


@pytest.mark.parametrize("max_degree", [0, 4, 9])
def test_the_table_integrates_the_sphere_and_its_parts(max_degree: int) -> None:
    k = 10
    table = octahedral_sh.sh_table(max_degree, k)
    assert table.values.nbytes == octahedral_sh.table_bytes(max_degree, k)
    assert not table.values.flags.writeable
    total = table.values[:, -1, 0].sum(axis=0)
    expected = np.zeros((max_degree + 1) ** 2)
    expected[0] = np.sqrt(4 * np.pi)
    # Sums over strips by Gauss rules, to the nodes: exact to rounding.
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-9)
    assert octahedral_sh.sh_table(max_degree, k) is table


def test_between_nodes_the_table_is_right_to_what_it_promises() -> None:
    """One interval of one strip against dense quadrature over it."""
    k, line, max_degree = 10, 6, 16
    low, high = -1 + 2 * line / k, -1 + 2 * (line + 1) / k
    for v0, v1 in ((0.1234, 0.777), (0.9, 3.0501), (3.3, 4.2)):
        u = 0.5 * (low + high) + 0.5 * (high - low) * NODES
        total = np.zeros((max_degree + 1) ** 2)
        cuts = [v0, *[c for c in range(1, 5) if v0 < c < v1], v1]
        for a, b in pairwise(cuts):
            v = 0.5 * (a + b) + 0.5 * (b - a) * NODES
            points = loop_points(u[:, None], v[None])
            r = np.linalg.norm(points, axis=-1)
            w = 0.25 * (high - low) * (b - a) * WEIGHTS[:, None] * WEIGHTS * (1 - np.abs(u[:, None])) / r**3
            total += w.ravel() @ sh.harmonics((points / r[..., None]).reshape(-1, 3), max_degree)
        offsets = np.zeros(k + 1, np.int64)
        offsets[line + 1 :] = 1
        normal = np.array([[0.0, 0.0, 1.0]])
        found = octahedral_sh._transfer(normal, (offsets, np.array([[v0, v1]])), k, max_degree, "uniform")
        np.testing.assert_allclose(found[0, line % 2], total, rtol=0, atol=1e-6)
        assert not found[0, 1 - line % 2].any()


def test_points_in_chunks_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    normals = units(50, 7)
    # Half of every run.
    offsets, runs = horizon_runs(normals, 12)
    half = np.stack([runs[:, 0], runs.mean(axis=1)], axis=1)
    whole = octahedral_sh.sh_transfer(normals, (offsets, half), 12, 3, "cosine")
    monkeypatch.setattr(octahedral_sh, "_CHUNK_BYTES", 7 * 32 * 25)
    parts = octahedral_sh.sh_transfer(normals, (offsets, half), 12, 3, "cosine")
    assert all((a == b).all() for a, b in zip(whole, parts, strict=True))
    assert whole[1].max() > 0


def test_tables_are_kept_within_memory() -> None:
    for max_degree in (0, 4, 8, 16):
        for weighting in WEIGHTINGS:
            most = octahedral_sh.most_isolines(max_degree, weighting)
            degree = sh.moment_degree(max_degree, weighting)
            size = octahedral_sh.table_bytes(degree, most)
            assert size <= octahedral_sh.TABLE_BYTES < 2 * size
            assert most & (most - 1) == 0 and most >= 128


@pytest.mark.nojit
def test_frames_turn_harmonics_as_they_turn_directions() -> None:
    """What the radial kernel does last: rows of the frame are its axes in the world."""
    normal = units(1, 8)[0]
    frame = np.empty((3, 3))
    set_frame(normal, frame)
    w = units(1, 9)
    x = sh.harmonics(w @ frame.T, 6)[0]
    sh_rotation.rotate(frame.T, 7, *sh_rotation.exchange(6), x, np.empty_like(x))
    np.testing.assert_allclose(x, sh.harmonics(w, 6)[0], rtol=0, atol=1e-13)
