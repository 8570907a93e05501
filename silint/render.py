"""A picture of a baked mesh: enough to see at a glance whether a bake is right.

A z-buffer with smooth interpolation, four samples a pixel, no textures and no shadows other than those
that were baked: what looks like light in the picture is the ambient occlusion.
"""

from __future__ import annotations

import io
import os
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from silint.io import check_output, write_bytes
from silint.validation import InputError, mesh_arrays, normals_array, positive_int, unit_vector

__all__ = ["Camera", "automatic_camera", "render"]

FloatArray = npt.NDArray[np.float64]

# Samples along each axis of a pixel.
_SUPERSAMPLING = 2

# Vertical field of view in degrees: long enough a lens that nothing near the border is stretched.
_FIELD_OF_VIEW = 28.0

# The default three-quarter view: degrees from +x towards +y, and above the horizon (z up).
_AZIMUTH, _ELEVATION = -60.0, 27.0

# The share of the picture's width or height that the mesh fills.
_FILL = 0.9

# Display-referred colours of the background, top and bottom, and the tints of sky and ground light.
_BACKGROUND_TOP = np.array([0.30, 0.35, 0.41])
_BACKGROUND_BOTTOM = np.array([0.62, 0.66, 0.69])
_ALBEDO = np.array([1.0, 0.965, 0.91])
_SKY_TINT = np.array([0.97, 0.99, 1.03])
_GROUND_TINT = np.array([1.02, 0.99, 0.95])


class Camera(NamedTuple):
    """A pinhole camera; right-handed, looking along `forward`."""

    position: FloatArray
    """(3,)"""
    right: FloatArray
    """(3,) unit"""
    up: FloatArray
    """(3,) unit"""
    forward: FloatArray
    """(3,) unit"""
    half_height: float
    """Tangent of half the vertical field of view."""


def automatic_camera(
    vertices: FloatArray,
    aspect: float,
    up: npt.ArrayLike = (0.0, 0.0, 1.0),
    azimuth: float = _AZIMUTH,
    elevation: float = _ELEVATION,
) -> Camera:
    """A camera that sees all of a mesh from three quarters, as large as the picture allows.

    Parameters
    ----------
    vertices : ndarray, shape (V, 3)
        What has to be in the picture.
    aspect : float
        Width over height of the picture.
    up : array_like, shape (3,)
        What is up in the picture.
    azimuth, elevation : float
        In degrees: where the camera stands, about `up` and above the horizon.

    Returns
    -------
    Camera
    """
    z = unit_vector(up, "up")
    # Any axis that is not close to `up` will do to start the azimuth from; x for z up, as maps have it.
    start = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = start - z * (start @ z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    forward = -(np.cos(e) * (np.cos(a) * x + np.sin(a) * y) + np.sin(e) * z)
    right = np.cross(forward, z)
    right /= np.linalg.norm(right)
    above = np.cross(right, forward)

    # Each vertex bounds how near the camera may stand: sideways |s - s0| <= t (d + depth), a pair of lines
    # in (s0, d), and the tightest cone has its apex where the highest and the lowest of them meet.
    half_height = float(np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2.0))
    slopes = (_FILL * half_height * aspect, _FILL * half_height)
    depth = vertices @ forward
    centre, distance = np.zeros(2), np.zeros(2)
    for i, (axis, slope) in enumerate(zip((right, above), slopes, strict=True)):
        s = vertices @ axis
        high, low = (s - slope * depth).max(), (s + slope * depth).min()
        centre[i] = 0.5 * (high + low)
        distance[i] = 0.5 * (high - low) / slope
    position = centre[0] * right + centre[1] * above - distance.max() * forward
    if distance.max() <= -depth.min():  # a single point: stand anywhere in front of it
        position = position - forward * max(1.0, float(np.abs(vertices).max()))
    return Camera(position, right, above, forward, half_height)


