"""90 degree turns of 12.5 m radius at 5 km/h: the kinematic trailer, and the Australian PBS turn.

In the first turn the center of the steer axle runs near the arc; the last unit's track is compared
with the kinematic model.

In the PBS turn the outer wall of the outer steer tire follows a straight, an arc of 12.5 m and a
straight. The driver turns the outer wheel towards the direction of the path a little ahead, with a
correction for the distance to the path. The reference point lies on that wheel and moves in its
direction. The reference is the tractrix chain of `analytic.swept_path`, whose guide point follows
the path without error.

Limits: `pbs.limits`, of the level that the combination's length allows; of a towed unit's front
corner against that of the unit ahead 0.2 m (difference of maxima) and 0.4 m (maximum of
difference). Tail swing is that at the beginning of the turn; tail swing on exit is an addition.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic import Kinematic, swept_path
from iits_mj.analytic.swept_path import (
    EXIT,
    HALF_TIRE,
    Outline,
    outward,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import SteeringRecord, drive, placed_truck
from iits_mj.validation.pbs.limits import STANDARDS, level_of_length
from iits_mj.validation.pbs.maneuvers import LowSpeedTurn
from iits_mj.validation.pbs.measures import PEAK_FRICTION, turn_measures

RADIUS, SPEED = LowSpeedTurn.radius, LowSpeedTurn.speed
# Straight before the first turn [m].
_STRAIGHT = 2.0
_ENTRY = 3.0
# The driver: preview [m], and turn of the wheel per distance from the path [rad/m].
_PREVIEW, _GAIN = 0.15, 0.8


@dataclass(frozen=True)
class Turn:
    """A turn of the steer axle's center along the arc.

    Attributes:
      recording: of the truck.
      kinematic_front, kinematic_rear: tracks of steer axle and last unit's axles of the kinematic
        model with the yaw of the truck's lead unit, (n, 2) [m].
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


def turn(parameters: TruckParameters, payload: float, timestep: float) -> Turn:
    """Drives the turn of the kinematic model."""
    truck = placed_truck(parameters, payload, timestep, speed=SPEED)
    kinematic = Kinematic.from_parameters(parameters, payload)
    angle = parameters.steering.ratio * np.arcsin(kinematic.L / RADIUS)
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


def compare_kinematic(parameters: TruckParameters, payload: float, timestep: float) -> Findings:
    """The turn against the kinematic model."""
    done = turn(parameters, payload, timestep)
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
    """Tracks of the kinematic model's steer axle and last unit's axles, each (n, 2) [m].

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
    """A PBS turn to the left; the origin of tracks is where the arc begins.

    Attributes:
      recording: of the truck.
      driven: its tracks; the path is that of the reference point.
      model: tracks of the tractrix chain.
      demand: steer tire friction demand, percent of `PEAK_FRICTION`, shape (n,).
    """

    recording: SteeringRecord
    driven: swept_path.Turn
    model: swept_path.Turn
    demand: FloatArray

    def path_error(self) -> float:
        """Greatest distance of the reference point from its path [m]."""
        return float(np.max(np.abs(outward(self.driven.path))))

    def tail_swing_on_exit(self) -> float:
        """Swing of the last unit's outer rear corner beyond its last straight line [m]."""
        x, y = self.driven.tracks()[:, -1, 2].T
        return float(max(x[y > RADIUS].max() - x[-1], 0.0)) if (y > RADIUS).any() else 0.0


def pbs_turn(parameters: TruckParameters, payload: float, timestep: float) -> SweptTurn:
    """Drives the PBS turn with this payload [kg]."""
    truck = placed_truck(parameters, payload, timestep, station=20.0, speed=SPEED)
    outline = Outline.from_parameters(parameters, payload)
    half_track = 0.5 * parameters.lead.axles[0].track
    steer = parameters.lead.axles[0].name
    origin = np.array([20.0 + _ENTRY, -outline.tire])
    share = half_track / outline.kinematic.L
    walls, demand = [], []

    def steering(_: float, yaw: float) -> float:
        outer = float(truck.data.joint(f"{steer}_right_knuckle").qpos[0])
        axle = truck.data.body("tractor").xpos[:2] - origin
        wall = axle + _wall(yaw, outer, half_track)
        walls.append(wall)
        demand.append(_demand(truck, steer))
        ahead = wall + _PREVIEW * np.array([math.cos(yaw + outer), math.sin(yaw + outer)])
        error = -float(outward(ahead))
        wanted = _direction(ahead) - math.atan(_GAIN * error) - yaw
        tangent = math.tan(float(np.clip(wanted, -0.6, 0.6)))
        return parameters.steering.ratio * math.atan(tangent / (1.0 - share * tangent))

    length = _ENTRY + 0.5 * math.pi * RADIUS + EXIT
    record = drive(truck, steering, speed=SPEED, duration=length / SPEED)
    poses = record.poses(parameters, payload) - [*origin, 0.0]
    driven = swept_path.Turn(outline, RADIUS, 0.5 * math.pi, np.array(walls), poses)
    return SweptTurn(record, driven, swept_path.turn(outline), np.array(demand))


def compare_swept_path(
    parameters: TruckParameters, payload: float, timestep: float, *, limits: bool = True
) -> Findings:
    """The PBS turn against the tractrix chain and, with `limits`, against those of PBS."""
    done = pbs_turn(parameters, payload, timestep)
    level = level_of_length(parameters.length)
    found = Findings(f"PBS 90 deg turn of {RADIUS:g} m, {payload / 1e3:g} t")
    found.check("path error of the outer steer tire", done.path_error(), "m", must="<= 0.05")
    modeled = turn_measures(done.model)
    for name, value in turn_measures(done.driven).items():
        standard = STANDARDS[name]
        title, must = f"{standard.name} (level {level})", standard.must(level)
        found.check(title, value, "m", modeled[name], must if limits else "")
        if name == "swept_path":
            error = 100.0 * abs(value / modeled[name] - 1.0)
            found.check(f"{standard.name}, error", error, "%", "tractrix chain", "<= 3")
    tail, demand = STANDARDS["tail_swing"].must(level), STANDARDS["friction_demand"]
    found.check(
        f"tail swing on exit (level {level})",
        done.tail_swing_on_exit(),
        "m",
        must=tail if limits else "",
    )
    used, must = float(np.max(done.demand)), demand.must(level)
    found.check(demand.name, used, "%", must=must if limits else "")
    angle = np.linspace(0.0, 0.5 * math.pi, 60)
    arc = RADIUS * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    path = np.vstack([[-10.0, 0.0], arc, [RADIUS, RADIUS + 15.0]])
    driven, model = done.driven.tracks(), done.model.tracks()
    x, y = driven[:, -1, 3].T
    found.panel(
        "",
        "x [m]",
        "y [m]",
        Line("path", path[:, 0], path[:, 1], "reference"),
        Line("outer steer tire", *done.driven.path.T),
        Line("front corner", *driven[:, 0, 1].T),
        Line("last unit's inner rear corner", x, y, "simulation"),
        Line("the same, tractrix chain", *model[:, -1, 3].T),
        Line("last unit's outer rear corner", *driven[:, -1, 2].T),
    )
    time = done.recording.time
    most = demand.limits[level - 1]
    allowed = Line("allowed", time[[0, -1]], np.full(2, most), "reference")
    tires = Line("steer tires", time, done.demand, "simulation")
    found.panel("friction demand", "time [s]", "share of 0.8 [%]", allowed, tires)
    return found


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
