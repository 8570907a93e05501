"""The integrator against formulas: exact where it can be, converging everywhere else."""

from __future__ import annotations

import numpy as np
import pytest

import silint
from scenes import polyhedra
from scenes.mesh import concatenate, moved
from silint import Scene, SilhouetteIntegrator
from silint.reference.analytic_scenes import AnalyticScene, analytic_scenes

SCENES = analytic_scenes()
METHODS = ("octahedral", "radial")
LINES = (8, 16, 32, 64, 128, 256, 512)

# At 512 lines. Radial ones are at their worst where edges stand nearly upright on the point's horizon: those
# run along a line for much of its length.
PROMISE = {"octahedral": 1e-4, "radial": 4e-4}

# Double precision; a value is a ratio of sums of some hundred terms.
ROUNDING = 1e-12


def units(n: int, seed: int = 0) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def errors(scene: AnalyticScene, isolines: int, weighting: str, method: str) -> np.ndarray:
    integrator = SilhouetteIntegrator(Scene(scene.vertices, scene.faces))
    found = integrator.ambient_occlusion(scene.points, scene.normals, isolines, weighting, method)
    return np.abs(found - getattr(scene, weighting))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_the_promise_at_512_isolines(scene: AnalyticScene, weighting: str, method: str) -> None:
    found = errors(scene, 512, weighting, method)
    assert found.max() < PROMISE[method]
    # What is wholly open or wholly closed is so exactly, at any number of isolines.
    exact = getattr(scene, weighting)
    decided = (exact == 0) | (exact == 1)
    assert not found[decided].any()
    assert not errors(scene, 2, weighting, method)[decided].any()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("placement", ["aligned", "turned"])
def test_errors_fall_with_isolines(placement: str, method: str) -> None:
    """At least like 1 / K over all scenes: midpoints of strips, wrong where an outline runs along them."""
    chosen = [s for s in SCENES if s.name.endswith(placement)]
    integrators = [SilhouetteIntegrator(Scene(s.vertices, s.faces)) for s in chosen]
    rms = []
    for k in LINES:
        found = [
            i.ambient_occlusion(s.points, s.normals, k, method=method) - s.cosine
            for i, s in zip(integrators, chosen, strict=True)
        ]
        rms.append(np.sqrt((np.concatenate(found) ** 2).mean()))
    # From end to end: 64 times the isolines, at most 1 / 64 of the error.
    assert rms[-1] < rms[0] / 64
    # And on the way: each doubling helps, if not always by half.
    assert (np.diff(np.log2(rms)) < -0.5).all()
    slope = np.polyfit(np.log2(LINES), np.log2(rms), 1)[0]
    print(f"{placement}, {method}: rms {rms[0]:.1e} to {rms[-1]:.1e} at {LINES[-1]} lines, slope {slope:.2f}")
    assert slope < -1.0


# ----------------------------------------------------------------------------------------------- open sky


BELOW = moved(polyhedra.box(), (0.0, 0.0, -3.0))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("isolines", [1, 2, 3, 64])
def test_an_open_sky_is_exactly_one(isolines: int, method: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*BELOW))
    normals = np.concatenate([units(40), np.eye(3), -np.eye(3)])
    normals[:, 2] = np.abs(normals[:, 2]) + 1e-3
    # The solid lies well below all these horizons.
    points = np.zeros((46, 3)) + [0.0, 0.0, 1e4]
    for weighting in ("cosine", "uniform"):
        assert (integrator.ambient_occlusion(points, normals, isolines, weighting, method) == 1.0).all()


@pytest.mark.parametrize("method", METHODS)
def test_an_open_sky_above_a_convex_solid_is_exactly_one(method: str) -> None:
    for mesh in (polyhedra.icosphere(2), polyhedra.dodecahedron(), polyhedra.capsule()):
        scene = Scene(*mesh)
        centers, normals, valid = scene.face_centers_normals()
        integrator = SilhouetteIntegrator(scene)
        assert (integrator.ambient_occlusion(centers[valid], normals[valid], 16, method=method) == 1.0).all()
        # A solid that is convex hides nothing of its vertices' sky either.
        vertex_normals, _ = scene.vertex_normals()
        value = integrator.ambient_occlusion(scene.vertices, vertex_normals, 16, method=method)
        below = np.array(
            [
                ((scene.vertices - p) @ n <= 1e-12).all()
                for p, n in zip(scene.vertices, vertex_normals, strict=True)
            ]
        )
        assert (value[below] == 1.0).all() and below.sum() > len(below) / 2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("isolines", [1, 2, 9, 32])
