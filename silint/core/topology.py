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


class Topology(NamedTuple):
    """A triangle scene as the kernels see it, in units of the scaled scene.

    A *code* is an index with a direction: ``i`` along, ``~i`` against.
    """

    vertices: np.ndarray  # (V, 3) float64, distinct positions in lexicographic order
    faces: np.ndarray  # (F, 3) int32, file order; faces with two equal vertices are left out
    face_planes: np.ndarray  # (F,) int32 codes into planes
    edges: np.ndarray  # (E, 2) int32, lower vertex first
    edge_offsets: np.ndarray  # (E + 1,) int32 into edge_faces
    edge_faces: np.ndarray  # (3 F,) int32 codes: ~f where face f runs from the upper vertex to the lower
    planes: np.ndarray  # (P, 4) float64: unit normal N and d; N.x + d > 0 in front
    plane_errors: np.ndarray  # (P,) float64: how far a vertex of a face may lie off its plane


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
    exponent = int(np.frexp(np.abs(vertices).max())[1])
    scaled = np.ldexp(vertices, -exponent) + 0.0  # + 0.0 turns -0 into +0, so both weld
    positions, vertex_map = _weld(scaled)

    welded = vertex_map[faces]
    a, b, c = welded.T
    distinct = (a != b) & (b != c) & (c != a)
    face_map = np.flatnonzero(distinct).astype(np.int32)
    welded = np.ascontiguousarray(welded[distinct])

    edges, edge_offsets, edge_faces, face_edges = _connect(welded, len(positions))
    own_planes, areas = _face_planes(positions, welded)
    by_area = np.argsort(-areas, kind="stable").astype(np.int32)
    face_planes, seeds = _share_planes(
        positions, welded, own_planes, by_area, face_edges, edge_offsets, edge_faces
    )
    planes = own_planes[seeds]
    plane_errors = _plane_errors(positions, welded, face_planes, planes)

    topology = Topology(positions, welded, face_planes, edges, edge_offsets, edge_faces, planes, plane_errors)
    degree = np.diff(edge_offsets)
    pairs = edge_offsets[:-1][degree == 2]
    same_way = (edge_faces[pairs] < 0) == (edge_faces[pairs + 1] < 0)
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    defects = {
        "boundary_edges": int((degree == 1).sum()),
        "non_manifold_edges": int((degree > 2).sum()),
        "inconsistent_edges": int(same_way.sum()),
        "duplicate_faces": int(_count_duplicate_faces(welded, edges, edge_offsets, edge_faces)),
        "zero_area_faces": int(len(faces) - len(welded) + (areas == 0.0).sum()),
        "unreferenced_vertices": int((~used).sum()),
        "welded_vertices": int(len(vertices) - len(positions)),
    }
    return topology, Welding(vertex_map, face_map, exponent), defects


