"""A trip under way: its end, its schedule, and the road ahead on the grid that ends with it.

All plans on a free road share the grid, so that the short horizon's problem is a piece of the
schedule's. A lag behind the schedule raises the price of a second; a lasting one makes a new
schedule from here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from controllers.pcc.leader_constraint import FenceConfig, easing_speeds
from controllers.pcc.planner import PccConfig
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import Schedule, level_price, make_schedule
from controllers.pcc.vehicle import PointMass
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import SpeedProfile

LEAST_INTERVALS = 4
_EASE = 0.3  # [m/s2] at which a truck comes down to the traffic's speed
LEAST_SPEED = 1.0  # [m/s] that plans begin with when the truck stands


@dataclass(frozen=True)
class RecedingConfig:
    """Settings of the receding horizon.

    Attributes:
      horizon: [m]; step: of the grid [m].
      time_limit: a solve that takes longer is given up [s]; inf for none, as in simulations, where
        the computer's load must not change the drive.
      fence: what is kept to the vehicle ahead.
      power_share: of the engine's full power that plans count on. Gear changes and the steps of the
        gears take the rest: on a long 5 % climb the MuJoCo truck of 55 t brings 0.76 to 0.88 of it
        to the wheels. Plans that counted on more would be late at the top of every climb.
      surplus: asked for beyond the plan where that takes all the power it counts on [m/s].
      resync: a plan goes on from the last one's speed, at most so far from the truck's [m/s].
      slack: of the cruise's trip time, where no arrival is asked for [1].
      reserve: of the time left until a wanted arrival, kept for what traffic takes [1].
      replan_lag: a new schedule is made when the truck is so late or early [s].
      replan_flow: or when the traffic's speed has changed by so much [m/s].
      replan_period: but not sooner after the last one than this [s].
      replan_length: and only for trips of at most this length, for its cost [m].
    """

    horizon: float = 5_000.0
    step: float = 50.0
    time_limit: float = 0.5
    fence: FenceConfig = field(default_factory=FenceConfig)
    power_share: float = 0.8
    surplus: float = 1.0
    resync: float = 0.5
    slack: float = 0.0
    reserve: float = 0.005
    replan_lag: float = 3.0
    replan_flow: float = 1.0
    replan_period: float = 10.0
    replan_length: float = 50_000.0

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite or not above 0."""
        for name in (
            "horizon",
            "step",
            "resync",
            "replan_lag",
            "replan_flow",
            "replan_period",
            "replan_length",
        ):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")
        if math.isnan(self.time_limit) or self.time_limit <= 0.0:
            raise InputError(f"time_limit = {self.time_limit!r} is not allowed: use more than 0 s")
        if not 0.1 <= self.power_share <= 1.0:
            raise InputError(f"power_share = {self.power_share!r} is not allowed: use 0.1 to 1")
        if not 0.0 <= self.surplus <= 5.0:
            raise InputError(f"surplus = {self.surplus!r} m/s is not allowed: use 0 to 5")
        for name in ("slack", "reserve"):
            if not 0.0 <= getattr(self, name) <= 0.5:
                raise InputError(f"{name} = {getattr(self, name)!r} is not allowed: use 0 to 0.5")


