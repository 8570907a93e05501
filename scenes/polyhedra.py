"""Shapes for analytic tests: platonic solids, smooth solids as polyhedra, sheets, and defective fixtures.

Provenance: classical geometry (Euclid XIII for the platonic solids), written for silint; no data file. Solids
are centred at the origin and wound counter-clockwise seen from outside, unless their docstring says
otherwise.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from scenes.mesh import Mesh, as_mesh, boxes, concatenate, flipped, grid_faces, moved, revolve, weld

GOLDEN = (1.0 + 5.0**0.5) / 2.0


def _deltahedron(vertices: object) -> Mesh:
    """The convex solid whose faces are all equilateral: triples of nearest neighbours."""
    points = np.asarray(vertices, dtype=np.float64)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    # Second neighbours are at least 1.4 edges away, so 1.1 separates them with no regard to rounding.
    near = distance < 1.1 * distance[0, 1:].min()
    faces = [t for t in combinations(range(len(points)), 3) if all(near[i, j] for i, j in combinations(t, 2))]
    outward = [t if np.linalg.det(points[list(t)]) > 0 else t[::-1] for t in faces]
    return as_mesh(points, outward)


def tetrahedron() -> Mesh:
    """Regular tetrahedron on the unit sphere, 4 triangles."""
    return _deltahedron([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])


def octahedron() -> Mesh:
    """Regular octahedron on the unit sphere, 8 triangles; its edges lie in the coordinate planes."""
    return _deltahedron([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])


def icosahedron() -> Mesh:
    """Regular icosahedron on the unit sphere, 20 triangles."""
    signs = [(a, b * GOLDEN) for a in (1, -1) for b in (1, -1)]
    return _deltahedron([p for a, b in signs for p in ((0, a, b), (a, b, 0), (b, 0, a))])


def dodecahedron() -> Mesh:
    """Regular dodecahedron on the unit sphere, 36 triangles: 12 pentagons, each a fan of three."""
    apexes, triangles = icosahedron()  # the dual: a corner for each triangle, a pentagon for each vertex
    corners = apexes[triangles].sum(axis=1)
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    faces = []
    for index, axis in enumerate(apexes):
        around = np.flatnonzero((triangles == index).any(axis=1))
        x = corners[around[0]] - corners[around[0]].dot(axis) * axis
        y = np.cross(axis, x)
        p = around[np.argsort(np.arctan2(corners[around] @ y, corners[around] @ x))]
        faces += [(p[0], p[1], p[2]), (p[0], p[2], p[3]), (p[0], p[3], p[4])]
    return as_mesh(corners, faces)


def box(size: tuple[float, float, float] = (2.0, 2.0, 2.0)) -> Mesh:
    """Closed box with the edge lengths `size`, 12 triangles."""
    half = 0.5 * np.asarray(size, dtype=np.float64)
    return boxes(-half, half)


def closed_room(size: tuple[float, float, float] = (4.0, 6.0, 3.0)) -> Mesh:
    """A box wound inwards, its floor on z = 0, 12 triangles: from inside nothing of the sky is visible."""
    return flipped(moved(box(size), (0.0, 0.0, 0.5 * size[2])))


def icosphere(subdivisions: int = 3) -> Mesh:
    """Icosahedron with every triangle split in four `subdivisions` times and pushed to the unit sphere.

    ``20 * 4**subdivisions`` triangles; all vertices lie on the unit sphere, to rounding.
    """
    vertices, faces = icosahedron()
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        ab, bc, ca = (len(vertices) + inverse.reshape(-1, 3)).T
        a, b, c = faces.T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        vertices = np.concatenate([vertices, middle])
    return as_mesh(vertices, faces)


def torus(major: float = 1.0, minor: float = 0.35, major_slices: int = 32, minor_slices: int = 20) -> Mesh:
    """Torus about z, ``2 * major_slices * minor_slices`` triangles."""
    angle = -2.0 * np.pi * np.arange(minor_slices) / minor_slices  # downwards on the outer side
    profile = np.stack([major + minor * np.cos(angle), minor * np.sin(angle)], axis=1)
    return revolve(profile, major_slices, closed=True)


def capsule(height: float = 1.5, radius: float = 0.5, slices: int = 16, rings: int = 16) -> Mesh:
    """Cylinder of `height` along z with round ends, ``2 * slices * rings`` triangles; `rings` is even."""
    theta = np.linspace(0.0, 0.5 * np.pi, rings // 2 + 1)[1:]
    cap = np.stack([radius * np.sin(theta), radius * np.cos(theta) + 0.5 * height], axis=1)
    pole = np.array([[0.0, radius + 0.5 * height]])
    upper = np.concatenate([pole, cap])
    return revolve(np.concatenate([upper, upper[::-1] * (1.0, -1.0)]), slices)


def convex_polyhedron(corners: int = 40, seed: int = 0) -> Mesh:
    """Convex hull of `corners` random points of the unit sphere, ``2 * corners - 4`` triangles."""
    from scipy.spatial import ConvexHull

    z, phi = np.random.default_rng(seed).random((2, corners)) * [[2.0], [2.0 * np.pi]] - [[1.0], [0.0]]
    r = np.sqrt(1.0 - z * z)
    points = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    hull = ConvexHull(points)
    faces = np.array(hull.simplices)
    inward = np.einsum("fi,fi->f", hull.equations[:, :3], np.cross(*_edges(points, faces))) < 0
    faces[inward] = faces[inward, ::-1]
    return as_mesh(points, faces)


def _edges(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return b - a, c - a


def triangle() -> Mesh:
    """One right triangle in the plane z = 1, seen from above: corners (0,0), (1,0), (0,1)."""
    return as_mesh([(0, 0, 1), (1, 0, 1), (0, 1, 1)], [(0, 1, 2)])


def rectangle(width: float = 1.0, height: float = 1.0, columns: int = 1, rows: int = 1) -> Mesh:
    """Rectangle in the plane z = 0, centred, normal +z, ``2 * columns * rows`` triangles."""
    x, y = np.meshgrid(
        np.linspace(-0.5 * width, 0.5 * width, columns + 1),
        np.linspace(-0.5 * height, 0.5 * height, rows + 1),
        indexing="ij",
    )
    return as_mesh(np.stack([x, y, np.zeros_like(x)], axis=-1), grid_faces(columns + 1, rows + 1))


def wall(width: float = 4.0, height: float = 2.0) -> Mesh:
    """Rectangle that stands on z = 0 in the plane y = 0, centred in x, normal -y, 2 triangles."""
    vertices, faces = rectangle(width, height)
    return as_mesh(vertices[:, [0, 2, 1]] + (0.0, 0.0, 0.5 * height), faces)


def wall_and_floor(size: float = 4.0) -> Mesh:
    """A square floor, normal +z, that meets a square wall, normal -y, in one shared edge; 4 triangles."""
    floor = moved(rectangle(size, size), (0.0, -0.5 * size, 0.0))
    return weld(concatenate([floor, wall(size, size)]))


def disc(radius: float = 1.0, slices: int = 64) -> Mesh:
    """Regular polygon of `slices` triangles inscribed in a circle of the plane z = 0, normal +z."""
    return revolve([(0.0, 0.0), (radius, 0.0)], slices)


def spherical_cap(angle: float = 60.0, slices: int = 64, rings: int = 16) -> Mesh:
    """Part of the unit sphere within `angle` degrees of +z: ``slices * (2 * rings - 1)`` triangles."""
    theta = np.radians(np.linspace(0.0, angle, rings + 1))
    profile = np.stack([np.sin(theta), np.cos(theta)], axis=1)
    return revolve(profile, slices)


def moebius_strip(segments: int = 48, width: float = 0.6) -> Mesh:
    """Strip with a half turn, ``2 * segments`` triangles: one boundary loop, and no consistent winding."""
    s = 2.0 * np.pi * np.arange(segments) / segments
    t = 0.5 * width * np.array([-1.0, 1.0])
    reach = 1.0 + t * np.cos(0.5 * s)[:, None]
    vertices = np.stack(
        [reach * np.cos(s)[:, None], reach * np.sin(s)[:, None], t * np.sin(0.5 * s)[:, None]], axis=-1
    )
    faces = grid_faces(segments + 1, 2)
    # Past the last row the strip comes back upside down: row `segments` is row 0 with its columns exchanged.
    last = faces >= 2 * segments
    faces[last] = 1 - (faces[last] - 2 * segments)
    return as_mesh(vertices, faces)


def fin(sheets: int = 3) -> Mesh:
    """`sheets` triangles around one edge on the z axis, all wound alike: non-manifold from three up."""
    angle = 2.0 * np.pi * np.arange(sheets) / sheets
    tips = np.stack([np.cos(angle), np.sin(angle), np.full(sheets, 0.5)], axis=1)
    return as_mesh(np.concatenate([[(0, 0, 0), (0, 0, 1)], tips]), [(0, 2 + k, 1) for k in range(sheets)])


def hourglass() -> Mesh:
    """Two closed tetrahedra that share one vertex, the origin: 8 triangles, a non-manifold vertex."""
    vertices, faces = tetrahedron()
    upper = moved((vertices, faces), -vertices[0])
    return weld(concatenate([upper, flipped(as_mesh(-upper[0], faces))]))
