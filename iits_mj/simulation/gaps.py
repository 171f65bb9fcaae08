"""Gaps between the truck and the traffic: along the lane, and box to box."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from iits_mj.messages import EgoFootprint, EgoState, TrackedVehicle
from iits_mj.parameters import TruckParameters
from traffic_bridge import VehicleFrame

FloatArray = NDArray[np.float64]

# [m] between two roads that cross one above the other: bridges leave at least that free.
OTHER_LEVEL = 4.5


def lane_gaps(
    ego: EgoState, lane: int, vehicles: Iterable[TrackedVehicle], footprint: EgoFootprint
) -> tuple[float, float]:
    """Bumper-to-bumper gaps to the vehicles ahead and behind in the truck's lane [m].

    A vehicle counts when its box reaches into the truck's own width, whatever lane it is listed
    in, so one that is cutting in is seen. inf where there is no vehicle; a negative gap is an
    overlap.
    """
    front = ego.station + footprint.front_overhang
    rear = front - footprint.length
    center = 0.5 * (front + rear)
    frame = VehicleFrame.of(vehicles)
    station, half = frame.column("station"), 0.5 * frame.column("length")
    reach = 0.5 * (frame.column("width") + footprint.width)
    inside = np.abs(frame.column("offset") - ego.offset) < reach
    if lane >= 0:
        inside |= frame.lanes == lane
    inside &= _on_level(frame, ego)
    before = inside & (station >= center)
    after = inside & (station < center)
    ahead = float(np.min((station - half - front)[before], initial=math.inf))
    behind = float(np.min((rear - station - half)[after], initial=math.inf))
    return ahead, behind


def truck_boxes(ego: EgoState, parameters: TruckParameters) -> tuple[FloatArray, FloatArray]:
    """Corners of tractor and semitrailer in the map frame, each of shape (4, 2) [m]."""
    tractor, trailer = parameters.tractor, parameters.semitrailer
    rear = tractor.axles[-1].position + 0.6
    tractor_box = _box(ego.x, ego.y, ego.yaw, tractor.front_overhang, rear, tractor.width)
    hitch = parameters.fifth_wheel.position
    kingpin_x = ego.x - hitch * math.cos(ego.yaw)
    kingpin_y = ego.y - hitch * math.sin(ego.yaw)
    trailer_box = _box(
        kingpin_x,
        kingpin_y,
        ego.yaw - ego.articulation,
        trailer.front_overhang,
        trailer.length - trailer.front_overhang,
        trailer.width,
    )
    return tractor_box, trailer_box


def nearest_box_distance(
    ego: EgoState,
    vehicles: Iterable[TrackedVehicle],
    parameters: TruckParameters,
    horizon: float = 80.0,
) -> float:
    """Distance from tractor or semitrailer to the nearest vehicle's box [m], in the plane.

    0 when two boxes overlap, inf when no vehicle's centre is within `horizon` of the steer axle, on
    its level: who is on a bridge above does not count.
    """
    frame = VehicleFrame.of(vehicles).near(ego.x, ego.y, horizon)
    frame = frame.select(_on_level(frame, ego))
    boxes = truck_boxes(ego, parameters)
    nearest = math.inf
    for vehicle in frame:
        half = 0.5 * vehicle.length
        other = _box(vehicle.x, vehicle.y, vehicle.yaw, half, half, vehicle.width)
        nearest = min(nearest, *(box_distance(box, other) for box in boxes))
    return nearest


def _on_level(frame: VehicleFrame, ego: EgoState) -> NDArray[np.bool_]:
    """Vehicles of the truck's road, and those of other roads that are not above or below it."""
    return np.asarray((frame.lanes >= 0) | (np.abs(frame.column("z") - ego.z) < OTHER_LEVEL))


def box_distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two rectangles given by their corners, shape (4, 2) each; 0 on overlap."""
    if not _separated(a, b) and not _separated(b, a):
        return 0.0
    return min(_corners_to_edges(a, b), _corners_to_edges(b, a))


def _box(x: float, y: float, yaw: float, ahead: float, behind: float, width: float) -> FloatArray:
    forward = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-forward[1], forward[0]])
    longitudinal = np.array([ahead, ahead, -behind, -behind])[:, None]
    lateral = 0.5 * width * np.array([-1.0, 1.0, 1.0, -1.0])[:, None]
    return np.array([x, y]) + longitudinal * forward + lateral * left


def _separated(a: FloatArray, b: FloatArray) -> bool:
    """Separating-axis test along the two edge directions of `a`."""
    for edge in (a[1] - a[0], a[3] - a[0]):
        on_a, on_b = a @ edge, b @ edge
        if on_a.max() < on_b.min() or on_b.max() < on_a.min():
            return True
    return False


def _corners_to_edges(corners: FloatArray, box: FloatArray) -> float:
    start = box[None, :, :]
    edge = np.roll(box, -1, axis=0)[None, :, :] - start
    relative = corners[:, None, :] - start
    along = np.clip((relative * edge).sum(-1) / (edge * edge).sum(-1), 0.0, 1.0)
    return float(np.linalg.norm(relative - along[..., None] * edge, axis=-1).min())
