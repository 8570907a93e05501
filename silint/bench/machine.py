"""What a benchmark ran on, and with."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from typing import Any

__all__ = ["describe", "n_threads", "versions"]


def versions() -> dict[str, str]:
    """Of silint and of what its speed depends on."""
    from silint import __version__

    others = {name: importlib.metadata.version(name) for name in ("numpy", "numba", "embreex")}
    return {**others, "silint": __version__}


def describe() -> dict[str, Any]:
    """Processor, threads, and how busy the machine is now."""
    return {
        "processor": _processor(),
        "threads": n_threads(),
        "threading_layer": _threading_layer(),
        "load_average": _load_average(),
    }


def n_threads() -> int:
    """Threads of both sides."""
    import numba

    return int(numba.get_num_threads())


def _threading_layer() -> str | None:
    """Numba's, or None before its first parallel kernel has run."""
    import numba

    try:
        return str(numba.threading_layer())  # type: ignore[attr-defined]
    except ValueError:
        return None


def _load_average() -> float | None:
    """Processes that wanted a core during the last minute."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            for line in stream:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
