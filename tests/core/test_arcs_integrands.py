"""Integrals over regions bounded by great-circle arcs: against quadrature, closed forms and invariances."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from silint.core import sh
from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs as by_arcs
from silint.core.integrands import arcs_sh
from silint.sh import rotate

JIT_DISABLED = numba.config.DISABLE_JIT

Z = np.array([0.0, 0.0, 1.0])

# Regions here have boundaries of a few turns, so that a dozen roundings of sums below 10 remain.
ROUNDING = 4e-15

# Quadrature with 60 x 12 nodes on triangles of at most 0.3 rad: measured against twice as many, 4e-15.
QUADRATURE = 2e-14


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


# ------------------------------------------------------------------------------------------------- regions


class Region(NamedTuple):
    """Boundary arcs of a region above the horizon of n."""

    n: np.ndarray  # (3,)
    rows: np.ndarray  # (m, 9): start, end, normal of the plane on the inside
    free: np.ndarray  # (m,) bool: stretches of the horizon

    def turned(self, rotation: np.ndarray) -> Region:
        rows = (self.rows.reshape(-1, 3, 3) @ rotation.T).reshape(-1, 9)
        return Region(rotation @ self.n, rows, self.free)


def region(n: np.ndarray, *loops: np.ndarray) -> Region:
    """Of loops of directions with the inside on their left."""
    a = np.concatenate([unit(loop) for loop in loops])
    b = np.concatenate([np.roll(unit(loop), -1, axis=0) for loop in loops])
    normal = unit(np.cross(a, b))
    free = (np.abs(a @ n) < 1e-15) & (np.abs(b @ n) < 1e-15) & (normal @ n > 0)
    normal[free] = n
    return Region(n, np.concatenate([a, b, normal], axis=1), free)


def gather(regions: Sequence[Region]) -> Arcs:
    counts = np.array([len(r.rows) for r in regions])
    free = np.concatenate([r.free for r in regions])
    edges = np.stack([np.arange(len(free)), np.arange(len(free)) + 1], axis=1).astype(np.int32)
    edges[free] = -1
    return Arcs(
        np.zeros((len(regions), 3)),
        np.array([r.n for r in regions]),
        counts,
        np.cumsum(counts) - counts,
        np.concatenate([r.rows for r in regions]),
        edges,
    )


def frame(n: np.ndarray) -> np.ndarray:
    """Columns: two tangents and n."""
    t = unit(np.cross(n, np.array([0.3, -0.5, 0.8]) + 0.1 * n))
    return np.stack([t, np.cross(n, t), n], axis=1)


def around(axis: np.ndarray, radii: np.ndarray, turn: float = 0.0) -> np.ndarray:
    """A star-shaped loop about an axis, counter-clockwise: one radius (rad) a corner."""
    phi = turn + 2 * np.pi * np.arange(len(radii)) / len(radii)
    local = np.stack([np.sin(radii) * np.cos(phi), np.sin(radii) * np.sin(phi), np.cos(radii)], axis=1)
    return local @ frame(axis).T


def octant(_: int) -> Region:
    return region(Z, np.eye(3))


def window(seed: int) -> Region:
    """One piece inside the hemisphere."""
    rng = np.random.default_rng(seed)
    n = unit(rng.normal(size=3))
    axis = unit(n + 0.2 * rng.normal(size=3))
    limit = 0.5 * np.pi - np.arccos(axis @ n)
    return region(n, around(axis, limit * rng.uniform(0.3, 0.95, 9), rng.uniform(0, 6)))


def ring(seed: int) -> Region:
    """A piece with two holes, and a piece in one of the holes; the outer loop has 40 corners."""
    rng = np.random.default_rng(seed)
    n = unit(rng.normal(size=3))
    t, m, _ = frame(n).T
    first, second = unit(n + 0.5 * t), unit(n - 0.6 * m)
    return region(
        n,
        around(n, rng.uniform(1.35, 1.5, 40)),
        around(first, rng.uniform(0.15, 0.3, 7))[::-1],
        around(second, rng.uniform(0.2, 0.33, 11))[::-1],
        around(second, rng.uniform(0.05, 0.12, 5)),
    )


def mountains(seed: int) -> Region:
    """Sky over a jagged skyline that leaves half of the horizon free."""
    rng = np.random.default_rng(seed)
    n = unit(rng.normal(size=3))
    phi = np.concatenate([np.linspace(0, np.pi, 4), np.pi + np.pi * np.sort(rng.uniform(0.05, 0.95, 8))])
    height = np.concatenate([np.zeros(4), rng.uniform(0.02, 1.2, 8)])
    local = np.stack([np.cos(height) * np.cos(phi), np.cos(height) * np.sin(phi), np.sin(height)], axis=1)
    return region(n, local @ frame(n).T)


def lune(seed: int, tip: float = 1e-3) -> Region:
    """Between the horizon and a plane through a line in it, without the tips: two arcs of nearly pi."""
    rng = np.random.default_rng(seed)
    n = unit(rng.normal(size=3))
    t, m, _ = frame(n).T
    opening = rng.uniform(0.3, 2.8)
    high = np.cos(opening) * m + np.sin(opening) * n
    a, d = np.cos(tip) * t + np.sin(tip) * m, np.cos(tip) * t + np.sin(tip) * high
    b, c = a - 2 * np.cos(tip) * t, d - 2 * np.cos(tip) * t
    inner = np.stack([n, np.cross(high, b), np.sin(opening) * m - np.cos(opening) * n, np.cross(m, d)])
    inner[1], inner[3] = unit(np.cross(b, c)), unit(np.cross(d, a))
    rows = np.concatenate([np.stack([a, b, c, d]), np.stack([b, c, d, a]), inner], axis=1)
    return Region(n, rows, np.zeros(4, bool))


REGIONS = {"octant": octant, "window": window, "ring": ring, "mountains": mountains, "lune": lune}
CASES = [(name, seed) for name in REGIONS for seed in (range(1) if name == "octant" else range(3))]
each_region = pytest.mark.parametrize(("name", "seed"), CASES)


def of(name: str, seed: int) -> Region:
    return REGIONS[name](seed)


def horizon(n: np.ndarray, corners: int = 6) -> Region:
    """The whole hemisphere."""
    found = region(n, around(n, np.full(corners, 0.5 * np.pi)))
    found.rows[:, 6:] = n
    return found._replace(free=np.ones(corners, bool))


def nothing(n: np.ndarray) -> Region:
    return Region(n, np.zeros((0, 9)), np.zeros(0, bool))


# ---------------------------------------------------------------------------------------------- quadrature


@lru_cache(maxsize=4)
def legendre(n: int) -> tuple[np.ndarray, np.ndarray]:
    x, w = np.polynomial.legendre.leggauss(n)
    return 0.5 * (x + 1), 0.5 * w


def triangles(shape: Region) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Plane triangles, whose signed sum seen from the origin is the region, from a point that is not n."""
    t, m, n = frame(shape.n).T
    apex = unit(n + 0.21 * t - 0.13 * m)
    for row in shape.rows:
        a, b, normal = row[:3], row[3:6], row[6:]
        length = np.arctan2(normal @ np.cross(a, b), a @ b)
        s = np.linspace(0, length, int(length / 0.3) + 2)[:, None]
        for p, q in pairwise(np.cos(s) * a + np.sin(s) * np.cross(normal, a)):
            yield apex, p, q


