"""The values of a bake, past whatever blocks each of its points."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from silint.bake.options import BakeOptions, Progress
from silint.bake.targets import Sites
from silint.finder import add_counts
from silint.integrator import SilhouetteIntegrator
from silint.interpolation import Interpolated, interpolate
from silint.scene import Scene

__all__ = ["Integrals", "blocking_scene", "integrate"]

FloatArray = npt.NDArray[np.float64]

# What it costs a thread to find what a point sees, in seconds for each of what is counted, by way. All of a
# point takes two to four times that, by measurements on seven scenes of 6k to 871k triangles.
_SWEPT = {"edges_tested": 6e-9, "contour_edges": 40e-9, "crossings": 52e-9}
_COVERED = {"nodes_visited": 59e-9, "edges_tested": 27e-9, "crossings": 30e-9}
_EXACT = 4.0  # times a sweep's

_BOUNDS = {"ao": (0.0, 1.0), "sky": (0.0, 1.0), "irradiance": (0.0, np.inf)}


class Integrals(NamedTuple):
    """What was integrated, and what was counted meanwhile."""

    value: FloatArray
    """(n,) or (n, 3), a row for each of the sites; those without a normal see everything (ambient
    occlusion, sky) or nothing."""
    diagnostics: dict[str, int]
    """The sum of all integrators' counts; two-sided points count twice."""
    build_seconds: float
    """Of the time, what went into hierarchies."""
    interpolation: dict[str, Any] | None
    """Where points were interpolated: how many were computed, how many of these held back, and the largest
    error of those."""


def integrate(
    source: SilhouetteIntegrator | Scene,
    occluders: Sequence[Scene],
    sites: Sites,
    asked: BakeOptions,
    limits: dict[str, Any],
    progress: Progress | None,
) -> Integrals:
    """Integrate at all points that have a normal.

    Parameters
    ----------
    source : SilhouetteIntegrator or Scene
        What the sites are on.
    occluders : sequence of Scene
        What blocks besides.
    sites : Sites
    asked : BakeOptions
    limits : dict
        As queries take them.
    progress : callable, optional

    Returns
    -------
    Integrals
    """
    queries: dict[str, tuple[str, dict[str, Any], tuple[int, ...], float]] = {
        "ao": ("ambient_occlusion", {"weighting": asked.weighting}, (), 1.0),
        "sky": ("sky_view_factor", {"up": asked.up}, (), 1.0),
        "bent": ("bent_normals", {}, (3,), 0.0),
        "irradiance": ("irradiance", {"environment": asked.environment}, (3,), 0.0),
    }
    name, options, shape, without_normal = queries[asked.quantity]
    options |= {"isolines": asked.isolines, "method": asked.method, "tolerance": asked.tolerance}
    options |= limits

    value = np.full((len(sites.points), *shape), without_normal)
    total, done, build_seconds = int(np.count_nonzero(sites.valid)), 0, 0.0
    counts: dict[str, int] = {}
    told: list[Interpolated] = []
    for part, rows in _parts(source, occluders, sites):
        began = time.perf_counter()
        integrator = part if isinstance(part, SilhouetteIntegrator) else SilhouetteIntegrator(part)
        build_seconds += time.perf_counter() - began
        query = partial(getattr(integrator, name), full_output=True, **options)
        shared = _share(progress, done, total)
        if asked.interpolate is None or not len(rows):
            value[rows] = _of_sides(
                query, asked.two_sided, sites.points[rows], sites.normals[rows], counts, shared
            )
        else:
            assert sites.surfaces is not None
            own: dict[str, int] = {}
            found = interpolate(
                partial(_of_sides, query, asked.two_sided, counts=own),
                sites.points[rows],
                sites.normals[rows],
                asked.interpolate,
                surfaces=sites.surfaces[rows],
                bounds=_BOUNDS.get(asked.quantity),
                progress=shared,
                cost=partial(_seconds_a_site, own, 2 if asked.two_sided else 1),
            )
            value[rows] = found.value
            _count(counts, own)
            told.append(found)
        done += len(rows)
    return Integrals(value, counts, build_seconds, _summary(told) if asked.interpolate is not None else None)


