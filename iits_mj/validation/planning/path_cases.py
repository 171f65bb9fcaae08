"""Manoeuvres that disturb a truck on its path: wind, bends, turns, braking, pushes, wrong models.

Planner and tracker drive the MuJoCo truck without traffic.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from controllers.decision.base import DecisionContext
from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.protocols import DecisionMaker
from controllers.stack import Stack
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import Decision, EgoState, Scene, VehicleCommand, XbrMode
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap, Route
from iits_mj.road.design import Design, build
from iits_mj.truck import Truck
from iits_mj.validation.planning.closed_loop import Record, Recorder, run_recorded
from iits_mj.validation.planning.side_wind import SideWind

# More than any surface allows, so that ABS works [m/s2].
FULL_BRAKING = -8.0
# A turn of the steering wheel back by more than this is a reversal: half the gear's play [rad].
REVERSAL = np.deg2rad(1.0)
# Standard deviation of the measured state, white at 50 Hz, as after the sensors' own filters: 6 mm,
# 0.015 deg, 1 cm/s, 0.03 deg/s, 0.03 deg at the hitch and 0.006 deg at the road wheels.
NOISE = {
    "x": 0.006,
    "y": 0.006,
    "yaw": 2.6e-4,
    "lateral_speed": 0.01,
    "yaw_rate": 5.2e-4,
    "trailer_yaw_rate": 5.2e-4,
    "articulation": 5.2e-4,
    "road_wheel_angle": 1.0e-4,
}
# Figures of a run, SI. error: of the steer axle, positive to the left of the planned path; wheel:
# actual angle of the steering wheel; trailer: offset of the trailer's axle group from the lane's
# middle; spare: from the trailer's outer side at its axle group to the lane's line; wind: across
# the road; cost: time of one call of the tracker; lane_changes: completed so far.
COLUMNS = (
    "time",
    "station",
    "speed",
    "error",
    "wheel",
    "articulation",
    "articulation_rate",
    "trailer",
    "spare",
    "wind",
    "cost",
    "lane_changes",
)
_STRAIGHT_BEFORE, _STRAIGHT_AFTER = 60.0, 500.0

Override = Callable[[EgoState, VehicleCommand], VehicleCommand]


def rms_error(run: Record) -> float:
    """Returns the root mean square of the lateral error [m]."""
    return float(np.sqrt(np.mean(run["error"] ** 2)))


def peak_error(run: Record) -> float:
    """Returns the greatest lateral error [m]."""
    return float(np.max(np.abs(run["error"])))


def wheel_reversals(run: Record) -> float:
    """Returns the reversals of the steering wheel by more than `REVERSAL` [1/km]."""
    return count_reversals(run["wheel"], float(REVERSAL)) / (run.length / 1e3)


def wheel_rates(run: Record) -> FloatArray:
    """Returns the magnitudes of the steering wheel's rate [rad/s]."""
    return np.asarray(np.abs(np.diff(run["wheel"])) / CONTROL_PERIOD)


def count_reversals(angle: FloatArray, threshold: float) -> int:
    """Returns how often an angle, shape (n,), turns back by more than a threshold."""
    count, direction = 0, 0
    low = high = float(angle[0])
    for value in angle.tolist():
        low, high = min(low, value), max(high, value)
        if direction >= 0 and high - value > threshold:
            count += direction > 0
            direction, low = -1, value
        elif direction <= 0 and value - low > threshold:
            count += direction < 0
            direction, high = 1, value
        elif direction > 0:
            low = value
        elif direction < 0:
            high = value
    return count


def settling_time(run: Record, since: float, share: float) -> float:
    """Returns how long after `since` the articulation rate stays below a share of its peak [s]."""
    rate = np.abs(run["articulation_rate"][run["time"] >= since])
    beyond = np.flatnonzero(rate > share * rate.max())
    return float((beyond[-1] + 1) * CONTROL_PERIOD)


