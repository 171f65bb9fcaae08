"""Typed groups to bytes and back, by our DBC file, with J1939-71's "error" and "not available".

cantools reads the layouts, the bit fields are taken apart and put together by bitstruct, which
cantools uses, too; what the raw numbers mean is J1939's:

| width | valid | out of range | error | not available |
|---|---|---|---|---|
| 8 bit | 0 .. 0xFA | 0xFB .. 0xFD | 0xFE | 0xFF |
| 16 bit | 0 .. 0xFAFF | 0xFB00 .. 0xFDFF | 0xFE00 .. 0xFEFF | 0xFF00 .. 0xFFFF |
| 32 bit | 0 .. 0xFAFFFFFF | .. 0xFDFFFFFF | 0xFE000000 .. | 0xFF000000 .. |
| switches, 2 bit | 0, 1 | - | 2 | 3 |

Other narrow fields (modes, counters) use all their values; the DBC's value table names the codes.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import bitstruct
import cantools.database.can

from iits_mj.errors import BusError
from iits_mj.j1939 import groups
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id
from iits_mj.j1939.group import NOT_AVAILABLE, Group, Status, Value
from iits_mj.j1939.layouts import class_name, layouts

try:
    from bitstruct.c import compile as _compile
except ImportError:
    # Slower, where there is no C extension.
    from bitstruct import compile as _compile


@dataclass(frozen=True, slots=True)
class Decoded:
    """A frame's content.

    Attributes:
      group: the typed message; source, destination: addresses; time: [s].
    """

    group: Group
    source: int
    destination: int
    time: float

    @property
    def name(self) -> str:
        """Of the message in the DBC."""
        return self.group.MESSAGE


@dataclass(frozen=True, slots=True)
class _Signal:
    """A signal's scale and raw numbers: top is the greatest valid one, error and missing codes."""

    name: str
    length: int
    scale: float
    offset: float
    top: int
    error: int | None
    missing: int

    def status(self, raw: int) -> Status:
        """What a raw number above the valid ones says."""
        if self.length >= 8:
            high = raw >> (self.length - 8)
            codes = {0xFF: Status.NOT_AVAILABLE, 0xFE: Status.ERROR}
            return codes.get(high, Status.OUT_OF_RANGE)
        return Status.ERROR if raw == self.error else Status.NOT_AVAILABLE

    def raw(self, value: Value, saturate: bool) -> int:
        if isinstance(value, Status):
            return self._code(value)
        try:
            raw = round((value - self.offset) / self.scale)
        except (ValueError, OverflowError) as error:
            wanted = "a finite number is wanted"
            raise BusError(f"signal {self.name} = {value!r}: {wanted}") from error
        if not 0 <= raw <= self.top:
            if not saturate:
                low, high = self.offset, self.top * self.scale + self.offset
                raise BusError(f"signal {self.name} = {value!r}: allowed is {low:g} to {high:g}")
            raw = min(max(raw, 0), self.top)
        return raw

    def _code(self, status: Status) -> int:
        if status is Status.NOT_AVAILABLE:
            return self.missing
        if status is Status.OUT_OF_RANGE or self.error is None:
            raise BusError(f"signal {self.name} has no code for {status.value!r}")
        return self.error


@dataclass(frozen=True, slots=True)
class _Message:
    layout: cantools.database.can.Message
    type: type[Group]
    length: int
    pgn: int
    priority: int
    source: int
    destination: int
    signals: tuple[_Signal, ...]
    # The same, flat for speed: top, scale, offset and the signal itself.
    rules: tuple[tuple[int, float, float, _Signal], ...]
    # The bit fields of the bytes in reverse, from the last signal to the first.
    bits: bitstruct.CompiledFormat
    # All fields of a group at once.
    values_of: Callable[[Group], tuple[Value, ...]]


def message_names() -> tuple[str, ...]:
    """Names of all messages of the DBC."""
    return tuple(_by_name())


def group_type(name: str) -> type[Group]:
    """The typed group of a message; BusError for an unknown name."""
    return _message(name).type


def make_group(name: str, values: Mapping[str, Value]) -> Group:
    """The group of a message from its signals by name; those left out say "not available".

    Raises:
      BusError: unknown message or signal.
    """
    message = _message(name)
    known = [signal.name for signal in message.signals]
    for signal in values:
        if signal not in known:
            raise BusError(f"message {name} has no signal {signal!r}; it has {known}")
    return message.type(**values)


def pgn_of(name: str) -> int:
    """Parameter group number of a message; BusError for an unknown name."""
    return _message(name).pgn


def cycle_time(name: str) -> float:
    """Period at which a message is sent [s]; BusError for an unknown name."""
    return (_message(name).layout.cycle_time or 0) * 1e-3


def decode(frame: Frame) -> Decoded | None:
    """The group in a frame, matched by PGN from any source; None for a PGN not in the DBC.

    Raises:
      BusError: the frame has not the length of its group.
    """
    message, source, destination = _addressed(frame.can_id)
    if message is None:
        return None
    return Decoded(_unpack(message, frame.data), source, destination, frame.time)


def unpack(pgn: int, data: bytes) -> Group | None:
    """The group in the bytes of a message of any length; None for a PGN not in the DBC.

    Raises:
      BusError: the bytes have not the length of the group.
    """
    message = _by_pgn().get(pgn)
    return None if message is None else _unpack(message, data)


