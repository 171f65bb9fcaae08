"""Values of signals to the bytes of a message and back, with J1939-71's codes for no value.

A message is one whole number of the bus's byte order, Intel's, and a signal some bits of it, as
cantools reads them from the DBC; its own coding, which takes twice as long and does not know
J1939's codes, is what the tests hold this one to. What the raw numbers of a signal mean is J1939's:

| width | valid | out of range | error | not available |
|---|---|---|---|---|
| 8 bit | 0 .. 0xFA | 0xFB .. 0xFD | 0xFE | 0xFF |
| 16 bit | 0 .. 0xFAFF | 0xFB00 .. 0xFDFF | 0xFE00 .. 0xFEFF | 0xFF00 .. 0xFFFF |
| 32 bit | 0 .. 0xFAFFFFFF | .. 0xFDFFFFFF | 0xFE000000 .. | 0xFF000000 .. |
| switches, 2 bit | 0, 1 | - | 2 | 3 |

Other narrow fields (modes, counters) use all their values; the DBC's value table names the codes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import cantools.database.can

from iits_mj.core.errors import BusError
from iits_mj.j1939.group import NOT_AVAILABLE, Status, Value


@dataclass(frozen=True, slots=True)
class Signal:
    """Bits of a message and what they mean.

    Attributes:
      name: in the DBC.
      start: place of the lowest bit; length: [bit].
      scale, offset: value = raw number * scale + offset.
      top: the greatest valid raw number; error, missing: codes, missing being all ones.
      unit: of the signal, in that of the values that a caller has.
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
        """A signal as the DBC has it.

        Raises:
          BusError: it is not an unsigned field of Intel byte order.
        """
        if signal.is_signed or signal.is_float or signal.byte_order != "little_endian":
            raise BusError(f"signal {signal.name}: an unsigned field of Intel order is wanted")
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
        scale, offset = float(signal.scale), float(signal.offset)
        return cls(signal.name, signal.start, width, scale, offset, top, error, ones)

    def status(self, raw: int) -> Status:
        """What a raw number above the valid ones says."""
        if self.length >= 8:
            high = raw >> (self.length - 8)
            codes = {0xFF: Status.NOT_AVAILABLE, 0xFE: Status.ERROR}
            return codes.get(high, Status.OUT_OF_RANGE)
        return Status.ERROR if raw == self.error else Status.NOT_AVAILABLE

    def raw(self, value: Value | None, saturate: bool) -> int:
        """The raw number of a value; None is "not available".

        Raises:
          BusError: a number is not finite or out of range, or a code is not in the signal.
        """
        if value is None:
            return self.missing
        if isinstance(value, Status):
            return self._code(value)
        try:
            raw = round((value / self.unit - self.offset) / self.scale)
        except (ValueError, OverflowError) as error:
            wanted = "a finite number is wanted"
            raise BusError(f"signal {self.name} = {value!r}: {wanted}") from error
        if not 0 <= raw <= self.top:
            if not saturate:
                ends = (self.offset, self.top * self.scale + self.offset)
                low, high = sorted(end * self.unit for end in ends)
                raise BusError(f"signal {self.name} = {value!r}: allowed is {low:g} to {high:g}")
            raw = min(max(raw, 0), self.top)
        return raw

    def _code(self, status: Status) -> int:
        if status is Status.NOT_AVAILABLE:
            return self.missing
        if status is Status.OUT_OF_RANGE or self.error is None:
            raise BusError(f"signal {self.name} has no code for {status.value!r}")
        return self.error


class Codec:
    """Signals of a message, all or some, in an order of one's own.

    Args:
      message: its name.
      length: of the message [byte].
      signals: the values are theirs, in this order; all other bits are ones, "not available".
    """

    __slots__ = ("_length", "_message", "_rules", "_signals", "_unknown")

    def __init__(self, message: str, length: int, signals: Iterable[Signal]) -> None:
        self._message = message
        self._length = length
        self._signals = tuple(signals)
        self._unknown = (1 << 8 * length) - 1
        # Flat for speed.
        self._rules = [
            (s.start, s.missing, s.top, s.scale, s.offset, s.unit, s) for s in self._signals
        ]

    def part(self, units: Mapping[str, float]) -> Codec:
        """The same message with these signals only, each with the unit of `Signal`."""
        known = {signal.name: signal for signal in self._signals}
        signals = [replace(known[name], unit=unit) for name, unit in units.items()]
        return Codec(self._message, self._length, signals)

    def pack(self, values: Sequence[Value | None], *, saturate: bool = False) -> bytes:
        """The bytes of the message.

        Args:
          values: of the signals; None is "not available".
          saturate: put a number outside the signal's range at its limit instead of refusing it.

        Raises:
          BusError: a number is not finite or out of range, or a code is not in the signal.
        """
        # All bits are ones until a field is known.
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
        """The values of the signals: numbers, floats all of them, or what the codes say.

        Raises:
          BusError: the bytes have not the length of the message.
        """
        if len(data) != self._length:
            raise BusError(f"{self._message} has {len(data)} bytes: {self._length} are wanted")
        whole = int.from_bytes(data, "little")
        return [
            (number * scale + offset) * unit
            if (number := whole >> start & missing) <= top
            else NOT_AVAILABLE
            if number == missing
            else signal.status(number)
            for start, missing, top, scale, offset, unit, signal in self._rules
        ]
