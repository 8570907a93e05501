"""Light from all around: maps, constants and skies, as something to integrate.

How maps lie on the sphere stands in `silint.core.conventions`. Everything a user passes or gets is in the
frame of the scene; an `Environment` holds its map and the rotation between the two.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from silint.core import cie_sky, equirect
from silint.core.integrands import radial_light
from silint.core.integrands.light import LightTable, constant_light, texel_light
from silint.core.integrands.radial import hemisphere_fraction
from silint.core.jit import KERNEL_LOCK
from silint.core.prefix_table import NODES_PER_QUARTER
from silint.core.radial import NO_AIM, RadialIntervals
from silint.core.texel_table import cells_per_quarter
from silint.io.images import read_image
from silint.radial_sky import RadialSky
from silint.radiance_map import MOST_ROWS, Texels, clamped_radiance, map_array
from silint.sh import MAX_DEGREE, project_samples
from silint.skies import Sun, draw_sky
from silint.validation import (
    InputError,
    choice,
    colour,
    finite_number,
    normals_array,
    points_array,
    positive_int,
    positive_number,
    rotation_about,
    rotation_matrix,
    unit_vector,
)

__all__ = ["Environment", "LightTable", "Texels"]

FloatArray = npt.NDArray[np.float64]

UP_AXES = ("y", "z")

# A map's y to the scene's z, its z to -y: the turn by 90 degrees about x that glTF's axes take to Blender's.
_FRAMES = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}

_CONSTANT_HEIGHT = 64  # rows that a constant shows in `texels`
_FINE_ROWS = 256  # texels of less than a degree
_TABLES_KEPT = 4
_CHUNK = 1 << 16  # texels projected to harmonics at a time


@dataclass(frozen=True, eq=False, repr=False)
class Environment:
    """Radiance from infinitely far away, as a function of direction; immutable.

    Made by `from_file`, `from_array`, `constant`, `cie_overcast`, `cie_clear_sky` or `from_function`. The
    unit of radiance is the caller's; integrals come out in it times steradians.

    Attributes
    ----------
    texel_radiance : (H, 2 H, C) float32 or float64, read-only
        The equirectangular map, one radiance for each texel.
    rotation : (3, 3) float64, read-only
        From the frame of the map to that of the scene.
    name : str
        What it was made from.
    clamped : int
        Texels whose radiance was negative, NaN (taken as 0) or infinite (taken as the largest finite one).
    """

    texel_radiance: npt.NDArray[Any]
    rotation: FloatArray
    name: str
    clamped: int = 0
    _tables: dict[int, LightTable] = field(default_factory=dict)
    _of_map: list[RadialSky] = field(default_factory=list)  # shared by all that are turned: one, when made

    def __repr__(self) -> str:
        shape = "constant" if self.is_constant else "{} x {} texels".format(*self.texel_radiance.shape[:2])
        channels = "1 channel" if self.channels == 1 else f"{self.channels} channels"
        return f"Environment({self.name!r}, {shape}, {channels})"

    # ------------------------------------------------------------------------------------------- making one

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], up: str = "y", rotate: float = 0.0) -> Environment:
        """An equirectangular map from an image file.

        Parameters
        ----------
        path : str or path-like
            .hdr, .exr (needs the OpenEXR package: ``pip install 'silint[exr]'``), .png or .jpg, twice as
            wide as high. The last two are decoded from sRGB, and a warning says that they clip the sun.
        up : "y" or "z"
            The scene's axis that the top of the map goes to. For "z" the map is turned by 90 degrees about
            x: its x stays the scene's x, its z becomes -y.
        rotate : float
            Degrees by which the map is then turned about that axis, counter-clockwise as seen from above.

        Returns
        -------
        Environment

        Raises
        ------
        InputError
            In one line that names the file: see `silint.io.images.read_image`; or not 2 : 1, or black.
        """
        frame = _frame(up, rotate)
        image = read_image(path)
        if not image.high_range:
            warnings.warn(
                f"{path}: images of this kind end at white, so that suns and lamps in them are far too dark; "
                "use .hdr or .exr",
                stacklevel=2,
            )
        try:
            return _from_texels(image.pixels, frame, Path(path).name, "image")
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @classmethod
    def from_array(cls, radiance: npt.ArrayLike, up: str = "y", rotate: float = 0.0) -> Environment:
        """An equirectangular map from an array of linear radiance.

        Parameters
        ----------
        radiance : array_like, shape (H, 2 H, 3), (H, 2 H, 1) or (H, 2 H)
            Real numbers of any dtype and layout, the top row first, taken as they are: nothing is decoded
            or scaled. Negative values and NaN count as 0, infinities as the largest finite value; a warning
            says how many texels that were.
        up, rotate
            As for `from_file`.

        Returns
        -------
        Environment

        Raises
        ------
        InputError
            Not numbers, another shape, or without any light.
        """
        return _from_texels(radiance, _frame(up, rotate), "array", "radiance")

    @classmethod
    def constant(cls, radiance: npt.ArrayLike = 1.0) -> Environment:
        """The same radiance from everywhere: a number, or three (red, green, blue)."""
        channels = colour(radiance, "radiance")
        if not channels.any():
            raise InputError("radiance is 0; expected some light")
        if (channels == channels[0]).all():
            channels = channels[:1]
        shape = (_CONSTANT_HEIGHT, 2 * _CONSTANT_HEIGHT, len(channels))
        return cls(np.broadcast_to(channels, shape), _frame("y", 0.0), "constant")

    @classmethod
    def from_function(
        cls,
        function: Callable[[FloatArray], npt.ArrayLike],
        height: int = 512,
    ) -> Environment:
        """A map of a function of direction, sampled at the centres of texels.

        Parameters
        ----------
        function : callable
            Unit directions (m, 3) -> radiance (m, 3), (m, 1) or (m,).
        height : int
            H; the map has H rows and 2 H columns.

        Returns
        -------
        Environment
        """
        height = positive_int(height, "height", maximum=MOST_ROWS)
        step = max(1, (1 << 16) // height)
        pieces = []
        for first in range(0, height, step):
            centres = equirect.texel_centres(height, first, min(first + step, height))
            found = np.asarray(function(centres.reshape(-1, 3)))
            n = centres.shape[0] * centres.shape[1]
            if found.shape not in ((n,), (n, 1), (n, 3)):
                raise InputError(
                    f"function returned shape {found.shape} for {n} directions; expected ({n}, 3) or ({n},)"
                )
            pieces.append(found.reshape(*centres.shape[:2], -1))
        if len({piece.shape[2] for piece in pieces}) > 1:
            raise InputError("function returned 1 channel for some directions and 3 for others")
        return _from_texels(np.concatenate(pieces), _frame("y", 0.0), "function", "function")

    @classmethod
    def cie_overcast(
        cls,
        zenith: npt.ArrayLike = 1.0,
        ground_albedo: npt.ArrayLike = 0.0,
        up: str = "y",
        height: int = 256,
    ) -> Environment:
        """The CIE's traditional overcast sky [MS42]: zenith times (1 + 2 sin(elevation)) / 3.

        Parameters
        ----------
        zenith : number or three
            Radiance of the zenith; irradiance on level ground is 7/9 pi times that.
        ground_albedo : number or three
            Below the horizon, a diffuse ground that the sky lights: radiance albedo E / pi. 0 is black.
        up : "y" or "z"
            The scene's upward axis.
        height : int
            Rows of the map.

        Returns
        -------
        Environment
        """
        return _sky(cie_sky.overcast, zenith, ground_albedo, up, height, None, "CIE overcast sky")

    @classmethod
    def cie_clear_sky(
        cls,
        sun_direction: npt.ArrayLike,
        zenith: npt.ArrayLike = 1.0,
        sun_irradiance: npt.ArrayLike = 0.0,
        sun_radius: float = cie_sky.SUN_RADIUS,
        ground_albedo: npt.ArrayLike = 0.0,
        up: str = "y",
        height: int = 512,
    ) -> Environment:
        """The CIE's standard clear sky, type 12 [CIES011], and the sun.

        Parameters
        ----------
        sun_direction : (3,)
            Towards the sun, in the frame of the scene; not below the horizon.
        zenith : number or three
            Radiance of the zenith.
        sun_irradiance : number or three
            Of the sun alone on a surface that faces it. 0 leaves the sun out: the sky is brightest about it
            all the same. In the unit of `zenith` times sr; for scale, 90,000 lx of sun go with a zenith of
            2,000 to 4,500 cd/m^2, 20 to 45 times as much.
        sun_radius : float
            Angular radius of the disc in degrees, at most 45. It is drawn into texels of 180 / height
            degrees, those at its rim in part, and keeps its irradiance whatever their size. On the
            horizon it is drawn whole.
        ground_albedo, up, height
            As for `cie_overcast`; the sun lights the ground too.

        Returns
        -------
        Environment
        """
        choice(up, "up", UP_AXES)
        direction = _FRAMES[up].T @ unit_vector(sun_direction, "sun_direction")
        if direction[1] < 0.0:
            raise InputError(f"sun_direction lies below the horizon; expected {up} of at least 0")
        radius = positive_number(sun_radius, "sun_radius")
        if radius > 45.0:
            raise InputError(f"sun_radius is {radius:g} degrees; expected at most 45")
        irradiance = colour(sun_irradiance, "sun_irradiance")
        sun = Sun(direction, math.radians(radius), irradiance) if irradiance.any() else None

        def luminance(directions: FloatArray) -> FloatArray:
            return cie_sky.clear(directions, direction)

        return _sky(luminance, zenith, ground_albedo, up, height, sun, "CIE clear sky")

    def rotated(self, rotation: npt.ArrayLike | tuple[npt.ArrayLike, float]) -> Environment:
        """The same light, turned in the frame of the scene.

        Parameters
        ----------
        rotation : (3, 3) array_like, or (axis, angle)
            A rotation matrix R (light from w comes from R w afterwards), or an axis (3,) and degrees
            counter-clockwise about it.

        Returns
        -------
        Environment
            Shares the map with this one.
        """
        turn = rotation_matrix(rotation, "rotation")
        rotated = _read_only(turn @ self.rotation)
        return Environment(self.texel_radiance, rotated, self.name, self.clamped, _of_map=self._of_map)

    # ------------------------------------------------------------------------------------- what it is

    @property
    def channels(self) -> int:
        """C: 1 where red, green and blue are the same everywhere, else 3."""
        return int(self.texel_radiance.shape[2])

    @cached_property
    def is_constant(self) -> bool:
        """Whether all directions have the same radiance."""
        return bool((self.texel_radiance == self.texel_radiance[0, 0]).all())

    def radiance(self, directions: npt.ArrayLike) -> FloatArray:
        """Radiance of the texels that directions (m, 3) of any length lie in: (m, 3)."""
        w = self._in_map(_unit_rows(directions, "directions"))
        row, column = equirect.texel_of(w, len(self.texel_radiance))
        return self._three(self.texel_radiance[row, column].astype(np.float64))

    def irradiance(self, normals: npt.ArrayLike) -> FloatArray:
        """int L max(n.w, 0) dw without occluders, to rounding: normals (n, 3) -> (n, 3).

        A sum over all texels; those that straddle the horizon are clipped by it.
        """
        n = _unit_rows(normals, "normals")
        if self.is_constant:
            return self._three(np.tile(np.pi * self._first, (len(n), 1)))
        with KERNEL_LOCK:
            found = equirect.irradiance(self.texel_radiance, self._in_map(n))
        return self._three(found)

    def total(self) -> FloatArray:
        """int L dw over the sphere: (3,)."""
        if self.is_constant:
            return self._three(4.0 * np.pi * self._first)
        rows = self.texel_radiance.sum(axis=1, dtype=np.float64)
        return self._three((equirect.solid_angles(len(rows))[:, None] * rows).sum(axis=0))

    def texels(self) -> Texels:
        """All texels as directions, radiances and solid angles, row by row."""
        height, width, channels = self.texel_radiance.shape
        centres = equirect.texel_centres(height, 0, height).reshape(-1, 3)
        return Texels(
            np.ascontiguousarray(centres @ self.rotation.T),
            self.texel_radiance.reshape(-1, channels).astype(np.float64),
            np.repeat(equirect.solid_angles(height), width),
        )

    def sh(self, max_degree: int = 4) -> FloatArray:
        """Spherical harmonics of the radiance, to be multiplied with `sh_transfer`; see `silint.sh`.

        Every texel counts at its centre: degree l is off by about (l / H)^2 of itself.

        Returns
        -------
        ((L + 1)^2, 3) float64
        """
        degree = positive_int(max_degree, "max_degree", 0, MAX_DEGREE)
        texels = self.texels()
        found = np.zeros(((degree + 1) ** 2, self.channels))
        if self.is_constant:
            found[0] = np.sqrt(4.0 * np.pi) * self._first
            return self._three(found)
        for i in range(0, len(texels.directions), _CHUNK):
            part = Texels(*(rows[i : i + _CHUNK] for rows in texels))
            found += project_samples(part.directions, part.radiance, degree, part.solid_angle)
        return self._three(found)

    def moment_table(self, isolines: int) -> LightTable:
        """Prefix sums of L w along that many octahedral isolines; the latest few are kept.

        Returns
        -------
        LightTable
            Of kind "constant" or "texels"; see `silint.core.integrands.light`.
        """
        isolines = positive_int(isolines, "isolines")
        with KERNEL_LOCK:
            table = self._tables.get(isolines)
            if table is None:
                if self.is_constant:
                    table = constant_light(_read_only(self._first), isolines)
                else:
                    table = texel_light(self.texel_radiance, self.rotation, isolines)
                self._tables[isolines] = table
                for old in list(self._tables)[:-_TABLES_KEPT]:
                    del self._tables[old]
        return table

    @property
    def _radial_sky(self) -> RadialSky:
        with KERNEL_LOCK:
            if not self._of_map:
                self._of_map.append(RadialSky(self.texel_radiance))
            return self._of_map[0]

    @property
    def aim(self) -> FloatArray:
        """(3,) towards the strongest small source, for radial isolines to pass through; 0 for none."""
        return NO_AIM if self.is_constant else self._radial_sky.aim(self.rotation)

    @property
    def suits_radial(self) -> bool:
        """Whether radial lines may stand for its texels: a sun of one coarse texel is no disc."""
        return self.is_constant or len(self.texel_radiance) >= _FINE_ROWS

    @property
    def radial_parts(self) -> tuple[int, int]:
        """What radial isolines take the map for: the number of discs, and the bytes of the rest."""
        return len(self._radial_sky.sources.radius), self._radial_sky.n_bytes

    def radial_irradiance(self, visible: RadialIntervals) -> tuple[FloatArray, FloatArray]:
        """Irradiance (n, 3) through intervals on lines through `aim`, and error estimates (n,)."""
        if self.is_constant:
            share, estimate = hemisphere_fraction(visible, "cosine")
            level = np.pi * self._first
            return self._three(share[:, None] * level), estimate * level.max()
        sky = self._radial_sky
        value, estimate = radial_light.irradiance(
            visible, *sky.turned(self.rotation, visible.counts.shape[1])
        )
        return np.ldexp(value, sky.exponent), np.ldexp(estimate, sky.exponent)

    def table_bytes(self, isolines: int) -> int:
        """Size of `moment_table`."""
        height, _, channels = self.texel_radiance.shape
        cells = 3 * channels * (4 * cells_per_quarter(height) + 1)
        return 8 * isolines * (6 * (4 * NODES_PER_QUARTER + 1) if self.is_constant else cells)

    @property
    def most_isolines(self) -> int:
        """How many isolines, a power of two, memory is spent on for a table: 1 GiB."""
        return 1 << ((1 << 30) // self.table_bytes(1)).bit_length() - 1

    @property
    def _first(self) -> FloatArray:
        return cast(FloatArray, self.texel_radiance[0, 0].astype(np.float64))

    def _in_map(self, w: FloatArray) -> FloatArray:
        """Directions (m, 3) in the frame of the map.

        Not by a matrix product, whose rounding may depend on m.
        """
        r = self.rotation
        return np.asarray(w[:, :1] * r[0] + w[:, 1:2] * r[1] + w[:, 2:] * r[2])

    def _three(self, values: FloatArray) -> FloatArray:
        """Channels (..., C) as red, green and blue (..., 3)."""
        return np.repeat(values, 3, axis=-1) if values.shape[-1] == 1 else values


def _unit_rows(rows: npt.ArrayLike, name: str) -> FloatArray:
    points, _ = points_array(rows, name)
    return normals_array(points, len(points), name)


def _from_texels(data: npt.ArrayLike, rotation: FloatArray, name: str, argument: str) -> Environment:
    """Check, clamp and store a map; `argument` is what messages call it."""
    texels, clamped = clamped_radiance(map_array(data, argument), argument)
    if clamped:
        warnings.warn(
            f"{name}: {clamped} of {texels.shape[0] * texels.shape[1]} texels had negative, NaN or infinite "
            "radiance; taken as 0, infinities as the largest finite value",
            stacklevel=3,
        )
    if texels.shape[2] == 3 and (texels[..., :1] == texels[..., 1:]).all():
        texels = texels[..., :1]
    return Environment(_read_only(texels), rotation, name, clamped)


def _sky(
    luminance: Callable[[FloatArray], FloatArray],
    zenith: npt.ArrayLike,
    ground_albedo: npt.ArrayLike,
    up: str,
    height: int,
    sun: Sun | None,
    name: str,
) -> Environment:
    radiance = colour(zenith, "zenith")
    albedo = colour(ground_albedo, "ground_albedo")
    if (albedo > 1.0).any():
        raise InputError(f"ground_albedo is {albedo.tolist()}; expected numbers from 0 to 1")
    if not radiance.any() and sun is None:
        raise InputError("zenith is 0 and there is no sun; expected some light")
    height = positive_int(height, "height", minimum=2, maximum=MOST_ROWS)
    if height % 2:
        raise InputError(f"height is {height}; expected an even number of rows")
    frame = _frame(up, 0.0)
    return _from_texels(draw_sky(luminance, radiance, albedo, height, sun), frame, name, name)


def _frame(up: str, rotate: float) -> FloatArray:
    """From the frame of a map to that of a scene."""
    choice(up, "up", UP_AXES)
    axis = np.eye(3)[1 if up == "y" else 2]
    return _read_only(rotation_about(axis, finite_number(rotate, "rotate")) @ _FRAMES[up])


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array.setflags(write=False)
    return array
