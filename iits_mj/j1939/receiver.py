"""Frames to `VehicleCommand`: the truck's side of the bus, with its fail-safe."""

from __future__ import annotations

import enum
import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace

from iits_mj.core.checks import require_positive
from iits_mj.core.errors import BusError
from iits_mj.core.messages import VehicleCommand, XbrMode
from iits_mj.j1939.command import COMMAND_MESSAGES, CommandMessage
from iits_mj.j1939.database import Codec, codec_of, pgn_of
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, counter_and_checksum
from iits_mj.j1939.network import checked_sources, foreign_addresses
from iits_mj.j1939.requests import (
    BodyRequest,
    PedalRequest,
    Reason,
    RejectedError,
    Request,
    RetarderRequest,
    SharedRequest,
    XbrRequest,
)

# The steering wheel's end stops [rad]: `steering.angle_max` of the truck's parameters.
STEERING_ANGLE_MAX = 15.708
# Names of the obeying units in the counts, by their names in `TimeOuts` and `Loss`.
UNIT_NAMES = {unit: message.name for unit, message in COMMAND_MESSAGES.items()}
# A counter of 15 means "not available" if the counter does not count that far.
_NO_COUNTER = 15
# Rounding of time stamps, which log files store in microseconds [s].
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before the command of a message falls back to its safe value.

    The defaults are five periods of the message: four consecutive frames may be lost.

    Attributes:
      pedal: EEC2; xbr: XBR; body: IITS_COMMAND.
      engine_retarder, driveline_retarder: TSC1 to each of the retarders.
    """

    pedal: float = 0.25
    xbr: float = 0.1
    engine_retarder: float = 0.25
    driveline_retarder: float = 0.25
    body: float = 0.1

    def __post_init__(self) -> None:
        require_positive(self, *(item.name for item in fields(self)))


class Heard(enum.Enum):
    """State of a command message at an instant.

    RELEASED: silent after a last request without a demand, as J1939 allows for XBR and TSC1.
    """

    NEVER = "never heard"
    ALIVE = "alive"
    RELEASED = "released"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Loss:
    """States of the command messages at an instant, by unit."""

    pedal: Heard
    xbr: Heard
    engine_retarder: Heard
    driveline_retarder: Heard
    body: Heard

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the commands that were received before and are missing now."""
        names = (item.name for item in fields(self))
        return tuple(name for name in names if getattr(self, name) is Heard.SILENT)

    @property
    def driver(self) -> bool:
        """Whether the driver is missing: no steering, or the accelerator or XBR fell silent."""
        return self.body is not Heard.ALIVE or Heard.SILENT in (self.pedal, self.xbr)


@dataclass(slots=True)
class _Stream:
    """The messages of one sender to one unit: their sequence and the last valid request.

    Attributes:
      time_out: silence after which the sequence starts again [s].
      counters: number of values of the message's counter; 0 without a counter.
      request: the last valid one; time: of its reception [s], minus infinity without one.
    """

    time_out: float
    counters: int
    request: Request | None = None
    time: float = -math.inf
    _counter: int | None = None
    _heard: float = -math.inf

    def alive(self, time: float) -> bool:
        """Whether the last valid request is recent; a request of the far future is not."""
        return abs(time - self.time) <= self.time_out + _ROUNDING

    def follow(self, time: float, counter: int) -> int:
        """Checks the counter of a frame with the right checksum; returns the number of lost frames.

        A skipped counter means that frames were lost; this frame is valid and the newest. A
        repeated counter is rejected even after a silence, so that a sender that is stuck does not
        regain control by waiting. The count is 0 after a silence, when the sequence starts again.

        Raises:
          RejectedError: the frame is older than the last one or repeats its counter.
        """
        if -self.time_out < time - self._heard < -_ROUNDING:
            raise RejectedError(Reason.LATE)
        last, gap = self._counter, abs(time - self._heard) > self.time_out + _ROUNDING
        if self.counters and counter == last:
            raise RejectedError(Reason.REPEATED)
        self._counter, self._heard = counter, time
        if not self.counters or last is None or gap:
            return 0
        return (counter - last - 1) % self.counters


# A bus has 254 addresses and four messages that command.
_MOST_STRANGERS = 1024


