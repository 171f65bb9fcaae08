"""Frames to python-can's messages and back."""

from __future__ import annotations

from typing import Any

import can

from iits_mj.j1939.frame import Frame


class _Message(can.Message):
    """A message that nobody changes once it is on its way.

    The virtual bus makes a deep copy for each listener, which is two thirds of what it costs; ours
    is its own copy.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any] | None) -> can.Message:
        return self


def to_can(frame: Frame, channel: str | None = None) -> can.Message:
    """An extended data frame as python-can sends and writes it."""
    # All else is as python-can has it by default; naming less takes less time.
    return _Message(frame.time, frame.can_id, channel=channel, data=frame.data)


def from_can(message: can.Message, time: float | None = None) -> Frame | None:
    """A message as J1939 has it; None for 11-bit, CAN FD, remote and error frames.

    Args:
      message: as python-can gives it.
      time: stamp for the frame [s]; default the message's own.
    """
    foreign = message.is_error_frame or message.is_remote_frame or message.is_fd
    if foreign or not message.is_extended_id or not 0 <= message.arbitration_id < 1 << 29:
        return None
    stamp = message.timestamp if time is None else time
    return Frame(message.arbitration_id, bytes(message.data)[:8], stamp)
