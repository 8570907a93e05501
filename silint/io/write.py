"""Results to files: whole, or not at all.

A file is written under a temporary name beside its target and renamed when complete, so that neither an
error nor Ctrl-C leaves half a file, and an older result stays until the new one is there.

==========  =====================================================================================
``.npz``    ``value``, ``points``, ``normals`` (float64) and ``metadata``, a JSON string
``.ply``    binary; the value as properties of vertices or faces in double (``ao``, ``sky``,
            ``bent_x bent_y bent_z``, ``irradiance_r irradiance_g irradiance_b``), positions as the
            mesh has them, ``nx ny nz``, and 8-bit colours for viewers; the metadata stands in a
            ``comment silint`` line
``.glb``    float32 ``_AO``, ``_SKY``, ``_BENT`` or ``_IRRADIANCE`` and ``COLOR_0`` (linear, as glTF
            asks: grey, for bent normals (b + 1) / 2, for irradiance `TONE_CURVE`); results for faces
            unshare the vertices, three for each face
==========  =====================================================================================

`read_values` reads all three. Other readers of .ply: trimesh puts properties that it does not know under
``mesh.metadata["_ply_raw"]["vertex"]["data"]["ao"]`` (or ``"face"``).
"""

from __future__ import annotations

import io
import json
import os
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from silint.io.glb import glb_bytes, glb_values
from silint.io.ply import Field, ply_bytes, position_type
from silint.io.unfinished import discarded_if_cut_off
from silint.validation import InputError

__all__ = [
    "LUMINANCE",
    "OUTPUT_SUFFIXES",
    "TONE_CURVE",
    "Baked",
    "check_output",
    "read_values",
    "write_baked",
    "write_bytes",
    "write_together",
]

OUTPUT_SUFFIXES = (".npz", ".ply", ".glb")

# Of linear Rec. 709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# How irradiance becomes a colour: 63 % of white at the mean.
TONE_CURVE = "1 - exp(-value / m) with m the mean luminance of all values, linear"


class Baked(NamedTuple):
    """One quantity on a mesh, and what a file says about it."""

    quantity: str
    """``ao``, ``sky``, ``bent`` or ``irradiance``: names the property."""
    per: str
    """``vertex`` or ``face``."""
    value: npt.NDArray[np.float64]
    """(n,) or (n, 3), a row for each vertex or face."""
    points: npt.NDArray[np.float64]
    """(n, 3) where the value was taken."""
    normals: npt.NDArray[np.float64]
    """(n, 3) unit normals there; zero where there is none."""
    vertices: npt.NDArray[np.float64]
    """(V, 3) of the mesh."""
    faces: npt.NDArray[np.integer[Any]]
    """(F, 3) of the mesh."""
    metadata: dict[str, Any]
    """Anything that JSON can hold."""


