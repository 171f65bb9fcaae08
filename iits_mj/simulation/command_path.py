"""The way of a command from who drives to the truck: straight, or as bytes over J1939."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from iits_mj.j1939 import CommandReceiver, CommandSender, Frame
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.messages import VehicleCommand

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
