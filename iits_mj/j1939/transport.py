"""Messages of 9 to 1785 bytes in several frames: sent as broadcasts, read from any transfer.

Public facts of SAE J1939-21. A long message is sent in packets of 7 bytes (TP.DT, PGN 60160), which
connection frames announce and control (TP.CM, PGN 60416):

- broadcast: a BAM, then the packets in order, 50 to 200 ms apart;
- to one address: a request to send (RTS); for each clear to send (CTS) of the receiver, the packets
  that the CTS requests; finally the receiver's acknowledgment. Both sides may abort.

`Reassembler` only listens, so it receives the frames of both sides.
"""

from __future__ import annotations

import enum
import math
from collections import Counter
from dataclasses import dataclass, field

from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, make_id

CONNECTION = 0xEC00
TRANSFER = 0xEB00
# Bytes of a long message, and of a packet without its number.
_MIN_LENGTH, _MAX_LENGTH = 9, 1785
_PACKET_LENGTH = 7
_BAM, _RTS, _CTS, _END, _ABORT = 32, 16, 17, 19, 255
_PRIORITY = 7
_FREE = 0xFF
# Least and greatest time between two frames of a broadcast [s].
_SPACINGS = (0.05, 0.2)
# T1: between two packets of a broadcast [s].
_PACKET_TIME_OUT = 0.75
# T2 and T3: longest wait of either side; Tr: until it reports the end of the transfer [s].
_ANSWER_TIME_OUT = 1.25 + 0.2
# Resolution of the frames' time stamps [s].
_RESOLUTION = 1e-6


class BroadcastSender:
    """Broadcasts the long messages of one source, one after the other.

    A newer message replaces a waiting one of the same PGN.

    Args:
      source: the sender's address.
      spacing: least time between two frames [s], 0.05 to 0.2.

    Attributes:
      source: as given.
    """

    def __init__(self, source: int, spacing: float = _SPACINGS[0]) -> None:
        _check(spacing, 0.0)
        self.source = source
        self._spacing = spacing
        self._waiting: dict[int, bytes] = {}
        self._frames: list[Frame] = []
        self._next = -math.inf

    def put(self, pgn: int, data: bytes) -> None:
        """Queues a message; BusError if its PGN or length (9 to 1785 bytes) is not allowed."""
        broadcast(pgn, data, self.source)
        self._waiting[pgn] = data

    def due(self, time: float) -> list[Frame]:
        """The frame that is due at a time [s], or none; BusError if the time is not finite.

        To be called every tick.
        """
        _check(self._spacing, time)
        if not self._frames and self._waiting:
            pgn = next(iter(self._waiting))
            self._frames = broadcast(pgn, self._waiting.pop(pgn), self.source)
        # An earlier time belongs to a new drive.
        if not self._frames or _RESOLUTION < self._next - time <= self._spacing + _RESOLUTION:
            return []
        self._next = time + self._spacing
        frame = self._frames.pop(0)
        return [Frame(frame.can_id, frame.data, time)]


