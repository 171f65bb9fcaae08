"""CAN buses over python-can (virtual, SocketCAN, UDP multicast), and a link that recovers.

UDP multicast returns datagrams to their sender. Ours carry a mark and are dropped when they return,
so that every kind of bus behaves as CAN does.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import logging
import math
import socket
import time as wall_time
import uuid
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import can

from iits_mj.core.checks import one_of, positive
from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import Frame

REACHES = ("host", "network")
# Default channels by interface of python-can.
DEFAULT_CHANNELS = {"virtual": "iits_mj", "socketcan": "can0", "udp_multicast": "239.74.163.2"}
# More than 2 s of a full bus at 500 kbit/s: a flood must not block a reader.
FRAMES_AT_ONCE = 8192
_CHANGES_KEPT = 100
# Error classes in the identifier of a SocketCAN error frame (Linux, can/error.h).
_BUS_OFF, _RESTARTED = 0x040, 0x100
# Our errors contain python-can's messages; without a handler, the standard library would also write
# them to stderr.
logging.getLogger("can").addHandler(logging.NullHandler())
_FAILURES = (can.CanError, OSError, ValueError)


class _Message(can.Message):
    """A message that does not change after sending, so that it is its own deep copy.

    The virtual bus makes a deep copy for each listener, which is two thirds of its cost.
    """

    __slots__ = ()

    def __deepcopy__(self, memo: dict[int, Any] | None) -> can.Message:
        return self


def to_can(frame: Frame, channel: str | None = None) -> can.Message:
    """The frame as an extended data frame of python-can."""
    # All other arguments keep python-can's defaults, which takes less time.
    return _Message(frame.time, frame.can_id, channel=channel, data=frame.data)


def from_can(message: can.Message, time: float | None = None) -> Frame | None:
    """The J1939 frame of a message; None for 11-bit, CAN FD, remote and error frames.

    Args:
      message: of python-can.
      time: stamp of the frame [s]; default that of the message.
    """
    foreign = message.is_error_frame or message.is_remote_frame or message.is_fd
    if foreign or not message.is_extended_id or not 0 <= message.arbitration_id < 1 << 29:
        return None
    stamp = message.timestamp if time is None else time
    return Frame(message.arbitration_id, bytes(message.data)[:8], stamp)


class Bus(Closing):
    """A CAN bus that carries `Frame`s; a context manager.

    Args:
      interface: python-can's name: "virtual", "socketcan", "udp_multicast" or another.
      channel: name of the channel, default that of `DEFAULT_CHANNELS`. Virtual buses of one process
        with the same channel are connected. For UDP, the multicast group, with an optional port:
        "239.74.163.2:43113".
      reach: of UDP multicast: "host" sends to and hears this machine alone, "network" every machine
        of the local network. Other buses reach what they are wired to.

    Attributes:
      name: "interface:channel", for messages.
      ignored: number of received messages that are not used, by kind: "11-bit", "error", "FD",
        "malformed", "other host", "own", "remote".
      off: whether the controller reports bus-off.

    Raises:
      BusError: the bus cannot be opened.
    """

    def __init__(
        self, interface: str = "virtual", channel: str | None = None, *, reach: str = "host"
    ) -> None:
        one_of("reach", reach, REACHES)
        channel = DEFAULT_CHANNELS.get(interface, "") if channel is None else channel
        self.name = f"{interface}:{channel}"
        self.ignored: Counter[str] = Counter()
        self.off = False
        self._mark: str | None = None
        self._has_error_frames = interface == "socketcan"
        self._failure: Exception | None = None
        settings: dict[str, Any] = {"channel": channel}
        if interface == "virtual":
            settings["preserve_timestamps"] = True
        if interface == "udp_multicast":
            settings |= _group_and_port(channel)
            settings["hop_limit"] = 0 if reach == "host" else 1
            # Other tools take the channel's number from its last digits: 0.
            self._mark = f"iits_mj-{uuid.uuid4().hex}-0"
        try:
            self._bus = can.Bus(interface=interface, **settings)
        except (*_FAILURES, ImportError, NotImplementedError) as error:
            raise self._error("cannot be opened", error) from error
        if interface == "udp_multicast" and reach == "host":
            self._hear_this_host()

    def _hear_this_host(self) -> None:
        """Drops datagrams from other machines before they are parsed."""
        multicast = self._bus._multicast  # type: ignore[attr-defined]
        receive = multicast.recv

        def receive_own(timeout: float | None = None) -> Any:
            for _ in range(FRAMES_AT_ONCE):
                found = receive(timeout)
                if found is None or is_own_address(found[1]):
                    return found
                self.ignored["other host"] += 1
            return None

        multicast.recv = receive_own

    def send(self, frame: Frame) -> None:
        """Sends one frame without waiting; BusError if the bus does not accept it."""
        try:
            self._bus.send(to_can(frame, self._mark), timeout=0.0)
        except _FAILURES as error:
            raise self._error(f"refused {frame.can_id:08X}", error) from error

    def receive(self, time: float | None = None, limit: int = FRAMES_AT_ONCE) -> list[Frame]:
        """The received J1939 frames, oldest first.

        Args:
          time: stamp of the frames [s]; default the driver's own stamp.
          limit: of messages to read; the others wait for the next call.

        Raises:
          BusError: the bus cannot be read. A call returns the frames that it read before a failure,
            and the next call raises the error.
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
            raise self._error("cannot be read", failure) from failure
        if not self._has_error_frames:
            self.off = self._bus.state is can.BusState.ERROR
        return frames

    def close(self) -> None:
        """Leaves the bus; BusError if the driver fails to do so."""
        try:
            self._bus.shutdown()
        except _FAILURES as error:
            raise self._error("cannot be closed", error) from error

    def _sort(self, message: can.Message, time: float | None) -> Frame | None:
        if message.is_error_frame and self._has_error_frames:
            if message.arbitration_id & _BUS_OFF:
                self.off = True
            if message.arbitration_id & _RESTARTED:
                self.off = False
        if self._mark is not None and message.channel == self._mark:
            self.ignored["own"] += 1
            return None
        frame = from_can(message, time)
        if frame is None:
            self.ignored[_kind(message)] += 1
        elif self._has_error_frames:
            # A controller that is bus-off receives no data.
            self.off = False
        return frame

    def _error(self, what: str, error: Exception) -> BusError:
        """A BusError of one line, with the operating system's reason if python-can omits it."""
        text = " ".join(str(error).split()) or type(error).__name__
        cause = error.__cause__
        inner = cause.strerror if isinstance(cause, OSError) else None
        reason = f"{text}: {inner}" if inner and inner not in text else text
        return BusError(f"CAN bus {self.name} {what}: {reason}")


