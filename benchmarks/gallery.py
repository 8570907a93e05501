"""A gallery: ambient occlusion for each pixel of five assets, silint beside Embree at equal time.

    python benchmarks/gallery.py --assets MESHES      # writes docs/gallery/*.png and docs/gallery.md

The left half of a picture is Embree QMC, the right half silint on 64 lines: one point a pixel, 1:1, not
smoothed. Both get the same float32 vertices and points, and all cores. Embree's rays are the power of two
whose time is nearest to silint's, measured on strips all over the picture; then both take the whole picture,
strip by strip in turns, so that what else the machine does falls on both. Building is in neither time.

Below, pixels enlarged, pure occlusion with the contrast of the place: where Embree is noisiest, by the
difference of two runs with other random numbers, on smooth surfaces; and where silint expects to err most, by
its own error estimates. Rules choose these places, for good or ill.

A picture that has been made is kept, with what was measured, until the package's source, the mesh or the
settings change: a run may be interrupted.
"""

from __future__ import annotations

import argparse
import io
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import ROOT, SOURCE, InputError, fail, find, keep, kept, load, markdown, mesh_hash, write
from pixels import Array, Pixels, Stage, display, look_at

import silint
from silint.bench.machine import describe
from silint.bench.truth import rms
from silint.io import write_bytes
from silint.reference import EmbreeQMC
from silint.render import Camera, automatic_camera

LINES = 64
WIDTH, HEIGHT = 800, 500
CELL, ENLARGED = 42, 3  # pixels of an inset, and how many times larger they are drawn
STRIPS = 32  # into which the pixels are cut, for turns
TRIAL_RAYS, TRIAL_STRIPS = 128, 16
RMSE_PIXELS, REFERENCE_RAYS, SCRAMBLES = 2048, 16384, 4
SEED, SECOND_SEED, REFERENCE_SEED = 1, 2, 3
FLOOR_SIZE, FLOOR_SUNK = 6.0, 0.002  # in extents of the asset
COLORS = {"Embree": "#D55E00", "silint": "#0072B2", "reference": "0.25"}  # [Okabe & Ito 2008], as all figures

TITLES = ("where Embree is noisiest", "where silint expects to err most")
INTRODUCTION = f"""\
Ambient occlusion of every pixel: left of the line by Embree QMC, right of it by silint on {LINES} lines (the
default), in equal time. One point a pixel, at 1:1, not smoothed but for the geometry's edges; both sides get
the same points, float32 vertices and cores, in turns. Embree takes the power of two of rays whose time is
nearest to silint's. The captions give each side's CPU seconds for the whole picture and its RMSE, over
{RMSE_PIXELS:,} random pixels against {REFERENCE_RAYS:,} other rays of Embree.

The insets show occlusion alone, pixels enlarged {ENLARGED} times, black and white at the values given, each
with the RMSE within it. Rules choose them: the left ones where two runs of Embree with other random numbers
differ most on smooth surfaces, the right ones where silint's own error estimates are largest elsewhere.

Points stand off the surface as far as Embree needs, on both sides. Building and the camera's rays are in
neither time."""
NOTES = {
    "spot": "On a floor of two triangles, which fades to white.",
    "armadillo": "A scan on a floor of two triangles.",
    "sponza_dabrovic": "The atrium, where little of the sky is seen: the picture shows (1 - exp(-10 AO)) / "
    "(1 - exp(-10)), the insets occlusion as it is; the RMSE is that of occlusion. High on the far wall 64 "
    "lines show as bands.",
    "jet-fighter": "Thin sheets, open borders and non-manifold edges, on a floor of two triangles.",
    "eztree_oak_large": "From below the crown. Leaves are whole cards: the file has no textures.",
}


@dataclass(frozen=True)
class Shot:
    """Where the camera stands: about the asset, or at a place of its own; y is up."""

    asset: str
    azimuth: float = 0.0
    elevation: float = 0.0
    fade: tuple[float, float] | None = None  # of the floor, in extents from the middle; None: no floor
    eye: tuple[float, float, float] | None = None
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_of_view: float = 28.0
    exposure: float = 0.0  # of the picture: (1 - exp(-exposure AO)) / (1 - exp(-exposure)); 0 is AO itself


