"""A drive as it was recorded, and the model of its truck placed as in the recording.

Nothing is simulated: the truck's recorded pose, articulations and steering are written into the
model, and the other vehicles are the recorded ones. Springs are at rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from iits_mj.bag.mcap_file import Bag, read_bag
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, RoadSignals, Scene, Trajectory, VehicleCommand
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveFrame, Observer, Simulation
from iits_mj.simulation.drive_log import options_of, truck_of
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.parts import load_map
from iits_mj.truck import Truck
from iits_mj.truck.placement import TruckPlacement
from traffic_bridge import Mirror, Recording

_BAG_SUFFIX = ".mcap"


@dataclass
class Track:
    """States of a drive every 100 ms.

    Attributes:
      name: of the drive; route: its road; parameters, payload [kg]: of the truck.
      states, vehicles, commands, signals: at each instant; plans: where known, else empty.
    """

    name: str
    route: Route
    parameters: TruckParameters
    payload: float
    states: list[EgoState] = field(default_factory=list)
    vehicles: list[VehicleFrame] = field(default_factory=list)
    commands: list[VehicleCommand] = field(default_factory=list)
    signals: list[RoadSignals] = field(default_factory=list)
    plans: list[Trajectory] = field(default_factory=list)

    @property
    def time(self) -> FloatArray:
        """Times from the first instant on [s], shape (n,)."""
        time = np.array([state.time for state in self.states])
        return time - time[0]

    @property
    def duration(self) -> float:
        """From the first to the last instant [s]."""
        return self.states[-1].time - self.states[0].time

    def scene(self, index: int) -> Scene:
        """Returns truck, vehicles and lights of an instant."""
        ego, size = self.states[index], self.parameters.footprint
        signals = self.signals[index] if self.signals else RoadSignals()
        return Scene(ego.time, ego, self.vehicles[index], size, signals)

    def check(self) -> Track:
        """Returns the track.

        Raises:
          InputError: it has fewer than two instants.
        """
        if len(self.states) < 2:
            raise InputError(f"{self.name}: has fewer than two states of a truck to show")
        return self

    @classmethod
    def of(
        cls,
        drive: Recording | Bag | Track,
        name: str = "the drive",
        *,
        map_path: Path | None = None,
        truck: AnyTruck | None = None,
    ) -> Track:
        """Returns the track of a recorded drive.

        Args:
          drive: recording, bag, or a track.
          name: of it in messages.
          map_path: the drive's map; None: the built-in one.
          truck: of the drive; None: the shipped one of the recorded name.

        Raises:
          InputError: the drive was on another map or by another truck, or has no truck.
        """
        if isinstance(drive, Track):
            return drive.check()
        if isinstance(drive, Bag):
            return _of_bag(drive, name, map_path, truck).check()
        return _of_recording(drive, name, map_path, truck).check()


class TrackObserver(Observer):
    """Collects the track of a running drive.

    Args:
      simulation: at its start.

    Attributes:
      track: of the drive so far.
    """

    def __init__(self, simulation: Simulation) -> None:
        truck = simulation.truck
        self.track = Track("the drive", simulation.route, truck.parameters, truck.payload)
        self._simulation = simulation

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Adds an instant."""
        del simulation
        track = self.track
        track.states.append(frame.ego)
        track.vehicles.append(VehicleFrame.of(self._simulation.vehicles))
        track.commands.append(frame.command)
        track.signals.append(frame.scene.signals)
        track.plans.append(frame.trajectory)


def read_track(path: Path, map_path: Path | None = None, truck: AnyTruck | None = None) -> Track:
    """Returns the track of a recording (.npz) or a bag (its folder, or the .mcap file).

    Raises:
      InputError: the file cannot be used.
    """
    if path.is_dir() or path.suffix == _BAG_SUFFIX:
        return Track.of(read_bag(path), f"bag {path}", map_path=map_path, truck=truck)
    return Track.of(Recording.load(path), f"recording {path}", map_path=map_path, truck=truck)


