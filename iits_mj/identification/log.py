"""Recorded drives: named signals in SI units, read from a telemetry table (CSV) or a CAN log.

A table samples all signals at once; on a bus every message has its own rate. Neither is resampled:
a fit uses the samples themselves (`series`) or values at other times (`at` for signals that change
steadily, `held` for signals that hold until the next message).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from iits_mj.core import tables
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import BusError, InputError
from iits_mj.core.units import GRAVITY, KMH, RPM
from iits_mj.j1939 import Frame, Status, decode, read_log
from iits_mj.j1939.mapping import SignalRow, commands, reports
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.parameters import TruckParameters

PRESSURES = tuple(
    f"brake_pressure_{place}"
    for place in ("front_left", "front_right", "rear_left", "rear_right", "trailer")
)
# Every signal that a fit may use: unit and meaning.
SIGNALS: dict[str, str] = {
    "time": "[s]",
    "speed": "[m/s] forward",
    "station": "[m] along the road",
    "z": "[m] height of the road under the steer axle",
    "grade": "[1] of the road, dz/ds, under the steer axle",
    "gear": "[1] 1 to 12, 0 neutral, -1 reverse",
    "shift_in_process": "[1] 1 while the driveline is open for a gear change",
    "engine_speed": "[rad/s]",
    "engine_torque": "[N m] at the crankshaft, negative in overrun and under engine brake",
    "retarder_torque": "[N m] at the propeller shaft, positive when it brakes",
    "command_accelerator_pedal": "[1] 0 to 1",
    "command_engine_brake": "[1] 0 to 1",
    "command_retarder": "[1] 0 to 1",
    "command_xbr_demand": "[m/s2] zero or negative",
    "command_xbr_mode": "[1] 0 off, 1 addition, 2 maximum",
    "command_brake_pedal": "[1] 0 to 1",
    **dict.fromkeys(PRESSURES, "[Pa] in the chambers"),
    "steering_wheel_angle": "[rad] actual",
    "road_wheel_angle": "[rad] mean of left and right",
    "yaw_rate": "[rad/s] of the tractor",
    "trailer_yaw_rate": "[rad/s]",
    "articulation": "[rad] tractor yaw minus trailer yaw",
    "lateral_acceleration": "[m/s2] of the tractor's centre of gravity",
}
_ROWS_MIN = 50
_DEGREE = np.pi / 180.0
# Other units that a table may have, by the unit of the signal, and that unit in each.
_UNITS = {
    "m/s": {"km/h": KMH},
    "m/s2": {"g": GRAVITY},
    "rad": {"deg": _DEGREE},
    "rad/s": {"rpm": RPM, "deg/s": _DEGREE},
    "Pa": {"kPa": 1e3, "bar": 1e5, "MPa": 1e6},
    "1": {"%": 0.01},
}
# Signals with another name on the bus, and signals that only serve to compute others.
_BUS_NAMES = {"wheel_based_speed": "speed_of_wheels"}
_PARTS = (
    "speed_of_wheels",
    "engine_torque_percent",
    "torque_loss_percent",
    "engine_brake_percent",
    "retarder_percent",
)
# Half a bit of SPN 514, in percent of the reference torque.
_HALF_BIT = 0.5
# Length on both sides of a place for the slope of the height [m].
_SLOPE_LENGTH = 40.0
_GRADE_MAX = 0.3


@dataclass(frozen=True)
class Series:
    """Samples of one signal: time [s], strictly increasing, and value, both of shape (n,)."""

    time: FloatArray
    value: FloatArray

    def integral(self) -> FloatArray:
        """Integral of the value over time from the first sample on, by trapezoids; shape (n,)."""
        steps = 0.5 * (self.value[1:] + self.value[:-1]) * np.diff(self.time)
        return np.concatenate([[0.0], np.cumsum(steps)])


@dataclass(frozen=True)
class Log:
    """The signals of a drive by name; see `SIGNALS` for names, units and signs.

    Attributes:
      signals: name to values of shape (n,), sampled at the signal "time"; or to a `Series`.
    """

    signals: Mapping[str, FloatArray | Series]

    def __post_init__(self) -> None:
        if not self.signals:
            raise InputError("the log has no signal that can be used")
        for name in self.signals:
            series = self.series(name)
            if len(series.value) != len(series.time) or not np.isfinite(series.value).all():
                raise InputError(f"signal {name!r} of the log has gaps or is not finite")
            if not np.isfinite(series.time).all() or np.any(np.diff(series.time) <= 0.0):
                raise InputError(f"the time of signal {name!r} must increase from row to row")
        length = max(len(self.series(name).time) for name in self.signals)
        if length < _ROWS_MIN:
            raise InputError(f"the log has {length} rows: at least {_ROWS_MIN} are needed")

    def __contains__(self, name: str) -> bool:
        return name in self.signals

    def series(self, name: str) -> Series:
        """The samples of a signal.

        Raises:
          InputError: the log lacks the signal, or its times.
        """
        found = self.signals.get(name)
        if found is None:
            raise InputError(f"the log lacks the signal {name!r}; it has {sorted(self.signals)}")
        if isinstance(found, Series):
            return found
        time = self.signals.get("time")
        if not isinstance(time, np.ndarray):
            raise InputError(f"the log lacks the signal 'time' that {name!r} was sampled at")
        return Series(time, np.asarray(found, dtype=float))

    def __getitem__(self, name: str) -> FloatArray:
        return self.series(name).value

    def missing(self, *names: str) -> list[str]:
        """Those of these signals that the log lacks."""
        return [name for name in names if name not in self.signals]

    def lacks(self, *names: str) -> str:
        """A sentence on the signals that the log lacks; "" if it has all of them."""
        missing = self.missing(*names)
        return f"the log lacks {', '.join(missing)}" if missing else ""

    def at(self, name: str, time: ArrayLike) -> FloatArray:
        """Values at other times, interpolated linearly between the samples."""
        series = self.series(name)
        return np.asarray(np.interp(np.asarray(time, dtype=float), series.time, series.value))

    def held(self, name: str, time: ArrayLike) -> FloatArray:
        """Values at other times, where each sample holds until the next."""
        series = self.series(name)
        index = np.searchsorted(series.time, np.asarray(time, dtype=float) + 1e-9, side="right")
        return np.asarray(series.value[np.maximum(index - 1, 0)])

    def only(self, names: list[str]) -> Log:
        """The log with these signals only; "time" always stays.

        Raises:
          InputError: the log lacks one of the signals.
        """
        for name in names:
            self.series(name)
        return Log({k: v for k, v in self.signals.items() if k in names or k == "time"})


def read(path: str | Path, parameters: TruckParameters, names: dict[str, str] | None = None) -> Log:
    """Reads a log: `.csv` is a table, any other file a CAN log (candump .log, .asc, .blf).

    Args:
      path: of the file.
      parameters: of the truck, with the reference torques of percentages on the bus.
      names: title of a signal's column in the table, if it differs from the signal's name.

    Raises:
      InputError: the file cannot be read or has no signal that can be used.
    """
    if Path(path).suffix.lower() == ".csv":
        return read_table(path, names)
    if names:
        raise InputError(f"a CAN log has no columns to rename: {sorted(names)}")
    try:
        frames = list(read_log(path))
    except BusError as error:
        raise InputError(f"log {str(path)!r} cannot be read: {error}") from error
    return from_frames(frames, parameters)


def read_table(path: str | Path, names: dict[str, str] | None = None) -> Log:
    """Reads a telemetry table: one column for each signal, with titles `name [unit]`.

    Raises:
      InputError: unreadable file, a missing column, an unknown unit, or a cell that is not a
        number.
    """
    titles = {title: name for name, title in (names or {}).items()}
    headings, rows = _csv(path, "log")
    columns: dict[str, FloatArray | Series] = {}
    for index, (title, unit) in enumerate(headings):
        name = titles.pop(title, title)
        if name in SIGNALS and not (name in (names or {}) and title == name):
            # `Log` refuses a value that becomes infinite.
            with np.errstate(over="ignore"):
                columns[name] = _column(rows, index, title) * _factor(name, unit)
    if titles:
        raise InputError(f"log {str(path)!r} has no column {next(iter(titles))!r}")
    if "time" not in columns:
        raise InputError(f"log {str(path)!r} lacks the column 'time'")
    return Log(columns)


def _factor(name: str, unit: str) -> float:
    """SI units in one unit of a column; a column without a unit, or with "-", has the signal's."""
    own = SIGNALS[name].partition("[")[2].partition("]")[0]
    known = {own: 1.0, **_UNITS.get(own, {})}
    if unit not in ("", "-", *known):
        raise InputError(f"column {name!r} has the unit {unit!r}; use {' or '.join(known)}")
    return known.get(unit, 1.0)


