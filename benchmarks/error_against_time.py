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


def cell(entry: dict | None, unit: str = "") -> str:
    """A value with its bound; a dash where the bounds decide nothing."""
    if entry is None:
        return "–"
    value = entry.get("us_per_point", entry.get("value"))
    return f"{entry['bound']}{value:.3g}{unit}"


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
    rows = []
    for scene in report["scenes"]:
        for row in scene["equal_error"]:
            rows.append(
                [
                    f"{scene['name']} ({scene['n_faces']:,})",
                    f"{row['rmse']:.0e}",
                    cell(row["silint"]),
                    cell(row["embree"]),
                    cell(row["speedup"], "x"),
                ]
            )
    header = ["scene (triangles)", "RMSE", "silint, us a point", "Embree, us a point", "ratio"]
    write(str(prefix.with_suffix(".md")), markdown(header, rows))


if __name__ == "__main__":
    main()
