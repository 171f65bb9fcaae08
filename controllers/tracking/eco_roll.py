"""Eco-roll: the truck rolls in neutral with the engine idling where the speed plan says so.

On a J1939 truck, TC1 (PGN 256) carries the request: its disengage driveline request (SPN 683), or a
requested gear of 0 (SPN 525). Here it is the transmission mode of the command.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from iits_mj.core.messages import EgoState, PlanMode, Trajectory, TransmissionMode, VehicleCommand

_SLOWEST = 8.0  # [m/s], as released systems roll on open roads only
_DEVIATION = 1.0  # [m/s] from the planned speed that ends the roll


def eco_roll(command: VehicleCommand, ego: EgoState, trajectory: Trajectory) -> VehicleCommand:
    """Returns a command in neutral without accelerator, or the given one where rolling is unsafe.

    The truck stays in gear if the command brakes, in an emergency, at low speed, and if its speed
    is off the planned one: then traffic or the road is not as the plan assumed.
    """
    brakes = command.xbr_demand < 0.0 or max(command.engine_brake, command.retarder) > 0.0
    planned = float(np.interp(ego.time, trajectory.time, trajectory.speed))
    off = abs(planned - ego.speed) > _DEVIATION or ego.speed < _SLOWEST
    if brakes or off or trajectory.mode is PlanMode.EMERGENCY or command.brake_pedal > 0.0:
        return command
    return replace(command, accelerator_pedal=0.0, transmission_mode=TransmissionMode.NEUTRAL)
