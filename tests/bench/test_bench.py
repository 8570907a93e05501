"""The benchmark on a small scene: its numbers hang together, and its judge can convict."""

from __future__ import annotations

import copy
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from silint.bench import bench_command, plot, plot_scaling, print_tables, run_bench, scaling, truth
from silint.bench.measure import LEVELS, prepare_references, supported_methods
from silint.bench.quantity import Quantity
from silint.bench.sites import area_samples, shade_sites, spread
from silint.bench.tolerance import calibrate
from silint.reference import EmbreeQMC, embree_available
from silint.scene import Scene
from silint.validation import InputError

pytestmark = pytest.mark.skipif(not embree_available(), reason="no embreex for this platform")


def _tent() -> Scene:
    """A floor under a crooked roof of two rectangles."""
    v = [(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)]
    v += [(-1, -1.1, 0.3), (0.2, -1.3, 1.4), (0.1, 1.2, 1.5), (-1.2, 1, 0.4), (1.3, -1, 0.6), (1.1, 0.9, 0.5)]
    quads = [(0, 1, 2, 3), (4, 5, 6, 7), (5, 8, 9, 6)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Scene(np.array(v, np.float64), np.array(faces), name="tent")


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    # A reference of 256 lines is far better than the 8 and 32 that it judges, and quick.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth, "_REFERENCE_ISOLINES", 256)
        return run_bench([_tent()], points=300, isolines=(32, 8), rays=(64, 1024), repeats=2, seconds=1.0)


def test_every_setting_has_a_row(report: dict[str, Any]) -> None:
    scene = report["scenes"][0]
    assert scene["name"] == "tent" and scene["n_faces"] == 6
    assert [(r["method"], r["setting"]) for r in scene["rows"]] == [
        ("auto", 8), ("embree", 64), ("auto", 32), ("embree", 1024),
    ]  # fmt: skip
    for row in scene["rows"]:
        assert 256 <= row["points"] <= 300 and 1 <= row["rounds"] <= 2
        assert row["us_per_point"] == pytest.approx(1e6 * row["seconds"] / row["points"])
        assert 0 < row["rmse"] <= row["max_error"] < 0.2
        if row["method"] == "embree":
            assert row["rays_per_second"] == pytest.approx(row["setting"] * row["points"] / row["seconds"])
            # Making rays takes time; 16 batches on a busy machine may say otherwise by a little.
            assert row["bare_rays_per_second"] > 0.5 * row["rays_per_second"]


def test_errors_fall_and_the_reference_is_better(report: dict[str, Any]) -> None:
    scene = report["scenes"][0]
    rmse = {(r["method"], r["setting"]): r["rmse"] for r in scene["rows"]}
    assert rmse["auto", 32] < 0.5 * rmse["auto", 8]
    assert rmse["embree", 1024] < 0.5 * rmse["embree", 64]
    noise = scene["reference"]["standard_error"]
    for row in scene["rows"]:
        assert row["resolved"] == (row["rmse"] >= 4 * noise)
    assert all(r["resolved"] for r in scene["rows"] if r["setting"] in (8, 64))


def test_embree_confirms_the_reference(report: dict[str, Any]) -> None:
    check = report["scenes"][0]["check"]
    assert check["p_value"] > 1e-6
    assert abs(check["mean_difference"]) < 6 * check["mean_difference_error"]
    assert 0.3 < check["rms_sigma"] < 2


def test_embree_convicts_a_wrong_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth, "_REFERENCE_ISOLINES", 256)
    scene = _tent()
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-1, 1, (256, 2)), np.full(256, 1e-3)])
    normals = np.tile([0.0, 0, 1], (256, 1))
    options = {"seed": 0}
    embree = EmbreeQMC(scene.vertices, scene.faces)
    right = truth.reference(
        scene.vertices, scene.faces, points, normals, Quantity(), options, lambda *_: None
    )
    wrong = right.value.copy()
    wrong[17] += 0.01
    shifted = truth.Reference(wrong, right.standard_error, right.isolines, right.rotations)
    judge = truth.rays_of_check(embree, points, normals, Quantity(), options, lambda *_: None)
    found = truth.check(shifted, judge, points, normals)
    assert [f["point"] for f in found["beyond_5_sigma"]] == [points[17].tolist()]
    assert found["p_value"] < 1e-9


def test_the_report_is_json_and_prints(report: dict[str, Any]) -> None:
    from rich.console import Console

    assert json.loads(json.dumps(report)) == report
    assert report["schema"] == "silint-bench/4"
    out = io.StringIO()
    print_tables(report, Console(file=out, width=100))
    text = out.getvalue()
    assert "tent: 6 triangles" in text and "1,024 rays" in text and "32 isolines" in text
    # No setting of either side is this good: a bound, not a figure.
    assert "3e-05" in text and ">" in text


