"""City: blocks of box buildings between streets, standing on one slab.

Provenance: written for silint; the usual abstraction of urban sky view studies. No data file. Faces coincide
on purpose: floors lie on the slab, neighbours share party walls, upper tiers stand on lower roofs, and
heights are whole storeys, so that many roofs are coplanar.
"""

from __future__ import annotations

import numpy as np

from scenes.mesh import Mesh, boxes, concatenate

LOT, STREET, STOREY = 16.0, 14.0, 3.5  # metres


def city(blocks: int = 12, lots: int = 3, seed: int = 0) -> Mesh:
    """``blocks x blocks`` blocks of ``lots x lots`` buildings of one to three tiers each; closed boxes, z up.

    One lot in eight stays empty. The slab's top is z = 0. The number of boxes follows from `seed`.
    """
    rng = np.random.default_rng(seed)
    k = np.arange(blocks * lots)
    west = LOT * k + STREET * (k // lots)
    x, y = (a.ravel() for a in np.meshgrid(west, west, indexing="ij"))
    built = rng.random(x.size) >= 0.125
    tiers = 1 + (rng.random(x.size) < 0.35).astype(int) + (rng.random(x.size) < 0.15)
    centre = west[-1] * 0.5
    # Towers gather in the middle of the town.
    nearness = np.exp(-((x - centre) ** 2 + (y - centre) ** 2) / (0.3 * west[-1]) ** 2)

    parts = []
    base = np.zeros(x.size)
    for tier in range(3):
        inset = 2.5 * tier
        height = STOREY * np.floor(2.0 + 5.0 * rng.random(x.size) + 14.0 * nearness * rng.random(x.size))
        keep = built & (tiers > tier)
        lower = np.stack([x + inset, y + inset, base], axis=1)
        upper = np.stack([x + LOT - inset, y + LOT - inset, base + height], axis=1)
        parts.append(boxes(lower[keep], upper[keep]))
        base = base + height
    far = west[-1] + LOT + STREET
    ground = boxes((-STREET, -STREET, -2.0), (far, far, 0.0))
    return concatenate([*parts, ground])
