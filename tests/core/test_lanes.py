"""Vector filters against their scalar twins and against exact statements; and that they are vector code."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest
from numba import njit

from silint.core import along, bundles, crossings, face_bundles, filters, radial, search
from silint.core.integrands import radial_sh
from silint.core.lanes import WIDTH, lowest
from silint.core.sh import recurrence

from_python = njit(error_model="numpy")
FIRST = np.zeros(1, np.int64)  # the block; in an array, so that no compiler knows


@from_python
def call_lowest(mask):
    return lowest(mask)


@from_python
def call_tile_mask(nodes, block, tile):
    return filters.tile_mask(nodes, block[0], tile)


@from_python
def call_tile_edge_mask(edges, block, place, tile, decoded):
    return filters.tile_edge_mask(edges, block[0], place[0], place[1], place[2], place[3], tile, decoded)


@from_python
def call_packet_mask(packets, block, q, reach):
    return filters.packet_mask(packets, block[0], q, reach)


@from_python
def call_octahedral_mask(packets, block, q):
    return filters.octahedral_mask(packets, block[0], q)


@from_python
def call_edge_mask(candidates, block, off, q, side):
    return filters.edge_mask(candidates, block[0], off[0], q, side, 0)


@from_python
def call_line_mask(candidates, block, off, q):
    return filters.line_mask(candidates, block[0], off[0], q, off[1], off[2])


@from_python
def call_axis_mask(nodes, block, axis):
    return along.axis_mask(nodes, block[0], axis)


@from_python
def call_corner_mask(corners, block, place, axis):
    return along.corner_mask(corners, block[0], place[0], place[1], place[2], place[3], axis)


@from_python
def call_project(lanes, spans, n, frame, n_lines):
    crossings._project(lanes, spans, (n[0], n[1], n[2]), frame, n_lines)


TWINS: dict[str, tuple[Callable, Callable]] = {
    "tile": (call_tile_mask, lambda a, b, t: filters.tile_mask.py_func(a, b[0], t)),
    "tile edge": (
        call_tile_edge_mask,
        lambda a, b, p, t, d: filters.tile_edge_mask.py_func(a, b[0], *p, t, d),
    ),
    "packet": (call_packet_mask, lambda a, b, q, r: filters.packet_mask.py_func(a, b[0], q, r)),
    "octahedral": (call_octahedral_mask, lambda a, b, q: filters.octahedral_mask.py_func(a, b[0], q)),
    "edge": (call_edge_mask, lambda a, b, o, q, s: filters.edge_mask.py_func(a, b[0], o[0], q, s, 0)),
    "line": (call_line_mask, lambda a, b, o, q: filters.line_mask.py_func(a, b[0], o[0], q, o[1], o[2])),
    "axis": (call_axis_mask, lambda a, b, x: along.axis_mask.py_func(a, b[0], x)),
    "corner": (call_corner_mask, lambda a, b, p, x: along.corner_mask.py_func(a, b[0], *p, x)),
}


@pytest.fixture(autouse=True)
def scalar_helpers(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a scalar twin calls has to be scalar too: private kernels cannot be called from Python."""
    helpers: list[tuple[ModuleType, str]] = [(filters, "rough_azimuth"), (crossings, "azimuth")]
    for module, name in helpers:
        monkeypatch.setattr(module, name, getattr(module, name).py_func)


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    """Compile all of them while their modules are as they are."""
    rng = np.random.default_rng(0)
    for name in TWINS:
        TWINS[name][0](*INPUTS[name](rng))
    call_project(*edges_in_lanes(rng))


