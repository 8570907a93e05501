"""What the benchmark scripts share: scenes by name or path, and tables."""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line has it, before numba starts

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the scenes package lives in the checkout, not in the installed silint

import scenes  # noqa: E402
import silint  # noqa: E402


def load(source: str) -> silint.Scene:
    """A generated scene by name or a mesh by path, its vertices rounded to float32 as Embree has them."""
    if source in scenes.SCENES:
        vertices, faces = scenes.build(source)
        name = source
    else:
        scene = silint.load_scene(source)
        vertices, faces, name = scene.vertices, scene.faces, Path(source).stem
    rounded = np.asarray(vertices, np.float32).astype(np.float64)
    return silint.Scene(rounded, faces, name=name)


def markdown(header: list[str], rows: list[list[str]]) -> str:
    """A table as README has it; all but the first column are numbers."""
    lines = ["| " + " | ".join(header) + " |", "|---|" + "---:|" * (len(header) - 1)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def write(path: str | None, text: str) -> None:
    """Print, and keep a copy where asked."""
    print(text)
    if path:
        Path(path).write_text(text + "\n", encoding="utf-8")
