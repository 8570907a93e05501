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

# Options that do nothing in some of the kinds of bake, and are refused there.
_OF_TEXTURES = ("uv", "padding", "normal_map", "space", "green", "samples", "depth")
_OF_MAPS = ("envmap_up", "envmap_rotate")
_OF_VERTICES = ("per",)
_NOT_OF_SH = (
    *("tolerance", "up", "envmap", "envmap_up", "envmap_rotate", "texture", "normals", "two_sided"),
    *("occluder", "self_only", "group", "max_distance", "falloff", "spread", "backfaces", "ground"),
    "interpolate",
)


def bake_command(
    context: typer.Context,
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    output: Annotated[
        str,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT",
            help=".npz .ply .glb; textures: .png .exr .glb (the MESH with the occlusion, if that is glTF)",
        ),
    ],
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
        str, typer.Option(help="file, smooth, flat, or auto: the file's or else smooth; flat for faces.")
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
    interpolate: Annotated[
        float | None,
        typer.Option(metavar="TOL", help="Compute some points, predict the rest; held-back ones within TOL."),
    ] = None,
    texture: Annotated[int | None, typer.Option(metavar="N", help="Bake a texture of N x N texels.")] = None,
    uv: Annotated[
        str, typer.Option(help="Of textures: file, unwrap, or auto: the file's coordinates where they fit.")
    ] = "auto",
    padding: Annotated[
        int | None, typer.Option(help="Texels around charts to fill; all of them by default.")
    ] = None,
    normal_map: Annotated[
        str | None, typer.Option(metavar="FILE", help="Tangent-space map that turns a texture's normals.")
    ] = None,
    space: Annotated[str, typer.Option(help="Of bent normals in textures: tangent or world.")] = "tangent",
    green: Annotated[
        str, typer.Option(help="up (OpenGL) or down (DirectX), in tangent space and in --normal-map.")
    ] = "up",
    samples: Annotated[int, typer.Option(help="Of texels that hold an edge; others have one.")] = 4,
    depth: Annotated[int, typer.Option(help="Bits a channel of .png: 8 or 16.")] = 8,
    as_json: JsonFlag = False,
) -> None:
    """Bake ambient occlusion, sky view factors, bent normals or irradiance of a mesh into a file."""
    if texture is None:
        _refuse(context, _OF_TEXTURES, "needs --texture N")
    else:
        _refuse(context, _OF_VERTICES, "is not for --texture")
    if envmap is None:
        _refuse(context, _OF_MAPS, "needs --envmap MAP")
    if quantity == "sh":
        from silint.cli.prt import prt_command

        _refuse(context, _NOT_OF_SH, "is not for quantity 'sh'")
        prt_command(
            mesh, output, per=per, isolines=isolines, method=method, weighting=weighting, as_json=as_json
        )
        return
    _check_named(quantity, envmap_up, envmap_rotate, texture)
    shared: dict[str, Any] = {
        "isolines": isolines,
        "method": method,
        "weighting": weighting,
        "up": up,
        "tolerance": tolerance,
        "normals": normals,
        "two_sided": two_sided,
        "occluders": occluder or (),
        "self_only": self_only,
        "groups": group or (),
        "max_distance": max_distance,
        "falloff": falloff,
        "spread": spread,
        "backfaces": backfaces,
        "ground": _number(ground),
        "interpolate": interpolate,
    }
    with progress_bar("points") as bar:
        from silint.environment import Environment

        if envmap is not None:
            from silint.bake import check_unread

            check_unread(output, mesh, envmap=envmap)
            shared["environment"] = Environment.from_file(envmap, envmap_up, envmap_rotate)
        shared["progress"] = stage(bar, "baking")
        if texture is None:
            from silint.bake import bake

            summary = bake(mesh, output, quantity, per, **shared)
        else:
            from silint.texture import bake_texture

            summary = bake_texture(
                mesh,
                output,
                texture,
                quantity,
                uv=uv,
                padding=padding,
                normal_map=normal_map,
                space=space,
                green=green,
                samples=samples,
                depth=depth,
                **shared,
            )
    if as_json:
        print_json(summary)
    else:
        _print_summary(summary)


