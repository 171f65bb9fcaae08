"""What one instant of a drive looks like to those who watch it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from iits_mj.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand

if TYPE_CHECKING:
    from iits_mj.simulation.loop import Simulation


_SLOWEST = 1.0  # [m/s]


@dataclass(frozen=True, slots=True)
class Frame:
    """One instant of a drive.

    Attributes:
      time: simulation time [s].
      ego: the truck now; scene: what the stack saw at the beginning of this 100 ms cycle.
      trajectory: the plan being followed; command: what the truck is being sent.
      decision: the last decision of the decision maker.
      lane: the truck's lane from the right, -1 outside every lane; lane_count: lanes here.
      grade: of the road at the steer axle, dz/ds; curvature: of the route [1/m], positive left.
      speed_limit: of the road [m/s]; reference_speed: asked of the truck [m/s].
      gap_ahead, gap_behind: bumper to bumper in the truck's lane [m], inf without a vehicle.
      box_distance: to the nearest other vehicle, box to box [m], inf without one.
      distance: driven since the start [m]; lane_changes, refused: counted since the start.
    """

    time: float
    ego: EgoState
    scene: Scene
    trajectory: Trajectory
    command: VehicleCommand
    decision: Decision
    lane: int
    lane_count: int
    grade: float
    curvature: float
    speed_limit: float
    reference_speed: float
    gap_ahead: float
    gap_behind: float
    box_distance: float
    distance: float
    lane_changes: int
    refused: int

    @property
    def time_gap(self) -> float:
        """To the vehicle ahead [s]; inf without one, and below 1 m/s, where it says nothing."""
        speed = self.ego.speed
        return self.gap_ahead / speed if speed > _SLOWEST else math.inf


class Observer(Protocol):
    """Somebody who watches a drive.

    Attributes:
      period: time between two calls of `observe` [s], a whole number of physics steps.
    """

    period: float

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        """Called at the start and after every period; may only call `simulation.stop`."""
