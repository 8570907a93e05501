"""A shade point for each pixel of a picture, and pictures back from values at those points.

One point a pixel, where the ray through its middle first meets the scene: noise and bands stand in the
picture as they are. Only edges are smoothed: a pixel whose neighbours differ from it takes 4 x 4 more rays.
Each shows the value of that pixel, among it and its eight neighbours, whose point is nearest to where it hit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

import silint
from silint.reference import embree_points
from silint.render import Camera

Array = np.ndarray[Any, np.dtype[Any]]

SUBPIXELS = 4  # along each axis, of a pixel at an edge
CREASE = np.cos(np.deg2rad(50.0))  # faces that meet at a sharper angle are not smoothed into each other
WHITE = 1.0
# A neighbour further off the tangent plane than so many pixels, or with a normal that turns by more, is
# another surface.
STEP, TURN = 1.5, np.cos(np.deg2rad(18.0))


@dataclass(frozen=True)
class Pixels:
    """What a camera sees of a scene; n pixels show it, the others the background."""

    shape: tuple[int, int]  # rows, columns
    where: Array  # (n,) numbers of the pixels, row by row
    points: Array  # (n, 3), as far off the faces as Embree needs
    normals: Array  # (n, 3) unit, towards the camera
    smooth: Array  # (rows, columns), whether a pixel and its neighbours show one smooth surface
    owners: Array  # (m,) rows of `points`: whose value each of the samples shows
    tones: Array  # (m,) what it is multiplied by
    veils: Array  # (m,) the share of white over it
    shares: Array  # (m,) of its pixel
    pixels: Array  # (m,) its pixel

    def map(self, values: Array, empty: float = np.nan) -> Array:
        """(n,) to (rows, columns)."""
        image = np.full(self.shape[0] * self.shape[1], empty)
        image[self.where] = values
        return image.reshape(self.shape)

    def picture(self, values: Array) -> Array:
        """(rows, columns), linear grey, from occlusion (n,): soft light times occlusion over white."""
        radiance = (1.0 - self.veils) * self.tones * values[self.owners] + self.veils * WHITE
        shown = np.bincount(self.pixels, self.shares * (radiance - WHITE), minlength=np.prod(self.shape))
        picture: Array = (WHITE + shown).reshape(self.shape)
        return picture


class Stage:
    """A scene before a camera: Embree finds what a pixel shows, the rest is looked up.

    Parameters
    ----------
    scene : silint.Scene
    floor : int
        How many of the last faces are a floor: white, and fading out.
    fade : (float, float)
        Distances from `middle` between which the floor fades.
    middle : ndarray, shape (3,)
    """

    def __init__(
        self, scene: silint.Scene, floor: int = 0, fade: tuple[float, float] = (0, 1), middle: Any = 0.0
    ) -> None:
        from embreex import mesh_construction, rtcore_scene

        self.scene, self.fade, self.middle = scene, fade, middle
        self.first_of_floor = scene.n_faces - floor
        self.face_normals = unit(
            np.cross(*(scene.vertices[scene.faces[:, i]] - scene.vertices[scene.faces[:, 0]] for i in (1, 2)))
        )
        self.corner_normals = creased_normals(scene, self.face_normals)
        self._embree = rtcore_scene.EmbreeScene(robust=True)
        mesh_construction.TriangleMesh(self._embree, scene.vertices.astype(np.float32), scene.faces)

    def seen(self, camera: Camera, rows: int, columns: int) -> Pixels:
        """A point for each pixel, and the samples that its picture is made of."""
        y, x = (grid.ravel() for grid in np.mgrid[0:rows, 0:columns])
        face, point, normal, tone, veil = self._hit(camera, rows, columns, x + 0.5, y + 0.5)
        kept = (face >= 0) & (veil < 1.0)  # a floor that is all white needs no value
        number = np.where(kept, np.cumsum(kept) - 1, -1)
        pixel = 2.0 * camera.half_height / rows * np.linalg.norm(point - camera.position, axis=1)
        smooth = self._smooth((rows, columns), face >= 0, point, normal, pixel)

        # Samples: of a smooth pixel itself, of others 4 x 4.
        flat = smooth.ravel()
        edge = np.flatnonzero(~flat & neighbours(kept.reshape(rows, columns)).any(axis=0).ravel())
        steps = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS
        dx, dy = (grid.ravel() for grid in np.meshgrid(steps, steps))
        sub_x = (x[edge, None] + dx).ravel()
        sub_y = (y[edge, None] + dy).ravel()
        at = np.repeat(edge, SUBPIXELS**2)
        sub_face, sub_point, sub_normal, sub_tone, sub_veil = self._hit(camera, rows, columns, sub_x, sub_y)
        best, owner = np.full(len(at), np.inf), np.full(len(at), -1)
        for j in (-1, 0, 1):
            for i in (-1, 0, 1):
                near = np.clip(y[at] + j, 0, rows - 1) * columns + np.clip(x[at] + i, 0, columns - 1)
                apart = np.linalg.norm(point[near] - sub_point, axis=1) / pixel[at]
                apart += 4.0 * (1.0 - (normal[near] * sub_normal).sum(axis=1))
                apart[~kept[near]] = np.inf
                closer = apart < best
                best[closer], owner[closer] = apart[closer], number[near[closer]]
        drawn = (sub_face >= 0) & (owner >= 0)
        whole = np.flatnonzero(flat & kept)
        n_whole, n_part = len(whole), int(drawn.sum())
        # Points stand off by a share of their face's edges; the floor's, as those of the asset's.
        sized = np.where(face < self.first_of_floor, face, 0)[kept]
        return Pixels(
            (rows, columns),
            np.flatnonzero(kept),
            embree_points(self.scene.vertices, self.scene.faces, point[kept], normal[kept], sized),
            normal[kept],
            smooth & kept.reshape(rows, columns),
            np.concatenate([number[whole], owner[drawn]]),
            np.concatenate([tone[whole], sub_tone[drawn]]),
            np.concatenate([veil[whole], sub_veil[drawn]]),
            np.concatenate([np.ones(n_whole), np.full(n_part, SUBPIXELS**-2.0)]),
            np.concatenate([whole, at[drawn]]),
        )

    def _hit(
        self, camera: Camera, rows: int, columns: int, x: Array, y: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Face (-1: none), point, normal, tone and veil of the rays through (x, y), in pixels."""
        scale = 2.0 * camera.half_height / rows
        rays = (
            camera.forward
            + (scale * (x - 0.5 * columns))[:, None] * camera.right
            + (scale * (0.5 * rows - y))[:, None] * camera.up
        )
        origins = np.tile(camera.position.astype(np.float32), (len(rays), 1))
        met = self._embree.run(origins, np.ascontiguousarray(rays, np.float32), output=1)
        face, u, v = met["primID"].astype(np.int64), met["u"].astype(np.float64), met["v"].astype(np.float64)
        weights = np.stack([1.0 - u - v, u, v], axis=1)[:, :, None]
        point = (weights * self.scene.vertices[self.scene.faces[face]]).sum(axis=1)
        normal = unit((weights * self.corner_normals[face]).sum(axis=1))
        flat = self.face_normals[face]
        flat = np.where((flat * rays).sum(axis=1, keepdims=True) > 0.0, -flat, flat)
        normal = np.where((normal * flat).sum(axis=1, keepdims=True) < 0.0, -normal, normal)
        normal[~normal.any(axis=1)] = camera.up
        light = unit(-0.5 * camera.right + 0.75 * camera.up - 0.6 * camera.forward)
        tone = 0.60 + 0.22 * (normal @ light)
        floor = face >= self.first_of_floor
        tone[floor] = WHITE
        low, high = self.fade
        t = np.clip((np.linalg.norm(point - self.middle, axis=1) - low) / (high - low), 0.0, 1.0)
        veil = np.where(floor, t * t * (3.0 - 2.0 * t), 0.0)
        return face, point, normal, tone, veil

    @staticmethod
    def _smooth(shape: tuple[int, int], hit: Array, point: Array, normal: Array, pixel: Array) -> Array:
        """Whether a pixel and its four neighbours show one surface, or all of them none."""
        smooth = np.ones(shape, bool)
        p, n, here, size = (a.reshape(*shape, -1) for a in (point, normal, hit, pixel))
        for axis in (0, 1):
            a, b = np.arange(shape[axis] - 1), np.arange(1, shape[axis])
            pa, pb, na, nb, ha, hb = (f.take(k, axis) for f in (p, n, here) for k in (a, b))
            off = np.abs(((pb - pa) * na).sum(axis=-1)) / size.take(a, axis)[..., 0]
            same = (ha & hb)[..., 0] & ((na * nb).sum(axis=-1) > TURN) & (off < STEP)
            same |= ~(ha | hb)[..., 0]
            for k in (a, b):
                smooth[(k, slice(None)) if axis == 0 else (slice(None), k)] &= same
        return smooth


