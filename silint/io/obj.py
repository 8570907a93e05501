"""Wavefront .obj files.

The one format that trimesh does not read here. Measured on its version 5.2: it hands back vertices in
the order of its own hash table (or, asked to keep the order, gives a vertex between two hard faces the
median of their normals' *indices*), splits a file at every material, and counts relative indices from
the end of the file instead of from where they stand.
"""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np
import numpy.typing as npt

from silint.validation import InputError

__all__ = ["ObjMesh", "read_obj"]

_NO_NAME = "default"  # what the format calls the group of faces that stand before any


class ObjMesh(NamedTuple):
    """The triangles of a file."""

    vertices: npt.NDArray[np.float64]
    """(V, 3), a row for each ``v`` line, in their order; where corners share a position but not a normal, a
    row for each pair of the two, in the order of the positions. Texture coordinates split nothing."""
    faces: npt.NDArray[np.int64]
    """(F, 3), polygons as fans from their first corner."""
    normals: npt.NDArray[np.float64] | None
    """(V, 3), None unless every corner of every face names one. Zero for vertices that no face uses."""
    groups: tuple[str, ...]
    """Names of objects (``o``) or, in a file without any, of groups (``g``), in the order of their first
    faces; empty where there are neither."""
    face_groups: npt.NDArray[np.int32] | None
    """(F,) rows of `groups`, None if that is empty."""


def read_obj(data: bytes) -> ObjMesh:
    """The triangles of a Wavefront .obj file.

    Parameters
    ----------
    data : bytes
        The file's contents.

    Returns
    -------
    ObjMesh

    Raises
    ------
    InputError
        A line that cannot be understood, by its number.
    """
    # Latin-1 maps every byte to a character: names and comments in any encoding get through unharmed.
    text = data.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    if "\\\n" in text:
        text = text.replace("\\\n", " ")
    positions: list[float] = []
    directions: list[float] = []
    corners: list[int] = []
    corner_normals: list[int] = []
    # Where objects and groups begin: how many faces stand before the line, and its name.
    begun: dict[str, list[tuple[int, str]]] = {"o": [], "g": []}

    for number, line in enumerate(text.split("\n"), start=1):
        words = line.split()
        if not words:
            continue
        kind = words[0]
        try:
            if kind == "v":
                positions += (float(words[1]), float(words[2]), float(words[3]))
            elif kind == "vn":
                directions += (float(words[1]), float(words[2]), float(words[3]))
            elif kind == "f":
                _add_polygon(words, len(positions) // 3, len(directions) // 3, corners, corner_normals)
            elif kind in begun:
                begun[kind].append((len(corners) // 3, _decoded(" ".join(words[1:])) or _NO_NAME))
        except (ValueError, IndexError):
            _refuse(number, line)

    vertices = np.array(positions, dtype=np.float64).reshape(-1, 3)
    if not corners:
        found = f"{len(vertices)} vertices and no faces" if len(vertices) else "neither vertices nor faces"
        raise InputError(f"has no triangles ({found})")
    faces = np.array(corners, dtype=np.int64).reshape(-1, 3)
    out_of_range = (faces < 0) | (faces >= len(vertices))
    if out_of_range.any():
        bad = int(faces[out_of_range][0])
        named = f"vertex {bad + 1}" if bad >= 0 else "a vertex before the first"
        raise InputError(f"a face names {named}, but there are {len(vertices)} vertices")
    groups, face_groups = _groups(begun["o"] or begun["g"], len(faces))
    normals = np.array(directions, dtype=np.float64).reshape(-1, 3)
    of_corner = np.array(corner_normals, dtype=np.int64).reshape(-1, 3)
    if (of_corner < 0).any() or (of_corner >= len(normals)).any():
        # Some corner names no normal, or one that is not there.
        return ObjMesh(vertices, faces, None, groups, face_groups)
    return ObjMesh(*_split_by_normal(vertices, faces, normals, of_corner), groups, face_groups)


def _add_polygon(
    words: list[str], n_positions: int, n_directions: int, corners: list[int], corner_normals: list[int]
) -> None:
    """Append the fan of one ``f`` line; corners are ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``."""
    places, normals = [], []
    for word in words[1:]:
        if word.startswith("#"):
            break
        parts = word.split("/")
        place = int(parts[0])
        if place == 0:
            raise ValueError
        # A relative index counts back from the last vertex *so far*.
        places.append(place - 1 if place > 0 else n_positions + place)
        normal = int(parts[2]) if len(parts) > 2 and parts[2] else 0
        normals.append(normal - 1 if normal >= 0 else n_directions + normal)
    if len(places) < 3:
        raise ValueError
    for i in range(1, len(places) - 1):
        corners += (places[0], places[i], places[i + 1])
        corner_normals += (normals[0], normals[i], normals[i + 1])


def _groups(
    begun: list[tuple[int, str]], n_faces: int
) -> tuple[tuple[str, ...], npt.NDArray[np.int32] | None]:
    """Names, and the row of its name for each face; a name that comes again goes on with its group."""
    if not begun:
        return (), None
    starts = [0, *(start for start, _ in begun)]
    names = [_NO_NAME, *(name for _, name in begun)]
    lengths = np.diff([*starts, n_faces])
    rows: dict[str, int] = {}
    row_of_start = [
        rows.setdefault(name, len(rows)) if length else 0 for name, length in zip(names, lengths, strict=True)
    ]
    return tuple(rows), np.repeat(np.array(row_of_start, dtype=np.int32), lengths)


def _decoded(name: str) -> str:
    """A name as UTF-8 if it is that, else as Latin-1."""
    raw = name.encode("latin-1")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return name


def _split_by_normal(
    vertices: npt.NDArray[np.float64],
    faces: npt.NDArray[np.int64],
    normals: npt.NDArray[np.float64],
    of_corner: npt.NDArray[np.int64],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """One row for each (position, normal) in use, and one for each position that no face uses."""
    stride = len(normals) + 1
    keys = faces * stride + of_corner + 1
    unused = np.setdiff1d(np.arange(len(vertices), dtype=np.int64), faces)
    rows, inverse = np.unique(np.concatenate([keys.ravel(), unused * stride]), return_inverse=True)
    place, normal = np.divmod(rows, stride)
    row_normals = np.concatenate([np.zeros((1, 3)), normals])[normal]
    return vertices[place], inverse.ravel()[: keys.size].reshape(-1, 3).astype(np.int64), row_normals


def _refuse(number: int, line: str) -> NoReturn:
    shown = line.strip()
    shown = shown if len(shown) <= 40 else shown[:37] + "..."
    raise InputError(f"line {number} cannot be understood: {shown!r}")
