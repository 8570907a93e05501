"""Cold and warm start: a process that imports silint, builds a small scene and bakes its vertices.

python benchmarks/startup.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

import common

PROGRAM = """
import time; t0 = time.perf_counter()
import scenes, silint
t1 = time.perf_counter()
vertices, faces = scenes.build("teapot")
silint.ambient_occlusion(silint.Scene(vertices, faces))
t2 = time.perf_counter()
print(f"import {t1 - t0:.2f} s, first ambient occlusion {t2 - t1:.2f} s")
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONPATH": str(common.ROOT)}
        for name in ("cold (compiling)", "warm (from the cache)"):
            began = time.perf_counter()
            command = [sys.executable, "-c", PROGRAM]
            out = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
            print(f"{name}: {out.stdout.strip()}, process {time.perf_counter() - began:.2f} s")


if __name__ == "__main__":
    main()
