"""Messages longer than 8 bytes, put together from their frames (`broadcast` sends them).

Public facts of SAE J1939-21. A message of 9 to 1785 bytes travels as packets of 7 bytes (TP.DT, PGN
60160), told of and steered by connection frames (TP.CM, PGN 60416):

- broadcast: a BAM, then the packets in order, 50 to 200 ms apart;
- to one address: a request to send (RTS), then for each clear to send (CTS) of the receiver some
  packets, from the number that it asks for, and at the end its acknowledgment. Either may abort.

`Reassembler` only listens, so it sees both sides of the second kind.
"""

from __future__ import annotations

import enum
from collections import Counter
from dataclasses import dataclass, field

from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame

CONNECTION = 0xEC00
TRANSFER = 0xEB00
MAX_LENGTH = 1785

# Of a packet, beside its number.
PACKET_LENGTH = 7
BAM = 32
_RTS, _CTS, _END, _ABORT = 16, 17, 19, 255
# T1, between two packets of a broadcast [s].
_PACKET_TIME_OUT = 0.75
# T2 and T3, in which either side waits, and Tr, in which it then says that it gives up [s].
_ANSWER_TIME_OUT = 1.25 + 0.2
# Of the frames' time stamps [s].
_RESOLUTION = 1e-6


class Failure(enum.Enum):
    """Why a transfer, or a frame of one, came to nothing."""

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
    """A message that came in several packets.

    Attributes:
      pgn: of the message itself.
      source, destination: addresses; 255 for everybody.
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
    pgn: int
    length: int
    packets: int
    started: float
    last: float
    patience: float
    # Number of the next packet that is wanted.
    wanted: int = 1
    data: bytearray = field(default_factory=bytearray)

    @property
    def whole(self) -> bool:
        return len(self.data) >= self.length


class Reassembler:
    """Puts long messages together from all frames of a bus, in the frames' own time.

    Never raises and never waits; a message with any doubt is dropped and counted. A packet that is
    the same as the one before is taken for a repetition and does no harm.

    Args:
      max_sessions: transfers at the same time; beyond, the one that is silent the longest goes.

    Attributes:
      messages: number of messages put together.
      failures: how often what went wrong. `SEQUENCE`, `TIME_OUT`, `ABORTED`, `REPLACED` and
        `CROWDED` are lost messages, the others single frames.
    """

    def __init__(self, max_sessions: int = 256) -> None:
        if max_sessions < 1:
            raise BusError(f"max_sessions = {max_sessions!r}: at least 1 is wanted")
        self.messages = 0
        self.failures: Counter[Failure] = Counter()
        self._max_sessions = max_sessions
        # By source and destination, the one silent the longest first.
        self._sessions: dict[tuple[int, int], _Session] = {}

    def receive(self, frame: Frame) -> LongMessage | None:
        """Takes any frame; returns the message that it completes."""
        pgn = frame.pgn
        if pgn == TRANSFER:
            return self._packet(frame)
        if pgn == CONNECTION:
            self._connection(frame)
        return None

    def finish(self) -> None:
        """Counts what is still under way as timed out: the frames have come to their end."""
        for key in list(self._sessions):
            self._drop(key, Failure.TIME_OUT)

    def _connection(self, frame: Frame) -> None:
        kind = frame.data[0] if len(frame.data) == 8 else None
        begins = kind == BAM if frame.destination == GLOBAL_ADDRESS else kind == _RTS
        if begins:
            self._begin(frame)
        elif kind in (_CTS, _END, _ABORT) and frame.destination != GLOBAL_ADDRESS:
            self._answer(frame, kind)
        else:
            self.failures[Failure.HEADER] += 1

    def _begin(self, frame: Frame) -> None:
        length = int.from_bytes(frame.data[1:3], "little")
        packets, pgn = frame.data[3], _pgn_in(frame)
        if not 1 <= length <= MAX_LENGTH or packets != -(-length // PACKET_LENGTH) or pgn is None:
            self.failures[Failure.HEADER] += 1
            return
        self._expire(frame.time)
        key = (frame.source, frame.destination)
        self._drop(key, Failure.REPLACED)
        if len(self._sessions) >= self._max_sessions:
            self._drop(next(iter(self._sessions)), Failure.CROWDED)
        patience = _PACKET_TIME_OUT if frame.data[0] == BAM else _ANSWER_TIME_OUT
        self._sessions[key] = _Session(pgn, length, packets, frame.time, frame.time, patience)

    def _answer(self, frame: Frame, kind: int) -> None:
        """What the receiver of a transfer says to its sender, or an abort by either of them."""
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
        elif kind == _END:
            # What is not whole by now was lost on the way to us only.
            self._drop(key, Failure.SEQUENCE)
        else:
            self._drop(key, Failure.ABORTED)

    def _clear_to_send(self, key: tuple[int, int], frame: Frame) -> None:
        session = self._sessions[key]
        count, number = frame.data[1], frame.data[2]
        # No packets for now: the receiver keeps the transfer open.
        if count and not session.whole:
            if not 1 <= number <= session.wanted:
                self._drop(key, Failure.SEQUENCE)
                return
            session.wanted = number
            del session.data[(number - 1) * PACKET_LENGTH :]
        self._heard(key, frame.time, _ANSWER_TIME_OUT)

    def _packet(self, frame: Frame) -> LongMessage | None:
        key = (frame.source, frame.destination)
        session = self._sessions.get(key)
        if session is not None and _silent(session, frame.time):
            self._drop(key, Failure.TIME_OUT)
            session = None
        if session is None or len(frame.data) != 8:
            self.failures[Failure.NO_SESSION if session is None else Failure.HEADER] += 1
            return None
        number, content = frame.data[0], frame.data[1:]
        if session.whole or number != session.wanted:
            self._unwanted(key, session, number, content)
            return None
        session.data += content
        session.wanted += 1
        to_all = frame.destination == GLOBAL_ADDRESS
        self._heard(key, frame.time, _PACKET_TIME_OUT if to_all else _ANSWER_TIME_OUT)
        if not session.whole:
            return None
        self.messages += 1
        data = bytes(session.data[: session.length])
        return LongMessage(session.pgn, *key, data, session.started, frame.time)

    def _unwanted(
        self, key: tuple[int, int], session: _Session, number: int, content: bytes
    ) -> None:
        """A packet out of turn: once more what we have, or the transfer is lost."""
        start = (number - 1) * PACKET_LENGTH
        known = number >= 1 and bytes(session.data[start : start + PACKET_LENGTH]) == content
        if session.whole or (number == session.wanted - 1 and known):
            self.failures[Failure.REPEATED] += 1
        else:
            self._drop(key, Failure.SEQUENCE)

    def _heard(self, key: tuple[int, int], time: float, patience: float) -> None:
        session = self._sessions.pop(key)
        session.last, session.patience = time, patience
        self._sessions[key] = session

    def _expire(self, time: float) -> None:
        for key in [k for k, session in self._sessions.items() if _silent(session, time)]:
            self._drop(key, Failure.TIME_OUT)

    def _drop(self, key: tuple[int, int], why: Failure) -> None:
        """Ends a session, which failed unless its message was whole."""
        session = self._sessions.pop(key, None)
        if session is not None and not session.whole:
            self.failures[why] += 1


def _pgn_in(frame: Frame) -> int | None:
    """The message's PGN in the last bytes of a connection frame."""
    number = int.from_bytes(frame.data[5:8], "little")
    return Frame(number << 8, b"").pgn if number < 1 << 18 else None


def _silent(session: _Session, time: float) -> bool:
    # Backwards as well, and a time that is no number: the frames are another recording's.
    return not abs(time - session.last) <= session.patience + _RESOLUTION
