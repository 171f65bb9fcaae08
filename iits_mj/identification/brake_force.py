"""Force of the friction brakes from the recorded chamber pressures, circuit by circuit."""

from __future__ import annotations

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.identification.log import PRESSURES, Log
from iits_mj.model.air_brake import torque_slope
from iits_mj.parameters import TruckParameters

# Circuit to the pressures recorded of it; the trailer reports one for both sides.
CIRCUITS: dict[str, tuple[str, ...]] = {
    "front": PRESSURES[0:2],
    "drive": PRESSURES[2:4],
    "trailer": PRESSURES[4:5],
}


def circuit_of_axle(parameters: TruckParameters) -> list[str]:
    """Name of the circuit of each axle, front to rear."""
    drive = len(parameters.tractor.axles) - 1
    return ["front", *["drive"] * drive, *["trailer"] * len(parameters.semitrailer.axles)]


def circuit_forces(
    log: Log, parameters: TruckParameters, time: FloatArray, radii: FloatArray
) -> FloatArray:
    """Brake force of the circuits at the road with the parameters' gains [N], shape (n, 3).

    A brake pulls with the pressure above push-out; when it is let off, the friction of its
    mechanism holds up to `hysteresis_pressure` more than the chamber has.

    Args:
      log: has the five brake pressures.
      parameters: of the truck.
      time: at which the forces are wanted [s], shape (n,).
      radii: rolling radius of each axle's tires [m], shape (6,).
    """
    brake = parameters.air_brake
    forces = np.zeros((len(time), len(CIRCUITS)))
    names = list(CIRCUITS)
    slopes = torque_slope(parameters)
    for column, names_of_circuit in enumerate(CIRCUITS.values()):
        sides = [
            play(log.at(name, time), brake.hysteresis_pressure) - brake.push_out_pressure
            for name in names_of_circuit
        ]
        both = (2.0 / len(sides)) * np.sum(np.maximum(sides, 0.0), axis=0)
        for axle, circuit in enumerate(circuit_of_axle(parameters)):
            if circuit == names[column]:
                forces[:, column] += slopes[axle] * both / radii[axle]
    return forces


def play(pressure: FloatArray, width: float) -> FloatArray:
    """The pressure that the mechanism lets through: never below, up to `width` above, (n,)."""
    through = np.empty_like(pressure)
    held = 0.0
    for index, value in enumerate(pressure):
        held = min(max(held, value), value + width)
        through[index] = held if value > 0.0 else 0.0
    return through
