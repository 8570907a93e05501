"""Visible regions as arcs: kept, lit and written; and where the command line meets them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import silint
from scenes import polyhedra
from silint import InputError, Scene, SilhouetteIntegrator, VisibleArcs
from silint.bake import bake
from silint.prt import prt


@pytest.fixture(scope="module")
def box() -> SilhouetteIntegrator:
    return SilhouetteIntegrator(Scene(*polyhedra.box()))


@pytest.fixture(scope="module")
def shade() -> tuple[np.ndarray, np.ndarray]:
    """Points round the box, whose normals look at it, along it and away; one of them is inside."""
    points = np.array([[2.5, 0.2, 0.3], [0.1, -1.9, 0.4], [0.3, 0.2, 2.2], [1.7, 1.6, 1.9], [0.1, 0.2, 0.3]])
    normals = np.array(
        [[-1.0, 0.2, 0.1], [0.1, 1.0, -0.2], [0.0, 0.3, -1.0], [1.0, 1.0, 1.0], [0.0, 0.0, 1.0]]
    )
    return points, normals


@pytest.fixture(scope="module")
def arcs(box: SilhouetteIntegrator, shade: tuple) -> VisibleArcs:
    found = box.visibility(*shade, method="exact")
    assert isinstance(found, VisibleArcs)
    return found


def test_it_integrates_as_the_queries_do(box, shade, arcs):
    """Bit for bit: the same sums over the same arcs."""
    assert len(arcs) == 5 and arcs.certain.all() and arcs.diagnostics["exact_points"] == 5
    np.testing.assert_array_equal(arcs.ambient_occlusion(), box.ambient_occlusion(*shade, method="exact"))
    np.testing.assert_array_equal(
        arcs.ambient_occlusion("uniform"),
        box.ambient_occlusion(*shade, weighting="uniform", method="exact"),
    )
    np.testing.assert_array_equal(arcs.bent_normals(), box.bent_normals(*shade, method="exact"))
    np.testing.assert_array_equal(
        arcs.sky_view_factor((0, 1, 0)), box.sky_view_factor(*shade, (0, 1, 0), method="exact")
    )
    np.testing.assert_array_equal(arcs.sh_transfer(3), box.sh_transfer(*shade, 3, method="exact"))
    n = shade[1] / np.linalg.norm(shade[1], axis=1)[:, None]
    along = (arcs.vector_irradiance() * n).sum(axis=1) / np.pi
    np.testing.assert_allclose(along, arcs.ambient_occlusion(), rtol=0, atol=1e-15)


def test_a_point_inside_sees_nothing_and_one_outside_sees_all(arcs):
    counts = np.diff(arcs.offsets)
    assert counts[4] == 0 and (counts[:4] > 0).all()
    horizon = arcs.edges[arcs.offsets[3] : arcs.offsets[4], 0] < 0
    assert horizon.all() and arcs.ambient_occlusion()[3] == 1.0


def test_edges_are_those_of_the_file():
    """Each side of the box has corners of its own: edges name the first copy of a corner."""
    vertices, faces = polyhedra.box()
    split = vertices[faces].reshape(-1, 3)
    integrator = SilhouetteIntegrator(Scene(split, np.arange(len(split)).reshape(-1, 3)))
    found = integrator.visibility([[2.5, 0.2, 0.3]], [[-1.0, 0.2, 0.1]], method="exact")
    on_mesh = found.edges[found.edges[:, 0] >= 0]
    assert len(on_mesh) > 3
    for v in np.unique(on_mesh):
        assert v == np.flatnonzero((split == split[v]).all(axis=1))[0]
    # An arc lies in the plane of its edge and the point.
    a, b = split[on_mesh[:, 0]] - [2.5, 0.2, 0.3], split[on_mesh[:, 1]] - [2.5, 0.2, 0.3]
    inner = found.directions[found.edges[:, 0] >= 0, 6:]
    np.testing.assert_allclose(np.abs((a * inner).sum(axis=1)).max(), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs((b * inner).sum(axis=1)).max(), 0.0, atol=1e-9)


def test_light_of_harmonics_is_exact(arcs):
    """A constant sky of radiance 2 gives 2 pi AO; any sky gives pi times its product with the transfer."""
    constant = np.zeros(9)
    constant[0] = 2.0 * np.sqrt(4.0 * np.pi)
    np.testing.assert_allclose(
        arcs.sh_irradiance(constant)[:, 0], 2.0 * np.pi * arcs.ambient_occlusion(), rtol=0, atol=1e-13
    )
    sky = np.random.default_rng(0).normal(size=(16, 3))
    np.testing.assert_allclose(arcs.sh_irradiance(sky), np.pi * arcs.sh_transfer(3) @ sky, rtol=0, atol=1e-12)


def test_it_comes_back_from_a_file(arcs, tmp_path: Path):
    arcs.save(tmp_path / "arcs.npz")
    back = VisibleArcs.load(tmp_path / "arcs.npz")
    for name in ("points", "normals", "offsets", "directions", "edges", "certain"):
        np.testing.assert_array_equal(getattr(back, name), getattr(arcs, name))
    np.testing.assert_array_equal(back.bent_normals(), arcs.bent_normals())


def test_bad_input(box, arcs, shade, tmp_path: Path):
    with pytest.raises(InputError, match=r"coefficients has length 5 on axis 0; expected a square"):
        arcs.sh_irradiance(np.ones(5))
    with pytest.raises(InputError, match=r"coefficients has shape \(4, 1, 1\)"):
        arcs.sh_irradiance(np.ones((4, 1, 1)))
    with pytest.raises(InputError, match="weighting is 'area'"):
        arcs.ambient_occlusion("area")
    with pytest.raises(InputError, match="method is 'exact'"):
        box.irradiance(*shade, silint.Environment.constant(1.0), method="exact")
    (tmp_path / "other.npz").write_bytes(b"no zip")
    with pytest.raises(InputError, match=r"other\.npz: not a file of visible arcs"):
        VisibleArcs.load(tmp_path / "other.npz")
    box.visibility(*shade, isolines=4).save(tmp_path / "lines.npz")
    with pytest.raises(InputError, match=r"lines\.npz: not arcs of schema"):
        VisibleArcs.load(tmp_path / "lines.npz")


def test_explain_says_what_is_left_out(box):
    parts = box.explain("bent_normals", method="exact").as_dict()
    assert parts["arrangement"]["built"]
    assert not parts["tables"]["built"] and not parts["isolines"]["built"]
    assert "512 lines" in box.explain("ambient_occlusion").as_dict()["arcs"]["reason"]


def test_bake_and_prt_take_it(box, tmp_path: Path):
    vertices, faces = polyhedra.box()
    (tmp_path / "box.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in vertices)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces)
    )
    summary = bake(tmp_path / "box.obj", tmp_path / "box.npz", method="exact")
    assert summary["isolines"] == 0
    with np.load(tmp_path / "box.npz") as data:
        scene = silint.load_scene(tmp_path / "box.obj")
        normals, _ = scene.vertex_normals()
        exact = SilhouetteIntegrator(scene).ambient_occlusion(scene.vertices, normals, method="exact")
        np.testing.assert_array_equal(data["value"], exact)
    transfer = prt(tmp_path / "box.obj", 2, method="exact")
    ao = transfer.coefficients[:, 0] * np.sqrt(4.0 * np.pi)
    np.testing.assert_allclose(ao, exact, rtol=0, atol=1e-13)
