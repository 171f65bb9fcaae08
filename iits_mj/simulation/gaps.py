"""Distances between the boxes of the truck and of the traffic."""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Iterable

import numpy as np

from iits_mj import kernels
from iits_mj.core.arrays import FloatArray
from iits_mj.core.boxes import UnitBox, box_corners, unit_boxes
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


def truck_boxes(ego: EgoState, parameters: TruckParameters) -> tuple[FloatArray, ...]:
    """Returns the corners of each unit in the map frame, of shape (4, 2) [m]."""
    return tuple(np.array(box_corners(*unit)) for unit in truck_units(ego, parameters))


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
    units = truck_units(ego, parameters)
    return float(
        _nearest_box(
            *(struct.pack(f"{6 * len(units)}d", *itertools.chain(*units)), len(units)),
            *(columns, _PLACES_ADDRESS, lanes, len(frame)),
            *(ego.x, ego.y, horizon, ego.z, LEVEL_OVER_TRUCK),
        )
    )


def truck_units(ego: EgoState, parameters: TruckParameters) -> list[UnitBox]:
    """Returns the boxes of the units, front to rear."""
    articulations = (ego.articulation, *ego.rear_articulations)
    return unit_boxes(ego.x, ego.y, ego.yaw, articulations, parameters.unit_shapes)
