"""`silint bench`: options as the command line has them, to reports and files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Any

from silint.bench.figures import PLOT_SUFFIXES, plot
from silint.bench.measure import ISOLINES, RAYS, StageProgress, run_bench
from silint.bench.quantity import QUANTITIES
from silint.io import check_output, write_bytes
from silint.validation import InputError, choice

__all__ = ["bench_command"]

# What --quick changes unless told otherwise: about 20 s with compiled kernels.
_QUICK: dict[str, Any] = {"points": 512, "rays": RAYS[:-1], "repeats": 3, "seconds": 8.0}
_FULL: dict[str, Any] = {"points": 2048, "rays": RAYS, "repeats": 3, "seconds": 60.0}


def bench_command(
    scenes: Sequence[str | os.PathLike[str]] = (),
    *,
    points: int | None = None,
    isolines: str | None = None,
    rays: str | None = None,
    weighting: str = "cosine",
    quantity: str = "ao",
    envmap: str | os.PathLike[str] | None = None,
    envmap_up: str = "y",
    max_degree: int = 4,
    seed: int = 0,
    repeats: int | None = None,
    seconds: float | None = None,
    quick: bool = False,
    json_file: str | os.PathLike[str] | None = None,
    plot_file: str | os.PathLike[str] | None = None,
    progress: StageProgress | None = None,
) -> dict[str, Any]:
    """Run the benchmark and write its files; `print_tables` shows what it returns.

    Parameters
    ----------
    scenes : sequence of paths
        Mesh files; the packaged scene if there are none.
    points, weighting, quantity, max_degree, seed, repeats, seconds, progress
        See `run_bench`.
    isolines, rays : str
        Settings, as in ``"8,16,32"``.
    envmap : path, optional
        The light of irradiance; see `Environment.from_file`.
    envmap_up : {"y", "z"}
        The scene's axis that the top of the map goes to.
    quick : bool
        Smaller defaults: a smoke run.
    json_file, plot_file : path, optional
        Where the report (.json) and the figure (.png, .svg, .pdf) go.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        In one line, before anything is measured; nothing is written then.
    """
    defaults = _QUICK if quick else _FULL
    if json_file is not None:
        check_output(json_file, (".json",))
    if plot_file is not None:
        check_output(plot_file, PLOT_SUFFIXES)
    line_settings = ISOLINES if isolines is None else _numbers(isolines, "isolines")
    ray_settings = defaults["rays"] if rays is None else _numbers(rays, "rays")
    choice(quantity, "quantity", QUANTITIES)
    environment = None
    if envmap is not None:
        from silint.environment import Environment

        environment = Environment.from_file(envmap, envmap_up)
    report = run_bench(
        list(scenes) or [_packaged()],
        points=defaults["points"] if points is None else points,
        isolines=line_settings,
        rays=ray_settings,
        weighting=weighting,
        quantity=quantity,
        environment=environment,
        max_degree=max_degree,
        seed=seed,
        repeats=defaults["repeats"] if repeats is None else repeats,
        seconds=defaults["seconds"] if seconds is None else seconds,
        progress=progress,
    )
    if json_file is not None:
        write_bytes(json_file, (json.dumps(report, indent=2) + "\n").encode())
    if plot_file is not None:
        plot(report, plot_file)
    return report


def _packaged() -> Any:
    from silint.demo import demo_scene

    return demo_scene()


def _numbers(text: str, name: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"{name} is {text!r}; expected whole numbers with commas, as in 8,64,512") from None
