"""Closed forms over the visible region from its boundary arcs: fractions, solid angle, bent normals, sky.

An arc runs from a to b with the visible side on its left, N is the unit normal of its plane on that side, and
s is its length, all of them arcs of a hemisphere about n. Sums over the boundary of the visible region V, in
any order (docs/exact.md derives them):

    int_V w dw     = 1/2 sum s N                                               [Lam60]
    int_V dw       = sum of the signed spherical triangles (n, a, b)           [VOS83]
    int_V w w^T dw = 1/3 (int_V dw) 1 + 1/6 sum (N c^T + c N^T),               [Arv95]
                     c = int w along the arc = N x (a - b)

N is not computed again from a and b, which do not determine it where an arc is tiny or almost pi; and what
vanishes with an arc (s, c, its triangle) is computed from the difference b - a, which is exact where a and b
are close. An arc errs by rounding times its length, however short it is.

A boundary is closed, so the b - a of a point's arcs sum to zero. How far they do not, the gap, is what an
arc that is missing or displaced leaves behind, and the error estimates are made of it.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from silint.core.arcs_types import Arcs
from silint.core.jit import INNER, PARALLEL
from silint.core.radial import azimuth
from silint.core.small_circle import cross, dot

# A sum over 64 arcs is rounded by less than this, over more by more as the square root: measured against
# sums in extended precision, 7e-16 for 60 arcs and 3e-15 for 1300.
ROUNDING = 1e-15
_FEW = 64

# A horizon whose stretches add up to a turn within this is whole; sums over thousands of arcs are better.
_TURN_TOLERANCE = 1e-9

# Sine squared of the angle between two horizons that are one: a lune between them has n.w below 1e-8, and
# less than its square of the integral of n.w.
_PARALLEL = 1e-16

# Squared distance from the axis within which a direction has no azimuth.
_ON_AXIS = 1e-18


@njit(**INNER)
def arc(directions, row):
    """Start, plane normal and end less start of an arc."""
    a = directions[row, 0], directions[row, 1], directions[row, 2]
    normal = directions[row, 6], directions[row, 7], directions[row, 8]
    chord = directions[row, 3] - a[0], directions[row, 4] - a[1], directions[row, 5] - a[2]
    return a, normal, chord


@njit(**INNER)
def _sine_cosine(a, normal, chord):
    """Sine and cosine of an arc's length; the sine is negative where rounding swapped the ends."""
    sine = dot(normal, cross(a, chord))  # a x b = a x (b - a)
    cosine = 1.0 - 0.5 * dot(chord, chord)
    if cosine < 0.0 and sine < 0.0:
        sine = 0.0  # rounding made an arc longer than pi
    return sine, cosine


@njit(**INNER)
def angle(sine, cosine):
    """Angle in [-pi, pi], as arctan2."""
    return azimuth(cosine, sine) if sine >= 0.0 else -azimuth(cosine, -sine)


@njit(**INNER)
def arc_length(a, normal, chord):
    """Length of an arc, negative where rounding swapped the ends."""
    sine, cosine = _sine_cosine(a, normal, chord)
    return angle(sine, cosine)


@njit(**INNER)
def triangle(a, normal, chord, n):
    """Signed solid angle of the spherical triangle (n, a, b), and c of the module's docstring.

    tan(triangle / 2) = a x b.n / (1 + a.b + (a + b).n) [VOS83], with sin(s) N for a x b. Both sides vanish
    as s becomes pi; with m the middle of the arc they are 2 cos(s/2) times those of sin(s/2) N.n / (cos(s/2)
    + m.n), which do not, and which are multiplied by 2 sin(s/2) here. That in turn fails for tiny arcs,
    whose chord is rounding and has any direction.
    """
    sine, cosine = _sine_cosine(a, normal, chord)
    c = cross(chord, normal)  # 2 sin(s/2) m
    if cosine > 0.0:
        over, under = sine * dot(normal, n), 1.0 + cosine + 2.0 * dot(a, n) + dot(chord, n)
    else:
        over, under = (1.0 - cosine) * dot(normal, n), sine + dot(c, n)
    return 2.0 * angle(over, under), c


