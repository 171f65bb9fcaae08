"""The lock-step: truck every 2 ms, control every 20 ms, traffic and planner every 100 ms."""

from __future__ import annotations

import copy
import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco

from controllers.planning.planner import Planner
from controllers.stack import Stack
from iits_mj.core.context import Closing
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoFootprint, EgoState, Scene, VehicleCommand
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD, TIMESTEP
from iits_mj.road import Route
from iits_mj.simulation import gaps
from iits_mj.simulation.bus import CommandPath
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import DriveLog
from iits_mj.simulation.driver import Driver, Tap
from iits_mj.simulation.frame import (
    DivergedError,
    Frame,
    Observer,
    check_finite,
    find_ending,
    read_signals,
)
from iits_mj.simulation.parts import check_start, load_map, make_stack, make_traffic
from iits_mj.simulation.summary import DriveSummary, SummaryBuilder
from iits_mj.truck import Truck
from traffic_bridge import Mirror, MixedSim, Recorder, RepSim, Traffic, VehicleFrame


class Simulation(Closing):
    """A truck with its stack on a route, in traffic.

    Args:
      config: what to drive.
      driver: who drives, made for the simulation's route; default: the stack of the configuration.
      edit_spec: called on the model's `MjSpec` before it is compiled, for cameras and the size of
        the offscreen buffer.
      traffic: the traffic, made for the route and the truck's size; default: the configuration's.
      record: keep traffic, commands and states for `save_recording`.
      visuals: adds what is only seen (road, landscape); the physics is the same without.
      timestep: of the physics [s], a whole part of 0.02 s: up to 0.005, which trains a decision
        maker as well in less time.

    Attributes:
      config, route, truck, mirror, traffic: the parts; vehicles: the traffic now.
      driver: who drives, which is the stack unless it is told otherwise; path: the way of its
        commands to the truck.
      ended: why the drive is over, "" while it is not.
      collision: the truck touched another vehicle; failed: that, or it rolled over, or the
        simulation diverged.

    Raises:
      MapError: the map cannot be read. TrafficError: SUMO refuses the network.
      InputError: the start is not on the route.
    """

    def __init__(
        self,
        config: DriveConfig,
        *,
        driver: Callable[[Route, Truck], Driver] | None = None,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
        traffic: Callable[[Route, EgoFootprint], Traffic | None] | None = None,
        record: bool = False,
        visuals: bool = True,
        timestep: float = TIMESTEP,
    ) -> None:
        self.config = config
        self.timestep = timestep
        self.route: Route = load_map(config.map).route()
        self.mirror = Mirror(visuals=visuals)
        self._taps: list[Tap] = []

        def edit(spec: mujoco.MjSpec) -> None:
            self.mirror.add_to(spec)
            if edit_spec is not None:
                edit_spec(spec)

        self.truck = Truck.load(
            config.payload,
            payload_height=config.payload_height,
            route=self.route,
            timestep=timestep,
            visuals=visuals,
            edit_spec=edit,
        )
        self._control_steps = round(CONTROL_PERIOD / timestep)
        self._cycle_steps = round(CYCLE_PERIOD / timestep)
        if abs(self._control_steps * timestep - CONTROL_PERIOD) > 1e-9:
            raise InputError(
                f"timestep {timestep!r} s: the commands' period of {CONTROL_PERIOD} s must be a "
                "multiple of it"
            )
        check_start(config, self.route, self.truck.footprint)
        if driver is None:
            self.driver: Driver = make_stack(config, self.route, self.truck.parameters)
        else:
            self.driver = driver(self.route, self.truck)
        planner = (
            self.driver.planner
            if isinstance(self.driver, Stack)
            else Planner(self.route, parameters=self.truck.parameters)
        )
        mass = self.truck.parameters.gross_mass(config.payload)
        self._bearable = planner.bearable_speed(config.start_station, mass)
        self.path = CommandPath(
            over_bytes=config.commands == "j1939",
            steering_angle_max=self.truck.parameters.steering.angle_max,
        )
        if traffic is None:
            self.traffic = make_traffic(config, self.route, self.truck.footprint, record=record)
        else:
            self.traffic = traffic(self.route, self.truck.footprint)
        self._log = (
            DriveLog(self.traffic, self.truck, config)
            if isinstance(self.traffic, Recorder)
            else None
        )
        try:
            self.reset()
        except BaseException:
            self.close()
            raise

    def reset(self) -> Frame:
        """Puts everything back to the beginning; the same drive follows, bit for bit."""
        config = self.config
        lane, station = config.start_lane, config.start_station
        offset = float(self.route.lane_offset(lane, station))
        limit = float(self.route.speed_limit(station, lane))
        ego = self.truck.reset(
            station=station,
            offset=offset,
            speed=min(config.start_speed, config.speed, limit, self._bearable),
        )
        self.mirror.bind(self.truck.model)
        self.driver.reset()
        self.path.reset()
        self.vehicles = VehicleFrame.empty()
        if self.traffic is not None:
            self.vehicles = VehicleFrame.of(self.traffic.reset(ego))
        if self._log is not None:
            self._log.begin()
        self.ended = ""
        self.collision = self.failed = False
        self._summary = SummaryBuilder()
        self._steps = 0
        self._touched: tuple[float, str, str] | None = None
        self._fuel_start = ego.fuel_used
        self._distance, self._odometer_time, self._odometer_speed = 0.0, 0.0, ego.speed
        self._wall_start = time.perf_counter()
        self._command = VehicleCommand()
        self._mirror(new=True)
        self._plan(ego)
        self.frame = self._frame(ego)
        return self.frame

    @property
    def stack(self) -> Stack:
        """The stack that drives.

        Raises:
          InputError: somebody else drives.
        """
        if not isinstance(self.driver, Stack):
            raise InputError(f"no stack drives here, but a {type(self.driver).__name__}")
        return self.driver

    @property
    def time(self) -> float:
        """Time since the start [s], exact multiples of the time step."""
        return self._steps * self.timestep

    def cycle(self, observers: Sequence[Observer] = ()) -> Frame:
        """Advances 100 ms and returns the frame at its end.

        Raises:
          DivergedError: the simulation diverged, or a number is not finite; the drive is over.
          TrafficError: SUMO failed.
        """
        schedule = [(observer, round(observer.period / self.timestep)) for observer in observers]
        for _ in range(self._cycle_steps // self._control_steps):
            ego = self._observe()
            self._drive_on(ego)
            wanted = self.driver.control(ego)
            self._command = self.path.pass_on(wanted, self.time)
            for tap in self._taps:
                tap.commanded(ego, wanted, self._command)
            self.truck.command(self._command)
            if self._log is not None:
                self._log.note_command(self.time, self._command)
            end = self._steps + self._control_steps
            while self._steps < end:
                due = [period - self._steps % period for _, period in schedule]
                self._advance(min([end - self._steps, *due]))
                # Those due at the cycle's end see the new plan, below.
                if self._steps % self._cycle_steps:
                    self._show(schedule)
        ego = self._observe()
        self._drive_on(ego)
        if self.traffic is not None:
            self.vehicles = VehicleFrame.of(self.traffic.step(ego))
        if self._log is not None:
            self._log.note_state()
        self._mirror(new=True)
        self._plan(ego)
        self.frame = self._frame(ego)
        self._summary.add(self.frame)
        self._judge_end(ego)
        self._show(schedule)
        return self.frame

    def run(
        self,
        observers: Sequence[Observer] = (),
        progress: Callable[[Frame], None] | None = None,
    ) -> DriveSummary:
        """Drives to the end of the time or of the route, to a collision or a roll-over.

        Args:
          observers: see `Observer`; they also see the instant of the start.
          progress: called after each 100 ms.

        Raises:
          DivergedError: see `cycle`; `summary` has the figures up to then.
        """
        for observer in observers:
            observer.observe(self, self.frame)
        while not self.ended:
            frame = self.cycle(observers)
            if progress is not None:
                progress(frame)
        return self.summary()

    def summary(self, ended: str | None = None) -> DriveSummary:
        """The figures so far; `ended` says why it stops here when the drive is not over."""
        warnings = {
            mujoco.mjtWarning(i).name.removeprefix("mjWARN_"): int(warning.number)
            for i, warning in enumerate(self.truck.data.warning)
            if warning.number
        }
        return self._summary.build(
            self.frame,
            wall_time=time.perf_counter() - self._wall_start,
            ended=ended or self.ended or "still driving",
            collision=self.collision,
            failed=self.failed,
            fuel=self.frame.ego.fuel_used - self._fuel_start,
            warnings=warnings,
        )

    def stop(self, reason: str) -> None:
        """Ends the drive after the present cycle, for an observer that has seen enough."""
        self.ended = self.ended or reason

    def listen(self, tap: Tap) -> None:
        """Lets a tap hear every plan and command from now on, and the plan that stands."""
        self._taps.append(tap)
        tap.planned(self.scene, self.trajectory)

    def forget(self, tap: Tap) -> None:
        """Ends what `listen` began; nothing where it did not."""
        if tap in self._taps:
            self._taps.remove(tap)

    def save_recording(self, path: Path) -> Path:
        """Writes the traffic and the truck's way through it, for `Recording.load`.

        Raises:
          InputError: the simulation does not record, or the file cannot be written.
        """
        if not isinstance(self.traffic, Recorder):
            raise InputError("this simulation does not record: make it with record=True")
        return self.traffic.save(path)

    def close(self) -> None:
        """Ends SUMO."""
        if self.traffic is not None:
            self.traffic.close()

    def _advance(self, steps: int) -> None:
        # Who may be touched in this cycle is moved and looked at in every step.
        stride = 1 if self._watching and self._touched is None else steps
        for _ in range(0, steps, stride):
            if stride < steps:
                self._mirror()
            try:
                self.truck.step(stride)
            except Error as error:
                raise self._diverged(str(error)) from error
            if self._watching:
                self._note_contact()
            self._steps += stride

    def _drive_on(self, ego: EgoState) -> None:
        """Adds the way driven since the last observation, by the trapezoidal rule."""
        elapsed = self.time - self._odometer_time
        self._distance += 0.5 * (ego.speed + self._odometer_speed) * elapsed
        self._odometer_time, self._odometer_speed = self.time, ego.speed

    def _show(self, schedule: Sequence[tuple[Observer, int]]) -> None:
        due = [observer for observer, period in schedule if self._steps % period == 0]
        if not due:
            return
        frame = self.frame
        if frame.time != self.time:
            frame = dataclasses.replace(
                frame, time=self.time, ego=self._glance(), command=self._command
            )
            self._mirror()
        for observer in due:
            observer.observe(self, frame)

    def _glance(self) -> EgoState:
        """The truck between two control instants, without a trace in the bits that follow."""
        # Observing moves the truck's memory of where it is on the route: the copy has its own.
        return copy.copy(self.truck).observe()

    def _plan(self, ego: EgoState) -> None:
        signals = read_signals(self.traffic, ego, self.route, self.truck.footprint)
        self.scene = Scene(ego.time, ego, self.vehicles, self.truck.footprint, signals)
        self.trajectory = self.driver.plan(self.scene)
        for tap in self._taps:
            tap.planned(self.scene, self.trajectory)

    def _mirror(self, *, new: bool = False) -> None:
        """Moves the traffic's bodies to where they are now; `new` after a step of the traffic.

        They exert no force, so that between two steps only pictures need them, and who may be
        touched before the next one.
        """
        ego_xy = self.truck.data.body("tractor").xpos[:2]
        elapsed = self._steps % self._cycle_steps * self.timestep
        known = None
        if elapsed > 0.0 and isinstance(self.traffic, RepSim | MixedSim):
            known = self.traffic.replay.at(self.time)
        self.mirror.update(
            self.truck.data,
            self.vehicles if new else None,
            (float(ego_xy[0]), float(ego_xy[1])),
            elapsed,
            known,
        )
        if new:
            self._watching = self.mirror.may_touch(self.truck.data, CYCLE_PERIOD)

    def _frame(self, ego: EgoState) -> Frame:
        route = self.route
        lane = int(route.lane_at(ego.station, ego.offset))
        point = route.evaluate(ego.station, ego.offset)
        ahead, behind = gaps.lane_gaps(ego, lane, self.vehicles, self.truck.footprint)
        return Frame(
            time=self.time,
            ego=ego,
            scene=self.scene,
            trajectory=self.trajectory,
            command=self._command,
            decision=self.driver.last_decision,
            lane=lane,
            lane_count=int(route.lane_count(ego.station)),
            grade=float(point.grade),
            curvature=float(point.curvature),
            speed_limit=float(route.speed_limit(ego.station, max(lane, 0))),
            reference_speed=self.driver.reference_speed(ego.station),
            gap_ahead=ahead,
            gap_behind=behind,
            box_distance=gaps.nearest_box_distance(ego, self.vehicles, self.truck.parameters),
            distance=self._distance,
            lane_changes=self.driver.lane_changes,
            refused=self.driver.refused,
        )

    def _note_contact(self) -> None:
        """Keeps the first contact, with its time."""
        if self._touched is None and (found := self.mirror.contacts(self.truck.data)):
            self._touched = (self.time, *found[0])

    def _observe(self) -> EgoState:
        try:
            ego = self.truck.observe()
            check_finite(ego)
        except Error as error:
            raise self._diverged(str(error)) from error
        return ego

    def _diverged(self, reason: str) -> DivergedError:
        self.ended, self.failed = reason, True
        return DivergedError(reason)

    def _judge_end(self, ego: EgoState) -> None:
        if self._watching:
            # The contacts of the last step are those of the vehicles' last places.
            mujoco.mj_fwdPosition(self.truck.model, self.truck.data)
            self._note_contact()
        if self._touched is not None:
            when, vehicle, body = self._touched
            self.collision = self.failed = True
            self.ended = f"collision with {vehicle} at the {body} at t = {when:.2f} s"
        elif (found := find_ending(ego, self.route, self.truck.footprint)) is not None:
            self.ended, self.failed = found
        elif self.time >= self.config.duration - 0.5 * self.timestep:
            self.ended = "reached the end of the time"
