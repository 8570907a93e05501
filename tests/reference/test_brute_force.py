"""The oracle itself: fixtures checked by hand, rays in plain NumPy, and identities of the sphere."""

from __future__ import annotations

import numpy as np
import pytest

from silint.reference import brute_force, strip_cells
from silint.reference.analytic_scenes import analytic_scenes

NO_FACES = np.zeros((0, 3), np.int32)
OCTANT = np.eye(3)
CUBE = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
CUBE_FACES = np.array(
    [
        t
        for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        for t in ((a, b, c), (a, c, d))
    ],
    np.int32,
)


def _units(rng: np.random.Generator, n: int) -> np.ndarray:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def _soup(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles at random in a cube of side 4 about the origin."""
    centers = rng.uniform(-2, 2, size=(n, 1, 3))
    return (centers + rng.normal(scale=0.5, size=(n, 3, 3))).reshape(-1, 3), np.arange(3 * n).reshape(n, 3)


def _depth(vertices: np.ndarray, faces: np.ndarray, p: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Number of faces that each ray p + t w meets [Moeller & Trumbore 1997]: (len(w),)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(w[:, None, :], (c - a)[None])
    det = (across * (b - a)).sum(axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (across * (p - a)).sum(axis=-1) / det
        q = np.cross(p - a, b - a)
        v = (w @ q.T) / det
        t = ((c - a) * q).sum(axis=-1) / det
        hit = (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return hit.sum(axis=1)


def _direction(u: float, v: np.ndarray) -> np.ndarray:
    """The octahedral map, from its definition: corners +y, +z, -y, -z at v = 0, 1, 2, 3."""
    corners = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)], np.float64)
    q = np.minimum(v.astype(int), 3)
    f = (v - q)[:, None]
    yz = (1 - abs(u)) * ((1 - f) * corners[q] + f * corners[q + 1])
    return np.column_stack([np.full(len(v), u), yz])


def test_one_octant_hides_one_quarter_of_the_positive_lines() -> None:
    faces = np.array([[0, 1, 2]], np.int32)
    n = np.array([[0.0, 1.0, 1.0]]) / np.sqrt(2)
    found = brute_force.visible_intervals(OCTANT, faces, np.zeros((1, 3)), n, 2)
    # Two lines, u = -1/2 and u = 1/2. Above the horizon is y + z > 0: v from 3.5 round to 1.5. The triangle
    # hides x, y, z > 0: all of v in [0, 1] on the second line.
    np.testing.assert_array_equal(found.offsets, [0, 2, 4])
    np.testing.assert_array_equal(found.intervals, [[0, 1.5], [3.5, 4], [1, 1.5], [3.5, 4]])


@pytest.mark.parametrize("isolines", [1, 2, 5, 8, 33])
def test_runs_and_cells_fill_hemisphere_and_sphere(isolines: int) -> None:
    n = _units(np.random.default_rng(1), 6)
    whole = brute_force.visible_intervals(OCTANT, NO_FACES, np.zeros((6, 3)), n, isolines)
    area = strip_cells.first_moments(whole.offsets, whole.intervals, isolines, n, 0)
    # A run is half its loop for every normal, by the symmetry w -> -w of lines u and -u.
    np.testing.assert_allclose(area, 2 * np.pi, rtol=1e-14)

    offsets, loops = np.arange(6 * isolines + 1), np.tile([[0.0, 4.0]], (6 * isolines, 1))
    np.testing.assert_allclose(
        strip_cells.first_moments(offsets, loops, isolines, n, 0), 4 * np.pi, rtol=1e-14
    )
    np.testing.assert_allclose(strip_cells.first_moments(offsets, loops, isolines, n, 1), 0, atol=1e-14)
    np.testing.assert_allclose(
        strip_cells.second_moments(offsets, loops, isolines, n), 4 / 3 * np.pi * n, atol=1e-13
    )


def test_cells_integrate_like_quadrature() -> None:
    # One cell across u = 0, and across two corners of the loop; the measure from finite differences alone.
    isolines = 5
    n = _units(np.random.default_rng(2), 1)
    offsets = np.array([0, 0, 0, 1, 1, 1])  # on the middle line, u in [-0.2, 0.2]
    cell = np.array([[0.7, 2.2]])
    x, weight = np.polynomial.legendre.leggauss(40)
    area, first, second = 0.0, 0.0, np.zeros(3)
    h = 1e-6
    for a, b in ((-0.2, 0.0), (0.0, 0.2)):
        for c, d in ((0.7, 1.0), (1.0, 2.0), (2.0, 2.2)):
            for i in range(40):
                u = 0.5 * (a + b) + 0.5 * (b - a) * x[i]
                v = 0.5 * (c + d) + 0.5 * (d - c) * x
                w, du = _direction(u, v), _direction(u + h, v) - _direction(u - h, v)
                dv = _direction(u, v + h) - _direction(u, v - h)
                r = np.linalg.norm(w, axis=1)
                dw = np.abs((np.cross(du, dv) * w).sum(axis=1)) / (4 * h * h) / r**3
                scale = 0.25 * (b - a) * (d - c) * weight[i] * weight * dw
                area += scale.sum()
                first += (scale * (w @ n[0]) / r).sum()
                second += ((scale * (w @ n[0]) / r**2)[:, None] * w).sum(axis=0)
    # Differences over 2e-6 carry 1e-10 of rounding.
    tolerance = {"rtol": 0, "atol": 1e-9}
    np.testing.assert_allclose(strip_cells.first_moments(offsets, cell, isolines, n, 0), area, **tolerance)
    np.testing.assert_allclose(strip_cells.first_moments(offsets, cell, isolines, n, 1), first, **tolerance)
    np.testing.assert_allclose(strip_cells.second_moments(offsets, cell, isolines, n)[0], second, **tolerance)


def test_intervals_are_where_rays_get_through() -> None:
    rng = np.random.default_rng(4)
    vertices, faces = _soup(rng, 40)
    points, normals = rng.uniform(-1, 1, size=(6, 3)), _units(rng, 6)
    isolines = 7  # odd: u = 0 too
    found = brute_force.visible_intervals(vertices, faces, points, normals, isolines)
    assert len(found.intervals) > 50
    for i in range(6):
        for k in range(isolines):
            u = -1 + (2 * k + 1) / isolines
            v = rng.uniform(0, 4, 300)
            w = _direction(u, v)
            open_by_rays = (_depth(vertices, faces, points[i], w) == 0) & (w @ normals[i] > 0)
            rows = found.intervals[found.offsets[i * isolines + k] : found.offsets[i * isolines + k + 1]]
            open_by_intervals = ((v[:, None] > rows[:, 0]) & (v[:, None] < rows[:, 1])).any(axis=1)
            # Random v lie within rounding of an end with probability 1e-13.
            np.testing.assert_array_equal(open_by_rays, open_by_intervals)


def test_nothing_leaks_out_of_a_closed_mesh() -> None:
    sphere = next(s for s in analytic_scenes() if s.name == "icosphere outside/turned")
    rng = np.random.default_rng(5)
    center = sphere.vertices.mean(axis=0)
    points = center + rng.normal(scale=0.4, size=(20, 3))
    found = brute_force.visible_intervals(sphere.vertices, sphere.faces, points, _units(rng, 20), 65)
    # Not even slivers: both faces of an edge give the very same limit.
    assert len(found.intervals) == 0


def test_contours_of_a_cube() -> None:
    seen = brute_force.contour_jumps(CUBE, CUBE_FACES, np.array([3.0, 0.2, 0.1]))
    assert len(seen.edges) == 18
    contour = seen.edges[seen.jumps != 0]
    # Only the side at x = 1 is seen: its four edges, and not its diagonal.
    assert len(contour) == 4
    assert (seen.positions[contour][:, :, 0] == 1).all()
    assert (np.abs(seen.jumps[seen.jumps != 0]) == 2).all()
    corner = brute_force.contour_jumps(CUBE, CUBE_FACES, np.array([3.0, 3.0, 3.0]))
    assert (corner.jumps != 0).sum() == 6
    inside = brute_force.contour_jumps(CUBE, CUBE_FACES, np.array([0.1, 0.2, 0.3]))
    assert (inside.jumps == 0).all()


def test_contour_jumps_count_faces_to_either_side() -> None:
    rng = np.random.default_rng(6)
    # Fans of 1 to 5 faces with winding at random, and closed parts, as seen from somewhere.
    vertices = [CUBE + 3]
    faces = [CUBE_FACES]
    for size in range(1, 6):
        base = rng.normal(size=(2, 3)) + rng.normal(scale=3, size=3)
        start = sum(map(len, vertices))
        vertices.append(np.vstack([base, base.mean(axis=0) + rng.normal(size=(size, 3))]))
        fan = np.array([(0, 1, 2 + i) if rng.random() < 0.5 else (1, 0, 2 + i) for i in range(size)])
        faces.append(fan + start)
    v, f = np.vstack(vertices), np.vstack(faces).astype(np.int32)
    p = np.array([0.3, -0.2, 0.5])
    seen = brute_force.contour_jumps(v, f, p)
    assert not seen.edge_on.any()
    assert set(np.abs(seen.jumps)) >= {0, 1, 2} and np.abs(seen.jumps).max() >= 3
    a, b = seen.positions[seen.edges[:, 0]] - p, seen.positions[seen.edges[:, 1]] - p
    side = np.cross(a, b)
    side /= np.linalg.norm(side, axis=1)[:, None]
    # At a generic place of the edge, either side of it, the count differs by the jump.
    middle = 0.43 * a + 0.57 * b
    step = 1e-7 * np.linalg.norm(middle, axis=1)[:, None] * side
    difference = _depth(v, f, p, middle + step) - _depth(v, f, p, middle - step)
    np.testing.assert_array_equal(difference, seen.jumps)


def test_sides_of_faces_are_exact() -> None:
    # Whole numbers below 2^53, so doubles hold them; determinants of some 2^140 do not fit any double.
    rng = np.random.default_rng(9)
    faces = np.array([[0, 1, 2]], np.int32)
    for off in (0, 1, -1):
        for _ in range(20):
            corners = [[int(x) for x in row] for row in rng.integers(-(2**45), 2**45, size=(3, 3))]
            edges = [[corners[k][i] - corners[0][i] for i in range(3)] for k in (1, 2)]
            s, t = (int(x) for x in rng.integers(-9, 9, size=2))
            p = [corners[0][i] + s * edges[0][i] + t * edges[1][i] for i in range(3)]
            p[0] += off
            normal_x = edges[0][1] * edges[1][2] - edges[0][2] * edges[1][1]  # Python integers: exact
            seen = brute_force.contour_jumps(np.array(corners, np.float64), faces, np.array(p, np.float64))
            if off == 0:
                # In the face's plane.
                assert seen.edge_on.all() and (seen.jumps == 0).all()
            else:
                # det(a, b, c) = -N.(p - a): one sign for all three edges, each seen from its lower vertex.
                a, b, c = (np.flatnonzero((seen.positions == v).all(axis=1))[0] for v in corners)
                for v, w in ((a, b), (b, c), (c, a)):
                    row = (seen.edges == sorted((v, w))).all(axis=1)
                    assert seen.jumps[row] == (1 if (off * normal_x < 0) == (v < w) else -1)


def test_seams_are_welded_and_collapsed_faces_left_out() -> None:
    split = CUBE[CUBE_FACES].reshape(-1, 3)
    faces = np.vstack([np.arange(36).reshape(12, 3), [[0, 0, 1]]]).astype(np.int32)
    seen = brute_force.contour_jumps(split, faces, np.array([3.0, 0.2, 0.1]))
    assert len(seen.edges) == 18
    assert (seen.jumps != 0).sum() == 4


def test_difference_of_intervals() -> None:
    first = np.array([[0.5, 1.0], [3.5, 4.5], [0.0, 4.0]])
    second = np.array([[0.75, 1.25], [0.0, 0.5], [3.5, 4.0]])
    found = brute_force.interval_difference(np.array([0, 1, 2, 3]), first, np.array([0, 1, 3, 3]), second)
    np.testing.assert_allclose(found, [0.5, 0.0, 4.0])
    one = np.array([0, 1])
    wrapped = brute_force.interval_difference(one, first[1:2], one, np.array([[3.5, 0.5]]))
    assert wrapped[0] == 0
    with pytest.raises(ValueError, match="2 lines against 1"):
        brute_force.interval_difference(np.array([0, 0, 0]), first[:0], np.array([0, 0]), second[:0])


def test_values_in_the_open_and_their_symmetries() -> None:
    n = _units(np.random.default_rng(7), 5)
    below = -3 * n[0] + OCTANT  # nothing above the first point's horizon
    faces = np.array([[0, 1, 2]], np.int32)
    args = (below, faces, np.zeros((1, 3)), n[:1], 16)
    assert brute_force.ambient_occlusion(*args)[0] == 1.0
    assert brute_force.ambient_occlusion(*args, "uniform")[0] == 1.0
    np.testing.assert_allclose(brute_force.bent_normals(*args), 2 / 3 * n[:1], atol=1e-15)
    up = _units(np.random.default_rng(8), 1)[0]
    np.testing.assert_allclose(brute_force.sky_view_factor(*args, up), 0.5 + 0.5 * n[:1] @ up, atol=1e-15)


def test_bent_normal_points_out_of_a_corner() -> None:
    # A wall of half the world at x < 0: what is left is a quarter sphere, int (n.w) w = (2/3) (1, 0, pi/2).
    wall = 1e6 * np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    p = np.array([[1e-3, 0, 0]])
    found = brute_force.bent_normals(wall, faces, p, np.array([[0.0, 0, 1]]), 64)[0]
    # 64 lines leave some 1e-4; the wall ends within 1e-6 of its horizon.
    np.testing.assert_allclose(found, np.array([2 / 3, 0, np.pi / 3]) / np.pi, atol=1e-3)


def test_shade_points_are_lifted_by_the_largest_coordinate() -> None:
    vertices, p, n = 8 * OCTANT, np.array([[0.0, 0, 0], [32, 0, 0]]), np.array([[0.0, 0, 1], [0, 0, 1]])
    np.testing.assert_array_equal(brute_force.shade_points(vertices, p, n)[:, 2], [2.0**-33, 2.0**-31])
    np.testing.assert_array_equal(brute_force.shade_points(vertices, p, n, True)[:, 2], [2.0**-15, 2.0**-13])
