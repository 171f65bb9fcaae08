"""Active faults of a control unit: DM1 (SAE J1939-73), in one frame or in many."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self

from iits_mj.errors import BusError
from iits_mj.j1939.group import NOT_AVAILABLE, Status, Value
from iits_mj.j1939.long_group import LongGroup, TextValue

# Names and SPNs from the lowest bits up: the lamps of byte 1, how they flash of byte 2.
_LAMPS = (
    ("protect_lamp", 987),
    ("amber_warning_lamp", 624),
    ("red_stop_lamp", 623),
    ("malfunction_lamp", 1213),
)
_FLASHES = (
    ("flash_protect_lamp", 3041),
    ("flash_amber_warning_lamp", 3040),
    ("flash_red_stop_lamp", 3039),
    ("flash_malfunction_lamp", 3038),
)
_CODES = {2: Status.ERROR, 3: Status.NOT_AVAILABLE}
_MIN_LENGTH = 6
_SINGLE_FRAME = 8
_NO_FAULT = (bytes(4), b"\xff" * 4)
_MAX_SPN, _MAX_FMI, _NO_COUNT = (1 << 19) - 1, 31, 127


@dataclass(frozen=True, slots=True)
class Fault:
    """A diagnostic trouble code.

    Attributes:
      spn: what is at fault, 0 to 524287; of 19 bits in Intel order, as version 4 of the conversion
        has it.
      fmi: how it fails, 0 to 31.
      occurrences: how often, 0 to 126, or not available.
      old_conversion: the SPN is in one of the orders before version 4, which the message does not
        name, so `spn` may be another.
    """

    spn: int
    fmi: int
    occurrences: int | Status = NOT_AVAILABLE
    old_conversion: bool = False


@dataclass(frozen=True, slots=True)
class ActiveFaults(LongGroup):
    """DM1, PGN 65226: lamps (0 off, 1 on) and faults that are there now.

    Attributes:
      protect_lamp, amber_warning_lamp, red_stop_lamp, malfunction_lamp: SPN 987, 624, 623, 1213.
      flash_*: 0 slowly, 1 fast, not available: does not flash. SPN 3041, 3040, 3039, 3038.
      faults: empty when there are none.
    """

    MESSAGE: ClassVar[str] = "DM1"
    PGN: ClassVar[int] = 65226

    protect_lamp: Value = NOT_AVAILABLE
    amber_warning_lamp: Value = NOT_AVAILABLE
    red_stop_lamp: Value = NOT_AVAILABLE
    malfunction_lamp: Value = NOT_AVAILABLE
    flash_protect_lamp: Value = NOT_AVAILABLE
    flash_amber_warning_lamp: Value = NOT_AVAILABLE
    flash_red_stop_lamp: Value = NOT_AVAILABLE
    flash_malfunction_lamp: Value = NOT_AVAILABLE
    faults: tuple[Fault, ...] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Lamps and faults; filling at the end is left out. BusError below 6 bytes."""
        if len(data) < _MIN_LENGTH:
            raise BusError(f"DM1 has {len(data)} bytes: at least {_MIN_LENGTH} are wanted")
        codes = (data[2 + 4 * i : 6 + 4 * i] for i in range((len(data) - 2) // 4))
        faults = tuple(_fault(code) for code in codes if code not in _NO_FAULT)
        switches = _switches(data[0], _LAMPS) | _switches(data[1], _FLASHES)
        return cls(**switches, faults=faults)

    def to_bytes(self) -> bytes:
        """The bytes: 8 with at most one fault, else 2 and 4 for each."""
        lamps = (_packed(self, _LAMPS), _packed(self, _FLASHES))
        codes = b"".join(map(_code, self.faults)) or _NO_FAULT[0]
        return (bytes(lamps) + codes).ljust(_SINGLE_FRAME, b"\xff")

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and number of lamps, flashes and of each fault's parts."""
        for name, spn in _LAMPS + _FLASHES:
            yield name, spn, getattr(self, name)
        for number, fault in enumerate(self.faults, start=1):
            yield f"fault_{number}_spn", 1214, float(fault.spn)
            yield f"fault_{number}_fmi", 1215, float(fault.fmi)
            count = fault.occurrences
            yield (
                f"fault_{number}_occurrences",
                1216,
                count if isinstance(count, Status) else float(count),
            )


def _switches(byte: int, names: tuple[tuple[str, int], ...]) -> dict[str, Value]:
    codes = {name: byte >> 2 * i & 3 for i, (name, _) in enumerate(names)}
    return {name: _CODES.get(code, float(code)) for name, code in codes.items()}


def _packed(faults: ActiveFaults, names: tuple[tuple[str, int], ...]) -> int:
    byte = 0
    for i, (name, _) in enumerate(names):
        value = getattr(faults, name)
        code = {Status.ERROR: 2, Status.NOT_AVAILABLE: 3, 0.0: 0, 1.0: 1}.get(value)
        if code is None:
            raise BusError(f"DM1's {name} = {value!r}: 0, 1, error or not available allowed")
        byte |= code << 2 * i
    return byte


def _fault(code: bytes) -> Fault:
    count = code[3] & 0x7F
    return Fault(
        spn=code[0] | code[1] << 8 | (code[2] >> 5) << 16,
        fmi=code[2] & 0x1F,
        occurrences=NOT_AVAILABLE if count == _NO_COUNT else count,
        old_conversion=bool(code[3] & 0x80),
    )


def _code(fault: Fault) -> bytes:
    count = _NO_COUNT if isinstance(fault.occurrences, Status) else fault.occurrences
    limits = (
        ("spn", fault.spn, _MAX_SPN),
        ("fmi", fault.fmi, _MAX_FMI),
        ("occurrences", count, 127),
    )
    for name, value, limit in limits:
        if not 0 <= value <= limit:
            raise BusError(f"fault's {name} = {value!r}: 0 to {limit} allowed")
    last = count | (0x80 if fault.old_conversion else 0)
    return bytes([fault.spn & 0xFF, fault.spn >> 8 & 0xFF, fault.spn >> 16 << 5 | fault.fmi, last])
