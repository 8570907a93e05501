"""Chain-link fence: zig-zag wires that hook into their neighbours, on posts, above a ground slab.

Provenance: written for silint after the real thing (A. and C. Barnard, Norwich, about 1844): flattened
helices of one hand, turned into one another. No data file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scenes.mesh import Mesh, boxes, concatenate, moved, revolve, tubes

PITCH = 0.06  # mesh width; all lengths in metres
WIRE = 0.003  # radius
SIDES = 5
BOTTOM = 0.04  # the wires' lower ends above the ground


def fence(wires: int = 40, bends: int = 24, fences: int = 1, spacing: float = 0.5) -> Mesh:
    """`fences` parallel fences in planes of constant y, `spacing` apart; closed tubes.

    ``fences * (wires * (10 * (3 * bends - 1) + 6) + 116) + 12`` triangles: wires of `bends` hooks, two posts,
    a rail.
    """
    width, height = PITCH * wires, BOTTOM + 0.5 * PITCH * (bends + 1)
    fabric = tubes(_wire_paths(wires, bends), WIRE, SIDES, reference=(0.0, 1.0, 0.0))

    post = revolve([(0.0, height + 0.06), (0.025, height + 0.04), (0.025, 0.0), (0.0, 0.0)], 12)
    left, right, top = -PITCH, width + PITCH, height + 0.02
    rail = tubes([[(left, 0.0, top), (right, 0.0, top)]], 0.012, 6, reference=(0.0, 1.0, 0.0))
    one = concatenate([fabric, moved(post, (left, 0.0, 0.0)), moved(post, (right, 0.0, 0.0)), rail])

    depth = spacing * (fences - 1)
    ground = boxes((-1.0, -1.5, -0.1), (width + 1.0, depth + 1.5, 0.0))
    return concatenate([moved(one, (0.0, spacing * k, 0.0)) for k in range(fences)] + [ground])


def _wire_paths(wires: int, bends: int) -> NDArray[np.float64]:
    """Polylines (wires, 3 * bends, 3): in front on the way to the right, behind on the way to the left.

    Neighbours run opposite ways and bend at the same heights. Being of one hand, the two wires of a hook are
    on opposite sides (y) below it, pass each other by `overlap`, and come out exchanged: linked, without
    touching.
    """
    overlap, depth = 2.0 * WIRE, 2.5 * WIRE
    k, j, s = np.meshgrid(np.arange(wires), np.arange(bends), (-1.0, 0.0, 1.0), indexing="ij")
    right = np.where((k + j) % 2 == 0, 1.0, -1.0)  # which way this bend points
    x = PITCH * (k + 0.5) + right * (0.5 * PITCH + overlap * np.where(s == 0, 1.0, -0.5))
    y = -right * s * depth
    z = BOTTOM + 0.5 * PITCH * (j + 1) + s * 2.5 * WIRE
    return np.stack([x, y, z], axis=-1).reshape(wires, 3 * bends, 3)