@functools.lru_cache(maxsize=1024)
def is_own_address(sender: tuple[Any, ...]) -> bool:
    """Whether a socket address is one of this machine: only to such a socket can be bound."""
    family = socket.AF_INET6 if ":" in sender[0] else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as trial:
            trial.bind((sender[0], 0, *sender[2:]))
    except OSError:
        return False
    return True


def _kind(message: can.Message) -> str:
    if message.is_error_frame:
        return "error"
    if message.is_remote_frame:
        return "remote"
    return "FD" if message.is_fd else "11-bit"


def _is_garbage(error: Exception) -> bool:
    """Whether a datagram is no CAN message: a fault of its sender, not of the bus."""
    cause = error.__cause__
    return (
        isinstance(error, can.CanOperationError)
        and cause is not None
        and not isinstance(cause, OSError)
    )


def _group_and_port(channel: str) -> dict[str, Any]:
    """Multicast group and port of "group", "group:port" or "[IPv6 group]:port"."""
    group, colon, port = channel.rpartition(":")
    plain_ipv6 = ":" in group and not group.endswith("]")
    if not colon or plain_ipv6:
        return {"channel": channel.strip("[]")}
    if not (port.isascii() and port.isdigit() and 0 < int(port[:6]) < 1 << 16):
        raise BusError(f"CAN bus udp_multicast:{channel}: port {port[:20]!r}: use 1 to 65535")
    return {"channel": group.strip("[]"), "port": int(port)}


class LinkState(enum.Enum):
    """State of a link."""

    UP = "up"
    BUS_OFF = "bus-off"
    DOWN = "down"


@dataclass(frozen=True, slots=True)
class LinkChange:
    """Time [s, the link's clock] at which a link entered a state, and why ("" for UP)."""

    time: float
    state: LinkState
    reason: str


