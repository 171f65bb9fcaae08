"""Scenes for the tests: cars on a route, a truck that follows its plan exactly, given decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from controllers.planning.config import PlannerConfig
from controllers.planning.planner import Planner
from iits_mj.core.messages import Decision, EgoState, Scene, TrackedVehicle, Trajectory
from iits_mj.road import Route

Decide = Callable[[float], Decision]


def car(route, name, station, lane, speed, **fields) -> TrackedVehicle:
    """A car in the middle of a lane; station is that of its middle."""
    return TrackedVehicle(
        id=name,
        station=station,
        offset=float(route.lane_offset(lane, station)),
        lane=lane,
        speed=speed,
        **fields,
    )


def posed(route, name, station, offset, course, speed, **fields) -> TrackedVehicle:
    """A car with a pose in the map frame; its course is relative to the road's direction [rad]."""
    point = route.evaluate(station, offset)
    return TrackedVehicle(
        id=name,
        x=float(point.x),
        y=float(point.y),
        z=float(point.z),
        yaw=float(point.heading) + course,
        speed=speed,
        station=station,
        offset=offset,
        **({"lane": -1} | fields),
    )


def moved(vehicle: TrackedVehicle, time: float) -> TrackedVehicle:
    """The vehicle after `time` seconds at constant speed."""
    return dataclasses.replace(vehicle, station=vehicle.station + vehicle.speed * time)


def advanced(ego: EgoState, plan: Trajectory) -> EgoState:
    """State 0.1 s later of a truck that follows a plan exactly."""
    return dataclasses.replace(
        ego,
        time=round(ego.time + 0.1, 6),
        station=float(plan.station[1]),
        offset=float(plan.offset[1]),
        speed=float(plan.speed[1]),
        acceleration=float(plan.acceleration[1]),
    )


class Script:
    """Makes given decisions by whole seconds, such as Script(at2=Decision.LEFT)."""

    name = "script"

    def __init__(self, **moments: Decision) -> None:
        self.moments = moments

    def reset(self):
        pass

    def decide(self, context):
        return self.moments.get(f"at{round(context.scene.time)}", Decision.KEEP)


class RightLaneEnds:
    """A straight road of two lanes whose right lane ends: lane 0 is then the left one."""

    def __init__(self, end: float = 800.0, length: float = 2000.0) -> None:
        self._route = Route.straight(length=length, lanes=2)
        self._end = end
        self.length = self._route.length

    def __getattr__(self, name):
        return getattr(self._route, name)

    def lane_count(self, station):
        return 2 if station < self._end else 1

    def lane_exists(self, lane, station):
        return 0 <= lane < self.lane_count(station)

    def lane_offset(self, lane, station):
        ended = np.asarray(station) >= self._end
        left = self._route.lane_offset(1, station)
        return np.where(ended, left, self._route.lane_offset(lane, station))[()]


class Ideal:
    """Runs a planner with a truck that follows the plan exactly."""

    def __init__(self, route, station, lane, speed, config: PlannerConfig | None = None) -> None:
        self.planner = Planner(route, config)
        offset = float(route.lane_offset(lane, station))
        self.ego = EgoState(station=station, offset=offset, speed=speed, mass=55_000.0)
        self.plans: list[Trajectory] = []
        self.states: list[EgoState] = []

    def run(self, duration, vehicles=(), decide: Decide = lambda time: Decision.KEEP) -> Ideal:
        """Drives for a duration [s]; vehicles is a tuple, or a function of time."""
        for _ in range(round(duration * 10)):
            time = self.ego.time
            around = (
                vehicles(time)
                if callable(vehicles)
                else tuple(moved(vehicle, time) for vehicle in vehicles)
            )
            plan = self.planner.plan(Scene(time, self.ego, around), decide(time))
            self.plans.append(plan)
            self.states.append(self.ego)
            self.ego = advanced(self.ego, plan)
        return self


def at(moment: float, decision: Decision) -> Decide:
    """One decision at a moment [s], else keep."""
    return lambda time: decision if abs(time - moment) < 0.05 else Decision.KEEP
