"""A truck that does exactly what the planner plans, among vehicles that are told where to be.

For what is the planner's alone: decisions, gaps, limits. What the MuJoCo truck makes of a plan is
looked at elsewhere.
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


def nobody(ego: EgoState) -> Sequence[TrackedVehicle]:
    """An empty road."""
    del ego
    return ()


def keep(scene: Scene) -> Decision:
    """Never a change."""
    del scene
    return Decision.KEEP


def once(at: float, decision: Decision) -> Decide:
    """One decision at a time [s], else keep."""
    return lambda scene: decision if abs(scene.time - at) < 0.5 * STEP else Decision.KEEP


def no_signals(ego: EgoState) -> RoadSignals:
    """Neither lights nor changing limits."""
    del ego
    return RoadSignals()


def car(route: Route, name: str, station: float, lane: int, speed: float) -> TrackedVehicle:
    """A car in the middle of a lane; station is that of its middle [m]."""
    offset = float(route.lane_offset(lane, station))
    return TrackedVehicle(name, station=station, offset=offset, lane=lane, speed=speed)


class IdealDrive:
    """Plans and obeys, every 100 ms.

    Args:
      route: the road.
      station: start [m]; lane: at the start; speed: [m/s]; mass: [kg].
      lane: see station.
      speed: see station.
      mass: see station.
      config: of the planner.

    Attributes:
      planner: with its counters; ego: the truck now.
      states, scenes, plans: of every cycle so far; cost: CPU time of each plan [s].
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
        vehicles: Vehicles = nobody,
        decide: Decide = keep,
        signals: Signals = no_signals,
    ) -> IdealDrive:
        """Drives on for a duration [s]."""
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
        """Least bumper gap to a vehicle beside or in line with the truck in a scene [m].

        Negative where a body overlaps the truck's length and is nearer than the widths allow.
        """
        front = scene.ego.station + scene.footprint.front_overhang
        rear = front - scene.footprint.length
        gaps = [float("inf")]
        for vehicle in scene.vehicles:
            width = 0.5 * (vehicle.width + scene.footprint.width)
            if abs(vehicle.offset - scene.ego.offset) < width:
                ahead = vehicle.station - 0.5 * vehicle.length - front
                gaps.append(max(ahead, rear - vehicle.station - 0.5 * vehicle.length))
        return min(gaps)
