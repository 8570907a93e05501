"""Numbers behind Embree QMC: Sobol points, the random bits of each shade point, and cache-friendly orders."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["point_bits", "sobol_bits", "space_order"]

Bits = npt.NDArray[np.int32]


@functools.lru_cache(maxsize=128)
def sobol_bits(samples: int, seed: int, scramble: int) -> tuple[Bits, Bits]:
    """A scrambled Sobol set as 32-bit fractions, in Morton order: two arrays of int32, shape (samples,)."""
    from scipy.stats import qmc

    rng = np.random.default_rng([seed, scramble])
    fractions = qmc.Sobol(2, scramble=True, bits=32, rng=rng).random(samples)
    bits = (fractions * 2.0**32).astype(np.uint32)
    morton = _spread(bits[:, 0], 2) << np.uint64(1) | _spread(bits[:, 1], 2)
    order = np.argsort(morton, kind="stable")
    first, second = (np.ascontiguousarray(bits[order, axis]).view(np.int32) for axis in (0, 1))
    first.flags.writeable = second.flags.writeable = False
    return first, second


def space_order(points: npt.NDArray[np.float32]) -> npt.NDArray[np.intp]:
    """Points along a Morton curve of 1024^3 cells."""
    if not len(points):
        return np.zeros(0, np.intp)
    offset = (points - points.min(axis=0)).astype(np.float64)
    cells = (offset / max(offset.max(), np.finfo(np.float32).tiny) * 1023).astype(np.uint32)
    code = functools.reduce(np.bitwise_or, (_spread(cells[:, k], 3) << np.uint64(k) for k in range(3)))
    return np.argsort(code, kind="stable")


def _spread(values: npt.NDArray[np.uint32], step: int) -> npt.NDArray[np.uint64]:
    """Bit i of each value at place i * step of a 64-bit number; what does not fit falls off the top."""
    v = values.astype(np.uint64)
    out = np.zeros(len(v), np.uint64)
    for i in range(min(32, -(-64 // step))):
        out |= (v >> np.uint64(i) & np.uint64(1)) << np.uint64(i * step)
    return out


def point_bits(
    origins: npt.NDArray[np.float32], normals: npt.NDArray[np.float64], seed: int, scramble: int
) -> npt.NDArray[np.int32]:
    """Random bits for the digital shift of each point, hashed from its own numbers: shape (n, 2), int32."""
    keys: list[Any] = [np.uint64(seed), np.uint64(scramble)]
    keys += [origins[:, k].view(np.uint32).astype(np.uint64) for k in range(3)]
    keys += [np.ascontiguousarray(normals[:, k]).view(np.uint64) for k in range(3)]
    state = np.zeros(len(origins), np.uint64)
    for key in keys:
        state = _mix(state ^ key)
    return np.ascontiguousarray(state).view(np.int32).reshape(-1, 2)


def _mix(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """The output function of SplitMix64 [Steele, Lea & Flood 2014]: a bijection that spreads every bit."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
