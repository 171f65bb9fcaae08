"""A drive of a Monte Carlo truck with the user's controllers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from iits_mj.core.own_parts import AnyPart, part_name, source_digest
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, Simulation
from iits_mj.simulation.frame import DivergedError, find_leaving
from iits_mj.simulation.lock_step import LockStep, Observer

# Bends of 620 m radius and grades of 2.6 % of the built-in highway, which a laden truck can hold.
START, SPEED, DURATION = 10_900.0, 20.0, 60.0  # [m], [m/s], [s]


@dataclass(frozen=True)
class Following:
    """How well a truck kept its lane and its speed.

    Attributes:
      path_error: greatest distance of the steer axle from the lane's middle [m].
      speed_error: mean difference from the requested speed [m/s].
      completed: 1 if the truck drove to the end, 0 if it left the road or the physics diverged.
    """

    path_error: float
    speed_error: float
    completed: int


def identity(lateral: AnyPart | None, longitudinal: AnyPart | None) -> str:
    """Returns names of the controllers with digests of their files; "" without any."""
    given = {"lateral": lateral, "longitudinal": longitudinal}
    return " ".join(
        f"{kind}={part_name(part)}@{source_digest(part)}"
        for kind, part in given.items()
        if part is not None
    )


def follow(
    parameters: TruckParameters,
    payload: float,
    timestep: float,
    lateral: AnyPart | None,
    longitudinal: AnyPart | None,
) -> Following:
    """Drives a truck along the built-in highway without traffic for 60 s.

    Args:
      parameters: of the truck.
      payload: [kg].
      timestep: of the physics [s].
      lateral: the user's steering controller; None: the shipped one.
      longitudinal: the user's speed controller; None: the shipped one.

    Raises:
      InputError: a controller cannot be made, or fails.
    """
    controllers: dict[str, Any] = {"lateral": lateral, "longitudinal": longitudinal}
    config = DriveConfig(
        truck=parameters,
        payload=payload,
        traffic_mode="none",
        decision="keep",
        speed_planner="cruise",
        speed=SPEED,
        start_speed=SPEED,
        start_station=START,
        duration=DURATION,
        **{name: part for name, part in controllers.items() if part is not None},
    )
    with Simulation(config, visuals=False, timestep=timestep) as simulation:
        seen = _Seen(simulation.route)
        try:
            simulation.run([seen])
        except DivergedError:
            seen.time = 0.0
    return Following(seen.path, seen.speed / max(seen.count, 1), int(seen.time >= DURATION - 0.05))


class _Seen(Observer):
    """Sums the errors of a drive."""

    def __init__(self, route: Route) -> None:
        self._route = route
        self.path, self.speed, self.time, self.count = 0.0, 0.0, 0.0, 0

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Adds the errors of a state."""
        ego = frame.ego
        middle = float(self._route.lane_offset(0, ego.station))
        self.path = max(self.path, abs(ego.offset - middle))
        self.speed += abs(ego.speed - frame.reference_speed)
        self.count += 1
        if find_leaving(ego, self._route) is not None:
            simulation.stop("left the road")
        else:
            self.time = frame.time
