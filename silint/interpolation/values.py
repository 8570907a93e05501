"""Values at all points from those at some."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core import scattered
from silint.interpolation.refinement import Progress, Query, Refinement
from silint.interpolation.surfaces import distinct_points, in_order, smooth_surfaces
from silint.validation import InputError, normals_array, points_array, positive_number, row_numbers

__all__ = ["Interpolated", "interpolate"]

FloatArray = npt.NDArray[np.float64]


class Interpolated(NamedTuple):
    """Values at all points, and what they rest on."""

    value: FloatArray
    """(n,) or (n, C), as the query's."""
    computed: npt.NDArray[np.bool_]
    """(n,) whose values are the query's own, bit by bit."""
    held_back_error: float
    """The largest difference, in any component, between a held-back point's value and its prediction from
    the anchors that all other predictions use; 0 where nothing was predicted."""
    diagnostics: dict[str, int]
    """``points``; ``distinct``, without those that repeat place and normal; ``computed`` of these;
    ``held_back`` of the computed; ``rounds``, 0 where predicting would not have paid."""


def interpolate(
    query: Query,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    tolerance: float,
    *,
    faces: npt.ArrayLike | None = None,
    surfaces: npt.ArrayLike | None = None,
    bounds: tuple[float, float] | None = None,
    progress: Progress | None = None,
    cost: Callable[[], float] | None = None,
) -> Interpolated:
    """Values of a query at points of a surface, most of them predicted from some that are computed.

    Parameters
    ----------
    query : callable
        From points and unit normals, (m, 3) each, to values (m,) or (m, C): any of an integrator's. It is
        called a few dozen times, and must give a point the same value whatever the others are.
    points, normals : array_like, shape (n, 3)
        Dense ones: vertices, texels.
    tolerance : float
        How far off held-back points may be, in the component that is the worst. Others may be further off
        where values jump between two of them.
    faces : array_like of int, shape (F, 3), optional
        Rows of points: triangles that join them to surfaces. See `smooth_surfaces`.
    surfaces : array_like of int, shape (n,), optional
        In place of faces: a number for each point, from 0. Points with different ones do not help each other.
    bounds : (float, float), optional
        Between which all values are; predictions beyond are moved there.
    progress : callable, optional
        Called with the numbers of points settled and in all.
    cost : callable, optional
        Seconds of one thread that a point of the query takes, about; asked for when some have been computed.
        Where predicting would cost more than it spares, all points are computed then. It must depend on
        nothing but the points, for values to do so. By default as few points are computed as will do.

    Returns
    -------
    Interpolated

    Raises
    ------
    silint.InputError
        Wrong shapes, NaN, a tolerance that is not above 0, in one line.
    """
    p, _ = points_array(points)
    n = normals_array(normals, len(p))
    limit = positive_number(tolerance, "tolerance")
    if faces is not None and surfaces is not None:
        raise InputError("faces and surfaces given; pass faces, or a surface's number for each point")
    label = np.zeros(len(p), np.int64)
    if faces is not None:
        label = smooth_surfaces(p, n, faces)
    elif surfaces is not None:
        label = row_numbers(surfaces, "surfaces", len(p), 2**31 - 1).astype(np.int64)
    distinct, of_point = distinct_points(p, n, label)

    def report(done: int, n: int) -> None:
        if progress is not None:
            progress(done * len(p) // n, len(p))

    work = Refinement(query, p[distinct], n[distinct], in_order(label[distinct]), limit, bounds, report, cost)
    work.run()
    counts = {
        "points": len(p),
        "distinct": len(distinct),
        "computed": int(np.count_nonzero(work.state)),
        "held_back": int(np.count_nonzero(work.state == scattered.CHECK)),
        "rounds": work.rounds,
    }
    value = work.value[of_point].reshape(len(p), *work.shape)
    return Interpolated(value, (work.state != scattered.UNKNOWN)[of_point], work.held_back_error, counts)
