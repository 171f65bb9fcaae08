"""Frames to `VehicleCommand`: the truck's side of the bus, with its fail-safe."""

from __future__ import annotations

import enum
import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import NamedTuple

from iits_mj.core.checks import require_positive
from iits_mj.core.errors import BusError
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrMode
from iits_mj.j1939.command import COMMAND_MESSAGES, CommandMessage
from iits_mj.j1939.database import Codec, codec_of, pgn_of
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, counter_and_checksum
from iits_mj.j1939.network import checked_sources, everybody_else
from iits_mj.j1939.requests import (
    BodyRequest,
    PedalRequest,
    Reason,
    RejectedError,
    Request,
    RetarderRequest,
    XbrRequest,
)

# The steering wheel's end stops [rad]: `steering.angle_max` of the truck's parameters.
STEERING_ANGLE_MAX = 15.708
# Names of the units that obey, as counted, by their names in `TimeOuts` and `Loss`.
UNIT_NAMES = {unit: message.name for unit, message in COMMAND_MESSAGES.items()}
# A counter of 15 says "not available" where 15 is no number of the counter.
_NO_COUNTER = 15
# Rounding of time stamps, which files keep to the microsecond [s].
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before the command of a message falls back to its safe value.

    The defaults are five periods of the message: four frames may be lost in a row.

    Attributes:
      pedal: EEC2; xbr: XBR; body: IITS_COMMAND.
      engine_retarder, driveline_retarder: TSC1 to the one and to the other.
    """

    pedal: float = 0.25
    xbr: float = 0.1
    engine_retarder: float = 0.25
    driveline_retarder: float = 0.25
    body: float = 0.1

    def __post_init__(self) -> None:
        require_positive(self, *(item.name for item in fields(self)))


class Heard(enum.Enum):
    """What was heard of a command message at an instant.

    RELEASED: silent, after its last request demanded nothing, as J1939 allows for XBR and TSC1.
    """

    NEVER = "never heard"
    ALIVE = "alive"
    RELEASED = "released"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Loss:
    """Which commands are missing at an instant."""

    pedal: Heard
    xbr: Heard
    engine_retarder: Heard
    driveline_retarder: Heard
    body: Heard

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the commands that were there and are gone."""
        names = (item.name for item in fields(self))
        return tuple(name for name in names if getattr(self, name) is Heard.SILENT)

    @property
    def driver(self) -> bool:
        """Whether the driver is missing: no steering, or an accelerator or brake demand is gone."""
        return self.body is not Heard.ALIVE or Heard.SILENT in (self.pedal, self.xbr)


@dataclass(slots=True)
class _Stream:
    """The messages of one sender to one unit: their sequence, and the last valid request.

    Attributes:
      time_out: silence after which its sequence starts again [s].
      counters: how many numbers the message's counter has; 0 for none.
      request: the last valid one; time: when it came [s], minus infinity before.
    """

    time_out: float
    counters: int
    request: Request | None = None
    time: float = -math.inf
    _counter: int | None = None
    _heard: float = -math.inf

    def alive(self, time: float) -> bool:
        """Whether the last valid request is recent; one of the far future is not."""
        return abs(time - self.time) <= self.time_out + _ROUNDING

    def follow(self, time: float, counter: int) -> int:
        """Takes the counter of an authentic frame, one with the right checksum.

        A skipped counter means that frames were lost; this one is valid, and no older command could
        be better. A repeated counter is not obeyed, not even after a silence, so that a sender that
        is stuck never comes back by waiting.

        Returns:
          How many frames were lost before this one, as far as the counter shows; 0 after a
          silence, when the sequence starts again.

        Raises:
          RejectedError: the frame is older than the last, or its counter is the last one's.
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


@dataclass(slots=True)
class _Unit:
    """A control unit that obeys a message of the controller.

    Attributes:
      message: that it obeys.
      read: makes a request from the values of the signals; signals: those that count.
      time_out: [s].
      shared: whether the unit obeys the request with the highest priority of all senders; else
        the first sender holds the message.
      streams: by sender; holder: the sender that holds the message.
      lost: frames that never arrived, by the counters of those that did.
    """

    message: CommandMessage
    read: Callable[..., Request]
    signals: tuple[str, ...]
    time_out: float
    shared: bool
    streams: dict[int, _Stream] = field(default_factory=dict)
    holder: int | None = None
    lost: int = 0
    _codec: Codec = field(init=False)

    def __post_init__(self) -> None:
        self._codec = codec_of(self.message.message).part(dict.fromkeys(self.signals, 1.0))

    def take(self, frame: Frame) -> Request:
        """Checks a frame and keeps the request in it.

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
        if not self.shared:
            if self.holder not in (None, frame.source) and self.held(frame.time) is not None:
                raise RejectedError(Reason.HELD)
            self.holder = frame.source
        stream.request, stream.time = request, frame.time
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


def _strongest_xbr(requests: list[tuple[int, Request]]) -> XbrRequest:
    """The demand of the highest priority (SPN 2915), among equals the strongest."""
    active = [
        (request.priority, request.demand, source, request)
        for source, request in requests
        if isinstance(request, XbrRequest) and request.active
    ]
    return min(active, key=lambda entry: entry[:3])[3] if active else XbrRequest(XbrMode.OFF)