class _TimedStack(Stack):
    """A stack that measures the time of the last call of its tracker, `cost` [s]."""

    cost = 0.0

    def control(self, ego: EgoState) -> VehicleCommand:
        begun = time.perf_counter()
        command = super().control(ego)
        self.cost = time.perf_counter() - begun
        return command


class _DisturbedTruck:
    """A truck in wind and under other disturbances, seen through its sensors.

    Args:
      truck: at the start of its run.
      wind: across the road.
      reported: gives the state that the driver gets for a true state.
      override: gives the command that the truck obeys, for its true state and the driver's command.
      disturb: called before each 20 ms of physics with the time since the start [s].

    Attributes:
      state: the true state; side: wind across the road [m/s], both at the last observation.
    """

    def __init__(
        self,
        truck: Truck,
        wind: SideWind | None,
        reported: Callable[[EgoState], EgoState],
        override: Override,
        disturb: Callable[[Truck, float], None],
    ) -> None:
        self._truck, self._wind = truck, wind
        self._reported, self._override, self._disturb = reported, override, disturb
        self._start = truck.time
        self.state, self.side = EgoState(), 0.0

    def observe(self) -> EgoState:
        state = self.state = self._truck.observe()
        self.side = 0.0 if self._wind is None else self._wind.at(state.station)
        heading = float(self._truck.route.evaluate(state.station).heading)
        self._truck.model.opt.wind[:2] = -np.sin(heading) * self.side, np.cos(heading) * self.side
        return self._reported(state)

    def command(self, command: VehicleCommand) -> None:
        self._truck.command(self._override(self.state, command))

    def step(self, n: int) -> None:
        self._disturb(self._truck, self._truck.time - self._start)
        self._truck.step(n)


def drive_path(
    route: Route,
    payload: float,
    timestep: float,
    *,
    cruise: float,
    duration: float,
    speed: float | None = None,
    station: float = 50.0,
    parameters: dict[str, Any] | None = None,
    wind: SideWind | None = None,
    maker: DecisionMaker | None = None,
    reported: Callable[[EgoState], EgoState] = lambda ego: ego,
    override: Override = lambda _, command: command,
    disturb: Callable[[Truck, float], None] = lambda _, __: None,
    end: float = math.inf,
) -> Record:
    """Drives the truck on the right lane of a route without traffic; records `COLUMNS`.

    Args:
      route: the road.
      payload: [kg].
      timestep: of the physics [s].
      cruise: speed to keep where the road allows it [m/s].
      duration: at most [s].
      speed: at the start [m/s]; default: `cruise`.
      station: at the start [m].
      parameters: overlay of the truck's, unknown to the controllers.
      wind: across the road.
      maker: decides on lane changes; default: none.
      reported: gives the state that the controllers get, to test errors in it.
      override: changes the command, to test braking.
      disturb: called before each 20 ms of physics with the time since the start [s].
      end: station at which to stop the run [m].
    """
    truck = Truck.load(
        payload, route=route, parameters=parameters, timestep=timestep, visuals=False
    )
    start = cruise if speed is None else speed
    truck.reset(station=station, offset=float(route.lane_offset(0, station)), speed=start)
    config = PlannerConfig(lanes=(0, 1), speed=SpeedConfig(cruise_speed=cruise))
    stack = _TimedStack(route, maker, config, None, TruckParameters.load())
    disturbed = _DisturbedTruck(truck, wind, reported, override, disturb)
    trailer, hitch = truck.parameters.units[1], truck.parameters.couplings[0].position
    behind = hitch + float(np.mean([axle.position for axle in trailer.axles]))

    def row(_: EgoState, __: VehicleCommand) -> tuple[float, ...]:
        state = disturbed.state
        place = state.station - behind
        lane = route.lane_at(place, state.trailer_offset)
        lane = min(max(lane, 0), route.lane_count(place) - 1)
        middle = float(route.lane_offset(lane, place))
        room = 0.5 * (float(route.lane_width(lane, place)) - trailer.width)
        aside = state.trailer_offset - middle
        return (
            state.time,
            state.station,
            state.speed,
            stack.tracker.lateral.error,
            state.steering_wheel_angle,
            state.articulation,
            state.articulation_rate,
            aside,
            room - abs(aside),
            disturbed.side,
            stack.cost,
            stack.lane_changes,
        )

    record, _ = run_recorded(
        disturbed,
        stack,
        Recorder(COLUMNS, row),
        lambda ego: Scene(ego.time, ego),
        timestep=timestep,
        duration=duration,
        until=lambda _: disturbed.state.station > end,
    )
    return record


