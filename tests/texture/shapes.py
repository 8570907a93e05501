from __future__ import annotations

import numpy as np
import pytest


def obj_text(vertices, faces, uvs=None, normals=None) -> str:
    """An .obj with a ``vt`` for each corner, and normals for each corner where given."""
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    if uvs is not None:
        rows += [f"vt {u!r} {v!r}" for u, v in np.asarray(uvs, float).reshape(-1, 2).tolist()]
    if normals is not None:
        rows += [f"vn {x!r} {y!r} {z!r}" for x, y, z in np.asarray(normals, float).reshape(-1, 3).tolist()]
    for f, face in enumerate(faces):
        corners = []
        for i, v in enumerate(face):
            vt = str(3 * f + i + 1) if uvs is not None else ""
            corners.append(
                f"{v + 1}/{vt}/{3 * f + i + 1}" if normals is not None else f"{v + 1}/{vt}".rstrip("/")
            )
        rows.append("f " + " ".join(corners))
    return "\n".join(rows) + "\n"


def grid(origin, across, up, n=1):
    """n x n squares as triangles with vertices, faces and unit-square coordinates of the corners."""
    t = np.linspace(0.0, 1.0, n + 1)
    u, v = np.meshgrid(t, t)
    places = np.stack([u.ravel(), v.ravel()], axis=1)
    vertices = np.asarray(origin) + places[:, :1] * np.asarray(across) + places[:, 1:] * np.asarray(up)
    faces = []
    for j in range(n):
        for i in range(n):
            a = j * (n + 1) + i
            faces += [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
    faces = np.array(faces)
    return vertices, faces, places[faces]


def placed(uvs, u0, v0, u1, v1):
    """Unit-square coordinates moved into a rectangle."""
    return uvs * (u1 - u0, v1 - v0) + (u0, v0)


@pytest.fixture
def wall_over_floor(tmp_path):
    """A floor in 0 <= x <= 1, -2 <= y <= 2 with +z up, and a long wall on x = 0 that looks along +x.

    The floor fills u < 0.5, x along growing u; the wall fills the rest, too far to be read with it.
    """
    floor = grid((0.0, -0.5, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    wall = grid((0.0, -400.0, 0.0), (0.0, 800.0, 0.0), (0.0, 0.0, 400.0))
    vertices = np.concatenate([floor[0], wall[0]])
    faces = np.concatenate([floor[1], wall[1] + len(floor[0])])
    uvs = np.concatenate([placed(floor[2], 0.0, 0.0, 0.45, 1.0), placed(wall[2], 0.55, 0.0, 1.0, 1.0)])
    path = tmp_path / "wall.obj"
    path.write_text(obj_text(vertices, faces, uvs))
    return path


@pytest.fixture
def box(tmp_path):
    """A cube of edge 1 over a floor; six charts of 3 x 2 cells with gutters, the floor's in the last row."""
    cells = []
    for axis in range(3):
        for side in (0.0, 1.0):
            e = np.roll(np.eye(3), axis, axis=1)  # e[0] is the axis of the face
            origin = side * e[0]
            a, b = (e[1], e[2]) if side else (e[2], e[1])
            cells.append(grid(origin, a, b))
    cells.append(grid((-2.0, -2.0, -0.25), (5.0, 0.0, 0.0), (0.0, 5.0, 0.0)))
    vertices, faces, uvs, start = [], [], [], 0
    for k, (v, f, uv) in enumerate(cells):
        column, row = k % 3, k // 3
        u0, v0 = column / 3 + 0.02, row / 3 + 0.02
        vertices.append(v)
        faces.append(f + start)
        uvs.append(placed(uv, u0, v0, u0 + 0.28, v0 + 0.28))
        start += len(v)
    path = tmp_path / "box.obj"
    path.write_text(obj_text(np.concatenate(vertices), np.concatenate(faces), np.concatenate(uvs)))
    return path
