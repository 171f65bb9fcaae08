"""`VehicleCommand` to frames: what a controller sends. The table is `signals.csv`.

The retarders take minus the share of the torque that they can give at the moment as percent torque.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import VehicleCommand
from iits_mj.j1939.database import cycle_time, identifier
from iits_mj.j1939.frame import Frame, tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.mapping import DataMaker, FieldOf, commands
from iits_mj.j1939.network import CONTROLLER, DRIVELINE_RETARDER, ENGINE_RETARDER, checked_sources
from iits_mj.j1939.schedule import Schedule

# SPN 2920's operational range is +/-10 m/s2; this truck takes decelerations only.
XBR_DEMAND_MIN = -10.0
# SPN 695: torque control.
TORQUE_CONTROL = 2
_SHARES = ("accelerator_pedal", "engine_brake", "retarder", "brake_pedal")
# SPN 2915: second of four, below an emergency brake.
_XBR_PRIORITY = 1
STEERING_ON = 1
_FIELDS = fields(VehicleCommand)
_numbers = operator.attrgetter(*(field.name for field in _FIELDS))


@dataclass(frozen=True, slots=True)
class _Order:
    """A message of a command: how its bytes are made and the last one sealed.

    Attributes:
      message: name in the DBC; destination: address, None for everybody.
      data: from the command and the message's counter.
      counters: how many numbers the counter has; checksum: None for a message without either.
    """

    message: str
    destination: int | None
    data: Callable[[VehicleCommand, int], bytes]
    counters: int = 16
    checksum: Callable[[Frame], int] | None = xbr_checksum

    def frame(self, command: VehicleCommand, counter: int, time: float, source: int) -> Frame:
        number = counter % self.counters
        can_id = identifier(self.message, source, self.destination)
        frame = Frame(can_id, self.data(command, number), time)
        if self.checksum is None:
            return frame
        return with_byte8(frame, number, self.checksum(frame))


def command_to_frames(
    command: VehicleCommand, counter: int, time: float = 0.0, *, source: int = CONTROLLER
) -> list[Frame]:
    """The five frames of a command: EEC2, XBR, TSC1 to either retarder, IITS_COMMAND.

    Args:
      command: what the truck shall do.
      counter: number of the cycle; the messages' own counters are taken from it.
      time: of the frames [s].
      source: the controller's address.

    Raises:
      InputError: a field is not finite or outside its range.
    """
    _check(command)
    return [_frame(order, command, counter, time, source) for order in _orders()]


class CommandSender:
    """A controller's commands, each message at its own rate with its own counter.

    The rates are the DBC's: XBR and IITS_COMMAND every 20 ms, EEC2 and TSC1 every 50 ms. The first
    call sends all of them.

    Args:
      source: the controller's address.

    Raises:
      InputError: the source is no address, 0 to 253.
    """

    def __init__(self, source: int = CONTROLLER) -> None:
        checked_sources([source])
        self._source = source
        self._schedule = Schedule([cycle_time(order.message) for order in _orders()])
        self._counters = [0] * len(_orders())

    def frames(self, command: VehicleCommand, time: float) -> list[Frame]:
        """The frames of this command that are due at this time [s].

        Raises:
          InputError: the time or a field is not finite, or a field is outside its range.
        """
        _check(command)
        found = []
        for place in self._schedule.due(time):
            counter = self._counters[place]
            found.append(_frame(_orders()[place], command, counter, time, self._source))
            self._counters[place] = counter + 1
        return found


def _frame(order: _Order, command: VehicleCommand, counter: int, time: float, source: int) -> Frame:
    try:
        return order.frame(command, counter, time, source)
    except BusError as error:
        raise InputError(f"command cannot be sent: {error}") from error


def _check(command: VehicleCommand) -> None:
    # A sum is finite only if all its terms are.
    if not math.isfinite(sum(_numbers(command))):
        for field, value in zip(_FIELDS, _numbers(command), strict=True):
            if not math.isfinite(value):
                raise InputError(f"command {field.name} = {value!r}: a finite number is wanted")
    for name in _SHARES:
        _within(name, getattr(command, name), 0.0, 1.0)
    _within("xbr_demand", command.xbr_demand, XBR_DEMAND_MIN, 0.0)


@functools.cache
def _orders() -> tuple[_Order, ...]:
    pedal = _maker("EEC2")
    xbr = _maker("XBR", extra=("xbr_priority", "xbr_message_counter"))
    body = _maker(
        "IITS_COMMAND",
        extra=("parking_brake_request", "steering_control_mode", "command_message_counter"),
    )

    def switches(command: VehicleCommand, counter: int) -> tuple[float, ...]:
        return float(command.parking_brake >= 0.5), STEERING_ON, counter

    return (
        _Order("EEC2", None, lambda command, _counter: pedal(command), checksum=None),
        _Order("XBR", None, lambda command, counter: xbr(command, extra=(_XBR_PRIORITY, counter))),
        _retarder(ENGINE_RETARDER, "engine_brake"),
        _retarder(DRIVELINE_RETARDER, "retarder"),
        _Order(
            "IITS_COMMAND",
            None,
            lambda command, counter: body(command, extra=switches(command, counter)),
        ),
    )


def _retarder(address: int, share: str) -> _Order:
    extra = ("override_control_mode", "tsc1_message_counter")
    make, wanted = _maker("TSC1", address, extra), operator.attrgetter(share)

    def data(command: VehicleCommand, counter: int) -> bytes:
        mode = TORQUE_CONTROL if wanted(command) != 0.0 else 0
        return make(command, extra=(mode, counter))

    return _Order("TSC1", address, data, counters=8, checksum=tsc1_checksum)


def _maker(message: str, address: int | None = None, extra: Sequence[str] = ()) -> DataMaker:
    rows = [r for r in commands() if r.message == message and address in (None, r.address)]
    return DataMaker(message, rows, {f.name: FieldOf(0, f.name) for f in _FIELDS}, extra=extra)


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise InputError(f"command {name} = {value!r}: allowed is {low:g} to {high:g}")
