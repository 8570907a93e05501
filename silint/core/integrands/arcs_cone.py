"""The visible fraction of a cone about the normal, from boundary arcs.

With F(theta) the integral of the weight over [0, theta], the integral over the part of V within the cone is
the contour integral of min(F(theta), F(spread)) dphi about the normal: inside the cone an arc counts as in
`arcs`, outside it counts F(spread) times its turn about the normal. For n.w, F = sin^2(theta) / 2; for solid
angle, F = 1 - cos(theta).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs as along_arcs
from silint.core.integrands.arcs import angle, arc, arc_length, error_of_gap, triangle
from silint.core.jit import INNER, PARALLEL
from silint.core.small_circle import cross, dot


@njit(**INNER)
def _inside(a, normal, chord, n, uniform):
    """What an arc inside the cone counts."""
    if uniform:
        solid, _ = triangle(a, normal, chord, n)
        return solid
    return 0.5 * arc_length(a, normal, chord) * dot(n, normal)


@njit(**INNER)
def _turn(a, normal, chord, n):
    """Turn about n of an arc that does not pass through n."""
    b = a[0] + chord[0], a[1] + chord[1], a[2] + chord[2]
    # a x b = a x (b - a) lies along the plane's normal, and a.b = 1 - |b - a|^2 / 2.
    sine = dot(normal, cross(a, chord))
    return angle(sine * dot(n, normal), 1.0 - 0.5 * dot(chord, chord) - dot(n, a) * dot(n, b))


@njit(**INNER)
def _between(a, b):
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]


@njit(**INNER)
def _arc_in_cone(a, b, normal, chord, n, cosine, whole, uniform):
    """What an arc counts; `whole` is F(spread)."""
    if dot(n, a) >= cosine and dot(n, b) >= cosine:
        return _inside(a, normal, chord, n, uniform)
    tilt = dot(n, normal)
    across = cross(normal, n)
    top = np.sqrt(dot(across, across))  # the cosine of the angle between n and the arc's great circle
    if top <= cosine:
        return whole * _turn(a, normal, chord, n)
    # The great circle is cos(psi) c + sin(psi) d, highest at psi = 0, and in the cone for |psi| < half.
    c = (n[0] - tilt * normal[0]) / top, (n[1] - tilt * normal[1]) / top, (n[2] - tilt * normal[2]) / top
    d = across[0] / top, across[1] / top, across[2] / top
    psi_a = np.arctan2(dot(d, a), dot(c, a))
    psi_b = np.arctan2(dot(d, b), dot(c, b))
    x, y = cosine / top, np.sqrt((top - cosine) * (top + cosine)) / top
    half = np.arctan2(y, x)
    if psi_a >= half or psi_b <= -half:
        return whole * _turn(a, normal, chord, n)
    total = 0.0
    if psi_a < -half:
        cut = x * c[0] - y * d[0], x * c[1] - y * d[1], x * c[2] - y * d[2]
        total += whole * _turn(a, normal, _between(a, cut), n)
        a = cut
    if psi_b > half:
        cut = x * c[0] + y * d[0], x * c[1] + y * d[1], x * c[2] + y * d[2]
        total += whole * _turn(cut, normal, _between(cut, b), n)
        b = cut
    return total + _inside(a, normal, _between(a, b), n, uniform)


@njit(**PARALLEL)
def sum_in_cone(normals, counts, starts, directions, cosine, uniform, out):
    """int n.w dw, or the solid angle, of V where n.w > cosine: out (n,)."""
    whole = 1.0 - cosine if uniform else 0.5 * (1.0 - cosine * cosine)
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        total = 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            b = directions[row, 3], directions[row, 4], directions[row, 5]
            total += _arc_in_cone(a, b, normal, chord, n, cosine, whole, uniform)
        out[i] = total


def cone_fraction(arcs: Arcs, weighting: str, cosine: float) -> tuple[np.ndarray, np.ndarray]:
    """Visible share of the cone n.w > cosine, weighted with n.w ("cosine") or evenly ("uniform").

    Returns
    -------
    value, error_estimate : (n,) float64
        As of `arcs.hemisphere_fraction`, over the share of the hemisphere that the cone has.
    """
    if cosine == 0.0:
        return along_arcs.hemisphere_fraction(arcs, weighting)
    uniform = weighting == "uniform"
    value = np.empty(len(arcs.counts))
    sum_in_cone(arcs.normals, arcs.counts, arcs.starts, arcs.directions, cosine, uniform, value)
    square = (1.0 - cosine) * (1.0 + cosine)
    value /= 2.0 * np.pi * (1.0 - cosine) if uniform else np.pi * square
    value[along_arcs.is_open(arcs)] = 1.0
    clipped = np.clip(value, 0.0, 1.0)
    return clipped, np.minimum(error_of_gap(arcs) / square + np.abs(value - clipped), 1.0)
