"""What a command message asks of the truck; every field that counts must be valid."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import ClassVar

from iits_mj.core.errors import BusError
from iits_mj.core.messages import TransmissionMode, XbrEbiMode, XbrMode
from iits_mj.j1939.command import STEERING_ON, TORQUE_CONTROL, XBR_DEMAND_MIN
from iits_mj.j1939.groups import NOT_AVAILABLE, Status, Value

# Zero of SPN 2920 lies 12 um/s2 off its grid of 1/2048.
_DEMAND_SLACK = 1e-3
# Half a step of the steering signal: an angle at the end stop may be rounded beyond it.
_ANGLE_SLACK = 0.5 / 1024
# SPN 695: no override.
_OVERRIDE_OFF = 0
# By the numbers of the bus, in less than half the time that the enumerations take.
_MODES: dict[float, XbrMode] = {mode.value: mode for mode in XbrMode}
_EBI_MODES: dict[float, XbrEbiMode] = {mode.value: mode for mode in XbrEbiMode}
_SELECTOR: dict[float, TransmissionMode] = {mode.value: mode for mode in TransmissionMode}


class Reason(enum.Enum):
    """What is wrong with a command frame, or why a valid one is not obeyed."""

    LENGTH = "wrong length"
    TIME = "time stamp not finite"
    LATE = "older than the last"
    CHECKSUM = "wrong checksum"
    REPEATED = "counter repeated"
    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"
    # Valid, but for another truck, or from a sender that may not command it.
    ADDRESS = "to another address"
    SENDER = "from an address that is not obeyed"
    HELD = "held by another sender"


class RejectedError(BusError):
    """A command frame is not acted upon, for this reason."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class PedalRequest:
    """Accelerator pedal, 0 to 1 (EEC2).

    This and the other requests have SIGNALS, the signals that count, and `read`, which makes the
    request from their values and raises RejectedError when one is not valid.
    """

    SIGNALS: ClassVar = ("accelerator_pedal_position_percent",)

    position: float

    @classmethod
    def read(cls, position_percent: Value) -> PedalRequest:
        """The request in the values of `SIGNALS`."""
        return cls(0.01 * _number(position_percent, 0.0, 100.0))


@dataclass(frozen=True, slots=True)
class XbrRequest:
    """XBR.

    Attributes:
      mode: `XbrMode`; OFF is no demand.
      demand: [m/s2], zero or negative; ebi_mode: `XbrEbiMode`.
      priority: SPN 2915, 0 the highest to 3.
    """

    SIGNALS: ClassVar = (
        *("xbr_control_mode", "external_acceleration_demand", "xbr_ebi_mode", "xbr_priority"),
    )

    mode: XbrMode
    demand: float = 0.0
    ebi_mode: XbrEbiMode = XbrEbiMode.FRICTION_ONLY
    priority: int = 3

    @property
    def active(self) -> bool:
        """Whether it demands anything."""
        return self.mode is not XbrMode.OFF

    @classmethod
    def read(cls, mode: Value, demand: Value, ebi_mode: Value, priority: Value) -> XbrRequest:
        """The request in the values of `SIGNALS`; if the mode is off the others do not count."""
        wanted = _MODES[_number(mode, 0, max(_MODES))]
        if wanted is XbrMode.OFF:
            return cls(wanted)
        return cls(
            wanted,
            min(_number(demand, XBR_DEMAND_MIN, _DEMAND_SLACK), 0.0),
            _EBI_MODES[_number(ebi_mode, 0, max(_EBI_MODES))],
            int(_number(priority, 0, 3)),
        )


@dataclass(frozen=True, slots=True)
class RetarderRequest:
    """TSC1 to a retarder.

    Attributes:
      active: torque control; False ends the request.
      share: of the torque that it can give, 0 to 1.
      priority: SPN 897, 0 the highest to 3.
    """

    SIGNALS: ClassVar = (
        *("override_control_mode", "requested_torque_percent", "override_control_mode_priority"),
    )

    active: bool
    share: float = 0.0
    priority: int = 3

    @classmethod
    def read(cls, mode: Value, torque_percent: Value, priority: Value) -> RetarderRequest:
        """The request in the values of `SIGNALS`; a retarder here obeys no speed control."""
        wanted = _number(mode, 0, 3)
        if wanted == _OVERRIDE_OFF:
            return cls(active=False)
        if wanted != TORQUE_CONTROL:
            raise RejectedError(Reason.OUT_OF_RANGE)
        percent = _number(torque_percent, -100.0, 0.0)
        # 0.0 - x: no negative zero.
        return cls(True, 0.0 - 0.01 * percent, int(_number(priority, 0, 3)))


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """The driver's controls (IITS_COMMAND); None leaves a control as it is.

    Attributes:
      steering_wheel_angle: [rad], or None; parking_brake: 0 or 1.
      transmission_mode: `TransmissionMode`; brake_pedal: 0 to 1, or None.
    """

    SIGNALS: ClassVar = (
        "steering_control_mode",
        "steering_wheel_angle_request",
        "parking_brake_request",
        "transmission_mode_request",
        "driver_brake_pedal_percent",
    )

    steering_wheel_angle: float | None = None
    parking_brake: float = 0.0
    transmission_mode: TransmissionMode = TransmissionMode.DRIVE
    brake_pedal: float | None = None

    @classmethod
    def read(
        cls,
        steering: Value,
        angle: Value,
        parking_brake: Value,
        selector: Value,
        pedal_percent: Value,
        *,
        angle_max: float,
    ) -> BodyRequest:
        """The request in the values of `SIGNALS`; `angle_max` is the steering's end stop [rad]."""
        wanted: float | None = None
        if _number(steering, 0, 1) == STEERING_ON:
            reach = angle_max + _ANGLE_SLACK
            wanted = _number(angle, -reach, reach)
            wanted = math.copysign(min(abs(wanted), angle_max), wanted)
        parking = _number(parking_brake, 0, 1)
        mode = _SELECTOR[_number(selector, 0, max(_SELECTOR))]
        # Without a driver's pedal on board the field is "not available".
        pedal: float | None = None
        if pedal_percent is not NOT_AVAILABLE:
            pedal = 0.01 * _number(pedal_percent, 0.0, 100.0)
        return cls(wanted, parking, mode, pedal)


Request = PedalRequest | XbrRequest | RetarderRequest | BodyRequest

_OF_STATUS = {
    Status.OUT_OF_RANGE: Reason.OUT_OF_RANGE,
    Status.ERROR: Reason.ERROR,
    Status.NOT_AVAILABLE: Reason.NOT_AVAILABLE,
}


def _number(value: Value, low: float, high: float) -> float:
    """The number in a field; RejectedError when it has none within [low, high]."""
    if isinstance(value, Status):
        raise RejectedError(_OF_STATUS[value])
    if not low <= value <= high:
        raise RejectedError(Reason.OUT_OF_RANGE)
    return float(value)
