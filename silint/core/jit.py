"""How kernels are compiled.

Numba optimises a function together with everything that it calls, and wraps each for calls from Python too.
Private functions, which only other kernels call, are spared the wrappers, a sixth of a cold start (35.6 ->
29.1 s of processor time on a busy machine). Calling one of them from Python crashes the interpreter.

Whatever a function calls is linked into it, optimised and written out again: a tree of calls costs its size
times its depth, and `parallel=True` makes it three levels deeper. The two large trees, of radial lines, are
therefore kernels for one block of points that release the GIL, and `each_block` hands blocks to threads (38
-> 31 s of processor time for a cold start).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from numba import get_num_threads

# Division by zero gives infinity or NaN as in NumPy instead of an exception that every division must check.
KERNEL: dict[str, Any] = {"cache": True, "error_model": "numpy"}
INNER: dict[str, Any] = {**KERNEL, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# Loops over lanes that only have to be right up to a bound. NaN and infinity keep their meaning.
FILTER: dict[str, Any] = {**INNER, "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
PARALLEL: dict[str, Any] = {**KERNEL, "parallel": True}
# For one block of points; see `each_block`.
BLOCK: dict[str, Any] = {**KERNEL, "nogil": True}

# Held by whoever runs a parallel kernel: numba's simplest threading layer may not be entered by two threads
# at a time, and ends the process if it is. Reentrant, as what holds it builds on what does.
KERNEL_LOCK = threading.RLock()


def each_block(kernel: Callable[..., None], n_blocks: int, *arguments: Any) -> None:
    """Call kernel(*arguments, block) for every block, on as many threads as numba is set to.

    Blocks go to whichever thread is free; a kernel writes what belongs to its block, and nothing else.
    """
    blocks = deque(range(n_blocks))

    def work() -> None:
        while True:
            try:
                block = blocks.popleft()
            except IndexError:
                return
            kernel(*arguments, block)

    hands = min(get_num_threads(), n_blocks)
    if hands <= 1:
        work()
        return
    with ThreadPoolExecutor(hands) as pool:
        shares = [pool.submit(work) for _ in range(hands)]
        try:
            for share in shares:
                share.result()
        finally:
            blocks.clear()  # after an error, or Ctrl-C, no thread begins another
