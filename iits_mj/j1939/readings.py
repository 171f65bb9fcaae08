"""What a bus says, frame by frame, with names and units: known or not, in one frame or in many."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from iits_mj.core.errors import BusError
from iits_mj.j1939.database import decode
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Group, Status, layouts
from iits_mj.j1939.long_groups import LongGroup, read_group
from iits_mj.j1939.transport import CONNECTION, TRANSFER, Reassembler

OK = "ok"
UNKNOWN = "unknown group"
PACKET = "part of a long message"
INVALID = "wrong length"
_TRANSPORT = {CONNECTION: "TP.CM", TRANSFER: "TP.DT"}


class Entry(NamedTuple):
    """A signal: its value, a number or a text, where `status` is `OK`, else raw bytes or None.

    Attributes:
      signal: name; "data" for the raw bytes of what is not decoded, in hex.
      spn: its number, 0 for our own; unit: of the number.
      status: `OK`, "not available", "error", "out of range", `UNKNOWN`, `PACKET`, `INVALID`.
    """

    signal: str
    spn: int
    value: float | str | None
    unit: str
    status: str


@dataclass(frozen=True, slots=True)
class Reading:
    """A frame, or a long message when its last frame has come.

    Attributes:
      time: [s]; source, destination: addresses.
      priority: 0 to 7; None for a long message, whose packets do not tell it.
      pgn: parameter group number.
      message: name of the group; empty when it is not known.
      entries: its signals.
    """

    time: float
    priority: int | None
    pgn: int
    message: str
    source: int
    destination: int
    entries: tuple[Entry, ...]


class BusReader:
    """Reads all frames of a bus; never raises.

    Attributes:
      transport: puts long messages together and counts what failed.
    """

    def __init__(self) -> None:
        self.transport = Reassembler()

    def read(self, frame: Frame) -> Iterator[Reading]:
        """The reading of the frame, and of the long message that it completes."""
        pgn, source, destination = frame.pgn, frame.source, frame.destination
        message, entries = _content(frame, pgn)
        yield Reading(frame.time, frame.priority, pgn, message, source, destination, entries)
        if pgn in _TRANSPORT:
            whole = self.transport.receive(frame)
            if whole is not None:
                name, entries = _long_content(whole.pgn, whole.data)
                yield Reading(
                    whole.time, None, whole.pgn, name, whole.source, whole.destination, entries
                )


def _content(frame: Frame, pgn: int) -> tuple[str, tuple[Entry, ...]]:
    if pgn in _TRANSPORT:
        return _TRANSPORT[pgn], _raw(frame.data, PACKET)
    try:
        decoded = decode(frame)
    except BusError:
        return _known_names()[pgn], _raw(frame.data, INVALID)
    if decoded is None:
        # Those of varying length may fit into one frame.
        return _long_content(pgn, frame.data)
    return decoded.name, _group_entries(decoded.group)


def _long_content(pgn: int, data: bytes) -> tuple[str, tuple[Entry, ...]]:
    try:
        group = read_group(pgn, data)
    except BusError:
        return _known_names().get(pgn, ""), _raw(data, INVALID)
    if group is None:
        return "", _raw(data, UNKNOWN)
    if isinstance(group, LongGroup):
        entries = (_entry(name, spn, "", value) for name, spn, value in group.entries())
        return group.MESSAGE, tuple(entries)
    return group.MESSAGE, _group_entries(group)


def _group_entries(group: Group) -> tuple[Entry, ...]:
    names = _signals(group.MESSAGE)
    return tuple(
        _entry(name, spn, unit, value)
        for (name, value), (spn, unit) in zip(group.items(), names, strict=True)
    )


def _entry(name: str, spn: int, unit: str, value: float | str | Status) -> Entry:
    if isinstance(value, Status):
        return Entry(name, spn, None, unit, value.value)
    return Entry(name, spn, value, unit, OK)


def _raw(data: bytes, status: str) -> tuple[Entry, ...]:
    return (Entry("data", 0, data.hex(), "hex", status),)


@functools.cache
def _signals(message: str) -> tuple[tuple[int, str], ...]:
    """SPN and unit of a message's signals, in the order of the DBC."""
    signals = layouts().get_message_by_name(message).signals
    return tuple((signal.spn or 0, signal.unit or "") for signal in signals)


@functools.cache
def _known_names() -> dict[int, str]:
    names = {Frame(message.frame_id, b"").pgn: message.name for message in layouts().messages}
    return names | {kind.PGN: kind.MESSAGE for kind in LongGroup.__subclasses__()}
