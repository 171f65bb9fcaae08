"""What may be changed of vehicles in the run, and within which bounds."""

from __future__ import annotations

import dataclasses
from typing import Any

from iits_mj.core.checks import in_range, shown
from iits_mj.core.errors import InputError
from traffic_bridge.vehicles.types import (
    LC2013_ATTRIBUTES,
    VehicleType,
    check_color,
    check_parameter,
)

# SUMO's name of what it acts on, vehicle and vehicle type alike.
SUMO_NAMES = {
    "time_headway": "Tau",
    "minimum_gap": "MinGap",
    "acceleration": "Accel",
    "deceleration": "Decel",
    "emergency_deceleration": "EmergencyDecel",
    "desired_speed": "MaxSpeed",
}
# Read by our own MOBIL only.
MOBIL_FIELDS = ("politeness", "change_threshold", "keep_right_bias", "safe_braking")
CHANGEABLE = (*SUMO_NAMES, *MOBIL_FIELDS, *LC2013_ATTRIBUTES, "color")
FASTEST = 70.0  # [m/s] as for `TrafficConfig.speed_limit`


def check_changes(target: str, values: dict[str, Any]) -> None:
    """Refuses what `Vehicles.change` could not use.

    Raises:
      InputError: the target is no name, no or an unknown parameter, or a value that is not allowed.
    """
    if not isinstance(target, str):
        raise InputError(f"{shown(target)} to change: must be the name of a vehicle or of a type")
    if not values:
        raise InputError(f"no parameter of {target} to change: there are {', '.join(CHANGEABLE)}")
    for name, value in values.items():
        if name not in CHANGEABLE:
            raise InputError(f"parameter {shown(name)}: allowed are {', '.join(CHANGEABLE)}")
        if name == "color":
            check_color(target, value)
            continue
        label = f"{target}.{name}"
        if name != "desired_speed":
            check_parameter(label, name, value)
            continue
        in_range(label, value, 0.0, FASTEST)
        if value == 0.0:
            raise InputError(f"{label} = {value!r}: must be positive")


def changed(kind: VehicleType, values: dict[str, Any]) -> VehicleType:
    """A type with the changes that are its own; desired speed and color are the vehicle's."""
    fields = {n: v for n, v in values.items() if n not in ("desired_speed", "color")}
    return dataclasses.replace(kind, **fields)
