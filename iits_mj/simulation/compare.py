"""Two drives side by side: figures, configuration, and where they part."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core import options
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.units import DIESEL_DENSITY, KMH
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_table import DriveTable
from iits_mj.simulation.telemetry import STATION, TIME
from traffic_bridge import Recording

TELEMETRY, SUMMARY, FILM = "telemetry.csv", "summary.json", "drive.mp4"
# Settings that name outputs, and what differs between any two drives: they do not change a drive.
_OUTPUTS = (
    *(
        "out",
        "video",
        "size",
        "camera",
        "fps",
        "weather",
        "can log",
        "bag",
        "xosc",
        "osi",
        "replay",
        "json",
    ),
    *("command line", "date", "telemetry sha256"),
)
_SAME_TIME = 1e-6  # of two rows [s]
# A table has nine digits, a recording all of them: below this share, they may be equal.
_ROUNDING = 1e-8
_VISIBLE = 0.01  # share of a column's range
_SHORTEST = 10.0  # way for which a consumption is computed [m]


@dataclass(frozen=True)
class Run:
    """A drive to compare.

    Attributes:
      name: the path that the user gave; drive: its columns; rounded: whether they have nine digits.
      settings, origin: names and values in words; empty when they are not stored.
      film: of the drive, None without one.
    """

    name: str
    drive: DriveTable
    rounded: bool
    settings: Mapping[str, str]
    origin: Mapping[str, str]
    film: Path | None = None

    @classmethod
    def read(cls, path: Path) -> Run:
        """Reads the output folder of a drive, a telemetry table (.csv) or a recording (.npz).

        Raises:
          InputError: there is none, or it cannot be read.
        """
        if not path.exists():
            raise InputError(f"{str(path)!r} does not exist: name an output folder, .csv or .npz")
        if path.is_dir():
            if not (path / TELEMETRY).is_file():
                raise InputError(
                    f"folder {str(path)!r} has no {TELEMETRY}: it is no output of 'iits-mj drive'"
                )
            return cls._of_table(path / TELEMETRY, str(path))
        if path.suffix == ".csv":
            return cls._of_table(path, str(path))
        if path.suffix != ".npz":
            raise InputError(f"{str(path)!r} is no output folder, .csv or .npz")
        drive, meta = DriveTable.read(path), Recording.load(path).meta
        stored = meta.get("drive") or {}
        rules = {field.name: options.of(field) for field in fields(DriveConfig)}
        settings = {
            name.replace("_", " "): rule.text(value)
            for name, value in stored.get("options", {}).items()
            if value is not None and (rule := rules.get(name)) is not None
        }
        versions = {**meta.get("versions", {}), **stored.get("versions", {})}
        return cls(str(path), drive, False, settings, {k: str(v) for k, v in versions.items()})

    @classmethod
    def _of_table(cls, path: Path, name: str) -> Run:
        drive, summary, film = DriveTable.read(path), path.with_name(SUMMARY), path.with_name(FILM)
        found: Any = {}
        if path.name == TELEMETRY and summary.is_file():
            try:
                found = json.loads(summary.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise InputError(f"summary {str(summary)!r} cannot be read: {error}") from error
        if not isinstance(found, dict):
            raise InputError(f"summary {str(summary)!r} is no JSON object")
        origin = {
            name.replace("_", " "): str(value)[:16] if "sha256" in name else str(value)
            for name, value in found.get("provenance", {}).items()
            if name != "versions"
        }
        origin |= {k: str(v) for k, v in found.get("provenance", {}).get("versions", {}).items()}
        settings = {k: str(v) for k, v in found.get("settings", {}).items() if v != "None"}
        return cls(name, drive, True, settings, origin, film if film.is_file() else None)

    def way(self) -> FloatArray:
        """Stations that never decrease, shape (n,) [m]."""
        return np.maximum.accumulate(self.drive.column(STATION))


@dataclass(frozen=True, slots=True)
class Parting:
    """Where a column of two drives begins to differ.

    Attributes:
      name: of the column; time [s], station [m]: of the first difference; first, second: values.
      visible: time when the difference exceeds 1 % of the column's range [s], NaN if it never does.
      greatest: the difference of largest magnitude, second less first; at: its time [s].
    """

    name: str
    time: float
    station: float
    first: float
    second: float
    visible: float
    greatest: float
    at: float


def partings(first: Run, second: Run) -> list[Parting]:
    """The columns that differ at equal times, the earliest first.

    Where the rows of the drives have other times, values are interpolated between them.

    Raises:
      InputError: the drives have no time in common.
    """
    time = common_times(first, second)
    found = []
    exact = first.rounded == second.rounded
    for name in first.drive.columns:
        if name == TIME or name not in second.drive:
            continue
        a, b = (at_times(run.drive, name, time) for run in (first, second))
        gone = np.isnan(a) != np.isnan(b)
        with np.errstate(invalid="ignore"):
            other = (
                a != b if exact else np.abs(a - b) > _ROUNDING * np.maximum(np.abs(a), np.abs(b))
            )
        differs = gone | (other & ~np.isnan(a) & ~np.isnan(b))
        if not differs.any():
            continue
        i = int(np.argmax(differs))
        size = np.abs(b - a)
        both = np.isfinite(size)
        spread = float(np.nanmax(a) - np.nanmin(a)) if np.isfinite(a).any() else 0.0
        seen = both & (size > _VISIBLE * spread)
        most = int(np.argmax(np.where(both, size, -1.0)))
        station = at_times(first.drive, STATION, time)
        found.append(
            Parting(
                name,
                float(time[i]),
                float(station[i]),
                float(a[i]),
                float(b[i]),
                float(time[int(np.argmax(seen))]) if seen.any() else math.nan,
                float((b - a)[most]) if both.any() else math.nan,
                float(time[most]) if both.any() else math.nan,
            )
        )
    return sorted(found, key=lambda parting: parting.time)


def common_times(first: Run, second: Run) -> FloatArray:
    """Times of the first drive within both, shape (n,) [s].

    Raises:
      InputError: there are none.
    """
    a, b = (run.drive.column(TIME) for run in (first, second))
    kept = a[(a >= b[0] - _SAME_TIME) & (a <= b[-1] + _SAME_TIME)]
    if not len(kept):
        raise InputError(
            f"{first.name!r} runs from {a[0]:g} to {a[-1]:g} s, {second.name!r} from {b[0]:g} to "
            f"{b[-1]:g} s: they have no time in common"
        )
    return kept


def at_times(drive: DriveTable, name: str, time: FloatArray) -> FloatArray:
    """Values of a column at other times: of a row with this time, else between two rows."""
    return resample(drive.column(TIME), drive.column(name), time)


def resample(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Values at other places: of an equal place, else linear; whole numbers hold until the next."""
    right = np.clip(np.searchsorted(x, at), 0, len(x) - 1)
    left = np.maximum(right - 1, 0)
    near = np.where(np.abs(x[left] - at) < np.abs(x[right] - at), left, right)
    equal = np.abs(x[near] - at) <= _SAME_TIME
    if np.array_equal(y, np.round(y), equal_nan=True):
        held = np.clip(np.searchsorted(x, at + _SAME_TIME, side="right") - 1, 0, len(x) - 1)
        between = y[held]
    else:
        between = np.interp(at, x, y)
    return np.where(equal, y[near], between)


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of two drives; NaN where a drive lacks the column."""

    name: str
    unit: str
    first: float
    second: float
    digits: int

    @property
    def difference(self) -> float:
        """The second less the first."""
        return self.second - self.first

    def cells(self) -> tuple[str, str, str, str]:
        """Name, both values and the difference, in words."""

        def text(value: float, sign: str = "") -> str:
            return (
                f"{value:{sign}.{self.digits}f} {self.unit}".strip() if value == value else "none"
            )

        known = not math.isnan(self.difference)
        return (
            self.name,
            text(self.first),
            text(self.second),
            text(self.difference, "+z") if known else "",
        )


def _of(
    column: str, reduce: Callable[[FloatArray], float], scale: float
) -> Callable[[DriveTable], float]:
    def figure(drive: DriveTable) -> float:
        values = drive.column(column) if column in drive else np.zeros(0)
        values = values[np.isfinite(values)]
        return scale * float(reduce(values)) if len(values) else math.nan

    return figure


def _distance(drive: DriveTable) -> float:
    time, speed = drive.column(TIME), drive.column("speed [m/s]")
    return float(np.sum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time)))


def _fuel(drive: DriveTable) -> float:
    return _of("fuel_used [kg]", lambda v: v[-1] - v[0], 1.0)(drive)


def _deviation(column: str, planned: str, scale: float) -> Callable[[DriveTable], float]:
    """The greatest magnitude of a column less another one."""

    def figure(drive: DriveTable) -> float:
        if column not in drive or planned not in drive:
            return math.nan
        errors = np.abs(drive.column(column) - drive.column(planned))
        errors = errors[np.isfinite(errors)]
        return scale * float(errors.max()) if len(errors) else math.nan

    return figure


def _consumption(drive: DriveTable) -> float:
    way = _distance(drive)
    return _fuel(drive) / DIESEL_DENSITY / (way / 1e5) if way >= _SHORTEST else math.nan


def _mean_speed(drive: DriveTable) -> float:
    time = drive.column(TIME)
    span = float(time[-1] - time[0])
    return _distance(drive) / span / KMH if span > 0.0 else math.nan


_DEGREES = 180.0 / math.pi
# Name, unit, digits and value of each figure.
_FIGURES: tuple[tuple[str, str, int, Callable[[DriveTable], float]], ...] = (
    ("time", "s", 1, _of(TIME, lambda v: v[-1] - v[0], 1.0)),
    ("distance", "km", 3, lambda drive: _distance(drive) / 1e3),
    ("mean speed", "km/h", 2, _mean_speed),
    ("greatest speed", "km/h", 2, _of("speed [m/s]", np.max, 1.0 / KMH)),
    ("fuel", "kg", 3, _fuel),
    ("consumption", "l/100 km", 1, _consumption),
    ("lane changes", "", 0, _of("lane_changes [-]", lambda v: v[-1] - v[0], 1.0)),
    ("closest gap ahead", "m", 2, _of("gap_ahead [m]", np.min, 1.0)),
    ("closest vehicle", "m", 2, _of("box_distance [m]", np.min, 1.0)),
    ("hardest braking", "m/s²", 2, _of("acceleration [m/s2]", lambda v: max(-v.min(), 0.0), 1.0)),
    (
        "largest lateral acceleration",
        "m/s²",
        2,
        _of("lateral_acceleration [m/s2]", lambda v: np.abs(v).max(), 1.0),
    ),
    (
        "largest articulation",
        "deg",
        2,
        _of("articulation [rad]", lambda v: np.abs(v).max(), _DEGREES),
    ),
    (
        "largest deviation from the planned offset",
        "m",
        3,
        _deviation("offset [m]", "planned_offset [m]", 1.0),
    ),
    (
        "largest deviation from the planned speed",
        "km/h",
        2,
        _deviation("speed [m/s]", "planned_speed [m/s]", 1.0 / KMH),
    ),
)


def figures(first: Run, second: Run) -> list[Figure]:
    """The figures that at least one drive has; the last is the time at a station of both."""
    found = [
        Figure(name, unit, value(first.drive), value(second.drive), digits)
        for name, unit, digits, value in _FIGURES
    ]
    last = math.floor(min(first.way()[-1], second.way()[-1]))
    if last > max(first.way()[0], second.way()[0]):
        reached = [
            float(np.interp(last, run.way(), run.drive.column(TIME))) for run in (first, second)
        ]
        found.append(Figure(f"time at station {last} m", "s", reached[0], reached[1], 2))
    return [f for f in found if not (math.isnan(f.first) and math.isnan(f.second))]


def differing(first: Mapping[str, str], second: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Name and both values of the settings that differ; "not set" where one has none."""
    names = dict.fromkeys((*first, *second))
    return [
        (name, first.get(name, "not set"), second.get(name, "not set"))
        for name in names
        if name not in _OUTPUTS and first.get(name) != second.get(name)
    ]
