"""Air brakes: the truck's parameters as attributes of the plugin `iits.air_brake`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.parameters import FloatArray, TruckParameters
from iits_mj.units import GRAVITY, RPM

# Local names of the sensors that the plugin knows, in the order of the model.
SIGNALS = (
    "brake_pressure_front_left",
    "brake_pressure_front_right",
    "brake_pressure_rear_left",
    "brake_pressure_rear_right",
    "brake_pressure_trailer",
    "xbr_active",
    "abs_active",
    *(f"brake_pressure_axle{axle}_{side}" for axle in range(1, 7) for side in ("left", "right")),
)

# The torque per pressure of the release is a line through zero; with a push-out pressure the same
# torque is met at one pressure only. It is the anchor of the XBR test: -1.5 m/s2 at 50 t.
ANCHOR_PRESSURE = 150e3
# Longest time for which the standing truck is kept from rolling back on an upgrade after the
# demand has ended [s] (judgement: torque for a 12 % grade takes 4 s to build up).
HILL_HOLD_TIME = 5.0

_PER_AXLE = ("dead_time", "build_up_time_constant", "release_time_constant")
_COMMON = (
    "push_out_pressure",
    "hysteresis_pressure",
    "abs_release_slip",
    "abs_reapply_slip",
    "abs_speed_min",
    "stiffness",
    "supply_rise_rate",
    "supply_fall_rate",
    "pressure_max",
)


def config(parameters: TruckParameters, gross_mass: float) -> dict[str, str]:
    """Attributes of the plugin instance `air_brake`, as text, for a truck of `gross_mass` [kg]."""
    brake = parameters.air_brake
    circuit = circuits(parameters)
    radius = [parameters.tires[axle.tire].rolling_radius for axle in parameters.axles]
    demand, pressure = pressure_table(parameters, gross_mass)
    attributes = {name: _text(getattr(brake, name)) for name in _PER_AXLE + _COMMON}
    attributes |= {
        "torque_per_pressure": _text(torque_slope(parameters)),
        "parking_torque": _text([brake.parking_torque if c else 0.0 for c in circuit]),
        "wheel_radius": _text(radius),
        "circuit": _text(circuit),
        "hill_hold_time": _text(HILL_HOLD_TIME),
        "demand": _text(demand),
        "pressure_front": _text(pressure[:, 0]),
        "pressure_drive": _text(pressure[:, 1]),
        "pressure_trailer": _text(pressure[:, 2]),
    }
    return attributes


def circuits(parameters: TruckParameters) -> list[int]:
    """Circuit of each axle, front to rear: 0 front, 1 drive, 2 trailer."""
    rear = len(parameters.tractor.axles) - 1
    return [0] + [1] * rear + [2] * len(parameters.semitrailer.axles)


def torque_slope(parameters: TruckParameters) -> FloatArray:
    """Torque per pressure above push-out, per wheel end of each axle [N m/Pa]."""
    brake = parameters.air_brake
    secant = ANCHOR_PRESSURE / (ANCHOR_PRESSURE - brake.push_out_pressure)
    return np.asarray(brake.torque_per_pressure) * secant


def pressure_table(parameters: TruckParameters, gross_mass: float) -> tuple[FloatArray, FloatArray]:
    """Demanded deceleration [m/s2], shape (n,), and the circuits' pressure [Pa], shape (n, 3).

    The release's tables, interpolated in mass, give the share of each circuit. Their level is
    scaled so that the wheels' torque gives the demand: m_eff a = sum(T) / r + m g f_r + F_d, where
    m_eff counts the wheels' spin and F_d is the engine's drag, since a braking truck has its pedal
    up. The last row doubles the table's last demand, in proportion.
    """
    brake = parameters.air_brake
    share = (gross_mass - brake.mass_light) / (brake.mass_heavy - brake.mass_light)
    share = float(np.clip(share, 0.0, 1.2))
    table = brake.pressure_light + share * (brake.pressure_heavy - brake.pressure_light)
    demand = np.append(brake.demand, 2.0 * brake.demand[-1])
    table = np.vstack([table, 2.0 * table[-1]])

    radius = np.array([parameters.tires[axle.tire].rolling_radius for axle in parameters.axles])
    spin = np.array([2.0 * axle.wheel_inertia_spin for axle in parameters.axles])
    mass = gross_mass + float(np.sum(spin / radius**2))
    force_slope = np.zeros(3)
    np.add.at(
        force_slope, circuits(parameters), 2.0 * np.asarray(brake.torque_per_pressure) / radius
    )
    rolling = gross_mass * GRAVITY * parameters.tire_common.rolling_resistance
    wanted = np.maximum(0.0, mass * demand - rolling - overrun_force(parameters))
    level = wanted / (table @ force_slope)
    effective = table * level[:, np.newaxis]
    secant = ANCHOR_PRESSURE / (ANCHOR_PRESSURE - brake.push_out_pressure)
    pressure = brake.push_out_pressure + effective / secant
    return demand, np.minimum(np.maximum.accumulate(pressure), brake.pressure_max)


def overrun_force(parameters: TruckParameters) -> float:
    """Drag of the motored engine at the driven wheels [N], in the last gear but one at 1100 rpm."""
    engine, gearbox = parameters.engine, parameters.gearbox
    driven = next(axle for axle in parameters.tractor.axles if axle.tire == "drive")
    torque = float(np.interp(1100.0 * RPM, engine.drag_speed, engine.drag_torque))
    reduction = float(gearbox.ratios[-2]) * gearbox.final_drive
    losses = gearbox.efficiency * gearbox.driveline_efficiency
    return torque * reduction / losses / parameters.tires[driven.tire].rolling_radius


def _text(values: ArrayLike) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(values))