def test_a_closed_room_is_exactly_closed(isolines: int, method: str) -> None:
    for mesh in (
        polyhedra.closed_room(),
        polyhedra.icosphere(2),
        polyhedra.torus(major_slices=8, minor_slices=8),
    ):
        integrator = SilhouetteIntegrator(Scene(*mesh))
        rng = np.random.default_rng(1)
        inside = rng.uniform(-0.2, 0.2, (30, 3)) + [0.0 if mesh[0].max() > 1.2 else 0.1, 0.0, 0.5]
        if mesh[0].max() < 1.5 and len(mesh[1]) == 128:
            angle = rng.random(30) * 6.28  # about the torus's core
            inside = np.column_stack([np.cos(angle), np.sin(angle), 0.1 * rng.random(30)]) * 0.95
        assert not integrator.ambient_occlusion(inside, units(30), isolines, method=method).any()
        assert not integrator.bent_normals(inside, units(30), isolines, method=method).any()
        assert not integrator.sky_view_factor(inside, units(30), isolines=isolines, method=method).any()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("isolines", [8, 33])
def test_the_open_sky_of_every_integrand(isolines: int, method: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*BELOW))
    normals = np.concatenate([units(30, 2), np.eye(3), -np.eye(3)])
    points = np.tile(
        [0.0, 0.0, 1e9], (36, 1)
    )  # the scene is a speck, smaller than the space between lines ...
    points[normals[:, 2] < 0, 2] *= -1.0  # ... and below the horizon
    points = np.where(np.abs(normals[:, 2:]) < 1e-3, normals * 1e9, points)
    bent = integrator.bent_normals(points, normals, isolines, method)
    np.testing.assert_allclose(bent, 2 / 3 * normals, rtol=0, atol=ROUNDING)
    for up in ((0, 0, 1), (0, 1, 0), (-0.3, 0.5, 0.2)):
        axis = np.array(up) / np.linalg.norm(up)
        svf = integrator.sky_view_factor(points, normals, up, isolines, method)
        np.testing.assert_allclose(svf, 0.5 * (1 + normals @ axis), rtol=0, atol=ROUNDING)
    below = integrator.sky_view_factor(points[-1:], [[0.0, 0.0, -1.0]], isolines=isolines, method=method)
    assert below[0] == 0.0


def test_a_linear_function_over_the_open_hemisphere() -> None:
    """int w dw = pi n. A line ends at the horizon for the whole width of its strip, an error of first order
    in the width, but of second order along n, since n.w vanishes there: cosine weights gain by that.
    """
    integrator = SilhouetteIntegrator(Scene(*BELOW))
    normals = units(20, 3)
    normals[:, 2] = np.abs(normals[:, 2])
    across, along = [], []
    for k in (32, 128, 512):
        visible = integrator.visibility(np.tile([0.0, 0.0, 1e9], (20, 1)), normals, k)
        error = visible.integrate(lambda w: w) - np.pi * normals
        across.append(np.abs(error).max())
        along.append(np.abs((error * normals).sum(axis=1)).max())
        # Half of every line is above any horizon: solid angle is exact.
        total = visible.integrate(lambda w: np.ones(len(w)))
        np.testing.assert_allclose(total, 2 * np.pi, rtol=1e-9, atol=0)
    # Four times the isolines: a quarter and a sixteenth of the error, give or take the luck of the lines.
    assert across[0] < 0.1 and across[1] < across[0] / 3 and across[2] < across[1] / 3
    assert along[0] < 5e-3 and along[1] < along[0] / 8 and along[2] < along[1] / 8


# -------------------------------------------------------------------------------------------- identities


@pytest.mark.parametrize("method", METHODS)
def test_sky_and_occluder_fill_the_hemisphere(method: str) -> None:
    """What a sheet hides of the sky is what is seen through a hole of its shape in a closed room."""
    window = np.array([(-0.5, 2, 1), (1, 2, 1), (1, 2, 2.2), (-0.5, 2, 2.2)], np.float64)
    sheet = (window, np.array([(0, 1, 2), (0, 2, 3)]))
    outer = np.array([(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)], np.float64)
    ring = [t for i in range(4) for j in [(i + 1) % 4] for t in ((i, j, 4 + j), (i, 4 + j, 4 + i))]
    walls = polyhedra.box((4.0, 4.0, 3.0))
    walls = moved(walls, (0.0, 0.0, 1.5))
    inner = walls[1][~(walls[0][walls[1]][:, :, 1] == 2.0).all(axis=1)]
    room = concatenate([(walls[0], inner), (np.concatenate([outer, window]), np.array(ring))])
    rng = np.random.default_rng(4)
    points = rng.uniform((-1.5, -1.5, 0.2), (1.5, 1.5, 2.8), (40, 3))
    normals = units(40, 5)
    hidden = SilhouetteIntegrator(Scene(*sheet)).ambient_occlusion(points, normals, method=method)
    seen = SilhouetteIntegrator(Scene(*room)).ambient_occlusion(points, normals, method=method)
    # The same edges cut the same lines.
    np.testing.assert_allclose(hidden + seen, 1.0, rtol=0, atol=1e-9)
    assert 0 < seen.max() < 1


