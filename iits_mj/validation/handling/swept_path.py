"""Low-speed 90 degree turn of 12.5 m by the Australian PBS: swept path, swings, friction demand.

The outer wall of the outer steer tire follows a straight, an arc of 12.5 m, a straight, at 5 km/h.
The driver turns the outer wheel towards the path's direction a little ahead, with a correction for
the distance to the path; the reference point rides on that wheel, so that it goes where it points.

Limits: PBS Scheme, Standards and Vehicle Assessment Rules, level 1 (general access) for prime
movers with semitrailers: low-speed swept path 7.4 m; frontal swing 0.7 m, and of the semitrailer
against the tractor 0.2 m (difference of maxima) and 0.4 m (maximum of difference); tail swing
0.3 m; steer tire friction demand 80 %. What is measured is as the regulator's summary describes it
(frontal swing of both units; tail swing as the turn begins: on exit it is our addition). The
numbers are known to us without the text of the Rules at hand: check them against it before use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import Kinematic
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel
from iits_mj.core.units import KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import Recording, drive

RADIUS = 12.5
SPEED = 5.0 * KMH
# Half the width of a steer tire (315/80 R 22.5) [m]: PBS measures at the tire's outer wall.
HALF_TIRE = 0.157
# Tire friction that PBS takes as available [1].
PEAK_FRICTION = 0.8
SWEPT_WIDTH, FRONTAL_SWING, TAIL_SWING, FRICTION_DEMAND = 7.4, 0.7, 0.3, 80.0
# Limits for the semitrailer's front corners against the tractor's: of the maxima, of paths [m].
FRONT_MAXIMA, FRONT_PATHS = 0.2, 0.4
_ENTRY, _EXIT = 3.0, 30.0
# The driver: preview [m], and turn of the wheel per distance from the path [rad/m].
_PREVIEW, _GAIN = 0.15, 0.8


@dataclass(frozen=True)
class SweptTurn:
    """One turn to the left; tracks have shape (n, 2) [m], their origin where the arc begins.

    Attributes:
      recording: of the truck; wall: track of the reference point.
      inner: of the semitrailer's side over its axle group.
      corner: of the tractor's front outer corner; trailer_corner: of the semitrailer's.
      tail: of the semitrailer's rear outer corner.
      demand: steer tire friction demand, percent of `PEAK_FRICTION`, shape (n,).
      kinematic: track of the kinematic model's inner side, whose tractor turns as the truck's does.
    """

    recording: Recording
    wall: FloatArray
    inner: FloatArray
    corner: FloatArray
    trailer_corner: FloatArray
    tail: FloatArray
    demand: FloatArray
    kinematic: FloatArray

    def path_error(self) -> float:
        """Greatest distance of the reference point from its path [m]."""
        return float(np.max(np.abs(signed_distance(self.wall))))

    def swept_width(self) -> float:
        """Greatest width across the path between the outermost and the innermost point [m]."""
        return self._width(self.inner)

    def kinematic_swept_width(self) -> float:
        """The same with the kinematic model's trailer [m]."""
        return self._width(self.kinematic)

    def _width(self, inner: FloatArray) -> float:
        along = np.arange(-_ENTRY, 0.5 * math.pi * RADIUS + 0.5 * _EXIT, 0.02)
        outside = [_across(track, along) for track in (self.wall, self.corner, self.trailer_corner)]
        return float(np.max(_across(inner, along) - np.min(outside, axis=0)))

    def frontal_swing(self) -> float:
        """How far the tractor's front corner swings beyond the path on exit [m]."""
        return _outside(self.corner)

    def front_corner_excess(self) -> tuple[float, float]:
        """Semitrailer's front corner against the tractor's [m]: of maxima, and place by place."""
        own, pulled = -signed_distance(self.corner), -signed_distance(self.trailer_corner)
        maxima = float(pulled.max() - own.max())
        # Place by place along the exit, where both corners pass in turn.
        along = np.arange(0.0, 0.5 * _EXIT, 0.05)
        gap = _along_exit(self.trailer_corner, along) - _along_exit(self.corner, along)
        return maxima, float(gap.max())

    def tail_swing(self) -> tuple[float, float]:
        """Swing of the rear outer corner beyond its own first and last straight line [m]."""
        x, y = self.tail.T
        entry = float(y[0] - y[x < 0.0].min())
        leaving = float(x[y > RADIUS].max() - x[-1]) if (y > RADIUS).any() else 0.0
        return max(entry, 0.0), max(leaving, 0.0)

    def friction_demand(self) -> float:
        """Greatest demand [%]."""
        return float(np.max(self.demand))


