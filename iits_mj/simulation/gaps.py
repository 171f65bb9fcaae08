"""Gaps between the truck and the traffic: along the lane, and box to box."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoFootprint, EgoState, TrackedVehicle
from iits_mj.parameters import TruckParameters
from traffic_bridge import VehicleFrame

# [m] between two roads that cross one above the other: bridges leave at least that free.
OTHER_LEVEL = 4.5
# A bound on a distance may be off by less than this [m].
_ROUNDING = 1e-6

Corners = Sequence[Sequence[float]]


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
    tractor, trailer = _truck_corners(ego, parameters)
    return np.array(tractor), np.array(trailer)


def _truck_corners(ego: EgoState, parameters: TruckParameters) -> tuple[Corners, Corners]:
    tractor, trailer = parameters.tractor, parameters.semitrailer
    rear = tractor.axles[-1].position + 0.6
    hitch = parameters.fifth_wheel.position
    return (
        _box(ego.x, ego.y, ego.yaw, tractor.front_overhang, rear, tractor.width),
        _box(
            ego.x - hitch * math.cos(ego.yaw),
            ego.y - hitch * math.sin(ego.yaw),
            ego.yaw - ego.articulation,
            trailer.front_overhang,
            trailer.length - trailer.front_overhang,
            trailer.width,
        ),
    )


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
    if not len(frame):
        return math.inf
    boxes = _truck_corners(ego, parameters)
    circles = [_circle(box) for box in boxes]
    places = frame.columns("x", "y", "yaw", "length", "width").T.tolist()
    # At least so far apart are their circles: the nearest first, the others most often not at all.
    apart = sorted(
        (math.hypot(x - place[0], y - place[1]) - reach - 0.5 * math.hypot(*place[3:]), n, unit)
        for n, place in enumerate(places)
        for unit, (x, y, reach) in enumerate(circles)
    )
    nearest = math.inf
    for least, number, unit in apart:
        if least > nearest + _ROUNDING:
            break
        x, y, yaw, length, width = places[number]
        other = _box(x, y, yaw, 0.5 * length, 0.5 * length, width)
        nearest = min(nearest, _distance(boxes[unit], other))
    return nearest


def _on_level(frame: VehicleFrame, ego: EgoState) -> NDArray[np.bool_]:
    """Vehicles of the truck's road, and those of other roads that are not above or below it."""
    return np.asarray((frame.lanes >= 0) | (np.abs(frame.column("z") - ego.z) < OTHER_LEVEL))


def box_distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two rectangles given by their corners, shape (4, 2) each; 0 on overlap."""
    return _distance(a.tolist(), b.tolist())


def _distance(a: Corners, b: Corners) -> float:
    if not _separated(a, b) and not _separated(b, a):
        return 0.0
    return min(_corners_to_edges(a, b), _corners_to_edges(b, a))


def _box(x: float, y: float, yaw: float, ahead: float, behind: float, width: float) -> Corners:
    """Front right, front left, rear left and rear right corner."""
    forward_x, forward_y, half = math.cos(yaw), math.sin(yaw), 0.5 * width
    return [
        (x + along * forward_x + across * -forward_y, y + along * forward_y + across * forward_x)
        for along, across in ((ahead, -half), (ahead, half), (-behind, half), (-behind, -half))
    ]


def _circle(box: Corners) -> tuple[float, float, float]:
    """Centre of a rectangle and how far its corners are from it [m]."""
    (x0, y0), _, (x1, y1), _ = box
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * math.hypot(x1 - x0, y1 - y0)


def _separated(a: Corners, b: Corners) -> bool:
    """Separating-axis test along the two edge directions of `a`."""
    (x0, y0), (x1, y1), _, (x3, y3) = a
    for ex, ey in ((x1 - x0, y1 - y0), (x3 - x0, y3 - y0)):
        on_a = [x * ex + y * ey for x, y in a]
        on_b = [x * ex + y * ey for x, y in b]
        if max(on_a) < min(on_b) or max(on_b) < min(on_a):
            return True
    return False


def _corners_to_edges(corners: Corners, box: Corners) -> float:
    nearest = math.inf
    for (x0, y0), (x1, y1) in zip(box, [*box[1:], box[0]], strict=True):
        ex, ey = x1 - x0, y1 - y0
        square = ex * ex + ey * ey
        for x, y in corners:
            dx, dy = x - x0, y - y0
            along = min(max((dx * ex + dy * ey) / square, 0.0), 1.0)
            dx, dy = dx - along * ex, dy - along * ey
            nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)
