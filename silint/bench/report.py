"""A benchmark's report on the terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from silint.bench.curves import Bounded
from silint.bench.rows import EMBREE
from silint.bench.truth import RESOLVED

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["NAMES", "UNITS", "bounded_text", "error_of", "methods_of", "print_tables", "three_digits"]

NAMES = {
    "auto": "silint",
    "radial": "silint, radial",
    "octahedral": "silint, octahedral",
    EMBREE: "Embree QMC",
}
UNITS = {"auto": "isolines", "radial": "isolines", "octahedral": "isolines", EMBREE: "rays"}

# Load for each thread, before the benchmark starts, from which its times are in doubt.
_BUSY = 0.5

# Beyond this, the reference and Embree do not differ by chance.
_SUSPICIOUS = 1e-4


def print_tables(report: dict[str, Any], console: Console | None = None) -> None:
    """Print every scene's curves, equal-error times, and what Embree says of the reference."""
    from rich.console import Console

    if console is None:
        console = Console(width=None if sys.stdout.isatty() else 100, highlight=False)
    machine = report["machine"]
    console.print(f"{machine['processor']}, {machine['threads']} threads, both sides")
    if machine["load_average"] is not None and machine["load_average"] > _BUSY * machine["threads"]:
        console.print(
            f"other work kept the machine busy (load {machine['load_average']}): times are unreliable"
        )
    for scene in report["scenes"]:
        console.print()
        _print_scene(scene, report["options"], console)


def _print_scene(scene: dict[str, Any], options: dict[str, Any], console: Console) -> None:
    from rich.table import Table

    build = scene["build_seconds"]
    noise = scene["reference"]["standard_error"]
    table = Table(
        title=f"{scene['name']}: {scene['n_faces']:,} triangles; built in "
        + ", ".join(f"{seconds:.2f} s ({NAMES[method]})" for method, seconds in build.items()),
        title_justify="left",
        caption=f"{_caption(options)}; the reference's own standard error is {noise:.1e}",
        caption_justify="left",
    )
    table.add_column("")
    for heading in ("a point", "us a point", "RMSE", "worst", "Mrays/s", "bare Embree"):
        table.add_column(heading, justify="right")
    methods = methods_of(scene)
    for method in methods:
        rows = [r for r in scene["rows"] if r["method"] == method]
        for i, row in enumerate(rows):
            traced = "rays_per_second" in row
            table.add_row(
                NAMES[method] if i == 0 else "",
                f"{row['setting']:,} {UNITS[method]}",
                f"{row['us_per_point']:,.1f}",
                _rmse_text(row, noise),
                f"{row['max_error']:.1e}",
                f"{row['rays_per_second'] / 1e6:.1f}" if traced else "",
                f"{row['bare_rays_per_second'] / 1e6:.1f}" if traced else "",
            )
        table.add_section()
    console.print(table)

    table = Table(title="time to an error, us a point", title_justify="left")
    for heading in ("RMSE", *(NAMES[m] for m in methods), *("faster" for _ in methods[:-1])):
        table.add_column(heading, justify="right")
    for row in scene["equal_error"]:
        table.add_row(
            f"{row['rmse']:.0e}",
            *(bounded_text(row["times"][m]) for m in methods),
            *(bounded_text(row["speedups"][m], " x") for m in methods[:-1]),
        )
    console.print(table)
    _print_check(scene["check"], console)


def _print_check(check: dict[str, Any], console: Console) -> None:
    console.print(
        f"the reference against Embree with {check['rays']:,} rays a point: mean difference "
        f"{check['mean_difference']:+.1e} +- {check['mean_difference_error']:.1e}, "
        f"at most {check['max_sigma']:.1f} standard errors (by chance with p = {check['p_value']:.2g})"
    )
    for found in check["beyond_5_sigma"]:
        where = ", ".join(f"{x:.9g}" for x in found["point"])
        console.print(
            f"  beyond 5 sigma: ({where}) silint {found['silint']:.6f}, Embree {found['embree']:.6f}, "
            f"{found['sigma']:.1f} sigma"
        )
    if check["p_value"] < _SUSPICIOUS:
        console.print("  this is no chance: one of the two is wrong at those points by more than they claim")


def _rmse_text(row: dict[str, Any], noise: float) -> str:
    return f"{row['rmse']:.1e}" if row["resolved"] else f"< {RESOLVED * noise:.1e}"


def error_of(options: dict[str, Any]) -> str:
    """What the errors of a report are, by its options; those before silint-bench/3 have no quantity."""
    if options.get("quantity") == "irradiance":
        under = f" under {options['environment']}" if options["environment"] else ""
        return f"relative RMSE of irradiance{under}"
    if options.get("quantity") == "sh":
        return f"RMSE of SH transfer, degree {options['max_degree']}"
    return "RMSE of ambient occlusion"


def _caption(options: dict[str, Any]) -> str:
    error = "RMSE" if options.get("quantity", "ao") == "ao" else error_of(options)
    if options.get("quantity") == "irradiance":
        error += " (of the worst channel)"
    return f"{error} over {options['error_points']} points ({options['weighting']})"


def methods_of(scene: dict[str, Any]) -> list[str]:
    """A scene's methods in the order in which they were asked for, Embree last."""
    return list(scene["equal_error"][0]["times"])


def bounded_text(number: dict[str, Any] | None, unit: str = "") -> str:
    """Three digits behind the bound; nothing where nothing is known."""
    if number is None:
        return ""
    known = Bounded(**number)
    return f"{known.bound}{three_digits(known.value)}{unit}"


def three_digits(x: float) -> str:
    """1234.5 as 1,230 and 0.12345 as 0.123."""
    return f"{float(f'{x:.3g}'):,.10g}"
