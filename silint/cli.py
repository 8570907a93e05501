"""The command line: demo, bake, prt, bench, info.

Only typer is imported before a command runs, so that help and mistakes answer at once. Whatever the user
can get wrong ends as one line on stderr and exit code 2; Ctrl-C as exit code 130.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any

import typer

from silint import __version__

if TYPE_CHECKING:
    from rich.progress import Progress

__all__ = ["app", "main"]

EXIT_INPUT, EXIT_INTERRUPTED, EXIT_BUG = 2, 130, 1

app = typer.Typer(
    name="silint",
    help="Noise-free ambient occlusion and sky visibility of triangle meshes, from silhouettes, not rays.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

JsonFlag = Annotated[bool, typer.Option("--json", help="Print the results as JSON on stdout.")]


def main() -> None:
    """Run the command line; the entry point of the package."""
    # OpenMP's idle threads spin by default and take the cores from whatever else runs: several times slower
    # on a busy machine, no faster on a quiet one. It reads this when it starts, which it has not yet.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    _stop_at_ctrl_c()
    sys.exit(_run(sys.argv[1:]))


def _run(arguments: list[str]) -> int:
    """Exit code of a command line, with every expected failure told in one line on stderr."""
    # ValueErrors that are not InputErrors are bugs, and look like bugs.
    from silint.validation import InputError

    try:
        code = app(args=arguments or ["--help"], prog_name="silint", standalone_mode=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except InputError as error:
        return _fail(str(error))
    except (KeyboardInterrupt, typer.Abort):
        return EXIT_INTERRUPTED
    except typer.Exit as stop:
        return int(stop.exit_code)
    except BrokenPipeError:
        # The reader of our output has gone (`silint info x | head`): end quietly, as typer does itself where
        # it notices first. Python's own flush at exit must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except MemoryError:
        return _fail("out of memory; use a smaller mesh or fewer isolines")
    except Exception as error:
        # typer's and click's usage errors come from whichever of the two this version of typer is built on.
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            return _fail(f"{error.format_message()} (try 'silint --help')")
        if os.environ.get("SILINT_DEBUG"):
            raise
        print(
            f"silint: internal error, please report it: {type(error).__name__}: {_one_line(str(error))} "
            "(SILINT_DEBUG=1 shows where)",
            file=sys.stderr,
        )
        return EXIT_BUG


def _stop_at_ctrl_c() -> None:
    """Make Ctrl-C end the process at once, whatever it is doing.

    Python's own way, an exception in the main thread, has to wait until compiled code returns, and is lost
    when it strikes inside one of the compiler's callbacks (measured: the demo then ran to its end). Here a
    thread waits for the signal, removes what is half-written, and leaves.
    """
    import signal
    import socket
    import threading

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return  # somebody else's business, or ignored as under nohup
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)

    def wait(sender: socket.socket) -> None:  # the argument keeps the socket alive
        while receiver.recv(1)[0] != signal.SIGINT:
            pass
        if "silint.io" in sys.modules:
            from silint.io.write import discard_unfinished

            discard_unfinished()
        # Progress bars hide the cursor; and the shell's prompt belongs on a line of its own.
        told = "\x1b[?25h\n" if os.isatty(2) else ""
        os.write(2, f"{told}silint: interrupted, nothing is left half-written\n".encode())
        os._exit(EXIT_INTERRUPTED)

    threading.Thread(target=wait, args=(sender,), daemon=True).start()


def _fail(message: str) -> int:
    print(f"silint: error: {_one_line(message)}", file=sys.stderr)
    return EXIT_INPUT


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"silint {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Noise-free ambient occlusion and sky visibility of triangle meshes, from silhouettes, not rays."""


@app.command("demo")
def _demo(
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Where to write.")] = "silint-demo",
    as_json: JsonFlag = False,
) -> None:
    """Bake the packaged scene, compare with Embree, draw a picture."""
    with _bar() as bar:
        from silint.demo import demo

        summary = demo(out, progress=_stages(bar))
    if as_json:
        _print_json(summary)
        return
    seconds = summary["seconds"]
    print(
        f"baked ambient occlusion at {summary['n_points']:,} vertices of {summary['n_faces']:,} triangles: "
        f"{seconds['bake']:.1f} s {_with_lines(summary['isolines'])}"
    )
    _print_comparison(summary["comparison"])
    for file in summary["files"]:
        print(f"wrote {file}")


