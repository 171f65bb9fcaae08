"""The lock-step: one clock on which a truck, its driver and the scene advance together.

`LockStep` takes the truck, its driver, the source of scenes and the observers as arguments.
`iits_mj.simulation.Simulation` is the lock-step of a drive in traffic; the validation passes its
own scenes, drivers and recorders.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from iits_mj.core.context import Closing
from iits_mj.core.errors import InputError
from iits_mj.core.messages import Decision, EgoState, Scene, Trajectory, VehicleCommand
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD, TIMESTEP
from iits_mj.j1939 import CommandReceiver, CommandSender, Frame
from iits_mj.j1939.command import EmergencySender, with_emergency
from iits_mj.j1939.receiver import STEERING_ANGLE_MAX
from iits_mj.simulation.frame import DriveFrame


class Driver(Protocol):
    """Plans every 100 ms and commands every 20 ms; `controllers.stack.Stack` is one."""

    last_decision: Decision

    @property
    def lane_changes(self) -> int:
        """Number of lane changes completed since `reset`."""

    @property
    def refused(self) -> int:
        """Number of lane changes requested and refused since `reset`."""

    def reset(self) -> None:
        """Prepares for a new drive."""

    def plan(self, scene: Scene) -> Trajectory:
        """Returns the trajectory to follow from now on; called every 100 ms."""

    def control(self, ego: EgoState) -> VehicleCommand:
        """Returns the command for the next 20 ms."""

    def reference_speed(self, station: float) -> float:
        """Returns the speed requested at a station [m/s]."""


class DrivenTruck(Protocol):
    """The methods of a truck that the lock-step calls; `iits_mj.truck.Truck` is one."""

    def observe(self) -> EgoState:
        """Returns the present state."""

    def command(self, command: VehicleCommand) -> None:
        """Sets the controls."""

    def step(self, n: int) -> None:
        """Advances the physics by `n` time steps."""


class Observer:
    """Base class that watches a drive without changing it; every method may be overridden.

    Attributes:
      period: time between two calls of `observe` [s], a whole number of physics steps.
      reads_bus: whether `sent` is called; frames are encoded only for such observers.
    """

    period: float = CYCLE_PERIOD
    reads_bus: bool = False

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Receives the drive at its start and after every period; may call `simulation.stop`."""

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Receives every plan and the scene it was made for, the first plan included."""

    def commanded(self, ego: EgoState, wanted: VehicleCommand, obeyed: VehicleCommand) -> None:
        """Receives every command before the physics advances with it.

        Args:
          ego: the state that the command answers.
          wanted: the driver's command.
          obeyed: the command that reaches the truck.
        """

    def sent(self, frame: Frame) -> None:
        """Receives every command frame in the order of sending."""


class Sender(Protocol):
    """The controller's end of the bus."""

    def frames(self, command: VehicleCommand, time: float) -> list[Frame]:
        """Returns the frames that are due at this time [s]."""


class Guard(Protocol):
    """Watches the way apart from the driver and brakes; `EmergencyBraking` is one."""

    def reset(self) -> None:
        """Prepares for a new drive."""

    def observe(self, scene: Scene) -> None:
        """Receives every scene that the driver plans in."""

    def demand(self, ego: EgoState, wanted: VehicleCommand) -> float:
        """Returns a demanded acceleration [m/s2], 0 for none; called every 20 ms."""


