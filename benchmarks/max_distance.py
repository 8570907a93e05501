"""Cost of ambient occlusion within a distance, beside Embree rays that end there.

    python benchmarks/max_distance.py [SCENE ...] [--assets DIR] [--output docs/max_distance.md]

One process, in turns, medians of rounds, all threads on both sides. Points come in runs of neighbours spread
over the scene, as in a bake. Distances are in percent of the diagonal of the bounding box. The reference is
Embree with many more rays; the error of both sides is against it.
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
from silint.reference import EmbreeQMC, embree_points

SCENES = ["dragon_vrip", "pipes_partial"]
PERCENT = (1, 2, 5, 10, 20, 50, None)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES, help="generated scenes, or mesh files")
    parser.add_argument("--assets", help="a folder of meshes")
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--embree-points", type=int, default=512)
    parser.add_argument("--isolines", type=int, default=64)
    parser.add_argument("--rays", type=int, default=256)
    parser.add_argument("--reference-rays", type=int, default=1 << 16)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", help="a markdown file")
    options = parser.parse_args()
    parts = []
    for name in options.scenes:
        try:
            parts.append(measure(name, options))
        except InputError as error:
            fail(error)
        write(options.output, report(parts, options))


def measure(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Microseconds a point, and errors, for every distance on one scene."""
    scene = load(name, options.assets)
    sites = "surface" if find(name, options.assets) is None else "vertices"
    points, normals = shade_sites(scene, sites, 100_000, np.random.default_rng(0))
    rows = in_company(points, normals)[: options.points]
    n = normals[rows]
    p = embree_points(scene.vertices, scene.faces, points[rows], n)  # the same points on both sides
    few = np.linspace(0, len(p) - 1, min(options.embree_points, len(p))).astype(int)
    sil = silint.SilhouetteIntegrator(scene)
    embree = EmbreeQMC(scene.vertices, scene.faces)
    used = scene.vertices[np.unique(scene.faces)]
    diagonal = float(np.linalg.norm(np.ptp(used, axis=0)))
    found = []
    for percent in PERCENT:
        reach = None if percent is None else percent / 100.0 * diagonal
        end = np.inf if reach is None else reach

        def lines(reach: float | None = reach) -> Any:
            return sil.ambient_occlusion(p, n, options.isolines, max_distance=reach)

        def falling(reach: float | None = reach) -> Any:
            return sil.ambient_occlusion(p, n, options.isolines, max_distance=reach, falloff="linear")

        def rays(end: float = end) -> Any:
            return embree.ambient_occlusion(p[few], n[few], options.rays, max_distance=end).value

        def arcs(reach: float | None = reach) -> Any:
            return sil.ambient_occlusion(p[few], n[few], method="exact", max_distance=reach)

        queries: dict[str, tuple[int, Callable[[], Any]]] = {
            "lines": (len(p), lines),
            "rays": (len(few), rays),
            "arcs": (len(few), arcs),
        }
        if reach is not None:
            queries["falling"] = (len(p), falling)
        values, times = in_turns(queries, options.rounds)
        truth = embree.ambient_occlusion(
            p[few], n[few], options.reference_rays, seed=1, max_distance=end
        ).value
        found.append(
            {
                "percent": percent,
                "ao": float(truth.mean()),
                "lines_error": rmse(values["lines"][few] - truth),
                "rays_error": rmse(values["rays"] - truth),
                "arcs_error": rmse(values["arcs"] - truth),
                **times,
            }
        )
    return {"name": scene.name, "triangles": scene.n_faces, "cover": sil._finder.cover, "rows": found}


def in_turns(
    queries: dict[str, tuple[int, Callable[[], Any]]], rounds: int
) -> tuple[dict[str, Any], dict[str, float]]:
    """What queries return, and the median of their microseconds a point; the first round compiles."""
    times: dict[str, list[float]] = {key: [] for key in queries}
    values = {}
    for r in range(rounds + 1):
        for key, (count, query) in queries.items():
            began = time.perf_counter()
            values[key] = query()
            if r > 0:
                times[key].append((time.perf_counter() - began) / count * 1e6)
    return values, {key: statistics.median(each) for key, each in times.items()}


def rmse(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean()))


def report(parts: list[dict[str, Any]], options: argparse.Namespace) -> str:
    """A table for each scene, as a page."""
    text = [
        "# What a maximum distance costs",
        "",
        "`python benchmarks/max_distance.py`: microseconds a point, all threads on both sides, medians of "
        f"{options.rounds} rounds in turns; {options.isolines} isolines, {options.rays} Embree rays that end "
        f"at R. RMSE against Embree with {options.reference_rays:,} rays, which has an error of its own: "
        "that of exact mode is little else. R in percent of the bounding box's diagonal.",
    ]
    header = [
        "R",
        "mean AO",
        "lines, us",
        "rays, us",
        "rays / lines",
        "RMSE of lines",
        "RMSE of rays",
        "exact, us",
        "of exact",
        "linear, us",
    ]
    for part in parts:
        rows = [
            [
                "none" if row["percent"] is None else f"{row['percent']} %",
                f"{row['ao']:.3f}",
                f"{row['lines']:.1f}",
                f"{row['rays']:.1f}",
                f"{row['rays'] / row['lines']:.1f}",
                f"{row['lines_error']:.1e}",
                f"{row['rays_error']:.1e}",
                f"{row['arcs']:.0f}",
                f"{row['arcs_error']:.1e}",
                f"{row['falling']:.1f}" if "falling" in row else "",
            ]
            for row in part["rows"]
        ]
        way = "covered" if part["cover"] else "swept"
        text += ["", f"## {part['name']}, {part['triangles']:,} triangles; {way} without a distance", ""]
        text += [markdown(header, rows)]
    return "\n".join(text)


if __name__ == "__main__":
    main()
