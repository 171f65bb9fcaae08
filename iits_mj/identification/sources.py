"""Where logs come from: a telemetry table (CSV) or the frames of the truck's CAN bus."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import BusError, InputError
from iits_mj.core.units import KMH, RPM
from iits_mj.identification.log import SIGNALS, Log, Series
from iits_mj.j1939 import Frame, Status, decode, read_log
from iits_mj.j1939.mapping import SignalRow, commands, reports
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.parameters import TruckParameters

# --- Logs and tables in CSV files, with units in their headings ---

_TO_SI = {"rpm": RPM, "kPa": 1e3, "km/h": KMH, "deg": np.pi / 180.0, "deg/s": np.pi / 180.0}
_TO_SI |= {"%": 0.01, "bar": 1e5, "MPa": 1e6}


def read_table(path: str | Path, names: dict[str, str] | None = None) -> Log:
    """A telemetry table: one column a signal, titles `name [unit]`.

    Raises:
      InputError: unreadable file, a column asked for is not there, a cell that is no number.
    """
    titles = {title: name for name, title in (names or {}).items()}
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"log {str(path)!r} cannot be read: {error}") from error
    if not rows:
        raise InputError(f"log {str(path)!r} is empty")
    columns: dict[str, FloatArray | Series] = {}
    for index, heading in enumerate(rows[0]):
        title, _, unit = heading.partition("[")
        title = title.strip()
        name = titles.pop(title, title)
        if name in SIGNALS and not (name in (names or {}) and title == name):
            factor = _TO_SI.get(unit.strip(" ]"), 1.0)
            columns[name] = _column(rows[1:], index, title) * factor
    if titles:
        raise InputError(f"log {str(path)!r} has no column {next(iter(titles))!r}")
    if "time" not in columns:
        raise InputError(f"log {str(path)!r} lacks the column 'time'")
    return Log(columns)


def _column(rows: list[list[str]], index: int, title: str) -> FloatArray:
    try:
        return np.array([float(row[index]) for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(f"column {title!r} of the log has a cell that is no number") from error


def read_table_columns(path: str | Path, wanted: tuple[str, ...]) -> list[FloatArray]:
    """Columns of a CSV whose titles begin with these names."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"table {str(path)!r} cannot be read: {error}") from error
    titles = [heading.partition("[")[0].strip() for heading in (rows[0] if rows else [])]
    missing = [name for name in wanted if name not in titles]
    if missing:
        raise InputError(f"table {str(path)!r} lacks the column {missing[0]!r}")
    return [_column(rows[1:], titles.index(name), name) for name in wanted]


# --- Logs from the frames of the truck's CAN bus, by our DBC and its table of signals ---

# Signals of the log that the bus calls otherwise, and those that only help to find others.
_BUS_NAMES = {"wheel_based_speed": "speed_of_wheels"}
_PARTS = (
    "speed_of_wheels",
    "engine_torque_percent",
    "torque_loss_percent",
    "engine_brake_percent",
    "retarder_percent",
)


def from_frames(frames: Iterable[Frame], parameters: TruckParameters) -> Log:
    """A log of CAN frames, by our DBC; what says "not available" or "error" is left out.

    Times start at the first frame's. The road's grade, which no message carries, is the slope of
    height over station where both are there; give a table otherwise (`with_grade`).

    Raises:
      InputError: no frame carries a signal that can be used.
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
    """(message, signal) of the DBC to the rows of the bus's table and the log's names."""
    found: dict[tuple[str, str], list[tuple[SignalRow, str]]] = {}
    rows = [(row, f"command_{row.quantity}") for row in commands()]
    rows += [(row, _BUS_NAMES.get(row.quantity, row.quantity)) for row in reports()]
    for row, name in rows:
        if name in SIGNALS or name in _PARTS:
            found.setdefault((row.message, row.signal), []).append((row, name))
    return found


def _with_torques(signals: dict[str, Series], parameters: TruckParameters) -> dict[str, Series]:
    """Adds the torques that the bus's percentages mean.

    SPN 513 is the indicated torque: less friction (SPN 514) and engine brake it is that of the
    crankshaft.
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


# Half a bit of SPN 514, in percent of the reference torque.
_HALF_BIT = 0.5


def _friction(
    signals: dict[str, Series], time: FloatArray, parameters: TruckParameters
) -> FloatArray:
    """Friction torque of the engine [N m], shape (n,): the truck's curve, scaled to the bus.

    A bit of SPN 514 is 1 % of the reference torque, a fifth of the friction itself: as such it
    would bias the coasting truck's resistances. Each sample bounds the curve's scale from both
    sides; the middle of what all of them leave is far finer than a bit.
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


# --- Where logs come from: a telemetry table (CSV) or the frames of the truck's CAN bus ---


def read(path: str | Path, parameters: TruckParameters, names: dict[str, str] | None = None) -> Log:
    """A log by its file's suffix: `.csv` is a table, all else a CAN log (candump .log, .asc, .blf).

    Args:
      path: of the file.
      parameters: give the reference torque of the bus's percent torques.
      names: signal to the title of its column, where a table calls it otherwise.

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


# --- The grade of the road along a log: from a table, a number, or the heights that were recorded

# Length over which the slope of a height is taken, on both sides [m].
_SLOPE_LENGTH = 40.0


def with_slope(log: Log) -> Log:
    """Adds the grade as slope of height over station, a straight line over 80 m fitted each."""
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
        steps = 0.5 * (speed.value[1:] + speed.value[:-1]) * np.diff(speed.time)
        place = Series(speed.time, np.concatenate([[0.0], np.cumsum(steps)]))
    value = np.interp(place.value, station, grade)
    return Log({**log.signals, "grade": Series(place.time, np.asarray(value))})


def read_grade(text: str, log: Log) -> Log:
    """The log with the grade that a number (everywhere) or a CSV of station and grade gives.

    Raises:
      InputError: neither a number within +/-0.3 nor a readable table.
    """
    try:
        value = float(text)
    except ValueError:
        table = read_table_columns(text, ("station", "grade"))
        return with_grade(log, table[0], table[1])
    if not abs(value) <= 0.3:
        raise InputError(f"grade {text!r} is not allowed: use -0.3 to 0.3, or a table's name")
    return with_grade(log, np.array([0.0, 1.0]), np.array([value, value]))
