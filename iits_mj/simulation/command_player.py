"""In the stack's place: commands that were recorded."""

from __future__ import annotations

import math
from collections.abc import Callable

from iits_mj.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.simulation.log_driver import nothing_planned


class CommandPlayer:
    """A `Driver` that gives recorded commands, whatever happens.

    Args:
      recorded: the command of a number, counted from 0 at `reset`, that answers a state.
    """

    last_decision = Decision.KEEP
    lane_changes = refused = 0

    def __init__(self, recorded: Callable[[int, EgoState], VehicleCommand]) -> None:
        self._recorded = recorded
        self.reset()

    def reset(self) -> None:
        """Back to the first command."""
        self._next = 0

    def plan(self, scene: Scene) -> Trajectory:
        """Plans nothing."""
        return nothing_planned(scene.time)

    def control(self, ego: EgoState) -> VehicleCommand:
        """The next command."""
        command = self._recorded(self._next, ego)
        self._next += 1
        return command

    def reference_speed(self, station: float) -> float:
        """Not a number: the recording does not tell."""
        del station
        return math.nan
