"""Limits of what counts: distance and falloff, spread, backfaces, ground; against formulas and rays."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numba
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import t as student

from scenes.clutter import clutter
from scenes.foliage import foliage
from silint import Environment, InputError, Limits, Scene, SilhouetteIntegrator, ambient_occlusion
from silint.core import visible
from silint.core.caps import LineLimits
from silint.core.search import TILE
from silint.core.visible import FoundRadial, find_radial
from silint.reference import EmbreeQMC, embree_available

Rows = tuple[np.ndarray, np.ndarray]

ORIGIN = np.zeros((1, 3))
UP = np.array([[0.0, 0.0, 1.0]])

# Lines about an axis 2 degrees off that of a round outline: a smooth function of azimuth. What is left is how
# far points are lifted in a scene of this size, 2^-36 of 100.
SMOOTH = 1e-8
# The error of 1024 lines where an outline is not smooth in azimuth: below this in all scenes measured.
LINES, ROUGH = 1024, 2e-4


def rectangle(corner: tuple[float, ...], u: tuple[float, ...], v: tuple[float, ...]) -> Scene:
    a, b, c = np.array(corner, float), np.array(u, float), np.array(v, float)
    return Scene(np.array([a, a + b, a + b + c, a + c]), [[0, 1, 2], [0, 2, 3]])


@cache
def ceiling(half: float = 100.0) -> SilhouetteIntegrator:
    """At height 1, its front downwards."""
    found = rectangle((-half, -half, 1), (0, 2 * half, 0), (2 * half, 0, 0))
    return SilhouetteIntegrator(found)


@cache
def wall(half: float = 1e6) -> SilhouetteIntegrator:
    """In the plane x = 1, above the horizon, its front towards the origin."""
    return SilhouetteIntegrator(rectangle((1, -half, 0), (0, 0, half), (0, 2 * half, 0)))


@cache
def cluttered() -> SilhouetteIntegrator:
    """Boxes and balls, in the coordinates of float32 that Embree has."""
    vertices, faces = clutter(2, 1)
    return SilhouetteIntegrator(Scene(np.asarray(vertices, np.float32).astype(np.float64), faces))


@cache
def leaves() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*foliage(1, 1)))


def rows(sil: SilhouetteIntegrator, n: int, seed: int = 0) -> Rows:
    """Points in front of faces, far enough for Embree."""
    p, normals, valid = sil.scene.face_centers_normals()
    chosen = np.random.default_rng(seed).choice(np.flatnonzero(valid), n, replace=False)
    return p[chosen] + 1e-4 * sil.scene.extent * normals[chosen], normals[chosen]


# --------------------------------------------------------------------------------------------- max_distance


@pytest.mark.parametrize("R", [1.25, 2.0, 10.0])
def test_a_ceiling_hides_the_cap_that_is_near(R: float) -> None:
    """At height h it is nearer than R where cos(theta) > h / R: a share 1 - (h / R)^2, or 1 - h / R."""
    sil = ceiling()
    assert abs(sil.ambient_occlusion(ORIGIN, UP, max_distance=R)[0] - R**-2) < SMOOTH
    assert abs(sil.ambient_occlusion(ORIGIN, UP, max_distance=R, weighting="uniform")[0] - 1 / R) < SMOOTH


@pytest.mark.parametrize("R", [1.25, 2.0, 10.0])
def test_a_wall_hides_a_cap_about_the_horizon(R: float) -> None:
    """1 - (g - sin(g) cos(g)) / pi with cos(g) = d / R; half of a cap's solid angle."""
    g = np.arccos(1 / R)
    found = wall().ambient_occlusion(ORIGIN, UP, LINES, max_distance=R)[0]
    assert abs(found - (1 - (g - np.sin(g) * np.cos(g)) / np.pi)) < ROUGH
    found = wall().ambient_occlusion(ORIGIN, UP, LINES, "uniform", max_distance=R)[0]
    assert abs(found - (1 - 0.5 * (1 - 1 / R))) < ROUGH


@pytest.mark.parametrize("R", [0.9, 1.05, 1.2, 1.5])
def test_a_disc_overhead(R: float) -> None:
    """Of the radius 1/2 at the height 1: hidden up to its rim, or to where it is R away."""
    turn = 2 * np.pi * np.arange(2000) / 2000
    rim = np.column_stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), np.ones_like(turn)])
    faces = [[0, i, i + 1] for i in range(1, len(turn) - 1)]
    sil = SilhouetteIntegrator(Scene(rim, faces))
    square = min(1 / (1 + 4), max(1 - R**-2, 0.0))  # sin^2 of the angle
    # The polygon is smaller than the disc by 2 pi^2 / (3 * 2000^2) of its area.
    assert abs(sil.ambient_occlusion(ORIGIN, UP, max_distance=R)[0] - (1 - square)) < 1e-5


