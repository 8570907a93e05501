"""Caps of the sphere on radial isolines: what is near of a plane, a cone about the normal, the ground.

The cap m.w > q cuts a line in one interval of keys. A ray along w meets a plane at the height h over the
shade point after h / (m.w), with m the unit normal towards it: the part of a plane within the distance R is
the cap with q = h / R, and all of it is that with q = 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from silint.core.jit import INNER, KERNEL, PARALLEL
from silint.core.radial import in_frame

# How far below the ground, relative to the larger of the scene and the point's distance from the origin, a
# point still counts as lying on it: above what lifting does to points whose normals lean down.
GROUND_CONTACT = 2.0**-16

NO_GROUND = np.zeros(4)
NO_GROUND.setflags(write=False)

# Fractional parts of its multiples are spread evenly, however many are taken.
_GOLDEN = 0.6180339887498949

NO_FALLOFF, LINEAR, QUADRATIC = 0, 1, 2

# Lines for each isoline where surfaces fall off with distance, as each of them takes one radius.
LINES_OF_FALLOFF = 4


class LineLimits(NamedTuple):
    """What of a scene counts, in scaled units."""

    reach: float = np.inf  # nothing blocks from this distance on
    falloff: int = NO_FALLOFF
    one_sided: bool = False  # faces seen from their back do not block
    cone: float = 0.0  # only directions with n.w above this count
    ground: np.ndarray = NO_GROUND  # (4,) float64: unit normal upwards and d; zero for none
    ground_reach: float = np.inf  # as `reach` for the ground, where that reaches beyond all faces

    @property
    def by_faces(self) -> bool:
        """Whether single faces are told apart, which only covering does."""
        return self.reach < np.inf or self.one_sided


UNLIMITED = LineLimits()


def reach_table(limits: LineLimits, n_lines: int, of_ground: bool = False) -> np.ndarray:
    """How far each line reaches, for faces or the ground: (K,) float64.

    With a falloff f, which goes from 1 at the point to 0 at R, a hit at the distance d blocks f(d) =
    int [d < r] (-f'(r)) dr: the mean over radii r that are distributed as -f'. Each line takes one of them,
    r = R f^-1(u) with u from a lattice over all lines, so that azimuths and radii are sampled together.
    """
    if limits.falloff == NO_FALLOFF:
        return np.full(n_lines, min(limits.reach, limits.ground_reach) if of_ground else limits.reach)
    u = (0.5 + _GOLDEN * np.arange(n_lines)) % 1.0
    return limits.reach * (u if limits.falloff == LINEAR else np.sqrt(u))


@njit(**KERNEL)
def cap_on_line(a, t, q):
    """Keys of start and end of the cap m.w > q >= 0 on a line; m is (a, t) along the axis and the line.

    The start is not above the end where there is nothing of it.
    """
    square = a * a + t * t - q * q
    if square <= 0.0:
        return -np.inf, np.inf
    g = np.sqrt(square)
    # theta_0 -+ arccos(q / rho), of which the half-plane has those whose sine is positive.
    start, end = t * q - a * g, t * q + a * g
    # Both are 0 where the cap is all of the line.
    if start <= 0.0 and end <= 0.0 and not (start == end and t > 0.0):
        return -np.inf, np.inf
    high = (a * q + t * g) / start if start > 0.0 else np.inf
    low = (a * q - t * g) / end if end > 0.0 else -np.inf
    return high, low


@njit(**INNER)
def crossing(a, e, c, s):
    """Where the edge from a to a + e, in the frame, crosses the half-plane of a line; a point of the edge."""
    x = (s * a[0] - c * a[1]) / (c * e[1] - s * e[0])
    # Along the half-plane it may be anything, or NaN; but it has to lie on the edge.
    x = x if x > 0.0 else 0.0
    x = x if x < 1.0 else 1.0
    return a[0] + x * e[0], a[1] + x * e[1], a[2] + x * e[2]


@njit(**INNER)
def is_near(t, m, a, reach):
    """Whether what lies at (t, m, a) from the shade point counts."""
    return t * t + m * m + a * a < reach * reach


@njit(**INNER)
def crosses_near(a, e, c, s, reach):
    """Whether an edge crosses the half-plane of a line within a distance.

    From the edge and the line alone: all faces of an edge agree.
    """
    t, m, z = crossing(a, e, c, s)
    return is_near(t, m, z, reach)


@njit(**INNER)
def plane_towards(face_planes, planes, f, p, frame):
    """Distance of a face's plane, and the unit normal towards it in the frame."""
    code = face_planes[f]
    k = max(code, ~code)
    x, y, z = planes[k, 0], planes[k, 1], planes[k, 2]
    height = x * p[0] + y * p[1] + z * p[2] + planes[k, 3]
    t, m, a = in_frame(x, y, z, frame)
    return (height, (-t, -m, -a)) if height > 0.0 else (-height, (t, m, a))


@njit(**INNER)
def meets_axis_near(height, along, reach):
    """Whether a plane at this distance, with its normal along the axis by so much, meets the axis near."""
    return height < along * reach


@njit(**PARALLEL)
def clip_lines(points, frames, lines, ends, reach, ground, counts, starts, intervals, new_starts, out):
    """What the ground and the ends of lines leave of intervals.

    Parameters
    ----------
    points : (n, 3) float64
    frames : (n, 3, 3) float64
    lines : (K, 2) float64
    ends : (K,) float64
        Keys beyond which lines do not count.
    reach : (K,) float64
        How far the ground counts on each line.
    ground : (4,) float64
        Unit normal upwards and d; zero for none. It is solid: points below it see nothing.
    counts : (n, K) int32, in and out
    starts : (n,) int64
    intervals : (m, 2) float64
    new_starts : (n,) int64
        First rows of each point in `out`, with room for K more than it has now.
    out : (m + n K, 2) float64, out
    """
    solid = ground[0] != 0.0 or ground[1] != 0.0 or ground[2] != 0.0
    for i in prange(len(counts)):
        row, n_out = starts[i], new_starts[i]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        height = ground[0] * x + ground[1] * y + ground[2] * z + ground[3]
        buried = solid and height < -GROUND_CONTACT * max(1.0, abs(x), abs(y), abs(z))
        height = max(height, 0.0)
        t, m, a = in_frame(-ground[0], -ground[1], -ground[2], frames[i])
        for k in range(len(lines)):
            # Hidden from `high` down to `low`.
            high, low = -np.inf, np.inf
            if solid:
                high, low = cap_on_line(a, t * lines[k, 0] + m * lines[k, 1], height / reach[k])
            first = n_out
            for _ in range(counts[i, k]):
                y0, y1 = intervals[row, 0], max(intervals[row, 1], ends[k])
                row += 1
                if buried or y0 <= y1:
                    continue
                if high <= low or high <= y1 or low >= y0:
                    out[n_out, 0], out[n_out, 1] = y0, y1
                    n_out += 1
                    continue
                if y0 > high:
                    out[n_out, 0], out[n_out, 1] = y0, high
                    n_out += 1
                if low > y1:
                    out[n_out, 0], out[n_out, 1] = low, y1
                    n_out += 1
            counts[i, k] = n_out - first
