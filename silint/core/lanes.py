"""Vector code from plain loops: sixteen lanes at a time.

Numba hands loops to LLVM, which turns them into vector instructions of whatever machine it is on (AVX2,
AVX-512, NEON), if they are written so that it can:

- exactly `WIDTH` lanes, in a loop over an *unsigned* index. A signed index may be negative and wrap around in
  Python; that check in front of every access keeps a loop scalar. 96 ns became 5 ns for 16 tests of an edge.
- arrays of one dimension, laid out in blocks of WIDTH lanes field by field, read at *block + field * WIDTH +
  lane* with constant fields: the compiler sees that no two accesses overlap.
- no branches: both sides are computed and one is chosen. No calls but to functions that are inlined. ``x if
  x > y else y`` instead of ``max``, which has to respect NaN.
- a set of lanes is an integer with a bit each, gathered by ``mask |= hit << lane``; `lowest` walks through
  it.

The same functions run as they are without the compiler (NUMBA_DISABLE_JIT=1), lane by lane: that is their
scalar twin, and the tests compare the two. Loops in float32 are filters: they may contract and reorder
products (`jit.FILTER`), and everything they drop is dropped by a margin. Loops in float64 keep every bit.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from silint.core.jit import INNER

WIDTH = 16  # lanes: one AVX-512 register of float32, two of AVX2, four of NEON

# Position of the only set bit of a 32 bit number, by de Bruijn's sequence.
_DE_BRUIJN = 0x077CB531
_BIT = np.zeros(32, np.int64)
for _i in range(32):
    _BIT[((_DE_BRUIJN << _i) & 0xFFFFFFFF) >> 27] = _i
_BIT.setflags(write=False)


@njit(**INNER)
def lowest(mask):
    """Position of the lowest set bit of a mask below 2^32."""
    return _BIT[(((mask & -mask) * _DE_BRUIJN) & 0xFFFFFFFF) >> 27]
