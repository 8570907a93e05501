"""What holds for the project as a whole: its import, its version, its size, its README."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_LINES = 500
MAX_IMPORT_SECONDS = 1.0
LATE = ("embreex", "matplotlib", "rich", "scipy", "trimesh", "typer")

# Numba itself loads the top of scipy where it is installed, hence "those that numba did not bring".
IMPORT_PROBE = """
import json, sys
import numba
from numba.core import event
with event.install_recorder("numba:compile") as compiled:
    brought_by_numba = set(sys.modules)
    import silint
    late = sorted(m for m in set(sys.modules) - brought_by_numba if m.split(".")[0] in LATE)
    import importlib, pkgutil
    for module in pkgutil.walk_packages(silint.__path__, "silint."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
starts = [e for _, e in compiled.buffer if e.is_start]
print(json.dumps(dict(late=late, compiled=[str(e.data["dispatcher"]) for e in starts])))
"""


def run_python(code: str, cwd: Path) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_is_light(tmp_path: Path) -> None:
    """`import silint` loads no library that a bare integration can do without; no module compiles."""
    found = json.loads(run_python(IMPORT_PROBE.replace("LATE", repr(LATE)), tmp_path))
    assert found == {"late": [], "compiled": []}


def test_import_is_quick(tmp_path: Path) -> None:
    code = "import time; t = time.perf_counter(); import silint; print(time.perf_counter() - t)"
    # The best of a few: other processes on the machine only ever add to the time.
    best = min(float(run_python(code, tmp_path)) for _ in range(4))
    assert best < MAX_IMPORT_SECONDS


def test_version_is_stated_once(checkout: Path) -> None:
    import silint

    def text(name: str) -> str:
        return (checkout / name).read_text(encoding="utf-8")

    version = tomllib.loads(text("pyproject.toml"))["project"]["version"]
    assert silint.__version__ == version
    assert f"\nversion: {version}\n" in text("CITATION.cff")
    assert f"\n## [{version}]" in text("CHANGELOG.md")


def test_files_stay_small(checkout: Path) -> None:
    lines = {
        path.relative_to(checkout).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in (checkout / "silint").rglob("*.py")
    }
    assert lines
    assert {path: n for path, n in lines.items() if n > MAX_LINES} == {}


def test_types_are_shipped() -> None:
    import silint

    assert (Path(silint.__file__).parent / "py.typed").is_file()


def python_blocks(markdown: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```$", markdown, re.M | re.S)


def linked_files(page: Path) -> list[Path]:
    """What a page of markdown links to or shows, beside what lies elsewhere on the web."""
    targets = re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    local = [target.split("#")[0] for target in targets if not re.match(r"[a-z]+:", target)]
    return [page.parent / name for name in local if name]


def test_links_lead_somewhere(checkout: Path) -> None:
    """Every file that README and the pages of docs/ link to or show is there."""
    pages = [*checkout.glob("*.md"), *(checkout / "docs").glob("*.md")]
    linked = {page.relative_to(checkout).as_posix(): linked_files(page) for page in pages}
    if not (checkout / "docs").is_dir():
        pytest.skip("the pages are not here")
    missing = {page: [str(f) for f in files if not f.exists()] for page, files in linked.items()}
    assert {page: files for page, files in missing.items() if files} == {}


def test_gallery_is_whole(checkout: Path) -> None:
    """A picture for each shot of the benchmark, all on the page, of a size for a page and quick to load."""
    pictures = sorted((checkout / "docs" / "gallery").glob("*.png"))
    script = checkout / "benchmarks" / "gallery.py"
    if not (script.is_file() and (checkout / "docs").is_dir()):
        pytest.skip("the benchmarks or the pages are not here")
    shots = re.findall(r'\bShot\(\s*"([\w-]+)"', script.read_text(encoding="utf-8"))
    assert [picture.stem for picture in pictures] == sorted(shots)
    shown = [f for f in linked_files(checkout / "docs" / "gallery.md") if f.suffix == ".png"]
    assert sorted(shown) == pictures
    for picture in pictures:
        data = picture.read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert 720 <= int.from_bytes(data[16:20], "big") <= 960  # the width, first in the header
        assert len(data) <= 350_000


def test_readme_examples_run(checkout: Path, tmp_path: Path) -> None:
    """All of README's Python, from top to bottom in one session, as a reader would type it.

    Runs in an empty folder, in a process of its own. The reader's own mesh is the one thing an example
    may expect to find: `model` with any of the suffixes below.
    """
    readme = checkout / "README.md"
    if not readme.is_file():
        pytest.skip("README.md is not written yet")
    blocks = python_blocks(readme.read_text(encoding="utf-8"))
    assert blocks, "README.md shows no Python"

    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=1)
    for suffix in (".glb", ".obj", ".ply", ".stl"):
        mesh.export(tmp_path / f"model{suffix}")
    # Line numbers of a traceback then count within the joined examples, which are left beside them.
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, script.name], capture_output=True, text=True, cwd=tmp_path, timeout=300
    )
    assert done.returncode == 0, done.stderr
