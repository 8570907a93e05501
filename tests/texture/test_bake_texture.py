from __future__ import annotations

import json
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

import silint
from silint import InputError
from silint.io import LUMINANCE
from silint.io.uvs import read_uvs
from silint.texture import bake_texture
from tests.io.test_png import decoded
from tests.texture.shapes import (
    BOX_CELL,
    box,
    box_cell,
    box_side,
    grid,
    obj_text,
    wall_and_floor,
)

# The integrals that a quarter of the sphere, x > 0 and z > 0, leaves of a bent normal on the floor: of
# cos(theta) w / pi it is (2 / (3 pi), 0, 1/3).
QUARTER = np.array([2.0 / (3.0 * np.pi), 0.0, 1.0 / 3.0])


def written(folder, vertices, faces, uvs=None, normals=None, name="mesh.obj"):
    path = folder / name
    path.write_text(obj_text(vertices, faces, uvs, normals))
    return path


def read_exr(path):
    """Values (H, W, C) and coverage (H, W)."""
    exr = pytest.importorskip("OpenEXR")
    with exr.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    names = ("Y",) if "Y" in channels else ("R", "G", "B")
    return np.stack([channels[name] for name in names], axis=-1).astype(float), channels["coverage"] > 0.5


def read_png(path):
    with Image.open(path) as image:
        return np.array(image)


def read_png16(path):
    return decoded(path.read_bytes())


def texel_uv(size):
    """(H, W, 2) of the centres."""
    at = (np.arange(size) + 0.5) / size
    u, v = np.meshgrid(at, 1.0 - at)
    return np.stack([u, v], axis=-1)


def lookups(image, uv):
    """Bilinear lookups, as a graphics card makes them."""
    size = len(image)
    x, y = uv[:, 0] * size - 0.5, (1.0 - uv[:, 1]) * size - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    total = 0.0
    for dj in (0, 1):
        for di in (0, 1):
            weight = (1 - np.abs(x - i - di)) * (1 - np.abs(y - j - dj))
            texel = image[np.clip(j + dj, 0, size - 1), np.clip(i + di, 0, size - 1)]
            total = total + weight[:, None] * texel
    return total


def test_texels_hold_what_the_integrator_says_of_their_places(tmp_path):
    """Seven squares: where a texel lies on the mesh follows from its cell alone."""
    path = written(tmp_path, *box())
    size = 96
    summary = bake_texture(path, tmp_path / "ao.exr", size, isolines=32, samples=1)
    image, coverage = read_exr(tmp_path / "ao.exr")
    integrator = silint.SilhouetteIntegrator(path)
    uv = texel_uv(size)
    for k in range(7):
        at = (uv - box_cell(k)) / BOX_CELL
        inside = ((at > 0.01) & (at < 0.99)).all(axis=2)
        assert coverage[inside].all()
        origin, a, b = box_side(k)
        points = origin + at[inside][:, :1] * a + at[inside][:, 1:] * b
        normals = np.tile(np.cross(a, b), (len(points), 1))
        expected = integrator.ambient_occlusion(points, normals, isolines=32)
        # Places differ by rounding, which moves no silhouette across a line; the file is of float32.
        np.testing.assert_allclose(image[inside, 0], expected, atol=2e-6)
    texels = summary["texels"]
    assert texels["total"] == size**2 and texels["covered"] == coverage.sum() == summary["n_points"]
    assert texels["inside"] == pytest.approx(7 * (BOX_CELL * size) ** 2, rel=0.03)
    assert texels["overlapping"] == texels["shared"] == texels["mixed"] == 0
    # The edges of a box are hard: their sides differ by right.
    assert summary["seams"] == {"smooth": 0, "sharp": 12} and summary["n_charts"] == 7
    assert summary["uv"] == "file" and summary["turned_normals"] == 0
    json.dumps(summary)


