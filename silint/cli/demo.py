"""`silint demo`."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from silint.cli.output import JsonFlag, print_json, progress_bar, stages, with_lines

__all__ = ["demo_command"]


def demo_command(
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Where to write.")] = "silint-demo",
    as_json: JsonFlag = False,
) -> None:
    """Bake the packaged scene, compare with Embree, draw a picture."""
    with progress_bar() as bar:
        from silint.demo import demo

        summary = demo(out, progress=stages(bar))
    if as_json:
        print_json(summary)
        return
    seconds = summary["seconds"]
    print(
        f"baked ambient occlusion at {summary['n_points']:,} vertices of {summary['n_faces']:,} triangles: "
        f"{seconds['bake']:.1f} s {with_lines(summary['isolines'])}"
    )
    _print_comparison(summary["comparison"])
    for file in summary["files"]:
        print(f"wrote {file}")


def _print_comparison(comparison: dict[str, Any] | None) -> None:
    if comparison is None:
        print("no comparison with Embree: the package embreex is not installed here")
        return
    from rich.console import Console
    from rich.table import Table

    reference = comparison["reference"]
    table = Table()
    table.add_column("")
    for heading in ("a point", "time", "RMSE", "worst"):
        table.add_column(heading, justify="right")
    for row in comparison["rows"]:
        lines = f"{row['isolines']} isolines" if row["method"] == "silint" else f"{row['rays']} rays"
        name = {"silint": "silint", "embree": "Embree QMC"}[row["method"]]
        # What the reference cannot tell from its own noise is a bound, not a figure.
        rmse = f"{row['rmse']:.1e}" if row["resolved"] else f"< {4.0 * reference['standard_error']:.1e}"
        table.add_row(name, lines, f"{1e3 * row['seconds']:.0f} ms", rmse, f"{row['max']:.1e}")
    Console(width=None if sys.stdout.isatty() else 100, highlight=False).print(table)
    print(
        f"{comparison['n_points']} points, {comparison['threads']} threads; "
        f"truth: Embree with {reference['rays']:,} rays a point"
    )