def turn_road(
    radius: float, angle: float, clothoid: float, cross_slope: float = 0.0, lane_width: float = 4.0
) -> Route:
    """Returns a level one-lane road with one bend between two straights.

    Args:
      radius: positive to the left [m].
      angle: change of the heading [rad], more than that of the clothoids.
      clothoid: length of each [m].
      cross_slope: of the arc, falling to its inner side [rad].
      lane_width: [m].
    """
    bend = 1.0 / radius
    roll = -math.copysign(cross_slope, radius)
    arc = (angle - clothoid * abs(bend)) * abs(radius)
    alignment = (
        (_STRAIGHT_BEFORE, 0.0, 0.0, 0.0, 0.0),
        (clothoid, 0.0, bend, 0.0, roll),
        (arc, bend, bend, roll, roll),
        (clothoid, bend, 0.0, roll, 0.0),
        (_STRAIGHT_AFTER, 0.0, 0.0, 0.0, 0.0),
    )
    design = Design(
        name="bend",
        lane_width=lane_width,
        lanes=1,
        left_shoulder=2.0,
        right_shoulder=2.0,
        speed_limit=90.0 * KMH,
        alignment=alignment,
    )
    return RoadMap(build(design), f"bend of {radius:g} m").route()


@dataclass
class _ChangeOnce:
    """Asks for the left lane within half a second of a time [s]."""

    at: float
    name: str = "once"

    def reset(self) -> None:
        """Has no state to reset."""

    def decide(self, context: DecisionContext) -> Decision:
        asked = self.at - 0.5 <= context.scene.time < self.at + 0.5
        return Decision.LEFT if asked else Decision.KEEP


def highway(
    payload: float, timestep: float, wind: SideWind | None, start: float, end: float
) -> Record:
    """Drives the built-in highway between two stations at its speeds, 60 to 80 km/h."""
    route = RoadMap.builtin().route()
    speed = min(80.0 * KMH, route.speed_limit(start))
    run = drive_path(
        route,
        payload,
        timestep,
        cruise=80.0 * KMH,
        duration=2.0 * (end - start) / speed,
        station=start,
        speed=speed,
        wind=wind,
        end=end,
    )
    # The truck starts with its wheel straight and without an estimate of the wind.
    return run.after(4.0)


def fast_bends(payload: float, timestep: float, wind: SideWind) -> Record:
    """Drives a bend of 500 m at 90 km/h, with cross-slope and gusts."""
    route, speed = turn_road(500.0, 1.0, 150.0, cross_slope=0.04), 90.0 * KMH
    return drive_path(
        route,
        payload,
        timestep,
        cruise=speed,
        duration=60.0,
        station=25.0,
        wind=wind,
        end=route.length - 400.0,
    )


def pull_away(payload: float, timestep: float, wind: SideWind) -> Record:
    """Drives from standstill towards 90 km/h on a straight road in wind, for a minute."""
    route = Route.straight(5000.0)
    return drive_path(
        route, payload, timestep, cruise=90.0 * KMH, duration=60.0, speed=0.0, wind=wind
    )


def junction(payload: float, timestep: float, radius: float, speed: float) -> Record:
    """Drives from standstill through a right angle of a small radius."""
    route = turn_road(radius, 0.5 * np.pi, 8.0, lane_width=6.0)
    end = route.length - _STRAIGHT_AFTER + 40.0
    return drive_path(
        route, payload, timestep, cruise=speed, duration=200.0, station=25.0, speed=0.0, end=end
    )


