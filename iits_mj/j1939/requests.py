"""Requests in the command messages, made from their signals, which must be valid."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import ClassVar

from iits_mj.core.errors import BusError
from iits_mj.core.messages import TransmissionMode, XbrEbiMode, XbrMode
from iits_mj.j1939.command import STEERING_ON, TORQUE_CONTROL, XBR_DEMAND_MIN
from iits_mj.j1939.groups import NOT_AVAILABLE, Status, Value

# A demand of zero is 12 um/s2 off the grid of SPN 2920, 1/2048 m/s2.
_DEMAND_SLACK = 1e-3
# Half a step of the steering signal: rounding may move an angle beyond the end stop.
_ANGLE_SLACK = 0.5 / 1024
# SPN 695: no override.
_OVERRIDE_OFF = 0
# A look-up by the number of the bus takes less than half the time of the enumerations.
_MODES: dict[float, XbrMode] = {mode.value: mode for mode in XbrMode}
_EBI_MODES: dict[float, XbrEbiMode] = {mode.value: mode for mode in XbrEbiMode}
_SELECTOR: dict[float, TransmissionMode] = {mode.value: mode for mode in TransmissionMode}


class Reason(enum.Enum):
    """Reason why a command frame is invalid, or why a valid one is not obeyed."""

    LENGTH = "wrong length"
    TIME = "time stamp not finite"
    LATE = "older than the last"
    CHECKSUM = "wrong checksum"
    REPEATED = "counter repeated"
    OUT_OF_RANGE = "out of range"
    ERROR = "error"
    NOT_AVAILABLE = "not available"
    # The frame is valid, but its destination or sender is not accepted.
    ADDRESS = "to another address"
    SENDER = "from an address that is not obeyed"
    HELD = "held by another sender"


class RejectedError(BusError):
    """A command frame is not obeyed for this reason."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class PedalRequest:
    """Accelerator pedal, 0 to 1 (EEC2).

    Every request has `SIGNALS`, the signals that it consists of, and `read`, which makes the
    request from their values and raises RejectedError if one is not valid.
    """

    SIGNALS: ClassVar = ("accelerator_pedal_position_percent",)

    position: float

    @classmethod
    def read(cls, position_percent: Value) -> PedalRequest:
        """The request in the values of `SIGNALS`."""
        return cls(0.01 * _number(position_percent, 0.0, 100.0))


@dataclass(frozen=True, slots=True)
class XbrRequest:
    """External brake request (XBR).

    Attributes:
      mode: `XbrMode`; OFF is no demand.
      demand: [m/s2], zero or negative; ebi_mode: `XbrEbiMode`.
      priority: SPN 2915, 0 (highest) to 3.
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
        """Whether the request demands a deceleration."""
        return self.mode is not XbrMode.OFF

    @classmethod
    def read(cls, mode: Value, demand: Value, ebi_mode: Value, priority: Value) -> XbrRequest:
        """The request in the values of `SIGNALS`; only the mode must be valid if it is off."""
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
      share: of the torque that the retarder can give, 0 to 1.
      priority: SPN 897, 0 (highest) to 3.
    """

    SIGNALS: ClassVar = (
        *("override_control_mode", "requested_torque_percent", "override_control_mode_priority"),
    )

    active: bool
    share: float = 0.0
    priority: int = 3

    @classmethod
    def read(cls, mode: Value, torque_percent: Value, priority: Value) -> RetarderRequest:
        """The request in the values of `SIGNALS`; retarders do not obey speed control."""
        wanted = _number(mode, 0, 3)
        if wanted == _OVERRIDE_OFF:
            return cls(active=False)
        if wanted != TORQUE_CONTROL:
            raise RejectedError(Reason.OUT_OF_RANGE)
        percent = _number(torque_percent, -100.0, 0.0)
        # 0.0 - x avoids a negative zero.
        return cls(True, 0.0 - 0.01 * percent, int(_number(priority, 0, 3)))


@dataclass(frozen=True, slots=True)
class BodyRequest:
    """The driver's controls (IITS_COMMAND); a control with None keeps its position.

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
        """The request in the values of `SIGNALS`; `angle_max` is the steering end stop [rad]."""
        wanted: float | None = None
        if _number(steering, 0, 1) == STEERING_ON:
            reach = angle_max + _ANGLE_SLACK
            wanted = _number(angle, -reach, reach)
            wanted = math.copysign(min(abs(wanted), angle_max), wanted)
        parking = _number(parking_brake, 0, 1)
        mode = _SELECTOR[_number(selector, 0, max(_SELECTOR))]
        # A sender without a driver's pedal sends "not available".
        pedal: float | None = None
        if pedal_percent is not NOT_AVAILABLE:
            pedal = 0.01 * _number(pedal_percent, 0.0, 100.0)
        return cls(wanted, parking, mode, pedal)


# A unit obeys the shared request with the highest priority; the first sender holds the others.
SharedRequest = XbrRequest | RetarderRequest
Request = PedalRequest | SharedRequest | BodyRequest


def _number(value: Value, low: float, high: float) -> float:
    """The number in a field; RejectedError unless it is within [low, high]."""
    if isinstance(value, Status):
        raise RejectedError(Reason[value.name])
    if not low <= value <= high:
        raise RejectedError(Reason.OUT_OF_RANGE)
    return float(value)
