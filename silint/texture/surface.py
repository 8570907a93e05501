"""A mesh laid out in a texture: coordinates that are fit for a bake, and a shade point for every texel."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.io.uvs import read_uvs
from silint.scene import Scene
from silint.texture.charts import Charts, charts_of, in_unit_square
from silint.texture.files import Corners
from silint.texture.shading import Tangents, corner_normals, corner_tangents, face_normals, frames
from silint.texture.slits import cut_at_slits
from silint.texture.texels import Texels, across_seams, find_texels
from silint.texture.unwrap import repack, unwrap
from silint.validation import InputError

__all__ = ["Layout", "Surface", "in_tangent_space", "shade_points", "surface_of", "tangents_of"]

FloatArray = npt.NDArray[np.float64]

# Shares above which texture coordinates are not fit for a bake: of texels that belong to several faces, and
# of the surface that has no area in the texture.
_MOST_OVERLAP = 0.01
_MOST_WITHOUT_AREA = 0.01

# How often unwrapped charts are cut where they come too close to themselves: packed anew, they fall on other
# texels, and a slit that was just wide enough may no longer be.
_CUTS = 4

# How far, as the sine of an angle, a shading normal stays above its face.
_ABOVE = 2.0**-8


class Layout(NamedTuple):
    """What is asked of a surface."""

    size: int
    """Texels a side."""
    samples: int = 1
    """Positions in a texel that holds an edge."""
    chosen: npt.NDArray[np.bool_] | slice = slice(None)
    """Faces that are baked."""
    normals: str = "auto"
    """As in `silint.bake.BakeOptions`; "auto": the file's, or smooth ones up to `shading.CREASE`."""


class Surface(NamedTuple):
    """A mesh with its texture coordinates, by the corners of its faces."""

    corners: Corners
    flat: FloatArray
    """(F, 3) unit normals of the faces."""
    front: FloatArray
    """(F, 3) the same, on the side of the shading normals."""
    charts: Charts
    texels: Texels
    welded: npt.NDArray[np.int64]
    """(F, 3) corners' vertices, one number a position."""
    uv_source: str
    uv_reason: str
    """Why the file's own coordinates were not taken, or nothing."""
    normals_from: str
    """``file``, ``smooth``, ``creased`` or ``flat``."""
    without_area: int
    """Faces without an area in space or in the texture."""
    shifted: int
    """Faces whose coordinates were moved by whole squares."""
    clamped: int
    """Corners whose coordinates lay beyond the square, by half a texel at most."""


def surface_of(scene: Scene, path: Path, uv: str, layout: Layout) -> Surface:
    """The mesh on texture coordinates that are fit for a bake, and the texels of the chosen faces."""
    if layout.normals == "file" and not scene.own_normals.any():
        raise InputError(f"{path}: has no normals of its own, which normals='file' asks for; try 'smooth'")
    reason = ""
    if uv != "unwrap":
        uvs = read_uvs(path, scene.n_faces)
        try:
            if uvs is None:
                raise InputError("the file has no texture coordinates")
            return _laid_out(scene, uvs, layout, "file", "")
        except InputError as error:
            if uv == "file":
                raise InputError(f"{path}: {error}; use uv='unwrap'") from None
            reason = str(error)
    try:
        return _unwrapped(scene, layout, reason)
    except InputError as error:
        raise InputError(f"{path}: {f'{reason}, and ' if reason else ''}{error}") from None


def _unwrapped(scene: Scene, layout: Layout, reason: str) -> Surface:
    """The mesh on coordinates by xatlas, whose charts are cut at slits."""
    welded = scene.welding.vertex_map[scene.faces].astype(np.int64)
    uvs = unwrap(scene.vertices[scene.first_vertices], welded, layout.size)
    surface = _laid_out(scene, uvs, layout, "unwrapped", reason)
    for _ in range(_CUTS):
        charts, uvs = surface.charts, surface.corners.uvs
        pieces = cut_at_slits(charts, surface.texels.rivals, uvs)
        if pieces.max() < charts.n_charts:
            break
        again = _laid_out(scene, repack(uvs, pieces, layout.size), layout, "unwrapped", reason)
        if again.texels.shared >= surface.texels.shared:
            break
        surface = again
    return surface


