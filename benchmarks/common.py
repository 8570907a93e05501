"""What the benchmark scripts share: scenes by name or path, tables, and places for them."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def source_hash() -> str:
    """Of the package's source: what was measured."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "silint").rglob("*.py")):
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# Before numba starts: OpenMP as the command line has it, and a cache of this very source, because numba does
# not notice edits in the helpers of a kernel.
SOURCE = source_hash()
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / "benchmarks" / "results" / "numba" / SOURCE))
sys.path.insert(0, str(ROOT))  # the scenes package lives in the checkout, not in the installed silint

import numpy as np  # noqa: E402

import scenes  # noqa: E402
import silint  # noqa: E402
from silint.io import write_bytes  # noqa: E402
from silint.validation import InputError  # noqa: E402


def find(source: str, assets: str | None = None) -> Path | None:
    """None for a generated scene, else the mesh file, by path or by its name in the folder of assets."""
    if source in scenes.SCENES:
        return None
    if Path(source).is_file():
        return Path(source)
    found = sorted(Path(assets).glob(f"{source}.*")) if assets else []
    if not found:
        where = f"and not in {assets}" if assets else "and there is no folder of assets"
        raise InputError(f"{source} is no generated scene, no file, {where}")
    return found[0]


def load(source: str, assets: str | None = None) -> silint.Scene:
    """A generated scene by name or a mesh by path, its vertices rounded to float32 as Embree has them."""
    path = find(source, assets)
    if path is None:
        vertices, faces = scenes.build(source)
        normals, name = None, source
    else:
        scene = silint.load_scene(path)
        vertices, faces, normals, name = scene.vertices, scene.faces, scene.normals, path.stem
    rounded = np.asarray(vertices, np.float32).astype(np.float64)
    return silint.Scene(rounded, faces, normals, name=name)


def mesh_hash(scene: silint.Scene) -> str:
    parts = [scene.vertices, scene.faces] + ([] if scene.normals is None else [scene.normals])
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:16]


def keep(path: Path, key: dict[str, Any], report: dict[str, Any]) -> dict[str, Any]:
    """Write a report as soon as it is measured, with the key of what it is of; what `kept` then returns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, (json.dumps({"key": key, "report": report}, indent=1) + "\n").encode())
    return {**report, "source": key["source"]}


def kept(path: Path, key: dict[str, Any] | None) -> dict[str, Any] | None:
    """The report that is kept there and the source it measured, if it is of that key, or whatever its key."""
    if not path.is_file():
        return None
    found = json.loads(path.read_text(encoding="utf-8"))
    return {**found["report"], "source": found["key"]["source"]} if key in (None, found["key"]) else None


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


def insert(path: str | Path, name: str, text: str) -> None:
    """Replace what stands between the comments ``NAME:begin`` and ``NAME:end`` of a markdown file."""
    page = Path(path).read_text(encoding="utf-8")
    begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
    if page.count(begin) != 1 or page.count(end) != 1:
        raise InputError(f"{path} has no place for the table: expected one {begin} and one {end}")
    before, after = page[: page.index(begin) + len(begin)], page[page.index(end) :]
    Path(path).write_text(f"{before}\n{text}\n{after}", encoding="utf-8")


def print_stage(stage: str, done: int, total: int) -> None:
    """A line on stderr when a stage of `silint.bench` begins and ends."""
    if done in (0, total):
        print(f"{stage}{'' if done == 0 else ': done'}", file=sys.stderr, flush=True)


def fail(error: InputError) -> None:
    """End in one line, as the command line does."""
    sys.exit(f"error: {error}")
