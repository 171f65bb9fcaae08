"""Typed groups to frames and back, by our DBC.

A message is one whole number in the byte order of the bus (Intel), and a signal is some of its
bits. cantools reads the DBC; the coding is our own, because that of cantools takes twice as long
and does not know the codes of J1939-71 for "no value". The tests compare both. The raw numbers
mean:

| width | valid | out of range | error | not available |
|---|---|---|---|---|
| 8 bit | 0 .. 0xFA | 0xFB .. 0xFD | 0xFE | 0xFF |
| 16 bit | 0 .. 0xFAFF | 0xFB00 .. 0xFDFF | 0xFE00 .. 0xFEFF | 0xFF00 .. 0xFFFF |
| 32 bit | 0 .. 0xFAFFFFFF | .. 0xFDFFFFFF | 0xFE000000 .. | 0xFF000000 .. |
| switches, 2 bit | 0, 1 | - | 2 | 3 |

Other narrow fields (modes, counters) use all their values; the value tables of the DBC name the
codes.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import Frame, make_id
from iits_mj.j1939.groups import NOT_AVAILABLE, Group, Status, Value, group_types, layouts

if TYPE_CHECKING:
    import cantools.database.can

# The highest byte of a raw number above the valid ones, in a signal of 8 bits or more.
_OUT_OF_RANGE, _ERROR, _MISSING = 0xFB, 0xFE, 0xFF


@dataclass(frozen=True, slots=True)
class Signal:
    """Bits of a message and their meaning.

    Attributes:
      name: in the DBC.
      start: index of the lowest bit; length: [bit].
      scale, offset: value = raw number * scale + offset.
      top: the greatest valid raw number; error, missing: codes; missing is all ones.
      unit: one unit of the signal in the unit of the caller's values.
    """

    name: str
    start: int
    length: int
    scale: float
    offset: float
    top: int
    error: int | None
    missing: int
    unit: float = 1.0

    @classmethod
    def of(cls, signal: cantools.database.can.Signal) -> Signal:
        """A signal of the DBC: an unsigned field of Intel byte order."""
        width = signal.length
        ones = (1 << width) - 1
        error: int | None
        if width >= 8:
            shift = width - 8
            top, error = (_OUT_OF_RANGE << shift) - 1, _ERROR << shift
        else:
            codes = {str(name): int(raw) for raw, name in (signal.choices or {}).items()}
            error = codes.get("error")
            # The codes are the highest numbers of a field.
            lowest = (error, codes.get("not_available"), ones + 1)
            top = min(code for code in lowest if code is not None) - 1
        scale, offset = float(signal.scale), float(signal.offset)
        return cls(signal.name, signal.start, width, scale, offset, top, error, ones)

    def status(self, raw: int) -> Status:
        """The status that a raw number above the valid ones stands for."""
        if self.length >= 8:
            codes = {_MISSING: Status.NOT_AVAILABLE, _ERROR: Status.ERROR}
            return codes.get(raw >> (self.length - 8), Status.OUT_OF_RANGE)
        return Status.ERROR if raw == self.error else Status.NOT_AVAILABLE

    def raw(self, value: Value | None, saturate: bool) -> int:
        """The raw number of a value; None is "not available". Errors as in `Codec.pack`."""
        if value is None or value is NOT_AVAILABLE:
            return self.missing
        if isinstance(value, Status):
            if value is Status.OUT_OF_RANGE or self.error is None:
                raise BusError(f"signal {self.name} has no code for {value.value!r}")
            return self.error
        try:
            raw = round((value / self.unit - self.offset) / self.scale)
        except (ValueError, OverflowError) as error:
            message = f"signal {self.name} = {value!r}: a finite number is needed"
            raise BusError(message) from error
        if not 0 <= raw <= self.top:
            if not saturate:
                ends = (self.offset, self.top * self.scale + self.offset)
                low, high = sorted(end * self.unit for end in ends)
                raise BusError(f"signal {self.name} = {value!r}: allowed is {low:g} to {high:g}")
            raw = min(max(raw, 0), self.top)
        return raw


class Codec:
    """Codes and decodes some signals of a message, in the order of the caller.

    Args:
      message: its name.
      length: of the message [byte].
      signals: in the order of the values; all other bits are ones, "not available".
    """

    __slots__ = ("_length", "_message", "_rules", "_signals", "_unknown")

    def __init__(self, message: str, length: int, signals: Sequence[Signal]) -> None:
        self._message = message
        self._length = length
        self._signals = tuple(signals)
        self._unknown = (1 << 8 * length) - 1
        # Flat tuples are faster than attributes.
        self._rules = [
            (s.start, s.missing, s.top, s.scale, s.offset, s.unit, s) for s in self._signals
        ]

    def part(self, units: Mapping[str, float]) -> Codec:
        """The codec of these signals alone, given with the `unit` of each."""
        known = {signal.name: signal for signal in self._signals}
        signals = [replace(known[name], unit=unit) for name, unit in units.items()]
        return Codec(self._message, self._length, signals)

    def pack(self, values: Sequence[Value | None], *, saturate: bool = False) -> bytes:
        """The bytes of the message.

        Args:
          values: of the signals; None is "not available".
          saturate: whether to send the limit of a signal for a number outside its range.

        Raises:
          BusError: a number is not finite or out of range, or a signal does not have the code.
        """
        # The bits of unknown fields are ones.
        whole = self._unknown
        for value, (start, missing, top, scale, offset, unit, signal) in zip(
            values, self._rules, strict=True
        ):
            if value is None or value is NOT_AVAILABLE:
                continue
            try:
                number = round((value / unit - offset) / scale)  # type: ignore[operator]
            except (TypeError, ValueError, OverflowError):
                number = -1
            if not 0 <= number <= top:
                number = signal.raw(value, saturate)
            whole -= (missing - number) << start
        return whole.to_bytes(self._length, "little")

    def unpack(self, data: bytes) -> list[Value]:
        """The values of the signals: floats, or the status that a code stands for.

        Raises:
          BusError: the bytes do not have the length of the message.
        """
        if len(data) != self._length:
            raise BusError(f"{self._message} has {len(data)} bytes: {self._length} are needed")
        whole = int.from_bytes(data, "little")
        return [
            (number * scale + offset) * unit
            if (number := whole >> start & missing) <= top
            else NOT_AVAILABLE
            if number == missing
            else signal.status(number)
            for start, missing, top, scale, offset, unit, signal in self._rules
        ]


@dataclass(frozen=True, slots=True)
class Decoded:
    """The content of a frame.

    Attributes:
      group: the typed message; source, destination: addresses; time: [s].
    """

    group: Group
    source: int
    destination: int
    time: float

    @property
    def name(self) -> str:
        """Name of the message in the DBC."""
        return self.group.MESSAGE


@dataclass(frozen=True, slots=True)
class _Message:
    """A message of the DBC; cycle_time is in seconds, values_of returns all fields of a group."""

    type: type[Group]
    codec: Codec
    cycle_time: float
    pgn: int
    priority: int
    source: int
    destination: int
    values_of: Callable[[Group], tuple[Value, ...]]

    def group(self, data: bytes) -> Group:
        return self.type(*self.codec.unpack(data))


def message_names() -> tuple[str, ...]:
    """Names of all messages of the DBC."""
    return tuple(_by_name())


def group_type(name: str) -> type[Group]:
    """The typed group of a message; BusError for an unknown name."""
    return _message(name).type


def make_group(name: str, values: Mapping[str, Value]) -> Group:
    """The group of a message from values by signal; all other signals are "not available".

    Raises:
      BusError: unknown message or signal.
    """
    kind = group_type(name)
    known = [field.name for field in fields(kind)]
    for signal in values:
        if signal not in known:
            raise BusError(f"message {name} has no signal {signal!r}; it has {known}")
    return kind(**values)


def pgn_of(name: str) -> int:
    """Parameter group number of a message; BusError for an unknown name."""
    return _message(name).pgn


def cycle_time(name: str) -> float:
    """Period at which a message is sent [s]; BusError for an unknown name."""
    return _message(name).cycle_time


def codec_of(name: str) -> Codec:
    """Codec of all signals of a message, in the order of the DBC; BusError for an unknown name."""
    return _message(name).codec


def name_of(pgn: int) -> str | None:
    """Name of the message with a parameter group number; None if the DBC has none."""
    message = _by_pgn().get(pgn)
    return None if message is None else message.type.MESSAGE


@functools.lru_cache(maxsize=4096)
def identifier(name: str, source: int | None = None, destination: int | None = None) -> int:
    """The 29-bit identifier of a message.

    Args:
      name: of the message.
      source: sender's address; default that of the DBC.
      destination: receiver's address; default that of the DBC.

    Raises:
      BusError: unknown message, or an address out of range.
    """
    message = _message(name)
    return make_id(
        message.priority,
        message.pgn,
        message.source if source is None else source,
        message.destination if destination is None else destination,
    )


def decode(frame: Frame) -> Decoded | None:
    """The group in a frame, matched by PGN from any source; None for a PGN not in the DBC.

    Raises:
      BusError: the frame does not have the length of the group.
    """
    message, source, destination = _addressed(frame.can_id)
    if message is None:
        return None
    return Decoded(message.group(frame.data), source, destination, frame.time)


def unpack(pgn: int, data: bytes) -> Group | None:
    """The group in the bytes of a message of any length; None for a PGN not in the DBC.

    Raises:
      BusError: the bytes do not have the length of the group.
    """
    message = _by_pgn().get(pgn)
    return None if message is None else message.group(data)


def encode(
    group: Group,
    *,
    time: float = 0.0,
    source: int | None = None,
    destination: int | None = None,
    saturate: bool = False,
) -> Frame:
    """A frame with this group of at most 8 bytes.

    Args:
      group: to send.
      time: of the frame [s].
      source: sender's address; default that of the DBC.
      destination: receiver's address; default that of the DBC.
      saturate: whether to send the limit of a signal for a number outside its range.

    Raises:
      BusError: a number is not finite or out of range, or a signal does not have the code.
    """
    can_id = identifier(group.MESSAGE, source, destination)
    return Frame(can_id, pack(group, saturate=saturate), time)


def pack(group: Group, *, saturate: bool = False) -> bytes:
    """The bytes of a group of any length; arguments and errors as in `encode`."""
    message = _message(group.MESSAGE)
    return message.codec.pack(message.values_of(group), saturate=saturate)


def _message(name: str) -> _Message:
    message = _by_name().get(name)
    if message is None:
        raise BusError(f"message {name!r} is not in the DBC; there are {list(_by_name())}")
    return message


@functools.lru_cache(maxsize=4096)
def _addressed(can_id: int) -> tuple[_Message | None, int, int]:
    frame = Frame(can_id, b"")
    return _by_pgn().get(frame.pgn), frame.source, frame.destination


@functools.cache
def _by_name() -> dict[str, _Message]:
    return {layout.name: _compile(layout) for layout in layouts().messages}


@functools.cache
def _by_pgn() -> dict[int, _Message]:
    return {message.pgn: message for message in _by_name().values()}


def _compile(layout: cantools.database.can.Message) -> _Message:
    """The message of a layout; BusError for a signal that cannot be coded.

    A signal is an unsigned field of Intel byte order that begins after the previous signal.
    """
    free = 0
    for signal in layout.signals:
        other = signal.is_signed or signal.is_float or signal.byte_order != "little_endian"
        if other or signal.start < free or signal.start + signal.length > 8 * layout.length:
            raise BusError(
                f"{layout.name}.{signal.name}: an unsigned field of Intel order is needed"
            )
        free = signal.start + signal.length
    frame = Frame(layout.frame_id, b"")
    return _Message(
        group_types()[layout.name],
        Codec(layout.name, layout.length, list(map(Signal.of, layout.signals))),
        (layout.cycle_time or 0) * 1e-3,
        frame.pgn,
        frame.priority,
        frame.source,
        frame.destination,
        operator.attrgetter(*(signal.name for signal in layout.signals)),
    )