def test_the_tables_name_what_is_suspicious(report: dict[str, Any]) -> None:
    from rich.console import Console

    accused = copy.deepcopy(report)
    found = {"point": [1.0, 2.0, 3.0], "normal": [0, 0, 1], "silint": 0.5, "embree": 0.6, "sigma": 9.0}
    accused["scenes"][0]["check"] |= {"p_value": 1e-12, "beyond_5_sigma": [found]}
    out = io.StringIO()
    print_tables(accused, Console(file=out, width=200))
    assert "(1, 2, 3)" in out.getvalue() and "no chance" in out.getvalue()


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_the_figure(report: dict[str, Any], tmp_path: Path, suffix: str, magic: bytes) -> None:
    path = tmp_path / f"curves{suffix}"
    many = {**report, "scenes": report["scenes"] * 4}
    plot(many, path)
    assert path.read_bytes().startswith(magic)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rays": "64,1000"}, "1000 is not one"),
        ({"rays": "many"}, "rays is 'many'"),
        ({"isolines": "8,0"}, "isolines is 0"),
        ({"isolines": ""}, "isolines is ''"),
        ({"points": 100}, "points is 100"),
        ({"repeats": 0}, "repeats is 0"),
        ({"seconds": 0.0}, "seconds is 0"),
        ({"weighting": "area"}, "weighting is 'area'"),
        ({"quantity": "bent"}, "quantity is 'bent'"),
        ({"quantity": "sh", "max_degree": 17}, "max_degree is 17"),
        ({"quantity": "irradiance"}, "--envmap MAP"),
        ({"quantity": "irradiance", "envmap": "no-such-map.hdr"}, "no-such-map.hdr"),
        ({"json_file": "no/such/folder/x.json"}, "does not exist"),
        ({"json_file": "x.txt"}, "unknown suffix"),
        ({"plot_file": "x.bmp"}, "unknown suffix"),
        ({"scenes": ["no-such-mesh.obj"]}, "no-such-mesh.obj"),
    ],
)
def test_mistakes_are_one_line_before_any_work(
    options: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        bench_command(**options)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_mesh_without_area_has_no_points() -> None:
    flat = Scene(np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0.0)]), [[0, 1, 2]])
    with pytest.raises(InputError, match="no face has any area"):
        run_bench([flat])


def test_points_are_uniform_over_the_area() -> None:
    v = np.array([(0, 0, 0), (3, 0, 0), (0, 1, 0), (0, 0, 5), (1, 0, 5), (0, 1, 5)], np.float64)
    faces = np.array([[0, 1, 2], [3, 5, 4], [0, 0, 1]], np.int32)
    p, n, ids = area_samples(v, faces, 4000, np.random.default_rng(0))
    # Three quarters on the large one: 4000 draws tell to 0.7 %.
    assert (ids == 0).mean() == pytest.approx(0.75, abs=0.03)
    np.testing.assert_array_equal(n[ids == 0], np.tile([0.0, 0, 1], ((ids == 0).sum(), 1)))
    np.testing.assert_array_equal(n[ids == 1], np.tile([0.0, 0, -1], ((ids == 1).sum(), 1)))
    np.testing.assert_allclose(p[ids == 0].mean(axis=0), [1, 1 / 3, 0], atol=0.06)


def test_points_at_vertices_leave_out_those_without_a_normal() -> None:
    v = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (7, 7, 7.0)])
    points, normals = shade_sites(Scene(v, [[0, 1, 2]]), "vertices", 100, np.random.default_rng(0))
    np.testing.assert_array_equal(normals, np.tile([0.0, 0, 1], (3, 1)))
    np.testing.assert_allclose(points[np.lexsort(points.T)][:, :2], [(0, 0), (1, 0), (0, 1)])
    assert (points[:, 2] > 0).all()


def test_points_at_vertices_leave_out_those_whose_normals_run_within_another_face() -> None:
    """A fin stands on the vertex at the origin: its displaced point is on the fin, on neither side of it."""
    v = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, -1, 0), (1, 1, 0), (0, 0, 1.0)])
    options = "vertices", 100, np.random.default_rng(0)
    bare, _ = shade_sites(Scene(v, [[0, 1, 2]]), *options)
    finned, _ = shade_sites(Scene(v, [[0, 1, 2], [3, 4, 5]]), *options)
    at_origin = [np.abs(points[:, :2]).max(axis=1) < 1e-3 for points in (bare, finned)]
    assert at_origin[0].sum() == 1
    assert at_origin[1].sum() == 0 or (np.abs(finned[at_origin[1], 2]) > 0.5).all()  # the fin's own top


