"""A wall across the lane, seen late: the MuJoCo truck with its stack brakes before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.planner import PlannerConfig
from controllers.speed_plan import SpeedConfig
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.messages import Scene, TrackedVehicle
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.ideal_drive import car

_CONTROL, _PLAN = 0.02, 5
_CRUISE = 2.0


@dataclass(frozen=True)
class WallStop:
    """How a stop before a wall went.

    Attributes:
      gap: left between bumper and wall when the truck stands, negative for a hit [m].
      time: shape (n,) [s], the wall is seen at 0; speed [m/s]; place: way to the wall [m].
      emergencies: brakings of the last layer.
    """

    gap: float
    time: FloatArray
    speed: FloatArray
    place: FloatArray
    emergencies: int


def wall_stop(speed: float, sight: float, payload: float, timestep: float) -> WallStop:
    """Drives at a speed [m/s] until a wall appears `sight` metres before the bumper.

    Args:
      speed: [m/s].
      sight: bumper to wall when it is first seen [m].
      payload: [kg].
      timestep: of the physics [s].
    """
    route = Route.straight(length=3000.0)
    truck = Truck.load(payload, route=route, timestep=timestep, visuals=False)
    truck.reset(station=500.0, offset=float(route.lane_offset(0, 500.0)), speed=speed)
    config = PlannerConfig(speed=SpeedConfig(cruise_speed=speed))
    stack = Stack(route, planner=config, parameters=truck.parameters)
    wall, rows = np.inf, []
    for tick in range(round(40.0 / _CONTROL)):
        ego = truck.observe()
        front = ego.station + truck.footprint.front_overhang
        if not np.isfinite(wall) and ego.time >= _CRUISE:
            wall = front + sight
        if tick % _PLAN == 0:
            seen: tuple[TrackedVehicle, ...] = ()
            if np.isfinite(wall):
                # A car's middle stands half its length behind the wall.
                seen = (car(route, "wall", wall + 2.4, 0, 0.0),)
            stack.plan(Scene(ego.time, ego, seen, truck.footprint))
        rows.append((ego.time - _CRUISE, ego.speed, wall - front))
        if wall - front < 0.0 or (np.isfinite(wall) and ego.speed < 0.02):
            break
        truck.command(stack.control(ego))
        truck.step(round(_CONTROL / timestep))
    time, speeds, place = np.array(rows).T
    return WallStop(float(place[-1]), time, speeds, place, stack.planner.emergencies)
