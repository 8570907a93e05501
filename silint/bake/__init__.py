"""From a mesh file to a file with a value for each of its vertices or faces."""

from __future__ import annotations

from silint.bake.files import bake, bake_scene, check_unread, load_and_build, peak_memory, same_file
from silint.bake.options import NORMALS, PER, QUANTITIES, WEIGHTINGS, BakeOptions
from silint.bake.targets import sites

__all__ = [
    "NORMALS",
    "PER",
    "QUANTITIES",
    "WEIGHTINGS",
    "BakeOptions",
    "bake",
    "bake_scene",
    "check_unread",
    "load_and_build",
    "peak_memory",
    "same_file",
    "sites",
]
