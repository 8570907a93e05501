"""From a mesh file to a texture of what its surface sees."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from silint import __version__
from silint.bake import BakeOptions, check_unread, peak_memory
from silint.bake.targets import Sites, chosen_faces
from silint.io import LUMINANCE, TONE_CURVE, check_output
from silint.texture.asset import Asset, left_out, open_asset, with_occlusion
from silint.texture.files import DEPTHS, SUFFIXES, Corners, check_packages, write_texture
from silint.texture.shading import read_normal_map
from silint.validation import InputError, choice, positive_int, unit_vector

if TYPE_CHECKING:
    from silint.environment import Environment
    from silint.scene import Scene
    from silint.texture.surface import Surface

__all__ = ["GREENS", "MAX_SIZE", "SPACES", "SUFFIXES", "UV_SOURCES", "bake_texture"]

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[int, int], None]

UV_SOURCES = ("auto", "file", "unwrap")
SPACES = ("tangent", "world")
GREENS = ("up", "down")
MAX_SIZE = 8192

# Options of a bake into vertices that mean the same here.
_SHARED = (
    *("normals", "occluders", "self_only", "groups", "two_sided"),
    *("max_distance", "falloff", "spread", "backfaces", "ground", "interpolate"),
)


def bake_texture(
    mesh_path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    size: int,
    quantity: str = "ao",
    *,
    isolines: int | None = None,
    tolerance: float | None = None,
    method: str = "auto",
    weighting: str = "cosine",
    up: npt.ArrayLike = (0.0, 0.0, 1.0),
    environment: Environment | str | os.PathLike[str] | None = None,
    uv: str = "auto",
    padding: int | None = None,
    normal_map: str | os.PathLike[str] | None = None,
    space: str = "tangent",
    green: str = "up",
    samples: int = 4,
    depth: int = 8,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Integrate over what the surface of a mesh sees at every texel of a texture, and write that.

    The hemisphere and its weights are those of the *shading normal*; what lies below the face is hidden by
    that face, as by any other: a normal that leans over loses what it leans into.

    Parameters
    ----------
    mesh_path : str or path-like
        Any mesh that `silint.load_scene` reads.
    output : str or path-like
        A .png, .exr or .glb file; see `silint.texture.files` for what stands in each.
    size : int
        Texels a side, 1 to 8192.
    quantity : {"ao", "sky", "bent", "irradiance"}
        As in `silint.bake.bake`.
    isolines, tolerance, method, weighting, up, environment
        As in `silint.bake.bake`.
    uv : {"auto", "file", "unwrap"}
        Texture coordinates: the file's, or new ones by xatlas. "auto" takes the file's where they fit: inside
        [0, 1], and no two charts in one place. Charts that stand whole in another square of the integer grid
        are moved into that one, and what is beyond it by half a texel (1e-3 at most) is clamped.
    padding : int, optional
        Texels around charts that get the value of the nearest chart. By default all there are, so that no
        background shows at any mip level.
    normal_map : path, optional
        Tangent-space map (.png, .jpg, .exr) that turns the shading normals, as `silint.texture.shading` says.
    space : {"tangent", "world"}
        Of bent normals.
    green : {"up", "down"}
        OpenGL or DirectX: which way the second channel of tangent-space bent normals and of `normal_map`
        points.
    samples : int
        Positions in a texel that holds an edge, 1 to 64. Others have one.
    depth : {8, 16}
        Bits a channel of .png.
    progress : callable, optional
        Called with (points done, points in all) from time to time.
    **options
        normals, occluders, self_only, groups, two_sided, max_distance, falloff, spread, backfaces, ground and
        interpolate: see `silint.bake.BakeOptions`. Coordinates may overlap between groups that are baked
        one by one. "auto" normals of a file that has none are smooth but over edges bent by more than 40
        degrees.

    Returns
    -------
    dict
        Counts, seconds, statistics, diagnostics. ``texels`` counts those covered, with several samples,
        overlapping and shared between charts closer than 2 texels; ``seams`` has the largest and the RMS
        difference across seams before and after they were made to agree. Of .glb: ``asset``, what
        `silint.texture.asset.with_occlusion` tells where the source is kept, else ``left_out``, what the
        source has and the output has not, and ``left_out_reason``.

    Raises
    ------
    InputError
        An option, the mesh file or the place of the output is no good, in one line. What can be checked is
        checked before anything is computed, and nothing is left half-written.
    """
    size = positive_int(size, "size", maximum=MAX_SIZE)
    for name in options:
        if name not in _SHARED:
            raise InputError(f"unknown option {name!r}; expected one of {', '.join(_SHARED)}")
    asked = BakeOptions(
        quantity,
        isolines=isolines,
        tolerance=tolerance,
        method=method,
        weighting=weighting,
        up=up,
        environment=environment,
        **options,
    )
    samples = _checked_options(quantity, uv, padding, normal_map, space, green, samples)
    target = check_output(output, SUFFIXES)
    if type(depth) is not int or depth not in DEPTHS:
        raise InputError(f"depth is {depth!r}; expected 8 or 16")
    if depth != 8 and target.suffix.lower() != ".png":
        raise InputError(f"depth is {depth}; only .png has a choice, {target.suffix} has not")
    check_packages(target.suffix.lower())
    check_unread(output, mesh_path, asked.occluders, environment=environment, normal_map=normal_map)
    bumps = None if normal_map is None else read_normal_map(normal_map, green)
    asked = asked.with_light()

    from silint.bake.integrate import integrate
    from silint.scene import as_scene, load_scene
    from silint.texture.surface import Layout, in_tangent_space, shade_points, surface_of, tangents_of

    times = [time.perf_counter()]
    scene = load_scene(mesh_path)
    asset, lost = _source(scene, Path(mesh_path), target, quantity)
    occluders = [as_scene(occluder) for occluder in asked.occluders]
    limits = asked.limits(scene, occluders)
    times.append(time.perf_counter())
    chosen = chosen_faces(scene, asked.groups, os.fspath(mesh_path))
    surface = surface_of(scene, Path(mesh_path), uv, Layout(size, samples, chosen, asked.normals))
    wanted = bumps is not None or (quantity == "bent" and space == "tangent")
    tangents = tangents_of(surface) if wanted else None
    points, normals, turned = shade_points(surface, tangents, bumps)
    times.append(time.perf_counter())
    of_face = scene.face_groups if asked.self_only else None
    groups = None if of_face is None else of_face[surface.texels.sample_face]
    surfaces = None
    if asked.interpolate is not None:
        from silint.interpolation import SAME_NORMAL, face_surfaces

        of_surface = face_surfaces(surface.welded, surface.corners.normals, SAME_NORMAL)
        surfaces = of_surface[surface.texels.sample_face]
    sites = Sites(points, normals, np.ones(len(points), bool), groups, surfaces)
    found = integrate(scene, occluders, sites, asked, limits, progress)
    times += [times[-1] + found.build_seconds, time.perf_counter()]
    texels = surface.texels
    values = texels.means(found.value.reshape(len(points), -1))
    values, seams = _seams(surface, values, size, quantity)
    if quantity == "bent" and tangents is not None and space == "tangent":
        values = in_tangent_space(surface, tangents, values, green)
    image, coverage = _padded(texels.texel, values, size, padding, quantity)
    light: Any = asked.environment
    metadata: dict[str, Any] = {
        "software": f"silint {__version__}",
        "quantity": quantity,
        "size": size,
        **({"depth": depth} if target.suffix.lower() == ".png" else {}),
        "isolines": found.diagnostics["isolines"],
        **({"tolerance": tolerance} if tolerance is not None else {}),
        "method": method,
        "weighting": weighting if quantity == "ao" else "cosine",
        **({"up": unit_vector(up, "up").tolist()} if quantity == "sky" else {}),
        **({"environment": light.name, "colours": f"{TONE_CURVE}, then sRGB"} if light is not None else {}),
        **({"space": space} if quantity == "bent" else {}),
        **({"green": green} if tangents is not None else {}),
        **({"normal_map": os.path.basename(normal_map)} if normal_map is not None else {}),
        **({"two_sided": True} if asked.two_sided else {}),
        **({"occluders": [occluder.name for occluder in occluders]} if occluders else {}),
        **({"self_only": True} if asked.self_only else {}),
        **({"groups": list(asked.groups)} if asked.groups else {}),
        **({"interpolate": asked.interpolate} if asked.interpolate is not None else {}),
        **limits,
        "uv": surface.uv_source,
        "normals": surface.normals_from,
    }
    c = surface.corners
    written = Corners(c.positions[chosen], c.vertices[chosen], c.normals[chosen], c.uvs[chosen])
    told_of_asset: dict[str, Any] = {}
    kept = None
    if asset is not None:
        baked = np.zeros(scene.n_faces, bool)
        baked[chosen] = True

        def kept(png: bytes) -> bytes:
            data, told_of_asset["asset"] = with_occlusion(asset, c.uvs, baked, png, metadata)
            return data

    write_texture(target, quantity, image, coverage, written, metadata, kept, depth)
    times.append(time.perf_counter())

    told = values[:, 0]
    if quantity == "bent":
        told = np.linalg.norm(values, axis=1)
    elif quantity == "irradiance":
        told = values @ LUMINANCE
    steps = ("load", "layout", "build", "integrate", "write")
    return {
        "mesh": os.fspath(mesh_path),
        "output": os.fspath(output),
        **metadata,
        **({"uv_reason": surface.uv_reason} if surface.uv_reason else {}),
        "n_vertices": scene.n_vertices,
        "n_faces": scene.n_faces,
        "n_points": len(points),
        "n_charts": surface.charts.n_charts,
        "texels": {
            "total": size * size,
            "covered": len(texels.texel),
            "inside": texels.inside,
            "mixed": texels.mixed,
            "overlapping": texels.overlapping,
            "shared": texels.shared,
        },
        "seams": seams,
        **told_of_asset,
        **lost,
        "faces_without_area": surface.without_area,
        "shifted_faces": surface.shifted,
        "clamped_corners": surface.clamped,
        "turned_normals": turned,
        "mean": float(told.mean()),
        "min": float(told.min()),
        "max": float(told.max()),
        "open": asked.open_value,
        "files": [{"path": os.fspath(output), "bytes": target.stat().st_size}],
        "seconds": dict(zip(steps, np.diff(times).tolist(), strict=True)),
        "peak_memory_bytes": peak_memory(),
        **({"interpolation": found.interpolation} if found.interpolation is not None else {}),
        "diagnostics": found.diagnostics,
    }


