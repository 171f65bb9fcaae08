"""Why a command frame is not acted upon."""

from __future__ import annotations

import enum

from iits_mj.errors import BusError
from iits_mj.j1939.group import Status, Value


class Reason(enum.Enum):
    """What is wrong with a frame, or why a sound one is not obeyed."""

    LENGTH = "wrong length"
    TIME = "time stamp not finite"
    LATE = "older than the last"
    CHECKSUM = "wrong checksum"
    REPEATED = "counter repeated"
    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"
    # Sound, but not for this truck, or not from who may command it.
    ADDRESS = "to another address"
    SENDER = "from an address that is not obeyed"
    HELD = "held by another sender"


class RejectedError(BusError):
    """A command frame is not acted upon, for this reason."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.value)
        self.reason = reason


_OF_STATUS = {
    Status.OUT_OF_RANGE: Reason.OUT_OF_RANGE,
    Status.ERROR: Reason.ERROR,
    Status.NOT_AVAILABLE: Reason.NOT_AVAILABLE,
}


def number(value: Value, low: float, high: float) -> float:
    """The number that a field carries, within [low, high].

    Raises:
      RejectedError: the field carries no number, or one outside.
    """
    if isinstance(value, Status):
        raise RejectedError(_OF_STATUS[value])
    if not low <= value <= high:
        raise RejectedError(Reason.OUT_OF_RANGE)
    return float(value)
