"""Logs from the frames of the truck's CAN bus, by our DBC and its table of signals."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import BusError, InputError
from iits_mj.identification.grade import with_slope
from iits_mj.identification.log import SIGNALS, Log, Series
from iits_mj.j1939 import Frame, Status, decode
from iits_mj.j1939.mapping import Mapping, commands, reports
from iits_mj.j1939.quantities import ReferenceTorques
from iits_mj.parameters import TruckParameters

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


def _bus_signals() -> dict[tuple[str, str], list[tuple[Mapping, str]]]:
    """(message, signal) of the DBC to the rows of the bus's table and the log's names."""
    found: dict[tuple[str, str], list[tuple[Mapping, str]]] = {}
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
