"""Error against run time beside Embree: README's figure and table.

    python benchmarks/error_against_time.py --output docs/error_against_time

Writes PREFIX.png, PREFIX.json (schema: silint.bench) and PREFIX.md. What is measured, and against what, is
told in the docstring of silint.bench.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from common import load, markdown, write

from silint.bench import plot, print_tables, run_bench

SCENES = ["clutter_9k", "clutter_31k", "clutter_185k", "city", "room", "foliage"]


RMSES = (3e-3, 1e-3, 3e-4, 1e-4)


def three_digits(x: float) -> str:
    """1234.5 as 1,230 and 0.12345 as 0.123."""
    return f"{float(f'{x:.3g}'):,.10g}"


def cell(entry: dict) -> str:
    """Times of both sides in us a point, and how many times faster silint is."""
    times = [f"{e['bound']}{three_digits(e['us_per_point'])}" for e in (entry["silint"], entry["embree"])]
    speedup = entry["speedup"]
    ratio = "" if speedup is None else f": **{speedup['bound']}{three_digits(speedup['value'])}x**"
    return " / ".join(times) + ratio


def table(report: dict) -> str:
    """One row a scene, one column an error."""
    rows = []
    for scene in report["scenes"]:
        entries = {row["rmse"]: row for row in scene["equal_error"]}
        cells = [cell(entries[rmse]) for rmse in RMSES]
        rows.append([f"{scene['name']} ({scene['n_faces']:,} triangles)", *cells])
    return markdown(["silint / Embree, us a point", *(f"RMSE {rmse:.0e}" for rmse in RMSES)], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=SCENES, help="generated scenes by name, or mesh files")
    parser.add_argument("--points", type=int, default=1024)
    parser.add_argument("--seconds", type=float, default=40.0, help="of timing, a scene")
    parser.add_argument("--output", default="error_against_time", help="prefix of the files written")
    options = parser.parse_args()
    report = run_bench([load(s) for s in options.scenes], points=options.points, seconds=options.seconds)
    print_tables(report)
    prefix = Path(options.output)
    plot(report, prefix.with_suffix(".png"))
    prefix.with_suffix(".json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    write(str(prefix.with_suffix(".md")), table(report))


if __name__ == "__main__":
    main()
