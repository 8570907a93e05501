"""Integrals along radial isolines: lines against quadrature, all of them against formulas, and their rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from scenes import polyhedra
from scenes.mesh import moved
from silint import Scene, SilhouetteIntegrator
from silint.core.integrands import radial
from silint.core.radial import RadialIntervals, line_table, normal_table, set_frame
from silint.reference import brute_force, closed_form

K = 12


def units(n: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


# ---------------------------------------------------------------------------------------------- one line


def some_intervals(n: int, seed: int) -> RadialIntervals:
    """Any intervals above the horizon of any normals; none on some lines, the whole of others, slivers."""
    rng = np.random.default_rng(seed)
    horizon = np.arctan2(1.0, normal_table(line_table(K))[:, 1])
    counts, rows = np.zeros((n, K), np.int32), []
    for i in range(n):
        for k in range(K):
            counts[i, k] = rng.integers(0, 4)
            theta = np.sort(rng.uniform(0, horizon[k], 2 * counts[i, k]))
            if counts[i, k] and rng.random() < 0.3:
                theta[0] = 0.0
            if counts[i, k] and rng.random() < 0.3:
                theta[-1] = horizon[k]
            if counts[i, k] and rng.random() < 0.2:
                theta[0] = max(theta[1] - 1e-9, 0.0)
            with np.errstate(divide="ignore"):
                rows.append(np.where(theta == 0, np.inf, 1 / np.tan(theta)).reshape(-1, 2))
    starts = np.concatenate([[0], np.cumsum(counts.sum(axis=1))[:-1]])
    return RadialIntervals(units(n, seed), counts, starts, np.concatenate(rows))


NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def quadrature(
    visible: RadialIntervals, f: Callable[[np.ndarray, np.ndarray], np.ndarray], whole: bool = False
) -> np.ndarray:
    """Integrals of f(w, n) sin(theta) over the intervals of each point and line: (n, K, ...)."""
    lines = line_table(K)
    horizon = np.arctan2(1.0, normal_table(lines)[:, 1])
    result = []
    for i, n in enumerate(visible.normals):
        frame = np.empty((3, 3))
        set_frame(n, frame)
        row = visible.starts[i]
        for k in range(K):
            parts = [(0.0, horizon[k])]
            if not whole:
                keys = visible.intervals[row : row + visible.counts[i, k]]
                row += len(keys)
                parts = np.arctan2(1.0, keys)
            total = 0.0
            for low, high in parts:
                theta = 0.5 * (low + high) + 0.5 * (high - low) * NODES
                t = lines[k] @ frame[:2]
                w = np.cos(theta)[:, None] * frame[2] + np.sin(theta)[:, None] * t
                weight = 0.5 * (high - low) * WEIGHTS * np.sin(theta)
                total = total + (weight.reshape(-1, *[1] * (f(w, n).ndim - 1)) * f(w, n)).sum(axis=0)
            result.append(np.broadcast_to(total, f(n[None], n).shape[1:]))
    return np.array(result).reshape(len(visible.normals), K, *result[0].shape)


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_fractions_are_those_of_quadrature(weighting: str) -> None:
    visible = some_intervals(20, 0)

    def f(w: np.ndarray, n: np.ndarray) -> np.ndarray:
        return w @ n if weighting == "cosine" else np.ones(len(w))

    seen, whole = quadrature(visible, f), quadrature(visible, f, whole=True)
    # Each of four groups of lines by itself.
    groups = [seen[:, g::4].sum(axis=1) / whole[:, g::4].sum(axis=1) for g in range(4)]
    value, estimate = radial.hemisphere_fraction(visible, weighting)
    np.testing.assert_allclose(value, np.mean(groups, axis=0), rtol=0, atol=1e-13)
    np.testing.assert_allclose(estimate, 0.5 * np.std(groups, axis=0), rtol=0, atol=1e-13)


def test_sky_view_factors_are_those_of_quadrature() -> None:
    visible = some_intervals(20, 1)
    for up in (np.array([0.0, 0.0, 1.0]), *units(3, 2), *visible.normals[:2], -visible.normals[2]):
        # Clipped by the second horizon, interval by interval: exact, so that quadrature sees no kink.
        clipped_rows, counts, whole_rows = [], np.zeros_like(visible.counts), []
        lines, horizon = line_table(K), np.arctan2(1.0, normal_table(line_table(K))[:, 1])
        for i, n in enumerate(visible.normals):
            frame = np.empty((3, 3))
            set_frame(n, frame)
            row = visible.starts[i]
            for k in range(K):
                ua, ut = frame[2] @ up, lines[k] @ frame[:2] @ up
                cut = np.arctan2(ua, -ut)  # cos(theta) ua + sin(theta) ut = 0
                low, high = (0.0, cut) if ua > 0 else (cut + np.pi, np.pi)
                keys = np.arctan2(1.0, visible.intervals[row : row + visible.counts[i, k]])
                row += len(keys)
                for parts, out in ((keys, clipped_rows), ([(0.0, horizon[k])], whole_rows)):
                    for a, b in parts:
                        a, b = max(a, low), min(b, high)
                        out.append((a, b) if a < b else (1.0, 1.0))
                counts[i, k] = len(keys)
        values = []
        for rows, c in ((clipped_rows, counts), (whole_rows, np.ones_like(counts))):
            starts = np.concatenate([[0], np.cumsum(c.sum(axis=1))[:-1]])
            with np.errstate(divide="ignore"):
                keys = 1 / np.tan(np.array(rows).reshape(-1, 2))
            values.append(
                quadrature(RadialIntervals(visible.normals, c, starts, keys), lambda w, n: w @ n).sum(axis=1)
            )
        expected = values[0] / np.where(values[1] > 0, values[1], 1) * 0.5 * (1 + visible.normals @ up)
        found, estimate = radial.sky_view_factor(visible, up)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
        assert ((estimate >= 0) & (estimate <= 1)).all()


def test_bent_normals_are_those_of_quadrature() -> None:
    visible = some_intervals(20, 3)

    def f(w: np.ndarray, n: np.ndarray) -> np.ndarray:
        return (w @ n)[:, None] * w

    seen, whole = (2 / K * quadrature(visible, f, whole=w).sum(axis=1) for w in (False, True))
    fraction, _ = radial.hemisphere_fraction(visible, "cosine")
    found, _ = radial.bent_normal(visible)
    expected = seen + fraction[:, None] * (2 / 3 * visible.normals - whole)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


# -------------------------------------------------------------------------------------------- all of them

RECTANGLE = np.array([(-0.5, 2.0, 1.0), (1.0, 2.0, 1.0), (1.0, 2.5, 2.2), (-0.5, 2.5, 2.2)])
BALL = moved(polyhedra.icosphere(2), (0.3, 0.2, 1.8))


def over_ground(n: int = 200, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3)) * 0.5 + [0.0, 0.0, 1.0]
    return rng.uniform(-1, 1, (n, 3)) * [1, 1, 0.3], normals / np.linalg.norm(normals, axis=1)[:, None]


def hidden_by_rectangle(p: np.ndarray, n: np.ndarray) -> closed_form.Hidden:
    return closed_form.polygon(RECTANGLE, p, n)


def hidden_by_ball(p: np.ndarray, n: np.ndarray) -> closed_form.Hidden:
    return closed_form.convex_polyhedron(BALL[0], p, n)


SHEET = RECTANGLE, np.array([(0, 1, 2), (0, 2, 3)])


def check_rate(errors: dict[int, np.ndarray], at_64: float, at_256: float) -> None:
    """Root mean squares, and that they fall like lines^-1.5, give or take the luck of the lines."""
    rms = {k: np.sqrt((e**2).mean()) for k, e in errors.items()}
    print({k: f"{r:.1e}" for k, r in rms.items()})
    assert rms[64] < at_64 and rms[256] < at_256
    slope = np.polyfit(np.log2(list(rms)), np.log2(list(rms.values())), 1)[0]
    assert -2.2 < slope < -1.2


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
@pytest.mark.parametrize(("mesh", "hidden"), [(SHEET, hidden_by_rectangle), (BALL, hidden_by_ball)])
def test_occlusion_by_a_sheet_and_by_a_solid(mesh: tuple, hidden: Callable, weighting: str) -> None:
    points, normals = over_ground()
    exact = np.array([1 - getattr(hidden(p, n), weighting) for p, n in zip(points, normals, strict=True)])
    integrator = SilhouetteIntegrator(Scene(*mesh))
    errors = {
        k: integrator.ambient_occlusion(points, normals, k, weighting, "radial") - exact
        for k in (16, 32, 64, 128, 256, 512)
    }
    check_rate(errors, 1e-3, 1.3e-4)


def test_the_sky_past_a_sheet() -> None:
    """Above both horizons: what the sheet takes from the sky is its form factor."""
    points, normals = over_ground()
    up = np.array([0.1, 0.2, 1.0])
    axis = up / np.linalg.norm(up)
    assert all(((RECTANGLE - p) @ axis > 0).all() for p in points)
    exact = np.array(
        [
            0.5 * (1 + n @ axis) - hidden_by_rectangle(p, n).cosine
            for p, n in zip(points, normals, strict=True)
        ]
    )
    integrator = SilhouetteIntegrator(Scene(*SHEET))
    errors = {
        k: integrator.sky_view_factor(points, normals, up, k, "radial") - exact
        for k in (16, 32, 64, 128, 256, 512)
    }
    check_rate(errors, 1e-3, 1.3e-4)


def test_bent_normals_past_a_ball() -> None:
    points, normals = over_ground(40)
    integrator = SilhouetteIntegrator(Scene(*BALL))
    topology = integrator.scene.topology
    p, n = integrator._finder.shade_points(points, normals)
    exact = brute_force.bent_normals(topology.vertices, topology.faces, p, n, 512)
    errors = {
        k: np.linalg.norm(integrator.bent_normals(points, normals, k, "radial") - exact, axis=1)
        for k in (16, 32, 64, 128, 256)
    }
    check_rate(errors, 1e-3, 1.3e-4)


@pytest.mark.parametrize("angle", [0.2, 0.7, 1.2])
def test_a_disc_overhead_takes_its_cone(angle: float) -> None:
    """(1/pi) int cos(theta) w dw over the cone is 2/3 (1 - cos^3) n; in fractions, sin^2 and 1 - cos."""
    disc = moved(polyhedra.disc(np.tan(angle), 512), (0.0, 0.0, 1.0))
    integrator = SilhouetteIntegrator(Scene(*disc))
    one = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    c = np.cos(angle)
    # A polygon of 512 corners is smaller by 2.5e-5.
    for k, atol in ((64, 3e-3), (256, 4e-4)):
        (bent,) = integrator.bent_normals(*one, k, "radial")
        np.testing.assert_allclose(bent, [0, 0, 2 / 3 * c**3], rtol=0, atol=atol)
        (cosine,) = integrator.ambient_occlusion(*one, k, "cosine", "radial")
        assert cosine == pytest.approx(c * c, abs=atol)
        (uniform,) = integrator.ambient_occlusion(*one, k, "uniform", "radial")
        assert uniform == pytest.approx(c, abs=atol)
        (sky,) = integrator.sky_view_factor(*one, (0, 0, 1), k, "radial")
        assert sky == pytest.approx(c * c, abs=atol)
