"""`Simulation`: the lock-step of a drive of the truck in traffic.

The truck advances every 2 ms, the controller every 20 ms, traffic and planner every 100 ms.
"""

from __future__ import annotations

import cmath
import copy
import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco

from controllers.emergency_braking import EmergencyBraking, EmergencyReport
from controllers.planning.planner import Planner
from controllers.stack import Stack
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import EgoFootprint, EgoState, Scene, positional
from iits_mj.core.neighbors import Neighbors
from iits_mj.core.progress import task
from iits_mj.core.timing import CYCLE_PERIOD, TIMESTEP
from iits_mj.road import Route
from iits_mj.simulation.config import DriveConfig
from iits_mj.simulation.drive_log import DriveLog
from iits_mj.simulation.frame import (
    DivergedError,
    DriveFrame,
    Impact,
    check_finite,
    find_ending,
    read_signals,
)
from iits_mj.simulation.gaps import nearest_box_distance
from iits_mj.simulation.lock_step import CommandPath, Driver, LockStep, Observer
from iits_mj.simulation.parts import (
    load_route,
    load_truck,
    make_recorder,
    make_stack,
    make_traffic,
    placed,
    road_user_slots,
    surface_text,
    with_scenario,
)
from iits_mj.simulation.sensors import SUITES, Perception
from iits_mj.simulation.summary import DriveSummary, SummaryBuilder
from iits_mj.simulation.traffic_flow import FlowMeter
from iits_mj.simulation.truck_events import TruckEvents
from iits_mj.truck import Truck
from traffic_bridge import EndDrive, EventRecord, Mirror, PureSim, Recorder, Traffic, VehicleFrame

_drive_frame = positional(DriveFrame)


