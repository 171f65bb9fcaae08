"""Long messages to everybody: a BAM and its packets (SAE J1939-21; `transport` reads them)."""

from __future__ import annotations

import math
from collections.abc import Sequence

from iits_mj.core.errors import BusError, InputError
from iits_mj.j1939.frame import Frame, make_id
from iits_mj.j1939.transport import BAM, CONNECTION, MAX_LENGTH, PACKET_LENGTH, TRANSFER

# --- When a cyclic message is due: whole microseconds inside, so that no rounding adds up ---

_MICROSECONDS = 1_000_000
# Offsets are whole ticks, and nothing waits longer for its first time.
_TICK = 10_000
_LATEST_START = 100_000


class Schedule:
    """Cyclic messages with a period and an offset each, counted from the first call of `due`.

    A message that came late keeps its grid; times that were missed are not made up for. When time
    goes back, because a drive begins anew, so does the schedule.

    Args:
      periods: [s], a multiple of a microsecond.
      offsets: of each [s]; default none.

    Raises:
      InputError: a period is not a positive number.
    """

    def __init__(self, periods: Sequence[float], offsets: Sequence[float] | None = None) -> None:
        for period in periods:
            if not (math.isfinite(period) and period >= 1e-6):
                raise InputError(f"period {period!r} s of a cyclic message: use 1e-6 s or more")
        self._periods = [_whole(period) for period in periods]
        self._offsets = [_whole(offset) for offset in offsets or [0.0] * len(self._periods)]
        # When each is due next, counted from the start [us]; empty before the first call.
        self._next: list[int] = []
        self._start = self._last = 0

    def due(self, time: float) -> list[int]:
        """Places of the messages whose time has come since the last call.

        Args:
          time: [s].

        Raises:
          InputError: the time is not finite.
        """
        if not math.isfinite(time):
            raise InputError(f"time {time!r} s of a bus: a finite number is wanted")
        now = _whole(time)
        if not self._next or now < self._last:
            self._start, self._next = now, list(self._offsets)
        self._last = now
        elapsed = now - self._start
        found = [place for place, due in enumerate(self._next) if due <= elapsed]
        for place in found:
            period = self._periods[place]
            self._next[place] += ((elapsed - self._next[place]) // period + 1) * period
        return found


def spread(periods: Sequence[float], weights: Sequence[int]) -> list[float]:
    """Offsets [s] that even out the frames of a bus over ticks of 10 ms.

    Each message in turn, the quickest first, gets the offset at which the fullest of its ticks is
    emptiest. All offsets lie below 0.1 s.

    Args:
      periods: [s].
      weights: frames that each message takes at a time.
    """
    ticks = [max(1, _whole(period) // _TICK) for period in periods]
    load = [0] * math.lcm(*ticks)
    offsets = [0.0] * len(ticks)
    for place in sorted(range(len(ticks)), key=lambda i: ticks[i]):
        period = ticks[place]

        def fullest(offset: int, period: int = period) -> int:
            return max(load[offset::period])

        best = min(range(min(period, _LATEST_START // _TICK)), key=fullest)
        for tick in range(best, len(load), period):
            load[tick] += weights[place]
        offsets[place] = best * _TICK / _MICROSECONDS
    return offsets


def _whole(seconds: float) -> int:
    return round(seconds * _MICROSECONDS)


# --- Long messages to everybody: a BAM and its packets (SAE J1939-21; `transport` reads them) ---

_MIN_LENGTH = 9
_PRIORITY = 7
_FREE = 0xFF
# Between two frames, least and most [s].
_SPACINGS = (0.05, 0.2)
# Of the frames' time stamps [s].
_RESOLUTION = 1e-6


class BroadcastSender:
    """Sends the long messages of one source, one after the other, as time goes by.

    A message that waits is replaced by a newer one of its PGN.

    Args:
      source: the sender's address.
      spacing: least time between two frames [s], 0.05 to 0.2.

    Attributes:
      source: as given.
    """

    def __init__(self, source: int, spacing: float = _SPACINGS[0]) -> None:
        _check(bytes(_MIN_LENGTH), spacing, 0.0)
        self.source = source
        self._spacing = spacing
        self._waiting: dict[int, bytes] = {}
        self._frames: list[Frame] = []
        self._next = -math.inf

    def put(self, pgn: int, data: bytes) -> None:
        """A message to send; BusError when its PGN or length (9 to 1785) is not allowed."""
        broadcast(pgn, data, self.source)
        self._waiting[pgn] = data

    def due(self, time: float) -> list[Frame]:
        """The frame whose time has come, with that time [s], or none; to be asked every tick.

        Raises:
          BusError: the time is not finite.
        """
        _check(bytes(_MIN_LENGTH), self._spacing, time)
        if not self._frames and self._waiting:
            pgn = next(iter(self._waiting))
            self._frames = broadcast(pgn, self._waiting.pop(pgn), self.source)
        # A time that lies further back is that of another drive.
        if not self._frames or _RESOLUTION < self._next - time <= self._spacing + _RESOLUTION:
            return []
        self._next = time + self._spacing
        frame = self._frames.pop(0)
        return [Frame(frame.can_id, frame.data, time)]


def broadcast(
    pgn: int, data: bytes, source: int, *, time: float = 0.0, spacing: float = _SPACINGS[0]
) -> list[Frame]:
    """The frames of a long message to everybody: the BAM and its packets.

    A source may have one broadcast under way at a time; the next begins after the last frame.

    Args:
      pgn: of the message.
      data: its 9 to 1785 bytes.
      source: sender's address.
      time: of the first frame [s].
      spacing: time between two frames [s], 0.05 to 0.2.

    Raises:
      BusError: length, spacing, time, PGN or address outside what is allowed.
    """
    _check(data, spacing, time)
    number = Frame(make_id(_PRIORITY, pgn, source), b"").pgn
    packets = -(-len(data) // PACKET_LENGTH)
    header = bytes([BAM, len(data) & 0xFF, len(data) >> 8, packets, _FREE])
    filled = data.ljust(packets * PACKET_LENGTH, bytes([_FREE]))
    parts = [filled[i * PACKET_LENGTH :][:PACKET_LENGTH] for i in range(packets)]
    contents = [header + number.to_bytes(3, "little")]
    contents += [bytes([i]) + part for i, part in enumerate(parts, start=1)]
    connection, transfer = (make_id(_PRIORITY, p, source) for p in (CONNECTION, TRANSFER))
    ids = [connection, *[transfer] * packets]
    times = [round(time + i * spacing, 6) for i in range(packets + 1)]
    return [Frame(*frame) for frame in zip(ids, contents, times, strict=True)]


def _check(data: bytes, spacing: float, time: float) -> None:
    if not _MIN_LENGTH <= len(data) <= MAX_LENGTH:
        raise BusError(f"long message of {len(data)} bytes: {_MIN_LENGTH} to {MAX_LENGTH} allowed")
    low, high = _SPACINGS
    if not low <= spacing <= high:
        raise BusError(f"spacing {spacing!r} s of packets: {low} to {high} allowed")
    if not math.isfinite(time):
        raise BusError(f"time {time!r} s of a long message: a finite number is wanted")
