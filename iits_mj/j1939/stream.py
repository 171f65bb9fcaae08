"""One sender's messages to one control unit: their sequence, and the last good request."""

from __future__ import annotations

import math

from iits_mj.j1939.rejection import Reason, RejectedError
from iits_mj.j1939.requests import Request

# Rounding of time stamps, which files keep to the microsecond [s].
_HAIR = 1e-6


class Stream:
    """What one sender says to one unit.

    Args:
      time_out: silence after which its sequence begins anew [s].
      modulus: of the message's counter; 0 where it has none.

    Attributes:
      request: the last good one; time: when it came [s], minus infinity before.
    """

    __slots__ = ("_counter", "_heard", "_modulus", "_time_out", "request", "time")

    def __init__(self, time_out: float, modulus: int) -> None:
        self.request: Request | None = None
        self.time = -math.inf
        self._time_out = time_out
        self._modulus = modulus
        self._counter: int | None = None
        self._heard = -math.inf

    def alive(self, time: float) -> bool:
        """Whether the last good request is young enough; one of the far future is not."""
        return abs(time - self.time) <= self._time_out + _HAIR

    def follow(self, time: float, counter: int) -> int:
        """Takes note of an authentic frame, one whose checksum is right.

        A counter that skips tells of frames that were lost on the way; this one is sound, and no
        older command could be better. A repeated counter is not obeyed, after a silence neither, so
        that a sender that is stuck never comes back by waiting.

        Returns:
          How many frames were lost before this one, as far as the counter can tell; 0 after a
          silence, where the sequence begins anew.

        Raises:
          RejectedError: the frame is older than the last, or its counter is the last one's.
        """
        if -self._time_out < time - self._heard < -_HAIR:
            raise RejectedError(Reason.LATE)
        last, gap = self._counter, abs(time - self._heard) > self._time_out + _HAIR
        if self._modulus and counter == last:
            raise RejectedError(Reason.REPEATED)
        self._counter, self._heard = counter, time
        if not self._modulus or last is None or gap:
            return 0
        return (counter - last - 1) % self._modulus

    def take(self, request: Request, time: float) -> None:
        """Keeps a good request."""
        self.request, self.time = request, time
