"""What is under way outside of this process's memory, and has to go if the process is cut off.

`silint.cli` ends at Ctrl-C without unwinding the stack of the main thread, which may be deep in compiled
code: what a ``finally`` would remove, it removes by `discard_unfinished`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

__all__ = ["discard_unfinished", "discarded_if_cut_off"]

_under_way: dict[object, Callable[[], None]] = {}


@contextlib.contextmanager
def discarded_if_cut_off(discard: Callable[[], None]) -> Iterator[None]:
    """Have something called by `discard_unfinished` for as long as the context lasts.

    Parameters
    ----------
    discard : callable
        Called from another thread. It may raise `OSError`.
    """
    key = object()
    _under_way[key] = discard
    try:
        yield
    finally:
        del _under_way[key]


def discard_unfinished() -> None:
    """Discard what is under way, the oldest first, for a process that is about to be cut off."""
    for discard in list(_under_way.values()):
        with contextlib.suppress(OSError):
            discard()
