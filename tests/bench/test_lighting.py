"""The benchmark of irradiance and transfer: relative errors, references that turn, Embree's verdict."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from silint import Environment, Scene, SilhouetteIntegrator
from silint.bench import measure, plot, print_tables, run_bench, truth
from silint.bench.measure import _row, _Setting
from silint.bench.quantity import Quantity, quantity_of
from silint.bench.report import error_of
from silint.bench.rows import LEVELS, channel_equal_error
from silint.reference import EmbreeQMC, embree_available
from silint.validation import InputError

pytestmark = pytest.mark.skipif(not embree_available(), reason="no embreex for this platform")

TURN = Rotation.from_rotvec([0.4, 1.3, -0.6]).as_matrix()


def _roof() -> Scene:
    """A floor under a crooked roof."""
    v = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
    v += [(-1, -1.1, 0.3), (0.2, -1.3, 1.4), (0.1, 1.2, 1.5), (-1.2, 1, 0.4)]
    return Scene(np.array(v, np.float64), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], name="roof")


def _sky() -> Environment:
    """Smooth, with a lamp of 4 x 4 texels in it."""

    def light(w: np.ndarray) -> np.ndarray:
        return np.stack([1.5 + w[:, 0], 1 + w[:, 1] ** 2, np.exp(w[:, 2])], axis=1)

    texels = np.array(Environment.from_function(light, 32).texel_radiance)
    texels[8:12, 40:44] = 60.0
    return Environment.from_array(texels, "z")


QUANTITIES = {
    "irradiance": Quantity("irradiance", environment=_sky()),
    "sh": Quantity("sh", max_degree=3),
}


def _report(quantity: Quantity) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth, "_REFERENCE_ISOLINES", 256)
        return run_bench(
            [_roof()],
            points=128,
            error_points=128,
            isolines=(8, 32),
            rays=(64, 1024),
            quantity=quantity.name,
            environment=quantity.environment,
            max_degree=quantity.max_degree,
            repeats=1,
            seconds=0.5,
        )


@pytest.fixture(scope="module", params=QUANTITIES)
def report(request: pytest.FixtureRequest) -> dict[str, Any]:
    return _report(QUANTITIES[request.param])


def test_errors_fall_and_embree_confirms(report: dict[str, Any]) -> None:
    scene = report["scenes"][0]
    rmse = {(r["method"], r["setting"]): r["rmse"] for r in scene["rows"]}
    assert rmse["auto", 32] < 0.5 * rmse["auto", 8] < 0.1
    assert rmse["embree", 1024] < 0.5 * rmse["embree", 64] < 0.1
    assert scene["check"]["p_value"] > 1e-6
    assert abs(scene["check"]["mean_difference"]) < 6 * scene["check"]["mean_difference_error"]
    assert 0.3 < scene["check"]["rms_sigma"] < 2
    for row in scene["rows"]:
        if "channels" in row:
            assert row["rmse"] == max(channel["rmse"] for channel in row["channels"])
        if row["method"] == "embree":
            assert row["rays_per_second"] <= row["setting"] * row["points"] / row["seconds"] * (1 + 1e-9)
            assert row["bare_rays_per_second"] > 0


def test_the_report_says_what_it_measured(report: dict[str, Any], tmp_path: Path) -> None:
    from rich.console import Console

    assert json.loads(json.dumps(report)) == report
    options, scene = report["options"], report["scenes"][0]
    out = io.StringIO()
    print_tables(report, Console(file=out, width=200))
    if options["quantity"] == "irradiance":
        assert options["environment"] == "array" and min(scene["reference"]["unit"]) > 1
        assert "relative RMSE of irradiance under array" in out.getvalue()
    else:
        assert options["environment"] is None and scene["reference"]["unit"] == 1
        assert scene["channels"] is None
        assert "RMSE of SH transfer, degree 3" in out.getvalue()
    plot(report, tmp_path / "curves.svg")
    label = error_of(options).split(" under")[0]
    assert label.split(",")[0] in (tmp_path / "curves.svg").read_text().replace("&#160;", " ")


def test_every_channel_has_its_error() -> None:
    """Errors made to measure: the worst channel counts, and each has times at equal error of its own."""
    quantity = QUANTITIES["irradiance"]
    value = np.array([[1.0, 10.0, 100.0], [3.0, 30.0, 300.0]])
    unit = quantity.unit(value)
    np.testing.assert_allclose(unit, [2.0, 20.0, 200.0])
    wrong = np.array([[1e-2, 1e-2, 1e-2], [-1e-2, -1e-2, -1e-2]]) * [1.0, 2.0, 0.5] * unit
    reference = truth.Reference(value, np.tile(unit * 1e-3, (2, 1)), 64, 6, unit)
    assert reference.noise == pytest.approx(1e-3)

    def setting(method: str, k: int, scale: float) -> dict[str, Any]:
        run = _Setting(method, k, lambda *_: None, 2, 2, 1, seconds=[2e-6 * k], value=value + scale * wrong)
        return _row(run, reference)

    rows = [setting(*args) for args in (("auto", 1, 1.0), ("auto", 8, 0.25), ("embree", 16, 1.0))]
    np.testing.assert_allclose([c["rmse"] for c in rows[0]["channels"]], [1e-2, 2e-2, 5e-3])
    assert rows[0]["rmse"] == pytest.approx(2e-2) and rows[0]["max_error"] == pytest.approx(2e-2)
    assert [c["resolved"] for c in rows[1]["channels"]] == [False, True, False] and rows[1]["resolved"]
    found = channel_equal_error(rows, ["auto"])
    assert found is not None and [len(entries) for entries in found] == [len(LEVELS)] * 3
    # Log-log from (1, 2e-2) to (8, 5e-3): half an octave of error at 1e-2 is the geometric mean of 1 and 8.
    green = next(entry for entry in found[1] if entry["rmse"] == 1e-2)
    assert green["times"]["auto"] == {"value": pytest.approx(8**0.5), "bound": ""}
    # Blue is better than that from the first setting on.
    blue = next(entry for entry in found[2] if entry["rmse"] == 1e-2)
    assert blue["times"]["auto"] == {"value": pytest.approx(1.0), "bound": "<"}


@pytest.mark.parametrize("name", QUANTITIES)
def test_what_is_turned_is_turned_back(name: str) -> None:
    quantity, scene = QUANTITIES[name], _roof()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (16, 2)), np.full(16, 1e-3)])
    normals = rng.normal(size=(16, 3))
    still = quantity.silhouettes(SilhouetteIntegrator(scene), points, normals, 512, "octahedral")
    turned = SilhouetteIntegrator(Scene(scene.vertices @ TURN.T, scene.faces))
    found = quantity.turned(TURN).silhouettes(turned, points @ TURN.T, normals @ TURN.T, 512, "octahedral")
    back = quantity.turned_back(found, TURN)
    # 512 isolines: below 1e-3 of the mean under a lamp, and far less for low degrees.
    assert truth.relative_rms(back - still, quantity.unit(still)).max() < 2e-3
    if name == "sh":
        assert truth.rms(found - still) > 0.05


def test_embree_convicts_a_wrong_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth, "_REFERENCE_ISOLINES", 256)
    quantity, scene = QUANTITIES["irradiance"], _roof()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (40, 2)), np.full(40, 1e-3)])
    normals = np.tile([0.0, 0, 1], (40, 1))
    site = scene.vertices, scene.faces, points, normals
    right = truth.reference(*site, quantity, {"seed": 0}, lambda *_: None)
    assert right.value.shape == (40, 3) and right.unit == pytest.approx(right.value.mean(axis=0))
    wrong = right.value.copy()
    wrong[17, 2] *= 1.02
    shifted = truth.Reference(wrong, right.standard_error, right.isolines, right.rotations, right.unit)
    embree = EmbreeQMC(scene.vertices, scene.faces)
    judge = truth.rays_of_check(embree, points, normals, quantity, {"seed": 0}, lambda *_: None)
    found = truth.check(shifted, judge, points, normals)
    assert [(f["point"], f["component"]) for f in found["beyond_5_sigma"]] == [(points[17].tolist(), 2)]


def test_references_are_kept_by_what_they_are_of(tmp_path: Path) -> None:
    scene = _roof()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (4, 2)), np.full(4, 1e-3)])
    normals = np.tile([0.0, 0, 1], (4, 1))
    embree = EmbreeQMC(scene.vertices, scene.faces)
    site = scene.vertices, scene.faces, points, normals

    def found(quantity: Quantity) -> truth.Reference:
        options = {"seed": 0, "reference_method": "octahedral"}
        return truth.judged_reference(*site, embree, quantity, options, 0.05, tmp_path, lambda *_: None)[0]

    sky = _sky()
    asked = [
        Quantity(),
        Quantity("sh", max_degree=1),
        Quantity("sh", max_degree=2),
        Quantity("irradiance", environment=sky),
        Quantity("irradiance", environment=sky.rotated(TURN)),
    ]
    first = [found(quantity) for quantity in asked]
    assert len(list(tmp_path.iterdir())) == len(asked)
    for quantity, reference in zip(asked, first, strict=True):
        again = found(quantity)
        np.testing.assert_array_equal(again.value, reference.value)
        np.testing.assert_array_equal(again.unit, reference.unit)
    assert len(list(tmp_path.iterdir())) == len(asked)


def test_the_surer_side_is_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lamp of one texel: 32 isolines miss it, rays towards it do not. Without it, 512 are surer."""
    scene = _roof()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (32, 2)), np.full(32, 1e-3)])
    normals = np.tile([0.0, 0, 1], (32, 1))
    embree = EmbreeQMC(scene.vertices, scene.faces)
    texels = np.ones((64, 128, 3))
    values = {}
    for lamp, isolines, side in ((1.0, 512, "silint"), (1e5, 32, "embree")):
        monkeypatch.setattr(truth, "_REFERENCE_ISOLINES", isolines)
        texels[20, 40] = lamp
        quantity = Quantity("irradiance", environment=Environment.from_array(texels, "z"))
        options = {"seed": 0, "reference_method": "octahedral"}
        asked = scene.vertices, scene.faces, points, normals, embree, quantity, options, 0.0, None
        found, verdict = truth.judged_reference(*asked, lambda *_: None)
        assert found.by == side and found.as_dict()["by"] == side
        assert verdict["scrambles"] == 64 and verdict["max_sigma"] < 8
        values[side] = found
    # 512 lines: below 1e-4, while 131,072 rays leave about that. The lamp: its rays are all open or all not.
    assert values["silint"].noise < 1e-4 and values["embree"].noise < 0.02


