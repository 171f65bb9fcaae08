"""Identification and faults of control units: messages of variable length, unknown to a DBC.

Vehicle, component and software identification (SAE J1939-71) are text fields that end with "*";
real trucks omit the last "*". Active faults are DM1 (SAE J1939-73), in one or several frames.
`read_group` reads these and the messages of the DBC from their bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self, TypeAlias

from iits_mj.core.errors import BusError
from iits_mj.j1939.database import pgn_of, unpack
from iits_mj.j1939.groups import NOT_AVAILABLE, Group, Status, Value, layouts

TextValue: TypeAlias = Value | str

# Limits of software versions, and of characters in a text field.
_MAX_FIELDS, _MAX_CHARACTERS = 250, 200


@dataclass(frozen=True, slots=True)
class LongGroup:
    """A parameter group whose length depends on its content, by default on its text fields.

    Attributes:
      MESSAGE: its short name; PGN: its number; SPNS: numbers of its first fields.
    """

    MESSAGE: ClassVar[str] = ""
    PGN: ClassVar[int] = -1
    SPNS: ClassVar[tuple[int, ...]] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The group in the bytes of a message; BusError for invalid bytes.

        Missing text fields are empty; excess fields are dropped.
        """
        return cls(*map(_text, data.split(b"*")[: len(cls.SPNS)]))

    def to_bytes(self) -> bytes:
        """The bytes of the message; BusError for a content that cannot be sent."""
        return b"".join(_text_field(f.name, getattr(self, f.name)) for f in fields(self))

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and content of each field."""
        for field, spn in zip(fields(self), self.SPNS, strict=False):
            yield field.name, spn, getattr(self, field.name)


@dataclass(frozen=True, slots=True)
class VehicleIdentification(LongGroup):
    """VI, PGN 65260.

    Attributes:
      vehicle_identification_number: SPN 237.
    """

    MESSAGE: ClassVar[str] = "VI"
    PGN: ClassVar[int] = 65260
    SPNS: ClassVar[tuple[int, ...]] = (237,)

    vehicle_identification_number: str = ""


@dataclass(frozen=True, slots=True)
class ComponentIdentification(LongGroup):
    """CI, PGN 65259; a missing field is empty.

    Attributes:
      make, model, serial_number, unit_number: SPN 586, 587, 588, 233.
    """

    MESSAGE: ClassVar[str] = "CI"
    PGN: ClassVar[int] = 65259
    SPNS: ClassVar[tuple[int, ...]] = (586, 587, 588, 233)

    make: str = ""
    model: str = ""
    serial_number: str = ""
    unit_number: str = ""


@dataclass(frozen=True, slots=True)
class SoftwareIdentification(LongGroup):
    """SOFT, PGN 65242.

    Attributes:
      versions: SPN 234, one text per field.
    """

    MESSAGE: ClassVar[str] = "SOFT"
    PGN: ClassVar[int] = 65242

    versions: tuple[str, ...] = ()

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The versions, at most as many as the first byte states; BusError without this byte."""
        if not data:
            raise BusError("SOFT has 0 bytes: at least the number of its fields is needed")
        texts = data[1:].split(b"*")
        if not texts[-1].strip(b" \xff\x00"):
            texts.pop()
        return cls(tuple(map(_text, texts[: data[0]])))

    def to_bytes(self) -> bytes:
        """The bytes of the message; BusError for too many versions or invalid characters."""
        if len(self.versions) > _MAX_FIELDS:
            raise BusError(f"{len(self.versions)} software versions: at most {_MAX_FIELDS} allowed")
        texts = b"".join(_text_field("software version", text) for text in self.versions)
        return bytes([len(self.versions)]) + texts

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and text of each version."""
        for number, text in enumerate(self.versions, start=1):
            yield f"software_version_{number}", 234, text


def _text(data: bytes) -> str:
    """The text without padding; "?" replaces unprintable characters."""
    characters = data.rstrip(b"\xff\x00").decode("latin-1")
    shown = (c if c.isascii() and c.isprintable() else "?" for c in characters)
    return "".join(shown).strip()


def _text_field(field: str, text: str) -> bytes:
    if not (text.isascii() and text.isprintable()) or "*" in text or len(text) > _MAX_CHARACTERS:
        raise BusError(
            f"{field} {text!r}: at most {_MAX_CHARACTERS} printable ASCII characters without '*' "
            "allowed"
        )
    return text.encode("ascii") + b"*"


# Values of the codes 0 to 3 of a switch.
_SWITCH_VALUES: tuple[Value, ...] = (0.0, 1.0, Status.ERROR, NOT_AVAILABLE)
_MIN_LENGTH = 6
_SINGLE_FRAME = 8
_NO_FAULT = (bytes(4), b"\xff" * 4)
_MAX_SPN, _MAX_FMI, _NO_COUNT = (1 << 19) - 1, 31, 127


@dataclass(frozen=True, slots=True)
class Fault:
    """A diagnostic trouble code.

    Attributes:
      spn: of the faulty part, 0 to 524287; 19 bits in Intel order (conversion method version 4).
      fmi: failure mode, 0 to 31.
      occurrences: 0 to 126, or not available.
      old_conversion: whether the SPN has one of the bit orders before version 4. The message does
        not state which one, so that `spn` may be wrong.
    """

    spn: int
    fmi: int
    occurrences: int | Status = NOT_AVAILABLE
    old_conversion: bool = False

    @classmethod
    def from_bytes(cls, code: bytes) -> Fault:
        """The fault in the four bytes of its code."""
        count = code[3] & 0x7F
        return cls(
            spn=code[0] | code[1] << 8 | (code[2] >> 5) << 16,
            fmi=code[2] & 0x1F,
            occurrences=NOT_AVAILABLE if count == _NO_COUNT else count,
            old_conversion=bool(code[3] & 0x80),
        )

    def to_bytes(self) -> bytes:
        """The four bytes of the code; BusError for a number out of range."""
        spn, fmi = self.spn, self.fmi
        # The number 127 would mean "not available".
        count, most = self.occurrences, _NO_COUNT - 1
        if isinstance(count, Status):
            count = most = _NO_COUNT
        limits = (("spn", spn, _MAX_SPN), ("fmi", fmi, _MAX_FMI), ("occurrences", count, most))
        for name, value, limit in limits:
            if not 0 <= value <= limit:
                raise BusError(f"fault's {name} = {value!r}: 0 to {limit} allowed")
        last = count | (0x80 if self.old_conversion else 0)
        return bytes([spn & 0xFF, spn >> 8 & 0xFF, spn >> 16 << 5 | fmi, last])


@dataclass(frozen=True, slots=True)
class ActiveFaults(LongGroup):
    """DM1, PGN 65226: lamps (0 off, 1 on) and active faults.

    Attributes:
      protect_lamp, amber_warning_lamp, red_stop_lamp, malfunction_lamp: SPN 987, 624, 623, 1213.
      flash_*: 0 slow, 1 fast, not available: does not flash. SPN 3041, 3040, 3039, 3038.
      faults: empty if there are none.
    """

    MESSAGE: ClassVar[str] = "DM1"
    PGN: ClassVar[int] = 65226
    SPNS: ClassVar[tuple[int, ...]] = (987, 624, 623, 1213, 3041, 3040, 3039, 3038)

    # In the order of the bits: byte 1 has the lamps and byte 2 their flashing, lowest bits first.
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
        """Lamps and faults without padding; BusError below 6 bytes."""
        if len(data) < _MIN_LENGTH:
            raise BusError(f"DM1 has {len(data)} bytes: at least {_MIN_LENGTH} are needed")
        word = int.from_bytes(data[:2], "little")
        lamps = enumerate(fields(cls)[: len(cls.SPNS)])
        switches: dict[str, Any] = {f.name: _SWITCH_VALUES[word >> 2 * i & 3] for i, f in lamps}
        codes = (data[2 + 4 * i : 6 + 4 * i] for i in range((len(data) - 2) // 4))
        faults = tuple(Fault.from_bytes(code) for code in codes if code not in _NO_FAULT)
        return cls(**switches, faults=faults)

    def to_bytes(self) -> bytes:
        """The bytes: 8 with at most one fault, else 2 plus 4 per fault."""
        word = 0
        for place, (name, _, value) in enumerate(LongGroup.entries(self)):
            if value not in _SWITCH_VALUES:
                raise BusError(f"DM1's {name} = {value!r}: 0, 1, error or not available allowed")
            word |= _SWITCH_VALUES.index(value) << 2 * place
        codes = b"".join(fault.to_bytes() for fault in self.faults) or _NO_FAULT[0]
        return (word.to_bytes(2, "little") + codes).ljust(_SINGLE_FRAME, b"\xff")

    def entries(self) -> Iterator[tuple[str, int, TextValue]]:
        """Name, SPN and value of lamps, flashing and the parts of each fault."""
        yield from LongGroup.entries(self)
        for number, fault in enumerate(self.faults, start=1):
            count = fault.occurrences
            known = count if isinstance(count, Status) else float(count)
            yield f"fault_{number}_spn", 1214, float(fault.spn)
            yield f"fault_{number}_fmi", 1215, float(fault.fmi)
            yield f"fault_{number}_occurrences", 1216, known


LONG_GROUPS: tuple[type[LongGroup], ...] = (
    ActiveFaults,
    ComponentIdentification,
    SoftwareIdentification,
    VehicleIdentification,
)
_BY_PGN = {kind.PGN: kind for kind in LONG_GROUPS}
# Least bytes of the configurations, which later versions of the standard extend.
_LEAST_LENGTHS = {"EC1": 28, "RC": 19}


def read_group(pgn: int, data: bytes) -> Group | LongGroup | None:
    """The group in the bytes of a message of any length; None for an unknown PGN.

    EC1 and RC of older and newer control units are shorter or longer: missing signals are not
    available, excess bytes are dropped.

    Raises:
      BusError: the bytes do not have the length of the group.
    """
    varying = _BY_PGN.get(pgn)
    if varying is not None:
        return varying.from_bytes(data)
    for name, least in _LEAST_LENGTHS.items():
        if pgn == pgn_of(name):
            length = layouts().get_message_by_name(name).length
            if len(data) < least:
                raise BusError(f"{name} has {len(data)} bytes: at least {least} are needed")
            data = data[:length].ljust(length, b"\xff")
    return unpack(pgn, data)
