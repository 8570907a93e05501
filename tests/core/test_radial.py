"""Frames, sectors, spans and keys of radial isolines: geometry, and what rounding cannot break."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from silint.core import radial
from silint.core.radial import NORMAL_ALONG_AXIS, edge_circle, line_table, normal_table, set_frame, span


@njit(error_model="numpy")
def azimuths(t, m, out):
    for i in range(len(t)):
        out[i] = radial.azimuth(t[i], m[i])


@njit(error_model="numpy")
def sectors(t, m, n_lines, out):
    for i in range(len(t)):
        out[i] = radial.sector(t[i], m[i], n_lines)


def azimuth(t: np.ndarray, m: np.ndarray) -> np.ndarray:
    t, m = np.broadcast_arrays(np.asarray(t, float), np.asarray(m, float))
    out = np.empty(t.size)
    azimuths(t.ravel().copy(), m.ravel().copy(), out)
    return out.reshape(t.shape)


def sector(t: np.ndarray, m: np.ndarray, n_lines: int) -> np.ndarray:
    t, m = np.broadcast_arrays(np.asarray(t, float), np.asarray(m, float))
    out = np.empty(t.size, np.int64)
    sectors(t.ravel().copy(), m.ravel().copy(), n_lines, out)
    return out.reshape(t.shape)


def frame_of(n: np.ndarray) -> np.ndarray:
    frame = np.empty((3, 3))
    set_frame(n, frame)
    return frame


def normals() -> np.ndarray:
    """Any, along axes, and where the basis of Duff et al. changes its formula."""
    v = np.random.default_rng(0).normal(size=(200, 3))
    near = [(1e-9, -1e-9, s) for s in (1, -1)] + [(1, 0, s * 1e-300) for s in (1, -1)] + [(0.6, -0.8, -0.0)]
    v = np.concatenate([v, np.eye(3), -np.eye(3), near])
    return v / np.linalg.norm(v, axis=1)[:, None]


# ------------------------------------------------------------------------------------------------ frames


def test_frames_are_orthonormal_and_stand_alike_on_every_normal() -> None:
    held = []
    for n in normals():
        frame = frame_of(n)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=8e-16)
        assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-15)
        held.append(frame @ n)
        # A function of the normal alone, to the last bit, whatever was in the frame before.
        np.testing.assert_array_equal(frame, frame_of(n))
    # So one table of horizons serves all points.
    held = np.array(held)
    assert np.ptp(held, axis=0).max() < 1e-15
    np.testing.assert_allclose(held[:, 2], NORMAL_ALONG_AXIS, rtol=0, atol=1e-15)
    assert 1e-3 < np.arccos(NORMAL_ALONG_AXIS) < 0.1


def test_no_common_direction_lies_on_a_line() -> None:
    """Walls and floors are square to each other: no half-plane of an axis holds another axis."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    for n in axes:
        frame = frame_of(n)
        for k_lines in (4, 8, 32, 64, 512):
            t, m, _ = frame @ axes[np.abs(axes @ n) < 0.5].T
            turns = np.arctan2(m, t) * k_lines / (2 * np.pi) - 0.5
            assert np.abs(turns - np.round(turns)).min() > 1e-3


@pytest.mark.parametrize("k_lines", [4, 6, 64])
def test_the_horizon_of_a_line_is_square_to_the_normal(k_lines: int) -> None:
    lines = line_table(k_lines)
    table = normal_table(lines)
    phi = 2 * np.pi * (np.arange(k_lines) + 0.5) / k_lines
    np.testing.assert_allclose(lines, np.column_stack([np.cos(phi), np.sin(phi)]), rtol=0, atol=1e-15)
    for n in normals()[::20]:
        frame = frame_of(n)
        t = lines @ frame[:2]
        np.testing.assert_allclose(table[:, 0], t @ n, rtol=0, atol=1e-15)
        w = table[:, 1:] * frame[2] + t  # key: along the axis for one along t
        np.testing.assert_allclose(w @ n, 0.0, rtol=0, atol=1e-15)


