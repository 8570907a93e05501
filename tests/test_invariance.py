"""What must not matter: threads, company, order, units, and how a mesh happens to be written down."""

from __future__ import annotations

from collections.abc import Callable

import numba
import numpy as np
import pytest

import scenes
import silint.finder
from scenes import polyhedra
from scenes.clutter import clutter
from scenes.foliage import foliage
from scenes.mesh import concatenate, flipped, moved
from silint import Result, Scene, SilhouetteIntegrator
from silint.core.search import TILE

Mesh = tuple[np.ndarray, np.ndarray]
Points = tuple[np.ndarray, np.ndarray]
Query = Callable[[SilhouetteIntegrator, np.ndarray, np.ndarray, str], np.ndarray]

# The tolerance, for the same geometry in other words: coordinates are rounded anew where something
# turns, edges are cut at other places, and sums are taken in another order.
SAME = 1e-9

METHODS = ("octahedral", "radial")
QUERIES: dict[str, Query] = {
    "cosine": lambda s, p, n, m: s.ambient_occlusion(p, n, 24, "cosine", m),
    "uniform": lambda s, p, n, m: s.ambient_occlusion(p, n, 24, "uniform", m),
    "bent normals": lambda s, p, n, m: s.bent_normals(p, n, 24, m),
    "sky": lambda s, p, n, m: s.sky_view_factor(p, n, (0.3, -0.1, 1.0), 24, m),
    "intervals": lambda s, p, n, m: intervals(s, p, n, m),
}


def intervals(s: SilhouetteIntegrator, p: np.ndarray, n: np.ndarray, method: str) -> np.ndarray:
    """All visible intervals, in the order of the points."""
    if method == "octahedral":
        return s.visibility(p, n, 24).intervals
    lines: list[np.ndarray] = [np.empty((0, 2))] * len(p)
    for found, _, rows in s._finder.radial(*s._finder.shade_points(p, n), 24, None):
        for row, start, count in zip(rows, found.starts, found.counts.sum(axis=1), strict=True):
            lines[row] = found.intervals[start : start + count]
    return np.concatenate(lines)


MESHES: dict[str, Callable[[], Mesh]] = {
    "clutter": lambda: clutter(1, 1),
    "leaves": lambda: foliage(1, 1),
    "fin": lambda: polyhedra.fin(5),
    "moebius strip": lambda: polyhedra.moebius_strip(12),
}


