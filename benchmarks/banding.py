"""Banding at few isolines: pictures as in fig. 8 of [NBMJ14], measured, and what removes it.

    python benchmarks/banding.py                      # writes docs/banding.png and docs/banding.md

A generated scene (a floor, a sphere, an upright ring, three posts) under the CIE's clear sky, whose sun is
as large as the real one (radius 0.265 degrees) or, by a disc of 5 degrees, that of a hazy day. One point a
pixel, not smoothed, so that nothing hides the bands. Embree's rays are the reference.

An isoline stands for a strip of the sky. Where the sun comes out from behind an occluder, points close to
each other see it on one isoline more or less: irradiance steps where it ought to ramp. What is measured, in
units of what the floor gets under the open sky, as luminance:

error e : value minus reference of a pixel; RMSE over the picture.
step : |e(p) - e(q)| of neighbouring pixels p and q of one object. An edge that the reference has as well does
    not count; an edge that it has elsewhere, or does not have, does. The largest, and the share of all pairs
    whose step is above 2 % (what an eye sees, by and large).
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from common import ROOT, InputError, fail, markdown, write

import scenes.mesh as shapes
import silint
from silint.bench.truth import rms
from silint.io import write_bytes
from silint.reference import EmbreeQMC, embree_points

Array = np.ndarray[Any, np.dtype[np.float64]]

SUN = (-0.72, -0.42, 0.5)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # [Rec. 709]
VISIBLE = 0.02
SUNS = {"sun, radius 0.265 degrees": 0.265, "hazy sun, radius 5 degrees": 5.0}
ISOLINES = (16, 64, 256, 1024)
SHOWN = (16, 64, 256)
ALIGNED = (16, 64)
TOLERANCES = (0.05, 0.01)
TURNED, TURNS = 64, 4
SATURATED = 0.2  # error at which the pictures of differences have their full colour
FIELD_OF_VIEW = 26.0
LUCK = (
    "The small sun stands at u = -0.4390 along the isolines' axis. 16 of them have one at -0.4375 and do "
    "better than 64, whose nearest ones, at -0.4219 and -0.4531, lie about as far from it as they can."
)
SCRAMBLES = 4  # of the reference: enough to state an error over all pixels


@dataclass(frozen=True)
class View:
    """One point of the scene for each pixel of a picture."""

    points: Array  # (n, 3), row by row
    normals: Array
    objects: Array  # (rows, columns), which part of the scene a pixel shows
    shape: tuple[int, int]


def scene_parts() -> list[tuple[Array, Array]]:
    ticks = np.linspace(-12.0, 12.0, 37)
    x, y = np.meshgrid(ticks, ticks, indexing="ij")
    floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), shapes.grid_faces(37, 37)
    angle = np.linspace(0.0, np.pi, 25)
    ball = shapes.revolve(np.column_stack([np.sin(angle), np.cos(angle)]), 48)
    angle = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
    profile = np.column_stack([0.85 + 0.13 * np.sin(angle), 0.13 * np.cos(angle)])
    ring = shapes.revolve(profile, 72, closed=True)
    upright = ring[0][:, [2, 0, 1]] + [0.9, -0.3, 0.97], ring[1]
    cap = np.linspace(0.0, 0.5 * np.pi, 7)
    outline = np.column_stack([0.07 * np.sin(cap), 1.6 + 0.07 * np.cos(cap)])
    post = shapes.revolve(np.concatenate([outline, [(0.07, -0.02), (0.0, -0.02)]]), 24)
    posts = [shapes.moved(post, (-1.7 + 0.45 * k, 0.7, 0.0)) for k in range(3)]
    return [floor, shapes.moved(ball, (-0.75, -1.05, 0.5), 0.5), upright, *posts]


def seen(scene: silint.Scene, part_of: Array, rows: int, columns: int) -> View:
    """The points that a camera sees, with interpolated normals, and as far off the faces as Embree needs."""
    from embreex import mesh_construction, rtcore_scene

    eye, target = np.array([3.2, -6.4, 5.4]), np.array([0.8, 0.25, 0.3])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(FIELD_OF_VIEW) / 2.0)
    y = half * (1.0 - (2.0 * np.arange(rows) + 1.0) / rows)
    x = half * columns / rows * ((2.0 * np.arange(columns) + 1.0) / columns - 1.0)
    rays = forward + y[:, None, None] * up + x[None, :, None] * right
    rays = np.ascontiguousarray(rays.reshape(-1, 3), np.float32)
    embree = rtcore_scene.EmbreeScene(robust=True)
    mesh_construction.TriangleMesh(embree, scene.vertices.astype(np.float32), scene.faces)
    met = embree.run(np.tile(eye.astype(np.float32), (len(rays), 1)), rays, output=1)
    face, u, v = met["primID"], met["u"].astype(np.float64), met["v"].astype(np.float64)
    if (face < 0).any():
        raise InputError("the camera looks past the floor")
    weights = np.stack([1.0 - u - v, u, v], axis=1)[:, :, None]
    corners = scene.faces[face]
    points = (weights * scene.vertices[corners]).sum(axis=1)
    normals = (weights * scene.vertex_normals()[0][corners]).sum(axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = embree_points(scene.vertices, scene.faces, points, normals, face)
    return View(points, normals, part_of[face].reshape(rows, columns), (rows, columns))


def sky(radius: float) -> silint.Environment:
    return silint.Environment.cie_clear_sky(
        SUN, (0.35, 0.6, 1.0), (16.0, 13.0, 9.0), radius, ground_albedo=0.15, up="z"
    )


def turned(scene: silint.Scene, view: View, light: silint.Environment, isolines: int, turn: Array) -> Array:
    """Irradiance with everything turned: the same question to other isolines."""
    integrator = silint.SilhouetteIntegrator(silint.Scene(scene.vertices @ turn.T, scene.faces))
    value: Array = integrator.irradiance(
        view.points @ turn.T, view.normals @ turn.T, light.rotated(turn), isolines
    )
    return value


def towards_an_isoline(isolines: int) -> Array:
    """The least turn about z that puts the sun's centre on an isoline: u = x / (|x| + |y| + |z|)."""
    from scipy.optimize import brentq

    def u(angle: float) -> float:
        x, y, z = about_z(angle) @ SUN
        return float(x / (abs(x) + abs(y) + abs(z)))

    k = np.floor((u(0.0) + 1.0) * isolines / 2.0)
    wanted = (2.0 * k + 1.0) / isolines - 1.0
    # u grows or falls evenly as long as the sun stays within an octant.
    low, high = -0.4, 0.4
    return about_z(brentq(lambda angle: u(angle) - wanted, low, high))


