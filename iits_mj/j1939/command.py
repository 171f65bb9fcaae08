"""`VehicleCommand` to frames and back: what a controller sends, and the truck's fail-safe receiver.

| VehicleCommand | message, SPN |
|---|---|
| accelerator_pedal | EEC2, 91 |
| xbr_demand, xbr_mode | XBR, 2920 and 2916, with counter 3188 and checksum 3189 |
| engine_brake | TSC1 to the retarder (address 15), 518: minus this share of torque |
| steering_wheel_angle, parking_brake, transmission_mode | IITS_COMMAND (proprietary B, 0xFF00) |
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields

from iits_mj.errors import BusError, InputError
from iits_mj.j1939.checksum import (
    counter_and_checksum,
    tsc1_checksum,
    with_byte8,
    xbr_checksum,
)
from iits_mj.j1939.database import Decoded, decode, encode
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame
from iits_mj.messages import TransmissionMode, VehicleCommand, XbrMode

BRAKE_ADDRESS = 0x0B
RETARDER_ADDRESS = 0x0F
# SPN 2920's operational range is +/-10 m/s2; this truck takes decelerations only.
XBR_DEMAND_MIN = -10.0
_TORQUE_CONTROL = 2
_ACTIVE_XBR_MODES = (XbrMode.ADDITION, XbrMode.MAXIMUM)


def command_to_frames(command: VehicleCommand, counter: int, time: float = 0.0) -> list[Frame]:
    """The four frames that carry a command: EEC2, XBR, TSC1 and IITS_COMMAND.

    Args:
      command: what the truck shall do.
      counter: number of the cycle; the messages' own counters are taken from it.
      time: of the frames [s].

    Raises:
      InputError: a field is not finite or outside its range.
    """
    for field in fields(command):
        value = float(getattr(command, field.name))
        if not math.isfinite(value):
            raise InputError(f"command {field.name} = {value!r}: a finite number is wanted")
    try:
        return _frames(command, counter, time)
    except BusError as error:
        raise InputError(f"command cannot be sent: {error}") from error


def _frames(command: VehicleCommand, counter: int, time: float) -> list[Frame]:
    _within("accelerator_pedal", command.accelerator_pedal, 0.0, 1.0)
    _within("engine_brake", command.engine_brake, 0.0, 1.0)
    _within("xbr_demand", command.xbr_demand, XBR_DEMAND_MIN, 0.0)
    pedal = {"accelerator_pedal_position_percent": 100.0 * command.accelerator_pedal}
    xbr = encode(
        "XBR",
        {
            "external_acceleration_demand": command.xbr_demand,
            "xbr_ebi_mode": 0,
            "xbr_priority": 1,
            "xbr_control_mode": int(command.xbr_mode),
            "xbr_message_counter": counter % 16,
        },
        time=time,
    )
    braking = command.engine_brake > 0.0
    retarder = encode(
        "TSC1",
        {
            "override_control_mode": _TORQUE_CONTROL if braking else 0,
            "requested_torque_percent": -100.0 * command.engine_brake,
            "tsc1_message_counter": counter % 8,
        },
        time=time,
    )
    body = encode(
        "IITS_COMMAND",
        {
            "steering_wheel_angle_request": command.steering_wheel_angle,
            "steering_control_mode": 1,
            "parking_brake_request": float(command.parking_brake >= 0.5),
            "transmission_mode_request": int(command.transmission_mode),
            "command_message_counter": counter % 16,
        },
        time=time,
    )
    return [
        encode("EEC2", pedal, time=time),
        with_byte8(xbr, counter % 16, xbr_checksum(xbr)),
        with_byte8(retarder, counter % 8, tsc1_checksum(retarder)),
        with_byte8(body, counter % 16, xbr_checksum(body)),
    ]


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"command {name} = {value!r}: allowed is {low:g} to {high:g}")


@dataclass(frozen=True, slots=True)
class TimeOuts:
    """Longest silence [s] before a message's command falls back to its safe value."""

    pedal: float = 0.25
    xbr: float = 0.1
    retarder: float = 0.1
    body: float = 0.1


