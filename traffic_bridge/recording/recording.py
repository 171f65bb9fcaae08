"""Stored configurations and trajectories: columns in SI units, the same in memory and in the file.

Schema (version 2) of the `.npz` file. n frames, m vehicles, k rows (one a vehicle and frame, sorted
by frame and within it by the vehicle's name), c commands:

| array | shape | content |
|---|---|---|
| `meta` | () | JSON text, see below |
| `time` | (n,) | traffic time of the frames [s], increasing; the first is the reset |
| `ego` | (n, e) | the truck's state as given, a column per name in `ego_columns`; NaN: none |
| `ego_columns` | (e,) | names of `EgoState`'s fields, its brake pressures one by one |
| `vehicle_id`, `vehicle_kind` | (m,) | name and kind |
| `vehicle_size` | (m, 3) | length, width, height [m] |
| `frame_start` | (n + 1,) | rows of frame i are `frame_start[i]` to `frame_start[i + 1]` |
| `vehicle` | (k,) | index into the vehicle arrays |
| `lane` | (k,) | index from the right on the ego route, -1 off it |
| `x y z yaw pitch roll yaw_rate speed acceleration lateral_speed station offset` | (k,) | as in |
| | | `TrackedVehicle` |
| `command_time` | (c,) | when the truck got a command [s] |
| `command` | (c, 10) | what it got, a column per field of `VehicleCommand` |
| `truck_hash` | (h,) | of the physics' whole state at each frame, chained; empty without a truck |

`meta` holds `schema`, `mode` ("PureSim", "InterSim"; others cannot be re-run), `seed`, `config`
(`TrafficConfig`), `map_hash`, `map_name`, `net_hash`, `versions`, `digest` (see `PoseDigest`) and,
of a whole drive, `drive`: its options and the versions of the truck.

Version 1 had neither `pitch`, `roll`, `yaw_rate` nor the arrays after `offset`. Such files are read
for replay (see `traffic_bridge.modes.repsim`); they cannot be re-run.
"""

from __future__ import annotations

import dataclasses
import hashlib
import struct
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, TrackedVehicle, VehicleCommand
from traffic_bridge import frame as frames
from traffic_bridge.frame import VehicleFrame
from traffic_bridge.recording.rows import COMMAND_COLUMNS, EGO_COLUMNS, command_of, ego_of, ego_row