def render(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    colors: npt.ArrayLike,
    path: str | os.PathLike[str],
    width: int = 960,
    height: int = 720,
    up: npt.ArrayLike = (0.0, 0.0, 1.0),
    azimuth: float = _AZIMUTH,
    elevation: float = _ELEVATION,
    normals: npt.ArrayLike | None = None,
    shaded: bool = True,
) -> None:
    """Draw a mesh with a colour at each vertex or face into a .png file.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
    faces : array_like of int, shape (F, 3)
    colors : array_like, shape (V,), (V, 3), (F,) or (F, 3)
        Linear, 0 to 1: a grey value such as ambient occlusion, or Rec. 709 primaries. A row for each vertex
        is interpolated; with as many faces as vertices, rows belong to the vertices.
    path : str or path-like
        A .png file; written whole or not at all.
    width, height : int
        In pixels.
    up : array_like, shape (3,)
        What is up in the picture.
    azimuth, elevation : float
        In degrees: where the camera stands.
    normals : array_like, shape (V, 3), optional
        Round off the shading, and are not zero; without them faces look flat.
    shaded : bool
        With a soft light of the picture's own; without, the colours are the picture's radiance as they are.

    Raises
    ------
    InputError
        The mesh, the colours, the size or the path is no good.
    """
    target = check_output(path, (".png",))
    positions, triangles, _ = mesh_arrays(vertices, faces)
    columns = positive_int(width, "width", maximum=16384) * _SUPERSAMPLING
    rows = positive_int(height, "height", maximum=16384) * _SUPERSAMPLING
    corner_colors = _corner_colors(colors, len(positions), triangles)
    smooth = None if normals is None else normals_array(normals, len(positions))[triangles]

    # A camera stands where the mesh is: coordinates about its middle, in its own size, lose nothing.
    used = positions[triangles]
    middle = 0.5 * (used.min(axis=(0, 1)) + used.max(axis=(0, 1)))
    size = float(np.abs(used - middle).max()) or 1.0
    corners = (used - middle) / size
    camera = automatic_camera(corners.reshape(-1, 3), columns / rows, up, azimuth, elevation)

    image = _background(rows, columns)
    screen = _projected(corners, camera, rows, columns)
    axis = unit_vector(up, "up")
    if shaded:
        corner_colors = corner_colors * _shading(corners, smooth, camera, axis)
    _rasterise(screen, corner_colors, np.full((rows, columns), np.inf), image)
    write_bytes(target, _png(image))


def _corner_colors(colors: npt.ArrayLike, n_vertices: int, faces: npt.NDArray[np.int32]) -> FloatArray:
    """(F, 3, 3) from a row for each vertex or face."""
    array = np.asarray(colors, dtype=np.float64)
    if array.ndim == 1:
        array = np.repeat(array[:, None], 3, axis=1)
    if array.ndim != 2 or array.shape[1] != 3 or array.shape[0] not in (n_vertices, len(faces)):
        raise InputError(
            f"colors has shape {np.shape(colors)}; expected a grey value or three for each of "
            f"{n_vertices} vertices or {len(faces)} faces"
        )
    array = np.clip(np.nan_to_num(array), 0.0, None)
    if array.shape[0] == n_vertices:
        return np.ascontiguousarray(array[faces])
    return np.ascontiguousarray(np.repeat(array[:, None, :], 3, axis=1))


def _projected(corners: FloatArray, camera: Camera, rows: int, columns: int) -> FloatArray:
    """(F, 3, 3): column, row and inverse depth, which is linear on the screen."""
    offset = corners - camera.position
    # The camera stands clear of everything (`automatic_camera`), so nothing needs clipping.
    inverse_depth = 1.0 / (offset @ camera.forward)
    scale = 0.5 * rows / camera.half_height
    out = np.empty_like(corners)
    out[..., 0] = 0.5 * columns + scale * (offset @ camera.right) * inverse_depth
    out[..., 1] = 0.5 * rows - scale * (offset @ camera.up) * inverse_depth
    out[..., 2] = inverse_depth
    return out