def points_about(mesh: Mesh, n: int, seed: int = 0) -> Points:
    """Half of them on faces, with their normals; half in space, with any normal."""
    rng = np.random.default_rng(seed)
    on_faces, normals = scenes.shade_points(*mesh, n // 2, seed)
    low, high = mesh[0].min(axis=0), mesh[0].max(axis=0)
    free = rng.normal(size=(n - n // 2, 3))
    free /= np.linalg.norm(free, axis=1)[:, None]
    in_space = low + (high - low) * rng.random((len(free), 3))
    return np.concatenate([on_faces, in_space]), np.concatenate([normals, free])


# ------------------------------------------------------------------------------------------ bit for bit


@pytest.fixture
def threads() -> Callable[[int], None]:
    before = numba.get_num_threads()
    yield numba.set_num_threads
    numba.set_num_threads(before)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("query", QUERIES)
@pytest.mark.parametrize("name", MESHES)
def test_the_number_of_threads_changes_no_bit(
    name: str, query: str, method: str, threads: Callable[[int], None]
) -> None:
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("needs two threads")
    mesh = MESHES[name]()
    p, n = points_about(mesh, 40)
    found = []
    for count in (1, 2):
        threads(count)
        # Hierarchies are built in parallel too.
        found.append(QUERIES[query](SilhouetteIntegrator(Scene(*mesh)), p, n, method))
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", MESHES)
def test_neither_company_nor_order_changes_a_bit(name: str, method: str) -> None:
    mesh = MESHES[name]()
    integrator = SilhouetteIntegrator(Scene(*mesh))
    p, n = points_about(mesh, 70)  # more than one tile
    order = np.random.default_rng(1).permutation(len(p))
    for query in ("cosine", "bent normals", "sky"):
        together = QUERIES[query](integrator, p, n, method)
        shuffled = QUERIES[query](integrator, p[order], n[order], method)
        np.testing.assert_array_equal(shuffled, together[order])
        for i in (0, 17, 69):
            np.testing.assert_array_equal(
                QUERIES[query](integrator, p[i : i + 1], n[i : i + 1], method)[0], together[i]
            )


@pytest.mark.parametrize("method", METHODS)
def test_the_size_of_chunks_changes_no_bit(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = MESHES["clutter"]()
    integrator = SilhouetteIntegrator(Scene(*mesh))
    p, n = points_about(mesh, 200)
    done: list[int] = []

    def values() -> Result:
        done.clear()
        return integrator.ambient_occlusion(
            p, n, 24, method=method, full_output=True, progress=lambda i, _: done.append(i)
        )

    base = values()
    # Tiles of one kind only at a time, so that all work is shared as it was.
    monkeypatch.setattr(silint.finder, "_PER_BLOCK", TILE)
    # As little time or memory as possible gives the smallest chunks after the first, much of both large ones.
    for seconds, n_bytes, chunks in ((1e-9, 1 << 28, 4), (0.2, 1, 4), (1e3, 1 << 28, 2)):
        monkeypatch.setattr(silint.finder, "_CHUNK_SECONDS", seconds)
        monkeypatch.setattr(silint.finder, "_CHUNK_BYTES", n_bytes)
        other = values()
        np.testing.assert_array_equal(other.value, base.value)
        np.testing.assert_array_equal(other.error_estimate, base.error_estimate)
        assert other.diagnostics == base.diagnostics
        assert done[-1] == 200 and len(done) == chunks
    # Points that are put into other tiles, in other company.
    monkeypatch.setattr(silint.finder, "_TILED_POINTS", 64)
    other = values()
    np.testing.assert_array_equal(other.value, base.value)
    np.testing.assert_array_equal(other.error_estimate, base.error_estimate)
    assert other.diagnostics["crossings"] == base.diagnostics["crossings"]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("exponent", [-300, -20, 3, 400])
@pytest.mark.parametrize("name", MESHES)
def test_powers_of_two_change_no_bit(name: str, exponent: int, method: str) -> None:
    """The unit of length is the user's: no tolerance anywhere is in absolute terms."""
    vertices, faces = MESHES[name]()
    vertices = np.where(np.abs(vertices) < 2.0**-60, 0.0, vertices)  # 1e-17 times 2^-1000 would be rounded
    points, normals = points_about((vertices, faces), 40)
    base = SilhouetteIntegrator(Scene(vertices, faces))
    scaled = SilhouetteIntegrator(Scene(np.ldexp(vertices, exponent), faces))
    assert scaled.scene.defects == base.scene.defects
    for query in QUERIES.values():
        expected = query(base, points, normals, method)
        found = query(scaled, np.ldexp(points, exponent), normals, method)
        np.testing.assert_array_equal(found, expected)
        # Normals have no unit at all.
        found = query(base, points, np.ldexp(normals, exponent), method)
        np.testing.assert_array_equal(found, expected)


# ------------------------------------------------------------------------------ the same mesh, differently


def same_values(mesh: Mesh, other: Mesh, points: Points, method: str) -> None:
    a, b = SilhouetteIntegrator(Scene(*mesh)), SilhouetteIntegrator(Scene(*other))
    for name in ("cosine", "uniform", "bent normals", "sky"):
        found = QUERIES[name](b, *points, method)
        np.testing.assert_allclose(found, QUERIES[name](a, *points, method), rtol=0, atol=SAME, err_msg=name)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", MESHES)
def test_the_order_of_vertices_and_faces_does_not_matter(name: str, method: str) -> None:
    vertices, faces = MESHES[name]()
    rng = np.random.default_rng(2)
    order = rng.permutation(len(vertices))
    renamed = np.argsort(order)[faces]
    turned = np.array([np.roll(f, k) for f, k in zip(renamed, rng.integers(0, 3, len(faces)), strict=True)])
    shuffled = vertices[order], turned[rng.permutation(len(faces))]
    same_values((vertices, faces), shuffled, points_about((vertices, faces), 40), method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", MESHES)
def test_winding_does_not_matter(name: str, method: str) -> None:
    """Faces hide alike from both sides."""
    mesh = MESHES[name]()
    points = points_about(mesh, 40)
    same_values(mesh, flipped(mesh), points, method)
    some = np.random.default_rng(3).random(len(mesh[1])) < 0.5
    same_values(mesh, (mesh[0], np.where(some[:, None], mesh[1][:, ::-1], mesh[1])), points, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("twin", ["same", "flipped"])
def test_a_mesh_twice_over_is_the_mesh(name: str, twin: str, method: str) -> None:
    mesh = MESHES[name]()
    copy = mesh if twin == "same" else flipped(mesh)
    same_values(mesh, concatenate([mesh, copy]), points_about(mesh, 40), method)
    # With the very same vertices, too.
    same_values(mesh, (mesh[0], np.concatenate([mesh[1], copy[1]])), points_about(mesh, 40), method)


def subdivided(mesh: Mesh) -> Mesh:
    """Every triangle in four, its new corners in the middle of its sides: exact halves of short numbers."""
    vertices, faces = mesh
    a, b, c = vertices[faces].transpose(1, 0, 2)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    triangles = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return triangles, np.arange(len(triangles)).reshape(-1, 3)


@pytest.mark.parametrize("method", METHODS)
def test_flat_faces_may_be_subdivided(method: str) -> None:
    room = concatenate(
        [
            polyhedra.wall_and_floor(4.0),
            moved(polyhedra.box((1.0, 0.5, 1.5)), (0.5, -1.0, 0.75)),
            moved(polyhedra.box((0.5, 0.75, 0.25)), (-1.0, -2.0, 0.5)),
        ]
    )
    fine = subdivided(subdivided(room))
    assert len(Scene(*fine).topology.planes) == len(Scene(*room).topology.planes)
    same_values(room, fine, points_about(room, 60), method)
    # T junctions too: one part fine, its neighbour coarse.
    faces = room[1]
    half = subdivided((room[0], faces[: len(faces) // 2]))
    same_values(
        room, concatenate([half, (room[0], faces[len(faces) // 2 :])]), points_about(room, 60), method
    )


# Rotations that carry the u axis and the octahedron into themselves.
ROTATIONS = {
    "x by 90": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "x by 180": np.array([[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "x by 270": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "y by 180": np.array([[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    "z by 180": np.array([[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
    "y - z by 180": np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0]]),
}


@pytest.mark.parametrize("rotation", ROTATIONS)
@pytest.mark.parametrize("name", ["clutter", "leaves"])
def test_rotations_that_keep_the_isolines(name: str, rotation: str) -> None:
    turn = ROTATIONS[rotation]
    vertices, faces = MESHES[name]()
    p, n = points_about((vertices, faces), 40)
    a = SilhouetteIntegrator(Scene(vertices, faces))
    b = SilhouetteIntegrator(Scene(vertices @ turn.T, faces))
    q, m = p @ turn.T, n @ turn.T
    for weighting in ("cosine", "uniform"):
        np.testing.assert_allclose(
            b.ambient_occlusion(q, m, 24, weighting, "octahedral"),
            a.ambient_occlusion(p, n, 24, weighting, "octahedral"),
            rtol=0,
            atol=SAME,
        )
    np.testing.assert_allclose(
        b.bent_normals(q, m, 24, "octahedral"),
        a.bent_normals(p, n, 24, "octahedral") @ turn.T,
        rtol=0,
        atol=SAME,
    )
    up = np.array([0.3, -0.1, 1.0])
    np.testing.assert_allclose(
        b.sky_view_factor(q, m, turn @ up, 24, "octahedral"),
        a.sky_view_factor(p, n, up, 24, "octahedral"),
        rtol=0,
        atol=SAME,
    )


def test_a_mirror_image_is_seen_mirrored() -> None:
    vertices, faces = MESHES["clutter"]()
    p, n = points_about((vertices, faces), 40)
    mirror = np.array([-1.0, 1.0, 1.0])
    a = SilhouetteIntegrator(Scene(vertices, faces))
    b = SilhouetteIntegrator(Scene(vertices * mirror, faces[:, ::-1]))
    np.testing.assert_allclose(
        b.ambient_occlusion(p * mirror, n * mirror, 24, method="octahedral"),
        a.ambient_occlusion(p, n, 24, method="octahedral"),
        rtol=0,
        atol=SAME,
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shift", [(1.0, -2.0, 0.5), (64.0, 64.0, 64.0)])
def test_the_place_in_the_world_matters_by_rounding_only(
    shift: tuple[float, float, float], method: str
) -> None:
    """A scene 64 units off the origin has its vertices rounded to 64 * 2^-53, and points lifted by as much
    more: 2^-36 of 64 units, 1e-9 of the nearest occluders' distance and so of their size."""
    mesh = MESHES["clutter"]()
    p, n = points_about(mesh, 40)
    a = SilhouetteIntegrator(Scene(*mesh)).ambient_occlusion(p, n, 24, method=method)
    b = SilhouetteIntegrator(Scene(*moved(mesh, shift))).ambient_occlusion(p + shift, n, 24, method=method)
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["clutter_9k", "teapot", "room", "fence", "city"])
def test_scenes_do_not_depend_on_threads_or_order(
    name: str, method: str, threads: Callable[[int], None]
) -> None:
    vertices, faces = scenes.build(name)
    p, n = points_about((vertices, faces), 500)
    order = np.random.default_rng(4).permutation(len(faces))
    threads(1)
    one = SilhouetteIntegrator(Scene(vertices, faces)).ambient_occlusion(p, n, method=method)
    threads(min(2, numba.config.NUMBA_NUM_THREADS))
    two = SilhouetteIntegrator(Scene(vertices, faces)).ambient_occlusion(p, n, method=method)
    np.testing.assert_array_equal(one, two)
    other = SilhouetteIntegrator(Scene(vertices, faces[order])).ambient_occlusion(p, n, method=method)
    np.testing.assert_allclose(other, two, rtol=0, atol=SAME)
