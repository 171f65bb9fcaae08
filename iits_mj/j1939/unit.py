"""A control unit that obeys a message: who speaks to it, and which of several requests counts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from iits_mj.errors import BusError
from iits_mj.j1939.checksum import counter_and_checksum
from iits_mj.j1939.codec import Codec
from iits_mj.j1939.database import codec_of
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.rejection import Reason, RejectedError
from iits_mj.j1939.requests import Request, RetarderRequest, XbrRequest
from iits_mj.j1939.stream import Stream
from iits_mj.j1939.time_outs import Heard
from iits_mj.messages import XbrMode

# In a counter of which 15 is no number it says "not available".
_NO_COUNTER = 15


@dataclass(slots=True)
class Unit:
    """A control unit that obeys a message.

    Attributes:
      message: name in the DBC; address: of the unit; name: of both, as counted.
      signals: of the message that count; read: makes the request of their values.
      time_out: [s].
      checksum: of the message, None where it has none; modulus: of its counter, 0 for none.
      shared: whether several senders are listened to at once, of which the priority decides; else
        the first one holds the message.
      streams: what was heard, by sender; holder: the sender that holds the message.
      lost: frames that never arrived, as the counters of those that did tell.
    """

    name: str
    message: str
    address: int
    signals: tuple[str, ...]
    read: Callable[..., Request]
    time_out: float
    checksum: Callable[[Frame], int] | None = None
    modulus: int = 0
    shared: bool = False
    streams: dict[int, Stream] = field(default_factory=dict)
    holder: int | None = None
    lost: int = 0
    _codec: Codec = field(init=False)

    def __post_init__(self) -> None:
        self._codec = codec_of(self.message).part(dict.fromkeys(self.signals, 1.0))

    def take(self, frame: Frame) -> Request:
        """Checks a frame and keeps the request in it.

        Raises:
          RejectedError: the frame is not sound, or somebody else holds the message.
        """
        if not math.isfinite(frame.time):
            raise RejectedError(Reason.TIME)
        try:
            values = self._codec.unpack(frame.data)
        except BusError as error:
            raise RejectedError(Reason.LENGTH) from error
        counter, checksum = counter_and_checksum(frame)
        if self.checksum is not None:
            if counter >= self.modulus:
                missing = counter == _NO_COUNTER
                raise RejectedError(Reason.NOT_AVAILABLE if missing else Reason.OUT_OF_RANGE)
            if checksum != self.checksum(frame):
                raise RejectedError(Reason.CHECKSUM)
        stream = self._stream(frame.source)
        self.lost += stream.follow(frame.time, counter)
        request = self.read(*values)
        if not self.shared:
            self._hold(frame)
        stream.take(request, frame.time)
        return request

    def requests(self, time: float) -> list[tuple[int, Request]]:
        """Requests in force at a time [s], with their senders."""
        return [
            (source, stream.request)
            for source, stream in self.streams.items()
            if stream.request is not None and stream.alive(time)
        ]

    def held(self, time: float) -> Request | None:
        """The holder's request, None while it is silent."""
        if self.holder is None:
            return None
        stream = self.streams[self.holder]
        return stream.request if stream.alive(time) else None

    def heard(self, time: float) -> Heard:
        """What was heard of the message until a time [s]."""
        if self.requests(time):
            return Heard.ALIVE
        spoken = [s for s in self.streams.values() if s.request is not None]
        if not spoken:
            return Heard.NEVER
        last = max(spoken, key=lambda stream: stream.time).request
        if isinstance(last, XbrRequest | RetarderRequest) and not last.active:
            return Heard.RELEASED
        return Heard.SILENT

    def _stream(self, source: int) -> Stream:
        if source not in self.streams:
            self.streams[source] = Stream(self.time_out, self.modulus)
        return self.streams[source]

    def _hold(self, frame: Frame) -> None:
        """Makes the sender the holder, where nobody is or the holder has gone silent.

        Raises:
          RejectedError: somebody else holds the message.
        """
        if self.holder not in (None, frame.source) and self.held(frame.time) is not None:
            raise RejectedError(Reason.HELD)
        self.holder = frame.source


def strongest_xbr(requests: list[tuple[int, Request]]) -> XbrRequest:
    """The demand of the highest priority (SPN 2915), among equals the strongest."""
    active = [
        (request.priority, request.demand, source, request)
        for source, request in requests
        if isinstance(request, XbrRequest) and request.active
    ]
    return min(active, key=lambda entry: entry[:3])[3] if active else XbrRequest(XbrMode.OFF)


def strongest_share(requests: list[tuple[int, Request]]) -> float:
    """Torque share of the highest priority (SPN 897), among equals the greatest; 0 for none."""
    active = [
        (request.priority, -request.share)
        for _, request in requests
        if isinstance(request, RetarderRequest) and request.active
    ]
    return -min(active)[1] if active else 0.0
