"""What phase one of the exact mode hands to phase two: the boundary of what each point sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Arcs(NamedTuple):
    """Great-circle arcs that bound the visible part of the hemisphere over each shade point.

    Every arc is shorter than pi and runs a -> b with the visible side on its left, seen from outside the
    sphere: N is parallel to a x b. Stretches of the horizon have N = n and are at most pi/2 long. A point's
    arcs come in any order; together they are the whole boundary, of any number of pieces with holes.
    """

    points: np.ndarray  # (n, 3) float64, lifted, in scaled units
    normals: np.ndarray  # (n, 3) float64, unit
    counts: np.ndarray  # (n,) int64: arcs of each point
    starts: np.ndarray  # (n,) int64: first row of each point's arcs
    directions: np.ndarray  # (m, 9) float64: unit start a, unit end b, unit inner normal N of the arc's plane
    edges: np.ndarray  # (m, 2) int32: vertices of the edge, from a's side to b's; -1, -1 for the horizon
