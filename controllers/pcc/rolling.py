"""A cruise control that may roll above its set speed downhill, as the stack's speed reference."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import PccConfig, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, rolling_speed
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import Scene, SpeedProfile
from iits_mj.core.neighbors import Neighbor
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route

_STEP, _COUNT = 10.0, 60  # grid of the predicted speeds [m]
# Over the engine's drag: the reference slows down a little more than the truck, so that the
# tracking controller, which ignores so small a difference, does not press the accelerator.
_DRAG = 1.25
_ABOVE = 0.3  # over the set speed, from which on the truck burns no fuel [m/s]
_MASS_CHANGE = 0.02  # relative change of mass that makes a new point mass


class RollingReference:
    """The set speed, and downhill the speed at which the truck rolls with the engine in overrun.

    From the truck's present speed it predicts the speeds of the coming 600 m, at most `top`. The
    truck burns no fuel above the set speed, but for a band of 0.3 m/s in which the tracking
    controller settles, and brakes at `top` only. See
    `controllers.planning.speed_reference` for the protocol.

    Attributes:
      speed: the set speed [m/s]; top: the greatest speed downhill [m/s].
    """

    def __init__(
        self, route: Route, speed: float, top: float, parameters: TruckParameters | None = None
    ) -> None:
        """Samples the road.

        Raises:
          InputError: the set speed is not 1 to 60 m/s, or `top` is below it or above 60 m/s.
        """
        in_range("rolling cruise: speed [m/s]", speed, 1.0, 60.0)
        in_range("rolling cruise: top [m/s]", top, speed, 60.0)
        self.speed, self.top = speed, top
        self._parameters = parameters or TruckParameters.load()
        self._road = RoadProfile.from_route(route, step=_STEP)
        self.reset()

    def reset(self) -> None:
        """Clears the prediction and the truck's mass."""
        self._vehicle: PointMass | None = None
        self._profile = SpeedProfile(np.zeros(1), np.full(1, self.speed))

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None]) -> SpeedProfile:
        """Returns the speeds from the truck's station on.

        Raises:
          InputError: the truck's station, speed or mass is not finite.
        """
        del find_leader
        ego = scene.ego
        for name, value in (("station", ego.station), ("speed", ego.speed), ("mass", ego.mass)):
            if not math.isfinite(value):
                raise InputError(f"rolling cruise: {name} is {value!r}: must be finite")
        if self._vehicle is None or abs(ego.mass / self._vehicle.mass - 1.0) > _MASS_CHANGE:
            fuel_map = FuelMap(self._parameters)
            config = PccConfig(v_ref=self.speed, v_min=self.speed, v_max=self.top)
            vehicle = make_vehicle(self._parameters, fuel_map, ego.mass, config)
            self._vehicle = replace(vehicle, power_overrun=_DRAG * vehicle.power_overrun)
        station = ego.station + _STEP * np.arange(_COUNT + 1.0)
        speed = np.maximum(self._rolling(self._vehicle, station, ego.speed), self.speed)
        self._profile = SpeedProfile(station, speed, coast_above=self.speed + _ABOVE)
        return self._profile

    def at(self, station: float) -> float:
        """Returns the reference speed at a station now [m/s]."""
        return self._profile.at(station)

    def free(self, station: float) -> float:
        """Returns the set speed [m/s]."""
        del station
        return self.speed

    def _rolling(self, vehicle: PointMass, station: FloatArray, speed: float) -> FloatArray:
        """Returns the speeds at the stations, (n,) [m/s], of a truck that rolls if it is fast."""
        if speed < self.speed:
            return np.full(station.size, self.speed)
        whole = self._road
        height = np.interp(station, whole.station, whole.height)
        road = whole.resampled(station, height, np.full(station.size, np.inf))
        cap, top = (np.full(station.size, v) for v in (self.speed, self.top))
        try:
            return rolling_speed(vehicle, road, min(speed, self.top), cap, top)
        except PlanningError:
            # A climb that the truck cannot hold.
            return np.full(station.size, self.speed)
