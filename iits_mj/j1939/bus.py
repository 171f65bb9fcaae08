"""Frames over python-can: a virtual bus in one process, SocketCAN, UDP multicast.

UDP multicast returns a sender's datagrams to the sender itself. Ours carry a mark, and those that
come back with it are left out, so that every kind of bus behaves as CAN does.
"""

from __future__ import annotations

import logging
import uuid
from collections import Counter
from typing import Any

import can

from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import Frame

# --- Frames to python-can's messages and back ---


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


# --- Frames over python-can: a virtual bus in one process, SocketCAN, UDP multicast ---

# Interface of python-can to the channel that is used when none is named.
DEFAULT_CHANNELS = {"virtual": "iits_mj", "socketcan": "can0", "udp_multicast": "239.74.163.2"}
# More than 2 s of a full 500 kbit/s bus: a flood must not keep a reader for ever.
FRAMES_AT_ONCE = 8192
# Error classes in the identifier of a SocketCAN error frame (Linux, can/error.h).
_BUS_OFF, _RESTARTED = 0x040, 0x100
# What python-can has to say of a failing bus is in our own messages; the standard library writes
# it to stderr beside them where nobody handles it.
logging.getLogger("can").addHandler(logging.NullHandler())
_FAILURES = (can.CanError, OSError, ValueError)


class Bus(Closing):
    """A CAN bus that carries `Frame`s; a context manager.

    Args:
      interface: python-can's name: "virtual", "socketcan", "udp_multicast" or another.
      channel: name of the channel, default that of `DEFAULT_CHANNELS`. Two virtual buses of one
        process and channel hear each other; for UDP it is the multicast group, with a port when it
        is written as "239.74.163.2:43113".

    Attributes:
      name: "interface:channel", for messages.
      ignored: what was heard and is not a J1939 frame, by kind: "11-bit", "error", "FD",
        "malformed", "own", "remote".
      off: True while the controller says that it is bus-off.

    Raises:
      BusError: the bus cannot be opened here.
    """

    def __init__(self, interface: str = "virtual", channel: str | None = None) -> None:
        channel = DEFAULT_CHANNELS.get(interface, "") if channel is None else channel
        self.name = f"{interface}:{channel}"
        self.ignored: Counter[str] = Counter()
        self.off = False
        self._mark: str | None = None
        self._errors_tell = interface == "socketcan"
        self._failure: Exception | None = None
        settings: dict[str, Any] = {"channel": channel}
        if interface == "virtual":
            settings["preserve_timestamps"] = True
        if interface == "udp_multicast":
            settings |= _group_and_port(channel)
            # Tools take a channel's number from its last digits: this one is channel 0 to them.
            self._mark = f"iits_mj-{uuid.uuid4().hex}-0"
        try:
            self._bus = can.Bus(interface=interface, **settings)
        except (*_FAILURES, ImportError, NotImplementedError) as error:
            raise BusError(f"CAN bus {self.name} cannot be opened: {_reason(error)}") from error

    def send(self, frame: Frame) -> None:
        """Sends one frame without waiting; BusError when the bus does not take it."""
        try:
            self._bus.send(to_can(frame, self._mark), timeout=0.0)
        except _FAILURES as error:
            reason = _reason(error)
            raise BusError(f"CAN bus {self.name} refused {frame.can_id:08X}: {reason}") from error

    def receive(self, time: float | None = None, limit: int = FRAMES_AT_ONCE) -> list[Frame]:
        """Frames waiting, oldest first; error, remote, 11-bit and own frames are left out.

        Args:
          time: stamp for the frames [s]; default the bus driver's own stamp.
          limit: of messages to be read; what is left waits for the next call.

        Raises:
          BusError: the bus cannot be read. What was read before is returned first, and the error
            is raised by the next call.
        """
        frames: list[Frame] = []
        for _ in range(limit if self._failure is None else 0):
            try:
                message = self._bus.recv(timeout=0.0)
            except _FAILURES as error:
                if _is_garbage(error):
                    self.ignored["malformed"] += 1
                    continue
                self._failure = error
                break
            if message is None:
                break
            frame = self._sort(message, time)
            if frame is not None:
                frames.append(frame)
        if self._failure is not None and not frames:
            failure, self._failure = self._failure, None
            reason = _reason(failure)
            raise BusError(f"CAN bus {self.name} cannot be read: {reason}") from failure
        if not self._errors_tell:
            self.off = self._bus.state is can.BusState.ERROR
        return frames

    def close(self) -> None:
        """Leaves the bus; BusError when the driver cannot even do that."""
        try:
            self._bus.shutdown()
        except _FAILURES as error:
            raise BusError(f"CAN bus {self.name} cannot be closed: {_reason(error)}") from error

    def _sort(self, message: can.Message, time: float | None) -> Frame | None:
        if message.is_error_frame and self._errors_tell:
            self._heed(message.arbitration_id)
        if self._mark is not None and message.channel == self._mark:
            self.ignored["own"] += 1
            return None
        frame = from_can(message, time)
        if frame is None:
            self.ignored[_kind(message)] += 1
        elif self._errors_tell:
            # Whoever hears data takes part in the bus.
            self.off = False
        return frame

    def _heed(self, classes: int) -> None:
        if classes & _BUS_OFF:
            self.off = True
        if classes & _RESTARTED:
            self.off = False


def _kind(message: can.Message) -> str:
    if message.is_error_frame:
        return "error"
    if message.is_remote_frame:
        return "remote"
    return "FD" if message.is_fd else "11-bit"


def _is_garbage(error: Exception) -> bool:
    """True for a datagram that is no CAN message: the bus is well, somebody else is not."""
    cause = error.__cause__
    return (
        isinstance(error, can.CanOperationError)
        and cause is not None
        and not isinstance(cause, OSError)
    )


def _reason(error: Exception) -> str:
    """The error on one line, with the operating system's reason where python-can hides it."""
    text = " ".join(str(error).split()) or type(error).__name__
    cause = error.__cause__
    inner = cause.strerror if isinstance(cause, OSError) else None
    return f"{text}: {inner}" if inner and inner not in text else text


def _group_and_port(channel: str) -> dict[str, Any]:
    """Multicast group and port of "group", "group:port" or "[IPv6 group]:port"."""
    group, colon, port = channel.rpartition(":")
    plain_ipv6 = ":" in group and not group.endswith("]")
    if not colon or plain_ipv6:
        return {"channel": channel.strip("[]")}
    if not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 1 << 16):
        raise BusError(f"CAN bus udp_multicast:{channel}: port {port[:20]!r}: use 1 to 65535")
    return {"channel": group.strip("[]"), "port": int(port)}
