"""Texture bakes: time, texels, jumps across seams; beside Blender's where its Python module is at hand.

    python benchmarks/texture.py spot room fandisk --assets MESHES --size 1024 --pictures DIR
    python benchmarks/texture.py spot --assets MESHES --blender PYTHON --samples 64 256 1024

Meshes are unwrapped by xatlas first. ``--blender`` names a Python that can import bpy, which bakes the .glb
that silint has written: same triangles, normals and texture coordinates, no limit of distance. Errors are
those of texels two texels and more away from the borders of charts, against silint with 2048 isolines.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT, InputError, fail, find, markdown, write

import scenes
from silint.io.uvs import read_uvs
from silint.render import render
from silint.scene import load_scene
from silint.texture import bake_texture

REFERENCE = 2048  # isolines


def as_file(source: str, assets: str | None, folder: Path) -> Path:
    path = find(source, assets)
    if path is not None:
        return path
    vertices, faces = scenes.build(source)
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, np.float32).astype(float).tolist()]
    rows += [f"f {a} {b} {c}" for a, b, c in (np.asarray(faces) + 1).tolist()]
    path = folder / f"{source}.obj"
    path.write_text("\n".join(rows) + "\n")
    return path


def read_exr(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Grey values (H, W) and where texels have their own; everywhere in files without that channel."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels, float) for name, channel in file.channels().items()}
    grey = channels["Y" if "Y" in channels else "R"]
    return grey, channels.get("coverage", np.ones_like(grey)) > 0.5


def picture(path: Path, glb: Path, texture: np.ndarray, up: str, **view: Any) -> None:
    """The mesh with its texture on it; every face in many, as `render` interpolates between corners."""
    scene = load_scene(glb)
    uvs = read_uvs(glb, scene.n_faces)
    assert uvs is not None
    n = int(np.clip(np.sqrt(3e5 / scene.n_faces), 1, 40))
    rows = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
    row_of = {place: k for k, place in enumerate(rows)}
    b, c = np.array(rows).T / n
    weights = np.stack([1.0 - b - c, b, c], axis=1)
    small = [(row_of[i, j], row_of[i + 1, j], row_of[i, j + 1]) for i, j in rows if i + j < n]
    small += [(row_of[i + 1, j], row_of[i + 1, j + 1], row_of[i, j + 1]) for i, j in rows if i + j < n - 1]
    vertices = np.einsum("wi,fij->fwj", weights, scene.vertices[scene.faces])
    uv = np.einsum("wi,fij->fwj", weights, uvs).reshape(-1, 2)
    faces = np.array(small)[None] + len(rows) * np.arange(scene.n_faces)[:, None, None]
    size = len(texture)
    x = np.clip(uv * (size, -size) + (-0.5, size - 0.5), 0, size - 1)
    low = np.minimum(x.astype(int), size - 2)
    f = x - low
    at = [texture[low[:, 1] + j, low[:, 0] + i] for j in (0, 1) for i in (0, 1)]
    upper, lower = at[0] * (1 - f[:, 0]) + at[1] * f[:, 0], at[2] * (1 - f[:, 0]) + at[3] * f[:, 0]
    colors = upper * (1 - f[:, 1]) + lower * f[:, 1]
    axis = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[up]
    corners = vertices.reshape(-1, 3)
    render(corners, faces.reshape(-1, 3), colors, path, up=axis, shaded=False, **view)


def interior(covered: np.ndarray) -> np.ndarray:
    """Texels all of whose neighbours, two steps far, have a value of their own."""
    from scipy.ndimage import binary_erosion

    return np.asarray(binary_erosion(covered, np.ones((5, 5))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--assets")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--isolines", type=int, default=64)
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--up", default="y", choices=("x", "y", "z"))
    parser.add_argument("--blender", metavar="PYTHON")
    parser.add_argument("--samples", type=int, nargs="+", default=[64, 256])
    parser.add_argument("--out")
    options = parser.parse_args()
    tables = []
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            rows = [row_of(source, options, folder) for source in options.scenes]
            header = ["mesh", "triangles", "charts", "texels", "shade points", "unwrap", "integrate"]
            header += ["points/s", "largest jump before", "after", "RMS before", "after"]
            tables.append(markdown(header, rows))
            if options.blender:
                for source in options.scenes:
                    tables.append(beside_blender(source, options, folder))
    except InputError as error:
        fail(error)
    write(options.out, "\n\n".join(tables))


def row_of(source: str, options: argparse.Namespace, folder: Path) -> list[str]:
    path, glb = as_file(source, options.assets, folder), folder / f"{source}.glb"
    bake_texture(path, folder / "warm.png", 16, isolines=options.isolines, uv="unwrap")
    summary = bake_texture(path, glb, options.size, isolines=options.isolines, uv="unwrap")
    seams, seconds = summary["seams"], summary["seconds"]
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
        bake_texture(glb, options.pictures / f"{source}.png", options.size, isolines=options.isolines)
        bake_texture(glb, folder / "shown.exr", options.size, isolines=options.isolines)
        image, _ = read_exr(folder / "shown.exr")
        picture(options.pictures / f"{source}-textured.png", glb, image, options.up)
    jumps = ("largest_jump_before", "largest_jump_after", "rms_jump_before", "rms_jump_after")
    return [
        source,
        f"{summary['n_faces']:,}",
        f"{summary['n_charts']}",
        f"{summary['texels']['covered']:,}",
        f"{summary['n_points']:,}",
        f"{seconds['layout']:.1f} s",
        f"{seconds['integrate']:.1f} s",
        f"{summary['n_points'] / seconds['integrate']:,.0f}",
        *(f"{seams[jump]:.1e}" if jump in seams else "-" for jump in jumps),
    ]


def beside_blender(source: str, options: argparse.Namespace, folder: Path) -> str:
    glb = folder / f"{source}.glb"
    bake_texture(glb, folder / "reference.exr", options.size, isolines=REFERENCE, samples=1)
    reference, covered = read_exr(folder / "reference.exr")
    inner = interior(covered)
    rows = []

    def add(name: str, seconds: float, image: np.ndarray) -> None:
        error = np.abs(image - reference)[inner]
        rms = np.sqrt((error**2).mean())
        rows.append([name, f"{seconds:.1f} s", f"{rms:.1e}", f"{np.quantile(error, 0.999):.1e}"])

    for isolines in (32, 64, 128):
        summary = bake_texture(glb, folder / "silint.exr", options.size, isolines=isolines, samples=1)
        seconds = sum(summary["seconds"].values()) - summary["seconds"]["load"]
        add(f"silint, {isolines} isolines", seconds, read_exr(folder / "silint.exr")[0])
    for samples in options.samples:
        out = folder / "blender.exr"
        command = [options.blender, str(ROOT / "benchmarks" / "blender_bake.py"), str(glb), str(out)]
        done = subprocess.run(
            [*command, str(options.size), str(samples)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            sys.exit(f"error: Blender's bake failed: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
        told = json.loads(done.stdout.strip().splitlines()[-1])
        add(f"Blender {told['version']}, {samples} samples", told["seconds"], read_exr(out)[0])
    title = f"{source}, {int(inner.sum()):,} texels away from charts' borders"
    return f"{title}\n\n" + markdown(["", "time", "RMSE", "99.9 % below"], rows)


if __name__ == "__main__":
    main()
