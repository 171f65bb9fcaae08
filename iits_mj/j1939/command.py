"""`VehicleCommand` to frames: what a controller sends. The table is `signals.csv`.

The retarders take minus the share of the torque that they can give at the moment as percent torque.
"""

from __future__ import annotations

import functools
import math
from dataclasses import fields

from iits_mj.errors import BusError, InputError
from iits_mj.j1939.addresses import DRIVELINE_RETARDER, ENGINE_RETARDER
from iits_mj.j1939.checksum import tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.database import encode
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.groups import EEC2, TSC1, XBR, IitsCommand
from iits_mj.j1939.mapping import Mapping, commands
from iits_mj.messages import VehicleCommand

# SPN 2920's operational range is +/-10 m/s2; this truck takes decelerations only.
XBR_DEMAND_MIN = -10.0
# SPN 695: torque control.
TORQUE_CONTROL = 2
_SHARES = ("accelerator_pedal", "engine_brake", "retarder", "brake_pedal")
# SPN 2915: second of four, below an emergency brake.
_XBR_PRIORITY = 1
_STEERING_ON = 1


def command_to_frames(command: VehicleCommand, counter: int, time: float = 0.0) -> list[Frame]:
    """The five frames of a command: EEC2, XBR, TSC1 to either retarder, IITS_COMMAND.

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
    for name in _SHARES:
        _within(name, getattr(command, name), 0.0, 1.0)
    _within("xbr_demand", command.xbr_demand, XBR_DEMAND_MIN, 0.0)
    try:
        return [
            encode(EEC2(**_signals(command, "EEC2")), time=time),
            _xbr(command, counter, time),
            _retarder(command, ENGINE_RETARDER, counter, time),
            _retarder(command, DRIVELINE_RETARDER, counter, time),
            _body(command, counter, time),
        ]
    except BusError as error:
        raise InputError(f"command cannot be sent: {error}") from error


def _xbr(command: VehicleCommand, counter: int, time: float) -> Frame:
    signals = _signals(command, "XBR")
    group = XBR(**signals, xbr_priority=_XBR_PRIORITY, xbr_message_counter=counter % 16)
    frame = encode(group, time=time)
    return with_byte8(frame, counter % 16, xbr_checksum(frame))


def _retarder(command: VehicleCommand, address: int, counter: int, time: float) -> Frame:
    signals = _signals(command, "TSC1", address)
    braking = signals["requested_torque_percent"] != 0.0
    group = TSC1(
        **signals,
        override_control_mode=TORQUE_CONTROL if braking else 0,
        tsc1_message_counter=counter % 8,
    )
    frame = encode(group, time=time, destination=address)
    return with_byte8(frame, counter % 8, tsc1_checksum(frame))


def _body(command: VehicleCommand, counter: int, time: float) -> Frame:
    signals = _signals(command, "IITS_COMMAND")
    signals["parking_brake_request"] = float(command.parking_brake >= 0.5)
    group = IitsCommand(
        **signals,
        steering_control_mode=_STEERING_ON,
        command_message_counter=counter % 16,
    )
    frame = encode(group, time=time)
    return with_byte8(frame, counter % 16, xbr_checksum(frame))


def _signals(command: VehicleCommand, message: str, address: int | None = None) -> dict[str, float]:
    """The command's part in a message (to one address), in the units of the signals."""
    return {
        row.signal: float(getattr(command, row.quantity)) / row.scale
        for row in _rows(message, address)
    }


@functools.cache
def _rows(message: str, address: int | None) -> tuple[Mapping, ...]:
    return tuple(
        row for row in commands() if row.message == message and address in (None, row.address)
    )


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"command {name} = {value!r}: allowed is {low:g} to {high:g}")
