"""Scenes whose ambient occlusion is a formula: meshes, points and exact answers, for every integrator.

Each scene comes twice: aligned with the axes, where vertices, faces and points coincide with coordinate
planes as they do in practice, and turned, shifted and scaled, where nothing does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from silint.reference.closed_form import (
    Hidden,
    closed_room,
    convex_polyhedron,
    parallel_rectangle,
    polygon,
    standing_rectangle,
)

__all__ = ["AnalyticScene", "analytic_scenes"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]
Mesh = tuple[FloatArray, IntArray]

UP = (0.0, 0.0, 1.0)
NOTHING = Hidden(0.0, 0.0)


@dataclass(frozen=True)
class AnalyticScene:
    """A mesh, shade points and what they see.

    Attributes
    ----------
    name : str
        ``"shape/placement"``.
    vertices, faces : ndarray, shapes (V, 3) and (F, 3)
    points, normals : ndarray, shape (n, 3)
        Unit normals. Points may lie on faces, edges and vertices; displace them as the integrator does.
    cosine, uniform : ndarray, shape (n,)
        Exact ambient occlusion and visible fraction of the hemisphere: 1 open, 0 closed.
    note : str
        Why that is the answer.
    """

    name: str
    vertices: FloatArray
    faces: IntArray
    points: FloatArray
    normals: FloatArray
    cosine: FloatArray
    uniform: FloatArray
    note: str


@cache
def analytic_scenes() -> tuple[AnalyticScene, ...]:
    """All scenes, each in both placements; computed once."""
    shapes = [
        _open_sky(),
        _closed_room(),
        _nested_rooms(),
        _standing_wall(),
        _long_wall(),
        _foot_of_walls(),
        _ceiling(),
        _fin_on_a_ceiling(),
        _disc_overhead(),
        _triangle(),
        _two_triangles(),
        _repeated_faces(),
        _cube_outside(),
        _own_surface(),
        _icosphere_outside(),
        _courtyard(),
        _window(),
        _stairs(),
    ]
    return tuple(placed for shape in shapes for placed in (shape, _turned(shape)))


# ------------------------------------------------------------------------------------------------ building


def _scene(
    name: str, mesh: Mesh, answers: Iterable[tuple[Sequence[float], Sequence[float], Hidden]], note: str
) -> AnalyticScene:
    rows = list(answers)
    normals = np.array([n for _, n, _ in rows], np.float64)
    hidden = np.array([h for _, _, h in rows])
    return AnalyticScene(
        name=name + "/aligned",
        vertices=np.ascontiguousarray(mesh[0], np.float64),
        faces=np.ascontiguousarray(mesh[1], np.int32),
        points=np.array([p for p, _, _ in rows], np.float64),
        normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        cosine=1.0 - hidden[:, 0],
        uniform=1.0 - hidden[:, 1],
        note=note,
    )


def _turned(scene: AnalyticScene) -> AnalyticScene:
    """The same answers elsewhere: a rotation about no special axis, 1.7 times as large, away from 0."""
    x, y, z, w = np.array([0.3, -0.5, 0.2, 0.78]) / np.linalg.norm([0.3, -0.5, 0.2, 0.78])
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    shift = np.array([2.1, -3.7, 5.3])
    normals = scene.normals @ rotation.T
    return AnalyticScene(
        name=scene.name.replace("/aligned", "/turned"),
        vertices=1.7 * scene.vertices @ rotation.T + shift,
        faces=scene.faces,
        points=1.7 * scene.points @ rotation.T + shift,
        normals=normals / np.linalg.norm(normals, axis=1)[:, None],
        cosine=scene.cosine,
        uniform=scene.uniform,
        note=scene.note,
    )


def _joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0] + [len(v) for v, _ in meshes[:-1]])
    return (
        np.concatenate([v for v, _ in meshes]),
        np.concatenate([f + o for (_, f), o in zip(meshes, offsets, strict=True)]).astype(np.int32),
    )


def _fan(corners: npt.ArrayLike) -> Mesh:
    """A convex polygon as triangles about its first corner."""
    v = np.array(corners, np.float64)
    return v, np.array([[0, i, i + 1] for i in range(1, len(v) - 1)], np.int32)


def _box(low: Sequence[float], high: Sequence[float], without: Sequence[str] = ()) -> Mesh:
    """A box, its faces counter-clockwise from outside, less the sides named ("+z", ...)."""
    v = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], np.float64)
    sides = {
        "-x": (0, 4, 6, 2), "+x": (1, 3, 7, 5), "-y": (0, 1, 5, 4),
        "+y": (2, 6, 7, 3), "-z": (0, 2, 3, 1), "+z": (4, 5, 7, 6),
    }  # fmt: skip
    quads = [q for side, q in sides.items() if side not in without]
    return v, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)


def _floor(size: float = 5.0) -> Mesh:
    return _fan([(-size, -size, 0), (size, -size, 0), (size, size, 0), (-size, size, 0)])


def _icosphere(levels: int) -> Mesh:
    from scipy.spatial import ConvexHull

    g = (1 + 5**0.5) / 2
    v = np.array([(0, s, t * g) for s in (-1, 1) for t in (-1, 1)], np.float64)
    v = np.concatenate([v, np.roll(v, 1, axis=1), np.roll(v, 2, axis=1)])
    v /= np.linalg.norm(v, axis=1)[:, None]
    f = ConvexHull(v).simplices
    for _ in range(levels):
        ab, bc, ca = (v[f[:, i]] + v[f[:, (i + 1) % 3]] for i in range(3))
        middle = np.concatenate([ab, bc, ca])
        middle /= np.linalg.norm(middle, axis=1)[:, None]
        a, b, c = f.T
        i, j, k = np.arange(3 * len(f)).reshape(3, -1) + len(v)
        v = np.concatenate([v, middle])
        f = np.concatenate([np.column_stack(t) for t in ((a, i, k), (i, b, j), (k, j, c), (i, j, k))])
        v, inverse = np.unique(np.round(v, 12), axis=0, return_inverse=True)
        f = inverse.reshape(-1)[f]
    inward = (np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]]) * v[f[:, 0]]).sum(axis=1) < 0
    f[inward] = f[inward][:, ::-1]
    return v, f.astype(np.int32)


# ------------------------------------------------------------------------------------------------- scenes


def _open_sky() -> AnalyticScene:
    mesh = _box((-1, -1, -3), (1, 1, -1))
    rows = [
        ((0, 0, 0), UP, NOTHING),
        ((0.3, -0.2, 5), (0.2, 0.1, 1), NOTHING),
        ((9, 0, 0), (1, 0, 1), NOTHING),
    ]
    return _scene("open sky", mesh, rows, "the box lies under every point's horizon")


def _closed_room() -> AnalyticScene:
    mesh = _box((-2, -3, 0), (2, 3, 2.5))
    room = closed_room()
    rows = [
        ((0.1, 0.2, 1.1), UP, room),
        ((0.1, 0.2, 1.1), (0.3, -1, 0.2), room),
        ((0.7, -1.1, 0), UP, room),  # on the floor
        ((-2, 1.0, 1.0), (1, 0, 0), room),  # on a wall
        ((-2, -3, 0), (1, 1, 1), room),  # in a corner: a vertex
        ((2, 0.5, 2.5), (-1, 0, -1), room),  # on the edge of a wall and the ceiling
    ]
    return _scene("closed room", mesh, rows, "a closed surface leaves nothing open from inside")


def _nested_rooms() -> AnalyticScene:
    inner = _box((-1, -1, -1), (1, 1, 1))
    mesh = _joined(inner, (_box((-2, -2, -2), (2, 2, 2))[0], _box((-2, -2, -2), (2, 2, 2))[1][:, ::-1]))
    room = closed_room()
    rows = [
        ((0.1, 0.2, 0.3), UP, room),
        ((1.5, 0.1, 0.2), (1, 0.3, 0), room),
        ((1, 0.2, 0.1), (1, 0, 0), room),
    ]
    return _scene("nested rooms", mesh, rows, "closed boxes of opposite winding, one in the other")


def _standing_wall() -> AnalyticScene:
    wall = _fan([(-1, 0, 0), (2, 0, 0), (2, 0, 1.5), (-1, 0, 1.5)])
    rows: list[tuple[Sequence[float], Sequence[float], Hidden]] = [
        ((x, y, 0), UP, standing_rectangle(abs(y), 1.5, -1 - x, 2 - x))
        for x, y in ((0, 0.5), (0.5, 2.0), (-1, -0.25), (3, 1.0), (2, -3.0))
    ]
    return _scene("standing wall", _joined(_floor(), wall), rows, "Howell B-4; both sides of a sheet")


def _long_wall() -> AnalyticScene:
    wall = _fan([(-40, 0, 0), (40, 0, 0), (40, 0, 1), (-40, 0, 1)])
    rows: list[tuple[Sequence[float], Sequence[float], Hidden]] = [
        ((0, y, 0), UP, standing_rectangle(y, 1, -40, 40)) for y in (0.1, 0.5, 1.0, 3.0)
    ]
    return _scene("long wall", _joined(_floor(50.0), wall), rows, "nearly the infinite wall")


def _foot_of_walls() -> AnalyticScene:
    mesh = _joined(_floor(), _box((-4, -4, 0), (0, 4, 3)), _box((0, 0, 0), (4, 4, 3)))
    # In contact with solids, so with a normal that leads away from all of them: along a wall a point
    # would be neither in nor out of the solid, and what it sees undefined.
    beside = polygon([(0, 0, 0), (4, 0, 0), (4, 0, 3), (0, 0, 3)], (0, -2, 0), _unit((1, 0, 1)))
    rows = [
        # Open is a lune of 90 degrees about n, less the other wall ...
        ((0, -2, 0), (1, 0, 1), Hidden(1 - 0.5**0.5, 0.5) + beside),
        # ... and in the corner an octant about n, over which w integrates to (pi / 4) (1, -1, 1).
        ((0, 0, 0), (1, -1, 1), Hidden(1 - 3**0.5 / 4, 0.75)),
    ]
    return _scene("foot of walls", mesh, rows, "on an edge of the floor with a wall, and in a corner")


def _ceiling() -> AnalyticScene:
    mesh = _fan([(-1, -2, 1.5), (2, -2, 1.5), (2, 1, 1.5), (-1, 1, 1.5)])
    rows = [
        ((x, y, z), UP, parallel_rectangle(1.5 - z, -1 - x, 2 - x, -2 - y, 1 - y))
        for x, y, z in ((0, 0, 0), (0.5, -0.5, 1.0), (2, 1, 0), (4, 0, 0.5), (-3, 3, -2))
    ]
    rows.append(((0, 0, 3), UP, NOTHING))
    return _scene("ceiling", mesh, rows, "Howell B-3 by signed corners")


def _fin_on_a_ceiling() -> AnalyticScene:
    v = [(-1, -1, 1), (0, -1, 1), (2, -1, 1), (2, 1, 1), (0, 1, 1), (-1, 1, 1), (0, -1, 2), (0, 1, 2)]
    quads = [(0, 1, 4, 5), (1, 2, 3, 4), (1, 4, 7, 6)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    rows = [
        ((x, y, 0), UP, parallel_rectangle(1, -1 - x, 2 - x, -1 - y, 1 - y))
        for x, y in ((0, 0), (0.25, 0.5), (-0.6, -0.3))
    ]
    note = "three sheets on one edge; from below, one of them is hidden by the other two"
    return _scene("fin on a ceiling", (np.array(v, np.float64), faces), rows, note)


def _disc_overhead() -> AnalyticScene:
    t = 2 * np.pi * np.arange(96) / 96
    corners = np.column_stack([np.cos(t), np.sin(t), np.full(96, 0.8)])
    at = [((0, 0, 0), UP), ((0.5, 0.1, 0), UP), ((1.4, -0.3, 0.2), UP), ((0.2, 0.1, 0), (1, 0.2, 0.3))]
    rows = [(p, n, polygon(corners, p, _unit(n))) for p, n in at]
    return _scene("disc overhead", _fan(corners), rows, "Lambert over 96 sides; Howell B-14 in the limit")


def _triangle() -> AnalyticScene:
    corners = np.array([(-0.7, -0.4, 1.0), (1.1, -0.6, 0.7), (0.2, 0.9, 1.3)])
    at = [
        ((0.15, -0.1, 0), UP),
        ((0.1, 0.1, 0.9), UP),
        ((2, 0.3, 0.1), UP),
        ((2, 0.3, 0.9), UP),  # cut by the horizon
        ((0.2, 0, 0), (1, 0.1, 0.2)),  # cut again
        ((0.1, 0.1, 3), (0.1, 0.2, -1)),
    ]
    rows = [(p, n, polygon(corners, p, _unit(n))) for p, n in at]
    return _scene("triangle", _fan(corners), rows, "Lambert, clipped at the horizon")


def _two_triangles() -> AnalyticScene:
    left = np.array([(-2, -0.5, 1.0), (-0.3, -0.7, 0.8), (-0.8, 0.9, 1.2)])
    right = np.array([(0.4, -0.8, 0.5), (1.5, 0.2, -0.4), (0.6, 0.7, 0.9)])
    at = [((0, 0, 0), UP), ((0, 0.2, -0.3), (0.3, 0, 1))]
    rows = [(p, n, polygon(left, p, _unit(n)) + polygon(right, p, _unit(n))) for p, n in at]
    return _scene("two triangles", _joined(_fan(left), _fan(right)), rows, "apart as seen: Lambert's sum")


def _repeated_faces() -> AnalyticScene:
    corners = np.array([(-0.7, -0.4, 1.0), (1.1, -0.6, 0.7), (0.2, 0.9, 1.3)])
    mesh = (corners, np.array([[0, 1, 2], [0, 1, 2], [0, 2, 1], [1, 1, 2]], np.int32))
    at = [((0.15, -0.1, 0), UP), ((2, 0.3, 0.9), UP)]
    rows = [(p, n, polygon(corners, p, _unit(n))) for p, n in at]
    return _scene("repeated faces", mesh, rows, "one triangle three times, once reversed, and one of no area")


def _cube_outside() -> AnalyticScene:
    mesh = _box((-1, -1, 0), (1, 1, 2))
    at = [
        ((2.5, 0.4, 0), UP),
        ((2.5, 2.5, 0), (-1, -1, 0.4)),
        ((0.2, 0.3, 4), (0, 0.2, -1)),
        ((1.25, 0, 1), (-1, 0, 0)),
        ((1.0, 3.0, 0.5), (0, -1, 0)),  # in the plane of a side
        ((60, 20, 35), (-1, -0.4, -0.5)),
    ]
    rows = [(p, n, convex_polyhedron(mesh[0], p, _unit(n))) for p, n in at]
    return _scene("cube outside", mesh, rows, "Lambert over the silhouette's hull")


def _own_surface() -> AnalyticScene:
    mesh = _box((-1, -1, -1), (1, 1, 1))
    rows = [
        ((0.2, 0.3, 1), UP, NOTHING),
        ((0, 0, 1), UP, NOTHING),  # on the diagonal of a side: an edge of coplanar faces
        ((1, 0.1, 1), UP, NOTHING),
        ((1, 0.1, 1), (1, 0, 1), NOTHING),
        ((1, 1, 1), (1, 1, 1), NOTHING),
        ((1, 1, 1), (1, 0, 0), NOTHING),
        ((-1, -0.4, 0.7), (-1, 0, 0), NOTHING),
    ]
    return _scene(
        "own surface", mesh, rows, "a convex solid hides nothing of its own sky: faces, edges, corners"
    )


def _icosphere_outside() -> AnalyticScene:
    mesh = _icosphere(2)
    at = [
        ((0, 0, -2), UP),
        ((0.3, 0.4, -1.2), UP),
        ((0, 1.5, 0), UP),
        ((2.2, 0.1, 0.9), (-1, 0.5, 0.2)),
        ((1.4, 0.6, 0.5), UP),
    ]
    rows = [(p, n, convex_polyhedron(mesh[0], p, _unit(n))) for p, n in at]
    return _scene("icosphere outside", mesh, rows, "Lambert over the silhouette's hull; a cap in the limit")


def _courtyard() -> AnalyticScene:
    mesh = _box((-2, -1, 0), (2, 1, 1.5), without=("+z",))
    opening = [(-2, -1, 1.5), (2, -1, 1.5), (2, 1, 1.5), (-2, 1, 1.5)]
    at = [
        ((0, 0, 0), UP),
        ((1.1, -0.4, 0), UP),
        ((0.5, 1, 0.7), (0, -1, 0)),
        ((-0.4, 0.2, 0.8), (0.4, 0.1, -1)),
    ]
    rows = [(p, n, _all_but(opening, p, n)) for p, n in at]
    return _scene("courtyard", mesh, rows, "what is open is the polygon of the missing lid")


def _window() -> AnalyticScene:
    room = _box((-2, -2, 0), (2, 2, 3), without=("+y",))
    outer = [(-2, 2, 0), (2, 2, 0), (2, 2, 3), (-2, 2, 3)]
    inner = [(-0.5, 2, 1), (1, 2, 1), (1, 2, 2.2), (-0.5, 2, 2.2)]
    ring = [t for i in range(4) for t in ((i, (i + 1) % 4, 4 + (i + 1) % 4), (i, 4 + (i + 1) % 4, 4 + i))]
    mesh = _joined(room, (np.array(outer + inner, np.float64), np.array(ring, np.int32)))
    at = [((0, 0, 0), UP), ((0.6, 1.2, 0), UP), ((0, -1, 1.5), (0.1, 1, 0)), ((1, 0, 1.6), (0, 1, 1))]
    rows = [(p, n, _all_but(inner, p, n)) for p, n in at]
    return _scene("window", mesh, rows, "a room with one hole: what is open is the hole's polygon")


def _stairs() -> AnalyticScene:
    mesh = _joined(_box((-3, 0, 0), (3, 1, 0.5)), _box((-3, 1, 0), (3, 4, 1.0)))
    rows: list[tuple[Sequence[float], Sequence[float], Hidden]] = [
        ((x, y, 0.5), UP, standing_rectangle(1 - y, 0.5, -3 - x, 3 - x))
        for x, y in ((0, 0.5), (1.5, 0.9), (-2, 0.0))
    ]
    return _scene("stairs", mesh, rows, "on a tread: the next riser; two solids touch in a face")


def _all_but(opening: Sequence[Sequence[float]], p: Sequence[float], n: Sequence[float]) -> Hidden:
    seen = polygon(opening, p, _unit(n))
    return Hidden(1.0 - seen.cosine, 1.0 - seen.uniform)


def _unit(v: Sequence[float]) -> FloatArray:
    return np.asarray(v, np.float64) / np.linalg.norm(v)
