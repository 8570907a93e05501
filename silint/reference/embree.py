"""Embree QMC: the opponent that silint is measured against.

Occlusion rays through embreex's own API, in robust mode, on all cores. Directions come from a scrambled
Sobol sequence [Owen 1998; scipy.stats.qmc] that every point shifts digitally (an exclusive or of 32 random
bits per axis). That keeps the stratification of the sequence exactly, where a shift modulo 1
[Cranley & Patterson 1976] blurs it: 4 to 7 % less RMSE, measured at 256 and at 4096 rays. The samples are
walked in Morton order, which the exclusive or maps onto Morton order again, so that neighbouring rays stay
neighbours in Embree's caches; so are the points.

The random bits of a point are a hash of the point, its normal, the seed and the number of the scramble.
A point's value is therefore the same alone or in company, in any order, for any number of threads and any
size of batch; and no ray is aimed exactly at a vertex that faces share, where even robust Embree leaks.

Each thread takes a batch through all three stages (make the rays, query, count), so that cores never wait
for each other and rays never leave the second-level cache's neighbourhood; numba kernels and embreex both
run outside the interpreter's lock.
"""

from __future__ import annotations

import functools
import itertools
import os
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from threading import local
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.reference import rays, sequence
from silint.validation import (
    InputError,
    choice,
    mesh_arrays,
    normals_array,
    points_array,
    positive_int,
    unit_vector,
)

__all__ = ["EmbreeQMC", "ReferenceResult", "ambient_occlusion", "embree_available"]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]

# Rays of one point that are made and summed together. Fixed, so that sums do not depend on the batch size.
BLOCK = 1 << 16

# Rays in a batch: 1.5 MB of origins and directions, about a core's share of the second-level cache. Measured
# between 2^12 and 2^20: flat from 2^14 to 2^18, slower beyond.
BATCH = 1 << 16

MAX_SAMPLES = 1 << 24

# Batches that are kept in memory at a time when Embree is timed alone.
_GROUP = 64


@dataclass(frozen=True)
class ReferenceResult:
    """What Embree QMC found, how sure it is, and how fast it was.

    Attributes
    ----------
    value : ndarray of float64, shape (n,) or (n, 3)
        Mean over all scrambles.
    standard_error : ndarray of float64, same shape
        Of `value`, point by point, from the spread of the independent scrambles; NaN with a single one.
    samples : int
        Rays a point in each scramble.
    scrambles : int
        Independent scrambles; a point took ``samples * scrambles`` rays.
    rays : int
        Rays in all.
    seconds : float
        Wall time of making the rays, tracing and counting them.
    threads : int
        Threads that did it.
    """

    value: FloatArray
    standard_error: FloatArray
    samples: int
    scrambles: int
    rays: int
    seconds: float
    threads: int

    @property
    def rays_per_second(self) -> float:
        """Rays in all over wall time."""
        return self.rays / self.seconds if self.seconds > 0 else float("nan")


