"""The integrator: hierarchies built once, integrals over what any number of points can see."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.core.contour import CONTOURS, CROSSINGS, EDGES, N_TALLY, NODES, SNAPPED
from silint.core.edge_hierarchy import EdgeHierarchy, build_edge_hierarchies
from silint.core.face_hierarchy import build_face_hierarchy
from silint.core.integrands import fractions
from silint.core.lift import lift_points
from silint.core.sweep import BLOCK
from silint.core.visible import Trees, VisibleIntervals, cover_visible, find_visible
from silint.plan import Part, Plan
from silint.scene import Scene, as_scene
from silint.validation import InputError, choice, normals_array, points_array, positive_int, unit_vector
from silint.visibility import WEIGHTINGS, FloatArray, Result, Visibility

METHODS = ("auto", "octahedral")
MAX_ISOLINES = 4096
Progress = Callable[[int, int], None]

# Shade points are lifted along their normals by the first distance, and off the faces that touch them and
# hold their normal by the second; a face touches within the third (core.lift). In units of the scene, for
# points that are exact in float64 and for coordinates that came as float32. Far above the rounding of the
# mesh, so that an edge below a lifted point keeps its direction to 1e-5; far below any feature of a mesh.
LIFT = (2.0**-36, 2.0**-44, 2.0**-48)
LIFT_FLOAT32 = (2.0**-18, 2.0**-21, 2.0**-23)

# A call into the kernels is kept near this time, so that Ctrl-C and progress bars stay responsive.
_CHUNK_SECONDS = 0.2
_CHUNK_BYTES = 1 << 28

# Numba's simplest threading layer may not be entered twice at a time.
_KERNEL_LOCK = threading.Lock()


class SilhouetteIntegrator:
    """Integrals over what points can see of a scene, from the silhouettes seen by them [NBMJ14].

    Built once for a scene; every query is a function of its arguments alone, and one integrator may serve
    many threads. A point's value does not depend on the other points, their order, or the number of threads.

    Parameters
    ----------
    scene : Scene, path, or trimesh object

    Notes
    -----
    All queries take `points` and `normals` of shape (n, 3). Normals need not be of unit length. Points may
    lie anywhere: in space, on faces, edges or vertices of the mesh (they then see what lies in front of
    them, along their normal), inside solids (they see nothing).

    With ``full_output=True`` a query returns a `Result`, whose diagnostics count, over all points:

    points, isolines
        The size of the request.
    buried
        Points that see nothing at all.
    fallback_isolines
        Isolines whose depth counts contradicted each other and that were computed again by covering.
    snapped_sides
        Sides of contour edges' faces that rounding could not tell and a rule decided.
    edges_tested, nodes_visited, contour_edges, crossings
        Work done by the search and the sweep.
    """

    def __init__(self, scene: Any) -> None:
        self.scene: Scene = as_scene(scene)
        topology = self.scene.topology
        contour, boundary, self._flat_edges = build_edge_hierarchies(topology)
        self._trees = Trees(contour, boundary, build_face_hierarchy(topology))
        self._geometry = topology

    # ------------------------------------------------------------------ queries

    def ambient_occlusion(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int = 64,
        weighting: str = "cosine",
        method: str = "auto",
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """Open fraction of the hemisphere over each point: 1 is open, 0 is closed.

        Parameters
        ----------
        points, normals : array_like, shape (n, 3)
        isolines : int
            Lines on the octahedral map, 1 to 4096; two are used for 1. The error falls about as
            isolines ** -1.5.
        weighting : {"cosine", "uniform"}
            (1/pi) int V max(n.w, 0) dw, or (1/2pi) int V dw over the hemisphere of n.
        method : {"auto", "octahedral"}
        full_output : bool
            Return a `Result` instead of the values.
        progress : callable, optional
            Called with the numbers of points done and in all.

        Returns
        -------
        (n,) float64, or Result

        Raises
        ------
        silint.InputError
            Wrong shapes, NaN, zero normals or unknown options, in one line.
        """
        choice(weighting, "weighting", WEIGHTINGS)

        def integrand(v: Visibility) -> tuple[FloatArray, FloatArray]:
            return fractions.hemisphere_fraction(v.normals, (v.offsets, v.intervals), v.isolines, weighting)

        return self._integrate(integrand, (), points, normals, isolines, method, full_output, progress)

    def sky_view_factor(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 0.0, 1.0),
        isolines: int = 64,
        method: str = "auto",
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) [up.w > 0] dw: the share of a uniform sky's light that arrives.

        1 for an open horizontal surface, 1/2 for an open vertical wall.

        Parameters
        ----------
        up : array_like, shape (3,)
            Where the sky is.

        Returns
        -------
        (n,) float64, or Result
        """
        axis = unit_vector(up, "up")

        def integrand(v: Visibility) -> tuple[FloatArray, FloatArray]:
            return fractions.sky_view_factor(v.normals, (v.offsets, v.intervals), v.isolines, axis)

        return self._integrate(integrand, (), points, normals, isolines, method, full_output, progress)

    def bent_normals(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int = 64,
        method: str = "auto",
        full_output: bool = False,
        progress: Progress | None = None,
    ) -> Any:
        """(1/pi) int V max(n.w, 0) w dw: where the open part of the sky lies, and how much there is.

        Under an open sky it is 2/3 n; zero where nothing is visible.

        Returns
        -------
        (n, 3) float64, or Result
        """

        def integrand(v: Visibility) -> tuple[FloatArray, FloatArray]:
            return fractions.bent_normal(v.normals, (v.offsets, v.intervals), v.isolines)

        return self._integrate(integrand, (3,), points, normals, isolines, method, full_output, progress)

    def visibility(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int = 64,
        method: str = "octahedral",
        progress: Progress | None = None,
    ) -> Visibility:
        """The visible intervals themselves, to be integrated as often as wanted.

        Returns
        -------
        Visibility
            About 100 bytes an isoline and point.
        """
        choice(method, "method", METHODS)
        lines = _at_least_two(isolines)
        p, n = self._shade_points(points, normals)
        totals = _diagnose(None, 0, 0, lines)
        lengths, intervals = [np.zeros(1, np.int64)], [np.zeros((0, 2))]
        for visible, _ in self._chunks(p, n, lines, progress):
            lengths.append(np.diff(visible.offsets))
            intervals.append(visible.intervals)
            _add(totals, visible.diagnostics)
        offsets = np.cumsum(np.concatenate(lengths))
        return Visibility(n, lines, offsets, np.concatenate(intervals), diagnostics=totals)

    # ------------------------------------------------------------------ what is built, and why

    @property
    def plan(self) -> Plan:
        """What the scene needs, whatever will be asked of it."""
        contour, boundary, _ = self._trees
        defects = self.scene.defects
        others = defects["boundary_edges"] + defects["non_manifold_edges"]
        return Plan(
            f"scene: {self.scene.n_faces:,} triangles",
            (
                Part(
                    "topology",
                    True,
                    "edges with all their faces, one plane a flat region",
                    self.memory["topology"],
                ),
                Part(
                    "contour hierarchy",
                    len(contour.ends) > 0,
                    f"{len(contour.ends):,} edges with two faces"
                    if len(contour.ends)
                    else "no edge has two faces",
                    self.memory["contour hierarchy"],
                ),
                Part(
                    "boundary hierarchy",
                    len(boundary.ends) > 0,
                    f"{len(boundary.ends):,} edges with one face, or more than two"
                    if others
                    else "closed mesh: every edge has two faces",
                    self.memory["boundary hierarchy"],
                ),
                Part(
                    "flat edges",
                    False,
                    f"{self._flat_edges:,} edges inside flat regions are contours from nowhere",
                ),
                Part(
                    "face hierarchy",
                    True,
                    "start counts, and covering where counts fail",
                    self.memory["face hierarchy"],
                ),
            ),
        )

    def explain(self, request: str, isolines: int = 64, weighting: str = "cosine") -> Plan:
        """What a request builds and runs beyond the scene's plan, and what it leaves out.

        Parameters
        ----------
        request : {"ambient_occlusion", "sky_view_factor", "bent_normals", "visibility"}
        isolines, weighting
            As in the request.
        """
        names = ("ambient_occlusion", "sky_view_factor", "bent_normals", "visibility")
        choice(request, "request", names)
        choice(weighting, "weighting", WEIGHTINGS)
        k = positive_int(isolines, "isolines", 1, MAX_ISOLINES)
        orders = {"ambient_occlusion": {1 if weighting == "cosine" else 0}, "sky_view_factor": {1}}
        used = orders.get(request, {1, 2} if request == "bent_normals" else set())
        has_boundary = len(self._trees.boundary.ends) > 0
        tables = tuple(
            Part(
                name,
                order in used,
                why if order in used else f"{request} does not need it",
                k * 1025 * 2 * channels * 8 if order in used else 0,
            )
            for order, name, channels, why in (
                (0, "solid angle table", 1, "uniform weighting; one table serves all normals"),
                (1, "first moment table", 3, "n.w is linear in w; one table serves all normals"),
                (2, "second moment table", 6, "(n.w) w is quadratic in w; one table serves all normals"),
            )
        )
        return Plan(
            f"{request}, {k} octahedral isolines",
            (
                Part("contour search", True, "dual-space and horizon tests over the contour hierarchy"),
                Part(
                    "boundary search",
                    has_boundary,
                    "open or non-manifold edges" if has_boundary else "closed mesh: no boundary edges",
                ),
                Part("sweep", True, f"depth counts on {k} isolines, start count at the pole, horizon check"),
                Part("cover", False, "only for isolines whose counts contradict each other"),
                *tables,
                Part(
                    "second horizon",
                    request == "sky_view_factor",
                    "clip by the plane of the sky"
                    if request == "sky_view_factor"
                    else "no sky plane asked for",
                ),
            ),
        )

    @property
    def memory(self) -> dict[str, int]:
        """Bytes of topology and hierarchies, by part."""
        contour, boundary, face_tree = self._trees
        return {
            "topology": _n_bytes(self._geometry),
            "contour hierarchy": _n_bytes(contour),
            "boundary hierarchy": _n_bytes(boundary) if len(boundary.ends) else 0,
            "face hierarchy": _n_bytes(face_tree),
        }

    def __repr__(self) -> str:
        return f"<silint.SilhouetteIntegrator of {self.scene!r}>"

    # ------------------------------------------------------------------ how

    def _integrate(
        self,
        integrand: Callable[[Visibility], tuple[FloatArray, FloatArray]],
        shape: tuple[int, ...],
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        isolines: int,
        method: str,
        full_output: bool,
        progress: Progress | None,
    ) -> Any:
        """Run phase one and one integrand chunk by chunk, so that memory does not grow with the points."""
        choice(method, "method", METHODS)
        lines = _at_least_two(isolines)
        p, n = self._shade_points(points, normals)
        value = np.empty((len(p), *shape))
        estimate = np.empty(len(p))
        totals = _diagnose(None, 0, 0, lines)
        for visible, rows in self._chunks(p, n, lines, progress):
            with _KERNEL_LOCK:
                value[rows], estimate[rows] = integrand(visible)
            _add(totals, visible.diagnostics)
        return Result(value, estimate, totals) if full_output else value

    def _shade_points(self, points: npt.ArrayLike, normals: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Points in scaled units, lifted along their unit normals."""
        p, float32_points = points_array(points)
        n = normals_array(normals, len(p))
        with np.errstate(over="ignore"):
            p = np.ldexp(p, -self.scene.welding.exponent)
        far = np.flatnonzero(~(np.abs(p) < 1e100).all(axis=1))
        if len(far):
            raise InputError(f"points row {far[0]} lies more than 1e100 scene extents away")
        lift = LIFT_FLOAT32 if float32_points or self.scene.float32_source else LIFT
        lifted = np.empty_like(p)
        with _KERNEL_LOCK:
            lift_points(self._geometry, self._trees.face, p, n, *lift, lifted)
        return lifted, n

    def _chunks(
        self, p: FloatArray, n: FloatArray, isolines: int, progress: Progress | None, cover_all: bool = False
    ) -> Iterator[tuple[Visibility, slice]]:
        """Visible intervals of consecutive runs of points, each found in about _CHUNK_SECONDS."""
        size, capacity, done = 2 * BLOCK, 4 * BLOCK * isolines, 0
        while done < len(p):
            rows = slice(done, min(done + size, len(p)))
            began = time.perf_counter()
            with _KERNEL_LOCK:
                found: VisibleIntervals | int
                if cover_all:
                    found = cover_visible(self._geometry, self._trees, p[rows], n[rows], isolines)
                else:
                    found = find_visible(self._geometry, self._trees, p[rows], n[rows], isolines, capacity)
            most_blocks = max(_CHUNK_BYTES // (16 * capacity), 1)
            if isinstance(found, int):
                # Grow the buffers, in fewer points at a time if they would become large.
                capacity = found + found // 4
                size = min(size, BLOCK * max(_CHUNK_BYTES // (16 * capacity), 1))
                continue
            seen = np.diff(found.offsets[::isolines])
            diagnostics = _diagnose(found, len(seen), int((seen == 0).sum()), isolines)
            yield (
                Visibility(n[rows], isolines, found.offsets, found.intervals, "octahedral", diagnostics),
                rows,
            )
            done = rows.stop
            if progress is not None:
                progress(done, len(p))
            factor = _CHUNK_SECONDS / max(time.perf_counter() - began, 1e-9)
            size = BLOCK * min(max(int(size * min(max(factor, 0.25), 4.0)) // BLOCK, 1), most_blocks)


def ambient_occlusion(
    source: Any,
    points: npt.ArrayLike | None = None,
    normals: npt.ArrayLike | None = None,
    **options: Any,
) -> Any:
    """Ambient occlusion in one call.

    Parameters
    ----------
    source : Scene, path, or trimesh object
    points, normals : array_like, shape (n, 3), optional
        By default every vertex of the file in order, with the file's normals or else angle-weighted ones;
        vertices without a normal (no face uses them) get 1 and are counted as ``without_normal``.
    **options
        Of `SilhouetteIntegrator.ambient_occlusion`.

    Returns
    -------
    (n,) float64, or Result

    Notes
    -----
    For more than one call on a scene, keep a `SilhouetteIntegrator`.
    """
    scene = as_scene(source)
    integrator = SilhouetteIntegrator(scene)
    if points is not None:
        if normals is None:
            raise InputError("normals is None; pass one normal for each of your points")
        return integrator.ambient_occlusion(points, normals, **options)
    if normals is not None:
        raise InputError("normals given without points; pass both, or neither for every vertex")
    vertex_normals, valid = scene.vertex_normals()
    return at_valid_points(
        integrator.ambient_occlusion, scene.vertices, vertex_normals, valid, 1.0, **options
    )


def at_valid_points(
    query: Callable[..., Any],
    points: FloatArray,
    normals: FloatArray,
    valid: Any,
    default: Any,
    **options: Any,
) -> Any:
    """Run a query where there is a normal; elsewhere, counted as ``without_normal``, it is `default`."""
    full_output = options.pop("full_output", False)
    result = query(points[valid], normals[valid], full_output=True, **options)
    value = np.empty((len(points), *result.value.shape[1:]))
    value[:] = default
    value[valid] = result.value
    estimate = np.zeros(len(points))
    estimate[valid] = result.error_estimate
    diagnostics = {**result.diagnostics, "without_normal": int((~np.asarray(valid)).sum())}
    return Result(value, estimate, diagnostics) if full_output else value


def _diagnose(found: VisibleIntervals | None, points: int, buried: int, isolines: int) -> dict[str, int]:
    tally = np.zeros(N_TALLY, np.int64) if found is None else found.tally
    return {
        "points": points,
        "isolines": isolines,
        "buried": buried,
        "fallback_isolines": 0 if found is None else found.covered,
        "snapped_sides": int(tally[SNAPPED]),
        "nodes_visited": int(tally[NODES]),
        "edges_tested": int(tally[EDGES]),
        "contour_edges": int(tally[CONTOURS]),
        "crossings": int(tally[CROSSINGS]),
    }


def _add(totals: dict[str, int], more: Mapping[str, int]) -> None:
    for key in totals:
        if key != "isolines":
            totals[key] += more[key]


def _at_least_two(isolines: int) -> int:
    """A single isoline, at u = 0, meets no hemisphere of a normal along x."""
    return max(positive_int(isolines, "isolines", 1, MAX_ISOLINES), 2)


def _n_bytes(arrays: EdgeHierarchy | Any) -> int:
    return sum(a.nbytes for a in arrays if isinstance(a, np.ndarray))
