"""Writes a drive into a bag while it is driven."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any, Final

import iits_mj
from iits_mj.bag.own_types import Decided, encode
from iits_mj.bag.standard import Standard
from iits_mj.bag.store import TOPICS, typestore
from iits_mj.closing import Finishing
from iits_mj.errors import InputError
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939.truck_sender import TruckSender
from iits_mj.messages import EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.simulation.drive_log import stored_options
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.loop import Simulation

# Of the bag's own format.
VERSION: Final = 9
_CAN_PERIOD = 0.01


class BagWriter(Finishing):
    """A tap and an observer that writes a ROS 2 bag; used as a context manager.

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
        self._simulation = simulation
        simulation.listen(self)
        simulation.path.listen(self._on_bus)

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

    def observe(self, simulation: Simulation, frame: Frame) -> None:
        """Writes the truck's reports on the bus that are due."""
        state = dataclasses.replace(frame.ego, time=round(frame.time, 6))
        for report in self._sender.frames(state, simulation.truck.report()):
            self._on_bus(report)

    def close(self) -> None:
        """Finishes the bag; the drive may go on."""
        if self._writer is not None:
            self._leave()
            self._writer.close()
            self._writer = None

    def abandon(self) -> None:
        """Leaves no bag behind."""
        if self._writer is not None:
            self._leave()
            self._writer.abort()
            self._writer = None
            shutil.rmtree(self.folder, ignore_errors=True)

    def _leave(self) -> None:
        self._simulation.forget(self)
        self._simulation.path.forget(self._on_bus)

    def _on_bus(self, frame: BusFrame) -> None:
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
