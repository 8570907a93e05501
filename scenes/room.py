"""A furnished room with a window: the interior scene.

Provenance: written for silint; everyday measures in metres. No data file but Newell's teapot on the table.
Legs stand on the floor, the shelf against a wall, books on their boards: coincident faces on purpose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scenes.mesh import Mesh, as_mesh, boxes, concatenate, copies, moved, revolve, turns_about_z
from scenes.polyhedra import icosphere
from scenes.teapot import teapot

Corners = tuple[tuple[float, ...], tuple[float, ...]]  # lower and upper, of a box


def shell(x: ArrayLike, y: ArrayLike, z: ArrayLike, solid: ArrayLike) -> Mesh:
    """Boundary surface of the `solid` cells of a rectilinear grid: conforming quads, closed, wound outwards.

    `x`, `y`, `z` are the grid's planes; `solid` is a boolean array with one value a cell. Walls with openings
    become one watertight surface without T-junctions.
    """
    planes = [np.asarray(p, dtype=np.float64) for p in (x, y, z)]
    cells = np.pad(np.asarray(solid, dtype=bool), 1)
    index = np.arange(np.prod([len(p) for p in planes])).reshape([len(p) for p in planes])
    faces = []
    for axis in range(3):
        across = np.moveaxis(cells, axis, 0)[:, 1:-1, 1:-1]
        corner = np.moveaxis(index, axis, 0)
        # Moving `axis` to the front is an even permutation for x and z, an odd one for y.
        quad = [corner[:, :-1, :-1], corner[:, 1:, :-1], corner[:, 1:, 1:], corner[:, :-1, 1:]]
        up = np.stack(quad if axis != 1 else quad[::-1], axis=-1)
        faces += [up[across[:-1] & ~across[1:]], up[across[1:] & ~across[:-1]][:, ::-1]]
    quads = np.concatenate(faces)
    used, corners = np.unique(quads, return_inverse=True)
    vertices = np.stack(np.meshgrid(*planes, indexing="ij"), axis=-1).reshape(-1, 3)[used]
    return as_mesh(vertices, corners.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]])


def room(seed: int = 0) -> Mesh:
    """Room of 5 x 4 x 2.6 m: table, four chairs, shelf with books, lamp, teapot; 6920 triangles.

    The floor is z = 0; walls are 0.2 m thick, and the one at x = 5 has a window.
    """
    x, y, z = (-0.2, 0.0, 5.0, 5.2), (-0.2, 0.0, 1.2, 2.8, 4.0, 4.2), (-0.2, 0.0, 0.9, 2.1, 2.6, 2.8)
    solid = np.ones((3, 5, 5), dtype=bool)
    solid[1, 1:4, 1:4] = False  # the air in the room
    solid[2, 2, 2] = False  # the window
    pot = moved(teapot(8), (2.0, 1.9, 0.75), 0.06)
    shade = revolve([(0.09, 2.0), (0.25, 1.75), (0.24, 1.75), (0.08, 2.0)], 32, closed=True)
    lamp = [moved(shade, (2.1, 2.0, 0.0)), moved(icosphere(2), (2.1, 2.0, 1.86), 0.05)]
    cord = boxes((2.095, 1.995, 1.9), (2.105, 2.005, 2.6))
    return concatenate([shell(x, y, z, solid), _table(), _chairs(), _shelf(seed), pot, *lamp, cord])


def _legs(width: float, depth: float, height: float, thick: float) -> list[Corners]:
    """Four square legs in the corners of a rectangle at the origin."""
    feet = [(a, b) for a in (0.0, width - thick) for b in (0.0, depth - thick)]
    return [((a, b, 0.0), (a + thick, b + thick, height)) for a, b in feet]


def _table() -> Mesh:
    top = ((0.0, 0.0, 0.7), (1.6, 0.9, 0.75))
    return moved(boxes(*zip(top, *_legs(1.6, 0.9, 0.7, 0.07), strict=True)), (1.3, 1.55, 0.0))


def _chairs() -> Mesh:
    parts = [((0.0, 0.0, 0.43), (0.42, 0.42, 0.46)), *_legs(0.42, 0.42, 0.43, 0.04)]
    parts += [((0.0, 0.0, z), (0.42, 0.03, z + 0.1)) for z in (0.58, 0.78)]  # back rest
    parts += [((a, 0.0, 0.46), (a + 0.03, 0.03, 0.9)) for a in (0.0, 0.39)]
    chair = moved(boxes(*zip(*parts, strict=True)), (-0.21, -0.21, 0.0))
    turns = turns_about_z(np.radians([0.0, 12.0, 180.0, 165.0]))
    places = np.array([(1.75, 1.45, 0.0), (2.45, 1.4, 0.0), (1.75, 2.6, 0.0), (2.5, 2.62, 0.0)])
    return copies(chair, turns, places)


def _shelf(seed: int) -> Mesh:
    """Shelf of five boards at the wall x = 0, filled with upright books of random thickness and height."""
    rng = np.random.default_rng(seed)
    boards = [((0.0, 0.0, z), (0.3, 1.6, z + 0.03)) for z in 0.4 * np.arange(5)]
    sides = [((0.0, a, 0.0), (0.3, a + 0.03, 2.0)) for a in (-0.03, 1.6)]
    books = []
    for z in 0.4 * np.arange(5) + 0.03:
        thick = 0.02 + 0.04 * rng.random(24)
        end = np.cumsum(thick)
        tall, deep = 0.2 + 0.12 * rng.random(24), 0.16 + 0.08 * rng.random(24)
        books += [((0.0, b - t, z), (d, b, z + h)) for b, t, h, d in zip(end, thick, tall, deep, strict=True)]
    return moved(boxes(*zip(*boards, *sides, *books, strict=True)), (0.0, 0.8, 0.0))
