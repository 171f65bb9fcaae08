"""Recorded drives as poses and frames for pictures, without physics, planner or SUMO.

The truck's recorded states give the pose of the motor vehicle and the angles of the couplings. The
road gives what a state does not report: pitch and roll of towed units. Axles and wheels hang in
their positions of rest.
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.angles import wrap_angle
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    Decision,
    EgoState,
    PlanMode,
    Scene,
    Trajectory,
    VehicleCommand,
)
from iits_mj.core.timing import TIMESTEP
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.gaps import nearest_box_distance
from iits_mj.simulation.parts import load_route, load_truck
from iits_mj.truck.placement import TruckPlacement
from traffic_bridge import Mirror, Recording

# The path that was driven stands for the plan where none is recorded [s].
AHEAD, PLAN_STEP = 5.0, 0.2
# [m] to the side from which such a path is a lane change.
ASIDE = 1.2
_ANGLES = ("yaw", "pitch", "roll")


@dataclasses.dataclass(frozen=True)
class Record:
    """What a drive's recording holds for pictures; lists in the order of time.

    Attributes:
      config: of the drive.
      states: of the truck; scenes: of the traffic, one or more.
      trajectories: plan of each scene; empty: the driven path stands for them.
      commands: that reached the truck, with their times [s].
    """

    config: DriveConfig
    states: Sequence[EgoState]
    scenes: Sequence[Scene]
    trajectories: Sequence[Trajectory] = ()
    commands: Sequence[tuple[float, VehicleCommand]] = ()

    @classmethod
    def of_recording(cls, recording: Recording, config: DriveConfig) -> Record:
        """Returns the record of a drive's recording."""
        states, scenes = [], []
        for k in range(len(recording)):
            ego = recording.ego_at(k)
            if ego is not None:
                time = float(recording.time[k])
                states.append(dataclasses.replace(ego, time=time))
                signals = recording.signals_at(k)
                scenes.append(Scene(time, ego, recording.frames[k], signals=signals))
        count = len(recording.command_time)
        times = recording.command_time.tolist()
        commands = [(times[k], recording.command_at(k)) for k in range(count)]
        return cls(config, states, scenes, commands=commands)


