"""Scenes for the exact mode: nothing in general position, and shade points where that hurts most.

A scene knows its answer as a formula of the shade point (displaced as the integrator does, in the scene's own
units), or leaves it to `exact_oracle`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from hypothesis import strategies as st

from scenes import polyhedra
from scenes.mesh import boxes, concatenate, flipped
from silint.reference import half_planes
from silint.reference.closed_form import (
    Hidden,
    closed_room,
    convex_polyhedron,
    parallel_rectangle,
    polygon,
    standing_rectangle,
)

Mesh = tuple[np.ndarray, np.ndarray]
Formula = Callable[[np.ndarray, np.ndarray], Hidden]

# Where a point touches surfaces, edges pass by it at 1e-11 or less of the scene, and the rounding of
# coordinates is up to 1e-5 of that: as well as that is known what they hide of each other.
CONTACT = 1e-5
EXACT = 1e-10


@dataclass(frozen=True)
class ExactScene:
    """A mesh, shade points, and what they see.

    Attributes
    ----------
    tolerance : float
        On ambient occlusion, against the oracle: EXACT, or CONTACT where points touch what they see.
    formula : callable, optional
        What is hidden from a point (p, n) as displaced, to rounding.
    """

    name: str
    mesh: Mesh
    points: np.ndarray
    normals: np.ndarray
    tolerance: float = EXACT
    formula: Formula | None = None


def scene(
    name: str, mesh: Mesh, rows: object, tolerance: float = EXACT, formula: Formula | None = None
) -> ExactScene:
    """A scene from pairs of points and normals."""
    pairs = np.array(list(rows), np.float64).reshape(-1, 2, 3)
    normals = pairs[:, 1] / np.linalg.norm(pairs[:, 1], axis=1)[:, None]
    vertices, faces = mesh
    mesh = np.asarray(vertices, np.float64), np.asarray(faces, np.int32)
    return ExactScene(name, mesh, pairs[:, 0], normals, tolerance, formula)


def turned(mesh: Mesh, turn: np.ndarray) -> Mesh:
    """The mesh under a rotation."""
    return mesh[0] @ turn.T, mesh[1]


def rotation(seed: int) -> np.ndarray:
    """A rotation about no special axis."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def fan(*corners: Sequence[float]) -> Mesh:
    """A convex polygon."""
    return np.array(corners, np.float64), np.array([[0, i, i + 1] for i in range(1, len(corners) - 1)])


def grid(low: Sequence[float], u: Sequence[float], v: Sequence[float], n: int, m: int) -> Mesh:
    """A parallelogram in n x m cells of two triangles each."""
    s, t = np.meshgrid(np.arange(n + 1) / n, np.arange(m + 1) / m, indexing="ij")
    vertices = np.array(low) + s.reshape(-1, 1) * np.array(u) + t.reshape(-1, 1) * np.array(v)
    cells = np.array([[i * (m + 1) + j for j in range(m)] for i in range(n)]).reshape(-1, 1)
    faces = np.concatenate([cells + [0, m + 1, m + 2], cells + [0, m + 2, 1]])
    return vertices, faces


# ----------------------------------------------------------------------------------------------- closed forms


UP = (0.0, 0.0, 1.0)


def _wall() -> ExactScene:
    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return polygon([(-1, 0, 0), (2, 0, 0), (2, 0, 1.5), (-1, 0, 1.5)], p, n)

    rows = [((x, y, z), UP) for x, y, z in product((0, 2, 3.5), (-0.25, 1.0), (0, 0.5))]
    return scene("wall", fan((-1, 0, 0), (2, 0, 0), (2, 0, 1.5), (-1, 0, 1.5)), rows, formula=hidden)


def _standing_wall_in_pieces() -> ExactScene:
    """Howell B-4, the wall in 12 x 5 coplanar cells, seen from the floor."""

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        below = standing_rectangle(abs(p[1]), 2.0 - p[2], -1.5 - p[0], 1.5 - p[0])
        # p stands a little above the foot: what is below its horizon is hidden anyway.
        return below

    mesh = concatenate(
        [grid((-1.5, 0, 0), (3, 0, 0), (0, 0, 2), 12, 5), grid((-4, -4, 0), (8, 0, 0), (0, 8, 0), 4, 4)]
    )
    rows = [((x, y, 0), UP) for x, y in ((0, 0.5), (1.5, 1.0), (0.25, -2.0), (-1.0, -0.25), (3, 0.75))]
    return scene("standing wall in pieces", mesh, rows, formula=hidden)