def _csv(path: str | Path, what: str) -> tuple[list[tuple[str, str]], list[list[str]]]:
    """Title and unit of each column, and the rows below."""
    headings, rows = tables.read_table(path, what)
    if not headings:
        raise InputError(f"{what} {str(path)!r} is empty")
    parts = [heading.partition("[") for heading in headings]
    return [(title.strip(), unit.strip(" ]")) for title, _, unit in parts], rows


def _column(rows: list[list[str]], index: int, title: str) -> FloatArray:
    try:
        return np.array([float(row[index]) for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(f"column {title!r} of the log has a cell that is not a number") from error


def from_frames(frames: Iterable[Frame], parameters: TruckParameters) -> Log:
    """The log of CAN frames by the DBC, without values "not available" or "error".

    Times start at the first frame. No message carries the road's grade: it is the slope of height
    over station if the log has both; otherwise use `with_grade`.

    Raises:
      InputError: no frame has a usable signal.
    """
    wanted = _bus_signals()
    found: dict[str, tuple[list[float], list[float]]] = {}
    start: float | None = None
    for frame in frames:
        try:
            decoded = decode(frame)
        except BusError:
            continue
        if decoded is None:
            continue
        start = frame.time if start is None else start
        for signal, value in decoded.group.items():
            if isinstance(value, Status):
                continue
            for row, name in wanted.get((decoded.name, signal), ()):
                address = decoded.destination if name.startswith("command_") else decoded.source
                if row.address not in (None, address):
                    continue
                times, values = found.setdefault(name, ([], []))
                if not times or frame.time - start > times[-1]:
                    times.append(frame.time - start)
                    values.append(value * row.scale)
    signals = {n: Series(np.array(t), np.array(v)) for n, (t, v) in found.items()}
    signals = _with_torques(signals, parameters)
    if "speed" not in signals and "speed_of_wheels" in signals:
        signals["speed"] = signals["speed_of_wheels"]
    usable = {name: series for name, series in signals.items() if name in SIGNALS}
    if not usable:
        raise InputError("the CAN log carries no signal that can be used")
    log = Log(usable)
    return log if log.missing("z", "station") else with_slope(log)


def _bus_signals() -> dict[tuple[str, str], list[tuple[SignalRow, str]]]:
    """Rows of `signals.csv` and names in the log, by message and signal of the DBC."""
    found: dict[tuple[str, str], list[tuple[SignalRow, str]]] = {}
    rows = [(row, f"command_{row.quantity}") for row in commands()]
    rows += [(row, _BUS_NAMES.get(row.quantity, row.quantity)) for row in reports()]
    for row, name in rows:
        if name in SIGNALS or name in _PARTS:
            found.setdefault((row.message, row.signal), []).append((row, name))
    return found


def _with_torques(signals: dict[str, Series], parameters: TruckParameters) -> dict[str, Series]:
    """Adds the torques of the percentages on the bus.

    SPN 513 is the indicated torque: less friction (SPN 514) and engine brake it is the torque of
    the crankshaft.
    """
    references = ReferenceTorques.of(parameters)
    indicated = signals.get("engine_torque_percent")
    found = dict(signals)
    if indicated is not None:
        torque = 0.01 * references.engine * indicated.value
        torque = torque - _friction(signals, indicated.time, parameters)
        if "engine_brake_percent" in signals:
            part = signals["engine_brake_percent"]
            share = np.interp(indicated.time, part.time, np.abs(part.value))
            torque = torque - 0.01 * references.engine_brake * share
        found["engine_torque"] = Series(indicated.time, torque)
    if "retarder_percent" in signals:
        part = signals["retarder_percent"]
        found["retarder_torque"] = Series(
            part.time, 0.01 * references.retarder * np.abs(part.value)
        )
    return found


def _friction(
    signals: dict[str, Series], time: FloatArray, parameters: TruckParameters
) -> FloatArray:
    """Friction torque of the engine [N m], shape (n,): the truck's curve, scaled to the bus.

    A bit of SPN 514 is 1 % of the reference torque, a fifth of the friction itself, and would bias
    the resistances of the coasting truck. Each sample bounds the curve's scale from both sides; the
    middle of their common interval is far finer than a bit.
    """
    engine = parameters.engine
    if "torque_loss_percent" not in signals:
        return np.zeros_like(time)
    loss = signals["torque_loss_percent"]
    unit = 0.01 * engine.reference_torque
    if "engine_speed" not in signals:
        return np.asarray(unit * np.interp(time, loss.time, loss.value))
    speed = signals["engine_speed"]
    curve = np.interp(
        np.interp(loss.time, speed.time, speed.value), engine.drag_speed, engine.drag_torque
    )
    low = float(np.max(unit * (loss.value - _HALF_BIT) / curve))
    high = float(np.min(unit * (loss.value + _HALF_BIT) / curve))
    scale = 0.5 * (low + high) if low < high else unit * float(loss.value @ curve / (curve @ curve))
    at = np.interp(time, speed.time, speed.value)
    return np.asarray(scale * np.interp(at, engine.drag_speed, engine.drag_torque))


def with_slope(log: Log) -> Log:
    """Adds the grade: the slope of straight lines fitted to height over 80 m of station."""
    height = log.series("z")
    station = np.maximum.accumulate(log.at("station", height.time))
    places = np.arange(station[0], station[-1], 10.0)
    if len(places) < 2:
        return log
    slopes = []
    for place in places:
        low, high = np.searchsorted(station, [place - _SLOPE_LENGTH, place + _SLOPE_LENGTH])
        near = slice(int(low), max(int(high), int(low) + 2))
        x, y = station[near] - station[near].mean(), height.value[near]
        slopes.append(float(x @ y / max(float(x @ x), 1e-9)))
    return with_grade(log, places, np.array(slopes))


def with_grade(log: Log, station: FloatArray, grade: FloatArray) -> Log:
    """The log with the road's grade from a table over station [m], both of shape (n,).

    Raises:
      InputError: the log has neither station nor speed, or the table's stations do not increase.
    """
    if np.any(np.diff(station) <= 0.0):
        raise InputError("the stations of a grade table must increase")
    if "station" in log:
        place = log.series("station")
    else:
        speed = log.series("speed")
        place = Series(speed.time, speed.integral())
    value = np.interp(place.value, station, grade)
    return Log({**log.signals, "grade": Series(place.time, np.asarray(value))})


def read_grade(text: str, log: Log) -> Log:
    """The log with a constant grade from a number, or the grades of a CSV of station and grade.

    Raises:
      InputError: neither a number within +/-0.3 nor a readable table.
    """
    try:
        value = float(text)
    except ValueError:
        headings, rows = _csv(text, "table")
        titles = [title for title, _ in headings]
        missing = [name for name in ("station", "grade") if name not in titles]
        if missing:
            raise InputError(f"table {text!r} lacks the column {missing[0]!r}") from None
        station, grade = (_column(rows, titles.index(name), name) for name in ("station", "grade"))
        return with_grade(log, station, grade)
    if not abs(value) <= _GRADE_MAX:
        raise InputError(
            f"grade {text!r} is not allowed: use -{_GRADE_MAX} to {_GRADE_MAX}, or a table's name"
        )
    return with_grade(log, np.array([0.0, 1.0]), np.array([value, value]))