def above(corners: Sequence[np.ndarray], up: np.ndarray) -> list[np.ndarray]:
    """The part of a plane convex polygon on one side of a plane through the origin [Sutherland, Hodgman]."""
    kept = []
    for p, q in zip(corners, [*corners[1:], corners[0]], strict=True):
        u, v = p @ up, q @ up
        if u >= 0:
            kept.append(p)
        if u * v < 0:
            kept.append(p + u / (u - v) * (q - p))
    return kept


def quadrature(
    shape: Region, f: Callable[[np.ndarray], np.ndarray], up: np.ndarray | None = None
) -> np.ndarray:
    """Integral of f (n, ...) over a region, or over what lies of it above a second horizon."""
    u, wu = legendre(60)
    v, wv = legendre(12 if up is None else 60)  # what is clipped is no longer thin
    total: np.ndarray | float = 0.0
    for whole in triangles(shape):
        corners = whole if up is None else above(whole, up)
        for p, q in pairwise(corners[1:]):
            chord = p + v[:, None] * (q - p)
            points = corners[0] + u[:, None, None] * (chord - corners[0])
            r = np.linalg.norm(points, axis=-1)
            weight = np.linalg.det([corners[0], p, q]) * (wu * u)[:, None] * wv / r**3
            values = f((points / r[..., None]).reshape(-1, 3))
            total = total + np.tensordot(weight.ravel(), values, 1)
    return np.asarray(total)


