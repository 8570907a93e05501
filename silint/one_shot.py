"""Queries in one call, at the vertices of a mesh where no points are given."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.integrator import SilhouetteIntegrator
from silint.scene import as_scene
from silint.validation import InputError
from silint.visibility import FloatArray, Result

__all__ = ["ambient_occlusion", "at_valid_points"]


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
        Of `SilhouetteIntegrator.ambient_occlusion`, `max_distance` and the other limits among them.

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
