"""The CIE's skies by themselves: figures that are known without any integration, and the sun's disc."""

from __future__ import annotations

import numpy as np
import pytest

from silint.core import cie_sky

pytestmark = pytest.mark.nojit

UP = np.array([0.0, 1.0, 0.0])


def test_overcast() -> None:
    # [MS42]: 1 at the zenith, 1/3 at the horizon, 2/3 at 30 degrees.
    w = np.array([UP, [1.0, 0, 0], [np.sqrt(0.75), 0.5, 0]])
    np.testing.assert_allclose(cie_sky.overcast(w), [1, 1 / 3, 2 / 3], rtol=1e-15)


@pytest.mark.parametrize("elevation", [0.0, 20.0, 90.0])
def test_clear_is_one_at_the_zenith(elevation: float) -> None:
    e = np.radians(elevation)
    sun = np.array([np.cos(e), np.sin(e), 0.0])
    assert cie_sky.clear(UP[None], sun)[0] == pytest.approx(1.0, rel=1e-14)
    # The horizon below the sun: no exp(b / 0) there, and no division by zero.
    assert np.isfinite(cie_sky.clear(np.array([[1.0, 0.0, 0.0]]), sun)).all()


def test_clear_under_a_sun_at_the_zenith() -> None:
    # L(Z) = f(Z) phi(Z) / (f(0) phi(0)); at 60 degrees, with cos Z = 1/2:
    expected = (
        (1 + 10 * (np.exp(-np.pi) - np.exp(-1.5 * np.pi)) + 0.45 / 4)
        / (1 + 10 * (1 - np.exp(-1.5 * np.pi)) + 0.45)
        * (1 - np.exp(-0.64))
        / (1 - np.exp(-0.32))
    )
    assert cie_sky.clear(np.array([[0.0, 0.5, np.sqrt(0.75)]]), UP)[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("radius", [0.005, 0.5])
@pytest.mark.parametrize("centre", [(0, 1, 0), (1, 0, 0), (0.48, 0.6, -0.64)])
def test_the_disc_is_even(radius: float, centre: tuple[float, float, float]) -> None:
    axis = np.array(centre, dtype=float)
    w = cie_sky.disc_directions(axis, radius, 4096)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, rtol=1e-14)
    angle = np.arctan2(np.linalg.norm(np.cross(w, axis), axis=1), w @ axis)
    assert angle.max() < radius
    # Solid angle grows with sin^2 of half the angle: a quarter of it lies within half that sine.
    inner = 2 * np.arcsin(0.5 * np.sin(0.5 * radius))
    assert (angle < inner).mean() == pytest.approx(0.25, abs=1 / 4096)
    # Evenly around: the mean direction is the centre, shortened to (1 + cos(radius)) / 2.
    np.testing.assert_allclose(w.mean(axis=0), axis * 0.5 * (1 + np.cos(radius)), rtol=0, atol=radius / 4096)
