"""Deterministic test and benchmark scenes; part of the checkout, not of the installed package.

    vertices, faces = scenes.build("clutter_31k")
    points, normals = scenes.shade_points(vertices, faces, 1000, seed=1)

``python -m scenes --list`` names them, ``python -m scenes NAME -o FOLDER`` writes them as binary PLY files.
Same release of a scene, same triangles: generators draw from fixed seeds, and the tests assert the exact
counts. Each module states where its idea and its data come from.
"""

from __future__ import annotations

from scenes.registry import SCENES, SceneSpec, build
from scenes.sampling import shade_points

__all__ = ["SCENES", "SceneSpec", "build", "shade_points"]
