"""Writes a drive into a ROS 2 bag, and reads its messages back."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import iits_mj
from iits_mj.bag import foxglove
from iits_mj.bag.message_types import (
    CAN_FRAME,
    CAN_TYPE,
    MESSAGES,
    Decided,
    StandardMessages,
    decode,
    definition,
    encode,
    type_name,
)
from iits_mj.core.context import Finishing
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_json
from iits_mj.core.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.core.output_files import unwritable
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939.state import TruckSender
from iits_mj.simulation.config import PARTS, DriveConfig
from iits_mj.simulation.drive_log import (
    FILES,
    stored_names,
    stored_options,
    truck_of,
    without_own_parts,
)
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep, Observer
from iits_mj.simulation.loop import Simulation

# Version of the bag format.
VERSION: Final = 9
# Types by topic: the paper's module boundaries, then messages for viewers and converters.
TOPICS = {
    "/drive": "std_msgs/msg/String",
    "/traffic/scene": type_name(Scene),
    "/decision": type_name(Decided),
    "/planning/trajectory": type_name(Trajectory),
    "/control/command": type_name(VehicleCommand),
    "/vehicle/command": type_name(VehicleCommand),
    "/vehicle/state": type_name(EgoState),
    "/vehicle/odometry": "nav_msgs/msg/Odometry",
    "/vehicle/twist": "geometry_msgs/msg/TwistStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/traffic/markers": "visualization_msgs/msg/MarkerArray",
    "/planning/path": "nav_msgs/msg/Path",
    "/can": CAN_TYPE,
    "/vehicle/model": foxglove.SCENE_TYPE,
}
# A topic of bags of drives that were filmed.
PICTURES = "/camera/image/compressed"


@functools.cache
def typestore() -> Any:
    """The types of ROS 2 Jazzy and ours; InputError if rosbags is not installed."""
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise InputError("bags need rosbags: pip install 'iits-mj[ros]'") from error
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(CAN_FRAME, CAN_TYPE))
    for name, text in foxglove.DEFINITIONS.items():
        store.register(get_types_from_msg(text, f"foxglove_msgs/msg/{name}"))
    for kind in MESSAGES:
        store.register(get_types_from_msg(definition(kind), type_name(kind)))
    return store


@dataclass(frozen=True)
class Bag:
    """The messages between the modules in a drive, each list in the order of time.

    Attributes:
      options: of the drive, the fields of `DriveConfig`, with names of files; timestep: [s].
      scenes, trajectories: of every plan; decided: answers of the decision maker.
      states, wanted, obeyed: of every command: the state before it, the command of the tracker, and
        the command that reached the truck.
    """

    options: dict[str, Any]
    timestep: float
    scenes: list[Scene]
    trajectories: list[Trajectory]
    decided: list[Decided]
    states: list[EgoState]
    wanted: list[VehicleCommand]
    obeyed: list[VehicleCommand]

    def config(
        self,
        map_path: Path | None = None,
        parts: Collection[str] = tuple(PARTS),
        **changes: Any,
    ) -> DriveConfig:
        """The options of the drive.

        Args:
          map_path: of the drive's map, if it was not the built-in one.
          parts: options of the parts that are used; a shipped part replaces any other own one.
          **changes: options with other values.

        Raises:
          InputError: the bag has other options than `DriveConfig`, or needs a map, a file, or a
            part of the user's own. No code is run because a bag names it.
        """
        known = stored_names()
        if set(self.options) != known:
            other = ", ".join(sorted(set(self.options) ^ known))
            raise InputError(f"the bag was made by a version with other options: {other}")
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
        if changes.get("truck") is None:
            changes["truck"] = truck_of(self.options, "the bag", None)
        for name in parts:
            value = self.options[name]
            if name not in changes and isinstance(value, str) and PARTS[name].is_own(value):
                raise InputError(
                    f"the bag's drive used the {PARTS[name].name} {value}, which a bag does not "
                    f"hold: name it by --{name.replace('_', '-')}"
                )
        return DriveConfig(**{**without_own_parts(self.options), "map": map_path, **changes})


def read_bag(path: Path) -> Bag:
    """Reads a bag from its folder or from the MCAP file in it.

    Raises:
      InputError: rosbags is missing, or `BagWriter` did not write the bag.
    """
    found: dict[str, list[Any]] = {}
    for topic, message in _messages(path):
        found.setdefault(topic, []).append(message)
    wanted = ("/traffic/scene", "/planning/trajectory", "/vehicle/state", "/control/command")
    missing = [topic for topic in ("/drive", *wanted) if topic not in found]
    if missing:
        raise InputError(f"bag {str(path)!r} holds no drive: it lacks {', '.join(missing)}")
    try:
        settings = read_json(found["/drive"][0], f"bag {str(path)!r}: /drive")
        options, timestep = dict(settings["options"]), float(settings["timestep"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"bag {str(path)!r}: /drive does not hold a drive's options") from error
    return Bag(
        options=options,
        timestep=timestep,
        scenes=found["/traffic/scene"],
        trajectories=found["/planning/trajectory"],
        decided=found.get("/decision", []),
        states=found["/vehicle/state"],
        wanted=found["/control/command"],
        obeyed=found.get("/vehicle/command", []),
    )


def _messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Yields topics and messages of our own types and of /drive, in the order of time."""
    store = typestore()
    from rosbags.highlevel import AnyReader

    kinds = {type_name(kind): kind for kind in MESSAGES}
    folder = path.parent if path.suffix == ".mcap" else path
    try:
        with AnyReader([folder], default_typestore=store) as reader:
            chosen = [c for c in reader.connections if c.msgtype in kinds or c.topic == "/drive"]
            for connection, _, data in reader.messages(chosen):
                message = store.deserialize_cdr(data, connection.msgtype)
                kind = kinds.get(connection.msgtype)
                yield connection.topic, message.data if kind is None else decode(message, kind)
    except InputError:
        raise
    except Exception as error:  # on damaged files rosbags raises what its parsers meet
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"bag {str(path)!r} cannot be read: {reason}") from error