@njit(**PARALLEL)
def sum_lengths(counts, starts, directions, out):
    """Vector irradiance int_V w dw of each point: out (n, 3)."""
    for i in prange(len(counts)):
        x, y, z = 0.0, 0.0, 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            half = 0.5 * arc_length(a, normal, chord)
            x += half * normal[0]
            y += half * normal[1]
            z += half * normal[2]
        out[i, 0], out[i, 1], out[i, 2] = x, y, z


@njit(**PARALLEL)
def sum_triangles(normals, counts, starts, directions, out):
    """Solid angle int_V dw of each point: out (n,).

    V and all triangles lie in the hemisphere of n, whose every region has one solid angle: nothing is lost
    by whole spheres.
    """
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        total = 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            solid, _ = triangle(a, normal, chord, n)
            total += solid
        out[i] = total


@njit(**PARALLEL)
def sum_moments(normals, counts, starts, directions, out):
    """int_V (n.w) w dw of each point: out (n, 3)."""
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        total = 0.0
        x, y, z = 0.0, 0.0, 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            a, normal, chord = arc(directions, row)
            solid, c = triangle(a, normal, chord, n)
            total += solid
            cn, nn = dot(c, n), dot(normal, n)
            x += normal[0] * cn + c[0] * nn
            y += normal[1] * cn + c[1] * nn
            z += normal[2] * cn + c[2] * nn
        out[i, 0] = total / 3.0 * n[0] + x / 6.0
        out[i, 1] = total / 3.0 * n[1] + y / 6.0
        out[i, 2] = total / 3.0 * n[2] + z / 6.0


@njit(**PARALLEL)
def sum_chords(counts, starts, directions, out):
    """Length of the sum of all b - a of each point, which closed boundaries leave at rounding: out (n,)."""
    for i in prange(len(counts)):
        x, y, z = 0.0, 0.0, 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            x += directions[row, 3] - directions[row, 0]
            y += directions[row, 4] - directions[row, 1]
            z += directions[row, 5] - directions[row, 2]
        out[i] = np.sqrt(x * x + y * y + z * z)


@njit(**PARALLEL)
def find_open(counts, starts, directions, edges, out):
    """Whether a point's boundary is the whole horizon and nothing else: out (n,) bool."""
    for i in prange(len(counts)):
        turn = 0.0
        for row in range(starts[i], starts[i] + counts[i]):
            if edges[row, 0] != -1:
                turn = 0.0
                break
            a, normal, chord = arc(directions, row)
            turn += arc_length(a, normal, chord)
        out[i] = abs(turn - 2.0 * np.pi) < _TURN_TOLERANCE


# ------------------------------------------------------------------------------------ above a second horizon


@njit(**INNER)
def _turn(x, y, frame):
    """e^(i (azimuth of y - azimuth of x)) about the axis frame[2], times any factor; 0 has azimuth 0."""
    xr = frame[0, 0] * x[0] + frame[0, 1] * x[1] + frame[0, 2] * x[2]
    xi = frame[1, 0] * x[0] + frame[1, 1] * x[1] + frame[1, 2] * x[2]
    yr = frame[0, 0] * y[0] + frame[0, 1] * y[1] + frame[0, 2] * y[2]
    yi = frame[1, 0] * y[0] + frame[1, 1] * y[1] + frame[1, 2] * y[2]
    if xr * xr + xi * xi < _ON_AXIS:
        xr, xi = 1.0, 0.0
    if yr * yr + yi * yi < _ON_AXIS:
        yr, yi = 1.0, 0.0
    return yr * xr + yi * xi, yi * xr - yr * xi


@njit(**INNER)
def _cut(a, b, za, zb):
    """Where an arc shorter than a quarter turn meets a plane, from the heights of its ends over it."""
    s, t = abs(zb), abs(za)
    x, y, z = s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    return scale * x, scale * y, scale * z


