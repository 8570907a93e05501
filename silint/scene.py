"""The scene: a triangle mesh as the file has it, and what silint needs to know of it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.core.topology import Topology, Welding, build_topology
from silint.io import mesh_data, read_mesh
from silint.validation import InputError, mesh_arrays, row_numbers

if TYPE_CHECKING:
    import trimesh

FloatArray = npt.NDArray[np.float64]


class Scene:
    """An immutable triangle mesh.

    Any triangles will do: open, non-manifold, inconsistently wound, with duplicate or degenerate faces.
    Nothing is repaired; `defects` counts what was found.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
        Positions in any unit.
    faces : array_like of int, shape (F, 3)
        Rows of `vertices`, counter-clockwise from the front.
    normals : array_like, shape (V, 3), optional
        The file's own vertex normals; those that are zero or not finite count as missing.
    name : str
        For messages.
    groups : sequence of str
        Names of objects that the faces belong to, each of its own.
    face_groups : array_like of int, shape (F,), optional
        The row of `groups` of each face.

    Raises
    ------
    silint.InputError
        Empty arrays, wrong shapes, non-finite vertices or indices out of range.
    """

    def __init__(
        self,
        vertices: npt.ArrayLike,
        faces: npt.ArrayLike,
        normals: npt.ArrayLike | None = None,
        name: str = "",
        groups: Sequence[str] = (),
        face_groups: npt.ArrayLike | None = None,
    ) -> None:
        v, f, float32_source = mesh_arrays(vertices, faces)
        self.vertices: FloatArray = _frozen(v)
        self.faces: npt.NDArray[np.int32] = _frozen(f)
        self.normals: FloatArray | None = None
        if normals is not None:
            try:
                own = np.asarray(normals, dtype=np.float64)
            except (TypeError, ValueError):
                raise InputError(
                    "normals is not an array of numbers; expected (V, 3), one a vertex"
                ) from None
            if own.shape != self.vertices.shape:
                raise InputError(
                    f"normals has shape {own.shape}; expected {self.vertices.shape}, one a vertex"
                )
            self.normals = _frozen(own)
        self.name = name
        self.float32_source = float32_source
        self.groups = tuple(groups)
        self.face_groups: npt.NDArray[np.int32] | None = None
        if (face_groups is None) != (not self.groups):
            raise InputError("groups and face_groups belong together; pass both or neither")
        if face_groups is not None:
            self.face_groups = _frozen(
                row_numbers(face_groups, "face_groups", self.n_faces, len(self.groups))
            )

    @classmethod
    def from_trimesh(cls, mesh: trimesh.Trimesh | trimesh.Scene) -> Scene:
        """A scene from a trimesh mesh, or from a trimesh scene with its transforms applied."""
        return _from_data(mesh_data(mesh))

    @property
    def n_vertices(self) -> int:
        """Number of the file's vertices."""
        return len(self.vertices)

    @property
    def n_faces(self) -> int:
        """Number of the file's faces."""
        return len(self.faces)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """The lowest and the highest corner, (3,) each, of the box around all faces."""
        used = self.vertices[np.unique(self.faces)]
        return used.min(axis=0), used.max(axis=0)

    @property
    def extent(self) -> float:
        """The longest side of the bounding box, in the file's unit."""
        low, high = self.bounds
        return float((high - low).max())

    @cached_property
    def _connected(self) -> tuple[Topology, Welding, dict[str, int]]:
        return build_topology(self.vertices, self.faces)

    @property
    def topology(self) -> Topology:
        """Welded vertices and faces, and their planes (scaled by a power of two)."""
        return self._connected[0]

    @property
    def welding(self) -> Welding:
        """How the file's vertices and faces map to the topology's, and the scale between them."""
        return self._connected[1]

    @cached_property
    def first_vertices(self) -> npt.NDArray[np.int32]:
        """The first of the file's vertices at each of the topology's."""
        vertex_map = self.welding.vertex_map
        first = np.empty(len(self.topology.vertices), np.int32)
        first[vertex_map[::-1]] = np.arange(len(vertex_map) - 1, -1, -1, dtype=np.int32)
        return first

    @property
    def defects(self) -> dict[str, int]:
        """Counts of boundary, non-manifold and inconsistently wound edges, duplicate and zero-area faces,
        unreferenced vertices, and vertices that share their position with an earlier one.
        """
        return dict(self._connected[2])

    def vertex_normals(self, smooth: bool = False) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """Unit normals of the file's vertices.

        Parameters
        ----------
        smooth : bool
            Angle-weighted normals even where the file has its own.

        Returns
        -------
        normals : (V, 3)
            The file's own where it has them, else the angle-weighted mean of the normals of all faces that
            meet at the vertex's position [Thuermer and Wuethrich 1998].
        valid : (V,) bool
            False where a vertex has neither, or belongs to no face; its normal is then (0, 0, 1) and means
            nothing.
        """
        normals = self._angle_weighted_normals()
        if self.normals is not None and not smooth:
            replace = self.own_normals & self._referenced
            normals[replace] = _unit(self.normals[replace])
        valid = np.asarray(normals.any(axis=1))
        normals[~valid] = (0.0, 0.0, 1.0)
        return normals, valid

    @property
    def own_normals(self) -> npt.NDArray[np.bool_]:
        """Where the file itself gives a vertex a normal, (V,)."""
        if self.normals is None:
            return np.zeros(self.n_vertices, dtype=bool)
        return np.asarray(np.isfinite(self.normals).all(axis=1) & self.normals.any(axis=1))

    def _angle_weighted_normals(self) -> FloatArray:
        topology, welding = self.topology, self.welding
        corners = topology.vertices[topology.faces]
        face_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face_normals = _unit(face_normals)
        total = np.zeros_like(topology.vertices)
        for i in range(3):
            a = _unit(corners[:, (i + 1) % 3] - corners[:, i])
            b = _unit(corners[:, (i + 2) % 3] - corners[:, i])
            angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
            for axis in range(3):
                total[:, axis] += np.bincount(
                    topology.faces[:, i], angle * face_normals[:, axis], minlength=len(total)
                )
        # Opposite faces cancel to rounding; what is left then is no direction.
        total[np.linalg.norm(total, axis=1) < 1e-9] = 0.0
        normals: FloatArray = _unit(total)[welding.vertex_map]
        normals[~self._referenced] = 0.0
        return normals

    @cached_property
    def _referenced(self) -> npt.NDArray[np.bool_]:
        used = np.zeros(self.n_vertices, dtype=bool)
        used[self.faces] = True
        return used

    def face_centers_normals(self) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
        """Centroids and unit normals of the file's faces; False where a face has no area."""
        corners = self.vertices[self.faces]
        scaled = np.ldexp(corners, -self.welding.exponent)
        normals = _unit(np.cross(scaled[:, 1] - scaled[:, 0], scaled[:, 2] - scaled[:, 0]))
        valid = np.asarray(normals.any(axis=1))
        normals[~valid] = (0.0, 0.0, 1.0)
        return corners.mean(axis=1), normals, valid

    def __repr__(self) -> str:
        title = f" {self.name!r}" if self.name else ""
        return f"<silint.Scene{title}: {self.n_faces:,} triangles, {self.n_vertices:,} vertices>"


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene from any mesh file that trimesh reads: .obj .ply .stl .glb .gltf .off.

    Scene graphs are flattened with their transforms. The file's vertices keep their order; those at one
    position are welded for topology only.

    Raises
    ------
    silint.InputError
        The file is missing, damaged, not a mesh, or empty; one line names it.
    """
    return _from_data(read_mesh(path))


def as_scene(source: Any) -> Scene:
    """A scene from a scene, a path, or a trimesh object."""
    if isinstance(source, Scene):
        return source
    if isinstance(source, str | os.PathLike):
        return load_scene(source)
    if (hasattr(source, "vertices") and hasattr(source, "faces")) or hasattr(source, "geometry"):
        return Scene.from_trimesh(source)
    raise InputError(f"scene is a {type(source).__name__}; expected a Scene, a path or a trimesh object")


def _from_data(data: Any) -> Scene:
    scene = Scene(data.vertices, data.faces, data.normals, data.name, data.groups, data.face_groups)
    scene.float32_source = data.float32_source
    return scene


def _frozen(array: Any) -> Any:
    """A read-only copy: the caller's array stays the caller's."""
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors, zero where there is no direction; safe for any magnitude."""
    size = np.abs(vectors).max(axis=-1, keepdims=True)
    scaled = np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0.0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    unit: FloatArray = np.divide(scaled, length, out=scaled, where=length > 0.0)
    return unit
