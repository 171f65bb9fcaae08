"""Swept path of any combination at low speed: the tractrix chain behind a guided point.

A guide point of the motor vehicle, at the first axle and `b` to the left of its middle, follows a
path. Per meter of the path, with the angle `e = path's heading - theta`, the center of the fixed
axles (L behind) moves and the motor vehicle turns by

    theta' = sin(e) / L,    v = cos(e) + b theta',

and the towed units follow as in `kinematic`. The guide point of a Performance-Based Standards turn
is the outer wall of the outer steer tire, whose arc has a radius of 12.5 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.kinematic import Kinematic
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import positive
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters

# Straight path before a turn and after it [m], and the step along the path [m].
ENTRY, EXIT, STEP = 5.0, 40.0, 0.02
# Stretch of the path whose width is one value [m].
_BIN = 0.1
# Half the width of a steer tire [m].
HALF_TIRE = 0.15


@dataclass(frozen=True)
class Outline:
    """A combination in plan view.

    Attributes:
      kinematic: lengths of the chain.
      front, rear: of each unit's body, ahead of the center of its axles [m], shape (n,).
      width: of each body [m], shape (n,).
      tire: outer wall of the steer tires, from the middle [m].
    """

    kinematic: Kinematic
    front: FloatArray
    rear: FloatArray
    width: FloatArray
    tire: float

    @classmethod
    def from_parameters(cls, parameters: TruckParameters, payload: float | None = None) -> Outline:
        """Plan view of a truck; axle groups as with a payload [kg], default: laden."""
        kinematic = Kinematic.from_parameters(parameters, payload)
        origins = np.array([kinematic.L + parameters.lead.axles[0].position, *kinematic.lengths])
        front = origins + [unit.front_overhang for unit in parameters.units]
        return cls(
            kinematic=kinematic,
            front=front,
            rear=front - [unit.length for unit in parameters.units],
            width=np.array([unit.width for unit in parameters.units]),
            tire=0.5 * parameters.lead.axles[0].track + HALF_TIRE,
        )

    def corners(self, poses: FloatArray) -> FloatArray:
        """Corners of the bodies [m], (m, n, 4, 2), from poses of the axles' centers, (m, n, 3).

        Front left, front right, rear right, rear left.
        """
        along = np.column_stack([self.front, self.front, self.rear, self.rear])
        across = 0.5 * self.width[:, None] * np.array([1.0, -1.0, -1.0, 1.0])
        cosine, sine = np.cos(poses[..., 2:]), np.sin(poses[..., 2:])
        x = poses[..., :1] + along * cosine - across * sine
        y = poses[..., 1:2] + along * sine + across * cosine
        return np.stack([x, y], axis=-1)


@dataclass(frozen=True)
class Turn:
    """A low-speed turn to the left whose guided point follows straight, arc, straight.

    The arc begins at x = 0 and has its center at (0, radius).

    Attributes:
      outline: of the combination.
      radius: of the path of the guided point [m]; angle: of the arc [rad].
      path: of the guided point [m], shape (m, 2).
      poses: x, y, heading of the center of each unit's axles, shape (m, n, 3).
    """

    outline: Outline
    radius: float
    angle: float
    path: FloatArray
    poses: FloatArray

    def tracks(self) -> FloatArray:
        """Paths of the bodies' corners [m], shape (m, n, 4, 2), as `Outline.corners`."""
        return self.outline.corners(self.poses)

    def sides(self) -> FloatArray:
        """Paths of points along both sides of every body [m], shape (m, n, 60, 2)."""
        corners, shares = self.tracks(), np.linspace(0.0, 1.0, 30)[:, None]
        left = corners[:, :, :1] * (1.0 - shares) + corners[:, :, 3:] * shares
        right = corners[:, :, 1:2] * (1.0 - shares) + corners[:, :, 2:3] * shares
        return np.concatenate([left, right], axis=2)


