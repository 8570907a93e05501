"""Mesh files to plain arrays.

Everything goes through trimesh, with ``process=False`` so that no vertex is merged, moved or dropped, but
for .obj: see `silint.io.obj`. What comes back are the file's own vertices in the file's own order, so that
the i-th result belongs to the i-th vertex of the file. Welding for topology is the scene's business.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from silint.io.obj import read_obj
from silint.validation import InputError, mesh_arrays

__all__ = ["MESH_SUFFIXES", "MeshData", "mesh_data", "read_mesh"]

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb", ".gltf", ".off")


class MeshData(NamedTuple):
    """A triangle mesh as plain arrays."""

    vertices: npt.NDArray[np.float64]
    """(V, 3) positions in file order."""
    faces: npt.NDArray[np.int64]
    """(F, 3) rows of `vertices`, counter-clockwise from the front."""
    normals: npt.NDArray[np.float64] | None
    """(V, 3) as the file has them, of any length and possibly zero; None unless every part brings its own."""
    float32_source: bool
    """Whether the positions carry float32 precision only."""
    name: str
    """The file's name without folder and suffix."""
    groups: tuple[str, ...] = ()
    """Names of the nodes (glTF) or objects (.obj) that the faces belong to; empty in formats without any."""
    face_groups: npt.NDArray[np.int32] | None = None
    """(F,) rows of `groups`; None where there are none."""


def read_mesh(path: str | os.PathLike[str]) -> MeshData:
    """Read a mesh file.

    Scene graphs (.glb, .gltf) are flattened: each instance of a mesh is written out with its transform,
    normals by the inverse transpose, and a mirroring transform turns the winding, as glTF asks. Lines and
    points beside triangles are ignored, and so are materials, textures and texture coordinates.

    Parameters
    ----------
    path : str or path-like
        A file whose suffix is one of `MESH_SUFFIXES`.

    Returns
    -------
    MeshData

    Raises
    ------
    InputError
        In one line that names the file: it is missing, a folder, of an unknown kind, damaged or cut
        short, has no triangles, or its vertices or indices make no sense.
    """
    file = _checked_path(path)
    suffix = file.suffix.lower()
    try:
        if suffix == ".obj":
            data = _from_obj(file)
        else:
            with _silence():
                data = _from_trimesh(file, suffix)
        mesh_arrays(data.vertices, data.faces)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except OSError as error:
        reason = error.strerror or f"it refers to a file that is not there: {_one_line(error)}"
        raise InputError(f"{file}: cannot be read ({reason})") from None
    except (
        Exception
    ) as error:  # trimesh fails with whatever the parser tripped over: AssertionError, KeyError, ...
        raise InputError(
            f"{file}: not a valid {suffix} file, or cut short ({_one_line(error)}); try exporting it again"
        ) from None
    return data


