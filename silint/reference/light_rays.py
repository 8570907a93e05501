"""Light of a map for Embree QMC: rays towards its bright texels, texels that rays lead to, and sums of both.

The equirectangular map is taken as it lies (silint.core.conventions), with formulas of its own: a texel is
an interval of y = cos(theta) and one of phi, so that its solid angle is the product of their lengths.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

__all__ = ["LightSampler", "add_light", "light_sampler", "make_light_rays", "texels_of"]

# Rec. 709.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# Maps with fewer rows are drawn finer, so that half a column's angle is small enough for `_rotated`.
_FEWEST_ROWS = 64

# Luminance this little above the mean is rounding.
_ROUNDING = 1e-9


class LightSampler(NamedTuple):
    """A map of H x W texels, ready to be sampled and looked up."""

    texels: npt.NDArray[np.float32]
    """(H W, 4) radiance (red, green, blue) over `scale`, and probability density a steradian."""
    row_cdf: npt.NDArray[np.float64]
    """(H + 1,) from 0 to 1."""
    row_guide: npt.NDArray[np.int32]
    """(H,) the interval of `row_cdf` that k / H lies in."""
    column_cdf: npt.NDArray[np.float64]
    """(H, W + 1), for each row."""
    column_guide: npt.NDArray[np.int32]
    """(H, W)."""
    rotation: npt.NDArray[np.float64]
    """(3, 3), from the frame of the map to that of the scene."""
    scale: float
    """Mean luminance; it keeps float32 from overflowing."""
    importance: bool
    """Whether there is anything to aim at: not under a constant sky."""


def light_sampler(
    texel_radiance: npt.NDArray[Any], rotation: npt.NDArray[np.float64], importance: bool = True
) -> LightSampler:
    """Tables of a map.

    The probability of a texel goes with what its luminance exceeds the mean by, times its solid angle. That
    is better than the luminance itself when other samples, drawn from the cosine, cover what is even: MIS
    compensation [Karlík et al., "MIS compensation: optimizing sampling techniques in multiple importance
    sampling", ACM TOG 38(6), 2019].

    Parameters
    ----------
    texel_radiance : (H, 2 H, C)
        C is 1 or 3.
    rotation : (3, 3)
    importance : bool
        False: probability 0 everywhere, for samples drawn from the cosine alone.
    """
    texels = np.asarray(texel_radiance, np.float64)
    repeat = -(-_FEWEST_ROWS // len(texels))
    texels = texels.repeat(repeat, axis=0).repeat(repeat, axis=1)
    radiance = np.broadcast_to(texels, (*texels.shape[:2], 3))
    height, width = radiance.shape[:2]
    y = np.cos(np.pi * np.arange(height + 1) / height)
    solid_angle = ((y[:-1] - y[1:]) * (2.0 * np.pi / width))[:, None]
    luminance = radiance @ _LUMINANCE
    mean = float((luminance * solid_angle).sum() / (4.0 * np.pi))
    excess = np.where(luminance > mean * (1.0 + _ROUNDING), luminance - mean, 0.0)
    weight = excess * solid_angle
    total = float(weight.sum())
    importance = importance and total > 0.0
    table = np.zeros((height * width, 4), np.float32)
    table[:, :3] = (radiance / mean).reshape(-1, 3)
    if importance:
        table[:, 3] = (excess / total).ravel()
    row_cdf, column_cdf = _cdf(weight.sum(axis=1)[None])[0], _cdf(weight)
    return LightSampler(
        table,
        row_cdf,
        _guides(row_cdf[None])[0],
        column_cdf,
        _guides(column_cdf),
        np.array(rotation, np.float64),
        mean,
        importance,
    )


def _cdf(weights: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Cumulative distributions (m, n + 1) of weights (m, n); even ones where all weights are zero."""
    out = np.zeros((weights.shape[0], weights.shape[1] + 1))
    np.cumsum(weights, axis=1, out=out[:, 1:])
    total = out[:, -1:]
    even = np.arange(out.shape[1]) / weights.shape[1]
    return np.where(total > 0.0, out / np.where(total > 0.0, total, 1.0), even)


@njit(cache=True)
def _guides(cdfs):
    """For each of m distributions (m, n + 1): the interval that k / n lies in, k < n [Chen & Asau 1974]."""
    m, n = cdfs.shape[0], cdfs.shape[1] - 1
    out = np.empty((m, n), np.int32)
    for i in range(m):
        interval = 0
        for k in range(n):
            while cdfs[i, interval + 1] <= k / n:
                interval += 1
            out[i, k] = interval
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _invert(cdf, guide, x):
    """Interval of a distribution that x in [0, 1) lies in, and how far along it: two steps on average."""
    i = guide[int(x * len(guide))]
    while cdf[i + 1] <= x:
        i += 1
    return i, (x - cdf[i]) / (cdf[i + 1] - cdf[i])


@njit(cache=True, nogil=True)
def _rotated(c, s, angle):
    """Cosine and sine of an angle turned on by another, of at most pi / 128: to 1e-12."""
    a2 = angle * angle
    dc = 1.0 - a2 * (1.0 / 2 - a2 * (1.0 / 24 - a2 * (1.0 / 720)))
    ds = angle * (1.0 - a2 * (1.0 / 6 - a2 * (1.0 / 120)))
    return c * dc - s * ds, s * dc + c * ds


@njit(cache=True, nogil=True, error_model="numpy")
def make_light_rays(
    origins, normals, first, second, shifts, light, ray_origins, ray_directions, texels, counts
):
    """Rays of some points towards the light, one point after the other; how many they are.

    Samples below a point's horizon bring nothing and make no ray: counts[i] are left of len(first). The
    two axes of the samples go through the inverse distributions of rows and of columns, and on evenly within
    the texel's solid angle: both monotone, so that stratified samples stay stratified.
    """
    height, width = light.column_guide.shape
    y = np.cos(np.pi * np.arange(height + 1) / height)
    phi = np.pi * ((2.0 * np.arange(width) + 1.0) / width - 1.0)
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    step = 2.0 * np.pi / width
    r = light.rotation
    k = 0
    for i in range(len(origins)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        start = k
        for j in range(len(first)):
            # Signed: the half of the axis that a bit names changes sides, another digital shift.
            a = np.float64(np.int32(first[j] ^ shifts[i, 0])) * 2.0**-32 + (0.5 + 2.0**-33)
            b = np.float64(np.int32(second[j] ^ shifts[i, 1])) * 2.0**-32 + (0.5 + 2.0**-33)
            row, down = _invert(light.row_cdf, light.row_guide, a)
            column, right = _invert(light.column_cdf[row], light.column_guide[row], b)
            h = y[row] + down * (y[row + 1] - y[row])
            radius = math.sqrt(max(0.0, 1.0 - h * h))
            c, s = _rotated(cos_phi[column], sin_phi[column], (right - 0.5) * step)
            mx, mz = radius * c, radius * s
            x = r[0, 0] * mx + r[0, 1] * h + r[0, 2] * mz
            z = r[2, 0] * mx + r[2, 1] * h + r[2, 2] * mz
            w = r[1, 0] * mx + r[1, 1] * h + r[1, 2] * mz
            if nx * x + ny * w + nz * z <= 0.0:
                continue
            ray_directions[k, 0], ray_directions[k, 1], ray_directions[k, 2] = x, w, z
            ray_origins[k, 0], ray_origins[k, 1], ray_origins[k, 2] = (
                origins[i, 0],
                origins[i, 1],
                origins[i, 2],
            )
            texels[k] = row * width + column
            k += 1
        counts[i] = k - start
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def _angle(s, c):
    """atan2(s, c) to 2e-8 [Abramowitz & Stegun 4.4.49], without branches, so that loops vectorise."""
    a, b = abs(s), abs(c)
    q = min(a, b) / max(max(a, b), 1e-300)
    q2 = q * q
    t = 0.0028662257
    t = t * q2 - 0.0161657367
    t = t * q2 + 0.0429096138
    t = t * q2 - 0.0752896400
    t = t * q2 + 0.1065626393
    t = t * q2 - 0.1420889944
    t = t * q2 + 0.1999355085
    t = t * q2 - 0.3333314528
    t = q + q * q2 * t
    t = 0.5 * np.pi - t if a > b else t
    t = np.pi - t if c < 0.0 else t
    return -t if s < 0.0 else t


@njit(cache=True, nogil=True, error_model="numpy")
def texels_of(directions, light, texels):
    """Texels that directions lead to, as row * width + column."""
    height, width = light.column_guide.shape
    per_row, per_column = height / np.pi, width / (2.0 * np.pi)
    r = light.rotation
    r00, r01, r02 = r[0, 0], r[0, 1], r[0, 2]
    r10, r11, r12 = r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22 = r[2, 0], r[2, 1], r[2, 2]
    for k in range(len(directions)):
        dx, dy, dz = np.float64(directions[k, 0]), np.float64(directions[k, 1]), np.float64(directions[k, 2])
        x = r00 * dx + r10 * dy + r20 * dz
        y = r01 * dx + r11 * dy + r21 * dz
        z = r02 * dx + r12 * dy + r22 * dz
        row = np.int32(_angle(np.sqrt(x * x + z * z), y) * per_row)
        column = np.int32((_angle(z, x) + np.pi) * per_column)
        row = min(max(row, np.int32(0)), np.int32(height - 1))
        column = min(max(column, np.int32(0)), np.int32(width - 1))
        texels[k] = row * np.int32(width) + column


@njit(cache=True, nogil=True, error_model="numpy")
def add_light(hits, directions, texels, counts, normals, light, out):
    """Add up what arrives along the rays that met nothing: out[i, :3], for counts[i] rays of each point.

    Each ray counts L c / (c / pi + q), with c its cosine and q the density of rays towards the light: the
    balance heuristic for as many samples of either kind [Veach & Guibas 1995].
    """
    k = 0
    for i in range(len(out)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        red, green, blue = 0.0, 0.0, 0.0
        for _ in range(counts[i]):
            if hits[k] < 0:
                c = nx * directions[k, 0] + ny * directions[k, 1] + nz * directions[k, 2]
                if c > 0.0:
                    t = texels[k]
                    weight = c / (c * (1.0 / np.pi) + np.float64(light.texels[t, 3]))
                    red += weight * np.float64(light.texels[t, 0])
                    green += weight * np.float64(light.texels[t, 1])
                    blue += weight * np.float64(light.texels[t, 2])
            k += 1
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue
