"""What a scene and a request need, in words and bytes: the integrator's plans."""

from __future__ import annotations

from typing import Any

import numpy as np

from silint.basis import Basis
from silint.core.caps import LINES_OF_FALLOFF, UNLIMITED, LineLimits
from silint.core.integrands.octahedral_sh import table_bytes
from silint.core.integrands.radial_light import cells_a_line
from silint.core.integrands.radial_sh import enough_lines
from silint.core.sh import moment_degree
from silint.environment import Environment
from silint.finder import VisibleFinder
from silint.lighting import table_bytes as harmonic_table_bytes
from silint.limits import EXACT_LIMITS, NO_LIMITS, Limits
from silint.plan import Part, Plan
from silint.scene import Scene
from silint.sh import MAX_DEGREE
from silint.validation import InputError, choice, positive_int
from silint.visibility import WEIGHTINGS

REQUESTS = (
    "ambient_occlusion",
    "sky_view_factor",
    "bent_normals",
    "sh_transfer",
    "irradiance",
    "visibility",
    "sh_lighting",
    "integrate",
)

# Those that have no closed form along radial isolines, which alone know limits.
_OCTAHEDRAL = ("visibility", "sh_lighting", "integrate")
# Fractions of a hemisphere, which may be fractions of a cone.
_OF_A_CONE = ("ambient_occlusion", "sky_view_factor", "bent_normals")


def memory(finder: VisibleFinder) -> dict[str, int]:
    """Bytes of topology and hierarchies, by part."""
    contour, boundary, faces = finder.bundles
    return {
        "topology": _n_bytes(finder.geometry),
        "contour hierarchy": _n_bytes(contour),
        "boundary hierarchy": _n_bytes(boundary) if len(boundary.ends) else 0,
        "face hierarchy": _n_bytes(faces) - faces.corners.nbytes,
        "face corners": faces.corners.nbytes,
    }


def scene_plan(scene: Scene, finder: VisibleFinder) -> Plan:
    """What the scene needs, whatever will be asked of it."""
    contour, boundary, faces = finder.bundles
    defects, size = scene.defects, memory(finder)
    others = defects["boundary_edges"] + defects["non_manifold_edges"]
    return Plan(
        f"scene: {scene.n_faces:,} triangles",
        (
            Part("topology", True, "welded vertices, faces, one plane a flat region", size["topology"]),
            Part(
                "contour hierarchy",
                len(contour.ends) > 0,
                f"{len(contour.ends):,} edges with two faces"
                if len(contour.ends)
                else "no edge has two faces",
                size["contour hierarchy"],
            ),
            Part(
                "boundary hierarchy",
                len(boundary.ends) > 0,
                f"{len(boundary.ends):,} edges with one face, or more than two"
                if others
                else "closed mesh: every edge has two faces",
                size["boundary hierarchy"],
            ),
            Part(
                "flat edges",
                False,
                f"{finder.flat_edges:,} edges inside flat regions are contours from nowhere",
            ),
            Part(
                "face hierarchy",
                True,
                "start counts, and covering where it is cheaper or counts fail",
                size["face hierarchy"],
            ),
            Part(
                "face corners",
                len(faces.corners) > 0,
                "covering reads them" if len(faces.corners) else "no radial query has asked to cover",
                size["face corners"],
            ),
        ),
    )


def request_plan(
    finder: VisibleFinder,
    request: str,
    isolines: int,
    weighting: str | None,
    method: str,
    max_degree: int | None,
    environment: Environment | None,
    basis: Any,
    limits: Limits = NO_LIMITS,
) -> Plan:
    """What a request needs, with its own defaults for what is None."""
    choice(request, "request", REQUESTS)
    if limits and request in _OCTAHEDRAL:
        raise InputError(f"{limits.given[0]} given; {request} knows no limits: leave it out")
    method = limits.method_for(method, EXACT_LIMITS.get(request, ()), request in _OF_A_CONE)
    if weighting is None:
        weighting = "uniform" if request in ("sh_lighting", "integrate") else "cosine"
    choice(weighting, "weighting", WEIGHTINGS)
    if max_degree is None:
        max_degree = 2 if request == "sh_lighting" else 4
    degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
    if method == "exact" and request not in ("irradiance", "sh_lighting", "integrate"):
        return exact_plan(finder, request, weighting, degree, limits)
    coarse = environment is not None and not environment.suits_radial and request == "irradiance"
    if method == "auto" and coarse:
        method = "octahedral"
    if method != "octahedral" and request not in _OCTAHEDRAL:
        return radial_plan(finder, request, isolines, weighting, degree, environment, limits)
    functions = None if basis is None or request != "integrate" else Basis(basis, weighting)
    return octahedral_plan(finder, request, isolines, weighting, degree, environment, functions)