def about_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def measured(error: Array, view: View) -> list[float]:
    """RMSE, largest step, share of steps above `VISIBLE`, of errors (rows, columns)."""
    steps = []
    for axis in (0, 1):
        same = np.diff(view.objects, axis=axis) == 0
        steps.append(np.abs(np.diff(error, axis=axis))[same])
    step = np.concatenate(steps)
    return [rms(error), float(step.max()), float((step > VISIBLE).mean())]


def cell(numbers: list[float]) -> list[str]:
    return [f"{numbers[0]:.1e}", f"{100 * numbers[1]:.1f} %", f"{100 * numbers[2]:.2f} %"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--output", default=str(ROOT / "docs" / "banding"), help="prefix of the files written"
    )
    parser.add_argument(
        "--height", type=int, default=120, help="pixels of a picture; its width is 1.4 times that"
    )
    parser.add_argument("--rays", type=int, default=2048, help="of the reference, a pixel")
    options = parser.parse_args()
    try:
        run(options)
    except InputError as error:
        fail(error)


def run(options: argparse.Namespace) -> None:
    parts = scene_parts()
    mesh = shapes.concatenate(parts)
    scene = silint.Scene(np.asarray(mesh[0], np.float32).astype(np.float64), mesh[1])
    part_of = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])
    view = seen(scene, part_of, options.height, round(1.4 * options.height))
    integrator = silint.SilhouetteIntegrator(scene)
    embree = EmbreeQMC(scene.vertices, scene.faces)
    rows: list[list[str]] = []
    pictures, noises = [], []
    for name, radius in SUNS.items():
        light = sky(radius)
        unit = float(light.irradiance([[0.0, 0.0, 1.0]])[0] @ LUMINANCE)
        truth = embree.irradiance(view.points, view.normals, light, options.rays // SCRAMBLES, 1, SCRAMBLES)
        noises.append(rms(truth.standard_error @ LUMINANCE) / unit)
        found: dict[str, Array] = {}
        for what, ask in cures(integrator, scene, view, light, unit).items():
            found[what] = ask()
            error = ((found[what] - truth.value) @ LUMINANCE / unit).reshape(view.shape)
            rows.append([f"{name}: {what}", *cell(measured(error, view))])
        pictures.append((name, found, truth.value, unit))
    rows += without_sun(integrator, embree, view, options)
    draw(pictures, view, f"{options.output}.png")
    text = "\n\n".join(
        [
            f"![Banding at few isolines]({Path(options.output).name}.png)",
            markdown(
                ["light: what is asked", "RMSE", "largest step", f"steps > {100 * VISIBLE:.0f} %"], rows
            ),
            f"{scene.n_faces:,} triangles, {len(view.points):,} pixels; all in units of what the open floor "
            "gets (luminance), ambient occlusion in its own. A step is the change of the error from a pixel "
            "to its neighbour on the same object. The reference, "
            f"{options.rays:,} rays of Embree a pixel, has an RMS standard error of "
            f"{' and '.join(f'{noise:.1e}' for noise in noises)} under the two suns: steps of a few times "
            "that are its noise.",
            LUCK,
        ]
    )
    write(f"{options.output}.md", text)


def cures(
    integrator: silint.SilhouetteIntegrator,
    scene: silint.Scene,
    view: View,
    light: silint.Environment,
    unit: float,
) -> dict[str, Callable[[], Array]]:
    """What to ask for under a sun, by name."""
    rng = np.random.default_rng(0)
    turns = [_random_rotation(rng) for _ in range(TURNS)]

    def plain(isolines: int) -> Array:
        value: Array = integrator.irradiance(view.points, view.normals, light, isolines)
        return value

    def tolerant(tolerance: float) -> Array:
        value: Array = integrator.irradiance(view.points, view.normals, light, tolerance=tolerance * unit)
        return value

    def aligned(isolines: int) -> Array:
        return turned(scene, view, light, isolines, towards_an_isoline(isolines))

    def averaged() -> Array:
        value: Array = np.mean([turned(scene, view, light, TURNED, turn) for turn in turns], axis=0)
        return value

    asked: dict[str, Callable[[], Array]] = {}
    for k in ISOLINES:
        asked[f"{k} isolines"] = lambda k=k: plain(k)
    for t in TOLERANCES:
        asked[f"tolerance={t:g} of the open floor"] = lambda t=t: tolerant(t)
    asked[f"{TURNED} isolines, mean of {TURNS} turns of everything"] = averaged
    for k in ALIGNED:
        asked[f"{k} isolines, turned so that one meets the sun"] = lambda k=k: aligned(k)
    return asked


def without_sun(
    integrator: silint.SilhouetteIntegrator, embree: EmbreeQMC, view: View, options: argparse.Namespace
) -> list[list[str]]:
    """Ambient occlusion, which has closed forms along radial isolines."""
    truth = embree.ambient_occlusion(
        view.points, view.normals, options.rays // SCRAMBLES, 1, scrambles=SCRAMBLES
    )
    rows = []
    for method in ("octahedral", "radial"):
        for isolines in (16, 64):
            value = integrator.ambient_occlusion(view.points, view.normals, isolines, method=method)
            numbers = measured((value - truth.value).reshape(view.shape), view)
            rows.append([f"ambient occlusion: {isolines} {method} isolines", *cell(numbers)])
    return rows


def _random_rotation(rng: np.random.Generator) -> Array:
    from scipy.spatial.transform import Rotation

    matrix: Array = Rotation.random(random_state=rng).as_matrix()
    return matrix


def draw(pictures: list[tuple[str, dict[str, Array], Array, float]], view: View, path: str) -> None:
    """A row of pictures and one of differences for each light; the reference at the right."""
    from matplotlib.figure import Figure

    shown = [f"{k} isolines" for k in SHOWN] + [f"{ALIGNED[-1]} isolines, turned so that one meets the sun"]
    columns = len(shown) + 1
    width = 2.6
    height = width * view.shape[0] / view.shape[1]
    figure = Figure(figsize=(width * columns, 2.0 * len(pictures) * (height + 0.3)), layout="constrained")
    axes = figure.subplots(2 * len(pictures), columns, squeeze=False)
    for ax in axes.flat:
        ax.set_axis_off()
    bar = None
    for i, (name, found, truth, unit) in enumerate(pictures):
        exposure = 1.6 / unit
        for j, what in enumerate(shown):
            error = ((found[what] - truth) @ LUMINANCE / unit).reshape(view.shape)
            numbers = cell(measured(error, view))
            axes[2 * i, j].imshow(_display(found[what], exposure, view), interpolation="nearest")
            axes[2 * i, j].set_title(what.replace(", ", ",\n", 1), fontsize=9)
            bar = axes[2 * i + 1, j].imshow(
                error, cmap="RdBu_r", vmin=-SATURATED, vmax=SATURATED, interpolation="nearest"
            )
            axes[2 * i + 1, j].set_title(
                f"RMSE {numbers[0]}, largest step {numbers[1]},\n{numbers[2]} of steps visible", fontsize=8
            )
        axes[2 * i, -1].imshow(_display(truth, exposure, view), interpolation="nearest")
        axes[2 * i, -1].set_title(f"reference (Embree):\n{name}", fontsize=9)
    scale = axes[1, -1].inset_axes((0.1, 0.5, 0.8, 0.08))
    figure.colorbar(bar, cax=scale, orientation="horizontal", label="error / irradiance of the open floor")
    figure.get_layout_engine().set(rect=(0.0, 0.0, 1.0, 0.98))  # or titles of the first row are cut
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    write_bytes(path, buffer.getvalue())


def _display(irradiance: Array, exposure: float, view: View) -> Array:
    """Tone-mapped and encoded [IEC 61966-2-1]."""
    x = 1.0 - np.exp(-exposure * irradiance)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055)
    return encoded.reshape(*view.shape, 3)


if __name__ == "__main__":
    main()
