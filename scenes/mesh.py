"""Small tools that every generator shares: grids, sweeps, copies, welding.

Provenance: elementary geometry, written for silint. A mesh is the plain pair ``(vertices, faces)``; faces are
counter-clockwise seen from outside. Random numbers are uniform draws of a seeded ``numpy.random.Generator``,
whose stream is stable across platforms; other distributions are derived here, so that a scene stays the scene
it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.int32]
Mesh = tuple[Vertices, Faces]


def as_mesh(vertices: object, faces: object) -> Mesh:
    """The pair as contiguous ``(V, 3)`` float64 and ``(F, 3)`` int32 arrays."""
    return (
        np.ascontiguousarray(vertices, dtype=np.float64).reshape(-1, 3),
        np.ascontiguousarray(faces, dtype=np.int32).reshape(-1, 3),
    )


def concatenate(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh that holds all of `meshes` side by side; nothing is welded."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    return as_mesh(
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=False)]),
    )


def copies(mesh: Mesh, linear: NDArray[np.float64], translations: NDArray[np.float64]) -> Mesh:
    """`mesh` under each of the linear maps (n, 3, 3), then translated by each of `translations` (n, 3)."""
    vertices, faces = mesh
    placed = np.einsum("nij,vj->nvi", linear, vertices) + translations[:, None, :]
    starts = len(vertices) * np.arange(len(translations), dtype=np.int32)
    return as_mesh(placed, faces[None] + starts[:, None, None])


def moved(mesh: Mesh, offset: Sequence[float], scale: float = 1.0) -> Mesh:
    """`mesh` scaled about the origin, then translated."""
    return as_mesh(mesh[0] * scale + np.asarray(offset, dtype=np.float64), mesh[1])


def flipped(mesh: Mesh) -> Mesh:
    """The same triangles seen from the other side."""
    return as_mesh(mesh[0], mesh[1][:, ::-1])


def weld(mesh: Mesh) -> Mesh:
    """Merge vertices at exactly equal positions and drop the faces that collapse.

    Equal means bit for bit (after -0 = 0): generators evaluate shared curves by the same operations, so no
    tolerance is needed, and none can close a gap that is meant to be there.
    """
    vertices, inverse = np.unique(mesh[0] + 0.0, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[mesh[1]]
    a, b, c = faces.T
    return as_mesh(vertices, faces[(a != b) & (b != c) & (c != a)])


def grid_faces(rows: int, columns: int, wrap_rows: bool = False, wrap_columns: bool = False) -> Faces:
    """Two triangles for each cell of a ``(rows, columns)`` vertex grid stored row by row.

    Their normal is (direction of increasing row) x (direction of increasing column).
    """
    i, j = np.meshgrid(
        np.arange(rows if wrap_rows else rows - 1),
        np.arange(columns if wrap_columns else columns - 1),
        indexing="ij",
    )
    i1, j1 = (i + 1) % rows, (j + 1) % columns
    a, b, c, d = (r * columns + k for r, k in ((i, j), (i1, j), (i1, j1), (i, j1)))
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)


def boxes(lower: object, upper: object) -> Mesh:
    """Closed axis-aligned boxes, 12 triangles each, between corners `lower` and `upper`, (3,) or (n, 3)."""
    low = np.atleast_2d(np.asarray(lower, dtype=np.float64))
    high = np.atleast_2d(np.asarray(upper, dtype=np.float64))
    bits = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=bool)
    corners = np.where(bits, high[:, None, :], low[:, None, :])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    return as_mesh(corners, faces[None] + 8 * np.arange(len(low))[:, None, None])


def revolve(profile: object, slices: int, closed: bool = False) -> Mesh:
    """Surface of revolution about z of a `profile` (k, 2) of (radius, height) rows.

    A profile that runs downwards on its outer side gives outward normals. Rows of radius 0 become one pole
    vertex; `closed` joins the last row to the first (a torus).
    """
    radius, height = np.asarray(profile, dtype=np.float64).T
    angle = 2.0 * np.pi * np.arange(slices) / slices
    vertices = np.empty((len(radius), slices, 3))
    vertices[..., 0] = radius[:, None] * np.cos(angle)
    vertices[..., 1] = radius[:, None] * np.sin(angle)
    vertices[..., 2] = height[:, None]
    return weld(as_mesh(vertices, grid_faces(len(radius), slices, wrap_rows=closed, wrap_columns=True)))


def tubes(paths: object, radii: object, sides: int, reference: Sequence[float], caps: bool = True) -> Mesh:
    """Sweep a regular polygon along each polyline of `paths` (n, k, 3); `radii` broadcasts to (n, k).

    `reference` is any direction that no path ever takes: it fixes the polygon's turn. `caps` closes both
    ends.
    """
    path = np.asarray(paths, dtype=np.float64)
    n, k, _ = path.shape
    step = np.diff(path, axis=1)
    step /= np.linalg.norm(step, axis=2, keepdims=True)
    tangent = np.concatenate([step[:, :1], step[:, 1:] + step[:, :-1], step[:, -1:]], axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    first = np.cross(np.asarray(reference, dtype=np.float64), tangent)
    first /= np.linalg.norm(first, axis=2, keepdims=True)
    second = np.cross(tangent, first)

    angle = 2.0 * np.pi * np.arange(sides) / sides
    # Down the row is along the tangent; columns turn so that (tangent x turn) points outwards.
    ring = np.cos(angle)[:, None] * first[:, :, None] - np.sin(angle)[:, None] * second[:, :, None]
    reach = np.broadcast_to(np.asarray(radii, dtype=np.float64), (n, k))
    vertices = path[:, :, None, :] + reach[:, :, None, None] * ring
    faces = grid_faces(k, sides, wrap_columns=True)
    if caps:
        fan = np.array([(0, j, j + 1) for j in range(1, sides - 1)], dtype=np.int32)
        faces = np.concatenate([faces, fan, fan[:, ::-1] + (k - 1) * sides])
    return as_mesh(vertices, faces[None] + (k * sides) * np.arange(n)[:, None, None])


def turns_about_z(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (n, 3, 3) about z by `angles` (n,) in radians."""
    turn = np.zeros((len(angles), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
    turn[:, 1, 0] = np.sin(angles)
    turn[:, 0, 1] = -turn[:, 1, 0]
    turn[:, 2, 2] = 1.0
    return turn


def random_rotations(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Uniformly distributed rotations (n, 3, 3), by Shoemake's map of three uniforms to a unit quaternion."""
    u, alpha, beta = rng.random((3, n)) * np.array([[1.0], [2.0 * np.pi], [2.0 * np.pi]])
    x, y = np.sqrt(1.0 - u) * np.sin(alpha), np.sqrt(1.0 - u) * np.cos(alpha)
    z, w = np.sqrt(u) * np.sin(beta), np.sqrt(u) * np.cos(beta)
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=-1),
            np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=-1),
            np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=-1),
        ],
        axis=-2,
    )
