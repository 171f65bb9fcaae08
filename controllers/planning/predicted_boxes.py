"""Boxes of the traffic over the coming seconds, and the ground that the truck's bodies sweep.

The prediction of a vehicle keeps its braking and the curvature of its path. For an oncoming vehicle
a second prediction keeps its offset from the road.

The truck follows its path without slip. Each unit is a bar whose rear axle group moves along the
bar (a tractrix): the motor vehicle from the steer axle to the middle of its fixed axles, a towed
unit from its coupling to the middle of its axle group. Trucks do this at walking pace; at speed,
slip of the tires moves trailers outward, see `controllers.planning.road_preview.off_tracking`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.trajectory import Quintic
from iits_mj.analytic import Kinematic
from iits_mj.core.angles import wrap_angle, wrap_angles
from iits_mj.core.arrays import BoolArray, FloatArray
from iits_mj.core.boxes import Boxes
from iits_mj.core.neighbors import Neighbors
from iits_mj.parameters import TruckParameters

# A slower vehicle is predicted to drive straight [m/s].
_TURNS = 0.5
# Distance after which a tractor with a trailer has settled on its path [m], and what each further
# unit adds, as multiple of its length from coupling to axle group.
_RUN_UP, _RUN_UP_LENGTHS = 30.0, 4.0
# The body of a tractor with a trailer counts up to here behind the middle of its fixed axles [m]:
# the rest of the frame is under the trailer.
_REAR = 1.0


@dataclass(frozen=True)
class Poses:
    """Vehicles in the map frame, arrays of shape (n,).

    Attributes:
      x, y: [m]; yaw: [rad]; to_road: heading relative to the road's [rad], -pi to pi.
      speed: magnitude [m/s]; braking: deceleration [m/s2], zero or positive; yaw_rate: [rad/s].
      station, offset, length, width: [m].
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    to_road: FloatArray
    speed: FloatArray
    braking: FloatArray
    yaw_rate: FloatArray
    station: FloatArray
    offset: FloatArray
    length: FloatArray
    width: FloatArray

    @classmethod
    def of(cls, neighbors: Neighbors, chosen: BoolArray, preview: RoadPreview) -> Poses:
        """Poses of the chosen vehicles; without a pose, from station and offset.

        Args:
          neighbors: the traffic.
          chosen: which of it, shape (n,).
          preview: of the road.
        """
        station, offset, speed, aside, yaw, x, y, acceleration = (
            column[chosen]
            for column in (
                *(neighbors.station, neighbors.offset, neighbors.speed, neighbors.lateral_speed),
                *(neighbors.yaw, neighbors.x, neighbors.y, neighbors.acceleration),
            )
        )
        posed = neighbors.posed[chosen]
        heading = preview.route.heading(station)
        fast = np.maximum(np.abs(speed), np.abs(aside))
        across = np.arcsin(np.minimum(np.maximum(aside / np.maximum(fast, 1e-6), -1.0), 1.0))
        across = np.where(speed < 0.0, np.pi - across, across)
        yaw = np.where(posed, yaw + np.where(speed < 0.0, np.pi, 0.0), heading + across)
        if not posed.all():
            point = preview.route.evaluate(station, offset)
            x, y = np.where(posed, x, point.x), np.where(posed, y, point.y)
        return cls(
            x=x,
            y=y,
            yaw=yaw,
            to_road=wrap_angles(yaw - heading),
            speed=np.where(posed, np.abs(speed), fast),
            braking=np.maximum(-np.sign(np.where(speed < 0.0, -1.0, 1.0)) * acceleration, 0.0),
            yaw_rate=neighbors.yaw_rate[chosen],
            station=station,
            offset=offset,
            length=neighbors.length[chosen],
            width=neighbors.width[chosen],
        )

    def only(self, chosen: BoolArray) -> Poses:
        """Some of the vehicles."""
        return Poses(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def one(self, index: int) -> Poses:
        """One of the vehicles."""
        return self.only(np.arange(len(self.x)) == index)

    def distance(self, times: FloatArray) -> FloatArray:
        """Distance driven until the times, shape (times, n) [m]."""
        t = times[:, None]
        stop = np.where(self.braking > 1e-3, self.speed / np.maximum(self.braking, 1e-3), np.inf)
        moving = np.minimum(t, stop)
        return np.asarray(self.speed * moving - 0.5 * self.braking * moving**2)

    def ahead(self, times: FloatArray) -> Boxes:
        """Boxes at constant turn rate, arrays of shape (times, n)."""
        distance = self.distance(times)
        bend = np.where(self.speed > _TURNS, self.yaw_rate / np.maximum(self.speed, _TURNS), 0.0)
        turn = bend * distance
        chord = distance * np.sinc(0.5 * turn / np.pi)
        course = self.yaw + 0.5 * turn
        x, y = self.x + chord * np.cos(course), self.y + chord * np.sin(course)
        return Boxes(x, y, self.yaw + turn, self.length, self.width)

    def along_road(self, times: FloatArray, preview: RoadPreview) -> Boxes:
        """Boxes of oncoming vehicles that keep their offset, arrays of shape (times, n)."""
        station = self.station - self.distance(times)
        offset = np.broadcast_to(self.offset, station.shape)
        point = preview.route.evaluate(station.ravel(), offset.ravel())
        x, y, yaw = (
            np.asarray(v).reshape(station.shape) for v in (point.x, point.y, point.heading)
        )
        return Boxes(x, y, yaw + np.pi, self.length, self.width)


@dataclass(frozen=True)
class UnitTrack:
    """Tracks of one unit over the points of a path; positions of shape (n, 2) [m].

    Attributes:
      origin: of the steer axle or the coupling to the unit ahead; group: of the axle group behind.
      yaw: heading, (n,) [rad].
      corners: front left, front right, rear right, rear left of the body, (n, 4, 2).
    """

    origin: FloatArray
    group: FloatArray
    yaw: FloatArray
    corners: FloatArray


def swept_path(
    parameters: TruckParameters,
    path: FloatArray,
    yaw: float,
    towed_yaws: Sequence[float] = (),
    payload: float | None = None,
) -> tuple[UnitTrack, ...]:
    """Tracks of the truck whose steer axle follows a path, unit by unit.

    Args:
      parameters: of the truck.
      path: points, shape (n, 2), some decimeters apart [m].
      yaw: heading of the motor vehicle at the first point [rad].
      towed_yaws: of the towed units there [rad]; default: the motor vehicle's.
      payload: see `unit_lengths`.
    """
    lead, origin = parameters.lead, path
    tracks: list[UnitTrack] = []
    yaws = [yaw, *(towed_yaws or [yaw] * len(parameters.couplings))]
    steered = lead.axles[0].position
    lengths = unit_lengths(parameters, payload)
    for k, (unit, length, start) in enumerate(zip(parameters.units, lengths, yaws, strict=True)):
        if unit.coupling:
            ahead = tracks[-1]
            hitch = unit.coupling.position - (steered if k == 1 else 0.0)
            origin = ahead.origin - hitch * _unit(ahead.yaw)
        headings = _towed(origin, length, start)
        rear = unit.length - unit.front_overhang
        if unit.kind == "tractor" and parameters.couplings:
            rear = length + _REAR
        tracks.append(
            UnitTrack(
                origin=origin,
                group=origin - length * _unit(headings),
                yaw=headings,
                corners=_corners(origin, headings, unit.front_overhang, rear, unit.width),
            )
        )
    return tuple(tracks)


def unit_lengths(parameters: TruckParameters, payload: float | None = None) -> tuple[float, ...]:
    """Distances from the steer axle or a coupling to the middle of the unit's other axles [m].

    Args:
      parameters: of the truck.
      payload: with which lift axles are up or down [kg]; default: laden.
    """
    lengths = Kinematic.from_parameters(parameters, payload)
    return (lengths.L, *lengths.lengths)


def bodies_along(
    parameters: TruckParameters,
    preview: RoadPreview,
    path: LanePath,
    residual: Quintic | None,
    stations: FloatArray,
    payload: float | None = None,
) -> tuple[Boxes, ...]:
    """Boxes of the units with the steer axle at stations [m], shape (n,) each.

    Args:
      parameters: of the truck.
      preview: of the road.
      path: that the steer axle follows.
      residual: offset from the path, None for none.
      stations: of the steer axle, rising [m].
      payload: see `unit_lengths`.
    """
    first = float(stations[0])
    before = _RUN_UP + _RUN_UP_LENGTHS * sum(unit_lengths(parameters, payload)[2:])
    run_up = np.arange(first - before, first - 0.5, 2.0)
    every = np.concatenate([run_up, stations])
    offset = path.driven_at(every)
    if residual is not None:
        offset = offset + residual.evaluate(every)[0]
    point = preview.route.evaluate(every, offset)
    way = np.column_stack([point.x, point.y])
    tracks = swept_path(parameters, way, float(np.asarray(point.heading)[0]), payload=payload)
    kept = slice(len(run_up), None)
    return tuple(_body_boxes(track.corners[kept], track.yaw[kept]) for track in tracks)


def _body_boxes(corners: FloatArray, yaw: FloatArray) -> Boxes:
    """Boxes of one unit from its corners of shape (n, 4, 2), see `UnitTrack`."""
    middle = corners.mean(axis=1)
    sides = np.linalg.norm(np.diff(corners[0, :3], axis=0), axis=1)
    return Boxes(middle[:, 0], middle[:, 1], yaw, np.array(sides[1]), np.array(sides[0]))


def _towed(lead: FloatArray, length: float, heading: float) -> FloatArray:
    """Headings of a bar whose front follows the points and whose rear rolls, shape (n,).

    Between two points the front moves straight; on this tractrix the angle `theta` of the bar to
    the course follows `tan(theta / 2) = tan(theta_0 / 2) exp(-way / length)`.
    """
    result = np.empty(len(lead))
    result[0] = heading
    steps = np.diff(lead, axis=0)
    ways, courses = np.hypot(*steps.T), np.arctan2(steps[:, 1], steps[:, 0])
    for i, (way, course) in enumerate(zip(ways.tolist(), courses.tolist(), strict=True)):
        if way > 0.0:
            angle = wrap_angle(heading - course)
            left = 2.0 * math.atan(math.tan(0.5 * angle) * math.exp(-way / length))
            heading += left - angle
        result[i + 1] = heading
    return result


def _unit(heading: FloatArray) -> FloatArray:
    return np.column_stack([np.cos(heading), np.sin(heading)])


def _corners(
    origin: FloatArray, heading: FloatArray, front: float, rear: float, width: float
) -> FloatArray:
    """Corners of a body about its origin, shape (n, 4, 2)."""
    along, left = _unit(heading), _unit(heading + 0.5 * np.pi)
    half = 0.5 * width
    ends = ((front, half), (front, -half), (-rear, -half), (-rear, half))
    return np.stack([origin + x * along + y * left for x, y in ends], axis=1)
