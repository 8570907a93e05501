"""Set-up that every test shares; the part that concerns Numba has to run before numba is imported."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
JIT_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0")

_CACHE_NAME = re.compile(r"silint-[0-9a-f]{16}")
_CACHE_LIFE = 3 * 24 * 3600  # seconds after which the kernels of an edited source are thrown away


def _source_hash(package: Path) -> str:
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(path.relative_to(package).as_posix().encode() + b"\0")
        digest.update(path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _find_package() -> Path:
    """The silint that the tests will import: the installed one, else the checkout's."""
    # Appended, not prepended, so that a checkout never hides the package that pip has just installed and
    # whose completeness (data files, modules) is a thing to test. `scenes` is only ever found here.
    sys.path.append(str(ROOT))
    spec = importlib.util.find_spec("silint")
    if spec is None or not spec.submodule_search_locations:
        raise pytest.UsageError(f"there is no silint to test in {ROOT}")
    package = Path(spec.submodule_search_locations[0]).resolve()
    if package == ROOT / "silint":
        # Not installed: tests that start `python -m silint...` elsewhere need the way to it as well.
        known = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = str(ROOT) if not known else known + os.pathsep + str(ROOT)
    elif _source_hash(package) != _source_hash(ROOT / "silint"):
        raise pytest.UsageError(
            f"the silint in {package} is not that of this checkout: pip install . again, or pip install -e ."
        )
    return package


def _choose_numba_cache(package: Path) -> Path:
    """Point Numba at a cache of this very source.

    Numba looks at the file of a kernel only, not at the helpers that it calls: after an edit in a helper,
    a cached caller would silently go on returning the old results.
    """
    if "numba" in sys.modules:
        raise pytest.UsageError("numba was imported before tests/conftest.py could choose its cache folder")
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or ROOT / ".pytest_cache" / "numba")
    if _CACHE_NAME.fullmatch(base.name):
        base = base.parent  # a subprocess or worker of a test run: chosen already
    try:
        base.mkdir(parents=True, exist_ok=True)
    except OSError:  # a read-only checkout
        base = Path(tempfile.mkdtemp(prefix="silint-numba-"))
    cache = base / f"silint-{_source_hash(package)}"
    cache.mkdir(exist_ok=True)
    os.utime(cache)
    os.environ["NUMBA_CACHE_DIR"] = str(cache)
    return cache


def _drop_old_caches(base: Path) -> None:
    for folder in base.iterdir():
        if _CACHE_NAME.fullmatch(folder.name) and time.time() - folder.stat().st_mtime > _CACHE_LIFE:
            shutil.rmtree(folder, ignore_errors=True)


def _load_hypothesis_profile() -> None:
    from hypothesis import settings

    # No deadline: the first example of a test may compile a kernel. In CI the same examples every time, so
    # that a red run is never a matter of luck; at a desk new ones every time, which is how bugs are found.
    settings.register_profile("desk", deadline=None, print_blob=True)
    settings.register_profile("ci", deadline=None, print_blob=True, derandomize=True, database=None)
    settings.load_profile("ci" if os.environ.get("CI") else "desk")


PACKAGE = _find_package()
NUMBA_CACHE = None if JIT_DISABLED else _choose_numba_cache(PACKAGE)
if NUMBA_CACHE is not None:
    _drop_old_caches(NUMBA_CACHE.parent)
_load_hypothesis_profile()


def pytest_report_header() -> list[str]:
    return [f"silint: {PACKAGE}", f"numba cache: {NUMBA_CACHE or 'none, NUMBA_DISABLE_JIT is set'}"]


@pytest.fixture(autouse=True)
def _compiled_floating_point() -> Iterator[None]:
    """Without the compiler, kernels divide by zero as silently as with it, instead of warning."""
    if not JIT_DISABLED:
        yield
        return
    import numpy as np

    with np.errstate(all="ignore"):
        yield


@pytest.fixture(scope="session")
def checkout() -> Path:
    """The folder that holds pyproject.toml; tests that read the project's own files skip without it."""
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("the project's own files are not here")
    return ROOT
