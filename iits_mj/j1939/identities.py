"""Who a control unit is: vehicle, component and software identification (SAE J1939-71).

Text fields, each ended by "*". Readers of real trucks must do without the last "*".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import ClassVar, Self

from iits_mj.errors import BusError
from iits_mj.j1939.long_group import LongGroup, TextValue, bytes_of, text_of

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
