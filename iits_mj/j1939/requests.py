"""What a command message asks of the truck, read strictly: a field that counts must be valid."""

from __future__ import annotations

import math
from dataclasses import dataclass

from iits_mj.j1939.command import TORQUE_CONTROL, XBR_DEMAND_MIN
from iits_mj.j1939.group import NOT_AVAILABLE, Group
from iits_mj.j1939.groups import IitsCommand
from iits_mj.j1939.rejection import Reason, RejectedError, number
from iits_mj.messages import TransmissionMode, XbrEbiMode, XbrMode

# Zero of SPN 2920 lies 12 um/s2 off its grid of 1/2048.
_DEMAND_SLACK = 1e-3
# Half a step of the steering signal: an angle at the end stop may be rounded beyond it.
ANGLE_SLACK = 0.5 / 1024
# SPN 695: no override.
_OVERRIDE_OFF = 0
_STEERING_ON = 1
_LAST_MODE, _LAST_EBI_MODE, _LAST_SELECTOR = max(XbrMode), max(XbrEbiMode), max(TransmissionMode)


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


def read_pedal(group: Group) -> PedalRequest:
    """The request in EEC2.

    Raises:
      RejectedError: as all readers here, a field that counts is not valid.
    """
    percent = number(group, "accelerator_pedal_position_percent", 0.0, 100.0)
    return PedalRequest(0.01 * percent)


def read_xbr(group: Group) -> XbrRequest:
    """The request in XBR; where the mode is off the other fields do not count."""
    mode = XbrMode(int(number(group, "xbr_control_mode", 0, _LAST_MODE)))
    if mode is XbrMode.OFF:
        return XbrRequest(mode)
    demand = number(group, "external_acceleration_demand", XBR_DEMAND_MIN, _DEMAND_SLACK)
    return XbrRequest(
        mode,
        min(demand, 0.0),
        XbrEbiMode(int(number(group, "xbr_ebi_mode", 0, _LAST_EBI_MODE))),
        int(number(group, "xbr_priority", 0, 3)),
    )


def read_retarder(group: Group) -> RetarderRequest:
    """The request in TSC1; speed control and limits are nothing that a retarder here obeys."""
    mode = int(number(group, "override_control_mode", 0, 3))
    if mode == _OVERRIDE_OFF:
        return RetarderRequest(active=False)
    if mode != TORQUE_CONTROL:
        raise RejectedError(Reason.OUT_OF_RANGE)
    percent = number(group, "requested_torque_percent", -100.0, 0.0)
    priority = int(number(group, "override_control_mode_priority", 0, 3))
    # 0.0 - x: no negative zero.
    return RetarderRequest(True, 0.0 - 0.01 * percent, priority)


def read_body(group: Group, angle_max: float) -> BodyRequest:
    """The request in IITS_COMMAND; `angle_max` is the steering wheel's end stop [rad]."""
    angle: float | None = None
    if int(number(group, "steering_control_mode", 0, 1)) == _STEERING_ON:
        reach = angle_max + ANGLE_SLACK
        angle = number(group, "steering_wheel_angle_request", -reach, reach)
        angle = math.copysign(min(abs(angle), angle_max), angle)
    parking = number(group, "parking_brake_request", 0, 1)
    selector = int(number(group, "transmission_mode_request", 0, _LAST_SELECTOR))
    # Without a driver's pedal on board the field is "not available".
    pedal: float | None = None
    assert isinstance(group, IitsCommand)
    if group.driver_brake_pedal_percent is not NOT_AVAILABLE:
        pedal = 0.01 * number(group, "driver_brake_pedal_percent", 0.0, 100.0)
    return BodyRequest(angle, parking, TransmissionMode(selector), pedal)
