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
    seconds = summary["seconds"]
    print(
        f"read {seconds['load']:.2f} s, built {seconds['build']:.2f} s, "
        f"integrated {seconds['integrate']:.2f} s {with_lines(summary['isolines'])}"
    )
    if summary["peak_memory_bytes"]:
        print(f"at most {summary['peak_memory_bytes'] / 2**20:,.0f} MiB of memory")


def with_lines(isolines: int) -> str:
    """How finely something was integrated; 0 isolines is exact mode."""
    return f"with {isolines} isolines" if isolines else "exactly"


def print_json(value: Any) -> None:
    """The machine's form of the results."""
    print(json.dumps(value, indent=2))


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Progress on stderr where that is a terminal, and nothing at all elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
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