@each_region
def test_moments_are_those_of_quadrature(name: str, seed: int) -> None:
    shape = of(name, seed)
    arcs, n = gather([shape]), shape.n
    expected = quadrature(
        shape, lambda w: np.concatenate([np.ones((len(w), 1)), w, w * (w @ n)[:, None]], axis=1)
    )
    moment, _ = by_arcs.bent_normal(arcs)
    found = [by_arcs.solid_angle(arcs), by_arcs.vector_irradiance(arcs)[0], np.pi * moment[0]]
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=0, atol=QUADRATURE)
    cosine, estimate = by_arcs.hemisphere_fraction(arcs, "cosine")
    uniform, _ = by_arcs.hemisphere_fraction(arcs, "uniform")
    assert cosine[0] == pytest.approx(expected[1:4] @ n / np.pi, abs=QUADRATURE)
    assert uniform[0] == pytest.approx(expected[0] / (2 * np.pi), abs=QUADRATURE)
    assert 0 < estimate[0] < ROUNDING  # closed


# -------------------------------------------------------------------------------------------- closed forms


def test_an_octant() -> None:
    arcs = gather([octant(0)])
    assert by_arcs.solid_angle(arcs)[0] == pytest.approx(np.pi / 2, abs=ROUNDING)
    np.testing.assert_allclose(by_arcs.vector_irradiance(arcs)[0], np.full(3, np.pi / 4), atol=ROUNDING)
    expected = np.array([1 / 3, 1 / 3, np.pi / 6]) / np.pi
    np.testing.assert_allclose(by_arcs.bent_normal(arcs)[0][0], expected, rtol=0, atol=ROUNDING)
    sky, _ = by_arcs.sky_view_factor(arcs, np.array([1.0, 0.0, 0.0]))
    assert sky[0] == pytest.approx(0.25, abs=ROUNDING)


@pytest.mark.parametrize("corners", [3, 40, 3000])
@pytest.mark.parametrize("radius", [1e-6, 0.4, 1.5])
def test_regular_polygons(corners: int, radius: float) -> None:
    n = unit(np.array([1.0, 2.0, -0.5]))
    arcs = gather([region(n, around(n, np.full(corners, radius)))])
    # Girard's excess and Lambert's sum of right triangles; the former cancels.
    half = np.pi / corners
    excess = np.arctan2(1.0, np.cos(radius) * np.tan(half)) - (0.5 * np.pi - half)
    side = 2 * np.arcsin(np.sin(half) * np.sin(radius))
    slant = np.tan(radius) * np.cos(half)  # of the apothem: N.n = sin(apothem)
    rounding = ROUNDING + corners * 1e-17
    assert by_arcs.solid_angle(arcs)[0] == pytest.approx(2 * corners * excess, abs=corners * 1e-15)
    cosine, _ = by_arcs.hemisphere_fraction(arcs, "cosine")
    expected = 0.5 * corners * side * slant / np.hypot(1.0, slant) / np.pi
    assert cosine[0] == pytest.approx(expected, abs=rounding, rel=1e-9 if radius < 1e-3 else rounding)
    bent, _ = by_arcs.bent_normal(arcs)
    np.testing.assert_allclose(np.cross(bent[0], n), 0, atol=rounding)