def octahedral_plan(
    finder: VisibleFinder,
    request: str,
    isolines: int,
    weighting: str,
    max_degree: int,
    environment: Environment | None = None,
    basis: Basis | None = None,
) -> Plan:
    """What a request needs on octahedral isolines."""
    orders = {"ambient_occlusion": {1 if weighting == "cosine" else 0}, "sky_view_factor": {1}}
    orders["irradiance"] = {1}  # of the open hemisphere, and of a constant environment
    used = orders.get(request, {1, 2} if request == "bent_normals" else set())
    tables = tuple(
        Part(
            name,
            order in used,
            why if order in used else f"{request} does not need it",
            isolines * 1025 * 2 * channels * 8 if order in used else 0,
        )
        for order, name, channels, why in (
            (0, "solid angle table", 1, "uniform weighting; one table serves all normals"),
            (1, "first moment table", 3, "n.w is linear in w; one table serves all normals"),
            (2, "second moment table", 6, "(n.w) w is quadratic in w; one table serves all normals"),
        )
    )
    return Plan(
        f"{request}, {isolines} octahedral isolines",
        (
            *_searches(finder),
            Part(
                "sweep", True, f"depth counts on {isolines} isolines, start count at the pole, horizon check"
            ),
            Part("cover", False, "only for isolines whose counts contradict each other"),
            *tables,
            _light(request, isolines, weighting, max_degree, environment),
            _basis(request, isolines, weighting, basis),
            _harmonics(request, isolines, weighting, max_degree),
            _second_horizon(request),
            Part("limits", False, "octahedral isolines know none"),
        ),
    )


def radial_plan(
    finder: VisibleFinder,
    request: str,
    isolines: int,
    weighting: str,
    max_degree: int,
    environment: Environment | None = None,
    limits: Limits = NO_LIMITS,
) -> Plan:
    """What a request needs on radial isolines."""
    within = finder.line_limits(limits) if limits else UNLIMITED
    low, high = finder._box
    ends_within = limits.falloff == "none" and within.reach >= np.linalg.norm(high - low)
    near = within.reach < np.inf and not ends_within
    cover = within.one_sided or (finder._covers(within) if near else finder.cover)
    n_lines = enough_lines(isolines, max_degree if request == "sh_transfer" else 0)
    if limits.falloff != "none":
        n_lines *= LINES_OF_FALLOFF
    searches = tuple(
        Part(part.name, False, "covering needs no contours") if cover else part for part in _searches(finder)
    )
    cosine = weighting == "cosine" or request in ("sky_view_factor", "bent_normals", "irradiance")
    integrand = "n.w" if cosine else "1"
    if request == "sh_transfer":
        integrand = f"harmonics to degree {moment_degree(max_degree, weighting)}"
    cheaper = "covering costs less here, by counts on a sample of faces"
    return Plan(
        f"{request}, {n_lines} radial isolines",
        (
            *searches,
            Part(
                "sweep",
                not cover,
                ("single faces have to be told apart" if within.one_sided else cheaper)
                if cover
                else f"depth counts on {n_lines} half-planes, one start count at the zenith",
            ),
            Part(
                "cover",
                cover,
                f"faces taken from {n_lines} half-planes, front to back"
                + ("" if within.one_sided else "; fewer counts than the sweep's")
                if cover
                else "the sweep costs less here; only for points whose counts contradict each other",
            ),
            Part("tables", False, f"the integral of {integrand} along a line has a closed form"),
            _arcs_instead(request, cover, limits),
            _rotation(request, max_degree),
            *_cells(request, n_lines, environment),
            _second_horizon(request),
            *_limits(finder, limits, within, near, cover),
        ),
    )


