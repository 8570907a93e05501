"""What silint is measured against, none of which shares code with it.

`embree`
    Embree quasi-Monte Carlo: the opponent in every benchmark, with standard errors.
`brute_force`
    The oracle: every face and every edge tested, in plain double precision.
`closed_form`
    Scenes whose answer is a formula.
"""

from silint.reference.displacement import embree_points, on_surface
from silint.reference.embree import EmbreeQMC, ReferenceResult, ambient_occlusion, embree_available

__all__ = [
    "EmbreeQMC",
    "ReferenceResult",
    "ambient_occlusion",
    "embree_available",
    "embree_points",
    "on_surface",
]
