"""Martin Newell's teapot from its bicubic Bezier patches.

Provenance: M. E. Newell, University of Utah, 1975 (patches listed in F. Crow, "The Origins of the Teapot",
IEEE Computer Graphics and Applications 7(1), 1987); the control points are treated as public domain
everywhere. They are Newell's heights as usually published (after J. Blinn's division by 1.3), with the bottom
that F. Crow added. Only the numbers are data; the tessellation is silint's own.

The 32 patches have symmetries, so 10 are stored: six of them are quarters of surfaces of revolution, of which
the profile says everything, and four are halves that are mirrored in the plane y = 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenes.mesh import Mesh, as_mesh, boxes, concatenate, copies, grid_faces, turns_about_z, weld

Columns = tuple[NDArray[np.float64], ...]

# Profiles, from the axis or the inner lip down and outwards, four rows a patch: (radius r, arm a, height z).
# A row stands for the quarter circle with control points (r, 0, z), (r, a, z), (a, r, z), (0, r, z).
LID = (
    (0.0, 0.0, 3.15), (0.8, 0.45, 3.15), (0.0, 0.0, 2.85), (0.2, 0.112, 2.7),
    (0.4, 0.224, 2.55), (1.3, 0.728, 2.55), (1.3, 0.728, 2.4),
)  # fmt: skip
BODY = (
    (1.4, 0.784, 2.4), (1.3375, 0.749, 2.53125), (1.4375, 0.805, 2.53125), (1.5, 0.84, 2.4),
    (1.75, 0.98, 1.875), (2.0, 1.12, 1.35), (2.0, 1.12, 0.9),
    (2.0, 1.12, 0.45), (1.5, 0.84, 0.225), (1.5, 0.84, 0.15),
    (1.5, 0.84, 0.075), (1.425, 0.798, 0.0), (0.0, 0.0, 0.0),
)  # fmt: skip

# Cross-sections along the handle and the spout, two patches each that share their middle row: (x0, z0) on the
# one curve of the plane y = 0, (x1, z1) on the other, half width w. A row stands for the half cross-section
# with control points (x0, 0, z0), (x0, w, z0), (x1, w, z1), (x1, 0, z1).
HANDLE = (
    (-1.6, 2.025, -1.5, 2.25, 0.3), (-2.3, 2.025, -2.5, 2.25, 0.3), (-2.7, 2.025, -3.0, 2.25, 0.3),
    (-2.7, 1.8, -3.0, 1.8, 0.3),
    (-2.7, 1.575, -3.0, 1.35, 0.3), (-2.5, 1.125, -2.65, 0.9375, 0.3), (-2.0, 0.9, -1.9, 0.6, 0.3),
)  # fmt: skip
SPOUT = (
    (1.7, 1.425, 1.7, 0.6, 0.66), (2.6, 1.425, 3.1, 0.825, 0.66), (2.3, 2.1, 2.4, 2.025, 0.25),
    (2.7, 2.4, 3.3, 2.4, 0.25),
    (2.8, 2.475, 3.525, 2.49375, 0.25), (2.9, 2.475, 3.45, 2.5125, 0.15), (2.8, 2.4, 3.2, 2.4, 0.15),
)  # fmt: skip


def patches() -> NDArray[np.float64]:
    """Control points of all 32 patches, shape (32, 4, 4, 3), with d_row x d_column pointing outwards."""
    pieces = []
    for profile in (LID, BODY):
        for r, a, z in _four_rows(profile):
            quarter = _control_points(x=(r, r, a, 0 * r), y=(0 * r, a, r, r), z=(z, z, z, z))
            across = quarter[..., [1, 0, 2]]
            pieces += [quarter, across * (-1, 1, 1), quarter * (-1, -1, 1), across * (1, -1, 1)]
    for sections in (HANDLE, SPOUT):
        for x0, z0, x1, z1, w in _four_rows(sections):
            half = _control_points(x=(x0, x0, x1, x1), y=(0 * w, w, w, 0 * w), z=(z0, z0, z1, z1))
            pieces += [half, half[:, ::-1] * (1, -1, 1)]
    return np.stack(pieces)


def _four_rows(table: Sequence[Sequence[float]]) -> list[NDArray[np.float64]]:
    """The table's patches, transposed: four rows each, the last one shared with the next patch."""
    return [np.array(table[k : k + 4]).T for k in range(0, len(table) - 1, 3)]


def _control_points(x: Columns, y: Columns, z: Columns) -> NDArray[np.float64]:
    """(4 rows, 4 columns, 3) from the four columns of each coordinate."""
    return np.stack([np.stack(columns, axis=1) for columns in (x, y, z)], axis=2)


def _bernstein(n: int) -> NDArray[np.int64]:
    """Cubic Bernstein weights at i/n, i = 0..n, times n^3: integers, shape (n + 1, 4)."""
    i = np.arange(n + 1, dtype=np.int64)
    j = n - i
    return np.stack([j**3, 3 * i * j**2, 3 * i**2 * j, i**3], axis=1)


def teapot(subdivisions: int = 10) -> Mesh:
    """The teapot, z up, bottom at z = 0, 3.15 high, spout towards +x; ``64 * n**2 - 8 * n`` triangles.

    Seams between patches are welded. Lid, body, handle and spout stay four open surfaces, as Newell made
    them: a gap runs around the lid, and the ends of handle and spout reach through the body's wall.
    `subdivisions` n: 1 to 200.
    """
    n = subdivisions
    if not 1 <= n <= 200:
        raise ValueError(f"subdivisions must be between 1 and 200, not {n}")
    # Coordinates are whole multiples of 1/32000, so points are sums of integers (below 2^63 up to n = 200)
    # and one division: shared curves and poles agree bit for bit however their patches run, and weld needs no
    # tolerance.
    units = np.rint(32000.0 * patches()).astype(np.int64)
    weights = _bernstein(n)
    grid = np.einsum("ik,jl,pklx->pijx", weights, weights, units, optimize=["einsum_path", (0, 2), (0, 1)])
    faces = grid_faces(n + 1, n + 1)
    starts = (n + 1) ** 2 * np.arange(len(grid))
    return weld(as_mesh(grid / (32000.0 * n**6), faces[None] + starts[:, None, None]))


def teapot_grid(columns: int = 20, rows: int = 15, subdivisions: int = 10, seed: int = 0) -> Mesh:
    """Teapots in rows on a slab, each turned by a random angle.

    ``columns * rows * (64 * n**2 - 8 * n) + 12`` triangles, n = `subdivisions`.
    """
    x, y = np.meshgrid(7.0 * np.arange(columns), 7.0 * np.arange(rows), indexing="ij")
    places = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    angles = 2.0 * np.pi * np.random.default_rng(seed).random(len(places))
    ground = boxes((-5.0, -5.0, -0.5), (7.0 * columns - 2.0, 7.0 * rows - 2.0, 0.0))
    return concatenate([copies(teapot(subdivisions), turns_about_z(angles), places), ground])
