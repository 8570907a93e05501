"""Luminance distributions of the CIE's standard skies, and the sun's disc.

Directions are unit, +y is the zenith; luminances are relative to that of the zenith. Nothing is said about
directions below the horizon.
"""

from __future__ import annotations

import numpy as np

# Mean angular radius of the sun seen from the Earth, in degrees (radius 695,700 km at 1 au).
SUN_RADIUS = 0.2666

# Parameters of sky type 12, "CIE standard clear sky, low illuminance turbidity" [CIES011]: gradation a, b
# and indicatrix c, d, e.
_A, _B, _C, _D, _E = -1.0, -0.32, 10.0, -3.0, 0.45

_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


def overcast(directions: np.ndarray) -> np.ndarray:
    """(1 + 2 sin(elevation)) / 3 [MS42]: (m, 3) -> (m,)."""
    return (1.0 + 2.0 * directions[:, 1]) / 3.0


def clear(directions: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """f(chi) phi(Z) / (f(Zs) phi(0)) [CIES011], chi the angle from the sun (3,): (m, 3) -> (m,)."""
    up = np.maximum(directions[:, 1], 1e-9)  # on the horizon itself exp(b / 0) is 0
    return (
        _indicatrix(directions @ sun)
        * (1.0 + _A * np.exp(_B / up))
        / (_indicatrix(sun[1]) * (1.0 + _A * np.exp(_B)))
    )


def _indicatrix(cosine):
    cosine = np.clip(cosine, -1.0, 1.0)
    return 1.0 + _C * (np.exp(_D * np.arccos(cosine)) - np.exp(0.5 * np.pi * _D)) + _E * cosine * cosine


def disc_directions(centre: np.ndarray, radius: float, n: int) -> np.ndarray:
    """n unit directions (n, 3) that stand for equal solid angles of a disc of `radius` radians."""
    i = np.arange(n) + 0.5
    depth = i / n * 2.0 * np.sin(0.5 * radius) ** 2  # 1 - cos
    across = np.sqrt(depth * (2.0 - depth))
    side = np.cross(centre, np.eye(3)[np.argmin(np.abs(centre))])
    side /= np.linalg.norm(side)
    other = np.cross(centre, side)
    turn = _GOLDEN_ANGLE * i
    return (
        (1.0 - depth)[:, None] * centre
        + (across * np.cos(turn))[:, None] * side
        + (across * np.sin(turn))[:, None] * other
    )