class CommandReceiver:
    """Frames in, a safe `VehicleCommand` out.

    A frame with a wrong checksum, a repeated counter, an error or not-available code, or a number
    out of range is rejected and counted in `rejected`, and the last good command stays until its
    time-out. Safe values: pedal 0; XBR released; engine brake 0; steering angle, parking brake and
    selector held as they are, with the pedal at 0, since nobody steers. With `stop_deceleration`
    the truck also brakes smoothly, at that deceleration, while steering commands are missing.
    """

    def __init__(self, time_outs: TimeOuts | None = None, stop_deceleration: float = 0.0) -> None:
        if not 0.0 <= stop_deceleration <= -XBR_DEMAND_MIN:
            raise InputError(f"stop_deceleration {stop_deceleration!r} m/s2: use 0 to 10")
        self.time_outs = time_outs or TimeOuts()
        self.stop_deceleration = stop_deceleration
        self.rejected: Counter[str] = Counter()
        self.accepted: Counter[str] = Counter()
        self._values: dict[str, float] = {}
        self._times: dict[str, float] = {}
        self._counters: dict[str, int] = {}
        self._readers: dict[str, Callable[[Frame, Decoded], dict[str, float]]] = {
            "EEC2": self._read_pedal,
            "XBR": self._read_xbr,
            "TSC1": self._read_retarder,
            "IITS_COMMAND": self._read_body,
        }

    def receive(self, frame: Frame) -> bool:
        """Takes one frame of the bus; returns True when it changed the command.

        Frames that are not commands to this truck pass untouched and uncounted.
        """
        try:
            decoded = decode(frame)
            if decoded is None or decoded.name not in self._readers:
                return False
            if not _addressed_to_us(decoded):
                return False
            values = self._readers[decoded.name](frame, decoded)
        except BusError as error:
            self.rejected[str(error)] += 1
            return False
        self._values.update(values)
        self._times[decoded.name] = frame.time
        self.accepted[decoded.name] += 1
        return True

    def command(self, time: float) -> VehicleCommand:
        """The command in force at this time [s], with the safe value of every silent message."""
        steered = self._alive("IITS_COMMAND", time, self.time_outs.body)
        pedal = self._alive("EEC2", time, self.time_outs.pedal) and steered
        braked = self._alive("XBR", time, self.time_outs.xbr)
        retarded = self._alive("TSC1", time, self.time_outs.retarder)
        value = self._values.get
        demand = value("demand", 0.0) if braked else 0.0
        mode = XbrMode(int(value("mode", 0))) if braked else XbrMode.OFF
        if not steered and self.stop_deceleration > 0.0:
            wanted = demand if mode is not XbrMode.OFF else 0.0
            demand, mode = min(wanted, -self.stop_deceleration), XbrMode.MAXIMUM
        return VehicleCommand(
            accelerator_pedal=value("pedal", 0.0) if pedal else 0.0,
            xbr_demand=demand,
            xbr_mode=mode,
            steering_wheel_angle=value("steering", 0.0),
            parking_brake=value("parking", 0.0),
            engine_brake=value("retarder", 0.0) if retarded else 0.0,
            transmission_mode=TransmissionMode(int(value("selector", 0))),
        )

    def _alive(self, name: str, time: float, time_out: float) -> bool:
        last = self._times.get(name)
        # A hair of slack: 0.1 s after a frame is still in time whatever the rounding.
        return last is not None and time - last <= time_out + 1e-9

    def _read_pedal(self, _frame: Frame, decoded: Decoded) -> dict[str, float]:
        pedal = decoded.number("accelerator_pedal_position_percent")
        return {"pedal": min(0.01 * pedal, 1.0)}

    def _read_xbr(self, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, "XBR", xbr_checksum(frame))
        mode = int(decoded.number("xbr_control_mode"))
        if mode not in (XbrMode.OFF, *_ACTIVE_XBR_MODES):
            raise BusError(f"XBR.xbr_control_mode = {mode}: allowed is 0, 1 or 2")
        demand = 0.0
        if mode in _ACTIVE_XBR_MODES:
            demand = decoded.number("external_acceleration_demand")
            # Zero lies 12 um/s2 off the grid of 1/2048.
            if not XBR_DEMAND_MIN <= demand <= 1e-3:
                raise BusError("XBR.external_acceleration_demand is outside -10 to 0 m/s2")
        self._check_counter(frame, "XBR")
        return {"mode": float(mode), "demand": min(demand, 0.0)}

    def _read_retarder(self, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, "TSC1", tsc1_checksum(frame))
        share = 0.0
        if int(decoded.number("override_control_mode")) == _TORQUE_CONTROL:
            share = -0.01 * decoded.number("requested_torque_percent")
            if not 0.0 <= share <= 1.0:
                raise BusError("TSC1.requested_torque_percent is outside -100 to 0 %")
        self._check_counter(frame, "TSC1")
        return {"retarder": share}

    def _read_body(self, frame: Frame, decoded: Decoded) -> dict[str, float]:
        self._check_sum(frame, "IITS_COMMAND", xbr_checksum(frame))
        values = {"parking": decoded.number("parking_brake_request")}
        selector = int(decoded.number("transmission_mode_request"))
        if selector not in tuple(TransmissionMode):
            raise BusError(f"IITS_COMMAND.transmission_mode_request = {selector}: use 0, 1 or 2")
        values["selector"] = float(selector)
        if int(decoded.number("steering_control_mode")) == 1:
            values["steering"] = decoded.number("steering_wheel_angle_request")
        self._check_counter(frame, "IITS_COMMAND")
        return values

    def _check_sum(self, frame: Frame, name: str, wanted: int) -> None:
        if counter_and_checksum(frame)[1] != wanted:
            raise BusError(f"{name}: wrong checksum")

    def _check_counter(self, frame: Frame, name: str) -> None:
        counter = counter_and_checksum(frame)[0]
        if self._counters.get(name) == counter:
            raise BusError(f"{name}: counter repeated")
        self._counters[name] = counter


def _addressed_to_us(decoded: Decoded) -> bool:
    wanted = {"XBR": BRAKE_ADDRESS, "TSC1": RETARDER_ADDRESS}.get(decoded.name, GLOBAL_ADDRESS)
    return decoded.destination in (wanted, GLOBAL_ADDRESS)
