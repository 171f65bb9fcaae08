"""Recorded drives: settings and trajectories as columns in SI units, in memory and in files.

`docs/traffic_data.md` describes the arrays of the `.npz` file, version 2. `meta` holds `schema`,
`mode` ("PureSim", "InterSim", or the name of the user's traffic), `seed`, `config`
(`TrafficConfig`), `map_hash`, `map_name`, `net_hash`, `versions`, `digest` (see `PoseDigest`) and,
for a whole drive, `drive`: its options and the versions of the truck.

Version 1 had neither `pitch`, `roll`, `yaw_rate` nor the arrays after `offset`. Such files are read
for replay (see `traffic_bridge.modes.repsim`); they cannot be re-run.
"""

from __future__ import annotations

import dataclasses
import hashlib
import struct
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, RoadSignals, TrackedVehicle, VehicleCommand
from iits_mj.core.vehicles import VehicleFrame
from traffic_bridge.recording import file
from traffic_bridge.recording.rows import (
    COLUMNS,
    COMMAND_COLUMNS,
    EGO_COLUMNS,
    SCHEMA,
    SIZE_COLUMNS,
    command_of,
    ego_columns,
    ego_of,
)
from traffic_bridge.vehicles.types import ALL_KINDS

PIECE = 1 << 18  # rows that are checked at a time, so that a mapped file is not read whole