class RecordedDrive:
    """A recorded drive that can be looked at at any time.

    Args:
      record: of the drive.

    Attributes:
      truck: with the scene's model; data: its pose at the time of the last `at`.
      start, end: times of the first and last state [s].

    Raises:
      InputError: the record has no states or scenes. MapError: the map cannot be read.
    """

    def __init__(self, record: Record) -> None:
        if not record.states or not record.scenes:
            raise InputError("the recording has no states of the truck, so that nothing is seen")
        self._record = record
        self._route = load_route(record.config)
        self._mirror = Mirror()
        self.truck = load_truck(record.config, self._route, self._mirror)
        self.data = self.truck.data
        self._times = [state.time for state in record.states]
        self._scene_times = [scene.time for scene in record.scenes]
        self._command_times = [time for time, _ in record.commands]
        self.start, self.end = self._times[0], self._times[-1]
        self._first = record.states[0]
        self._ends = np.array([(s.time, s.station, s.offset) for s in record.states])
        lanes = [self._route.lane_at(s.station, s.offset) for s in record.states]
        self._shown = -1
        self._changes = np.concatenate([[0], np.cumsum(np.diff(lanes) != 0)])
        self._rewind()

    def at(self, time: float) -> DriveFrame:
        """Poses truck and traffic as at a time [s] and returns the drive then.

        Raises:
          InputError: the time is not within the recording.
        """
        if not self.start - 1e-9 <= time <= self.end + 1e-9:
            raise InputError(
                f"time {time:g} s is not in the recording: use {self.start:g} to {self.end:g} s"
            )
        ego = self._ego(time)
        number = max(bisect_right(self._scene_times, time + 1e-6) - 1, 0)
        if number < self._shown:
            self._rewind()
        self._pose(ego)
        # Every step of the traffic, in which semitrailers follow their tractors.
        for k in range(self._shown + 1, number + 1):
            self._mirror.update(self.data, self._record.scenes[k].vehicles, (ego.x, ego.y))
        self._shown = number
        scene = self._record.scenes[number]
        self._mirror.update(self.data, None, (ego.x, ego.y), max(time - scene.time, 0.0))
        mujoco.mj_kinematics(self.truck.model, self.data)
        mujoco.mj_camlight(self.truck.model, self.data)
        return self._frame(time, ego, scene, number)

    def _rewind(self) -> None:
        """Forgets the traffic."""
        mujoco.mj_resetData(self.truck.model, self.data)
        self._mirror.bind(self.truck.model)
        self._shown = -1

    def _ego(self, time: float) -> EgoState:
        """The truck's state at a time, linear between the recorded ones."""
        k = min(max(bisect_right(self._times, time) - 1, 0), len(self._times) - 1)
        before = self._record.states[k]
        after = self._record.states[min(k + 1, len(self._times) - 1)]
        gap = after.time - before.time
        share = 0.0 if gap <= 0.0 else (time - before.time) / gap
        values: dict[str, Any] = {}
        for field in dataclasses.fields(EgoState):
            a, b = getattr(before, field.name), getattr(after, field.name)
            if isinstance(a, float):
                step = wrap_angle(b - a) if field.name in _ANGLES else b - a
                values[field.name] = a + share * step
            elif isinstance(a, tuple):
                values[field.name] = tuple(p + share * (q - p) for p, q in zip(a, b, strict=True))
        return dataclasses.replace(before, **values | {"time": time})

    def _pose(self, ego: EgoState) -> None:
        """Writes the pose of the truck into the data."""
        model, data, parameters = self.truck.model, self.data, self.truck.parameters
        shown = data.mocap_pos.copy(), data.mocap_quat.copy()
        mujoco.mj_resetData(model, data)
        data.mocap_pos[:], data.mocap_quat[:] = shown
        data.time = ego.time
        self.truck.place(TruckPlacement(station=ego.station, offset=ego.offset))
        at = int(model.joint("tractor_free").qposadr[0])
        data.qpos[at : at + 3] = ego.x, ego.y, ego.z
        data.qpos[at + 3 : at + 7] = _quaternion(ego.yaw, ego.pitch, ego.roll)
        angles = (ego.articulation, *ego.rear_articulations)
        for name, angle in zip(parameters.coupling_names, angles, strict=False):
            data.qpos[model.joint(f"{name}_yaw").qposadr[0]] = -angle
        way = ego.station - self._first.station
        for axle in parameters.axles:
            for side in ("left", "right"):
                spin = model.joint(f"{axle.name}_{side}_spin")
                turned = way / parameters.tires[axle.tire].rolling_radius
                data.qpos[spin.qposadr[0]] = math.remainder(turned, 2.0 * math.pi)
                if axle.steered:
                    knuckle = model.joint(f"{axle.name}_{side}_knuckle")
                    data.qpos[knuckle.qposadr[0]] = ego.road_wheel_angle

    def _frame(self, time: float, ego: EgoState, scene: Scene, number: int) -> DriveFrame:
        route, record = self._route, self._record
        lane = int(route.lane_at(ego.station, ego.offset))
        point = route.evaluate(ego.station, ego.offset)
        scene = dataclasses.replace(scene, footprint=self.truck.footprint)
        ahead, behind = scene.neighbors.corridor_gaps(lane)
        order = bisect_right(self._command_times, time + 1e-6) - 1
        command = record.commands[order][1] if order >= 0 else VehicleCommand()
        trajectory = self._driven(ego)
        if record.trajectories:
            trajectory = record.trajectories[min(number, len(record.trajectories) - 1)]
        limit = float(route.speed_limit(ego.station, max(lane, 0)))
        k = max(bisect_right(self._times, time + 1e-6) - 1, 0)
        return DriveFrame(
            time=time,
            ego=ego,
            scene=scene,
            trajectory=trajectory,
            command=command,
            decision=Decision.KEEP,
            lane=lane,
            lane_count=int(route.lane_count(ego.station)),
            grade=float(point.grade),
            curvature=float(point.curvature),
            speed_limit=limit,
            reference_speed=min(record.config.speed, limit),
            gap_ahead=ahead,
            gap_behind=behind,
            box_distance=nearest_box_distance(ego, scene.vehicles, self.truck.parameters),
            distance=ego.station - self._first.station,
            lane_changes=int(self._changes[k]),
            refused=0,
        )

    def _driven(self, ego: EgoState) -> Trajectory:
        """The path that the truck drives from this state on."""
        time = ego.time + np.arange(0.0, AHEAD, PLAN_STEP)
        time = time[time <= self.end + 1e-9]
        station, offset = (np.interp(time, self._ends[:, 0], self._ends[:, i]) for i in (1, 2))
        point = self._route.evaluate(station, offset)
        away = float(np.abs(offset - ego.offset).max(initial=0.0))
        none = np.zeros_like(time)
        return Trajectory(
            time=time,
            station=station,
            offset=offset,
            x=np.asarray(point.x),
            y=np.asarray(point.y),
            z=np.asarray(point.z),
            yaw=np.asarray(point.heading),
            curvature=none,
            speed=none + ego.speed,
            acceleration=none,
            mode=PlanMode.LANE_CHANGE if away > ASIDE else PlanMode.LANE_KEEPING,
            target_lane=int(self._route.lane_at(float(station[-1]), float(offset[-1]))),
        )


def times_of(start: float, end: float, period: float) -> FloatArray:
    """Returns the times of the pictures from `start` to `end` [s], whole steps of the physics."""
    count = int((end - start) / period + 1e-6) + 1
    return np.round((start + period * np.arange(count)) / TIMESTEP) * TIMESTEP


def _quaternion(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Returns the rotation of yaw, then pitch, then roll [rad], ISO 8855."""
    found, turn, step = np.array([1.0, 0.0, 0.0, 0.0]), np.empty(4), np.empty(4)
    for angle, axis in ((yaw, (0.0, 0.0, 1.0)), (pitch, (0.0, 1.0, 0.0)), (roll, (1.0, 0.0, 0.0))):
        mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
        mujoco.mju_mulQuat(step, found, turn)
        found = step.copy()
    return found
