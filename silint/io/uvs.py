"""Texture coordinates of mesh files, for the few who want them.

`silint.io.read` leaves them aside. Here they are read by themselves, one pair for each corner of each of the
faces that `read_mesh` returns, in their order.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.io.gltf import accessor_values, gltf_parts, read_gltf
from silint.io.read import _silence as silence
from silint.validation import InputError

__all__ = ["read_uvs"]

FloatArray = npt.NDArray[np.float64]

# What .ply files call those of vertices.
_PLY_UVS = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))


def read_uvs(path: Path, n_faces: int) -> FloatArray | None:
    """The texture coordinates of a mesh file that `read_mesh` has read.

    Parameters
    ----------
    path : pathlib.Path
        Texture coordinates are ``vt`` of .obj, of .glb and .gltf the set that the material's occlusion reads
        or else TEXCOORD_0, and what a .ply has for its vertices (u v, s t, texture_u texture_v) or, if it
        consists of triangles, for their corners (texcoord).
    n_faces : int
        Its number of triangles.

    Returns
    -------
    (n_faces, 3, 2) float64, or None
        v upwards; None unless every corner has one.

    Raises
    ------
    InputError
        A line of .obj that cannot be understood.
    """
    suffix = path.suffix.lower()
    if suffix in (".obj", ".glb", ".gltf", ".ply"):
        try:
            if suffix == ".obj":
                uvs = _obj_uvs(path.read_bytes())
            else:
                with silence():
                    uvs = _gltf_uvs(path) if suffix != ".ply" else _ply_uvs(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
        if uvs is not None and uvs.shape == (n_faces, 3, 2):
            return uvs
    return None


def _obj_uvs(data: bytes) -> FloatArray | None:
    """(F, 3, 2) of polygons as fans from their first corner."""
    text = data.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    coordinates: list[tuple[float, float]] = []
    corners: list[int] = []
    for line in text.split("\n"):
        if not line.lstrip().startswith(("vt", "f")):
            continue
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["vt"]:
                # The second may be left out; a third is of no use here.
                coordinates.append((float(words[1]), float(words[2]) if len(words) > 2 else 0.0))
            elif words[:1] == ["f"]:
                named = [int(word.split("/")[1]) for word in words[1:]]
                # A relative index counts back from the last row *so far*.
                rows = [i - 1 if i > 0 else len(coordinates) + i for i in named]
                for i in range(1, len(rows) - 1):
                    corners += (rows[0], rows[i], rows[i + 1])
        except (ValueError, IndexError):
            return None  # a corner without one: the faces as such are `read_obj`'s business
    of_corner = np.array(corners, dtype=np.int64).reshape(-1, 3)
    if not len(coordinates) or (of_corner < 0).any() or (of_corner >= len(coordinates)).any():
        return None
    return np.array(coordinates)[of_corner]


def _gltf_uvs(path: Path) -> FloatArray | None:
    gltf = read_gltf(path)
    parts = []
    for part in gltf_parts(gltf, path):
        primitive = gltf.document["meshes"][part.mesh]["primitives"][part.primitive]
        index = primitive["attributes"].get(f"TEXCOORD_{_occlusion_set(gltf.document, primitive)}")
        if index is None:
            return None
        faces = part.faces[:, [0, 2, 1]] if part.mirrored else part.faces
        parts.append(accessor_values(gltf, index)[faces])
    # glTF's v points down.
    return np.concatenate(parts) * (1.0, -1.0) + (0.0, 1.0) if parts else None


def _occlusion_set(document: dict[str, Any], primitive: dict[str, Any]) -> int:
    """Which set of coordinates the occlusion of a primitive's material is read by; 0 where it has none."""
    material = primitive.get("material")
    texture = {} if material is None else document["materials"][material].get("occlusionTexture", {})
    return int(texture.get("texCoord", 0))


def _ply_uvs(path: Path) -> FloatArray | None:
    import trimesh

    scene: Any = trimesh.load_scene(str(path), process=False, fix_texture=False, skip_materials=True)
    parts = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
    if len(parts) != 1:
        return None
    faces, elements = np.asarray(parts[0].faces), parts[0].metadata.get("_ply_raw", {})
    corners = _columns(elements, "face", ("texcoord",))
    if corners is not None:
        rows = corners[0]["f1"] if corners[0].dtype.names else corners[0]  # a list, after its length
        fits = rows.dtype != object and rows.shape == (len(faces), 6)  # of polygons nobody knows whose
        return rows.astype(np.float64).reshape(-1, 3, 2) if fits else None
    for names in _PLY_UVS:
        columns = _columns(elements, "vertex", names)
        if columns is not None:
            uvs: FloatArray = np.stack([c.astype(np.float64).reshape(-1) for c in columns], axis=1)
            return np.asarray(uvs[faces])
    return None


def _columns(elements: Any, key: str, names: tuple[str, ...]) -> list[npt.NDArray[Any]] | None:
    data: Any = elements.get(key, {}).get("data")
    known = () if data is None else data.dtype.names or () if isinstance(data, np.ndarray) else data
    return [np.asarray(data[name]) for name in names] if all(name in known for name in names) else None
