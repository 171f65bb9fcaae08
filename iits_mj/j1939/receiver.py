"""Frames to `VehicleCommand`: the truck's side of the bus, with its fail-safe."""

from __future__ import annotations

import enum
import functools
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import NamedTuple

from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrMode
from iits_mj.j1939.database import Codec, codec_of, pgn_of
from iits_mj.j1939.frame import (
    GLOBAL_ADDRESS,
    Frame,
    counter_and_checksum,
    tsc1_checksum,
    xbr_checksum,
)
from iits_mj.j1939.network import (
    BRAKES,
    DRIVELINE_RETARDER,
    ENGINE_RETARDER,
    checked_sources,
    everybody_else,
)
from iits_mj.j1939.requests import (
    BODY_SIGNALS,
    PEDAL_SIGNALS,
    RETARDER_SIGNALS,
    XBR_SIGNALS,
    BodyRequest,
    PedalRequest,
    Reason,
    RejectedError,
    Request,
    RetarderRequest,
    Stream,
    XbrRequest,
    read_body,
    read_pedal,
    read_retarder,
    read_xbr,
)

# --- How long a command may stay away, and what the receiver tells of those that do ---


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before a message's command falls back to its safe value.

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
        for item in fields(self):
            value = getattr(self, item.name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"time-out {item.name} = {value!r} s: must be finite and positive")


class Heard(enum.Enum):
    """What was heard of a command message at an instant.

    RELEASED: silent, after its last word was that it demands nothing, as J1939 lets XBR and TSC1.
    """

    NEVER = "never heard"
    ALIVE = "alive"
    RELEASED = "released"
    SILENT = "silent"


@dataclass(frozen=True, slots=True)
class Loss:
    """Which commands are missing at an instant, for who decides what to do about it."""

    pedal: Heard
    xbr: Heard
    engine_retarder: Heard
    driveline_retarder: Heard
    body: Heard

    @property
    def silent(self) -> tuple[str, ...]:
        """Names of the commands that were there and are gone."""
        names = (field.name for field in fields(self))
        return tuple(name for name in names if getattr(self, name) is Heard.SILENT)

    @property
    def driver(self) -> bool:
        """Whether nobody drives: no steering, or an accelerator or brake demand that is gone."""
        return self.body is not Heard.ALIVE or Heard.SILENT in (self.pedal, self.xbr)


# --- A control unit that obeys a message: who speaks to it, and which of several requests counts

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


# --- Frames to `VehicleCommand`: the truck's side of the bus, with its fail-safe ---

# What the units are called, by the names that their commands have in `TimeOuts` and `Loss`.
UNIT_NAMES = {
    "pedal": "EEC2",
    "xbr": "XBR",
    "engine_retarder": f"TSC1 to {ENGINE_RETARDER}",
    "driveline_retarder": f"TSC1 to {DRIVELINE_RETARDER}",
    "body": "IITS_COMMAND",
}
# The steering wheel's end stops [rad]: `steering.angle_max` of the truck's parameters.
STEERING_ANGLE_MAX = 15.708


class _Left(NamedTuple):
    """What steering, pedal and switches are left at, as `VehicleCommand` has them."""

    steering_wheel_angle: float = 0.0
    parking_brake: float = 0.0
    transmission_mode: TransmissionMode = TransmissionMode.DRIVE
    brake_pedal: float = 0.0


