"""README's picture of lighting: one transfer under a sun that turns, and the all-frequency answer beside it.

    python benchmarks/lighting.py                     # the packaged scene, a clear sky: docs/lighting.png
    python benchmarks/lighting.py --envmap MAP.hdr    # under a map

From left to right: harmonics of degree 4 (25 numbers a vertex) under two turns of the sky, and irradiance
past silhouettes with the sun as sharp as the map has it, on 64 and on 512 isolines.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path

import numpy as np
from common import ROOT

import silint
from silint.demo import demo_scene
from silint.prt import prt
from silint.render import render

SUN = (-0.75, -0.35, 0.5)
DEGREE = 4
TURNS = (100.0, 0.0)
ISOLINES = (64, 512)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--envmap", help="a map in place of the clear sky")
    parser.add_argument("--output", default=str(ROOT / "docs" / "lighting.png"))
    parser.add_argument("--size", type=int, default=420, help="pixels of each picture's side")
    options = parser.parse_args()
    if options.envmap:
        sky = silint.Environment.from_file(options.envmap, up="z")
    else:
        sky = silint.Environment.cie_clear_sky(
            SUN, zenith=(0.35, 0.6, 1.0), sun_irradiance=(16.0, 13.0, 9.0), up="z", ground_albedo=0.15
        )
    integrator = silint.SilhouetteIntegrator(demo_scene())
    scene = integrator.scene
    normals, valid = scene.vertex_normals()

    transfer = prt(integrator, max_degree=DEGREE)
    light = silint.sh.window(sky.sh(DEGREE), "hanning", DEGREE + 2, axis=0)
    pictures = []
    for degrees in TURNS:
        turned = silint.sh.rotate(
            light, silint.validation.rotation_matrix(((0, 0, 1), degrees), "turn"), axis=0
        )
        pictures.append(np.maximum(transfer.shade(turned), 0.0))
    for isolines in ISOLINES:
        exitant = np.zeros((scene.n_vertices, 3))
        exitant[valid] = integrator.irradiance(scene.vertices[valid], normals[valid], sky, isolines) / np.pi
        pictures.append(exitant)
    exposure = 0.45 / np.mean(pictures[-1])
    tiles = []
    for picture in pictures:
        tiles.append(_drawn(scene, 1.0 - np.exp(-exposure * picture), options.size))
    _save(np.concatenate(tiles, axis=1), options.output)
    print(f"wrote {options.output}")


def _drawn(scene: silint.Scene, colours: np.ndarray, size: int) -> np.ndarray:
    from matplotlib.image import imread

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "tile.png"
        render(scene.vertices, scene.faces, colours, path, size, size, shaded=False)
        return imread(io.BytesIO(path.read_bytes()))


def _save(image: np.ndarray, path: str) -> None:
    from matplotlib.image import imsave

    imsave(path, image)


if __name__ == "__main__":
    main()
