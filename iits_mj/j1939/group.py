"""What every typed message has in common: fields that are numbers or say why they are not."""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import ClassVar, TypeAlias

from iits_mj.errors import BusError


class Status(enum.Enum):
    """What a field says when it carries no value."""

    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"


Value: TypeAlias = float | Status

NOT_AVAILABLE = Status.NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class Group:
    """A parameter group: one field a signal, in the order and the units of the DBC.

    The groups are in `iits_mj.j1939.groups`, made from the DBC.
    """

    MESSAGE: ClassVar[str] = ""

    def items(self) -> Iterator[tuple[str, Value]]:
        """Signals and what they carry, in the order of the DBC."""
        return ((field.name, getattr(self, field.name)) for field in fields(self))

    def number(self, signal: str) -> float:
        """The number in a field.

        Raises:
          BusError: the sender says error, not available, or a value outside the signal's range.
        """
        value = getattr(self, signal)
        if isinstance(value, Status):
            raise BusError(f"{self.MESSAGE}.{signal} carries no value: {value.value}")
        return float(value)