def check_output(path: str | os.PathLike[str], suffixes: tuple[str, ...] = OUTPUT_SUFFIXES) -> Path:
    """Make sure, before any computing, that a file can be written there.

    Parameters
    ----------
    path : str or path-like
        The file to be written.
    suffixes : tuple of str
        What its name may end in.

    Returns
    -------
    pathlib.Path
        Where links lead; the place itself is not touched.

    Raises
    ------
    InputError
        Unknown suffix, a folder of that name, a folder that does not exist or cannot be written to, or a
        write-protected file, in one line that names the path.
    """
    try:
        file = Path(path)
    except TypeError:
        raise InputError(f"output path is a {type(path).__name__}; expected a string or a path") from None
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: unknown suffix {file.suffix!r}; expected one of {' '.join(suffixes)}")
    try:
        target = Path(os.path.realpath(file))
        if target.is_dir():
            raise InputError(f"{file}: is a folder; expected the name of a file")
        if not target.parent.is_dir():
            raise InputError(f"{file}: its folder {str(file.parent)!r} does not exist; create it first")
        if target.exists() and not os.access(target, os.W_OK):
            raise InputError(f"{file}: the file is write-protected")
        # Permission bits do not tell about read-only mounts, quotas or access lists; an attempt does.
        attempt = _temporary_name(target)
        attempt.open("xb").close()
        attempt.unlink()
    except InputError:
        raise
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{file}: its folder cannot be written to ({reason})") from None
    return target


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file whole or not at all.

    Parameters
    ----------
    path : str or path-like
        Replaced if it exists.
    data : bytes
        All of its contents.

    Raises
    ------
    InputError
        The file system refuses; whatever stood there before is untouched.
    """
    write_together([(path, data)])


def write_together(contents: Sequence[tuple[str | os.PathLike[str], bytes]]) -> None:
    """Write files that belong together, each whole or not at all.

    All are complete, under their temporary names, before the first is renamed: a full disk leaves all of the
    old ones.

    Parameters
    ----------
    contents : sequence of (path, bytes)
        Each is replaced if it exists.

    Raises
    ------
    InputError
        The file system refuses.
    """
    moves: list[tuple[Path, Path]] = []
    path: str | os.PathLike[str] = ""

    def discard() -> None:
        for temporary, _ in moves:
            temporary.unlink(missing_ok=True)

    with discarded_if_cut_off(discard):
        try:
            for path, data in contents:
                target = Path(os.path.realpath(path))
                temporary = _temporary_name(target)
                moves.append((temporary, target))
                with temporary.open("xb") as stream:
                    stream.write(data)
            for (temporary, target), (path, _) in zip(moves, contents, strict=True):  # noqa: B007
                os.replace(temporary, target)
        except OSError as error:
            discard()
            raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None
        except BaseException:  # Ctrl-C too
            discard()
            raise


def write_baked(path: str | os.PathLike[str], baked: Baked) -> None:
    """Write a result in the format that the suffix names (see the module's head).

    Parameters
    ----------
    path : str or path-like
        Ends in one of `OUTPUT_SUFFIXES`.
    baked : Baked
        The result and its mesh.

    Raises
    ------
    InputError
        As `check_output` and `write_bytes`.
    """
    target = check_output(path)
    formats = {".npz": _npz_bytes, ".ply": _ply_bytes, ".glb": _glb_bytes}
    write_bytes(target, formats[target.suffix.lower()](baked))


def read_values(path: str | os.PathLike[str], quantity: str) -> npt.NDArray[np.float64]:
    """The values that `write_baked` wrote.

    Parameters
    ----------
    path : str or path-like
        An .npz, .ply or .glb file.
    quantity : str
        ``ao``, ``sky``, ``bent`` or ``irradiance``.

    Returns
    -------
    ndarray of float64, shape (n,) or (n, 3)
        A row for each vertex or face; of a .glb, for each of its vertices, in float32 precision.

    Raises
    ------
    InputError
        No such file, or it does not hold that quantity.
    """
    file = Path(path)
    try:
        if file.suffix.lower() == ".npz":
            with np.load(file, allow_pickle=False) as archive:
                if json.loads(str(archive["metadata"])).get("quantity") != quantity:
                    raise KeyError(quantity)
                return np.asarray(archive["value"], dtype=np.float64)
        if file.suffix.lower() == ".glb":
            return glb_values(file.read_bytes(), f"_{quantity.upper()}")
        return _ply_values(file, _property_names(quantity))
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror or error})") from None
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError(f"{file}: holds no {quantity!r} that silint wrote") from None


def _temporary_name(target: Path) -> Path:
    # Not mkstemp: it would leave the result readable by its owner only, whatever the umask says.
    return target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")


def _property_names(quantity: str) -> tuple[str, ...]:
    suffixes = {"bent": "xyz", "irradiance": "rgb"}.get(quantity)
    return tuple(f"{quantity}_{suffix}" for suffix in suffixes) if suffixes else (quantity,)


def _colors(baked: Baked) -> npt.NDArray[np.float64]:
    """(n, 3) in [0, 1]: grey for a fraction, (b + 1) / 2 for a direction, `TONE_CURVE` for irradiance."""
    value = baked.value
    if baked.quantity == "irradiance":
        mean = float((value @ LUMINANCE).mean()) if len(value) else 0.0
        return np.asarray(-np.expm1(-value / mean)) if mean > 0.0 else np.zeros_like(value)
    rgb = np.repeat(value[:, None], 3, axis=1) if value.ndim == 1 else 0.5 * (value + 1.0)
    return np.clip(rgb, 0.0, 1.0)


def _npz_bytes(baked: Baked) -> bytes:
    buffer = io.BytesIO()
    np.savez(
        buffer,
        value=baked.value,
        points=baked.points,
        normals=baked.normals,
        metadata=np.array(json.dumps(baked.metadata)),
    )
    return buffer.getvalue()


def _ply_bytes(baked: Baked) -> bytes:
    kind = position_type(baked.vertices)
    columns = baked.value.reshape(len(baked.value), -1)
    results: list[Field] = [(f"n{axis}", kind, baked.normals[:, i]) for i, axis in enumerate("xyz")]
    results += [(name, "double", columns[:, i]) for i, name in enumerate(_property_names(baked.quantity))]
    eight_bit = np.rint(255.0 * _colors(baked))
    results += [(name, "uchar", eight_bit[:, i]) for i, name in enumerate(("red", "green", "blue"))]

    vertex: list[Field] = [(axis, kind, baked.vertices[:, i]) for i, axis in enumerate("xyz")]
    per_vertex = baked.per == "vertex"
    return ply_bytes(
        vertex + results if per_vertex else vertex,
        baked.faces,
        [] if per_vertex else results,
        [f"silint {json.dumps(baked.metadata)}"],
    )


def _ply_values(file: Path, names: tuple[str, ...]) -> npt.NDArray[np.float64]:
    import trimesh

    mesh = cast(Any, trimesh.load_scene(str(file), process=False, fix_texture=False))
    for part in mesh.geometry.values():
        for element in part.metadata["_ply_raw"].values():
            if all(name in element["properties"] for name in names):
                columns = [np.array(element["data"][name], dtype=np.float64).reshape(-1) for name in names]
                return np.stack(columns, axis=1) if len(columns) > 1 else columns[0]
    raise KeyError(names[0])


def _glb_bytes(baked: Baked) -> bytes:
    value, normals, colors = baked.value, baked.normals, _colors(baked)
    vertices, faces = baked.vertices, np.asarray(baked.faces)
    if baked.per == "face":
        vertices = vertices[faces.ravel()]
        value, normals, colors = (np.repeat(rows, 3, axis=0) for rows in (value, normals, colors))
        faces = np.arange(3 * len(faces)).reshape(-1, 3)
    attributes = {"COLOR_0": colors, f"_{baked.quantity.upper()}": value}
    return glb_bytes(vertices, faces, normals, attributes, baked.metadata)
