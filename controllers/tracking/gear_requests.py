"""Requests for a gear: that of a speed plan, neutral (eco-roll), and the gear of a lane change.

On a J1939 truck, TC1 (PGN 256) carries the request as its requested gear (SPN 525), 0 for neutral.
Here it is the transmission mode of the command.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from iits_mj.core.messages import (
    EgoState,
    PlanMode,
    SpeedProfile,
    Trajectory,
    TransmissionMode,
    VehicleCommand,
)

_SLOWEST = 8.0  # [m/s], as released systems roll on open roads only
# From the planned speed, that ends the roll, and the request for a gear [m/s]: on a climb the truck
# may be slower than its plan.
_ROLL_DEVIATION, _GEAR_DEVIATION = 1.0, 3.0


def in_planned_gear(
    command: VehicleCommand, ego: EgoState, trajectory: Trajectory, profile: SpeedProfile
) -> VehicleCommand:
    """Returns a command in the gear of a profile, or the given one where that is not sensible.

    The gearbox chooses the gear if the command brakes, in an emergency, at low speed, and if the
    speed is off the planned one: then traffic or the road is not as the plan assumed. In neutral
    there is no accelerator.
    """
    mode = profile.mode_at(ego.station)
    if mode is TransmissionMode.DRIVE:
        return command
    if _gearbox_decides(command, ego, trajectory):
        return command
    if mode is TransmissionMode.NEUTRAL:
        planned = float(np.interp(ego.time, trajectory.time, trajectory.speed))
        if abs(planned - ego.speed) > _ROLL_DEVIATION:
            return command
        return replace(command, accelerator_pedal=0.0, transmission_mode=mode)
    if abs(profile.at(ego.station) - ego.speed) > _GEAR_DEVIATION:
        return command
    return replace(command, transmission_mode=mode)


class GearKeeper:
    """Keeps the gear during a lane change, as long as the engine can run in it.

    At the start of a change to a free lane the accelerator goes down, and the gearbox would shift.
    That interrupts the pull: on a climb the truck would lose up to 1 m/s before its new follower.
    """

    def __init__(self) -> None:
        self._gear = 0

    def reset(self) -> None:
        """Forgets the gear."""
        self._gear = 0

    def keep(
        self, command: VehicleCommand, ego: EgoState, trajectory: Trajectory
    ) -> VehicleCommand:
        """Returns a command in the gear in which the lane change began, or the given one.

        The given one is returned outside a lane change, if it requests a gear itself, and where
        the gearbox decides, as in `in_planned_gear`.
        """
        if trajectory.mode is not PlanMode.LANE_CHANGE:
            self._gear = 0
        elif self._gear == 0 and not ego.shift_in_process:
            self._gear = max(ego.gear, 0)
        asks = command.transmission_mode is not TransmissionMode.DRIVE
        if self._gear == 0 or asks or _gearbox_decides(command, ego, trajectory):
            return command
        return replace(command, transmission_mode=TransmissionMode.forward(self._gear))


def _gearbox_decides(command: VehicleCommand, ego: EgoState, trajectory: Trajectory) -> bool:
    """Whether the truck brakes, is slow or in an emergency."""
    brakes = command.xbr_demand < 0.0 or max(command.engine_brake, command.retarder) > 0.0
    emergency = trajectory.mode is PlanMode.EMERGENCY or command.brake_pedal > 0.0
    return brakes or emergency or ego.speed < _SLOWEST