class EmbreeQMC:
    """Embree's scene for a mesh, built once, and quasi-Monte Carlo estimates of what its points see.

    Points are taken as they are: displace them first with `embree_points`, or rays hit the surface that
    they start on. Embree computes in float32, to which vertices and points are rounded.

    Parameters
    ----------
    vertices : array_like, shape (V, 3)
        Finite positions within float32's range.
    faces : array_like of int, shape (F, 3)
        Rows of `vertices`.
    threads : int, optional
        Default: as many as numba uses, so that both sides of a comparison have the same cores.
    batch : int
        Rays per query, a power of two; it changes speed alone.

    Raises
    ------
    InputError
        embreex is not installed, or the mesh is not one.

    References
    ----------
    Wald et al., "Embree: a kernel framework for efficient CPU ray tracing", ACM TOG 33(4), 2014.
    """

    def __init__(
        self, vertices: npt.ArrayLike, faces: npt.ArrayLike, *, threads: int | None = None, batch: int = BATCH
    ) -> None:
        rtcore_scene, mesh_construction = _embreex()
        positions, triangles, _ = mesh_arrays(vertices, faces)
        if np.abs(positions).max() > np.finfo(np.float32).max:
            raise InputError(
                "vertices exceed the range of float32, in which Embree computes; scale the mesh down"
            )
        self.threads = _default_threads() if threads is None else positive_int(threads, "threads")
        self.batch = positive_int(batch, "batch")
        # The wrapper keeps no reference to its mesh; Embree holds copies of both arrays.
        self._scene = rtcore_scene.EmbreeScene(robust=True)
        mesh_construction.TriangleMesh(self._scene, positions.astype(np.float32), triangles)
        # Embree builds its hierarchy at the first query; that must happen here and once, not in a race.
        zero = np.zeros((1, 3), np.float32)
        self._scene.run(zero, zero + np.float32(1.0), query="OCCLUDED")

    def ambient_occlusion(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int = 4096,
        seed: int = 0,
        weighting: str = "cosine",
        scrambles: int = 1,
        progress: Progress | None = None,
    ) -> ReferenceResult:
        """Ambient occlusion (cosine) or the visible fraction of the hemisphere (uniform): 1 open, 0 closed.

        Parameters
        ----------
        points, normals : array_like, shape (n, 3)
            Normals of any length.
        samples : int
            Rays a point in each scramble, a power of two.
        seed : int
            Changes every random bit.
        weighting : {"cosine", "uniform"}
            Rays follow the weight, so each counts the same.
        scrambles : int
            Independent repetitions. From two on they give standard errors, from 64 on dependable ones.
        progress : callable, optional
            Called as ``progress(done, total)`` now and then, in rays.

        Returns
        -------
        ReferenceResult
            ``value`` and ``standard_error`` of shape (n,).
        """
        uniform = choice(weighting, "weighting", ("cosine", "uniform")) == "uniform"
        counts, info = self._trace(points, normals, samples, seed, scrambles, uniform, None, progress)
        return _result(counts / info["samples"], **info)

    def sky_view_factor(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        up: npt.ArrayLike = (0.0, 0.0, 1.0),
        samples: int = 4096,
        seed: int = 0,
        scrambles: int = 1,
        progress: Progress | None = None,
    ) -> ReferenceResult:
        """(1/pi) times the integral of max(n.w, 0) over the visible directions with up.w > 0.

        Parameters as for `ambient_occlusion`; `up` of shape (3,). ``value`` has shape (n,).
        """
        sums, info = self._trace(
            points, normals, samples, seed, scrambles, False, unit_vector(up, "up"), progress
        )
        return _result(sums[..., 3] / info["samples"], **info)

    def bent_normals(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int = 4096,
        seed: int = 0,
        scrambles: int = 1,
        progress: Progress | None = None,
    ) -> ReferenceResult:
        """(1/pi) times the integral of V max(n.w, 0) w: ``value`` and ``standard_error`` of shape (n, 3)."""
        sums, info = self._trace(points, normals, samples, seed, scrambles, False, np.zeros(3), progress)
        return _result(sums[..., :3] / info["samples"], **info)

    def bare_rays_per_second(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int = 4096,
        seed: int = 0,
        max_rays: int = 1 << 24,
    ) -> float:
        """Speed of Embree alone: the rays of `ambient_occlusion`, made beforehand; `run` and nothing else.

        On the same threads with the same batches: all of them up to `max_rays`, and beyond that as many,
        evenly spaced. What `rays_per_second` of a result falls short of this is the cost of making and
        counting the rays.
        """
        origins, units, samples = self._checked(points, normals, samples)
        block = min(samples, BLOCK)
        origins, units = _sorted_in_space(origins, units)[1:]
        bits = sequence.point_bits(origins, units, seed, 0)
        first, second = sequence.sobol_bits(samples, seed, 0)
        rows = self._rows(len(origins) * (samples // block), block)
        tasks = list(itertools.product(range(0, samples, block), range(0, len(origins), rows)))
        tasks = tasks[:: -(-len(tasks) * rows * block // max_rays)]
        traced, seconds = 0, 0.0
        with ThreadPoolExecutor(self.threads) as pool:
            # A few at a time, to bound the memory: 100 MB.
            for group in range(0, len(tasks), _GROUP):
                batches = []
                for b, i in tasks[group : group + _GROUP]:
                    part, u = slice(i, i + rows), slice(b, b + block)
                    m = len(origins[part]) * block
                    o, d = np.empty((m, 3), np.float32), np.empty((m, 3), np.float32)
                    rays.make_rays(origins[part], units[part], first[u], second[u], bits[part], False, o, d)
                    batches.append((o, d))
                start = time.perf_counter()
                list(pool.map(lambda batch: self._scene.run(*batch, query="OCCLUDED"), batches))
                seconds += time.perf_counter() - start
                traced += sum(len(o) for o, _ in batches)
        return traced / seconds if seconds else float("nan")

    def _checked(
        self, points: npt.ArrayLike, normals: npt.ArrayLike, samples: int
    ) -> tuple[npt.NDArray[np.float32], FloatArray, int]:
        p, _ = points_array(points)
        n = normals_array(normals, len(p))
        samples = positive_int(samples, "samples", maximum=MAX_SAMPLES)
        if samples & (samples - 1):
            near = 1 << samples.bit_length()
            raise InputError(
                f"samples is {samples}; Sobol sequences are balanced at powers of two: pass {near}"
            )
        # Adding zero turns -0 into 0, which the hash would tell apart.
        return p.astype(np.float32) + np.float32(0.0), n + 0.0, samples

    def _rows(self, total: int, block: int) -> int:
        """Points in a batch: no more than fit it, and few enough that every thread gets several batches."""
        return max(1, min(self.batch // block, -(-total // (4 * self.threads))))

    def _trace(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int,
        seed: int,
        scrambles: int,
        uniform: bool,
        up: FloatArray | None,
        progress: Progress | None,
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Open rays per scramble and point: (R, n), or with `up` sums (R, n, 4) of w and of [up.w > 0]."""
        origins, units, samples = self._checked(points, normals, samples)
        scrambles = positive_int(scrambles, "scrambles")
        seed = positive_int(seed, "seed", minimum=0, maximum=2**63 - 1)
        n, block = len(origins), min(samples, BLOCK)
        sets = [sequence.sobol_bits(samples, seed, r) for r in range(scrambles)]
        start = time.perf_counter()
        order, origins, units = _sorted_in_space(origins, units)
        bits = [sequence.point_bits(origins, units, seed, r) for r in range(scrambles)]
        rows = self._rows(n * scrambles * (samples // block), block)
        out = np.zeros((scrambles, samples // block, n) + (() if up is None else (4,)), np.float64)
        scratch = local()

        def work(r: int, b: int, i: int) -> int:
            if not hasattr(scratch, "origins"):
                scratch.origins = np.empty((rows * block, 3), np.float32)
                scratch.directions = np.empty((rows * block, 3), np.float32)
            part = slice(i, min(i + rows, n))
            m = (part.stop - i) * block
            o, d = scratch.origins[:m], scratch.directions[:m]
            u = slice(b * block, (b + 1) * block)
            rays.make_rays(
                origins[part], units[part], sets[r][0][u], sets[r][1][u], bits[r][part], uniform, o, d
            )
            hits = self._scene.run(o, d, query="OCCLUDED")
            if up is None:
                rays.count_open(hits, out[r, b, part])
            else:
                rays.sum_open(hits, d, up, out[r, b, part])
            return m

        tasks = itertools.product(range(scrambles), range(samples // block), range(0, n, rows))
        total = n * samples * scrambles
        with ThreadPoolExecutor(self.threads) as pool:
            pending = {pool.submit(work, *task) for task in tasks}
            done_rays = 0
            try:
                while pending:
                    done, pending = wait(pending, timeout=0.2, return_when=FIRST_EXCEPTION)
                    done_rays += sum(f.result() for f in done)
                    if progress is not None:
                        progress(done_rays, total)
            except BaseException:
                # Ctrl-C included: what has not started never will.
                for future in pending:
                    future.cancel()
                raise
        # Blocks are added in their order, whichever thread did them; points go back to theirs.
        sums = np.empty_like(out[:, 0])
        sums[:, order] = functools.reduce(np.add, out.swapaxes(0, 1))
        info = {
            "samples": samples,
            "scrambles": scrambles,
            "rays": total,
            "seconds": time.perf_counter() - start,
            "threads": self.threads,
        }
        return sums, info


def ambient_occlusion(
    scene: Any,
    points: npt.ArrayLike,
    normals: npt.ArrayLike,
    samples: int = 4096,
    seed: int = 0,
    weighting: str = "cosine",
    scrambles: int = 1,
    displace: bool = True,
) -> ReferenceResult:
    """Ambient occlusion by Embree QMC, in one call; see `EmbreeQMC.ambient_occlusion`.

    Parameters
    ----------
    scene : Scene
        Anything with `vertices` (V, 3) and `faces` (F, 3).
    points, normals : array_like, shape (n, 3)
    samples, seed, weighting, scrambles
        See `EmbreeQMC.ambient_occlusion`.
    displace : bool
        Move the points off the surface first, as far as Embree needs (`embree_points`). Pass False for
        points that have been displaced already.

    Returns
    -------
    ReferenceResult
        ``value`` of shape (n,), 1 open and 0 closed.
    """
    from silint.reference.displacement import embree_points

    qmc = EmbreeQMC(scene.vertices, scene.faces)
    if displace:
        points = embree_points(scene.vertices, scene.faces, points, normals)
    return qmc.ambient_occlusion(points, normals, samples, seed, weighting, scrambles)


def embree_available() -> bool:
    """Whether embreex can be imported here."""
    try:
        _embreex()
    except InputError:
        return False
    return True


def _embreex() -> tuple[Any, Any]:
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError as error:
        raise InputError(
            f"comparing with Embree needs the package embreex, which cannot be imported here ({error}); "
            "run `pip install embreex` where a wheel exists, or leave the comparison out"
        ) from None
    return rtcore_scene, mesh_construction


def _default_threads() -> int:
    import numba

    return min(int(numba.get_num_threads()), os.cpu_count() or 1)


def _sorted_in_space(
    origins: npt.NDArray[np.float32], units: FloatArray
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float32], FloatArray]:
    """Consecutive batches should meet the same part of the scene."""
    order = sequence.space_order(origins)
    return order, origins[order], units[order]


def _result(per_scramble: FloatArray, **info: Any) -> ReferenceResult:
    # Scrambles last and contiguous: NumPy then sums each point's the same way for one point as for many.
    estimates = np.ascontiguousarray(np.moveaxis(per_scramble, 0, -1))
    scrambles = info["scrambles"]
    value = estimates.mean(axis=-1)
    if scrambles > 1:
        error = estimates.std(axis=-1, ddof=1) / np.sqrt(scrambles)
    else:
        error = np.full_like(value, np.nan)
    return ReferenceResult(value=value, standard_error=error, **info)
