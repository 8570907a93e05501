"""Clutter: spheres, tori, capsules and boxes scattered over a ground slab.

Provenance: written for silint after the usual test scene for visibility from everywhere (many closed convex
and non-convex solids, near and far, that may interpenetrate). No data file.
"""

from __future__ import annotations

import numpy as np

from scenes.mesh import Mesh, boxes, concatenate, copies, random_rotations
from scenes.polyhedra import box, capsule, icosphere, torus


def clutter(groups: int, level: int, seed: int = 0) -> Mesh:
    """`groups` each of four solids over a ground slab whose top is z = 0; closed, interpenetrating.

    Tessellation `level` doubles the resolution of the curved ones: ``groups * (48 * 4**level + 12) + 12``
    triangles.
    """
    solids = (
        icosphere(level),
        torus(major_slices=4 * 2**level, minor_slices=5 * 2**level // 2),
        capsule(slices=2 * 2**level, rings=2 * 2**level),
        box((1.4, 1.4, 1.4)),
    )
    rng = np.random.default_rng(seed)
    reach = np.sqrt(4.0 * groups)  # constant density: about one object per 6.8 square units
    parts = []
    for solid in solids:
        scale = 0.4 + 0.6 * rng.random(groups)
        corner, size = (-1.3 * reach, -1.3 * reach, 0.5), (2.6 * reach, 2.6 * reach, 1.2)
        place = corner + rng.random((groups, 3)) * size
        parts.append(copies(solid, random_rotations(rng, groups) * scale[:, None, None], place))
    ground = boxes((-2.0 * reach, -2.0 * reach, -0.2), (2.0 * reach, 2.0 * reach, 0.0))
    return concatenate([*parts, ground])
