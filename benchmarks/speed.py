"""The table that users judge us by: equal-error speed over Embree QMC, beside the targets.

    python benchmarks/speed.py --references-only --assets MESHES     # once, at any time: what errors need
    python benchmarks/speed.py --assets MESHES --readme README.md    # then, on an idle machine

Generated scenes are asked at uniform surface samples, assets (mesh files, or names in the folder --assets) at
their vertices. How it is measured, and against what, is told in the docstring of silint.bench. Every scene is
kept in --results as soon as it is measured, and read back by the next run with the same options, mesh and
source; --report measures nothing and reports what is kept, saying what of it another source measured.

Writes PREFIX.md, PREFIX.json (schema: silint.bench, with targets and scaling), PREFIX.png (error against
time) and PREFIX_by_triangles.png (time to an error in the clutter family).
"""

from __future__ import annotations

import argparse
import json
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

from silint.bench import plot, plot_scaling, run_bench, scaling
from silint.bench.curves import Bounded
from silint.bench.measure import prepare_references
from silint.bench.report import bounded_text, methods_of, three_digits
from silint.bench.truth import RESOLVED

LEVELS = (1e-3, 3e-4, 1e-4)

# What twice the isolines take off an error: the setting just below the least level has to be resolved, too.
DOUBLING = 2**1.5

# Speed-ups aimed at, at LEVELS.
TARGETS: dict[str, tuple[int | None, ...]] = {
    "clutter_9k": (60, 200, 600),
    "clutter_31k": (20, 70, 250),
    "clutter_185k": (10, 40, 150),
    "clutter_2500k": (3, 12, 50),
    "teapot_grid": (3, 12, 50),
    "foliage": (15, 50, 150),
    "spot": (50, 180, None),
    "fandisk": (50, 180, None),
    "beetle-alt": (45, 170, None),
    "stanford-bunny": (20, 75, 200),
    "skull": (20, 75, 200),
    "armadillo": (17, 70, None),
    "jet-fighter": (10, 35, None),
    "dragon_vrip": (6, 25, None),
    "pipes_partial": (8, 25, None),
    "eztree_oak_large": (16, 50, None),
    "sponza_dabrovic": (7, 20, None),
}
FAMILY = "clutter_"


def measured(source: str, options: argparse.Namespace) -> dict[str, Any] | None:
    """One scene's report, from the folder of results where known; None if only references are wanted."""
    settings = {
        "methods": options.methods.split(","),
        "points": options.points,
        "embree_points": min(options.embree_points, options.points),
        "error_points": options.error_points,
        "sites": "surface" if find(source, options.assets) is None else "vertices",
        "isolines": [int(k) for k in options.isolines.split(",")],
        "rays": [int(k) for k in options.rays.split(",")],
        "weighting": "cosine",
        "seed": options.seed,
        "repeats": options.repeats,
        "seconds": options.seconds,
        "goal": min(LEVELS) / RESOLVED / DOUBLING,
        "reference_method": options.reference_method,
    }
    scene = load(source, options.assets)
    key = {"settings": settings, "mesh": mesh_hash(scene), "source": SOURCE}
    path = Path(options.results) / f"{scene.name}.json"
    references = Path(options.results) / "references"
    if options.references_only:
        prepare_references(scene, references, settings, print_stage)
        return None
    found = kept(path, None if options.report else key)
    if found is not None:
        return found
    if options.report:
        raise InputError(f"{path} is not there; measure {source} first")
    report = run_bench([scene], **settings, references=references, progress=print_stage)
    return keep(path, key, report)