# ----------------------------------------------------------------------------------------------- azimuth


def test_azimuth_is_arctan2() -> None:
    rng = np.random.default_rng(1)
    t, m = rng.normal(size=(2, 200_000))
    scale = 10.0 ** rng.uniform(-300, 300, 200_000)
    exact = np.arctan2(m, t) % (2 * np.pi)
    for s in (1.0, scale):
        found = azimuth(t * s, m * s)
        # An ulp or two of a number below 8.
        assert np.abs(found - exact).max() <= 2e-15
        assert np.sqrt(((found - exact) ** 2).mean()) < 5e-16
    small = exact < 1.0
    assert np.abs(azimuth(t, m) - exact)[small].max() <= 3e-16


def test_azimuths_of_special_directions() -> None:
    quarter = 0.5 * np.pi
    t = np.array([1, 1, 0, -1, -1, -1, 0, 1, 0.0])
    m = np.array([0, 1, 1, 1, 0, -1, -1, -1, 0.0])
    expected = np.array([0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 0.0]) * quarter
    np.testing.assert_allclose(azimuth(t, m), expected, rtol=0, atol=1e-15)
    assert azimuth(0.0, 0.0) == 0.0 and azimuth(5e-324, 0.0) == 0.0
    # It grows with the angle, over the joints of its pieces too, but for rounding.
    phi = np.linspace(0, 2 * np.pi, 100_001)[1:-1]
    assert (np.diff(azimuth(np.cos(phi), np.sin(phi))) > 0).all()


@pytest.mark.parametrize("k_lines", [4, 6, 64, 4096])
def test_sector_s_lies_between_the_lines_before_and_after(k_lines: int) -> None:
    lines = line_table(k_lines)
    phi = np.random.default_rng(2).uniform(0, 2 * np.pi, 20_000)
    s = sector(np.cos(phi), np.sin(phi), k_lines)
    assert ((s >= 0) & (s < k_lines)).all()
    before, after = lines[s - 1], lines[s]
    w = np.column_stack([np.cos(phi), np.sin(phi)])

    def left_of(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    assert (left_of(before, w) > -1e-14).all() and (left_of(w, after) > -1e-14).all()
    # Just before the last half line and at the very end of the turn, too.
    assert sector(1.0, -1e-18, k_lines) == sector(1.0, 0.0, k_lines) == 0


# ------------------------------------------------------------------------------------------------- spans


def steps(a: np.ndarray, b: np.ndarray, n_lines: int) -> int:
    """Signed number of lines that the arc from a to b crosses, taken from its lower end."""
    flip = tuple(a) > tuple(b)
    if flip:
        a, b = b, a
    turn = float(a[0] * b[1] - a[1] * b[0])
    sa, sb = sector([a[0], b[0]], [a[1], b[1]], n_lines)
    first, number, left = span(int(sa), int(sb), turn, n_lines)
    assert 0 <= first < n_lines and 0 <= number <= n_lines // 2
    # From the sector of the one end it leads to that of the other.
    assert (first, (first + number) % n_lines) == ((sa, sb) if left else (sb, sa))
    signed = number if left else -number
    return -signed if flip else signed


@pytest.mark.parametrize("n_lines", [4, 6, 16, 34])
def test_closed_loops_span_whole_turns(n_lines: int) -> None:
    """Whatever happens at ties: directions on the axis, equal, opposite, and on the lines themselves."""
    rng = np.random.default_rng(3)
    for length in (2, 3, 4, 7):
        for _ in range(150):
            loop = rng.integers(-2, 3, (length, 3)).astype(float)
            total = sum(steps(a, b, n_lines) for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True))
            assert total % n_lines == 0
            assert length > 3 or abs(total) <= n_lines


