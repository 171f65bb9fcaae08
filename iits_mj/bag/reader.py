"""Reads back what a drive's bag holds of our own messages."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.bag.own_types import MESSAGES, Decided, decode, type_name
from iits_mj.bag.store import typestore
from iits_mj.errors import InputError
from iits_mj.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.recorded_options import FILES


@dataclass(frozen=True)
class Bag:
    """What the modules said to each other in a drive, each list in the order of time.

    Attributes:
      options: of the drive, as `DriveConfig` has them, files by their names; timestep: [s].
      scenes, trajectories: of every plan; decided: answers of the decision maker.
      states, wanted, obeyed: of every command: the state it answers, as given, as it reached the
        truck.
    """

    options: dict[str, Any]
    timestep: float
    scenes: list[Scene]
    trajectories: list[Trajectory]
    decided: list[Decided]
    states: list[EgoState]
    wanted: list[VehicleCommand]
    obeyed: list[VehicleCommand]

    def config(self, map_path: Path | None = None, **changes: Any) -> DriveConfig:
        """The drive's options again.

        Args:
          map_path: of a drive on another map than the built-in one.
          **changes: options that are to be others.

        Raises:
          InputError: it was made with other options than there are now, or needs a map.
        """
        known = {field.name for field in dataclasses.fields(DriveConfig)}
        if set(self.options) != known:
            other = ", ".join(sorted(set(self.options) ^ known))
            raise InputError(f"the bag was made with other options than there are now: {other}")
        name = self.options["map"]
        if (name is None) != (map_path is None):
            raise InputError(
                "the bag's drive was on the built-in map: leave --map out"
                if name is None
                else f"the bag's drive was on the map {name!r}: name its file by --map"
            )
        for file in FILES:
            if file != "map" and self.options[file] is not None and file not in changes:
                raise InputError(
                    f"the bag's drive used the file {self.options[file]!r} for "
                    f"--{file.replace('_', '-')}, which a bag does not hold"
                )
        return DriveConfig(**{**self.options, "map": map_path, **changes})


def read_bag(path: Path) -> Bag:
    """Reads a bag's folder, or the MCAP file in it.

    Raises:
      InputError: rosbags is missing, or this is no bag of a drive of ours.
    """
    found: dict[str, list[Any]] = {}
    for topic, message in _messages(path):
        found.setdefault(topic, []).append(message)
    wanted = ("/traffic/scene", "/planning/trajectory", "/vehicle/state", "/control/command")
    missing = [topic for topic in ("/drive", *wanted) if topic not in found]
    if missing:
        raise InputError(f"bag {str(path)!r} is of no drive of ours: it lacks {', '.join(missing)}")
    told = _told(found["/drive"][0], path)
    return Bag(
        options=told["options"],
        timestep=float(told["timestep"]),
        scenes=found["/traffic/scene"],
        trajectories=found["/planning/trajectory"],
        decided=found.get("/decision", []),
        states=found["/vehicle/state"],
        wanted=found["/control/command"],
        obeyed=found.get("/vehicle/command", []),
    )


def _messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Topic and message of all that is ours, in the order of time."""
    store = typestore()
    from rosbags.highlevel import AnyReader, AnyReaderError

    kinds = {type_name(kind): kind for kind in MESSAGES}
    folder = path.parent if path.suffix == ".mcap" else path
    try:
        with AnyReader([folder], default_typestore=store) as reader:
            chosen = [c for c in reader.connections if c.msgtype in kinds or c.topic == "/drive"]
            for connection, _, data in reader.messages(chosen):
                message = store.deserialize_cdr(data, connection.msgtype)
                kind = kinds.get(connection.msgtype)
                yield connection.topic, message.data if kind is None else decode(message, kind)
    except (AnyReaderError, OSError) as error:
        raise InputError(f"bag {str(path)!r} cannot be read: {error}") from error


def _told(text: str, path: Path) -> dict[str, Any]:
    try:
        told = json.loads(text)
        return {"options": dict(told["options"]), "timestep": told["timestep"]}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"bag {str(path)!r}: /drive does not hold a drive's options") from error
