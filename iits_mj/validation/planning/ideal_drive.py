"""A truck that follows its plans exactly, among vehicles with prescribed positions.

It tests decisions, gaps and limits of the planner alone. Other modules test how the MuJoCo truck
follows a plan.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

from controllers.planning.planner import Planner
from iits_mj.core.messages import Decision, EgoState, RoadSignals, Scene, TrackedVehicle, Trajectory
from iits_mj.core.timing import CYCLE_PERIOD
from iits_mj.road import Route

Vehicles = Callable[[EgoState], Sequence[TrackedVehicle]]
Decide = Callable[[Scene], Decision]
Signals = Callable[[EgoState], RoadSignals]


def once(at: float, decision: Decision) -> Decide:
    """Returns the decision once, at a time [s]; otherwise the truck keeps its lane."""
    return lambda scene: decision if abs(scene.time - at) < 0.5 * CYCLE_PERIOD else Decision.KEEP


def car(route: Route, name: str, station: float, lane: int, speed: float) -> TrackedVehicle:
    """Returns a car in the middle of a lane; the station [m] is that of its middle."""
    offset = float(route.lane_offset(lane, station))
    return TrackedVehicle(name, station=station, offset=offset, lane=lane, speed=speed)


class IdealDrive:
    """Plans every 100 ms and follows the plan.

    Args:
      route: the road.
      station, lane, speed: at the start [m], [m/s].

    Attributes:
      planner: with its counters; ego: present state of the truck.
      states, scenes, plans: of all cycles; cost: CPU time of each plan [s].
    """

    def __init__(self, route: Route, station: float, lane: int, speed: float) -> None:
        self.route = route
        self.planner = Planner(route)
        offset = float(route.lane_offset(lane, station))
        self.ego = EgoState(station=station, offset=offset, speed=speed)
        self.states: list[EgoState] = []
        self.scenes: list[Scene] = []
        self.plans: list[Trajectory] = []
        self.cost: list[float] = []

    def run(
        self,
        duration: float,
        vehicles: Vehicles = lambda _: (),
        decide: Decide = lambda _: Decision.KEEP,
        signals: Signals = lambda _: RoadSignals(),
    ) -> IdealDrive:
        """Drives for a duration [s]; default: an empty road without lights, in one lane."""
        for _ in range(round(duration / CYCLE_PERIOD)):
            ego = self.ego
            scene = Scene(ego.time, ego, tuple(vehicles(ego)), signals=signals(ego))
            decision = decide(scene)
            begun = time.process_time()
            plan = self.planner.plan(scene, decision)
            self.cost.append(time.process_time() - begun)
            self.states.append(ego)
            self.scenes.append(scene)
            self.plans.append(plan)
            self.ego = dataclasses.replace(
                ego,
                time=round(ego.time + CYCLE_PERIOD, 6),
                station=float(plan.station[1]),
                offset=float(plan.offset[1]),
                speed=float(plan.speed[1]),
                acceleration=float(plan.acceleration[0]),
            )
        return self

    def gap(self, scene: Scene) -> float:
        """Least bumper gap to a vehicle in the truck's way in a scene [m]; negative on overlap."""
        front = scene.ego.station + scene.footprint.front_overhang
        rear = front - scene.footprint.length
        gaps = [float("inf")]
        for vehicle in scene.vehicles:
            width = 0.5 * (vehicle.width + scene.footprint.width)
            if abs(vehicle.offset - scene.ego.offset) < width:
                ahead = vehicle.station - 0.5 * vehicle.length - front
                gaps.append(max(ahead, rear - vehicle.station - 0.5 * vehicle.length))
        return min(gaps)

    def least_gap(self) -> float:
        """Least `gap` of all scenes [m]."""
        return min(map(self.gap, self.scenes))

    def strongest_braking(self) -> float:
        """Strongest planned deceleration [m/s2]."""
        return -min(float(plan.acceleration[0]) for plan in self.plans)
