"""Due times of cyclic messages, in whole microseconds so that rounding does not accumulate."""

from __future__ import annotations

import math
from collections.abc import Sequence

from iits_mj.core.errors import InputError

_MICROSECONDS = 1_000_000
# Offsets are multiples of the tick, below the latest start [us].
_TICK = 10_000
_LATEST_START = 100_000


class Schedule:
    """Cyclic messages with a period and an offset each, counted from the first call of `due`.

    A late message stays on its grid, and missed messages are not sent later. When time goes back,
    because a new drive begins, the schedule starts again.

    Args:
      periods: [s], 1 us or more.
      offsets: one per message [s]; default 0.

    Raises:
      InputError: a period is not a positive number.
    """

    def __init__(self, periods: Sequence[float], offsets: Sequence[float] | None = None) -> None:
        for period in periods:
            if not (math.isfinite(period) and period >= 1e-6):
                raise InputError(f"period {period!r} s of a cyclic message: use 1e-6 s or more")
        self._periods = [_whole(period) for period in periods]
        self._offsets = [_whole(offset) for offset in offsets or [0.0] * len(self._periods)]
        # Next due times from the start [us]; empty before the first call.
        self._next: list[int] = []
        self._start = self._last = 0

    def due(self, time: float) -> list[int]:
        """Indices of the messages that have become due since the last call, at a time [s].

        Raises:
          InputError: the time is not finite.
        """
        if not math.isfinite(time):
            raise InputError(f"time {time!r} s of a bus: a finite number is needed")
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
    """Offsets [s], below 0.1 s, that distribute the frames of a bus evenly over ticks of 10 ms.

    Each message in turn, the one with the shortest period first, gets the offset that minimizes the
    greatest load of its ticks.

    Args:
      periods: [s].
      weights: number of frames of each message.
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
