"""90 degree turns of 12.5 m radius at 5 km/h: the kinematic trailer, and the Australian PBS turn.

In the first turn the center of the steer axle runs near the arc; the trailer's track is compared
with the kinematic trailer.

In the PBS turn the outer wall of the outer steer tire follows a straight, an arc of 12.5 m and a
straight. The driver turns the outer wheel towards the direction of the path a little ahead, with a
correction for the distance to the path. The reference point lies on that wheel and moves in its
direction.

Limits: PBS Scheme, Standards and Vehicle Assessment Rules, level 1 (general access) for prime
movers with semitrailers: low-speed swept path 7.4 m; frontal swing 0.7 m, and of the semitrailer
against the tractor 0.2 m (difference of maxima) and 0.4 m (maximum of difference); tail swing
0.3 m; steer tire friction demand 80 %. The measures follow the regulator's summary (frontal swing
of both units; tail swing at the beginning of the turn; tail swing on exit is an addition). The
numbers are not checked against the text of the Rules: do this before use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import Kinematic
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.core.units import KMH
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import SteeringRecord, drive
from iits_mj.validation.pbs.limits import STANDARDS

RADIUS = 12.5
SPEED = 5.0 * KMH
# Straight before the first turn [m].
_STRAIGHT = 2.0
# Half the width of a steer tire (315/80 R 22.5) [m]: PBS measures at the outer wall of the tire.
HALF_TIRE = 0.157
# Available tire friction by PBS [1].
PEAK_FRICTION = 0.8
SWEPT_WIDTH, FRONTAL_SWING, TAIL_SWING, FRICTION_DEMAND = (
    STANDARDS[name].limits[0]
    for name in ("swept_path", "frontal_swing", "tail_swing", "friction_demand")
)
# Limits for the semitrailer's front corner against the tractor's: of the maxima, of the paths [m].
FRONT_MAXIMA, FRONT_PATHS = 0.2, 0.4
_ENTRY, _EXIT = 3.0, 30.0
# The driver: preview [m], and turn of the wheel per distance from the path [rad/m].
_PREVIEW, _GAIN = 0.15, 0.8


@dataclass(frozen=True)
class Turn:
    """A turn of the steer axle's center along the arc.

    Attributes:
      recording: of the truck.
      kinematic_front, kinematic_rear: tracks of steer axle and trailer group of the kinematic model
        with the yaw of the truck's tractor, (n, 2) [m].
    """

    recording: SteeringRecord
    kinematic_front: FloatArray
    kinematic_rear: FloatArray

    def path_error(self) -> float:
        """Greatest distance between the tracks of the trailer group, truck and kinematic [m]."""
        truck = np.column_stack([self.recording.rear_x, self.recording.rear_y])
        return max(_distance(point, self.kinematic_rear) for point in truck[::20])

    def off_tracking(self) -> float:
        """Greatest distance of the trailer group's track from the steer axle's track [m]."""
        record = self.recording
        front = np.column_stack([record.x, record.y])
        return _off_tracking(front, np.column_stack([record.rear_x, record.rear_y]))

    def kinematic_off_tracking(self) -> float:
        """Off-tracking of the kinematic model [m]."""
        return _off_tracking(self.kinematic_front, self.kinematic_rear)


def turn(payload: float, timestep: float) -> Turn:
    """Drives the turn of the kinematic trailer."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    kinematic = Kinematic.from_parameters(truck.parameters)
    angle = truck.parameters.steering.ratio * np.arcsin(kinematic.L / RADIUS)
    truck.reset(speed=SPEED)
    # The driver knows the corner and turns the wheels within 1.5 s.
    rate = angle / 1.5

    def steering(time: float, yaw: float) -> float:
        into = np.clip((time * SPEED - _STRAIGHT) / SPEED * rate, 0.0, angle)
        # Straighten so that the heading ends near 90 degrees.
        left = np.deg2rad(90.0) - yaw
        lead = 0.75 * SPEED / RADIUS
        return float(min(into, max(left / lead, 0.0) * angle if left < lead else angle))

    recording = drive(truck, steering, speed=SPEED, duration=30.0)
    front, rear = _kinematic_tracks(kinematic, recording)
    shift = np.array([recording.x[0], recording.y[0]]) - front[0]
    return Turn(recording, front + shift, rear + shift)