@njit(**INNER)
def _above(a, b, normal, frame):
    """Length of the part of an arc above the plane, and the turn about its axis.

    Parameters
    ----------
    a, b, normal : (3,) tuples
        An arc of at most a quarter turn.
    frame : (3, 3) float64
        Rows: two axes in the plane, and its normal.
    """
    za = frame[2, 0] * a[0] + frame[2, 1] * a[1] + frame[2, 2] * a[2]
    zb = frame[2, 0] * b[0] + frame[2, 1] * b[1] + frame[2, 2] * b[2]
    if za <= 0.0 and zb <= 0.0:
        return 0.0, 1.0, 0.0
    if za <= 0.0:
        a = _cut(a, b, za, zb)
    elif zb <= 0.0:
        b = _cut(a, b, za, zb)
    real, imaginary = _turn(a, b, frame)
    return arc_length(a, normal, (b[0] - a[0], b[1] - a[1], b[2] - a[2])), real, imaginary


@njit(**INNER)
def _middle(a, normal, chord):
    """Middle of an arc that is not tiny."""
    c = cross(chord, normal)
    scale = 1.0 / np.sqrt(dot(c, c))
    return scale * c[0], scale * c[1], scale * c[2]


@njit(**INNER)
def _sky(n, frame, first, count, directions):
    """int n.w dw over the part of V above the plane of frame."""
    total = 0.0
    real, imaginary = 1.0, 0.0  # e^(i sum of the turns)
    for row in range(first, first + count):
        a, normal, chord = arc(directions, row)
        b = directions[row, 3], directions[row, 4], directions[row, 5]
        nn = dot(n, normal)
        middle = b
        if dot(chord, chord) > 2.0:  # more than a quarter turn
            middle = _middle(a, normal, chord)
            length, re, im = _above(middle, b, normal, frame)
            total += 0.5 * length * nn
            real, imaginary = real * re - imaginary * im, real * im + imaginary * re
        length, re, im = _above(a, middle, normal, frame)
        total += 0.5 * length * nn
        real, imaginary = real * re - imaginary * im, real * im + imaginary * re
        scale = 1.0 / (abs(real) + abs(imaginary))
        real, imaginary = scale * real, scale * imaginary
    # The stretches of the plane's circle inside V turn about the axis as well, and all turns together close.
    # They lie within the half circle that is above the horizon: 0 <= stretches <= pi.
    stretches = -angle(imaginary, real)
    if stretches < -0.5 * np.pi:
        stretches += 2.0 * np.pi
    up = n[0] * frame[2, 0] + n[1] * frame[2, 1] + n[2] * frame[2, 2]
    return total + 0.5 * up * stretches


@njit(**PARALLEL)
def sum_sky(normals, frame, counts, starts, directions, out):
    """int_V n.w [up.w > 0] dw of each point.

    Parameters
    ----------
    normals : (n, 3) float64
    frame : (3, 3) float64
        Orthonormal rows, the last one up.
    counts, starts, directions
        Of Arcs.
    out : (n,) float64, out
    """
    for i in prange(len(counts)):
        n = normals[i, 0], normals[i, 1], normals[i, 2]
        up = frame[2, 0], frame[2, 1], frame[2, 2]
        across = cross(n, up)
        if dot(across, across) >= _PARALLEL:
            out[i] = _sky(n, frame, starts[i], counts[i], directions)
            continue
        total = 0.0  # one horizon: all of V is sky, or none
        if dot(n, up) > 0.0:
            for row in range(starts[i], starts[i] + counts[i]):
                a, normal, chord = arc(directions, row)
                total += 0.5 * arc_length(a, normal, chord) * dot(n, normal)
        out[i] = total


# ------------------------------------------------------------------------------------------------ integrands


def vector_irradiance(arcs: Arcs) -> np.ndarray:
    """int_V w dw: (n, 3) float64."""
    out = np.empty((len(arcs.counts), 3))
    sum_lengths(arcs.counts, arcs.starts, arcs.directions, out)
    return out


def solid_angle(arcs: Arcs) -> np.ndarray:
    """int_V dw, in steradians: (n,) float64."""
    out = np.empty(len(arcs.counts))
    sum_triangles(arcs.normals, arcs.counts, arcs.starts, arcs.directions, out)
    return out


