"""The search does no more work than it did: counted a point, never timed.

The bounds stand in work_bounds.json, with the reason. ``python benchmarks/work.py --record`` rewrites them:
after a method came, after the search became better (so that it stays so), or, with the reason in the commit,
after it had to become worse.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import scenes
from silint.bench.measure import supported_methods
from silint.bench.work import COUNTED, work
from silint.integrator import SilhouetteIntegrator
from silint.scene import Scene
from silint.validation import InputError

TABLE: dict[str, Any] = json.loads((Path(__file__).parent / "work_bounds.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("method", TABLE["methods"])
@pytest.mark.parametrize("name", TABLE["bounds"])
def test_no_more_work_than_recorded(name: str, method: str) -> None:
    try:
        supported_methods([method])
    except InputError:
        pytest.skip(f"there is no method {method!r} yet")
    bounds = TABLE["bounds"][name].get(method)
    assert bounds, "no bounds are recorded: python benchmarks/work.py --record"
    vertices, faces = scenes.build(name)
    # As the script has them, which measures at what both sides of a comparison can have.
    scene = Scene(vertices.astype("f4").astype("f8"), faces)
    points, normals = scenes.shade_points(scene.vertices, scene.faces, TABLE["points"], 1)
    integrator = SilhouetteIntegrator(scene)
    counts = work(integrator, points, normals, TABLE["isolines"], [method])[method]
    assert set(bounds) == set(COUNTED)
    # A count of nothing would satisfy any bound.
    assert all(0 < counts[key] <= bounds[key] for key in COUNTED), counts