class Puppet:
    """The truck's model, with the traffic's bodies, placed as on a track.

    Args:
      track: of the drive.

    Attributes:
      truck: with MuJoCo's model and data.
    """

    def __init__(self, track: Track) -> None:
        self._track = track
        self._mirror = Mirror()
        self.truck = Truck.load(
            track.payload,
            parameters=track.parameters,
            route=track.route,
            edit_spec=self._mirror.add_to,
        )
        model, parameters = self.truck.model, track.parameters
        self._mirror.bind(model)
        self._root = int(model.joint("tractor_free").qposadr[0])
        self._yaws = [
            int(model.joint(f"{name}_yaw").qposadr[0]) for name in parameters.coupling_names
        ]
        names = [model.joint(i).name for i in range(model.njnt)]
        steered = [
            f"{a.name}_{s}_knuckle" for a in parameters.lead.axles for s in ("left", "right")
        ]
        self._knuckles = [int(model.joint(n).qposadr[0]) for n in steered if n in names]
        self._spins = [
            (int(model.joint(f"{axle.name}_{side}_spin").qposadr[0]), radius)
            for axle in parameters.axles
            for side in ("left", "right")
            for radius in (parameters.tires[axle.tire].rolling_radius,)
        ]
        speeds = np.array([state.speed for state in track.states])
        steps = 0.5 * (speeds[1:] + speeds[:-1]) * np.diff(track.time)
        self._driven = np.concatenate([[0.0], np.cumsum(steps)])

    def place(self, index: int) -> mujoco.MjData:
        """Places the truck and the vehicles as at an instant; returns the data."""
        ego, truck = self._track.states[index], self.truck
        data = truck.data
        # The units behind follow the road's slopes, as they are not recorded.
        truck.place(TruckPlacement(station=ego.station, offset=ego.offset))
        data.qpos[self._root : self._root + 3] = ego.x, ego.y, ego.z
        data.qpos[self._root + 3 : self._root + 7] = _quaternion(ego.yaw, ego.pitch, ego.roll)
        bends = (ego.articulation, *ego.rear_articulations)
        for address, angle in zip(self._yaws, bends, strict=False):
            data.qpos[address] = -angle
        data.qpos[self._knuckles] = ego.road_wheel_angle
        for address, radius in self._spins:
            data.qpos[address] = math.remainder(self._driven[index] / radius, 2.0 * math.pi)
        data.time = ego.time
        self._mirror.update(data, self._track.vehicles[index], (ego.x, ego.y))
        mujoco.mj_kinematics(truck.model, data)
        return data


def _quaternion(yaw: float, pitch: float, roll: float) -> FloatArray:
    """Rotation by yaw, then pitch (nose down), then roll."""
    found = np.empty(4)
    mujoco.mju_euler2Quat(found, np.array([yaw, pitch, roll]), "zyx")
    return found


def _of_recording(
    recording: Recording, name: str, map_path: Path | None, truck: AnyTruck | None
) -> Track:
    options = options_of(recording, name)
    _check_map(options.get("map"), map_path, name)
    known = [k for k in range(len(recording)) if recording.ego_at(k) is not None]
    track = _empty(name, map_path, truck_of(options, name, truck), options)
    times = recording.command_time
    for k in known:
        ego = recording.ego_at(k)
        assert ego is not None
        track.states.append(ego)
        track.vehicles.append(recording.frames[k])
        track.signals.append(recording.signals_at(k))
        command = int(np.searchsorted(times, recording.time[k] + 1e-6)) - 1
        track.commands.append(recording.command_at(command) if command >= 0 else VehicleCommand())
    return track


def _of_bag(bag: Bag, name: str, map_path: Path | None, truck: AnyTruck | None) -> Track:
    _check_map(bag.options.get("map"), map_path, name)
    track = _empty(name, map_path, truck_of(bag.options, name, truck), bag.options)
    times = [state.time for state in bag.states]
    obeyed: Sequence[VehicleCommand] = bag.obeyed or bag.wanted
    for scene, plan in zip(bag.scenes, bag.trajectories, strict=False):
        command = int(np.searchsorted(times, scene.time + 1e-6)) - 1
        track.states.append(scene.ego)
        track.vehicles.append(VehicleFrame.of(scene.vehicles))
        track.signals.append(scene.signals)
        track.plans.append(plan)
        track.commands.append(obeyed[command] if command >= 0 else VehicleCommand())
    return track


def _empty(name: str, map_path: Path | None, truck: AnyTruck, options: dict[str, object]) -> Track:
    parameters = TruckParameters.load(truck)
    height = options.get("payload_height")
    if isinstance(height, float):
        parameters = parameters.with_payload_height(height)
    payload = options.get("payload")
    found = parameters.check_payload(payload if isinstance(payload, float) else None)
    along = options.get("route")
    route = load_map(map_path).route(along=along if isinstance(along, str) else None)
    return Track(name, route, parameters, found)


def _check_map(recorded: object, given: Path | None, name: str) -> None:
    if recorded is None and given is not None:
        raise InputError(f"{name}: the drive was on the built-in map: leave --map out")
    if recorded is not None and given is None:
        raise InputError(f"{name}: the drive was on the map {recorded!r}: name its file by --map")