# ---------------------------------------------------------------------------------------------- inputs


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    v = rng.normal(size=(*shape, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def block(*fields: np.ndarray) -> np.ndarray:
    """Fields of 16 lanes, side by side: arrays of shape (16,) or (16, d)."""
    rows = [f[None] if f.ndim == 1 else f.T for f in fields]
    return np.ascontiguousarray(np.concatenate(rows).ravel(), np.float32)


def a_tile(rng: np.random.Generator) -> np.ndarray:
    tile = np.empty(search.N_TILE, np.float32)
    tile[:3], tile[3:6] = rng.uniform(-1, 1, 3), rng.uniform(0, 0.2, 3)
    tile[6:9], tile[9:12] = unit(rng), rng.uniform(0, 0.2, 3)
    tile[search.TILE_SLACK] = 4 * 2.0**-20
    return tile


def a_point(rng: np.random.Generator, per_radian: float) -> np.ndarray:
    q = np.empty(search.N_POINT, np.float32)
    frame = np.empty((3, 3))
    q[:3], q[3:6] = rng.uniform(-0.5, 0.5, 3), unit(rng)
    radial.set_frame(q[3:6].astype(np.float64), frame)
    q[6:9], q[9:12] = frame[0], frame[1]
    q[search.P_SLACK], q[search.P_PER_RADIAN] = 2.0**-20, per_radian
    return q


def some_nodes(rng: np.random.Generator) -> np.ndarray:
    return block(
        rng.uniform(-1, 1, (WIDTH, 3)),
        rng.uniform(0, 0.3, (WIDTH, 3)),
        rng.uniform(0, 0.5, WIDTH),
        rng.uniform(-1, 1, (WIDTH, 3)),
        rng.uniform(0, 0.2, (WIDTH, 3)),
        rng.normal(0, 0.3, WIDTH),
        rng.uniform(0, 0.3, WIDTH),
    )


def some_edges(rng: np.random.Generator) -> np.ndarray:
    """Edges of 16 bits about the centre of a bundle of radius 1, between planes through them."""
    a, b, c, d = (0.5 * rng.uniform(-1, 1, (WIDTH, 3)) for _ in range(4))
    f, g = (np.cross(b - a, e - a) for e in (c, d))
    f, g = (n / np.linalg.norm(n, axis=1)[:, None] for n in (f, g))
    offsets = [-(n * a).sum(axis=1)[:, None] for n in (f, g)]
    fields = np.concatenate([f, offsets[0], g, offsets[1], a, b], axis=1)
    return np.rint(fields.T.ravel() * bundles.FULL_SCALE).astype(np.int16)


def some_candidates(rng: np.random.Generator) -> np.ndarray:
    edges = some_edges(rng).reshape(bundles.N_EDGE_FIELDS, WIDTH) / bundles.FULL_SCALE
    # A little smaller, and somewhere: planes' offsets go with it.
    scale, place = rng.uniform(0.1, 1.0, WIDTH), rng.uniform(-1, 1, (3, WIDTH))
    for plane in (bundles.PLANE_A, bundles.PLANE_B):
        edges[plane + 3] = scale * edges[plane + 3] - (edges[plane : plane + 3] * place).sum(axis=0)
    for vertex in (bundles.VERTEX_A, bundles.VERTEX_B):
        edges[vertex : vertex + 3] = place + scale * edges[vertex : vertex + 3]
    return np.concatenate([edges, np.full((1, WIDTH), 1e-5)]).astype(np.float32).ravel()


def some_packets(rng: np.random.Generator) -> np.ndarray:
    radius = 10 ** rng.uniform(-3, 0, WIDTH)
    return block(rng.uniform(-1, 1, (WIDTH, 3)), radius, 1e-5 * radius)


def an_axis(rng: np.random.Generator) -> np.ndarray:
    axis, frame = np.empty(along.N_AXIS, np.float32), np.empty((3, 3))
    radial.set_frame(unit(rng), frame)
    axis[:3], axis[3:12], axis[along.A_SLACK] = rng.uniform(-1, 1, 3), frame.ravel(), 2.0**-20
    return axis


def some_boxes(rng: np.random.Generator) -> np.ndarray:
    return block(rng.uniform(-1, 1, (WIDTH, 3)), rng.uniform(0, 0.5, (WIDTH, 3)))


def some_corners(rng: np.random.Generator) -> np.ndarray:
    return np.rint(rng.uniform(-1, 1, 9 * WIDTH) * face_bundles.FULL_SCALE).astype(np.int16)


def a_place(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([rng.uniform(-0.7, 0.7, 3), [1.0]]).astype(np.float32)


def an_angle(rng: np.random.Generator) -> np.ndarray:
    phi = rng.uniform(0, 2 * np.pi)
    return np.array([1e-5, np.cos(phi), np.sin(phi)], np.float32)


INPUTS: dict[str, Callable[[np.random.Generator], tuple[np.ndarray, ...]]] = {
    "tile": lambda rng: (some_nodes(rng), FIRST, a_tile(rng)),
    "tile edge": lambda rng: (
        some_edges(rng),
        FIRST,
        a_place(rng),
        a_tile(rng),
        np.zeros(filters.CANDIDATE_BLOCK, np.float32),
    ),
    "packet": lambda rng: (some_packets(rng), FIRST, a_point(rng, 16 / (2 * np.pi)), np.zeros(32, np.int32)),
    "octahedral": lambda rng: (some_packets(rng), FIRST, a_point(rng, 8.0)),
    "edge": lambda rng: (
        some_candidates(rng),
        FIRST,
        np.array([1e-5], np.float32),
        a_point(rng, 1.0),
        np.zeros(WIDTH, np.int32),
    ),
    "line": lambda rng: (some_candidates(rng), FIRST, an_angle(rng), a_point(rng, 1.0)),
    "axis": lambda rng: (some_boxes(rng), FIRST, an_axis(rng)),
    "corner": lambda rng: (some_corners(rng), FIRST, a_place(rng), an_axis(rng)),
}


def bits(mask: int) -> np.ndarray:
    assert 0 <= mask < 1 << WIDTH
    return (int(mask) >> np.arange(WIDTH)) & 1 == 1


def nudged(rng: np.random.Generator, arrays: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Numbers in float32 by a few units in the last place of 1; integers as they are."""
    moved = []
    for a in arrays:
        if a.dtype == np.float32:
            off = 2e-6 * rng.uniform(-1, 1, a.shape) * np.maximum(np.abs(a), 1e-2)
            moved.append((a + off).astype(np.float32))
        else:
            moved.append(a.copy())
    return tuple(moved)


# ------------------------------------------------------------------------------------------------ twins


def test_lowest_is_the_lowest() -> None:
    masks = [1 << i for i in range(32)] + [0xFFFF, 0xFFFFFFFF, 0x8000, 0xC0000000]
    masks += np.random.default_rng(0).integers(1, 1 << 32, 200).tolist()
    for mask in masks:
        assert call_lowest(mask) == (mask & -mask).bit_length() - 1


@pytest.mark.parametrize("name", TWINS)
def test_compiled_filters_decide_as_their_scalar_twins(name: str) -> None:
    """But for lanes that are so close to a decision that rounding takes it."""
    compiled, twin = TWINS[name]
    rng = np.random.default_rng(1)
    n_kept = n_decided = n_lanes = 0
    for _ in range(25):
        arrays = INPUTS[name](rng)
        expected = bits(twin(*(a.copy() for a in arrays)))
        decided = np.ones(WIDTH, bool)
        for _ in range(4):
            decided &= bits(twin(*nudged(rng, arrays))) == expected
        found = bits(compiled(*arrays))
        np.testing.assert_array_equal(found[decided], expected[decided])
        n_kept, n_decided, n_lanes = n_kept + found.sum(), n_decided + decided.sum(), n_lanes + WIDTH
    assert n_decided > 0.98 * n_lanes
    assert 0.03 * n_lanes < n_kept < 0.97 * n_lanes


NASTY = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 3e38, -3e38, 1e-45, 1e-30, 1e19, 1.0, -1.0], np.float32)


@pytest.mark.parametrize("name", [name for name in TWINS if name not in ("tile edge", "corner")])
def test_no_number_is_too_nasty_for_a_filter(name: str) -> None:
    """NaN, infinities and overflow: the twins agree, and NaN does not drop."""
    compiled, twin = TWINS[name]
    rng = np.random.default_rng(2)
    for _ in range(25):
        arrays = INPUTS[name](rng)
        table = arrays[0].reshape(-1, WIDTH)
        lanes_spoilt = rng.random(WIDTH) < 0.5
        fields = rng.random(table.shape) < 0.3
        spoilt = fields & lanes_spoilt
        table[spoilt] = rng.choice(NASTY, int(spoilt.sum()))
        if name == "packet":
            # As bound_packets makes them: where it is is no better known than how large it is.
            unknown = ~(np.abs(table[:3]) < 1e18).all(axis=0)
            table[filters.PACKET_RADIUS, unknown] = np.inf
        all_nan = int(rng.integers(WIDTH))
        table[:, all_nan] = np.nan
        arrays[0][:] = table.ravel()
        with np.errstate(all="ignore"):
            expected = bits(twin(*(a.copy() for a in arrays)))
            decided = np.ones(WIDTH, bool)
            for _ in range(4):
                decided &= bits(twin(*nudged(rng, arrays))) == expected
        found = bits(compiled(*arrays))
        # Contracted products may overflow elsewhere: then the one is infinite or NaN, and does not drop.
        huge = (np.abs(table) > 1e18).any(axis=0) | ~np.isfinite(table).all(axis=0)
        differ = (found != expected) & decided
        assert not differ[~huge].any()
        assert found[all_nan] and expected[all_nan]


def edges_in_lanes(rng: np.random.Generator, nasty: bool = False) -> tuple:
    n = unit(rng)
    frame = np.empty((3, 3))
    radial.set_frame(n, frame)
    a, b = rng.normal(size=(3, WIDTH)), rng.normal(size=(3, WIDTH))
    if nasty:
        for ends in (a, b):
            spoilt = rng.random(ends.shape) < 0.2
            ends[spoilt] = rng.choice([0.0, -0.0, 1e-300, -1e-300, 1e150, 5e-324], int(spoilt.sum()))
        same = rng.random(WIDTH) < 0.1
        b[:, same] = a[:, same]
        opposite = rng.random(WIDTH) < 0.1
        b[:, opposite] = -a[:, opposite]
        up = rng.random(WIDTH) < 0.1
        a[:, up] = frame[2][:, None]
    table = np.zeros((crossings.N_LANE_FIELDS, WIDTH))
    table[:3], table[3:6], table[6:9] = a, b, b - a
    spans = np.zeros((crossings.N_SPAN_FIELDS, WIDTH), np.int32)
    spans[0] = rng.choice([-2, -1, 0, 1, 2, 3], WIDTH)
    return table.ravel(), spans.ravel(), n, frame, int(rng.choice([4, 6, 64, 4096]))


@pytest.mark.parametrize("nasty", [False, True])
def test_edges_are_projected_bit_for_bit_as_by_the_scalar_twin(nasty: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(40):
        numbers, spans, n, frame, n_lines = edges_in_lanes(rng, nasty)
        other_numbers, other_spans = numbers.copy(), spans.copy()
        call_project(numbers, spans, n, frame, n_lines)
        with np.errstate(all="ignore"):
            crossings._project.py_func(other_numbers, other_spans, tuple(n.tolist()), frame, n_lines)
        np.testing.assert_array_equal(spans, other_spans)
        assert (numbers.view(np.int64) == other_numbers.view(np.int64))[~np.isnan(numbers)].all()
        np.testing.assert_array_equal(np.isnan(numbers), np.isnan(other_numbers))


def test_an_edge_is_projected_alike_in_every_lane() -> None:
    """What is known of an edge does not depend on its neighbours."""
    rng = np.random.default_rng(4)
    numbers, spans, n, frame, n_lines = edges_in_lanes(rng)
    shift = np.roll(np.arange(WIDTH), 5)
    turned = numbers.reshape(-1, WIDTH)[:, shift].copy().ravel()
    turned_spans = spans.reshape(-1, WIDTH)[:, shift].copy().ravel()
    call_project(numbers, spans, n, frame, n_lines)
    call_project(turned, turned_spans, n, frame, n_lines)
    np.testing.assert_array_equal(turned.reshape(-1, WIDTH), numbers.reshape(-1, WIDTH)[:, shift])
    np.testing.assert_array_equal(turned_spans.reshape(-1, WIDTH), spans.reshape(-1, WIDTH)[:, shift])


# -------------------------------------------------------------------------------- nothing wrongly dropped


def within(rng: np.random.Generator, centre: np.ndarray, half: np.ndarray, n: int) -> np.ndarray:
    """Points of a box, many of them at its corners."""
    t = np.where(rng.random((n, 1)) < 0.5, rng.choice([-1.0, 1.0], (n, 3)), rng.uniform(-1, 1, (n, 3)))
    return centre.astype(np.float64) + t * half


def test_a_node_is_kept_if_some_point_of_the_tile_may_see_a_contour() -> None:
    rng = np.random.default_rng(5)
    n_needed = 0
    for _ in range(60):
        nodes, _, tile = INPUTS["tile"](rng)
        kept = bits(call_tile_mask(nodes, FIRST, tile))
        points, normals = within(rng, tile[:3], tile[3:6], 40), within(rng, tile[6:9], tile[9:12], 40)
        for lane in range(WIDTH):
            node = nodes.reshape(-1, WIDTH)[:, lane].astype(np.float64)
            place, half = node[:3], node[3:6]
            # Highest corner of the box above each point's horizon; planes' values at the point.
            top = ((place - points) * normals).sum(axis=1) + np.abs(normals) @ half
            middle = (points - place) @ node[bundles.NORMAL : bundles.NORMAL + 3] + node[bundles.OFFSET]
            width = np.abs(points - place) @ node[bundles.NORMAL_HALF : bundles.NORMAL_HALF + 3]
            needed = (top >= 0) & (np.abs(middle) <= width + node[bundles.OFFSET_HALF])
            assert kept[lane] or not needed.any()
            n_needed += needed.any()
    assert n_needed > 100


def exact_edges(
    rng: np.random.Generator, p: np.ndarray, n: np.ndarray, close: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes (16, 2, 4) and ends (16, 2, 3) of edges within a ball of radius 1, and the same in 16 bits.

    Where `close`, the point is nearly on a plane of some, and others reach the horizon barely: float32 and 16
    bits know nothing better.
    """
    a, b, c, d = (0.57 * rng.uniform(-1, 1, (WIDTH, 3)) for _ in range(4))
    if close:
        low = rng.random(WIDTH) < 0.5
        at_horizon = a + (1e-6 * rng.random(WIDTH) - (a - p) @ n)[:, None] * n
        below = b - (np.maximum((b - p) @ n, 0.0) + 0.05)[:, None] * n
        low &= (np.abs(at_horizon) < 0.99).all(axis=1) & (np.abs(below) < 0.99).all(axis=1)
        a, b = np.where(low[:, None], at_horizon, a), np.where(low[:, None], below, b)
        c = np.where(low[:, None], c, p + 1e-6 * unit(rng, WIDTH))
    planes = np.empty((WIDTH, 2, 4))
    for k, other in enumerate((c, d)):
        normal = np.cross(b - a, other - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        planes[:, k, :3], planes[:, k, 3] = normal, -(normal * a).sum(axis=1)
    ends = np.stack([a, b], axis=1)
    fields = np.concatenate([planes.reshape(WIDTH, 8), ends.reshape(WIDTH, 6)], axis=1)
    return planes, ends, np.rint(fields.T.ravel() * bundles.FULL_SCALE).astype(np.int16)


@pytest.mark.parametrize("close", [False, True])
def test_an_edge_is_kept_if_it_is_a_contour_for_some_point_of_the_tile(close: bool) -> None:
    rng = np.random.default_rng(6)
    n_needed = n_kept = 0
    for _ in range(80):
        tile, place = a_tile(rng), a_place(rng)
        tile[3:6] *= 0.3
        if close:
            tile[3:6] = tile[9:12] = 0.0
        p, n = -place[:3].astype(np.float64), tile[6:9].astype(np.float64)
        planes, ends, edges = exact_edges(rng, p, n, close)
        decoded = np.empty(filters.CANDIDATE_BLOCK, np.float32)
        kept = bits(call_tile_edge_mask(edges, FIRST, place, tile, decoded))
        # The tile's centre is the origin of `place`.
        points = within(rng, np.zeros(3), tile[3:6], 60) - place[:3]
        normals = within(rng, tile[6:9], tile[9:12], 60)
        sides = np.einsum("ekj,pj->epk", planes[..., :3], points) + planes[:, None, :, 3]
        heights = np.einsum("ekj,pj->epk", ends, normals) - (points * normals).sum(axis=1)[:, None]
        needed = (sides[..., 0] * sides[..., 1] <= 0) & (heights >= 0).any(axis=2)
        assert (kept | ~needed.any(axis=1)).all()
        n_needed += needed.any(axis=1).sum()
        n_kept += kept.sum()
        # All are handed on, no more wrong than is said: in place, and in distance from any point of the tile.
        table = decoded.reshape(-1, WIDTH).T.astype(np.float64)
        wrong = table[:, filters.WRONG]
        for k, (plane, vertex) in enumerate(((0, bundles.VERTEX_A), (4, bundles.VERTEX_B))):
            off = table[:, vertex : vertex + 3] - place[:3] - ends[:, k]
            assert (np.linalg.norm(off, axis=1) <= 2 * wrong).all()
            distance = table[:, plane : plane + 3] @ (points + place[:3]).T + table[:, plane + 3, None]
            assert (np.abs(distance - sides[..., k]) <= wrong[:, None]).all()
    assert 100 < n_needed <= n_kept < 0.95 * 80 * WIDTH


def frame_of(q: np.ndarray) -> np.ndarray:
    """T and M of a point, in float64."""
    return q[6:12].astype(np.float64).reshape(2, 3)


def packed(planes: np.ndarray, ends: np.ndarray, wrong: float) -> np.ndarray:
    """Candidates, off by what they may be off by."""
    fields = np.concatenate(
        [planes.reshape(WIDTH, 8), ends.reshape(WIDTH, 6), np.full((WIDTH, 1), wrong)], axis=1
    )
    return fields.T.ravel().astype(np.float32)


@pytest.mark.parametrize("close", [False, True])
def test_edges_that_float32_drops_or_decides_are_as_float64_has_them(close: bool) -> None:
    rng = np.random.default_rng(7)
    n_known = 0
    for _ in range(80):
        q, wrong, off = a_point(rng, 1.0), 1e-5, 1e-5
        p, n = q[:3].astype(np.float64), q[3:6].astype(np.float64)
        planes, ends, _ = exact_edges(rng, p, n, close)
        moved_planes = planes + rng.uniform(-0.2, 0.2, planes.shape) * wrong
        moved_ends = ends + rng.uniform(-0.5, 0.5, ends.shape) * off
        side = np.empty(WIDTH, np.int32)
        candidates = packed(moved_planes, moved_ends, wrong)
        kept = bits(call_edge_mask(candidates, FIRST, np.array([off], np.float32), q, side))
        sides = planes[..., :3] @ p + planes[..., 3]
        needed = (sides[:, 0] * sides[:, 1] <= 0) & ((ends - p) @ n >= 0).any(axis=1)
        assert (kept | ~needed).all()
        # What is said of a side is true.
        known = side != 0
        assert (np.sign(sides[known, 0]) == side[known]).all() and (
            np.sign(sides[known, 1]) == -side[known]
        ).all()
        n_known += known.sum()
        # And one line: kept if the ends are on either side of its plane.
        angle = an_angle(rng)
        if close:
            # That of an end, but for 1e-6.
            end = frame_of(q) @ (ends[0, 0] - p)
            phi = np.arctan2(end[1], end[0]) + 1e-6 * rng.uniform(-1, 1)
            angle[1:] = np.cos(phi), np.sin(phi)
        kept = bits(call_line_mask(candidates, FIRST, np.array([off, *angle[1:]], np.float32), q))
        t, m = q[6:9].astype(np.float64), q[9:12].astype(np.float64)
        across = (ends - p) @ (float(angle[1]) * m - float(angle[2]) * t)
        assert (kept | (across[:, 0] * across[:, 1] > 0)).all()
        assert not kept.all()
    assert n_known > 100


def test_a_packet_is_kept_if_an_edge_in_it_crosses_a_line() -> None:
    """With every radial line that it crosses in its reach; octahedral lines too."""
    rng = np.random.default_rng(8)
    k_lines, n_crossed = 16, 0
    for _ in range(120):
        q = a_point(rng, k_lines / (2 * np.pi))
        centres, radius = rng.uniform(-1, 1, (WIDTH, 3)), 10 ** rng.uniform(-2.5, -0.3, WIDTH)
        a, b = (centres + radius[:, None] * unit(rng, WIDTH) for _ in range(2))
        packets, reach = block(centres, radius * (1 + 1e-6), np.zeros(WIDTH)), np.empty(2 * WIDTH, np.int32)
        kept = bits(call_packet_mask(packets, FIRST, q, reach))
        o = q.copy()
        o[6:12], o[search.P_PER_RADIAN] = [0, 1, 0, 0, 0, 1], 0.5 * k_lines
        kept_octahedral = bits(call_octahedral_mask(packets, FIRST, o))
        p, n, t, m = (q[i : i + 3].astype(np.float64) for i in (0, 3, 6, 9))
        s = np.linspace(0, 1, 400)[:, None, None]
        w = (1 - s) * (a - p) + s * (b - p)
        above = w @ n > 0
        sectors = np.floor(np.arctan2(w @ m, w @ t) * k_lines / (2 * np.pi) + 0.5).astype(int) % k_lines
        u = w[..., 0] / np.abs(w).sum(axis=2)
        strips = np.floor((u + 1) * 0.5 * k_lines + 0.5)
        for lane in range(WIDTH):
            crosses = np.flatnonzero(
                (sectors[1:, lane] != sectors[:-1, lane]) & above[1:, lane] & above[:-1, lane]
            )
            for i in crosses:
                x, y = sectors[i, lane], sectors[i + 1, lane]
                if (y - x) % k_lines not in (1, k_lines - 1):
                    continue  # past the axis, or too coarse a walk
                line = x if (y - x) % k_lines == 1 else y
                first, number = reach[lane], reach[WIDTH + lane]
                assert kept[lane] and (line - first) % k_lines < number
                n_crossed += 1
            leaves = (strips[1:, lane] != strips[:-1, lane]) & above[1:, lane] & above[:-1, lane]
            assert kept_octahedral[lane] or not leaves.any()
        assert not kept.all() and not kept_octahedral.all()
    assert n_crossed > 200


def test_what_the_half_line_meets_is_kept() -> None:
    rng = np.random.default_rng(9)
    n_met = n_kept = 0
    for _ in range(200):
        boxes, _, axis = INPUTS["axis"](rng)
        kept = bits(call_axis_mask(boxes, FIRST, axis))
        table = boxes.reshape(-1, WIDTH).astype(np.float64)
        p, d = axis[:3].astype(np.float64), axis[9:12].astype(np.float64)
        with np.errstate(divide="ignore"):
            t0 = (table[:3].T - table[3:].T - p) / d
            t1 = (table[:3].T + table[3:].T - p) / d
        enter, leave = np.minimum(t0, t1).max(axis=1), np.maximum(t0, t1).min(axis=1)
        met = (enter <= leave) & (leave >= 0)
        assert (kept | ~met).all()
        n_met, n_kept = n_met + met.sum(), n_kept + kept.sum()
    assert 100 < n_met <= n_kept < 0.9 * 200 * WIDTH
    n_met = n_kept = 0
    for _ in range(200):
        _, _, place, axis = INPUTS["corner"](rng)
        exact = rng.uniform(-1, 1, (WIDTH, 3, 3))
        corners = np.rint(exact.reshape(WIDTH, 9).T.ravel() * face_bundles.FULL_SCALE).astype(np.int16)
        kept = bits(call_corner_mask(corners, FIRST, place, axis))
        d = axis[9:12].astype(np.float64)
        a, b, c = (place[:3] + exact).transpose(1, 0, 2)
        around = [np.cross(u, v) @ d for u, v in ((a, b), (b, c), (c, a))]
        met = (np.array(around) >= 0).all(axis=0) | (np.array(around) <= 0).all(axis=0)
        assert (kept | ~met).all()
        n_met, n_kept = n_met + met.sum(), n_kept + kept.sum()
    assert 100 < n_met <= n_kept < 0.9 * 200 * WIDTH


# ------------------------------------------------------------------------------------------- vector code

PACKED_X86 = re.compile(r"^\s*v(?:mul|fn?m(?:add|sub)\d+)p[sd]\s", re.M)
SCALAR_X86 = re.compile(r"^\s*v?(?:mul|fn?m(?:add|sub)\d+)s[sd]\s", re.M)
GATHERED_X86 = re.compile(r"^\s*v(?:insertps|gather\w+)\s", re.M)  # lane by lane out of memory
PACKED_NEON = re.compile(r"^\s*f(?:mul|mla|mls)(?:\.(?:4s|2d)\s|\s+v\d+\.(?:4s|2d))", re.M)
SCALAR_NEON = re.compile(r"^\s*f(?:mul|madd|msub|nmadd|nmsub)\s+[sd]\d+", re.M)


def multiplies(compiled: Callable) -> tuple[int, int, int]:
    """Packed and scalar float multiplies, and loads lane by lane, in the machine code of a kernel."""
    machine = platform.machine().lower()
    text = "\n".join(compiled.inspect_asm().values())
    if machine in ("x86_64", "amd64"):
        import llvmlite.binding

        if not dict(llvmlite.binding.get_host_cpu_features()).get("avx2"):
            pytest.skip("no AVX2 here")
        return tuple(len(kind.findall(text)) for kind in (PACKED_X86, SCALAR_X86, GATHERED_X86))
    if machine in ("arm64", "aarch64"):
        return len(PACKED_NEON.findall(text)), len(SCALAR_NEON.findall(text)), 0
    pytest.skip(f"nothing known of {machine}")


@pytest.mark.parametrize("name", [*TWINS, "project"])
def test_loops_over_lanes_are_vector_code(name: str) -> None:
    compiled = call_project if name == "project" else TWINS[name][0]
    n_packed, n_scalar, n_gathered = multiplies(compiled)
    # What is left scalar is what a filter does once, before its loop.
    assert n_packed >= 6
    assert n_scalar <= max(30, n_packed)
    # A signed index might wrap around: every lane is then loaded by itself.
    assert n_gathered < 10


def test_packets_of_ends_are_vector_code() -> None:
    # Compiled for this test: there is no looking into a function that came from the cache.
    compiled = from_python(radial_sh.packet_moments.py_func)
    packet, sums = np.zeros(radial_sh._N_FIELDS * WIDTH), np.zeros(12 * WIDTH)
    compiled(packet, recurrence(2), sums)
    n_packed, n_scalar, n_gathered = multiplies(compiled)
    # Scalar are the factors of each degree, and what stands by for arrays that overlap.
    assert n_packed >= 30 and n_scalar <= n_packed and n_gathered < 10
