"""A highway with traffic: the fast world that the policy is trained in, without the truck.

The drivers of the SUMO traffic follow by the IDM (Treiber et al. 2000, eq. 3) and change lanes by
MOBIL (Kesting et al. 2007, eq. 3-5), on a straight road, in a window that moves with the truck.
There is no SUMO, no MuJoCo and no lateral dynamics; lane changes of the others are instant for
their followers, and the truck sees them as a smooth move.

On-ramps end after 250 m: a ramp's end is a stopped leader, and MOBIL finds the gap to merge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from controllers.decision.fast_world.config import KINDS, LANE_WIDTH, HighwayConfig, Obstacle
from controllers.decision.fast_world.state import (
    OBSTACLE,
    VEHICLE,
    States,
    capacity_of,
    function,
    new_states,
    set_traffic,
)
from iits_mj import kernels
from iits_mj.core.messages import TrackedVehicle
from iits_mj.kernels import Address, Integer, Real

_NAMES = VEHICLE.names or ()
_start = function("iits_traffic_start", None, Address)
_spawn = function("iits_traffic_spawn", None, Integer, Real)
_step = function("iits_traffic_step", None, Address, Integer)
_places = function("iits_traffic_places", None, Address)


class HighwayTraffic:
    """The vehicles around a truck, of one world.

    Attributes:
      state: of the world, shape (1,); `serial`, `lane`, `front` and the other numbers of vehicles
        (`state.VEHICLE`) are attributes of shape (n,), sorted by `front`; writing to one changes
        the world.
    """

    def __init__(self, state: States) -> None:
        self.state = state

    @classmethod
    def of(cls, config: HighwayConfig, generator: np.random.Generator) -> HighwayTraffic:
        """Returns the traffic of a configuration, without vehicles."""
        traffic = cls(new_states(1, capacity_of(config)))
        set_traffic(traffic.state[0], config, generator)
        return traffic

    def fill(self, truck: Obstacle) -> None:
        """Places traffic in the whole window, with 40 m free around the truck in its lane."""
        _start(self.state, kernels.address(_rows([truck])))

    def step(self, obstacles: list[Obstacle]) -> None:
        """Advances one timestep; obstacles are the lanes that the truck occupies, its own first."""
        _step(self.state, kernels.address(_rows(obstacles)), len(obstacles))

    def spawn(self, lane: int, front: float) -> None:
        """Adds a random vehicle with its front bumper at a station [m], if there is room."""
        _spawn(self.state, lane, front)

    def __getattr__(self, name: str) -> Any:
        if name not in _NAMES:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return self.state["vehicles"][name][0, : self.state["count"][0]]

    def tracked(self, front: float | None = None) -> tuple[TrackedVehicle, ...]:
        """Returns the vehicles as messages, x along the road, y to the left of lane 0's center.

        Args:
          front: of the truck [m], to return only vehicles in sight of it; default: all.
        """
        places = np.empty((2, self.front.size))
        _places(self.state, kernels.address(places))
        seen = slice(None)
        if front is not None:
            rear = front - self.state["sight_behind"][0]
            end = front + self.state["sight_ahead"][0]
            first = np.searchsorted(self.front, rear, side="right")
            seen = slice(first, np.searchsorted(self.front, end))
        columns = (self.serial, self.kind, self.front - 0.5 * self.length, *places)
        rows = zip(
            *(column[seen].tolist() for column in (*columns, self.speed, self.acceleration)),
            strict=True,
        )
        return tuple(
            TrackedVehicle(
                id=f"v{serial}",
                kind=(kind := KINDS[index]).kind,
                x=x,
                y=y,
                speed=speed,
                acceleration=acceleration,
                lateral_speed=lateral_speed,
                station=x,
                offset=y,
                lane=math.floor(y / LANE_WIDTH + 0.5),
                length=kind.length,
                width=kind.width,
                height=kind.height,
            )
            for serial, index, x, y, lateral_speed, speed, acceleration in rows
        )


def _rows(obstacles: list[Obstacle]) -> Any:
    return np.array([(o.front, o.length, o.speed, o.lane) for o in obstacles], OBSTACLE)
