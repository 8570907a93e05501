"""Start counts of radial isolines: the surfaces that the axis of a shade point meets.

A face covers the zenith or the nadir when its edges' signed spans wind once round the axis. On every line its
crossings then add up to -1 or +1, with the very sides and sectors that the sweep counts with: -1 is a
surface that lies at the zenith and ends along the line. No intersection is computed, and counts and crossings
cannot disagree.
"""

from __future__ import annotations

from numba import njit

from silint.core.caps import meets_axis_near, plane_towards
from silint.core.contour import plane_side
from silint.core.jit import INNER
from silint.core.radial import in_frame, local_vertex, sector, span


@njit(**INNER)
def zenith_count(geometry, face_ids, n_along, p, n, frame, n_lines, rounding):
    """W at the zenith of a shade point, from the faces along its axis (along.faces_along)."""
    vertices, faces, face_planes = geometry.vertices, geometry.faces, geometry.face_planes
    planes, plane_errors = geometry.planes, geometry.plane_errors
    count = 0
    for i in range(n_along):
        count += covers_zenith(
            vertices, faces, face_planes, planes, plane_errors, face_ids[i], p, n, frame, n_lines, rounding
        )
    return count


@njit(**INNER)
def near_zenith_counts(geometry, face_ids, n_along, p, n, frame, reach, rounding, counts):
    """The same within the reach of each line: counts (K,) int32."""
    vertices, faces, face_planes = geometry.vertices, geometry.faces, geometry.face_planes
    planes, plane_errors = geometry.planes, geometry.plane_errors
    counts[:] = 0
    for i in range(n_along):
        f = face_ids[i]
        if covers_zenith(
            vertices, faces, face_planes, planes, plane_errors, f, p, n, frame, len(reach), rounding
        ):
            height, (_, _, along) = plane_towards(face_planes, planes, f, p, frame)
            for k in range(len(reach)):
                counts[k] += int(meets_axis_near(height, along, reach[k]))


@njit(**INNER)
def covers_zenith(vertices, faces, face_planes, planes, plane_errors, f, p, n, frame, n_lines, rounding):
    """1 where a face winds round the axis and leaves the depth count as lines run down, else 0."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    at, am, _, _ = local_vertex(vertices, a, p, n, frame)
    bt, bm, _, _ = local_vertex(vertices, b, p, n, frame)
    ct, cm, _, _ = local_vertex(vertices, c, p, n, frame)
    # Clearly beside the axis.
    if (
        min(at, bt, ct) > rounding
        or max(at, bt, ct) < -rounding
        or min(am, bm, cm) > rounding
        or max(am, bm, cm) < -rounding
    ):
        return 0
    sa, sb, sc = sector(at, am, n_lines), sector(bt, bm, n_lines), sector(ct, cm, n_lines)
    winding = _signed_span(vertices, a, b, at, am, bt, bm, sa, sb, frame, n_lines)
    winding += _signed_span(vertices, b, c, bt, bm, ct, cm, sb, sc, frame, n_lines)
    winding += _signed_span(vertices, c, a, ct, cm, at, am, sc, sa, frame, n_lines)
    if winding == 0:
        return 0
    code = face_planes[f]
    k = max(code, ~code)
    front = (plane_side(planes, k, plane_errors[k] + rounding, p, n) > 0) == (code >= 0)
    return 1 if (winding < 0) == front else 0


@njit(**INNER)
def _signed_span(vertices, a, b, at, am, bt, bm, sector_a, sector_b, frame, n_lines):
    """Lines from a to b, negative to the right; counted from the lower vertex on, as crossings are."""
    if a > b:
        return -_signed_span_up(vertices, b, a, bt, bm, sector_b, sector_a, frame, n_lines)
    return _signed_span_up(vertices, a, b, at, am, sector_a, sector_b, frame, n_lines)


@njit(**INNER)
def _signed_span_up(vertices, a, b, at, am, sector_a, sector_b, frame, n_lines):
    et, em, _ = in_frame(
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
        frame,
    )
    # N_A as in radial.edge_circle.
    _, steps, left = span(sector_a, sector_b, at * em - am * et, n_lines)
    return steps if left else -steps
