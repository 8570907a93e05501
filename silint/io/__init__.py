"""Files to plain arrays and back."""

from __future__ import annotations

from silint.io.bounce import read_bounce
from silint.io.read import MESH_SUFFIXES, MeshData, mesh_data, read_mesh
from silint.io.write import (
    LUMINANCE,
    OUTPUT_SUFFIXES,
    TONE_CURVE,
    Baked,
    check_output,
    read_values,
    write_baked,
    write_bytes,
)

__all__ = [
    "LUMINANCE",
    "MESH_SUFFIXES",
    "OUTPUT_SUFFIXES",
    "TONE_CURVE",
    "Baked",
    "MeshData",
    "check_output",
    "mesh_data",
    "read_bounce",
    "read_mesh",
    "read_values",
    "write_baked",
    "write_bytes",
]
