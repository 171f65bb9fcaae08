"""A bus that comes back: what a program holds that must outlive bus-off and a pulled plug."""

from __future__ import annotations

import enum
import math
import time as wall_time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError, InputError
from iits_mj.j1939.bus import Bus
from iits_mj.j1939.frame import Frame

_CHANGES_KEPT = 100


class LinkState(enum.Enum):
    """How a link is."""

    UP = "up"
    BUS_OFF = "bus-off"
    DOWN = "down"


@dataclass(frozen=True, slots=True)
class LinkChange:
    """When [s, the link's clock] a link came into a state, and why ("" when it came up)."""

    time: float
    state: LinkState
    reason: str


class Link(Closing):
    """A `Bus` that is opened again whenever it fails, and never raises on sending or receiving.

    A bus that cannot be read is down at once; one that takes no frame for `patience` is down, too,
    while a single frame that is not taken (a full queue) is only dropped. A bus that is down or
    bus-off is closed and opened again after `first_wait`, then after twice as long each time, up to
    `longest_wait`, until it carries frames; frames sent in between are dropped and counted. A
    controller that recovers from bus-off by itself is believed.

    Args:
      interface, channel: as `Bus` takes them.
      first_wait, longest_wait: before the bus is opened again [s].
      patience: longest time with every frame refused [s].
      clock: monotonic time [s].

    Attributes:
      name: of the bus; state: `LinkState`; changes: the last 100 `LinkChange`s.
      sent, received, dropped: frames; ignored: see `Bus.ignored`, over all openings.
      failures: how often the link left `UP`; restarts: how often it was opened again.

    Raises:
      BusError: the bus cannot be opened in the first place. InputError: a time is not positive.
    """

    def __init__(
        self,
        interface: str = "virtual",
        channel: str | None = None,
        *,
        first_wait: float = 0.1,
        longest_wait: float = 2.0,
        patience: float = 0.25,
        clock: Callable[[], float] = wall_time.monotonic,
    ) -> None:
        times = {"first_wait": first_wait, "longest_wait": longest_wait, "patience": patience}
        for name, value in times.items():
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"link: {name} = {value!r} s: a positive time is wanted")
        self._interface, self._channel = interface, channel
        self._first_wait, self._longest_wait = first_wait, max(first_wait, longest_wait)
        self._patience = patience
        self._clock = clock
        bus = Bus(interface, channel)
        self._bus: Bus | None = bus
        self.name = bus.name
        self.state = LinkState.UP
        self.changes: deque[LinkChange] = deque(maxlen=_CHANGES_KEPT)
        self.sent = self.received = self.dropped = self.failures = self.restarts = 0
        self._ignored: Counter[str] = Counter()
        self._wait = first_wait
        self._retry_at = math.inf
        self._refused_since: float | None = None

    @property
    def ignored(self) -> Counter[str]:
        """What was heard and is no J1939 frame, by kind."""
        return self._ignored + (self._bus.ignored if self._bus is not None else Counter())

    def send(self, frame: Frame) -> bool:
        """Sends one frame; False when it was dropped."""
        self._mend()
        if self._bus is None or self.state is LinkState.BUS_OFF:
            self.dropped += 1
            return False
        try:
            self._bus.send(frame)
        except BusError as error:
            self.dropped += 1
            self._refused(str(error))
            return False
        self.sent += 1
        self._refused_since = None
        self._well()
        return True

    def receive(self, time: float | None = None) -> list[Frame]:
        """Frames waiting, oldest first; none while the bus is down.

        Args:
          time: stamp for the frames [s]; default the bus driver's own.
        """
        self._mend()
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
            self._well()
        return frames

    def close(self) -> None:
        """Leaves the bus for good."""
        self._drop_bus()
        self._retry_at = math.inf

    def _refused(self, reason: str) -> None:
        now = self._clock()
        if self._refused_since is None:
            self._refused_since = now
        elif now - self._refused_since >= self._patience:
            self._fail(LinkState.DOWN, reason)

    def _well(self) -> None:
        """Frames pass: the next failure is a new one, with a short wait."""
        self._wait = self._first_wait

    def _fail(self, state: LinkState, reason: str) -> None:
        self.failures += self.state is LinkState.UP
        self._refused_since = None
        self._change(state, reason)
        if state is LinkState.DOWN:
            self._drop_bus()
        self._retry_at = self._clock() + self._wait
        self._wait = min(2.0 * self._wait, self._longest_wait)

    def _mend(self) -> None:
        """Opens the bus again when it is time."""
        if self.state is LinkState.UP or self._clock() < self._retry_at:
            return
        self._drop_bus()
        try:
            self._bus = Bus(self._interface, self._channel)
        except BusError:
            self._retry_at = self._clock() + self._wait
            self._wait = min(2.0 * self._wait, self._longest_wait)
            if self.state is not LinkState.DOWN:
                self._change(LinkState.DOWN, f"CAN bus {self.name} cannot be opened again")
            return
        self.restarts += 1
        self._change(LinkState.UP, "")

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
        # A driver whose device is gone may fail at this, too; there is nothing left to save.
        try:
            bus.close()
        except BusError:
            return
