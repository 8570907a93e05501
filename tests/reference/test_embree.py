"""Embree QMC: right within its own standard error, and a function of its arguments alone."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from silint.reference import EmbreeQMC, ambient_occlusion, brute_force, embree_available, embree_points
from silint.reference.analytic_scenes import analytic_scenes
from silint.reference.rays import make_rays
from silint.reference.sequence import point_bits, sobol_bits, space_order
from silint.validation import InputError

SCENES = {s.name: s for s in analytic_scenes()}
COURT = SCENES["courtyard/turned"]

needs_embree = pytest.mark.skipif(not embree_available(), reason="no embreex for this platform")


@pytest.fixture(scope="module")
def court() -> EmbreeQMC:
    return EmbreeQMC(COURT.vertices, COURT.faces)


def _many(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points inside the courtyard's hull, with normals at random."""
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(len(COURT.vertices)), n)
    normals = rng.normal(size=(n, 3))
    return weights @ COURT.vertices, normals / np.linalg.norm(normals, axis=1)[:, None]


# ------------------------------------------------------------------------------------------------ values


@needs_embree
@pytest.mark.parametrize("weighting", ["cosine", "uniform"])
def test_closed_forms_within_standard_errors(weighting: str) -> None:
    from scipy.stats import t

    scores = []
    for s in SCENES.values():
        # Rays must leave the surface; 1e-4 of displacement moves no answer here by as much as 1e-4.
        points = s.points + 1e-4 * s.normals
        found = EmbreeQMC(s.vertices, s.faces).ambient_occlusion(
            points, s.normals, 256, weighting=weighting, scrambles=64
        )
        exact = getattr(s, weighting)
        error = np.abs(found.value - exact)
        # Where no ray hits, the spread says nothing about occlusion below one ray in 256 * 64.
        scores.append((error - 1e-4).clip(0) / np.maximum(found.standard_error, 1 / (256 * 64)))
        decided = (exact == 0) | (exact == 1)
        assert error[decided].max(initial=0) < 1e-4
    score = np.concatenate(scores)
    # Sidak: one false alarm in 10,000 runs over all points together; 63 degrees of freedom.
    p = 1 - (1 - 1e-4) ** (1 / len(score))
    assert score.max() < t.isf(p / 2, 63)


@needs_embree
def test_standard_errors_are_honest(court: EmbreeQMC) -> None:
    points, normals = _many(200)
    exact = court.ambient_occlusion(points, normals, 1 << 14, seed=1, scrambles=4).value
    found = court.ambient_occlusion(points, normals, 64, scrambles=16)
    z = (found.value - exact)[found.standard_error > 0] / found.standard_error[found.standard_error > 0]
    # A Student t with 15 degrees of freedom has variance 15 / 13; 200 of them estimate its root to 6 %.
    assert 0.9 < np.sqrt((z**2).mean()) < 1.3
    assert np.isnan(court.ambient_occlusion(points[:2], normals[:2], 64).standard_error).all()


@needs_embree
def test_more_rays_err_less(court: EmbreeQMC) -> None:
    points, normals = _many(100)
    exact = court.ambient_occlusion(points, normals, 1 << 14, seed=1, scrambles=4).value
    values = [court.ambient_occlusion(points, normals, k).value for k in (64, 4096)]
    error = [np.sqrt(((v - exact) ** 2).mean()) for v in values]
    # 64 times the rays: 8 times better at random, 23 times at the rate -3/4 of stratified samples at an edge.
    assert error[0] / error[1] > 12


@needs_embree
def test_bent_normals_and_sky_against_the_oracle(court: EmbreeQMC) -> None:
    points, normals = _many(24)
    bent = court.bent_normals(points, normals, 1024, scrambles=16)
    exact = brute_force.bent_normals(COURT.vertices, COURT.faces, points, normals, 256)
    # 72 Student t of 15 degrees of freedom stay below 5.5 but once in 1000; 256 lines leave 5e-5.
    assert (np.abs(bent.value - exact) < 5.5 * bent.standard_error + 5e-5).all()
    up = np.array([0.6, 0.0, 0.8])
    sky = court.sky_view_factor(points, normals, up, 1024, scrambles=16)
    exact = brute_force.sky_view_factor(COURT.vertices, COURT.faces, points, normals, 256, up)
    assert (np.abs(sky.value - exact) < 5.5 * sky.standard_error + 5e-5).all()


