from __future__ import annotations

import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import trimesh

from silint import InputError
from silint.io.unfinished import discard_unfinished
from silint.texture.unwrap import repack, unwrap
from tests.texture.shapes import grid

BALL = trimesh.creation.icosphere(2)


def refused(**options) -> str:
    with pytest.raises(InputError) as caught:
        unwrap(BALL.vertices, BALL.faces, 64, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e12])
def test_charts_keep_shapes_and_gaps(scale):
    pytest.importorskip("xatlas")
    size = 128
    uvs = unwrap(scale * BALL.vertices + scale, BALL.faces, size)
    assert uvs.shape == (len(BALL.faces), 3, 2) and uvs.min() >= 0.0 and uvs.max() <= 1.0
    d1, d2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    area = 0.5 * (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])
    assert (area > 0.0).all() and 0.3 < area.sum() < 1.0  # v upwards: none is mirrored
    stretch = area / BALL.area_faces
    assert stretch.max() < 4.0 * stretch.min()
    assert np.array_equal(uvs, unwrap(scale * BALL.vertices + scale, BALL.faces, size))


def test_charts_are_packed_anew_with_gaps():
    pytest.importorskip("xatlas")
    size = 128
    # Two squares that touch, of 16 triangles in all; the last is left out.
    uvs = 0.4 * np.concatenate([grid((0, 0, 0), (1, 0, 0), (0, 1, 0), 2)[2] + (side, 0) for side in (0, 1)])
    charts = np.repeat([0, 1], 8).astype(np.int32)
    charts[-1] = -1
    out = repack(uvs, charts, size)
    assert out.min() >= 0.0 and out.max() <= 1.0 and (out[-1] == out[-1, 0]).all()
    used = charts >= 0
    lengths = [np.linalg.norm(np.roll(uv, -1, axis=1) - uv, axis=2)[used] for uv in (uvs, out)]
    scale = lengths[1] / lengths[0]
    np.testing.assert_allclose(scale, scale[0, 0], rtol=0.05)  # boxes of whole texels
    d1, d2 = out[:, 1] - out[:, 0], out[:, 2] - out[:, 0]
    assert (d1[used, 0] * d2[used, 1] > d1[used, 1] * d2[used, 0]).all()  # none is mirrored
    # Their boxes are 2 texels apart, at least.
    low = np.array([out[charts == k].min(axis=(0, 1)) for k in (0, 1)])
    high = np.array([out[charts == k].max(axis=(0, 1)) for k in (0, 1)])
    assert size * np.maximum(low[1] - high[0], low[0] - high[1]).max() >= 2.0


def test_a_missing_package_is_one_line(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert "pip install 'silint[texture]'" in refused()


def instead_of_xatlas(monkeypatch, code: str) -> list[subprocess.Popen]:
    """Run this in its place; the list gets the processes."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    popen, started = subprocess.Popen, []

    def start(command, **options):
        started.append(popen([sys.executable, "-c", code, *command[2:]], **options))
        return started[-1]

    monkeypatch.setattr("silint.texture.unwrap.subprocess.Popen", start)
    return started


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import os; os.abort()", "signal 6"),
        ("raise SystemExit(3)", "code 3"),
        ("raise ValueError('of no use')", "ValueError: of no use"),
        ("pass", "code 0"),  # ended well, and wrote nothing
    ],
)
def test_a_crash_is_one_line(monkeypatch, code, words):
    instead_of_xatlas(monkeypatch, code)
    message = refused()
    assert words in message and "bring texture coordinates" in message


def test_a_process_that_is_cut_off_takes_the_program_and_its_folder_along(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    started = instead_of_xatlas(
        monkeypatch, "import sys, time; open(sys.argv[2], 'wb').write(b'half'); time.sleep(60)"
    )

    def cut_off() -> None:
        while not list(tmp_path.glob("*/atlas.npz")):
            time.sleep(0.01)
        discard_unfinished()

    thread = threading.Thread(target=cut_off)
    thread.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        unwrap(BALL.vertices, BALL.faces, 64)
    thread.join()
    assert time.monotonic() - began < 30.0 and started[0].poll() is not None
    assert list(tmp_path.iterdir()) == []
    discard_unfinished()  # nothing is left to be discarded
