"""Who drives: what a simulation asks of a stack, or of whoever sits in its place."""

from __future__ import annotations

from typing import Protocol

from iits_mj.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand


class Driver(Protocol):
    """Plans every 100 ms and commands every 20 ms; `controllers.stack.Stack` is one."""

    last_decision: Decision

    @property
    def lane_changes(self) -> int:
        """Lane changes completed since `reset`."""

    @property
    def refused(self) -> int:
        """Lane changes wanted and refused since `reset`."""

    def reset(self) -> None:
        """Ready for a new drive."""

    def plan(self, scene: Scene) -> Trajectory:
        """What is followed from now on; every 100 ms."""

    def control(self, ego: EgoState) -> VehicleCommand:
        """The command for the next 20 ms."""

    def reference_speed(self, station: float) -> float:
        """Speed asked for at a station [m/s]."""
