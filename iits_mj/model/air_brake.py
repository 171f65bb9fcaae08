"""Air brakes: attributes and sensors of the plugin `iits.air_brake`, and the brake distribution.

Tables for a light and a heavy truck share the braking force between the circuits: by axle load, so
that every axle uses the same friction, like an EBS with load sensing; or in proportion to the
pressures of the published tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.model.attributes import PLUGIN_DIGITS, plugin_attributes, text
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import rolling_resistance, supports

# Names of the truck's sensors, in the order of the model. The plural ones have one number for each
# wheel end, axle by axle, left before right.
SIGNALS = (
    "brake_pressure_front_left",
    "brake_pressure_front_right",
    "brake_pressure_rear_left",
    "brake_pressure_rear_right",
    "brake_pressure_trailer",
    "xbr_active",
    "abs_active",
    "brake_pressures",
    "brake_torques",
    "wheel_speeds",
    *(f"reservoir_pressure_{circuit}" for circuit in ("front", "rear", "trailer")),
    "compressor_active",
    "brake_work",
    "endurance_torque_demand",
    "slip_control_active",
)
# Decelerations of the table by axle loads [m/s2]; friction allows no more.
_DEMAND = np.arange(0.0, 11.0)


@dataclass(frozen=True)
class Distribution:
    """Shares of the braking force.

    Attributes:
      mass_light, mass_heavy: gross masses of the two tables [kg].
      demand: deceleration [m/s2], shape (n,).
      light, heavy: shares of (front, drive, trailer) circuits, sum 1, shape (n, 3).
    """

    mass_light: float
    mass_heavy: float
    demand: FloatArray
    light: FloatArray
    heavy: FloatArray


def circuits(parameters: TruckParameters) -> list[int]:
    """Returns the circuit of each axle, front to rear: 0 front (steered), 1 drive, 2 trailer."""
    lead = [0 if axle.steered else 1 for axle in parameters.lead.axles]
    return lead + [2] * (len(parameters.axles) - len(lead))


def distribution(parameters: TruckParameters) -> Distribution:
    """Returns the distribution that `parameters.air_brake.distribution` names.

    Raises:
      InputError: the name is unknown.
    """
    name = parameters.air_brake.distribution
    if name == "axle_loads":
        return _by_axle_loads(parameters)
    if name == "table":
        return _by_table(parameters)
    raise InputError(
        f"parameter truck.air_brake.distribution = {name!r}: allowed are 'axle_loads' and 'table'"
    )


def circuit_loads(parameters: TruckParameters, payload: float, deceleration: float) -> FloatArray:
    """Returns the loads on the axles of each circuit while braking on the level [N], shape (3,).

    Every axle brakes in proportion to its load (friction used z = a / g).
    """
    found = supports(parameters, payload, used=deceleration / GRAVITY)
    (front, rear), *towed = found.groups
    return np.array([front, rear, sum(load for (load,) in towed)])


def _by_axle_loads(parameters: TruckParameters) -> Distribution:
    full = parameters.payload_max

    def shares(payload: float) -> FloatArray:
        loads = np.array([circuit_loads(parameters, payload, a) for a in _DEMAND])
        loads = np.maximum(loads, 0.0)
        return np.asarray(loads / loads.sum(axis=1, keepdims=True))

    light, heavy = parameters.gross_mass(0.0), parameters.gross_mass(full)
    heavy = max(heavy, light + 1.0)  # a truck without load has one distribution
    return Distribution(light, heavy, _DEMAND, shares(0.0), shares(full))


def _by_table(parameters: TruckParameters) -> Distribution:
    brake = parameters.air_brake
    if not brake.demand.size:
        raise InputError("air_brake.distribution = 'table' needs an air_brake.pressure_table")
    slope = np.zeros(3)
    radius = np.array([parameters.tires[axle.tire].rolling_radius for axle in parameters.axles])
    per_pressure = np.array([axle.brake.torque_per_pressure for axle in parameters.axles])
    np.add.at(slope, circuits(parameters), per_pressure / radius)

    def shares(pressure: FloatArray) -> FloatArray:
        force = pressure * slope
        return np.asarray(force / force.sum(axis=1, keepdims=True))

    return Distribution(
        brake.mass_light,
        brake.mass_heavy,
        brake.demand,
        shares(brake.pressure_light),
        shares(brake.pressure_heavy),
    )


def config(parameters: TruckParameters, payload: float) -> dict[str, str]:
    """Returns the attributes of the plugin instance `air_brake`.

    A parameter of the section `air_brake` is passed on by its name, unless it is replaced here; an
    axle's `brake` makes one number of each list. The plugin reads the vehicle's mass from the
    model.

    Raises:
      InputError: the name of the distribution is unknown.
    """
    brake = parameters.air_brake
    circuit = circuits(parameters)
    radius = [parameters.tires[axle.tire].rolling_radius for axle in parameters.axles]
    shares = distribution(parameters)
    replaced = ("anchor_pressure", "distribution", "pressure_light", "pressure_heavy")
    per_axle = ("dead_time", "build_up_time_constant", "release_time_constant", "chamber_volume")
    values: dict[str, ArrayLike] = {
        name: [getattr(axle.brake, name) for axle in parameters.axles] for name in per_axle
    }
    # A valve of a second towed unit follows that of the first.
    values["dead_time"] = [
        axle.brake.dead_time + max(place - 1, 0) * brake.trailer_line_delay
        for place, unit in enumerate(parameters.units)
        for axle in unit.axles
    ]
    values |= {
        "torque_per_pressure": torque_slope(parameters),
        "parking_torque": [brake.parking_torque if c else 0.0 for c in circuit],
        "wheel_radius": radius,
        "circuit": circuit,
        "rolling_resistance": rolling_resistance(parameters, payload),
        "mass_light": shares.mass_light,
        "mass_heavy": shares.mass_heavy,
        "demand": shares.demand,
        "share_light": shares.light,
        "share_heavy": shares.heavy,
    }
    lifted = [axle.lifted(payload) for axle in parameters.axles]
    if any(lifted):
        values["lifted"] = [float(each) for each in lifted]
    return plugin_attributes(brake, *replaced, digits=PLUGIN_DIGITS) | {
        name: text(value, digits=PLUGIN_DIGITS) for name, value in values.items()
    }


def torque_slope(parameters: TruckParameters) -> FloatArray:
    """Returns torque per pressure above push-out, per wheel end of each axle [N m/Pa].

    The published torque per pressure is a line through zero. With a push-out pressure the torque is
    the same at one pressure only, that of the XBR test: -1.5 m/s2 at 50 t.
    """
    brake = parameters.air_brake
    secant = brake.anchor_pressure / (brake.anchor_pressure - brake.push_out_pressure)
    return np.array([axle.brake.torque_per_pressure for axle in parameters.axles]) * secant
