"""`silint info`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from silint.cli.output import JsonFlag, print_json, progress_bar

if TYPE_CHECKING:
    from silint.scene import Scene

__all__ = ["info_command"]


def info_command(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    as_json: JsonFlag = False,
) -> None:
    """Tell a mesh's size and topology defects, the memory it takes, and the plan for it."""
    with progress_bar() as bar:
        bar.add_task("reading and building", total=None)
        from silint.integrator import SilhouetteIntegrator
        from silint.scene import load_scene

        scene = load_scene(mesh)
        integrator = SilhouetteIntegrator(scene)
        plan, memory, defects = integrator.plan, integrator.memory, scene.defects
        low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    per_triangle = sum(memory.values()) / scene.n_faces
    if as_json:
        print_json(
            {
                "mesh": mesh,
                "n_vertices": scene.n_vertices,
                "n_faces": scene.n_faces,
                "bounds": [low.tolist(), high.tolist()],
                "float32_source": scene.float32_source,
                "normals": "file" if scene.normals is not None else "computed",
                "groups": _faces_by_group(scene),
                "defects": defects,
                "memory": memory,
                "bytes_per_triangle": per_triangle,
                "plan": plan.as_dict(),
            }
        )
        return
    precision = "float32" if scene.float32_source else "float64"
    origin = "in the file" if scene.normals is not None else "none in the file: angle-weighted"
    print(f"{mesh}: {scene.n_faces:,} triangles, {scene.n_vertices:,} vertices ({precision})")
    print(f"bounds   {_vector(low)} to {_vector(high)}")
    print(f"normals  {origin}")
    if scene.groups:
        print(f"groups   {_group_names(scene.groups)}")
    print("defects  (counted, not repaired)")
    width = max(len(name) for name in defects)
    for name, count in defects.items():
        print(f"  {name.replace('_', ' '):<{width}} {count:>12,}")
    print(f"memory   {per_triangle:.0f} bytes a triangle of topology and hierarchies")
    for name, n_bytes in memory.items():
        print(f"  {name:<{width}} {n_bytes:>12,}")
    print(f"plan     {plan}")


def _faces_by_group(scene: Scene) -> dict[str, int]:
    import numpy as np

    if scene.face_groups is None:
        return {}
    counts = np.bincount(scene.face_groups, minlength=len(scene.groups))
    return dict(zip(scene.groups, counts.tolist(), strict=True))


def _group_names(names: tuple[str, ...], shown: int = 8) -> str:
    more = len(names) - shown
    return ", ".join(names[:shown]) + (f" and {more:,} more (--json has all)" if more > 0 else "")


def _vector(v: Any) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in v) + ")"
