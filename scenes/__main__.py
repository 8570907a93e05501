"""Write scenes as files: ``python -m scenes NAME... [-o DIR] [--list]``.

The files are binary PLY with double coordinates. (Writers of float coordinates, such as trimesh's, would
round abutting and coplanar faces apart.)
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import NoReturn

import numpy as np

from scenes import SCENES, build
from scenes.mesh import Faces, Vertices


def write_ply(path: Path, vertices: Vertices, faces: Faces) -> None:
    """Write one mesh; `path` appears whole or not at all."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    records = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    records["count"] = 3
    records["corners"] = faces
    unfinished = path.with_name(path.name + ".part")
    try:
        with unfinished.open("wb") as file:
            file.write(header.encode("ascii"))
            file.write(vertices.astype("<f8").tobytes())
            file.write(records.tobytes())
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and write what it names."""
    parser = argparse.ArgumentParser(prog="python -m scenes", description="Write scenes as .ply files.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenes to write")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path(), metavar="DIR", help="existing folder (default: .)"
    )
    parser.add_argument("--list", action="store_true", help="list all scenes and exit")
    options = parser.parse_args(arguments)
    if options.list:
        for spec in SCENES.values():
            print(f"{spec.name:18} {spec.triangles:>9,}  {spec.kind:9} {spec.description}")
        return

    def fail(message: str) -> NoReturn:
        parser.exit(2, f"scenes: {message}\n")

    if not options.names:
        fail("name at least one scene, or use --list")
    unknown = [name for name in options.names if name not in SCENES]
    if unknown:
        fail(f"no scene is called {', '.join(unknown)}: --list shows them all")
    if not options.out.is_dir():
        fail(f"{options.out} is not a folder: create it first")
    for name in options.names:
        path = options.out / f"{name}.ply"
        try:
            write_ply(path, *build(name))
        except OSError as error:
            fail(f"cannot write {path}: {error.strerror}")
        print(f"{path}  {SCENES[name].triangles:,} triangles")


if __name__ == "__main__":
    main()
