"""`silint prt`."""

from __future__ import annotations

from typing import Annotated

import typer

from silint.cli.output import JsonFlag, print_costs, print_files, print_json, print_notes, progress_bar, stage

__all__ = ["prt_command"]


def prt_command(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT", help=".npz .ply .glb, or a folder")],
    max_degree: Annotated[int, typer.Option(help="0 to 16, of spherical harmonics.")] = 2,
    per: Annotated[str, typer.Option(help="vertex or face.")] = "vertex",
    isolines: Annotated[int | None, typer.Option(help="More are more accurate; 64 by default.")] = None,
    method: Annotated[str, typer.Option(help="auto, radial, octahedral or exact.")] = "auto",
    weighting: Annotated[str, typer.Option(help="cosine or uniform.")] = "cosine",
    as_json: JsonFlag = False,
) -> None:
    """Bake transfer coefficients (PRT) of a mesh into a file: lighting by dot product.

    A folder gets bounce/bounce0.txt and bounce/face.npy, as computePRT of PIFu writes them.
    """
    with progress_bar("points") as bar:
        from silint.prt import prt_file

        summary = prt_file(
            mesh, output, max_degree, per, isolines, weighting, method, progress=stage(bar, "baking")
        )
    if as_json:
        print_json(summary)
        return
    sites = "vertices" if per == "vertex" else "faces"
    openness = summary["openness"]
    print(
        f"transfer of degree {max_degree} ({summary['n_coefficients']} coefficients, {weighting}) at "
        f"{summary['n_points']:,} {sites}: openness {openness['mean']:.4f}, "
        f"from {openness['min']:.4f} to {openness['max']:.4f}; 1 is open, 0 is closed"
    )
    if summary["without_normal"]:
        print(f"{summary['without_normal']:,} {sites} have no normal and got 0")
    print_notes(summary["diagnostics"])
    print_costs(summary)
    print_files(summary["files"])
