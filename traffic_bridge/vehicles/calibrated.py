"""The package's vehicle types with the car as fitted to recorded drivers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from traffic_bridge.vehicles.types import VehicleType, read_types


@cache
def calibrated_types() -> tuple[VehicleType, ...]:
    """The default types with the car of `calibrated_types.toml`, which says where it comes from.

    Fitted in congestion: for dense traffic, `TrafficConfig(types=calibrated_types())`. Cars then
    stop within 1 m, nearer than the default ones.
    """
    return read_types(Path(__file__).with_name("calibrated_types.toml"))
