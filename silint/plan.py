"""What a scene and a request need, and what is left out: a value that a user can print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Part:
    """One thing that is built, or left out."""

    name: str
    built: bool
    reason: str
    n_bytes: int = 0


@dataclass(frozen=True)
class Plan:
    """Parts in the order in which they are built; `str` prints a table."""

    title: str
    parts: tuple[Part, ...]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """part -> {"built": bool, "reason": str, "bytes": int}"""
        return {p.name: {"built": p.built, "reason": p.reason, "bytes": p.n_bytes} for p in self.parts}

    @property
    def n_bytes(self) -> int:
        """Memory of everything built."""
        return sum(p.n_bytes for p in self.parts)

    def __str__(self) -> str:
        width = max(len(p.name) for p in self.parts)
        lines = [self.title]
        for p in self.parts:
            size = f"{p.n_bytes / 2**20:9.2f} MiB" if p.n_bytes else " " * 13
            lines.append(f"  {'+' if p.built else '-'} {p.name:<{width}} {size}  {p.reason}")
        return "\n".join(lines)