class CommandReceiver:
    """Frames in, a safe `VehicleCommand` out.

    Control units listen by message and address: TSC1 to the engine's retarder (15) and TSC1 to the
    driveline's (16) have their own counters, values and time-outs, and so has each sender; a
    message to the global address reaches every unit that understands it. A frame that is not sound
    is counted in `rejected`, one that is not to be obeyed in `ignored`, and the last good command
    stays until its time-out.

    Several senders: of the XBR demands in force, and of the requests to a retarder, the one of the
    highest priority counts (SPN 2915, SPN 897), among equals the strongest. The accelerator and
    IITS_COMMAND belong to the sender that was first, until it has been silent for their time-out.

    Safe values: pedal 0; XBR released; retarders 0; steering angle, brake pedal, parking brake and
    selector held as they are, with the accelerator at 0, since nobody steers. `loss` tells what is
    missing, for who can do better (`controllers.safe_stop.fallback`).

    Args:
      time_outs: of the messages.
      sources: addresses that may command; default: all but the truck's own, see `senders`.
      steering_angle_max: end stops of the steering wheel [rad]; more is out of range.

    Attributes:
      accepted: frames taken, by unit: `EEC2`, `XBR`, `TSC1 to 15`, `TSC1 to 16`, `IITS_COMMAND`.
      rejected, ignored: frames not acted upon, as "unit: reason", see `Reason`.
      lost: frames that never arrived, as the counters of those that did tell, by unit.

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
        if not (math.isfinite(steering_angle_max) and steering_angle_max > 0.0):
            raise InputError(
                f"steering_angle_max = {steering_angle_max!r} rad: must be finite and positive"
            )
        self.sources = everybody_else() if sources is None else checked_sources(sources)
        self.time_outs = time_outs or TimeOuts()
        self.steering_angle_max = steering_angle_max
        self.accepted: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.ignored: Counter[str] = Counter()
        self._left = _Left()
        self._pedal = Unit(
            UNIT_NAMES["pedal"],
            "EEC2",
            GLOBAL_ADDRESS,
            PEDAL_SIGNALS,
            read_pedal,
            self.time_outs.pedal,
        )
        self._xbr = Unit(
            UNIT_NAMES["xbr"],
            "XBR",
            BRAKES,
            XBR_SIGNALS,
            read_xbr,
            self.time_outs.xbr,
            xbr_checksum,
            16,
            shared=True,
        )
        self._engine_retarder = _retarder(
            UNIT_NAMES["engine_retarder"], ENGINE_RETARDER, self.time_outs.engine_retarder
        )
        self._retarder = _retarder(
            UNIT_NAMES["driveline_retarder"],
            DRIVELINE_RETARDER,
            self.time_outs.driveline_retarder,
        )
        self._body = Unit(
            UNIT_NAMES["body"],
            "IITS_COMMAND",
            GLOBAL_ADDRESS,
            BODY_SIGNALS,
            functools.partial(read_body, angle_max=steering_angle_max),
            self.time_outs.body,
            xbr_checksum,
            16,
        )
        self._units: dict[int, list[Unit]] = {}
        for unit in (self._pedal, self._xbr, self._engine_retarder, self._retarder, self._body):
            self._units.setdefault(pgn_of(unit.message), []).append(unit)

    @property
    def lost(self) -> dict[str, int]:
        """See the class."""
        units = [unit for units in self._units.values() for unit in units]
        return {unit.name: unit.lost for unit in units if unit.lost}

    def receive(self, frame: Frame) -> bool:
        """Takes one frame of the bus; returns True when it is obeyed.

        Frames that are not commands pass untouched and uncounted.
        """
        units = self._units.get(frame.pgn)
        if units is None:
            return False
        destination = frame.destination
        addressed = [u for u in units if destination in (u.address, GLOBAL_ADDRESS)]
        reason = Reason.ADDRESS if not addressed else Reason.SENDER
        if not addressed or frame.source not in self.sources:
            self.ignored[f"{units[0].message}: {reason.value}"] += 1
            return False
        taken = [self._take(unit, frame) for unit in addressed]
        return any(taken)

    def command(self, time: float) -> VehicleCommand:
        """The command in force at this time [s], with the safe value of every silent message."""
        xbr = strongest_xbr(self._xbr.requests(time))
        pedal = self._pedal.held(time)
        steered = self._body.held(time) is not None
        pressed = pedal.position if steered and isinstance(pedal, PedalRequest) else 0.0
        return VehicleCommand(
            accelerator_pedal=pressed,
            xbr_demand=xbr.demand,
            xbr_mode=xbr.mode,
            steering_wheel_angle=self._left.steering_wheel_angle,
            parking_brake=self._left.parking_brake,
            engine_brake=strongest_share(self._engine_retarder.requests(time)),
            transmission_mode=self._left.transmission_mode,
            retarder=strongest_share(self._retarder.requests(time)),
            brake_pedal=self._left.brake_pedal,
            xbr_ebi_mode=xbr.ebi_mode,
        )

    def loss(self, time: float) -> Loss:
        """Which commands are missing at this time [s]."""
        return Loss(
            pedal=self._pedal.heard(time),
            xbr=self._xbr.heard(time),
            engine_retarder=self._engine_retarder.heard(time),
            driveline_retarder=self._retarder.heard(time),
            body=self._body.heard(time),
        )

    def _take(self, unit: Unit, frame: Frame) -> bool:
        try:
            request = unit.take(frame)
        except RejectedError as error:
            count = self.ignored if error.reason is Reason.HELD else self.rejected
            count[f"{unit.name}: {error.reason.value}"] += 1
            return False
        if isinstance(request, BodyRequest):
            self._left = _after(self._left, request)
        self.accepted[unit.name] += 1
        return True


def _retarder(name: str, address: int, time_out: float) -> Unit:
    return Unit(
        name,
        "TSC1",
        address,
        RETARDER_SIGNALS,
        read_retarder,
        time_out,
        tsc1_checksum,
        8,
        shared=True,
    )


def _after(left: _Left, request: BodyRequest) -> _Left:
    """What steering, pedal and switches are left at; what a request leaves out stays."""
    angle, pedal = request.steering_wheel_angle, request.brake_pedal
    return _Left(
        left.steering_wheel_angle if angle is None else angle,
        request.parking_brake,
        request.transmission_mode,
        left.brake_pedal if pedal is None else pedal,
    )
