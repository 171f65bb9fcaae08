"""What a command message asks of the truck, read strictly: a field that counts must be valid."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from iits_mj.core.errors import BusError
from iits_mj.core.messages import TransmissionMode, XbrEbiMode, XbrMode
from iits_mj.j1939.command import STEERING_ON, TORQUE_CONTROL, XBR_DEMAND_MIN
from iits_mj.j1939.groups import NOT_AVAILABLE, Status, Value

# Zero of SPN 2920 lies 12 um/s2 off its grid of 1/2048.
_DEMAND_SLACK = 1e-3
# Half a step of the steering signal: an angle at the end stop may be rounded beyond it.
ANGLE_SLACK = 0.5 / 1024
# SPN 695: no override.
_OVERRIDE_OFF = 0
_LAST_MODE, _LAST_EBI_MODE, _LAST_SELECTOR = max(XbrMode), max(XbrEbiMode), max(TransmissionMode)
# By the numbers of the bus, in less than half the time that the enumerations take.
_MODES: dict[float, XbrMode] = {mode.value: mode for mode in XbrMode}
_EBI_MODES: dict[float, XbrEbiMode] = {mode.value: mode for mode in XbrEbiMode}
_SELECTOR: dict[float, TransmissionMode] = {mode.value: mode for mode in TransmissionMode}

# The signals that count in a message, in the order in which its reader takes their values.
PEDAL_SIGNALS = ("accelerator_pedal_position_percent",)
XBR_SIGNALS = (
    "xbr_control_mode",
    "external_acceleration_demand",
    "xbr_ebi_mode",
    "xbr_priority",
)
RETARDER_SIGNALS = (
    "override_control_mode",
    "requested_torque_percent",
    "override_control_mode_priority",
)
BODY_SIGNALS = (
    "steering_control_mode",
    "steering_wheel_angle_request",
    "parking_brake_request",
    "transmission_mode_request",
    "driver_brake_pedal_percent",
)


@dataclass(frozen=True, slots=True)
class PedalRequest:
    """Accelerator pedal, 0 to 1 (EEC2)."""

    position: float


@dataclass(frozen=True, slots=True)
class XbrRequest:
    """XBR.

    Attributes:
      mode: `XbrMode`; OFF is no demand.
      demand: [m/s2], zero or negative; ebi_mode: `XbrEbiMode`.
      priority: SPN 2915, 0 the highest to 3.
    """

    mode: XbrMode
    demand: float = 0.0
    ebi_mode: XbrEbiMode = XbrEbiMode.FRICTION_ONLY
    priority: int = 3

    @property
    def active(self) -> bool:
        """Whether it demands anything."""
        return self.mode is not XbrMode.OFF


@dataclass(frozen=True, slots=True)
class RetarderRequest:
    """TSC1 to a retarder.

    Attributes:
      active: torque control; False ends the request.
      share: of the torque that it can give, 0 to 1.
      priority: SPN 897, 0 the highest to 3.
    """

    active: bool
    share: float = 0.0
    priority: int = 3


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """What a driver does (IITS_COMMAND); None leaves it as it is.

    Attributes:
      steering_wheel_angle: [rad], or None; parking_brake: 0 or 1.
      transmission_mode: `TransmissionMode`; brake_pedal: 0 to 1, or None.
    """

    steering_wheel_angle: float | None = None
    parking_brake: float = 0.0
    transmission_mode: TransmissionMode = TransmissionMode.DRIVE
    brake_pedal: float | None = None


Request = PedalRequest | XbrRequest | RetarderRequest | BodyRequest


def read_pedal(position_percent: Value) -> PedalRequest:
    """The request in EEC2.

    Raises:
      RejectedError: as all readers here, a field that counts is not valid.
    """
    return PedalRequest(0.01 * number(position_percent, 0.0, 100.0))


def read_xbr(mode: Value, demand: Value, ebi_mode: Value, priority: Value) -> XbrRequest:
    """The request in XBR; where the mode is off the other fields do not count."""
    wanted = _MODES[number(mode, 0, _LAST_MODE)]
    if wanted is XbrMode.OFF:
        return XbrRequest(wanted)
    return XbrRequest(
        wanted,
        min(number(demand, XBR_DEMAND_MIN, _DEMAND_SLACK), 0.0),
        _EBI_MODES[number(ebi_mode, 0, _LAST_EBI_MODE)],
        int(number(priority, 0, 3)),
    )


def read_retarder(mode: Value, torque_percent: Value, priority: Value) -> RetarderRequest:
    """The request in TSC1; speed control and limits are nothing that a retarder here obeys."""
    wanted = number(mode, 0, 3)
    if wanted == _OVERRIDE_OFF:
        return RetarderRequest(active=False)
    if wanted != TORQUE_CONTROL:
        raise RejectedError(Reason.OUT_OF_RANGE)
    percent = number(torque_percent, -100.0, 0.0)
    # 0.0 - x: no negative zero.
    return RetarderRequest(True, 0.0 - 0.01 * percent, int(number(priority, 0, 3)))


def read_body(
    steering: Value,
    angle: Value,
    parking_brake: Value,
    selector: Value,
    pedal_percent: Value,
    *,
    angle_max: float,
) -> BodyRequest:
    """The request in IITS_COMMAND; `angle_max` is the steering wheel's end stop [rad]."""
    wanted: float | None = None
    if number(steering, 0, 1) == STEERING_ON:
        reach = angle_max + ANGLE_SLACK
        wanted = number(angle, -reach, reach)
        wanted = math.copysign(min(abs(wanted), angle_max), wanted)
    parking = number(parking_brake, 0, 1)
    mode = _SELECTOR[number(selector, 0, _LAST_SELECTOR)]
    # Without a driver's pedal on board the field is "not available".
    pedal: float | None = None
    if pedal_percent is not NOT_AVAILABLE:
        pedal = 0.01 * number(pedal_percent, 0.0, 100.0)
    return BodyRequest(wanted, parking, mode, pedal)


# --- One sender's messages to one control unit: their sequence, and the last good request ---

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


# --- Why a command frame is not acted upon ---


class Reason(enum.Enum):
    """What is wrong with a frame, or why a sound one is not obeyed."""

    LENGTH = "wrong length"
    TIME = "time stamp not finite"
    LATE = "older than the last"
    CHECKSUM = "wrong checksum"
    REPEATED = "counter repeated"
    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"
    # Sound, but not for this truck, or not from who may command it.
    ADDRESS = "to another address"
    SENDER = "from an address that is not obeyed"
    HELD = "held by another sender"


class RejectedError(BusError):
    """A command frame is not acted upon, for this reason."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.value)
        self.reason = reason


_OF_STATUS = {
    Status.OUT_OF_RANGE: Reason.OUT_OF_RANGE,
    Status.ERROR: Reason.ERROR,
    Status.NOT_AVAILABLE: Reason.NOT_AVAILABLE,
}


def number(value: Value, low: float, high: float) -> float:
    """The number that a field carries, within [low, high].

    Raises:
      RejectedError: the field carries no number, or one outside.
    """
    if isinstance(value, Status):
        raise RejectedError(_OF_STATUS[value])
    if not low <= value <= high:
        raise RejectedError(Reason.OUT_OF_RANGE)
    return float(value)
