"""Recorder: runs a traffic and records it together with the truck's states and commands."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, RoadSignals, TrafficLight, VehicleCommand
from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.modes.event_sim import EventSim, Repeatable
from traffic_bridge.modes.sumo_modes import Mode, PureSim
from traffic_bridge.network.nets import build_network
from traffic_bridge.own_traffic import OwnTraffic
from traffic_bridge.recording.provenance import net_hash, versions
from traffic_bridge.recording.recording import PoseDigest, Recording
from traffic_bridge.recording.rows import (
    COLUMNS,
    COMMAND_COLUMNS,
    EGO_COLUMNS,
    SCHEMA,
    SIZE_COLUMNS,
    command_row,
    ego_row,
)
from traffic_bridge.scenario.runner import Scenario
from traffic_bridge.signals.controller import TrafficController

PIECE = 1 << 20  # bytes of a table that are held in memory
GROWTH = 256  # number of vehicles by which the tables of vehicles grow
_ROW = np.dtype([("vehicle", "i4"), ("lane", "i2"), ("figures", "f8", (len(COLUMNS),))])
_COMMAND = np.dtype([("time", "f8"), ("figures", "f8", (len(COMMAND_COLUMNS),))])
_HASH = np.dtype([("hash", "u8")])


class SpillTable:
    """A growing array of one record type that keeps full pieces in a temporary file.

    Args:
      dtype: of a row, a structured type.

    Raises:
      InputError: the file in the folder for temporary files cannot be written (the disk is full).
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        self._piece = np.zeros(max(1, PIECE // dtype.itemsize), dtype=dtype)
        self._used = 0
        self._written = 0
        self._file: Any = None

    def __len__(self) -> int:
        return self._written + self._used

    def room(self, count: int) -> NDArray[Any]:
        """The next `count` rows, zeroed; the caller fills them in place before the next call."""
        if self._used + count > len(self._piece):
            self._flush()
            if count > len(self._piece):
                self._piece = np.zeros(count, dtype=self.dtype)
        rows = self._piece[self._used : self._used + count]
        self._used += count
        return rows

    def append(self, row: tuple[Any, ...]) -> None:
        """Adds one row; after an interrupt it is either complete or missing."""
        if self._used == len(self._piece):
            self._flush()
        self._piece[self._used] = row
        self._used += 1

    def array(self) -> NDArray[Any]:
        """All rows, shape (n,); those in the file are memory-mapped."""
        if self._written == 0:
            return self._piece[: self._used].copy()
        self._flush()
        return np.memmap(self._file, dtype=self.dtype, mode="r", shape=(self._written,))

    def clear(self) -> None:
        """Drops all rows; arrays that were returned before stay valid."""
        self._piece[:] = 0
        self._used = self._written = 0
        if self._file is not None:
            self._file.close()
            self._file = None

    def _flush(self) -> None:
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(prefix="iits_mj_recording_")  # noqa: SIM115
            self._file.write(self._piece[: self._used].tobytes())
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"the recording cannot be stored in {tempfile.gettempdir()}: {error.strerror}; "
                "set TMPDIR to a folder with free space"
            ) from error
        self._written += self._used
        self._piece[:] = 0
        self._used = 0


def _frame_type(width: int) -> np.dtype[Any]:
    """Type of a frame's row with this number of columns of the truck's state."""
    return np.dtype([("time", "f8"), ("count", "i8"), ("ego", "f8", (width,))])


class Recorder(Mode):
    """Runs another mode and records it, with the truck's states and commands.

    Long drives need little memory, because the data are in a temporary file.

    Args:
      traffic: a PureSim, InterSim or EventSim, which can be run again, or your own, which can be
        replayed.

    Attributes:
      drive: data (JSON) that the re-run of a whole drive needs besides the traffic.
    """

    def __init__(self, traffic: Repeatable | OwnTraffic) -> None:
        self.traffic = traffic
        self.route = traffic.route
        self.drive: dict[str, Any] | None = None
        self._net = ""
        self._tables = {
            "frame": SpillTable(_frame_type(len(EGO_COLUMNS))),
            "row": SpillTable(_ROW),
            "command": SpillTable(_COMMAND),
            "truck": SpillTable(_HASH),
        }
        self._clear()

    def _clear(self) -> None:
        self._digest = PoseDigest()
        self._signals: list[tuple[int, RoadSignals]] = []
        for table in self._tables.values():
            table.clear()
        self._index: dict[str, int] = {}
        self._ids: list[str] = []
        self._kinds: list[str] = []
        self._sizes = np.zeros((GROWTH, len(SIZE_COLUMNS)))
        self._last_ids: tuple[str, ...] = ()
        self._last = np.zeros(0, dtype=np.intp)

    @property
    def time(self) -> float:
        """Traffic time since the reset [s]."""
        return self.traffic.time

    def reset(self, ego: EgoState | None = None) -> VehicleFrame:
        """Resets the traffic and drops the recorded data."""
        self._clear()
        truck = ego_row(ego)
        self._tables["frame"] = SpillTable(_frame_type(len(truck)))
        frame = self._note(truck, self.traffic.reset(ego))
        if isinstance(self.traffic, PureSim):
            self._net = self._net or net_hash(build_network(self.route, whole=False).path)
        return frame

    def step(self, ego: EgoState | None = None) -> VehicleFrame:
        """Steps the traffic and records truck and vehicles."""
        truck = ego_row(ego)
        return self._note(truck, self.traffic.step(ego))

    def signal_controller(self) -> TrafficController | None:
        """Returns the lights and changing limits of the traffic."""
        return self.traffic.signal_controller()

    def running_scenario(self) -> Scenario | None:
        """Returns the running events of the traffic."""
        return self.traffic.running_scenario()

    def note_command(self, time: float, command: VehicleCommand) -> None:
        """Records a command that reaches the truck.

        Args:
          time: since the reset, later than that of the last command [s].
          command: to record.

        Raises:
          InputError: a value is not finite.
        """
        self._tables["command"].append((time, command_row(command)))

    def note_truck(self, state_hash: int) -> None:
        """Records the hash of the truck's physics at the last frame, below 2^64."""
        self._tables["truck"].append((state_hash,))

    def note_signals(self, signals: RoadSignals) -> None:
        """Records the traffic lights at the last frame, if they have changed."""
        light = signals.light and TrafficLight(signals.light.station, signals.light.state)
        shown = RoadSignals(light, lamps=signals.lamps)
        if shown != (self._signals[-1][1] if self._signals else RoadSignals()):
            self._signals.append((self._digest.count - 1, shown))

    def _note(self, truck: tuple[float, ...], vehicles: VehicleFrame) -> VehicleFrame:
        table = self._tables["frame"]
        if table.dtype["ego"].shape != (len(truck),):
            raise InputError("a truck of several couplings must be given from the reset on")
        frame = VehicleFrame.of(vehicles)
        rows = self._tables["row"].room(len(frame))
        rows["vehicle"] = self._indices(frame)
        rows["lane"] = frame.lanes
        rows["figures"] = frame.values[:, : len(COLUMNS)]
        self._digest.add(frame)
        table.append((self.traffic.time, len(frame), truck))
        return frame

    def _indices(self, frame: VehicleFrame) -> NDArray[np.intp]:
        """Indices of a frame's vehicles in the list of vehicles; adds the new ones."""
        sizes = frame.values[:, len(COLUMNS) :]
        if frame.ids == self._last_ids and np.array_equal(sizes, self._sizes[self._last]):
            return self._last
        known = np.array([self._index.get(name, -1) for name in frame.ids], dtype=np.intp)
        # The same name with another size is another vehicle.
        new = (known < 0) | (self._sizes[known] != sizes).any(axis=1)
        for k in np.flatnonzero(new).tolist():
            known[k] = self._index[frame.ids[k]] = len(self._ids)
            self._add(frame.ids[k], frame.kinds[k], sizes[k])
        self._last_ids, self._last = frame.ids, known
        return known

    def _add(self, name: str, kind: str, size: NDArray[np.float64]) -> None:
        if len(self._ids) == len(self._sizes):
            more = np.zeros((len(self._sizes) + GROWTH, len(SIZE_COLUMNS)))
            more[: len(self._sizes)] = self._sizes
            self._sizes = more
        self._sizes[len(self._ids)] = size
        self._ids.append(name)
        self._kinds.append(kind)

    @property
    def recording(self) -> Recording:
        """The recording up to now."""
        frame, row, command, truck = (table.array() for table in self._tables.values())
        counts = np.asarray(frame["count"])
        start = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
        # After an interrupt the last frame may be incomplete.
        row = row[: start[-1]]
        made = Recording(
            meta=self._meta(),
            time=np.array(frame["time"]),
            ids=tuple(self._ids),
            kinds=tuple(self._kinds),
            sizes=self._sizes[: len(self._ids)].copy(),
            start=start,
            vehicle=row["vehicle"],
            lane=row["lane"],
            columns=row["figures"].T,
            ego=frame["ego"],
            command_time=command["time"],
            commands=command["figures"],
            truck_hash=truck["hash"][: len(counts)],
            signals=tuple(self._signals),
        )
        whole = self._digest.count == len(counts)
        made.meta["digest"] = self._digest.hexdigest() if whole else made.digest()
        return made

    def _meta(self) -> dict[str, Any]:
        road_map = self.route.road_map
        traffic = self.traffic
        sumo: dict[str, Any] = {}
        if isinstance(traffic, (PureSim, EventSim)):
            sumo = {"seed": traffic.seed, "config": traffic.config.as_dict()}
        meta: dict[str, Any] = {
            "schema": SCHEMA,
            "mode": traffic.mode,
            **sumo,
            "map_hash": road_map.content_hash,
            "map_name": road_map.path.name,
            "net_hash": self._net,
            "versions": versions(),
        }
        return meta if self.drive is None else {**meta, "drive": self.drive}

    def save(self, path: str | Path) -> Path:
        """Writes the recording; see `Recording.save`."""
        return self.recording.save(path)

    def close(self) -> None:
        """Ends the traffic; the recorded data stay."""
        self.traffic.close()
