"""Distances between the boxes of the truck and of the traffic."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable

import numpy as np

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.boxes import box_corners
from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.core.neighbors import LEVEL_OVER_TRUCK
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from iits_mj.kernels import Address, Integer, Real
from iits_mj.parameters import TruckParameters

_nearest_box = kernels.function(
    "iits_nearest_box",
    Real,
    *(Address, Integer),  # the truck's units
    *(Address, Address, Address, Integer),  # the vehicles
    *(Real, Real, Real, Real, Real),  # horizon and level
)
_PLACES = np.array([COLUMNS.index(name) for name in ("x", "y", "z", "yaw", "length", "width")])
_PLACES_ADDRESS = kernels.address(_PLACES)
_pack_units = struct.Struct("12d").pack


def truck_boxes(ego: EgoState, parameters: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Returns corners of tractor and semitrailer in the map frame, each of shape (4, 2) [m]."""
    tractor, trailer = (box_corners(*unit) for unit in _units(ego, parameters))
    return np.array(tractor), np.array(trailer)


def nearest_box_distance(
    ego: EgoState,
    vehicles: Iterable[TrackedVehicle],
    parameters: TruckParameters,
    horizon: float = 80.0,
) -> float:
    """Returns the distance in the plane from the truck to the nearest vehicle's box [m].

    It is 0 when two boxes overlap, and inf when no vehicle's centre is within `horizon` of the
    steer axle [m]. Vehicles on another level, such as a bridge above, are ignored.
    """
    frame = VehicleFrame.of(vehicles)
    if not frame:
        return math.inf
    columns, lanes = frame.addresses
    tractor, trailer = _units(ego, parameters)
    return float(
        _nearest_box(
            *(_pack_units(*tractor, *trailer), 2),
            *(columns, _PLACES_ADDRESS, lanes, len(frame)),
            *(ego.x, ego.y, horizon, ego.z, LEVEL_OVER_TRUCK),
        )
    )


def _units(ego: EgoState, parameters: TruckParameters) -> tuple[tuple[float, ...], ...]:
    """Origin, heading, reach ahead and behind, and width of tractor and semitrailer."""
    tractor, trailer = parameters.lead, parameters.units[1]
    rear = tractor.axles[-1].position + 0.6
    hitch = parameters.couplings[0].position
    return (
        (ego.x, ego.y, ego.yaw, tractor.front_overhang, rear, tractor.width),
        (
            ego.x - hitch * math.cos(ego.yaw),
            ego.y - hitch * math.sin(ego.yaw),
            ego.yaw - ego.articulation,
            trailer.front_overhang,
            trailer.length - trailer.front_overhang,
            trailer.width,
        ),
    )