def signed_distance(track: FloatArray) -> FloatArray:
    """Distance of points (n, 2) from the path [m], (n,), positive towards the turn's inside."""
    x, y = track.T
    radial = RADIUS - np.hypot(x, y - RADIUS)
    return np.where(x < 0.0, y, np.where(y > RADIUS, RADIUS - x, radial))


def _across(track: FloatArray, along: FloatArray) -> FloatArray:
    """Distance of a track from the path at stations of the path [m], positive inside, (k,)."""
    x, y = track.T
    turned = RADIUS * np.arctan2(x, RADIUS - y)
    station = np.where(
        x < 0.0, x, np.where(y > RADIUS, 0.5 * math.pi * RADIUS + y - RADIUS, turned)
    )
    return np.interp(along, station, signed_distance(track))


def _outside(track: FloatArray) -> float:
    return float(np.max(-signed_distance(track)))


def _along_exit(track: FloatArray, along: FloatArray) -> FloatArray:
    """How far a track lies outside of the path at distances along the exit [m]."""
    after = track[:, 1] >= RADIUS
    return np.interp(along, track[after, 1] - RADIUS, track[after, 0] - RADIUS)


def turn(payload: float, timestep: float) -> SweptTurn:
    """Drives the turn with this payload [kg]."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    parameters = truck.parameters
    kinematic = Kinematic.from_parameters(parameters)
    half_track = 0.5 * parameters.tractor.axles[0].track
    steer = parameters.tractor.axles[0].name
    origin = np.array([20.0 + _ENTRY, -half_track - HALF_TIRE])
    truck.reset(station=20.0, speed=SPEED)
    share = half_track / kinematic.L
    walls, demand = [], []

    def steering(_: float, yaw: float) -> float:
        outer = float(truck.data.joint(f"{steer}_right_knuckle").qpos[0])
        axle = truck.data.body("tractor").xpos[:2] - origin
        wall = axle + _wall(yaw, outer, half_track)
        walls.append(wall)
        demand.append(_demand(truck, steer))
        ahead = wall + _PREVIEW * np.array([math.cos(yaw + outer), math.sin(yaw + outer)])
        error = float(signed_distance(ahead[None])[0])
        wanted = _direction(ahead) - math.atan(_GAIN * error) - yaw
        tangent = math.tan(float(np.clip(wanted, -0.6, 0.6)))
        return parameters.steering.ratio * math.atan(tangent / (1.0 - share * tangent))

    length = _ENTRY + 0.5 * math.pi * RADIUS + _EXIT
    record = drive(truck, steering, speed=SPEED, duration=length / SPEED)
    n = len(walls)
    yaw, heading = record.yaw, record.yaw - record.articulation
    front = np.column_stack([record.x, record.y]) - origin
    rear = np.column_stack([record.rear_x, record.rear_y]) - origin
    tractor, trailer = parameters.tractor, parameters.semitrailer
    group = float(np.mean([axle.position for axle in trailer.axles]))
    half, tail = 0.5 * trailer.width, trailer.length - trailer.front_overhang - group
    turning = record.yaw_rate / np.maximum(record.speed, 0.1)
    states = kinematic.simulate(record.time, record.speed, np.arctan(kinematic.L * turning))
    pulled = kinematic.trailer_axle(states) + front[0] - kinematic.steer_axle(states)[0]
    # Heading of the kinematic trailer: its axle moves along it.
    step = np.gradient(pulled, axis=0)
    return SweptTurn(
        record,
        np.array(walls)[:n],
        _point(rear, heading, 0.0, half),
        _point(front, yaw, tractor.front_overhang, -0.5 * tractor.width),
        _point(rear, heading, group + trailer.front_overhang, -half),
        _point(rear, heading, -tail, -half),
        np.array(demand)[:n],
        _point(pulled, np.arctan2(step[:, 1], step[:, 0]), 0.0, half),
    )


def _direction(point: FloatArray) -> float:
    """Direction of the path beside a point (2,) [rad]."""
    if point[0] < 0.0:
        return 0.0
    return 0.5 * math.pi if point[1] > RADIUS else math.atan2(point[0], RADIUS - point[1])


def _wall(yaw: float, wheel: float, half_track: float) -> FloatArray:
    """Outer wall of the right steer tire from the axle's centre (2,) [m]."""
    across = np.array([math.sin(yaw), -math.cos(yaw)])
    own = np.array([math.sin(yaw + wheel), -math.cos(yaw + wheel)])
    return half_track * across + HALF_TIRE * own