def _laid_out(
    scene: Scene,
    uvs: FloatArray,
    layout: Layout,
    source: str,
    reason: str,
) -> Surface:
    size = layout.size
    wanted = np.zeros(scene.n_faces, bool)
    wanted[layout.chosen] = True
    faces = scene.faces.astype(np.int64)
    welded = scene.welding.vertex_map[scene.faces].astype(np.int64)
    square = in_unit_square(uvs[wanted], welded[wanted], size)
    uvs = uvs.copy()
    uvs[wanted] = square.uvs
    positions = scene.vertices[faces]
    flat = face_normals(positions)
    normals, normals_from = _normals(scene, positions, welded, flat, layout.normals)

    d1, d2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    in_texture = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0] != 0.0
    in_space = flat.any(axis=1)
    e = np.ldexp(positions[:, 1:] - positions[:, :1], -scene.welding.exponent)
    area = np.linalg.norm(np.cross(e[:, 0], e[:, 1]), axis=1)
    lost = float(area[wanted & ~in_texture].sum() / area[wanted].sum()) if area[wanted].any() else 0.0
    if source == "file" and lost > _MOST_WITHOUT_AREA:
        raise InputError(f"its texture coordinates have no area for {100.0 * lost:.3g} % of the surface")
    charts = charts_of(uvs, welded, normals, flat, wanted & in_texture & in_space)

    texels = find_texels(uvs, positions, charts, flat, size, layout.samples)
    texels = across_seams(texels, charts, positions, uvs, size)
    if texels.overlapping > _MOST_OVERLAP * texels.inside:
        share = 100.0 * texels.overlapping / texels.inside
        moved = ", once all charts are moved into [0, 1]" if square.shifted else ""
        raise InputError(f"{share:.3g} % of the texels in its charts belong to two or more faces{moved}")
    towards = (normals.sum(axis=1) * flat).sum(axis=1) < 0.0
    return Surface(
        Corners(positions, faces, normals, uvs),
        flat,
        np.where(towards[:, None], -flat, flat),
        charts,
        texels,
        welded,
        source,
        reason,
        normals_from,
        int((wanted & ~(in_texture & in_space)).sum()),
        square.shifted,
        square.clamped,
    )


def _normals(
    scene: Scene, positions: FloatArray, welded: npt.NDArray[np.int64], flat: FloatArray, asked: str
) -> tuple[FloatArray, str]:
    """Shading normals (F, 3, 3), and where they come from."""
    if asked == "flat":
        return np.repeat(flat[:, None], 3, axis=1), "flat"
    if asked == "smooth":
        return corner_normals(positions, welded, flat, None, crease=180.0), "smooth"
    own = None if scene.normals is None else scene.normals[scene.faces]
    return corner_normals(positions, welded, flat, own), "creased" if own is None else "file"


def tangents_of(surface: Surface) -> Tangents:
    """Tangents of the corners of all faces."""
    c = surface.corners
    return corner_tangents(c.positions, c.uvs, surface.welded, c.normals)


def shade_points(
    surface: Surface, tangents: Tangents | None, bumps: FloatArray | None
) -> tuple[FloatArray, FloatArray, int]:
    """Points and unit shading normals of all samples, and how many normals had to be turned to the front."""
    face, w = surface.texels.sample_face, surface.texels.sample_weights
    corners = surface.corners
    points = _interpolated(w, corners.positions[face])
    normals = _interpolated(w, corners.normals[face])
    front = surface.front[face]
    if bumps is not None and tangents is not None:
        frame = frames(normals, _interpolated(w, tangents.tangent[face]), tangents.sign[face])
        local = _looked_up(bumps, _interpolated(w, corners.uvs[face]))
        normals = _interpolated(local, frame)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Normals that cancel, and a black normal map.
    normals = np.where(length > 1e-9, normals / np.maximum(length, 1e-9), front)
    rise = (normals * front).sum(axis=1)
    below = rise < _ABOVE
    normals[below] += (_ABOVE - rise[below])[:, None] * front[below]
    return points, normals, int(below.sum())


def in_tangent_space(surface: Surface, tangents: Tangents, values: FloatArray, green: str) -> FloatArray:
    """World-space directions (T, 3) in the frames of their texels."""
    texels = surface.texels
    w, face = texels.weights, texels.face
    normals = _interpolated(w, surface.corners.normals[face])
    frame = frames(normals, _interpolated(w, tangents.tangent[face]), tangents.sign[face])
    local = _interpolated(values, frame.transpose(0, 2, 1))
    return local * (1.0, -1.0, 1.0) if green == "down" else local


def _interpolated(weights: FloatArray, rows: FloatArray) -> FloatArray:
    """(m, d) sums of rows (m, 3, d) with weights (m, 3)."""
    total: FloatArray = np.einsum("mi,mid->md", weights, rows)
    return total


def _looked_up(image: FloatArray, uv: FloatArray) -> FloatArray:
    """Bilinear lookups (n, 3) that end at the image's edges."""
    height, width = image.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0.0, height - 1.0)
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    upper = (1.0 - fx) * image[row, column] + fx * image[row, right]
    lower = (1.0 - fx) * image[below, column] + fx * image[below, right]
    return np.asarray((1.0 - fy) * upper + fy * lower)
