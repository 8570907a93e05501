"""Caps on lines, and all limits of lines, against rays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from silint.core.bundles import build_edge_bundles
from silint.core.caps import LINEAR, NO_GROUND, QUADRATIC, LineLimits, cap_on_line, reach_table
from silint.core.face_bundles import build_face_bundles
from silint.core.radial import line_table, normal_table, set_frame
from silint.core.topology import Topology, build_topology
from silint.core.visible import Bundles, find_radial

K, THETAS = 16, 200


@pytest.mark.nojit
@given(
    st.floats(-1, 1),
    st.floats(-1, 1),
    st.sampled_from([0.0, 1e-9, 0.1, 0.5, 0.9]),
)
def test_a_cap_has_the_directions_that_it_should(a: float, t: float, q: float) -> None:
    high, low = cap_on_line(a, t, q)
    theta = np.pi * (np.arange(400) + 0.5) / 400
    inside = a * np.cos(theta) + t * np.sin(theta) - q
    keys = 1.0 / np.tan(theta)
    found = (keys < high) & (keys > low)
    # Within rounding of the end of a cap, which may be as thin as rounding, either will do.
    clear = np.abs(inside) > 1e-12
    assert (found == (inside > 0.0))[clear].all()


def test_falloffs_give_lines_the_distribution_of_radii() -> None:
    """P(r < x R) is what f falls by up to x: x for 1 - x, x^2 for 1 - x^2; evenly in every group of lines."""
    for falloff, power in ((LINEAR, 1), (QUADRATIC, 2)):
        radii = reach_table(LineLimits(3.0, falloff), 256) / 3.0
        for part in (radii, *(radii[g::4] for g in range(4))):
            expected = (np.arange(len(part)) + 0.5) / len(part)
            # The discrepancy of multiples of the golden ratio is below 1.5 log2(n) / n.
            assert np.abs(np.sort(part) ** power - expected).max() < 1.5 * np.log2(len(part)) / len(part)
    assert (reach_table(LineLimits(3.0), 4) == 3.0).all()
    assert (reach_table(LineLimits(ground_reach=2.0), 4) == np.inf).all()
    assert (reach_table(LineLimits(ground_reach=2.0), 4, of_ground=True) == 2.0).all()


# ------------------------------------------------------------------------------------------- against rays


def soup(n: int = 60, seed: int = 0) -> Topology:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.6, 0.6, size=(n, 1, 3)) + rng.normal(scale=0.15, size=(n, 3, 3))
    faces = np.arange(3 * n, dtype=np.int32).reshape(n, 3)
    return build_topology(np.clip(corners, -0.9, 0.9).reshape(-1, 3), faces)[0]


def blocked(topology: Topology, p: np.ndarray, w: np.ndarray, limits: LineLimits, reach: float) -> np.ndarray:
    """Which rays meet anything near, by testing all faces [Moeller & Trumbore 1997]."""
    a, b, c = np.moveaxis(topology.vertices[topology.faces], 1, 0)
    u, v = b - a, c - a
    normal = np.cross(u, v)
    along = w @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((a - p) * normal).sum(axis=1) / along
        x = p + distance[..., None] * w[:, None] - a
        scale = (normal**2).sum(axis=1)
        y = (np.cross(x, v) * normal).sum(axis=-1) / scale
        z = (np.cross(u, x) * normal).sum(axis=-1) / scale
        hit = (y > 0) & (z > 0) & (y + z < 1) & (distance > 0) & (distance < reach)
    if limits.one_sided:
        hit &= along < 0
    found = hit.any(axis=1)
    if limits.ground.any():
        height = limits.ground[:3] @ p + limits.ground[3]
        fall = -(w @ limits.ground[:3])
        found |= (height < 0) | ((fall > 0) & (height < min(reach, limits.ground_reach) * fall))
    return found


TILTED = np.array([0.6, 0.0, 0.8, 0.3])
CASES = {
    "nothing": LineLimits(),
    "near": LineLimits(reach=0.3),
    "nearer": LineLimits(reach=0.05),
    "linear": LineLimits(reach=0.8, falloff=LINEAR),
    "quadratic": LineLimits(reach=0.8, falloff=QUADRATIC),
    "fronts": LineLimits(one_sided=True),
    "near fronts": LineLimits(reach=0.5, one_sided=True),
    "cone": LineLimits(cone=0.5),
    "near in a cone": LineLimits(reach=0.4, cone=0.9),
    "ground": LineLimits(ground=TILTED),
    "near ground": LineLimits(ground=TILTED, ground_reach=0.4),
    # Seen between what lies on either side of it.
    "ground in the middle": LineLimits(ground=np.array([0.6, 0.0, 0.8, 0.7]), ground_reach=0.6),
    "all": LineLimits(0.5, LINEAR, True, 0.3, TILTED),
}


@pytest.mark.parametrize("cover", [True, False])
@pytest.mark.parametrize("name", CASES)
def test_intervals_are_what_rays_see(name: str, cover: bool) -> None:
    limits = CASES[name]
    if limits.one_sided and not cover:
        return
    topology = soup()
    bundles = Bundles(*build_edge_bundles(topology)[:2], build_face_bundles(topology))
    rng = np.random.default_rng(3)
    p, n = rng.uniform(-0.6, 0.6, size=(24, 3)), rng.normal(size=(24, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    found = find_radial(topology, bundles, p, n, K, 32, 4096, cover, limits=limits)
    assert not isinstance(found, int)
    assert found.contradicted == 0
    visible, lines = found.visible, line_table(K)
    ends, reach = normal_table(lines, limits.cone)[:, 1], reach_table(limits, K)
    frame = np.empty((3, 3))
    tested = 0
    for i in range(len(p)):
        set_frame(n[i], frame)
        row = visible.starts[i]
        for k in range(K):
            theta = np.arctan2(1.0, ends[k]) * (np.arange(THETAS) + 0.5) / THETAS
            t = lines[k] @ frame[:2]
            w = np.cos(theta)[:, None] * frame[2] + np.sin(theta)[:, None] * t
            intervals = visible.intervals[row : row + visible.counts[i, k]]
            row += visible.counts[i, k]
            assert (intervals[:, 0] > intervals[:, 1]).all() and (intervals[:, 1] >= ends[k]).all()
            assert (intervals[1:, 0] < intervals[:-1, 1]).all()
            angles = np.arctan2(1.0, intervals)
            seen = ((theta[:, None] > angles[:, 0]) & (theta[:, None] < angles[:, 1])).any(axis=1)
            # Rays that pass an end within rounding see either side.
            clear = np.abs(theta[:, None] - angles.reshape(1, -1)).min(axis=1, initial=1.0) > 1e-9
            hidden = blocked(topology, p[i], w, limits, reach[k])
            assert (seen != hidden)[clear].all()
            tested += int(hidden[clear].sum())
    assert tested > 100 or name == "nearer"


def test_limits_that_limit_nothing_change_no_bit() -> None:
    topology = soup()
    bundles = Bundles(*build_edge_bundles(topology)[:2], build_face_bundles(topology))
    rng = np.random.default_rng(4)
    p, n = rng.uniform(-0.6, 0.6, size=(40, 3)), rng.normal(size=(40, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    for cover in (True, False):
        plain = find_radial(topology, bundles, p, n, K, 32, 4096, cover)
        far = np.array([0.0, 0.0, 1.0, 50.0])
        for limits in (LineLimits(ground=far, ground_reach=1.0), LineLimits(ground=NO_GROUND)):
            found = find_radial(topology, bundles, p, n, K, 32, 4096, cover, limits=limits)
            assert not isinstance(found, int) and not isinstance(plain, int)
            assert (found.visible.counts == plain.visible.counts).all()
            for i in range(len(p)):
                rows = [
                    v.intervals[v.starts[i] :][: v.counts[i].sum()] for v in (found.visible, plain.visible)
                ]
                assert (rows[0] == rows[1]).all()
