"""A benchmark's report for people: tables on the terminal, and a figure."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from silint.io import check_output, write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import Console

__all__ = ["PLOT_SUFFIXES", "plot", "print_tables"]

PLOT_SUFFIXES = (".png", ".svg", ".pdf")

NAMES = {"silint": "silint", "embree": "Embree QMC"}
UNITS = {"silint": "isolines", "embree": "rays"}

# Two colours that the colour-blind tell apart [Okabe & Ito 2008].
_COLORS = {"silint": "#0072B2", "embree": "#D55E00"}
_MARKERS = {"silint": "o", "embree": "s"}

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
        title=f"{scene['name']}: {scene['n_faces']:,} triangles; built in {build['silint']:.2f} s "
        f"(Embree {build['embree']:.2f} s)",
        title_justify="left",
        caption=f"RMSE over {options['error_points']} points ({options['weighting']}); the reference's own "
        f"standard error is {noise:.1e}",
        caption_justify="left",
    )
    table.add_column("")
    for heading in ("a point", "us a point", "RMSE", "worst", "Mrays/s", "bare Embree"):
        table.add_column(heading, justify="right")
    for method in ("silint", "embree"):
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
        if method == "silint":
            table.add_section()
    console.print(table)

    table = Table(title="time to an error, us a point", title_justify="left")
    for heading in ("RMSE", NAMES["silint"], NAMES["embree"], "faster"):
        table.add_column(heading, justify="right")
    for row in scene["equal_error"]:
        ratio = row["speedup"]
        table.add_row(
            f"{row['rmse']:.0e}",
            *(_time_text(row[method]) for method in ("silint", "embree")),
            "" if ratio is None else f"{ratio['bound']}{_three_digits(ratio['value'])} x",
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
    return f"{row['rmse']:.1e}" if row["resolved"] else f"< {4 * noise:.1e}"


def _time_text(time: dict[str, Any] | None) -> str:
    return "" if time is None else f"{time['bound']}{_three_digits(time['us_per_point'])}"


def _three_digits(x: float) -> str:
    return f"{x:,.0f}" if x >= 100 else f"{x:.3g}"


def plot(report: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the figure: a panel for each scene, error against time a point, both axes logarithmic.

    Parameters
    ----------
    report : dict
        From `run_bench`, or read from a file of ``silint bench --json``.
    path : str or path-like
        .png, .svg or .pdf.
    """
    from matplotlib.figure import Figure

    target = check_output(path, PLOT_SUFFIXES)
    scenes = report["scenes"]
    columns = min(3, len(scenes))
    rows = -(-len(scenes) // columns)
    figure = Figure(figsize=(5.4 * columns, 4.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[len(scenes) :]:
        ax.set_visible(False)
    for ax, scene in zip(axes.flat, scenes, strict=False):
        _draw_scene(ax, scene)
    for ax in axes[-1]:
        ax.set_xlabel("time a point, all cores [µs]")
    for ax in axes[:, 0]:
        ax.set_ylabel("RMSE of ambient occlusion")
    machine = report["machine"]
    figure.suptitle(
        f"silint {report['silint']} and Embree QMC on {machine['threads']} threads, {machine['processor']}",
        fontsize=9,
        color="0.35",
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format=Path(target).suffix[1:].lower(), dpi=160)
    write_bytes(target, buffer.getvalue())


def _draw_scene(ax: Axes, scene: dict[str, Any]) -> None:
    for method in ("silint", "embree"):
        rows = [r for r in scene["rows"] if r["method"] == method and r["resolved"] and r["rmse"] > 0]
        x = [r["us_per_point"] for r in rows]
        y = [r["rmse"] for r in rows]
        color = _COLORS[method]
        ax.plot(x, y, marker=_MARKERS[method], ms=5, lw=1.8, color=color, label=f"{NAMES[method]}")
        for i, row in enumerate(rows):
            # Below silint's curve and above Embree's, where the other one is not.
            unit = f" {UNITS[method]}" if i == 0 else ""
            below = method == "silint"
            ax.annotate(
                f"{row['setting']:,}{unit}",
                (x[i], y[i]),
                xytext=(-5, -5) if below else (5, 5),
                textcoords="offset points",
                ha="right" if below else "left",
                va="top" if below else "bottom",
                fontsize=7,
                color=color,
            )
    noise = scene["reference"]["standard_error"]
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.margins(0.14)
    low, high = ax.get_ylim()
    if low < noise < high:
        ax.axhspan(low, noise, color="0.92", zorder=0)
    ax.set_ylim(low, high)
    _draw_speedup(ax, scene)
    ax.grid(True, which="major", color="0.9", lw=0.8)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.legend(frameon=False, fontsize=8, loc="upper right")
    ax.set_title(f"{scene['name']}: {scene['n_faces']:,} triangles", fontsize=10, loc="left")


def _draw_speedup(ax: Axes, scene: dict[str, Any]) -> None:
    """An arrow between the curves at the smallest error that both reach."""
    both = [
        r
        for r in scene["equal_error"]
        if r["silint"] and r["embree"] and not r["silint"]["bound"] and not r["embree"]["bound"]
    ]
    if not both:
        return
    row = min(both, key=lambda r: float(r["rmse"]))
    start, end, y = row["embree"]["us_per_point"], row["silint"]["us_per_point"], row["rmse"]
    ax.annotate("", (end, y), (start, y), arrowprops={"arrowstyle": "->", "color": "0.3", "lw": 1.2})
    ax.annotate(
        f"{_three_digits(row['speedup']['value'])} x",
        ((start * end) ** 0.5, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
        color="0.3",
    )
