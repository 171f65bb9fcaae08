"""Passes received commands to the truck, or those of the safe stop while none arrive.

A stop never weakens other braking: an active XBR demand, for example of an emergency brake
assistant that still sends, and the driver's brake pedal count beside it.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass

from controllers.safe_stop.stop import SLACK, SafeStop, StopPhase
from iits_mj.core.checks import require_positive
from iits_mj.core.messages import EgoState, VehicleCommand, XbrMode


class CommandSource(enum.Enum):
    """Source of the truck's command: the bus, the stop, or the bus while it fades in."""

    COMMANDS = "commands"
    STOP = "stop"
    RETURNING = "returning"


@dataclass(frozen=True, slots=True)
class FallbackConfig:
    """Settings of the return to commands.

    Attributes:
      return_time: time without a gap in the commands after which they count again [s].
      blend_time: time over which they fade in [s].
      acknowledge: at standstill, commands count only after one with the accelerator released, so
        that the truck never starts with the pedal pressed.
    """

    return_time: float = 0.5
    blend_time: float = 1.0
    acknowledge: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "return_time", "blend_time", zero=True)


class Fallback:
    """Passes commands on, begins a stop when they are lost, and returns when they are back.

    Attributes:
      source: of the command now; stops: number of stops begun.
    """

    def __init__(self, stop: SafeStop, config: FallbackConfig | None = None) -> None:
        self.stop = stop
        self.config = config or FallbackConfig()
        self.reset()

    def reset(self) -> None:
        """Returns to commands without a stop."""
        self.stop.reset()
        self.source = CommandSource.COMMANDS
        self.stops = 0
        self._obeyed = VehicleCommand()
        self._back_since = math.inf
        self._acknowledged = False
        self._returned_at = 0.0
        self._left = VehicleCommand()
        self._gap = 0.0

    def command(self, ego: EgoState, received: VehicleCommand, lost: bool) -> VehicleCommand:
        """The command for the truck now; call it at least every 20 ms.

        Args:
          ego: the truck.
          received: from the bus, with safe values for missing messages.
          lost: whether the driving commands are missing.

        Raises:
          InputError: a stop is active and the truck's state is not finite.
        """
        if lost:
            self._begin()
        if self.source is CommandSource.STOP:
            stopping = self.stop.command(ego, self._obeyed)
            parked = self.stop.phase is StopPhase.PARKED
            self._obeyed = stopping if parked else _no_weaker(stopping, received)
            if self._may_return(ego, received, lost):
                self.source = CommandSource.RETURNING
                self._returned_at, self._left = ego.time, self._obeyed
                self._gap = self._obeyed.steering_wheel_angle - received.steering_wheel_angle
            return self._obeyed
        if self.source is CommandSource.RETURNING:
            blend = self.config.blend_time
            share = min((ego.time - self._returned_at) / blend, 1.0) if blend > 0.0 else 1.0
            self._obeyed = self._blend(received, share)
            if share >= 1.0:
                self.source = CommandSource.COMMANDS
        else:
            self._obeyed = received
        return self._obeyed

    def _begin(self) -> None:
        if self.source is CommandSource.STOP:
            return
        self.stop.reset()
        self.source = CommandSource.STOP
        self.stops += 1
        self._back_since, self._acknowledged = math.inf, False

    def _may_return(self, ego: EgoState, received: VehicleCommand, lost: bool) -> bool:
        config = self.config
        if lost:
            self._back_since, self._acknowledged = math.inf, False
            return False
        self._back_since = min(self._back_since, ego.time)
        self._acknowledged |= received.accelerator_pedal <= 0.0
        stands = self.stop.phase is not StopPhase.BRAKING
        if config.acknowledge and stands and not self._acknowledged:
            return False
        return ego.time - self._back_since >= config.return_time - SLACK

    def _blend(self, received: VehicleCommand, share: float) -> VehicleCommand:
        """A share of the commands, 0 to 1, with the rest of the stop's braking and steering."""
        left = 1.0 - share
        braking = -self._left.xbr_demand if self._left.xbr_mode is not XbrMode.OFF else 0.0
        fading = -braking * left
        blended = dataclasses.replace(
            received,
            accelerator_pedal=received.accelerator_pedal * share,
            steering_wheel_angle=received.steering_wheel_angle + self._gap * left,
        )
        own = received.xbr_demand if received.xbr_mode is not XbrMode.OFF else 0.0
        if fading >= own or share >= 1.0:
            return blended
        return dataclasses.replace(
            blended,
            xbr_demand=fading,
            xbr_mode=XbrMode.MAXIMUM,
            xbr_ebi_mode=self._left.xbr_ebi_mode,
        )


def _no_weaker(stopping: VehicleCommand, received: VehicleCommand) -> VehicleCommand:
    """The stop's command, with stronger braking of the received one."""
    pedal = max(stopping.brake_pedal, received.brake_pedal)
    if pedal > stopping.brake_pedal:
        stopping = dataclasses.replace(stopping, brake_pedal=pedal)
    if received.xbr_mode is XbrMode.OFF or received.xbr_demand >= stopping.xbr_demand:
        return stopping
    return dataclasses.replace(
        stopping, xbr_demand=received.xbr_demand, xbr_ebi_mode=received.xbr_ebi_mode
    )