class Simulation(LockStep):
    """A truck with its driving stack on a route in traffic.

    Args:
      config: of the drive.
      driver: makes the driver for a route and a truck; default: the stack of the configuration.
      edit_spec: called on the model's `MjSpec` before compilation, for cameras and the size of the
        offscreen buffer.
      traffic: makes the traffic for a route and a truck's size; default: the configuration's.
      route: the truck's road, for instance with another friction; default: the configured map's.
      record: keeps traffic, commands and states for `save_recording`.
      visuals: adds road and landscape for pictures; the physics is the same without.
      timestep: of the physics [s], a divisor of 0.02 s up to 0.005; the largest one trains a
        decision maker as well in less time.

    Attributes:
      config, route, truck, mirror, traffic: the parts; vehicles: the traffic now.
      driver: of the truck; path: from its commands to the truck.
      perception: sensors and tracker, None where the stack knows the traffic as it is.
      frame: the drive at the end of the last cycle.
      ended: reason of the end, "" while the drive goes on.
      collision: the truck touched another vehicle; failed: it did, it rolled over, or the
        simulation diverged.
      impact: the collision; None without one.

    Raises:
      MapError: the map cannot be read. TrafficError: SUMO refuses the network.
      InputError: the start is not on the route, or the time step is not allowed.
    """

    truck: Truck

    def __init__(
        self,
        config: DriveConfig,
        *,
        driver: Callable[[Route, Truck], Driver] | None = None,
        edit_spec: Callable[[mujoco.MjSpec], None] | None = None,
        traffic: Callable[[Route, EgoFootprint], Traffic | None] | None = None,
        route: Route | None = None,
        record: bool = False,
        visuals: bool = True,
        timestep: float = TIMESTEP,
    ) -> None:
        self.config = config = with_scenario(config)
        self.route: Route = load_route(config) if route is None else route
        road_users = road_user_slots(config) or traffic is not None
        self.mirror = Mirror(visuals=visuals, road_users=road_users)
        truck = load_truck(
            config,
            self.route,
            self.mirror,
            timestep=timestep,
            visuals=visuals,
            edit_spec=edit_spec,
        )
        self.config = config = placed(config, self.route, truck.footprint)
        made: Driver
        if driver is None:
            made = stack = make_stack(config, self.route, truck.parameters)
            planner = stack.planner
        else:
            made = driver(self.route, truck)
            planner = None
        if not isinstance(planner, Planner):
            planner = Planner(self.route, parameters=truck.parameters)
        mass = truck.parameters.gross_mass(truck.payload)
        self._safe_speed = planner.bearable_speed(config.start_station, mass)
        path = CommandPath(
            over_bytes=config.commands == "j1939",
            steering_angle_max=truck.parameters.steering.angle_max,
        )
        self.perception: Perception | None = None
        if config.sensors in SUITES:
            self.perception = Perception(
                SUITES[config.sensors], self.route, truck.footprint, config.seed
            )
        guard: EmergencyBraking | None = None
        if config.aeb == "on":
            # A driver knows a wet road from the wipers: so does the emergency braking.
            guard = EmergencyBraking(
                truck.parameters, lambda ego: self.route.friction(ego.station, ego.offset)
            )
        super().__init__(truck, made, self._scene, timestep=timestep, path=path, guard=guard)
        self._truck_events = TruckEvents(truck)
        self._recorder: Recorder | None = None
        self.traffic: Traffic | None
        if traffic is not None:
            self.traffic = traffic(self.route, truck.footprint)
        elif record:
            self.traffic = self._recorder = make_recorder(config, self.route, truck.footprint)
        else:
            self.traffic = make_traffic(config, self.route, truck.footprint)
        try:
            self.reset()
        except BaseException:
            self.close()
            raise

    def reset(self) -> DriveFrame:
        """Returns to the start; the drive then repeats bit for bit."""
        config = self.config
        lane, station = config.start_lane, config.start_station
        offset = float(self.route.lane_offset(lane, station))
        limit = float(self.route.speed_limit(station, lane))
        speeds = (config.start_speed, config.speed, limit, self._safe_speed, self._flow_speed())
        self._truck_events.restore()
        ego = self.truck.reset(station=station, offset=offset, speed=min(speeds))
        self.mirror.bind(self.truck.model)
        self._tractor = self.truck.model.body("tractor").id
        self.driver.reset()
        self.path.reset()
        if self.perception is not None:
            self.perception.reset()
        if self.guard is not None:
            self.guard.reset()
        self.vehicles = VehicleFrame.empty()
        if self.traffic is not None:
            with task("starting the traffic", usual=0.5):
                self.vehicles = VehicleFrame.of(self.traffic.reset(ego))
            if (scenario := self.traffic.running_scenario()) is not None:
                self._truck_events.check(scenario)
        self._apply_events(ego)
        self._start()
        self._log: tuple[Observer, ...] = ()
        if self._recorder is not None:
            self._log = (DriveLog(self._recorder, self, self.truck, config),)
        self.observers = self._log
        self.collision = self.failed = False
        self._summary = SummaryBuilder(FlowMeter(self.route))
        self.impact: Impact | None = None
        self._fuel_start = ego.fuel_used
        self._distance, self._odometer_time, self._odometer_speed = 0.0, 0.0, ego.speed
        self._wall_start = time.perf_counter()
        self._move_bodies(new=True)
        self._plan(ego)
        self.frame = self._make_frame(ego)
        return self.frame

    def _apply_events(self, ego: EgoState) -> None:
        """Applies the events of the truck's world and parts."""
        scenario = None if self.traffic is None else self.traffic.running_scenario()
        if scenario is not None and len(scenario):
            self._truck_events.apply(scenario.truck_events, self.time, ego.yaw)

    @property
    def events(self) -> tuple[EventRecord, ...]:
        """The scripted events that have begun, in their order."""
        scenario = None if self.traffic is None else self.traffic.running_scenario()
        return () if scenario is None else tuple(scenario.records)

    def _flow_speed(self) -> float:
        """Mean speed of the traffic of a level of service [m/s]; infinite for other traffic."""
        steady = self.traffic.config.steady if isinstance(self.traffic, PureSim) else None
        return math.inf if steady is None else steady.speed

    @property
    def emergency(self) -> EmergencyReport | None:
        """What the emergency braking reports now; None without one."""
        return self.guard.report if isinstance(self.guard, EmergencyBraking) else None

    def _stage(self) -> tuple[str, bool, float] | None:
        report = self.emergency
        if report is None:
            return None
        return report.state.value, bool(report.target), report.time_to_collision

    @property
    def stack(self) -> Stack:
        """The stack that drives.

        Raises:
          InputError: the driver is not a stack.
        """
        if not isinstance(self.driver, Stack):
            raise InputError(f"the driver is a {type(self.driver).__name__}, not a Stack")
        return self.driver

    def cycle(self, observers: Sequence[Observer] = ()) -> DriveFrame:
        """Advances 100 ms and returns the frame at its end.

        Raises:
          DivergedError: the simulation diverged, or a number is not finite; the drive is over.
          TrafficError: SUMO failed.
        """
        self.observers = (*self._log, *observers)
        for _ in range(self._cycle_steps // self._control_steps):
            self._control_step()
        ego = self._observe()
        if self.traffic is not None:
            self.vehicles = VehicleFrame.of(self.traffic.step(ego))
            self._apply_events(ego)
        self._move_bodies(new=True)
        self._plan(ego)
        self.frame = self._make_frame(ego)
        self._summary.add(self._frame_of_all())
        self._check_end(ego)
        self._show()
        return self.frame

    def run(
        self,
        observers: Sequence[Observer] = (),
        progress: Callable[[DriveFrame], None] | None = None,
    ) -> DriveSummary:
        """Drives to the end of the time or of the route, a collision or a roll-over.

        Args:
          observers: called from the first instant and plan on; see `Observer`.
          progress: called every 100 ms.

        Raises:
          DivergedError: the simulation diverged; `summary` has the figures up to then.
        """
        for observer in observers:
            observer.planned(self.scene, self.trajectory)
        for observer in observers:
            observer.observe(self, self.frame)
        while not self.ended:
            frame = self.cycle(observers)
            if progress is not None:
                progress(frame)
        return self.summary()

    def summary(self, ended: str | None = None) -> DriveSummary:
        """Returns the figures so far.

        Args:
          ended: reason of a premature end.
        """
        warnings = {
            mujoco.mjtWarning(i).name.removeprefix("mjWARN_"): int(warning.number)
            for i, warning in enumerate(self.truck.data.warning)
            if warning.number
        }
        # Counted with MuJoCo's warnings: both tell that the physics was not what a truck does.
        warnings |= dict.fromkeys(self.truck.left_range, 1)
        return self._summary.build(
            self.frame,
            wall_time=time.perf_counter() - self._wall_start,
            ended=ended or self.ended or "still driving",
            collision=self.collision,
            failed=self.failed,
            impact_speed=None if self.impact is None else self.impact.speed,
            fuel=self.frame.ego.fuel_used - self._fuel_start,
            road_surface=surface_text(self.route),
            warnings=warnings,
            unsure_decisions=getattr(self.driver, "unsure_decisions", 0),
        )

    def save_recording(self, path: Path) -> Path:
        """Writes the traffic and the truck's drive to a file for `Recording.load`.

        Raises:
          InputError: the simulation does not record, or the file cannot be written.
        """
        if self._recorder is None:
            raise InputError("this simulation does not record: use Simulation(..., record=True)")
        return self._recorder.save(path)

    def close(self) -> None:
        """Ends SUMO."""
        if self.traffic is not None:
            self.traffic.close()

    def _scene(self, ego: EgoState) -> Scene:
        signals = read_signals(self.traffic, ego, self.route, self.truck.footprint)
        vehicles = self.vehicles
        if self.perception is not None:
            vehicles = self.perception.see(ego, vehicles)
        return Scene(ego.time, ego, vehicles, self.truck.footprint, signals)

    def _observe(self) -> EgoState:
        """Observes the truck and adds the distance since the last call, by the trapezoidal rule."""
        try:
            ego = self.truck.observe()
            check_finite(ego)
        except Error as error:
            raise self._diverged(str(error)) from error
        elapsed = self.time - self._odometer_time
        self._distance += 0.5 * (ego.speed + self._odometer_speed) * elapsed
        self._odometer_time, self._odometer_speed = self.time, ego.speed
        return ego

    def _diverged(self, reason: str) -> DivergedError:
        self.ended, self.failed = reason, True
        return DivergedError(reason)

    def _advance_physics(self, steps: int) -> None:
        """Advances the truck and calls the observers that are due in between."""
        if not self.observers:
            self._advance_bodies(steps)
            return
        periods = [round(observer.period / self.timestep) for observer in self.observers]
        end = self._steps + steps
        while self._steps < end:
            due = [period - self._steps % period for period in periods]
            self._advance_bodies(min([end - self._steps, *due]))
            # At the end of a cycle, `cycle` shows the new plan to the observers.
            if self._steps % self._cycle_steps:
                self._show()

    def _advance_bodies(self, steps: int) -> None:
        # While a contact is possible in this cycle, every step moves and checks the bodies.
        stride = 1 if self._watching and self.impact is None else steps
        for _ in range(0, steps, stride):
            if stride < steps:
                self._move_bodies()
            try:
                self.truck.step(stride)
            except Error as error:
                raise self._diverged(str(error)) from error
            if self._watching:
                self._note_contact()
            self._steps += stride

    def _show(self) -> None:
        """Calls the observers that are due."""
        due = [o for o in self.observers if self._steps % round(o.period / self.timestep) == 0]
        if not due:
            return
        frame = self.frame
        if frame.time != self.time:
            # `observe` updates the place on the route that the truck remembers. Observing a copy
            # leaves the bits of the drive independent of the observers.
            ego = copy.copy(self.truck).observe()
            frame = dataclasses.replace(
                frame, time=self.time, ego=ego, command=self.command, emergency=self.emergency
            )
            self._move_bodies()
        for observer in due:
            observer.observe(self, frame)

    def _move_bodies(self, *, new: bool = False) -> None:
        """Moves the traffic's bodies to their present places; `new` after a step of the traffic.

        They exert no force: between two steps of the traffic only pictures and contacts use them.
        """
        x, y, _ = self.truck.data.xpos[self._tractor].tolist()
        elapsed = self._steps % self._cycle_steps * self.timestep
        known = None
        if elapsed > 0.0 and self.traffic is not None:
            known = self.traffic.exact_vehicles(self.time)
        self.mirror.update(
            self.truck.data,
            self.vehicles if new else None,
            (x, y),
            elapsed,
            known,
        )
        if new:
            self._watching = self.mirror.may_touch(self.truck.data, CYCLE_PERIOD)
            self.truck.detects_contacts = self._watching or not self.mirror.finds_all

    def _make_frame(self, ego: EgoState) -> DriveFrame:
        route = self.route
        lane = int(route.lane_at(ego.station, ego.offset))
        point = route.evaluate(ego.station, ego.offset)
        neighbors = self.scene.neighbors
        if self.perception is not None:  # gaps to the vehicles as they are
            neighbors = Neighbors(ego, self.vehicles, self.truck.footprint)
        ahead, behind = neighbors.corridor_gaps(lane)
        return _drive_frame(
            self.time,
            ego,
            self.scene,
            self.trajectory,
            self.command,
            self.driver.last_decision,
            lane,
            int(route.lane_count(ego.station)),
            float(point.grade),
            float(point.curvature),
            float(route.speed_limit(ego.station, max(lane, 0))),
            self.driver.reference_speed(ego.station),
            ahead,
            behind,
            nearest_box_distance(ego, self.vehicles, self.truck.parameters),
            self._distance,
            self.driver.lane_changes,
            self.driver.refused,
            self.emergency,
            self.truck.read("steering_wheel_torque"),
        )

    def _frame_of_all(self) -> DriveFrame:
        """Returns the frame with the traffic as it is, for figures of the drive."""
        if self.perception is None:
            return self.frame
        scene = dataclasses.replace(self.frame.scene, vehicles=self.vehicles)
        return dataclasses.replace(self.frame, scene=scene)

    def _note_contact(self) -> None:
        """Stores the first contact."""
        if self.impact is None and (found := self.mirror.contacts(self.truck.data)):
            name, body = found[0]
            elapsed = self._steps % self._cycle_steps * self.timestep
            other = next(each for each in self.vehicles if each.id == name)
            speed = other.speed + other.acceleration * elapsed
            # Observing a copy leaves the bits of the drive as they are, see `_show`.
            ego = copy.copy(self.truck).observe()
            difference = cmath.rect(ego.speed, ego.yaw) - cmath.rect(speed, other.yaw)
            self.impact = Impact(self.time, name, body, abs(difference))

    def _check_end(self, ego: EgoState) -> None:
        if self._watching:
            # The contacts of the last step are those of the vehicles' former places.
            mujoco.mj_fwdPosition(self.truck.model, self.truck.data)
            self._note_contact()
        if self.impact is not None:
            hit = self.impact
            self.collision = self.failed = True
            self.ended = f"collision with {hit.vehicle} at the {hit.body} at t = {hit.time:.2f} s"
        elif (found := find_ending(ego, self.route, self.truck.footprint)) is not None:
            self.ended, self.failed = found
        elif any(isinstance(record.event, EndDrive) for record in self.events):
            self.ended = "reached the end of the scenario"
        elif self.time >= self.config.duration - 0.5 * self.timestep:
            self.ended = "reached the end of the time"
