"""A writer of binary PLY for triangles with any properties, and a reader of what it wrote.

Written here because trimesh's writer rounds positions to float32, and its reader drops the comments, which
carry the metadata.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Field", "Ply", "ply_bytes", "position_type", "read_ply"]

Field = tuple[str, str, npt.NDArray[Any]]
"""Name, type as PLY calls it, and values, of a property."""

_TYPES = {"uchar": "u1", "int": "<i4", "float": "<f4", "double": "<f8"}
_FORMAT = "format binary_little_endian 1.0"
_TRIANGLE = [("count", "u1"), ("index", "<i4", (3,))]


class Ply(NamedTuple):
    """What stands in a file."""

    comments: list[str]
    """Without the word ``comment``."""
    vertex: npt.NDArray[np.void]
    """(V,) with a named field for each property."""
    face: npt.NDArray[np.void]
    """(F,) likewise; ``index`` holds the three vertices."""


def position_type(vertices: npt.NDArray[np.float64]) -> str:
    """``float`` where that keeps every bit of the positions, else ``double``."""
    with np.errstate(over="ignore"):
        exact = np.array_equal(vertices.astype(np.float32), vertices)
    return "float" if exact else "double"


def ply_bytes(
    vertex: Sequence[Field],
    faces: npt.NDArray[np.integer[Any]],
    face: Sequence[Field],
    comments: Sequence[str],
) -> bytes:
    """A triangle mesh as the bytes of a .ply file.

    Parameters
    ----------
    vertex, face : sequence of Field
        Properties beside the faces' own ``vertex_indices``, in this order.
    faces : ndarray of int, shape (F, 3)
    comments : sequence of str
        ASCII, each on one line.

    Returns
    -------
    bytes
        Little endian.
    """
    header = ["ply", _FORMAT, *(f"comment {comment}" for comment in comments)]
    header.append(f"element vertex {len(vertex[0][2])}")
    header += [f"property {kind} {name}" for name, kind, _ in vertex]
    header.append(f"element face {len(faces)}")
    header.append("property list uchar int vertex_indices")
    header += [f"property {kind} {name}" for name, kind, _ in face]
    header.append("end_header\n")

    vertex_rows = np.empty(len(vertex[0][2]), dtype=[(name, _TYPES[kind]) for name, kind, _ in vertex])
    face_rows = np.empty(len(faces), dtype=[*_TRIANGLE, *((name, _TYPES[kind]) for name, kind, _ in face)])
    face_rows["count"] = 3
    face_rows["index"] = faces
    for rows, fields in ((vertex_rows, vertex), (face_rows, face)):
        for name, _, column in fields:
            rows[name] = column
    return "\n".join(header).encode("ascii") + vertex_rows.tobytes() + face_rows.tobytes()


def read_ply(data: bytes) -> Ply:
    """Read what `ply_bytes` wrote.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    Ply

    Raises
    ------
    ValueError, KeyError, IndexError
        Not a file of that kind, or cut short.
    """
    marker = b"end_header\n"
    end = data.index(marker)
    lines = data[:end].decode("ascii").splitlines()
    if lines[:2] != ["ply", _FORMAT]:
        raise ValueError("not a binary little endian .ply file")

    comments: list[str] = []
    elements: list[tuple[str, int, list[Any]]] = []
    for line in lines[2:]:
        word, _, rest = line.partition(" ")
        if word == "comment":
            comments.append(rest)
        elif word == "element":
            name, count = rest.split()
            elements.append((name, int(count), []))
        elif rest == "list uchar int vertex_indices":
            elements[-1][2].extend(_TRIANGLE)
        else:
            kind, name = rest.split()
            elements[-1][2].append((name, _TYPES[kind]))
    if [name for name, _, _ in elements] != ["vertex", "face"]:
        raise ValueError("elements other than vertex and face")

    tables, offset = [], end + len(marker)
    for _, n_rows, fields in elements:
        dtype = np.dtype(fields)
        tables.append(np.frombuffer(data, dtype, n_rows, offset))
        offset += n_rows * dtype.itemsize
    if offset != len(data) or not (tables[1]["count"] == 3).all():
        raise ValueError("faces that are no triangles, or bytes beyond the last")
    return Ply(comments, tables[0], tables[1])