def _strongest_share(requests: list[tuple[int, Request]]) -> float:
    """Torque share of the highest priority (SPN 897), among equals the greatest; 0 for none."""
    active = [
        (request.priority, -request.share)
        for _, request in requests
        if isinstance(request, RetarderRequest) and request.active
    ]
    return -min(active)[1] if active else 0.0


class _Held(NamedTuple):
    """Positions in which steering, parking brake, selector and brake pedal are held."""

    steering_wheel_angle: float = 0.0
    parking_brake: float = 0.0
    transmission_mode: TransmissionMode = TransmissionMode.DRIVE
    brake_pedal: float = 0.0


class CommandReceiver:
    """Turns the frames of a bus into a safe `VehicleCommand`.

    Control units listen by message and address: TSC1 to the engine's retarder (15) and TSC1 to the
    driveline's (16) have their own counters, values and time-outs, and so has each sender. A
    message to the global address reaches every unit that understands it. A frame that is not valid
    is counted in `rejected`, one that is not to be obeyed in `ignored`, and the last valid command
    stays until its time-out.

    Several senders: of the XBR demands in force, and of the requests to a retarder, the one of the
    highest priority counts (SPN 2915, SPN 897), among equals the strongest. The accelerator and
    IITS_COMMAND belong to the first sender, until it has been silent for their time-out.

    Safe values: pedal 0; XBR released; retarders 0; steering angle, brake pedal, parking brake and
    selector held as they are, with the accelerator at 0 without steering. `loss` names the
    missing commands, for a fallback that does more (`controllers.safe_stop.fallback`).

    Args:
      time_outs: of the messages.
      sources: addresses that may command; default all but the truck's own, see `network`.
      steering_angle_max: end stops of the steering wheel [rad]; greater angles are out of range.

    Attributes:
      accepted: frames taken, by unit: `EEC2`, `XBR`, `TSC1 to 15`, `TSC1 to 16`, `IITS_COMMAND`.
      rejected, ignored: frames not acted upon, as "unit: reason", see `Reason`.
      lost: frames that never arrived, by the counters of those that did, by unit.

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
        self.sources = everybody_else() if sources is None else checked_sources(sources)
        self.time_outs = time_outs or TimeOuts()
        self.accepted: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self._held = _Held()
        body = functools.partial(BodyRequest.read, angle_max=steering_angle_max)
        self._units = {
            "pedal": self._unit("pedal", PedalRequest.read, PedalRequest.SIGNALS),
            "xbr": self._unit("xbr", XbrRequest.read, XbrRequest.SIGNALS, shared=True),
            **{
                name: self._unit(name, RetarderRequest.read, RetarderRequest.SIGNALS, shared=True)
                for name in ("engine_retarder", "driveline_retarder")
            },
            "body": self._unit("body", body, BodyRequest.SIGNALS),
        }
        self._by_pgn: dict[int, list[_Unit]] = {}
        for unit in self._units.values():
            self._by_pgn.setdefault(pgn_of(unit.message.message), []).append(unit)

    def _unit(
        self,
        name: str,
        read: Callable[..., Request],
        signals: tuple[str, ...],
        *,
        shared: bool = False,
    ) -> _Unit:
        return _Unit(COMMAND_MESSAGES[name], read, signals, getattr(self.time_outs, name), shared)

    @property
    def lost(self) -> dict[str, int]:
        """See the class."""
        return {unit.message.name: unit.lost for unit in self._units.values() if unit.lost}

    def receive(self, frame: Frame) -> bool:
        """Takes one frame of the bus; returns True when it is obeyed.

        Frames that are not commands are ignored and not counted.
        """
        units = self._by_pgn.get(frame.pgn)
        if units is None:
            return False
        destination = frame.destination
        addressed = [u for u in units if destination in (u.message.address, GLOBAL_ADDRESS)]
        reason = Reason.ADDRESS if not addressed else Reason.SENDER
        if not addressed or frame.source not in self.sources:
            self.ignored[f"{units[0].message.message}: {reason.value}"] += 1
            return False
        taken = [self._take(unit, frame) for unit in addressed]
        return any(taken)

    def command(self, time: float) -> VehicleCommand:
        """The command in force at this time [s], with the safe value of every silent message."""
        units = self._units
        xbr = _strongest_xbr(units["xbr"].requests(time))
        pedal = units["pedal"].held(time)
        steered = units["body"].held(time) is not None
        pressed = pedal.position if steered and isinstance(pedal, PedalRequest) else 0.0
        return VehicleCommand(
            accelerator_pedal=pressed,
            xbr_demand=xbr.demand,
            xbr_mode=xbr.mode,
            engine_brake=_strongest_share(units["engine_retarder"].requests(time)),
            retarder=_strongest_share(units["driveline_retarder"].requests(time)),
            xbr_ebi_mode=xbr.ebi_mode,
            **self._held._asdict(),
        )

    def loss(self, time: float) -> Loss:
        """Which commands are missing at this time [s]."""
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
            # Controls that a request leaves out stay.
            given = {name: getattr(request, name) for name in _Held._fields}
            self._held = self._held._replace(**{k: v for k, v in given.items() if v is not None})
        self.accepted[name] += 1
        return True
