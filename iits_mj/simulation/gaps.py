"""Distances between the boxes of the truck and of the traffic."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.boxes import Corners, box_corners, box_distance, separation
from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.core.neighbors import LEVEL_OVER_TRUCK
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import TruckParameters

# A lower bound of a distance may be off by less than this [m].
_ROUNDING = 1e-6


def truck_boxes(ego: EgoState, parameters: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Returns corners of tractor and semitrailer in the map frame, each of shape (4, 2) [m]."""
    tractor, trailer = _truck_corners(ego, parameters)
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
    frame = VehicleFrame.of(vehicles).near(ego.x, ego.y, horizon)
    level = (frame.lanes >= 0) | (np.abs(frame.column("z") - ego.z) < LEVEL_OVER_TRUCK)
    places = frame.select(level).columns("x", "y", "yaw", "length", "width").T.tolist()
    others = [
        box_corners(x, y, yaw, 0.5 * long, 0.5 * long, wide) for x, y, yaw, long, wide in places
    ]
    units = _truck_corners(ego, parameters)
    # Sorted by the lower bound: most pairs need no exact distance.
    pairs = sorted(
        (separation(unit, other), u, o)
        for u, unit in enumerate(units)
        for o, other in enumerate(others)
    )
    nearest = math.inf
    for least, u, o in pairs:
        if least > nearest + _ROUNDING:
            break
        nearest = min(nearest, box_distance(units[u], others[o]))
    return nearest


def _truck_corners(ego: EgoState, parameters: TruckParameters) -> tuple[Corners, Corners]:
    tractor, trailer = parameters.tractor, parameters.semitrailer
    rear = tractor.axles[-1].position + 0.6
    hitch = parameters.fifth_wheel.position
    return (
        box_corners(ego.x, ego.y, ego.yaw, tractor.front_overhang, rear, tractor.width),
        box_corners(
            ego.x - hitch * math.cos(ego.yaw),
            ego.y - hitch * math.sin(ego.yaw),
            ego.yaw - ego.articulation,
            trailer.front_overhang,
            trailer.length - trailer.front_overhang,
            trailer.width,
        ),
    )
