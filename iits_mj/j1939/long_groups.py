"""The content of messages of any length: those of the DBC and those of varying length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import ClassVar, Self, TypeAlias

from iits_mj.core.errors import BusError
from iits_mj.j1939.database import pgn_of, unpack
from iits_mj.j1939.group import NOT_AVAILABLE, Group, Status, Value, layouts

# --- What the messages of varying length have in common; the DBC cannot hold them ---

TextValue: TypeAlias = Value | str


@dataclass(frozen=True, slots=True)
class LongGroup:
    """A parameter group whose length depends on its content.

    Attributes:
      MESSAGE: its short name; PGN: its number.
    """

    MESSAGE: ClassVar[str] = ""
    PGN: ClassVar[int] = -1

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The group in the bytes of a message; BusError when they cannot be one."""
        raise NotImplementedError

    def to_bytes(self) -> bytes:
        """The bytes of the message; BusError when the content cannot be sent."""
        raise NotImplementedError

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and content of each field."""
        raise NotImplementedError


def text_of(data: bytes) -> str:
    """Text as control units send it: without filling, and "?" for what is no printable ASCII."""
    characters = data.rstrip(b"\xff\x00").decode("latin-1")
    shown = (c if c.isascii() and c.isprintable() else "?" for c in characters)
    return "".join(shown).strip()


def bytes_of(field: str, text: str) -> bytes:
    """A text field, ended by its "*"; BusError when it cannot stand in one."""
    if not (text.isascii() and text.isprintable()) or "*" in text or len(text) > 200:
        raise BusError(
            f"{field} {text!r}: at most 200 printable ASCII characters without '*' allowed"
        )
    return text.encode("ascii") + b"*"


# --- Who a control unit is: vehicle, component and software identification (SAE J1939-71) ---
# Text fields, each ended by "*". Readers of real trucks must do without the last "*".

_MAX_FIELDS = 250


@dataclass(frozen=True, slots=True)
class VehicleIdentification(LongGroup):
    """VI, PGN 65260.

    Attributes:
      vehicle_identification_number: SPN 237.
    """

    MESSAGE: ClassVar[str] = "VI"
    PGN: ClassVar[int] = 65260

    vehicle_identification_number: str = ""

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """What stands before the first "*"; no text is too short."""
        return cls(text_of(data.split(b"*")[0]))

    def to_bytes(self) -> bytes:
        """The bytes of the message."""
        return bytes_of("vehicle identification number", self.vehicle_identification_number)

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and text."""
        yield "vehicle_identification_number", 237, self.vehicle_identification_number


@dataclass(frozen=True, slots=True)
class ComponentIdentification(LongGroup):
    """CI, PGN 65259; a field that is not told is empty.

    Attributes:
      make, model, serial_number, unit_number: SPN 586, 587, 588, 233.
    """

    MESSAGE: ClassVar[str] = "CI"
    PGN: ClassVar[int] = 65259

    make: str = ""
    model: str = ""
    serial_number: str = ""
    unit_number: str = ""

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The first four fields; those left out are empty."""
        return cls(*map(text_of, data.split(b"*")[:4]))

    def to_bytes(self) -> bytes:
        """The bytes of the message."""
        return b"".join(bytes_of(f.name, getattr(self, f.name)) for f in fields(self))

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and text of the four fields."""
        for field, spn in zip(fields(self), (586, 587, 588, 233), strict=True):
            yield field.name, spn, getattr(self, field.name)


@dataclass(frozen=True, slots=True)
class SoftwareIdentification(LongGroup):
    """SOFT, PGN 65242.

    Attributes:
      versions: SPN 234, one text a field.
    """

    MESSAGE: ClassVar[str] = "SOFT"
    PGN: ClassVar[int] = 65242

    versions: tuple[str, ...] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The fields, at most as many as the first byte says; BusError without that byte."""
        if not data:
            raise BusError("SOFT has 0 bytes: at least the number of its fields is wanted")
        texts = data[1:].split(b"*")
        if not texts[-1].strip(b" \xff\x00"):
            texts.pop()
        return cls(tuple(map(text_of, texts[: data[0]])))

    def to_bytes(self) -> bytes:
        """The bytes of the message."""
        if len(self.versions) > _MAX_FIELDS:
            raise BusError(f"{len(self.versions)} software versions: at most {_MAX_FIELDS} allowed")
        texts = b"".join(bytes_of("software version", text) for text in self.versions)
        return bytes([len(self.versions)]) + texts

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and text of each version."""
        for number, text in enumerate(self.versions, start=1):
            yield f"software_version_{number}", 234, text


# --- Active faults of a control unit: DM1 (SAE J1939-73), in one frame or in many ---

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


# --- The content of messages of any length: those of the DBC and those of varying length ---

_VARYING: dict[int, type[LongGroup]] = {
    kind.PGN: kind
    for kind in (
        ActiveFaults,
        ComponentIdentification,
        SoftwareIdentification,
        VehicleIdentification,
    )
}
# Configurations have grown over the years; the first so many bytes were always there.
_GROWN = {"EC1": 28, "RC": 19}


def read_group(pgn: int, data: bytes) -> Group | LongGroup | None:
    """The group in the bytes of a message of any length; None for a PGN that is not known.

    EC1 and RC of older and newer control units are shorter or longer: what is missing is not
    available, what is beyond is left out.

    Raises:
      BusError: the bytes have not the length of the group.
    """
    varying = _VARYING.get(pgn)
    if varying is not None:
        return varying.from_bytes(data)
    for name, least in _GROWN.items():
        if pgn == pgn_of(name):
            length = layouts().get_message_by_name(name).length
            if len(data) < least:
                raise BusError(f"{name} has {len(data)} bytes: at least {least} are wanted")
            data = data[:length].ljust(length, b"\xff")
    return unpack(pgn, data)
