"""Weather and time of day of pictures; they do not change the drive."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.model.scenery.materials import Sky, sky_faces

Color = tuple[float, float, float]
# Contrast of a black object that is just seen, which defines the meteorological visibility
# (ICAO Annex 3: 5 %).
_CONTRAST = 0.05
_CLEAR = Sky()


@dataclass(frozen=True)
class Weather:
    """Light, sky and air of a scene.

    Attributes:
      sun: height of sun or moon above the horizon, and direction from which it shines, from x
        (east) to the left [deg]; sunlight: its color.
      above, below: light of the sky, and light that the ground returns.
      sky: colors of the sky; fog: color of the air.
      visibility: meteorological [m]; inf for clear air.
      lamps: whether vehicles have their lamps on; beams: whether these light the scene.
      glow: of lamps in the air, 0 to 1.
      wet: film of water on the road, 0 to 1; drops: number of falling drops in a picture.
    """

    sun: tuple[float, float] = (68.5, 130.0)
    sunlight: Color = (0.72, 0.69, 0.62)
    above: Color = (0.52, 0.56, 0.63)
    below: Color = (0.35, 0.36, 0.33)
    sky: Sky = _CLEAR
    fog: Color = (0.80, 0.87, 0.93)
    visibility: float = math.inf
    lamps: bool = False
    beams: bool = False
    glow: float = 0.10
    wet: float = 0.0
    drops: int = 0

    @property
    def mist(self) -> float:
        """Extinction of the air [1/m]."""
        return -math.log(_CONTRAST) / self.visibility

    @property
    def to_sun(self) -> FloatArray:
        """Direction to sun or moon."""
        height, azimuth = (math.radians(angle) for angle in self.sun)
        flat = math.cos(height)
        return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(height)])

    def faces(self) -> FloatArray:
        """Faces of the sky's cube, (6 size, size, 3), as of `sky_faces`."""
        return _faces(self.sky, self.sun)


@functools.cache
def _faces(sky: Sky, sun: tuple[float, float]) -> FloatArray:
    return sky_faces(sky, Weather(sun=sun).to_sun)


_OVERCAST = (0.64, 0.67, 0.70)
_RAIN = Weather(
    sun=(60.0, 130.0),
    sunlight=(0.06, 0.06, 0.06),
    above=(0.60, 0.63, 0.66),
    below=(0.30, 0.31, 0.31),
    sky=Sky(horizon=_OVERCAST, zenith=(0.43, 0.47, 0.52), clouds=-0.55, cloud=(0.52, 0.55, 0.59)),
    fog=_OVERCAST,
    visibility=1200.0,
    lamps=True,
    glow=0.35,
    wet=1.0,
    drops=1400,
)
_NIGHT = Weather(
    sun=(42.0, 150.0),
    sunlight=(0.105, 0.122, 0.165),
    above=(0.120, 0.137, 0.190),
    below=(0.055, 0.061, 0.082),
    sky=Sky(
        horizon=(0.060, 0.072, 0.115),
        zenith=(0.012, 0.016, 0.038),
        clouds=0.5,
        cloud=(0.075, 0.085, 0.120),
        stars=1.0,
    ),
    fog=(0.052, 0.062, 0.098),
    visibility=6000.0,
    lamps=True,
    beams=True,
    glow=0.75,
)
WEATHERS = {
    "day": Weather(),
    "low-sun": Weather(
        sun=(10.0, 48.0),
        sunlight=(1.70, 1.10, 0.58),
        above=(0.36, 0.38, 0.48),
        below=(0.25, 0.22, 0.21),
        sky=Sky(
            horizon=(0.96, 0.72, 0.50),
            zenith=(0.26, 0.37, 0.60),
            clouds=0.2,
            cloud=(0.98, 0.68, 0.52),
            glow=1.0,
        ),
        fog=(0.88, 0.68, 0.52),
        visibility=9000.0,
        lamps=True,
        glow=0.25,
    ),
    "night": _NIGHT,
    "rain": _RAIN,
    "fog": replace(
        _RAIN,
        above=(0.70, 0.72, 0.74),
        below=(0.42, 0.43, 0.43),
        sky=replace(_RAIN.sky, zenith=(0.66, 0.69, 0.72)),
        fog=(0.70, 0.725, 0.745),
        visibility=180.0,
        glow=0.9,
        wet=0.25,
        drops=0,
    ),
    "night-rain": replace(
        _NIGHT,
        sky=replace(_NIGHT.sky, clouds=-0.5, stars=0.0),
        visibility=900.0,
        glow=0.9,
        wet=1.0,
        drops=1000,
    ),
}
