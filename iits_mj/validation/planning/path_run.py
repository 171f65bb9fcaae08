"""Drives the MuJoCo truck with planner and tracker and records how it keeps its path."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from controllers.decision.base import DecisionMaker
from controllers.planning.planner import PlannerConfig
from controllers.planning.speed_plan import SpeedConfig
from controllers.stack import Stack
from controllers.tracking.controller import TrackingConfig
from iits_mj.core.arrays import FloatArray
from iits_mj.core.messages import EgoState, Scene, VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.truck import Truck
from iits_mj.validation.handling.side_wind import SideWind

PERIOD = 0.02
# A turn of the steering wheel back by more than this is a reversal: half the gear's play [rad].
REVERSAL = np.deg2rad(1.0)

Override = Callable[[EgoState, VehicleCommand], VehicleCommand]


@dataclass(frozen=True)
class PathRun:
    """Time histories, each of shape (n,), every 20 ms; SI.

    Attributes:
      time, station, speed; error: of the steer axle to the left of the planned path.
      wheel: actual angle of the steering wheel; articulation; articulation_rate.
      trailer: offset of the trailer's axle group from the lane's middle.
      spare: from the trailer's outer side at its axle group to the lane's line.
      wind: across the road.
      cost: median time of a call of the tracker [s].
      lane_changes: completed.
    """

    time: FloatArray
    station: FloatArray
    speed: FloatArray
    error: FloatArray
    wheel: FloatArray
    articulation: FloatArray
    articulation_rate: FloatArray
    trailer: FloatArray
    spare: FloatArray
    wind: FloatArray
    cost: float = 0.0
    lane_changes: int = 0

    def after(self, start: float) -> PathRun:
        """The run from a time [s] on."""
        keep = self.time >= self.time[0] + start
        return replace(self, **{name: getattr(self, name)[keep] for name in COLUMNS})

    @property
    def distance(self) -> float:
        """[m]."""
        return float(self.station[-1] - self.station[0])

    def rms(self) -> float:
        """Of the lateral error [m]."""
        return float(np.sqrt(np.mean(self.error**2)))

    def peak(self) -> float:
        """Of the lateral error [m]."""
        return float(np.max(np.abs(self.error)))

    def reversals(self) -> float:
        """Reversals of the steering wheel by more than `REVERSAL`, a kilometre [1/km]."""
        return count_reversals(self.wheel, float(REVERSAL)) / (self.distance / 1e3)

    def wheel_rate(self) -> float:
        """Root mean square of the steering wheel's rate [rad/s]."""
        return float(np.sqrt(np.mean((np.diff(self.wheel) / PERIOD) ** 2)))

    def wheel_rate_max(self) -> float:
        """Greatest rate of the steering wheel [rad/s]."""
        return float(np.max(np.abs(np.diff(self.wheel)))) / PERIOD


COLUMNS = tuple(PathRun.__dataclass_fields__)[:-2]


def count_reversals(angle: FloatArray, threshold: float) -> int:
    """How often an angle, (n,), turns back by more than a threshold."""
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


def drive_path(
    truck: Truck,
    *,
    cruise: float,
    duration: float,
    station: float,
    speed: float,
    wind: SideWind | None = None,
    maker: DecisionMaker | None = None,
    lanes: tuple[int, ...] = (0, 1),
    tracking: TrackingConfig | None = None,
    reported: Callable[[EgoState], EgoState] = lambda ego: ego,
    override: Override = lambda _, command: command,
    disturb: Callable[[Truck, float], None] = lambda _, __: None,
    end: float | None = None,
) -> PathRun:
    """Puts the truck on the right lane of its route and drives it without traffic.

    The controllers know the shipped truck, whatever the truck's own parameters are.

    Args:
      truck: on its route.
      cruise: speed to keep where the road allows it [m/s].
      duration: at most [s].
      station: at the start [m].
      speed: at the start [m/s].
      wind: across the road.
      maker: decides on lane changes; default: none.
      lanes: open to it.
      tracking: settings; default: the shipped ones.
      reported: what the controllers are told of the state, to test errors in it.
      override: changes the command, to test braking.
      disturb: called before each step of 20 ms with the time since the start [s].
      end: station at which to stop the run [m].
    """
    route, parameters = truck.route, truck.parameters
    truck.reset(station=station, offset=float(route.lane_offset(0, station)), speed=speed)
    config = PlannerConfig(lanes=lanes, speed=SpeedConfig(cruise_speed=cruise))
    stack = Stack(route, maker, config, tracking, TruckParameters.load())
    hitch, axles = parameters.fifth_wheel.position, parameters.semitrailer.axles
    behind = hitch + float(np.mean([axle.position for axle in axles]))
    rows: list[tuple[float, ...]] = []
    costs: list[float] = []
    start = truck.time
    for tick in range(round(duration / PERIOD)):
        state = truck.observe()
        side = 0.0 if wind is None else wind.at(state.station)
        heading = float(route.evaluate(state.station).heading)
        truck.model.opt.wind[:2] = -np.sin(heading) * side, np.cos(heading) * side
        ego = reported(state)
        if tick % 5 == 0:
            stack.plan(Scene(ego.time, ego))
        called = time.perf_counter()
        command = override(state, stack.control(ego))
        costs.append(time.perf_counter() - called)
        truck.command(command)
        disturb(truck, truck.time - start)
        truck.step(round(PERIOD / truck.model.opt.timestep))
        place = state.station - behind
        lane = route.lane_at(place, state.trailer_offset)
        lane = min(max(lane, 0), route.lane_count(place) - 1)
        middle = float(route.lane_offset(lane, place))
        room = 0.5 * (float(route.lane_width(lane, place)) - parameters.semitrailer.width)
        aside = state.trailer_offset - middle
        rows.append(
            (
                state.time,
                state.station,
                state.speed,
                stack.tracker.lateral.error,
                state.steering_wheel_angle,
                state.articulation,
                state.articulation_rate,
                aside,
                room - abs(aside),
                side,
            )
        )
        if end is not None and state.station > end:
            break
    truck.model.opt.wind[:2] = 0.0
    columns = dict(zip(COLUMNS, np.array(rows).T, strict=True))
    return PathRun(**columns, cost=float(np.median(costs)), lane_changes=stack.lane_changes)
