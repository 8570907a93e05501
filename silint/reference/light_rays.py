"""Light of a map for Embree QMC: rays towards its bright texels, texels that rays lead to, and sums of both.

The equirectangular map is taken as it lies (silint.core.conventions), with formulas of its own: a texel is
an interval of y = cos(theta) and one of phi, so that its solid angle is the product of their lengths.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

__all__ = ["LightSampler", "add_light", "light_sampler", "make_light_rays", "texels_of"]

# Rec. 709.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

# Maps with fewer rows are drawn finer, so that half a column's angle is small enough for `_to_scene`.
_FEWEST_ROWS = 64

# Guide entries for each interval of the distributions: 21 ns a sample in a map of 512 rows; 29 with one.
_ROW_STEPS, _COLUMN_STEPS = 8, 2

_BLOCK = 256  # directions looked up together

# Luminance this little above the mean is rounding.
_ROUNDING = 1e-9


class LightSampler(NamedTuple):
    """A map of H x W texels, ready to be sampled and looked up."""

    texels: npt.NDArray[np.float32]
    """(H W, 4) radiance (red, green, blue) over `scale`, and probability density a steradian."""
    row_cdf: npt.NDArray[np.float64]
    """(H + 1,) from 0 to 1."""
    row_guide: npt.NDArray[np.int32]
    """(8 H,) the interval of `row_cdf` that k / 8 H lies in."""
    column_cdf: npt.NDArray[np.float64]
    """(H, W + 1), for each row."""
    column_guide: npt.NDArray[np.int32]
    """(H, 2 W)."""
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
        _guides(row_cdf[None], _ROW_STEPS * height)[0],
        column_cdf,
        _guides(column_cdf, _COLUMN_STEPS * width),
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
def _guides(cdfs, steps):
    """For each of m distributions (m, n + 1): the interval that k / steps lies in [Chen & Asau 1974]."""
    m = len(cdfs)
    out = np.empty((m, steps), np.int32)
    for i in range(m):
        interval = 0
        for k in range(steps):
            while cdfs[i, interval + 1] <= k / steps:
                interval += 1
            out[i, k] = interval
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def make_light_rays(
    origins, normals, first, second, shifts, light, ray_origins, ray_directions, texels, counts
):
    """Rays of some points towards the light, one point after the other; how many they are.

    Samples below a point's horizon bring nothing and make no ray: counts[i] are left of len(first). The
    two axes of the samples go through the inverse distributions of rows and of columns, and on evenly within
    the texel's solid angle: both monotone, so that stratified samples stay stratified.
    """
    height, width = light.column_cdf.shape[0], light.column_cdf.shape[1] - 1
    row_steps, column_steps = len(light.row_guide), light.column_guide.shape[1]
    y = np.cos(np.pi * np.arange(height + 1) / height)
    phi = np.pi * ((2.0 * np.arange(width) + 1.0) / width - 1.0)
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    step = 2.0 * np.pi / width
    row_cdf, row_guide = light.row_cdf, light.row_guide
    column_cdf, column_guide = light.column_cdf, light.column_guide
    m = len(first)
    texel, rows, columns = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m, np.int64)
    b, low, high = np.empty(m), np.empty(m), np.empty(m)
    h, c, s, angle = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    w0, w1, w2, cosine = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    k = 0
    for i in range(len(origins)):
        # In stages, so that loads which miss the caches do not wait for one another: 20 % more rays a second
        # under a map of 512 rows.
        for j in range(m):
            # Signed: the half of the axis that a bit names changes sides, another digital shift.
            a = np.float64(np.int32(first[j] ^ shifts[i, 0])) * 2.0**-32 + (0.5 + 2.0**-33)
            b[j] = np.float64(np.int32(second[j] ^ shifts[i, 1])) * 2.0**-32 + (0.5 + 2.0**-33)
            # From the guides on, a step or less on average.
            row = row_guide[np.int64(a * row_steps)]
            while row_cdf[row + 1] <= a:
                row += 1
            down = (a - row_cdf[row]) / (row_cdf[row + 1] - row_cdf[row])
            h[j] = y[row] + down * (y[row + 1] - y[row])
            rows[j] = row
        for j in range(m):
            columns[j] = column_guide[rows[j], np.int64(b[j] * column_steps)]
        for j in range(m):
            low[j], high[j] = column_cdf[rows[j], columns[j]], column_cdf[rows[j], columns[j] + 1]
        for j in range(m):
            column = columns[j]
            while high[j] <= b[j]:
                column += 1
                low[j], high[j] = high[j], column_cdf[rows[j], column + 1]
            c[j], s[j] = cos_phi[column], sin_phi[column]
            angle[j] = ((b[j] - low[j]) / (high[j] - low[j]) - 0.5) * step
            texel[j] = rows[j] * width + column
        _to_scene(h, c, s, angle, light.rotation, normals[i], w0, w1, w2, cosine)
        start = k
        for j in range(m):
            if cosine[j] > 0.0:
                ray_directions[k, 0], ray_directions[k, 1], ray_directions[k, 2] = w0[j], w1[j], w2[j]
                ray_origins[k, 0], ray_origins[k, 1], ray_origins[k, 2] = (
                    origins[i, 0],
                    origins[i, 1],
                    origins[i, 2],
                )
                texels[k] = texel[j]
                k += 1
        counts[i] = k - start
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def _to_scene(h, c, s, angle, r, normal, w0, w1, w2, cosine):
    """Directions from heights, columns and angles off their centres; apart, so that the loop vectorises."""
    r00, r01, r02 = r[0, 0], r[0, 1], r[0, 2]
    r10, r11, r12 = r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22 = r[2, 0], r[2, 1], r[2, 2]
    nx, ny, nz = normal[0], normal[1], normal[2]
    for j in range(len(h)):
        radius = np.sqrt(max(0.0, 1.0 - h[j] * h[j]))
        # The angle is pi / 128 at most: series to 1e-12.
        a2 = angle[j] * angle[j]
        dc = 1.0 - a2 * (1.0 / 2 - a2 * (1.0 / 24 - a2 * (1.0 / 720)))
        ds = angle[j] * (1.0 - a2 * (1.0 / 6 - a2 * (1.0 / 120)))
        x, z = radius * (c[j] * dc - s[j] * ds), radius * (s[j] * dc + c[j] * ds)
        w0[j] = r00 * x + r01 * h[j] + r02 * z
        w1[j] = r10 * x + r11 * h[j] + r12 * z
        w2[j] = r20 * x + r21 * h[j] + r22 * z
        cosine[j] = nx * w0[j] + ny * w1[j] + nz * w2[j]


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
    height, width = light.column_cdf.shape[0], light.column_cdf.shape[1] - 1
    x, y, z = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    rows, columns = np.empty(_BLOCK), np.empty(_BLOCK)
    for start in range(0, len(directions), _BLOCK):
        m = min(_BLOCK, len(directions) - start)
        for j in range(m):
            x[j], y[j], z[j] = directions[start + j, 0], directions[start + j, 1], directions[start + j, 2]
        _places(x, y, z, light.rotation, height / np.pi, rows, columns)
        for j in range(m):
            # A hair beyond the map's border, by rounding, is on it.
            row, column = min(np.int64(rows[j]), height - 1), min(np.int64(columns[j]), width - 1)
            texels[start + j] = row * width + column


@njit(cache=True, nogil=True, error_model="numpy")
def _places(x, y, z, r, scale, rows, columns):
    """Rows and columns, with fractions, in a map of `scale` texels a radian; a loop that vectorises."""
    r00, r01, r02 = r[0, 0], r[0, 1], r[0, 2]
    r10, r11, r12 = r[1, 0], r[1, 1], r[1, 2]
    r20, r21, r22 = r[2, 0], r[2, 1], r[2, 2]
    for j in range(len(x)):
        mx = r00 * x[j] + r10 * y[j] + r20 * z[j]
        my = r01 * x[j] + r11 * y[j] + r21 * z[j]
        mz = r02 * x[j] + r12 * y[j] + r22 * z[j]
        rows[j] = max(_angle(np.sqrt(mx * mx + mz * mz), my) * scale, 0.0)
        columns[j] = max((_angle(mz, mx) + np.pi) * scale, 0.0)


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