@app.command("bake")
def _bake(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT", help=".npz .ply .glb")],
    quantity: Annotated[
        str, typer.Option(help="ao, sky (sky view factor), bent (bent normals), irradiance, or sh (as prt).")
    ] = "ao",
    per: Annotated[str, typer.Option(help="vertex or face.")] = "vertex",
    isolines: Annotated[int | None, typer.Option(help="More are more accurate; 64 by default.")] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="In place of isolines: as many as every point needs.")
    ] = None,
    method: Annotated[str, typer.Option(help="auto, radial, octahedral or exact.")] = "auto",
    weighting: Annotated[str, typer.Option(help="Of ao: cosine or uniform.")] = "cosine",
    up: Annotated[tuple[float, float, float], typer.Option(help="Of sky: where it is.")] = (0.0, 0.0, 1.0),
    envmap: Annotated[
        str | None, typer.Option(metavar="MAP", help="Of irradiance: .hdr .exr .png .jpg.")
    ] = None,
    envmap_up: Annotated[str, typer.Option(help="Where the map's top goes: y or z.")] = "y",
    envmap_rotate: Annotated[float, typer.Option(help="Degrees about that axis.")] = 0.0,
    as_json: JsonFlag = False,
) -> None:
    """Bake ambient occlusion, sky view factors, bent normals or irradiance of a mesh into a file."""
    if quantity == "sh" and tolerance is None and envmap is None:
        _prt(mesh, output, per=per, isolines=isolines, method=method, weighting=weighting, as_json=as_json)
        return
    with _bar() as bar:
        from silint.bake import bake
        from silint.environment import Environment

        environment = None if envmap is None else Environment.from_file(envmap, envmap_up, envmap_rotate)
        summary = bake(
            mesh,
            output,
            quantity,
            per,
            isolines,
            method,
            weighting,
            up,
            tolerance,
            progress=_stage(bar, "baking"),
            environment=environment,
        )
    if as_json:
        _print_json(summary)
        return
    sites = "vertices" if per == "vertex" else "faces"
    meaning = "luminance of radiance x sr" if quantity == "irradiance" else "1 is open, 0 is closed"
    print(
        f"{quantity} at {summary['n_points']:,} {sites}: mean {summary['mean']:.4f}, "
        f"from {summary['min']:.4f} to {summary['max']:.4f}; {meaning}"
    )
    if summary["without_normal"]:
        told = "1" if quantity in ("ao", "sky") else "0"
        print(f"{summary['without_normal']:,} {sites} have no normal and got {told}")
    _print_costs(summary)
    print(f"wrote {output}")


@app.command("prt")
def _prt(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    output: Annotated[str, typer.Option("-o", "--output", metavar="OUT", help=".npz .ply .glb, or a folder")],
    max_degree: Annotated[int, typer.Option(help="0 to 16, of spherical harmonics.")] = 2,
    per: Annotated[str, typer.Option(help="vertex or face.")] = "vertex",
    isolines: Annotated[int | None, typer.Option(help="More are more accurate; 64 by default.")] = None,
    method: Annotated[str, typer.Option(help="auto, radial, octahedral or exact.")] = "auto",
    weighting: Annotated[str, typer.Option(help="cosine or uniform.")] = "cosine",
    as_json: JsonFlag = False,
) -> None:
    """Bake transfer coefficients (PRT) of a mesh into a file: lighting by dot product.

    A folder gets bounce/bounce0.txt and bounce/face.npy, as computePRT of PIFu writes them.
    """
    with _bar() as bar:
        from silint.prt import prt_file

        summary = prt_file(
            mesh, output, max_degree, per, isolines, weighting, method, progress=_stage(bar, "baking")
        )
    if as_json:
        _print_json(summary)
        return
    sites = "vertices" if per == "vertex" else "faces"
    openness = summary["openness"]
    print(
        f"transfer of degree {max_degree} ({summary['n_coefficients']} coefficients, {weighting}) at "
        f"{summary['n_points']:,} {sites}: openness {openness['mean']:.4f}, "
        f"from {openness['min']:.4f} to {openness['max']:.4f}; 1 is open, 0 is closed"
    )
    if summary["without_normal"]:
        print(f"{summary['without_normal']:,} {sites} have no normal and got 0")
    _print_costs(summary)
    for file in summary["files"]:
        print(f"wrote {file['path']} ({file['bytes']:,} bytes)")


@app.command("bench")
def _bench(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="[MESH]...", help="The packaged scene if there is none.")
    ] = None,
    points: Annotated[int | None, typer.Option(help="How many, spread over the surface.")] = None,
    isolines: Annotated[str | None, typer.Option(metavar="N,N,...", help="silint's settings.")] = None,
    rays: Annotated[str | None, typer.Option(metavar="N,N,...", help="Embree's settings.")] = None,
    weighting: Annotated[str, typer.Option(help="cosine or uniform.")] = "cosine",
    quantity: Annotated[str, typer.Option(help="ao, irradiance (with --envmap), or sh.")] = "ao",
    envmap: Annotated[
        str | None, typer.Option(metavar="MAP", help="Of irradiance: .hdr .exr .png .jpg.")
    ] = None,
    envmap_up: Annotated[str, typer.Option(help="Where the map's top goes: y or z.")] = "y",
    max_degree: Annotated[int, typer.Option(help="Of sh: 0 to 16.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the points and the rays.")] = 0,
    repeats: Annotated[int | None, typer.Option(help="Rounds; the median of their times counts.")] = None,
    seconds: Annotated[float | None, typer.Option(help="Time to spend on each scene's timings.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer points, rays and rounds.")] = False,
    json_file: Annotated[str | None, typer.Option("--json", metavar="FILE", help="Write a report.")] = None,
    plot_file: Annotated[str | None, typer.Option("--plot", metavar="FILE", help="Draw a figure.")] = None,
) -> None:
    """Measure error against run time, silint and Embree QMC side by side."""
    with _bar() as bar:
        from silint.bench import bench_command, print_tables

        report = bench_command(
            scenes or (),
            points=points,
            isolines=isolines,
            rays=rays,
            weighting=weighting,
            quantity=quantity,
            envmap=envmap,
            envmap_up=envmap_up,
            max_degree=max_degree,
            seed=seed,
            repeats=repeats,
            seconds=seconds,
            quick=quick,
            json_file=json_file,
            plot_file=plot_file,
            progress=_stages(bar),
        )
    print_tables(report)
    for file in (json_file, plot_file):
        if file is not None:
            print(f"wrote {file}")