@dataclass(slots=True)
class _Unit:
    """A control unit that obeys a message of the controller.

    Attributes:
      message: that the unit obeys.
      signals: that a request consists of; read: makes a request from their values.
      time_out: [s].
      streams: by sender; holder: the sender that holds a message that is not shared.
      lost: number of frames that never arrived, from the counters of the received frames.
    """

    message: CommandMessage
    signals: tuple[str, ...]
    read: Callable[..., Request]
    time_out: float
    streams: dict[int, _Stream] = field(default_factory=dict)
    holder: int | None = None
    lost: int = 0
    _codec: Codec = field(init=False)

    def __post_init__(self) -> None:
        self._codec = codec_of(self.message.message).part(dict.fromkeys(self.signals, 1.0))

    def take(self, frame: Frame) -> Request:
        """Checks a frame, stores its request and returns it.

        Raises:
          RejectedError: the frame is not valid, or another sender holds the message.
        """
        if not math.isfinite(frame.time):
            raise RejectedError(Reason.TIME)
        try:
            values = self._codec.unpack(frame.data)
        except BusError as error:
            raise RejectedError(Reason.LENGTH) from error
        counter, checksum = counter_and_checksum(frame)
        if self.message.checksum is not None:
            if counter >= self.message.counters:
                missing = counter == _NO_COUNTER
                raise RejectedError(Reason.NOT_AVAILABLE if missing else Reason.OUT_OF_RANGE)
            if checksum != self.message.checksum(frame):
                raise RejectedError(Reason.CHECKSUM)
        if frame.source not in self.streams:
            self.streams[frame.source] = _Stream(self.time_out, self.message.counters)
        stream = self.streams[frame.source]
        self.lost += stream.follow(frame.time, counter)
        request = self.read(*values)
        if not isinstance(request, SharedRequest):
            if self.holder not in (None, frame.source) and self.held(frame.time) is not None:
                raise RejectedError(Reason.HELD)
            self.holder = frame.source
        stream.request, stream.time = request, frame.time
        return request

    def requests(self, time: float) -> list[tuple[int, Request]]:
        """Senders and requests in force at a time [s]."""
        return [
            (source, stream.request)
            for source, stream in self.streams.items()
            if stream.request is not None and stream.alive(time)
        ]

    def held(self, time: float) -> Request | None:
        """The holder's request; None while the holder is silent."""
        if self.holder is None:
            return None
        stream = self.streams[self.holder]
        return stream.request if stream.alive(time) else None

    def heard(self, time: float) -> Heard:
        """State of the message at a time [s]."""
        if self.requests(time):
            return Heard.ALIVE
        spoken = [s for s in self.streams.values() if s.request is not None]
        if not spoken:
            return Heard.NEVER
        last = max(spoken, key=lambda stream: stream.time).request
        if isinstance(last, SharedRequest) and not last.active:
            return Heard.RELEASED
        return Heard.SILENT


def _strongest_xbr(requests: list[tuple[int, Request]]) -> XbrRequest:
    """The demand with the highest priority (SPN 2915), of equal ones the strongest."""
    active = [
        (request.priority, request.demand, source, request)
        for source, request in requests
        if isinstance(request, XbrRequest) and request.active
    ]
    return min(active, key=lambda entry: entry[:3])[3] if active else XbrRequest(XbrMode.OFF)


def _strongest_share(requests: list[tuple[int, Request]]) -> float:
    """Torque share with the highest priority (SPN 897), of equal ones the greatest; 0 for none."""
    active = [
        (request.priority, -request.share)
        for _, request in requests
        if isinstance(request, RetarderRequest) and request.active
    ]
    return -min(active)[1] if active else 0.0


