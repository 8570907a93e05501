"""Limits of what counts in a query: how far, how wide, from which side, and above which ground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.validation import InputError, choice, finite_array, positive_number

__all__ = [
    "BACKFACES",
    "EXACT_LIMITS",
    "FALLOFFS",
    "LEAST_RADIAL_SPREAD",
    "LEAST_SPREAD",
    "NO_LIMITS",
    "Limits",
    "refuse_limits",
]

FALLOFFS = ("none", "linear", "quadratic")
BACKFACES = ("block", "ignore")

# Limits that queries know along arcs, one at a time.
EXACT_LIMITS = {"ambient_occlusion": ("spread", "max_distance"), "bent_normals": ("max_distance",)}

# Radial lines start at an axis 2 degrees off the normal, which a cone has to hold: then all of them enter it.
LEAST_RADIAL_SPREAD = 4.0

# Below this rounding shows: it is 1e-8 of a fraction here, and grows as spread ** -2.
LEAST_SPREAD = 1e-3


@dataclass(frozen=True)
class Limits:
    """What of a scene counts, and which directions; checked when it is made, and never changed.

    Attributes
    ----------
    max_distance : float or str, optional
        R: surfaces at the distance R and farther, from the point along the direction, do not block. In the
        unit of the scene, or, as "5%", in percent of the diagonal of the scene's bounding box.
    falloff : {"none", "linear", "quadratic"}
        How much a surface at the distance d < R blocks: all, 1 - d / R, or 1 - (d / R)^2.
    spread : float
        Half-angle in degrees, 0.001 to 90, of a cone about the normal to which the integral is limited.
        Values are fractions of what the whole cone would give: open is 1 still. Radial isolines take 4
        degrees and more, method="exact" all.
    backfaces : {"block", "ignore"}
        Whether faces block that are seen from their back: their vertices, in the file's order, then turn
        clockwise.
    ground : array_like, shape (4,), optional
        The plane a x + b y + c z + d = 0 with (a, b, c) upwards, of any length: the surface of a solid that
        fills all below. Points on it see what lies above its horizon (with a maximum distance: all but the
        ground within it), points below it see nothing.

    Raises
    ------
    silint.InputError
        Of any of these, in one line.
    """

    max_distance: float | str | None = None
    falloff: str = "none"
    spread: float = 90.0
    backfaces: str = "block"
    ground: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.max_distance is not None:
            object.__setattr__(self, "max_distance", _checked_distance(self.max_distance))
        choice(self.falloff, "falloff", FALLOFFS)
        if self.falloff != "none" and self.max_distance is None:
            raise InputError(
                f"falloff is {self.falloff!r} without max_distance; it needs one, where it falls to 0"
            )
        object.__setattr__(self, "spread", _checked_spread(self.spread))
        choice(self.backfaces, "backfaces", BACKFACES)
        if self.ground is not None:
            # As a tuple, which cannot be changed and compares as a whole.
            object.__setattr__(self, "ground", _checked_ground(self.ground))

    def __bool__(self) -> bool:
        """Whether anything is limited at all."""
        return bool(self.given)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the limits that are set."""
        found = {
            "max_distance": self.max_distance is not None,
            "spread": self.spread < 90.0,
            "backfaces": self.backfaces != "block",
            "ground": self.ground is not None,
        }
        return tuple(name for name, is_given in found.items() if is_given)

    @property
    def cone(self) -> float:
        """Cosine of `spread`, exactly 0 for the hemisphere."""
        return math.cos(math.radians(self.spread)) if self.spread < 90.0 else 0.0

    def distance(self, diagonal: float) -> float:
        """R in the unit of the scene, whose bounding box has this diagonal; infinite for no limit."""
        if self.max_distance is None:
            return math.inf
        if isinstance(self.max_distance, str):
            return float(self.max_distance.removesuffix("%")) / 100.0 * diagonal
        return self.max_distance

    def method_for(self, method: str, exact_limits: tuple[str, ...], has_spread: bool) -> str:
        """The method that serves a query under these limits, or one line that says why the asked one cannot.

        Parameters
        ----------
        method : {"auto", "octahedral", "radial", "exact"}
        exact_limits : tuple of str
            Limits that the query's form along arcs knows, one at a time.
        has_spread : bool
            Whether the query is a fraction of a cone at all.
        """
        given = self.given
        if not given:
            return method
        if "spread" in given and not has_spread:
            raise InputError(
                f"spread is {self.spread:g}; this query is no fraction of a cone: leave spread out"
            )
        if method == "octahedral":
            raise InputError(
                f"{given[0]} given with method='octahedral', which knows no limits: use method='radial'"
            )
        if method == "exact":
            self._require_exact(exact_limits)
            return "exact"
        if self.spread >= LEAST_RADIAL_SPREAD:
            return "radial"
        only_spread = given == ("spread",) and "spread" in exact_limits
        if method == "auto" and only_spread:
            return "exact"
        better = "use method='exact'" if only_spread else "take a wider one"
        others = [name for name in given if name != "spread"]
        if "spread" in exact_limits and others:
            better += f", or leave {others[0]} out"
        raise InputError(
            f"spread is {self.spread:g}; radial isolines need {LEAST_RADIAL_SPREAD:g} to 90 degrees: {better}"
        )

    def _require_exact(self, exact_limits: tuple[str, ...]) -> None:
        """One line of what is given and what arcs do not know."""
        known = " and ".join(exact_limits) or "no limits"
        for name in self.given:
            if name not in exact_limits:
                raise InputError(
                    f"{name} given with method='exact', which knows {known} for this query: "
                    "use method='radial'"
                )
        if len(self.given) > 1:
            raise InputError(
                f"{' and '.join(self.given)} given with method='exact', which knows one of them at a time: "
                "use method='radial'"
            )
        if self.falloff != "none":
            raise InputError(
                f"falloff is {self.falloff!r} with method='exact', which knows none: use method='radial'"
            )