def _of_sides(
    query: Any,
    two_sided: bool,
    points: FloatArray,
    normals: FloatArray,
    counts: dict[str, int],
    progress: Progress | None = None,
) -> FloatArray:
    """Values for n, or their mean with those for -n; what is counted goes to `counts`."""
    found: list[FloatArray] = []
    sides = (1.0, -1.0) if two_sided else (1.0,)
    for side in sides:
        result = query(points, side * normals, progress=_side(progress, len(found), len(sides)))
        found.append(result.value)
        _count(counts, result.diagnostics)
    mean: FloatArray = found[0] if len(found) == 1 else 0.5 * (found[0] + found[1])
    return mean


def _count(counts: dict[str, int], more: Mapping[str, int]) -> None:
    if counts:
        add_counts(counts, more)
    else:
        counts.update(more)


def _seconds_a_site(counts: Mapping[str, int], sides: int) -> float:
    """What a site costs a thread, about, from what was counted for some: the same on any machine."""
    points = max(counts["points"], 1)
    covered, exact = counts["covered_points"] / points, counts["exact_points"] / points

    def seconds(costs: Mapping[str, float]) -> float:
        return sum(cost * counts[name] for name, cost in costs.items()) / points

    swept = seconds(_SWEPT) * (1.0 + (_EXACT - 1.0) * exact)
    return sides * (covered * seconds(_COVERED) + (1.0 - covered) * swept)


def _summary(found: Sequence[Interpolated]) -> dict[str, Any]:
    """What interpolations tell, of all parts."""
    names = ("points", "distinct", "computed", "held_back")
    counts: dict[str, Any] = {name: sum(part.diagnostics[name] for part in found) for name in names}
    return {**counts, "held_back_error": max((part.held_back_error for part in found), default=0.0)}


def blocking_scene(parts: Sequence[Scene], rows: npt.NDArray[np.int64] | None = None) -> Scene:
    """One scene of several; of the first some faces only, if `rows` says which.

    It holds nothing but positions and faces: points and normals come from elsewhere. If one of the parts has
    float32 positions, contact with it is only as good as these.
    """
    vertices, faces, offset = [], [], 0
    for i, part in enumerate(parts):
        own = part.faces if i or rows is None else part.faces[rows]
        used, renumbered = np.unique(own, return_inverse=True)
        vertices.append(part.vertices[used])
        faces.append(renumbered.reshape(-1, 3) + offset)
        offset += len(used)
    scene = Scene(np.concatenate(vertices), np.concatenate(faces), name=parts[0].name)
    scene.float32_source = any(part.float32_source for part in parts)
    return scene


def _parts(
    source: SilhouetteIntegrator | Scene, occluders: Sequence[Scene], sites: Sites
) -> Iterator[tuple[SilhouetteIntegrator | Scene, npt.NDArray[np.int64]]]:
    """What blocks some of the points, and which; every point once."""
    scene = source if isinstance(source, Scene) else source.scene
    valid = np.flatnonzero(sites.valid)
    if sites.groups is None or scene.face_groups is None:
        yield blocking_scene([scene, *occluders]) if occluders else source, valid
        return
    n_groups = len(scene.groups)
    faces = _by_group(scene.face_groups, np.arange(scene.n_faces), n_groups)
    points = _by_group(sites.groups[valid], valid, n_groups)
    # A mesh of needles has no point at all; one query has to be made all the same, for its counts.
    for group in [i for i in range(n_groups) if len(points[i])] or [0]:
        yield blocking_scene([scene, *occluders], faces[group]), points[group]


def _by_group(
    of_row: npt.NDArray[np.int32], rows: npt.NDArray[np.int64], n_groups: int
) -> list[npt.NDArray[np.int64]]:
    """The rows of each group, in their order."""
    order = np.argsort(of_row, kind="stable")
    ends = np.cumsum(np.bincount(of_row, minlength=n_groups))
    return np.split(rows[order], ends[:-1])


def _share(progress: Progress | None, before: int, total: int) -> Progress | None:
    """Progress of one query as that of all."""
    if progress is None:
        return None
    return lambda done, _: progress(before + done, total)


def _side(progress: Progress | None, side: int, sides: int) -> Progress | None:
    """Progress of one side of points as that of all of them."""
    if progress is None:
        return None
    return lambda done, n: progress((side * n + done) // sides, n)
