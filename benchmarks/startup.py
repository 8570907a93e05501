"""Cold and warm start: a process that imports silint, builds a small scene and bakes its vertices.

    python benchmarks/startup.py --mesh MESHES/spot.obj

Cold means an empty cache of kernels: everything is compiled. Aims: under 20 s cold, under 2 s warm (spot).
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import common

PROGRAM = """
import sys, time; t0 = time.perf_counter()
import scenes, silint
t1 = time.perf_counter()
source = sys.argv[1]
scene = silint.load_scene(source) if source not in scenes.SCENES else silint.Scene(*scenes.build(source))
silint.ambient_occlusion(scene)
print(t1 - t0, time.perf_counter() - t1)
"""


def start(source: str, environment: dict[str, str]) -> tuple[float, float, float]:
    """Seconds of the import, of reading up to the first result, and of the whole process."""
    began = time.perf_counter()
    command = [sys.executable, "-c", PROGRAM, source]
    out = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    imported, first = map(float, out.stdout.split())
    return imported, first, time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--mesh", default="teapot", help="a generated scene or a mesh file")
    parser.add_argument("--runs", type=int, default=5, help="warm ones, whose median counts")
    options = parser.parse_args()
    try:
        path = common.find(options.mesh)
    except common.InputError as error:
        common.fail(error)
    source = options.mesh if path is None else str(Path(path).resolve())
    with tempfile.TemporaryDirectory() as cache:
        # Warm includes Python's own bytecode, whatever the shell says of it.
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(common.ROOT)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        cold = start(source, environment)
        warm = [start(source, environment) for _ in range(options.runs)]
    medians = tuple(map(statistics.median, zip(*warm, strict=True)))
    rows = [
        [name, *(f"{seconds:.2f}" for seconds in times)]
        for name, times in (("cold (compiling)", cold), ("warm (from the cache)", medians))
    ]
    title = f"start of a process that bakes {Path(source).stem}, s"
    print(common.markdown([title, "import", "to the first result", "process"], rows))


if __name__ == "__main__":
    main()