class CommandPath:
    """Passes commands from the driver to the truck, directly or as J1939 frames.

    On the direct path the truck gets the unchanged command, and the frames are only for listeners.
    Over bytes, the truck gets the command that its `CommandReceiver` decodes from the frames. The
    demand of a guard is an XBR message of its own address, with the highest priority.

    Args:
      over_bytes: whether the truck obeys the frames; also an attribute.
      steering_angle_max: of the truck's steering wheel [rad].
      sender: makes the controller's end; default: sends each message at its own rate.

    Attributes:
      receiver: the truck's side; it receives nothing on the direct path.
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
        self.reset()

    def reset(self) -> None:
        """Prepares for a new drive."""
        self.receiver = CommandReceiver(steering_angle_max=self._steering_angle_max)
        self._sender = self._make_sender()
        self._guard_sender = EmergencySender()

    def transmit(
        self,
        command: VehicleCommand,
        time: float,
        listeners: Sequence[Callable[[Frame], None]] = (),
        emergency: float = 0.0,
        stage: tuple[str, bool, float] | None = None,
    ) -> VehicleCommand:
        """Returns the command that reaches the truck; calls the listeners with its frames.

        Args:
          command: of the driver.
          time: of the command [s].
          listeners: called with each frame; without listeners a direct command is not encoded.
          emergency: demand of a guard [m/s2], 0 for none.
          stage: of an emergency braking, whether it has a target, and the time to collision [s],
            for AEBS1; None: no guard that reports them.

        Raises:
          InputError: the command cannot be encoded.
        """
        if not (self.over_bytes or listeners):
            return with_emergency(command, emergency)
        # Log files keep microseconds: a drive repeated from a log must be the same.
        time = round(time, 6)
        frames = self._sender.frames(command, time) + self._guard_sender.frames(emergency, time)
        reports = [] if stage is None else self._guard_sender.status(*stage, time)
        for frame in frames + reports:
            for listener in listeners:
                listener(frame)
        if not self.over_bytes:
            return with_emergency(command, emergency)
        for frame in frames:
            self.receiver.receive(frame)
        return self.receiver.command(time)


class LockStep(Closing):
    """Advances a truck, its driver and the scene on one clock.

    A control step lasts 20 ms. Its order: the truck is observed; when the last plan is 100 ms old,
    the driver plans in the scene of this observation; the driver commands; the observers are
    called; the truck obeys and the physics advances.

    `Simulation` plans at the end of each cycle, before the control step of the same instant, so
    that the frame that it returns shows the new plan. This plan and the next command then answer
    two observations of one instant, whose stations differ by rounding because the road position is
    searched from the last one found. In a plain lock-step they answer the same observation.

    Args:
      truck: at the start of its drive.
      driver: plans and commands.
      scenes: returns the scene of a state.
      observers: called at their periods.
      timestep: of the truck's physics [s], which divides 20 ms.
      path: from the driver's commands to the truck; default: the direct path.
      guard: brakes apart from the driver; default: none.

    Attributes:
      truck, driver, observers, timestep, path, guard: the arguments.
      scene, trajectory: of the last plan; command: the last one that reached the truck.
      ended: reason of the end, "" while the drive goes on.

    Raises:
      InputError: 20 ms is not a multiple of the time step.
    """

    def __init__(
        self,
        truck: DrivenTruck,
        driver: Driver,
        scenes: Callable[[EgoState], Scene],
        observers: Sequence[Observer] = (),
        *,
        timestep: float = TIMESTEP,
        path: CommandPath | None = None,
        guard: Guard | None = None,
    ) -> None:
        self._control_steps = round(CONTROL_PERIOD / timestep)
        self._cycle_steps = round(CYCLE_PERIOD / timestep)
        if abs(self._control_steps * timestep - CONTROL_PERIOD) > 1e-9:
            raise InputError(
                f"timestep {timestep!r} s: the period of the commands, {CONTROL_PERIOD} s, must be "
                "a multiple of it"
            )
        self.truck: DrivenTruck = truck
        self.driver = driver
        self.observers = tuple(observers)
        self.timestep = timestep
        self.path = CommandPath(over_bytes=False) if path is None else path
        self.guard = guard
        self._scenes = scenes
        self._start()

    def _start(self) -> None:
        """Sets the clock to zero."""
        self.ended = ""
        self.command = VehicleCommand()
        self._steps = self._plan_due = 0

    @property
    def time(self) -> float:
        """Time since the start [s], a multiple of the time step."""
        return self._steps * self.timestep

    def stop(self, reason: str) -> None:
        """Ends the drive after the present cycle."""
        self.ended = self.ended or reason

    def advance(self, duration: float, until: Callable[[EgoState], bool] = lambda _: False) -> bool:
        """Drives for at most `duration` [s]; returns whether `until` ended the drive.

        `until` is called with the state at the start of every control step; a true result makes
        this step the last one.
        """
        return any(until(self._control_step()) for _ in range(round(duration / CONTROL_PERIOD)))

    def close(self) -> None:
        """Releases the resources of the drive; may be called again."""

    def _control_step(self) -> EgoState:
        """Advances 20 ms and returns the state at the start."""
        ego = self._observe()
        if self._steps >= self._plan_due:
            self._plan(ego)
        wanted = self.driver.control(ego)
        listeners = [observer.sent for observer in self.observers if observer.reads_bus]
        emergency = 0.0 if self.guard is None else self.guard.demand(ego, wanted)
        stage = self._stage()
        self.command = self.path.transmit(wanted, self.time, listeners, emergency, stage)
        for observer in self.observers:
            observer.commanded(ego, wanted, self.command)
        self.truck.command(self.command)
        self._advance_physics(self._control_steps)
        return ego

    def _stage(self) -> tuple[str, bool, float] | None:
        """Stage of an emergency braking, see `CommandPath.transmit`; None without one."""
        return None

    def _plan(self, ego: EgoState) -> None:
        """Plans in the scene of a state; the next plan is due 100 ms later."""
        self.scene = self._scenes(ego)
        self.trajectory = self.driver.plan(self.scene)
        if self.guard is not None:
            self.guard.observe(self.scene)
        self._plan_due = self._steps + self._cycle_steps
        for observer in self.observers:
            observer.planned(self.scene, self.trajectory)

    def _observe(self) -> EgoState:
        return self.truck.observe()

    def _advance_physics(self, steps: int) -> None:
        self.truck.step(steps)
        self._steps += steps
