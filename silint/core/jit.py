"""How kernels are compiled.

Numba optimises a function together with everything that it calls, and wraps each for calls from Python too.
Private functions, which only other kernels call, are spared the wrappers, a sixth of a cold start (35.6 ->
29.1 s of processor time on a busy machine). Calling one of them from Python crashes the interpreter.
"""

from __future__ import annotations

import threading
from typing import Any

# Division by zero gives infinity or NaN as in NumPy instead of an exception that every division must check.
KERNEL: dict[str, Any] = {"cache": True, "error_model": "numpy"}
INNER: dict[str, Any] = {**KERNEL, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# Loops over lanes that only have to be right up to a bound. NaN and infinity keep their meaning.
FILTER: dict[str, Any] = {**INNER, "fastmath": {"contract", "nsz", "arcp", "reassoc"}}
PARALLEL: dict[str, Any] = {**KERNEL, "parallel": True}

# Held by whoever runs a parallel kernel: numba's simplest threading layer may not be entered by two threads
# at a time, and ends the process if it is. Reentrant, as what holds it builds on what does.
KERNEL_LOCK = threading.RLock()
