"""The table of named scenes with their exact triangle counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

from scenes import polyhedra
from scenes.city import city
from scenes.clutter import clutter
from scenes.fence import fence
from scenes.foliage import foliage
from scenes.mesh import Mesh
from scenes.room import room
from scenes.teapot import teapot, teapot_grid

Kind = Literal["closed", "open", "foliage", "interior"]


@dataclass(frozen=True)
class SceneSpec:
    """A scene: what builds it, and what it promises.

    Attributes
    ----------
    name : str
    function : callable
        Builds the mesh; takes no argument.
    triangles : int
        Exact count.
    kind : {"closed", "open", "foliage", "interior"}
        closed: outward solids without any boundary edge (they may interpenetrate); open: has boundary edges
        or no consistent winding; foliage: nearly all edges are boundaries; interior: to be looked at from
        inside.
    description : str
        One line.
    """

    name: str
    function: Callable[[], Mesh]
    triangles: int
    kind: Kind
    description: str


_TABLE: tuple[tuple[str, Callable[[], Mesh], int, Kind, str], ...] = (
    ("tetrahedron", polyhedra.tetrahedron, 4, "closed", "platonic solid"),
    ("box", polyhedra.box, 12, "closed", "cube of edge 2"),
    ("octahedron", polyhedra.octahedron, 8, "closed", "platonic solid, edges in the coordinate planes"),
    ("dodecahedron", polyhedra.dodecahedron, 36, "closed", "platonic solid, coplanar triangles"),
    ("icosahedron", polyhedra.icosahedron, 20, "closed", "platonic solid"),
    ("icosphere", polyhedra.icosphere, 1280, "closed", "unit sphere, three subdivisions"),
    ("torus", polyhedra.torus, 1280, "closed", "genus one"),
    ("capsule", polyhedra.capsule, 512, "closed", "rounded cylinder"),
    ("convex_polyhedron", polyhedra.convex_polyhedron, 76, "closed", "hull of 40 random points"),
    ("hourglass", polyhedra.hourglass, 8, "closed", "two tetrahedra that share one vertex"),
    ("closed_room", polyhedra.closed_room, 12, "interior", "box wound inwards: nothing visible from inside"),
    ("triangle", polyhedra.triangle, 1, "open", "one triangle"),
    ("rectangle", polyhedra.rectangle, 2, "open", "unit square, normal +z"),
    ("disc", polyhedra.disc, 64, "open", "regular 64-gon, normal +z"),
    ("wall", polyhedra.wall, 2, "open", "upright rectangle on z = 0"),
    ("wall_and_floor", polyhedra.wall_and_floor, 4, "open", "two squares at a right angle"),
    ("spherical_cap", polyhedra.spherical_cap, 1984, "open", "60 degrees of the unit sphere"),
    ("moebius_strip", polyhedra.moebius_strip, 96, "open", "no consistent winding"),
    ("fin", polyhedra.fin, 3, "open", "three sheets on one edge"),
    ("clutter_9k", partial(clutter, 12, 2), 9_372, "closed", "48 solids over a slab"),
    ("clutter_31k", partial(clutter, 10, 3), 30_852, "closed", "40 solids over a slab"),
    ("clutter_185k", partial(clutter, 60, 3), 185_052, "closed", "240 solids over a slab"),
    ("clutter_2500k", partial(clutter, 200, 4), 2_460_012, "closed", "800 solids over a slab"),
    ("teapot", teapot, 6_320, "open", "Newell's teapot, each patch 10 x 10"),
    ("teapot_grid", teapot_grid, 1_896_012, "open", "300 teapots on a slab"),
    ("foliage", foliage, 119_562, "foliage", "five trees, 48,000 leaves"),
    ("fence", fence, 28_768, "closed", "chain-link fence"),
    ("fence_rows", partial(fence, fences=4), 115_036, "closed", "four chain-link fences behind each other"),
    ("city", city, 20_868, "closed", "144 blocks of box buildings, coplanar and abutting"),
    ("room", room, 6_920, "interior", "furnished room with a window"),
)

SCENES: dict[str, SceneSpec] = {row[0]: SceneSpec(*row) for row in _TABLE}


def build(name: str) -> Mesh:
    """Vertices (V, 3) float64 and faces (F, 3) int32 of the scene called `name`.

    Raises
    ------
    ValueError
        If there is no scene of that name.
    """
    if name not in SCENES:
        raise ValueError(f"no scene is called {name!r}: choose one of {', '.join(SCENES)}")
    return SCENES[name].function()
