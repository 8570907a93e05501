"""How kernels are compiled and shared out to threads."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import numba
import pytest

from silint.core.jit import each_block


@pytest.fixture(params=[1, 2])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    before = numba.get_num_threads()
    numba.set_num_threads(min(request.param, numba.config.NUMBA_NUM_THREADS))
    yield numba.get_num_threads()
    numba.set_num_threads(before)


@pytest.mark.parametrize("n_blocks", [0, 1, 2, 37])
def test_each_block_is_done_once(threads: int, n_blocks: int) -> None:
    done: list[tuple[str, int]] = []
    each_block(lambda name, block: done.append((name, block)), n_blocks, "given")
    assert sorted(done) == [("given", block) for block in range(n_blocks)]


def test_as_many_threads_work_as_numba_is_set_to(threads: int) -> None:
    # Each waits for the others: were they fewer, it would wait in vain.
    all_there = threading.Barrier(threads, timeout=30.0)
    each_block(lambda block: all_there.wait() and None, threads)
    assert all_there.n_waiting == 0 and not all_there.broken


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_error_ends_the_loop(threads: int, error: type[BaseException]) -> None:
    done = []

    def kernel(block: int) -> None:
        done.append(block)
        if block == 3:
            raise error("of block 3")

    with pytest.raises(error, match="of block 3"):
        each_block(kernel, 100_000)
    assert 4 <= len(done) < 100_000


# What only a maximum distance needs, as modules and names of their functions.
_OF_DISTANCES = {
    "sphere_search": ("gather_faces", "find_faces", "walk_faces"),
    "sphere_cuts": ("cross_sphere",),
    "caps": ("cap_on_line", "crosses_near", "clip_lines"),
    "filters": ("near_mask", "near_edge_mask", "near_packet_mask"),
    "zenith": ("near_zenith_counts",),
    "cuts": ("keep_near", "farthest_corners", "meets_near"),
}
_BAKE = f"""
import importlib
import numpy as np, silint
vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
integrator = silint.SilhouetteIntegrator(silint.Scene(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
for cover in (False, True):
    integrator._finder._cover = cover
    if cover:
        from silint.core.visible import _with_corners
        integrator._finder.bundles = _with_corners(integrator._finder.bundles, integrator._finder.geometry)
    assert integrator.ambient_occlusion([[2.0, 2, 2]], [[0, 0, 1.0]])[0] == 1.0
    names = ("radial_sweep", "radial_intervals"), ("radial_cover", "covered_radial_intervals")
    module, name = names[cover]
    assert getattr(importlib.import_module(f"silint.core.{{module}}"), name).overloads
for module, names in {_OF_DISTANCES!r}.items():
    for name in names:
        assert not getattr(importlib.import_module(f"silint.core.{{module}}"), name).overloads, name
"""


@pytest.mark.slow
def test_without_a_distance_nothing_of_it_is_compiled(tmp_path: os.PathLike[str]) -> None:
    """Half of the cold start of every process, if it were."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "0"}
    done = subprocess.run(
        [sys.executable, "-c", _BAKE], env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]
