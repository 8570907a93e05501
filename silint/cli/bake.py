"""`silint bake`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from silint.cli.output import (
    JsonFlag,
    print_costs,
    print_files,
    print_json,
    print_notes,
    progress_bar,
    stage,
)

__all__ = ["bake_command"]

# What of these options `silint prt` has as well.
_OF_SH = frozenset({"mesh", "output", "quantity", "per", "isolines", "method", "weighting", "as_json"})


def bake_command(
    context: typer.Context,
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
    up: Annotated[tuple[float, float, float], typer.Option(help="Of sky and ground.")] = (0.0, 0.0, 1.0),
    envmap: Annotated[
        str | None, typer.Option(metavar="MAP", help="Of irradiance: .hdr .exr .png .jpg.")
    ] = None,
    envmap_up: Annotated[str, typer.Option(help="Where the map's top goes: y or z.")] = "y",
    envmap_rotate: Annotated[float, typer.Option(help="Degrees about that axis.")] = 0.0,
    normals: Annotated[
        str, typer.Option(help="file, smooth, flat, or auto: the file's or smooth; flat for faces.")
    ] = "auto",
    two_sided: Annotated[
        bool, typer.Option("--two-sided", help="Mean of both sides of the surface, as for leaves.")
    ] = False,
    occluder: Annotated[
        list[str] | None, typer.Option(metavar="FILE", help="Blocks, and is not baked; may be repeated.")
    ] = None,
    self_only: Annotated[
        bool, typer.Option("--self-only", help="Nodes (glTF), objects (.obj) do not block each other.")
    ] = False,
    group: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Bake this node or object only; may be repeated.")
    ] = None,
    max_distance: Annotated[
        str | None,
        typer.Option(metavar="R|P%", help="What is farther does not block: length, or % of diagonal."),
    ] = None,
    falloff: Annotated[
        str, typer.Option(help="Of blocking over max-distance: none, linear or quadratic.")
    ] = "none",
    spread: Annotated[float, typer.Option(help="Degrees: the half-angle of the cone that counts.")] = 90.0,
    backfaces: Annotated[str, typer.Option(help="block or ignore: faces seen from their back.")] = "block",
    ground: Annotated[
        str | None,
        typer.Option(metavar="HEIGHT|auto", help="A plane that blocks, along --up; auto: below all."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Bake ambient occlusion, sky view factors, bent normals or irradiance of a mesh into a file."""
    if quantity == "sh":
        from silint.cli.prt import prt_command

        _refuse_others(context, _OF_SH, "quantity 'sh'")
        prt_command(
            mesh, output, per=per, isolines=isolines, method=method, weighting=weighting, as_json=as_json
        )
        return
    with progress_bar("points") as bar:
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
            normals=normals,
            two_sided=two_sided,
            occluders=occluder or (),
            self_only=self_only,
            groups=group or (),
            max_distance=max_distance,
            falloff=falloff,
            spread=spread,
            backfaces=backfaces,
            ground=_number(ground),
        )
    if as_json:
        print_json(summary)
    else:
        _print_summary(summary)


def _print_summary(summary: dict[str, Any]) -> None:
    quantity, sites = summary["quantity"], "vertices" if summary["per"] == "vertex" else "faces"
    meaning = "luminance of radiance x sr" if quantity == "irradiance" else "1 is open, 0 is closed"
    print(
        f"{quantity} at {summary['n_points']:,} {sites}: mean {summary['mean']:.4f}, "
        f"from {summary['min']:.4f} to {summary['max']:.4f}; {meaning}"
    )
    if summary["without_normal"]:
        told = "1" if quantity in ("ao", "sky") else "0"
        print(f"{summary['without_normal']:,} {sites} have no normal and got {told}")
    if summary["computed_normals"]:
        print(f"{summary['computed_normals']:,} vertices have no normal in the file and got a smooth one")
    if summary["split_vertices"]:
        print(f"{summary['split_vertices']:,} vertices are new: those that faces or groups shared are split")
    print_notes(summary["diagnostics"], "points' two sides" if summary.get("two_sided") else "points")
    print_costs(summary)
    print_files(summary["files"])


def _number(text: str | None) -> float | str | None:
    """A number as such, and anything else for others to judge."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _refuse_others(context: typer.Context, known: frozenset[str], of: str) -> None:
    """Options that would do nothing are mistakes."""
    from silint.validation import InputError

    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in known and source is not None and source.name == "COMMANDLINE":
            raise InputError(f"--{name.replace('_', '-')} is not for {of}")
