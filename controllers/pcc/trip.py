"""The state of a trip for the receding horizon: destination, schedule, and the road ahead.

All plans on a free road share the grid that ends at the destination, so that the short horizon's
problem is a part of the schedule's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from controllers.pcc.leader_constraint import LeaderConfig, easing_speeds
from controllers.pcc.planner import PccConfig
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import Schedule, level_price, make_schedule
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range, require_positive
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import SpeedProfile

LEAST_INTERVALS = 4
_BEFORE, _AFTER = 4, LEAST_INTERVALS  # intervals of the grid before the road and beyond its end
_EASE = 0.3  # [m/s2] deceleration to the traffic's speed
LEAST_SPEED = 1.0  # [m/s] at which the plans of a stopped truck begin


@dataclass(frozen=True)
class RecedingConfig:
    """Settings of the receding horizon.

    Attributes:
      horizon: [m]; step: of the grid [m].
      time_limit: of a solve [s]; inf for none, as in simulations, where the computer's load must
        not change the drive.
      leader: gaps to the vehicle ahead.
      power_share: share of the engine's full power that plans use. Gear changes and the steps of
        the gears cost the rest: on a long 5 % climb the MuJoCo truck of 55 t transmits 0.76 to 0.88
        of it to the wheels. Plans with more would be late at the top of every climb.
      surplus: added to the plan's speed where the plan uses all of that power [m/s].
      resync: greatest difference between a plan's first speed and the truck's speed [m/s].
      slack: of the cruise's trip time, without a wanted arrival [1].
      reserve: share of the time left until a wanted arrival, reserved for delays by traffic [1].
      replan_lag: lag or lead that makes a new schedule [s].
      replan_flow: change of the traffic's speed that makes a new schedule [m/s].
      replan_period: least time between two schedules [s].
      gears: whether plans on a free road choose gears and roll in neutral, see
        `controllers.pcc.joint`; only neutral reaches the truck.
      replan_length: greatest length of a trip that gets a new schedule; longer ones take too much
        computing time [m].
    """

    horizon: float = 5_000.0
    step: float = 50.0
    time_limit: float = 0.5
    leader: LeaderConfig = field(default_factory=LeaderConfig)
    power_share: float = 0.8
    surplus: float = 1.0
    resync: float = 0.5
    slack: float = 0.0
    reserve: float = 0.005
    replan_lag: float = 3.0
    replan_flow: float = 1.0
    replan_period: float = 10.0
    replan_length: float = 50_000.0
    gears: bool = False

    def __post_init__(self) -> None:
        require_positive(self, "horizon", "step", "resync", "replan_lag", "replan_flow")
        require_positive(self, "replan_period", "replan_length")
        if math.isnan(self.time_limit) or self.time_limit <= 0.0:
            raise InputError(f"time_limit = {self.time_limit!r} is not allowed: use more than 0 s")
        in_range("power_share", self.power_share, 0.1, 1.0)
        in_range("surplus", self.surplus, 0.0, 5.0)
        in_range("slack", self.slack, 0.0, 0.5)
        in_range("reserve", self.reserve, 0.0, 0.5)


@dataclass(frozen=True)
class Appointment:
    """End of a trip.

    Attributes:
      station: [m].
      time: wanted, of arrival [s]; None: that of a cruise at v_ref.
      speed: wanted, at the end [m/s]; None: free, with the worth of the fuel that it saves later.
    """

    station: float
    time: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        for name in ("station", "time", "speed"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"appointment: {name} is {value!r}: must be finite")


@dataclass(frozen=True)
class PlanStart:
    """Station [m] at which a plan starts, with speed [m/s] and time [s] there."""

    station: float
    speed: float
    time: float


class PccTrip:
    """A trip of the receding-horizon planner.

    Attributes:
      vehicle: the point mass of the plans; road: the whole road, on any grid.
      appointment: the end.
      schedule: of the trip or None; schedule_error: why there is none; schedules: number so far.
      flow: greatest mean speed that the traffic allows [m/s].
      limits: greatest speeds at stations, in place of the road's; see `limit_by`.
    """

    def __init__(
        self,
        vehicle: PointMass,
        road: RoadProfile,
        config: PccConfig,
        receding: RecedingConfig,
        appointment: Appointment,
    ) -> None:
        self.vehicle, self.road, self.config = vehicle, road, config
        self.receding, self.appointment = receding, appointment
        self.limits: Callable[[FloatArray], FloatArray] | None = None
        self._whole: RoadProfile | None = None
        self.reset()

    def reset(self) -> None:
        """Clears the trip so far."""
        self.schedule: Schedule | None = None
        self.schedule_error, self.schedules = "", 0
        self._scheduled_at, self._outdated = -math.inf, False
        self.flow = self._scheduled_flow = math.inf

    def limit_by(self, limits: Callable[[FloatArray], FloatArray]) -> None:
        """Sets other speed limits; the next plan makes a new schedule."""
        self.limits, self._whole = limits, None
        self._outdated, self._scheduled_at = True, -math.inf

    @property
    def end(self) -> float:
        """Station of the destination [m]."""
        return min(self.appointment.station, float(self.road.station[-1]))

    def next_node(
        self, station: float, speed: float, time: float, last: SpeedProfile | None
    ) -> PlanStart:
        """Returns the grid's next node, with the speed and time of the last plan there."""
        end, step = self.end, self.receding.step
        node = end - step * math.floor((end - station) / step + 1e-9)
        b = speed**2
        if last is not None and last.station[0] <= station <= last.station[-1]:
            passed = np.interp([station, node], last.station, last.speed**2)
            b = max(b + float(passed[1] - passed[0]), LEAST_SPEED**2)
        after = math.sqrt(b)
        return PlanStart(node, after, time + 2.0 * (node - station) / (speed + after))

    def keep_schedule(self, start: PlanStart) -> None:
        """Makes a schedule from a node of the grid if there is none or the truck is far off it."""
        receding, schedule = self.receding, self.schedule
        left = self.end - start.station
        recent = start.time - self._scheduled_at < receding.replan_period
        if recent or left < 2 * LEAST_INTERVALS * receding.step:
            return
        if schedule is not None:
            near = schedule.covers(start.station) and (
                abs(schedule.lag(start.station, start.time)) < receding.replan_lag
            )
            same = self.flow == self._scheduled_flow or (
                abs(self.flow - self._scheduled_flow) < receding.replan_flow
            )
            if (near and same and not self._outdated) or left > receding.replan_length:
                return
        self._scheduled_at, self._scheduled_flow = start.time, self.flow
        self._outdated = False
        arrival = self.appointment.time
        if arrival is not None:
            arrival -= receding.reserve * max(arrival - start.time, 0.0)
        road = self.grid(start.station, round(left / receding.step))
        try:
            self.schedule = make_schedule(
                self.vehicle,
                self._below(road, start.speed, self.flow),
                self.config,
                start.speed,
                start.time,
                arrival,
                receding.slack,
                self.appointment.speed,
            )
            self.schedule_error = ""
            self.schedules += 1
        except PlanningError as error:
            self.schedule_error = str(error)

    def ahead_of(self, station: float) -> Schedule | None:
        """Returns the schedule if enough of it lies ahead of a station [m], else None."""
        schedule = self.schedule
        near = LEAST_INTERVALS * self.receding.step
        if schedule is None or not schedule.covers(station) or station > schedule.end - near:
            return None
        return schedule

    def price(self, start: PlanStart) -> tuple[float, float]:
        """Returns price of a second [kg/s] and lag [s]; without schedule those of v_ref, NaN."""
        schedule = self.ahead_of(start.station)
        if schedule is None:
            return max(level_price(self.vehicle, self.config.v_ref), 0.0), math.nan
        price = schedule.price_at(self.vehicle, start.station, start.time)
        return price, schedule.lag(start.station, start.time)

    def grid(self, station: float, intervals: int) -> RoadProfile:
        """Returns the road from a station [m] in the steps of plans, level beyond its end."""
        intervals, step = max(intervals, LEAST_INTERVALS), self.receding.step
        if self._whole is None:
            length = max(self.end - float(self.road.station[0]), 0.0)
            before = math.ceil(length / step) + _BEFORE
            self._whole = self._sampled(self.end - step * np.arange(before, -_AFTER - 1, -1.0))
        whole = self._whole
        first = round((station - float(whole.station[0])) / step)
        on_grid = 0 <= first <= whole.intervals - intervals and station == whole.station[first]
        if on_grid:
            return whole.part(first, intervals)
        return self._sampled(station + step * np.arange(intervals + 1.0))

    def _sampled(self, grid: FloatArray) -> RoadProfile:
        """Returns the road at the stations of a grid, shape (n + 1,) [m]."""
        road = self.road
        height = np.interp(grid, road.station, road.height)
        if self.limits is not None:
            return road.resampled(grid, height, self.limits(grid))
        # Between two nodes of the road the lower limit applies.
        last = road.station.size - 1
        below = np.clip(np.searchsorted(road.station, grid + 1e-6, "right") - 1, 0, last)
        above = np.clip(np.searchsorted(road.station, grid - 1e-6), 0, last)
        limit = np.minimum(road.v_limit[below], road.v_limit[above])
        return road.resampled(grid, height, limit)

    def _below(self, road: RoadProfile, speed: float, top: float) -> RoadProfile:
        """Returns the road with a top speed as limit, to which a faster truck slows down."""
        if math.isinf(top):
            return road
        cap = easing_speeds(road, speed, max(top, LEAST_SPEED), _EASE)
        return road.below(cap)

    def horizon(self, start: PlanStart, sight: float, *, free: bool) -> RoadProfile:
        """Returns the road of a plan of length `sight` [m], at most to the end of the trip.

        `free` means that no vehicle is ahead in the truck's lane.
        """
        schedule = self.ahead_of(start.station)
        if schedule is not None:
            sight = min(sight, schedule.end - start.station)
        road = self.grid(start.station, math.floor(sight / self.receding.step + 1e-6))
        top = math.inf if schedule is None else schedule.top
        flow = max(self.flow, self._needed(start)) if free else self.flow
        return self._below(road, start.speed, min(flow, top))

    def _needed(self, start: PlanStart) -> float:
        """Returns the mean speed needed for the wanted arrival [m/s]; 0 without one.

        A truck delayed by traffic may be faster than the traffic while no vehicle is in its way.
        """
        if self.appointment.time is None:
            return 0.0
        left = max(self.appointment.time - start.time, 1e-3)
        return min(max(self.end - start.station, 0.0) / left, self.config.v_max)
