"""Where the benchmark asks: points spread over a mesh's area, or its own vertices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

if TYPE_CHECKING:
    from silint.scene import Scene

__all__ = ["SITES", "area_samples", "shade_sites", "spread"]

FloatArray = npt.NDArray[np.float64]

SITES = ("surface", "vertices")

_GOLDEN = (5**0.5 - 1) / 2

# The first vertices, at which errors are measured, are checked to be off all faces.
_LOOKED_AT = 1024


def shade_sites(scene: Scene, sites: str, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """At most `n` points with their normals, displaced as far as Embree needs.

    Parameters
    ----------
    scene : Scene
    sites : {"surface", "vertices"}
        Uniform samples of the area, exactly `n`; or all vertices that have a normal, and where there are
        more than `n`, as many evenly out of the file's order. Of the first, which errors are measured at,
        those are left out whose normals do not lead off the faces about them.
    n : int
    rng : numpy.random.Generator
        Draws the surface samples.

    Returns
    -------
    points, normals : (m, 3)
        In an order in which the first few, however many, are spread over all of them.
    """
    from silint.reference import embree_points, on_surface

    if sites == "surface":
        points, normals, face_ids = area_samples(scene.vertices, scene.faces, n, rng)
        return embree_points(scene.vertices, scene.faces, points, normals, face_ids), normals
    normals, valid = scene.vertex_normals()
    rows = np.flatnonzero(valid)
    if not len(rows):
        raise InputError("no vertex has a normal; there is nowhere to put points")
    rows = rows[spread(len(rows))[:n]]
    normals = normals[rows]
    points = embree_points(scene.vertices, scene.faces, scene.vertices[rows], normals)
    clear = np.ones(len(points), bool)
    clear[:_LOOKED_AT] = ~on_surface(scene.vertices, scene.faces, points[:_LOOKED_AT])
    return points[clear], normals[clear]


def spread(n: int) -> npt.NDArray[np.intp]:
    """An order of 0..n-1 whose every beginning is spread evenly: neighbours keep one of three distances.

    (Rows whose multiples of the golden ratio have the smallest fractions; the three-gap theorem.)
    """
    return np.argsort(np.arange(n) * _GOLDEN % 1.0, kind="stable")


def area_samples(
    vertices: FloatArray, faces: npt.NDArray[np.int32], n: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Points uniform in area on the front of the faces, with their normals and faces."""
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    if not area.sum() > 0:
        raise InputError("no face has any area; there is nowhere to put points")
    face_ids = rng.choice(len(faces), size=n, p=area / area.sum())
    # Reflected at the diagonal, the unit square covers the triangle evenly.
    st = rng.random((n, 2))
    st = np.where(st.sum(axis=1, keepdims=True) > 1, 1 - st, st)
    a, b, c = (corners[face_ids, k] for k in range(3))
    points = a + st[:, :1] * (b - a) + st[:, 1:] * (c - a)
    return points, cross[face_ids] / area[face_ids, None], face_ids
