"""What the contour search visits, how long building takes, and what the hierarchies weigh.

python benchmarks/search.py clutter_9k clutter_31k clutter_185k --output docs/search.md
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from common import load, markdown, write

import scenes
import silint
from silint.core.topology import edges_of


def measure(source: str, n_points: int, isolines: int) -> list[str]:
    """One row: counts an integrator reports of itself, a point and in shares of all edges."""
    scene = load(source)
    began = time.perf_counter()
    integrator = silint.SilhouetteIntegrator(scene)
    build = time.perf_counter() - began
    points, normals = scenes.shade_points(scene.vertices, scene.faces, n_points, 1)
    integrator.ambient_occlusion(points[:64], normals[:64], isolines)  # compile, tabulate
    times = []
    for _ in range(3):
        began = time.perf_counter()
        result = integrator.ambient_occlusion(points, normals, isolines, full_output=True)
        times.append((time.perf_counter() - began) / n_points)
    counts = {key: value / n_points for key, value in result.diagnostics.items()}
    n_edges = len(edges_of(scene.topology).ends)
    return [
        scene.name,
        f"{scene.n_faces:,}",
        f"{build:.2f}",
        f"{sum(integrator.memory.values()) / scene.n_faces:.0f}",
        f"{counts['nodes_visited']:,.0f}",
        f"{100 * counts['edges_tested'] / n_edges:.1f} %",
        f"{counts['contour_edges']:,.0f}",
        f"{counts['crossings']:,.0f}",
        f"{1e6 * np.median(times):.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="generated scenes by name, or mesh files")
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--isolines", type=int, default=64)
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    silint.SilhouetteIntegrator(load("box"))  # compile the builders, so that build times are warm
    rows = []
    for source in options.scenes:
        rows.append(measure(source, options.points, options.isolines))
        print(*rows[-1], sep="  ", flush=True)
    header = ["scene", "triangles", "build, s", "bytes a triangle", "nodes visited", "edges tested"]
    header += ["contours", "crossings", "us a point"]
    write(options.output, markdown(header, rows))


if __name__ == "__main__":
    main()
