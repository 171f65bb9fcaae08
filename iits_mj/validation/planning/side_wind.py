"""Side wind along the road: a steady part, turbulence with Kaimal's spectrum, and discrete gusts.

The wind is a field over the station, constant in time (Taylor's hypothesis of frozen turbulence).

Turbulence: lateral component of the surface layer over open country (Kaimal et al. 1972),
`n S_v(n) / u*^2 = 17 f / (1 + 9.5 f)^(5/3)`, `f = n z / U`, with `u* = 0.4 U / ln(z / z0)`. The
wavenumber of the frozen field is `k = n / U`; the spectrum along the road is taken as that along
the wind. The turbulence is a sum of harmonics with random phases (Shinozuka and Jan 1972).

Discrete gusts have the shape `U / 2 (1 - cos(pi s / H))` over `0 <= s <= 2 H`, with gradients H
from 9 to 107 m (30 to 350 ft), as in the certification of aircraft (CS-25.341). They come from
both sides in turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iits_mj.core.arrays import FloatArray

# Open country: roughness length [m]; von Karman's constant.
ROUGHNESS = 0.03
KARMAN = 0.4
GRADIENTS = (9.0, 15.0, 30.0, 60.0, 107.0)
# Wavelengths of the harmonics [m] and their number; shorter waves average out over the truck.
_SHORTEST, _LONGEST, _COUNT = 16.0, 1000.0, 60


@dataclass(frozen=True)
class SideWind:
    """Wind across the road over station [m/s], positive to the left.

    Attributes:
      mean: steady part.
      amplitude, wavenumber, phase: of the turbulence's harmonics, (n,); [m/s], [1/m], [rad].
      start, gradient, peak: of the gusts, (m,); [m], [m], [m/s], starts rising.
    """

    mean: float
    amplitude: FloatArray
    wavenumber: FloatArray
    phase: FloatArray
    start: FloatArray
    gradient: FloatArray
    peak: FloatArray

    @classmethod
    def gusty(
        cls,
        generator: np.random.Generator,
        length: float,
        mean: float = 6.0,
        peak: float = 12.0,
        spacing: float = 400.0,
        height: float = 2.2,
    ) -> SideWind:
        """A steady side wind with its turbulence, and a gust at every `spacing`.

        Args:
          generator: of the phases.
          length: of the road with gusts [m].
          mean: of the wind [m/s].
          peak: of the gusts, in addition to the rest [m/s].
          spacing: of the gusts [m], at least twice the longest gradient.
          height: at which the wind acts on the truck [m].
        """
        edges = np.geomspace(1.0 / _LONGEST, 1.0 / _SHORTEST, _COUNT + 1)
        wavenumber = np.sqrt(edges[1:] * edges[:-1])
        amplitude = np.sqrt(2.0 * spectrum(wavenumber, mean, height) * np.diff(edges))
        start = np.arange(0.25 * spacing, length, spacing)
        order = np.arange(len(start))
        return cls(
            mean,
            amplitude,
            wavenumber,
            generator.uniform(0.0, 2.0 * np.pi, _COUNT),
            start,
            np.array(GRADIENTS)[(order // 2) % len(GRADIENTS)],
            np.where(order % 2 == 0, peak, -peak),
        )

    def at(self, station: float) -> float:
        """Speed of the wind across the road [m/s]."""
        angle = 2.0 * np.pi * self.wavenumber * station + self.phase
        wind = self.mean + float(self.amplitude @ np.sin(angle))
        row = int(np.searchsorted(self.start, station, side="right")) - 1
        if row >= 0:
            into = (station - float(self.start[row])) / float(self.gradient[row])
            if into < 2.0:
                wind += 0.5 * float(self.peak[row]) * (1.0 - np.cos(np.pi * into))
        return wind


def spectrum(wavenumber: FloatArray, mean: float, height: float) -> FloatArray:
    """Power of the lateral turbulence by wavenumber [m3/s2], shape of wavenumber [1/m]."""
    friction_speed = KARMAN * mean / np.log(height / ROUGHNESS)
    reduced = wavenumber * height
    return np.asarray(friction_speed**2 * 17.0 * height / (1.0 + 9.5 * reduced) ** (5.0 / 3.0))
