"""Radial isolines: half-planes through an axis close to the shade point's own normal.

The frame (T, M, A) of a point is a function of its normal alone: A is the normal tilted by about two degrees
and T, M are turned by an angle that no mesh was built with, since walls and floors aligned with the normal
would make zenith and lines degenerate. With azimuth phi about A, line k is the half-plane phi_k = 2 pi (k +
1/2) / K, and a direction on it is known by its key y = cot(theta): +inf at the zenith A, falling towards the
horizon of the normal. The circle is cut into K sectors, sector s between the lines s - 1 and s.

A great circle arc through a and b with normal N = a x (b - a) has
cot(theta) = -(N_T cos(phi) + N_M sin(phi)) / N_A: two products a crossing, and azimuth is monotone along it.
Every vertex has one sector. An edge crosses the lines between the sectors of its ends, the short way round,
whatever rounding does to where exactly: so the crossings of closed contours cancel. K is even, 4 at least.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import FILTER, INNER, KERNEL, PARALLEL

# A vertex at the shade point itself is seen along -n; its distance only has to be small.
AT_POINT = 2.0**-500

# The fixed rotation of the frame: turned by 0.7 about the normal, then tilted by 0.035.
_TILT, _TURN, _TILT_AXIS = 0.035, 0.7, 2.1


def _fixed_rotation() -> np.ndarray:
    """Rows T, M, A in an orthonormal basis whose last vector is the normal."""
    x, y = np.cos(_TILT_AXIS), np.sin(_TILT_AXIS)
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    tilt = np.eye(3) + np.sin(_TILT) * cross + (1.0 - np.cos(_TILT)) * cross @ cross
    c, s = np.cos(_TURN), np.sin(_TURN)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rows: np.ndarray = (tilt @ turn).T
    return rows


_G = tuple(float(x) for x in _fixed_rotation().ravel())
NORMAL_ALONG_AXIS = _G[8]
NORMAL_IN_FRAME = (_G[2], _G[5], _G[8])
_G00, _G01, _G02, _G10, _G11, _G12, _G20, _G21, _G22 = _G

# atan(x) / x as a polynomial in x^2 for |x| <= tan(pi / 8), to rounding.
_ATAN = (
    1.0,
    -0.3333333333332844,
    0.1999999999885511,
    -0.14285714180976467,
    0.11111106180455946,
    -0.09090773074808414,
    0.07689953496306857,
    -0.06640233930429408,
    0.056883492268090106,
    -0.04348052215716462,
    0.021135373157693246,
)
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = _ATAN
_TAN_EIGHTH = 0.41421356237309503

# The same on [0, 1] in float32, to 1.5e-4; what `rough_azimuth` may be off by, in radians.
ROUGHNESS = 2e-4
_F = np.float32
_ZERO = _F(0.0)
_A0, _A1, _A2, _A3 = _F(0.99921406), _F(-0.32117496), _F(0.14626446), _F(-0.03898651)
_QUARTER, _TURN_HALF, _TURN_WHOLE = _F(0.5 * np.pi), _F(np.pi), _F(2.0 * np.pi)


def line_table(n_lines: int) -> np.ndarray:
    """Cosine and sine of phi_k: (K, 2) float64."""
    phi = 2.0 * np.pi * (np.arange(n_lines) + 0.5) / n_lines
    return np.stack([np.cos(phi), np.sin(phi)], axis=1)


def normal_table(lines: np.ndarray, cosine: float = 0.0) -> np.ndarray:
    """The normal seen from each line: its component along the line's t and the key of its horizon, (K, 2).

    The frame is fixed to the normal, so these are the same for every shade point. With a `cosine` above 0 the
    keys are those of the cone n.w > cosine instead, which has to hold the axis: 4 degrees wide at least.
    """
    along = _G02 * lines[:, 0] + _G12 * lines[:, 1]
    if cosine == 0.0:
        return np.stack([along, -along / _G22], axis=1)
    # n.w = rho cos(theta - theta_0), and rho cos(theta_0) = n_A: theta is theta_0 + arccos(cosine / rho).
    sine = np.sqrt(_G22 * _G22 + along * along - cosine * cosine)
    return np.stack([along, (_G22 * cosine - along * sine) / (along * cosine + _G22 * sine)], axis=1)


NO_AIM = np.zeros(3)
NO_AIM.setflags(write=False)


class RadialIntervals(NamedTuple):
    """Visible intervals on the radial isolines of n points: what phase one knows, and phase two reads."""

    normals: np.ndarray  # (n, 3) float64, unit
    counts: np.ndarray  # (n, K) int32: intervals on each line
    starts: np.ndarray  # (n,) int64: first row of each point's intervals, line by line
    intervals: np.ndarray  # (m, 2) float64: keys of start (inf at the zenith) and end, from the zenith down
    cone: float = 0.0  # lines end where n.w falls to this: at the horizon, or at that of a cone about n


@njit(**KERNEL)
def set_frame(n, frame):
    """Write T, M, A of a unit normal to the rows of frame (3, 3).

    The basis of Duff et al. 2017 (Building an Orthonormal Basis, Revisited), then a fixed rotation.
    """
    sign = 1.0 if n[2] >= 0.0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    bx, by, bz = 1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]
    cx, cy, cz = b, sign + n[1] * n[1] * a, -n[1]
    frame[0, 0] = _G00 * bx + _G01 * cx + _G02 * n[0]
    frame[0, 1] = _G00 * by + _G01 * cy + _G02 * n[1]
    frame[0, 2] = _G00 * bz + _G01 * cz + _G02 * n[2]
    frame[1, 0] = _G10 * bx + _G11 * cx + _G12 * n[0]
    frame[1, 1] = _G10 * by + _G11 * cy + _G12 * n[1]
    frame[1, 2] = _G10 * bz + _G11 * cz + _G12 * n[2]
    frame[2, 0] = _G20 * bx + _G21 * cx + _G22 * n[0]
    frame[2, 1] = _G20 * by + _G21 * cy + _G22 * n[1]
    frame[2, 2] = _G20 * bz + _G21 * cz + _G22 * n[2]


@njit(**PARALLEL)
def set_frames(normals, aim, n_lines, frames):
    """Frames of many shade points, turned about their normals such that a line meets a direction.

    Turned about the normal, a frame keeps where the normal lies in it, and with it the horizon's keys. A
    direction off the normal by more than the axis is off the line next to the normal (2 degrees times pi / K)
    comes to lie on that line to rounding; one closer comes as close as can be.

    Parameters
    ----------
    normals : (n, 3) float64
    aim : (3,) float64
        Unit; zero for none. A point above whose horizon it does not lie keeps the frame of its normal.
    n_lines : int
    frames : (n, 3, 3) float64, out
    """
    step = 2.0 * np.pi / n_lines
    phi = (np.floor(np.arctan2(_G12, _G02) / step) + 0.5) * step
    t, m = np.cos(phi), np.sin(phi)
    along = _G02 * t + _G12 * m
    reach, rest = np.hypot(_G22, along), np.arctan2(along, _G22)
    for i in prange(len(normals)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        height = n[0] * aim[0] + n[1] * aim[1] + n[2] * aim[2]
        set_frame(n, frames[i])
        if height > 0.0:
            # Where on the line the normal is as far away as it is from the direction.
            theta = rest + np.arccos(min(height / reach, 1.0))
            s, c = np.sin(theta), np.cos(theta)
            _turn_frame(n, aim, (s * t, s * m, c), frames[i])


@njit(**INNER)
def _turn_frame(n, aim, wanted, frame):
    """Turn a frame about the normal such that the azimuth of a direction is that of coordinates `wanted`."""
    here = in_frame(aim[0], aim[1], aim[2], frame)
    # Both, about the normal as it lies in the frame.
    ax, ay, az = _off_normal(here[0], here[1], here[2])
    bx, by, bz = _off_normal(wanted[0], wanted[1], wanted[2])
    c = ax * bx + ay * by + az * bz
    s = _G02 * (ay * bz - az * by) + _G12 * (az * bx - ax * bz) + _G22 * (ax * by - ay * bx)
    length = np.hypot(c, s)
    if length < 1e-12:
        return
    c, s = c / length, s / length
    for j in range(3):
        x, y, z = frame[0, j], frame[1, j], frame[2, j]
        # The coordinates of the world's axes, turned about the normal by the angle (c, s) [Rodrigues].
        d = (1.0 - c) * (_G02 * x + _G12 * y + _G22 * z)
        frame[0, j] = c * x + s * (_G12 * z - _G22 * y) + d * _G02
        frame[1, j] = c * y + s * (_G22 * x - _G02 * z) + d * _G12
        frame[2, j] = c * z + s * (_G02 * y - _G12 * x) + d * _G22


@njit(**INNER)
def _off_normal(x, y, z):
    """The part of coordinates across the normal."""
    d = _G02 * x + _G12 * y + _G22 * z
    return x - d * _G02, y - d * _G12, z - d * _G22


@njit(**KERNEL)
def in_frame(x, y, z, frame):
    """Coordinates of a world vector along T, M, A."""
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z,
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z,
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z,
    )


@njit(**KERNEL)
def local_vertex(vertices, v, p, n, frame):
    """Direction from p to a vertex in the frame, and its height above the horizon of n."""
    x, y, z = vertices[v, 0] - p[0], vertices[v, 1] - p[1], vertices[v, 2] - p[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        x, y, z = -AT_POINT * n[0], -AT_POINT * n[1], -AT_POINT * n[2]
    t, m, a = in_frame(x, y, z, frame)
    return t, m, a, n[0] * x + n[1] * y + n[2] * z


@njit(**INNER)
def azimuth(t, m):
    """Azimuth in [0, 2 pi] of a direction, 0 along the axis.

    Without a branch or a call, so that a loop over it becomes vector code with the same bits as a single one.
    """
    x, y = abs(t), abs(m)
    big = x if x > y else y
    small = y if x > y else x
    steep = small > _TAN_EIGHTH * big
    above = small - big if steep else small
    below = small + big if steep else big
    q = above / (below if below > 0.0 else 1.0)
    s = q * q
    r = _C4 + s * (_C5 + s * (_C6 + s * (_C7 + s * (_C8 + s * (_C9 + s * _C10)))))
    r = q * (_C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * r))))
    r = 0.25 * np.pi + r if steep else r
    r = 0.5 * np.pi - r if y > x else r
    r = np.pi - r if t < 0.0 else r
    return 2.0 * np.pi - r if m < 0.0 else r


@njit(**FILTER)
def rough_azimuth(t, m):
    """Azimuth in [0, 2 pi] of a float32 direction, to ROUGHNESS."""
    x, y = abs(t), abs(m)
    big = x if x > y else y
    small = y if x > y else x
    q = small / (big + _F(1e-30))
    s = q * q
    r = q * (_A0 + s * (_A1 + s * (_A2 + s * _A3)))
    r = _QUARTER - r if y > x else r
    r = _TURN_HALF - r if t < _ZERO else r
    return _TURN_WHOLE - r if m < _ZERO else r


@njit(**INNER)
def sector(t, m, n_lines):
    """Sector of a direction: sector s lies between the lines s - 1 and s."""
    s = np.int32(azimuth(t, m) * (n_lines / (2.0 * np.pi)) + 0.5)
    return s if s < n_lines else np.int32(0)


@njit(**KERNEL)
def edge_circle(ax, ay, az, ex, ey, ez):
    """Great circle through a and a + e, in the frame: A and B of key = A cos(phi) + B sin(phi), and N_A.

    Where N_A is 0 the keys are infinite, or NaN for an edge through the shade point, which counts as seen
    along -n.
    """
    turn = ax * ey - ay * ex
    scale = -1.0 / turn
    return (ay * ez - az * ey) * scale, (az * ex - ax * ez) * scale, turn


@njit(**KERNEL)
def span(sector_a, sector_b, turn, n_lines):
    """Lines that an arc crosses: the first, their number, and whether it turns left, seen from the axis.

    An arc spans less than half a turn, so the sectors tell the direction; where they leave it open, the sign
    of N_A does. K is even: then that is never a matter of rounding.
    """
    left = sector_b - sector_a
    if left < 0:
        left += n_lines
    if 2 * left < n_lines or (2 * left == n_lines and turn > 0.0):
        return sector_a, left, True
    return sector_b, n_lines - left, False
