"""Do error estimates hold? The share of points whose error is below their own estimate, and by how much.

    python benchmarks/estimates.py clutter_9k room spot stanford-bunny --assets MESHES --maps sunset.hdr

Ambient occlusion, transfer in spherical harmonics of degree 4 (the length of the error of all coefficients)
and irradiance (the channel that errs most) under a clear sky with its sun and under maps. The reference is
the same quantity with many more isolines. Every cell: points that hold, and what the estimate would have to
be multiplied by to hold for 95 %.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from common import InputError, fail, find, load, markdown, write

import silint
from silint import Environment
from silint.bench.sites import shade_sites

REFERENCE = {"radial": 4096, "octahedral": 1024}  # isolines; tables of maps for more take long to build
DEGREE = 4

# Errors and estimates below this, of the largest value, are rounding.
ROUNDING = 1e-9

Query = Callable[..., Any]


def quantities(integrator: silint.SilhouetteIntegrator, lights: dict[str, Environment]) -> dict[str, Query]:
    found: dict[str, Query] = {}
    for method in REFERENCE:
        found[f"ambient occlusion, {method}"] = partial(integrator.ambient_occlusion, method=method)
        found[f"transfer, {method}"] = partial(integrator.sh_transfer, max_degree=DEGREE, method=method)
    for name, light in lights.items():
        found[f"irradiance, {name}, octahedral"] = partial(integrator.irradiance, environment=light)
    return found


def size(name: str, difference: np.ndarray) -> np.ndarray:
    """Of errors, as the estimate means it: (n,)."""
    if difference.ndim == 1:
        return np.abs(difference)
    return np.linalg.norm(difference, axis=1) if "transfer" in name else np.abs(difference).max(axis=1)


def cells(name: str, query: Query, settings: list[int]) -> list[str]:
    most = REFERENCE["radial" if "radial" in name or "transfer" in name else "octahedral"]
    truth = query(isolines=most) if "transfer" not in name else query(isolines=most, method="radial")
    out, least = [], ROUNDING * np.abs(truth).max()
    for k in settings:
        found = query(isolines=k, full_output=True)
        error = size(name, found.value - truth)
        held = (error <= np.maximum(found.error_estimate, least)).mean()
        seen = found.error_estimate > least
        factor = np.quantile(error[seen] / found.error_estimate[seen], 0.95) if seen.any() else 0.0
        out.append(f"{100 * held:.0f} %; {factor:.2f}")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="+", help="generated scenes, files, or names in the folder of assets")
    parser.add_argument("--assets", help="folder of meshes")
    parser.add_argument("--maps", nargs="*", default=[], help="environment maps, z up")
    parser.add_argument("--isolines", default="32,64,128")
    parser.add_argument("--points", type=int, default=256)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--output", help="where to keep the table")
    options = parser.parse_args()
    settings = [int(k) for k in options.isolines.split(",")]
    try:
        lights = {
            "sunny sky": Environment.cie_clear_sky((0.4, 0.3, 0.8), sun_irradiance=20.0, up="z", height=128)
        }
        lights |= {light.name: light for light in (Environment.from_file(m, "z") for m in options.maps)}
        rows = []
        for source in options.scenes:
            scene = load(source, options.assets)
            sites = "surface" if find(source, options.assets) is None else "vertices"
            places = shade_sites(scene, sites, options.points, np.random.default_rng(options.seed))
            for name, query in quantities(silint.SilhouetteIntegrator(scene), lights).items():
                rows.append([f"{source}: {name}", *cells(name, partial(query, *places), settings)])
                print(*rows[-1], sep="  ", file=sys.stderr, flush=True)
    except InputError as error:
        fail(error)
    write(options.output, markdown(["holds for; to hold for 95 %", *map(str, settings)], rows))


if __name__ == "__main__":
    main()
