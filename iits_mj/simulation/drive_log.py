"""What a recording needs of the truck, so that the whole drive can be run again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from iits_mj.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.plugin_library import library_path
from iits_mj.simulation.config import DriveConfig
from iits_mj.truck import Truck
from traffic_bridge import Recorder

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


class DriveLog:
    """Notes commands and states of a drive in its recorder.

    Args:
      recorder: of the traffic, which keeps the notes.
      truck: that is driven.
      config: of the drive.
    """

    def __init__(self, recorder: Recorder, truck: Truck, config: DriveConfig) -> None:
        self._recorder = recorder
        self._truck = truck
        recorder.drive = {
            "options": stored_options(config),
            "versions": truck_versions(truck.parameters),
        }

    def begin(self) -> None:
        """Begins with the drive, after the reset of the traffic."""
        self._hash = StateHash(self._truck)
        self.note_state()

    def note_command(self, time: float, command: VehicleCommand) -> None:
        """Notes what the truck gets at a time [s]."""
        self._recorder.note_command(time, command)

    def note_state(self) -> None:
        """Notes the truck's state, once after each frame of the traffic."""
        self._recorder.note_truck(self._hash.add())


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return str(value)