def _demand(truck: Truck, axle: str) -> float:
    """Friction that the steer tires use, percent of what PBS takes as available."""
    forces = [truck.data.sensor(f"{axle}_{side}_tire_force").data for side in ("left", "right")]
    used = sum(math.hypot(force[0], force[1]) for force in forces)
    return float(100.0 * used / sum(force[2] for force in forces) / PEAK_FRICTION)


def _point(origin: FloatArray, heading: FloatArray, ahead: float, left: float) -> FloatArray:
    cosine, sine = np.cos(heading), np.sin(heading)
    return origin + np.column_stack([ahead * cosine - left * sine, ahead * sine + left * cosine])


def compare(payload: float, timestep: float) -> tuple[list[Check], list[Panel]]:
    """Checks and panels of the turn."""
    done = turn(payload, timestep)
    label = f"PBS 90 deg turn of {RADIUS:g} m, {payload / 1e3:g} t"
    entry, leaving = done.tail_swing()
    maxima, paths = done.front_corner_excess()

    def check(name: str, value: float, unit: str, most: float, model: float | None = None) -> Check:
        return Check(f"{label}: {name}", value, unit, model, f"<= {most:g}")

    checks = [
        check("path error of the outer steer tire", done.path_error(), "m", 0.05),
        check(
            "low-speed swept path (level 1)",
            done.swept_width(),
            "m",
            SWEPT_WIDTH,
            done.kinematic_swept_width(),
        ),
        check("frontal swing", done.frontal_swing(), "m", FRONTAL_SWING),
        check("front corners, difference of maxima", maxima, "m", FRONT_MAXIMA),
        check("front corners, maximum of difference", paths, "m", FRONT_PATHS),
        check("tail swing on entry (level 1)", entry, "m", TAIL_SWING),
        check("tail swing on exit (level 1)", leaving, "m", TAIL_SWING),
        check("steer tire friction demand", done.friction_demand(), "%", FRICTION_DEMAND),
    ]
    angle = np.linspace(0.0, 0.5 * math.pi, 60)
    arc = RADIUS * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    path = np.vstack([[-10.0, 0.0], arc, [RADIUS, RADIUS + 15.0]])
    lines = (
        Line("path", path[:, 0], path[:, 1], "reference"),
        Line("outer steer tire", done.wall[:, 0], done.wall[:, 1]),
        Line("front corner", done.corner[:, 0], done.corner[:, 1]),
        Line("trailer's inner side", done.inner[:, 0], done.inner[:, 1], "simulation"),
        Line("the same, kinematic", done.kinematic[:, 0], done.kinematic[:, 1]),
        Line("rear outer corner", done.tail[:, 0], done.tail[:, 1]),
    )
    time = done.recording.time
    friction = (
        Line("allowed", time[[0, -1]], np.full(2, FRICTION_DEMAND), "reference"),
        Line("steer tires", time, done.demand, "simulation"),
    )
    return checks, [
        Panel(label, "x [m]", "y [m]", lines),
        Panel(f"{label}: friction demand", "time [s]", "share of 0.8 [%]", friction),
    ]
