"""Small circles of the sphere of directions, as edges of the sweep: where faces leave a ball.

The ball of radius R about the shade point cuts a plane at the distance d in a circle, seen as N.w = c with
c = d / R and N the unit normal towards it. In the frame of `radial`, with its axis N on the left, such a
circle runs towards rising azimuth phi where

    cos(theta) = (c N_A - B r) / q,    sin(theta) = (c B + N_A r) / q,
    B = N_T cos(phi) + N_M sin(phi),   q = B^2 + N_A^2,   r = sqrt(q - c^2)

(half-plane and circle meet at theta_0 -+ arccos(c / sqrt(q)), tan(theta_0) = B / N_A; the other branch runs
the other way, and with -N and -c this one). A great circle has c = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.jit import INNER
from silint.core.radial import azimuth

# Sine squared of the angle between planes whose circles count as one.
_SAME = 1e-28
_LEAST = 1e-300


class Circle(NamedTuple):
    """A circle N.w = c with angles about its axis N, counted to its left, from `first` on."""

    axis: tuple[float, float, float]
    c: float
    first: tuple[float, float, float]
    second: tuple[float, float, float]


@njit(**INNER)
def dot(a, b):
    """a . b of tuples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INNER)
def cross(a, b):
    """a x b of tuples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**INNER)
def circle_about(axis, c):
    """The circle with angles from somewhere on."""
    x, y, z = axis
    u, v, w = abs(x), abs(y), abs(z)
    if u <= v and u <= w:
        s = 1.0 / np.sqrt(y * y + z * z)
        first = 0.0, s * z, -s * y
    elif v <= w:
        s = 1.0 / np.sqrt(x * x + z * z)
        first = -s * z, 0.0, s * x
    else:
        s = 1.0 / np.sqrt(x * x + y * y)
        first = s * y, -s * x, 0.0
    return Circle(axis, c, first, cross(axis, first))


@njit(**INNER)
def angle_on(circle, w):
    """Angle of a direction about the axis, in [0, 2 pi]."""
    return azimuth(dot(w, circle.first), dot(w, circle.second))


@njit(**INNER)
def direction_on(circle, angle):
    """Direction of the circle at an angle about its axis."""
    axis, first, second, c = circle.axis, circle.first, circle.second, circle.c
    rho = np.sqrt((1.0 - c) * (1.0 + c))
    u, v = rho * np.cos(angle), rho * np.sin(angle)
    return (
        c * axis[0] + u * first[0] + v * second[0],
        c * axis[1] + u * first[1] + v * second[1],
        c * axis[2] + u * first[2] + v * second[2],
    )


@njit(**INNER)
def height_on(axis, c, x, y):
    """cot(theta) above (x, y), times the length of (x, y)."""
    square = x * x + y * y
    b = axis[0] * x + axis[1] * y
    r = b * b + (axis[2] * axis[2] - c * c) * square
    r = np.sqrt(r if r > 0.0 else 0.0)
    under = c * b + axis[2] * r
    return (c * axis[2] * square - b * r) / (under if under > _LEAST else _LEAST)


@njit(**INNER)
def slope_at(axis, x, y, z):
    """d cot(theta) / d phi times sin(theta), at a direction of the circle; infinite where it turns back."""
    t, m, a = axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x
    under = x * m - y * t
    return a / under if under > 0.0 else (np.inf if a > 0.0 else -np.inf)


@njit(**INNER)
def onto_circle(axis, c, x, y, z):
    """The direction of the circle that is nearest to (x, y, z)."""
    d = axis[0] * x + axis[1] * y + axis[2] * z
    x, y, z = x - d * axis[0], y - d * axis[1], z - d * axis[2]
    square = x * x + y * y + z * z
    s = np.sqrt((1.0 - c) * (1.0 + c) / square) if square > 0.0 else 0.0
    return c * axis[0] + s * x, c * axis[1] + s * y, c * axis[2] + s * z


@njit(**INNER)
def circles_meet(axis, c, other, d):
    """Where two circles cross.

    Returns
    -------
    meet : bool
        False for circles of one plane too.
    first, second : tuple of 3 float
        Directions.
    """
    x = axis[1] * other[2] - axis[2] * other[1]
    y = axis[2] * other[0] - axis[0] * other[2]
    z = axis[0] * other[1] - axis[1] * other[0]
    square = x * x + y * y + z * z
    if square < _SAME:
        return False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    g = axis[0] * other[0] + axis[1] * other[1] + axis[2] * other[2]
    s = 1.0 / square
    a, b = s * (c - g * d), s * (d - g * c)
    rest = 1.0 - (a * c + b * d)
    if not rest >= 0.0:
        return False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    u, v, w = a * axis[0] + b * other[0], a * axis[1] + b * other[1], a * axis[2] + b * other[2]
    h = np.sqrt(s * rest)
    return True, (u + h * x, v + h * y, w + h * z), (u - h * x, v - h * y, w - h * z)
