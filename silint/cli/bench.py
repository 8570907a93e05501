"""`silint bench`."""

from __future__ import annotations

from typing import Annotated

import typer

from silint.cli.output import progress_bar, stages

__all__ = ["bench_command"]


def bench_command(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="[MESH]...", help="The packaged scene if there is none.")
    ] = None,
    points: Annotated[int | None, typer.Option(help="How many, spread over the surface.")] = None,
    isolines: Annotated[str | None, typer.Option(metavar="N,N,...", help="silint's settings.")] = None,
    rays: Annotated[str | None, typer.Option(metavar="N,N,...", help="Embree's settings.")] = None,
    weighting: Annotated[str, typer.Option(help="cosine or uniform.")] = "cosine",
    quantity: Annotated[str, typer.Option(help="ao, irradiance (with --envmap), or sh.")] = "ao",
    envmap: Annotated[
        str | None, typer.Option(metavar="MAP", help="Of irradiance: .hdr .exr .png .jpg.")
    ] = None,
    envmap_up: Annotated[str, typer.Option(help="Where the map's top goes: y or z.")] = "y",
    max_degree: Annotated[int, typer.Option(help="Of sh: 0 to 16.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the points and the rays.")] = 0,
    repeats: Annotated[int | None, typer.Option(help="Rounds; the median of their times counts.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Time to spend on each scene's timings.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer points, rays and rounds.")] = False,
    json_file: Annotated[str | None, typer.Option("--json", metavar="FILE", help="Write a report.")] = None,
    plot_file: Annotated[str | None, typer.Option("--plot", metavar="FILE", help="Draw a figure.")] = None,
) -> None:
    """Measure error against run time, silint and Embree QMC side by side."""
    with progress_bar() as bar:
        from silint import bench

        report = bench.bench_command(
            scenes or (),
            points=points,
            isolines=isolines,
            rays=rays,
            weighting=weighting,
            quantity=quantity,
            envmap=envmap,
            envmap_up=envmap_up,
            max_degree=max_degree,
            seed=seed,
            repeats=repeats,
            seconds=seconds,
            quick=quick,
            json_file=json_file,
            plot_file=plot_file,
            progress=stages(bar),
        )
    bench.print_tables(report)
    for file in (json_file, plot_file):
        if file is not None:
            print(f"wrote {file}")
