"""What the messages of varying length have in common; the DBC cannot hold them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Self, TypeAlias

from iits_mj.errors import BusError
from iits_mj.j1939.group import Value

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
