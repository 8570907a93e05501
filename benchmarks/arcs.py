"""What phase two of the exact mode costs an arc, by integrand.

    python benchmarks/arcs.py
    python benchmarks/arcs.py --page docs/exact.md

Arcs are made up, of lengths as silhouettes of finely tessellated meshes have them; phase two does not see
where they come from. Processor time of one thread, so that a busy machine does not matter much: medians of
rounds.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from common import insert, markdown  # sets the cache, before numba starts

from silint.core.arcs_types import Arcs
from silint.core.integrands import arcs as by_arcs
from silint.core.integrands import arcs_sh

# Median length, rad, and standard deviation of the logarithm.
LENGTH, SPREAD = 0.01, 1.0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=250)
    parser.add_argument("--arcs", type=int, default=400, help="a point")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--page", help="a markdown file with a place for the table")
    options = parser.parse_args()
    import numba

    numba.set_num_threads(1)
    arcs = some_arcs(options.points, options.arcs)
    up = np.array([0.0, 0.0, 1.0])
    integrands: dict[str, Callable[[], object]] = {
        "ambient occlusion, cosine": lambda: by_arcs.hemisphere_fraction(arcs, "cosine"),
        "ambient occlusion, uniform": lambda: by_arcs.hemisphere_fraction(arcs, "uniform"),
        "bent normal": lambda: by_arcs.bent_normal(arcs),
        "sky view factor": lambda: by_arcs.sky_view_factor(arcs, up),
    }
    for degree in (2, 4, 8, 10, 16):
        integrands[f"SH transfer, cosine, degree {degree}"] = lambda degree=degree: arcs_sh.sh_transfer(
            arcs, degree, "cosine"
        )
    each = 1e9 / len(arcs.directions)
    rows = [[name, f"{each * cost(run, options.rounds):.0f}"] for name, run in integrands.items()]
    table = markdown(["integrand", "ns an arc"], rows)
    print(table)
    if options.page:
        insert(options.page, "arcs", table)


def some_arcs(points: int, arcs: int) -> Arcs:
    """Boundaries that do not close, above random horizons."""
    rng = np.random.default_rng(0)
    normals = unit(rng.normal(size=(points, 3)))
    n = np.repeat(normals, arcs, axis=0)
    a = unit(rng.normal(size=n.shape))
    a *= np.where((a * n).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    across = unit(np.cross(a, rng.normal(size=n.shape)))
    length = np.minimum(LENGTH * rng.lognormal(0.0, SPREAD, size=(len(n), 1)), 1.5)
    b = np.cos(length) * a + np.sin(length) * across
    directions = np.concatenate([a, b, unit(np.cross(a, across))], axis=1)
    counts = np.full(points, arcs)
    return Arcs(
        np.zeros((points, 3)),
        normals,
        counts,
        np.cumsum(counts) - counts,
        directions,
        np.zeros((len(n), 2), np.int32),
    )


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def cost(run: Callable[[], object], rounds: int) -> float:
    """Median of processor seconds, after a call that compiles."""
    run()
    seconds = []
    for _ in range(rounds):
        start = time.process_time()
        run()
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


if __name__ == "__main__":
    main()