def test_every_setting_has_tables_of_its_own() -> None:
    quantity = QUANTITIES["irradiance"]
    copies = [quantity.separate(), quantity.separate()]
    for copy in copies:
        assert copy.environment is not None
        assert copy.environment.texel_radiance is quantity.environment.texel_radiance
        np.testing.assert_array_equal(copy.environment.rotation, quantity.environment.rotation)
    table = copies[0].environment.moment_table(8)
    assert copies[0].environment.moment_table(8) is table
    assert copies[1].environment.moment_table(8) is not table


def test_irradiance_takes_two_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused before anything is compiled or measured; a constant sky needs one, having nothing to aim at."""
    monkeypatch.setattr(measure, "supported_methods", lambda *_: pytest.fail("began to measure"))
    with pytest.raises(InputError, match="rays is 1; irradiance takes 2 at least") as caught:
        run_bench([_roof()], quantity="irradiance", environment=_sky(), rays=(64, 1))
    assert "\n" not in str(caught.value)
    assert Quantity("irradiance", environment=Environment.constant()).fewest_rays == 1
    assert Quantity().fewest_rays == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("bent", "cosine", None, 4), "quantity is 'bent'"),
        (("ao", "area", None, 4), "weighting is 'area'"),
        (("sh", "cosine", None, -1), "max_degree is -1"),
        (("irradiance", "cosine", None, 4), "environment is missing"),
        (("irradiance", "cosine", "sky.hdr", 4), "environment is a str"),
        (("irradiance", "uniform", _sky(), 4), "irradiance has the cosine"),
        (("ao", "cosine", _sky(), 4), "ask for quantity irradiance"),
    ],
)
def test_contradictions_are_named(options: tuple[Any, ...], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        quantity_of(*options)
    assert "\n" not in str(caught.value)
