"""Transfer coefficients of precomputed radiance transfer (PRT) to files that other tools take as they are.

==========  =====================================================================================
``.npz``    everything in float64, with a SHA-256 of each array: the one to keep
``.glb``    float32, four coefficients in each of the vertex attributes ``_SH0``, ``_SH1``, ...;
            results for faces unshare the vertices, three for each face
``.ply``    binary; float32 properties ``sh_0``, ``sh_1``, ... of vertices or faces, after ``x y z
            nx ny nz``
folder      ``bounce/bounce0.txt`` and ``bounce/face.npy``: see `silint.io.bounce`
==========  =====================================================================================

All but the last carry a header in JSON with the conventions that are stated in `CONVENTIONS`. Byte by byte
they are described in docs/prt_formats.md.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.io.bounce import check_bounce_output, write_bounce
from silint.io.glb import glb_bytes, read_glb
from silint.io.ply import Field, ply_bytes, position_type, read_ply
from silint.io.write import check_output, write_bytes
from silint.validation import InputError, choice, finite_array, mesh_arrays, positive_int

__all__ = [
    "CONVENTIONS",
    "MAX_DEGREE",
    "TRANSFER_SUFFIXES",
    "TransferArrays",
    "check_transfer_output",
    "read_transfer",
    "write_transfer",
]

TRANSFER_SUFFIXES = (".npz", ".ply", ".glb")
MAX_DEGREE = 16

SCHEMA = 1
CONVENTIONS = {
    "basis": "real orthonormal spherical harmonics",
    "condon_shortley": False,
    "signs": "Y_1,-1 Y_1,0 Y_1,1 = sqrt(3 / (4 pi)) (y, z, x)",
    "index": "l (l + 1) + m",
    "axes": "right-handed, as in the mesh file",
}
"""What a reader has to know, in every header; a file that says otherwise is refused."""

_MEANINGS = {
    "cosine": "T_i = (1/pi) int V max(n.w,0) Y_i dw; sum T_i L_i is the radiance that leaves a white diffuse "
    "surface under the radiance sum L_i Y_i",
    "uniform": "T_i = int V Y_i dw over the hemisphere of n; sum T_i L_i is the integral of the radiance "
    "sum L_i Y_i that arrives there",
}
_KEY = "silint_transfer"  # its value in a header is the schema
_ARRAYS = ("vertices", "faces", "normals", "coefficients")


@dataclass(frozen=True, eq=False)
class TransferArrays:
    """SH transfer at the vertices or faces of a mesh, checked on construction.

    Attributes
    ----------
    vertices : (V, 3) float64
        Of the mesh, in any unit.
    faces : (F, 3) int32
        Rows of `vertices`.
    normals : (n, 3) float64
        Unit; zero where there is none.
    coefficients : (n, (max_degree + 1)^2) float64
        Real orthonormal SH without Condon-Shortley phase, index l (l + 1) + m, in the mesh's own axes:
        cosine: (1/pi) int V max(n.w,0) Y dw, a number between -1 and 1 without unit;
        uniform: int V Y dw over the hemisphere of n, in steradians. Zero where there is no normal.
    per : {"vertex", "face"}
        What the n rows belong to.
    max_degree : int
        0 to 16.
    weighting : {"cosine", "uniform"}
    diagnostics : mapping of str to int
        The integrator's counts.
    metadata : mapping
        Anything that JSON can hold.

    Raises
    ------
    InputError
        Shapes do not fit each other, NaN, normals that are neither unit nor zero, or unknown options.
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int32]
    normals: npt.NDArray[np.float64]
    coefficients: npt.NDArray[np.float64]
    per: str = "vertex"
    max_degree: int = 2
    weighting: str = "cosine"
    diagnostics: Mapping[str, int] = field(default_factory=dict)
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        choice(self.per, "per", ("vertex", "face"))
        choice(self.weighting, "weighting", tuple(_MEANINGS))
        degree = positive_int(self.max_degree, "max_degree", 0, MAX_DEGREE)
        vertices, faces, _ = mesh_arrays(self.vertices, self.faces)
        n = len(vertices if self.per == "vertex" else faces)
        normals = finite_array(self.normals, "normals", [(n, 3)], f"one a {self.per}")
        with np.errstate(over="ignore"):  # a length of infinity is refused below
            length = np.linalg.norm(normals, axis=1)
        wrong = np.flatnonzero((length != 0.0) & (np.abs(length - 1.0) > 1e-3))
        if wrong.size:
            raise InputError(
                f"normals has a length of {length[wrong[0]]:.4g} in row {wrong[0]}; expected 1 or 0"
            )
        coefficients = finite_array(
            self.coefficients,
            "coefficients",
            [(n, (degree + 1) ** 2)],
            f"one row a {self.per}, (max_degree + 1)^2 columns",
        )
        checked = {
            "max_degree": degree,
            "vertices": vertices,
            "faces": faces,
            "normals": normals,
            "coefficients": coefficients,
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)  # frozen for everybody else

    def __len__(self) -> int:
        return len(self.coefficients)


