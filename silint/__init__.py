"""silint: integrals over what a point can see, from the silhouettes of visibility instead of from rays.

>>> import silint
>>> ao = silint.ambient_occlusion("model.glb")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from silint import reference as reference
    from silint import sh as sh
    from silint.basis import prefix_table as prefix_table
    from silint.core.prefix_table import PrefixTable as PrefixTable
    from silint.environment import Environment as Environment
    from silint.integrator import SilhouetteIntegrator as SilhouetteIntegrator
    from silint.limits import Limits as Limits
    from silint.one_shot import ambient_occlusion as ambient_occlusion
    from silint.plan import Plan as Plan
    from silint.prt import Transfer as Transfer
    from silint.scene import Scene as Scene
    from silint.scene import load_scene as load_scene
    from silint.validation import InputError as InputError
    from silint.visibility import Result as Result
    from silint.visibility import Visibility as Visibility
    from silint.visible_arcs import VisibleArcs as VisibleArcs

# Numba takes most of a second to import: only what is used is loaded, when it is used.
_HOME = {
    "Environment": "environment",
    "InputError": "validation",
    "Limits": "limits",
    "Plan": "plan",
    "PrefixTable": "core.prefix_table",
    "Result": "visibility",
    "Scene": "scene",
    "SilhouetteIntegrator": "integrator",
    "Transfer": "prt",
    "Visibility": "visibility",
    "VisibleArcs": "visible_arcs",
    "ambient_occlusion": "one_shot",
    "load_scene": "scene",
    "prefix_table": "basis",
}

_MODULES = ("reference", "sh")

__all__ = ["__version__", *_MODULES, *_HOME]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"silint.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'silint' has no attribute {name!r}")
    value = getattr(import_module(f"silint.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