@app.command("info")
def _info(
    mesh: Annotated[str, typer.Argument(metavar="MESH", help=".obj .ply .stl .glb .gltf .off")],
    as_json: JsonFlag = False,
) -> None:
    """Tell a mesh's size and topology defects, the memory it takes, and the plan for it."""
    with _bar() as bar:
        bar.add_task("reading and building", total=None)
        from silint.integrator import SilhouetteIntegrator
        from silint.scene import load_scene

        scene = load_scene(mesh)
        integrator = SilhouetteIntegrator(scene)
        plan, memory, defects = integrator.plan, integrator.memory, scene.defects
        low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    per_triangle = sum(memory.values()) / scene.n_faces
    if as_json:
        _print_json(
            {
                "mesh": mesh,
                "n_vertices": scene.n_vertices,
                "n_faces": scene.n_faces,
                "bounds": [low.tolist(), high.tolist()],
                "float32_source": scene.float32_source,
                "normals": "file" if scene.normals is not None else "computed",
                "defects": defects,
                "memory": memory,
                "bytes_per_triangle": per_triangle,
                "plan": plan.as_dict(),
            }
        )
        return
    precision = "float32" if scene.float32_source else "float64"
    origin = "in the file" if scene.normals is not None else "none in the file: angle-weighted"
    print(f"{mesh}: {scene.n_faces:,} triangles, {scene.n_vertices:,} vertices ({precision})")
    print(f"bounds   {_vector(low)} to {_vector(high)}")
    print(f"normals  {origin}")
    print("defects  (counted, not repaired)")
    width = max(len(name) for name in defects)
    for name, count in defects.items():
        print(f"  {name.replace('_', ' '):<{width}} {count:>12,}")
    print(f"memory   {per_triangle:.0f} bytes a triangle of topology and hierarchies")
    for name, n_bytes in memory.items():
        print(f"  {name:<{width}} {n_bytes:>12,}")
    print(f"plan     {plan}")


def _print_comparison(comparison: dict[str, Any] | None) -> None:
    if comparison is None:
        print("no comparison with Embree: the package embreex is not installed here")
        return
    from rich.console import Console
    from rich.table import Table

    reference = comparison["reference"]
    table = Table()
    table.add_column("")
    for heading in ("a point", "time", "RMSE", "worst"):
        table.add_column(heading, justify="right")
    for row in comparison["rows"]:
        lines = f"{row['isolines']} isolines" if row["method"] == "silint" else f"{row['rays']} rays"
        name = {"silint": "silint", "embree": "Embree QMC"}[row["method"]]
        # What the reference cannot tell from its own noise is a bound, not a figure.
        rmse = f"{row['rmse']:.1e}" if row["resolved"] else f"< {4.0 * reference['standard_error']:.1e}"
        table.add_row(name, lines, f"{1e3 * row['seconds']:.0f} ms", rmse, f"{row['max']:.1e}")
    Console(width=None if sys.stdout.isatty() else 100, highlight=False).print(table)
    print(
        f"{comparison['n_points']} points, {comparison['threads']} threads; "
        f"truth: Embree with {reference['rays']:,} rays a point"
    )


def _print_costs(summary: dict[str, Any]) -> None:
    """Time and memory of a bake."""
    seconds = summary["seconds"]
    print(
        f"read {seconds['load']:.2f} s, built {seconds['build']:.2f} s, "
        f"integrated {seconds['integrate']:.2f} s {_with_lines(summary['isolines'])}"
    )
    if summary["peak_memory_bytes"]:
        print(f"at most {summary['peak_memory_bytes'] / 2**20:,.0f} MiB of memory")


def _with_lines(isolines: int) -> str:
    return f"with {isolines} isolines" if isolines else "exactly"


def _vector(v: Any) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in v) + ")"


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2))


@contextmanager
def _bar() -> Iterator[Progress]:
    """Progress on stderr where that is a terminal, and nothing at all elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        yield bar


def _stage(bar: Progress, name: str) -> Callable[[int, int], None]:
    update = _stages(bar)
    update(name, 0, 0)
    return lambda done, total: update(name, done, total)


def _stages(bar: Progress) -> Callable[[str, int, int], None]:
    tasks: dict[str, Any] = {}

    def update(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=None)
        bar.update(tasks[stage], completed=done, total=total or None)

    return update


if __name__ == "__main__":
    main()