# --------------------------------------------------------------------------------------------- writing


def check_transfer_output(
    path: str | os.PathLike[str], max_degree: int = 2, per: str = "vertex", weighting: str = "cosine"
) -> Path:
    """Make sure, before any computing, that a transfer of that kind can be written there.

    Parameters
    ----------
    path : str or path-like
        A file that ends in one of `TRANSFER_SUFFIXES`, or a folder: one that is there, or a name without
        suffix or with a slash at its end.
    max_degree, per, weighting
        Of the transfer.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    InputError
        As `silint.io.check_output`; or the folder's format does not take that transfer.
    """
    try:
        file = Path(path)
    except TypeError:
        raise InputError(f"output path is a {type(path).__name__}; expected a string or a path") from None
    if not _is_folder(path):
        if file.suffix.lower() not in TRANSFER_SUFFIXES:
            raise InputError(
                f"{file}: unknown suffix {file.suffix!r}; expected one of {' '.join(TRANSFER_SUFFIXES)}, "
                "or a folder for bounce/bounce0.txt"
            )
        return check_output(file, TRANSFER_SUFFIXES)
    if (max_degree, per, weighting) != (2, "vertex", "cosine"):
        raise InputError(
            f"{file}: a folder gets bounce/bounce0.txt, which takes degree 2, per vertex, cosine; "
            f"this is degree {max_degree}, per {per}, {weighting}"
        )
    return check_bounce_output(file)


def write_transfer(path: str | os.PathLike[str], transfer: TransferArrays) -> tuple[Path, ...]:
    """Write a transfer in the format that the suffix names (see the module's head).

    Parameters
    ----------
    path : str or path-like
        As in `check_transfer_output`.
    transfer : TransferArrays

    Returns
    -------
    tuple of pathlib.Path
        The files that were written, each whole or not at all.

    Raises
    ------
    InputError
        As `check_transfer_output`, or the format cannot hold the numbers.
    """
    check_transfer_output(path, transfer.max_degree, transfer.per, transfer.weighting)
    file = Path(path)
    if _is_folder(path):
        return write_bounce(file, transfer.coefficients, transfer.faces)
    header = _header(transfer)
    formats = {".npz": _npz_bytes, ".ply": _ply_bytes, ".glb": _glb_bytes}
    write_bytes(file, formats[file.suffix.lower()](transfer, header))
    return (file,)


def _is_folder(path: str | os.PathLike[str]) -> bool:
    if os.fspath(path).endswith(("/", os.sep)):
        return True
    suffix = Path(path).suffix.lower()
    return suffix not in TRANSFER_SUFFIXES and (not suffix or os.path.isdir(path))