def broadcast(
    pgn: int, data: bytes, source: int, *, time: float = 0.0, spacing: float = _SPACINGS[0]
) -> list[Frame]:
    """The frames of a long message to all units: the BAM and its packets.

    A source may send only one broadcast at a time.

    Args:
      pgn: of the message.
      data: its 9 to 1785 bytes.
      source: sender's address.
      time: of the first frame [s].
      spacing: time between two frames [s], 0.05 to 0.2.

    Raises:
      BusError: length, spacing, time, PGN or address is not allowed.
    """
    if not _MIN_LENGTH <= len(data) <= _MAX_LENGTH:
        raise BusError(f"long message of {len(data)} bytes: {_MIN_LENGTH} to {_MAX_LENGTH} allowed")
    _check(spacing, time)
    number = Frame(make_id(_PRIORITY, pgn, source), b"").pgn
    packets = -(-len(data) // _PACKET_LENGTH)
    header = bytes([_BAM, len(data) & 0xFF, len(data) >> 8, packets, _FREE])
    filled = data.ljust(packets * _PACKET_LENGTH, bytes([_FREE]))
    parts = [filled[i * _PACKET_LENGTH :][:_PACKET_LENGTH] for i in range(packets)]
    contents = [header + number.to_bytes(3, "little")]
    contents += [bytes([i]) + part for i, part in enumerate(parts, start=1)]
    connection, transfer = (make_id(_PRIORITY, p, source) for p in (CONNECTION, TRANSFER))
    ids = [connection, *[transfer] * packets]
    times = [round(time + i * spacing, 6) for i in range(packets + 1)]
    return [Frame(*frame) for frame in zip(ids, contents, times, strict=True)]


def _check(spacing: float, time: float) -> None:
    low, high = _SPACINGS
    if not low <= spacing <= high:
        raise BusError(f"spacing {spacing!r} s of packets: {low} to {high} allowed")
    if not math.isfinite(time):
        raise BusError(f"time {time!r} s of a long message: a finite number is needed")


class Failure(enum.Enum):
    """Why a transfer, or a frame of one, failed."""

    HEADER = "connection frame that cannot be"
    NO_SESSION = "frame of a transfer whose start was not seen"
    SEQUENCE = "packet lost or out of order"
    REPEATED = "packet repeated"
    TIME_OUT = "time-out"
    ABORTED = "aborted by its sender or receiver"
    REPLACED = "new transfer begun before the end"
    CROWDED = "too many transfers at once"


@dataclass(frozen=True, slots=True)
class LongMessage:
    """A message that was sent in several packets.

    Attributes:
      pgn: of the message itself.
      source, destination: addresses; 255 is the global address.
      data: 1 to 1785 bytes.
      started, time: of its first and its last frame [s].
    """

    pgn: int
    source: int
    destination: int
    data: bytes
    started: float
    time: float


@dataclass(slots=True)
class _Session:
    """An open transfer."""

    pgn: int
    length: int
    started: float
    last: float
    time_out: float
    next_number: int = 1
    data: bytearray = field(default_factory=bytearray)

    @property
    def whole(self) -> bool:
        return len(self.data) >= self.length

    def silent(self, time: float) -> bool:
        # An earlier time, or one that is not a number, belongs to another recording.
        return not abs(time - self.last) <= self.time_out + _RESOLUTION


class Reassembler:
    """Reassembles long messages from all frames of a bus, by the times of the frames.

    It never raises and never waits; an incomplete message is dropped and counted. A packet that
    equals the previous one counts as repeated and is ignored.

    Args:
      max_sessions: limit of open transfers; a further one ends the transfer with the longest
        silence.

    Attributes:
      messages: number of reassembled messages.
      failures: count of each failure. `SEQUENCE`, `TIME_OUT`, `ABORTED`, `REPLACED` and `CROWDED`
        are lost messages, the others single frames.
    """

    def __init__(self, max_sessions: int = 256) -> None:
        if max_sessions < 1:
            raise BusError(f"max_sessions = {max_sessions!r}: at least 1 is needed")
        self.messages = 0
        self.failures: Counter[Failure] = Counter()
        self._max_sessions = max_sessions
        # By source and destination, the one with the longest silence first.
        self._sessions: dict[tuple[int, int], _Session] = {}

    def receive(self, frame: Frame) -> LongMessage | None:
        """Receives any frame; returns the message that it completes, or None."""
        pgn = frame.pgn
        if pgn == TRANSFER:
            return self._packet(frame)
        if pgn == CONNECTION:
            self._connection(frame)
        return None

    def finish(self) -> None:
        """Counts open transfers as timed out; to be called after the last frame."""
        for key in list(self._sessions):
            self._drop(key, Failure.TIME_OUT)

    def _connection(self, frame: Frame) -> None:
        kind = frame.data[0] if len(frame.data) == 8 else None
        if kind == (_BAM if frame.destination == GLOBAL_ADDRESS else _RTS):
            self._begin(frame)
        elif kind in (_CTS, _END, _ABORT) and frame.destination != GLOBAL_ADDRESS:
            self._answer(frame, kind)
        else:
            self.failures[Failure.HEADER] += 1

    def _begin(self, frame: Frame) -> None:
        length = int.from_bytes(frame.data[1:3], "little")
        packets, pgn = frame.data[3], _pgn_in(frame)
        valid = 1 <= length <= _MAX_LENGTH and packets == -(-length // _PACKET_LENGTH)
        if not valid or pgn is None:
            self.failures[Failure.HEADER] += 1
            return
        self._expire(frame.time)
        key = (frame.source, frame.destination)
        self._drop(key, Failure.REPLACED)
        if len(self._sessions) >= self._max_sessions:
            self._drop(next(iter(self._sessions)), Failure.CROWDED)
        time_out = _time_out(frame)
        self._sessions[key] = _Session(pgn, length, frame.time, frame.time, time_out)

    def _answer(self, frame: Frame, kind: int) -> None:
        """Handles a CTS or acknowledgment of the receiver, or an abort by either side."""
        self._expire(frame.time)
        keys = [(frame.destination, frame.source)]
        if kind == _ABORT:
            keys.append((frame.source, frame.destination))
        pgn = _pgn_in(frame)
        key = next((k for k in keys if k in self._sessions and self._sessions[k].pgn == pgn), None)
        if key is None:
            self.failures[Failure.NO_SESSION] += 1
        elif kind == _CTS:
            self._clear_to_send(key, frame)
        else:
            # The receiver may have a message that is incomplete here.
            self._drop(key, Failure.SEQUENCE if kind == _END else Failure.ABORTED)

    def _clear_to_send(self, key: tuple[int, int], frame: Frame) -> None:
        session = self._sessions[key]
        count, number = frame.data[1], frame.data[2]
        # A count of zero keeps the transfer open without packets.
        if count and not session.whole:
            if not 1 <= number <= session.next_number:
                self._drop(key, Failure.SEQUENCE)
                return
            session.next_number = number
            del session.data[(number - 1) * _PACKET_LENGTH :]
        self._heard(key, frame)

    def _packet(self, frame: Frame) -> LongMessage | None:
        key = (frame.source, frame.destination)
        session = self._sessions.get(key)
        if session is not None and session.silent(frame.time):
            self._drop(key, Failure.TIME_OUT)
            session = None
        if session is None or len(frame.data) != 8:
            self.failures[Failure.NO_SESSION if session is None else Failure.HEADER] += 1
            return None
        number, content = frame.data[0], frame.data[1:]
        if session.whole or number != session.next_number:
            start = (number - 1) * _PACKET_LENGTH
            known = number >= 1 and session.data[start : start + _PACKET_LENGTH] == content
            if session.whole or (number == session.next_number - 1 and known):
                self.failures[Failure.REPEATED] += 1
            else:
                self._drop(key, Failure.SEQUENCE)
            return None
        session.data += content
        session.next_number += 1
        self._heard(key, frame)
        if not session.whole:
            return None
        self.messages += 1
        data = bytes(session.data[: session.length])
        return LongMessage(session.pgn, *key, data, session.started, frame.time)

    def _heard(self, key: tuple[int, int], frame: Frame) -> None:
        """Restarts the time-out of a session and moves it to the end of the order."""
        session = self._sessions.pop(key)
        session.last, session.time_out = frame.time, _time_out(frame)
        self._sessions[key] = session

    def _expire(self, time: float) -> None:
        for key in [k for k, session in self._sessions.items() if session.silent(time)]:
            self._drop(key, Failure.TIME_OUT)

    def _drop(self, key: tuple[int, int], why: Failure) -> None:
        """Ends a session; counts the failure unless its message is whole."""
        session = self._sessions.pop(key, None)
        if session is not None and not session.whole:
            self.failures[why] += 1


def _time_out(frame: Frame) -> float:
    """Longest silence after a frame of a transfer [s]."""
    return _PACKET_TIME_OUT if frame.destination == GLOBAL_ADDRESS else _ANSWER_TIME_OUT


def _pgn_in(frame: Frame) -> int | None:
    """The PGN of the message in the last bytes of a connection frame."""
    number = int.from_bytes(frame.data[5:8], "little")
    return Frame(number << 8, b"").pgn if number < 1 << 18 else None