@pytest.mark.parametrize("tip", [1e-6, 1e-8, 1e-11, 1e-14])
def test_arcs_of_nearly_pi(tip: float) -> None:
    for seed in range(5):
        shape = lune(seed, tip)
        arcs = gather([shape])
        t, m, n = frame(shape.n).T
        gamma = np.arctan2(shape.rows[2, 6:] @ m, -shape.rows[2, 6:] @ n)  # the opening; the tips are tip^2
        assert by_arcs.solid_angle(arcs)[0] == pytest.approx(2 * gamma, abs=ROUNDING + 2 * tip**2)
        cosine, _ = by_arcs.hemisphere_fraction(arcs, "cosine")
        assert cosine[0] == pytest.approx(0.5 * (1 - np.cos(gamma)), abs=ROUNDING + tip**2)
        moment = np.array([0, np.sin(gamma) ** 2 / 2, gamma / 2 - np.sin(2 * gamma) / 4]) * 4 / 3 / np.pi
        expected = frame(shape.n) @ moment
        np.testing.assert_allclose(by_arcs.bent_normal(arcs)[0][0], expected, rtol=0, atol=ROUNDING + tip**2)
        # The half of it on one side of the plane through t's middle.
        sky, _ = by_arcs.sky_view_factor(arcs, t)
        assert sky[0] == pytest.approx(0.5 * cosine[0], abs=ROUNDING + tip**2)


@pytest.mark.parametrize("corners", [4, 5, 64])
def test_an_open_sky_is_exact_and_nothing_is_exactly_nothing(corners: int) -> None:
    normals = unit(np.random.default_rng(0).normal(size=(30, 3)))
    up = np.array([0.6, 0.0, 0.8])
    wide = gather([horizon(n, corners) for n in normals])
    shut = gather([nothing(n) for n in normals])
    for weighting in ("cosine", "uniform"):
        assert (by_arcs.hemisphere_fraction(wide, weighting)[0] == 1).all()
        assert (by_arcs.hemisphere_fraction(shut, weighting)[0] == 0).all()
        value, _ = arcs_sh.sh_transfer(wide, 4, weighting)
        np.testing.assert_array_equal(value, sh.open_hemisphere(normals, 4, weighting))
        assert (arcs_sh.sh_transfer(shut, 4, weighting)[0] == 0).all()
    np.testing.assert_array_equal(by_arcs.bent_normal(wide)[0], 2 / 3 * normals)
    assert (by_arcs.bent_normal(shut)[0] == 0).all()
    np.testing.assert_allclose(by_arcs.sky_view_factor(wide, up)[0], (1 + normals @ up) / 2, rtol=1e-15)
    assert (by_arcs.sky_view_factor(shut, up)[0] == 0).all()


def test_the_sums_of_an_open_sky_are_right_as_well() -> None:
    # As part of the list of an arc that encloses nothing, so that it does not count as open.
    n = unit(np.array([1.0, 2.0, -0.5]))
    wide, spike = horizon(n), unit(frame(n) @ np.array([[0.3, 0.1, 0.8], [0.2, 0.4, 0.7]]).T).T
    spike = unit(spike)
    there = region(n, spike)
    arcs = gather([Region(n, np.concatenate([wide.rows, there.rows]), np.zeros(8, bool))])
    assert by_arcs.hemisphere_fraction(arcs, "cosine")[0][0] == pytest.approx(1, abs=ROUNDING)
    assert by_arcs.hemisphere_fraction(arcs, "uniform")[0][0] == pytest.approx(1, abs=ROUNDING)
    np.testing.assert_allclose(by_arcs.bent_normal(arcs)[0][0], 2 / 3 * n, rtol=0, atol=ROUNDING)
    value, _ = arcs_sh.sh_transfer(arcs, 10, "cosine")
    np.testing.assert_allclose(value, sh.open_hemisphere(n[None], 10, "cosine"), rtol=0, atol=ROUNDING)