# ------------------------------------------------------------------------------- the same, whatever happens


@needs_embree
def test_values_depend_on_nothing_but_the_point(court: EmbreeQMC) -> None:
    points, normals = _many(50)
    whole = court.ambient_occlusion(points, normals, 256, scrambles=3)
    order = np.random.default_rng(1).permutation(50)
    shuffled = court.ambient_occlusion(points[order], normals[order], 256, scrambles=3)
    np.testing.assert_array_equal(shuffled.value, whole.value[order])
    np.testing.assert_array_equal(shuffled.standard_error, whole.standard_error[order])
    for threads, batch in ((1, 1 << 16), (3, 512)):
        other = EmbreeQMC(COURT.vertices, COURT.faces, threads=threads, batch=batch)
        alone = other.ambient_occlusion(points[7:8], normals[7:8], 256, scrambles=3)
        assert alone.value[0] == whole.value[7]
        assert alone.standard_error[0] == whole.standard_error[7]
        np.testing.assert_array_equal(
            other.bent_normals(points, normals, 64).value, court.bent_normals(points, normals, 64).value
        )
    again = court.ambient_occlusion(points, normals, 256, seed=1)
    assert (again.value != court.ambient_occlusion(points, normals, 256).value).any()


@needs_embree
def test_long_sequences_go_in_blocks(court: EmbreeQMC) -> None:
    points, normals = _many(2)
    reported: list[tuple[int, int]] = []
    long = court.ambient_occlusion(points, normals, 1 << 18, progress=lambda *done: reported.append(done))
    assert long.rays == 2 << 18
    assert reported[-1] == (2 << 18, 2 << 18)
    assert long.rays_per_second > 0
    short = court.ambient_occlusion(points, normals, 1 << 14, scrambles=8)
    assert (np.abs(long.value - short.value) < 6 * short.standard_error + 1e-5).all()


@needs_embree
def test_bare_speed_is_a_rate_of_the_same_size(court: EmbreeQMC) -> None:
    points, normals = _many(100)
    for options in ({"samples": 64}, {"samples": 1 << 17, "max_rays": 1 << 20}):
        rate = court.bare_rays_per_second(points, normals, **options)
        full = court.ambient_occlusion(points[:8], normals[:8], options["samples"]).rays_per_second
        # Other processes may take either measurement's cores away, but hardly nine tenths of them.
        assert 0.1 * full < rate


@needs_embree
def test_no_points_at_all(court: EmbreeQMC) -> None:
    none = np.zeros((0, 3))
    assert court.ambient_occlusion(none, none, 64).value.shape == (0,)
    assert court.bent_normals(none, none, 64).value.shape == (0, 3)


# ---------------------------------------------------------------------------------------------------- rays


@pytest.mark.parametrize(("uniform", "height", "square"), [(False, 2 / 3, 1 / 2), (True, 1 / 2, 1 / 3)])
def test_rays_follow_the_weight(uniform: bool, height: float, square: float) -> None:
    n = np.array([[2.0, -1.0, -2.0], [0, 0, 1], [0, 0, -1], [1, 0, 0]])
    n /= np.linalg.norm(n, axis=1)[:, None]
    origins = np.arange(12, dtype=np.float32).reshape(4, 3)
    first, second = sobol_bits(4096, 0, 0)
    o, d = np.empty((4 * 4096, 3), np.float32), np.empty((4 * 4096, 3), np.float32)
    make_rays(origins, n, first, second, point_bits(origins, n, 0, 0), uniform, o, d)
    np.testing.assert_array_equal(o, np.repeat(origins, 4096, axis=0))
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1, atol=1e-6)
    for i, w in enumerate(d.reshape(4, 4096, 3).astype(np.float64)):
        z = w @ n[i]
        assert z.min() >= -1e-6
        # Moments of n.w, and of w across n; 4096 Sobol points integrate smooth functions to 1e-4.
        assert z.mean() == pytest.approx(height, abs=2e-4)
        assert (z**2).mean() == pytest.approx(square, abs=2e-4)
        across = w - z[:, None] * n[i]
        np.testing.assert_allclose(across.mean(axis=0), 0, atol=2e-3)


