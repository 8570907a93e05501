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
from threading import local
from typing import Any

import numpy as np
import numpy.typing as npt

from silint.reference import estimators, sequence
from silint.reference.estimators import Estimator, RayBuffers
from silint.reference.result import ReferenceResult, combined
from silint.validation import (
    InputError,
    choice,
    mesh_arrays,
    normals_array,
    points_array,
    positive_int,
    positive_number,
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

MAX_DEGREE = 16  # of spherical harmonics

# Batches that are kept in memory at a time when Embree is timed alone.
_GROUP = 64


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
        self._sampler: tuple[Any, Any, str, Any] | None = None  # of the latest environment

    def ambient_occlusion(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int = 4096,
        seed: int = 0,
        weighting: str = "cosine",
        scrambles: int = 1,
        progress: Progress | None = None,
        max_distance: float = np.inf,
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
        max_distance : float
            Where rays end.

        Returns
        -------
        ReferenceResult
            ``value`` and ``standard_error`` of shape (n,).
        """
        uniform = choice(weighting, "weighting", ("cosine", "uniform")) == "uniform"
        estimator = estimators.OpenShare(uniform)
        if max_distance != np.inf:
            max_distance = positive_number(max_distance, "max_distance")
        traced = self._trace(points, normals, samples, seed, scrambles, estimator, progress, max_distance)
        counts, info = traced
        return combined(counts / info["samples"], **info)

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
        estimator = estimators.OpenDirections(unit_vector(up, "up"))
        sums, info = self._trace(points, normals, samples, seed, scrambles, estimator, progress)
        return combined(sums[..., 3] / info["samples"], **info)

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
        estimator = estimators.OpenDirections(np.zeros(3))
        sums, info = self._trace(points, normals, samples, seed, scrambles, estimator, progress)
        return combined(sums[..., :3] / info["samples"], **info)

    def sh_transfer(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        max_degree: int = 4,
        samples: int = 4096,
        seed: int = 0,
        weighting: str = "cosine",
        scrambles: int = 1,
        progress: Progress | None = None,
    ) -> ReferenceResult:
        """Visibility in spherical harmonics up to a degree; conventions in `silint.core.conventions`.

        Parameters
        ----------
        max_degree : int
            L, 0 to 16.
        weighting : {"cosine", "uniform"}
            (1/pi) int V max(n.w, 0) Y_lm dw, or int V Y_lm dw over the hemisphere of n.
        points, normals, samples, seed, scrambles, progress
            As for `ambient_occlusion`.

        Returns
        -------
        ReferenceResult
            ``value`` and ``standard_error`` of shape (n, (L + 1)^2).
        """
        uniform = choice(weighting, "weighting", ("cosine", "uniform")) == "uniform"
        estimator = estimators.Harmonics(uniform, positive_int(max_degree, "max_degree", 0, MAX_DEGREE))
        sums, info = self._trace(points, normals, samples, seed, scrambles, estimator, progress)
        return combined(sums * ((2.0 * np.pi if uniform else 1.0) / info["samples"]), **info)

    def irradiance(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        environment: Any,
        samples: int = 4096,
        seed: int = 0,
        scrambles: int = 1,
        progress: Progress | None = None,
        sampling: str = "mis",
    ) -> ReferenceResult:
        """int L V max(n.w, 0) dw by multiple importance sampling [Veach & Guibas 1995].

        Half of the samples follow the cosine, half the light of the map, combined by the balance heuristic:
        good under an even sky and under a sun. Samples of the light below the horizon of a point cost no ray.

        Parameters
        ----------
        environment : silint.Environment
            Its tables are built at the first call and kept for the next with the same one.
        samples : int
            A point in each scramble, of both kinds together: a power of two, 2 at least.
        points, normals, seed, scrambles, progress
            As for `ambient_occlusion`.
        sampling : {"mis", "cosine"}
            "cosine": all samples follow the cosine, as they do under a constant sky, where there is nothing
            to aim at.

        Returns
        -------
        ReferenceResult
            ``value`` and ``standard_error`` of shape (n, 3), in radiance times steradians.
        """
        estimator = self._light(environment, choice(sampling, "sampling", ("mis", "cosine")))
        sums, info = self._trace(points, normals, samples, seed, scrambles, estimator, progress)
        return combined(sums * (estimator.light.scale * estimator.streams / info["samples"]), **info)

    def bare_rays_per_second(
        self,
        points: npt.ArrayLike,
        normals: npt.ArrayLike,
        samples: int = 4096,
        seed: int = 0,
        max_rays: int = 1 << 24,
        environment: Any = None,
    ) -> float:
        """Speed of Embree alone: the rays of `ambient_occlusion`, made beforehand; `run` and nothing else.

        On the same threads with the same batches: all of them up to `max_rays`, and beyond that as many,
        evenly spaced. What `rays_per_second` of a result falls short of this is the cost of making and
        counting the rays. With an environment, the rays of `irradiance`.
        """
        estimator: Estimator = estimators.OpenShare(False)
        if environment is not None:
            estimator = self._light(environment, "mis")
        origins, units, samples = self._checked(points, normals, samples, estimator.streams)
        each = samples // estimator.streams
        block = min(each, BLOCK)
        origins, units = _sorted_in_space(origins, units)[1:]
        sets = [sequence.sobol_bits(each, seed, s) for s in range(estimator.streams)]
        shifts = [sequence.point_bits(origins, units, seed, s) for s in range(estimator.streams)]
        rows = self._rows(len(origins) * (samples // block), block)
        tasks = list(
            itertools.product(range(estimator.streams), range(0, each, block), range(0, len(origins), rows))
        )
        tasks = tasks[:: -(-len(tasks) * rows * block // max_rays)]
        traced, seconds = 0, 0.0
        with ThreadPoolExecutor(self.threads) as pool:
            # A few at a time, to bound the memory: 150 MB.
            for group in range(0, len(tasks), _GROUP):
                batches = []
                for s, b, i in tasks[group : group + _GROUP]:
                    part = slice(i, min(i + rows, len(origins)))
                    made = RayBuffers(part.stop - i, block)
                    samples_of = sets[s][0][b : b + block], sets[s][1][b : b + block]
                    m = estimator.make(s, origins[part], units[part], samples_of, shifts[s][part], made)
                    batches.append((made.origins[:m], made.directions[:m]))
                start = time.perf_counter()
                list(pool.map(lambda batch: self._hits(*batch), batches))
                seconds += time.perf_counter() - start
                traced += sum(len(o) for o, _ in batches)
        return traced / seconds if seconds else float("nan")

    def _light(self, environment: Any, sampling: str) -> estimators.Light:
        """The estimator of irradiance, with the tables of the latest environment where it is that one."""
        key = getattr(environment, "texel_radiance", None), getattr(environment, "rotation", None), sampling
        kept = self._sampler
        if kept is None or any(a is not b for a, b in zip(kept, key, strict=False)):
            sampler = estimators.sampler_of(environment, sampling == "mis")
            self._sampler = kept = (*key, sampler)
        return estimators.Light(kept[3])

    def _hits(
        self,
        origins: npt.NDArray[np.float32],
        directions: npt.NDArray[np.float32],
        max_distance: float = np.inf,
    ) -> npt.NDArray[Any]:
        """Negative for each ray that meets nothing."""
        if not len(origins):
            return np.empty(0, np.int32)
        if max_distance < np.inf:
            ends = np.full(len(origins), max_distance, np.float32)
            return np.asarray(self._scene.run(origins, directions, dists=ends, query="OCCLUDED"))
        return np.asarray(self._scene.run(origins, directions, query="OCCLUDED"))

    def _checked(
        self, points: npt.ArrayLike, normals: npt.ArrayLike, samples: int, fewest: int
    ) -> tuple[npt.NDArray[np.float32], FloatArray, int]:
        p, _ = points_array(points)
        n = normals_array(normals, len(p))
        samples = positive_int(samples, "samples", fewest, MAX_SAMPLES)
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
        estimator: Estimator,
        progress: Progress | None,
        max_distance: float = np.inf,
    ) -> tuple[FloatArray, dict[str, Any]]:
        """An estimator's sums per scramble and point, (R, n, ...), and what a result tells of the run."""
        origins, units, samples = self._checked(points, normals, samples, estimator.streams)
        scrambles = positive_int(scrambles, "scrambles")
        seed = positive_int(seed, "seed", minimum=0, maximum=2**63 - 1)
        streams = scrambles * estimator.streams  # all of them independent
        n, each = len(origins), samples // estimator.streams
        block = min(each, BLOCK)
        sets = [sequence.sobol_bits(each, seed, s) for s in range(streams)]
        start = time.perf_counter()
        order, origins, units = _sorted_in_space(origins, units)
        shifts = [sequence.point_bits(origins, units, seed, s) for s in range(streams)]
        rows = self._rows(n * streams * (each // block), block)
        out = np.zeros((streams, each // block, n, *estimator.columns), np.float64)
        scratch = local()

        def work(s: int, b: int, i: int) -> tuple[int, int]:
            if not hasattr(scratch, "rays"):
                scratch.rays = RayBuffers(rows, block)
            part, made = slice(i, min(i + rows, n)), scratch.rays
            kind = s % estimator.streams
            u = slice(b * block, (b + 1) * block)
            samples_of = sets[s][0][u], sets[s][1][u]
            m = estimator.make(kind, origins[part], units[part], samples_of, shifts[s][part], made)
            hits = self._hits(made.origins[:m], made.directions[:m], max_distance)
            estimator.add(kind, hits, units[part], made, out[s, b, part])
            return (part.stop - i) * block, m

        tasks = itertools.product(range(streams), range(each // block), range(0, n, rows))
        total = n * samples * scrambles
        with ThreadPoolExecutor(self.threads) as pool:
            pending = {pool.submit(work, *task) for task in tasks}
            done_samples, traced = 0, 0
            try:
                while pending:
                    done, pending = wait(pending, timeout=0.2, return_when=FIRST_EXCEPTION)
                    for future in done:
                        done_samples += future.result()[0]
                        traced += future.result()[1]
                    if progress is not None:
                        progress(done_samples, total)
            except BaseException:
                # Ctrl-C included: what has not started never will.
                for future in pending:
                    future.cancel()
                raise
        # Blocks are added in their order, whichever thread did them; points go back to theirs.
        kinds = out.reshape(scrambles, estimator.streams * (each // block), *out.shape[2:])
        sums = np.empty_like(kinds[:, 0])
        sums[:, order] = functools.reduce(np.add, kinds.swapaxes(0, 1))
        info = {
            "samples": samples,
            "scrambles": scrambles,
            "rays": traced,
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
    max_distance: float = np.inf,
) -> ReferenceResult:
    """Ambient occlusion by Embree QMC, in one call; see `EmbreeQMC.ambient_occlusion`.

    Parameters
    ----------
    scene : Scene
        Anything with `vertices` (V, 3) and `faces` (F, 3).
    points, normals : array_like, shape (n, 3)
    samples, seed, weighting, scrambles, max_distance
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
    return qmc.ambient_occlusion(
        points, normals, samples, seed, weighting, scrambles, max_distance=max_distance
    )


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
