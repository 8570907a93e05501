"""Work a point, counted: nodes visited, edges tested, contours, crossings; and memory.

    python benchmarks/work.py clutter_9k clutter_31k path/to/mesh.ply --output work.md
    python benchmarks/work.py --record

`--record` measures the guarded scenes with every method that there is and rewrites the bounds that
tests/bench/test_work_bounds.py holds the counts to: today's counts plus a margin. Say in the commit why they
changed.
"""

from __future__ import annotations

import argparse
import json

from common import ROOT, InputError, fail, load, markdown, write

import scenes
import silint
from silint.bench.measure import supported_methods
from silint.bench.work import COUNTED, work

BOUNDS = ROOT / "tests" / "bench" / "work_bounds.json"


def count(source: str, n_points: int, isolines: int, methods: list[str], assets: str | None = None):
    """Scene, integrator, and counts a point for each method."""
    scene = load(source, assets)
    integrator = silint.SilhouetteIntegrator(scene)
    points, normals = scenes.shade_points(scene.vertices, scene.faces, n_points, 1)
    return scene, integrator, work(integrator, points, normals, isolines, methods)


def table(options: argparse.Namespace) -> str:
    rows = []
    for source in options.scenes:
        counted = count(source, options.points, options.isolines, options.methods, options.assets)
        scene, integrator, counts = counted
        edges, memory = len(scene.topology.edges), sum(integrator.memory.values()) / scene.n_faces
        for method, found in counts.items():
            cells = [f"{found[name]:,.0f}" for name in COUNTED]
            share = f"{100 * found['edges_tested'] / edges:.1f} %"
            rows.append([scene.name, f"{scene.n_faces:,}", f"{memory:.0f}", method, share, *cells])
    header = ["scene", "triangles", "bytes a triangle", "method", "edges tested"]
    return markdown([*header, *(f"{name.replace('_', ' ')} a point" for name in COUNTED)], rows)


def record() -> None:
    """Rewrite the table of bounds; methods that this silint does not have keep what they had."""
    kept = json.loads(BOUNDS.read_text(encoding="utf-8"))
    for source, bounds in kept["bounds"].items():
        methods = supported_methods(kept["methods"])
        *_, counts = count(source, kept["points"], kept["isolines"], methods)
        for method, found in counts.items():
            bounds[method] = {name: float(f"{kept['margin'] * found[name]:.3g}") for name in COUNTED}
    BOUNDS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    print(f"wrote {BOUNDS.relative_to(ROOT)}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="generated scenes, files, or names in the folder of assets")
    parser.add_argument("--assets", help="folder of meshes")
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--isolines", type=int, default=64)
    parser.add_argument("--methods", default="radial,octahedral", help="unknown ones are left out")
    parser.add_argument("--output", help="where to keep the table")
    parser.add_argument("--record", action="store_true", help="rewrite the bounds of the tests")
    options = parser.parse_args()
    try:
        if options.record:
            record()
            return
        options.methods = supported_methods(options.methods.split(","))
        write(options.output, table(options))
    except InputError as error:
        fail(error)


if __name__ == "__main__":
    main()
