"""Light at equal error: silint and Embree QMC, irradiance under maps and a sky, and harmonics of transfer.

    python benchmarks/lighting_speed.py --assets MESHES --maps HDRIS --references-only   # once, at any time
    python benchmarks/lighting_speed.py --assets MESHES --maps HDRIS --readme README.md  # on an idle machine

Scenes and sites as for benchmarks/speed.py: generated ones at surface samples, z up; files at vertices, y up.
Lights: the maps (files, or folders of .hdr and .exr), and the CIE's clear sky with its sun. Times are
microseconds a point on all cores, at a relative RMSE of irradiance (each channel over its mean; the worst of
red, green and blue counts) and an RMSE of the coefficients; Embree follows the cosine and the light, combined
by the balance heuristic. How it is measured is told in the docstring of silint.bench; tables of a map, which
serve all points, are built beforehand and their time is given. Every scene and light is kept in --results as
soon as it is measured, and read back by the next run with the same options, mesh, light and source; --report
measures nothing and reports what is kept.

Writes PREFIX.md, PREFIX.json (schema: silint.bench) and PREFIX.png (error against time; the band below a
curve, of the worst channel, reaches down to the best one).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from common import (
    SOURCE,
    InputError,
    fail,
    find,
    insert,
    keep,
    kept,
    load,
    markdown,
    mesh_hash,
    print_stage,
    write,
)

from silint import Environment
from silint.bench import plot, run_bench
from silint.bench.measure import prepare_references
from silint.bench.quantity import Quantity, quantity_of
from silint.bench.report import bounded_text, three_digits
from silint.bench.rows import EMBREE
from silint.bench.truth import RESOLVED

SCENES = ("clutter_31k", "armadillo", "spot", "fandisk", "sponza_dabrovic")
LEVELS = {"irradiance": (1e-2, 3e-3, 1e-3), "sh": (1e-3,)}
CHANNELS_AT = 3e-3  # where the channels are told apart
MAP_SUFFIXES = (".hdr", ".exr")

# Towards the sun, with z up, and radiances: those of benchmarks/lighting.py.
SUN = (-0.75, -0.35, 0.5)
ZENITH, SUN_IRRADIANCE, GROUND = (0.35, 0.6, 1.0), (16.0, 13.0, 9.0), 0.15
SKY = "clear sky"

OURS = "auto"


def lights(up: str, options: argparse.Namespace) -> Iterator[tuple[str, Quantity]]:
    """Names and quantities, of a scene whose upward axis is `up`."""
    for path in map_files(options.maps):
        yield path.stem, quantity_of("irradiance", "cosine", Environment.from_file(path, up), 0)
    if not options.no_sky:
        x, y, z = SUN
        sun = SUN if up == "z" else (x, z, -y)
        sky = Environment.cie_clear_sky(sun, ZENITH, SUN_IRRADIANCE, up=up, ground_albedo=GROUND)
        yield SKY, quantity_of("irradiance", "cosine", sky, 0)
    if not options.no_sh:
        yield "transfer", quantity_of("sh", "cosine", None, options.max_degree)


def map_files(given: list[str]) -> list[Path]:
    """Maps, and those in folders, by name."""
    found = []
    for path in map(Path, given):
        inside = sorted(p for p in path.iterdir() if p.suffix in MAP_SUFFIXES) if path.is_dir() else [path]
        if not inside:
            raise InputError(f"{path} has no {' or '.join(MAP_SUFFIXES)} file in it")
        found += inside
    return found


def measured(source: str, light: str, asked: Quantity, options: argparse.Namespace) -> dict[str, Any] | None:
    """One scene under one light, from the folder of results where known; None: nothing to report."""
    settings = {
        "points": options.points,
        "embree_points": min(options.embree_points, options.points),
        "error_points": options.error_points,
        "sites": "surface" if find(source, options.assets) is None else "vertices",
        "isolines": [int(k) for k in options.isolines.split(",")],
        "rays": [int(k) for k in options.rays.split(",")],
        "seed": options.seed,
        "repeats": options.repeats,
        "seconds": options.seconds,
        # Half: the setting beyond the least level has to be resolved, too.
        "goal": min(LEVELS[asked.name]) / RESOLVED / 2.0,
        "reference_method": "octahedral",
    }
    question = {"weighting": "cosine", "quantity": asked.name, "max_degree": asked.max_degree}
    scene = load(source, options.assets)
    key = {"settings": settings, "light": asked.as_key(), "mesh": mesh_hash(scene), "source": SOURCE}
    path = Path(options.results) / "lighting" / f"{scene.name}_{light.replace(' ', '_')}.json"
    references = Path(options.results) / "references"
    if options.references_only:
        prepare_references(
            scene, references, {**settings, **question, "environment": asked.environment}, print_stage
        )
        return None
    found = kept(path, None if options.report else key)
    if found is None:
        if options.report:
            print(f"{path} is not there", file=sys.stderr)
            return None
        print(f"{scene.name} under {light}", file=sys.stderr)
        report = run_bench(
            [scene],
            methods=(OURS,),
            environment=asked.environment,
            references=references,
            progress=print_stage,
            **settings,
            **question,
        )
        found = keep(path, key, report)
    return {**found, "light": light}


def row(report: dict[str, Any]) -> list[str]:
    """Times of both sides and the speed-up at each error, of each channel too, and what was paid before."""
    scene = report["scenes"][0]
    cells = [f"{scene['name']} ({scene['n_faces']:,})"]
    if report["options"]["quantity"] == "irradiance":
        cells.append(report["light"])
    for level in LEVELS[report["options"]["quantity"]]:
        entry = at(scene["equal_error"], level)
        times = " / ".join(bounded_text(entry["times"][method]) or "?" for method in (OURS, EMBREE))
        cells.append(f"{times}: **{speed(entry)}**")
    if scene["channels"]:
        cells.append(" / ".join(speed(at(entries, CHANNELS_AT)) for entries in scene["channels"]))
    prepared = [r["prepare_seconds"] for r in scene["rows"] if r["method"] == OURS]
    return [*cells, three_digits(max(prepared)), f"{scene['check']['max_sigma']:.1f}"]


def at(entries: list[dict[str, Any]], level: float) -> dict[str, Any]:
    return next(entry for entry in entries if entry["rmse"] == level)


def speed(entry: dict[str, Any]) -> str:
    return bounded_text(entry["speedups"][OURS], "x") or "?"


def table(reports: list[dict[str, Any]], quantity: str) -> str:
    header = ["scene (triangles)"] + (["light"] if quantity == "irradiance" else [])
    header += [f"RMSE {level:.0e}" for level in LEVELS[quantity]]
    if quantity == "irradiance":
        header.append(f"red / green / blue at {CHANNELS_AT:.0e}")
    return markdown([*header, "tables, s", "check, sigma"], [row(r) for r in reports])


def grid(reports: list[dict[str, Any]]) -> str:
    """README's: scenes down, lights across, speed-ups at all levels in a cell."""
    names = list(dict.fromkeys(r["light"] for r in reports))
    cells: dict[str, dict[str, str]] = {}
    for report in reports:
        scene = report["scenes"][0]
        speeds = [speed(at(scene["equal_error"], level)) for level in LEVELS["irradiance"]]
        cells.setdefault(f"{scene['name']} ({scene['n_faces']:,})", {})[report["light"]] = ", ".join(speeds)
    rows = [[scene, *(found.get(name, "") for name in names)] for scene, found in cells.items()]
    return markdown(["scene (triangles)", *names], rows)