@dataclass(frozen=True)
class Appointment:
    """Where a trip ends, and how.

    Attributes:
      station: [m].
      time: to be there [s]; None: when a cruise at v_ref would.
      speed: to be there with [m/s]; None: any, faster being worth the fuel that it saves later.
    """

    station: float
    time: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite."""
        for name in ("station", "time", "speed"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"appointment: {name} is {value!r}: must be finite")


@dataclass(frozen=True)
class Begin:
    """Where a plan begins: station [m], speed [m/s] and time [s] there."""

    station: float
    speed: float
    time: float


class Trip:
    """Where the truck goes, and by when.

    Attributes:
      vehicle: the point mass that is planned for; road: the whole road, of any grid.
      appointment: where the trip ends.
      schedule: of the trip, None when there is none; schedule_error: why; schedules: made so far.
      flow: greatest speed that the traffic allows on the whole [m/s].
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
        self.reset()

    def reset(self) -> None:
        """Forgets the trip so far."""
        self.schedule: Schedule | None = None
        self.schedule_error, self.schedules = "", 0
        self._scheduled_at, self._outdated = -math.inf, False
        self.flow = self._scheduled_flow = math.inf

    def limit_by(self, limits: Callable[[FloatArray], FloatArray]) -> None:
        """From now on the road has other limits: the schedule is made anew with the next plan."""
        self.limits = limits
        self._outdated, self._scheduled_at = True, -math.inf

    @property
    def end(self) -> float:
        """Station [m]."""
        return min(self.appointment.station, float(self.road.station[-1]))

    def next_node(
        self, station: float, speed: float, time: float, last: SpeedProfile | None
    ) -> Begin:
        """The next node of the grid that ends with the trip, and how the last plan gets there."""
        end, step = self.end, self.receding.step
        node = end - step * math.floor((end - station) / step + 1e-9)
        b = speed**2
        if last is not None and last.station[0] <= station <= last.station[-1]:
            passed = np.interp([station, node], last.station, last.speed**2)
            b = max(b + float(passed[1] - passed[0]), LEAST_SPEED**2)
        after = math.sqrt(b)
        return Begin(node, after, time + 2.0 * (node - station) / (speed + after))

    def keep_schedule(self, begin: Begin) -> None:
        """Makes the schedule from a node of the grid, and anew when the truck is far from it."""
        receding, schedule = self.receding, self.schedule
        left = self.end - begin.station
        recent = begin.time - self._scheduled_at < receding.replan_period
        if recent or left < 2 * LEAST_INTERVALS * receding.step:
            return
        if schedule is not None:
            near = schedule.covers(begin.station) and (
                abs(schedule.lag(begin.station, begin.time)) < receding.replan_lag
            )
            same = self.flow == self._scheduled_flow or (
                abs(self.flow - self._scheduled_flow) < receding.replan_flow
            )
            if (near and same and not self._outdated) or left > receding.replan_length:
                return
        self._scheduled_at, self._scheduled_flow = begin.time, self.flow
        self._outdated = False
        arrival = self.appointment.time
        if arrival is not None:
            arrival -= receding.reserve * max(arrival - begin.time, 0.0)
        try:
            self.schedule = make_schedule(
                self.vehicle,
                self.in_flow(self.grid(begin.station, round(left / receding.step)), begin.speed),
                self.config,
                begin.speed,
                begin.time,
                arrival,
                receding.slack,
                self.appointment.speed,
            )
            self.schedule_error = ""
            self.schedules += 1
        except PlanningError as error:
            self.schedule_error = str(error)

    def ahead_of(self, station: float) -> Schedule | None:
        """The schedule, where enough of it lies ahead of a station [m]; else None."""
        schedule = self.schedule
        near = LEAST_INTERVALS * self.receding.step
        if schedule is None or not schedule.covers(station) or station > schedule.end - near:
            return None
        return schedule

    def price(self, begin: Begin) -> tuple[float, float]:
        """Price of a second [kg/s] and the lag [s]; without a schedule v_ref's on the level."""
        schedule = self.ahead_of(begin.station)
        if schedule is None:
            return max(level_price(self.vehicle, self.config.v_ref), 0.0), math.nan
        price = schedule.price_at(self.vehicle, begin.station, begin.time)
        return price, schedule.lag(begin.station, begin.time)

    def grid(self, station: float, intervals: int) -> RoadProfile:
        """The road from a station [m] on the grid of plans; beyond its end it goes on level."""
        road, step = self.road, self.receding.step
        grid = station + step * np.arange(max(intervals, LEAST_INTERVALS) + 1, dtype=float)
        height = np.interp(grid, road.station, road.height)
        if self.limits is not None:
            return RoadProfile(grid, height, self.limits(grid), road.name)
        # Between two nodes of the road the lower limit holds.
        last = road.station.size - 1
        below = np.clip(np.searchsorted(road.station, grid + 1e-6, "right") - 1, 0, last)
        above = np.clip(np.searchsorted(road.station, grid - 1e-6), 0, last)
        limit = np.minimum(road.v_limit[below], road.v_limit[above])
        return RoadProfile(grid, height, limit, road.name)

    def in_flow(self, road: RoadProfile, speed: float) -> RoadProfile:
        """The road with the traffic's speed as a limit, which a faster truck comes down to."""
        return self._below(road, speed, self.flow)

    def _below(self, road: RoadProfile, speed: float, top: float) -> RoadProfile:
        if math.isinf(top):
            return road
        cap = easing_speeds(road, speed, max(top, LEAST_SPEED), _EASE)
        return replace(road, v_limit=np.minimum(road.v_limit, cap))

    def horizon(self, begin: Begin, sight: float, *, free: bool) -> RoadProfile:
        """The road of a plan over `sight` [m], at most to the end of the trip.

        Args:
          begin: of the plan.
          sight: how far it looks [m].
          free: whether nobody is ahead in the truck's lane.
        """
        schedule = self.ahead_of(begin.station)
        if schedule is not None:
            sight = min(sight, schedule.end - begin.station)
        road = self.grid(begin.station, math.floor(sight / self.receding.step + 1e-6))
        top = math.inf if schedule is None else schedule.top
        flow = max(self.flow, self._needed(begin)) if free else self.flow
        return self._below(road, begin.speed, min(flow, top))

    def _needed(self, begin: Begin) -> float:
        """Mean speed that the appointment still asks for [m/s]; 0 where none was made.

        Who is late through others may be faster than they are while none of them is in the way.
        """
        if self.appointment.time is None:
            return 0.0
        left = max(self.appointment.time - begin.time, 1e-3)
        return min(max(self.end - begin.station, 0.0) / left, self.config.v_max)
