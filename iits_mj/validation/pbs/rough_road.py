"""Straight road with cross slope and unevenness, for the tracking ability of a combination.

The two wheel tracks have the displacement spectrum of ISO 8608, `G(n) = G(0.1) (n / 0.1)^-2`, and
the coherence of an isotropic surface, `2 pi n t K1(2 pi n t)` at the distance t between them
(Kamash and Robson, The application of isotropy in road surface modelling, J. Sound Vib. 57, 1978).
Their amplitude is set by the International Roughness Index of the measured stretch.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy import signal, special

from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.core.errors import InputError
from iits_mj.core.units import KMH
from iits_mj.model.road_table import add_surface
from iits_mj.road.elements import DEFAULT_FRICTION
from iits_mj.road.unevenness import CLASSES, random_track, spectrum
from iits_mj.validation.pbs.maneuvers import StraightPath

# Distance of the rows of the road's table, and of the wheel tracks [m].
STEP, TRACKS = 0.25, 2.0
# Flat beginning, stretch over which cross slope and unevenness rise, and stretch on which the truck
# settles before the measured one, then the road's end behind it [m].
FLAT, RISE, SETTLE, END = 150.0, 100.0, 500.0, 100.0
START = FLAT + RISE + SETTLE
# Band of the unevenness [1/m].
_BAND = (0.01, 1.0)
# Golden car (Sayers, Gillespie, Queiroz, World Bank Technical Paper 45, 1986): tire and suspension
# rate, unsprung mass and damping over the sprung mass, and speed.
_TIRE, _SPRING, _UNSPRUNG, _DAMPING = 653.0, 63.3, 0.15, 6.0
_SPEED = 80.0 * KMH
# Distance on which the golden car settles [m].
_RUN_UP = 11.0


def roughness_index(heights: FloatArray, step: float = STEP) -> float:
    """Returns the International Roughness Index of a wheel track [m/km].

    The mean rate of the suspension's travel of the golden car at 80 km/h over its speed.

    Args:
      heights: at equal steps, shape (n,) [m].
      step: [m].

    Raises:
      InputError: a height is not finite, or the track is too short.
    """
    step = positive("step", step, "m")
    if len(heights) * step < 2.0 * _RUN_UP or not np.isfinite(heights).all():
        raise InputError(f"the track needs finite heights on more than {2.0 * _RUN_UP:g} m")
    hub = np.array([_SPRING, _DAMPING, -_SPRING - _TIRE, -_DAMPING]) / _UNSPRUNG
    motion = np.array(
        [[0.0, 1.0, 0.0, 0.0], [-_SPRING, -_DAMPING, _SPRING, _DAMPING], [0.0, 0.0, 0.0, 1.0], hub]
    )
    road = np.array([[0.0], [0.0], [0.0], [_TIRE / _UNSPRUNG]])
    travel = np.array([[0.0, 1.0, 0.0, -1.0]])
    time = np.arange(len(heights)) * step / _SPEED
    level = heights - heights[0]
    rate = signal.lsim((motion, road, travel, np.zeros((1, 1))), level, time)[1].ravel()
    return float(1e3 * np.mean(np.abs(rate[round(_RUN_UP / step) :])) / _SPEED)


def wheel_tracks(count: int, seed: int, step: float = STEP) -> FloatArray:
    """Returns heights of the left and right wheel track of ISO 8608's class A, (2, count) [m].

    Args:
      count: of the samples.
      seed: of the random unevenness.
      step: of the samples [m].
    """
    random = np.random.default_rng(seed)
    frequency = np.asarray(np.fft.rfftfreq(count, step), dtype=float)
    density = spectrum(frequency, CLASSES["A"], _BAND)
    apart = 2.0 * np.pi * np.where(density > 0.0, frequency, 1.0) * TRACKS
    coherence = apart * special.k1(apart)
    # A component that both tracks share, and one of each.
    powers = [coherence, 1.0 - coherence, 1.0 - coherence]
    common, *own = (random_track(density * share, count, step, random) for share in powers)
    return np.array([common + track for track in own])


@dataclass(frozen=True)
class RoughRoad:
    """Surface of the road along x, which falls to the right.

    Attributes:
      station: of the rows [m], shape (n,).
      height: of the middle [m]; tilt: rise to the left over the distance [1], shape (n,).
    """

    station: FloatArray
    height: FloatArray
    tilt: FloatArray

    @classmethod
    def of(cls, path: StraightPath, seed: int = 0) -> RoughRoad:
        """The road of a test; its two wheel tracks have the wanted roughness in the mean."""
        station = np.arange(0.0, START + path.length + END + STEP, STEP)
        tracks = wheel_tracks(len(station), seed)
        measured = (station >= START) & (station <= START + path.length)
        found = np.mean([roughness_index(track[measured]) for track in tracks])
        rise = np.clip((station - FLAT) / RISE, 0.0, 1.0)
        rise = rise**2 * (3.0 - 2.0 * rise)
        left, right = path.roughness / found * tracks * rise
        return cls(station, 0.5 * (left + right), (left - right) / TRACKS + path.cross_slope * rise)

    def track(self, offset: float) -> FloatArray:
        """Heights at a distance to the left of the middle [m], shape (n,)."""
        return self.height + offset * self.tilt

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Lays the road under the truck of a specification."""
        still = np.zeros_like(self.station)
        grip = np.full_like(self.station, DEFAULT_FRICTION)
        columns = [self.station, still, self.height, still, still]
        columns += [np.gradient(self.height, STEP), np.arctan(self.tilt), grip, grip, still]
        add_surface(spec, np.column_stack(columns), STEP)