SHOTS = (
    Shot("spot", 52.0, 13.0, (0.6, 1.3)),
    Shot("armadillo", -60.0, 10.0, (0.6, 1.3)),
    Shot(
        "sponza_dabrovic", eye=(-11.0, 8.5, 0.6), target=(8.0, 3.0, -0.5), field_of_view=62.0, exposure=10.0
    ),
    Shot("jet-fighter", -50.0, 22.0, (0.5, 1.1)),
    Shot("eztree_oak_large", eye=(70.0, 6.0, 105.0), target=(-1.0, 56.0, 3.0), field_of_view=41.0),
)


class Seconds(NamedTuple):
    """Of the processor, in all threads: what others do on the machine is not in it; and of the wall clock."""

    cpu: float
    wall: float


@dataclass(frozen=True)
class Found:
    """Both sides of a picture, with what they took."""

    embree: Array  # (n,)
    silint: Array  # (n,)
    rays: int
    spent: dict[str, Seconds]
    rmse: dict[str, float]
    noise: float  # standard error of the RMSE's reference, rms
    places: list[tuple[int, int]]  # first row and column of the insets
    references: list[Array]  # (CELL, CELL) each


def staged(shot: Shot, scene: silint.Scene) -> tuple[Stage, Camera]:
    """The scene on its floor, and the camera before it."""
    low, high = scene.bounds
    if shot.eye is None:
        camera = automatic_camera(
            scene.vertices, WIDTH / HEIGHT, (0.0, 1.0, 0.0), shot.azimuth, shot.elevation
        )
    else:
        camera = look_at(shot.eye, shot.target, (0.0, 1.0, 0.0), shot.field_of_view)
    if shot.fade is None:
        return Stage(scene), camera
    middle = 0.5 * (low + high)
    middle[1] = low[1] + FLOOR_SUNK * scene.extent
    side = FLOOR_SIZE * scene.extent
    square = middle + side * np.array([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)])
    vertices = np.concatenate([scene.vertices, square.astype(np.float32).astype(np.float64)])
    faces = np.concatenate([scene.faces, scene.n_vertices + np.array([(0, 1, 2), (0, 2, 3)])])
    near, far = shot.fade
    fade = near * scene.extent, far * scene.extent
    return Stage(silint.Scene(vertices, faces, name=scene.name), 2, fade, middle), camera


