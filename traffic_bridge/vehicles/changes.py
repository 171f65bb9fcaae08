"""What may be changed of vehicles in the run, and within which bounds."""

from __future__ import annotations

import dataclasses
from typing import Any

from iits_mj.errors import InputError
from traffic_bridge.checks import is_number
from traffic_bridge.vehicles.types import LC2013_ATTRIBUTES, VehicleType, check_color

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
_POSITIVE = ("time_headway", "acceleration", "deceleration", "desired_speed", "lc_assertive")


def check_changes(target: str, values: dict[str, Any]) -> None:
    """Refuses what `Vehicles.change` could not use.

    Raises:
      InputError: no or an unknown parameter, or a value that is not allowed.
    """
    if not values:
        raise InputError(f"no parameter of {target} to change: there are {', '.join(CHANGEABLE)}")
    for name, value in values.items():
        if name not in CHANGEABLE:
            raise InputError(f"parameter {name!r}: allowed are {', '.join(CHANGEABLE)}")
        if name == "color":
            check_color(target, value)
            continue
        if not is_number(value) or value < 0.0:
            raise InputError(f"{target}.{name} = {value!r}: must be finite and not negative")
        if name in _POSITIVE and value == 0.0:
            raise InputError(f"{target}.{name} = {value!r}: must be positive")


def changed(kind: VehicleType, values: dict[str, Any]) -> VehicleType:
    """A type with the changes that are its own; desired speed and color are the vehicle's."""
    fields = {n: v for n, v in values.items() if n not in ("desired_speed", "color")}
    return dataclasses.replace(kind, **fields)