def test_sobol_sets_are_stratified_and_in_morton_order() -> None:
    first, second = (bits.view(np.uint32).astype(np.float64) / 2**32 for bits in sobol_bits(1024, 3, 1))
    # A (0, 2)-net: one point in each of 32 x 32 cells; in Morton order, 4 consecutive ones share a 16th.
    cells = np.unique((first * 32).astype(int) * 32 + (second * 32).astype(int))
    assert len(cells) == 1024
    quads = ((first * 16).astype(int) * 16 + (second * 16).astype(int)).reshape(-1, 4)
    assert (quads == quads[:, :1]).all()


def test_bits_differ_by_point_normal_seed_and_scramble() -> None:
    p, n = np.zeros((3, 3), np.float32), np.tile([0.0, 0, 1], (3, 1))
    p[1, 0], n[2] = 1e-30, (0, 1, 0)
    bits = [point_bits(p, n, *key) for key in ((0, 0), (1, 0), (0, 1))]
    assert len(np.unique(np.concatenate(bits), axis=0)) == 9
    assert sorted(space_order(p)) == [0, 1, 2]
    assert space_order(p[:0]).shape == (0,)


# --------------------------------------------------------------------------------------------- displacement


def test_displacement_is_the_greater_of_edge_and_rounding() -> None:
    # Edges of 1 at the origin and of 1e-4 at x = 2: one wins by 1e-3 of itself, the other by 16 ulp.
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (2.0001, 0, 0), (2, 0.0001, 0)])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points, normals = np.array([(0.2, 0.2, 0), (2.00002, 0.00002, 0)]), np.array([(0, 0, 3.0), (0, 0, 1)])
    moved = embree_points(vertices, faces, points, normals)
    np.testing.assert_allclose(moved[:, 2], [1e-3, 16 * 2.0**-22], rtol=1e-6)
    np.testing.assert_array_equal(moved, moved.astype(np.float32))
    np.testing.assert_array_equal(moved, embree_points(vertices, faces, points, normals, face_ids=[0, 1]))
    np.testing.assert_allclose(embree_points(vertices, faces, points, normals, [1, 1])[0, 2], 16 * 2.0**-22)


@needs_embree
def test_one_shot_leaves_the_surface() -> None:
    box = SCENES["own surface/aligned"]
    scene = SimpleNamespace(vertices=box.vertices, faces=box.faces)
    found = ambient_occlusion(scene, box.points, box.normals, samples=256)
    np.testing.assert_array_equal(found.value, 1.0)
    stuck = ambient_occlusion(
        scene, box.points - 1e-3 * box.normals, box.normals, samples=256, displace=False
    )
    assert (stuck.value < 1).all()


# --------------------------------------------------------------------------------------------------- errors


@needs_embree
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 1000}, "pass 1024"),
        ({"samples": 0}, "samples is 0"),
        ({"scrambles": 0}, "scrambles is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"weighting": "area"}, "weighting is 'area'"),
    ],
)
def test_bad_options_are_named(court: EmbreeQMC, options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        court.ambient_occlusion(*_many(1), **options)


@needs_embree
def test_bad_arrays_are_named(court: EmbreeQMC) -> None:
    with pytest.raises(InputError, match="normals must not be zero"):
        court.ambient_occlusion(np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(InputError, match="float32"):
        EmbreeQMC(1e39 * np.eye(3), [[0, 1, 2]])
    with pytest.raises(InputError, match="face_ids"):
        embree_points(np.eye(3), [[0, 1, 2]], np.zeros((1, 3)), np.ones((1, 3)), [1])


def test_missing_embree_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "embreex", None)
    assert not embree_available()
    with pytest.raises(InputError, match="pip install embreex") as caught:
        EmbreeQMC(np.eye(3), [[0, 1, 2]])
    assert "\n" not in str(caught.value)
