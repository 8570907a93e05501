"""The exact mode against Embree on any scenes: are they the same number, to six digits?

    python benchmarks/exact_against_embree.py spot clutter_9k --assets DIR --output docs/exact_embree.md
    ... --keep FOLDER        # Embree's values, which take hours at 2^20 rays, are kept there and read again

Area samples (scans: vertices), displaced as far as Embree needs; Embree takes 64 independent scrambles of
Sobol points each. `z rms` is the root mean square of differences in standard errors: about 1 where nothing
but sampling separates the two. A point counts as different beyond the quantile that one of all points passes
once in a hundred runs (Sidak); each is listed with what 4096 isolines of both families make of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import InputError, fail, find, load, markdown, write
from scipy.stats import t as student

import silint
from silint.bench.sites import shade_sites
from silint.reference import EmbreeQMC, embree_points

SCRAMBLES = 64


class Estimate(NamedTuple):
    """Of the rays that were kept."""

    value: np.ndarray  # (n,)
    standard_error: np.ndarray  # (n,)


def references(
    scene: silint.Scene, points: np.ndarray, normals: np.ndarray, options: argparse.Namespace
) -> Estimate:
    """Embree's values at the points, from a file where they are kept."""
    rays = options.rays // SCRAMBLES
    kept = None
    if options.keep:
        kept = Path(options.keep) / f"{scene.name}_{len(points)}x{options.rays}_{options.seed}.npz"
        if kept.exists():
            with np.load(kept) as file:
                if np.array_equal(file["points"], points) and np.array_equal(file["normals"], normals):
                    return Estimate(file["value"], file["standard_error"])
    embree = EmbreeQMC(scene.vertices, scene.faces)
    found = embree.ambient_occlusion(points, normals, rays, seed=options.seed, scrambles=SCRAMBLES)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(kept, points=points, normals=normals, value=found.value, standard_error=found.standard_error)
    return Estimate(found.value, found.standard_error)


def compare(source: str, options: argparse.Namespace) -> tuple[list[str], list[str]]:
    """One row of the table, and a line for every point that differs."""
    scene = load(source, options.assets)
    sites = "surface" if find(source, options.assets) is None else "vertices"
    points, normals = shade_sites(scene, sites, options.points, np.random.default_rng(options.seed))
    p = embree_points(scene.vertices, scene.faces, points, normals)
    integrator = silint.SilhouetteIntegrator(scene)
    exact = integrator.ambient_occlusion(p, normals, method="exact", full_output=True)
    found = references(scene, p, normals, options)
    difference = exact.value - found.value
    known = found.standard_error > 0
    z = np.zeros(len(p))
    z[known] = difference[known] / found.standard_error[known]
    limit = student.isf(0.5 * (1.0 - 0.99 ** (1.0 / len(p))), SCRAMBLES - 1)
    # Where all rays agree: so many would have been expected to differ that none is as improbable.
    missed = ~known & (np.abs(difference) * options.rays > np.log(len(p) / 0.01))
    apart = np.flatnonzero((np.abs(z) > limit) | missed)
    notes = []
    if len(apart):
        lines = integrator.ambient_occlusion(p[apart], normals[apart], 4096)
        swept = integrator.ambient_occlusion(p[apart], normals[apart], 4096, method="octahedral")
        notes = [
            f"{scene.name}, point {i}: exact {exact.value[i]:.8f}, radial {a:.8f}, octahedral {b:.8f}, "
            f"Embree {found.value[i]:.8f} ± {found.standard_error[i]:.1e} ({z[i]:+.1f} standard errors)"
            for i, a, b in zip(apart, lines, swept, strict=True)
        ]
    row = [
        scene.name,
        f"{scene.n_faces:,}",
        f"{len(p):,}",
        f"{np.sqrt((found.standard_error**2).mean()):.1e}",
        f"{np.sqrt((z[known] ** 2).mean()):.2f}",
        f"{difference.mean():+.1e}",
        f"{np.abs(difference).max():.1e}",
        str(len(apart)),
        str(exact.diagnostics["uncertified_points"]),
    ]
    return row, notes


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", help="generated scenes, files, or names in the folder")
    parser.add_argument("--assets", help="a folder of meshes")
    parser.add_argument("--points", type=int, default=2000)
    parser.add_argument("--rays", type=int, default=1 << 20, help="a point")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", help="a folder for Embree's values")
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    rows: list[list[str]] = []
    notes: list[str] = []
    header = ["scene", "triangles", "points", "Embree s.e.", "z rms", "mean exact - Embree", "largest"]
    header += ["points apart", "without certificate"]
    for source in options.scenes:
        try:
            row, more = compare(source, options)
        except InputError as error:
            fail(error)
        rows.append(row)
        notes += more
        title = f"Embree with {options.rays:,} rays a point."
        write(options.output, "\n\n".join([title, markdown(header, rows), *notes]))


if __name__ == "__main__":
    main()
