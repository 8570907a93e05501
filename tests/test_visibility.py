"""Visible regions as values: what they hold, and saving and loading them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import silint
from scenes import polyhedra
from scenes.mesh import moved
from silint import InputError, Scene, SilhouetteIntegrator, Visibility


@pytest.fixture(scope="module")
def integrator() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*moved(polyhedra.icosphere(1), (0.2, 0.1, 1.6))))


@pytest.fixture(scope="module")
def visible(integrator: SilhouetteIntegrator) -> Visibility:
    rng = np.random.default_rng(0)
    points, normals = rng.uniform(-0.5, 0.5, (70, 3)), rng.normal(size=(70, 3)) * 0.3 + [0, 0, 2.0]
    return integrator.visibility(points, normals, 16)


def test_shapes_and_dtypes(visible: Visibility) -> None:
    assert len(visible) == 70 and visible.isolines == 16 and visible.method == "octahedral"
    assert visible.offsets.shape == (70 * 16 + 1,) and visible.offsets.dtype == np.int64
    assert visible.offsets[0] == 0 and visible.offsets[-1] == len(visible.intervals)
    assert (np.diff(visible.offsets) >= 0).all()
    assert visible.intervals.dtype == np.float64 and visible.intervals.shape[1] == 2
    np.testing.assert_allclose(np.linalg.norm(visible.normals, axis=1), 1.0, rtol=0, atol=1e-15)
    assert visible.diagnostics["points"] == 70 and visible.diagnostics["isolines"] == 16


def test_a_point_needs_about_a_hundred_bytes_an_isoline(visible: Visibility) -> None:
    n_bytes = visible.offsets.nbytes + visible.intervals.nbytes
    assert n_bytes / (70 * 16) < 100


def test_nothing_visible_of_no_points(integrator: SilhouetteIntegrator) -> None:
    empty = integrator.visibility([], [], 4)
    assert len(empty) == 0 and empty.offsets.tolist() == [0] and empty.intervals.shape == (0, 2)
    assert empty.ambient_occlusion().shape == (0,)
    assert empty.bent_normals().shape == (0, 3)
    assert empty.integrate(lambda w: w).shape == (0, 3)


def test_integrate_takes_tables_and_functions(visible: Visibility) -> None:
    def function(w: np.ndarray) -> np.ndarray:
        return np.column_stack([np.ones(len(w)), w[:, 2] ** 2])

    table = silint.prefix_table(function, 16)
    np.testing.assert_array_equal(visible.integrate(function), visible.integrate(table))
    assert visible.integrate(table).shape == (70, 2)
    # Cosine-weighted by hand, one normal at a time, and as the fraction of an open sky.
    i = 3
    n = visible.normals[i]
    seen = visible.integrate(lambda w: w @ n)[i, 0]
    assert seen / np.pi == pytest.approx(visible.ambient_occlusion()[i], abs=0.02)


def test_integrals_are_linear(visible: Visibility) -> None:
    f = visible.integrate(lambda w: np.exp(w[:, 0]))
    g = visible.integrate(lambda w: w[:, 1])
    both = visible.integrate(lambda w: 2 * np.exp(w[:, 0]) - 3 * w[:, 1])
    np.testing.assert_allclose(both, 2 * f - 3 * g, rtol=0, atol=1e-12)  # rounding of sums


def test_save_and_load(visible: Visibility, tmp_path: Path) -> None:
    path = tmp_path / "visible.npz"
    visible.save(path)
    loaded = Visibility.load(path)
    assert (loaded.isolines, loaded.method) == (16, "octahedral")
    for name in ("normals", "offsets", "intervals"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(visible, name))
    np.testing.assert_array_equal(loaded.ambient_occlusion(), visible.ambient_occlusion())
    np.testing.assert_array_equal(Visibility.load(str(path)).bent_normals(), visible.bent_normals())


def refusal(function, *arguments) -> str:
    with pytest.raises(InputError) as caught:
        function(*arguments)
    message = str(caught.value)
    assert message and "\n" not in message
    return message


def test_where_nothing_can_be_saved(visible: Visibility, tmp_path: Path) -> None:
    assert "npz" in refusal(visible.save, tmp_path / "visible.txt")
    assert "nowhere" in refusal(visible.save, tmp_path / "nowhere" / "visible.npz")
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_visibility(visible: Visibility, tmp_path: Path) -> None:
    assert "missing.npz" in refusal(Visibility.load, tmp_path / "missing.npz")
    text = tmp_path / "text.npz"
    text.write_text("hello")
    assert "text.npz: not a visibility file" in refusal(Visibility.load, text)
    other = tmp_path / "other.npz"
    np.savez(other, value=np.zeros(3))
    assert "other.npz: not a visibility file" in refusal(Visibility.load, other)
    whole = tmp_path / "visible.npz"
    visible.save(whole)
    cut = tmp_path / "cut.npz"
    for share in (0.1, 0.5, 0.9, 0.999):
        data = whole.read_bytes()
        cut.write_bytes(data[: int(share * len(data))])
        assert "cut.npz" in refusal(Visibility.load, cut)


def test_what_cannot_be_asked_of_it(visible: Visibility) -> None:
    assert "weighting is 'flat'" in refusal(visible.ambient_occlusion, "flat")
    assert "up is" in refusal(visible.sky_view_factor, (0, 0, 0))
    assert "basis is a str" in refusal(visible.integrate, "sky")
    assert "table has 8 isolines; this visibility has 16" in refusal(
        visible.integrate, silint.prefix_table(lambda w: w, 8, 16)
    )