@dataclasses.dataclass(frozen=True, eq=False)
class Recording:
    """A recorded drive: its settings, the truck's states and commands, and the other vehicles.

    Attributes:
      meta: see the module.
      time: of the frames [s], shape (n,).
      ids, kinds: of the m vehicles; sizes: length, width, height, shape (m, 3) [m].
      start: rows of frame i are start[i] to start[i + 1], shape (n + 1,).
      vehicle: index of the vehicle of each row, shape (k,).
      lane: of each row, shape (k,).
      columns: the values named by `COLUMNS`, shape (len(COLUMNS), k).
      ego: the truck's values named by `ego_columns`, shape (n, columns); NaN: no truck.
      command_time: [s], shape (c,); commands: shape (c, len(COMMAND_COLUMNS)).
      truck_hash: of the truck's physics at the frames, shape (h,), h at most n.
      signals: frame and state of the traffic lights from it on, in the order of the frames; empty
        in recordings of earlier versions and of traffic alone.

    The arrays may be mapped from a file. `of_rows` and `of_frames` make recordings.
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
    signals: tuple[tuple[int, RoadSignals], ...] = ()

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
    ) -> Recording:
        """A recording of rows in any order, without a truck.

        Args:
          meta: see the module; `schema` and `digest` are added.
          time: of the frames, increasing, shape (n,) [s].
          ids: names of the m vehicles.
          kinds: of each, see `TrackedVehicle`.
          sizes: length, width, height, shape (m, 3) [m].
          frame: index of the frame of each row, shape (k,).
          vehicle: index of the vehicle of each row, shape (k,).
          lane: from the outside on the route, -1 off it, shape (k,).
          columns: the values named by `COLUMNS`, shape (len(COLUMNS), k).

        Raises:
          InputError: shapes do not fit, a vehicle is twice in a frame, a value is not finite.
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
            ego=np.full((len(time), len(EGO_COLUMNS)), np.nan),
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
    ) -> Recording:
        """A recording of frames, one for each time; see `of_rows`."""
        given = [VehicleFrame.of(each) for each in vehicles]
        rows = [
            (name, kind, tuple(size))
            for each in given
            for name, kind, size in zip(
                each.ids, each.kinds, each.columns(*SIZE_COLUMNS).T.tolist(), strict=True
            )
        ]
        # The same name with another size is another vehicle.
        index = {row: k for k, row in enumerate(dict.fromkeys(rows))}
        return cls.of_rows(
            meta,
            time,
            [name for name, _, _ in index],
            [kind for _, kind, _ in index],
            np.array([size for _, _, size in index]).reshape(-1, 3),
            np.repeat(np.arange(len(given)), [len(each) for each in given]),
            np.array([index[row] for row in rows], dtype=np.int64),
            np.concatenate([np.zeros(0, dtype=np.int64), *(each.lanes for each in given)]),
            np.concatenate(
                [np.zeros((len(COLUMNS), 0)), *(each.columns(*COLUMNS) for each in given)], axis=1
            ),
        )

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.time)

    @cached_property
    def frames(self) -> Frames:
        """The vehicles of each frame."""
        return Frames(self)

    def ego_at(self, k: int) -> EgoState | None:
        """The truck's state at frame k, None without a truck."""
        return ego_of(self.ego[k])

    def command_at(self, k: int) -> VehicleCommand:
        """The k-th command."""
        return command_of(self.commands[k])

    def signals_at(self, k: int) -> RoadSignals:
        """The lights at frame k: `light` without its next switch, and `lamps`."""
        place = bisect_right(self.signals, k, key=lambda change: change[0])
        return self.signals[place - 1][1] if place else RoadSignals()

    def digest(self) -> str:
        """The hash of all poses, see `PoseDigest`."""
        digest = PoseDigest()
        for each in self.frames:
            digest.add(each)
        return digest.hexdigest()

    def check(self, name: str) -> None:
        """Checks that the arrays fit together and all values are finite.

        Raises:
          InputError: says which array of the recording `name` is wrong and where.
        """
        n, m, k = len(self.time), len(self.ids), self.columns.shape[-1]
        for array, shape, what in (
            (self.time, (n,), "time"),
            (self.kinds, (m,), "vehicle_kind"),
            (self.sizes, (m, 3), "vehicle_size"),
            (self.start, (n + 1,), "frame_start"),
            (self.vehicle, (k,), "vehicle"),
            (self.lane, (k,), "lane"),
            (self.columns, (len(COLUMNS), k), "columns"),
            (self.ego, (n, *np.shape(self.ego)[1:2]), "ego"),
            (self.commands, (len(self.command_time), len(COMMAND_COLUMNS)), "command"),
        ):
            found = np.shape(array)
            if found != shape:
                raise InputError(f"{name}: {what} has the shape {found}, must be {shape}")
        try:
            ego_columns(self.ego.shape[1])
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        for array, what in (
            (self.time, "time"),
            (self.sizes, "vehicle_size"),
            (self.command_time, "command_time"),
            (self.commands, "command"),
        ):
            _check_finite(array, name, what)
        for times, what in ((self.time, "time"), (self.command_time, "command_time")):
            if (np.diff(times) <= 0.0).any():
                place = int(np.argmax(np.diff(times) <= 0.0)) + 1
                raise InputError(
                    f"{name}: {what} does not increase: [{place}] = {times[place]:g} s after "
                    f"{times[place - 1]:g} s"
                )
        if (self.sizes <= 0.0).any():
            raise InputError(f"{name}: vehicle_size has values that are not positive")
        unknown = sorted(set(self.kinds) - set(ALL_KINDS))
        if unknown:
            raise InputError(
                f"{name}: vehicle_kind {unknown[0]!r}: allowed are {', '.join(ALL_KINDS)}"
            )
        self._check_rows(name, m, k)
        absent, infinite = np.isnan(self.ego), np.isinf(self.ego).any(axis=1)
        wrong = (absent.any(axis=1) & ~absent.all(axis=1)) | infinite
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(f"{name}: ego has values that are not finite in frame {row}")

    def _check_rows(self, name: str, m: int, k: int) -> None:
        start = self.start
        if len(start) and (start[0] != 0 or start[-1] != k or (np.diff(start) < 0).any()):
            raise InputError(f"{name}: frame_start does not fit the other arrays")
        for column, values in zip(COLUMNS, self.columns, strict=True):
            _check_finite(values, name, column)
        rank, first = ranks(self.ids), np.zeros(k + 1, dtype=bool)
        first[start] = True
        before = -1
        for low in range(0, k, PIECE):
            vehicle = np.asarray(self.vehicle[low : low + PIECE])
            if vehicle.min() < 0 or vehicle.max() >= m:
                raise InputError(f"{name}: vehicle has an index that is not 0 to {m - 1}")
            place = np.concatenate(([before], rank[vehicle]))
            bad = (np.diff(place) <= 0) & ~first[low : low + len(vehicle)]
            if bad.any():
                row = int(np.argmax(bad))
                raise InputError(
                    f"{name}: vehicle {self.ids[vehicle[row]]!r} is twice in a frame, or a frame "
                    f"is not sorted by name (row {low + row})"
                )
            before = int(place[-1])

    def save(self, path: str | Path) -> Path:
        """Writes a file and returns its path; a missing ending `.npz` is added.

        An existing file is replaced when the new one is complete.

        Raises:
          InputError: the file cannot be written.
        """
        return file.write(vars(self), Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Reads a file.

        Raises:
          InputError: it is missing, damaged, of an unknown schema, or has unusable values.
        """
        made = cls(**file.read(Path(path)))
        made.check(f"recording {path}")
        return made


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
    """Rank of each name in the sorted list of names, shape (m,); equal names have equal ranks."""
    places = {name: place for place, name in enumerate(sorted(set(ids)))}
    return np.array([places[name] for name in ids], dtype=np.int64)


def _check_finite(values: NDArray[Any], name: str, what: str) -> None:
    for low in range(0, len(values), PIECE):
        if not np.isfinite(values[low : low + PIECE]).all():
            raise InputError(f"{name}: column {what!r} has values that are not finite")


class PoseDigest:
    """SHA-256 over every vehicle's name, kind, lane and values, frame after frame.

    Two runs with the same hash are bit-identical.

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
