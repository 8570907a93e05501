"""What the commands share: progress on stderr, results on stdout."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.progress import Progress

JsonFlag = Annotated[bool, typer.Option("--json", help="Print the results as JSON on stdout.")]


def print_costs(summary: dict[str, Any]) -> None:
    """Time and memory of a bake."""
    seconds, n_points = summary["seconds"], summary["n_points"] - summary.get("without_normal", 0)
    print(
        f"read {seconds['load']:.2f} s, built {seconds['build']:.2f} s, "
        f"integrated {n_points:,} points in {seconds['integrate']:.2f} s "
        f"({n_points / max(seconds['integrate'], 1e-9):,.0f} points/s) {with_lines(summary['isolines'])}"
    )
    if summary["peak_memory_bytes"]:
        print(f"at most {summary['peak_memory_bytes'] / 2**20:,.0f} MiB of memory")


def print_notes(diagnostics: dict[str, int], points: str = "points") -> None:
    """What was not as everywhere, in plain words; nothing for what did not happen."""
    told = {
        "buried": f"of {diagnostics['points']:,} {points} see nothing: inside something, or shut in",
        "snapped_sides": "sides of faces were within rounding of their plane and decided by rule",
        "fallback_isolines": "isolines contradicted themselves and were computed again, by covering",
        "uncertified_points": "points have arcs that contradict each other; 1024 isolines stand in for them",
        "above_tolerance": "points stay above the tolerance with as many isolines as there may be",
    }
    for name, meaning in told.items():
        if diagnostics.get(name):
            print(f"{diagnostics[name]:,} {meaning}")


def print_files(files: list[dict[str, Any]]) -> None:
    """What was written, with sizes."""
    for file in files:
        print(f"wrote {file['path']} ({file['bytes']:,} bytes)")


def with_lines(isolines: int) -> str:
    """How finely something was integrated; 0 isolines is exact mode."""
    return f"with {isolines} isolines" if isolines else "exactly"


def print_json(value: Any) -> None:
    """The machine's form of the results."""
    print(json.dumps(value, indent=2))


@contextmanager
def progress_bar(unit: str = "") -> Iterator[Progress]:
    """Progress on stderr where that is a terminal, and nothing at all elsewhere.

    With the name of what is counted, how many a second, and the time that is left.
    """
    from rich import progress
    from rich.console import Console
    from rich.text import Text

    class Rate(progress.ProgressColumn):
        def render(self, task: progress.Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None else f"{speed:,.0f} {unit}/s")

    console = Console(stderr=True)
    columns = [progress.TextColumn("{task.description}"), progress.BarColumn(), progress.TimeElapsedColumn()]
    if unit:
        columns += [Rate(), progress.TimeRemainingColumn(), progress.TextColumn("left")]
    with progress.Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        yield bar


def stage(bar: Progress, name: str) -> Callable[[int, int], None]:
    """What a computation of one stage calls with (done, total)."""
    update = stages(bar)
    update(name, 0, 0)
    return lambda done, total: update(name, done, total)


def stages(bar: Progress) -> Callable[[str, int, int], None]:
    """What a computation of several stages calls with (stage, done, total); a line for each."""
    tasks: dict[str, Any] = {}

    def update(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=None)
        bar.update(tasks[stage], completed=done, total=total or None)

    return update