def notes(reports: list[dict[str, Any]]) -> str:
    rows = [r for report in reports for r in report["scenes"][0]["rows"] if r["method"] == EMBREE]
    rate, bare = ([r[key] / 1e6 for r in rows] for key in ("rays_per_second", "bare_rays_per_second"))
    machine, options = reports[-1]["machine"], reports[-1]["options"]
    loads = max(report["machine"]["load_average"] or 0.0 for report in reports)
    checks = [report["scenes"][0]["check"] for report in reports]
    beyond = sum(len(check["beyond_5_sigma"]) for check in checks)
    text = (
        f"{machine['processor']}, {machine['threads']} threads for both sides; errors over "
        f"{options['error_points']} points; Embree {min(rate):.1f} to {max(rate):.1f} Mrays/s, `run` alone "
        f"{min(bare):.1f} to {max(bare):.1f}; silint's and Embree's references differ by at most "
        f"{max(check['max_sigma'] for check in checks):.1f} joint standard errors, {beyond} values beyond 5. "
        f"Load averages before the scenes, the runs before them included: up to {loads:.1f}."
    )
    other = [f"{r['scenes'][0]['name']} under {r['light']}" for r in reports if r["source"] != SOURCE]
    if other:
        text += f"\n\nMeasured with another source than the present one: {', '.join(other)}."
    return text


