"""Air brakes: the truck's parameters as attributes of the plugin `iits.air_brake`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core.arrays import FloatArray
from iits_mj.model.brake_distribution import circuits, distribution
from iits_mj.parameters import TruckParameters

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
