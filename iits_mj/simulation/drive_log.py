"""What a recording needs of the truck, so that the whole drive can be run again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939 import LogWriter
from iits_mj.j1939.state import TruckSender
from iits_mj.parameters import TruckParameters
from iits_mj.plugin import library_path
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.truck import Truck
from traffic_bridge import Recorder, Recording, read_events
from traffic_bridge.modes.resim import config_of

# Time, positions, speeds, activations, histories and the plugins' states: all that evolves.
_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


def truck_versions(parameters: TruckParameters) -> dict[str, str]:
    """What the truck's physics depends on beside the road and the commands."""
    figures = json.dumps(dataclasses.asdict(parameters), sort_keys=True, default=_plain)
    return {
        "mujoco": mujoco.__version__,
        "engine plugin of hash": hashlib.sha256(library_path().read_bytes()).hexdigest(),
        "truck parameters of hash": hashlib.sha256(figures.encode()).hexdigest(),
    }


def stored_options(config: DriveConfig) -> dict[str, Any]:
    """The options of a drive as plain values; files by their names."""
    values = {field.name: getattr(config, field.name) for field in dataclasses.fields(DriveConfig)}
    return {
        name: value.name if isinstance(value, Path) else value for name, value in values.items()
    }


class StateHash:
    """Hash of the truck's physics at every frame so far; its first 64 bits are the frame's."""

    def __init__(self, truck: Truck) -> None:
        self._model, self._data = truck.model, truck.data
        self._state = np.empty(mujoco.mj_stateSize(truck.model, _STATE))
        self._hash = hashlib.sha256()

    def add(self) -> int:
        """Adds the present state; the hash up to it."""
        mujoco.mj_getState(self._model, self._data, self._state, _STATE)
        self._hash.update(self._state.tobytes())
        return int.from_bytes(self._hash.digest()[:8], "big")


class DriveLog(Observer):
    """Writes the commands and the truck's states of a drive into a recorder.

    Args:
      recorder: of the traffic.
      clock: of the drive, at its start.
      truck: the truck that is driven.
      config: of the drive.
    """

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

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Writes the hash of the truck's state, once for each frame of the traffic."""
        del scene, trajectory
        self._recorder.note_truck(self._hash.add())

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Writes the command that reaches the truck."""
        del ego, wanted
        self._recorder.note_command(self._clock.time, obeyed)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return str(value)


class BusLog(Closing, Observer):
    """Observer that writes the traffic of the truck's bus; used as a context manager.

    Frames are in the order of time, which starts at 0. At one instant the reports come first, then
    the command that answers them.

    Args:
      path: of the file; its suffix chooses the format.
      truck: whose bus it is.

    Attributes:
      count: frames written.

    Raises:
      BusError: the file cannot be written, or there is no such format.
    """

    period = 0.01
    reads_bus = True

    def __init__(self, path: Path, truck: Truck) -> None:
        self.path = path
        self.count = 0
        self._truck = truck
        self._sender = TruckSender(truck.parameters)
        self._writer = LogWriter(path)

    def observe(self, simulation: LockStep, frame: Frame) -> None:
        """Writes the reports that are due."""
        del simulation
        # Log files keep microseconds, and the sum of many steps is not exact.
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, self._truck.report()):
            self.sent(report)

    def sent(self, frame: BusFrame) -> None:
        """Writes a frame."""
        self._writer.write(frame)
        self.count += 1

    def close(self) -> None:
        """Finishes the file; the drive may go on without this observer."""
        self._writer.close()


# --- Options beside a recording: those given must be those of then, or have a meaning at all ---

# Files whose content the recording holds itself or checks by its hash.
FILES = ("map", "recording", "events", "speed_profile")
# What SUMO's traffic is asked for; recorded traffic alone hears none of it.
OF_SUMO = (
    *("density", "traffic_speed", "traffic_mode"),
    *("lane_change", "lane_discipline", "traffic_scope", "seed"),
)
_MODES = {"InterSim": "inter", "PureSim": "pure"}


def check_given(config: DriveConfig, given: Collection[str]) -> None:
    """Refuses options of SUMO's traffic where there is none but the recorded one.

    Args:
      config: of a drive.
      given: names of the options that somebody asked for.

    Raises:
      InputError: names the first.
    """
    if config.recording is None or config.reactive:
        return
    for name in OF_SUMO:
        if name in given:
            raise InputError(
                f"{_flag(name)} has no meaning in recorded traffic, which stays as it was; leave "
                "it out, or add --reactive for SUMO traffic around it"
            )


def check_options(
    recording: Recording, name: str, asked: DriveConfig, given: Collection[str]
) -> None:
    """Refuses options that are given and differ from those of a recording.

    Args:
      recording: that is to be run again.
      name: how messages call it.
      asked: the options.
      given: names of those that somebody asked for; the others are as in the recording.

    Raises:
      InputError: names the first that differs; or the events' file cannot be used.
    """
    values = stored_options(asked)
    then = options_of(recording, name) if "drive" in recording.meta else _of_traffic(recording)
    for field in dataclasses.fields(DriveConfig):
        if field.name not in given or field.name in FILES:
            continue
        flag, value = field.name.replace("_", "-"), values[field.name]
        if field.name not in then:
            raise InputError(f"{name}: does not hold {flag}, asked is {flag} {value}")
        if value != then[field.name]:
            raise InputError(
                f"{name}: made with {flag} {then[field.name]}, asked is {flag} {value}"
            )
    if "events" in given and asked.events is not None:
        events, stored = read_events(asked.events), config_of(recording, name).events
        if events != stored:
            was = "other events than those" if stored else "no events, asked are those"
            raise InputError(f"{name}: made with {was} of {asked.events}")


def options_of(recording: Recording, name: str) -> dict[str, Any]:
    """The options of a recorded drive.

    Raises:
      InputError: it is of a traffic without a drive.
    """
    drive = recording.meta.get("drive")
    if not isinstance(drive, dict) or not isinstance(drive.get("options"), dict):
        raise InputError(f"{name}: is of a traffic without a drive: its truck cannot be driven")
    return dict(drive["options"])


def _of_traffic(recording: Recording) -> dict[str, Any]:
    """The same options, as far as a traffic without a drive has them."""
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


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
