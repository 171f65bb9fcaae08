"""Listening at the boundaries between the modules of a drive."""

from __future__ import annotations

from typing import Protocol

from iits_mj.messages import EgoState, Scene, Trajectory, VehicleCommand


class Tap(Protocol):
    """Hears what goes in and out of the driver, exactly as it does; must not change anything."""

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """After every plan, the first one included."""

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """After every command: the state it answers, as it was given, and as it reached the truck.

        Called before the truck drives on with it.
        """