def compare_kinematic(payload: float, timestep: float) -> Findings:
    """The turn against the kinematic trailer."""
    done = turn(payload, timestep)
    found = Findings(f"90 deg turn of {RADIUS:g} m, {payload / 1e3:g} t")
    found.check("path of the trailer", done.path_error(), "m", "kinematic trailer", "<= 0.1")
    found.check("off-tracking", done.off_tracking(), "m", done.kinematic_off_tracking())
    record, (x, y) = done.recording, done.kinematic_rear.T
    axle = Line("steer axle", record.x, record.y)
    model = Line("trailer, kinematic", x, y, "reference")
    truck = Line("trailer, truck", record.rear_x, record.rear_y, "simulation")
    found.panel("", "x [m]", "y [m]", axle, model, truck)
    return found


def _kinematic_tracks(
    kinematic: Kinematic, recording: SteeringRecord
) -> tuple[FloatArray, FloatArray]:
    """Tracks of the kinematic model's steer axle and trailer axle, each (n, 2) [m].

    The truck's yaw rate per speed gives its steer angle.
    """
    turning = recording.yaw_rate / np.maximum(recording.speed, 0.1)
    states = kinematic.simulate(recording.time, recording.speed, np.arctan(kinematic.L * turning))
    return kinematic.steer_axle(states), kinematic.trailer_axle(states)


def _off_tracking(front: FloatArray, rear: FloatArray) -> float:
    inside = rear[(rear[:, 0] > front[0, 0]) & (rear[:, 0] < front[-1, 0])]
    return max(_distance(point, front) for point in inside[::20])


def _distance(point: FloatArray, track: FloatArray) -> float:
    """Distance [m] of a point (2,) from a polyline (n, 2)."""
    start, step = track[:-1], np.diff(track, axis=0)
    length = np.maximum((step**2).sum(1), 1e-18)
    share = np.clip(((point - start) * step).sum(1) / length, 0.0, 1.0)
    return float(np.min(np.linalg.norm(start + share[:, None] * step - point, axis=1)))


@dataclass(frozen=True)
class SweptTurn:
    """A PBS turn to the left; tracks have shape (n, 2) [m] and their origin where the arc begins.

    Attributes:
      recording: of the truck; wall: track of the reference point.
      inner: of the semitrailer's side over its axle group.
      corner: of the tractor's front outer corner; trailer_corner: of the semitrailer's.
      tail: of the semitrailer's rear outer corner.
      demand: steer tire friction demand, percent of `PEAK_FRICTION`, shape (n,).
      kinematic: inner side of the kinematic model with the yaw of the truck's tractor.
    """

    recording: SteeringRecord
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
        """Swept width with the trailer of the kinematic model [m]."""
        return self._width(self.kinematic)

    def _width(self, inner: FloatArray) -> float:
        along = np.arange(-_ENTRY, 0.5 * math.pi * RADIUS + 0.5 * _EXIT, 0.02)
        outside = [_across(track, along) for track in (self.wall, self.corner, self.trailer_corner)]
        return float(np.max(_across(inner, along) - np.min(outside, axis=0)))

    def frontal_swing(self) -> float:
        """Greatest distance of the tractor's front corner outside of the path [m]."""
        return float(np.max(-signed_distance(self.corner)))

    def front_corner_excess(self) -> tuple[float, float]:
        """Front corner of the semitrailer beyond that of the tractor [m]: maxima, and paths."""
        own, pulled = -signed_distance(self.corner), -signed_distance(self.trailer_corner)
        maxima = float(pulled.max() - own.max())
        # At each place along the exit, which both corners pass one after the other.
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
        """Greatest friction demand [%]."""
        return float(np.max(self.demand))


def signed_distance(track: FloatArray) -> FloatArray:
    """Distance of points (n, 2) from the path [m], (n,), positive towards the inside."""
    x, y = track.T
    radial = RADIUS - np.hypot(x, y - RADIUS)
    return np.where(x < 0.0, y, np.where(y > RADIUS, RADIUS - x, radial))


def pbs_turn(payload: float, timestep: float) -> SweptTurn:
    """Drives the PBS turn with this payload [kg]."""
    truck = Truck.load(payload, timestep=timestep, visuals=False)
    parameters = truck.parameters
    kinematic = Kinematic.from_parameters(parameters)
    half_track = 0.5 * parameters.lead.axles[0].track
    steer = parameters.lead.axles[0].name
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
    yaw, heading = record.yaw, record.yaw - record.articulation
    front = np.column_stack([record.x, record.y]) - origin
    rear = np.column_stack([record.rear_x, record.rear_y]) - origin
    tractor, trailer = parameters.lead, parameters.units[1]
    group = float(np.mean([axle.position for axle in trailer.axles]))
    half, tail = 0.5 * trailer.width, trailer.length - trailer.front_overhang - group
    steered, towed = _kinematic_tracks(kinematic, record)
    towed = towed + front[0] - steered[0]
    # The axle of the kinematic trailer moves along its heading.
    step = np.gradient(towed, axis=0)
    return SweptTurn(
        record,
        np.array(walls),
        _point(rear, heading, 0.0, half),
        _point(front, yaw, tractor.front_overhang, -0.5 * tractor.width),
        _point(rear, heading, group + trailer.front_overhang, -half),
        _point(rear, heading, -tail, -half),
        np.array(demand),
        _point(towed, np.arctan2(step[:, 1], step[:, 0]), 0.0, half),
    )


