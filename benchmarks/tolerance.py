"""Is ``ambient_occlusion(..., tolerance=t)`` within t? The share of points that are, and their cost.

    python benchmarks/tolerance.py clutter_9k foliage spot --assets MESHES --output docs/tolerance.md

The reference is 2048 octahedral isolines; where a point is further from it than t, Embree with 131,072 rays
tells which of the two is right.
"""

from __future__ import annotations

import argparse
import inspect
import sys

import numpy as np
from common import InputError, fail, find, load, markdown, write

import silint
from silint.bench.sites import shade_sites
from silint.bench.tolerance import Calibration, calibrate
from silint.reference import EmbreeQMC

SCENES = ["clutter_9k", "clutter_31k", "clutter_185k", "foliage", "room", "city", "teapot"]
REFERENCE_ISOLINES = 2048


def calibrations(source: str, options: argparse.Namespace) -> list[Calibration]:
    """One for each tolerance."""
    scene = load(source, options.assets)
    sites = "surface" if find(source, options.assets) is None else "vertices"
    points, normals = shade_sites(scene, sites, options.points, np.random.default_rng(options.seed))
    integrator = silint.SilhouetteIntegrator(scene)
    embree = EmbreeQMC(scene.vertices, scene.faces)
    reference = integrator.ambient_occlusion(points, normals, REFERENCE_ISOLINES, method="octahedral")

    def query(tolerance: float, rows: slice = slice(None)) -> np.ndarray:
        return integrator.ambient_occlusion(
            points[rows], normals[rows], tolerance=tolerance, method=options.method
        )

    out = []
    for tolerance in options.tolerances:
        query(tolerance, slice(1))  # compile, tabulate
        out.append(calibrate(query, reference, embree, points, normals, tolerance, options.seed))
    return out


def cell(found: Calibration) -> str:
    told = f", {100 * found.exonerated:.2f} % by Embree's word" if found.exonerated else ""
    return f"{100 * found.within:.2f} %{told}; {found.largest:.1e}; {found.us_per_point:,.1f} us"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES, help="generated scenes, files, or assets")
    parser.add_argument("--assets", help="folder of meshes")
    parser.add_argument("--tolerances", default="3e-3,1e-3,3e-4")
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--method", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    options.tolerances = [float(t) for t in options.tolerances.split(",")]
    if "tolerance" not in inspect.signature(silint.SilhouetteIntegrator.ambient_occlusion).parameters:
        sys.exit("this silint has no tolerance= yet: nothing to calibrate")
    rows = []
    try:
        for source in options.scenes:
            rows.append([source, *map(cell, calibrations(source, options))])
            print(*rows[-1], sep="  ", file=sys.stderr, flush=True)
    except InputError as error:
        fail(error)
    header = ["within tolerance; largest error; time a point", *(f"{t:.0e}" for t in options.tolerances)]
    write(options.output, markdown(header, rows))


if __name__ == "__main__":
    main()