SCHEMA = 2
SIZE_COLUMNS = ("length", "width", "height")
COLUMNS = tuple(name for name in frames.COLUMNS if name not in SIZE_COLUMNS)


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A recorded drive: what was asked for, what the truck did, what the others did.

    Attributes:
      meta: see the module's schema.
      time: of the frames [s], shape (n,).
      ids, kinds: of the m vehicles; sizes: length, width, height, shape (m, 3) [m].
      start: rows of frame i are start[i] to start[i + 1], shape (n + 1,).
      vehicle: index of the vehicle of each row, shape (k,).
      lane: of each row, shape (k,).
      columns: figures named by `COLUMNS`, shape (len(COLUMNS), k).
      ego: figures of the truck named by `EGO_COLUMNS`, shape (n, len(EGO_COLUMNS)); NaN: none.
      command_time: [s], shape (c,); commands: shape (c, len(COMMAND_COLUMNS)).
      truck_hash: of the truck's physics at the frames, shape (h,), h at most n.

    The arrays may be mapped from a file. See `of_rows` and `of_frames` for making one.
    """

    meta: dict[str, Any]
    time: FloatArray
    ids: tuple[str, ...]
    kinds: tuple[str, ...]
    sizes: FloatArray
    start: NDArray[np.int64]
    vehicle: NDArray[np.int32]
    lane: NDArray[np.int16]
    columns: FloatArray
    ego: FloatArray
    command_time: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    commands: FloatArray = dataclasses.field(
        default_factory=lambda: np.zeros((0, len(COMMAND_COLUMNS)))
    )
    truck_hash: NDArray[np.uint64] = dataclasses.field(
        default_factory=lambda: np.zeros(0, dtype=np.uint64)
    )

    @classmethod
    def of_rows(
        cls,
        meta: dict[str, Any],
        time: FloatArray,
        ids: Sequence[str],
        kinds: Sequence[str],
        sizes: FloatArray,
        frame: NDArray[Any],
        vehicle: NDArray[Any],
        lane: NDArray[Any],
        columns: FloatArray,
        ego: FloatArray | None = None,
    ) -> Recording:
        """A recording of rows in any order.

        Args:
          meta: what is known; `schema` and `digest` are added.
          time: of the frames, increasing, shape (n,) [s].
          ids: names of the m vehicles.
          kinds: of each, see `TrackedVehicle`.
          sizes: length, width, height, shape (m, 3) [m].
          frame: index of the frame of each row, shape (k,).
          vehicle: index of the vehicle of each row, shape (k,).
          lane: from the right on the route, -1 off it, shape (k,).
          columns: figures named by `COLUMNS`, shape (len(COLUMNS), k).
          ego: figures of the truck, shape (n, len(EGO_COLUMNS)); default: no truck.

        Raises:
          InputError: shapes do not fit, a vehicle is twice in a frame, a figure is not finite.
        """
        frame, vehicle = np.asarray(frame, dtype=np.int64), np.asarray(vehicle, dtype=np.int64)
        order = np.lexsort((ranks(ids)[vehicle], frame))
        counts = np.bincount(frame, minlength=len(time))
        made = cls(
            meta={**meta, "schema": SCHEMA},
            time=np.asarray(time, dtype=np.float64),
            ids=tuple(ids),
            kinds=tuple(kinds),
            sizes=np.asarray(sizes, dtype=np.float64).reshape(-1, 3),
            start=np.concatenate(([0], np.cumsum(counts))).astype(np.int64),
            vehicle=vehicle[order].astype(np.int32),
            lane=np.asarray(lane)[order].astype(np.int16),
            columns=np.asarray(columns, dtype=np.float64)[:, order],
            ego=np.full((len(time), len(EGO_COLUMNS)), np.nan) if ego is None else ego,
        )
        made.check("recording")
        made.meta["digest"] = made.digest()
        return made

    @classmethod
    def of_frames(
        cls,
        meta: dict[str, Any],
        time: FloatArray,
        vehicles: Sequence[Iterable[TrackedVehicle]],
        egos: Sequence[EgoState | None] | None = None,
    ) -> Recording:
        """A recording of frames, one a time; see `of_rows`."""
        given = [VehicleFrame.of(each) for each in vehicles]
        index: dict[tuple[str, tuple[float, ...]], int] = {}
        rows = [
            (name, kind, tuple(size))
            for each in given
            for name, kind, size in zip(
                each.ids, each.kinds, each.columns(*SIZE_COLUMNS).T.tolist(), strict=True
            )
        ]
        kinds: list[str] = []
        for name, kind, size in rows:
            if (name, size) not in index:
                index[name, size] = len(kinds)
                kinds.append(kind)
        return cls.of_rows(
            meta,
            time,
            [name for name, _ in index],
            kinds,
            np.array([size for _, size in index]).reshape(-1, 3),
            np.repeat(np.arange(len(given)), [len(each) for each in given]),
            np.array([index[name, size] for name, _, size in rows], dtype=np.int64),
            np.concatenate([np.zeros(0, dtype=np.int64), *(each.lanes for each in given)]),
            np.concatenate(
                [np.zeros((len(COLUMNS), 0)), *(each.columns(*COLUMNS) for each in given)], axis=1
            ),
            None if egos is None else np.array([ego_row(ego) for ego in egos]),
        )

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.time)

    @cached_property
    def frames(self) -> Frames:
        """The vehicles per frame, made when asked for."""
        return Frames(self)

    @property
    def egos(self) -> tuple[EgoState | None, ...]:
        """The truck's state per frame, None where there was none."""
        return tuple(self.ego_at(k) for k in range(len(self)))

    def ego_at(self, k: int) -> EgoState | None:
        """The truck's state at frame k, None where there was none."""
        return ego_of(self.ego[k])

    def command_at(self, k: int) -> VehicleCommand:
        """The k-th command that the truck got."""
        return command_of(self.commands[k])

    def digest(self) -> str:
        """The hash of all poses, see `PoseDigest`."""
        digest = PoseDigest()
        for each in self.frames:
            digest.add(each)
        return digest.hexdigest()

    def check(self, name: str) -> None:
        """Holds the arrays against each other; see `traffic_bridge.recording.file`."""
        from traffic_bridge.recording.file import check_arrays

        check_arrays(self, name)

    def save(self, path: str | Path) -> Path:
        """Writes the file; the ending `.npz` is added where it is missing.

        The file takes its place when it is complete.

        Raises:
          InputError: the file cannot be written.
        """
        from traffic_bridge.recording.file import write

        return write(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Reads a file.

        Raises:
          InputError: it is missing, damaged, of an unknown schema, or has unusable values.
        """
        from traffic_bridge.recording.file import read

        return read(Path(path))


class Frames(Sequence[VehicleFrame]):
    """The frames of a recording, each made when it is asked for."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def __len__(self) -> int:
        return len(self._recording.time)

    @overload
    def __getitem__(self, index: int) -> VehicleFrame: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[VehicleFrame, ...]: ...
    def __getitem__(self, index: int | slice) -> VehicleFrame | tuple[VehicleFrame, ...]:
        if isinstance(index, slice):
            return tuple(self._at(k) for k in range(*index.indices(len(self))))
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._at(index % len(self))

    def __iter__(self) -> Iterator[VehicleFrame]:
        return (self._at(k) for k in range(len(self)))

    def _at(self, k: int) -> VehicleFrame:
        recording = self._recording
        rows = slice(int(recording.start[k]), int(recording.start[k + 1]))
        who = recording.vehicle[rows]
        picks = who.tolist()
        columns = np.concatenate((recording.columns[:, rows], recording.sizes[who].T))
        return VehicleFrame(
            [recording.ids[v] for v in picks],
            [recording.kinds[v] for v in picks],
            recording.lane[rows].astype(np.intp),
            columns,
        )


def ranks(ids: Sequence[str]) -> NDArray[np.int64]:
    """Place of each name in the sorted list of names, shape (m,); one name has one rank."""
    places = {name: place for place, name in enumerate(sorted(set(ids)))}
    return np.array([places[name] for name in ids], dtype=np.int64)


# --- The hash of a traffic's course: two runs with one hash had every vehicle at the same places


class PoseDigest:
    """SHA-256 over every vehicle's name, kind, lane and figures, frame after frame.

    Bits count, not values: a difference in the last place of one number gives another hash.

    Attributes:
      count: frames added.
    """

    def __init__(self) -> None:
        self.count = 0
        self._hash = hashlib.sha256()

    def add(self, vehicles: Iterable[TrackedVehicle]) -> None:
        """Adds a frame."""
        frame = VehicleFrame.of(vehicles)
        self._hash.update(struct.pack("<I", len(frame)))
        self._hash.update("\0".join((*frame.ids, *frame.kinds)).encode())
        self._hash.update(np.ascontiguousarray(frame.lanes, dtype="<i4").tobytes())
        self._hash.update(np.ascontiguousarray(frame.values, dtype="<f8").tobytes())
        self.count += 1

    def hexdigest(self) -> str:
        """The digest so far."""
        return self._hash.hexdigest()