@pytest.mark.parametrize("n_lines", [4, 6, 64])
def test_a_loop_spans_as_many_turns_as_it_winds(n_lines: int) -> None:
    rng = np.random.default_rng(4)
    wound = set()
    for _ in range(200):
        loop = rng.normal(size=(rng.integers(3, 9), 3)) + rng.choice([0.0, 0.8]) * np.array([1, 0, 0])
        after = np.roll(loop, -1, axis=0)
        # An arc is shorter than half a turn: from its left or right, by the angle between its ends.
        turned = np.arctan2(
            loop[:, 0] * after[:, 1] - loop[:, 1] * after[:, 0], (loop * after)[:, :2].sum(axis=1)
        )
        winding = round(turned.sum() / (2 * np.pi))
        assert sum(steps(a, b, n_lines) for a, b in zip(loop, after, strict=True)) == winding * n_lines
        wound.add(winding)
    assert {-1, 0, 1} <= wound


def test_a_triangle_winds_where_the_axis_meets_it() -> None:
    """Small integers: turns and heights are exact. The axis is a line here, up and down."""
    rng = np.random.default_rng(5)
    n_met = 0
    for _ in range(300):
        a, b, c = rng.integers(-9, 10, (3, 3)).astype(float)
        around = [u[0] * v[1] - u[1] * v[0] for u, v in ((a, b), (b, c), (c, a))]
        if 0 in around:
            continue
        total = sum(steps(u, v, 6) for u, v in ((a, b), (b, c), (c, a)))
        met = len(set(np.sign(around))) == 1
        assert total == (6 * np.sign(around[0]) if met else 0)
        n_met += met
    assert n_met > 30


# -------------------------------------------------------------------------------------------------- keys


def test_keys_are_where_the_half_plane_cuts_the_edge() -> None:
    rng = np.random.default_rng(6)
    n_cut = 0
    for _ in range(3000):
        a, b = rng.normal(size=(2, 3)) * 10.0 ** (rng.uniform(-3, 3) + rng.uniform(-0.5, 0.5, (2, 1)))
        e = b - a
        along, across, turn = edge_circle(*a, *e)
        assert np.sign(turn) == np.sign(a[0] * b[1] - a[1] * b[0])
        phi = rng.uniform(0, 2 * np.pi)
        c, s = np.cos(phi), np.sin(phi)
        # The point of the segment on the plane of the half-plane, if that is on the right side of the axis.
        ya, yb = c * a[1] - s * a[0], c * b[1] - s * b[0]
        if ya * yb >= 0:
            continue
        w = a + ya / (ya - yb) * e
        ahead = c * w[0] + s * w[1]
        if ahead <= 0 or abs(turn) < 1e-2 * np.linalg.norm(a) * np.linalg.norm(b):
            continue
        key = along * c + across * s
        theta = np.arctan2(1.0, key)
        assert abs(theta - np.arctan2(ahead, w[2])) < 1e-12
        n_cut += 1
    assert n_cut > 300


def test_keys_at_the_ends_of_an_edge_are_those_of_its_ends() -> None:
    rng = np.random.default_rng(7)
    for _ in range(1000):
        a, b = rng.normal(size=(2, 3))
        along, across, turn = edge_circle(*a, *(b - a))
        if abs(turn) < 1e-3:
            continue
        for w in (a, b):
            rho = np.hypot(w[0], w[1])
            key = (along * w[0] + across * w[1]) / rho
            assert abs(key - w[2] / rho) < 1e-12 * (1 + abs(key)) / abs(turn)


def test_edges_that_have_no_keys_say_so() -> None:
    # Through the axis: infinite, or NaN; comparisons with a horizon are then decided by whoever asks.
    along, across, turn = edge_circle(1.0, 0.0, 1.0, 1.0, 0.0, 3.0)
    assert turn == 0.0 and not np.isfinite(along) | np.isfinite(across)
