"""Logs of a drive: commands and states for a recording, and the frames of the truck's bus.

The module also stores the options of a drive in its recording and checks options against it.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.core.own_parts import part_name, source_digest
from iits_mj.j1939 import Frame, LogWriter
from iits_mj.j1939.state import TruckSender
from iits_mj.parameters import AnyTruck, TruckParameters, shipped_trucks
from iits_mj.plugin import library_path
from iits_mj.simulation.config import PARTS, DriveConfig
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.parts import configured_events
from iits_mj.truck import Truck
from traffic_bridge import Recorder, Recording
from traffic_bridge.modes.resim import config_of

# Time, positions, speeds, activations, histories and the plugins' states.
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
# Options that name files; the recording stores or hashes their content.
FILES = ("map", "recording", "events", "scenario", "speed_profile")
# Options of the content of these files, which the recording stores.
OF_FILES = ("param",)
# Options of SUMO traffic, without effect on recorded traffic.
OF_SUMO = (
    *("density", "traffic_speed", "traffic_mode"),
    *("lane_change", "lane_discipline", "traffic_scope", "seed"),
)
_MODES = {"InterSim": "inter", "PureSim": "pure", "EventSim": "none"}


def truck_versions(parameters: TruckParameters) -> dict[str, str]:
    """Returns the versions and hashes that determine the truck's physics."""
    return {
        "mujoco": mujoco.__version__,
        "engine plugin of hash": hashlib.sha256(library_path().read_bytes()).hexdigest(),
        "truck parameters of hash": parameters.digest(),
    }


def stored_names() -> set[str]:
    """Returns the names of the options that a recording or a bag stores."""
    return {field.name for field in dataclasses.fields(DriveConfig)} - set(OF_FILES)


def stored_options(config: DriveConfig) -> dict[str, Any]:
    """Returns the options of a drive as plain values: files, truck and own parts by name."""
    kept = stored_names()
    fields = [field.name for field in dataclasses.fields(DriveConfig) if field.name in kept]
    values = {name: getattr(config, name) for name in fields}
    parameters = TruckParameters.load(config.truck)
    values |= {"truck": parameters.name, "payload": parameters.check_payload(config.payload)}
    values |= {name: part_name(values[name]) for name in PARTS}
    return {
        name: value.name if isinstance(value, Path) else value for name, value in values.items()
    }


def without_own_parts(options: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the options of a stored drive with shipped parts in place of the user's own.

    It suffices where the drive's commands or pictures are repeated and nothing is planned.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(DriveConfig)}

    def own(name: str, value: Any) -> bool:
        # Anything but text is a fault of the file, which `DriveConfig` refuses.
        return name in PARTS and isinstance(value, str) and PARTS[name].is_own(value)

    return {name: defaults[name] if own(name, v) else v for name, v in options.items()}


def truck_of(options: Mapping[str, Any], name: str, given: AnyTruck | None) -> AnyTruck:
    """Returns the truck of a stored drive.

    Args:
      options: of the drive, from `stored_options`.
      name: of the recording or bag in messages.
      given: the truck that the user names; None: the shipped one of the stored name.

    Raises:
      InputError: another truck is given, or none although the stored one is not shipped.
    """
    stored = options["truck"]
    if given is not None:
        found = TruckParameters.load(given)
        if found.name != stored:
            raise InputError(f"{name}: made with truck {stored!r}, not {found.name!r}")
        return found
    if stored not in shipped_trucks():
        raise InputError(
            f"{name}: made with truck {stored!r}, which is not shipped: name its file by --truck"
        )
    return str(stored)


class StateHash:
    """Running hash of the truck's physics; its first 64 bits are stored with each frame."""

    def __init__(self, truck: Truck) -> None:
        self._model, self._data = truck.model, truck.data
        self._state = np.empty(mujoco.mj_stateSize(truck.model, _STATE))
        self._hash = hashlib.sha256()

    def add(self) -> int:
        """Adds the present state; returns the first 64 bits of the hash so far."""
        mujoco.mj_getState(self._model, self._data, self._state, _STATE)
        self._hash.update(self._state.tobytes())
        return int.from_bytes(self._hash.digest()[:8], "big")


class DriveLog(Observer):
    """Writes the commands and the hashes of the truck's states into a recorder of the traffic."""

    def __init__(
        self, recorder: Recorder, clock: LockStep, truck: Truck, config: DriveConfig
    ) -> None:
        self._recorder = recorder
        self._clock = clock
        self._hash = StateHash(truck)
        recorder.drive = {
            "options": stored_options(config),
            "versions": truck_versions(truck.parameters),
        }
        if digest := source_digest(config.traffic_mode):
            recorder.drive["versions"]["own traffic of hash"] = digest

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Writes the hash of the truck's state and the lights, once for each traffic frame."""
        del trajectory
        self._recorder.note_truck(self._hash.add())
        self._recorder.note_signals(scene.signals)

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Writes the command that reaches the truck."""
        del ego, wanted
        self._recorder.note_command(self._clock.time, obeyed)


class BusLog(Closing, Observer):
    """Observer that writes the frames of the truck's bus to a file; a context manager.

    Frames are in the order of time, which starts at 0. At one instant the reports precede the
    command that answers them.

    Args:
      path: of the file; its suffix selects the format.
      truck: sends the reports.

    Attributes:
      count: frames written.

    Raises:
      BusError: the file cannot be written, or the format is unknown.
    """

    period = 0.01
    reads_bus = True

    def __init__(self, path: Path, truck: Truck) -> None:
        self.path = path
        self.count = 0
        self._truck = truck
        self._sender = TruckSender(truck.parameters)
        self._writer = LogWriter(path)

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Writes the reports that are due."""
        del simulation
        # Log files keep microseconds, and the sum of many steps is not exact.
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, self._truck.report()):
            self.sent(report)

    def sent(self, frame: Frame) -> None:
        """Writes a frame."""
        self._writer.write(frame)
        self.count += 1

    def close(self) -> None:
        """Completes the file; the drive may continue without this observer."""
        self._writer.close()


