"""Our messages as ROS 2 types: definitions and conversion are made from the dataclasses.

| Python                         | ROS 2                                                  |
|--------------------------------|--------------------------------------------------------|
| float, int, bool, str          | float64, int64, bool, string                           |
| IntEnum                        | int64; other enumerations: string, their value         |
| arrays and tuples of floats    | float64[]                                              |
| float or None                  | float64, nan for None                                  |
| enumeration or None            | string, empty for None                                 |
| int or None                    | int64[], empty for None                                |
| dataclass; dataclass or None   | message; message[], empty for None                     |
| sequence of dataclasses        | message[]                                              |
| dictionary of floats           | string[] `<field>_names` and float64[] `<field>`       |
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.messages import (
    Decision,
    EgoFootprint,
    EgoState,
    RoadSignals,
    Scene,
    SpeedZone,
    TrackedVehicle,
    TrafficLight,
    Trajectory,
    VehicleCommand,
)

PACKAGE = "iits_msgs/msg"


@dataclass(frozen=True, slots=True)
class Decided:
    """An answer of the decision maker: when it was asked [s], and what it said."""

    time: float
    decision: Decision


# In the order in which they build on each other.
MESSAGES = (
    *(EgoState, EgoFootprint, TrackedVehicle, TrafficLight, SpeedZone, RoadSignals),
    *(Scene, Trajectory, VehicleCommand, Decided),
)


def type_name(kind: type) -> str:
    """Name of a dataclass's ROS 2 type."""
    return f"{PACKAGE}/{kind.__name__}"


def definition(kind: type) -> str:
    """Text of the `.msg` file of a dataclass."""
    lines = []
    for field in _fields(kind):
        if field.form == "dictionary":
            lines.append(f"string[] {field.name}_names")
        lines.append(f"{field.ros} {field.name}")
    return "\n".join(lines) + "\n"


def encode(message: Any, make: Callable[[str], type]) -> Any:
    """A dataclass as an instance of its ROS 2 type.

    Args:
      message: one of `MESSAGES`.
      make: class of a ROS 2 type by its name.
    """
    kind = typing.cast(Any, type(message))
    values: dict[str, Any] = {}
    for field in _fields(kind):
        value = getattr(message, field.name)
        if field.form == "dictionary":
            values[f"{field.name}_names"] = list(value)
            values[field.name] = np.array(list(value.values()), dtype=np.float64)
        else:
            values[field.name] = _encoded(value, field, make)
    return make(type_name(kind))(**values)


def decode(message: Any, kind: type) -> Any:
    """An instance of a ROS 2 type as the dataclass."""
    values: dict[str, Any] = {}
    for field in _fields(kind):
        value = getattr(message, field.name)
        if field.form == "dictionary":
            names = getattr(message, f"{field.name}_names")
            values[field.name] = dict(zip(names, np.asarray(value).tolist(), strict=True))
        else:
            values[field.name] = _decoded(value, field)
    return kind(**values)


@dataclass(frozen=True)
class _Field:
    name: str
    ros: str
    form: str
    kind: Any = None


@functools.cache
def _fields(kind: type) -> tuple[_Field, ...]:
    hints = typing.get_type_hints(kind)
    return tuple(_field(field.name, hints[field.name]) for field in dataclasses.fields(kind))


_PLAIN = {float: "float64", int: "int64", bool: "bool", str: "string"}


def _field(name: str, hint: Any) -> _Field:
    origin, inside = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        (wanted,) = (part for part in inside if part is not type(None))
        if wanted is float:
            return _Field(name, "float64", "float or none")
        if wanted is int:
            return _Field(name, "int64[]", "int or none")
        if dataclasses.is_dataclass(wanted):
            return _Field(
                name, f"{type_name(typing.cast(type, wanted))}[]", "message or none", wanted
            )
        return _Field(name, "string", "enum or none", wanted)
    if hint in _PLAIN:
        return _Field(name, _PLAIN[hint], "plain", hint)
    if origin is dict:
        return _Field(name, "float64[]", "dictionary")
    if dataclasses.is_dataclass(hint):
        return _Field(name, type_name(typing.cast(type, hint)), "message", hint)
    if isinstance(hint, type) and issubclass(hint, enum.IntEnum):
        return _Field(name, "int64", "number enum", hint)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return _Field(name, "string", "enum", hint)
    if inside and dataclasses.is_dataclass(inside[0]):
        return _Field(name, f"{type_name(typing.cast(type, inside[0]))}[]", "messages", inside[0])
    if origin is tuple:
        return _Field(name, "float64[]", "tuple")
    return _Field(name, "float64[]", "array")


def _encoded(value: Any, field: _Field, make: Callable[[str], type]) -> Any:
    form = field.form
    if form == "float or none":
        return math.nan if value is None else float(value)
    if form == "int or none":
        return np.array([] if value is None else [value], dtype=np.int64)
    if form == "message or none":
        return [] if value is None else [encode(value, make)]
    if form == "messages":
        return [encode(part, make) for part in value]
    if form == "message":
        return encode(value, make)
    if form in ("enum", "enum or none"):
        return "" if value is None else str(value.value)
    if form in ("tuple", "array"):
        return np.ascontiguousarray(value, dtype=np.float64)
    return int(value) if form == "number enum" else field.kind(value)


def _decoded(value: Any, field: _Field) -> Any:
    form, kind = field.form, field.kind
    if form == "float or none":
        return None if math.isnan(value) else float(value)
    if form == "int or none":
        return int(value[0]) if len(value) else None
    if form == "message or none":
        return decode(value[0], kind) if len(value) else None
    if form == "messages":
        return tuple(decode(part, kind) for part in typing.cast(Sequence[Any], value))
    if form == "message":
        return decode(value, kind)
    if form == "enum or none" and value == "":
        return None
    if form == "tuple":
        return tuple(np.asarray(value).tolist())
    if form == "array":
        return np.array(value, dtype=np.float64)
    return kind(value)