def _print_summary(summary: dict[str, Any]) -> None:
    quantity, per = summary["quantity"], summary.get("per", "texel")
    sites = {"vertex": "vertices", "face": "faces", "texel": "texels"}[per]
    n_sites = summary["texels"]["covered"] if per == "texel" else summary["n_points"]
    meaning = "luminance of radiance x sr" if quantity == "irradiance" else "0 is closed"
    if summary["open"] is not None:
        meaning = f"{summary['open']:.4g} is open, {meaning}"
    told = "length of bent" if quantity == "bent" else quantity
    print(
        f"{told} at {n_sites:,} {sites}: mean {summary['mean']:.4f}, "
        f"from {summary['min']:.4f} to {summary['max']:.4f}; {meaning}"
    )
    if per == "texel":
        _print_texture_notes(summary)
    else:
        if summary["without_normal"]:
            told = "1" if quantity in ("ao", "sky") else "0"
            print(f"{summary['without_normal']:,} {sites} have no normal and got {told}")
        if summary["computed_normals"]:
            print(f"{summary['computed_normals']:,} vertices have no normal in the file and got a smooth one")
        if summary["split_vertices"]:
            print(f"{summary['split_vertices']:,} vertices are new, where faces or groups shared one")
    if "interpolation" in summary:
        told = summary["interpolation"]
        if told["computed"] == told["distinct"]:
            print("computed all points: to predict some would have cost more than it spares")
        else:
            print(
                f"computed {told['computed']:,} of {told['points']:,} points; "
                f"held-back error at most {told['held_back_error']:.2g}"
            )
    print_notes(summary["diagnostics"], "points' two sides" if summary.get("two_sided") else "points")
    print_costs(summary)
    print_files(summary["files"])


def _print_texture_notes(summary: dict[str, Any]) -> None:
    texels, seams = summary["texels"], summary["seams"]
    print(
        f"{summary['size']} x {summary['size']} texels in {summary['n_charts']:,} charts, "
        f"{texels['mixed']:,} of them on edges with several points each"
    )
    if "uv_reason" in summary:
        print(f"unwrapped anew: {summary['uv_reason']}")
    told = {
        "overlapping texels belong to more than one face": texels["overlapping"],
        "texels are read beside two charts at once, which are closer than 2 texels": texels["shared"],
        "faces have no area, in space or in the texture, and no texels": summary["faces_without_area"],
        "faces have coordinates in other squares than [0, 1] and were moved there": summary["shifted_faces"],
        "corners have coordinates beyond [0, 1] by half a texel or less, and were clamped": summary[
            "clamped_corners"
        ],
        "shading normals looked below the surface and were turned": summary["turned_normals"],
    }
    for meaning, count in told.items():
        if count:
            print(f"{count:,} {meaning}")
    if "asset" in summary:
        asset = summary["asset"]
        sets = " and ".join(f"TEXCOORD_{n}" for n in asset["texcoord"])
        had = f"; {asset['replaced']:,} had one before" if asset["replaced"] else ""
        print(
            f"the source is kept: {asset['materials']:,} of its materials have the occlusion, by {sets}{had}"
        )
        if asset["emptied"]:
            print(f"{asset['emptied']:,} nodes of other groups stay without their meshes")
        if asset["variants"]:
            print("variants of materials stay without the occlusion")
    if "left_out" in summary:
        print(f"left out of the source: {', '.join(summary['left_out'])}; {summary['left_out_reason']}")
    if "largest_jump_before" in seams:
        print(
            f"across seams at most {seams['largest_jump_before']:.1e} apart, "
            f"after they were made to agree {seams['largest_jump_after']:.1e}"
        )


def _check_named(quantity: str, envmap_up: str, envmap_rotate: float, texture: int | None) -> None:
    """What is checked again by others, who call it something else or know less of it."""
    from silint.bake import QUANTITIES
    from silint.texture.bake import MAX_SIZE
    from silint.validation import choice, finite_number, positive_int

    choice(quantity, "quantity", (*QUANTITIES, "sh"))
    choice(envmap_up, "envmap_up", ("y", "z"))
    finite_number(envmap_rotate, "envmap_rotate")
    if texture is not None:
        positive_int(texture, "texture", maximum=MAX_SIZE)


def _number(text: str | None) -> float | str | None:
    """A number as such, and anything else for others to judge."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return text


def _refuse(context: typer.Context, names: tuple[str, ...], why: str) -> None:
    """Options that would do nothing are mistakes."""
    from silint.validation import InputError

    for name in names:
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise InputError(f"--{name.replace('_', '-')} {why}")
