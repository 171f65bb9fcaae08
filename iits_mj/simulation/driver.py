"""Drivers that repeat the commands of a CAN log or of a recording."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from controllers.stack import Stack
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.j1939 import CommandReceiver, Frame, command_to_frames, pgn_of
from iits_mj.j1939.network import CONTROLLER
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.road import Route
from iits_mj.simulation.frame import DriveFrame
from iits_mj.simulation.lock_step import LockStep, Observer

# Longest silence of the bus within a drive [s]; a logger whose clock is set may leave years.
LONGEST_SILENCE = 60.0
_STEERING = "IITS_COMMAND"


class LogDriver(Observer):
    """A `Driver` that sends the frames of a log, and an observer that ends the drive with the log.

    The drive starts with the log's first frame and ends with the last frame before a silence of
    more than `LONGEST_SILENCE`. Every 20 ms the receiver gets the frames up to that instant: a log
    of `iits-mj drive` gives the same drive, and frames of other logs act up to 20 ms late.
    Nothing is planned: the trajectory and the reference speed are not a number.

    Args:
      read: opens the log and returns its frames, in the order of time [s].
      route: the truck's road.
      steering_angle_max: of the truck's steering wheel [rad].
      source: the only sender to obey; default: every sender except the truck's control units.
      keeper: steers instead of the log, for logs without steering commands.

    Attributes:
      receiver: the truck's side, which counts accepted and rejected frames.
      heard: number of frames read; lane_changes: number of changes from one lane to another.
    """

    last_decision = Decision.KEEP
    refused = 0

    def __init__(
        self,
        read: Callable[[], Iterable[Frame]],
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
        self._left: Iterator[Frame] = iter(())
        self._next: Frame | None = None
        self._end = ""
        self.receiver = self._new_receiver()
        self.heard = self.lane_changes = 0

    def reset(self) -> None:
        """Returns to the start of the log.

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
            raise InputError("the CAN log has no J1939 frame: use a log with command frames")
        self._start = self._next.time
        if self._keeper is not None:
            self._keeper.reset()

    def plan(self, scene: Scene) -> Trajectory:
        """Returns an unknown plan, or the path of `keeper`; counts lane changes."""
        lane = int(self._route.lane_at(scene.ego.station, scene.ego.offset))
        if lane >= 0:
            self.lane_changes += self._lane not in (None, lane)
            self._lane = lane
        self._hear(round(scene.time, 6))
        if self._keeper is None:
            return nothing_planned(scene.time)
        plan = self._keeper.plan(scene)
        # The log has accelerator and brakes: the truck does not follow the keeper's speed.
        unknown = np.full_like(plan.speed, np.nan)
        return dataclasses.replace(plan, speed=unknown, acceleration=unknown)

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the command of the frames received up to now."""
        time = round(ego.time, 6)
        self._hear(time)
        if self._keeper is not None:
            self._steer(self._keeper.control(ego).steering_wheel_angle, time)
        return self.receiver.command(time)

    def reference_speed(self, station: float) -> float:
        """Returns not a number: a log has no reference speed."""
        del station
        return math.nan

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Ends the drive at the end of the log or before a long silence."""
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
                self.receiver.receive(Frame(frame.can_id, frame.data, stamp))
            self._next = self._following(frame.time)

    def _following(self, time: float) -> Frame | None:
        """Returns the frame after one at `time` [s]; None at the end or before a long silence."""
        frame = next(self._left, None)
        # Negated, so that a time that is not a number counts as a silence.
        if frame is not None and not frame.time - time <= LONGEST_SILENCE:
            self._end = (
                f"reached a gap in the log: frame {self.heard + 1} ({frame.can_id:08X}) comes "
                f"{frame.time - time:.0f} s after the one before; allowed: {LONGEST_SILENCE:g} s"
            )
            return None
        return frame

    def _passes(self, frame: Frame) -> bool:
        """Returns False for a frame that the keeper replaces or that another sender sent."""
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
    """Returns a plan with a known time; everything else is not a number."""
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
    """A `Driver` that repeats recorded commands.

    Args:
      recorded: returns the command of a number, counted from 0 at `reset`, in a state.
    """

    last_decision = Decision.KEEP
    lane_changes = refused = 0

    def __init__(self, recorded: Callable[[int, EgoState], VehicleCommand]) -> None:
        self._recorded = recorded
        self.reset()

    def reset(self) -> None:
        """Returns to the first command."""
        self._next = 0

    def plan(self, scene: Scene) -> Trajectory:
        """Returns an unknown plan."""
        return nothing_planned(scene.time)

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the next command."""
        command = self._recorded(self._next, ego)
        self._next += 1
        return command

    def reference_speed(self, station: float) -> float:
        """Returns not a number: the reference speed is not recorded."""
        del station
        return math.nan
