"""Writes a drive into a bag while it is driven."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import iits_mj
from iits_mj.bag import message_types
from iits_mj.bag.message_types import MESSAGES, Decided, Standard, decode, encode, type_name
from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939.state import TruckSender
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import FILES, stored_options
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.loop import Simulation

# --- The types of a bag: ROS 2's own, CAN frames, and ours ---

REMEDY = "pip install 'iits-mj[ros]'"

# Topic to type: the paper's module boundaries, then what others show or convert.
TOPICS = {
    "/drive": "std_msgs/msg/String",
    "/traffic/scene": message_types.type_name(message_types.Scene),
    "/decision": message_types.type_name(message_types.Decided),
    "/planning/trajectory": message_types.type_name(message_types.Trajectory),
    "/control/command": message_types.type_name(message_types.VehicleCommand),
    "/vehicle/command": message_types.type_name(message_types.VehicleCommand),
    "/vehicle/state": message_types.type_name(message_types.EgoState),
    "/vehicle/odometry": "nav_msgs/msg/Odometry",
    "/vehicle/twist": "geometry_msgs/msg/TwistStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/traffic/markers": "visualization_msgs/msg/MarkerArray",
    "/planning/path": "nav_msgs/msg/Path",
    "/can": message_types.CAN_TYPE,
}


@functools.cache
def typestore() -> Any:
    """ROS 2 Jazzy's types and ours.

    Raises:
      InputError: rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise InputError(f"bags need rosbags: {REMEDY}") from error
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(message_types.CAN_FRAME, message_types.CAN_TYPE))
    for kind in message_types.MESSAGES:
        text = message_types.definition(kind)
        store.register(get_types_from_msg(text, message_types.type_name(kind)))
    return store


# --- Reads back what a drive's bag holds of our own messages ---


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


# --- Writes a drive into a bag while it is driven ---

# Of the bag's own format.
VERSION: Final = 9
_CAN_PERIOD = 0.01


class BagWriter(Finishing, Observer):
    """Observer that writes a ROS 2 bag; used as a context manager.

    `/traffic/scene`, `/planning/trajectory`, `/decision` every 100 ms (the last when it is asked),
    `/control/command`, `/vehicle/command` and `/vehicle/state` every 20 ms: exactly what the
    modules heard and said. Times are those of the simulation, from 0. `/drive` holds the options.

    Args:
      folder: of the bag, made here: `metadata.yaml` and the MCAP file, as `ros2 bag` makes them.
      simulation: at its start.

    Attributes:
      count: messages written.

    Raises:
      InputError: rosbags is missing, the folder exists or cannot be made, or nobody's stack drives.
    """

    period = _CAN_PERIOD
    reads_bus = True

    def __init__(self, folder: Path, simulation: Simulation) -> None:
        self.folder = folder
        self.count = 0
        self._store = typestore()
        self._stack = simulation.stack
        self._asked = 0
        make = self._store.types.__getitem__
        self._make = make
        self._standard = Standard(make, simulation.truck.parameters)
        self._sender = TruckSender(simulation.truck.parameters)
        self._writer = _open(folder)
        self._connections = {
            topic: self._writer.add_connection(topic, kind, typestore=self._store)
            for topic, kind in TOPICS.items()
        }
        options = stored_options(simulation.config)
        told = {"version": iits_mj.__version__, "timestep": simulation.timestep, "options": options}
        self._write("/drive", 0.0, self._standard.text(json.dumps(told)))
        self._truck = simulation.truck

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Writes a scene, what was decided and planned in it, and how they look."""
        time, standard = scene.time, self._standard
        self._write("/traffic/scene", time, encode(_plain(scene), self._make))
        self._write("/traffic/markers", time, standard.markers(time, scene.vehicles))
        if self._stack.decisions != self._asked:
            self._asked = self._stack.decisions
            answer = Decided(time, self._stack.last_decision)
            self._write("/decision", time, encode(answer, self._make))
        self._write("/planning/trajectory", time, encode(trajectory, self._make))
        self._write("/planning/path", time, standard.path(time, trajectory))

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Writes the state and the commands that answer it."""
        time, standard = ego.time, self._standard
        self._write("/vehicle/state", time, encode(ego, self._make))
        self._write("/vehicle/odometry", time, standard.odometry(ego))
        self._write("/vehicle/twist", time, standard.twist(ego))
        self._write("/tf", time, standard.transforms(ego))
        self._write("/control/command", time, encode(wanted, self._make))
        self._write("/vehicle/command", time, encode(obeyed, self._make))

    def observe(self, simulation: LockStep, frame: Frame) -> None:
        """Writes the truck's reports on the bus that are due."""
        del simulation
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, self._truck.report()):
            self.sent(report)

    def close(self) -> None:
        """Finishes the bag; the drive may go on."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def abandon(self) -> None:
        """Leaves no bag behind."""
        if self._writer is not None:
            self._writer.abort()
            self._writer = None
            shutil.rmtree(self.folder, ignore_errors=True)

    def sent(self, frame: BusFrame) -> None:
        """Writes a frame of the bus."""
        self._write("/can", frame.time, self._standard.can(frame))

    def _write(self, topic: str, time: float, message: Any) -> None:
        connection = self._connections[topic]
        data = self._store.serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, round(time * 1e9), data)
        self.count += 1


def _plain(scene: Scene) -> Scene:
    """The scene with its vehicles as a tuple."""
    return dataclasses.replace(scene, vehicles=tuple(scene.vehicles))


def _open(folder: Path) -> Any:
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        writer = Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.open()
    except (OSError, WriterError) as error:
        raise InputError(f"bag {str(folder)!r} cannot be written: {error}") from error
    return writer
