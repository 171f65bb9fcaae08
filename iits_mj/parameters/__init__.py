"""A truck's parameters: read from its `truck.toml`, with overlays, and checked."""

from iits_mj.parameters.files import shipped_trucks, truck_file
from iits_mj.parameters.mass_state import MAX_PAYLOAD, payload_option
from iits_mj.parameters.truck import Aerodynamics, Steering, Tire, TireCommon, TruckParameters
from iits_mj.parameters.units import Axle, Coupling, Payload, Unit

__all__ = [
    "MAX_PAYLOAD",
    "Aerodynamics",
    "Axle",
    "Coupling",
    "Payload",
    "Steering",
    "Tire",
    "TireCommon",
    "TruckParameters",
    "Unit",
    "payload_option",
    "shipped_trucks",
    "truck_file",
]
