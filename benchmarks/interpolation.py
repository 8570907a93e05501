"""Interpolated against full bakes: points computed, time, and true errors; and what derivatives would give.

    python benchmarks/interpolation.py --assets MESHES --write docs/interpolation.md --pictures DIR

Three assets: all vertices of a scan (armadillo), the vertices of a part of a dense one (dragon_vrip), those
of a small model (spot) and its texture (1024 texels a side, unwrapped). Full and interpolated bakes take
turns in one process; times are of the processor, all threads together, which other work on it changes less.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import InputError, fail, find, insert, markdown

import silint
from silint.bake import BakeOptions
from silint.bake.integrate import Integrals, integrate
from silint.bake.targets import Sites as Baked
from silint.interpolation import SAME_NORMAL, face_surfaces, smooth_surfaces

TOLERANCES = (0.01, 0.003)
PART = 12_000  # vertices of the dragon


class Sites(NamedTuple):
    """Where to integrate, and how to show it."""

    name: str
    integrator: silint.SilhouetteIntegrator
    points: np.ndarray
    normals: np.ndarray
    surfaces: np.ndarray
    draw: Any  # from values (n,) to an image, or None


def vertices_of(name: str, assets: str, part: int | None = None) -> Sites:
    scene = silint.load_scene(find(name, assets))
    normals, valid = scene.vertex_normals()
    surfaces = smooth_surfaces(scene.vertices, normals, scene.faces)
    rows = np.flatnonzero(valid)
    if part is not None:
        # A ball about a vertex: as dense as the whole.
        centre = scene.vertices[np.argsort(scene.vertices[:, 0])[scene.n_vertices // 3]]
        distance = np.linalg.norm(scene.vertices[rows] - centre, axis=1)
        rows = rows[np.sort(np.argsort(distance, kind="stable")[:part])]
    title = f"{name}, {len(rows):,} {'vertices' if part is None else 'of its vertices'}"
    integrator = silint.SilhouetteIntegrator(scene)
    return Sites(title, integrator, scene.vertices[rows], normals[rows], surfaces[rows], None)


def texels_of(name: str, assets: str, size: int) -> Sites:
    from silint.texture.surface import Layout, shade_points, surface_of

    path = find(name, assets)
    assert path is not None
    scene = silint.load_scene(path)
    surface = surface_of(scene, path, "auto", Layout(size, 4))
    points, normals, _ = shade_points(surface, None, None)
    of_face = face_surfaces(surface.welded, surface.corners.normals, SAME_NORMAL)

    def draw(values: np.ndarray) -> np.ndarray:
        image = np.zeros(size * size)
        image[surface.texels.texel] = surface.texels.means(values[:, None])[:, 0]
        return image.reshape(size, size)

    title = f"{name}, {size} x {size} texels, {len(points):,} samples"
    integrator = silint.SilhouetteIntegrator(scene)
    return Sites(title, integrator, points, normals, of_face[surface.texels.sample_face], draw)


def rows_of(sites: Sites, pictures: Path | None, turns: int = 3) -> list[list[str]]:
    """A row for each tolerance: medians over bakes that take turns."""
    on = Baked(sites.points, sites.normals, np.ones(len(sites.points), bool), surfaces=sites.surfaces)
    few = Baked(*(field[:2000] for field in on[:3]), surfaces=on.surfaces[:2000])

    def bake(at: Baked, tolerance: float | None) -> tuple[Integrals, float]:
        began = time.process_time()
        found = integrate(sites.integrator, [], at, BakeOptions(interpolate=tolerance), {}, None)
        return found, time.process_time() - began

    for tolerance in (None, 0.1):
        bake(few, tolerance)  # compiles
    seconds: dict[float | None, list[float]] = {tolerance: [] for tolerance in (None, *TOLERANCES)}
    values: dict[float | None, Integrals] = {}
    for _ in range(turns):
        for tolerance, taken in seconds.items():
            values[tolerance], last = bake(on, tolerance)
            taken.append(last)
    out, full = [], values[None].value
    plain = float(np.median(seconds[None]))
    for tolerance in TOLERANCES:
        found, told = values[tolerance], values[tolerance].interpolation
        error = np.abs(found.value - full)
        taken = float(np.median(seconds[tolerance]))
        out.append(
            [
                sites.name,
                f"{tolerance:g}",
                f"{told['computed']:,} ({100.0 * told['computed'] / told['distinct']:.1f} %)",
                f"{plain:.2f} s",
                f"{taken:.2f} s ({taken / plain:.2f}x)",
                f"{told['held_back_error']:.4f}",
                f"{np.sqrt((error**2).mean()):.5f}",
                f"{100.0 * (error > tolerance).mean():.2f} %",
                f"{error.max():.3f}",
            ]
        )
        print(*out[-1], sep=" | ", flush=True)
        if pictures is not None and sites.draw is not None:
            from PIL import Image

            pictures.mkdir(parents=True, exist_ok=True)
            shown = [sites.draw(full), sites.draw(found.value), sites.draw(25.0 * error)]
            grey = (255.0 * np.concatenate(shown, axis=1).clip(0.0, 1.0)).astype(np.uint8)
            Image.fromarray(grey).save(pictures / f"{sites.name.split(',')[0]}-{tolerance:g}.png")
    return out


def derivatives(sites: Sites, n: int = 60) -> list[str]:
    """Cost of an exact derivative, in evaluations, and errors of predictions around n anchors with it.

    Of the points nearest to an anchor as many as a cluster has at first, predicted by the anchor's value
    alone, and by value and derivatives by place and normal; a full bake is the truth.
    """
    from scipy.spatial import cKDTree

    rows = np.linspace(0, len(sites.points) - 1, n).astype(int)
    _, near = cKDTree(sites.points).query(sites.points[rows], 48)
    p, normals = sites.points[near.ravel()], sites.normals[near.ravel()]
    query, gradient = sites.integrator.ambient_occlusion, sites.integrator.ambient_occlusion_gradient
    gradient(sites.points[rows[:2]], sites.normals[rows[:2]])
    began = time.perf_counter()
    truth = query(p, normals).reshape(near.shape)
    middle = time.perf_counter()
    at = gradient(sites.points[rows], sites.normals[rows])
    end = time.perf_counter()
    cost = ((end - middle) / n) / ((middle - began) / truth.size)
    along = ((sites.points[near] - sites.points[rows, None]) * at.points[:, None]).sum(axis=2)
    turned = ((sites.normals[near] - sites.normals[rows, None]) * at.normals[:, None]).sum(axis=2)
    same = (sites.normals[near] * sites.normals[rows, None]).sum(axis=2) > 0.9
    told = [sites.name, f"{cost:.0f}"]
    for prediction in (at.value[:, None] + 0.0 * along, at.value[:, None] + along + turned):
        error = np.abs(prediction - truth)[same]
        told += [f"{np.median(error):.4f}", f"{np.sqrt((error**2).mean()):.4f}"]
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--assets", required=True)
    parser.add_argument("--only", choices=("armadillo", "dragon_vrip", "spot"), nargs="+")
    parser.add_argument("--size", type=int, default=1024)
    parser.add_argument("--write", metavar="PAGE")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    rows, slopes = [], []
    try:
        for name in options.only or ("armadillo", "dragon_vrip", "spot"):
            if name == "spot":
                rows += rows_of(vertices_of(name, options.assets), None, turns=9)
                sites = texels_of(name, options.assets, options.size)
            else:
                sites = vertices_of(name, options.assets, PART if name == "dragon_vrip" else None)
            rows += rows_of(sites, options.pictures)
            slopes.append(derivatives(sites))
            print(*slopes[-1], sep=" | ", flush=True)
        header = ["asset", "tolerance", "points computed", "full", "interpolated", "held back: at most"]
        header += ["RMS error", "beyond tolerance", "largest error"]
        other = ["asset", "derivative costs, in points", "value alone: median error", "RMS"]
        other += ["with derivatives: median", "RMS"]
        tables = {"bakes": markdown(header, rows), "derivatives": markdown(other, slopes)}
        for table, text in tables.items():
            print(text)
            if options.write:
                insert(options.write, table, text)
    except InputError as error:
        fail(error)


if __name__ == "__main__":
    main()
