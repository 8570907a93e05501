"""`silint bake`."""

from __future__ import annotations

from typing import Annotated

import typer

from silint.cli.output import JsonFlag, print_costs, print_json, progress_bar, stage

__all__ = ["bake_command"]


def bake_command(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT", help=".npz .ply .glb")],
    quantity: Annotated[
        str, typer.Option(help="ao, sky (sky view factor), bent (bent normals), irradiance, or sh (as prt).")
    ] = "ao",
    per: Annotated[str, typer.Option(help="vertex or face.")] = "vertex",
    isolines: Annotated[int | None, typer.Option(help="More are more accurate; 64 by default.")] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="In place of isolines: as many as every point needs.")
    ] = None,
    method: Annotated[str, typer.Option(help="auto, radial, octahedral or exact.")] = "auto",
    weighting: Annotated[str, typer.Option(help="Of ao: cosine or uniform.")] = "cosine",
    up: Annotated[tuple[float, float, float], typer.Option(help="Of sky: where it is.")] = (0.0, 0.0, 1.0),
    envmap: Annotated[
        str | None, typer.Option(metavar="MAP", help="Of irradiance: .hdr .exr .png .jpg.")
    ] = None,
    envmap_up: Annotated[str, typer.Option(help="Where the map's top goes: y or z.")] = "y",
    envmap_rotate: Annotated[float, typer.Option(help="Degrees about that axis.")] = 0.0,
    as_json: JsonFlag = False,
) -> None:
    """Bake ambient occlusion, sky view factors, bent normals or irradiance of a mesh into a file."""
    if quantity == "sh" and tolerance is None and envmap is None:
        from silint.cli.prt import prt_command

        prt_command(
            mesh, output, per=per, isolines=isolines, method=method, weighting=weighting, as_json=as_json
        )
        return
    with progress_bar() as bar:
        from silint.bake import bake
        from silint.environment import Environment

        environment = None if envmap is None else Environment.from_file(envmap, envmap_up, envmap_rotate)
        summary = bake(
            mesh,
            output,
            quantity,
            per,
            progress=stage(bar, "baking"),
            isolines=isolines,
            method=method,
            weighting=weighting,
            up=up,
            tolerance=tolerance,
            environment=environment,
        )
    if as_json:
        print_json(summary)
        return
    sites = "vertices" if per == "vertex" else "faces"
    meaning = "luminance of radiance x sr" if quantity == "irradiance" else "1 is open, 0 is closed"
    print(
        f"{quantity} at {summary['n_points']:,} {sites}: mean {summary['mean']:.4f}, "
        f"from {summary['min']:.4f} to {summary['max']:.4f}; {meaning}"
    )
    if summary["without_normal"]:
        told = "1" if quantity in ("ao", "sky") else "0"
        print(f"{summary['without_normal']:,} {sites} have no normal and got {told}")
    print_costs(summary)
    print(f"wrote {output}")
