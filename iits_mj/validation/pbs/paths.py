"""The simulated truck on the paths of the Performance-Based Standards: turn and straight road.

In the low-speed turn the outer wall of the outer steer tire follows a straight, an arc of 12.5 m
and a straight. The driver turns the outer wheel towards the direction of the path a little ahead,
with a correction for the distance to the path.

On the straight road of `rough_road` the driver holds the steer axle on the middle by its distance a
little ahead and the integral of it, which balances the cross slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from iits_mj.analytic.swept_path import ENTRY, EXIT, Outline, Turn, outward
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.harness.recorder import PERIOD, SpeedHold, sampled
from iits_mj.validation.pbs.maneuvers import LowSpeedTurn, StraightPath
from iits_mj.validation.pbs.rough_road import FLAT, START, RoughRoad

# The driver of the turn: preview [m], and turn of the wheel per distance from the path [rad/m].
_AHEAD, _GAIN = 0.15, 1.5
# The driver of the straight: preview [s], road-wheel angle per distance [rad/m] and per its
# integral [rad/(m s)].
_PREVIEW, _HOLD, _INTEGRAL = 2.0, 0.03, 0.003


@dataclass(frozen=True)
class SimulatedTurn:
    """The low-speed turn of the truck.

    Attributes:
      turn: paths of the units, as the kinematic model gives them.
      time: of the forces [s], shape (m,).
      forces: on the steer tires along, to the left and upward [N], shape (m, tires, 3).
    """

    turn: Turn
    time: FloatArray
    forces: FloatArray

    def path_error(self) -> float:
        """Greatest distance of the tire's outer wall from its path [m]."""
        return float(np.max(np.abs(outward(self.turn.path, self.turn.radius, self.turn.angle))))


def low_speed_turn(parameters: TruckParameters, payload: float, timestep: float) -> SimulatedTurn:
    """Drives the turn of 12.5 m with a payload [kg]."""
    wanted, outline = LowSpeedTurn(), Outline.from_parameters(parameters, payload)
    truck = Truck.load(payload, parameters=parameters, timestep=timestep, visuals=False)
    steered = [axle for axle in parameters.lead.axles if axle.steered]
    half_track = 0.5 * steered[0].track
    half_tire = outline.tire - half_track
    truck.reset(station=20.0, speed=wanted.speed)
    origin = np.array([20.0 + ENTRY, -outline.tire])
    share, hold = half_track / outline.kinematic.L, SpeedHold()
    knuckle = truck.data.joint(f"{steered[0].name}_right_knuckle").qpos
    tires = [f"{axle.name}_{side}_tire_force" for axle in steered for side in ("left", "right")]
    centers = [outline.kinematic.L + parameters.lead.axles[0].position, *outline.kinematic.lengths]
    bodies = [truck.data.body(unit.name) for unit in parameters.units]

    def wall() -> FloatArray:
        yaw, outer = _heading(bodies[0].xmat), _heading(bodies[0].xmat) + float(knuckle[0])
        across = half_track * np.array([math.sin(yaw), -math.cos(yaw)])
        own = half_tire * np.array([math.sin(outer), -math.cos(outer)])
        return np.asarray(bodies[0].xpos[:2] + across + own - origin)

    def command(_: float, state: EgoState) -> VehicleCommand:
        direction = state.yaw + float(knuckle[0])
        ahead = wall() + _AHEAD * np.array([math.cos(direction), math.sin(direction)])
        error = -float(outward(ahead, wanted.radius, wanted.angle))
        goal = _direction(ahead, wanted) - math.atan(_GAIN * error) - state.yaw
        tangent = math.tan(float(np.clip(goal, -0.6, 0.6)))
        angle = parameters.steering.ratio * math.atan(tangent / (1.0 - share * tangent))
        return hold.command(wanted.speed - state.speed, angle)

    def read(_: EgoState) -> list[float]:
        row = wall().tolist()
        for body, center in zip(bodies, centers, strict=True):
            yaw = _heading(body.xmat)
            axles = body.xpos[:2] - origin - center * np.array([math.cos(yaw), math.sin(yaw)])
            row += [*axles.tolist(), yaw]
        return row + [float(x) for name in tires for x in truck.data.sensor(name).data]

    length = ENTRY + wanted.radius * wanted.angle + EXIT
    table = sampled(truck, command, read, length / wanted.speed)
    time, path, rest = table[:, 0], table[:, 1:3], table[:, 3:]
    count = 3 * len(bodies)
    poses = rest[:, :count].reshape(len(table), -1, 3)
    forces = rest[:, count:].reshape(len(table), -1, 3)
    turn = Turn(outline, wanted.radius, wanted.angle, path, poses)
    return SimulatedTurn(turn, time, forces)


