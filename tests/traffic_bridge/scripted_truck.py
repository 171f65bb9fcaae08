"""A scripted truck and the exact overlap of boxes, for the tests of the traffic bridge."""

from __future__ import annotations

import math

import numpy as np

from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.road import Route


def ego_at(route: Route, time: float, station: float, speed: float, offset: float) -> EgoState:
    """State of a truck that follows the road at an offset."""
    point = route.evaluate(station, offset)
    return EgoState(
        time=time,
        x=float(point.x),
        y=float(point.y),
        z=float(point.z),
        yaw=float(point.heading),
        speed=speed,
        station=station,
        offset=offset,
        trailer_offset=offset,
    )


def ego_box(ego: EgoState) -> np.ndarray:
    """Corners (4, 2) of the straight combination."""
    back = 16.5 / 2 - 1.40
    x, y = ego.x - back * math.cos(ego.yaw), ego.y - back * math.sin(ego.yaw)
    return corners(x, y, ego.yaw, 16.5, 2.55)


def vehicle_box(vehicle: TrackedVehicle) -> np.ndarray:
    """Corners (4, 2) of a vehicle."""
    return corners(vehicle.x, vehicle.y, vehicle.yaw, vehicle.length, vehicle.width)


def corners(x: float, y: float, yaw: float, length: float, width: float) -> np.ndarray:
    along = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-along[1], along[0]])
    signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
    return np.array(
        [np.array([x, y]) + 0.5 * a * length * along + 0.5 * b * width * left for a, b in signs]
    )


def overlap(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two convex quadrilaterals overlap (separating axes)."""
    for box in (a, b):
        for edge in np.roll(box, -1, axis=0) - box:
            normal = np.array([edge[1], -edge[0]])
            first, second = a @ normal, b @ normal
            if first.max() <= second.min() or second.max() <= first.min():
                return False
    return True
