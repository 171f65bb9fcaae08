"""The ground that tractor and semitrailer sweep when the steer axle follows a path, without slip.

Each unit is a bar whose rear axle group moves along the bar (a tractrix): tractor from the steer
axle to the middle of its fixed axles, semitrailer from the kingpin to the middle of its axle group.
At walking pace this is what trucks do; at speed tires' slip moves the trailer outward, see
`controllers.planning.placement.off_tracking`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.planning.road_preview import RoadPreview
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import TrackedVehicle
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.mass_state import group_center

# --- Boxes of vehicles over the coming seconds, and which of them the truck's bodies would touch
# A vehicle keeps its speed, its braking and its yaw rate (constant turn rate); who comes towards
# the truck on its road also keeps its offset from the road. Boxes touch unless a side of one of
# them separates them (separating axes).

# Slower than this a vehicle does not turn on [m/s].
_TURNS = 0.5
# Columns of `table_of`: what the planner uses of a vehicle; without a pose the last three are zero.
FIGURES = (
    *("station", "offset", "speed", "lateral_speed", "length", "width"),
    *("acceleration", "yaw", "yaw_rate", "x", "y", "z"),
)
_figures = operator.attrgetter(*FIGURES)


@dataclass(frozen=True)
class Boxes:
    """Rectangles; arrays of one shape, lengths and widths broadcast to it.

    Attributes:
      x, y: of the middles [m]; yaw: [rad]; length, width: [m].
    """

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray


@dataclass(frozen=True)
class Poses:
    """Vehicles in the map frame, arrays of shape (n,).

    Attributes:
      x, y: [m]; yaw: [rad]; to_road: heading to the road's [rad], -pi to pi; speed: [m/s], a
        magnitude; braking: deceleration [m/s2], zero at least; yaw_rate: [rad/s].
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

    def only(self, which: NDArray[np.bool_]) -> Poses:
        """Some of them."""
        return Poses(**{name: getattr(self, name)[which] for name in self.__dataclass_fields__})

    def ways(self, times: FloatArray) -> FloatArray:
        """Ways gone until the times, shape (times, n) [m]."""
        t = times[:, None]
        stop = np.where(self.braking > 1e-3, self.speed / np.maximum(self.braking, 1e-3), np.inf)
        moving = np.minimum(t, stop)
        return np.asarray(self.speed * moving - 0.5 * self.braking * moving**2)

    def ahead(self, times: FloatArray) -> Boxes:
        """Boxes at constant turn rate, arrays of shape (times, n)."""
        ways = self.ways(times)
        bend = np.where(self.speed > _TURNS, self.yaw_rate / np.maximum(self.speed, _TURNS), 0.0)
        turn = bend * ways
        chord = ways * np.sinc(0.5 * turn / np.pi)
        course = self.yaw + 0.5 * turn
        x, y = self.x + chord * np.cos(course), self.y + chord * np.sin(course)
        return Boxes(x, y, self.yaw + turn, self.length, self.width)

    def along_road(self, times: FloatArray, preview: RoadPreview) -> Boxes:
        """Boxes that come towards the truck at their offset, arrays of shape (times, n)."""
        station = self.station - self.ways(times)
        offset = np.broadcast_to(self.offset, station.shape)
        point = preview.route.evaluate(station.ravel(), offset.ravel())
        x, y, yaw = (
            np.asarray(v).reshape(station.shape) for v in (point.x, point.y, point.heading)
        )
        return Boxes(x, y, yaw + np.pi, self.length, self.width)


def table_of(vehicles: Sequence[TrackedVehicle]) -> FloatArray:
    """The `FIGURES` of vehicles, one a row, shape (n, 12)."""
    return np.array(list(map(_figures, vehicles)), dtype=float).reshape(-1, len(FIGURES))


def poses(table: FloatArray, preview: RoadPreview) -> Poses:
    """Poses of vehicles; one whose x, y and z are all zero has its place by station and offset.

    Args:
      table: of them, see `table_of`.
      preview: of the road.
    """
    station, offset, speed, aside, length, width, acceleration, yaw, yaw_rate, x, y, z = table.T
    heading = preview.route.heading(station)
    posed = (x != 0.0) | (y != 0.0) | (z != 0.0)
    fast = np.maximum(np.abs(speed), np.abs(aside))
    across = np.arcsin(np.minimum(np.maximum(aside / np.maximum(fast, 1e-6), -1.0), 1.0))
    across = np.where(speed < 0.0, np.pi - across, across)
    yaw = np.where(posed, yaw + np.where(speed < 0.0, np.pi, 0.0), heading + across)
    if not posed.all():
        point = preview.route.evaluate(station, offset)
        x, y = np.where(posed, x, point.x), np.where(posed, y, point.y)
    return Poses(
        x=x,
        y=y,
        yaw=yaw,
        to_road=np.remainder(yaw - heading + np.pi, 2.0 * np.pi) - np.pi,
        speed=np.where(posed, np.abs(speed), fast),
        braking=np.maximum(-np.sign(np.where(speed < 0.0, -1.0, 1.0)) * acceleration, 0.0),
        yaw_rate=yaw_rate,
        station=station,
        offset=offset,
        length=length,
        width=width,
    )