def joined(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """One report of all scenes, each with what its own run alone knows."""
    own = ("machine", "options", "source")
    scenes = [{**r["scenes"][0], **{key: r[key] for key in own}} for r in reports]
    for scene in scenes:
        scene["targets"] = dict(zip(map(str, LEVELS), TARGETS.get(scene["name"], ()), strict=False))
    return {**reports[-1], "scenes": scenes}


def row(scene: dict[str, Any], aims: bool) -> list[str]:
    """Of the table; with the speed-ups aimed at, or without."""
    first, *others = methods_of(scene)[:-1]
    entries = {entry["rmse"]: entry for entry in scene["equal_error"]}
    timed = [r["points"] for r in scene["rows"] if r["method"] == first]
    cells = [f"{scene['name']} ({scene['n_faces']:,})", span(min(timed), max(timed))]
    for level in LEVELS:
        entry, target = entries[level], scene["targets"].get(str(level))
        times = " / ".join(bounded_text(entry["times"][m]) or "?" for m in (first, "embree"))
        speed = bounded_text(entry["speedups"][first], "x") or "?"
        cells.append(f"{times}: **{speed}**" + (f" of {target}x" if target and aims else ""))
    cells.append(three_digits(scene["build_seconds"][first]))
    pays = scene["pays_after"][first]
    cells.append(pays if isinstance(pays, str) else bounded_text(pays) or "?")
    for other in others:
        costs = (bounded_text(entries[level]["costs"][other], "x") or "?" for level in LEVELS[:2])
        cells.append(" / ".join(costs))
    return [*cells, served(scene, first)]


def span(low: int, high: int) -> str:
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def served(scene: dict[str, Any], method: str) -> str:
    """Shares of points by way, where the diagnostics count ``swept_points`` and ``covered_points``."""
    rows = [r["diagnostics"] for r in scene["rows"] if r["method"] == method]
    counts = max(rows, key=lambda d: int(d["points"]))
    ways = {way: counts.get(f"{way}_points", 0) for way in ("swept", "covered")}
    total = sum(ways.values())
    return ", ".join(f"{way} {100 * n / total:.0f} %" for way, n in ways.items() if n)


def verdicts(scenes: list[dict[str, Any]]) -> str:
    """How many targets are met, and which are not."""
    met, missed, undecided = 0, [], []
    for scene in scenes:
        first = methods_of(scene)[0]
        for entry in scene["equal_error"]:
            target, speed = scene["targets"].get(str(entry["rmse"])), entry["speedups"][first]
            if not target:
                continue
            what = f"{scene['name']} at {entry['rmse']:.0e}"
            known = None if speed is None else Bounded(**speed)
            if known and known.value >= target and known.bound != "<":
                met += 1
            elif known and known.value < target and known.bound != ">":
                missed.append(what)
            else:
                undecided.append(what)
    text = f"Targets met: {met} of {met + len(missed) + len(undecided)}."
    for label, names in (("Missed", missed), ("Left open by bounds", undecided)):
        text += f" {label}: {', '.join(names)}." if names else ""
    return text


def notes(report: dict[str, Any]) -> list[str]:
    """What a reader has to know of this run."""
    scenes = report["scenes"]
    traced = [r for s in scenes for r in s["rows"] if r["method"] == "embree"]
    rate, bare = ([r[key] / 1e6 for r in traced] for key in ("rays_per_second", "bare_rays_per_second"))
    check = max(s["check"]["max_sigma"] for s in scenes)
    beyond = sum(len(s["check"]["beyond_5_sigma"]) for s in scenes)
    machine, options = report["machine"], report["options"]
    lines = [
        f"{machine['processor']}, {machine['threads']} threads for both sides; RMSE over "
        f"{options['error_points']} points; Embree {min(rate):.1f} to {max(rate):.1f} Mrays/s, `run` alone "
        f"{min(bare):.1f} to {max(bare):.1f}; Embree and the references differ by at most {check:.1f} joint "
        f"standard errors, {beyond} points beyond 5.",
    ]
    loads = [s["machine"]["load_average"] or 0.0 for s in scenes]
    other = [s["name"] for s in scenes if s["source"] != SOURCE]
    if other:
        lines.append(f"Measured with another source than the present one: {', '.join(other)}.")
    lines.append(f"Load averages before the scenes, the runs before them included: up to {max(loads):.1f}.")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="generated scenes, files, or names in the folder of assets")
    parser.add_argument("--assets", help="folder of meshes; with it, all targets are measured by default")
    parser.add_argument("--results", default="benchmarks/results", help="folder that keeps finished scenes")
    parser.add_argument("--output", default="docs/speed", help="prefix of the files written")
    parser.add_argument("--readme", help="markdown file whose table is replaced (speed:begin, speed:end)")
    parser.add_argument("--methods", default="radial,octahedral", help="of silint; unknown ones are left out")
    parser.add_argument("--seconds", type=float, default=60.0, help="of timing a scene, an aim")
    parser.add_argument("--points", type=int, default=100_000, help="timed by silint, at most")
    parser.add_argument("--embree-points", type=int, default=4_000)
    parser.add_argument("--error-points", type=int, default=512)
    parser.add_argument("--isolines", default="16,32,64,128,256,512")
    parser.add_argument("--rays", default="256,1024,4096,16384,65536,131072")
    parser.add_argument("--repeats", type=int, default=3, help="rounds, whose medians count")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reference-method", default="octahedral", help="of silint, for the references")
    parser.add_argument("--references-only", action="store_true", help="prepare references, time nothing")
    parser.add_argument("--report", action="store_true", help="measure nothing, report what is kept")
    options = parser.parse_args()
    sources = options.scenes or [
        name for name in TARGETS if options.assets or name in ("foliage", "teapot_grid") or FAMILY in name
    ]
    try:
        for source in sources:
            find(source, options.assets)
        reports = [report for source in sources if (report := measured(source, options))]
        if reports:
            publish(joined(reports), options)
    except InputError as error:
        fail(error)


def publish(report: dict[str, Any], options: argparse.Namespace) -> None:
    """Table, figures and JSON of everything measured."""
    first, *others = methods_of(report["scenes"][0])[:-1]
    header = ["scene (triangles)", "points", *(f"RMSE {level:.0e}" for level in LEVELS)]
    header += ["build, s", "pays after, points"]
    header += [*(f"{other} / {first} at 1e-3, 3e-4" for other in others), "served by"]
    tables = []
    for aims in (False, True):
        rows = [row(s, aims) for s in report["scenes"]]
        served_by = any(cells[-1] for cells in rows)  # else there are no diagnostics of that
        tables.append(markdown(header, rows) if served_by else markdown(header[:-1], [c[:-1] for c in rows]))
    prefix = Path(options.output)
    plot(report, prefix.with_name(prefix.name + ".png"))
    if sum(FAMILY in s["name"] for s in report["scenes"]) > 1:
        report["scaling"] = scaling(report, LEVELS[:2], lambda name: name.startswith(FAMILY))
        plot_scaling(report, report["scaling"], prefix.with_name(prefix.name + "_by_triangles.png"))
    path = prefix.with_name(prefix.name + ".json")
    path.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    text = "\n\n".join([tables[1], *notes(report), verdicts(report["scenes"])])
    write(str(prefix.with_name(prefix.name + ".md")), text)
    if options.readme:
        insert(options.readme, "speed", "\n\n".join([tables[0], *notes(report)]))


if __name__ == "__main__":
    main()