def _shading(corners: FloatArray, smooth: FloatArray | None, camera: Camera, up: FloatArray) -> FloatArray:
    """(F, 3, 3): a soft light from the upper left, so that planes of one openness still tell apart.

    Both sides of a face are lit as the one that the camera sees.
    """
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0)
    towards = camera.position - corners[:, 0]
    front = np.where((normals * towards).sum(axis=1) < 0.0, -1.0, 1.0)
    normals = np.repeat(normals[:, None, :], 3, axis=1) if smooth is None else smooth
    normals = normals * front[:, None, None]
    light = -0.6 * camera.right + 0.8 * up - 0.5 * camera.forward
    light /= np.linalg.norm(light)
    wrapped = 0.5 + 0.5 * (normals @ light)
    height = (0.5 + 0.5 * (normals @ up))[..., None]
    tint = height * _SKY_TINT + (1.0 - height) * _GROUND_TINT
    shading: FloatArray = _ALBEDO * (0.55 + 0.45 * wrapped)[..., None] * tint
    return shading


def _background(rows: int, columns: int) -> FloatArray:
    """(rows, columns, 3), linear: a soft vertical gradient."""
    t = (np.linspace(0.0, 1.0, rows) ** 1.2)[:, None, None]
    display = (1.0 - t) * _BACKGROUND_TOP + t * _BACKGROUND_BOTTOM
    return np.ascontiguousarray(np.broadcast_to(_to_linear(display), (rows, columns, 3)))


@njit(cache=True, error_model="numpy")
def _rasterise(screen, colors, depth, image):  # type: ignore[no-untyped-def]
    """Paint all triangles, nearest in front; colours are interpolated with perspective."""
    rows, columns = depth.shape
    for f in range(screen.shape[0]):
        x0, y0, w0 = screen[f, 0]
        x1, y1, w1 = screen[f, 1]
        x2, y2, w2 = screen[f, 2]
        area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        if area == 0.0:
            continue
        left, right = max(0, int(np.ceil(min(x0, x1, x2) - 0.5))), min(columns - 1, int(max(x0, x1, x2)))
        top, bottom = max(0, int(np.ceil(min(y0, y1, y2) - 0.5))), min(rows - 1, int(max(y0, y1, y2)))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                b0 = ((x1 - x) * (y2 - y) - (y1 - y) * (x2 - x)) / area
                b1 = ((x2 - x) * (y0 - y) - (y2 - y) * (x0 - x)) / area
                b2 = 1.0 - b0 - b1
                # A sample on a shared edge may be painted twice, never left out.
                if b0 < -1e-12 or b1 < -1e-12 or b2 < -1e-12:
                    continue
                w = b0 * w0 + b1 * w1 + b2 * w2
                if 1.0 / w < depth[row, column]:
                    depth[row, column] = 1.0 / w
                    for c in range(3):
                        value = (
                            b0 * w0 * colors[f, 0, c] + b1 * w1 * colors[f, 1, c] + b2 * w2 * colors[f, 2, c]
                        )
                        image[row, column, c] = value / w


def _png(image: FloatArray) -> bytes:
    from matplotlib.image import imsave

    n = _SUPERSAMPLING
    # Averaged in linear light, then encoded: the other way round darkens edges.
    pixels = image.reshape(image.shape[0] // n, n, image.shape[1] // n, n, 3).mean(axis=(1, 3))
    buffer = io.BytesIO()
    imsave(buffer, np.rint(255.0 * _to_display(pixels)).astype(np.uint8), format="png")
    return buffer.getvalue()


def _to_display(linear: FloatArray) -> FloatArray:
    """The sRGB curve [IEC 61966-2-1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055)


def _to_linear(display: FloatArray) -> FloatArray:
    linear: FloatArray = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    return linear