def _checked_options(
    quantity: str,
    uv: str,
    padding: int | None,
    normal_map: object,
    space: str,
    green: str,
    samples: int,
) -> int:
    choice(uv, "uv", UV_SOURCES)
    if padding is not None:
        positive_int(padding, "padding", 0)
    choice(space, "space", SPACES)
    choice(green, "green", GREENS)
    if space == "world" and quantity != "bent":
        raise InputError(f"space is 'world'; only quantity 'bent' has directions, this is {quantity!r}")
    if green == "down" and normal_map is None and (quantity != "bent" or space == "world"):
        raise InputError("green is 'down', but there are neither tangent-space bent normals nor a normal map")
    from silint.texture.texels import MAX_SAMPLES

    return positive_int(samples, "samples", 1, MAX_SAMPLES)


def _source(scene: Scene, path: Path, target: Path, quantity: str) -> tuple[Asset | None, dict[str, Any]]:
    """The glTF file that a .glb is to keep, or what that leaves out of its source and why."""
    if target.suffix.lower() != ".glb":
        return None, {}
    reason = "only .glb and .gltf are kept"
    if path.suffix.lower() in (".glb", ".gltf"):
        reason = f"{quantity} is shown by a material of its own"
        if quantity in ("ao", "sky"):
            asset = open_asset(path, scene.faces)
            if not isinstance(asset, str):
                return asset, {}
            reason = asset
    names = left_out(path)
    return None, {"left_out": names, "left_out_reason": reason} if names else {}


