"""The oracle for exact mode within a distance: every circle against every circle, every side by rays.

The boundary of what is visible within R lies on great circles through edges, on the circles in which the
planes of faces cut the ball, and on the horizon. All of these circles are taken whole, cut wherever they meet
another, and each piece is looked at on both sides: rays that end at R, against all faces. Where just one side
is visible, the piece is boundary, and the integral over it is taken numerically, as that of F(theta) dphi
about the normal, F being the integral of the weight from 0 to theta. Nothing is known of contours, depth
counts or closed forms.

Right to about 1e-9 for scenes in general position, where no two circles touch.
"""

from __future__ import annotations

import numpy as np

_SIDE = 1e-9
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(40)


def _visible(triangles: np.ndarray, n: np.ndarray, w: np.ndarray, reach: float) -> np.ndarray:
    """Whether directions (k, 3) see past triangles (f, 3, 3), relative to the point, up to the distance."""
    a, b, c = triangles.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a * normal).sum(axis=1) / (w @ normal.T)
    inside = np.stack([w @ np.cross(u, v).T for u, v in ((a, b), (b, c), (c, a))])
    hit = (t > 0) & (t < reach) & ((inside > 0).all(axis=0) | (inside < 0).all(axis=0))
    seen: np.ndarray = ~hit.any(axis=1) & (w @ n > 0)
    return seen


def _circles(triangles: np.ndarray, n: np.ndarray, reach: float) -> np.ndarray:
    """Unit axes and offsets c of all circles N.w = c: (m, 4), every circle once."""
    found = [[*n, 0.0]]
    for triangle in triangles:
        for i in range(3):
            axis = np.cross(triangle[i], triangle[i - 1])
            found.append([*axis / np.linalg.norm(axis), 0.0])
        axis = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        axis /= np.linalg.norm(axis)
        c = triangle[0] @ axis / reach
        if abs(c) < 1:
            found.append([*axis, c])
    kept: list[np.ndarray] = []
    for circle in np.array(found):
        if all(min(abs(circle - k).max(), abs(circle + k).max()) > 1e-10 for k in kept):
            kept.append(circle)
    return np.array(kept)


def _cuts(circles: np.ndarray, i: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles at which circle i meets the others, sorted, and once round."""
    axis, c = circles[i, :3], circles[i, 3]
    rho = np.sqrt(1 - c * c)
    others = np.delete(circles, i, axis=0)
    x, y = rho * others[:, :3] @ first, rho * others[:, :3] @ second
    level = others[:, 3] - c * others[:, :3] @ axis
    swing = np.hypot(x, y)
    meet = swing > abs(level)
    middle, half = np.arctan2(y[meet], x[meet]), np.arccos(level[meet] / swing[meet])
    angles = np.sort(np.mod(np.concatenate([middle - half, middle + half, [0.0]]), 2 * np.pi))
    return np.append(angles, angles[0] + 2 * np.pi)


def integrals(
    vertices: np.ndarray, faces: np.ndarray, p: np.ndarray, n: np.ndarray, reach: float
) -> np.ndarray:
    """Ambient occlusion with n.w and evenly weighted, and the bent normal, of one point: (5,)."""
    triangles = np.asarray(vertices, np.float64)[faces] - p
    across = np.cross(n, np.eye(3)[np.argmin(abs(n))])
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(n, across), n])
    total = np.zeros(5)
    circles = _circles(triangles, n, reach)
    for i, circle in enumerate(circles):
        axis, c = circle[:3], circle[3]
        first = np.cross(axis, np.eye(3)[np.argmin(abs(axis))])
        first /= np.linalg.norm(first)
        second, rho = np.cross(axis, first), np.sqrt(1 - c * c)
        cuts = _cuts(circles, i, first, second)
        angle = 0.5 * (cuts[1:] + cuts[:-1])
        u = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        w, side = c * axis + rho * u, _SIDE * (rho * axis - c * u)
        left = _visible(triangles, n, w + side, reach)
        right = _visible(triangles, n, w - side, reach)
        for k in np.flatnonzero(left != right):
            half = 0.5 * (cuts[k + 1] - cuts[k])
            beta = angle[k] + half * _NODES
            u = np.cos(beta)[:, None] * first + np.sin(beta)[:, None] * second
            v = np.cos(beta)[:, None] * second - np.sin(beta)[:, None] * first
            x, y, z = frame @ (c * axis + rho * u).T
            dx, dy, _ = frame @ (rho * v).T
            square = x * x + y * y
            # F(theta) dphi, with s dphi = (x dy - y dx) / s^2 and s = sin(theta), z = cos(theta).
            turn = _WEIGHTS * half * (x * dy - y * dx) / square
            sign = 1.0 if left[k] else -1.0
            total[0] += sign * (0.5 * square * turn).sum() / np.pi
            total[1] += sign * ((1 - z) * turn).sum() / (2 * np.pi)
            across_x, across_y = (square * x / 3 * turn).sum(), (square * y / 3 * turn).sum()
            along = ((1 - z**3) / 3 * turn).sum()
            total[2:] += sign / np.pi * np.array([across_x, across_y, along]) @ frame
    return total