class CommandReceiver:
    """Turns the frames of a bus into a safe `VehicleCommand`.

    Control units listen by message and address: TSC1 to the engine's retarder (15) and TSC1 to the
    driveline's (16) have separate counters, values and time-outs, each also per sender. A message
    to the global address reaches every unit that obeys this message. An invalid frame is counted in
    `rejected`, a valid frame that must not be obeyed in `ignored`; the last valid command stays in
    force until its time-out.

    Several senders: of the XBR demands in force, and of the requests to a retarder, the truck obeys
    the one with the highest priority (SPN 2915, SPN 897), of equal ones the strongest. The
    accelerator and IITS_COMMAND belong to the first sender until its silence exceeds the time-out.

    Safe values: pedal 0; XBR released; retarders 0; steering angle, brake pedal, parking brake and
    selector keep their positions, with the accelerator at 0 without steering. `loss` names the
    missing commands for a fallback that does more (`controllers.safe_stop.fallback`).

    Args:
      time_outs: of the messages.
      sources: addresses that may command; default all except the truck's own, see `network`.
      steering_angle_max: end stops of the steering wheel [rad]; greater angles are out of range.

    Attributes:
      accepted: obeyed frames by unit: `EEC2`, `XBR`, `TSC1 to 15`, `TSC1 to 16`, `IITS_COMMAND`.
      rejected, ignored: frames that are not obeyed, by "unit: reason", see `Reason`.
      strangers: commands by message and address of a sender that may not command.
      lost: frames that never arrived, by unit, from the counters of the received frames.

    Raises:
      InputError: a setting is not usable.
    """

    def __init__(
        self,
        time_outs: TimeOuts | None = None,
        *,
        sources: Iterable[int] | None = None,
        steering_angle_max: float = STEERING_ANGLE_MAX,
    ) -> None:
        self.steering_angle_max = steering_angle_max
        require_positive(self, "steering_angle_max")
        self.sources = foreign_addresses() if sources is None else checked_sources(sources)
        self.time_outs = time_outs or TimeOuts()
        self.accepted: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self.strangers: Counter[tuple[str, int]] = Counter()
        # Steering, parking brake, selector and brake pedal keep the positions of this command.
        self._held = VehicleCommand()
        read_body = functools.partial(BodyRequest.read, angle_max=steering_angle_max)
        readers: dict[str, tuple[tuple[str, ...], Callable[..., Request]]] = {
            "pedal": (PedalRequest.SIGNALS, PedalRequest.read),
            "xbr": (XbrRequest.SIGNALS, XbrRequest.read),
            "engine_retarder": (RetarderRequest.SIGNALS, RetarderRequest.read),
            "driveline_retarder": (RetarderRequest.SIGNALS, RetarderRequest.read),
            "body": (BodyRequest.SIGNALS, read_body),
        }
        self._units = {
            name: _Unit(COMMAND_MESSAGES[name], *reader, getattr(self.time_outs, name))
            for name, reader in readers.items()
        }
        self._by_pgn: dict[int, list[_Unit]] = {}
        for unit in self._units.values():
            self._by_pgn.setdefault(pgn_of(unit.message.message), []).append(unit)

    @property
    def lost(self) -> dict[str, int]:
        """Frames that never arrived, by unit."""
        return {unit.message.name: unit.lost for unit in self._units.values() if unit.lost}

    @property
    def senders(self) -> dict[str, list[int]]:
        """Addresses whose commands were accepted, by unit."""
        return {
            unit.message.name: sorted(k for k, s in unit.streams.items() if s.request is not None)
            for unit in self._units.values()
        }

    def receive(self, frame: Frame) -> bool:
        """Receives one frame of the bus; returns whether a unit obeys it.

        A frame that is no command is neither obeyed nor counted.
        """
        units = self._by_pgn.get(frame.pgn)
        if units is None:
            return False
        destination = frame.destination
        addressed = [u for u in units if destination in (u.message.address, GLOBAL_ADDRESS)]
        reason = Reason.ADDRESS if not addressed else Reason.SENDER
        if not addressed or frame.source not in self.sources:
            message = units[0].message.message
            self.ignored[f"{message}: {reason.value}"] += 1
            if reason is Reason.SENDER and len(self.strangers) < _MOST_STRANGERS:
                self.strangers[message, frame.source] += 1
            return False
        taken = [self._take(unit, frame) for unit in addressed]
        return any(taken)

    def command(self, time: float) -> VehicleCommand:
        """The command in force at a time [s], with the safe value of every silent message."""
        units = self._units
        xbr = _strongest_xbr(units["xbr"].requests(time))
        pedal = units["pedal"].held(time)
        steered = units["body"].held(time) is not None
        pressed = pedal.position if steered and isinstance(pedal, PedalRequest) else 0.0
        return replace(
            self._held,
            accelerator_pedal=pressed,
            xbr_demand=xbr.demand,
            xbr_mode=xbr.mode,
            engine_brake=_strongest_share(units["engine_retarder"].requests(time)),
            retarder=_strongest_share(units["driveline_retarder"].requests(time)),
            xbr_ebi_mode=xbr.ebi_mode,
        )

    def loss(self, time: float) -> Loss:
        """States of the command messages at a time [s]."""
        return Loss(**{name: unit.heard(time) for name, unit in self._units.items()})

    def _take(self, unit: _Unit, frame: Frame) -> bool:
        name = unit.message.name
        try:
            request = unit.take(frame)
        except RejectedError as error:
            count = self.ignored if error.reason is Reason.HELD else self.rejected
            count[f"{name}: {error.reason.value}"] += 1
            return False
        if isinstance(request, BodyRequest):
            # Controls that a request leaves out keep their positions.
            given = {item.name: getattr(request, item.name) for item in fields(request)}
            self._held = replace(self._held, **{k: v for k, v in given.items() if v is not None})
        self.accepted[name] += 1
        return True