def turn(
    outline: Outline,
    radius: float = 12.5,
    angle: float = 0.5 * math.pi,
    *,
    guide: float | None = None,
    exit_length: float = EXIT,
) -> Turn:
    """Drives a turn to the left at walking pace, without slip (Runge-Kutta 4 along the path).

    Args:
      outline: of the combination.
      radius: of the path of the guided point [m].
      angle: of the arc [rad].
      guide: place of the guided point to the left of the first axle's middle [m]; default: the
        outer wall of the outer, right, steer tire.
      exit_length: of the straight path after the arc [m].

    Raises:
      InputError: a value is not positive, or the radius is too small for the wheelbase.
    """
    radius = positive("radius", radius, "m")
    angle, exit_length = positive("angle", angle, "rad"), positive("exit_length", exit_length, "m")
    kinematic = outline.kinematic
    if radius <= kinematic.L:
        raise InputError(
            f"radius {radius!r} m must be greater than the wheelbase {kinematic.L:g} m"
        )
    offset, arc = -outline.tire if guide is None else guide, radius * angle
    # Whole steps on each of the three parts, so that no step crosses a jump of the curvature.
    parts = [
        np.linspace(0.0, length, max(2, round(length / STEP)) + 1)
        for length in (ENTRY, arc, exit_length)
    ]
    stations = np.concatenate([parts[0] - ENTRY, parts[1][1:], arc + parts[2][1:]])

    def heading(station: float) -> float:
        return min(max(station / radius, 0.0), angle)

    def derivative(station: float, state: FloatArray) -> FloatArray:
        theta = float(state[0])
        bend = heading(station) - theta
        rate = math.sin(bend) / kinematic.L
        speed = math.cos(bend) + offset * rate
        return np.concatenate([[rate], kinematic.swing(state[1:], speed, rate)])

    states = np.zeros((len(stations), kinematic.units))
    for i, h in enumerate(np.diff(stations)):
        s, x = float(stations[i]), states[i]
        k1 = derivative(s, x)
        k2 = derivative(s + 0.5 * h, x + 0.5 * h * k1)
        k3 = derivative(s + 0.5 * h, x + 0.5 * h * k2)
        k4 = derivative(s + h, x + h * k3)
        states[i + 1] = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    turned = np.clip(stations / radius, 0.0, angle)
    beyond = np.minimum(stations, 0.0) + np.maximum(stations - arc, 0.0)
    path = np.column_stack(
        [
            radius * np.sin(turned) + beyond * np.cos(turned),
            radius * (1.0 - np.cos(turned)) + beyond * np.sin(turned),
        ]
    )
    return Turn(outline, radius, angle, path, _poses(kinematic, path, states, offset))


def _poses(kinematic: Kinematic, path: FloatArray, states: FloatArray, offset: float) -> FloatArray:
    theta = states[:, 0]
    guide = np.array([kinematic.L, offset])
    x = path[:, 0] - guide[0] * np.cos(theta) + guide[1] * np.sin(theta)
    y = path[:, 1] - guide[0] * np.sin(theta) - guide[1] * np.cos(theta)
    still = np.zeros_like(theta)
    full = np.column_stack([x, y, theta, still, states[:, 1:]])
    poses = []
    for unit in range(kinematic.units):
        heading = theta if unit == 0 else theta + states[:, unit]
        poses.append(np.column_stack([kinematic.trailer_axle(full, unit), heading]))
    return np.stack(poses, axis=1)


def swept_width(points: FloatArray, radius: float = 12.5, angle: float = 0.5 * math.pi) -> float:
    """Returns the greatest width of the swept path [m], across the path of the guided point.

    At each station of the path, the outermost minus the innermost place that a point passes; the
    guided point, an outer edge, is always among them.

    Args:
      points: tracks of points of the combination (`Turn.sides`) [m], shape (..., 2).
      radius: of the path [m].
      angle: of its arc [rad].

    Raises:
      InputError: no point passes the arc.
    """
    points = points.reshape(-1, 2)
    station, offset = _on_path(points, radius, angle)
    # From the beginning of the arc to the last place that every unit has passed.
    passed = (station >= 0.0) & (station <= radius * angle + EXIT - 2.0 * ENTRY)
    if not np.any(passed):
        raise InputError(f"no point passes the arc of {radius:g} m")
    bins = np.floor(station[passed] / _BIN).astype(int)
    outer, inner = np.zeros(bins.max() + 1), np.zeros(bins.max() + 1)
    np.maximum.at(outer, bins, offset[passed])
    np.minimum.at(inner, bins, offset[passed])
    return float(np.max(outer - inner))


