"""Compiled stages of Embree QMC: rays of a batch of points, and what got through."""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["count_open", "make_rays", "sum_open"]

_F = np.float32
_QUARTER_PI = np.float32(np.pi / 4)


@njit(cache=True, nogil=True, error_model="numpy")
def _hemisphere(first, second, shift0, shift1, uniform, x, y, z):
    """Shifted samples, mapped to the hemisphere of +z; separate arrays, so that the loop vectorises.

    The square goes to the disc by the concentric map [Shirley & Chiu 1997], and the disc up to the
    hemisphere: straight up for the cosine [Malley's method], by equal areas for the uniform weight. The
    angle stays within a quarter of pi, where these polynomials are exact to float32's rounding.
    """
    half_step = _F(2.0**-32)  # keeps zero, and with it 0 / 0, out
    for j in range(len(first)):
        a = _F(np.int32(first[j] ^ shift0)) * _F(2.0**-31) + half_step
        b = _F(np.int32(second[j] ^ shift1)) * _F(2.0**-31) + half_step
        swap = abs(a) > abs(b)
        r = a if swap else b
        t = b if swap else a
        q = t / r * _QUARTER_PI
        q2 = q * q
        s = q * (_F(1) + q2 * (_F(-1 / 6) + q2 * (_F(1 / 120) + q2 * (_F(-1 / 5040) + q2 * _F(1 / 362880)))))
        c = _F(1) + q2 * (_F(-1 / 2) + q2 * (_F(1 / 24) + q2 * (_F(-1 / 720) + q2 * _F(1 / 40320))))
        r2 = r * r
        height = _F(1) - r2
        stretch = r
        if uniform:
            stretch = r * np.sqrt(_F(2) - r2)
        else:
            height = np.sqrt(max(_F(0), height))
        x[j] = stretch * (c if swap else s)
        y[j] = stretch * (s if swap else c)
        z[j] = height


@njit(cache=True, nogil=True, error_model="numpy")
def make_rays(origins, normals, first, second, shifts, uniform, ray_origins, ray_directions):
    """Rays of some points: len(first) each, one point after the other, into the first rows of the output.

    The frame around a normal is that of Duff et al., "Building an orthonormal basis, revisited", JCGT 2017.
    """
    m = len(first)
    x, y, z = np.empty(m, _F), np.empty(m, _F), np.empty(m, _F)
    for i in range(len(origins)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        sign = 1.0 if nz >= 0.0 else -1.0
        a = -1.0 / (sign + nz)
        b = nx * ny * a
        t0, t1, t2 = _F(1.0 + sign * nx * nx * a), _F(sign * b), _F(-sign * nx)
        s0, s1, s2 = _F(b), _F(sign + ny * ny * a), _F(-ny)
        n0, n1, n2 = _F(nx), _F(ny), _F(nz)
        p0, p1, p2 = origins[i, 0], origins[i, 1], origins[i, 2]
        _hemisphere(first, second, shifts[i, 0], shifts[i, 1], uniform, x, y, z)
        for j in range(m):
            k = i * m + j
            ray_directions[k, 0] = x[j] * t0 + y[j] * s0 + z[j] * n0
            ray_directions[k, 1] = x[j] * t1 + y[j] * s1 + z[j] * n1
            ray_directions[k, 2] = x[j] * t2 + y[j] * s2 + z[j] * n2
            ray_origins[k, 0], ray_origins[k, 1], ray_origins[k, 2] = p0, p1, p2


@njit(cache=True, nogil=True)
def count_open(hits, out):
    """Rays that met nothing (embreex says -1), for each of len(out) points."""
    m = len(hits) // len(out)
    for i in range(len(out)):
        count = 0
        for j in range(i * m, (i + 1) * m):
            count += hits[j] < 0
        out[i] = count


@njit(cache=True, nogil=True)
def sum_open(hits, directions, up, out):
    """Sums over the rays that met nothing: of their directions (3 columns), and of [up.w > 0]."""
    m = len(hits) // len(out)
    for i in range(len(out)):
        sx, sy, sz, above = 0.0, 0.0, 0.0, 0.0
        for j in range(i * m, (i + 1) * m):
            if hits[j] < 0:
                x = np.float64(directions[j, 0])
                y = np.float64(directions[j, 1])
                z = np.float64(directions[j, 2])
                sx += x
                sy += y
                sz += z
                if up[0] * x + up[1] * y + up[2] * z > 0.0:
                    above += 1.0
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = sx, sy, sz, above