def body_boxes(corners: FloatArray, yaw: FloatArray) -> Boxes:
    """Boxes of a truck's unit from its corners of shape (n, 4, 2), see `swept_path`."""
    middle = corners.mean(axis=1)
    sides = np.linalg.norm(np.diff(corners[0, :3], axis=0), axis=1)
    return Boxes(middle[:, 0], middle[:, 1], yaw, np.array(sides[1]), np.array(sides[0]))


def touching(truck: Boxes, others: Boxes, room: float) -> NDArray[np.bool_]:
    """Which boxes come nearer than `room` [m]; shape (truck's n, *shape of others)."""
    extra = (None,) * others.x.ndim
    dx = others.x[None] - truck.x[(slice(None), *extra)]
    dy = others.y[None] - truck.y[(slice(None), *extra)]
    yaw = truck.yaw[(slice(None), *extra)]
    own = 0.5 * truck.length + room, 0.5 * truck.width + room
    half = 0.5 * others.length, 0.5 * others.width
    c, s = np.cos(yaw), np.sin(yaw)
    other_c, other_s = np.cos(others.yaw)[None], np.sin(others.yaw)[None]
    cos, sin = np.abs(c * other_c + s * other_s), np.abs(c * other_s - s * other_c)
    meets = np.abs(c * dx + s * dy) <= own[0] + half[0] * cos + half[1] * sin
    meets &= np.abs(c * dy - s * dx) <= own[1] + half[0] * sin + half[1] * cos
    c, s = other_c, other_s
    meets &= np.abs(c * dx + s * dy) <= half[0] + own[0] * cos + own[1] * sin
    meets &= np.abs(c * dy - s * dx) <= half[1] + own[0] * sin + own[1] * cos
    return np.asarray(meets)


# --- The ground that tractor and semitrailer sweep when the steer axle follows a path, without slip


@dataclass(frozen=True)
class SweptPath:
    """Tracks over the path's points; positions of shape (n, 2) [m], headings (n,) [rad].

    Attributes:
      steer, kingpin, trailer_axle: of the steer axle, the kingpin, the trailer's axle group.
      yaw, trailer_yaw: headings of the units.
      tractor_corners, trailer_corners: front left, front right, rear right, rear left of the
        bodies, shape (n, 4, 2).
    """

    steer: FloatArray
    kingpin: FloatArray
    trailer_axle: FloatArray
    yaw: FloatArray
    trailer_yaw: FloatArray
    tractor_corners: FloatArray
    trailer_corners: FloatArray


def swept_path(
    parameters: TruckParameters,
    path: FloatArray,
    yaw: float,
    trailer_yaw: float | None = None,
) -> SweptPath:
    """Sweeps the truck along a path of its steer axle.

    Args:
      parameters: of the truck.
      path: points, shape (n, 2), some decimetres apart [m].
      yaw: heading of the tractor at the first point [rad].
      trailer_yaw: of the semitrailer there [rad]; default: the tractor's.
    """
    tractor, trailer = parameters.tractor, parameters.semitrailer
    wheelbase = group_center(tractor.axles[1:]) - tractor.axles[0].position
    hitch = parameters.fifth_wheel.position - tractor.axles[0].position
    length = group_center(trailer.axles)
    headings = _towed(path, wheelbase, yaw)
    kingpin = path - hitch * _unit(headings)
    followed = _towed(kingpin, length, yaw if trailer_yaw is None else trailer_yaw)
    tail = wheelbase + 1.0
    return SweptPath(
        steer=path,
        kingpin=kingpin,
        trailer_axle=kingpin - length * _unit(followed),
        yaw=headings,
        trailer_yaw=followed,
        tractor_corners=_corners(path, headings, tractor.front_overhang, tail, tractor.width),
        trailer_corners=_corners(
            kingpin,
            followed,
            trailer.front_overhang,
            trailer.length - trailer.front_overhang,
            trailer.width,
        ),
    )


def _towed(lead: FloatArray, length: float, heading: float) -> FloatArray:
    """Headings of a bar whose front is at the points and whose rear rolls, shape (n,).

    Between two points the front goes straight, for which the tractrix is known: the angle to its
    course falls by `tan(theta / 2) exp(-way / length)`.
    """
    result = np.empty(len(lead))
    result[0] = heading
    steps = np.diff(lead, axis=0)
    ways, courses = np.hypot(*steps.T), np.arctan2(steps[:, 1], steps[:, 0])
    for i, (way, course) in enumerate(zip(ways.tolist(), courses.tolist(), strict=True)):
        if way > 0.0:
            angle = math.remainder(heading - course, 2.0 * math.pi)
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
