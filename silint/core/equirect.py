"""Equirectangular maps: texels, their exact solid angles and first moments, and sums over them.

A map has H rows and 2 H columns; conventions.py says where they lie. A texel is a rectangle of the angles
(theta, phi), so that its solid angle and the integral of w over it have closed forms:

    int dw   = 2 sin(theta) sin(h/2) d
    int x dw = A 2 sin(d/2) cos(phi),   int z dw = A 2 sin(d/2) sin(phi),   A = h/2 - cos(2 theta) sin(h)/2
    int y dw = B d,                     B = sin(theta) cos(theta) sin(h)

with (theta, phi) its centre, h its height and d its width in radians. What lies above a horizon of one that
straddles it is in core.texel_clip.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numba import njit, prange

from silint.core.jit import KERNEL, PARALLEL
from silint.core.texel_clip import lit_part

# So that a band of rows takes a fraction of a second, and can be interrupted.
_NORMALS_AT_ONCE = 1024


@njit(**KERNEL)
def row_moments(theta, h):
    """A and B of the module's docstring: int sin^2 and int sin cos over a height h about theta."""
    s, c = np.sin(theta), np.cos(theta)
    return 0.5 * h - 0.5 * (c * c - s * s) * np.sin(h), s * c * np.sin(h)


def solid_angles(height: int) -> np.ndarray:
    """Solid angle of a texel of each row: (H,), in steradians; the texels of a map sum to 4 pi."""
    theta = np.pi * (np.arange(height) + 0.5) / height
    return 2.0 * np.sin(theta) * np.sin(0.5 * np.pi / height) * (np.pi / height)


def texel_centres(height: int, first: int, last: int) -> np.ndarray:
    """Directions of the centres of rows first..last-1 of a map: (last - first, 2 H, 3)."""
    theta = (np.pi * (np.arange(first, last) + 0.5) / height)[:, None]
    phi = np.pi * ((np.arange(2 * height) + 0.5) / height - 1.0)
    centres = np.empty((last - first, 2 * height, 3))
    centres[..., 0] = np.sin(theta) * np.cos(phi)
    centres[..., 1] = np.cos(theta)
    centres[..., 2] = np.sin(theta) * np.sin(phi)
    return centres


def texel_of(directions: np.ndarray, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the texels that directions (m, 3) of any length lie in."""
    x, y, z = directions.T
    row = np.arctan2(np.hypot(x, z), y) * (height / np.pi)
    column = (0.5 + np.arctan2(z, x) / (2.0 * np.pi)) * (2 * height)
    return np.minimum(row.astype(np.int64), height - 1), column.astype(np.int64) % (2 * height)


def irradiance(radiance: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """int L max(n.w, 0) dw without occluders.

    Parameters
    ----------
    radiance : (H, 2 H, C) float
    normals : (n, 3) float64
        Unit, in the frame of the map.

    Returns
    -------
    (n, C) float64
        Exact to rounding: texels that straddle the horizon are clipped by it.
    """
    height = len(radiance)
    out = np.zeros((len(normals), radiance.shape[2]))
    for first, band in bands(radiance):
        for i in range(0, len(normals), _NORMALS_AT_ONCE):
            piece = slice(i, i + _NORMALS_AT_ONCE)
            _add_irradiance(band, first, height, normals[piece], out[piece])
    return out


def bands(radiance: np.ndarray, texels: int = 1 << 16) -> Iterator[tuple[int, np.ndarray]]:
    """First row and radiance, as a copy in float64, of bands of rows with about so many texels each."""
    step = max(1, texels // radiance.shape[1])
    for first in range(0, len(radiance), step):
        yield first, np.array(radiance[first : first + step], dtype=np.float64, order="C")


@njit(**PARALLEL)
def _add_irradiance(band, first_row, height, normals, out):
    """Add the irradiance from rows of a map to out (n, C)."""
    n_rows, width, n_channels = band.shape
    h = np.pi / height
    phi = np.pi * ((np.arange(width) + 0.5) / height - 1.0)
    cos_phi, sin_phi = np.cos(phi), np.sin(phi)
    chord = 2.0 * np.sin(0.5 * h)
    for i in prange(len(normals)):
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        row_sum = np.empty(n_channels)
        for r in range(n_rows):
            theta = np.pi * (first_row + r + 0.5) / height
            a, b = row_moments(theta, h)
            # A texel's diagonal, as a height above the horizon, times its solid angle: where the mean height
            # is beyond it, all of the texel is on one side.
            margin = np.sqrt(2.0) * h * 2.0 * np.sin(theta) * np.sin(0.5 * h) * h
            row_sum[:] = 0.0
            for c in range(width):
                cosine = a * chord * (nx * cos_phi[c] + nz * sin_phi[c]) + b * h * ny
                if cosine < -margin:
                    continue
                if cosine < margin:
                    top, left = first_row + r, c - height
                    cosine = lit_part(top * h, (top + 1) * h, left * h, (left + 1) * h, nx, ny, nz)
                for channel in range(n_channels):
                    row_sum[channel] += band[r, c, channel] * cosine
            for channel in range(n_channels):
                out[i, channel] += row_sum[channel]
