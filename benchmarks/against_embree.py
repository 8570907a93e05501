"""silint against Embree on any scenes: are they the same number?

    python benchmarks/against_embree.py clutter_9k room path/to/mesh.ply --output table.md

For 256 area samples of each scene, the reference is the mean of silint in six random orientations at 1024
isolines, with its standard error; Embree takes 64 independent scrambles of 2048 rays. `z rms` is the root
mean square of their differences in joint standard errors (about 1 if nothing but sampling separates them),
`beyond 5` lists points further apart, each with what exhaustive covering, which shares neither contours nor
counts with the sweep, makes of it. RMSE is that of 64 and of 256 isolines in the file's own orientation.
"""

from __future__ import annotations

import argparse

import numpy as np
from common import load, markdown, write

import silint
from silint.bench.truth import check, reference, rms
from silint.reference import EmbreeQMC, embree_points

import scenes  # isort: skip


def compare(source: str, seed: int) -> tuple[list[str], list[str]]:
    """One row of the table, and a line for every point beyond 5 standard errors."""
    scene = load(source)
    integrator = silint.SilhouetteIntegrator(scene)
    points, normals = scenes.shade_points(scene.vertices, scene.faces, 256, seed)
    points = embree_points(scene.vertices, scene.faces, points, normals)
    options = {"weighting": "cosine", "seed": seed}
    quiet = lambda *_: None  # noqa: E731
    truth = reference(scene.vertices, scene.faces, points, normals, options, quiet)
    verdict = check(EmbreeQMC(scene.vertices, scene.faces), truth, points, normals, options, quiet)
    results = {k: integrator.ambient_occlusion(points, normals, k, full_output=True) for k in (64, 256)}
    errors = {k: r.value - truth.value for k, r in results.items()}
    fallback = sum(r.diagnostics["fallback_isolines"] for r in results.values())

    notes = []
    for outlier in verdict["beyond_5_sigma"]:
        p, n = (np.asarray(outlier[key])[None] for key in ("point", "normal"))
        lifted = integrator._shade_points(p, n)
        (covered, _), *_ = integrator._chunks(*lifted, 1024, None, cover_all=True)
        notes.append(
            f"{scene.name}: point {np.round(p[0], 6).tolist()} normal {np.round(n[0], 4).tolist()}: silint "
            f"{outlier['silint']:.6f}, Embree {outlier['embree']:.6f} ({outlier['sigma']:.1f} sigma), "
            f"covering {covered.ambient_occlusion()[0]:.6f}"
        )
    row = [
        scene.name,
        f"{scene.n_faces:,}",
        f"{rms(errors[64]):.1e}",
        f"{rms(errors[256]):.1e}",
        f"{np.abs(errors[256]).max():.1e}",
        f"{rms(truth.standard_error):.1e}",
        f"{verdict['rms_sigma']:.2f}",
        f"{verdict['mean_difference']:+.1e} ± {verdict['mean_difference_error']:.0e}",
        str(len(notes)),
        str(fallback),
    ]
    return row, notes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="generated scenes by name, or mesh files")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    rows, notes = [], []
    for source in options.scenes:
        row, more = compare(source, options.seed)
        print(*row, *more, sep="  ", flush=True)
        rows.append(row)
        notes += more
    header = ["scene", "triangles", "RMSE 64", "RMSE 256", "max 256", "reference s.e.", "z rms"]
    header += ["mean silint - Embree", "beyond 5", "fallback lines"]
    write(options.output, "\n\n".join([markdown(header, rows), *notes]))


if __name__ == "__main__":
    main()