def mesh_data(geometry: Any, name: str = "", file_nodes: frozenset[str] | None = None) -> MeshData:
    """The arrays of a `trimesh.Trimesh` or `trimesh.Scene`, flattened as `read_mesh` does.

    Parameters
    ----------
    geometry : trimesh.Trimesh or trimesh.Scene
    name : str
        What the result is called.
    file_nodes : frozenset of str, optional
        Names of a glTF file's own nodes, beside which trimesh makes one for each part of a mesh that has
        several materials.

    Returns
    -------
    MeshData

    Raises
    ------
    InputError
        Neither of the two, or without a triangle.
    """
    import trimesh

    parts: list[tuple[Any, npt.NDArray[np.float64], str]]
    if isinstance(geometry, trimesh.Trimesh):
        parts = [(geometry, np.eye(4), "")]
    elif isinstance(geometry, trimesh.Scene):
        parts = []
        for node in geometry.graph.nodes_geometry:
            transform, key = geometry.graph[node]
            group = _file_node(geometry.graph, node, file_nodes)
            parts.append((geometry.geometry[key], np.asarray(transform, dtype=np.float64), group))
    else:
        raise InputError(f"expected a trimesh.Trimesh or trimesh.Scene, got {type(geometry).__name__}")
    meshes = [part for part in parts if isinstance(part[0], trimesh.Trimesh) and len(part[0].faces)]
    if not meshes:
        found = (
            "only points or lines"
            if any(len(getattr(part, "vertices", ())) for part, _, _ in parts)
            else "no geometry"
        )
        raise InputError(f"has no triangles ({found})")

    vertices, faces, normals, as_float32 = [], [], [], []
    rows: dict[str, int] = {}
    face_groups = []
    offset = 0
    for mesh, matrix, group in meshes:
        positions = np.array(mesh.vertices, dtype=np.float64)
        triangles = np.array(mesh.faces, dtype=np.int64)
        # Asked before the transform: turning float32 vertices gives doubles that fill all 53 bits and are
        # still no better than the float32 that they came from.
        as_float32.append(_is_float32(positions))
        # Only the cache tells normals that came with the mesh from those that trimesh would compute.
        own = np.array(mesh.vertex_normals, dtype=np.float64) if "vertex_normals" in mesh._cache else None
        if not np.array_equal(matrix, np.eye(4)):
            linear = matrix[:3, :3]
            positions = positions @ linear.T + matrix[:3, 3]
            if np.linalg.det(linear) < 0.0:
                triangles = triangles[:, [0, 2, 1]]
            if own is not None:
                own = _transformed_normals(own, linear)
        vertices.append(positions)
        faces.append(triangles + offset)
        face_groups.append(np.full(len(triangles), rows.setdefault(group, len(rows)), dtype=np.int32))
        normals.append(own)
        offset += len(positions)
    grouped = isinstance(geometry, trimesh.Scene)
    complete = all(own is not None and len(own) == len(p) for own, p in zip(normals, vertices, strict=True))
    return MeshData(
        np.ascontiguousarray(np.concatenate(vertices)),
        np.ascontiguousarray(np.concatenate(faces)),
        np.ascontiguousarray(np.concatenate(cast("list[npt.NDArray[np.float64]]", normals)))
        if complete
        else None,
        all(as_float32),
        name,
        groups=tuple(rows) if grouped else (),
        face_groups=np.concatenate(face_groups) if grouped else None,
    )


def _file_node(graph: Any, node: str, file_nodes: frozenset[str] | None) -> str:
    """The file's node that one of trimesh's nodes stands for."""
    parent = graph.transforms.parents.get(node)
    if file_nodes is None or parent is None or node in file_nodes:
        return node
    # One of several parts of a mesh: named after its node with six random characters.
    return parent if node.startswith(f"{parent}_") and len(node) == len(parent) + 7 else node


def _checked_path(path: str | os.PathLike[str]) -> Path:
    try:
        file = Path(path)
    except TypeError:
        raise InputError(f"mesh path is a {type(path).__name__}; expected a string or a path") from None
    known = " ".join(MESH_SUFFIXES)
    try:
        is_folder, exists = file.is_dir(), "\0" not in str(file) and file.exists()
    except OSError as error:  # a name that is too long, or a folder that may not be entered
        raise InputError(f"{_one_line(file)}: cannot be read ({error.strerror})") from None
    if is_folder:
        raise InputError(f"{file}: is a folder; expected a mesh file ({known})")
    if not exists:
        raise InputError(f"{_one_line(file)}: no such file")
    if file.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"{file}: unknown suffix {file.suffix!r}; expected one of {known}")
    if not file.is_file():
        raise InputError(f"{file}: is not a regular file; expected a mesh file ({known})")
    if file.stat().st_size == 0:
        raise InputError(f"{file}: is empty (0 bytes)")
    return file


def _from_obj(file: Path) -> MeshData:
    mesh = read_obj(file.read_bytes())
    return MeshData(
        mesh.vertices,
        mesh.faces,
        mesh.normals,
        _is_float32(mesh.vertices),
        file.stem,
        groups=mesh.groups,
        face_groups=mesh.face_groups,
    )


