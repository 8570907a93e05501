"""Boundary arcs: what exact phase one knows of the visible region, and exact phase two reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Arcs(NamedTuple):
    """The boundaries of the regions that n shade points see, as great circle arcs in no particular order.

    An arc is shorter than pi and has the visible side on its left, seen from outside the sphere. Stretches of
    the horizon run counter-clockwise about the normal.
    """

    points: np.ndarray  # (n, 3) float64, scaled units, lifted
    normals: np.ndarray  # (n, 3) float64, unit
    counts: np.ndarray  # (n,) int64: arcs of each point
    starts: np.ndarray  # (n,) int64: first row of each point's arcs
    directions: np.ndarray  # (m, 9) float64: unit start and end, unit normal of the plane (to the left)
    edges: np.ndarray  # (m, 2) int32: mesh vertices from start to end; -1, -1 on the horizon
