"""What every typed message has in common: fields that are numbers or say why they are not."""

from __future__ import annotations

import enum
import functools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, TypeAlias

import cantools.database.can

from iits_mj.core.errors import BusError

# --- The DBC file as cantools reads it ---


def database_path() -> Path:
    """Our DBC file, for other CAN tools."""
    return Path(__file__).with_name("iits_mj.dbc")


@functools.cache
def layouts() -> cantools.database.can.Database:
    """All messages of the DBC; read once."""
    database = cantools.database.can.Database()
    database.add_dbc_file(str(database_path()))
    return database


def class_name(message: str) -> str:
    """Name of the typed group: the message's own, or "IitsTrailer" of IITS_TRAILER."""
    return message.title().replace("_", "") if "_" in message else message


# --- What every typed message has in common: fields that are numbers or say why they are not ---


class Status(enum.Enum):
    """What a field says when it carries no value."""

    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"


Value: TypeAlias = float | Status

NOT_AVAILABLE = Status.NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class Group:
    """A parameter group: one field a signal, in the order and the units of the DBC.

    The groups are in `iits_mj.j1939.groups`, made from the DBC.
    """

    MESSAGE: ClassVar[str] = ""

    def items(self) -> Iterator[tuple[str, Value]]:
        """Signals and what they carry, in the order of the DBC."""
        return ((field.name, getattr(self, field.name)) for field in fields(self))

    def number(self, signal: str) -> float:
        """The number in a field.

        Raises:
          BusError: the sender says error, not available, or a value outside the signal's range.
        """
        value = getattr(self, signal)
        if isinstance(value, Status):
            raise BusError(f"{self.MESSAGE}.{signal} carries no value: {value.value}")
        return float(value)