def closure_gap(arcs: Arcs) -> np.ndarray:
    """How far each point's boundary is from closed: (n,) float64, a chord, 0 to rounding."""
    out = np.empty(len(arcs.counts))
    sum_chords(arcs.counts, arcs.starts, arcs.directions, out)
    return out


def is_open(arcs: Arcs) -> np.ndarray:
    """Points whose boundary is the horizon alone: (n,) bool. Their values are known without rounding."""
    out = np.empty(len(arcs.counts), np.bool_)
    find_open(arcs.counts, arcs.starts, arcs.directions, arcs.edges, out)
    return out


def hemisphere_fraction(arcs: Arcs, weighting: str) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) dw for "cosine", (1/2pi) int V dw over the hemisphere for "uniform".

    Returns
    -------
    value, error_estimate : (n,) float64
        Exactly 1 under an open sky and exactly 0 where nothing is visible. The estimate is rounding, plus
        what an arc of the gap's length would contribute, plus what had to be clipped.
    """
    if weighting == "cosine":
        value = _along(vector_irradiance(arcs), arcs.normals.T) / np.pi
    else:
        value = solid_angle(arcs) / (2.0 * np.pi)
    return as_fraction(value, np.ones(len(value)), arcs)


def sky_view_factor(arcs: Arcs, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) [up.w > 0] dw, whose open value is (1 + n.up) / 2.

    Returns
    -------
    value, error_estimate : (n,) float64
        As of `hemisphere_fraction`, except that an arc missing close to up does more harm than its length.
    """
    value = np.empty(len(arcs.counts))
    sum_sky(arcs.normals, frame_of(up), arcs.counts, arcs.starts, arcs.directions, value)
    return as_fraction(value / np.pi, np.clip(0.5 * (1.0 + _along(arcs.normals, up)), 0.0, 1.0), arcs)


def bent_normal(arcs: Arcs) -> tuple[np.ndarray, np.ndarray]:
    """(1/pi) int V max(n.w, 0) w dw: (n, 3), 2/3 n under an open sky; the estimate is that of its length."""
    value = np.empty((len(arcs.counts), 3))
    sum_moments(arcs.normals, arcs.counts, arcs.starts, arcs.directions, value)
    value /= np.pi
    whole = is_open(arcs)
    value[whole] = (2.0 / 3.0) * arcs.normals[whole]
    return value, error_of_gap(arcs)


def _along(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Products of rows with an axis, written out: the same bits whatever the number of rows."""
    along: np.ndarray = vectors[:, 0] * axis[0] + vectors[:, 1] * axis[1] + vectors[:, 2] * axis[2]
    return along


def frame_of(up: np.ndarray) -> np.ndarray:
    """Orthonormal rows, the last one a unit vector: (3, 3) float64."""
    least = np.zeros(3)
    least[np.argmin(np.abs(up))] = 1.0
    first = np.cross(up, least)
    first /= np.sqrt(first @ first)
    return np.stack([first, np.cross(up, first), up])


def rounding(arcs: Arcs) -> np.ndarray:
    """What rounding may make of a sum of fractions: (n,) float64."""
    grown: np.ndarray = ROUNDING * np.sqrt(1.0 + arcs.counts / _FEW)
    return grown


def error_of_gap(arcs: Arcs) -> np.ndarray:
    """Error estimate of fractions: (n,) float64.

    An arc of length s adds at most s / 2 pi to any of them, and s is at most pi / 2 times its chord.
    """
    estimate: np.ndarray = rounding(arcs) + 0.25 * closure_gap(arcs)
    return np.minimum(estimate, 1.0)


def as_fraction(value: np.ndarray, open_value: np.ndarray, arcs: Arcs) -> tuple[np.ndarray, np.ndarray]:
    """Values in [0, open value] with their estimates; what is clipped is in the estimate."""
    whole = is_open(arcs)
    value[whole] = open_value[whole]
    clipped = np.clip(value, 0.0, open_value)
    return clipped, np.minimum(error_of_gap(arcs) + np.abs(value - clipped), 1.0)