def creased_normals(scene: silint.Scene, face_normals: Array) -> Array:
    """(F, 3, 3): angle-weighted mean normals of the faces at a corner that no crease parts from its own."""
    corners = scene.vertices[scene.faces]
    ahead, behind = (unit(np.roll(corners, -s, axis=1) - corners) for s in (1, 2))
    angle = np.arccos(np.clip((ahead * behind).sum(axis=2), -1.0, 1.0)).ravel()
    vertex = scene.welding.vertex_map[scene.faces].ravel()
    n = len(vertex)
    at = sparse.csr_array((np.ones(n), (np.arange(n), vertex)))
    i, j = (at @ at.T).nonzero()
    own, other = face_normals[i // 3], face_normals[j // 3]
    cosine = (own * other).sum(axis=1)
    # Faces that are wound the other way are turned.
    weight = np.where(np.abs(cosine) > CREASE, np.sign(cosine) * angle[j], 0.0)
    total = np.stack([np.bincount(i, weight * other[:, k], minlength=n) for k in range(3)], axis=1)
    return unit(total).reshape(-1, 3, 3)


def neighbours(mask: Array) -> Array:
    """(9, rows, columns): a mask moved by a pixel in all directions, and itself."""
    padded = np.pad(mask, 1)
    rows, columns = mask.shape
    return np.stack([padded[j : j + rows, i : i + columns] for j in range(3) for i in range(3)])


def unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def display(linear: Array) -> Array:
    """The sRGB curve [IEC 61966-2-1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055)


def look_at(eye: Any, target: Any, up: Any, field_of_view: float) -> Camera:
    eye, target, up = (np.asarray(a, np.float64) for a in (eye, target, up))
    forward = unit(target - eye)
    right = unit(np.cross(forward, up))
    return Camera(
        eye, right, np.cross(right, forward), forward, float(np.tan(np.deg2rad(field_of_view) / 2.0))
    )
