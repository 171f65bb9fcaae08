"""The truck's parameters: read from `mjcf/truck.toml`, checked, with overrides on top."""

from iits_mj.parameters.truck import (
    Axle,
    FifthWheel,
    Semitrailer,
    Steering,
    Tire,
    TireCommon,
    Tractor,
    TruckParameters,
)

__all__ = [
    "Axle",
    "FifthWheel",
    "Semitrailer",
    "Steering",
    "Tire",
    "TireCommon",
    "Tractor",
    "TruckParameters",
]
