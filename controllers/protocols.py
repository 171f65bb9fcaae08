"""What the replaceable parts of the driving stack must offer: a protocol for each.

A class needs the methods and no base class. The stack calls `reset` at the start of every drive,
then the other method at the rate that its protocol states, always with all arguments, by position
(`/`), so that their names are free.
Messages are those of `iits_mj.core.messages`: SI units and radians, ISO 8855 axes (x forward, y
left, z up), positions in the map frame (x east, y north), lanes counted from the outside. `station`
and `offset` are meters along the route and to the left of its reference line; the truck's are those
of the center of its steer axle.

The same inputs after `reset` must give the same outputs, or drives do not repeat: random draws need
a generator made from the `seed` that the constructor may ask for. `docs/how_to/` has an example of
each part.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from controllers.decision.base import DecisionContext
    from iits_mj.core.messages import (
        Decision,
        EgoState,
        Scene,
        SpeedProfile,
        Trajectory,
        VehicleCommand,
    )
    from iits_mj.core.neighbors import Neighbor


@runtime_checkable
class DecisionMaker(Protocol):
    """Decides about lane changes, once a second and not during a change.

    The constructor may ask for `parameters` (`TruckParameters`) and `seed`. A part may also have
    the attribute `speed_max`: the highest speed [m/s], 0.5 or more, that the truck aims at from
    this decision to the next one, `math.inf` for the reference speed.
    """

    def reset(self) -> None:
        """Clears all memory."""

    def decide(self, context: DecisionContext, /) -> Decision:
        """Returns the decision for the next second, or its number: -1 left, 0 keep, 1 right.

        The planner checks it again and may refuse it.

        Args:
          context: the scene (truck, vehicles, lights), the route, the lane and the lanes that the
            truck may use, the reference speed [m/s], and the observation of 216 numbers.
        """


@runtime_checkable
class TrajectoryPlanner(Protocol):
    """Plans the motion of the next seconds, every 100 ms.

    The constructor may ask for `route`, `config` (`PlannerConfig` with the set speed in
    `config.speed.cruise_speed`) and `parameters`. `controllers.planning.trajectory.on_road` makes a
    trajectory of a lane and a speed over time.
    """

    def reset(self) -> None:
        """Clears plan and memory."""

    def plan(self, scene: Scene, decision: Decision, profile: SpeedProfile, /) -> Trajectory:
        """Returns the trajectory to follow from now on.

        Its arrays have one shape (n,), n >= 2, and finite numbers; its time increases and ends
        after the scene's, its stations do not fall, its speed is zero or more.

        Args:
          scene: truck, vehicles, lights and changed limits.
          decision: of the decision maker; `Decision.KEEP` when it was not asked.
          profile: reference speed [m/s] over station [m].
        """


@runtime_checkable
class LateralControl(Protocol):
    """Steers along the trajectory, every 20 ms, before the speed is controlled.

    The constructor may ask for `route` and `parameters`.
    """

    def reset(self) -> None:
        """Clears all memory."""

    def steer(self, ego: EgoState, trajectory: Trajectory, /) -> float:
        """Returns the angle of the steering wheel [rad], positive to the left.

        The truck bounds it to `parameters.steering.angle_max`; the angle of the road wheels is
        smaller by `parameters.steering.ratio`.

        Args:
          ego: the truck now.
          trajectory: the last plan, up to 100 ms old.
        """


@runtime_checkable
class LongitudinalControl(Protocol):
    """Follows the planned speed with accelerator and brakes, every 20 ms.

    The constructor may ask for `route` and `parameters`.
    """

    def reset(self) -> None:
        """Clears all memory."""

    def command(self, ego: EgoState, trajectory: Trajectory, grade: float, /) -> VehicleCommand:
        """Returns the command of pedal and brakes; its steering angle is replaced.

        Args:
          ego: the truck now.
          trajectory: the last plan, up to 100 ms old, with speed [m/s] and acceleration [m/s2] over
            absolute time [s].
          grade: of the road under the combination, rise over run.
        """


@runtime_checkable
class SpeedSource(Protocol):
    """Gives the reference speed over the road ahead, every 100 ms.

    The planner keeps limits, bends and distances whatever the reference is. The constructor may ask
    for `route`, `parameters` and `speed`, the set speed [m/s]. A part may also have the method
    `free(station)`, the speed [m/s] that it would give without traffic; otherwise the profile
    counts.
    """

    def reset(self) -> None:
        """Prepares for a new drive."""

    def update(self, scene: Scene, find_leader: Callable[[], Neighbor | None], /) -> SpeedProfile:
        """Returns the profile to follow from now on: stations [m] that rise, speeds 0.5 to 60 m/s.

        Args:
          scene: truck, vehicles, lights and changed limits.
          find_leader: returns the vehicle ahead in the lane that is kept or changed to, None
            without one.
        """
