"""Columns of recordings, and the truck's states and commands as rows of numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from iits_mj.core import vehicles
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import (
    EgoState,
    LightState,
    RoadSignals,
    SignalLamp,
    TrafficLight,
    TransmissionMode,
    VehicleCommand,
    XbrEbiMode,
    XbrMode,
)

SCHEMA = 2  # version of the file format
SIZE_COLUMNS = ("length", "width", "height")
COLUMNS = tuple(name for name in vehicles.COLUMNS if name not in SIZE_COLUMNS)
PRESSURES = tuple(
    f"brake_pressure_{place}"
    for place in ("front_left", "front_right", "rear_left", "rear_right", "trailer")
)
_SCALARS = tuple(
    field.name for field in dataclasses.fields(EgoState) if not isinstance(field.default, tuple)
)
# Of a truck with one coupling or none; `ego_columns` has those of the couplings behind the first.
EGO_COLUMNS = (*_SCALARS, *PRESSURES)
_REAR = ("rear_articulation", "rear_articulation_rate")
COMMAND_COLUMNS = tuple(field.name for field in dataclasses.fields(VehicleCommand))
_ABSENT = (math.nan,) * len(EGO_COLUMNS)


def ego_columns(width: int) -> tuple[str, ...]:
    """Names of a state's columns by their number.

    Raises:
      InputError: no truck has this number of columns.
    """
    couplings, odd = divmod(width - len(EGO_COLUMNS), 2)
    if couplings < 0 or odd:
        raise InputError(
            f"ego has {width} columns: must be {len(EGO_COLUMNS)}, and two more for each coupling "
            "behind the first"
        )
    rear = (f"{name}{number}" for name in _REAR for number in range(2, couplings + 2))
    return (*EGO_COLUMNS, *rear)


def ego_row(ego: EgoState | None) -> tuple[float, ...]:
    """A truck's state in the order of `ego_columns`; NaN without a truck.

    Raises:
      InputError: a value is not finite.
    """
    if ego is None:
        return _ABSENT
    row = (*(float(getattr(ego, name)) for name in _SCALARS), *ego.brake_pressures)
    row += (*ego.rear_articulations, *ego.rear_articulation_rates)
    if not all(map(math.isfinite, row)):
        names = ego_columns(len(row))
        name, value = next(
            pair for pair in zip(names, row, strict=True) if not math.isfinite(pair[1])
        )
        raise InputError(f"ego.{name} = {value!r}: must be finite to be recorded")
    return row


def ego_of(row: FloatArray) -> EgoState | None:
    """The truck's state of a row; the inverse of `ego_row`."""
    if np.isnan(row).any():
        return None
    values: dict[str, Any] = dict(zip(EGO_COLUMNS, row.tolist(), strict=False))
    pressures = tuple(values.pop(name) for name in PRESSURES)
    values["gear"] = int(values["gear"])
    values["shift_in_process"] = bool(values["shift_in_process"])
    angles, rates = row[len(EGO_COLUMNS) :].reshape(2, -1).tolist()
    return EgoState(
        **values,
        brake_pressures=pressures,
        rear_articulations=tuple(angles),
        rear_articulation_rates=tuple(rates),
    )


def command_row(command: VehicleCommand) -> tuple[float, ...]:
    """A command in the order of `COMMAND_COLUMNS`; InputError if a value is not finite."""
    row = tuple(float(getattr(command, name)) for name in COMMAND_COLUMNS)
    if not all(map(math.isfinite, row)):
        raise InputError(f"{command}: every value must be finite to be recorded")
    return row


def command_of(row: FloatArray) -> VehicleCommand:
    """The command of a row, the inverse of `command_row`; InputError if a mode is unknown."""
    values: dict[str, Any] = dict(zip(COMMAND_COLUMNS, row.tolist(), strict=True))
    try:
        for name, modes in (
            ("xbr_mode", XbrMode),
            ("transmission_mode", TransmissionMode),
            ("xbr_ebi_mode", XbrEbiMode),
        ):
            values[name] = modes(int(values[name]))
    except ValueError as error:
        raise InputError(f"recorded command: {name} = {values[name]!r}: {error}") from error
    return VehicleCommand(**values)


def signal_rows(changes: Iterable[tuple[int, RoadSignals]]) -> list[list[Any]]:
    """Changes of traffic lights as values for JSON, see `Recording.signals`.

    A row has the frame, station and state of the next light or null, and the states of the map's
    lamps that are other than before, null where one went out.
    """
    rows, before = [], dict[str, str]()
    for frame, signals in changes:
        light = (
            None if signals.light is None else [signals.light.station, signals.light.state.value]
        )
        shown = {lamp.signal: lamp.state.value for lamp in signals.lamps}
        changed: dict[str, str | None] = {
            name: shown.get(name)
            for name in {**before, **shown}
            if before.get(name) != shown.get(name)
        }
        rows.append([frame, light, changed])
        before = shown
    return rows


def signals_of(rows: Any, name: str) -> tuple[tuple[int, RoadSignals], ...]:
    """The changes of rows; the inverse of `signal_rows`.

    Args:
      rows: from a file.
      name: of them in messages.

    Raises:
      InputError: a row is not one of `signal_rows`.
    """
    found: list[tuple[int, RoadSignals]] = []
    shown: dict[str, SignalLamp] = {}
    try:
        for row in rows:
            frame, given, changed = row
            light = None if given is None else TrafficLight(float(given[0]), LightState(given[1]))
            for signal, state in changed.items():
                shown.pop(signal, None)
                if state is not None:
                    shown[signal] = SignalLamp(signal, LightState(state))
            if light is not None and not math.isfinite(light.station):
                raise ValueError(light.station)
            if not isinstance(frame, int) or frame < (found[-1][0] + 1 if found else 0):
                raise ValueError(frame)
            found.append((frame, RoadSignals(light, lamps=tuple(shown.values()))))
    except (TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(f"{name}: row {len(found)} is not usable: {error}") from error
    return tuple(found)