def lane_change(payload: float, timestep: float, speed: float) -> Record:
    """Changes once to the left on a straight road."""
    route, maker = Route.straight(2000.0), _ChangeOnce(2.0)
    return drive_path(route, payload, timestep, cruise=speed, duration=16.0, maker=maker)


def brake_in_bend(payload: float, timestep: float, friction: float, speed: float) -> Record:
    """Brakes fully to standstill in the middle of a bend of 400 m."""
    return drive_path(
        turn_road(400.0, 1.2, 120.0).with_friction(friction, friction),
        payload,
        timestep,
        cruise=speed,
        duration=40.0,
        station=120.0,
        override=_full_braking(after=5.0),
    )


def split_braking(
    payload: float, timestep: float, high: float, low: float, after: float = 3.0
) -> Record:
    """Brakes fully from 50 km/h with friction `high` left and `low` right (ISO 16234).

    Payload [kg], time step [s]; the brakes act from `after` on [s].
    """
    route, speed = Route.straight(2000.0).with_friction(high, low), 50.0 * KMH
    braking = _full_braking(after)
    return drive_path(route, payload, timestep, cruise=speed, duration=30.0, override=braking)


def _full_braking(after: float) -> Override:
    """Returns an override that brakes fully from a time [s] on."""

    def override(state: EgoState, command: VehicleCommand) -> VehicleCommand:
        if state.time < after:
            return command
        return replace(
            command, accelerator_pedal=0.0, xbr_demand=FULL_BRAKING, xbr_mode=XbrMode.MAXIMUM
        )

    return override


def side_impulse(
    payload: float, timestep: float, speed: float, force: float, *, steered: bool
) -> Record:
    """Pushes the trailer's centre of gravity to the left for half a second, from 5 s on.

    The controller steers if `steered`; else the steering wheel is held straight from the push on.
    Payload [kg], time step [s], speed [m/s], force [N].
    """

    def push(truck: Truck, time: float) -> None:
        truck.data.body("trailer").xfrc_applied[1] = force if 5.0 <= time < 5.5 else 0.0

    def hold(state: EgoState, command: VehicleCommand) -> VehicleCommand:
        free = steered or state.time < 5.0
        return command if free else replace(command, steering_wheel_angle=0.0)

    return drive_path(
        Route.straight(5000.0),
        payload,
        timestep,
        cruise=speed,
        duration=17.0,
        override=hold,
        disturb=push,
    )


def measured(ego: EgoState, noise: float, generator: np.random.Generator) -> EgoState:
    """Returns a state with white noise at 50 Hz, `noise` times that of `NOISE`."""
    errors = noise * generator.normal(size=len(NOISE)) * np.array(list(NOISE.values()))
    pairs = zip(NOISE, errors.tolist(), strict=True)
    return replace(ego, **{name: getattr(ego, name) + error for name, error in pairs})


def wrong_model(
    timestep: float,
    wind: SideWind | None,
    *,
    stiffness: float = 1.0,
    mass: float = 1.0,
    dead_band: float = 1.0,
    noise: float = 0.0,
) -> Record:
    """Drives 30 s of the highway laden; the truck differs from the model of its controller.

    Args:
      timestep: [s].
      wind: across the road.
      stiffness: cornering stiffness of all tires over the model's.
      mass: reported mass over the truck's.
      dead_band: of the steering over the model's.
      noise: of the measured state, over `NOISE`.
    """
    plain, generator = TruckParameters.load(), np.random.default_rng(0)
    overlay = {
        "tires": {
            name: {"cornering_coefficient": stiffness * tire.cornering_coefficient}
            for name, tire in plain.tires.items()
        },
        "steering": {"dead_band": dead_band * plain.steering.dead_band},
    }
    run = drive_path(
        RoadMap.builtin().route(),
        plain.payload_max,
        timestep,
        cruise=80.0 * KMH,
        duration=34.0,
        station=5200.0,
        parameters=overlay,
        wind=wind,
        reported=lambda ego: measured(replace(ego, mass=mass * ego.mass), noise, generator),
    )
    return run.after(4.0)