def exact_plan(
    finder: VisibleFinder, request: str, weighting: str, max_degree: int, limits: Limits = NO_LIMITS
) -> Plan:
    """What a request needs in exact mode."""
    if request == "sh_transfer":
        integrand = f"zonal lobes of degrees 0 to {moment_degree(max_degree, weighting)}"
    else:
        integrand = {"bent_normals": "(n.w) w", "visibility": "nothing yet"}.get(
            request, "n.w" if weighting == "cosine" or request == "sky_view_factor" else "1"
        )
    limit = Part("limits", False, "none is given; of all, arcs know a spread or a maximum distance")
    if "spread" in limits.given:
        told = "arcs beyond it count by their turn about the normal"
        limit = Part("spread", True, f"{limits.spread:g} degrees from the normal: {told}; open is 1")
    elif limits:
        within = finder.line_limits(limits)
        reach = float(np.ldexp(within.reach, finder.scene.welding.exponent))
        told = "edges end there, and small circles bound what is seen where faces leave that ball"
        limit = Part("max distance", True, f"{reach:g}: {told}")
    return Plan(
        f"{request}, exact",
        (
            *_searches(finder),
            Part("arrangement", True, "an angular sweep over all contour edges above the horizon, once"),
            Part("second frame", False, "only for points whose depth counts contradict each other"),
            Part("isolines", False, "only for points that the second frame does not settle"),
            Part("tables", False, f"the integral of {integrand} along an arc has a closed form"),
            _second_horizon(request),
            limit,
        ),
    )


def _limits(
    finder: VisibleFinder, limits: Limits, within: LineLimits, near: bool, cover: bool
) -> tuple[Part, ...]:
    """What limits change, and which are left out."""
    if not limits:
        return (Part("limits", False, "none is given: all that a point sees counts"),)
    reach = float(np.ldexp(within.reach, finder.scene.welding.exponent))
    if limits.max_distance is None:
        distance = Part("max distance", False, "surfaces count however far they are")
    elif near:
        nearer = "faces and boxes nearer than" if cover else "contour edges that come nearer than"
        distance = Part("max distance", True, f"{nearer} {reach:g}")
    else:
        distance = Part("max distance", False, f"the scene ends within {reach:g} of every point in it")
    mean = f"a radius of its own for each line, {LINES_OF_FALLOFF} lines an isoline"
    sphere = "faces that pass through the sphere of the distance; one more jump for each"
    unneeded = "covering takes of each face what is near" if near else "no distance cuts faces"
    return (
        distance,
        Part("sphere search", near and not cover, sphere if near and not cover else unneeded),
        Part(
            "falloff", limits.falloff != "none", mean if limits.falloff != "none" else "what is near blocks"
        ),
        Part(
            "spread",
            limits.spread < 90.0,
            f"lines end {limits.spread:g} degrees from the normal; open is 1"
            if limits.spread < 90.0
            else "the whole hemisphere counts",
        ),
        Part(
            "backfaces",
            within.one_sided,
            "faces seen from their back are passed over" if within.one_sided else "both sides block",
        ),
        Part(
            "ground",
            limits.ground is not None,
            "one interval cut from each line, no mesh" if limits.ground is not None else "there is none",
        ),
    )


def _arcs_instead(request: str, cover: bool, limits: Limits) -> Part:
    if limits:
        return Part("arcs", False, "they know a spread or a distance, by method='exact'")
    if request == "irradiance":
        return Part("arcs", False, "light has no closed form along them")
    if cover:
        return Part("arcs", False, "too much lies behind what is seen; lines serve every tolerance")
    return Part("arcs", False, "only for points that need more than 512 lines for a tolerance")


def _searches(finder: VisibleFinder) -> tuple[Part, Part]:
    has_boundary = len(finder.bundles.boundary.ends) > 0
    return (
        Part("contour search", True, "dual-space, horizon and line tests for tiles of points"),
        Part(
            "boundary search",
            has_boundary,
            "open or non-manifold edges" if has_boundary else "closed mesh: no boundary edges",
        ),
    )


