"""Scenes for tests of pictures: a truck that stands at a place, with vehicles around it."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from iits_mj.core.messages import EgoState, PlanMode, Scene, TrackedVehicle, Trajectory
from iits_mj.render.recorded import Record, RecordedDrive
from iits_mj.road import RoadMap
from iits_mj.simulation import DriveConfig
from iits_mj.simulation.parts import load_truck
from traffic_bridge import Mirror


@functools.cache
def road():
    return RoadMap.builtin().route()


@functools.cache
def plain_truck(name=None):
    return load_truck(DriveConfig(truck=name), road(), Mirror(visuals=False), visuals=False)


def vehicle(station, lane, kind="car", **values):
    """A vehicle on the built-in highway."""
    route = road()
    offset = float(route.lane_offset(lane, station))
    point = route.evaluate(station, offset)
    place = {name: float(getattr(point, name)) for name in ("x", "y", "z")}
    size = {"car": (4.6, 1.8, 1.5), "truck": (9.0, 2.5, 3.4)}[kind]
    return TrackedVehicle(
        f"{kind}{station:.0f}",
        kind,
        **place,
        yaw=float(point.heading),
        station=station,
        offset=offset,
        lane=lane,
        **dict(zip(("length", "width", "height"), size, strict=True)),
        **values,
    )


def standing(station, lane=0, vehicles=(), *, to=None, truck=None, duration=4.0, **values):
    """A recorded drive of a truck that does not move.

    Args:
      station, lane: of the truck; to: lane to which it plans to change.
      vehicles: around it, or a function that returns them at a time [s].
      truck: name of a shipped one; duration: [s]; values: of its state, or functions of time [s].
    """

    def at(time, value):
        return value(time) if callable(value) else value

    route = road()
    offset = float(route.lane_offset(lane, station))
    ego = plain_truck(truck).reset(station=station, offset=offset, speed=15.0)
    times = np.arange(0.0, duration + 0.05, 0.1)
    values = {"acceleration": 0.0, **values}
    states = [
        dataclasses.replace(ego, time=t, **{name: at(t, value) for name, value in values.items()})
        for t in times
    ]
    scenes = [Scene(state.time, state, at(state.time, vehicles)) for state in states]
    config = DriveConfig(truck=truck)
    return RecordedDrive(Record(config, states, scenes, [_plan(ego, to)] * len(states)))


def _plan(ego: EgoState, to: int | None) -> Trajectory:
    time = np.arange(0.0, 5.0, 0.1)
    station = ego.station + ego.speed * time
    goal = ego.offset if to is None else float(road().lane_offset(to, ego.station))
    offset = np.linspace(ego.offset, goal, len(time))
    point = road().evaluate(station, offset)
    none = np.zeros_like(time)
    mode = PlanMode.LANE_KEEPING if to is None else PlanMode.LANE_CHANGE
    places = (np.asarray(value) for value in (point.x, point.y, point.z, point.heading))
    return Trajectory(time, station, offset, *places, none, none, none, mode=mode)