class Link(Closing):
    """A `Bus` that is opened again after a failure and never raises on sending or receiving.

    A bus that cannot be read is down at once. A bus that refuses every frame for `patience` is down
    as well; a single refused frame (a full queue) is only dropped. A bus that is down or bus-off is
    closed and opened again after `first_wait`, then after twice as long each time, up to
    `longest_wait`, until it carries frames; frames sent in between are dropped and counted. A
    controller that recovers from bus-off by itself is used again at once.

    Args:
      interface, channel, reach: see `Bus`.
      first_wait, longest_wait: before the bus is opened again [s].
      patience: longest time with every frame refused [s].
      clock: monotonic time [s].

    Attributes:
      name: of the bus; state: `LinkState`; changes: the last 100 `LinkChange`s.
      sent, received, dropped: numbers of frames; ignored: see `Bus.ignored`, over all openings.
      failures: how often the link left `UP`; restarts: how often it was opened again.

    Raises:
      BusError: the first opening failed. InputError: a time is not positive.
    """

    def __init__(
        self,
        interface: str = "virtual",
        channel: str | None = None,
        *,
        reach: str = "host",
        first_wait: float = 0.1,
        longest_wait: float = 2.0,
        patience: float = 0.25,
        clock: Callable[[], float] = wall_time.monotonic,
    ) -> None:
        times = {"first_wait": first_wait, "longest_wait": longest_wait, "patience": patience}
        for name, value in times.items():
            positive(f"link: {name}", value, "s")
        self._interface, self._channel, self._reach = interface, channel, reach
        self._first_wait, self._longest_wait = first_wait, max(first_wait, longest_wait)
        self._patience = patience
        self._clock = clock
        bus = Bus(interface, channel, reach=reach)
        self._bus: Bus | None = bus
        self.name = bus.name
        self.state = LinkState.UP
        self.changes: deque[LinkChange] = deque(maxlen=_CHANGES_KEPT)
        self.sent = self.received = self.dropped = self.failures = self.restarts = 0
        self._ignored: Counter[str] = Counter()
        # Before the next opening [s]; short again after a frame has passed.
        self._wait = first_wait
        self._retry_at = math.inf
        self._refused_since: float | None = None

    @property
    def ignored(self) -> Counter[str]:
        """Number of received messages that are no J1939 frames, by kind."""
        return self._ignored + (self._bus.ignored if self._bus is not None else Counter())

    def send(self, frame: Frame) -> bool:
        """Sends one frame; returns False if it was dropped."""
        self._reopen_if_due()
        if self._bus is None or self.state is LinkState.BUS_OFF:
            self.dropped += 1
            return False
        try:
            self._bus.send(frame)
        except BusError as error:
            self.dropped += 1
            now = self._clock()
            if self._refused_since is None:
                self._refused_since = now
            elif now - self._refused_since >= self._patience:
                self._fail(LinkState.DOWN, str(error))
            return False
        self.sent += 1
        self._refused_since = None
        self._wait = self._first_wait
        return True

    def receive(self, time: float | None = None) -> list[Frame]:
        """The received frames, oldest first; none while the bus is down.

        Args:
          time: stamp of the frames [s]; default the driver's own.
        """
        self._reopen_if_due()
        bus = self._bus
        if bus is None:
            return []
        try:
            frames = bus.receive(time)
        except BusError as error:
            self._fail(LinkState.DOWN, str(error))
            return []
        if bus.off and self.state is LinkState.UP:
            self._fail(LinkState.BUS_OFF, f"CAN bus {self.name} is bus-off")
        elif not bus.off and self.state is LinkState.BUS_OFF:
            self._change(LinkState.UP, "")
        if frames:
            self.received += len(frames)
            self._wait = self._first_wait
        return frames

    def close(self) -> None:
        """Leaves the bus for good."""
        self._drop_bus()
        self._retry_at = math.inf

    def _fail(self, state: LinkState, reason: str) -> None:
        self.failures += self.state is LinkState.UP
        self._refused_since = None
        self._change(state, reason)
        if state is LinkState.DOWN:
            self._drop_bus()
        self._retry_later()

    def _reopen_if_due(self) -> None:
        if self.state is LinkState.UP or self._clock() < self._retry_at:
            return
        self._drop_bus()
        try:
            self._bus = Bus(self._interface, self._channel, reach=self._reach)
        except BusError:
            self._retry_later()
            if self.state is not LinkState.DOWN:
                self._change(LinkState.DOWN, f"CAN bus {self.name} cannot be opened again")
            return
        self.restarts += 1
        self._change(LinkState.UP, "")

    def _retry_later(self) -> None:
        self._retry_at = self._clock() + self._wait
        self._wait = min(2.0 * self._wait, self._longest_wait)

    def _change(self, state: LinkState, reason: str) -> None:
        self.state = state
        self.changes.append(LinkChange(self._clock(), state, reason))
        if state is LinkState.UP:
            self._retry_at = math.inf

    def _drop_bus(self) -> None:
        bus, self._bus = self._bus, None
        if bus is None:
            return
        self._ignored += bus.ignored
        # The driver of a missing device may also fail to close.
        with contextlib.suppress(BusError):
            bus.close()
