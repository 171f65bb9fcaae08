"""Air brakes: the truck's parameters as attributes of the plugin `iits.air_brake`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.units import GRAVITY
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center, laden_trailer

# --- How the braking force is shared between the circuits, as tables for a light and a heavy truck
# Either by axle load, so that every axle uses the same friction, as an EBS with load sensing aims
# at; or in proportion to the pressures of the release's tables.

# Decelerations of the table by axle loads [m/s2]: friction allows no more.
_DEMAND = np.arange(0.0, 11.0)


@dataclass(frozen=True)
class Distribution:
    """Shares of the braking force.

    Attributes:
      mass_light, mass_heavy: gross masses that the tables are for [kg].
      demand: deceleration [m/s2], shape (n,).
      light, heavy: shares of (front, drive, trailer) circuits, sum 1, shape (n, 3).
    """

    mass_light: float
    mass_heavy: float
    demand: FloatArray
    light: FloatArray
    heavy: FloatArray


def circuits(parameters: TruckParameters) -> list[int]:
    """Circuit of each axle, front to rear: 0 front, 1 drive, 2 trailer."""
    rear = len(parameters.tractor.axles) - 1
    return [0] + [1] * rear + [2] * len(parameters.semitrailer.axles)


def distribution(parameters: TruckParameters) -> Distribution:
    """The tables that `parameters.air_brake.distribution` names.

    Raises:
      InputError: there is none of that name.
    """
    name = parameters.air_brake.distribution
    if name == "axle_loads":
        return _by_axle_loads(parameters)
    if name == "table":
        return _by_table(parameters)
    raise InputError(
        f"parameter truck.air_brake.distribution = {name!r}: allowed are 'axle_loads' and 'table'"
    )


def group_loads(parameters: TruckParameters, payload: float, deceleration: float) -> FloatArray:
    """Loads of steer axle, tandem and tri-axle in braking on the level [N], shape (3,).

    Statics with inertia forces of two rigid units, when every axle brakes in proportion to its load
    (friction used z = a / g). About the kingpin, on the road below it the brake force of the
    tri-axle; about the steer axle's contact, the trailer's push at the height of the kingpin.
    """
    tractor, coupling = parameters.tractor, parameters.fifth_wheel
    trailer = laden_trailer(parameters, payload)
    used = deceleration / GRAVITY
    group = group_center(parameters.semitrailer.axles)
    turning = trailer.cg_position - used * (trailer.cg_height - coupling.height)
    on_trailer = trailer.mass * GRAVITY * turning / (group + used * coupling.height)
    kingpin = trailer.mass * GRAVITY - on_trailer
    push = used * kingpin
    origin = tractor.axles[0].position
    moment = tractor.mass * GRAVITY * (tractor.cg_position - origin - used * tractor.cg_height)
    moment += kingpin * (coupling.position - origin) - push * coupling.height
    drive = moment / (group_center(tractor.axles[1:]) - origin)
    steer = tractor.mass * GRAVITY + kingpin - drive
    return np.array([steer, drive, on_trailer])


def _by_axle_loads(parameters: TruckParameters) -> Distribution:
    full = parameters.payload.mass_max

    def shares(payload: float) -> FloatArray:
        loads = np.array([group_loads(parameters, payload, a) for a in _DEMAND])
        loads = np.maximum(loads, 0.0)
        return np.asarray(loads / loads.sum(axis=1, keepdims=True))

    light, heavy = parameters.gross_mass(0.0), parameters.gross_mass(full)
    return Distribution(light, heavy, _DEMAND, shares(0.0), shares(full))


def _by_table(parameters: TruckParameters) -> Distribution:
    brake = parameters.air_brake
    slope = np.zeros(3)
    radius = np.array([parameters.tires[axle.tire].rolling_radius for axle in parameters.axles])
    np.add.at(slope, circuits(parameters), np.asarray(brake.torque_per_pressure) / radius)

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


# --- Air brakes: the truck's parameters as attributes of the plugin `iits.air_brake` ---

# Local names of the truck's sensors, in the order of the model. The plural ones have a number for
# each wheel end, axle by axle, left before right.
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
)

_PLAIN = (
    "dead_time",
    "trailer_line_delay",
    "build_up_time_constant",
    "release_time_constant",
    "supply_rise_rate",
    "supply_fall_rate",
    "push_out_pressure",
    "hysteresis_pressure",
    "pressure_max",
    "chamber_volume",
    "abs_release_slip",
    "abs_reapply_slip",
    "abs_speed_min",
    "abs_time_constant",
    "abs_yaw_rise_rate",
    "abs_slip_lag",
    "abs_slip_lead",
    "abs_speed_low",
    "stiffness",
    "parking_time_constant",
    "release_rate",
    "pedal_deceleration",
    "filter_time_constant",
    "trim_gain",
    "trim_max",
    "trim_share",
    "trim_speed_min",
    "hysteresis_time_constant",
    "endurance_speed_off",
    "endurance_speed_on",
    "endurance_rate",
    "hold_speed",
    "hold_deceleration",
    "hold_release_speed",
    "hill_hold_time",
    "hill_hold_min",
    "reservoir_volume",
    "compressor_displacement",
    "governor_cut_in",
    "governor_cut_out",
    "spring_begin_pressure",
    "spring_full_pressure",
)


def config(parameters: TruckParameters) -> dict[str, str]:
    """Attributes of the plugin instance `air_brake`, as text.

    The vehicle's mass is not among them: the plugin asks the model for it.

    Raises:
      InputError: `distribution` is not one of those that are known.
    """
    brake = parameters.air_brake
    circuit = circuits(parameters)
    radius = [parameters.tires[axle.tire].rolling_radius for axle in parameters.axles]
    shares = distribution(parameters)
    attributes = {name: _text(getattr(brake, name)) for name in _PLAIN}
    attributes |= {
        "torque_per_pressure": _text(torque_slope(parameters)),
        "parking_torque": _text([brake.parking_torque if c else 0.0 for c in circuit]),
        "wheel_radius": _text(radius),
        "circuit": _text(circuit),
        "rolling_resistance": _text(parameters.tire_common.rolling_resistance),
        "mass_light": _text(shares.mass_light),
        "mass_heavy": _text(shares.mass_heavy),
        "demand": _text(shares.demand),
        "share_light": _text(shares.light),
        "share_heavy": _text(shares.heavy),
    }
    return attributes


def torque_slope(parameters: TruckParameters) -> FloatArray:
    """Torque per pressure above push-out, per wheel end of each axle [N m/Pa].

    The torque per pressure of the release is a line through zero; above a push-out pressure the
    same torque is met at one pressure only, that of the XBR test: -1.5 m/s2 at 50 t.
    """
    brake = parameters.air_brake
    secant = brake.anchor_pressure / (brake.anchor_pressure - brake.push_out_pressure)
    return np.asarray(brake.torque_per_pressure) * secant


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(values))