@pytest.mark.parametrize("height", [0.3, 400.0])
def test_a_floor_beside_a_wall_has_the_closed_form(tmp_path, height):
    path = written(tmp_path, *wall_and_floor(height))
    size = 64
    bake_texture(path, tmp_path / "ao.exr", size, isolines=256)
    image, _ = read_exr(tmp_path / "ao.exr")
    x = (np.arange(28) + 0.5) / size / 0.45
    # View factor of an infinite wall: (1 - cos(elevation of its top)) / 2.
    expected = 0.5 * (1.0 + x / np.hypot(x, height))
    # Isolines: below 1e-3; the first texel is nearer to the wall than its neighbours, the wall 800 long.
    np.testing.assert_allclose(image[size // 2, 1:28, 0], expected[1:], atol=2e-3)


@pytest.mark.parametrize(
    ("turn", "mirror", "green", "expected"),
    [
        (0, False, "up", (1, 0)),  # u along +x, away from the wall
        (0, True, "up", (-1, 0)),
        (1, False, "up", (0, 1)),  # v along +x
        (1, False, "down", (0, -1)),
        (1, True, "up", (0, 1)),  # mirrored: the bitangent is still along growing v
        (1, True, "down", (0, -1)),
        (2, False, "up", (-1, 0)),
        (3, False, "up", (0, -1)),
        (3, False, "down", (0, 1)),
    ],
)
def test_tangent_space_follows_the_texture(tmp_path, turn, mirror, green, expected):
    path = written(tmp_path, *wall_and_floor(turn=turn, mirror=mirror))
    bake_texture(path, tmp_path / "bent.exr", 24, "bent", isolines=128, green=green)
    image, _ = read_exr(tmp_path / "bent.exr")
    wanted = (QUARTER[0] * expected[0], QUARTER[0] * expected[1], QUARTER[2])
    np.testing.assert_allclose(image[12, 5], wanted, atol=4e-3)


def test_world_space_is_that_of_the_file_whatever_the_texture(tmp_path):
    for turn, mirror in ((0, False), (1, True)):
        path = written(tmp_path, *wall_and_floor(turn=turn, mirror=mirror))
        summary = bake_texture(path, tmp_path / "bent.exr", 24, "bent", isolines=128, space="world")
        image, _ = read_exr(tmp_path / "bent.exr")
        np.testing.assert_allclose(image[12, 5], QUARTER, atol=4e-3)
        assert summary["space"] == "world" and "green" not in summary
        # The picture has unit directions.
        bake_texture(path, tmp_path / "bent.png", 24, "bent", isolines=128, space="world")
        pixel = read_png(tmp_path / "bent.png")[12, 5]
        unit = QUARTER / np.linalg.norm(QUARTER)
        np.testing.assert_allclose(pixel / 255.0 * 2.0 - 1.0, unit, atol=0.01)


def normal_map(folder, x, y, z, name="bumps.png"):
    pixels = np.rint(255 * (0.5 + 0.5 * np.array([x, y, z]))).astype(np.uint8)
    Image.fromarray(np.tile(pixels, (8, 8, 1))).save(folder / name)
    read = pixels / 255.0 * 2.0 - 1.0
    return folder / name, read / np.linalg.norm(read)


@pytest.mark.parametrize(("turn", "channel"), [(0, 0), (1, 1)])
def test_normal_maps_tilt_the_hemisphere(tmp_path, turn, channel):
    """Away from the wall, n has (sin a + cos a) / 2 of its hemisphere; towards it, (1 - sin a) / 2."""
    path = written(tmp_path, *wall_and_floor(turn=turn))
    away = {}
    for sign in (1.0, -1.0):
        tilt = [0.0, 0.0, 0.8]
        tilt[channel] = 0.6 * sign
        bumps, n = normal_map(tmp_path, *tilt)
        for green in ("up", "down"):
            bake_texture(path, tmp_path / "ao.exr", 24, isolines=256, normal_map=bumps, green=green)
            sine = abs(n[channel])
            outwards = sign * (-1.0 if green == "down" and channel == 1 else 1.0) > 0.0
            expected = 0.5 * (sine + n[2]) if outwards else 0.5 * (1.0 - sine)
            away[sign, green] = read_exr(tmp_path / "ao.exr")[0][12, 5, 0]
            assert away[sign, green] == pytest.approx(expected, abs=5e-3)
    # 127.5 stands for 0, and 128 in the file.
    assert (abs(away[1.0, "up"] - away[1.0, "down"]) < 1e-4) == (channel == 0)


def test_a_flat_normal_map_changes_nothing_and_a_folded_one_stays_above_its_face(tmp_path):
    path = written(tmp_path, *wall_and_floor(0.3))
    bake_texture(path, tmp_path / "plain.exr", 16, isolines=16)
    # 127.5, which is no byte, means 0: .exr holds it.
    exr = pytest.importorskip("OpenEXR")
    flat = {
        name: np.full((4, 4), value, np.float32) for name, value in zip("RGB", (0.5, 0.5, 1), strict=True)
    }
    with exr.File({}, flat) as file:
        file.write(str(tmp_path / "flat.exr"))
    summary = bake_texture(path, tmp_path / "same.exr", 16, isolines=16, normal_map=tmp_path / "flat.exr")
    np.testing.assert_allclose(
        read_exr(tmp_path / "same.exr")[0], read_exr(tmp_path / "plain.exr")[0], atol=1e-6
    )
    assert summary["turned_normals"] == 0
    bumps, _ = normal_map(tmp_path, 0.6, 0.0, -0.8)
    summary = bake_texture(path, tmp_path / "folded.exr", 16, isolines=16, normal_map=bumps)
    assert summary["turned_normals"] == summary["n_points"]
    image = read_exr(tmp_path / "folded.exr")[0]
    # Level with the face, a normal sees half of its hemisphere; the floor's far half, or that with the wall.
    assert 0.3 < image.min() and image.max() < 0.6


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball over a floor, without texture coordinates."""
    folder = tmp_path_factory.mktemp("ball")
    sphere = trimesh.creation.icosphere(3)
    floor = grid((-4.0, -4.0, -1.25), (8.0, 0.0, 0.0), (0.0, 8.0, 0.0))
    vertices = np.concatenate([sphere.vertices, floor[0]])
    return written(folder, vertices, np.concatenate([sphere.faces, floor[1] + len(sphere.vertices)]))


@pytest.fixture(scope="module")
def unwrapped(ball):
    """It as a .glb: the new coordinates are the file's own from here on."""
    pytest.importorskip("xatlas")
    path = ball.with_name("unwrapped.glb")
    summary = bake_texture(ball, path, 256, isolines=32)
    return path, summary


def test_an_unwrapped_ball_looks_like_itself_everywhere(unwrapped, tmp_path):
    """Lookups at random places of the mesh, seams included, against the integrator there."""
    path, first = unwrapped
    assert first["uv"] == "unwrapped" and first["uv_reason"] == "the file has no texture coordinates"
    summary = bake_texture(path, tmp_path / "ao.exr", 256, isolines=64)
    assert summary["uv"] == "file" and summary["n_charts"] == first["n_charts"] > 2
    image, _ = read_exr(tmp_path / "ao.exr")
    scene = silint.load_scene(path)
    uvs = read_uvs(path, scene.n_faces)
    rng = np.random.default_rng(1)
    face = rng.integers(0, scene.n_faces, 4000)
    weights = rng.dirichlet([0.4, 0.4, 0.4], 4000)  # mostly beside edges and vertices
    corners = scene.faces[face]
    points = np.einsum("ni,nij->nj", weights, scene.vertices[corners])
    normals = np.einsum("ni,nij->nj", weights, scene.normals[corners])
    uv = np.einsum("ni,nij->nj", weights, uvs[face])
    expected = silint.SilhouetteIntegrator(scene).ambient_occlusion(points, normals, isolines=64)
    error = np.abs(lookups(image, uv)[:, 0] - expected)
    # A texel is 0.04 wide. Openness has kinks along the edges of facets, of a slope of 0.5 at most.
    assert np.sqrt((error**2).mean()) < 1.5e-3 and error.max() < 0.02


def test_seams_agree(unwrapped, tmp_path):
    path, _ = unwrapped
    summary = bake_texture(path, tmp_path / "ao.png", 256, isolines=64)
    seams = summary["seams"]
    assert seams["smooth"] > 20
    # Beyond a step of 8 bits before, far below it after.
    assert seams["largest_jump_after"] < 1e-3 < 1 / 255 < seams["largest_jump_before"] < 0.02
    assert seams["rms_jump_after"] < 0.1 * seams["rms_jump_before"]
    # What was moved is no more than what had to be.
    assert seams["largest_change"] < 1.5 * seams["largest_jump_before"]


@pytest.mark.parametrize("padding", [None, 0, 3])
def test_padding_copies_the_nearest_texel_of_a_chart(tmp_path, padding):
    path = written(tmp_path, *box())
    size = 80
    bake_texture(path, tmp_path / "bent.exr", size, "bent", isolines=16, space="world", padding=padding)
    image, coverage = read_exr(tmp_path / "bent.exr")
    at = np.argwhere(coverage)
    for row, column in np.argwhere(~coverage):
        distance = np.hypot(*(at - (row, column)).T)
        if padding is not None and distance.min() > padding:
            assert (image[row, column] == 0.0).all()
            continue
        nearest = at[distance == distance.min()]
        assert (image[row, column] == image[nearest[:, 0], nearest[:, 1]]).all(axis=1).any()
    # And so no chart's value reaches beyond the middle between it and another: each side has its direction.
    if padding is None:
        uv = texel_uv(size)
        cells = [np.array(box_cell(k)) + 0.5 * BOX_CELL for k in range(7)]
        _, nearest = cKDTree(cells).query(uv[:, :32])
        for k in range(6):
            _, a, b = box_side(k)
            assert (image[:, :32][nearest == k] @ np.cross(a, b) > 0.0).all()


def test_no_background_at_any_mip_level(tmp_path):
    """Inside a closed box everything is black, and the background would be white."""
    path = written(tmp_path, *box(inwards=True, floor=False))
    bake_texture(path, tmp_path / "ao.png", 64, isolines=16)
    level = read_png(tmp_path / "ao.png").astype(float)
    while True:
        assert level.max() == 0.0
        if len(level) == 1:
            break
        level = level.reshape(len(level) // 2, 2, -1, 2).mean(axis=(1, 3))
    bake_texture(path, tmp_path / "ao.png", 64, isolines=16, padding=1)
    assert read_png(tmp_path / "ao.png").max() == 255


@pytest.mark.parametrize("quantity", ["ao", "sky", "bent", "irradiance"])
def test_a_glb_shows_the_texture(tmp_path, quantity):
    light = silint.Environment.constant((1.0, 2.0, 3.0)) if quantity == "irradiance" else None
    path = written(tmp_path, *box())
    out, png = tmp_path / "box.glb", tmp_path / "box.png"
    bake_texture(path, out, 32, quantity, isolines=16, environment=light)
    bake_texture(path, png, 32, quantity, isolines=16, environment=light)
    mesh = trimesh.load(out, process=False, force="mesh")
    material = mesh.visual.material
    shown = material.occlusionTexture if quantity in ("ao", "sky") else material.baseColorTexture
    other = material.baseColorTexture if quantity in ("ao", "sky") else material.occlusionTexture
    assert other is None
    assert np.array_equal(np.asarray(shown), read_png(png))
    vertices, faces, uvs = box()
    np.testing.assert_allclose(mesh.vertices[mesh.faces], vertices[faces], atol=1e-6)
    np.testing.assert_allclose(mesh.visual.uv[mesh.faces], uvs, atol=1e-6)
    flat = np.cross(*np.moveaxis(vertices[faces][:, 1:] - vertices[faces][:, :1], 1, 0))
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(mesh.vertex_normals[mesh.faces], np.repeat(flat[:, None], 3, 1), atol=1e-6)
    text = out.read_bytes()
    assert (b"KHR_materials_unlit" in text) == (quantity not in ("ao", "sky"))
    assert b'"wrapS":33071' in text
    with Image.open(png) as image:
        metadata = json.loads(image.text["silint"])
    assert metadata["quantity"] == quantity and metadata["size"] == 32


def test_irradiance_is_linear_in_exr_and_toned_in_png(tmp_path):
    rgb = np.array([1.0, 2.0, 3.0])
    path = written(tmp_path, *box())
    for name in ("light.exr", "light.png"):
        bake_texture(
            path,
            tmp_path / name,
            48,
            "irradiance",
            environment=silint.Environment.constant(rgb),
            isolines=128,
        )
    bake_texture(path, tmp_path / "ao.exr", 48, isolines=128)
    light, coverage = read_exr(tmp_path / "light.exr")
    ao, _ = read_exr(tmp_path / "ao.exr")
    # Octahedral isolines against radial ones.
    np.testing.assert_allclose(light, np.pi * rgb * ao, atol=0.03)
    np.testing.assert_allclose(light / light[..., :1], np.broadcast_to(rgb, light.shape), rtol=1e-5)
    mean = (light[coverage] @ LUMINANCE).mean()
    linear = 1.0 - np.exp(-light / mean)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = read_png(tmp_path / "light.png") / 255.0
    np.testing.assert_allclose(shown, encoded, atol=0.51 / 255)


def test_normals_are_those_that_are_asked_for(tmp_path):
    """Of a box alone: only the face itself blocks, so that a leaning normal n sees (1 + n.f) / 2."""
    vertices, faces, uvs = box(floor=False)
    size = 64
    middle = vertices.mean(axis=0)
    leaning = vertices[faces] - middle  # towards the corners, as the mean of three sides is
    bare = written(tmp_path, vertices, faces, uvs, name="bare.obj")
    own = written(tmp_path, vertices, faces, uvs, leaning, name="own.obj")
    seen = {}
    for path, normals, source in [
        (bare, "auto", "creased"),
        (bare, "flat", "flat"),
        (bare, "smooth", "smooth"),
        (own, "auto", "file"),
        (own, "file", "file"),
        (own, "flat", "flat"),
        (own, "smooth", "smooth"),
    ]:
        summary = bake_texture(path, tmp_path / "ao.exr", size, isolines=256, samples=1, normals=normals)
        assert summary["normals"] == source
        seen[path.stem, normals] = read_exr(tmp_path / "ao.exr")[0][..., 0]
    assert (seen["bare", "auto"] == 1.0).all() and (seen["bare", "flat"] == 1.0).all()
    assert (seen["own", "flat"] == 1.0).all()
    for k in range(6):
        at = (texel_uv(size) - box_cell(k)) / BOX_CELL
        inside = ((at > 0.02) & (at < 0.98)).all(axis=2)
        across, up = (2.0 * at[inside] - 1.0).T
        expected = 0.5 * (1.0 + 1.0 / np.sqrt(1.0 + across**2 + up**2))
        for key in (("bare", "smooth"), ("own", "auto"), ("own", "file"), ("own", "smooth")):
            np.testing.assert_allclose(seen[key][inside], expected, atol=1e-3)  # of 256 isolines
    message = refused(bare, tmp_path / "ao.exr", 16, normals="file")
    assert message.endswith("has no normals of its own, which normals='file' asks for; try 'smooth'")
    assert "normals is 'round'" in refused(bare, tmp_path / "ao.exr", 16, normals="round")


@pytest.mark.parametrize("quantity", ["ao", "bent"])
def test_sixteen_bits_are_those_of_the_values(tmp_path, quantity):
    path = written(tmp_path, *box())
    summary = bake_texture(path, tmp_path / "deep.png", 40, quantity, isolines=16, depth=16)
    assert summary["depth"] == 16
    bake_texture(path, tmp_path / "values.exr", 40, quantity, isolines=16)
    bake_texture(path, tmp_path / "flat.png", 40, quantity, isolines=16)
    values, _ = read_exr(tmp_path / "values.exr")
    if quantity == "bent":
        values = 0.5 + 0.5 * values / np.linalg.norm(values, axis=2, keepdims=True)
    deep = read_png16(tmp_path / "deep.png").reshape(values.shape)
    # Half a step, and float32's rounding in the .exr.
    np.testing.assert_allclose(deep / 65535.0, values, atol=0.51 / 65535)
    np.testing.assert_allclose(read_png(tmp_path / "flat.png").reshape(values.shape), deep / 257.0, atol=0.51)
    with Image.open(tmp_path / "deep.png") as image:
        assert json.loads(image.text["silint"])["quantity"] == quantity


def test_a_texture_of_one_texel(tmp_path):
    path = written(tmp_path, *box())
    summary = bake_texture(path, tmp_path / "one.png", 1, isolines=16)
    assert read_png(tmp_path / "one.png").shape == (1, 1)
    assert summary["texels"]["covered"] == summary["texels"]["shared"] == 1


def test_every_option_changes_something(tmp_path):
    """Texels of a scene in which each of the options matters."""
    path = written(tmp_path, *box())
    bumps, _ = normal_map(tmp_path, 0.3, 0.3, 0.9)
    sun = silint.Environment.from_function(lambda w: np.maximum(w, 0.1), 16)
    common = {"size": 40, "isolines": 16}
    variants = [
        ("ao", {}),
        ("ao", {"size": 41}),
        ("ao", {"isolines": 18}),
        ("ao", {"isolines": None, "tolerance": 1e-3}),
        ("ao", {"method": "octahedral"}),
        ("ao", {"weighting": "uniform"}),
        ("ao", {"padding": 1}),
        ("ao", {"samples": 16}),
        ("ao", {"normal_map": bumps}),
        ("ao", {"normal_map": bumps, "green": "down"}),
        ("sky", {}),
        ("sky", {"up": (1, 0, 1)}),
        ("bent", {}),
        ("bent", {"space": "world"}),
        ("bent", {"green": "down"}),
        ("irradiance", {"environment": silint.Environment.constant((1, 1, 1))}),
        ("irradiance", {"environment": sun}),
    ]
    if trimesh.util.has_module("xatlas"):
        variants.append(("ao", {"uv": "unwrap"}))
    seen = []
    for i, (quantity, options) in enumerate(variants):
        out = tmp_path / f"{i}.exr"
        bake_texture(path, out, quantity=quantity, **(common | options))
        seen.append(read_exr(out)[0].round(5).tobytes())
    assert len(set(seen)) == len(variants)


def test_progress_ends_with_all_points(tmp_path):
    calls = []
    path = written(tmp_path, *box())
    summary = bake_texture(
        path, tmp_path / "a.png", 24, isolines=8, progress=lambda done, all_: calls.append((done, all_))
    )
    assert calls and calls[-1] == (summary["n_points"],) * 2
    assert all(a[0] <= b[0] for a, b in pairwise(calls))


def refused(*arguments, **options) -> str:
    with pytest.raises(InputError) as caught:
        bake_texture(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_bad_options_are_told_before_anything_is_computed(tmp_path):
    path = written(tmp_path, *box())
    out = tmp_path / "out.png"
    for options, words in [
        ({"size": 0}, "size is 0"),
        ({"size": 9000}, "8192"),
        ({"size": 4.0}, "size is 4.0"),
        ({"quantity": "gloss"}, "quantity"),
        ({"uv": "own"}, "'auto', 'file', 'unwrap'"),
        ({"padding": -1}, "padding is -1"),
        ({"samples": 0}, "samples is 0"),
        ({"samples": 65}, "samples is 65"),
        ({"space": "object"}, "space"),
        ({"space": "world"}, "only quantity 'bent'"),
        ({"green": "left"}, "green"),
        ({"green": "down"}, "neither"),
        ({"green": "down", "quantity": "bent", "space": "world"}, "neither"),
        ({"method": "magic"}, "method"),
        ({"weighting": "round"}, "weighting"),
        ({"isolines": -3}, "isolines"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"up": (0, 0, 0)}, "up"),
        ({"environment": 3}, "only quantity 'irradiance'"),
        ({"quantity": "irradiance"}, "needs an environment"),
        ({"depth": 12}, "depth is 12; expected 8 or 16"),
        ({"depth": "16"}, "depth is '16'"),
        ({"depth": True}, "depth is True"),
        ({"depth": 16.0}, "depth is 16.0"),
        ({"wobble": 3}, "unknown option 'wobble'"),
        ({"normal_map": tmp_path / "no.png"}, "no.png"),
        ({"normal_map": path}, "unknown suffix"),
    ]:
        message = refused(path, out, **({"size": 16} | options))
        assert words in message, message
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "grey.png")
    assert "grey" in refused(path, out, 16, normal_map=tmp_path / "grey.png")
    for name in ("out.exr", "out.glb"):
        assert "depth is 16; only .png" in refused(path, tmp_path / name, 16, depth=16)
    assert ".png .exr .glb" in refused(path, tmp_path / "out.jpg", 16)
    assert "no such file" in refused(tmp_path / "none.obj", out, 16)
    assert not out.exists()
    glb = tmp_path / "same.glb"
    trimesh.creation.box().export(glb)
    assert "is the mesh itself" in refused(glb, glb, 16)


def test_coordinates_that_are_not_fit_for_a_bake(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    vertices, faces, uvs = box()
    out = tmp_path / "out.png"

    def complaint(uvs, uv="file"):
        return refused(written(tmp_path, vertices, faces, uvs), out, 32, uv=uv)

    assert "no texture coordinates; use uv='unwrap'" in complaint(None)
    # The third row of charts lies across v = 1; or else wholly beyond, where it falls onto the first.
    assert "span [0.02, 0.9667] x [0.024, 1.16]" in complaint(uvs * (1, 1.2))
    assert "belong to two or more faces, once all charts are moved into [0, 1]" in complaint(uvs * (1, 1.5))
    assert "not finite" in complaint(uvs * np.nan)
    assert "no area for 100 % of the surface" in complaint(uvs * (1, 0))
    stacked = uvs.copy()
    stacked[2:4] = uvs[:2]
    message = complaint(stacked)
    assert "% of the texels in its charts belong to two or more faces" in message
    assert 100 / 7 < float(message.split(": ")[1].split(" %")[0]) < 100 / 5
    # "auto" says both why the file's were no good and why there are no others.
    message = complaint(stacked, "auto")
    assert "belong to two or more faces, and unwrapping needs the package xatlas" in message
    assert not out.exists()


def test_charts_in_other_squares_are_baked_as_if_in_this_one(tmp_path):
    vertices, faces, uvs = box()
    elsewhere = uvs.copy()
    elsewhere[:2] += (3.0, -1.0)
    elsewhere[4:6] += (0.0, 1.0)
    images = []
    for moved in (uvs, elsewhere):
        summary = bake_texture(written(tmp_path, vertices, faces, moved), tmp_path / "a.png", 48, isolines=8)
        assert summary["uv"] == "file"
        images.append(read_png(tmp_path / "a.png"))
    assert summary["shifted_faces"] == 4 and summary["clamped_corners"] == 0
    # Subtracting 3 rounds: a texel on a chart's border may take another point.
    assert np.abs(images[0].astype(int) - images[1]).max() <= 1


def test_faces_without_area_are_counted(tmp_path):
    vertices, faces, uvs = box()
    extra = np.array([[0, 1, 1]])
    faces, uvs = np.concatenate([faces, extra]), np.concatenate([uvs, uvs[:1]])
    summary = bake_texture(written(tmp_path, vertices, faces, uvs), tmp_path / "a.glb", 16, isolines=8)
    assert summary["faces_without_area"] == 1