def check_given(config: DriveConfig, given: Collection[str]) -> None:
    """Refuses options of SUMO traffic that were set in a drive with recorded traffic alone.

    Args:
      config: of a drive.
      given: names of the options that were set.

    Raises:
      InputError: such an option was set.
    """
    if config.recording is None or config.reactive:
        return
    for name in OF_SUMO:
        if name in given:
            flag = name.replace("_", "-")
            raise InputError(
                f"--{flag} has no effect on recorded traffic; leave it out, or add --reactive for "
                "additional SUMO traffic"
            )


def check_options(
    recording: Recording, name: str, asked: DriveConfig, given: Collection[str]
) -> None:
    """Refuses options that were set and differ from those of a recording.

    Args:
      recording: of a drive, or of traffic alone.
      name: of the recording in messages.
      asked: the requested options.
      given: names of the options that were set; the recording determines the others.

    Raises:
      InputError: an option differs, or the file of events cannot be used.
    """
    values = stored_options(asked)
    then = options_of(recording, name) if "drive" in recording.meta else _of_traffic(recording)
    for field in dataclasses.fields(DriveConfig):
        if field.name not in given or field.name in (*FILES, *OF_FILES):
            continue
        flag, value = field.name.replace("_", "-"), values[field.name]
        if field.name not in then:
            raise InputError(f"{name}: has no {flag}; leave --{flag} out")
        if value != then[field.name]:
            raise InputError(
                f"{name}: made with {flag} {then[field.name]}, not {value}; leave --{flag} out"
            )
    if "events" in given and asked.events is not None:
        events, stored = configured_events(asked), config_of(recording, name).events
        if events != stored:
            was = "other events than" if stored else "no events, not with"
            raise InputError(f"{name}: made with {was} {asked.events}; leave --events out")


def options_of(recording: Recording, name: str) -> dict[str, Any]:
    """Returns the options of a recorded drive.

    Raises:
      InputError: the recording has no drive, only traffic.
    """
    drive = recording.meta.get("drive")
    if not isinstance(drive, dict) or not isinstance(drive.get("options"), dict):
        raise InputError(
            f"{name}: traffic without a drive, so no truck can drive again; leave --drive out"
        )
    return dict(drive["options"])


def _of_traffic(recording: Recording) -> dict[str, Any]:
    """Returns the options of a recording of traffic without a drive."""
    meta = recording.meta
    config = meta.get("config")
    stored = config if isinstance(config, Mapping) else {}
    return {
        "density": stored.get("density"),
        "traffic_speed": stored.get("speed_limit"),
        "traffic_mode": _MODES.get(str(meta.get("mode"))),
        "lane_change": stored.get("lane_change"),
        "lane_discipline": stored.get("lane_discipline"),
        "traffic_scope": stored.get("scope"),
        "seed": meta.get("seed"),
    }
