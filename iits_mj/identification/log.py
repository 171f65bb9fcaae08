"""A recorded drive as columns in SI units, read from the telemetry's CSV.

The header of a column is `name [unit]`. Needed are time, speed, grade, gear, engine torque, engine
speed and the five brake pressures; the rest is used where it is present.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from iits_mj.errors import InputError
from iits_mj.units import RPM

FloatArray = NDArray[np.float64]

PRESSURES = tuple(
    f"brake_pressure_{place}"
    for place in ("front_left", "front_right", "rear_left", "rear_right", "trailer")
)
NEEDED = ("time", "speed", "grade", "gear", "engine_torque", *PRESSURES)
OPTIONAL = (
    "shift_in_process",
    "command_xbr_demand",
    "command_xbr_mode",
    "yaw_rate",
    "road_wheel_angle",
    "steering_wheel_angle",
)
_TO_SI = {"": 1.0, "-": 1.0, "rpm": RPM, "kPa": 1e3, "km/h": 1.0 / 3.6, "deg": np.pi / 180.0}


@dataclass(frozen=True)
class Log:
    """Columns of a drive, each of shape (n,), SI units, time strictly increasing.

    Attributes:
      columns: name to values; `NEEDED` are always there, `OPTIONAL` when the file has them.
    """

    columns: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        missing = [name for name in NEEDED if name not in self.columns]
        if missing:
            raise InputError(f"the log lacks the column {missing[0]!r}; needed are {list(NEEDED)}")
        length = len(self.columns["time"])
        if length < 50:
            raise InputError(f"the log has {length} rows: at least 50 are wanted")
        for name, values in self.columns.items():
            if len(values) != length or not np.isfinite(values).all():
                raise InputError(f"column {name!r} of the log has gaps or is not finite")
        if np.any(np.diff(self.columns["time"]) <= 0.0):
            raise InputError("the log's time must increase from row to row")

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    @classmethod
    def from_csv(cls, path: str | Path) -> Log:
        """Reads a telemetry table.

        Raises:
          InputError: unreadable file, missing column, a cell of a used column that is no number.
        """
        wanted = {*NEEDED, *OPTIONAL}
        try:
            with Path(path).open(newline="", encoding="utf-8") as file:
                rows = list(csv.reader(file))
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"log {str(path)!r} cannot be read: {error}") from error
        if not rows:
            raise InputError(f"log {str(path)!r} is empty")
        columns = {}
        for index, title in enumerate(rows[0]):
            name, _, unit = title.partition("[")
            name = name.strip()
            if name in wanted:
                columns[name] = _column(rows[1:], index, name) * _TO_SI.get(unit.strip(" ]"), 1.0)
        return cls(columns)


def _column(rows: list[list[str]], index: int, name: str) -> FloatArray:
    try:
        return np.array([float(row[index]) for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(f"column {name!r} of the log has a cell that is no number") from error