def _seams(
    surface: Surface, values: FloatArray, size: int, quantity: str
) -> tuple[FloatArray, dict[str, Any]]:
    """Values whose seams agree, and by how much they did before and do now."""
    from silint.texture.seams import equalised, jumps, seam_lookups

    seams = surface.charts.seams
    report: dict[str, Any] = {"smooth": len(seams.left), "sharp": seams.n_sharp}
    if not len(seams.left):
        return values, report
    rows = np.full(size * size, -1, np.int64)
    rows[surface.texels.texel] = np.arange(len(values))
    lookups = seam_lookups(seams, rows, size)
    out = equalised(lookups, values, positive=quantity != "bent")
    for name, of in (("before", jumps(lookups, values)), ("after", jumps(lookups, out))):
        report[f"largest_jump_{name}"] = float(of.max())
        report[f"rms_jump_{name}"] = float(np.sqrt((of * of).mean()))
    report["largest_change"] = float(np.abs(out - values).max())
    return out, report


def _padded(
    index: npt.NDArray[np.int64], values: FloatArray, size: int, padding: int | None, quantity: str
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """The image (size, size, C), and where a texel has a value of its own."""
    from scipy.ndimage import distance_transform_edt

    coverage = np.zeros((size, size), bool)
    coverage.ravel()[index] = True
    background = 1.0 if quantity in ("ao", "sky") else 0.0
    image = np.full((size, size, values.shape[1]), background)
    image[coverage] = values
    if padding != 0 and not coverage.all():
        distance, (row, column) = distance_transform_edt(~coverage, return_indices=True)
        fill = ~coverage if padding is None else ~coverage & (distance <= padding)
        image[fill] = image[row[fill], column[fill]]
    return image, coverage
