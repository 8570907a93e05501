"""Light at equal error: silint and Embree QMC, irradiance under maps and transfer in spherical harmonics.

    python benchmarks/lighting_speed.py clutter_31k armadillo --assets MESHES --maps sky.hdr sunset.hdr
    python benchmarks/lighting_speed.py clutter_31k --no-sh --maps sky.hdr --output docs/lighting_speed

Scenes and sites as for benchmarks/speed.py: generated ones at surface samples, meshes at vertices. Times
are microseconds a point on all cores, at a relative RMSE of irradiance (over its mean) and an RMSE of the
coefficients; Embree follows the cosine and the light, combined by the balance heuristic. How it is measured
is told in the docstring of silint.bench; tables of a map, which serve all points, are built beforehand and
their time is given. Prints markdown; --output PREFIX keeps it in PREFIX.md, with all reports in PREFIX.json.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from common import InputError, fail, find, load, markdown, print_stage, write

from silint import Environment
from silint.bench import run_bench
from silint.bench.report import bounded_text, three_digits
from silint.bench.rows import EMBREE
from silint.bench.truth import RESOLVED

LEVELS = {"irradiance": (1e-2, 3e-3), "sh": (1e-3,)}

OURS = "auto"


def measured(source: str, environment: Environment | None, options: argparse.Namespace) -> dict[str, Any]:
    """The report of one scene, under a map or of transfer."""
    quantity = "sh" if environment is None else "irradiance"
    return run_bench(
        [load(source, options.assets)],
        methods=(OURS,),
        points=options.points,
        embree_points=min(options.embree_points, options.points),
        error_points=options.error_points,
        sites="surface" if find(source, options.assets) is None else "vertices",
        isolines=[int(k) for k in options.isolines.split(",")],
        rays=[int(k) for k in options.rays.split(",")],
        quantity=quantity,
        environment=environment,
        max_degree=options.max_degree,
        seed=options.seed,
        repeats=options.repeats,
        seconds=options.seconds,
        goal=min(LEVELS[quantity]) / RESOLVED / 2.0,  # half: the setting beyond the least level counts, too
        references=options.references,
        progress=print_stage,
    )


def row(report: dict[str, Any], levels: tuple[float, ...]) -> list[str]:
    """Times of both sides and the speed-up at each error, and what was paid before."""
    scene, quantity = report["scenes"][0], report["options"]["quantity"]
    entries = {entry["rmse"]: entry for entry in scene["equal_error"]}
    light = report["options"]["environment"] if quantity == "irradiance" else "any"
    cells = [f"{scene['name']} ({scene['n_faces']:,})", light]
    for level in levels:
        entry = entries[level]
        cells += [bounded_text(entry["times"][m]) or "?" for m in (OURS, EMBREE)]
        cells.append(bounded_text(entry["speedups"][OURS], "x") or "?")
    cells.append(three_digits(scene["build_seconds"][OURS]))
    prepared = [r["prepare_seconds"] for r in scene["rows"] if r["method"] == OURS]
    return [*cells, three_digits(max(prepared)), f"{scene['check']['max_sigma']:.1f}"]


def table(reports: list[dict[str, Any]], levels: tuple[float, ...]) -> str:
    header = ["scene (triangles)", "light"]
    for level in levels:
        header += [f"silint, us at {level:.0e}", "Embree, us", "faster"]
    return markdown([*header, "build, s", "tables, s", "check, sigma"], [row(r, levels) for r in reports])


def notes(reports: list[dict[str, Any]]) -> str:
    rows = [r for report in reports for r in report["scenes"][0]["rows"] if r["method"] == EMBREE]
    rate, bare = ([r[key] / 1e6 for r in rows] for key in ("rays_per_second", "bare_rays_per_second"))
    machine, options = reports[-1]["machine"], reports[-1]["options"]
    load = max(report["machine"]["load_average"] or 0.0 for report in reports)
    return (
        f"{machine['processor']}, {machine['threads']} threads for both sides; errors over "
        f"{options['error_points']} points; Embree {min(rate):.1f} to {max(rate):.1f} Mrays/s, `run` alone "
        f"{min(bare):.1f} to {max(bare):.1f}. Tables: the longest building of a map's tables, for the most "
        "isolines; check: the largest difference between reference and Embree in joint standard errors. Load "
        f"averages before: up to {load:.1f}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", help="generated scenes, files, or names in the folder of assets")
    parser.add_argument("--assets", help="folder of meshes")
    parser.add_argument("--maps", nargs="*", default=[], help="environment maps; none: transfer alone")
    parser.add_argument("--map-up", default="z", help="where the maps' tops go: y or z")
    parser.add_argument("--no-sh", action="store_true", help="irradiance alone")
    parser.add_argument("--max-degree", type=int, default=4, help="of transfer")
    parser.add_argument(
        "--references", default="benchmarks/results/references", help="folder that keeps them"
    )
    parser.add_argument("--output", help="prefix of the files written")
    parser.add_argument("--seconds", type=float, default=30.0, help="of timing a scene and map, an aim")
    parser.add_argument("--points", type=int, default=20_000, help="timed by silint, at most")
    parser.add_argument("--embree-points", type=int, default=2_000)
    parser.add_argument("--error-points", type=int, default=512)
    parser.add_argument("--isolines", default="8,16,32,64,128,256,512")
    parser.add_argument("--rays", default="64,256,1024,4096,16384,65536")
    parser.add_argument("--repeats", type=int, default=3, help="rounds, whose medians count")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    try:
        for source in options.scenes:
            find(source, options.assets)
        maps = [Environment.from_file(path, options.map_up) for path in options.maps]
        lit = [measured(source, light, options) for source in options.scenes for light in maps]
        transfer = [] if options.no_sh else [measured(source, None, options) for source in options.scenes]
    except InputError as error:
        fail(error)
    parts = []
    if lit:
        parts += ["Irradiance, relative RMSE:", table(lit, LEVELS["irradiance"])]
    if transfer:
        parts += [f"Transfer of degree {options.max_degree}, RMSE:", table(transfer, LEVELS["sh"])]
    if not parts:
        fail(InputError("nothing to measure: pass --maps, or leave --no-sh out"))
    text = "\n\n".join([*parts, notes([*lit, *transfer])])
    if options.output:
        with open(f"{options.output}.json", "w", encoding="utf-8") as stream:
            json.dump([*lit, *transfer], stream, indent=1)
    write(f"{options.output}.md" if options.output else None, text)


if __name__ == "__main__":
    main()
