"""Drivers that repeat commands: those of a CAN log, and those of a recording."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from controllers.stack import Stack
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.j1939 import CommandReceiver, command_to_frames, pgn_of
from iits_mj.j1939 import Frame as BusFrame
from iits_mj.j1939.network import CONTROLLER
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.road import Route
from iits_mj.simulation.frame import Frame
from iits_mj.simulation.lock_step import LockStep, Observer

# Longest silence of the whole bus that is driven through [s]; a clock that is set leaves years.
LONGEST_SILENCE = 60.0
_STEERING = "IITS_COMMAND"


class LogDriver(Observer):
    """A `Driver` that sends what a log holds, and an observer that ends the drive with the log.

    A log in which nobody says anything for more than `LONGEST_SILENCE` ends where that begins.

    The log's first frame is the beginning of the drive. Each 20 ms the receiver hears the frames up
    to that instant, so that a log of `iits-mj drive` gives the drive again, while frames of
    somebody else's log are obeyed up to 20 ms late. Nothing is planned: the trajectory and the
    reference speed are not a number.

    Args:
      read: opens the log and gives its frames, in the order of time [s].
      route: the truck's road.
      steering_angle_max: of the truck's steering wheel [rad].
      source: whose commands are obeyed; default: everybody's who may command the truck, which the
        truck's own control units may not.
      keeper: steers in place of the log, for logs without steering commands.

    Attributes:
      receiver: the truck's side, which counts what it accepted and rejected.
      heard: frames read so far; lane_changes: changes of the lane, from one to another.
    """

    last_decision = Decision.KEEP
    refused = 0

    def __init__(
        self,
        read: Callable[[], Iterable[BusFrame]],
        route: Route,
        *,
        steering_angle_max: float = STEERING_ANGLE_MAX,
        source: int | None = None,
        keeper: Stack | None = None,
    ) -> None:
        self._read = read
        self._route = route
        self._steering_angle_max = steering_angle_max
        self._source = source
        self._keeper = keeper
        self._left: Iterator[BusFrame] = iter(())
        self._next: BusFrame | None = None
        self._end = ""
        self.receiver = self._new_receiver()
        self.heard = self.lane_changes = 0

    def reset(self) -> None:
        """Back to the beginning of the log.

        Raises:
          InputError: the log has no frame.
        """
        self.receiver = self._new_receiver()
        self.heard = self.lane_changes = 0
        self._counter = 0
        self._lane: int | None = None
        self._end = "reached the end of the log"
        self._left = iter(self._read())
        self._next = next(self._left, None)
        if self._next is None:
            raise InputError("the CAN log has no J1939 frame: nothing to drive by")
        self._start = self._next.time
        if self._keeper is not None:
            self._keeper.reset()

    def plan(self, scene: Scene) -> Trajectory:
        """Follows nothing; counts the lanes."""
        lane = int(self._route.lane_at(scene.ego.station, scene.ego.offset))
        if lane >= 0:
            self.lane_changes += self._lane not in (None, lane)
            self._lane = lane
        self._hear(round(scene.time, 6))
        if self._keeper is None:
            return nothing_planned(scene.time)
        plan = self._keeper.plan(scene)
        # The log has the accelerator and the brakes: nobody follows the keeper's speed.
        unknown = np.full_like(plan.speed, np.nan)
        return dataclasses.replace(plan, speed=unknown, acceleration=unknown)

    def control(self, ego: EgoState) -> VehicleCommand:
        """The command in force by the frames heard until now."""
        time = round(ego.time, 6)
        self._hear(time)
        if self._keeper is not None:
            self._steer(self._keeper.control(ego).steering_wheel_angle, time)
        return self.receiver.command(time)

    def reference_speed(self, station: float) -> float:
        """Not a number: the log does not tell."""
        del station
        return math.nan

    def observe(self, simulation: LockStep, frame: Frame) -> None:
        """Ends the drive when the log has no more frames, or none for long."""
        del frame
        if self._next is None:
            simulation.stop(self._end)

    def _hear(self, time: float) -> None:
        while self._next is not None:
            frame = self._next
            stamp = round(frame.time - self._start, 6)
            if stamp > time:
                return
            self.heard += 1
            if self._passes(frame):
                self.receiver.receive(BusFrame(frame.can_id, frame.data, stamp))
            self._next = self._following(frame.time)

    def _following(self, time: float) -> BusFrame | None:
        """The frame after one of a time [s]; None at the end, and before a long silence."""
        frame = next(self._left, None)
        # Not a number is no silence that can be driven through either.
        if frame is not None and not frame.time - time <= LONGEST_SILENCE:
            self._end = (
                f"reached a gap in the log: frame {self.heard + 1} ({frame.can_id:08X}) comes "
                f"{frame.time - time:.0f} s after the one before; {LONGEST_SILENCE:g} s at most"
            )
            return None
        return frame

    def _passes(self, frame: BusFrame) -> bool:
        """False for what the keeper says in place of the log, and for who would speak with it."""
        if self._keeper is None:
            return True
        return frame.pgn != pgn_of(_STEERING) and self._source in (None, frame.source)

    def _steer(self, angle: float, time: float) -> None:
        wanted = VehicleCommand(steering_wheel_angle=angle)
        for frame in command_to_frames(wanted, self._counter, time):
            if frame.pgn == pgn_of(_STEERING):
                self.receiver.receive(frame)
        self._counter += 1

    def _new_receiver(self) -> CommandReceiver:
        sources = None if self._source is None else {self._source}
        if sources is not None and self._keeper is not None:
            sources.add(CONTROLLER)
        return CommandReceiver(sources=sources, steering_angle_max=self._steering_angle_max)


def nothing_planned(time: float) -> Trajectory:
    """A plan of which nothing is known but its time."""
    unknown = np.full(2, np.nan)
    return Trajectory(
        time=np.array([time, time + 1.0]),
        station=unknown,
        offset=unknown,
        x=unknown,
        y=unknown,
        z=unknown,
        yaw=unknown,
        curvature=unknown,
        speed=unknown,
        acceleration=unknown,
        reason="a log drives",
        target_lane=-1,
    )


class CommandPlayer:
    """A `Driver` that gives recorded commands, whatever happens.

    Args:
      recorded: the command of a number, counted from 0 at `reset`, that answers a state.
    """

    last_decision = Decision.KEEP
    lane_changes = refused = 0

    def __init__(self, recorded: Callable[[int, EgoState], VehicleCommand]) -> None:
        self._recorded = recorded
        self.reset()

    def reset(self) -> None:
        """Back to the first command."""
        self._next = 0

    def plan(self, scene: Scene) -> Trajectory:
        """Plans nothing."""
        return nothing_planned(scene.time)

    def control(self, ego: EgoState) -> VehicleCommand:
        """The next command."""
        command = self._recorded(self._next, ego)
        self._next += 1
        return command

    def reference_speed(self, station: float) -> float:
        """Not a number: the recording does not tell."""
        del station
        return math.nan
