"""The messages of the DBC as typed groups: frozen dataclasses with one field for each signal.

The classes are built from `iits_mj.dbc` when the first of them is used. Their names are those of
the messages (`EEC1`), `IitsTrailer` for IITS_TRAILER:

    from iits_mj.j1939.groups import EEC1
    EEC1(engine_speed_rpm=1200.0)

Numbers are in the units of the signals; the default of every field is "not available".
"""

from __future__ import annotations

import enum
import functools
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import Frame

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal


class Status(enum.Enum):
    """Status of a field without a value."""

    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"


Value: TypeAlias = float | Status

NOT_AVAILABLE = Status.NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class Group:
    """A parameter group: one field for each signal, in the order and the units of the DBC."""

    MESSAGE: ClassVar[str] = ""

    def items(self) -> Iterator[tuple[str, Value]]:
        """Signals and their values, in the order of the DBC."""
        return ((item.name, getattr(self, item.name)) for item in fields(self))

    def number(self, signal: str) -> float:
        """The number in a field; BusError if the field has a `Status`."""
        value = getattr(self, signal)
        if isinstance(value, Status):
            raise BusError(f"{self.MESSAGE}.{signal} has no value: {value.value}")
        return float(value)


def database_path() -> Path:
    """Path of our DBC file, for other CAN tools."""
    return Path(__file__).with_name("iits_mj.dbc")


@functools.cache
def layouts() -> Database:
    """All messages of the DBC as objects of cantools; read once."""
    from cantools.database.can import Database

    database = Database()
    database.add_dbc_file(str(database_path()))
    return database


@functools.cache
def group_types() -> dict[str, type[Group]]:
    """The typed group of each message, by the message's name in the DBC; built once."""
    return {message.name: _group_type(message) for message in layouts().messages}


def _group_type(message: Message) -> type[Group]:
    name = message.name
    return make_dataclass(
        name.title().replace("_", "") if "_" in name else name,
        [(signal.name, "Value", field(default=NOT_AVAILABLE)) for signal in message.signals],
        bases=(Group,),
        namespace={"__module__": __name__, "__doc__": _docstring(message), "MESSAGE": name},
        frozen=True,
        slots=True,
    )


def _docstring(message: Message) -> str:
    pgn = Frame(message.frame_id, b"").pgn
    comment = textwrap.fill((message.comment or "").rstrip(".") + ".", 96)
    lines = [f"{message.name}, PGN {pgn} (0x{pgn:04X}).", "", comment, "", "Attributes:"]
    return "\n".join(lines + [_attribute(signal) for signal in message.signals])


def _attribute(signal: Signal) -> str:
    spn = f"SPN {signal.spn}" if signal.spn else "our own"
    unit = f" [{signal.unit}]" if signal.unit else ""
    about = f"{signal.comment.rstrip('.')}; {spn}" if signal.comment else spn
    text = f"  {signal.name}:{unit} {about}."
    return textwrap.fill(text, 96, subsequent_indent="    ")


def __getattr__(name: str) -> Any:
    """Looks up a typed group by its class name, for `from iits_mj.j1939.groups import EEC1`."""
    if not name.startswith("_"):
        for kind in group_types().values():
            if kind.__name__ == name:
                return kind
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
