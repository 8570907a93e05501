"""Public functions may be called by many threads, on numba's simplest threading layer as well.

That layer ends the process when two threads run parallel kernels at a time: hence a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from silint.core.jit import KERNEL_LOCK

# One task for each public function that runs a parallel kernel; all at once, and each against its own first
# answer.
_SCRIPT = """
import sys
from concurrent.futures import ThreadPoolExecutor
import numba, numpy as np
from silint import Environment, Visibility, sh
from silint.core.runs import horizon_runs
from silint import prefix_table

rng = np.random.default_rng(0)
normals = rng.normal(size=(400, 3))
points = rng.uniform(-1, 1, (400, 3))
normals /= np.linalg.norm(normals, axis=1)[:, None]
vis = Visibility(normals, 16, *horizon_runs(normals, 16))
env = Environment.from_array(rng.random((64, 128, 3)))
table = prefix_table(lambda w: w, 16, 32)
coefficients = rng.normal(size=(5000, 25))
tasks = [
    lambda: sh.evaluate(np.tile(normals, (20, 1)), 6),
    lambda: sh.project(lambda w: w[:, 0], 6),
    lambda: sh.project_samples(normals, points[:, 0], 3),
    lambda: sh.rotate(coefficients, ((1, 2, 3), 40)),
    lambda: sh.rotation_blocks(((1, 2, 3), 40), 12)[12],
    lambda: env.irradiance(normals),
    lambda: env.sh(2),
    lambda: env.rotated(np.eye(3)).moment_table(16).table.values,
    vis.ambient_occlusion,
    vis.bent_normals,
    vis.sky_view_factor,
    vis.sh_transfer,
    lambda: vis.irradiance(env),
    lambda: vis.integrate(table),
]
expected = [task() for task in tasks]
assert numba.threading_layer() == "workqueue" and numba.get_num_threads() == 2
rounds = list(range(len(tasks))) * 20
rng.shuffle(rounds)
with ThreadPoolExecutor(4) as pool:
    for i, found in zip(rounds, pool.map(lambda i: tasks[i](), rounds)):
        np.testing.assert_array_equal(found, expected[i])
"""


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"), reason="no kernels")
def test_public_functions_from_many_threads() -> None:
    environment = {**os.environ, "NUMBA_THREADING_LAYER": "workqueue", "NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT], env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_lock_may_be_taken_twice_by_one_thread() -> None:
    with KERNEL_LOCK, KERNEL_LOCK:
        pass
