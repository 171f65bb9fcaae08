"""`VehicleCommand` to the frames of a controller, by the table of signals `signals.csv`.

The percent torque of a retarder command is minus the requested share of the available torque.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass, fields, replace

from iits_mj.core.checks import in_range
from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import groups
from iits_mj.j1939.database import cycle_time, encode, identifier
from iits_mj.j1939.frame import GLOBAL_ADDRESS, Frame, tsc1_checksum, with_byte8, xbr_checksum
from iits_mj.j1939.mapping import DataMaker, FieldOf, commands
from iits_mj.j1939.network import (
    BRAKES,
    CONTROLLER,
    DRIVELINE_RETARDER,
    EMERGENCY_BRAKING,
    ENGINE_RETARDER,
    checked_sources,
)
from iits_mj.j1939.schedule import Schedule

# SPN 2920's operational range is +/-10 m/s2; this truck takes decelerations only.
XBR_DEMAND_MIN = -10.0
# SPN 695: torque control.
TORQUE_CONTROL = 2
STEERING_ON = 1
# SPN 2915: the second of four priorities, below an emergency brake.
_XBR_PRIORITY, _EMERGENCY_PRIORITY = 1, 0
# SPN 5676 and 5677 by the stage of the emergency braking: state, and level of the warning.
_STAGES = {
    "off": (1, 0),
    "standby": (3, 0),
    "overridden": (4, 0),
    "warning": (5, 1),
    "partial braking": (6, 2),
    "emergency braking": (7, 2),
}
_LONGEST_TTC = 12.5  # of SPN 5680 [s]
_SHARES = ("accelerator_pedal", "engine_brake", "retarder", "brake_pedal")
_FIELDS = tuple(field.name for field in fields(VehicleCommand))
_numbers = operator.attrgetter(*_FIELDS)


@dataclass(frozen=True, slots=True)
class CommandMessage:
    """A message of a command.

    Attributes:
      message: name in the DBC; address: of the unit that obeys; 255 is the global address.
      counters: number of values of its counter, 0 without a counter.
      checksum: function of a frame, None without a checksum.
    """

    message: str
    address: int
    counters: int = 16
    checksum: Callable[[Frame], int] | None = xbr_checksum

    @property
    def name(self) -> str:
        """The message, with the address if several units obey messages of this name."""
        return f"{self.message} to {self.address}" if self.message == "TSC1" else self.message


# By the names of the messages in `TimeOuts` and `Loss`.
COMMAND_MESSAGES = {
    "pedal": CommandMessage("EEC2", GLOBAL_ADDRESS, 0, None),
    "xbr": CommandMessage("XBR", BRAKES),
    "engine_retarder": CommandMessage("TSC1", ENGINE_RETARDER, 8, tsc1_checksum),
    "driveline_retarder": CommandMessage("TSC1", DRIVELINE_RETARDER, 8, tsc1_checksum),
    "body": CommandMessage("IITS_COMMAND", GLOBAL_ADDRESS),
}


def command_to_frames(
    command: VehicleCommand, counter: int, time: float = 0.0, *, source: int = CONTROLLER
) -> list[Frame]:
    """The five frames of a command: EEC2, XBR, TSC1 to each retarder, IITS_COMMAND.

    Args:
      command: for the truck.
      counter: number of the cycle, from which the counters of the messages are derived.
      time: of the frames [s].
      source: the controller's address.

    Raises:
      InputError: a field is not finite or outside its range.
    """
    _check(command)
    return [_frame(sent, command, counter, time, source) for sent in COMMAND_MESSAGES.values()]


class CommandSender:
    """Sends a controller's commands, each message at its own rate with its own counter.

    The rates are those of the DBC: XBR and IITS_COMMAND every 20 ms, EEC2 and TSC1 every 50 ms. The
    first call sends all messages.

    Args:
      source: the controller's address.

    Raises:
      InputError: the source is no address from 0 to 253.
    """

    def __init__(self, source: int = CONTROLLER) -> None:
        checked_sources([source])
        self._source = source
        self._messages = tuple(COMMAND_MESSAGES.values())
        self._schedule = Schedule([cycle_time(sent.message) for sent in self._messages])
        self._counters = [0] * len(self._messages)

    def frames(self, command: VehicleCommand, time: float) -> list[Frame]:
        """The frames of a command that are due at a time [s].

        Raises:
          InputError: the time or a field is not finite, or a field is outside its range.
        """
        _check(command)
        found = []
        for place in self._schedule.due(time):
            counter = self._counters[place]
            found.append(_frame(self._messages[place], command, counter, time, self._source))
            self._counters[place] = counter + 1
        return found


class EmergencySender:
    """Sends the brake demand (XBR) of an emergency braking, with the highest priority (SPN 2915).

    A demand is sent with every call, its end once. AEBS1 is sent at its own rate.
    """

    def __init__(self, source: int = EMERGENCY_BRAKING) -> None:
        checked_sources([source])
        self._source, self._counter, self._demands = source, 0, False
        self._schedule = Schedule([cycle_time("AEBS1")])

    def status(
        self, stage: str, target: bool, time_to_collision: float, time: float
    ) -> list[Frame]:
        """The frame of AEBS1 if it is due at a time [s].

        Args:
          stage: of the emergency braking, a value of its `EmergencyState`.
          target: whether it has one.
          time_to_collision: with the target [s]; inf if the truck does not close in.
          time: [s].
        """
        if not self._schedule.due(time):
            return []
        state, level = _STAGES[stage]
        group = groups.AEBS1(
            aebs_state=state,
            collision_warning_level=level,
            relevant_object_detected=float(target),
            time_to_collision=min(time_to_collision, _LONGEST_TTC),
        )
        return [encode(group, time=time, source=self._source)]

    def frames(self, demand: float, time: float) -> list[Frame]:
        """The frames of a demand [m/s2], zero or negative, at a time [s].

        Raises:
          InputError: the demand is not finite or out of its range.
        """
        if not (demand or self._demands):
            return []
        self._demands = demand != 0.0
        command = with_emergency(VehicleCommand(), demand)
        _check(command)
        sent, self._counter = COMMAND_MESSAGES["xbr"], self._counter + 1
        return [_frame(sent, command, self._counter, time, self._source, _EMERGENCY_PRIORITY)]


def with_emergency(command: VehicleCommand, demand: float) -> VehicleCommand:
    """Returns a command with the stronger one of its XBR demand and an emergency braking's [m/s2].

    All brakes answer the emergency braking.
    """
    own = command.xbr_demand if command.xbr_mode is not XbrMode.OFF else 0.0
    if not demand < 0.0 or demand > own:
        return command
    return replace(
        command,
        xbr_demand=demand,
        xbr_mode=XbrMode.MAXIMUM,
        xbr_ebi_mode=XbrEbiMode.INTEGRATION,
    )


def _frame(
    sent: CommandMessage,
    command: VehicleCommand,
    counter: int,
    time: float,
    source: int,
    priority: int = _XBR_PRIORITY,
) -> Frame:
    number = counter % sent.counters if sent.counters else 0
    try:
        can_id = identifier(sent.message, source, sent.address)
        frame = Frame(can_id, _data(sent, priority)(command, number), time)
    except BusError as error:
        raise InputError(f"command cannot be sent: {error}") from error
    return frame if sent.checksum is None else with_byte8(frame, number, sent.checksum(frame))


def _check(command: VehicleCommand) -> None:
    # A sum is finite only if all its terms are.
    if not math.isfinite(sum(_numbers(command))):
        for name, value in zip(_FIELDS, _numbers(command), strict=True):
            if not math.isfinite(value):
                raise InputError(f"command {name} = {value!r}: a finite number is needed")
    for name in _SHARES:
        in_range(f"command {name}", getattr(command, name), 0.0, 1.0)
    in_range("command xbr_demand", command.xbr_demand, XBR_DEMAND_MIN, 0.0)


@functools.cache
def _data(sent: CommandMessage, priority: int) -> Callable[[VehicleCommand, int], bytes]:
    """A function that makes the bytes of a message from a command and the message's counter.

    The priority is that of XBR.
    """
    rows = [
        r for r in commands() if r.message == sent.message and r.address in (None, sent.address)
    ]
    plain = {name: FieldOf(0, name) for name in _FIELDS}

    def maker(*extra: str) -> DataMaker:
        return DataMaker(sent.message, rows, plain, extra=extra)

    if sent.message == "EEC2":
        make = maker()
        return lambda command, _counter: make(command)
    if sent.message == "XBR":
        make = maker("xbr_priority", "xbr_message_counter")
        return lambda command, counter: make(command, extra=(priority, counter))
    if sent.message == "TSC1":
        make = maker("override_control_mode", "tsc1_message_counter")
        share = operator.attrgetter(rows[0].quantity)

        def retarder(command: VehicleCommand, counter: int) -> bytes:
            mode = TORQUE_CONTROL if share(command) != 0.0 else 0
            return make(command, extra=(mode, counter))

        return retarder
    make = maker("parking_brake_request", "steering_control_mode", "command_message_counter")

    def body(command: VehicleCommand, counter: int) -> bytes:
        parking = float(command.parking_brake >= 0.5)
        return make(command, extra=(parking, STEERING_ON, counter))

    return body
