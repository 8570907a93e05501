"""How much of a hemisphere simple shapes hide: formulas, each with its source.

Every function returns `Hidden`: the occluded fraction with the cosine weight (a form factor from a small
patch to the shape) and with the uniform one (solid angle over 2 pi). Ambient occlusion is 1 minus it.

Sources
-------
Lambert, *Photometria*, 1760: the polygon.
Howell, Mengüç, Daun & Siegel, *Thermal Radiation Heat Transfer*, catalogue of configuration factors: B-3
(parallel rectangle), B-4 (perpendicular rectangle), B-14 (parallel disc off the axis), B-16 (sphere).
Baum, Rushmeier & Winget, "Improving radiosity solutions through the use of analytically determined
form-factors", SIGGRAPH 1989: Lambert's polygon clipped at the horizon, in double precision.
Van Oosterom & Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed. Eng. 30(2), 1983.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = [
    "Hidden",
    "closed_room",
    "convex_polyhedron",
    "infinite_wall",
    "parallel_disc",
    "parallel_rectangle",
    "polygon",
    "sphere",
    "standing_rectangle",
]

FloatArray = npt.NDArray[np.float64]


class Hidden(NamedTuple):
    """Occluded fractions of the hemisphere: 0 hides nothing, 1 everything."""

    cosine: float
    uniform: float

    def __add__(self, other: object) -> Hidden:
        """Together, if seen from the point the two do not overlap."""
        if not isinstance(other, Hidden):
            return NotImplemented
        return Hidden(self.cosine + other.cosine, self.uniform + other.uniform)


def closed_room() -> Hidden:
    """All of it: what a point inside a closed surface sees, wherever it is and wherever it faces."""
    return Hidden(1.0, 1.0)


def infinite_wall(distance: float, height: float) -> Hidden:
    """A wall of infinite length that stands on the point's own plane.

    It hides a lune of dihedral angle t = atan(height / distance): (1 - cos t) / 2 of the cosine [the limit
    of Howell B-4, or Lambert's formula with its two infinite edges] and t / pi of the solid angle.
    """
    t = math.atan2(height, distance)
    return Hidden(0.5 * (1.0 - math.cos(t)), t / math.pi)


def standing_rectangle(distance: float, height: float, left: float, right: float) -> Hidden:
    """A wall that stands on the point's plane, from `left` to `right` of the point's foot on it [Howell B-4].

    `left` < `right` are signed positions along the wall, both 0 at the foot of the perpendicular.
    """

    def to_corner(width: float) -> Hidden:
        if width == 0.0:
            return Hidden(0.0, 0.0)
        r = math.hypot(distance, height)
        cosine = (math.atan2(width, distance) - distance / r * math.atan2(width, r)) / (2 * math.pi)
        return Hidden(cosine, _corner_solid_angle(width, height, distance) / (2 * math.pi))

    a, b = to_corner(right), to_corner(left)
    return Hidden(a.cosine - b.cosine, a.uniform - b.uniform)


def parallel_rectangle(height: float, x0: float, x1: float, y0: float, y1: float) -> Hidden:
    """A rectangle at `height` above the point, parallel to its plane [Howell B-3, with signs].

    The point stands under the origin of x and y.
    """

    def to_corner(x: float, y: float) -> Hidden:
        p, q = math.hypot(x, height), math.hypot(y, height)
        cosine = (x / p * math.atan2(y, p) + y / q * math.atan2(x, q)) / (2 * math.pi)
        return Hidden(cosine, _corner_solid_angle(x, y, height) / (2 * math.pi))

    corners = [
        (1, to_corner(x1, y1)),
        (-1, to_corner(x0, y1)),
        (-1, to_corner(x1, y0)),
        (1, to_corner(x0, y0)),
    ]
    return Hidden(sum(s * c.cosine for s, c in corners), sum(s * c.uniform for s, c in corners))


def _corner_solid_angle(a: float, b: float, distance: float) -> float:
    """Of the rectangle [0, a] x [0, b], signed, seen from `distance` before its corner at 0."""
    return math.atan2(a * b, distance * math.sqrt(a * a + b * b + distance * distance))


def parallel_disc(height: float, radius: float, offset: float = 0.0) -> Hidden:
    """A disc at `height` above the point's plane and parallel to it, its axis `offset` away.

    Cosine: Howell B-14. Uniform: elementary on the axis; off it the area inside an elliptical cone is an
    elliptic integral, here a quadrature to about 1e-12.
    """
    h2, r2, a2 = height**2, radius**2, offset**2
    z = h2 + r2 + a2
    # B-14 with numerator and denominator multiplied by the square of the offset, which may then be 0.
    cosine = 0.5 * (1.0 - (h2 + a2 - r2) / math.sqrt(z * z - 4 * a2 * r2))
    if offset == 0.0:
        return Hidden(cosine, 1.0 - height / math.hypot(height, radius))
    from scipy.integrate import quad

    def below(rho: float) -> float:
        return 1.0 - height / math.hypot(height, rho)

    if offset < radius:  # the foot is under the disc: every azimuth meets its rim once

        def ring(phi: float) -> float:
            return below(offset * math.cos(phi) + math.sqrt(r2 - a2 * math.sin(phi) ** 2))

        return Hidden(cosine, quad(ring, 0, math.pi, epsabs=1e-13, epsrel=1e-13)[0] / math.pi)

    def chord(t: float) -> float:
        # sin(phi) = (radius / offset) sin(t) takes out the square roots at the two tangents.
        s = radius / offset * math.sin(t)
        c = math.sqrt(max(0.0, 1.0 - s * s))
        half = radius * math.cos(t)
        middle = offset * c
        return (below(middle + half) - below(middle - half)) * radius / offset * math.cos(t) / c

    return Hidden(cosine, quad(chord, 0, math.pi / 2, epsabs=1e-13, epsrel=1e-13)[0] / math.pi)


def polygon(corners: npt.ArrayLike, point: npt.ArrayLike, normal: npt.ArrayLike) -> Hidden:
    """A plane polygon, clipped at the horizon [Lambert 1760; Baum et al. 1989].

    Half the sum, over its edges, of the angle that the edge subtends times the unit normal of its plane
    with the point, is the integral of w over the polygon; dotted with n, over pi. Either winding.

    Parameters
    ----------
    corners : array_like, shape (m, 3)
        In order; simple, convex or not; the point is not in its plane.
    point, normal : array_like, shape (3,)
        `normal` of unit length.
    """
    n = np.asarray(normal, np.float64)
    relative = np.asarray(corners, np.float64) - np.asarray(point, np.float64)
    above = _clipped(relative, n)
    if len(above) < 3:
        return Hidden(0.0, 0.0)
    ahead = np.roll(above, -1, axis=0)
    axis = np.cross(above, ahead)
    length = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(length, (above * ahead).sum(axis=1))
    unit = axis / np.where(length > 0, length, 1.0)[:, None]
    cosine = abs(0.5 * (angle * (unit @ n)).sum()) / np.pi
    area = sum(_signed_area(above[0], above[i], above[i + 1]) for i in range(1, len(above) - 1))
    return Hidden(float(cosine), abs(area) / (2 * math.pi))


def _clipped(corners: FloatArray, n: FloatArray) -> FloatArray:
    """The part with n.x >= 0 of a polygon [Sutherland & Hodgman 1974]; edges it doubles back on cancel."""
    out = []
    height = corners @ n
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        if height[i] >= 0:
            out.append(corners[i])
        if (height[i] > 0 > height[j]) or (height[i] < 0 < height[j]):
            t = height[i] / (height[i] - height[j])
            x = corners[i] + t * (corners[j] - corners[i])
            out.append(x - (x @ n) * n)
    return np.array(out).reshape(-1, 3)


def _signed_area(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    """Solid angle of a triangle seen from the origin, positive if counter-clockwise from outside."""
    a, b, c = (x / np.linalg.norm(x) for x in (a, b, c))
    return 2.0 * math.atan2(float(np.cross(a, b) @ c), float(1.0 + a @ b + b @ c + c @ a))


def sphere(center: npt.ArrayLike, radius: float, point: npt.ArrayLike, normal: npt.ArrayLike) -> Hidden:
    """A sphere seen from outside: a cap of half angle alpha about an axis at theta from the normal.

    Wholly above the horizon: sin^2(alpha) cos(theta), and 1 - cos(alpha) [Howell B-16]. Cut by it: the
    boundary is an arc of the cap's rim over azimuths +-psi, and an arc of the horizon over +-phi; half the
    integral of n.(w x dw) along both gives the cosine, and Gauss and Bonnet's theorem the area.
    """
    to_center = np.asarray(center, np.float64) - np.asarray(point, np.float64)
    distance = float(np.linalg.norm(to_center))
    if distance <= radius:
        raise ValueError(
            f"the point is {distance} from the center of a sphere of radius {radius}; need outside"
        )
    sin_a = radius / distance
    cos_a = math.sqrt(1.0 - sin_a * sin_a)
    cos_t = float(to_center @ np.asarray(normal, np.float64)) / distance
    sin_t = math.sqrt(max(0.0, 1.0 - cos_t * cos_t))
    if cos_t >= sin_a:
        return Hidden(sin_a * sin_a * cos_t, 1.0 - cos_a)
    if cos_t <= -sin_a:
        return Hidden(0.0, 0.0)
    psi = math.acos(max(-1.0, min(1.0, -cos_a * cos_t / (sin_a * sin_t))))
    phi = math.acos(min(1.0, cos_a / sin_t))
    cosine = psi * sin_a**2 * cos_t - sin_a * cos_a * sin_t * math.sin(psi) + phi
    area = 2.0 * (math.pi - math.acos(cos_t / sin_a)) - 2.0 * psi * cos_a
    return Hidden(cosine / math.pi, area / (2 * math.pi))


def convex_polyhedron(vertices: npt.ArrayLike, point: npt.ArrayLike, normal: npt.ArrayLike) -> Hidden:
    """A convex solid seen from outside: Lambert's polygon over its silhouette.

    Its silhouette is the convex hull of its vertices in a central projection, onto a plane before which
    the whole solid lies: that of the facet which the point is farthest in front of.

    Parameters
    ----------
    vertices : array_like, shape (m, 3)
        Any points whose hull is the solid.
    point, normal : array_like, shape (3,)
        `point` strictly outside; `normal` of unit length.
    """
    from scipy.spatial import ConvexHull

    v = np.asarray(vertices, np.float64)
    p = np.asarray(point, np.float64)
    planes = ConvexHull(v).equations
    distance = planes[:, :3] @ p + planes[:, 3]
    best = int(distance.argmax())
    if distance[best] <= 0:
        raise ValueError("the point is not outside the polyhedron")
    axis = -planes[best, :3]
    side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    side /= np.linalg.norm(side)
    relative = v - p
    depth = relative @ axis
    flat = np.column_stack([relative @ side, relative @ np.cross(axis, side)]) / depth[:, None]
    outline = ConvexHull(flat).vertices
    # The hull's corners span one cone, whatever their depth; on the plane they form one plane polygon.
    return polygon(relative[outline] / depth[outline, None], np.zeros(3), normal)
