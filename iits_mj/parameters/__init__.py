"""The truck's parameters: read from `mjcf/truck.toml`, with overlays, and checked."""

from iits_mj.parameters.mass_state import MAX_PAYLOAD, payload_option
from iits_mj.parameters.truck import (
    Axle,
    FifthWheel,
    Semitrailer,
    Steering,
    Tire,
    TireCommon,
    Tractor,
    TruckParameters,
    Unit,
)

__all__ = [
    "MAX_PAYLOAD",
    "Axle",
    "FifthWheel",
    "Semitrailer",
    "Steering",
    "Tire",
    "TireCommon",
    "Tractor",
    "TruckParameters",
    "Unit",
    "payload_option",
]