@pytest.mark.parametrize("n", [1, 2, 10, 5000])
def test_every_beginning_is_spread(n: int) -> None:
    order = spread(n)
    np.testing.assert_array_equal(np.sort(order), np.arange(n))
    for m in {1, min(n, 10), min(n, 512)}:
        # Three gaps between neighbours, the longest below three means.
        edges = np.sort(np.concatenate([[-1], order[:m], [n]]))
        assert np.diff(edges).max() <= 3 * (n + 1) / m + 1


def test_methods_that_do_not_exist_are_left_out() -> None:
    assert supported_methods(["nonsense", "octahedral", "octahedral"]) == ["octahedral"]
    with pytest.raises(InputError, match="'nonsense'"):
        supported_methods(["nonsense"])


def test_several_methods_and_a_cap_for_embree(tmp_path: Path) -> None:
    options = {"points": 600, "error_points": 64, "sites": "surface", "seed": 3, "weighting": "cosine"}
    options |= {"goal": 1e-3, "reference_method": "octahedral"}
    scene = _tent()
    prepare_references(scene, tmp_path, options)
    (kept,) = tmp_path.iterdir()
    before = kept.read_bytes(), kept.stat().st_mtime_ns
    report = run_bench(
        [scene],
        **options,
        methods=("auto", "nonsense", "octahedral"),
        embree_points=100,
        isolines=(8, 32),
        rays=(64, 1024),
        seconds=2.0,
        references=tmp_path,
    )
    assert [*tmp_path.iterdir()] == [kept]
    assert (kept.read_bytes(), kept.stat().st_mtime_ns) == before
    found = report["scenes"][0]
    assert 0 < found["reference"]["standard_error"] <= 1e-3
    assert list(found["equal_error"][0]["times"]) == ["auto", "octahedral", "embree"]
    assert set(found["build_seconds"]) == {"auto", "octahedral", "embree"}
    assert set(found["pays_after"]) == {"auto", "octahedral"}
    by_setting = {(r["method"], r["setting"]): r for r in found["rows"]}
    assert max(r["points"] for r in found["rows"] if r["method"] == "embree") <= 100
    for k in (8, 32):  # here auto is octahedral, or better
        assert by_setting["auto", k]["diagnostics"]["points"] >= 64
        assert by_setting["octahedral", k]["rmse"] < 0.2
    for entry in found["equal_error"]:
        assert set(entry["speedups"]) == {"auto", "octahedral"} and set(entry["costs"]) == {"octahedral"}


def test_time_against_triangles(report: dict[str, Any], tmp_path: Path) -> None:
    family = []
    for n in (1_000, 100_000):
        scene = copy.deepcopy(report["scenes"][0]) | {"name": f"tent_{n}", "n_faces": n}
        for entry in scene["equal_error"]:
            entry["times"] = {
                "auto": {"value": 2.0 * n**0.25, "bound": ""},
                "embree": {"value": 100.0, "bound": ">" if n > 1_000 else ""},
            }
        family.append(scene)
    other = copy.deepcopy(report["scenes"][0])
    many = {**report, "scenes": [*family[::-1], other]}
    found = scaling(many, LEVELS[2:4], lambda name: name.startswith("tent_"))
    assert found["scenes"] == ["tent_1000", "tent_100000"]
    for level in found["levels"]:
        ours, theirs = level["methods"]["auto"], level["methods"]["embree"]
        assert (ours["factor"], ours["exponent"]) == pytest.approx((2.0, 0.25))
        # A bound is drawn, not fitted; one time makes no law.
        assert theirs["bound"] == ["", ">"] and theirs["exponent"] is None
    plot_scaling(many, found, tmp_path / "scaling.png")
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="none of the family"):
        scaling(many, LEVELS[2:4], lambda name: False)


def test_embree_decides_where_a_tolerance_and_the_reference_differ() -> None:
    """Four points below open sky, where the answer is 1: right, wrong, and a wrong reference."""
    scene = _tent()
    points = np.tile([0.0, 0.0, 5.0], (4, 1))
    normals = np.tile([0.0, 0.0, 1.0], (4, 1))
    answer, reference = np.array([1.0, 1.0005, 0.9, 1.0]), np.array([1.0, 1.0, 1.0, 0.9])
    embree = EmbreeQMC(scene.vertices, scene.faces)
    found = calibrate(lambda tolerance: answer, reference, embree, points, normals, 1e-3)
    assert found.within == 0.5 and found.exonerated == 0.25
    assert found.largest == pytest.approx(0.1) and found.us_per_point >= 0
