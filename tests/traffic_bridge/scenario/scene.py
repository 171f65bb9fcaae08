"""A straight road, a truck at constant speed on it, and the traffic of events around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from iits_mj.core.vehicles import TrackedVehicle, VehicleFrame
from iits_mj.road import Route
from tests.traffic_bridge.scripted_truck import ego_at
from traffic_bridge import EventRecord, EventSim, TrafficConfig

ROAD = Route.straight(length=3000.0, lanes=3)
STEP, SPEED, START = 0.1, 20.0, 300.0
FRONT = 1.40  # of the truck's bumper before its station [m]


@dataclass
class Run:
    """Frames of a run, one every 0.1 s, and the events that began."""

    frames: list[VehicleFrame] = field(default_factory=list)
    stations: list[float] = field(default_factory=list)
    records: list[EventRecord] = field(default_factory=list)

    def track(self, name: str) -> list[TrackedVehicle | None]:
        return [frame.find(name) for frame in self.frames]

    def record(self, name: str) -> EventRecord:
        (found,) = [r for r in self.records if r.event.title == name]
        return found

    def gap(self, name: str, time: float) -> float:
        """From the truck's front bumper to a vehicle's rear at a time [m]."""
        step = round(time / STEP)
        vehicle = self.track(name)[step]
        return vehicle.station - 0.5 * vehicle.length - self.stations[step] - FRONT


def drive(
    events: Sequence,
    duration: float = 20.0,
    *,
    make: Callable = EventSim,
    road: Route = ROAD,
    lane: int = 0,
    speed: Callable[[float], float] = lambda _: SPEED,
    seed: int = 0,
    **settings,
) -> Run:
    """Runs traffic with events around a truck that keeps its lane."""
    config = TrafficConfig(**({"density": "empty", "speed_limit": 25.0} | settings), events=events)
    run, station = Run(), START
    with make(road, config, seed) as traffic:
        for step in range(round(duration / STEP) + 1):
            v = speed(step * STEP)
            ego = ego_at(road, step * STEP, station, v, float(road.lane_offset(lane, station)))
            run.frames.append(traffic.step(ego) if step else traffic.reset(ego))
            run.stations.append(station)
            station += v * STEP
        run.records = list(traffic.running_scenario().records)
    return run
