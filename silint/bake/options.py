"""What can be asked of a bake."""

from __future__ import annotations

import numbers
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint.limits import EXACT_LIMITS, Limits
from silint.validation import (
    InputError,
    choice,
    finite_number,
    positive_int,
    positive_number,
    unit_vector,
)

if TYPE_CHECKING:
    from silint.environment import Environment
    from silint.scene import Scene

__all__ = ["NORMALS", "PER", "QUANTITIES", "WEIGHTINGS", "BakeOptions", "Progress"]

QUANTITIES = ("ao", "sky", "bent", "irradiance")
PER = ("vertex", "face")
WEIGHTINGS = ("cosine", "uniform")
NORMALS = ("auto", "file", "smooth", "flat")

_QUERIES = {"ao": "ambient_occlusion", "bent": "bent_normals"}  # that know limits with method "exact"

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class BakeOptions:
    """The options of `bake` and `bake_scene`, checked when made.

    Parameters
    ----------
    quantity : {"ao", "sky", "bent", "irradiance"}
        Ambient occlusion, sky view factor, or bent normals: 1 = open, 0 = closed. Or what arrives from an
        environment.
    per : {"vertex", "face"}
        At the file's own vertices with their normals, or at the faces' centres.
    isolines : int, optional
        Lines for each point, by default 64; the error falls as their number grows.
    method : {"auto", "octahedral", "radial", "exact"}
        "exact" integrates along boundary arcs, without lines.
    weighting : {"cosine", "uniform"}
        Of ambient occlusion; the other quantities are cosine-weighted by definition.
    up : array_like, shape (3,)
        Where the sky is, for "sky", and which way a `ground` looks.
    tolerance : float, optional
        In place of isolines: take as many as every point needs to be this accurate.
    environment : Environment or path, optional
        For "irradiance": a map (.hdr, .exr, ...), with its +y up.
    normals : {"auto", "file", "smooth", "flat"}
        The hemispheres' axes. "file": the file's own. "smooth": angle-weighted means of the faces that meet
        at a vertex, whatever the file has. "flat": the faces' own; for vertices this splits the mesh, so that
        every face has its three. "auto": for vertices the file's own or else smooth, for faces flat. Faces
        with "file" or "smooth" take the mean of their corners'.
    two_sided : bool
        Mean of the values for n and for -n: of surfaces that are seen from both sides, such as leaves.
    occluders : sequence of path, Scene or trimesh object
        Meshes that block and are not baked: the output does not hold them.
    self_only : bool
        Objects do not occlude each other: each group of the file (glTF node, .obj object) is blocked by
        itself and the occluders alone. A vertex that several groups use becomes one for each.
    groups : sequence of str
        Bake these only, and leave the rest of the file out of the output; it blocks all the same, unless
        `self_only`.
    max_distance, falloff, spread, backfaces
        What counts: see `silint.Limits`. Percents are of the diagonal of the mesh file's bounding box,
        whatever is baked of it and whatever else blocks. Irradiance has no `spread`.
    ground : float, "auto" or array_like (4,), optional
        A ground that blocks: its height along `up`, "auto" for that of the lowest vertex of all meshes, or a
        plane as in `silint.Limits`.
    interpolate : float, optional
        Compute some points only and predict the others from them, such that held-back points are predicted
        within this; see `silint.interpolation`.

    Raises
    ------
    InputError
        One of them is no good, in one line.
    """

    quantity: str = "ao"
    per: str = "vertex"
    isolines: int | None = None
    method: str = "auto"
    weighting: str = "cosine"
    up: npt.ArrayLike = (0.0, 0.0, 1.0)
    tolerance: float | None = None
    environment: Environment | str | os.PathLike[str] | None = None
    normals: str = "auto"
    two_sided: bool = False
    occluders: Sequence[Any] = ()
    self_only: bool = False
    groups: Sequence[str] = ()
    max_distance: float | str | None = None
    falloff: str = "none"
    spread: float = 90.0
    backfaces: str = "block"
    ground: float | str | npt.ArrayLike | None = None
    interpolate: float | None = None

    def __post_init__(self) -> None:
        choice(self.quantity, "quantity", QUANTITIES)
        choice(self.per, "per", PER)
        if self.isolines is not None:
            positive_int(self.isolines, "isolines")
        if self.tolerance is not None:
            positive_number(self.tolerance, "tolerance")
        if self.interpolate is not None:
            positive_number(self.interpolate, "interpolate")
        from silint.evaluate import METHODS  # and numba with it

        choice(self.method, "method", METHODS)
        choice(self.weighting, "weighting", WEIGHTINGS)
        self._check_unused()
        choice(self.normals, "normals", NORMALS)
        # One may stand alone. (A string would pass for a sequence of its letters.)
        for name in ("occluders", "groups"):
            given = getattr(self, name)
            alone = given is not None and not isinstance(given, list | tuple | set | frozenset)
            object.__setattr__(self, name, (given,) if alone else tuple(given or ()))
        for group in self.groups:
            if not isinstance(group, str):
                raise InputError(f"groups holds a {type(group).__name__}; expected names")
        self._check_limits()
        if self.quantity == "irradiance" and self.environment is None:
            raise InputError("quantity 'irradiance' needs an environment: a map (.hdr, .exr), or Environment")
        if self.quantity != "irradiance" and self.environment is not None:
            raise InputError(
                f"environment given; only quantity 'irradiance' has one, this is {self.quantity!r}"
            )

    def _check_unused(self) -> None:
        """Refuse what would do nothing."""
        if self.weighting != "cosine" and self.quantity != "ao":
            raise InputError(
                f"weighting {self.weighting!r} given; only quantity 'ao' has one, this is {self.quantity!r}"
            )
        turned = not np.array_equal(unit_vector(self.up, "up"), [0.0, 0.0, 1.0])
        if turned and self.quantity != "sky" and not _is_height(self.ground):
            raise InputError("up given; only quantity 'sky' and a ground given by its height have one")

    def _check_limits(self) -> None:
        """Before anything is read: any plane may stand for a ground that depends on the scene."""
        plane = self.ground
        if _is_height(plane):
            if isinstance(plane, str) and plane != "auto":
                raise InputError(f"ground is {plane!r}; expected a height, 'auto', or a plane's four numbers")
            if not isinstance(plane, str):
                finite_number(plane, "ground")
            plane = (0.0, 0.0, 1.0, 0.0)
        limits = Limits(self.max_distance, self.falloff, self.spread, self.backfaces, plane)
        if self.quantity == "irradiance" and limits.spread < 90.0:
            raise InputError(f"spread is {limits.spread:g}; quantity 'irradiance' has none: leave it out")
        limits.method_for(self.method, EXACT_LIMITS.get(_QUERIES.get(self.quantity, ""), ()), has_spread=True)

    def limits(self, scene: Scene, occluders: Sequence[Scene]) -> dict[str, Any]:
        """The limits that are given, as queries take them, in the unit of the scene.

        Parameters
        ----------
        scene : Scene
            The whole of what is in the mesh file.
        occluders : sequence of Scene

        Returns
        -------
        dict
            By the names of `silint.Limits`; empty if there are none.
        """
        ground: Any = self.ground
        if _is_height(ground):
            up = unit_vector(self.up, "up")
            if ground == "auto":
                parts = (scene, *occluders)
                ground = min(float((part.vertices[np.unique(part.faces)] @ up).min()) for part in parts)
            ground = (*up, -float(ground))
        limits = Limits(self.max_distance, self.falloff, self.spread, self.backfaces, ground)
        low, high = scene.bounds
        found = {name: getattr(limits, name) for name in limits.given}
        if "max_distance" in found:
            found["max_distance"] = limits.distance(float(np.linalg.norm(high - low)))
            found["falloff"] = limits.falloff
        return found

    @property
    def open_value(self) -> float | None:
        """What a point has that sees everything (of bent normals: their length), if that is one number.

        Within a spread S a bent normal is int n.w w dw over the cone, over int n.w dw = pi sin^2 S.
        """
        if self.quantity in ("ao", "sky"):
            return 1.0
        if self.quantity == "irradiance" or self.two_sided:  # of which open sides cancel
            return None
        c = Limits(spread=self.spread).cone
        return 2.0 / 3.0 * (1.0 + c + c * c) / (1.0 + c)

    def with_light(self) -> BakeOptions:
        """The same, with the environment read if it is the name of a file."""
        from silint.environment import Environment

        if self.environment is None or isinstance(self.environment, Environment):
            return self
        return replace(self, environment=Environment.from_file(self.environment))


def _is_height(ground: Any) -> bool:
    """Whether a ground is given along `up`, by a number or "auto", and not as a plane."""
    return isinstance(ground, str | numbers.Real) or (isinstance(ground, np.ndarray) and ground.ndim == 0)
