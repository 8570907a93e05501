"""Small meshes with texture coordinates made by hand."""

from __future__ import annotations

import numpy as np


def obj_text(vertices, faces, uvs=None, normals=None) -> str:
    """An .obj with a ``vt`` for each corner, and normals for each corner where given."""
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    if uvs is not None:
        rows += [f"vt {u!r} {v!r}" for u, v in np.asarray(uvs, float).reshape(-1, 2).tolist()]
    if normals is not None:
        rows += [f"vn {x!r} {y!r} {z!r}" for x, y, z in np.asarray(normals, float).reshape(-1, 3).tolist()]
    for f, face in enumerate(faces):
        of_corner = [3 * f + i + 1 for i in range(3)]
        vt = of_corner if uvs is not None else ["", "", ""]
        vn = [f"/{k}" for k in of_corner] if normals is not None else ["", "", ""]
        rows.append("f " + " ".join(f"{v + 1}/{vt[i]}{vn[i]}".rstrip("/") for i, v in enumerate(face)))
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


def strip(uvs_of, n=12):
    """A straight strip of n squares; its texture coordinates by a function of their (x, y)."""
    i = np.arange(n)
    vertices = np.array([(x, y, 0.0) for x in range(n + 1) for y in range(2)])
    faces = np.concatenate([np.c_[2 * i, 2 * i + 2, 2 * i + 3], np.c_[2 * i, 2 * i + 3, 2 * i + 1]])
    return vertices, faces, np.array([uvs_of(x, y) for x, y, _ in vertices])[faces]


def ring(gap):
    """A strip of 12 squares bent round until its ends, far apart in space, are within twice a gap."""

    def place(x, y):
        angle = gap / 0.35 + (2 * np.pi - 2 * gap / 0.35) * x / 12
        radius = 0.45 - 0.18 * y
        return 0.5 + radius * np.cos(angle), 0.5 - radius * np.sin(angle)

    return place


def placed(uvs, u0, v0, u1, v1):
    """Unit-square coordinates moved into a rectangle."""
    return uvs * (u1 - u0, v1 - v0) + (u0, v0)


def wall_and_floor(height=400.0, turn=0, mirror=False, half_length=400.0):
    """A floor 0 <= x <= 1, |y| <= 1/2 that looks along +z, and a long wall on x = 0 that looks along +x.

    The floor fills u < 0.45; `turn` quarter turns of its coordinates, then perhaps u -> 1 - u. The wall fills
    u > 0.55.
    """
    floor = grid((0.0, -0.5, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    wall = grid((0.0, -half_length, 0.0), (0.0, 2.0 * half_length, 0.0), (0.0, 0.0, height))
    uv = floor[2]
    for _ in range(turn):
        uv = np.stack([1.0 - uv[..., 1], uv[..., 0]], axis=-1)
    if mirror:
        uv = uv * (-1.0, 1.0) + (1.0, 0.0)
    vertices = np.concatenate([floor[0], wall[0]])
    faces = np.concatenate([floor[1], wall[1] + len(floor[0])])
    uvs = np.concatenate([placed(uv, 0.0, 0.0, 0.45, 1.0), placed(wall[2], 0.55, 0.0, 1.0, 1.0)])
    return vertices, faces, uvs


BOX_CELL = 0.28  # side of each chart of the box


def box_cell(k):
    """Lower left corner of the k-th chart."""
    return k % 3 / 3 + 0.02, k // 3 / 3 + 0.02


def box_side(k):
    """Origin and two edges of the k-th side of the unit cube, x, y, z from low to high; 6 is the floor."""
    if k == 6:
        return np.array([-2.0, -2.0, -0.25]), np.array([5.0, 0.0, 0.0]), np.array([0.0, 5.0, 0.0])
    e = np.roll(np.eye(3), -(k // 2), axis=0)
    return (e[0], e[1], e[2]) if k % 2 else (np.zeros(3), e[2], e[1])


def box(inwards=False, floor=True):
    """A unit cube over a floor, seven charts in a grid of 3 x 3 cells."""
    vertices, faces, uvs, start = [], [], [], 0
    for k in range(7 if floor else 6):
        v, f, uv = grid(*box_side(k))
        u0, v0 = box_cell(k)
        vertices.append(v)
        faces.append(f + start)
        uvs.append(placed(uv, u0, v0, u0 + BOX_CELL, v0 + BOX_CELL))
        start += len(v)
    faces, uvs = np.concatenate(faces), np.concatenate(uvs)
    if inwards:
        faces, uvs = faces[:, ::-1], uvs[:, ::-1]
    return np.concatenate(vertices), faces, uvs
