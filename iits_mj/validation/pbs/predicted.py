"""PBS measures of any combination that the analytic models predict, without a simulation.

The low-speed turn is that of the tractrix chain, the lane change that of the yaw-plane model, the
damping that of the yaw-roll model, and the rollover threshold that of statics in the roll plane.
The simulated truck is assessed by `measures`; these values are its reference, and a fast estimate.
"""

from __future__ import annotations

import numpy as np

from controllers.planning.rollover_limits import roll_threshold
from iits_mj.analytic import YawPlane, YawRoll, simulate, unit_track
from iits_mj.analytic.swept_path import Outline, turn
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling.lane_change import inverse_steer
from iits_mj.validation.pbs import measures
from iits_mj.validation.pbs.maneuvers import LaneChange, LowSpeedTurn, PulseSteer

_STEP = 0.01
# Time before the lane change, and after it [s].
_LEAD, _LENGTH = 1.0, 9.0


def predicted(parameters: TruckParameters, payload: float) -> dict[str, float]:
    """Returns the predicted measures by the keys of `limits.STANDARDS`.

    Those of towed units are missing for a single unit.

    Args:
      parameters: of the truck.
      payload: of the combination [kg].

    Raises:
      InputError: the payload is not allowed, or the combination is too long for the turn.
    """
    values = {"rollover": float(roll_threshold(parameters, payload)) / GRAVITY}
    values |= low_speed_turn(parameters, payload)
    values |= lane_change(parameters, payload, values["rollover"])
    return values | {"yaw_damping": pulse_steer(parameters, payload)}


def low_speed_turn(parameters: TruckParameters, payload: float) -> dict[str, float]:
    """Returns swept path, frontal and tail swing of the turn of 12.5 m [m]; as of `predicted`."""
    wanted = LowSpeedTurn()
    outline = Outline.from_parameters(parameters, payload)
    return measures.turn_measures(turn(outline, wanted.radius, wanted.angle))


def lane_change(parameters: TruckParameters, payload: float, threshold: float) -> dict[str, float]:
    """Returns off-tracking [m] and amplification over a rollover threshold [1/g]."""
    change = LaneChange()
    if len(parameters.units) == 1:
        return {}
    model = YawPlane.from_parameters(parameters, payload, cruise_speed=change.speed)
    system = model.at(change.speed)
    time = np.arange(0.0, _LEAD + change.period + _LENGTH, _STEP)
    phase = 2.0 * np.pi * np.clip((time - _LEAD) / change.period, 0.0, 1.0)
    answer = simulate(system, time, inverse_steer(system, time, change.peak * np.sin(phase)))
    front = np.column_stack([answer.x, answer.y])
    rear = unit_track(answer, system, -1, parameters.last.axles[-1].position)
    gain = measures.rearward_amplification(
        answer.steer_axle_acceleration,
        measures.roll_coupled_acceleration(parameters, payload, answer.lateral_accelerations),
    )
    return {
        "off_tracking": measures.transient_off_tracking(front, rear),
        "amplification": gain / threshold,
    }


def pulse_steer(parameters: TruckParameters, payload: float) -> float:
    """Returns the damping of the worst yaw rate or articulation after a pulse steer."""
    pulse = PulseSteer()
    model = YawRoll.from_parameters(parameters, payload, cruise_speed=pulse.speed)
    time = np.arange(0.0, 12.0, _STEP)
    answer = simulate(model.at(pulse.speed), time, 1e-3 * pulse.steer(time))
    free = time > 2.0 * pulse.rise
    return measures.yaw_damping([*answer.yaw_rates[free].T, *answer.articulations[free].T])
