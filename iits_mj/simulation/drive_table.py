"""The columns of a drive in memory: of its telemetry, of a telemetry file, or of a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.core import tables
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.units import RPM
from iits_mj.simulation.telemetry import COLUMNS, STATION, TIME, Telemetry
from traffic_bridge import Recording
from traffic_bridge.recording.rows import ego_columns

# SI values of a recording over values of the telemetry, by the unit of the column.
_SI = {"rpm": RPM, "kPa": 1e3}


@dataclass(frozen=True)
class DriveTable:
    """Columns of a drive by name and unit, such as "speed [m/s]"; each of shape (n,), n > 0.

    Text and missing values, such as the gap to a missing vehicle, are NaN; the time increases.
    """

    columns: Mapping[str, FloatArray]

    @classmethod
    def of(cls, telemetry: Telemetry) -> DriveTable:
        """The columns of a telemetry that observed a drive."""
        values = {name: telemetry.column(name) for name in telemetry.names}
        return cls({n: np.where(np.isfinite(v), v, np.nan) for n, v in values.items()})

    @classmethod
    def read(cls, path: Path) -> DriveTable:
        """Reads `telemetry.csv`, or the truck's states of a recording (`.npz`).

        Raises:
          InputError: the file cannot be read, or holds no drive.
        """
        made = cls._of_recording(path) if path.suffix == ".npz" else cls._of_csv(path)
        time = made.columns[TIME]
        if not len(time):
            raise InputError(f"{str(path)!r} has no row of a drive")
        if not np.isfinite(time).all() or (np.diff(time) <= 0.0).any():
            raise InputError(f"{str(path)!r}: the column {TIME!r} must increase from row to row")
        if not np.isfinite(made.columns[STATION]).all():
            raise InputError(f"{str(path)!r}: the column {STATION!r} has gaps")
        return made

    @classmethod
    def _of_csv(cls, path: Path) -> DriveTable:
        names, rows = tables.read_table(path, "telemetry")
        missing = [name for name in (TIME, STATION) if name not in names]
        if missing:
            raise InputError(
                f"telemetry {str(path)!r} lacks the column {missing[0]!r}: a telemetry.csv of "
                "'iits-mj drive' is needed"
            )
        short = next((i for i, row in enumerate(rows) if len(row) != len(names)), None)
        if short is not None:
            raise InputError(
                f"telemetry {str(path)!r}: row {short + 1} has {len(rows[short])} cells, must have "
                f"{len(names)}"
            )
        columns = zip(*rows, strict=True) if rows else ([] for _ in names)
        return cls(
            {
                n: np.array([_number(c) for c in cells])
                for n, cells in zip(names, columns, strict=True)
            }
        )

    @classmethod
    def _of_recording(cls, path: Path) -> DriveTable:
        recording = Recording.load(path)
        present = ~np.isnan(recording.ego[:, 0])
        ego = dict(zip(ego_columns(recording.ego.shape[1]), recording.ego[present].T, strict=True))
        columns = {TIME: recording.time[present]}
        for name in COLUMNS:
            base, _, unit = name.rstrip("]").partition(" [")
            if base in ego and name != TIME:
                columns[name] = np.array(ego[base]) / _SI.get(unit, 1.0)
        number = 2
        while f"rear_articulation{number}" in ego:
            columns[f"articulation{number} [rad]"] = np.array(ego[f"rear_articulation{number}"])
            number += 1
        return cls(columns)

    def __len__(self) -> int:
        return len(self.columns[TIME])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def column(self, name: str) -> FloatArray:
        """Returns one column.

        Raises:
          InputError: there is none of this name.
        """
        if name not in self.columns:
            raise InputError(f"the drive has no column {name!r}; it has {', '.join(self.columns)}")
        return self.columns[name]

    def thinned(self, rows: int) -> DriveTable:
        """Returns the drive with at most this number of rows, without loss of an extreme value.

        Several rows become two: of the same span, one has the least and one the greatest value of
        each column, in their order. Time, station and pose are those of the first and last row.
        """
        count = len(self)
        if count <= rows:
            return self
        size = math.ceil(2 * count / rows)
        starts = np.arange(0, count, size)
        ends = np.minimum(starts + size, count) - 1
        plain = np.column_stack((starts, ends)).ravel()
        kept = {}
        for name, values in self.columns.items():
            if name in _PLAIN:
                kept[name] = values[plain]
                continue
            padded = np.full(len(starts) * size, np.nan)
            padded[:count] = values
            blocks = padded.reshape(-1, size)
            empty = np.isnan(blocks)
            low = np.argmin(np.where(empty, np.inf, blocks), axis=1) + starts
            high = np.argmax(np.where(empty, -np.inf, blocks), axis=1) + starts
            kept[name] = values[np.sort(np.column_stack((low, high)), axis=1).ravel()]
        return DriveTable(kept)


# Columns that place the truck; two of them from different rows would not be a place.
_PLAIN = (TIME, STATION, "x [m]", "y [m]", "z [m]", "yaw [rad]", "offset [m]")


def _number(cell: str) -> float:
    """The number of a cell; NaN for text, an empty cell and infinity."""
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