def _ceiling_in_pieces() -> ExactScene:
    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return parallel_rectangle(1.5 - p[2], -1 - p[0], 2 - p[0], -2 - p[1], 1 - p[1])

    # Corners of cells at the zenith, on azimuths along the axes and diagonals.
    rows = [((x, y, z), UP) for x, y, z in product((-1, 0, 0.5, 2), (-2, -0.5, 0), (0, 1.0))]
    return scene("ceiling in pieces", grid((-1, -2, 1.5), (3, 0, 0), (0, 3, 0), 6, 6), rows, formula=hidden)


def _disc() -> ExactScene:
    t = 2 * np.pi * np.arange(48) / 48
    corners = np.column_stack([np.cos(t), np.sin(t), np.full(48, 0.8)])
    centre = np.concatenate([corners, [[0, 0, 0.8]]])
    faces = [[i, (i + 1) % 48, 48] for i in range(48)]

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return polygon(corners, p, n)

    rows = [
        ((0, 0, 0), UP),
        ((0, 0, 0.5), (1, 0, 1)),
        ((1, 0, 0), UP),
        ((0.5, 0.5, 0), (1, 1, 1)),
        ((3, 0, 0.25), UP),
    ]
    return scene("disc round its zenith", (centre, faces), rows, formula=hidden)


def _box_over_floor() -> ExactScene:
    box = boxes((-1, -1, 1), (1, 1, 2))
    floor = grid((-5, -5, 0), (10, 0, 0), (0, 10, 0), 10, 10)

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return convex_polyhedron(box[0], p, n)

    rows = [((x, y, 0), UP) for x, y in product((0, 1, 1.5, 3), (0, 1, -2))]
    return scene("box over a floor", concatenate([box, floor]), rows, formula=hidden)


def _edges_along_n() -> ExactScene:
    """A post over the point: four of its edges run along n, one of them through the point itself."""
    box = boxes((0, 0, 1), (1, 1, 3))

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return convex_polyhedron(box[0], p, n)

    rows = [((x, y, z), UP) for x, y, z in product((0, 0.5, 1, 2), (0, 1, -1), (0, 0.5))]
    rows += [((0, 0, 0), (1, 0, 0)), ((0, 0, 0), (1, 1, 0)), ((0, 1, 0), (0, -1, 1))]
    return scene("edges along the normal", box, rows, formula=hidden)


def _zenith() -> ExactScene:
    """Apexes, edges and faces of an octahedron exactly overhead."""
    mesh = polyhedra.octahedron()

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        return convex_polyhedron(mesh[0], p, n)

    rows = [((x, y, -2), UP) for x, y in product((0, 0.5, 1, -1), (0, 0.5, 1))]
    rows += [
        ((-3, 0, 0), (1, 0, 0)),
        ((-3, 0, 0), (1, 1, 0)),
        ((2, 2, 0), (-1, -1, 0)),
        ((0, 0, -3), (0, 1, 1)),
    ]
    return scene("vertices at the zenith", mesh, rows, formula=hidden)


def _rooms() -> list[ExactScene]:
    room = grid((0, 0, 0), (4, 0, 0), (0, 3, 0), 4, 3)
    # All wound inwards, so that points in contact with two know on which side they are.
    walls = [
        grid((0, 0, 0), (0, 0, 2), (4, 0, 0), 4, 8),
        grid((0, 3, 0), (4, 0, 0), (0, 0, 2), 4, 2),
        grid((0, 0, 0), (0, 3, 0), (0, 0, 2), 3, 2),
        grid((4, 0, 0), (0, 0, 2), (0, 3, 0), 1, 6),
        grid((0, 0, 2), (0, 3, 0), (4, 0, 0), 6, 2),
    ]
    # Its walls meet in T junctions: closed to the eye, open to topology.
    junctions = concatenate([room, *walls])
    rows = []
    for p in product((0, 1, 1.5, 4), (0, 1.5, 3), (0, 1, 2)):
        inwards = np.array([2, 1.5, 1]) - p
        rows += [(p, inwards if inwards.any() else UP)]
        touched = [
            np.sign(inwards[k]) * np.eye(3)[k] for k in range(3) if p[k] in ((0, 4), (0, 3), (0, 2))[k]
        ]
        rows += [(p, n) for n in touched]
    inside = [
        ((1.5, 1, z), n) for z in (0.5, 1, 1.25) for n in (UP, (1, 0, 0), (1, 1, 0), (1, 2, 3), (0, -1, 0))
    ]

    def all_of_it(p: np.ndarray, n: np.ndarray) -> Hidden:
        return closed_room()

    return [
        scene("closed room", flipped(boxes((0, 0, 0), (4, 3, 2))), rows + inside, CONTACT, all_of_it),
        scene("closed room of T junctions", junctions, inside, formula=all_of_it),
        scene("closed room of T junctions, on its walls", junctions, rows, CONTACT, all_of_it),
        scene(
            "closed room twice",
            concatenate([boxes((0, 0, 0), (4, 3, 2)), flipped(boxes((0, 0, 0), (4, 3, 2)))]),
            inside,
            formula=all_of_it,
        ),
    ]