def _weld(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct positions, and for each vertex the index of its position.

    Lexicographic numbering makes the direction of every edge, and so every rounding along it,
    independent of the order of the file.
    """
    order = np.lexsort((vertices[:, 2], vertices[:, 1], vertices[:, 0]))
    ordered = vertices[order]
    first = np.ones(len(vertices), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    vertex_map = np.empty(len(vertices), dtype=np.int32)
    vertex_map[order] = np.cumsum(first) - 1
    return np.ascontiguousarray(ordered[first]), vertex_map


def _connect(faces: np.ndarray, n_vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Edges, the faces along each with their directions, and the edges of each face."""
    start = faces.ravel()
    end = np.roll(faces, -1, axis=1).ravel()
    lower, upper = np.minimum(start, end), np.maximum(start, end)
    key = lower.astype(np.int64) * n_vertices + upper
    order = np.argsort(key, kind="stable")
    key = key[order]
    first = np.ones(len(key), dtype=bool)
    first[1:] = key[1:] != key[:-1]

    heads = order[first]
    edges = np.stack([lower[heads], upper[heads]], axis=1).astype(np.int32)
    offsets = np.append(np.flatnonzero(first), len(key)).astype(np.int32)
    face = (order // 3).astype(np.int32)
    edge_faces = np.where(start[order] < end[order], face, ~face)
    face_edges = np.empty(len(key), dtype=np.int32)
    face_edges[order] = np.cumsum(first) - 1
    return edges, offsets, edge_faces, face_edges.reshape(-1, 3)


def _face_planes(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit plane and twice the area of every face.

    The cross product is taken at the vertex opposite the longest side, where it cancels least. A face
    without area keeps its edges connected; any normal perpendicular to its longest side will do.
    """
    corners = vertices[faces]
    sides = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)  # side i is opposite corner i
    opposite = (sides**2).sum(axis=2).argmax(axis=1)
    turned = np.take_along_axis(corners, (opposite[:, None] + np.arange(3))[..., None] % 3, axis=1)
    e, g = turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0]
    # Scale before multiplying: sides of 1e-160 would underflow.
    size = np.maximum(np.abs(e), np.abs(g)).max(axis=1, keepdims=True)
    e, g = e / size, g / size
    normals = np.cross(e, g)
    length = np.sqrt((normals**2).sum(axis=1))
    areas = length * size[:, 0] ** 2

    flat = length == 0.0
    if flat.any():
        s = e[flat] - g[flat]
        steep = np.abs(s[:, 0]) <= np.abs(s[:, 1:]).max(axis=1)
        zero = np.zeros(len(s))
        across_x = np.stack([zero, s[:, 2], -s[:, 1]], axis=1)
        across_z = np.stack([s[:, 1], -s[:, 0], zero], axis=1)
        normals[flat] = np.where(steep[:, None], across_x, across_z)
        length[flat] = np.sqrt((normals[flat] ** 2).sum(axis=1))
    normals /= length[:, None]
    offsets = -np.einsum("fi,fci->f", normals, corners) / 3.0
    return np.concatenate([normals, offsets[:, None]], axis=1), areas


@njit(**KERNEL)
def _share_planes(vertices, faces, planes, by_area, face_edges, edge_offsets, edge_faces):
    """Grow flat regions from the largest faces; every face gets the code of its region's plane.

    A face joins when its three vertices lie within 4 ulp of the *seed's* plane: comparing with the
    neighbour instead would let a gently curved surface chain into one plane.
    """
    tolerance = 8.0 * ULP
    n = len(faces)
    code = np.empty(n, dtype=np.int32)
    assigned = np.zeros(n, dtype=np.bool_)
    seeds = np.empty(n, dtype=np.int32)
    stack = np.empty(n, dtype=np.int32)
    n_planes = 0
    for s in by_area:
        if assigned[s]:
            continue
        seeds[n_planes] = s
        assigned[s] = True
        code[s] = n_planes
        px, py, pz, pd = planes[s, 0], planes[s, 1], planes[s, 2], planes[s, 3]
        stack[0] = s
        top = 1
        while top > 0:
            top -= 1
            f = stack[top]
            for i in range(3):
                e = face_edges[f, i]
                for j in range(edge_offsets[e], edge_offsets[e + 1]):
                    g = edge_faces[j]
                    g = g if g >= 0 else ~g
                    if assigned[g]:
                        continue
                    flat = True
                    for c in range(3):
                        v = faces[g, c]
                        r = px * vertices[v, 0] + py * vertices[v, 1] + pz * vertices[v, 2] + pd
                        flat = flat and abs(r) <= tolerance
                    if flat:
                        assigned[g] = True
                        along = px * planes[g, 0] + py * planes[g, 1] + pz * planes[g, 2]
                        code[g] = n_planes if along >= 0.0 else ~n_planes
                        stack[top] = g
                        top += 1
        n_planes += 1
    return code, seeds[:n_planes].copy()


def _plane_errors(
    vertices: np.ndarray, faces: np.ndarray, face_planes: np.ndarray, planes: np.ndarray
) -> np.ndarray:
    """The largest distance of a face's vertices from its plane, plus the rounding of measuring it."""
    index = np.where(face_planes < 0, ~face_planes, face_planes)
    own = planes[index]
    distances = np.einsum("fi,fci->fc", own[:, :3], vertices[faces]) + own[:, 3:]
    errors = np.zeros(len(planes))
    np.maximum.at(errors, index, np.abs(distances).max(axis=1))
    return errors + 4.0 * ULP


@njit(**KERNEL)
def _count_duplicate_faces(faces, edges, edge_offsets, edge_faces):
    """Faces whose three vertices already belong to another face, in any winding."""
    count = 0
    for e in range(len(edges)):
        lo, hi = edge_offsets[e], edge_offsets[e + 1]
        if hi - lo < 2:
            continue
        for j in range(lo, hi):
            apex = _apex(faces, edges, edge_faces, e, j)
            if apex < edges[e, 1]:
                continue  # a face is counted once, along the edge between its two lowest vertices
            for i in range(lo, j):
                if _apex(faces, edges, edge_faces, e, i) == apex:
                    count += 1
                    break
    return count


@njit(**INNER)
def _apex(faces, edges, edge_faces, e, j):
    """The vertex of the j-th face along edge e that is not on the edge."""
    f = edge_faces[j]
    f = f if f >= 0 else ~f
    return faces[f, 0] + faces[f, 1] + faces[f, 2] - edges[e, 0] - edges[e, 1]