def encode(
    group: Group,
    *,
    time: float = 0.0,
    source: int | None = None,
    destination: int | None = None,
    saturate: bool = False,
) -> Frame:
    """A frame with this group.

    Args:
      group: one of at most 8 bytes.
      time: of the frame [s].
      source: sender's address; default the DBC's.
      destination: receiver's address; default the DBC's.
      saturate: put a number outside the signal's range at its limit instead of refusing it.

    Raises:
      BusError: a number is not finite or out of range, or a code is not in the signal.
    """
    message = _message(group.MESSAGE)
    can_id = _identifier(
        message.priority,
        message.pgn,
        message.source if source is None else source,
        message.destination if destination is None else destination,
    )
    return Frame(can_id, _pack(message, group, saturate), time)


def pack(group: Group, *, saturate: bool = False) -> bytes:
    """The bytes of a group of any length; arguments and errors as in `encode`."""
    return _pack(_message(group.MESSAGE), group, saturate)


def _pack(message: _Message, group: Group, saturate: bool) -> bytes:
    values = message.values_of(group)
    try:
        # The usual case in one go: numbers within their range, and what is not known.
        raw = [
            signal.missing
            if value is NOT_AVAILABLE
            else number
            if 0 <= (number := round((value - offset) / scale)) <= top  # type: ignore[operator]
            else signal.raw(value, saturate)
            for value, (top, scale, offset, signal) in zip(values, message.rules, strict=True)
        ]
    except (TypeError, ValueError, OverflowError):
        raw = [s.raw(v, saturate) for v, s in zip(values, message.signals, strict=True)]
    raw.reverse()
    return bytes(message.bits.pack(*raw)[::-1])


def _unpack(message: _Message, data: bytes) -> Group:
    if len(data) != message.length:
        name, wanted = message.layout.name, message.length
        raise BusError(f"{name} has {len(data)} bytes: {wanted} are wanted")
    numbers = reversed(message.bits.unpack(data[::-1]))
    values = [
        number * scale + offset
        if number <= top
        else NOT_AVAILABLE
        if number == signal.missing
        else signal.status(number)
        for number, (top, scale, offset, signal) in zip(numbers, message.rules, strict=True)
    ]
    return message.type(*values)


def _message(name: str) -> _Message:
    message = _by_name().get(name)
    if message is None:
        raise BusError(f"message {name!r} is not in the DBC; there are {list(_by_name())}")
    return message


_identifier = functools.lru_cache(maxsize=4096)(make_id)


@functools.lru_cache(maxsize=4096)
def _addressed(can_id: int) -> tuple[_Message | None, int, int]:
    frame = Frame(can_id, b"")
    return _by_pgn().get(frame.pgn), frame.source, frame.destination


@functools.cache
def _by_name() -> dict[str, _Message]:
    return {layout.name: _flatten(layout) for layout in layouts().messages}


@functools.cache
def _by_pgn() -> dict[int, _Message]:
    return {message.pgn: message for message in _by_name().values()}


def _flatten(layout: cantools.database.can.Message) -> _Message:
    frame = Frame(layout.frame_id, b"")
    kind: type[Group] | None = getattr(groups, class_name(layout.name), None)
    names = [signal.name for signal in layout.signals]
    if kind is None or [field.name for field in fields(kind)] != names:
        raise BusError(
            f"groups.py does not have {layout.name}'s fields: run python -m iits_mj.j1939"
        )
    signals = tuple(_signal(signal) for signal in layout.signals)
    return _Message(
        layout,
        kind,
        layout.length,
        frame.pgn,
        frame.priority,
        frame.source,
        frame.destination if frame.pgn < 0xF000 else GLOBAL_ADDRESS,
        signals,
        tuple((s.top, s.scale, s.offset, s) for s in signals),
        _bits(layout),
        operator.attrgetter(*names),
    )


def _bits(layout: cantools.database.can.Message) -> bitstruct.CompiledFormat:
    """The fields of a little-endian message, unused bits being ones as J1939 has them.

    Raises:
      BusError: the DBC holds a signal that is not an unsigned little-endian field.
    """
    fields_down, free = "", 8 * layout.length
    for signal in reversed(layout.signals):
        gap = free - signal.start - signal.length
        if signal.is_signed or signal.is_float or signal.byte_order != "little_endian" or gap < 0:
            raise BusError(
                f"{layout.name}.{signal.name}: an unsigned field of Intel order is wanted"
            )
        fields_down += (f"P{gap}" if gap else "") + f"u{signal.length}"
        free = signal.start
    return _compile(fields_down + (f"P{free}" if free else ""))


def _signal(signal: cantools.database.can.Signal) -> _Signal:
    width = signal.length
    codes = {str(name): int(raw) for raw, name in (signal.choices or {}).items()}
    error, missing = codes.get("error"), codes.get("not_available")
    top = ones = (1 << width) - 1
    if width >= 8:
        shift = width - 8
        top, error = (0xFB << shift) - 1, 0xFE << shift
    else:
        # The codes are the highest numbers of a field.
        top = min(code - 1 for code in (error, missing, top + 1) if code is not None)
    return _Signal(signal.name, width, float(signal.scale), float(signal.offset), top, error, ones)