@pytest.mark.parametrize("method", METHODS)
def test_more_occluders_never_open_the_sky(method: str) -> None:
    rng = np.random.default_rng(6)
    parts = [moved(polyhedra.icosahedron(), c, 0.5) for c in rng.uniform(-1, 1, (6, 3))]
    points, normals = rng.uniform(-2, 2, (60, 3)), units(60, 7)
    before = np.ones(60)
    for n in range(1, 7):
        integrator = SilhouetteIntegrator(Scene(*concatenate(parts[:n])))
        # By solid angle, of which every piece of a line has a positive share.
        now = integrator.ambient_occlusion(points, normals, 24, "uniform", method)
        assert (now <= before + 1e-9).all()
        before = now
    assert before.mean() < 0.95


def test_visibility_gives_what_the_integrator_gives() -> None:
    integrator = SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(1), (0.0, 0.0, 2.0))))
    points, normals = np.zeros((5, 3)), units(5, 8) + [0.0, 0.0, 1.0]
    visible = integrator.visibility(points, normals, 32)
    np.testing.assert_array_equal(
        visible.ambient_occlusion(), integrator.ambient_occlusion(points, normals, 32, method="octahedral")
    )
    np.testing.assert_array_equal(
        visible.ambient_occlusion("uniform"),
        integrator.ambient_occlusion(points, normals, 32, "uniform", "octahedral"),
    )
    np.testing.assert_array_equal(
        visible.bent_normals(), integrator.bent_normals(points, normals, 32, "octahedral")
    )
    up = (0.2, 0.1, 1.0)
    np.testing.assert_array_equal(
        visible.sky_view_factor(up), integrator.sky_view_factor(points, normals, up, 32, "octahedral")
    )
    # The uniform fraction is the integral of 1 over the same intervals, in 2 pi.
    solid_angle = visible.integrate(silint.prefix_table(lambda w: np.ones(len(w)), 32))[:, 0]
    np.testing.assert_allclose(
        solid_angle / (2 * np.pi), visible.ambient_occlusion("uniform"), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("method", METHODS)
def test_the_sky_view_factor_is_ambient_occlusion_where_up_is_the_normal(method: str) -> None:
    integrator = SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(1), (0.5, 0.0, 1.5))))
    points, normals = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    sky = integrator.sky_view_factor(points, normals, method=method)
    np.testing.assert_allclose(sky, integrator.ambient_occlusion(points, normals, method=method), atol=1e-15)
    # A wall's lower half of the view counts as closed.
    wall = integrator.sky_view_factor([[-5.0, 0.0, 1.5]], [[-1.0, 0.0, 0.0]], method=method)
    np.testing.assert_allclose(wall, 0.5, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("isolines", [32, 64])
def test_bent_normals_and_sky_view_factors_are_those_of_brute_force(isolines: int) -> None:
    from silint.reference import brute_force

    integrator = SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(1), (0.3, 0.1, 1.6))))
    topology = integrator.scene.topology
    rng = np.random.default_rng(9)
    points, normals = rng.uniform(-1, 1, (20, 3)), units(20, 10)
    p, n = integrator._finder.shade_points(points, normals)
    oracle = topology.vertices, topology.faces, p, n, isolines
    # The tolerance; tables interpolate to 1e-10.
    np.testing.assert_allclose(
        integrator.bent_normals(points, normals, isolines, "octahedral"),
        brute_force.bent_normals(*oracle),
        rtol=0,
        atol=1e-9,
    )
    up = np.array([0.2, 0.9, 0.3])
    np.testing.assert_allclose(
        integrator.sky_view_factor(points, normals, up, isolines, "octahedral"),
        brute_force.sky_view_factor(*oracle, up),
        rtol=0,
        atol=1e-9,
    )
