"""Shade points for a mesh: uniform by area, with geometric normals.

Provenance: the textbook map of the unit square to a triangle, written for silint.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.mesh import Faces, Vertices


def shade_points(
    vertices: Vertices, faces: Faces, n: int, seed: int = 0, lift: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`n` points on the surface, uniform by area, with the unit normals of their faces.

    Parameters
    ----------
    vertices, faces : (V, 3) float64, (F, 3) int32
        The mesh. Zero-area faces get no points.
    n : int
        Number of points.
    seed : int
        Same seed, same points.
    lift : float
        Distance by which points are moved along their normals, in the mesh's unit of length.

    Returns
    -------
    points, normals : (n, 3) float64
    """
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    doubled_area = np.linalg.norm(normal, axis=1)
    cumulative = np.cumsum(doubled_area)
    # side="right" steps over faces that add nothing to the sum; u < 1 never reaches past the last.
    pick, s, t = rng.random((3, n))
    face = np.searchsorted(cumulative, pick * cumulative[-1], side="right")
    # Fold the unit square's upper half onto the lower one.
    over = s + t > 1.0
    s, t = np.where(over, 1.0 - s, s)[:, None], np.where(over, 1.0 - t, t)[:, None]
    points = a[face] + s * (b - a)[face] + t * (c - a)[face]
    normals = normal[face] / doubled_area[face, None]
    return points + lift * normals, normals