def _header(transfer: TransferArrays) -> dict[str, Any]:
    header = {
        _KEY: SCHEMA,
        **CONVENTIONS,
        "meaning": _MEANINGS[transfer.weighting],
        "weighting": transfer.weighting,
        "max_degree": transfer.max_degree,
        "per": transfer.per,
        "diagnostics": dict(transfer.diagnostics),
        "metadata": dict(transfer.metadata),
    }
    try:
        # NaN is no JSON, and other readers stop at it.
        copy: dict[str, Any] = json.loads(json.dumps(header, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(f"diagnostics or metadata hold what JSON cannot: {error}") from None
    return copy


def _npz_bytes(transfer: TransferArrays, header: dict[str, Any]) -> bytes:
    arrays = {name: _little_endian(getattr(transfer, name)) for name in _ARRAYS}
    text = json.dumps(header)
    sums = {name: _checksum(array) for name, array in arrays.items()}
    sums["metadata"] = hashlib.sha256(text.encode()).hexdigest()
    buffer = io.BytesIO()
    np.savez(buffer, metadata=np.array(text), checksums=np.array(json.dumps(sums)), **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _little_endian(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def _checksum(array: npt.NDArray[Any]) -> str:
    """SHA-256 of type, shape and contents: the same numbers in another shape are another array."""
    digest = hashlib.sha256(f"{array.dtype.str} {array.shape}".encode())
    digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _float32(transfer: TransferArrays) -> npt.NDArray[np.float32]:
    with np.errstate(over="ignore"):
        values = transfer.coefficients.astype(np.float32)
    if not np.isfinite(values).all():
        raise InputError("coefficients reach beyond 3.4e38, the end of float32; write .npz")
    return values


def _ply_bytes(transfer: TransferArrays, header: dict[str, Any]) -> bytes:
    kind = position_type(transfer.vertices)
    results: list[Field] = [(f"n{axis}", kind, transfer.normals[:, i]) for i, axis in enumerate("xyz")]
    results += [(f"sh_{i}", "float", column) for i, column in enumerate(_float32(transfer).T)]
    vertex: list[Field] = [(axis, kind, transfer.vertices[:, i]) for i, axis in enumerate("xyz")]
    per_vertex = transfer.per == "vertex"
    return ply_bytes(
        vertex + results if per_vertex else vertex,
        transfer.faces,
        [] if per_vertex else results,
        [f"silint {json.dumps(header)}"],
    )


def _glb_bytes(transfer: TransferArrays, header: dict[str, Any]) -> bytes:
    values: npt.NDArray[Any] = _float32(transfer)
    vertices, faces, normals = transfer.vertices, transfer.faces, transfer.normals
    if transfer.per == "face":
        vertices = vertices[faces.ravel()]
        values, normals = np.repeat(values, 3, axis=0), np.repeat(normals, 3, axis=0)
        faces = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    padded = np.pad(values, ((0, 0), (0, -values.shape[1] % 4)))
    attributes = {f"_SH{i // 4}": padded[:, i : i + 4] for i in range(0, padded.shape[1], 4)}
    return glb_bytes(vertices, faces, normals, attributes, header)


# --------------------------------------------------------------------------------------------- reading


def read_transfer(path: str | os.PathLike[str]) -> TransferArrays:
    """Read what `write_transfer` wrote.

    Parameters
    ----------
    path : str or path-like
        A .npz, .ply or .glb file.

    Returns
    -------
    TransferArrays
        Of a .npz to the last bit. Of a .ply with coefficients rounded to float32. Of a .glb everything is
        rounded to float32, a vertex without normal has got (0, 0, 1), and with results for faces every face
        has three vertices of its own.

    Raises
    ------
    InputError
        No such file, not one of these, damaged (a checksum of a .npz does not fit), or of a newer schema.
    """
    try:
        file = Path(path)
    except TypeError:
        raise InputError(f"path is a {type(path).__name__}; expected a string or a path") from None
    try:
        if file.is_dir():
            raise InputError("is a folder, whose bounce0.txt has no vertices; silint.io.read_bounce reads it")
        readers = {".npz": _read_npz, ".ply": _read_ply, ".glb": _read_glb}
        if file.suffix.lower() not in readers:
            raise InputError(f"unknown suffix {file.suffix!r}; expected one of {' '.join(readers)}")
        return readers[file.suffix.lower()](file.read_bytes())
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror or error})") from None
    except MemoryError:
        raise
    except Exception:  # whatever the parsers trip over: KeyError, zlib.error, "is encrypted", ...
        raise InputError(f"{file}: not a transfer file that silint wrote, or damaged") from None


def _read_npz(data: bytes) -> TransferArrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        text = str(archive["metadata"])
        header = _checked_header(json.loads(text))
        sums = json.loads(str(archive["checksums"]))
        arrays = {name: archive[name] for name in _ARRAYS}
    found = {name: _checksum(array) for name, array in arrays.items()}
    found["metadata"] = hashlib.sha256(text.encode()).hexdigest()
    for name, digest in found.items():
        if sums[name] != digest:
            raise InputError(f"the checksum of {name} does not fit; the file was changed or is damaged")
    return _from_header(header, **arrays)


def _read_ply(data: bytes) -> TransferArrays:
    ply = read_ply(data)
    comment = next(c for c in [*ply.comments, ""] if c.startswith("silint ") or not c)
    header = _checked_header(json.loads(comment.removeprefix("silint ")))
    rows = ply.vertex if header["per"] == "vertex" else ply.face
    return _from_header(
        header,
        _columns(ply.vertex, ["x", "y", "z"]),
        ply.face["index"],
        _columns(rows, ["nx", "ny", "nz"]),
        _columns(rows, [f"sh_{i}" for i in range((header["max_degree"] + 1) ** 2)]),
    )


def _read_glb(data: bytes) -> TransferArrays:
    mesh = read_glb(data)
    header = _checked_header(mesh.extras)
    # Every third vertex speaks for a face; the other two say the same.
    step = 1 if header["per"] == "vertex" else 3
    if step == 3 and not np.array_equal(mesh.faces.ravel(), np.arange(len(mesh.attributes["POSITION"]))):
        raise ValueError("faces share vertices")
    n = (header["max_degree"] + 1) ** 2
    parts = [mesh.attributes[f"_SH{i}"] for i in range((n + 3) // 4)]
    return _from_header(
        header,
        mesh.attributes["POSITION"],
        mesh.faces,
        mesh.attributes["NORMAL"][::step],
        np.concatenate(parts, axis=1)[::step, :n],
    )


def _columns(rows: npt.NDArray[np.void], names: list[str]) -> npt.NDArray[np.float64]:
    out = np.empty((len(rows), len(names)))
    with np.errstate(invalid="ignore"):  # signalling NaNs, which are refused with the others
        for i, name in enumerate(names):
            out[:, i] = rows[name]
    return out


def _checked_header(header: Any) -> dict[str, Any]:
    """The header, if this version knows what everything in its file means."""
    schema = header[_KEY]
    if not isinstance(schema, int) or schema > SCHEMA:
        raise InputError(f"schema {schema}; this silint reads up to {SCHEMA}, a newer one wrote the file")
    for name, value in CONVENTIONS.items():
        if header[name] != value:
            raise InputError(f"{name} is {header[name]!r}; this silint reads {value!r}")
    checked: dict[str, Any] = header
    return checked


def _from_header(
    header: dict[str, Any],
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    normals: npt.NDArray[Any],
    coefficients: npt.NDArray[Any],
) -> TransferArrays:
    return TransferArrays(
        vertices,
        faces,
        normals,
        coefficients,
        header["per"],
        header["max_degree"],
        header["weighting"],
        header["diagnostics"],
        header["metadata"],
    )
