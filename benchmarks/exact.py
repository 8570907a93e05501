"""The exact mode beside Embree: what a point costs, and what gradients add.

    python benchmarks/exact.py [SCENE ...] [--assets DIR] [--output docs/exact_speed.md] [--json FILE]
    python benchmarks/exact.py --figure docs/speed   # nothing is measured: the times join speed.json's figure

One process, in turns, medians of rounds, all threads on both sides. Points come in runs of neighbours
spread over the scene, as in a bake. Aims: at most the time of 4096 Embree rays on clutter 9k and 31k, three
times that on clutter 185k; gradients by points, normals and all vertices together at most 25 % on top.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import InputError, fail, find, load, markdown, write

import silint
from silint.bench import plot
from silint.bench.measure import in_company
from silint.bench.sites import shade_sites
from silint.reference import EmbreeQMC, embree_points

SCENES = ["clutter_9k", "clutter_31k", "clutter_185k"]
RAYS = 4096


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES, help="generated scenes, or mesh files")
    parser.add_argument("--assets", help="a folder of meshes")
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--embree-points", type=int, default=512)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", help="a markdown file")
    parser.add_argument("--json", help="a file for the figures")
    parser.add_argument("--figure", help="of speed.py, path without suffix: draw it with the times of --json")
    options = parser.parse_args()
    if options.figure:
        draw(Path(options.figure), Path(options.json or "docs/exact_speed.json"))
        return
    rows = []
    for name in options.scenes:
        try:
            rows.append(measure(name, options))
        except InputError as error:
            fail(error)
        write(options.output, report(rows))
        if options.json:
            Path(options.json).write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def measure(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Microseconds a point of everything, on one scene."""
    scene = load(name, options.assets)
    sites = "surface" if find(name, options.assets) is None else "vertices"
    points, normals = shade_sites(scene, sites, 100_000, np.random.default_rng(0))
    rows = in_company(points, normals)[: options.points]
    p, n = points[rows], normals[rows]
    few = np.linspace(0, len(p) - 1, min(options.embree_points, len(p))).astype(int)
    sil = silint.SilhouetteIntegrator(scene)
    embree = EmbreeQMC(scene.vertices, scene.faces)
    p = embree_points(scene.vertices, scene.faces, p, n)  # the same points on both sides
    cotangents = np.ones(len(p))

    queries: dict[str, tuple[int, Callable[[], Any]]] = {
        "exact": (len(p), lambda: sil.ambient_occlusion(p, n, method="exact", full_output=True)),
        "sh4": (len(p), lambda: sil.sh_transfer(p, n, 4, method="exact")),
        "gradient": (len(p), lambda: sil.ambient_occlusion_gradient(p, n)),
        "pullback": (len(p), lambda: sil.pullback(p, n, cotangents)),
        "lines": (len(p), lambda: sil.ambient_occlusion(p, n, isolines=64)),
        "embree": (len(few), lambda: embree.ambient_occlusion(p[few], n[few], samples=RAYS)),
    }
    times: dict[str, list[float]] = {key: [] for key in queries}
    told: dict[str, int] = {}
    for r in range(options.rounds + 1):  # the first compiles
        for key, (count, query) in queries.items():
            began = time.perf_counter()
            found = query()
            if r > 0:
                times[key].append((time.perf_counter() - began) / count * 1e6)
            if key == "exact":
                told = dict(found.diagnostics)
    return {
        "scene": scene.name,
        "triangles": len(scene.faces),
        "points": len(p),
        **{key: statistics.median(found) for key, found in times.items()},
        "edges": told["contour_edges"] / len(p),
        "second_frames": told["second_frames"],
        "uncertified": told["uncertified_points"],
    }


def draw(figure: Path, times: Path) -> None:
    """Error against time as speed.py draws it, with the time of the exact mode where it is known."""
    found = json.loads(figure.with_suffix(".json").read_text(encoding="utf-8"))
    exact = {row["scene"]: row["exact"] for row in json.loads(times.read_text(encoding="utf-8"))}
    for scene in found["scenes"]:
        if scene["name"] in exact:
            scene["exact_us_per_point"] = exact[scene["name"]]
    plot(found, figure.with_suffix(".png"))


def report(rows: list[dict[str, Any]]) -> str:
    """The table as a page."""
    header = [
        "scene (triangles)",
        "contour edges a point",
        "exact AO, us",
        f"Embree {RAYS} rays, us",
        "exact / Embree",
        "exact SH degree 4, us",
        "AO and gradients by p, n, us",
        "pullback to vertices, us",
        "64 lines, us",
        "points without certificate",
    ]
    lines = [
        [
            f"{row['scene']} ({row['triangles']:,})",
            f"{row['edges']:.0f}",
            f"{row['exact']:.1f}",
            f"{row['embree']:.1f}",
            f"{row['exact'] / row['embree']:.2f}",
            f"{row['sh4']:.1f}",
            f"{row['gradient']:.1f}",
            f"{row['pullback']:.1f}",
            f"{row['lines']:.1f}",
            f"{row['uncertified']} of {row['points']:,}",
        ]
        for row in rows
    ]
    return f"# What exactness costs\n\n`python benchmarks/exact.py`\n\n{markdown(header, lines)}"


if __name__ == "__main__":
    main()
