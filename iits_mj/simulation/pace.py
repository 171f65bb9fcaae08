"""Soft real time: ticks on the monotonic clock, with their lateness measured."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from iits_mj.errors import InputError


class Pace:
    """Waits for tick after tick of a fixed period, and keeps account.

    A tick that is late is made up for by those after it, which do not wait until the clock is
    reached again; none is left out. When the lag is longer than `longest_lag`, the clock is set
    anew instead: simulated time then stays behind by what is counted in `slipped`.

    Args:
      period: of a tick [s].
      longest_lag: that is made up for [s].
      late_after: lateness from which a tick counts as late [s]; default half a period.
      clock: monotonic time [s]; sleep: waits for so many seconds.

    Attributes:
      ticks, late: how many; worst, total: lateness of the ticks [s].
      slips, slipped: how often the clock was set anew, and by how much in all [s].
    """

    def __init__(
        self,
        period: float,
        *,
        longest_lag: float = 0.05,
        late_after: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        for name, value in (("period", period), ("longest_lag", longest_lag)):
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"pace: {name} = {value!r} s: a positive time is wanted")
        self.period = period
        self.longest_lag = longest_lag
        self.late_after = 0.5 * period if late_after is None else late_after
        self._clock, self._sleep = clock, sleep
        self.ticks = self.late = self.slips = 0
        self.worst = self.total = self.slipped = 0.0
        self._start: float | None = None
        self._since_start = 0

    @property
    def mean(self) -> float:
        """Mean lateness of a tick [s]."""
        return self.total / self.ticks if self.ticks else 0.0

    def wait(self) -> float:
        """Returns when the next tick is due, with its lateness [s]; the first is due at once."""
        now = self._clock()
        if self._start is None:
            self._start = now
        due = self._start + self._since_start * self.period
        # Sleeping may end early, by the rounding of the clock.
        while (ahead := due - now) > 0.0:
            self._sleep(ahead)
            now = self._clock()
        lateness = now - due
        self._since_start += 1
        self.ticks += 1
        self.total += lateness
        self.worst = max(self.worst, lateness)
        self.late += lateness > self.late_after
        if lateness > self.longest_lag:
            self.slips += 1
            self.slipped += lateness
            self._start, self._since_start = now, 1
        return lateness
