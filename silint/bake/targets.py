"""What is baked: the output's mesh, and the points and normals on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.bake.options import BakeOptions
from silint.validation import InputError

if TYPE_CHECKING:
    from silint.scene import Scene

__all__ = ["Sites", "Targets", "chosen_faces", "sites", "targets"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int32]

_NAMES_SHOWN = 6  # of groups, in an error message


class Sites(NamedTuple):
    """Where to integrate."""

    points: FloatArray
    """(n, 3)."""
    normals: FloatArray
    """(n, 3), unit, or zero where there is none."""
    valid: npt.NDArray[np.bool_]
    """(n,) where there is a normal."""
    groups: IntArray | None = None
    """(n,) which of the scene's groups a point is on; None unless groups are occluded by themselves alone."""
    surfaces: npt.NDArray[np.int64] | None = None
    """(n,) which smooth surface a point is on; None unless points are interpolated."""


class Targets(NamedTuple):
    """The output's mesh, and a point for each of its vertices or faces."""

    vertices: FloatArray
    """(V, 3)."""
    faces: IntArray
    """(F, 3)."""
    sites: Sites
    normals_from: str
    """``file``, ``smooth`` or ``flat``."""
    computed_normals: int
    """Points whose normal the file should have given but did not; they got a smooth one."""
    split_vertices: int
    """How many more vertices there are than those of the file that are used."""


def targets(scene: Scene, asked: BakeOptions, label: str) -> Targets:
    """The mesh that a bake puts out, with its points.

    Parameters
    ----------
    scene : Scene
        The file, whole: smooth normals see all of its faces, whatever is left out.
    asked : BakeOptions
    label : str
        What messages call the scene.

    Returns
    -------
    Targets

    Raises
    ------
    InputError
        Groups that are not there, or normals that the file does not have.
    """
    chosen = chosen_faces(scene, asked.groups, label)
    if asked.normals == "file" and not scene.own_normals.any():
        raise InputError(f"{label}: has no normals of its own, which normals='file' asks for; try 'smooth'")
    faces = scene.faces[chosen]
    of_face = scene.face_groups[chosen] if asked.self_only and scene.face_groups is not None else None
    flat = asked.normals == "flat" or (asked.normals == "auto" and asked.per == "face")

    rows: npt.NDArray[Any]
    new_faces: IntArray
    if asked.per == "vertex" and flat:
        rows, new_faces = faces.ravel(), np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
        of_row = None if of_face is None else np.repeat(of_face, 3)
    else:
        keep_unused = not asked.groups
        rows, new_faces, of_row = _rows(faces, of_face if asked.per == "vertex" else None, scene, keep_unused)
    vertices = scene.vertices[rows]

    centers, face_normals, has_area = scene.face_centers_normals()
    centers, face_normals, has_area = centers[chosen], face_normals[chosen], has_area[chosen]
    computed = 0
    if flat:
        repeats = 3 if asked.per == "vertex" else 1
        normals, valid = np.repeat(face_normals, repeats, axis=0), np.repeat(has_area, repeats)
    else:
        normals, valid = scene.vertex_normals(smooth=asked.normals == "smooth")
        if asked.per == "face":
            mean = normals[faces].sum(axis=1)
            length = np.linalg.norm(mean, axis=1, keepdims=True)
            # Corners whose normals cancel leave the face its own.
            normals = np.where(length > 1e-9, mean / np.maximum(length, 1e-9), face_normals)
            valid = has_area
        else:
            normals, valid = normals[rows], valid[rows]
            if scene.normals is not None and asked.normals != "smooth":
                computed = int(np.count_nonzero(valid & ~scene.own_normals[rows]))
    from_file = scene.normals is not None and asked.normals != "smooth"
    points = vertices if asked.per == "vertex" else centers
    normals = np.where(valid[:, None], normals, 0.0)
    surfaces = None
    if asked.interpolate is not None:
        from silint.interpolation import face_surfaces, smooth_surfaces  # and numba with it

        if asked.per == "vertex":
            surfaces = smooth_surfaces(points, normals, new_faces)
        else:
            welded = scene.welding.vertex_map[faces]
            surfaces = face_surfaces(welded, np.repeat(normals[:, None], 3, axis=1))
    used = len(np.unique(rows))
    return Targets(
        vertices,
        new_faces,
        Sites(
            points,
            normals,
            valid,
            of_row if asked.per == "vertex" else of_face,
            surfaces,
        ),
        "flat" if flat else "file" if from_file else "smooth",
        computed,
        len(rows) - used,
    )


def sites(scene: Scene, per: str) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Points, normals (zero where there is none), and where there is one, of a mesh's vertices or faces."""
    return targets(scene, BakeOptions(per=per), scene.name).sites[:3]


def chosen_faces(scene: Scene, names: Sequence[str], label: str) -> npt.NDArray[np.bool_] | slice:
    """Which faces belong to the named groups; all if none is named."""
    if not names:
        return slice(None)
    if scene.face_groups is None:
        raise InputError(f"{label}: has no groups, so no {names[0]!r}; .glb, .gltf and .obj files have some")
    rows = {name: i for i, name in enumerate(scene.groups)}
    for name in names:
        if name not in rows:
            known = ", ".join(repr(known) for known in scene.groups[:_NAMES_SHOWN])
            more = len(scene.groups) - _NAMES_SHOWN
            rest = f" and {more:,} more" if more > 0 else ""
            raise InputError(f"{label}: has no group {name!r}; it has {known}{rest}")
    wanted = np.zeros(len(scene.groups), dtype=bool)
    wanted[[rows[name] for name in names]] = True
    chosen: npt.NDArray[np.bool_] = wanted[scene.face_groups]
    return chosen


def _rows(
    faces: IntArray, of_face: IntArray | None, scene: Scene, keep_unused: bool
) -> tuple[npt.NDArray[Any], IntArray, IntArray | None]:
    """The file's vertex that each of the output's is, the output's faces, and the group of each vertex.

    One for each pair of vertex and group in use, in the file's order.
    """
    if of_face is None and keep_unused:
        return np.arange(scene.n_vertices), scene.faces, None
    stride = max(len(scene.groups), 1)
    keys = faces * np.int64(stride) + (0 if of_face is None else of_face[:, None])
    unused = np.zeros(0, np.int64)
    if keep_unused:
        unused = np.setdiff1d(np.arange(scene.n_vertices), faces) * stride
    pairs, inverse = np.unique(np.concatenate([keys.ravel(), unused]), return_inverse=True)
    rows, groups = np.divmod(pairs, stride)
    new_faces = inverse.ravel()[: keys.size].reshape(-1, 3).astype(np.int32)
    return rows, new_faces, None if of_face is None else groups.astype(np.int32)
