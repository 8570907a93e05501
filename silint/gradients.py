"""Exact derivatives of what the exact mode computes: by points, by normals, and by the mesh's vertices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs_gradient, arcs_sh_gradient
from silint.core.jit import KERNEL_LOCK
from silint.finder import Progress, VisibleFinder, add_counts, diagnose
from silint.scene import Scene
from silint.sh import MAX_DEGREE
from silint.validation import InputError, choice, finite_array, positive_int

__all__ = [
    "QUANTITIES",
    "Gradient",
    "Integrand",
    "differentiate",
    "file_vertices",
    "gradient",
    "integrand",
    "pull_back",
    "pullback",
]

FloatArray = npt.NDArray[np.float64]

QUANTITIES = ("ambient_occlusion", "bent_normals", "sh_transfer", "vector_irradiance")


class Gradient(NamedTuple):
    """A quantity at n points, and its derivatives by their positions and normals.

    Shapes are those of scalar quantities; those with C components have them last: (n, C), (n, 3, C).
    """

    value: FloatArray  # (n,)
    points: FloatArray  # (n, 3), per unit of length of the file
    normals: FloatArray  # (n, 3), of the normal as it was passed, which is normalised first


class Integrand(NamedTuple):
    """What is differentiated; see `integrand`."""

    quantity: str
    weighting: str
    max_degree: int

    @property
    def components(self) -> tuple[int, ...]:
        """Shape of a value: () or (C,)."""
        if self.quantity == "sh_transfer":
            return ((self.max_degree + 1) ** 2,)
        return () if self.quantity == "ambient_occlusion" else (3,)

    @property
    def closed_form(self) -> int | None:
        """The number that it has in `arcs_gradient`; None for SH, which `arcs_sh_gradient` does."""
        if self.quantity == "ambient_occlusion":
            return arcs_gradient.COSINE if self.weighting == "cosine" else arcs_gradient.UNIFORM
        return {"vector_irradiance": arcs_gradient.VECTOR, "bent_normals": arcs_gradient.BENT}.get(
            self.quantity
        )


def integrand(
    quantity: str = "ambient_occlusion", weighting: str = "cosine", max_degree: int = 4
) -> Integrand:
    """What to differentiate, checked.

    Parameters
    ----------
    quantity : {"ambient_occlusion", "bent_normals", "sh_transfer", "vector_irradiance"}
        As the integrator's methods of these names; the last is int V w dw over the hemisphere of n.
    weighting : {"cosine", "uniform"}
        Of ambient occlusion and SH transfer; the others have none.
    max_degree : int
        Of SH transfer, 0 to 16.

    Raises
    ------
    silint.InputError
        Anything else.
    """
    choice(quantity, "quantity", QUANTITIES)
    choice(weighting, "weighting", ("cosine", "uniform"))
    if weighting != "cosine" and quantity in ("bent_normals", "vector_irradiance"):
        raise InputError(f"weighting is {weighting!r}; {quantity} knows no weighting, leave it out")
    return Integrand(quantity, weighting, positive_int(max_degree, "max_degree", 0, MAX_DEGREE))


def differentiate(
    arcs: Arcs, scene: Scene, what: Integrand, lengths: FloatArray | None = None
) -> tuple[Gradient, int]:
    """Values and derivatives at the points of arcs.

    Parameters
    ----------
    arcs : Arcs
        Those of the scene.
    scene : Scene
    what : Integrand
    lengths : (n,) float64, optional
        Of the normals as they were passed, which the arcs hold normalised; by default 1.

    Returns
    -------
    gradient : Gradient
    singular : int
        Arcs whose edge passes through its point, where there is no derivative: they count as 0.

    Notes
    -----
    The normal is a free vector that is normalised, so the derivative is perpendicular to it. The tiny lift
    of a point off its surface counts as fixed.
    """
    vertices, factor = scene.topology.vertices, _per_unit(scene)
    number = what.closed_form
    if number is None:
        found = arcs_sh_gradient.gradient(arcs, vertices, what.max_degree, what.weighting, factor)
    else:
        found = arcs_gradient.gradient(arcs, vertices, number, factor)
    value, by_point, by_normal, singular = found
    if lengths is not None:
        by_normal /= lengths[:, None, None]
    if what.components == ():
        value, by_point, by_normal = value[:, 0], by_point[:, :, 0], by_normal[:, :, 0]
    return Gradient(value, by_point, by_normal), singular


def pull_back(arcs: Arcs, scene: Scene, what: Integrand, cotangents: FloatArray, out: FloatArray) -> int:
    """Add the derivative of sum(cotangents * values) by the scene's *welded* vertices to `out`.

    `file_vertices` hands it to the file's, after all groups of points.

    Parameters
    ----------
    arcs, scene, what
        As in `differentiate`.
    cotangents : (n, C) float64
    out : (welded vertices, 3) float64, out
        The same bits for any number of threads and any groups: arcs are summed one by one, in the order of
        the points.

    Returns
    -------
    singular : int
        See `differentiate`.
    """
    vertices, factor, number = scene.topology.vertices, _per_unit(scene), what.closed_form
    if number is None:
        return arcs_sh_gradient.pullback(
            arcs, vertices, what.max_degree, what.weighting, factor, cotangents, out
        )
    return arcs_gradient.pullback(arcs, vertices, number, factor, cotangents, out)


def file_vertices(gradient: FloatArray, scene: Scene) -> FloatArray:
    """A derivative by welded vertices as one by the file's vertices: (V, 3).

    The file's vertices at one position move a corner of the surface together or tear it open. Only the first
    has a derivative, g: each of k copies that faces use gets g / k. So whatever moves all copies alike (a
    transform, a parameter, a step of gradient descent) gets the true derivative from the sum over vertices,
    and copies with equal rows stay together. To take the step that a mesh without copies would take, multiply
    each row by its number of copies.

    Parameters
    ----------
    gradient : (welded vertices, 3) float64
    scene : Scene
    """
    used = np.zeros(scene.n_vertices, bool)
    used[scene.faces] = True
    vertex_map = scene.welding.vertex_map
    copies = np.bincount(vertex_map[used], minlength=len(gradient))
    out = np.zeros((scene.n_vertices, 3))
    out[used] = gradient[vertex_map[used]] / copies[vertex_map[used], None]
    return out


def gradient(
    finder: VisibleFinder,
    what: Integrand,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    progress: Progress | None = None,
) -> tuple[Gradient, dict[str, int]]:
    """Both phases: values and derivatives at points, and what was counted.

    Points whose arcs contradict each other (``uncertified_points``) get NaN throughout.
    """
    n_points, chunks = finder.shade_point_chunks(points, normals)
    shape = what.components
    value = np.empty((n_points, *shape))
    by_point, by_normal = np.empty((n_points, 3, *shape)), np.empty((n_points, 3, *shape))
    lengths, totals = _lengths(normals), _counts()
    for arcs, certain, rows in _groups(finder, n_points, chunks, totals, progress):
        with KERNEL_LOCK:
            found, singular = differentiate(arcs, finder.scene, what, lengths[rows])
        for array, part in zip((value, by_point, by_normal), found, strict=True):
            array[rows] = part
            array[rows[~certain]] = np.nan
        totals["singular_arcs"] += singular
    return Gradient(value, by_point, by_normal), totals


def pullback(
    finder: VisibleFinder,
    what: Integrand,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    cotangents: npt.ArrayLike,
    progress: Progress | None = None,
) -> tuple[FloatArray, dict[str, int]]:
    """Both phases: derivative of sum(cotangents * values) by the file's vertices (V, 3), and counts.

    Points whose arcs contradict each other (``uncertified_points``) are left out.

    Parameters
    ----------
    cotangents : array_like, shape (n,) or (n, C)
        Shaped as the values are.

    Raises
    ------
    silint.InputError
        Cotangents of another shape, or not finite.
    """
    n_points, chunks = finder.shade_point_chunks(points, normals)
    shape = (n_points, *what.components)
    weights = finite_array(cotangents, "cotangents", [shape], "the derivative of a loss by each value")
    weights = weights.reshape(n_points, -1)
    out, totals = np.zeros_like(finder.scene.topology.vertices), _counts()
    for arcs, certain, rows in _groups(finder, n_points, chunks, totals, progress):
        sound = arcs._replace(counts=np.where(certain, arcs.counts, 0))
        with KERNEL_LOCK:
            totals["singular_arcs"] += pull_back(sound, finder.scene, what, weights[rows], out)
    return file_vertices(out, finder.scene), totals


def _groups(
    finder: VisibleFinder,
    n_points: int,
    chunks: Iterator[tuple[slice, FloatArray, FloatArray]],
    totals: dict[str, int],
    progress: Progress | None,
) -> Iterator[tuple[Arcs, npt.NDArray[np.bool_], npt.NDArray[np.int64]]]:
    """Arcs of groups of points, whether they are certain, and the points' rows; counts go to `totals`."""
    for chunk, p, n in chunks:
        first = chunk.start

        def report(done: int, _: int, first: int = first) -> None:
            if progress is not None:
                progress(first + done, n_points)

        for arcs, certain, counts, group in finder.arcs(p, n, report):
            add_counts(totals, counts)
            yield arcs, certain, group + first


def _counts() -> dict[str, int]:
    return {**diagnose(None, 0, 0, 0), "singular_arcs": 0}


def _lengths(vectors: npt.ArrayLike) -> FloatArray:
    """Lengths of rows that have been checked, of any magnitude."""
    rows = np.asarray(vectors, np.float64)
    largest = np.abs(rows).max(axis=1)
    lengths: FloatArray = largest * np.linalg.norm(rows / largest[:, None], axis=1)
    return lengths


def _per_unit(scene: Scene) -> float:
    """Scaled units in one of the file's."""
    return float(np.ldexp(1.0, -scene.welding.exponent))
