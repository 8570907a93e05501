"""What each integrand costs on top of the silhouettes: both phases apart, on one scene.

    python benchmarks/integrands.py clutter_31k
    python benchmarks/integrands.py MESHES/armadillo.ply --output docs/integrands.md

Octahedral isolines: phase one (`visibility`) is the same for every integrand; phase two reads its tables.
Radial isolines: whole queries, since their intervals are not handed out. Medians of rounds taken in turns;
tables are built before, as they serve all points. Aims: irradiance at most 1.5 times ambient occlusion, both
octahedral and as a whole; SH transfer of degree 4 at most twice ambient occlusion, both radial.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import InputError, fail, find, load, markdown, write

import silint
from silint.bench.measure import in_company
from silint.bench.sites import shade_sites

Query = Callable[[], Any]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene", nargs="?", default="clutter_31k", help="a generated scene, or a mesh file")
    parser.add_argument("--assets", help="folder of meshes")
    parser.add_argument("--envmap", help="an RGB map in place of the clear sky")
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--isolines", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", help="a markdown file")
    options = parser.parse_args()
    try:
        scene = load(options.scene, options.assets)
        sites = "surface" if find(options.scene, options.assets) is None else "vertices"
    except InputError as error:
        fail(error)
    points, normals = shade_sites(scene, sites, 100_000, np.random.default_rng(0))
    rows = in_company(points, normals)[: options.points]
    p, n, k = points[rows], normals[rows], options.isolines
    sil = silint.SilhouetteIntegrator(scene)
    sky = silint.Environment.cie_clear_sky((0.5, 0.6, 0.6), sun_irradiance=3.0)
    colour = silint.Environment.from_array(np.repeat(sky.texel_radiance, 3, axis=2) * [1.0, 0.9, 0.8])
    if options.envmap:
        colour = silint.Environment.from_file(options.envmap)
    vis = sil.visibility(p, n, isolines=k)
    octahedral = {"isolines": k, "method": "octahedral"}

    def harmonics(degree: int, **how: Any) -> Query:
        return lambda: sil.sh_transfer(p, n, degree, **how)

    queries: dict[str, Query] = {
        "phase one: octahedral visibility": lambda: sil.visibility(p, n, isolines=k),
        "phase two: ambient occlusion": vis.ambient_occlusion,
        "phase two: irradiance, grey": lambda: vis.irradiance(sky),
        "phase two: irradiance, RGB": lambda: vis.irradiance(colour),
        **{f"phase two: SH degree {d}": lambda d=d: vis.sh_transfer(d) for d in (2, 4, 8)},
        "octahedral ambient occlusion": lambda: sil.ambient_occlusion(p, n, **octahedral),
        "octahedral irradiance, RGB": lambda: sil.irradiance(p, n, colour, **octahedral),
        "octahedral SH degree 4": harmonics(4, **octahedral),
        "radial ambient occlusion": lambda: sil.ambient_occlusion(p, n, isolines=k),
        "radial bent normals": lambda: sil.bent_normals(p, n, isolines=k),
        "radial irradiance, RGB": lambda: sil.irradiance(p, n, colour, isolines=k),
        **{f"radial SH degree {d}": harmonics(d, isolines=k) for d in (2, 4, 8)},
    }
    times: dict[str, list[float]] = {name: [] for name in queries}
    for r in range(options.rounds + 1):  # the first compiles and builds tables
        for name, query in queries.items():
            began = time.perf_counter()
            query()
            if r > 0:
                times[name].append((time.perf_counter() - began) / len(p) * 1e6)
    medians = {name: statistics.median(found) for name, found in times.items()}
    whole = {"octahedral": "octahedral ambient occlusion", "radial": "radial ambient occlusion"}
    lines = []
    for name, found in medians.items():
        base = whole.get(name.split()[0])
        lines.append([name, f"{found:.2f}", f"{found / medians[base]:.2f}x" if base else ""])
    title = f"{scene.name}, {len(scene.faces):,} triangles, {len(p):,} points, {k} isolines"
    header = ["what", "us a point", "over ambient occlusion"]
    write(options.output, f"{title}\n\n{markdown(header, lines)}")


if __name__ == "__main__":
    main()
