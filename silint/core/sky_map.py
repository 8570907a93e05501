"""Radiance at many sizes of cell: an environment map as a pyramid of octahedral ones [PH03].

A level of N x N texels holds means of radiance, weighted with solid angle, so that no light is lost from one
level to the next. What is fetched from is a level spread over twice as many texels each way, linear between
the level's centres: the nearest of them is as good as four of the level itself, in one access.

A direction w in the frame of the map is projected on |x| + |y| + |z| = 1; the half y < 0 is folded out over
the square's edges. Texel (row, column) covers x to the right and z downwards, both in [-1, 1].
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, KERNEL, PARALLEL

# Texels each way of the finest level, which takes 4 MiB when spread, and of the coarsest.
MOST_TEXELS, _LEAST_TEXELS, _COARSEST = 512, 128, 4
# Texels of the map are cut in parts, so many from pole to pole for each texel of the finest level: these are
# 2 / N wide at least, so that some lie in each of them.
_PARTS = 3
# Normals, each way, that irradiance without occluders is tabulated for, and the texels it is summed over.
OPEN_NORMALS, _OPEN_TEXELS = 128, 128


@njit(**INNER)
def unfolded(x, y, z):
    """Coordinates in [-1, 1]^2 of a direction of any length."""
    one = type(x)(1.0)
    scale = one / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, z * scale
    au, av = abs(u), abs(v)
    folded = y < 0
    p = one - av if folded else au
    q = one - au if folded else av
    return -p if u < 0 else p, -q if v < 0 else q


@njit(**KERNEL)
def texel_of(x, y, z, size):
    """Index row * size + column of the texel that a direction of any length lies in."""
    u, v = unfolded(x, y, z)
    half = 0.5 * size
    column, row = min(int((u + 1.0) * half), size - 1), min(int((v + 1.0) * half), size - 1)
    return row * size + column


@njit(**KERNEL)
def _deal_out(radiance, parts, size, sums):
    """Add radiance times solid angle, and solid angle, of the parts of all texels to those they lie in."""
    height, width, n_channels = radiance.shape
    h = np.pi / (height * parts)
    for r in range(height * parts):
        theta = h * (r + 0.5)
        sine, cosine = np.sin(theta), np.cos(theta)
        solid = 2.0 * sine * np.sin(0.5 * h) * h
        for c in range(width * parts):
            phi = h * (c + 0.5) - np.pi
            at = texel_of(sine * np.cos(phi), cosine, sine * np.sin(phi), size)
            row, column = r // parts, c // parts
            sums[at, 3] += solid
            for i in range(3):
                sums[at, i] += solid * radiance[row, column, min(i, n_channels - 1)]


def build_pyramid(radiance: np.ndarray) -> tuple[np.ndarray, ...]:
    """Levels of light and solid angle, the finest first.

    Parameters
    ----------
    radiance : (H, 2 H, C) float64
        An equirectangular map.

    Returns
    -------
    tuple of (N, N, 4) float64
        int L dw of three channels over each texel, and int dw. N is a power of two, halved from level to
        level, at first the least that is not below H, within bounds.
    """
    size = min(max(1 << (len(radiance) - 1).bit_length(), _LEAST_TEXELS), MOST_TEXELS)
    flat = np.zeros((size * size, 4))
    parts = -(-_PARTS * size // len(radiance))
    _deal_out(np.ascontiguousarray(radiance), parts, size, flat)
    levels = [flat.reshape(size, size, 4)]
    while size > _COARSEST:
        size //= 2
        levels.append(levels[-1].reshape(size, 2, size, 2, 4).sum(axis=(1, 3)))
    return tuple(levels)


def spread_level(level: np.ndarray) -> np.ndarray:
    """Radiance of a level (N, N, 4), linear between its centres, at four times as many: (4 N^2, 4) float32.

    The last column is there to have a texel in one line of a cache.
    """
    n = len(level)
    padded = pad_square(level[..., :3] / level[..., 3:])
    down = _twice(padded)
    fine = _twice(down.swapaxes(0, 1)).swapaxes(0, 1)
    out = np.zeros((4 * n * n, 4), np.float32)
    out[:, :3] = fine.reshape(-1, 3)
    out.setflags(write=False)
    return out


def pad_square(square: np.ndarray) -> np.ndarray:
    """An octahedral square (N, N, C) with what lies over its edges and corners: (N + 2, N + 2, C)."""
    n = len(square)
    padded = np.empty((n + 2, n + 2, square.shape[2]))
    padded[1:-1, 1:-1] = square
    # Over an edge lies the same edge, mirrored; over a corner the opposite one.
    padded[0, 1:-1], padded[-1, 1:-1] = square[0, ::-1], square[-1, ::-1]
    padded[1:-1, 0], padded[1:-1, -1] = square[::-1, 0], square[::-1, -1]
    padded[0, 0], padded[-1, -1] = square[-1, -1], square[0, 0]
    padded[0, -1], padded[-1, 0] = square[-1, 0], square[0, -1]
    return padded


def _twice(rows: np.ndarray) -> np.ndarray:
    """Twice the inner rows, a quarter of the way to either neighbour."""
    out = np.empty((2 * (len(rows) - 2), *rows.shape[1:]))
    out[::2] = 0.75 * rows[1:-1] + 0.25 * rows[:-2]
    out[1::2] = 0.75 * rows[1:-1] + 0.25 * rows[2:]
    return out


def directions_of(u: np.ndarray) -> np.ndarray:
    """Unit directions at all pairs of coordinates u (N,), row by row: (N^2, 3)."""
    x, z = np.broadcast_to(u, (len(u), len(u))), np.broadcast_to(u[:, None], (len(u), len(u)))
    y = 1.0 - abs(x) - abs(z)
    across = np.where(y < 0.0, np.copysign(1.0 - abs(z), x), x)
    along = np.where(y < 0.0, np.copysign(1.0 - abs(x), z), z)
    w = np.stack([across, y, along], axis=-1).reshape(-1, 3)
    unit: np.ndarray = w / np.sqrt((w * w).sum(axis=1, keepdims=True))
    return unit


@njit(**PARALLEL)
def _open_sums(normals, directions, light, out):
    for i in prange(len(normals)):
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        red, green, blue = 0.0, 0.0, 0.0
        for j in range(len(directions)):
            cosine = max(x * directions[j, 0] + y * directions[j, 1] + z * directions[j, 2], 0.0)
            red += light[j, 0] * cosine
            green += light[j, 1] * cosine
            blue += light[j, 2] * cosine
        out[i, 0], out[i, 1], out[i, 2] = red, green, blue


def open_irradiance(levels: tuple[np.ndarray, ...]) -> np.ndarray:
    """int L max(n.w, 0) dw for normals n on a grid over the octahedral square: (G + 1, G + 1, 3).

    Exact for light at the centres of a level's texels: a part in 10^4 for skies.
    """
    level = next(a for a in levels if len(a) <= _OPEN_TEXELS)
    n, g = len(level), OPEN_NORMALS
    out = np.empty(((g + 1) ** 2, 3))
    _open_sums(
        directions_of(np.arange(g + 1) * (2.0 / g) - 1.0),
        directions_of((np.arange(n) + 0.5) * (2.0 / n) - 1.0),
        np.ascontiguousarray(level[..., :3].reshape(-1, 3)),
        out,
    )
    return out.reshape(g + 1, g + 1, 3)


@njit(**INNER)
def interpolate_open(table, x, y, z, out):
    """Value of `open_irradiance` for a normal in the frame of the map.

    Linear in triangles whose sides lie where the projection has its creases: both axes, and |u| + |v| = 1.
    """
    u, v = unfolded(x, y, z)
    half = 0.5 * (len(table) - 1)
    column, row = (u + 1.0) * half, (v + 1.0) * half
    c, r = min(int(column), len(table) - 2), min(int(row), len(table) - 2)
    fc, fr = column - c, row - r
    falling = (u < 0.0) == (v < 0.0)
    for i in range(3):
        a, b = table[r, c, i], table[r, c + 1, i]
        d, e = table[r + 1, c, i], table[r + 1, c + 1, i]
        if falling:
            near, far = a + fc * (b - a) + fr * (d - a), e + (1.0 - fc) * (d - e) + (1.0 - fr) * (b - e)
            out[i] = near if fc + fr < 1.0 else far
        else:
            right, left = a + fc * (b - a) + fr * (e - b), a + fr * (d - a) + fc * (e - d)
            out[i] = right if fc > fr else left