# --------------------------------------------------------------------------------------------------- skies


def ups(shape: Region) -> dict[str, np.ndarray]:
    """Second horizons, with all that can coincide."""
    n, a, b = shape.n, shape.rows[0, :3], shape.rows[0, 3:6]
    corner = shape.rows[len(shape.rows) // 2, :3]
    return {
        "any": unit(np.array([0.3, -0.7, 0.5])),
        "other": unit(np.array([-0.2, 0.1, 0.9])),
        "normal": n,
        "almost the normal": unit(n + 1e-7 * frame(n)[:, 0]),
        "hardly not the normal": unit(n + 3e-9 * frame(n)[:, 0]),
        "opposite": -n,
        "almost opposite": unit(-n + 1e-6 * frame(n)[:, 1]),
        "wall": frame(n)[:, 0],
        "corner on the axis": corner,
        "corner below the axis": -corner,
        "arc through the axis": unit(a + b),
        "corners on the circle": unit(np.cross(a, corner)) if abs(a @ corner) < 0.99 else frame(a)[:, 0],
        "arc on the circle": shape.rows[0, 6:],
        "arc on the circle from below": -shape.rows[0, 6:],
    }


@pytest.mark.parametrize("which", list(ups(octant(0))))
@each_region
def test_sky_view_factors_are_those_of_quadrature(name: str, seed: int, which: str) -> None:
    shape = of(name, seed)
    up = ups(shape)[which]
    found, estimate = by_arcs.sky_view_factor(gather([shape]), up)
    expected = quadrature(shape, lambda w: w @ shape.n, up) / np.pi if which != "opposite" else 0.0
    assert found[0] == pytest.approx(expected, abs=QUADRATURE)
    assert 0 <= found[0] <= (1 + shape.n @ up) / 2 + 2e-16
    assert estimate[0] < ROUNDING + QUADRATURE


@pytest.mark.parametrize("which", ["corner on the axis", "corners on the circle", "arc on the circle"])
@each_region
def test_skies_where_copies_of_a_corner_differ(name: str, seed: int, which: str) -> None:
    # Each arc computes its ends for itself: they agree to rounding only.
    shape = of(name, seed)
    up = ups(shape)[which]
    expected, _ = by_arcs.sky_view_factor(gather([shape]), up)
    for trial in range(10):
        noise = np.random.default_rng(trial).uniform(-2e-16, 2e-16, (len(shape.rows), 6))
        rows = shape.rows.copy()
        rows[:, :6] += noise
        found, _ = by_arcs.sky_view_factor(gather([shape._replace(rows=rows)]), up)
        assert found[0] == pytest.approx(expected[0], abs=ROUNDING)


# ------------------------------------------------------------------------------------ spherical harmonics


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
@pytest.mark.parametrize("max_degree", [0, 1, 4, 10, 16])
def test_transfer_is_that_of_quadrature(max_degree: int, weighting: str) -> None:
    for name, seed in CASES[::2]:
        shape = of(name, seed)

        def f(w: np.ndarray, n: np.ndarray = shape.n) -> np.ndarray:
            y = sh.harmonics(np.ascontiguousarray(w), max_degree)
            return y * (w @ n / np.pi)[:, None] if weighting == "cosine" else y

        found, estimate = arcs_sh.sh_transfer(gather([shape]), max_degree, weighting)
        np.testing.assert_allclose(found[0], quadrature(shape, f), rtol=0, atol=QUADRATURE)
        assert 0 < estimate[0] < 1e-13


def test_harmonics_turn_with_the_region() -> None:
    shapes = [of(name, seed) for name, seed in CASES]
    for weighting in ("cosine", "uniform"):
        straight, _ = arcs_sh.sh_transfer(gather(shapes), 10, weighting)
        for rotation in Rotation.random(3, random_state=0).as_matrix():
            turned, _ = arcs_sh.sh_transfer(gather([s.turned(rotation) for s in shapes]), 10, weighting)
            # 2 pi at most; the rotation itself rounds by about 1e-15 of that a degree.
            np.testing.assert_allclose(turned, rotate(straight, rotation), rtol=0, atol=6e-14)


def test_lobes_are_well_conditioned() -> None:
    conditions = [arcs_sh.lobes(degree).condition for degree in range(18)]
    assert max(conditions) < 21
    assert arcs_sh.lobes(5).axes.shape == (48,) and arcs_sh.lobes(5).matrix.shape == (36, 16)


def test_irradiance_from_harmonics() -> None:
    rng = np.random.default_rng(0)
    coefficients = rng.normal(size=(25, 3))
    shapes = [of(name, 0) for name in REGIONS]
    found, estimate = arcs_sh.sh_irradiance(gather(shapes), coefficients, 4)
    for shape, value in zip(shapes, found, strict=True):

        def f(w: np.ndarray, n: np.ndarray = shape.n) -> np.ndarray:
            return (w @ n)[:, None] * (sh.harmonics(np.ascontiguousarray(w), 4) @ coefficients)

        np.testing.assert_allclose(value, quadrature(shape, f), rtol=0, atol=10 * QUADRATURE)
    assert (estimate < 1e-12).all()
    # A constant environment: pi L times ambient occlusion.
    grey = np.zeros((25, 1))
    grey[0] = np.sqrt(4 * np.pi) * 3
    found, _ = arcs_sh.sh_irradiance(gather(shapes), grey, 4)
    cosine, _ = by_arcs.hemisphere_fraction(gather(shapes), "cosine")
    np.testing.assert_allclose(found[:, 0], 3 * np.pi * cosine, rtol=1e-14)


# ---------------------------------------------------------------------------------------------- invariances

UP = unit(np.array([0.2, 0.9, 0.4]))


def everything(arcs: Arcs) -> np.ndarray:
    """All integrands that have one value for any way to list a boundary: (n, C)."""
    cosine, uniform = (by_arcs.hemisphere_fraction(arcs, w)[0] for w in ("cosine", "uniform"))
    columns = [cosine, uniform, by_arcs.sky_view_factor(arcs, UP)[0]]
    tables = [
        by_arcs.bent_normal(arcs)[0],
        *(arcs_sh.sh_transfer(arcs, 5, w)[0] for w in ("cosine", "uniform")),
    ]
    return np.concatenate([np.stack(columns, axis=1), *tables], axis=1)


def cut(rows: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Arcs in pieces: at fractions of their lengths, given in ascending order."""
    pieces = []
    for a, b, normal in rows.reshape(-1, 3, 3):
        length = np.arctan2(normal @ np.cross(a, b), a @ b)
        s = (length * at)[:, None]
        ends = np.concatenate([[a], np.cos(s) * a + np.sin(s) * np.cross(normal, a), [b]])
        pieces += [np.concatenate([p, q, normal]) for p, q in pairwise(ends)]
    return np.array(pieces)


@pytest.mark.parametrize("gap", [1e-3, 1e-8, 1e-12, 1e-16, 0.0])
def test_tiny_arcs_change_nothing(gap: float) -> None:
    at = np.concatenate([0.2 + gap * np.arange(4), 0.7 + gap * np.arange(3)])
    for name in REGIONS:
        shape = of(name, 1)
        rows = cut(shape.rows, at)
        cut_shape = shape._replace(rows=rows, free=np.repeat(shape.free, len(at) + 1))
        plain, pieces = everything(gather([shape])), everything(gather([cut_shape]))
        np.testing.assert_allclose(pieces, plain, rtol=0, atol=2 * ROUNDING)


@given(st.integers(0, 10**6), st.sampled_from(sorted(REGIONS)))
def test_the_order_of_arcs_matters_to_rounding_only(seed: int, name: str) -> None:
    shape = of(name, seed)
    order = np.random.default_rng(seed).permutation(len(shape.rows))
    mixed = shape._replace(rows=shape.rows[order], free=shape.free[order])
    plain = everything(gather([shape]))
    np.testing.assert_allclose(everything(gather([mixed])), plain, rtol=0, atol=2 * ROUNDING)


@given(st.integers(0, 10**6), st.sampled_from(sorted(REGIONS)))
def test_opposite_arcs_cancel(seed: int, name: str) -> None:
    shape = of(name, seed)
    rng = np.random.default_rng(seed)
    across = rng.normal(size=(3, 3))
    a, b = (unit(x + (abs(x @ shape.n) + 0.01) * shape.n) for x in (across[0], across[1]))
    scale = 10.0 ** rng.uniform(-13, 0)
    b = unit(a + scale * (b - a))
    extra = np.concatenate([a, b, unit(np.cross(a, b - a))])
    back = np.concatenate([b, a, -extra[6:]])
    more = Region(shape.n, np.concatenate([[extra], shape.rows, [back]]), np.r_[False, shape.free, False])
    plain = everything(gather([shape]))
    np.testing.assert_allclose(everything(gather([more])), plain, rtol=0, atol=2 * ROUNDING)


@given(st.integers(0, 10**6), st.sampled_from(sorted(REGIONS)))
def test_fractions_do_not_turn(seed: int, name: str) -> None:
    shape = of(name, seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    straight, turned = gather([shape]), gather([shape.turned(rotation)])
    for weighting in ("cosine", "uniform"):
        plain, _ = by_arcs.hemisphere_fraction(straight, weighting)
        np.testing.assert_allclose(
            by_arcs.hemisphere_fraction(turned, weighting)[0], plain, rtol=0, atol=ROUNDING
        )
    bent, _ = by_arcs.bent_normal(straight)
    np.testing.assert_allclose(by_arcs.bent_normal(turned)[0], bent @ rotation.T, rtol=0, atol=ROUNDING)
    sky, _ = by_arcs.sky_view_factor(straight, UP)
    np.testing.assert_allclose(
        by_arcs.sky_view_factor(turned, rotation @ UP)[0], sky, rtol=0, atol=2 * ROUNDING
    )


def test_a_point_has_the_same_bits_among_any_others_and_for_any_number_of_threads() -> None:
    shapes = [of(name, seed) for name, seed in CASES] + [nothing(Z), horizon(Z)]
    shapes = shapes * 6
    together = everything(gather(shapes))
    order = np.random.default_rng(0).permutation(len(shapes))
    np.testing.assert_array_equal(everything(gather([shapes[i] for i in order])), together[order])
    for i in range(0, len(CASES) + 2, 3):
        np.testing.assert_array_equal(everything(gather([shapes[i]])), together[[i]])
    if not JIT_DISABLED:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)
        try:
            np.testing.assert_array_equal(everything(gather(shapes)), together)
        finally:
            numba.set_num_threads(threads)


@each_region
def test_estimates_show_a_missing_arc(name: str, seed: int) -> None:
    shape = of(name, seed)
    whole = gather([shape])
    for missing in range(len(shape.rows)):
        kept = np.arange(len(shape.rows)) != missing
        rest = gather([Region(shape.n, shape.rows[kept], shape.free[kept])])
        for f in (
            lambda arcs: by_arcs.hemisphere_fraction(arcs, "cosine"),
            lambda arcs: by_arcs.hemisphere_fraction(arcs, "uniform"),
            by_arcs.bent_normal,
            lambda arcs: arcs_sh.sh_transfer(arcs, 10, "cosine"),
            lambda arcs: arcs_sh.sh_transfer(arcs, 10, "uniform"),
        ):
            truth, _ = f(whole)
            value, estimate = f(rest)
            assert np.linalg.norm(value - truth) <= estimate[0]
