"""Texels cut by a horizon: int max(n.w, 0) dw over a rectangle of the angles (theta, phi), in closed form.

The integral of w over a part of the sphere is that of w x dw / 2 round its boundary, counter-clockwise as
seen from outside [Lam60]. With e_theta and e_phi the unit vectors along the angles, w x dw is
e_theta sin(theta) dphi along a parallel, -e_phi dtheta along a meridian, and n ds along the horizon: every
piece is elementary, and of the pieces of the horizon only the length counts.

Each side of the rectangle is cut where it meets the horizon, by itself. Rounding may tell two sides that meet
in a corner on the horizon different things about it: then the loop is open there, by rounding. The ends of
all pieces are therefore kept as places s on the horizon, which need no order. Where a piece ends, a piece of
the horizon begins, so that its length is the sum of s over beginnings less that over ends, up to full turns;
where two sides meet above the horizon both terms cancel to the last bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER, KERNEL


@njit(**INNER)
def _place(theta, phi, across, along):
    """Where on the horizon a direction lies, or where it lies above: the angle from `across` to `along`."""
    x, y, z = np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)
    a = x * across[0] + y * across[1] + z * across[2]
    b = x * along[0] + y * along[1] + z * along[2]
    return np.arctan2(b, a)


@njit(**INNER)
def _horizon_axes(n):
    """Unit vectors such that (across, along, n) is right-handed."""
    x, y, z = n
    # The axis that n has least of.
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        length = np.sqrt(y * y + z * z)
        across = (0.0, z / length, -y / length)
    elif abs(y) <= abs(z):
        length = np.sqrt(x * x + z * z)
        across = (-z / length, 0.0, x / length)
    else:
        length = np.sqrt(x * x + y * y)
        across = (y / length, -x / length, 0.0)
    a, b, c = across
    return across, (y * c - z * b, z * a - x * c, x * b - y * a)


@njit(**INNER)
def _parallel(theta, phi0, phi1, start, end, n, axes):
    """int n.(w x dw) and s of beginnings less ends, along a parallel from phi0 to phi1 > phi0.

    Of what lies above the horizon. `start` and `end` are the places of its ends.
    """
    nx, ny, nz = n
    sine, cosine = np.sin(theta), np.cos(theta)
    rho, centre = np.hypot(nx, nz), np.arctan2(nz, nx)
    level = -ny * cosine / (rho * sine)
    # NaN, all of it on the horizon, counts as below.
    half = 4.0 * np.pi if level <= -1.0 else np.arccos(level) if level < 1.0 else -1.0
    integral, places = 0.0, 0.0
    for turn in range(-1, 2):
        middle = centre + turn * 2.0 * np.pi
        if half > np.pi and turn != 0:
            continue
        low, high = max(phi0, middle - half), min(phi1, middle + half)
        if low >= high:
            continue
        along_n = nx * (np.sin(high) - np.sin(low)) - nz * (np.cos(high) - np.cos(low))
        integral += sine * (cosine * along_n - ny * sine * (high - low))
        places += start if low == phi0 else _place(theta, low, *axes)
        places -= end if high == phi1 else _place(theta, high, *axes)
    return integral, places


@njit(**INNER)
def _meridian(phi, theta0, theta1, start, end, n, axes):
    """The same of a meridian, from theta0 to theta1 > theta0."""
    nx, ny, nz = n
    # n.w is a cosine of theta about the highest point of the full circle.
    centre = np.arctan2(nx * np.cos(phi) + nz * np.sin(phi), ny)
    integral, places = 0.0, 0.0
    for turn in range(2):
        middle = centre + turn * 2.0 * np.pi
        low, high = max(theta0, middle - 0.5 * np.pi), min(theta1, middle + 0.5 * np.pi)
        if low >= high:
            continue
        integral -= (nz * np.cos(phi) - nx * np.sin(phi)) * (high - low)
        places += start if low == theta0 else _place(low, phi, *axes)
        places -= end if high == theta1 else _place(high, phi, *axes)
    return integral, places


@njit(**KERNEL)
def lit_part(theta0, theta1, phi0, phi1, nx, ny, nz):
    """int max(n.w, 0) dw over [theta0, theta1] x [phi0, phi1].

    Parameters
    ----------
    theta0, theta1 : float
        In [0, pi].
    phi0, phi1 : float
        In [-pi, pi], no more than pi apart.
    nx, ny, nz : float
        Unit, in the frame of the map.
    """
    n = (nx, ny, nz)
    axes = _horizon_axes(n)
    p00, p01 = _place(theta0, phi0, *axes), _place(theta0, phi1, *axes)
    p10, p11 = _place(theta1, phi0, *axes), _place(theta1, phi1, *axes)
    # Seen from outside, phi grows to the right of theta turned upwards: the top side runs forwards.
    top, top_places = _parallel(theta0, phi0, phi1, p00, p01, n, axes)
    bottom, bottom_places = _parallel(theta1, phi0, phi1, p10, p11, n, axes)
    left, left_places = _meridian(phi0, theta0, theta1, p00, p10, n, axes)
    right, right_places = _meridian(phi1, theta0, theta1, p01, p11, n, axes)
    length = top_places - bottom_places + right_places - left_places
    # From 0 to pi, but for full turns and rounding.
    length -= 2.0 * np.pi * np.floor((length + 0.5 * np.pi) / (2.0 * np.pi))
    return 0.5 * (top - bottom + right - left + length)