def _light(
    request: str, isolines: int, weighting: str, max_degree: int, environment: Environment | None
) -> Part:
    name = "light table"
    if request == "sh_lighting":
        return _masked_light(isolines, moment_degree(max_degree, weighting), environment)
    if request != "irradiance":
        return Part(name, False, f"{request} does not need it")
    if environment is None:
        return Part(name, True, "3 columns for each channel of an environment, 1 if it is grey; all normals")
    if environment.is_constant:
        return Part(name, False, "a constant environment: first moments times its radiance")
    columns = "3 columns, grey" if environment.channels == 1 else "9 columns, 3 channels"
    return Part(
        name,
        True,
        f"{columns}: L (n.w) is linear in L w; one table serves all normals",
        environment.table_bytes(isolines),
    )


def _masked_light(isolines: int, degree: int, environment: Environment | None) -> Part:
    name, columns = "light table", (degree + 1) ** 2
    why = f"L times {columns} harmonics of degrees 0 to {degree}"
    if environment is None:
        return Part(name, True, f"{why} for each channel of an environment, 1 if it is grey; all normals")
    if environment.is_constant:
        return Part(name, False, "a constant environment: harmonics times its radiance")
    channels = environment.channels
    total = f"{channels * columns} columns, " + ("grey" if channels == 1 else f"{channels} channels")
    size = harmonic_table_bytes(environment, isolines, degree)
    return Part(name, True, f"{total}: {why}; one table serves all normals", size)


def _basis(request: str, isolines: int, weighting: str, basis: Basis | None) -> Part:
    name = "basis table"
    if request != "integrate":
        return Part(name, False, f"{request} does not need it")
    why = "f w, of which f (n.w) is a product" if weighting == "cosine" else "f"
    times = 3 if weighting == "cosine" else 1
    if basis is None:
        return Part(name, True, f"{times} column{'s'[: times - 1]} for each function: {why}; all normals")
    lines = max(isolines, 2)
    columns = basis.channels * times
    told = f"{columns} column{'s' if columns > 1 else ''} for {basis.channels} of {basis.described}"
    return Part(name, True, f"{told}: {why}; one table serves all normals", basis.table_bytes(lines))


def _cells(request: str, n_lines: int, environment: Environment | None) -> tuple[Part, Part]:
    """Light along radial lines: the map in cells, and what is too small for them."""
    sky, sun = "sky in cells", "small sources"
    if request != "irradiance":
        return Part(sky, False, f"{request} has no light"), Part(sun, False, f"{request} has no light")
    if environment is not None and environment.is_constant:
        why = "a constant environment: pi L times ambient occlusion"
        return Part(sky, False, why), Part(sun, False, why)
    cells = f"{cells_a_line(n_lines)} a line, of an octahedral pyramid; irradiance without occluders"
    if environment is None:
        return Part(sky, True, cells), Part(
            sun, True, "where the map has any; a line passes through the first"
        )
    n_discs, size = environment.radial_parts
    why = f"{n_discs} discs; a line of each point passes through the first" if n_discs else "the map has none"
    return Part(sky, True, cells, size), Part(sun, n_discs > 0, why)


def _harmonics(request: str, isolines: int, weighting: str, max_degree: int) -> Part:
    name = "harmonics table"
    if request not in ("sh_transfer", "sh_lighting"):
        return Part(name, False, f"{request} does not need it")
    degree = moment_degree(max_degree, weighting)
    why = f"{(degree + 1) ** 2} harmonics of degrees 0 to {degree}"
    if weighting == "cosine":
        why += f": n.w times those to {max_degree}"
    if request == "sh_lighting":
        why += ", of the open hemisphere and of a constant environment"
    return Part(name, True, f"{why}; one table serves all normals", table_bytes(degree, isolines))


def _rotation(request: str, max_degree: int) -> Part:
    if request != "sh_transfer":
        return Part("rotation", False, "no harmonics asked for")
    return Part("rotation", True, f"degrees 0 to {max_degree} from each point's frame to the world's axes")


def _second_horizon(request: str) -> Part:
    sky = request == "sky_view_factor"
    return Part("second horizon", sky, "clip by the plane of the sky" if sky else "no sky plane asked for")


def _n_bytes(arrays: Any) -> int:
    return sum(a.nbytes for a in arrays if isinstance(a, np.ndarray))
