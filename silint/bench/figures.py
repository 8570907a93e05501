"""A benchmark's figures: error against time, and time against triangles."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from silint.bench.curves import power_law
from silint.bench.report import NAMES, UNITS, error_of, methods_of, three_digits
from silint.bench.rows import EMBREE
from silint.io import check_output, write_bytes
from silint.validation import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["PLOT_SUFFIXES", "plot", "plot_scaling", "scaling"]

PLOT_SUFFIXES = (".png", ".svg", ".pdf")

# Colours that the colour-blind tell apart [Okabe & Ito 2008].
_COLORS = {"auto": "#0072B2", "radial": "#0072B2", "octahedral": "#009E73", EMBREE: "#D55E00"}
_MARKERS = {"auto": "o", "radial": "o", "octahedral": "^", EMBREE: "s"}

# From this many scenes on, panels are small, and only the ends of their curves are labelled.
_MANY = 7


def plot(report: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the figure: a panel for each scene, error against time a point, both axes logarithmic.

    Parameters
    ----------
    report : dict
        From `run_bench`, or read from a file of ``silint bench --json``. Scenes that hold an
        ``exact_us_per_point`` show that time too.
    path : str or path-like
        .png, .svg or .pdf.
    """
    from matplotlib.figure import Figure

    target = check_output(path, PLOT_SUFFIXES)
    scenes = report["scenes"]
    many = len(scenes) >= _MANY
    columns = min(4 if many else 3, len(scenes))
    rows = -(-len(scenes) // columns)
    width, height = (3.7, 3.0) if many else (5.4, 4.4)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat[len(scenes) :]:
        ax.set_visible(False)
    for i, (ax, scene) in enumerate(zip(axes.flat, scenes, strict=False)):
        _draw_scene(ax, scene, many, legend=i == 0 or not many)
        if i + columns >= len(scenes):
            ax.set_xlabel("time a point, all cores [µs]")
    for ax in axes[:, 0]:
        ax.set_ylabel(error_of(report["options"]))
    _finish(figure, report, target)


def scaling(report: dict[str, Any], levels: Sequence[float], chosen: Callable[[str], bool]) -> dict[str, Any]:
    """Time against triangles at equal errors.

    Parameters
    ----------
    report : dict
        As for `plot`.
    levels : sequence of float
        Errors, of those in the report.
    chosen : callable
        Tells from a scene's name whether it belongs to the family.

    Returns
    -------
    dict
        {scenes, levels: [{rmse, methods: {method: {triangles, us_per_point, bound, factor, exponent}}}]};
        factor and exponent of the power law through the times that are known, not merely bounded; null
        where these are fewer than two.
    """
    family = sorted((s for s in report["scenes"] if chosen(s["name"])), key=lambda s: int(s["n_faces"]))
    if not family:
        raise InputError("scenes has none of the family whose times are wanted against triangles")
    out: list[dict[str, Any]] = []
    for level in levels:
        curves = {}
        for method in methods_of(family[0]):
            known = []
            for scene in family:
                times = next(row["times"] for row in scene["equal_error"] if row["rmse"] == level)
                if times.get(method):
                    known.append((scene["n_faces"], times[method]["value"], times[method]["bound"]))
            exact = [(n, t) for n, t, bound in known if not bound]
            law = power_law(*zip(*exact, strict=True)) if len(exact) > 1 else (None, None)
            curves[method] = {
                "triangles": [n for n, _, _ in known],
                "us_per_point": [t for _, t, _ in known],
                "bound": [bound for _, _, bound in known],
                "factor": law[0],
                "exponent": law[1],
            }
        out.append({"rmse": level, "methods": curves})
    return {"scenes": [s["name"] for s in family], "levels": out}


def plot_scaling(report: dict[str, Any], found: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write the figure of what `scaling` found: a panel for each error, hollow bounds, the power laws."""
    from matplotlib.figure import Figure

    target = check_output(path, PLOT_SUFFIXES)
    levels = found["levels"]
    figure = Figure(figsize=(5.4 * len(levels), 4.4), layout="constrained")
    for ax, level in zip(figure.subplots(1, len(levels), squeeze=False).flat, levels, strict=True):
        for method, curve in level["methods"].items():
            color, marker = _COLORS[method], _MARKERS[method]
            label = NAMES[method]
            if curve["exponent"] is not None:
                label += f": $n^{{{curve['exponent']:.2f}}}$"
                x = curve["triangles"]
                y = [curve["factor"] * n ** curve["exponent"] for n in x]
                ax.plot(x, y, lw=1.2, color=color, alpha=0.5)
            ax.plot([], [], marker=marker, color=color, lw=1.2, label=label)
            for n, t, bound in zip(curve["triangles"], curve["us_per_point"], curve["bound"], strict=True):
                ax.plot(n, t, marker=marker, ms=6, color=color, mfc="white" if bound else color)
        _style(ax)
        ax.legend(frameon=False, fontsize=8, loc="upper left")
        ax.set_title(f"time to an RMSE of {level['rmse']:.0e}", fontsize=10, loc="left")
        ax.set_xlabel("triangles")
        ax.set_ylabel("time a point, all cores [µs]")
    _finish(figure, report, target)


def _finish(figure: Figure, report: dict[str, Any], target: Path) -> None:
    machine = report["machine"]
    figure.suptitle(
        f"silint {report['silint']} and Embree QMC on {machine['threads']} threads, {machine['processor']}",
        fontsize=9,
        color="0.35",
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format=target.suffix[1:].lower(), dpi=160)
    write_bytes(target, buffer.getvalue())


def _draw_scene(ax: Axes, scene: dict[str, Any], small: bool, legend: bool) -> None:
    methods = methods_of(scene)
    for method in methods:
        rows = [r for r in scene["rows"] if r["method"] == method and r["resolved"] and r["rmse"] > 0]
        x = [r["us_per_point"] for r in rows]
        y = [r["rmse"] for r in rows]
        color = _COLORS[method]
        if rows and "channels" in rows[0]:
            # The best channel's error is the other side of a band below the curve, which is the worst one's.
            best = [min(channel["rmse"] for channel in r["channels"]) for r in rows]
            ax.fill_between(x, best, y, color=color, alpha=0.2, lw=0)
        ax.plot(x, y, marker=_MARKERS[method], ms=4 if small else 5, lw=1.8, color=color, label=NAMES[method])
        if method not in (methods[0], EMBREE):
            continue  # its settings are those of the first
        for i, row in enumerate(rows):
            if small and 0 < i < len(rows) - 1:
                continue
            # Below silint's curve and above Embree's, where the other one is not.
            unit = f" {UNITS[method]}" if i == 0 else ""
            below = method != EMBREE
            ax.annotate(
                f"{row['setting']:,}{unit}",
                (x[i], y[i]),
                xytext=(-5, -5) if below else (5, 5),
                textcoords="offset points",
                ha="right" if below else "left",
                va="top" if below else "bottom",
                fontsize=6 if small else 7,
                color=color,
            )
    noise = scene["reference"]["standard_error"]
    _style(ax)
    ax.margins(0.14)
    low, high = ax.get_ylim()
    if low < noise < high:
        ax.axhspan(low, noise, color="0.92", zorder=0)
    ax.set_ylim(low, high)
    _draw_speedup(ax, scene)
    if "exact_us_per_point" in scene:
        # Its error is rounding, far below: an arrow at the time that it takes.
        x, grey = scene["exact_us_per_point"], "0.3"
        ax.axvline(x, color=grey, lw=1.2, ls=":", zorder=1, label="silint, exact")
        ax.plot([x], [0.04], marker="v", ms=6, color=grey, transform=ax.get_xaxis_transform())
    if legend:
        ax.legend(frameon=False, fontsize=7 if small else 8, loc="upper right")
    ax.set_title(f"{scene['name']}: {scene['n_faces']:,} triangles", fontsize=9 if small else 10, loc="left")


def _style(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.grid(True, which="major", color="0.9", lw=0.8)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _draw_speedup(ax: Axes, scene: dict[str, Any]) -> None:
    """An arrow from Embree's curve to silint's first at the smallest error that both reach."""
    first = methods_of(scene)[0]
    both = [
        row
        for row in scene["equal_error"]
        if all(row["times"][m] and not row["times"][m]["bound"] for m in (first, EMBREE))
    ]
    if not both:
        return
    row = min(both, key=lambda r: float(r["rmse"]))
    start, end, y = row["times"][EMBREE]["value"], row["times"][first]["value"], row["rmse"]
    ax.annotate("", (end, y), (start, y), arrowprops={"arrowstyle": "->", "color": "0.3", "lw": 1.2})
    ax.annotate(
        f"{three_digits(row['speedups'][first]['value'])} x",
        ((start * end) ** 0.5, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
        color="0.3",
    )