def _checked_distance(value: Any) -> float | str:
    if not isinstance(value, str):
        return positive_number(value, "max_distance")
    text = value.strip()
    expected = 'expected a finite number above 0, or percent of the diagonal as "5%"'
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = math.nan
    if "_" in text or not 0.0 < number < math.inf:  # "1_0" is Python's ten, and elsewhere a slip
        raise InputError(f"max_distance is {value!r}; {expected}")
    return f"{number!r}%" if text.endswith("%") else number


def _checked_spread(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, bool | np.bool_) or not LEAST_SPREAD <= number <= 90.0:
        raise InputError(f"spread is {value!r}; expected degrees from the normal, {LEAST_SPREAD:g} to 90")
    return number


def _checked_ground(value: npt.ArrayLike) -> tuple[float, ...]:
    plane = finite_array(value, "ground", [(4,)], "a, b, c, d of the plane a x + b y + c z + d = 0")
    if not plane[:3].any():
        raise InputError("ground has no normal: its a, b and c are 0; expected the direction upwards")
    # The largest first, so that no length overflows.
    with np.errstate(over="ignore", invalid="ignore"):
        plane = plane / np.abs(plane[:3]).max()
    plane = plane / np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    if not np.isfinite(plane).all():
        raise InputError("ground lies too far away for its normal; expected a, b, c of about unit length")
    return tuple(float(x) for x in plane)


NO_LIMITS = Limits()


def refuse_limits(query: str, keywords: Mapping[str, Any], instead: str) -> None:
    """Keywords of a query that knows no limits: those of `Limits` may have their defaults, nothing else.

    Parameters
    ----------
    query : str
        The name of the method.
    keywords : dict
        What it was given beyond what it knows.
    instead : str
        What serves whoever wants a limit.

    Raises
    ------
    InputError
        A limit is set: one line that says what to do.
    TypeError
        A keyword is none of a limit's, as Python has it.
    """
    known = {field.name for field in fields(Limits)}
    for name in keywords:
        if name not in known:
            raise TypeError(f"{query}() got an unexpected keyword argument {name!r}")
    given = Limits(**keywords).given
    if given:
        raise InputError(f"{given[0]} given; {query} knows no limits: leave it out, {instead}")