def joined(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """One report of all, each under a name that tells its light, with what its own run alone knows."""
    scenes = []
    for report in reports:
        scene = report["scenes"][0]
        own = {name: report[name] for name in ("machine", "options", "source", "light")}
        scenes.append({**scene, **own, "name": f"{scene['name']}, {report['light']}"})
    options = {**reports[-1]["options"], "environment": None}
    return {**reports[-1], "options": options, "scenes": scenes}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="generated scenes, files, or names in the folder of assets")
    parser.add_argument("--assets", help="folder of meshes; with it, five scenes by default, else one")
    parser.add_argument("--maps", nargs="*", default=[], help="environment maps, or folders of them")
    parser.add_argument("--assets-up", default="y", help="the meshes' upward axis: y or z")
    parser.add_argument("--no-sky", action="store_true", help="leave the clear sky out")
    parser.add_argument("--no-sh", action="store_true", help="leave transfer out")
    parser.add_argument("--max-degree", type=int, default=4, help="of transfer")
    parser.add_argument("--results", default="benchmarks/results", help="folder that keeps what is measured")
    parser.add_argument("--output", default="docs/lighting_speed", help="prefix of the files written")
    parser.add_argument(
        "--readme", help="markdown file whose table is replaced (lighting:begin, lighting:end)"
    )
    parser.add_argument("--seconds", type=float, default=12.0, help="of timing a scene and light, an aim")
    parser.add_argument("--points", type=int, default=20_000, help="timed by silint, at most")
    parser.add_argument("--embree-points", type=int, default=2_000)
    # Under a sun, the few points in its penumbrae decide the RMSE: about one in a hundred.
    parser.add_argument("--error-points", type=int, default=1024)
    parser.add_argument("--isolines", default="8,16,32,64,128,256,512")
    parser.add_argument("--rays", default="64,256,1024,4096,16384,65536")
    parser.add_argument("--repeats", type=int, default=3, help="rounds, whose medians count")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--references-only", action="store_true", help="prepare references, time nothing")
    parser.add_argument("--report", action="store_true", help="measure nothing, report what is kept")
    options = parser.parse_args()
    sources = options.scenes or [name for name in SCENES if options.assets or name == "clutter_31k"]
    try:
        reports = []
        for source in sources:
            up = "z" if find(source, options.assets) is None else options.assets_up
            for light, asked in lights(up, options):
                reports.append(measured(source, light, asked, options))
        if found := [report for report in reports if report is not None]:
            publish(found, options)
    except InputError as error:
        fail(error)


def publish(reports: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Tables, figure and JSON of everything measured."""
    lit = [r for r in reports if r["options"]["quantity"] == "irradiance"]
    transfer = [r for r in reports if r["options"]["quantity"] == "sh"]
    parts = []
    if lit:
        parts += [
            "Microseconds a point at a relative RMSE of irradiance in the worst channel, silint / Embree, "
            "and how many times faster silint is:",
            table(lit, "irradiance"),
            f"![RMSE of irradiance against time, silint and Embree]({Path(options.output).name}.png)",
        ]
        plot(joined(lit), f"{options.output}.png")
    if transfer:
        parts += [f"The same at an RMSE of transfer, degree {options.max_degree}:", table(transfer, "sh")]
    parts += [
        "Tables: the longest building of a map's tables, for the most isolines; check: the largest "
        "difference between silint's reference and Embree's in joint standard errors; the surer of the two "
        "is the truth.",
        notes(reports),
    ]
    Path(f"{options.output}.json").write_text(json.dumps(joined(reports), indent=1) + "\n", encoding="utf-8")
    write(f"{options.output}.md", "\n\n".join(parts))
    if options.readme and lit:
        insert(options.readme, "lighting", f"{grid(lit)}\n\n{notes(lit)}")


if __name__ == "__main__":
    main()
