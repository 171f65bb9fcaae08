"""A truck's parameters: read from its `truck.toml`, with overlays, and checked."""

from iits_mj.parameters.files import shipped_trucks, truck_file
from iits_mj.parameters.options import check_truck, payload_option, truck_option
from iits_mj.parameters.truck import (
    Aerodynamics,
    AnyTruck,
    Steering,
    Tire,
    TireCommon,
    TruckParameters,
    label_of,
)
from iits_mj.parameters.units import Axle, Coupling, Payload, Unit

__all__ = [
    "Aerodynamics",
    "AnyTruck",
    "Axle",
    "Coupling",
    "Payload",
    "Steering",
    "Tire",
    "TireCommon",
    "TruckParameters",
    "Unit",
    "check_truck",
    "label_of",
    "payload_option",
    "shipped_trucks",
    "truck_file",
    "truck_option",
]
