"""A truck that follows the plans exactly, among vehicles with prescribed positions.

It tests what depends on the planner alone: decisions, gaps, limits. Other modules test how the
MuJoCo truck follows a plan.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence

from controllers.planning.planner import Planner, PlannerConfig
from iits_mj.core.messages import Decision, EgoState, RoadSignals, Scene, TrackedVehicle, Trajectory
from iits_mj.road import Route

STEP = 0.1

Vehicles = Callable[[EgoState], Sequence[TrackedVehicle]]
Decide = Callable[[Scene], Decision]
Signals = Callable[[EgoState], RoadSignals]


def no_vehicles(ego: EgoState) -> Sequence[TrackedVehicle]:
    """An empty road."""
    del ego
    return ()


def keep(scene: Scene) -> Decision:
    """The decision to keep the lane."""
    del scene
    return Decision.KEEP


def once(at: float, decision: Decision) -> Decide:
    """One decision at a time [s]; otherwise the truck keeps its lane."""
    return lambda scene: decision if abs(scene.time - at) < 0.5 * STEP else Decision.KEEP


def no_signals(ego: EgoState) -> RoadSignals:
    """No lights and no variable limits."""
    del ego
    return RoadSignals()


def car(route: Route, name: str, station: float, lane: int, speed: float) -> TrackedVehicle:
    """A car in the middle of a lane; the station [m] is that of its middle."""
    offset = float(route.lane_offset(lane, station))
    return TrackedVehicle(name, station=station, offset=offset, lane=lane, speed=speed)


class IdealDrive:
    """Plans every 100 ms and follows the plan.

    Args:
      route: the road.
      station, lane, speed: at the start [m], [m/s].
      mass: [kg].
      config: of the planner.

    Attributes:
      planner: with its counters; ego: present state of the truck.
      states, scenes, plans: of all cycles; cost: CPU time of each plan [s].
    """

    def __init__(
        self,
        route: Route,
        station: float,
        lane: int,
        speed: float,
        mass: float = 55_000.0,
        config: PlannerConfig | None = None,
    ) -> None:
        self.route = route
        self.planner = Planner(route, config)
        offset = float(route.lane_offset(lane, station))
        self.ego = EgoState(station=station, offset=offset, speed=speed, mass=mass)
        self.states: list[EgoState] = []
        self.scenes: list[Scene] = []
        self.plans: list[Trajectory] = []
        self.cost: list[float] = []

    def run(
        self,
        duration: float,
        vehicles: Vehicles = no_vehicles,
        decide: Decide = keep,
        signals: Signals = no_signals,
    ) -> IdealDrive:
        """Drives for a duration [s]."""
        for _ in range(round(duration / STEP)):
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
                time=round(ego.time + STEP, 6),
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