def _corner_of_a_room() -> ExactScene:
    """Two walls and a floor: a point on the floor sees a quarter room; an octant from the corner itself."""
    mesh = concatenate(
        [
            grid((0, 0, 0), (6, 0, 0), (0, 6, 0), 3, 3),
            grid((0, 0, 0), (6, 0, 0), (0, 0, 3), 4, 2),
            grid((0, 0, 0), (0, 6, 0), (0, 0, 3), 5, 3),
        ]
    )

    def hidden(p: np.ndarray, n: np.ndarray) -> Hidden:
        walls = [
            [(0, 0, 0), (6, 0, 0), (6, 0, 3), (0, 0, 3)],
            [(0, 0, 0), (0, 6, 0), (0, 6, 3), (0, 0, 3)],
        ]
        first, second = (polygon(w, p, n) for w in walls)
        return first + second

    rows = [((x, y, 0), UP) for x, y in product((0.5, 1, 3), (0.5, 2, 3))]
    return scene("corner of a room", mesh, rows, formula=hidden)


# ------------------------------------------------------------------------------------------- for the oracle


def blocks() -> Mesh:
    """Abutting boxes: edges on edges, edges in faces, corners on faces, all on a floor of cells."""
    low = [
        (0, 0, 0),
        (1, 0, 0),
        (2, 0, 0),
        (0, 1, 0),
        (1, 1, 0),
        (0, 0, 1),
        (-2, 0, 0),
        (-2, 2, 0),
        (3, 3, 0),
        (4, 3, 0),
    ]
    size = [
        (1, 1, 1),
        (1, 1, 2),
        (1, 2, 1),
        (1, 1, 3),
        (1, 1, 1),
        (1, 1, 1),
        (1, 1, 2),
        (2, 1, 1),
        (1, 1, 1),
        (1, 1, 1),
    ]
    return concatenate([boxes(low, np.add(low, size)), grid((-6, -6, 0), (12, 0, 0), (0, 12, 0), 6, 6)])