def outward(points: FloatArray, radius: float = 12.5, angle: float = 0.5 * math.pi) -> FloatArray:
    """Returns distances of points to the outside of the path of a turn to the left [m].

    Args:
      points: [m], shape (..., 2).
      radius: of the path [m]; its arc begins at x = 0.
      angle: of the arc [rad].
    """
    return _on_path(points, radius, angle)[1]


def _on_path(points: FloatArray, radius: float, angle: float) -> tuple[FloatArray, FloatArray]:
    """Station along the path and distance to its outside of points [m], shape (...) each."""
    x, y = points[..., 0], points[..., 1]
    beside = np.arctan2(x, radius - y)
    along, across = (
        np.array([math.cos(angle), math.sin(angle)]),
        [math.sin(angle), -math.cos(angle)],
    )
    end = radius * np.array([math.sin(angle), 1.0 - math.cos(angle)])
    after = (points - end) @ along
    places = [x < 0.0, (after > 0.0) & (beside > 0.5 * angle)]
    station = np.select(places, [x, radius * angle + after], radius * beside)
    offset = np.select(places, [-y, (points - end) @ across], np.hypot(x, y - radius) - radius)
    return station, offset


def frontal_swing(
    corners: FloatArray, radius: float = 12.5, angle: float = 0.5 * math.pi
) -> FloatArray:
    """Returns how far outer front corners swing beyond the path of the guided point [m], (n,).

    Args:
      corners: tracks of each unit's outer front corner [m], shape (m, n, 2).
      radius: of the path [m].
      angle: of its arc [rad].
    """
    return np.asarray(np.max(outward(corners, radius, angle), axis=0))


def tail_swing(corners: FloatArray) -> FloatArray:
    """Returns how far outer rear corners swing out as the turn begins [m], shape (n,).

    Beyond the line, along x, on which each corner drives before the turn.

    Args:
      corners: tracks of each unit's outer rear corner in a turn to the left [m], shape (m, n, 2).
    """
    return np.asarray(np.max(corners[0, :, 1] - corners[..., 1], axis=0))


@dataclass(frozen=True)
class TurningCircle:
    """Turning circle of a steady turn at the greatest steer angle.

    Attributes:
      curb: diameter between curbs, over the outer steer tire [m].
      wall: diameter between walls, over the outermost corner [m].
      inner: radius of the innermost point of the combination [m]; NaN if a towed unit cannot turn
        steadily.
    """

    curb: float
    wall: float
    inner: float


def turning_circle(outline: Outline, steer: float) -> TurningCircle:
    """Returns the turning circle at a road-wheel angle of the bicycle model [rad].

    Args:
      outline: of the combination.
      steer: greatest road-wheel angle [rad], below a right angle.

    Raises:
      InputError: the angle is not allowed.
    """
    if not 0.0 < steer < 0.5 * math.pi:
        raise InputError(f"steer {steer!r} rad must be positive and below a right angle")
    kinematic = outline.kinematic
    center = kinematic.L / math.tan(steer)
    curb = math.hypot(center + outline.tire, kinematic.L)
    radii, squared = [center], center**2
    for hitch, length in zip(kinematic.hitches, kinematic.lengths, strict=True):
        squared += hitch**2 - length**2
        radii.append(math.sqrt(squared) if squared > 0.0 else math.nan)
    radius, half = np.array(radii), 0.5 * outline.width
    ends = np.maximum(np.abs(outline.front), np.abs(outline.rear))
    wall = np.nanmax(np.hypot(radius + half, ends))
    return TurningCircle(2.0 * curb, 2.0 * max(float(wall), curb), float(np.min(radius - half)))
