"""Welded topology: vertices by position, edges with all their faces, one plane per flat region.

Nothing is repaired. Faces keep their winding; an edge keeps every face with the direction in which
that face runs along it, so that the jump of the depth count across any edge is a plain sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from silint.core.jit import INNER, KERNEL

ULP = 2.0**-53  # half the spacing of float64 just below 1; every stored coordinate is below 1

NO_PLANE = np.iinfo(np.int32).min  # the code of a face whose region is not known yet


class Topology(NamedTuple):
    """A triangle scene as the kernels see it, in units of the scaled scene.

    A *code* is an index with a direction: ``i`` along, ``~i`` against.
    """

    vertices: np.ndarray  # (V, 3) float64, distinct positions in lexicographic order
    faces: np.ndarray  # (F, 3) int32, file order; faces with two equal vertices are left out
    face_planes: np.ndarray  # (F,) int32 codes into planes
    planes: np.ndarray  # (P, 4) float64: unit normal N and d; N.x + d > 0 in front
    plane_errors: np.ndarray  # (P,) float64: how far a vertex of a face may lie off its plane


class Edges(NamedTuple):
    """How the faces of a topology meet: 30 bytes a triangle that only those who build hierarchies need."""

    ends: np.ndarray  # (E, 2) int32 vertices, lower first; in lexicographic order
    offsets: np.ndarray  # (E + 1,) int32 into faces
    faces: np.ndarray  # (3 F,) int32 codes: ~f where face f runs from the upper vertex to the lower


class Welding(NamedTuple):
    """How the file's vertices and faces map to the topology's."""

    vertex_map: np.ndarray  # (file vertices,) int32: topology vertex
    face_map: np.ndarray  # (F,) int32: file face of each topology face
    exponent: int  # topology coordinates = file coordinates * 2**-exponent


def build_topology(vertices: np.ndarray, faces: np.ndarray) -> tuple[Topology, Welding, dict[str, int]]:
    """Weld, connect and classify a mesh.

    Parameters
    ----------
    vertices : (n, 3) float64, finite
    faces : (m, 3) int32, in range

    Returns
    -------
    topology, welding, defects
        ``defects`` counts what a modeller would want to know; see `Scene.defects`.
    """
    largest = max(vertices.max(), -vertices.min())
    exponent = int(np.frexp(largest)[1])
    scaled = np.ldexp(vertices, -exponent)
    scaled += 0.0  # turns -0 into +0, so both weld
    positions, vertex_map = _weld(scaled)
    del scaled

    welded = vertex_map[faces]
    a, b, c = welded.T
    distinct = (a != b) & (b != c) & (c != a)
    face_map = np.flatnonzero(distinct).astype(np.int32)
    if len(face_map) < len(welded):
        welded = welded[face_map]

    edges, across = _connect(welded, len(positions))
    own_planes, areas = _face_planes(positions, welded)
    by_area = np.argsort(-areas, kind="stable")
    face_planes = np.full(len(welded), NO_PLANE, dtype=np.int32)
    seeds = np.empty(len(welded), dtype=np.int32)
    n_planes = _share_planes(positions, welded, own_planes, by_area, across, edges, face_planes, seeds)
    planes = own_planes[seeds[:n_planes]]
    plane_errors = _largest_distances(positions, welded, face_planes, planes)
    plane_errors += 4.0 * ULP  # the rounding of measuring them

    boundary, non_manifold, inconsistent, duplicate = _count_defects(welded, edges)
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    defects = {
        "boundary_edges": int(boundary),
        "non_manifold_edges": int(non_manifold),
        "inconsistent_edges": int(inconsistent),
        "duplicate_faces": int(duplicate),
        "zero_area_faces": int(len(faces) - len(welded) + (areas == 0.0).sum()),
        "unreferenced_vertices": int((~used).sum()),
        "welded_vertices": int(len(vertices) - len(positions)),
    }
    topology = Topology(positions, welded, face_planes, planes, plane_errors)
    return topology, Welding(vertex_map, face_map, exponent), defects


def edges_of(topology: Topology) -> Edges:
    """The edges, found once more: that is quick, and keeping them would cost half as much as the topology."""
    return _connect(topology.faces, len(topology.vertices))[0]


def _weld(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct positions, and for each vertex the index of its position.

    Lexicographic numbering makes the direction of every edge, and so every rounding along it,
    independent of the order of the file.
    """
    order = _ascending(*np.ascontiguousarray(vertices.T))
    ordered = vertices[order]
    first = np.ones(len(vertices), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    vertex_map = np.empty(len(vertices), dtype=np.int32)
    vertex_map[order] = np.cumsum(first, dtype=np.int32) - 1
    return ordered if first.all() else ordered[first], vertex_map


def _ascending(key: np.ndarray, *further: np.ndarray) -> np.ndarray:
    """Lexicographic order by several keys; all but the first are compared only where it ties."""
    order = np.argsort(key)
    ordered = key[order]
    equal = ordered[1:] == ordered[:-1]
    tied = np.zeros(len(key), dtype=bool)
    tied[1:] = equal
    tied[:-1] |= equal
    rows = order[tied]
    order[tied] = rows[np.lexsort((*(k[rows] for k in further[::-1]), ordered[tied]))]
    return order


def _connect(faces: np.ndarray, n_vertices: int) -> tuple[Edges, np.ndarray]:
    """Edges with the faces along each; and what is across each side of each face.

    That is a face where there is just one, else ~e for the edge e.
    """
    n = 3 * len(faces)
    keys = np.empty(n, dtype=np.int64)
    codes, across = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    ends, offsets = np.empty((n, 2), dtype=np.int32), np.empty(n + 1, dtype=np.int32)
    n_edges = _join_sides(faces, np.zeros(n_vertices, dtype=np.int32), keys, codes, ends, offsets, across)
    return Edges(ends[:n_edges].copy(), offsets[: n_edges + 1].copy(), codes), across.reshape(-1, 3)


@njit(**KERNEL)
def _join_sides(faces, place, keys, codes, ends, offsets, across):
    # Collect the sides under their lower vertices: upper vertex, side, direction packed into one key.
    for f in range(len(faces)):
        for i in range(3):
            place[min(faces[f, i], faces[f, (i + 1) % 3])] += 1
    total = 0
    for v in range(len(place)):
        place[v], total = total, total + place[v]
    for f in range(len(faces)):
        for i in range(3):
            a, b = faces[f, i], faces[f, (i + 1) % 3]
            lower, upper = min(a, b), np.int64(max(a, b))
            keys[place[lower]] = upper << 32 | (3 * f + i) << 1 | (b < a)
            place[lower] += 1

    e, first = -1, 0
    for lower in range(len(place)):
        last = place[lower]
        _sort(keys, first, last)
        for i in range(first, last):
            # Equal upper vertices share an edge.
            upper = keys[i] >> 32
            side = (keys[i] & 0xFFFFFFFF) >> 1
            f = side // 3
            codes[i] = ~f if keys[i] & 1 else f
            if i == first or upper != ends[e, 1]:
                e += 1
                ends[e, 0], ends[e, 1], offsets[e] = lower, upper, i
            across[side] = ~e
            if i == offsets[e] + 1:
                before = (keys[i - 1] & 0xFFFFFFFF) >> 1
                across[side], across[before] = before // 3, f
            elif i == offsets[e] + 2:
                for j in range(offsets[e], i):
                    across[(keys[j] & 0xFFFFFFFF) >> 1] = ~e
        first = last
    offsets[e + 1] = len(keys)
    return e + 1


@njit(**INNER)
def _sort(keys, first, last):
    """Sort the few keys of one vertex, or the many (Shell's sort with Knuth's gaps)."""
    gap = 1
    while gap < (last - first) // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(first + gap, last):
            key, j = keys[i], i
            while j >= first + gap and keys[j - gap] > key:
                keys[j] = keys[j - gap]
                j -= gap
            keys[j] = key
        gap //= 3


@njit(**KERNEL)
def _face_planes(vertices, faces):
    """Unit plane and twice the area of every face.

    The cross product is taken at the vertex opposite the longest side, where it cancels least. A face
    without area keeps its edges connected; any normal perpendicular to its longest side will do.
    """
    n = len(faces)
    planes, areas = np.empty((n, 4)), np.empty(n)
    for f in range(n):
        opposite, longest = 0, -1.0
        for i in range(3):
            u, v = faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
            square = 0.0
            for axis in range(3):
                square += (vertices[v, axis] - vertices[u, axis]) ** 2
            if square > longest:
                opposite, longest = i, square
        a, b, c = faces[f, opposite], faces[f, (opposite + 1) % 3], faces[f, (opposite + 2) % 3]
        ex, ey, ez = _difference(vertices, a, b)
        gx, gy, gz = _difference(vertices, a, c)
        # Scale before multiplying: sides of 1e-160 would underflow.
        size = max(max(abs(ex), abs(ey), abs(ez)), max(abs(gx), abs(gy), abs(gz)))
        ex, ey, ez = ex / size, ey / size, ez / size
        gx, gy, gz = gx / size, gy / size, gz / size
        nx, ny, nz = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        areas[f] = length * size**2
        if length == 0.0:
            sx, sy, sz = ex - gx, ey - gy, ez - gz
            if abs(sx) <= max(abs(sy), abs(sz)):
                nx, ny, nz = 0.0, sz, -sy
            else:
                nx, ny, nz = sy, -sx, 0.0
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / length, ny / length, nz / length
        offset = 0.0
        for i in range(3):
            offset += _along(vertices, faces[f, i], nx, ny, nz)
        planes[f, 0], planes[f, 1], planes[f, 2], planes[f, 3] = nx, ny, nz, -offset / 3.0
    return planes, areas


@njit(**INNER)
def _difference(vertices, a, b):
    return (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )


@njit(**INNER)
def _along(vertices, v, x, y, z):
    # The order is arbitrary, but one and the same for a plane's offset and its errors.
    return (vertices[v, 0] * x + vertices[v, 2] * z) + vertices[v, 1] * y


@njit(**INNER)
def _is_flat(vertices, faces, f, px, py, pz, pd):
    """Whether the three vertices of a face lie within 4 ulp of a plane."""
    for i in range(3):
        v = faces[f, i]
        if not abs(px * vertices[v, 0] + py * vertices[v, 1] + pz * vertices[v, 2] + pd) <= 8.0 * ULP:
            return False
    return True


@njit(**KERNEL)
def _share_planes(vertices, faces, planes, by_area, across, edges, code, seeds):
    """Grow flat regions from the largest faces; every face gets the code of its region's plane.

    A face joins when its three vertices lie within 4 ulp of the *seed's* plane: comparing with the
    neighbour instead would let a gently curved surface chain into one plane.
    """
    stack = np.empty(len(faces), np.int32)
    one = np.empty(1, np.int32)  # the only face across a side
    n_planes = 0
    for s in by_area:
        if code[s] != NO_PLANE:
            continue
        seeds[n_planes] = s
        code[s] = n_planes
        px, py, pz, pd = planes[s, 0], planes[s, 1], planes[s, 2], planes[s, 3]
        stack[0] = s
        top = 1
        while top > 0:
            top -= 1
            f = stack[top]
            for i in range(3):
                one[0] = across[f, i]
                near = one
                if one[0] < 0:
                    near = edges.faces[edges.offsets[~one[0]] : edges.offsets[~one[0] + 1]]
                for g in near:
                    g = max(g, ~g)
                    if code[g] == NO_PLANE and _is_flat(vertices, faces, g, px, py, pz, pd):
                        along = px * planes[g, 0] + py * planes[g, 1] + pz * planes[g, 2]
                        code[g] = n_planes if along >= 0.0 else ~n_planes
                        stack[top] = g
                        top += 1
        n_planes += 1
    return n_planes


@njit(**KERNEL)
def _largest_distances(vertices, faces, face_planes, planes):
    """The largest distance of a face's vertices from each plane."""
    errors = np.zeros(len(planes))
    for f in range(len(faces)):
        k = max(face_planes[f], ~face_planes[f])
        for i in range(3):
            r = _along(vertices, faces[f, i], planes[k, 0], planes[k, 1], planes[k, 2]) + planes[k, 3]
            errors[k] = max(errors[k], abs(r))
    return errors


@njit(**KERNEL)
def _count_defects(faces, edges):
    """Edges with one face, with many, with two that run the same way; faces whose three vertices already
    belong to another, in any winding.
    """
    boundary, non_manifold, inconsistent, duplicate = 0, 0, 0, 0
    for e in range(len(edges.ends)):
        lo, hi = edges.offsets[e], edges.offsets[e + 1]
        boundary += hi - lo == 1
        non_manifold += hi - lo > 2
        inconsistent += hi - lo == 2 and (edges.faces[lo] < 0) == (edges.faces[lo + 1] < 0)
        if hi - lo < 2:
            continue
        for j in range(lo, hi):
            apex = _apex(faces, edges, e, j)
            if apex < edges.ends[e, 1]:
                continue  # a face is counted once, along the edge between its two lowest vertices
            for i in range(lo, j):
                if _apex(faces, edges, e, i) == apex:
                    duplicate += 1
                    break
    return boundary, non_manifold, inconsistent, duplicate


@njit(**INNER)
def _apex(faces, edges, e, j):
    """The vertex of the j-th face along edge e that is not on the edge."""
    f = max(edges.faces[j], ~edges.faces[j])
    return faces[f, 0] + faces[f, 1] + faces[f, 2] - edges.ends[e, 0] - edges.ends[e, 1]
