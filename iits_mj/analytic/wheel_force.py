"""Forces at the driven wheels and resistances of a truck at constant speed.

    F = ((T - P_aux / w - T_g) i_g - T_r - T_a) i_f / r

with engine torque T, auxiliaries P_aux, losses of the gear T_g (at the gearbox input) and of the
axle T_a (at the propeller shaft), from maps or as efficiencies, and the drag T_r of an empty
retarder (Wong, Theory of Ground Vehicles, 4th ed., chapter 3).
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance


def overall_ratio(parameters: TruckParameters, gear: int) -> float:
    """Returns the engine's speed over the vehicle's [rad/m] in a gear, from 1."""
    gearbox = parameters.gearbox
    radius = parameters.tires[parameters.driven_axles[0].tire].rolling_radius
    return float(gearbox.ratios[gear - 1]) * gearbox.final_drive / radius


def full_load_force(
    parameters: TruckParameters, gear: int, points: int = 80
) -> tuple[FloatArray, FloatArray]:
    """Returns vehicle speed [m/s] and force at the wheels [N] at full load, from idle to governor.

    Args:
      parameters: of the truck.
      gear: from 1, clutch closed.
      points: number of speeds.
    """
    engine = parameters.engine
    speed = np.linspace(engine.idle_speed, engine.governed_speed, points)
    torque = np.interp(speed, *full_load(parameters)) - engine.auxiliary_torque(speed)
    return speed / overall_ratio(parameters, gear), wheel_force(parameters, gear, torque, speed)


def wheel_force(
    parameters: TruckParameters, gear: int, torque: FloatArray, speed: FloatArray
) -> FloatArray:
    """Returns the force at the driven wheels [N] of torques at the gearbox input.

    Args:
      parameters: of the truck.
      gear: from 1.
      torque: [N m], below 0 in overrun.
      speed: of the input [rad/s], same shape.
    """
    gearbox, ratio = parameters.gearbox, float(parameters.gearbox.ratios[gear - 1])
    geared, shaft = gearbox.gear_losses[gear - 1].after(torque, speed) * ratio, speed / ratio
    torque = gearbox.final_drive_loss.after(geared - parameters.retarder.empty_drag(shaft), shaft)
    radius = parameters.tires[parameters.driven_axles[0].tire].rolling_radius
    return torque * gearbox.final_drive / radius


def input_torque(
    parameters: TruckParameters, gear: int, force: FloatArray, speed: FloatArray
) -> FloatArray:
    """Returns the torque at the gearbox input [N m] for forces: the inverse of `wheel_force`."""
    gearbox, ratio = parameters.gearbox, float(parameters.gearbox.ratios[gear - 1])
    radius, shaft = parameters.tires[parameters.driven_axles[0].tire].rolling_radius, speed / ratio
    torque = gearbox.final_drive_loss.before(force * radius / gearbox.final_drive, shaft)
    geared = torque + parameters.retarder.empty_drag(shaft)
    return gearbox.gear_losses[gear - 1].before(geared / ratio, speed)


def resistance(
    parameters: TruckParameters, payload: float, speed: FloatArray, grade: float = 0.0
) -> FloatArray:
    """Returns rolling, grade and air resistance [N] over the speed [m/s], same shape.

    Args:
      parameters: of the truck.
      payload: [kg].
      speed: [m/s].
      grade: dz/ds of the road.
    """
    weight = parameters.gross_mass(payload) * GRAVITY / np.hypot(1.0, grade)
    rolling = rolling_resistance(parameters, payload)
    air = parameters.aerodynamics
    drag = 0.5 * air.density * air.mean_drag_area() * speed**2
    return np.asarray(weight * (grade + rolling) + drag)