def compared(scene: silint.Scene, view: Pixels) -> Found:
    """silint's values, and Embree's in the same time."""
    integrator = silint.SilhouetteIntegrator(scene)
    opponent = EmbreeQMC(scene.vertices, scene.faces)
    p, n = view.points, view.normals
    strips = np.array_split(np.arange(len(p)), STRIPS)

    def ours(rows: Array) -> Any:
        return integrator.ambient_occlusion(p[rows], n[rows], LINES, full_output=True)

    def theirs(rows: Array, rays: int, seed: int = SEED, scrambles: int = 1) -> Any:
        return opponent.ambient_occlusion(p[rows], n[rows], rays, seed, scrambles=scrambles)

    # Small strips all over the picture, after a first one that compiles. A ray costs less in company of many:
    # the second trial has about the number that will be taken.
    ours(strips[0]), theirs(strips[0], TRIAL_RAYS)
    trial = np.array_split(np.arange(len(p)), 16 * TRIAL_STRIPS)[8::16]
    mine = sum(timed(partial(ours, rows))[0].cpu for rows in trial)
    rays = TRIAL_RAYS
    for _ in range(2):
        others = sum(timed(partial(theirs, rows, rays))[0].cpu for rows in trial)
        rays = 1 << max(round(np.log2(rays * mine / others)), 0)

    values = {"silint": np.empty(len(p)), "Embree": np.empty(len(p))}
    spent = {side: Seconds(0.0, 0.0) for side in values}
    estimate = np.empty(len(p))
    for turn, rows in enumerate(strips):
        for side in ("silint", "Embree") if turn % 2 == 0 else ("Embree", "silint"):
            took, result = timed(partial(ours, rows) if side == "silint" else partial(theirs, rows, rays))
            spent[side] = Seconds(spent[side].cpu + took.cpu, spent[side].wall + took.wall)
            values[side][rows] = result.value
            if side == "silint":
                estimate[rows] = result.error_estimate

    chosen = np.sort(np.random.default_rng(SEED).permutation(len(p))[:RMSE_PIXELS])
    truth = theirs(chosen, REFERENCE_RAYS // SCRAMBLES, REFERENCE_SEED, SCRAMBLES)
    rmse = {side: rms(value[chosen] - truth.value) for side, value in values.items()}

    # A quarter of the pixels is enough to know where the noise is.
    row, column = np.divmod(view.where, view.shape[1])
    again = np.flatnonzero((row % 2 == 0) & (column % 2 == 0) & view.smooth.ravel()[view.where])
    difference = np.zeros(len(p))
    difference[again] = values["Embree"][again] - theirs(again, rays, SECOND_SEED).value
    noisiest = worst(view, difference**2)
    places = [noisiest, worst(view, estimate**2, noisiest)]
    numbers = view.map(np.arange(len(p)), -1).astype(np.int64)
    references = []
    for j, i in places:
        inside = numbers[j : j + CELL, i : i + CELL]
        reference = np.full(inside.shape, np.nan)
        asked = inside[inside >= 0]
        reference[inside >= 0] = theirs(asked, REFERENCE_RAYS // SCRAMBLES, REFERENCE_SEED, SCRAMBLES).value
        references.append(reference)
    return Found(
        values["Embree"], values["silint"], rays, spent, rmse, rms(truth.standard_error), places, references
    )


def timed(run: Any) -> tuple[Seconds, Any]:
    wall, cpu = time.perf_counter(), time.process_time()
    result = run()
    return Seconds(time.process_time() - cpu, time.perf_counter() - wall), result


def worst(view: Pixels, squares: Array, apart: tuple[int, int] | None = None) -> tuple[int, int]:
    """First row and column of the square of `CELL` pixels with the largest sum, apart from another square."""
    total = np.pad(view.map(squares, 0.0), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    sums = total[CELL:, CELL:] - total[:-CELL, CELL:] - total[CELL:, :-CELL] + total[:-CELL, :-CELL]
    if apart is not None:
        near = tuple(slice(max(first - CELL + 1, 0), first + CELL) for first in apart)
        sums[near] = -1.0
    row, column = np.unravel_index(sums.argmax(), sums.shape)
    return int(row), int(column)


def draw(shot: Shot, view: Pixels, found: Found, path: Path) -> list[dict[str, float]]:
    """The picture, its insets and its captions; every value is a pixel of the file, or 3 x 3 in an inset.

    Returns both sides' RMSE in each inset.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    side = CELL * ENLARGED
    gap = 4
    strip = HEIGHT + 48  # first row of the insets
    height = strip + side + 26
    figure = Figure(figsize=(WIDTH / 100.0, height / 100.0), dpi=100, facecolor="white")

    def expose(values: Array) -> Array:
        e = shot.exposure
        return values if e == 0.0 else (1.0 - np.exp(-e * values)) / (1.0 - np.exp(-e))

    def place(image: Array, row: int, column: int) -> None:
        figure.figimage(
            np.repeat(np.rint(255.0 * display(image))[..., None] / 255.0, 3, axis=2),
            column,
            height - row - image.shape[0],
            origin="upper",
        )

    def say(text: str, row: float, column: float, **style: Any) -> None:
        figure.text(column / WIDTH, 1.0 - row / height, text, **{"fontsize": 8.5, "va": "center", **style})

    def box(row: float, column: float, size: float, color: str) -> None:
        figure.add_artist(
            Rectangle(
                (column / WIDTH, 1.0 - (row + size) / height),
                size / WIDTH,
                size / height,
                fill=False,
                ec=color,
                lw=1.2,
            )
        )

    half = WIDTH // 2
    both = {"Embree": found.embree, "silint": found.silint}
    pictures = {name: view.picture(expose(values)) for name, values in both.items()}
    place(np.hstack([pictures["Embree"][:, :half], pictures["silint"][:, half:]]), 0, 0)
    line = {"color": "white", "lw": 1.6, "transform": figure.transFigure}

    figure.add_artist(Line2D([0.5, 0.5], [1.0, 1.0 - HEIGHT / height], **line))
    figure.add_artist(
        Line2D([0.5, 0.5], [1.0, 1.0 - HEIGHT / height], **{**line, "color": "0.35", "lw": 0.7})
    )
    took = {"Embree": f"Embree QMC, {found.rays} rays", "silint": f"silint, {LINES} lines"}
    for name, column, align in (("Embree", half - 10, "right"), ("silint", half + 10, "left")):
        text = f"{took[name]}: {found.spent[name].cpu:.1f} CPU s, RMSE {short(found.rmse[name])}"
        say(text, HEIGHT + 14, column, ha=align, color=COLORS[name], weight="bold", fontsize=9.5)

    places: list[dict[str, float]] = []
    whole = {name: view.map(values) for name, values in both.items()}
    group = 3 * side + 2 * gap
    for k, ((j, i), reference) in enumerate(zip(found.places, found.references, strict=True)):
        places.append({})
        left = k * (WIDTH - group)
        mark = ("#D55E00", "#0072B2")[k]
        box(j, i, CELL, mark)
        low, high = contrast(reference)
        say(f"{TITLES[k]}: AO {low:.2f} to {high:.2f}", strip - 12, left + group / 2, ha="center", color=mark)
        for m, name in enumerate(("Embree", "silint", "reference")):
            values = reference if name == "reference" else whole[name][j : j + CELL, i : i + CELL]
            shown = np.where(np.isnan(values), 1.0, np.clip((values - low) / (high - low), 0.0, 1.0))
            # Evenly spaced values look evenly spaced: the sRGB curve is undone.
            linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
            column = left + m * (side + gap)
            place(np.kron(linear, np.ones((ENLARGED, ENLARGED))), strip, column)
            text = name
            if name != "reference":
                places[k][name] = rms((values - reference)[~np.isnan(reference)])
                text = f"{name} {short(places[k][name])}"
            say(text, strip + side + 12, column + side / 2, ha="center", color=COLORS[name])
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100, pil_kwargs={"optimize": True})
    write_bytes(path, buffer.getvalue())
    return places


def contrast(reference: Array) -> tuple[float, float]:
    """What is drawn black and white in an inset: the values of its reference, and a little room."""
    low, high = np.nanquantile(reference, (0.01, 0.99))
    room = max(0.15 * (high - low), 0.02)
    return max(0.0, float(low - room)), min(1.0, float(high + room))


def short(x: float) -> str:
    """1.3e-3."""
    return f"{x:.1e}".replace("e-0", "e-")


def page(reports: list[dict[str, Any]], folder: str) -> str:
    """docs/gallery.md: the table, how it was made, and every picture."""
    header = ["asset", "triangles", "pixels", "Embree: rays", "CPU s", "wall s", "RMSE"]
    header += [
        f"silint, {LINES} lines: CPU s",
        "wall s",
        "RMSE",
        "Embree's RMSE / silint's",
        "reference s.e.",
    ]
    rows = []
    for r in reports:
        row = [f"[{r['asset']}](#{r['asset']})", f"{r['triangles']:,}", f"{r['pixels']:,}", f"{r['rays']}"]
        for side in ("Embree", "silint"):
            row += [f"{r['cpu'][side]:.1f}", f"{r['wall'][side]:.1f}", short(r["rmse"][side])]
        rows.append([*row, f"{r['rmse']['Embree'] / r['rmse']['silint']:.1f}", short(r["noise"])])
    machine = reports[-1]["machine"]
    loads = max(r["machine"]["load_average"] or 0.0 for r in reports)
    better = [r["asset"] for r in reports if r["rmse"]["Embree"] < r["rmse"]["silint"]]
    insets = [
        f"the {which} one of {r['asset']} ({short(place['Embree'])} against {short(place['silint'])})"
        for r in reports
        for which, place in zip(("left", "right"), r["places"], strict=True)
        if place["Embree"] < place["silint"]
    ]
    verdict = (
        f"Embree's RMSE is the smaller one in {', '.join(better) or 'none of the pictures'}; among the "
        f"insets in {', '.join(insets) or 'none'}."
    )
    text = [
        "# Gallery",
        INTRODUCTION,
        "    python benchmarks/gallery.py --assets MESHES",
        markdown(header, rows),
        f"{machine['processor']}, {machine['threads']} threads for both sides; load averages up to "
        f"{loads:.1f}. CPU seconds are those of all threads together. Embree's rays are chosen by them: on a "
        "busy machine they tell what each side takes, where wall seconds tell what the others leave. "
        + verdict,
    ]
    for r in reports:
        text += [f"## {r['asset']}", NOTES[r["asset"]], f"![{r['asset']}]({folder}/{r['asset']}.png)"]
    stale = [r["asset"] for r in reports if r["source"] != SOURCE]
    if stale:
        text.append(f"Measured with another source than the present one: {', '.join(stale)}.")
    return "\n\n".join(text)


def measured(shot: Shot, options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """A picture made, and what its row of the table needs, kept for a run that was interrupted."""
    asset = load(shot.asset, options.assets)
    kept_at = ROOT / "benchmarks" / "results" / "gallery" / f"{shot.asset}.json"
    settings = [WIDTH, HEIGHT, LINES, CELL, STRIPS, RMSE_PIXELS, REFERENCE_RAYS, repr(shot)]
    key = {"settings": settings, "mesh": mesh_hash(asset), "source": SOURCE}
    path = folder / f"{shot.asset}.png"
    report = kept(kept_at, None if options.report else key)
    if report is not None and path.is_file():
        return report
    stage, camera = staged(shot, asset)
    machine = describe()
    view = stage.seen(camera, HEIGHT, WIDTH)
    found = compared(stage.scene, view)
    places = draw(shot, view, found, path)
    report = {
        "asset": shot.asset,
        "triangles": stage.scene.n_faces,
        "pixels": len(view.points),
        "rays": found.rays,
        "cpu": {side: spent.cpu for side, spent in found.spent.items()},
        "wall": {side: spent.wall for side, spent in found.spent.items()},
        "rmse": found.rmse,
        "noise": found.noise,
        "places": places,
        "machine": machine,
    }
    return keep(kept_at, key, report)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--assets", required=True, help="folder with the meshes")
    parser.add_argument(
        "--only", nargs="+", choices=[s.asset for s in SHOTS], help="some pictures, and no page"
    )
    parser.add_argument(
        "--report", action="store_true", help="keep pictures of other sources, which the page says"
    )
    parser.add_argument(
        "--output",
        default=str(ROOT / "docs" / "gallery"),
        help="folder of the pictures; the page lies beside it",
    )
    options = parser.parse_args()
    try:
        run(options)
    except InputError as error:
        fail(error)


def run(options: argparse.Namespace) -> None:
    shots = [shot for shot in SHOTS if not options.only or shot.asset in options.only]
    for shot in shots:
        find(shot.asset, options.assets)  # before the first one costs anything
    folder = Path(options.output)
    folder.mkdir(parents=True, exist_ok=True)
    reports = []
    for shot in shots:
        reports.append(measured(shot, options, folder))
        print(
            *(f"{key} {value}" for key, value in reports[-1].items() if key != "machine"),
            sep=", ",
            flush=True,
        )
    if not options.only:
        write(str(folder.with_suffix(".md")), page(reports, folder.name))


if __name__ == "__main__":
    main()