def _rows_about(
    mesh: Mesh, n: int, seed: int, step: float = 0.5, low: float = -4, high: float = 6
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points of a grid that no face contains, with normals along axes and diagonals."""
    rng = np.random.default_rng(seed)
    v = mesh[0][mesh[1]]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    found = 0
    while found < n:
        p = rng.integers(low / step, high / step + 1, 3) * step
        flat = (np.abs(((p - v[:, 0]) * normal).sum(axis=1)) < 1e-12) & normal.any(axis=1)
        inside = np.all(
            [
                (np.cross(v[:, (k + 1) % 3] - v[:, k], p - v[:, k]) * normal).sum(axis=1) >= -1e-12
                for k in range(3)
            ],
            axis=0,
        )
        if (flat & inside).any() or p[2] <= 0:
            continue
        direction = rng.integers(-1, 2, 3)
        if direction.any():
            found += 1
            yield p, direction


def slivers() -> Mesh:
    """Long thin triangles, tiny ones, and one that is nearly a line, among others of usual shape."""
    rng = np.random.default_rng(8)
    t = rng.normal(size=(30, 3, 3))
    t[:10, 2] = t[:10, 0] + (t[:10, 1] - t[:10, 0]) * 0.4 + 1e-7 * t[:10, 2]
    t[10:20, 1:] = t[10:20, :1] + 1e-5 * (t[10:20, 1:] - t[10:20, :1])
    t += 3 * rng.normal(size=(30, 1, 3))
    return t.reshape(-1, 3), np.arange(90).reshape(-1, 3)


def soup(n: int = 60, seed: int = 4) -> Mesh:
    """Triangles at random that pass through each other: all edges are boundaries."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-2, 2, size=(n, 1, 3))
    return (centres + rng.normal(scale=0.5, size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def tangle(n: int = 40, seed: int = 5) -> Mesh:
    """Triangles between few vertices: edges of any number of faces, wound anyhow."""
    rng = np.random.default_rng(seed)
    triples = [tuple(rng.choice(10, 3, replace=False)) for _ in range(n)]
    return rng.uniform(-1, 1, size=(10, 3)), np.array(list({frozenset(t): t for t in triples}.values()))


def integer_tangle(n: int = 40, seed: int = 6) -> Mesh:
    """The same between corners of a grid: many coplanar, collinear and coincident."""
    rng = np.random.default_rng(seed)
    triples = [tuple(rng.choice(14, 3, replace=False)) for _ in range(n)]
    return rng.integers(-2, 3, size=(14, 3)).astype(float), np.array(triples)


def random_rows(mesh: Mesh, n: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    for _ in range(n):
        yield low + (high - low) * (1.4 * rng.random(3) - 0.2), rng.normal(size=3)


def contact_rows(mesh: Mesh, n: int, seed: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """On faces, edges and vertices, along the face's normal: what lies in front of them."""
    rng = np.random.default_rng(seed)
    v = mesh[0][mesh[1]]
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    sound = np.flatnonzero(np.linalg.norm(normal, axis=1) > 1e-3)
    for i in range(n):
        f = rng.choice(sound)
        weights = (
            rng.dirichlet([1, 1, 1])
            if i % 3 == 0
            else np.array([0.5, 0.5, 0])
            if i % 3 == 1
            else np.eye(3)[0]
        )
        yield rng.permutation(weights) @ v[f], normal[f]


def _doubled(mesh: Mesh, again: int = 1) -> Mesh:
    return concatenate([mesh] * (again + 1))


def _moved(s: ExactScene, scale: float, shift: float) -> ExactScene:
    return replace(
        s,
        name=f"{s.name}, times {scale:g}, plus {shift:g}",
        mesh=(s.mesh[0] * scale + shift, s.mesh[1]),
        points=s.points * scale + shift,
        formula=None,
    )


def closed_form_scenes() -> list[ExactScene]:
    """Scenes with a formula."""
    return [
        _wall(),
        _standing_wall_in_pieces(),
        _ceiling_in_pieces(),
        _disc(),
        _box_over_floor(),
        _edges_along_n(),
        _zenith(),
        _corner_of_a_room(),
        *_rooms(),
    ]


def oracle_scenes(n: int = 12) -> list[ExactScene]:
    """Scenes for the oracle, n points each."""
    b = blocks()
    fins = polyhedra.fin(5)
    moebius = polyhedra.moebius_strip(12)
    inside_out = concatenate([b, flipped(boxes((-3, -3, 0), (-2, -2, 1))), boxes((-3, -3, 1), (-2, -2, 2))])
    found = [
        scene("blocks", b, _rows_about(b, n, 1)),
        scene("blocks, any point", b, random_rows(b, n, 2)),
        scene("blocks, in contact", b, contact_rows(b, n, 3), CONTACT),
        scene("blocks twice", _doubled(b), _rows_about(b, n, 4)),
        scene("blocks wound anyhow", inside_out, _rows_about(inside_out, n, 5)),
        scene("five sheets on an edge", fins, random_rows(fins, n, 6)),
        scene("moebius strip", moebius, random_rows(moebius, n, 7)),
        scene("slivers", slivers(), random_rows(slivers(), n, 8)),
        scene("soup", soup(), random_rows(soup(), n, 9)),
        scene("tangle", tangle(), random_rows(tangle(), n, 10)),
        scene("integer tangle", integer_tangle(), _rows_about(integer_tangle(), n, 11, low=-3, high=3)),
        scene("integer tangle, any point", integer_tangle(), random_rows(integer_tangle(), n, 12)),
        scene("open sheet", grid((-1, -1, 1), (2, 0, 0), (0, 2, 0.5), 4, 4), random_rows(b, n, 13)),
    ]
    turn = rotation(3)
    for s in found[:4]:
        found.append(
            replace(
                s,
                name=f"{s.name}, turned",
                mesh=turned(s.mesh, turn),
                points=s.points @ turn.T,
                normals=s.normals @ turn.T,
            )
        )
    found += [_moved(found[0], 1e-6, 0.0), _moved(found[0], 1e6, 0.0), _moved(found[0], 1.0, 1e3)]
    found += [_moved(found[1], 1e-6, 0.0), _moved(found[1], 1e6, 0.0), _moved(found[1], 1.0, 1e3)]
    return found


# --------------------------------------------------------------------------------------- against the oracle


def radial_ao(
    vertices: np.ndarray, faces: np.ndarray, p: np.ndarray, n: np.ndarray, lines: int
) -> tuple[float, float]:
    """Cosine and uniform AO of a shade point, by that many half-planes through n, each integrated exactly."""
    side = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    side /= np.linalg.norm(side)
    phi = 2 * np.pi * (np.arange(lines) + 0.381966) / lines
    sides = np.cos(phi)[:, None] * side + np.sin(phi)[:, None] * np.cross(n, side)
    corners = vertices[faces]
    cosine = whole = 0.0
    chunk = max(1, 400_000 // len(faces))
    for first in range(0, lines, chunk):
        for theta in half_planes.visible_ranges(corners, p, n, n, sides[first : first + chunk]):
            s, c = np.sin(theta), np.cos(theta)
            cosine += (s[:, 1] ** 2 - s[:, 0] ** 2).sum()
            whole += (c[:, 0] - c[:, 1]).sum()
    return cosine / lines, whole / lines


# ------------------------------------------------------------------------------------------- box scenes, any


@st.composite
def integer_boxes(draw: st.DrawFn) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """One to six boxes with small integer coordinates; points on integers and halves; plain normals."""
    low = st.tuples(*[st.integers(-3, 2)] * 3)
    size = st.tuples(*[st.integers(1, 3)] * 3)
    n = draw(st.integers(1, 6))
    corners = np.array(draw(st.lists(low, min_size=n, max_size=n)))
    sizes = np.array(draw(st.lists(size, min_size=n, max_size=n)))
    half = st.tuples(*[st.integers(-8, 8)] * 3)
    points = np.array(draw(st.lists(half, min_size=4, max_size=4)), np.float64) / 2
    step = st.tuples(*[st.integers(-1, 1)] * 3).filter(any)
    normals = np.array(draw(st.lists(step, min_size=4, max_size=4)), np.float64)
    return boxes(corners, corners + sizes), points, normals / np.linalg.norm(normals, axis=1)[:, None]


def reduced_scenes() -> list[ExactScene]:
    """What once went wrong, as few triangles as show it; from random boxes with integer coordinates."""
    rows = [
        # An edge seen end on, along n: drawn as if it had a direction.
        ("end on at the zenith", [[1, 3, 2], [1, 3, 5], [3, 3, 5]], [[0, 1, 2]], (1, 3, 0.5), (0, 0, 1)),
        (
            "end on at the zenith, 2",
            [[-2, 4, 1], [-2, 4, 2], [0, 4, 2]],
            [[0, 1, 2]],
            (-2, 4, 0.5),
            (0, 0, 1),
        ),
        (
            "end on, a plane through n",
            [[-1, -2, 0], [-1, 0, 0], [2, 0, 0]],
            [[0, 1, 2]],
            (3.5, 0, 0),
            (-1, 0, 0),
        ),
        (
            "end on, a plane through n, 2",
            [[2, 1, -1], [2, 4, -1], [4, 4, -1]],
            [[0, 1, 2]],
            (-1.5, 4, -1),
            (1, 0, 0),
        ),
        # An edge that points at p but for its lift, 1e-11 away: its direction is known to 1e-5 at best.
        (
            "nearly end on, a wall edge-on",
            [[1, 2, -1], [1, 2, 2], [2, 2, -1], [2, 2, 2]],
            [[0, 2, 3], [0, 3, 1]],
            (1, 2, 4),
            (-1, 0, -1),
        ),
        (
            "nearly end on, before an edge in one plane",
            [[1, 2, -1], [2, 2, -1], [2, 2, 2], [1, -1, 1], [1, 2, 1], [2, 2, 1]],
            [[0, 1, 2], [3, 5, 4]],
            (4, 2, 1),
            (-1, -1, 1),
        ),
        (
            "nearly end on, below the horizon too",
            [[-1, -2, -1], [0, -2, -1], [0, 0, -1], [0, 0, 0], [0, -2, 2], [0, -2, 4], [0, 0, 4]],
            [[1, 2, 3], [0, 2, 1], [4, 6, 5]],
            (0, -2, -4),
            (0, 1, 1),
        ),
        # Planes that agree to the lift: the crossing was found off both of them.
        (
            "a T junction in a plane through p",
            boxes([(2, 1, 1), (1, -1, -1), (2, 1, -1)], [(5, 2, 4), (2, 2, 1), (3, 2, 0)]),
            None,
            (2.5, -1.5, -1),
            (0, 1, 1),
        ),
    ]
    found = []
    for name, vertices, faces, p, n in rows:
        found.append(scene(name, vertices if faces is None else (vertices, faces), [(p, n)]))
    return found