@pytest.mark.parametrize("R", [0.9, 1.1, 1.5, 1.7, 1.8, 4.0])
def test_a_ball_overhead(R: float) -> None:
    """Of radius 1 at the distance D = 2: what is near is seen within the angle of the law of cosines."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(4)
    sil = SilhouetteIntegrator(Scene(ball.vertices + [0, 0, 2], ball.faces))
    if R >= np.sqrt(3):
        square = 1 / 4
    else:
        square = 1 - min((R * R + 3) / (4 * R), 1.0) ** 2
    # Faces lie up to 1.2e-3 inside the ball.
    assert abs(sil.ambient_occlusion(ORIGIN, UP, max_distance=R)[0] - (1 - square)) < 2.5e-3


def test_percent_are_of_the_diagonal() -> None:
    sil = cluttered()
    p, n = rows(sil, 20)
    used = sil.scene.vertices[np.unique(sil.scene.faces)]
    diagonal = float(np.linalg.norm(np.ptp(used, axis=0)))
    found = sil.ambient_occlusion(p, n, max_distance="12.5%")
    np.testing.assert_allclose(
        found, sil.ambient_occlusion(p, n, max_distance=diagonal / 8), rtol=0, atol=1e-12
    )
    assert np.ptp(found) > 0.1


@pytest.mark.parametrize("R", [0.2, 1.0, 4.0])
def test_rays_that_end_agree(R: float) -> None:
    if not embree_available():
        pytest.skip("no embreex here")
    sil = cluttered()
    p, n = rows(sil, 150)
    found = sil.ambient_occlusion(p, n, LINES, max_distance=R, full_output=True)
    embree = EmbreeQMC(sil.scene.vertices, sil.scene.faces)
    rays = embree.ambient_occlusion(p, n, 512, scrambles=32, max_distance=R)
    off = found.value - rays.value
    known = rays.standard_error > 0
    z = off[known] / np.hypot(rays.standard_error, found.error_estimate)[known]
    # What one of all points passes in a thousand runs.
    assert np.abs(z).max() < student.isf(0.5e-3 / len(p), 31)
    assert np.sqrt((z**2).mean()) < 1.3
    # All rays of a point agree: so do lines, up to what is too small for 16384 rays.
    assert np.abs(off[~known]).max(initial=0.0) < 1e-3
    assert known.sum() > 50


def test_more_distance_hides_more_and_costs_more() -> None:
    for sil in (cluttered(), leaves()):
        p, n = rows(sil, 40)
        last, work = np.ones(len(p)), 0
        for percent in (0.5, 2, 5, 10, 30):
            found = sil.ambient_occlusion(p, n, max_distance=f"{percent}%", full_output=True)
            assert (found.value <= last + 1e-12).all()
            # Faces on the sphere count too, of which there are fewer where it has left most of the scene.
            assert found.diagnostics["edges_tested"] >= 0.8 * work
            last, work = found.value, found.diagnostics["edges_tested"]
        near = sil.ambient_occlusion(p, n, max_distance="0.5%", full_output=True).diagnostics
        assert near["edges_tested"] < 0.5 * work
        assert (sil.ambient_occlusion(p, n) <= last + 1e-6).all()  # swept, perhaps: to rounding of crossings


@pytest.mark.parametrize("sil", [cluttered, leaves])
def test_beyond_the_scene_every_bit_is_that_of_no_limit(sil: Any) -> None:
    sil = sil()
    p, n = rows(sil, 60)
    free = sil.ambient_occlusion(p, n, full_output=True)
    for R in (2.0 * sil.scene.extent, 1e300, "200%"):
        found = sil.ambient_occlusion(p, n, max_distance=R, full_output=True)
        assert (found.value == free.value).all()
        assert (found.error_estimate == free.error_estimate).all()
    # With backfaces, against covering without a distance.
    some = sil.ambient_occlusion(p, n, backfaces="ignore")
    assert (sil.ambient_occlusion(p, n, backfaces="ignore", max_distance="101%") == some).all()


@pytest.mark.parametrize(
    ("reach", "sweeping", "covering", "cover", "tried"),
    [
        (np.inf, 1e3, 0.0, False, [False]),
        (np.inf, 1e9, 1e8, True, [False, True]),
        (np.inf, 1e8, 1e9, False, [False, True]),
        (0.1, 0.0, 1e3, True, [True]),
        (0.1, 1e8, 1e9, False, [True, False]),
        (0.1, 1e9, 1e8, True, [True, False]),
    ],
)
def test_the_cheaper_way_is_taken_and_no_other_tried_where_one_is_cheap(
    monkeypatch: pytest.MonkeyPatch,
    reach: float,
    sweeping: float,
    covering: float,
    cover: bool,
    tried: list[bool],
) -> None:
    """Trying a way compiles it, for half a minute."""
    finder, asked = cluttered()._finder, []

    def probe(geometry: Any, bundles: Any, points: Any, normals: Any, cover: bool, limits: Any) -> float:
        asked.append(cover)
        assert len(bundles.face.corners) or (not cover and limits.reach == np.inf)
        return covering if cover else sweeping

    monkeypatch.setattr(visible, "_probe", probe)
    bare = finder.bundles._replace(face=finder.bundles.face._replace(corners=np.zeros(0)))
    found, bundles = visible.prefers_cover(finder.geometry, bare, LineLimits(reach))
    assert (found, asked) == (cover, tried)
    assert len(bundles.face.corners) or not cover


@pytest.mark.parametrize("sil", [cluttered, leaves])
@pytest.mark.parametrize("falloff", ["none", "linear"])
@pytest.mark.parametrize("R", [0.03, 0.2, 0.6])
def test_sweeping_and_covering_give_the_same_bits(sil: Any, falloff: str, R: float) -> None:
    """Each skips what lies beyond the reach of lines by boxes of its own; neither may lack anything."""
    finder = sil()._finder
    vertices = finder.scene.vertices
    rng = np.random.default_rng(3)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    p, n = rng.uniform(low, high, (96, 3)), rng.normal(size=(96, 3))
    p, n = finder.shade_points(p, n)
    limits = finder.line_limits(Limits(R * float(np.linalg.norm(high - low)), falloff))
    swept, covered = (
        find_radial(finder.geometry, finder.bundles, p, n, 64, TILE, 64 * 64 * TILE, cover, limits=limits)
        for cover in (False, True)
    )
    assert isinstance(swept, FoundRadial) and isinstance(covered, FoundRadial) and swept.contradicted == 0
    np.testing.assert_array_equal(swept.visible.counts, covered.visible.counts)
    for i, count in enumerate(swept.visible.counts.sum(axis=1)):
        a, b = swept.visible.starts[i], covered.visible.starts[i]
        np.testing.assert_array_equal(
            swept.visible.intervals[a : a + count], covered.visible.intervals[b : b + count]
        )
    assert (swept.visible.counts > 1).any() or R < 0.1


def test_a_distance_below_all_faces_leaves_everything_open() -> None:
    sil = cluttered()
    p, n = rows(sil, 20)
    assert (sil.ambient_occlusion(p, n, max_distance=1e-300) == 1.0).all()
    assert (sil.ambient_occlusion(p, n, max_distance=1e-5 * sil.scene.extent) == 1.0).all()


# -------------------------------------------------------------------------------------------------- falloff


@pytest.mark.parametrize("R", [1.1, 2.0, 10.0])
def test_falloff_below_a_ceiling(R: float) -> None:
    """int f(h / c) 2 c dc over the near cap, with q = h / R: (1 - q)^2, and 1 - q^2 + 2 q^2 ln(q)."""
    q = 1 / R
    hidden = {"linear": (1 - q) ** 2, "quadratic": 1 - q * q + 2 * q * q * np.log(q)}
    for falloff, expected in hidden.items():
        for isolines, bound in ((64, 4e-3), (LINES, 3e-4)):  # the lattice's discrepancy falls as 1 / lines
            found = ceiling().ambient_occlusion(
                ORIGIN, UP, isolines, max_distance=R, falloff=falloff, full_output=True
            )
            error = abs(found.value[0] - (1 - expected))
            assert error < bound
            assert error < found.error_estimate[0]


@pytest.mark.parametrize("falloff", ["linear", "quadratic"])
def test_falloff_is_the_mean_over_radii(falloff: str) -> None:
    sil = cluttered()
    p, n = rows(sil, 60)
    u = (np.arange(64) + 0.5) / 64
    radii = 2.0 * (u if falloff == "linear" else np.sqrt(u))
    expected = np.mean([sil.ambient_occlusion(p, n, 256, max_distance=float(r)) for r in radii], axis=0)
    found = sil.ambient_occlusion(p, n, max_distance=2.0, falloff=falloff, full_output=True)
    error = np.abs(found.value - expected)
    # Measured: 1.6e-3 for 64 lines; of the midpoint rule over 64 radii 5e-4.
    assert np.sqrt((error**2).mean()) < 4e-3
    assert (error <= found.error_estimate + 1e-3).mean() > 0.9
    # What falls off blocks less than what does not.
    hard = sil.ambient_occlusion(p, n, 256, max_distance=2.0)
    assert (found.value >= hard - 0.01).all() and (found.value > hard + 0.01).any()


# --------------------------------------------------------------------------------------------------- spread


def half_space_in_cone(beta: float, sigma: float, power: int) -> float:
    """Share of a cone on the front of a plane through the apex, whose normal is beta off the axis."""

    def ring(theta: float) -> float:
        c = -np.cos(theta) * np.cos(beta) / max(np.sin(theta) * np.sin(beta), 1e-300)
        return 2 * np.arccos(np.clip(c, -1, 1)) * np.sin(theta) * np.cos(theta) ** power

    bends = [x for x in (abs(np.pi / 2 - beta),) if 0 < x < sigma]
    value, _ = quad(ring, 0, sigma, points=bends or None, epsabs=1e-12, epsrel=1e-12, limit=200)
    whole = np.pi * np.sin(sigma) ** 2 if power else 2 * np.pi * (1 - np.cos(sigma))
    return float(value / whole)


@pytest.mark.parametrize("degrees", [10.0, 40.0, 60.0, 89.0, 90.0])
@pytest.mark.parametrize("tilt", [0.0, 25.0, 60.0, 90.0, 100.0])
@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_a_cone_past_a_half_space(degrees: float, tilt: float, weighting: str) -> None:
    """Under an endless ceiling what is open lies below the horizontal; the normal leans off the nadir."""
    a = np.radians(tilt)
    n = np.array([[0.6 * np.sin(a), 0.8 * np.sin(a), -np.cos(a)]])
    expected = half_space_in_cone(a, np.radians(degrees), weighting == "cosine")
    sil = ceiling(1e6)
    found = sil.ambient_occlusion(ORIGIN, n, method="exact", weighting=weighting, spread=degrees)[0]
    assert abs(found - expected) < 1e-5  # the ceiling ends 1e-6 above the horizon
    found = sil.ambient_occlusion(ORIGIN, n, LINES, weighting, spread=degrees)[0]
    assert abs(found - expected) < ROUGH


@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_lines_and_arcs_agree_in_cones(weighting: str) -> None:
    sil = cluttered()
    p, n = rows(sil, 60)
    hemisphere = sil.ambient_occlusion(p, n, method="exact", weighting=weighting)
    for degrees in (5.0, 30.0, 75.0):
        exact = sil.ambient_occlusion(p, n, method="exact", weighting=weighting, spread=degrees)
        found = sil.ambient_occlusion(p, n, LINES, weighting, spread=degrees, full_output=True)
        error = np.abs(found.value - exact)
        assert np.sqrt((error**2).mean()) < 1e-3 and error.max() < 1e-2
        assert (error <= found.error_estimate + 1e-9).mean() > 0.85
        assert np.abs(exact - hemisphere).max() > 0.02
    almost = sil.ambient_occlusion(p, n, method="exact", weighting=weighting, spread=90.0 - 1e-7)
    np.testing.assert_allclose(almost, hemisphere, rtol=0, atol=1e-8)


@pytest.mark.parametrize("degrees", [0.001, 0.01, 0.3])
def test_narrow_cones_past_an_edge(degrees: float) -> None:
    """A chord half a radius off the middle of a disc, which a cone is as it becomes narrow."""
    x = 0.5 * np.tan(np.radians(degrees))
    sil = SilhouetteIntegrator(rectangle((x, -9, 1), (0, 18, 0), (9, 0, 0)))
    found = sil.ambient_occlusion(ORIGIN, UP, spread=degrees, full_output=True)
    expected = 0.5 + (0.5 * np.sqrt(0.75) + np.arcsin(0.5)) / np.pi
    # Rounding over spread^2, and the cone's own curvature.
    error = abs(found.value[0] - expected)
    assert error < 1e-7 + np.radians(degrees) ** 2
    assert error < found.error_estimate[0] + np.radians(degrees) ** 2


def test_open_cones_are_one_and_closed_ones_zero() -> None:
    sil = ceiling()
    down = -UP
    for degrees in (4.0, 30.0, 89.9):
        for method in ("radial", "exact"):
            assert sil.ambient_occlusion(ORIGIN, down, method=method, spread=degrees)[0] == 1.0
            # Up to 89.4 degrees the ceiling fills the cone.
            hidden = sil.ambient_occlusion(ORIGIN, UP, method=method, spread=min(degrees, 89.0))[0]
            assert hidden < 1e-14
    # Too narrow for lines, so "auto" takes arcs.
    narrow = sil.ambient_occlusion(ORIGIN, [[0.0, 1.0, 1.0]], spread=0.5, full_output=True)
    assert narrow.value[0] < 1e-10 and narrow.diagnostics["exact_points"] == 1


def test_sky_in_a_cone() -> None:
    sil = ceiling()
    for tilt in (0.0, 20.0, 60.0, 85.0, 120.0):
        a = np.radians(tilt)
        normal = [[np.sin(a), 0.0, -np.cos(a)]]  # away from the ceiling
        for degrees in (10.0, 50.0):
            found = sil.sky_view_factor(ORIGIN, normal, (0, 0, -1), spread=degrees)[0]
            assert abs(found - half_space_in_cone(a, np.radians(degrees), 1)) < 1e-9
    p, n = rows(cluttered(), 20)
    for i in range(3):
        options: dict[str, Any] = {"spread": 35.0, "max_distance": 2.0}
        sky = cluttered().sky_view_factor(p[i : i + 1], n[i : i + 1], n[i], **options)
        assert abs(sky - cluttered().ambient_occlusion(p[i : i + 1], n[i : i + 1], **options))[0] < 1e-12


def test_bent_normals_in_a_cone() -> None:
    """int (n.w) w over a cone is 2 pi / 3 (1 - cos^3) n."""
    for degrees in (10.0, 60.0, 90.0):
        c = np.cos(np.radians(degrees)) if degrees < 90 else 0.0
        found = ceiling().bent_normals(ORIGIN, -UP, spread=degrees)[0]
        np.testing.assert_allclose(found, [0, 0, -(2 / 3) * (1 - c**3) / (1 - c * c)], rtol=0, atol=1e-12)
    p, n = rows(cluttered(), 30)
    bent = cluttered().bent_normals(p, n, 256, spread=5.0)
    # In a narrow cone n.w is 1 to 0.4 %.
    np.testing.assert_allclose(
        (bent * n).sum(axis=1), cluttered().ambient_occlusion(p, n, 256, spread=5.0), atol=5e-3
    )


# ------------------------------------------------------------------------------------------------ backfaces


def test_backfaces_may_be_ignored() -> None:
    sil = ceiling()
    above = np.array([[0.0, 0.0, 2.0]])
    for method in ("auto", "radial"):
        assert sil.ambient_occlusion(ORIGIN, UP, method=method, backfaces="ignore")[0] < 1e-3
        assert sil.ambient_occlusion(above, -UP, method=method, backfaces="ignore")[0] == 1.0
    assert sil.ambient_occlusion(above, -UP)[0] < 1e-3
    # Inside a closed solid all faces are seen from their back.
    box = pytest.importorskip("trimesh").creation.box((2, 2, 2))
    inside = SilhouetteIntegrator(Scene(box.vertices, box.faces))
    assert inside.ambient_occlusion(ORIGIN, UP, backfaces="ignore")[0] == 1.0
    assert inside.ambient_occlusion(ORIGIN, UP)[0] == 0.0
    # Outside, closed solids hide as much with their fronts alone.
    p, n = rows(cluttered(), 40)
    both = cluttered().ambient_occlusion(p, n), cluttered().ambient_occlusion(p, n, backfaces="ignore")
    open_solids = np.abs(both[0] - both[1])
    assert np.median(open_solids) < 1e-6


# --------------------------------------------------------------------------------------------------- ground

FAR = rectangle((1e5, 1e5, 1e5), (1, 0, 0), (0, 1, 0))  # a scene that hides nothing to speak of
FLOOR = (0.0, 0.0, 2.0, 0.0)  # z = 0


@cache
def empty() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(rectangle((50, 50, 80), (1e-6, 0, 0), (0, 1e-6, 0)))


def test_the_ground_hides_half_of_what_a_wall_sees() -> None:
    sideways = np.array([[0.6, 0.8, 0.0]])
    for p in ([0.0, 0.0, 3.0], [-5.0, 2.0, 1e-3], [0.0, 0.0, 0.0]):
        assert abs(empty().ambient_occlusion([p], sideways, LINES, ground=FLOOR)[0] - 0.5) < ROUGH
    high = np.array([[0.0, 0.0, 1.0]])
    assert abs(empty().ambient_occlusion(high, UP, ground=FLOOR)[0] - 1.0) < 1e-9
    assert empty().ambient_occlusion(high, -UP, ground=FLOOR)[0] == 0.0
    # A slope of 30 degrees sees (1 + cos) / 2 of the sky.
    slope = [[0.5, 0.0, np.sqrt(0.75)]]
    assert (
        abs(empty().ambient_occlusion(high, slope, LINES, ground=FLOOR)[0] - 0.5 * (1 + np.sqrt(0.75)))
        < ROUGH
    )


@pytest.mark.parametrize("R", [1.25, 2.0, 10.0])
def test_the_ground_is_near_or_not(R: float) -> None:
    g, p = np.arccos(1 / R), np.array([[4.0, 0.0, 1.0]])
    sideways = np.array([[0.6, 0.8, 0.0]])
    found = empty().ambient_occlusion(p, sideways, LINES, max_distance=R, ground=FLOOR)[0]
    assert abs(found - (1 - (g - np.sin(g) * np.cos(g)) / np.pi)) < ROUGH
    assert abs(empty().ambient_occlusion(p, -UP, max_distance=R, ground=FLOOR)[0] - R**-2) < SMOOTH
    # The scene ends within the distance, the ground does not.
    small = SilhouetteIntegrator(rectangle((0, 0, 1.1), (1e-6, 0, 0), (0, 1e-6, 0)))
    found = small.ambient_occlusion([[0, 0, 1.0]], -UP, max_distance=R, ground=FLOOR)[0]
    assert abs(found - R**-2) < SMOOTH


@pytest.mark.parametrize("options", [{}, {"max_distance": 3.0}, {"spread": 50.0}, {"weighting": "uniform"}])
def test_the_ground_is_a_very_large_quad(options: dict[str, Any]) -> None:
    vertices, faces = clutter(2, 1)
    low = vertices[:, 2].min() + 0.3
    a = 1e4
    square = np.array([[-a, -a, low], [a, -a, low], [a, a, low], [-a, a, low]])
    joined = Scene(
        np.concatenate([vertices, square]),
        np.concatenate([faces, len(vertices) + np.array([[0, 1, 2], [0, 2, 3]])]),
    )
    both = SilhouetteIntegrator(joined), SilhouetteIntegrator(Scene(vertices, faces))
    p, n = rows(both[1], 60)
    p, n = p[p[:, 2] > low + 1e-3], n[p[:, 2] > low + 1e-3]
    found = both[1].ambient_occlusion(p, n, ground=(0, 0, 1, -low), **options)
    expected = both[0].ambient_occlusion(p, n, method="radial", **options)
    # The quad ends, 1e-4 above its horizon at most.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-4)
    assert np.abs(found - both[1].ambient_occlusion(p, n, **options)).max() > 0.1


def test_below_the_ground_nothing_is_seen() -> None:
    buried = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    normals = np.repeat(UP, 2, axis=0)
    found = empty().ambient_occlusion(buried, normals, ground=FLOOR, full_output=True)
    assert found.value.tolist() == [0.0, 1.0] and found.diagnostics["buried"] == 1
    assert (empty().bent_normals(buried, normals, ground=FLOOR)[0] == 0.0).all()
    # On it, whatever the normal: what lies above.
    for normal in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.8, 0.0, -0.6]):
        expected = 0.5 * (1 + normal[2])
        assert abs(empty().ambient_occlusion(ORIGIN, [normal], LINES, ground=FLOOR)[0] - expected) < ROUGH


# ---------------------------------------------------------------------------------------------- all of them

EVERYTHING: dict[str, Any] = {
    "max_distance": 2.5,
    "falloff": "linear",
    "backfaces": "ignore",
    "ground": (0.1, 0.0, 1.0, 0.5),
}
ONE_BY_ONE: list[dict[str, Any]] = [
    {"max_distance": 1.0},
    {"max_distance": "3%"},
    {"max_distance": 2.0, "falloff": "linear"},
    {"max_distance": 2.0, "falloff": "quadratic"},
    {"spread": 40.0},
    {"backfaces": "ignore"},
    {"ground": (0.1, 0.0, 1.0, 0.5)},
]


@pytest.mark.parametrize("query", ["ambient_occlusion", "sky_view_factor", "bent_normals", "sh_transfer"])
def test_every_option_changes_something_and_defaults_nothing(query: str) -> None:
    # Leaves are sheets: half of them are seen from their back.
    sil = leaves()
    p, n = rows(sil, 30)
    free = getattr(sil, query)(p, n)
    same = getattr(sil, query)(p, n, max_distance=None, falloff="none", backfaces="block", ground=None)
    assert (free == same).all()
    seen = [free]
    for options in ONE_BY_ONE:
        if query == "sh_transfer" and "spread" in options:
            continue
        seen.append(getattr(sil, query)(p, n, **options))
    for i in range(len(seen)):
        for j in range(i):
            assert np.abs(seen[i] - seen[j]).max() > 1e-4, (i, j)


def test_no_value_depends_on_company_order_or_threads() -> None:
    sil = cluttered()
    p, n = rows(sil, 80)
    # From some of the points the scene ends within this distance.
    far = float(
        np.quantile(
            np.linalg.norm(
                np.maximum(
                    np.abs(p - sil.scene.vertices.min(axis=0)), np.abs(p - sil.scene.vertices.max(axis=0))
                ),
                axis=1,
            ),
            0.5,
        )
    )
    for options in ({**EVERYTHING, "spread": 70.0}, {"max_distance": far, "ground": EVERYTHING["ground"]}):
        together = sil.ambient_occlusion(p, n, **options)
        assert np.ptp(together) > 0.3
        order = np.random.default_rng(1).permutation(len(p))
        assert (sil.ambient_occlusion(p[order], n[order], **options) == together[order]).all()
        for i in (0, 7, 33):
            assert sil.ambient_occlusion(p[i : i + 1], n[i : i + 1], **options)[0] == together[i]
        threads = numba.get_num_threads()
        try:
            numba.set_num_threads(1)
            assert (sil.ambient_occlusion(p, n, **options) == together).all()
        finally:
            numba.set_num_threads(threads)


def test_no_value_depends_on_the_unit() -> None:
    sil = cluttered()
    p, n = rows(sil, 30)
    large = SilhouetteIntegrator(Scene(1024.0 * sil.scene.vertices, sil.scene.faces))
    ground = (0.1, 0.0, 1.0, 0.5)
    found = sil.ambient_occlusion(p, n, max_distance=1.5, falloff="linear", ground=ground)
    again = large.ambient_occlusion(
        1024.0 * p, n, max_distance=1536.0, falloff="linear", ground=(*ground[:3], 512.0)
    )
    assert (found == again).all()


def test_all_quantities_know_the_same_visibility() -> None:
    sil = cluttered()
    p, n = rows(sil, 20)
    ao = sil.ambient_occlusion(p, n, **EVERYTHING)
    assert np.ptp(ao) > 0.2
    # Y_00 is constant, and so is this sky. Harmonics sum the same intervals.
    sh = sil.sh_transfer(p, n, 2, **EVERYTHING)
    np.testing.assert_allclose(sh[:, 0] * np.sqrt(4 * np.pi), ao, rtol=0, atol=1e-12)
    light = sil.irradiance(p, n, Environment.constant([1.0, 2.0, 3.0]), **EVERYTHING)
    np.testing.assert_allclose(light, np.pi * ao[:, None] * [1.0, 2.0, 3.0], rtol=0, atol=1e-9)
    bent = sil.bent_normals(p, n, **EVERYTHING)
    assert (np.linalg.norm(bent, axis=1) <= ao + 1e-9).all()


def test_coarse_maps_take_radial_lines_under_limits() -> None:
    sil = cluttered()
    p, n = rows(sil, 10)
    sky = Environment.from_array(np.ones((8, 16, 3)) + np.arange(8)[:, None, None])
    found = sil.irradiance(p, n, sky, 256, max_distance=1e-5 * sil.scene.extent)
    np.testing.assert_allclose(found, SilhouetteIntegrator(FAR).irradiance(p, n, sky, 256), rtol=5e-3)


@pytest.mark.parametrize("options", [*ONE_BY_ONE[::2], {**EVERYTHING, "spread": 60.0}])
def test_tolerances_hold(options: dict[str, Any]) -> None:
    sil = cluttered()
    p, n = rows(sil, 60)
    fine = sil.ambient_occlusion(p, n, 2048, **options)
    found = sil.ambient_occlusion(p, n, tolerance=2e-3, full_output=True, **options)
    error = np.abs(found.value - fine)
    # Estimates are made to hold for 95 % of points.
    assert (error <= 2e-3).mean() > 0.93
    assert (found.error_estimate <= 2e-3).mean() > 0.95
    assert found.diagnostics["points"] == len(p)


def test_one_shot_progress_and_diagnostics() -> None:
    sil = cluttered()
    p, n = rows(sil, 50)
    calls: list[tuple[int, int]] = []
    found = sil.ambient_occlusion(
        p, n, max_distance="40%", progress=lambda *x: calls.append(x), full_output=True
    )
    assert calls[-1] == (50, 50) and calls == sorted(calls)
    assert found.diagnostics["covered_points"] + found.diagnostics["swept_points"] == 50
    assert (ambient_occlusion(sil.scene, p, n, max_distance="40%") == found.value).all()
    near = sil.ambient_occlusion(p, n, max_distance="5%", full_output=True)
    assert near.diagnostics["covered_points"] == 50
    assert len(sil.ambient_occlusion(np.zeros((0, 3)), np.zeros((0, 3)), max_distance=1.0)) == 0


# ---------------------------------------------------------------------------------------------- bad input

BAD: list[tuple[dict[str, Any], str]] = [
    ({"max_distance": 0.0}, "max_distance is 0.0; expected a finite number above 0"),
    ({"max_distance": -1.0}, "max_distance is -1.0"),
    ({"max_distance": np.nan}, "max_distance is nan"),
    ({"max_distance": np.inf}, "max_distance is inf"),
    ({"max_distance": True}, "max_distance is True"),
    ({"max_distance": np.bool_(True)}, "max_distance is"),
    ({"max_distance": 10**400}, "max_distance is 1000"),
    ({"max_distance": [1.0]}, "max_distance is [1.0]"),
    ({"max_distance": "abc%"}, "max_distance is 'abc%'; expected a finite number above 0, or percent"),
    ({"max_distance": "5%%"}, "max_distance is '5%%'"),
    ({"max_distance": "%"}, "max_distance is '%'"),
    ({"max_distance": "1_0"}, "max_distance is '1_0'"),
    ({"max_distance": "0%"}, "max_distance is '0%'"),
    ({"max_distance": "-5%"}, "max_distance is '-5%'"),
    ({"max_distance": "nan%"}, "max_distance is 'nan%'"),
    ({"max_distance": ""}, "max_distance is ''"),
    (
        {"max_distance": 1.0, "falloff": "cubic"},
        "falloff is 'cubic'; expected one of 'none', 'linear', 'quadratic'",
    ),
    ({"falloff": "linear"}, "falloff is 'linear' without max_distance"),
    ({"spread": 0.0}, "spread is 0.0; expected degrees"),
    ({"spread": 1e-300}, "spread is 1e-300; expected degrees from the normal, 0.001 to 90"),
    ({"spread": 10**400}, "spread is 1000"),
    ({"spread": 90.5}, "spread is 90.5"),
    ({"spread": np.nan}, "spread is nan"),
    ({"spread": "wide"}, "spread is 'wide'"),
    ({"spread": None}, "spread is None"),
    ({"spread": True}, "spread is True"),
    ({"backfaces": "cull"}, "backfaces is 'cull'; expected one of 'block', 'ignore'"),
    ({"ground": (0, 0, 1)}, "ground has shape (3,)"),
    ({"ground": (0, 0, 0, 1)}, "ground has no normal"),
    ({"ground": (0, 0, np.inf, 1)}, "ground must be finite; NaN or infinity"),
    ({"ground": (0, 0, 1e-300, 1e300)}, "ground lies too far away"),
    ({"ground": "floor"}, "ground has dtype"),
    ({"max_distance": 1.0, "method": "octahedral"}, "max_distance given with method='octahedral'"),
    ({"spread": 20.0, "method": "octahedral"}, "spread given with method='octahedral'"),
    (
        {"max_distance": 1.0, "method": "exact", "spread": 20.0},
        "max_distance and spread given with method='exact', which knows one of them at a time",
    ),
    (
        {"max_distance": 1.0, "method": "exact", "falloff": "linear"},
        "falloff is 'linear' with method='exact', which knows none",
    ),
    ({"backfaces": "ignore", "method": "exact"}, "backfaces given with method='exact'"),
    ({"ground": FLOOR, "method": "exact", "spread": 20.0}, "ground given with method='exact'"),
    (
        {"spread": 3.0, "method": "radial"},
        "spread is 3; radial isolines need 4 to 90 degrees: use method='exact'",
    ),
    ({"spread": 3.0, "ground": FLOOR}, "spread is 3; radial isolines need 4 to 90 degrees: take a wider"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=lambda x: str(x)[:40])
def test_what_cannot_be_is_refused_in_one_line(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match="^" + re.escape(message)) as caught:
        empty().ambient_occlusion(ORIGIN, UP, **options)
    assert "\n" not in str(caught.value)


def test_what_a_query_cannot_do_is_refused() -> None:
    for query, known in ((empty().sky_view_factor, "no limits"), (empty().bent_normals, "max_distance")):
        with pytest.raises(InputError, match=rf"spread given with method='exact', which knows {known}"):
            query(ORIGIN, UP, method="exact", spread=20.0)
    with pytest.raises(InputError, match="spread is 20; this query is no fraction of a cone: leave spread"):
        empty().sh_transfer(ORIGIN, UP, spread=20.0)
    with pytest.raises(InputError, match="spread is 20"):
        empty().irradiance(ORIGIN, UP, Environment.constant(1.0), spread=20.0)


@pytest.mark.parametrize(
    ("query", "more", "instead"),
    [
        ("ambient_occlusion_gradient", (), "or take differences of ambient_occlusion"),
        ("gradient", (), "or take differences of ambient_occlusion"),
        ("pullback", ([1.0],), "or take differences of ambient_occlusion"),
        ("visibility", (), "or ask ambient_occlusion and its like"),
        ("integrate", (lambda w: w[:, 2],), "or ask for irradiance or sh_transfer"),
        ("sh_lighting", (Environment.constant(1.0),), "or ask for irradiance or sh_transfer"),
    ],
)
def test_queries_without_limits_say_so(query: str, more: tuple[Any, ...], instead: str) -> None:
    ask = getattr(empty(), query)
    for limits in ({"max_distance": 1.0, "falloff": "linear"}, {"spread": 9}, {"ground": FLOOR}):
        name = next(iter(limits))
        with pytest.raises(InputError, match=f"^{name} given; {query} knows no limits: leave it out, ") as e:
            ask(ORIGIN, UP, *more, **limits)
        assert instead in str(e.value) and "\n" not in str(e.value)
    with pytest.raises(InputError, match="spread is 91"):  # a mistake first of all
        ask(ORIGIN, UP, *more, spread=91)
    with pytest.raises(TypeError, match=f"{query}.. got an unexpected keyword argument 'spred'"):
        ask(ORIGIN, UP, *more, spred=30)
    # Their defaults may be handed on.
    ask(ORIGIN, UP, *more, max_distance=None, falloff="none", spread=90.0, backfaces="block", ground=None)


def test_limits_are_values() -> None:
    assert not Limits() and Limits().given == ()
    limits = Limits("5 %", "linear", 30, "ignore", [0, 0, 2, 4])
    assert limits == Limits("5.0%", "linear", 30.0, "ignore", (0.0, 0.0, 1.0, 2.0))
    assert hash(limits) == hash(Limits("5%", "linear", 30, "ignore", (0, 0, 1, 2)))
    assert limits.given == ("max_distance", "spread", "backfaces", "ground")
    assert limits.distance(200.0) == 10.0 and Limits("0.5").distance(7.0) == 0.5
    assert Limits().distance(7.0) == np.inf
    with pytest.raises(AttributeError):
        limits.spread = 3.0  # type: ignore[misc]


# ------------------------------------------------------------------------------------------------- plans


@pytest.mark.parametrize(
    ("scene", "limits", "built", "told"),
    [
        (cluttered, {"max_distance": 0.3}, {"max distance"}, "0.3"),
        (cluttered, {"max_distance": "40%"}, {"max distance"}, "nearer than"),
        (cluttered, {"max_distance": "150%"}, set(), "the scene ends within"),
        (leaves, {"max_distance": 1.0}, {"max distance"}, "faces and boxes nearer than 1"),
        (cluttered, {"max_distance": 2.0, "falloff": "linear"}, {"max distance", "falloff"}, "nearer than 2"),
        (cluttered, {"spread": 30.0}, {"spread"}, "surfaces count however far they are"),
        (cluttered, {"backfaces": "ignore"}, {"backfaces"}, "surfaces count however far they are"),
        (cluttered, {"ground": FLOOR}, {"ground"}, "surfaces count however far they are"),
        (
            leaves,
            {"max_distance": 3.0, "spread": 60, "backfaces": "ignore", "ground": FLOOR},
            {"max distance", "spread", "backfaces", "ground"},
            "faces and boxes nearer than 3",
        ),
    ],
)
@pytest.mark.parametrize("query", ["ambient_occlusion", "bent_normals"])
def test_what_is_explained_is_done(
    scene: Any, limits: dict[str, Any], built: set[str], told: str, query: str
) -> None:
    sil = scene()
    parts = sil.explain(query, 16, **limits).as_dict()
    names = {"max distance", "sphere search", "falloff", "spread", "backfaces", "ground"}
    assert {name for name in names if parts[name]["built"]} - {"sphere search"} == built - {"sphere search"}
    assert told in parts["max distance"]["reason"]
    p, n = rows(sil, 12)
    done = getattr(sil, query)(p, n, 16, full_output=True, **limits).diagnostics
    assert parts["cover"]["built"] != parts["sweep"]["built"]
    assert done["covered_points" if parts["cover"]["built"] else "swept_points"] == len(p)
    assert str(sil.explain(query, 16, **limits)).startswith(f"{query}, {done['isolines']} radial isolines")
    assert parts["sphere search"]["built"] == (parts["sweep"]["built"] and "max distance" in built)


def test_plans_without_limits_leave_them_out() -> None:
    for options in ({}, {"method": "octahedral"}, {"method": "exact"}):
        part = cluttered().explain("ambient_occlusion", **options).as_dict()["limits"]
        assert not part["built"]
    # A narrow cone takes arcs, as the query does.
    narrow = cluttered().explain("ambient_occlusion", spread=2.0)
    assert narrow.title == "ambient_occlusion, exact" and narrow.as_dict()["spread"]["built"]
    with pytest.raises(InputError, match="spread is 2; radial isolines need"):
        cluttered().explain("bent_normals", spread=2.0)
    with pytest.raises(InputError, match="spread is 9; this query is no fraction"):
        cluttered().explain("irradiance", spread=9.0)
    with pytest.raises(InputError, match="ground given; visibility knows no limits: leave it out"):
        cluttered().explain("visibility", ground=FLOOR)
    with pytest.raises(InputError, match="max_distance is 0"):
        cluttered().explain("visibility", max_distance=0)
