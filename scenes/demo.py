"""The scene that `silint demo` bakes: a small round temple around a trefoil knot.

Provenance: composed and generated here, for silint; no data file. Everything rests on, and reaches a little
into, what it stands on, so that the solids interpenetrate as they do in scenes made by hand. Tessellation is
graded towards every contact, because ambient occlusion at vertices is only as sharp as the mesh.

``python -m scenes.demo`` writes silint/data/demo.npz, the packaged copy.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from scenes.mesh import Mesh, as_mesh, concatenate, flipped, grid_faces, moved, revolve, weld

Array = NDArray[np.float64]

GROUND_RADIUS = 3.0
# Distances from a footprint's outline at which the ground has vertices; the first is hidden inside.
GRADES = (-0.03, 0.004, 0.035, 0.09, 0.17)
# How far things reach into what they stand on.
SUNK = 0.03
# Faces that meet at a larger angle than this keep their own normals along the edge.
CREASE_DEGREES = 38.0


def demo() -> tuple[Array, NDArray[np.int32], Array]:
    """Vertices, faces and vertex normals of the packaged scene; 16,986 triangles, z up."""
    columns = [2.35 * _towards(angle) for angle in np.linspace(45.0, 205.0, 5)]
    sphere, cup, cube, pearl = (
        2.05 * _towards(-97.0),
        2.2 * _towards(-40.0),
        2.42 * _towards(-71.0),
        1.72 * _towards(-60.0),
    )
    footprints = [_circle(1.3, (0.0, 0.0), 48)]
    footprints += [_circle(0.25, place, 16) for place in columns]
    footprints += [_circle(0.13, sphere, 12), _circle(0.22, cup, 20), _circle(0.06, pearl, 8)]
    footprints += [_square(0.27, cube, 25.0)]

    parts = [_base(footprints), _podium(), moved(_knot(), (0.0, 0.0, 1.245), 0.46), _entablature()]
    parts += [moved(_column(), (*place, 0.0)) for place in columns]
    parts += [
        moved(_ball(28, 16), (*sphere, 0.40), 0.42),
        moved(_ball(18, 10), (*pearl, 0.15), 0.16),
        moved(_cup(), (*cup, 0.0)),
        _turned(_rounded_cube(), cube, 25.0),
    ]
    vertices, faces, normals = _creased(concatenate(parts))
    # float32 is what a model file would hold; the copy on disk and the one computed here are the same.
    return (
        vertices.astype(np.float32).astype(np.float64),
        faces,
        normals.astype(np.float32).astype(np.float64),
    )


def _towards(degrees: float) -> Array:
    return np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])


def _circle(radius: float, centre: object, n: int) -> tuple[Array, Array]:
    """Outline points (n, 2) and outward unit normals (n, 2)."""
    angle = 2.0 * np.pi * np.arange(n) / n
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return radius * out + np.asarray(centre), out


def _square(half: float, centre: object, degrees: float, n: int = 7) -> tuple[Array, Array]:
    """As `_circle`; corners carry their diagonal, so that offsets keep the shape."""
    t = np.linspace(-1.0, 1.0, n)[:-1]
    one = np.ones_like(t)
    outline = np.concatenate([np.stack(s, axis=1) for s in ((t, -one), (one, t), (-t, one), (-one, -t))])
    out = np.where(np.abs(outline) == 1.0, outline, 0.0)
    c, s = _towards(degrees)
    turn = np.array([[c, s], [-s, c]])
    return half * outline @ turn + np.asarray(centre), out @ turn


def _base(footprints: list[tuple[Array, Array]]) -> Mesh:
    """The round ground with vertices graded around each footprint, on a plinth of two steps."""
    slices = 96
    rim = _circle(GROUND_RADIUS, (0.0, 0.0), slices)[0]
    rings = [outline + grade * out for outline, out in footprints for grade in GRADES]
    rings += [0.985 * rim, rim]
    # Where the rings of neighbours cross, the later one keeps its distance.
    fixed = rings[-1]
    for ring in rings[:-1]:
        ring = ring[np.linalg.norm(ring, axis=1) < 0.99 * GROUND_RADIUS]
        fixed = np.concatenate([ring[_distance(ring, fixed) > 0.018], fixed])
    spacing = 0.2
    i, j = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21))
    hexagons = np.stack([(i + 0.5 * (j % 2)) * spacing, j * spacing * 0.75**0.5], axis=-1).reshape(-1, 2)
    hexagons = hexagons[np.linalg.norm(hexagons, axis=1) < GROUND_RADIUS - 0.6 * spacing]
    hexagons = hexagons[_distance(hexagons, fixed) > 0.55 * spacing]
    # Nothing of the ground shows under the podium.
    hexagons = hexagons[np.linalg.norm(hexagons, axis=1) > 1.2]
    points = np.concatenate([hexagons, fixed])
    triangles = Delaunay(points).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles = np.where((area > 0.0)[:, None], triangles, triangles[:, ::-1])[np.abs(area) > 1e-9]
    top = as_mesh(np.column_stack([points, np.zeros(len(points))]), triangles)
    r = GROUND_RADIUS
    plinth = revolve(
        [
            (r, 0.0),
            (r + 0.02, -0.02),
            (r + 0.02, -0.08),
            (r + 0.02, -0.14),
            (r + 0.02, -0.18),
            (r + 0.06, -0.18),
            (r + 0.14, -0.18),
            (r + 0.28, -0.18),
            (r + 0.3, -0.2),
            (r + 0.3, -0.4),
            (0.0, -0.4),
        ],
        slices,
    )
    return concatenate([top, plinth])


def _distance(points: Array, others: Array) -> Array:
    return np.linalg.norm(points[:, None, :] - others[None, :, :], axis=2).min(axis=1)


def _podium() -> Mesh:
    """Three round steps."""
    profile = [(0.0, 0.54), (0.3, 0.54), (0.5, 0.54)]
    for radius, height in ((0.72, 0.54), (1.01, 0.36), (1.3, 0.18)):
        profile += [(radius - 0.015, height), (radius, height - 0.015)]
        profile += [(radius, height - 0.1), (radius, height - 0.174)]
        if height > 0.2:
            below = height - 0.18
            profile += [(radius + d, below) for d in (0.0, 0.05, 0.13)]
    return revolve([*profile, (1.3, -SUNK), (0.0, -SUNK)], 48)


def _column() -> Mesh:
    """A fluted column on a moulded foot, with a square-shouldered head; 1.9 high."""
    foot = [(0.25, 0.004), (0.25, 0.05), (0.235, 0.07), (0.21, 0.085), (0.2, 0.12)]
    head = [(0.15, 1.7), (0.165, 1.73), (0.187, 1.79), (0.19, 1.82), (0.19, 1.895), (0.19, 1.93)]
    shaft = [(0.195 - 0.04 * t**1.5, 0.12 + 1.56 * t) for t in (0.05, 0.25, 0.5, 0.75, 0.96)]
    profile = np.array([(0.0, -SUNK), (0.25, -SUNK), *foot, *shaft, *head, (0.0, 1.93)])[::-1]
    flutes, a_flute = 12, 2
    slices = flutes * a_flute
    vertices = np.empty((len(profile), slices, 3))
    angle = 2.0 * np.pi * np.arange(slices) / slices
    fluted = ((profile[:, 1] > 0.13) & (profile[:, 1] < 1.66)).astype(float)[:, None]
    radius = profile[:, :1] - 0.016 * fluted * (np.arange(slices) % a_flute != 0)
    vertices[..., 0] = radius * np.cos(angle)
    vertices[..., 1] = radius * np.sin(angle)
    vertices[..., 2] = profile[:, 1:]
    return weld(as_mesh(vertices, grid_faces(len(profile), slices, wrap_columns=True)))


def _entablature() -> Mesh:
    """A beam over the columns: a chamfered rectangle swept along their arc."""
    angle = np.deg2rad(np.linspace(36.0, 214.0, 45))
    half, low, high, c = 0.21, 1.9, 2.22, 0.02
    section = np.array(
        [
            (half, low + c),
            (half, 0.5 * (low + high)),
            (half, high - c),
            (half - c, high),
            (0.0, high),
            (c - half, high),
            (-half, high - c),
            (-half, 0.5 * (low + high)),
            (-half, low + c),
            (c - half, low),
            (-0.1, low),
            (0.1, low),
            (half - c, low),
        ]
    )
    radius = 2.35 + section[:, 0]
    vertices = np.stack(
        [
            np.cos(angle)[:, None] * radius,
            np.sin(angle)[:, None] * radius,
            np.broadcast_to(section[:, 1], (len(angle), len(section))),
        ],
        axis=-1,
    )
    n = len(section)
    faces = grid_faces(len(angle), n, wrap_columns=True)
    ends = vertices[[0, -1]].mean(axis=1)
    middle = len(angle) * n + np.arange(2)
    k = np.arange(n)
    first = np.stack([np.full(n, middle[0]), k, (k + 1) % n], axis=1)
    last = np.stack([middle[1] - n * (len(angle) - 1) + 0 * k, (k + 1) % n, k], axis=1) + n * (len(angle) - 1)
    corners = np.concatenate([vertices.reshape(-1, 3), ends])
    return as_mesh(corners, np.concatenate([faces, first, last]))


def _knot(along: int = 90, around: int = 11) -> Mesh:
    """A trefoil, upright, as a tube; about 3 high."""
    t = 2.0 * np.pi * np.arange(along) / along

    def curve(t: Array) -> Array:
        return np.stack(
            [np.sin(t) + 2 * np.sin(2 * t), -0.75 * np.sin(3 * t), np.cos(t) - 2 * np.cos(2 * t)], axis=1
        )

    step = 1e-4
    centre, forward = curve(t), curve(t + step) - curve(t - step)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    side = np.cross((0.0, 1.0, 0.0), forward)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(forward, side)
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = np.cos(turn)[:, None] * side[:, None, :] + np.sin(turn)[:, None] * other[:, None, :]
    faces = grid_faces(along, around, wrap_rows=True, wrap_columns=True)
    mesh = flipped(as_mesh(0.5 * (centre[:, None, :] + 0.92 * ring), faces))
    low = mesh[0][:, 2].min()
    return moved(mesh, (0.0, 0.0, -low - 1.6))


def _ball(slices: int, rings: int) -> Mesh:
    polar = np.linspace(0.0, np.pi, rings + 1)
    profile = np.stack([np.sin(polar), np.cos(polar)], axis=1)
    profile[[0, -1], 0] = 0.0
    return revolve(profile, slices)


def _cup() -> Mesh:
    """An open bowl on a foot."""
    inside = [(0.46 * np.sin(a), 0.56 - 0.46 * np.cos(a)) for a in np.linspace(0.0, 0.5 * np.pi, 8)]
    outside = [(0.50 * np.sin(a), 0.56 - 0.50 * np.cos(a)) for a in np.linspace(0.5 * np.pi, 0.3, 6)]
    foot = [(0.13, 0.06), (0.17, 0.035), (0.22, 0.02), (0.22, 0.004), (0.22, -SUNK), (0.0, -SUNK)]
    rim = [(0.465, 0.575), (0.48, 0.58), (0.495, 0.575)]
    profile = np.array([*inside, *rim, *outside, *foot])
    profile[0, 0] = 0.0
    return revolve(profile, 30)


def _rounded_cube(half: float = 0.27, bevel: float = 0.03) -> Mesh:
    """A cube with rounded edges on z = 0, finer towards them and towards the ground."""
    inner = half - bevel
    line = np.array([-half, -half + 0.35 * bevel, -inner, -0.55 * inner, 0.2 * inner, inner])
    line = np.concatenate([line, [half - 0.35 * bevel, half]])
    u, v = np.meshgrid(line, line, indexing="ij")
    faces = grid_faces(len(line), len(line))
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            p = np.empty((*u.shape, 3))
            p[..., axis] = sign * half
            p[..., (axis + 1) % 3], p[..., (axis + 2) % 3] = u, v
            sides.append(as_mesh(p, faces if sign > 0 else faces[:, ::-1]))
    vertices, triangles = weld(concatenate(sides))
    core = np.clip(vertices, -inner, inner)
    out = vertices - core
    vertices = core + bevel * out / np.linalg.norm(out, axis=1, keepdims=True)
    return as_mesh(vertices + np.array([0.0, 0.0, half - bevel + 0.004]), triangles)


def _turned(mesh: Mesh, place: Array, degrees: float) -> Mesh:
    c, s = _towards(degrees)
    return as_mesh(mesh[0] @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + (*place, 0.0), mesh[1])


def _creased(mesh: Mesh) -> tuple[Array, NDArray[np.int32], Array]:
    """Vertices split where faces meet at more than `CREASE_DEGREES`; normals weighted by corner angles."""
    vertices, faces = weld(mesh)
    p = vertices[faces]
    flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    around: list[list[tuple[int, float]]] = [[] for _ in vertices]
    for f, face in enumerate(faces):
        for k in range(3):
            a, b = p[f, (k + 1) % 3] - p[f, k], p[f, (k + 2) % 3] - p[f, k]
            around[face[k]].append((f, float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))))
    limit = np.cos(np.deg2rad(CREASE_DEGREES))
    rows: dict[tuple[int, bytes], int] = {}
    positions, normals = [], []
    corners = np.empty_like(faces)
    for f, face in enumerate(faces):
        for k, v in enumerate(face):
            normal = sum(angle * flat[g] for g, angle in around[v] if flat[g] @ flat[f] >= limit)
            normal = normal / np.linalg.norm(normal)
            key = (int(v), np.round(normal, 5).tobytes())
            if key not in rows:
                rows[key] = len(positions)
                positions.append(vertices[v])
                normals.append(normal)
            corners[f, k] = rows[key]
    return np.array(positions), corners, np.array(normals)


def main() -> None:
    """Write the packaged copy and say how large it is."""
    vertices, faces, normals = demo()
    index = np.uint16 if len(vertices) < 2**16 else np.int32
    path = Path(__file__).parent.parent / "silint" / "data" / "demo.npz"
    np.savez_compressed(
        path,
        vertices=vertices.astype(np.float32),
        faces=faces.astype(index),
        normals=normals.astype(np.float32),
    )
    print(f"{path}: {len(faces)} triangles, {len(vertices)} vertices, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