def _from_trimesh(file: Path, suffix: str) -> MeshData:
    import trimesh

    nodes = None
    if suffix == ".stl":
        _check_stl(file)
    elif suffix == ".gltf":
        # trimesh answers broken JSON with a complaint about some other file.
        nodes = _node_names(file.read_bytes())
    n_polygons = _off_face_count(file) if suffix == ".off" else 0
    # fix_texture would split and reorder a .ply's vertices along the seams of its texture; images are of no
    # use here, and unpacking them costs more than everything else.
    scene = trimesh.load_scene(str(file), process=False, fix_texture=False, skip_materials=True)
    if suffix == ".ply":
        _check_ply(scene)
    elif suffix == ".glb":
        with file.open("rb") as stream:
            head = stream.read(20)
            nodes = _node_names(stream.read(int.from_bytes(head[12:16], "little")))
    data = mesh_data(scene, file.stem, nodes)
    if suffix not in (".glb", ".gltf"):
        data = data._replace(groups=(), face_groups=None)
    if suffix == ".off" and len(data.faces) < n_polygons:
        raise InputError(f"announces {n_polygons} faces but has {len(data.faces)} triangles: cut short")
    return data


def _node_names(document: bytes) -> frozenset[str]:
    """Names of the nodes of a glTF file's JSON; without a name, a node's number, as trimesh has it."""
    nodes = json.loads(document).get("nodes", [])
    return frozenset(str(node.get("name", i)) for i, node in enumerate(nodes))


def _check_stl(file: Path) -> None:
    """Refuse an .stl that was cut short: trimesh would take it for a text one with nothing in it."""
    size = file.stat().st_size
    with file.open("rb") as stream:
        head = stream.read(4096)
    if head.lstrip()[:5].lower() == b"solid" and b"\x00" not in head:
        with file.open("rb") as stream:
            stream.seek(max(0, size - 4096))
            if b"endsolid" not in stream.read().lower():
                raise InputError("is a text .stl without its closing 'endsolid': cut short")
        return
    if size < 84:
        raise InputError(f"has {size} bytes, too few for a binary .stl: cut short, or not an .stl file")
    n_faces = int.from_bytes(head[80:84], "little")
    if size != 84 + 50 * n_faces:
        raise InputError(
            f"announces {n_faces} triangles ({84 + 50 * n_faces} bytes) but has {size} bytes: "
            "cut short, or not an .stl file"
        )


def _check_ply(scene: Any) -> None:
    """Refuse a text .ply with fewer rows than its header announces, which trimesh takes without a word."""
    for part in scene.geometry.values():
        elements = part.metadata.get("_ply_raw", {})
        for key in ("vertex", "face"):
            element = elements.get(key, {})
            data = element.get("data")
            if data is None:
                continue
            rows = len(next(iter(data.values()))) if isinstance(data, dict) else len(data)
            if rows != element["length"]:
                raise InputError(f"announces {element['length']} rows of '{key}' but has {rows}: cut short")


def _off_face_count(file: Path) -> int:
    """What the header announces: trimesh takes an .off with fewer faces than that without a word."""
    with file.open("rb") as stream:
        head = stream.read(65536).decode("latin-1")
    header = re.search(r"OFF\s+(\d+)\s+(\d+)", re.sub(r"#[^\n]*", "", head))
    if header is None:
        raise InputError("has no 'OFF' header with its two counts; not an .off file")
    return int(header[2])


def _is_float32(vertices: npt.NDArray[np.float64]) -> bool:
    """Whether every coordinate is exactly a float32.

    trimesh promotes everything to float64, and most formats that silint reads hold nothing better than
    float32 in the first place, so the dtype tells nothing; the low 29 bits of the values do. Text files
    with a few short decimals pass for float64, which they are.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return bool((vertices.astype(np.float32).astype(np.float64) == vertices).all())


def _transformed_normals(
    normals: npt.NDArray[np.float64], linear: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Normals through a transform, at their own lengths' scale; zero rows if it flattens space."""
    try:
        inverse = np.linalg.inv(linear)
    except np.linalg.LinAlgError:
        return np.zeros_like(normals)
    return normals @ inverse


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep trimesh's warnings and log off the terminal; what matters comes back as one InputError."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _one_line(thing: object) -> str:
    """A path or an exception in at most 120 printable characters."""
    text = (
        "".join(c if c.isprintable() else "?" for c in " ".join(str(thing).split())) or type(thing).__name__
    )
    return text if len(text) <= 120 else text[:117] + "..."
