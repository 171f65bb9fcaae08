"""Forces at the driven wheels and resistances of a truck at constant speed.

    F = ((T - P_aux / w - T_g) i_g - T_a) i_f / r

with engine torque T, auxiliaries P_aux, losses of the gear T_g (at the gearbox input) and of the
axle T_a (at the propeller shaft), from maps or as efficiencies (Wong, Theory of Ground Vehicles,
4th ed., chapter 3).
"""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.units import GRAVITY
from iits_mj.model.powertrain import full_load
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance
from iits_mj.parameters.tables import Table2D


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
    engine, gearbox = parameters.engine, parameters.gearbox
    speed = np.linspace(engine.idle_speed, engine.governed_speed, points)
    torque = np.interp(speed, *full_load(parameters)) - engine.auxiliary_power / speed
    torque = _after(torque, speed, gearbox.gear_losses[gear - 1], gearbox.efficiency)
    ratio, axle = float(gearbox.ratios[gear - 1]), gearbox.axle_loss
    shaft = _after(torque * ratio, speed / ratio, axle, gearbox.driveline_efficiency)
    radius = parameters.tires[parameters.driven_axles[0].tire].rolling_radius
    return speed / overall_ratio(parameters, gear), shaft * gearbox.final_drive / radius


def _after(torque: FloatArray, speed: FloatArray, losses: Table2D, efficiency: float) -> FloatArray:
    """Torque less the losses of a map, or times an efficiency if there is no map."""
    if not losses.values.size:
        return torque * np.where(torque >= 0.0, efficiency, 1.0 / efficiency)
    return torque - [losses.at(w, t) for w, t in zip(speed, torque, strict=True)]


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