class BagWriter(Finishing, Observer):
    """Observer that writes the messages of a simulation to a ROS 2 bag; a context manager.

    The bag holds exactly the messages between the modules: `/traffic/scene` and
    `/planning/trajectory` every 100 ms, `/decision` for every decision, `/control/command`,
    `/vehicle/command` and `/vehicle/state` every 20 ms. Times are those of the simulation, from 0.
    `/drive` holds the options.

    Args:
      folder: of the new bag, with `metadata.yaml` and the MCAP file, as of `ros2 bag`, and a layout
        for Foxglove.
      simulation: at its start.
      video: film of the drive, complete when the bag is closed: its pictures become a topic; a
        missing film is left out.

    Attributes:
      count: number of messages written.

    Raises:
      InputError: rosbags or mjviser is missing, the folder exists or cannot be made, or no stack
        drives.
    """

    # Of the reports on the bus [s].
    period = 0.01
    reads_bus = True

    def __init__(self, folder: Path, simulation: Simulation, video: Path | None = None) -> None:
        self.folder = folder
        self._video = video
        self.count = 0
        self._store = typestore()
        self._stack = simulation.stack
        self._asked = 0
        self._make = self._store.types.__getitem__
        parameters = simulation.truck.parameters
        self._standard = StandardMessages(self._make, parameters)
        self._units = tuple(unit.name for unit in parameters.units)
        models = foxglove.unit_models(parameters, simulation.truck.payload)
        self._sender = TruckSender(simulation.truck.parameters)
        self._writer = _open(folder)
        self._connections = {
            topic: self._writer.add_connection(topic, kind, typestore=self._store)
            for topic, kind in TOPICS.items()
        }
        options = stored_options(simulation.config)
        about = {"version": iits_mj.__version__, "timestep": simulation.timestep}
        text = json.dumps(about | {"options": options})
        self._write("/drive", 0.0, self._standard.text(text))
        self._write("/vehicle/model", 0.0, self._standard.models(models))
        self._truck = simulation.truck

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Writes a scene with its decision and plan, and their standard messages."""
        time, standard = scene.time, self._standard
        plain = dataclasses.replace(scene, vehicles=tuple(scene.vehicles))
        self._write("/traffic/scene", time, encode(plain, self._make))
        self._write("/traffic/markers", time, standard.markers(time, scene.vehicles))
        if self._stack.decisions != self._asked:
            self._asked = self._stack.decisions
            answer = Decided(time, self._stack.last_decision, self._stack.speed_max)
            self._write("/decision", time, encode(answer, self._make))
        self._write("/planning/trajectory", time, encode(trajectory, self._make))
        self._write("/planning/path", time, standard.path(time, trajectory))

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Writes a state and the commands that follow from it."""
        time, standard = ego.time, self._standard
        self._write("/vehicle/state", time, encode(ego, self._make))
        self._write("/vehicle/odometry", time, standard.odometry(ego))
        self._write("/vehicle/twist", time, standard.twist(ego))
        self._write("/tf", time, standard.transforms(ego))
        self._write("/control/command", time, encode(wanted, self._make))
        self._write("/vehicle/command", time, encode(obeyed, self._make))

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Writes the truck's reports that are due on the bus."""
        del simulation
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, self._truck.report()):
            self.sent(report)

    def close(self) -> None:
        """Completes the bag; the drive may go on."""
        if self._writer is None:
            return
        filmed = self._video is not None and self._video.is_file()
        if filmed and self._video is not None:
            self._connections[PICTURES] = self._writer.add_connection(
                PICTURES, "sensor_msgs/msg/CompressedImage", typestore=self._store
            )
            for time, picture in foxglove.pictures(self._video):
                self._write(PICTURES, time, self._standard.picture(time, picture))
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
                layout = foxglove.layout(self._units, pictures=filmed)
                (self.folder / foxglove.LAYOUT).write_text(layout)
            except OSError as error:
                shutil.rmtree(self.folder, ignore_errors=True)
                raise unwritable("bag", self.folder, error) from error

    def abandon(self) -> None:
        """Deletes the unfinished bag."""
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
        try:
            self._writer.write(connection, round(time * 1e9), data)
        except OSError as error:
            raise unwritable("bag", self.folder, error) from error
        self.count += 1


def _open(folder: Path) -> Any:
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        writer = Writer(folder, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.open()
    except (OSError, WriterError) as error:
        raise unwritable("bag", folder, error) from error
    return writer
