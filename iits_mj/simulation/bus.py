"""The truck's end of a bus: what it says, hears and answers at one instant."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand
from iits_mj.j1939 import CommandReceiver, CommandSender, Frame, Link, LogWriter
from iits_mj.j1939.network import ControlUnits, truck_addresses, unit_names
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.j1939.state import TruckSender
from iits_mj.parameters import TruckParameters

# --- The way of a command from who drives to the truck: straight, or as bytes over J1939 ---

FrameListener = Callable[[Frame], None]


class Sender(Protocol):
    """A controller's end of the bus."""

    def frames(self, command: VehicleCommand, time: float) -> list[Frame]:
        """The frames that are due at this time [s]."""


class CommandPath:
    """Passes commands on, and tells listeners the frames that carry them.

    Straight, the truck gets the command as it is, and the frames are what would be said. Over
    bytes, the truck gets what its `CommandReceiver` makes of the frames, so that a listener hears
    what was obeyed.

    Args:
      over_bytes: whether the truck obeys the frames.
      steering_angle_max: of the truck's steering wheel [rad].
      sender: makes the controller's end; default: each message at its own rate.

    Attributes:
      over_bytes: whether the truck obeys the frames.
      receiver: the truck's side; it has heard nothing where commands go straight.
    """

    def __init__(
        self,
        *,
        over_bytes: bool,
        steering_angle_max: float = STEERING_ANGLE_MAX,
        sender: Callable[[], Sender] = CommandSender,
    ) -> None:
        self.over_bytes = over_bytes
        self._steering_angle_max = steering_angle_max
        self._make_sender = sender
        self._listeners: list[FrameListener] = []
        self.reset()

    def reset(self) -> None:
        """Ready for a new drive; listeners stay."""
        self.receiver = CommandReceiver(steering_angle_max=self._steering_angle_max)
        self._sender = self._make_sender()

    def listen(self, listener: FrameListener) -> None:
        """Calls `listener` with every command frame from now on, in the order of sending."""
        self._listeners.append(listener)

    def forget(self, listener: FrameListener) -> None:
        """Ends what `listen` began; nothing where it did not."""
        if listener in self._listeners:
            self._listeners.remove(listener)

    def pass_on(self, command: VehicleCommand, time: float) -> VehicleCommand:
        """What reaches the truck of a command given at this time [s].

        Raises:
          InputError: the command cannot be put into frames.
        """
        if not (self.over_bytes or self._listeners):
            return command
        # Log files keep microseconds: what is obeyed now must be obeyed again from the log.
        time = round(time, 6)
        frames = self._sender.frames(command, time)
        for frame in frames:
            for listener in self._listeners:
                listener(frame)
        if not self.over_bytes:
            return command
        for frame in frames:
            self.receiver.receive(frame)
        return self.receiver.command(time)


# --- The truck's end of a bus: what it says, hears and answers at one instant ---


class TruckBus(Closing):
    """Reports a truck on a link, answers requests, and passes commands to a receiver.

    Args:
      link: the bus; it is closed with this.
      receiver: gets every frame that is heard.
      parameters: of the truck, for its percent torques and configurations.
      log: gets every frame, both ways, until it cannot be written; it is closed with this.

    Attributes:
      link, receiver: as given; units: the truck's control units in the network.
      log_failure: why the log ends before its time, "" when it does not.
    """

    def __init__(
        self,
        link: Link,
        receiver: CommandReceiver,
        parameters: TruckParameters,
        log: LogWriter | None = None,
    ) -> None:
        self.link = link
        self.receiver = receiver
        self._sender = TruckSender(parameters)
        self._log = log
        self.log_failure = ""
        self._state, self._report = EgoState(), TruckReport()
        self._due: list[Frame] = []
        # Claimed before anything else is sent, and again whenever the bus was opened anew.
        self._claimed_at_restart = -1
        self.units = ControlUnits(unit_names(sorted(truck_addresses())))

    def prepare(self, state: EgoState, report: TruckReport) -> None:
        """Makes the frames that are due at the state's time, so that `exchange` can send at once.

        Raises:
          BusError: a value is not finite.
        """
        self._state, self._report = state, report
        self._due = self._sender.frames(state, report)

    def exchange(self, time: float) -> None:
        """Sends what was prepared, hears what has come, answers it and hands it to the receiver.

        Args:
          time: of everything that is sent and heard [s].
        """
        if self._claimed_at_restart != self.link.restarts:
            self._claimed_at_restart = self.link.restarts
            self._send(self.units.claims(time))
        self._send([frame for frame in self._due if self.units.owns(frame)])
        self._due = []
        heard = self.link.receive(time)
        for frame in heard:
            self._note(frame)
            self.receiver.receive(frame)
        self._send(self.units.answer(heard, self._groups, time))

    def close(self) -> None:
        """Leaves the bus and finishes the log."""
        self.link.close()
        self.finish_log()

    def finish_log(self) -> None:
        """Completes the log and goes on without one; may be called again."""
        log, self._log = self._log, None
        if log is None:
            return
        try:
            log.close()
        except BusError as error:
            self.log_failure = self.log_failure or str(error)

    def _note(self, frame: Frame) -> None:
        """Logs a frame; a log that cannot be written is finished, and the bus goes on without."""
        if self._log is None:
            return
        try:
            self._log.write(frame)
        except BusError as error:
            self.log_failure = str(error)
            self.finish_log()

    def _groups(self, pgn: int, address: int) -> list[Frame] | None:
        return self._sender.answer(pgn, address, self._state, self._report)

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            if self.link.send(frame):
                self._note(frame)
