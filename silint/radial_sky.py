"""A map as radial isolines take it: small sources, and the rest at every size of cell."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from silint.core.integrands import radial_light
from silint.core.radial import NO_AIM
from silint.core.sky_map import build_pyramid, open_irradiance, spread_level
from silint.suns import split_map

__all__ = ["RadialSky"]

FloatArray = npt.NDArray[np.float64]


class RadialSky:
    """Made once for a map; levels are spread when they are first asked for, and kept.

    Parameters
    ----------
    radiance : (H, 2 H, C) float
        Finite, not negative.
    """

    def __init__(self, radiance: npt.NDArray[np.floating]) -> None:
        # Texels that are fetched are float32, whatever the unit of the map.
        self.exponent = int(np.frexp(float(radiance.max()))[1])
        self.sources, rest = split_map(np.ldexp(radiance.astype(np.float64), -self.exponent))
        self._pyramid = build_pyramid(rest)
        self._open = _read_only(open_irradiance(self._pyramid))
        self._spread: dict[int, npt.NDArray[np.float32]] = {}

    def turned(self, rotation: FloatArray, isolines: int) -> tuple[radial_light.Sky, radial_light.Sources]:
        """What so many lines need of the map, turned by (3, 3) `rotation` to the frame of the scene.

        Its light is that of the map over 2 ** `exponent`.
        """
        wanted = radial_light.texels_for(isolines)
        level = next((a for a in self._pyramid if len(a) <= wanted), self._pyramid[-1])
        texels = self._spread.get(len(level))
        if texels is None:
            texels = self._spread[len(level)] = spread_level(level)
        turned = _read_only(_turned(self.sources.directions, rotation))
        to_map = _read_only(np.array(rotation.T, order="C"))
        sky = radial_light.Sky(self.aim(rotation), to_map, texels, self._open)
        return sky, self.sources._replace(directions=turned)

    def aim(self, rotation: FloatArray) -> FloatArray:
        """Where a line of every point should pass through: (3,), the strongest source; 0 for none."""
        if not len(self.sources.directions):
            return NO_AIM
        aim: FloatArray = _turned(self.sources.directions[:1], rotation)[0]
        return _read_only(aim)

    @property
    def n_bytes(self) -> int:
        """Memory of all levels, whether spread yet or not."""
        texels = sum(len(a) ** 2 for a in self._pyramid)
        return texels * (4 * 8 + 4 * 4 * 4) + self._open.nbytes


def _turned(w: FloatArray, rotation: FloatArray) -> FloatArray:
    """Directions (m, 3), not by a matrix product, whose rounding may depend on m."""
    r = rotation.T
    turned: FloatArray = w[:, :1] * r[0] + w[:, 1:2] * r[1] + w[:, 2:] * r[2]
    length: FloatArray = np.sqrt((turned * turned).sum(axis=1, keepdims=True))
    return turned / length


def _read_only(array: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    array.setflags(write=False)
    return array
