"""From the planner's pieces to a trajectory, and from neighbors to leads."""

from __future__ import annotations

import numpy as np

from controllers.following import Lead
from controllers.quintic import Quintic
from controllers.road_preview import LanePath, RoadPreview
from controllers.surroundings import Neighbor
from iits_mj.core.arrays import FloatArray
from iits_mj.messages import Scene, Trajectory

# Shorter pieces of the plan have no direction of their own [m].
_MOVES = 0.02


def on_road(
    preview: RoadPreview,
    path: LanePath,
    residual: Quintic | None,
    time: float,
    station: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    step: float,
    urgency: float,
) -> Trajectory:
    """Lane path plus quintic over station, with speed over time, in the map frame.

    Args:
      preview: tables of the road.
      path: of the target lane.
      residual: offset from the path, None for none.
      time: of the first point [s].
      station: of shape (n,) [m].
      speed: of shape (n,) [m/s].
      acceleration: of shape (n,) [m/s2].
      step: between points [s].
      urgency: greatest deceleration that a leader requires, for logs [m/s2].
    """
    slopes, bends = preview.course(path)
    slope = np.interp(station, path.station, slopes)
    bend = np.interp(station, path.station, bends)
    offset = np.interp(station, path.station, path.driven)
    if residual is not None:
        q, first, second, _ = residual.evaluate(station)
        offset, slope, bend = offset + q, slope + first, bend + second
    curvature = np.interp(station, preview.station, preview.curvature)
    stretch = 1.0 - curvature * offset
    point = preview.route.evaluate(station, offset)
    x, y = np.asarray(point.x), np.asarray(point.y)
    yaw = np.asarray(point.heading) + np.arctan2(slope, stretch)
    # Of an offset curve, for small angles to the road; where the truck moves, of its points.
    bent = _turn_by_way(x, y, yaw, curvature / stretch + bend / stretch**2)
    return Trajectory(
        time=np.asarray(time + step * np.arange(len(station)), dtype=np.float64),
        station=station,
        offset=offset,
        x=x,
        y=y,
        z=np.asarray(point.z),
        yaw=yaw,
        curvature=bent,
        speed=speed,
        acceleration=acceleration,
        extra={"urgency": urgency},
    )


def _turn_by_way(x: FloatArray, y: FloatArray, yaw: FloatArray, still: FloatArray) -> FloatArray:
    """Curvature of a path of points with headings [1/m]; `still` where it does not move on."""
    ways = np.hypot(x[1:] - x[:-1], y[1:] - y[:-1])
    turns = yaw[1:] - yaw[:-1]
    turns = np.remainder(turns + np.pi, 2.0 * np.pi) - np.pi
    moves = ways > _MOVES
    each = np.where(moves, turns / np.maximum(ways, _MOVES), 0.0)
    # At a point: of the pieces before and behind that have a length.
    pieces = np.zeros((2, len(yaw) + 1))
    pieces[0, 1:-1], pieces[1, 1:-1] = each, moves
    total, count = pieces[:, 1:] + pieces[:, :-1]
    return np.asarray(np.where(count > 0.0, total / np.maximum(count, 1.0), still))


def lead_of(neighbor: Neighbor) -> Lead:
    """The neighbor as somebody to follow."""
    vehicle = neighbor.vehicle
    return Lead(neighbor.gap, max(vehicle.speed, 0.0), vehicle.acceleration)


def lead_while_passing(
    scene: Scene,
    path: LanePath,
    residual: Quintic,
    old: Neighbor,
    side_gap: float,
    margin: float,
) -> Lead | None:
    """The leader of the lane being left, as long as it can still be touched; else None.

    Args:
      scene: the truck.
      path: of the target lane.
      residual: of the change under way.
      old: the leader of the old lane.
      side_gap: wanted beside it [m].
      margin: wanted behind it until the truck is beside [m].
    """
    ego = scene.ego
    clear = 0.5 * (old.vehicle.width + scene.footprint.width) + side_gap
    stations = np.linspace(ego.station, max(residual.end, ego.station + 1.0), 40)
    offsets = path.driven_at(stations) + residual.evaluate(stations)[0]
    aside = np.abs(offsets - old.vehicle.offset) > clear
    free_at = float(stations[int(np.argmax(aside))]) if aside.any() else float(stations[-1])
    until = (free_at - ego.station) / max(ego.speed, 1.0)
    closing = ego.speed - old.vehicle.speed
    spare = old.gap - max(closing, 0.0) * until - margin
    if until <= 0.0 or spare > 0.0:
        return None
    lead = lead_of(old)
    return Lead(lead.gap, lead.speed, lead.acceleration, until)
