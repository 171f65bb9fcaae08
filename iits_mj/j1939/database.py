"""Signals to bytes and back, by our DBC file, with J1939-71's "error" and "not available" codes.

| width | valid | out of range | error | not available |
|---|---|---|---|---|
| 8 bit | 0 .. 0xFA | 0xFB .. 0xFD | 0xFE | 0xFF |
| 16 bit | 0 .. 0xFAFF | 0xFB00 .. 0xFDFF | 0xFE00 .. 0xFEFF | 0xFF00 .. 0xFFFF |
| 32 bit | 0 .. 0xFAFFFFFF | .. 0xFDFFFFFF | 0xFE000000 .. | 0xFF000000 .. |
| switches, 2 bit | 0, 1 | - | 2 | 3 |

Other narrow fields (modes, counters) use all their values; the DBC's value table names the codes.
"""

from __future__ import annotations

import enum
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cantools.database

from iits_mj.errors import BusError
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id


class Status(enum.Enum):
    """What a field says when it carries no value."""

    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"


@dataclass(frozen=True, slots=True)
class Decoded:
    """A frame's signals: numbers in the DBC's units, or a `Status`.

    Attributes:
      name: of the message in the DBC; source, destination: addresses; time: [s].
      values: signal name to number or `Status`.
    """

    name: str
    source: int
    destination: int
    time: float
    values: dict[str, float | Status]

    def number(self, signal: str) -> float:
        """The signal's number.

        Raises:
          BusError: the sender says error, not available, or a value outside the signal's range.
        """
        value = self.values[signal]
        if isinstance(value, Status):
            raise BusError(f"{self.name}.{signal} carries no value: {value.value}")
        return value


@dataclass(frozen=True, slots=True)
class _Signal:
    name: str
    start: int
    length: int
    scale: float
    offset: float
    top: int
    error: int | None
    not_available: int | None

    def decode(self, raw: int) -> float | Status:
        if raw <= self.top and raw not in (self.error, self.not_available):
            # The error code 2 of a switch lies above its top.
            return raw * self.scale + self.offset
        return self._status(raw)

    def _status(self, raw: int) -> Status:
        if self.length >= 8:
            high = raw >> (self.length - 8)
            codes = {0xFF: Status.NOT_AVAILABLE, 0xFE: Status.ERROR}
            return codes.get(high, Status.OUT_OF_RANGE)
        return Status.ERROR if raw == self.error else Status.NOT_AVAILABLE

    def encode(self, value: float | Status | None, saturate: bool) -> int:
        if value is None or value is Status.NOT_AVAILABLE:
            return (1 << self.length) - 1
        if isinstance(value, Status):
            if self.error is None:
                raise BusError(f"signal {self.name} has no code for {value.value!r}")
            return self.error
        if not math.isfinite(value):
            raise BusError(f"signal {self.name} = {value!r}: a finite number is wanted")
        raw = round((value - self.offset) / self.scale)
        if not 0 <= raw <= self.top:
            if not saturate:
                low, high = self.offset, self.top * self.scale + self.offset
                raise BusError(f"signal {self.name} = {value!r}: allowed is {low:g} to {high:g}")
            raw = min(max(raw, 0), self.top)
        return raw


@dataclass(frozen=True, slots=True)
class _Message:
    name: str
    pgn: int
    priority: int
    source: int
    destination: int
    cycle_time: float
    signals: tuple[_Signal, ...]


def database_path() -> Path:
    """Our DBC file, for other CAN tools."""
    return Path(__file__).with_name("iits_mj.dbc")


def message_names() -> tuple[str, ...]:
    """Names of all messages of the DBC."""
    return tuple(_by_name())


def pgn_of(name: str) -> int:
    """Parameter group number of a message; BusError for an unknown name."""
    return _message(name).pgn


def cycle_time(name: str) -> float:
    """Period at which a message is sent [s]; BusError for an unknown name."""
    return _message(name).cycle_time


def decode(frame: Frame) -> Decoded | None:
    """Signals of a frame, matched by PGN from any source; None for a group that is not in the DBC.

    Raises:
      BusError: the frame is shorter than the 8 bytes of its group.
    """
    message = _by_pgn().get(frame.pgn)
    if message is None:
        return None
    if len(frame.data) != 8:
        raise BusError(f"{message.name} has {len(frame.data)} bytes: 8 are wanted")
    word = int.from_bytes(frame.data, "little")
    values = {s.name: s.decode(word >> s.start & (1 << s.length) - 1) for s in message.signals}
    return Decoded(message.name, frame.source, frame.destination, frame.time, values)


def encode(
    name: str,
    values: Mapping[str, float | Status | None],
    *,
    time: float = 0.0,
    source: int | None = None,
    destination: int | None = None,
    saturate: bool = False,
) -> Frame:
    """A frame with these signals; signals left out, and None, say "not available".

    Args:
      name: message name in the DBC.
      values: signal name to number (DBC units), `Status` or None.
      time: of the frame [s].
      source: sender's address; default the DBC's.
      destination: receiver's address; default the DBC's.
      saturate: put a number outside the signal's range at its limit instead of refusing it.

    Raises:
      BusError: unknown message or signal, number not finite or out of range.
    """
    message = _message(name)
    known = {signal.name for signal in message.signals}
    unknown = sorted(set(values) - known)
    if unknown:
        raise BusError(f"message {name} has no signal {unknown[0]!r}; it has {sorted(known)}")
    word = (1 << 64) - 1
    for signal in message.signals:
        mask = (1 << signal.length) - 1
        raw = signal.encode(values.get(signal.name), saturate)
        word = word & ~(mask << signal.start) | raw << signal.start
    can_id = make_id(
        message.priority,
        message.pgn,
        message.source if source is None else source,
        message.destination if destination is None else destination,
    )
    return Frame(can_id, word.to_bytes(8, "little"), time)


def _message(name: str) -> _Message:
    message = _by_name().get(name)
    if message is None:
        raise BusError(f"message {name!r} is not in the DBC; there are {list(_by_name())}")
    return message


@functools.cache
def _by_name() -> dict[str, _Message]:
    """The DBC, read once by cantools and flattened for speed."""
    database = cantools.database.can.Database()
    database.add_dbc_file(str(database_path()))
    return {message.name: _flatten(message) for message in database.messages}


@functools.cache
def _by_pgn() -> dict[int, _Message]:
    return {message.pgn: message for message in _by_name().values()}


def _flatten(message: cantools.database.can.Message) -> _Message:
    frame = Frame(message.frame_id, b"")
    destination = frame.destination if frame.pgn < 0xF000 else GLOBAL_ADDRESS
    signals = []
    for signal in message.signals:
        width = signal.length
        codes = {str(name): int(raw) for raw, name in (signal.choices or {}).items()}
        error, missing = codes.get("error"), codes.get("not_available")
        top = (1 << width) - 1
        if width >= 8:
            shift = width - 8
            top, error, missing = (0xFB << shift) - 1, 0xFE << shift, top
        signals.append(
            _Signal(
                signal.name,
                signal.start,
                width,
                float(signal.scale),
                float(signal.offset),
                top if error is None or width >= 8 else error - 1,
                error,
                missing,
            )
        )
    return _Message(
        message.name,
        frame.pgn,
        frame.priority,
        frame.source,
        destination,
        (message.cycle_time or 0) * 1e-3,
        tuple(signals),
    )