def _direction(point: FloatArray, turn: LowSpeedTurn) -> float:
    """Direction of the path beside a point (2,) [rad]."""
    beside = math.atan2(point[0], turn.radius - point[1])
    return min(max(beside, 0.0), turn.angle) if point[1] < turn.radius else turn.angle


def _heading(axes: FloatArray) -> float:
    """Heading [rad] of a body with this flat rotation matrix."""
    return math.atan2(axes[3], axes[0])


@dataclass(frozen=True)
class StraightDrive:
    """The truck on the rough straight.

    Attributes:
      speed: [m/s], shape (m,).
      points: extreme points of all units on the measured stretch [m], shape (m, points, 2).
      steer_axle: its offset [m], shape (m,).
    """

    speed: FloatArray
    points: FloatArray
    steer_axle: FloatArray


def straight_path(
    parameters: TruckParameters, payload: float, timestep: float, seed: int = 0
) -> StraightDrive:
    """Drives the rough straight with a payload [kg]; the seed is of its unevenness."""
    path = StraightPath()
    truck = Truck.load(
        payload,
        parameters=parameters,
        timestep=timestep,
        visuals=False,
        edit_spec=RoughRoad.of(path, seed).add_to,
    )
    truck.reset(station=0.8 * FLAT, speed=path.speed)
    bodies = [truck.data.body(unit.name) for unit in parameters.units]
    outer = [_outer_points(parameters, unit) for unit in range(len(bodies))]
    hold, total = SpeedHold(), 0.0

    def command(_: float, state: EgoState) -> VehicleCommand:
        nonlocal total
        ahead = state.y + _PREVIEW * state.speed * math.sin(state.yaw)
        total += state.y * PERIOD
        angle = -_HOLD * ahead - _INTEGRAL * total
        return hold.command(path.speed - state.speed, parameters.steering.ratio * angle)

    def read(state: EgoState) -> list[float]:
        row = [state.speed, state.y]
        for body, points in zip(bodies, outer, strict=True):
            row += (body.xpos[:2] + points @ body.xmat.reshape(3, 3)[:2].T).ravel().tolist()
        return row

    length = START + path.length + 0.5 * FLAT
    limit = 2.0 * length / path.speed
    table = sampled(truck, command, read, limit, lambda state: state.x > length)
    rear = table[:, 3::2].min(axis=1)
    kept = table[rear >= START]
    return StraightDrive(kept[:, 1], kept[:, 3:].reshape(len(kept), -1, 2), kept[:, 2])


def _outer_points(parameters: TruckParameters, index: int) -> FloatArray:
    """Corners of a unit's body, low and high, in its frame, shape (8, 3) [m]."""
    unit = parameters.units[index]
    origin = 0.0 if unit.coupling is None else unit.coupling.height
    ends = (unit.front_overhang, unit.front_overhang - unit.length)
    sides = (0.5 * unit.width, -0.5 * unit.width)
    heights = (0.3 * unit.height - origin, unit.height - origin)
    return np.array([(x, y, z) for z in heights for x in ends for y in sides])