def compare_pbs(payload: float, timestep: float) -> Findings:
    """The PBS turn against its limits."""
    done = pbs_turn(payload, timestep)
    found = Findings(f"PBS 90 deg turn of {RADIUS:g} m, {payload / 1e3:g} t")
    entry, leaving = done.tail_swing()
    maxima, paths = done.front_corner_excess()
    model_width = done.kinematic_swept_width()
    for name, value, unit, most, model in (
        ("path error of the outer steer tire", done.path_error(), "m", 0.05, None),
        ("low-speed swept path (level 1)", done.swept_width(), "m", SWEPT_WIDTH, model_width),
        ("frontal swing", done.frontal_swing(), "m", FRONTAL_SWING, None),
        ("front corners, difference of maxima", maxima, "m", FRONT_MAXIMA, None),
        ("front corners, maximum of difference", paths, "m", FRONT_PATHS, None),
        ("tail swing on entry (level 1)", entry, "m", TAIL_SWING, None),
        ("tail swing on exit (level 1)", leaving, "m", TAIL_SWING, None),
        ("steer tire friction demand", done.friction_demand(), "%", FRICTION_DEMAND, None),
    ):
        found.check(name, value, unit, model, f"<= {most:g}")
    angle = np.linspace(0.0, 0.5 * math.pi, 60)
    arc = RADIUS * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    path = np.vstack([[-10.0, 0.0], arc, [RADIUS, RADIUS + 15.0]])
    found.panel(
        "",
        "x [m]",
        "y [m]",
        Line("path", path[:, 0], path[:, 1], "reference"),
        Line("outer steer tire", *done.wall.T),
        Line("front corner", *done.corner.T),
        Line("trailer's inner side", done.inner[:, 0], done.inner[:, 1], "simulation"),
        Line("the same, kinematic", *done.kinematic.T),
        Line("rear outer corner", *done.tail.T),
    )
    time = done.recording.time
    allowed = Line("allowed", time[[0, -1]], np.full(2, FRICTION_DEMAND), "reference")
    tires = Line("steer tires", time, done.demand, "simulation")
    found.panel("friction demand", "time [s]", "share of 0.8 [%]", allowed, tires)
    return found


def _across(track: FloatArray, along: FloatArray) -> FloatArray:
    """Distance of a track from the path at stations of the path [m], positive inside, (k,)."""
    x, y = track.T
    turned = RADIUS * np.arctan2(x, RADIUS - y)
    station = np.where(
        x < 0.0, x, np.where(y > RADIUS, 0.5 * math.pi * RADIUS + y - RADIUS, turned)
    )
    return np.interp(along, station, signed_distance(track))


def _along_exit(track: FloatArray, along: FloatArray) -> FloatArray:
    """Distance of a track outside the path at distances along the exit [m]."""
    after = track[:, 1] >= RADIUS
    return np.interp(along, track[after, 1] - RADIUS, track[after, 0] - RADIUS)


def _direction(point: FloatArray) -> float:
    """Direction of the path beside a point (2,) [rad]."""
    if point[0] < 0.0:
        return 0.0
    return 0.5 * math.pi if point[1] > RADIUS else math.atan2(point[0], RADIUS - point[1])


def _wall(yaw: float, wheel: float, half_track: float) -> FloatArray:
    """Outer wall of the right steer tire from the center of the axle (2,) [m]."""
    across = np.array([math.sin(yaw), -math.cos(yaw)])
    own = np.array([math.sin(yaw + wheel), -math.cos(yaw + wheel)])
    return half_track * across + HALF_TIRE * own


def _demand(truck: Truck, axle: str) -> float:
    """Friction used by the steer tires, percent of `PEAK_FRICTION`."""
    forces = [truck.data.sensor(f"{axle}_{side}_tire_force").data for side in ("left", "right")]
    used = sum(math.hypot(force[0], force[1]) for force in forces)
    return float(100.0 * used / sum(force[2] for force in forces) / PEAK_FRICTION)


def _point(origin: FloatArray, heading: FloatArray, ahead: float, left: float) -> FloatArray:
    """Track of a point ahead and to the left [m] of a moving origin (n, 2)."""
    cosine, sine = np.cos(heading), np.sin(heading)
    return origin + np.column_stack([ahead * cosine - left * sine, ahead * sine + left * cosine])
