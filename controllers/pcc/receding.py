"""On line: the speed over the next 5 km, planned again and again, a vehicle ahead as fence.

Over a short horizon the trip time is not a constraint but has a price, which pulls the mean speed
to v_ref, and the speed at its end is worth the fuel that gave it. The plan of the last call is the
guess of the next one. When a solve fails or comes too late the last plan is kept while it holds,
and otherwise a plain cruise at v_ref within all limits, which needs no optimizer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import PccConfig, lower_speeds, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.solver import Solver, Task
from controllers.pcc.vehicle import cruise, durations, full_power_speed
from iits_mj.errors import InputError, PlanningError
from iits_mj.messages import SpeedProfile
from iits_mj.parameters import TruckParameters

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class RecedingConfig:
    """Settings of the receding horizon.

    Attributes:
      horizon: [m]; step: of the grid [m].
      time_limit: a solve that takes longer is given up [s].
      time_gap: kept to the vehicle ahead [s]; standstill_gap: further distance to it [m].
      fence_time: the vehicle ahead is predicted to keep its speed for so long [s].
      feedback: how strongly a lag behind v_ref raises the price of time, per second of lag.
    """

    horizon: float = 5_000.0
    step: float = 50.0
    time_limit: float = 0.5
    time_gap: float = 1.8
    standstill_gap: float = 10.0
    fence_time: float = 60.0
    feedback: float = 0.02

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite or not above 0."""
        for name in ("horizon", "step", "time_limit", "time_gap", "standstill_gap", "fence_time"):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{name} = {value!r} is not allowed: use a number above 0")


@dataclass(frozen=True)
class Leader:
    """The vehicle ahead: station of its rear bumper [m] and speed [m/s]."""

    rear: float
    speed: float


@dataclass(frozen=True)
class HorizonPlan:
    """Outcome of one call.

    Attributes:
      profile: speed over station.
      status: "optimal", "kept" (the last plan) or "cruise"; reason: why not optimal, in words.
      solve_time: wall time of the solver [s].
    """

    profile: SpeedProfile
    status: str
    reason: str
    solve_time: float


class RecedingPlanner:
    """Speed planner for a drive along one road; call `plan` every second or as it suits."""

    def __init__(
        self,
        road: RoadProfile,
        parameters: TruckParameters | None = None,
        mass: float = 55_000.0,
        config: PccConfig | None = None,
        receding: RecedingConfig | None = None,
    ) -> None:
        self.config, self.receding = config or PccConfig(), receding or RecedingConfig()
        parameters = parameters or TruckParameters.load()
        self.vehicle = make_vehicle(parameters, FuelMap(parameters), mass, self.config)
        self._heights = road
        intervals = math.floor(min(self.receding.horizon, road.length) / self.receding.step + 1e-9)
        self.intervals = max(intervals, 4)
        self._solver = Solver(
            self.vehicle,
            self.intervals,
            self.receding.step,
            fenced=True,
            time_limit=self.receding.time_limit,
        )
        self._last: SpeedProfile | None = None
        self._begun: tuple[float, float] | None = None

    def reset(self) -> None:
        """Forgets the last plan and the trip so far."""
        self._last, self._begun = None, None

    def plan(
        self, station: float, speed: float, time: float, leader: Leader | None = None
    ) -> HorizonPlan:
        """Speed over the horizon from a station [m] at a speed [m/s] and time [s].

        Args:
          station: of the truck's front bumper; the plan is to be followed by it.
          speed: now.
          time: now, for the lag behind v_ref since the first call.
          leader: vehicle ahead in the lane, if any.

        Raises:
          InputError: a number is not finite.
          PlanningError: full power does not carry the truck over the horizon.
        """
        for name, value in (("station", station), ("speed", speed), ("time", time)):
            if not math.isfinite(value):
                raise InputError(f"speed planner: {name} is {value!r}: must be finite")
        if leader is not None and not (math.isfinite(leader.rear) and math.isfinite(leader.speed)):
            raise InputError(f"speed planner: leader {leader!r}: must be finite")
        if self._begun is None:
            self._begun = (time, station)
        road = self._ahead(station)
        speed = max(speed, 1.0)
        fence = self._fence(road, leader)
        try:
            answer = self._optimize(road, speed, time, fence)
        except PlanningError as error:
            return self._fallback(road, speed, fence, leader, str(error))
        self._last = SpeedProfile(road.station, answer[0])
        return HorizonPlan(self._last, "optimal", "", answer[1])

    def _ahead(self, station: float) -> RoadProfile:
        """The road ahead on the horizon's grid; beyond its end it goes on level."""
        road, step = self._heights, self.receding.step
        grid = station + step * np.arange(self.intervals + 1, dtype=float)
        # Between two nodes of the road the lower limit holds.
        below = np.clip(np.searchsorted(road.station, grid) - 1, 0, road.station.size - 1)
        above = np.clip(below + 1, 0, road.station.size - 1)
        limit = np.minimum(road.v_limit[below], road.v_limit[above])
        return RoadProfile(grid, np.interp(grid, road.station, road.height), limit, road.name)

    def _fence(self, road: RoadProfile, leader: Leader | None) -> FloatArray:
        """Earliest time from now at which each node may be passed, shape (n + 1,) [s].

        The leader keeps its speed for `fence_time` and is gone after that.
        """
        fence = np.zeros(road.station.size)
        if leader is None:
            return fence
        pace = max(leader.speed, 0.5)
        clear = leader.rear - self.receding.standstill_gap
        passing = (road.station - clear) / pace + self.receding.time_gap
        reach = clear + pace * self.receding.fence_time
        fence = np.where(road.station <= reach, passing, 0.0)
        return np.maximum(fence, 0.0)

    def _optimize(
        self, road: RoadProfile, speed: float, time: float, fence: FloatArray
    ) -> tuple[FloatArray, float]:
        config, vehicle = self.config, self.vehicle
        cap = np.minimum(road.v_limit, config.v_max)
        cap[0] = max(cap[0], speed)
        fastest = full_power_speed(vehicle, road, speed, cap)
        low = lower_speeds(fastest, config.v_min)
        if fence.any():
            # Behind a slow leader the band has no lower edge.
            low = np.minimum(low, 1.0)
        b_low, b_high = low**2, cap**2
        b_low[0] = b_high[0] = speed**2
        fence = np.minimum(fence, np.maximum.accumulate(fence))
        fence[0] = 0.0
        guess = self._guess(road, fastest, b_low, b_high)
        task = Task(
            road,
            b_low,
            b_high,
            math.inf,
            fence,
            k_a=1e-3 * config.k_a,
            price_time=self._time_price(time, road.station[0]),
            price_energy=self._energy_price(),
        )
        answer = self._solver.solve(task, guess)
        return answer.speed, answer.wall_time

    def _guess(
        self, road: RoadProfile, fastest: FloatArray, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        guess = np.minimum(fastest, self.config.v_ref)
        if self._last is not None:
            guess = np.interp(road.station, self._last.station, self._last.speed)
        return np.clip(guess, np.sqrt(low), np.sqrt(high))

    def _energy_price(self) -> float:
        """Worth of final v^2 [kg/(m2/s2)]: the fuel that a little more force costs at v_ref.

        The optimum's condition on the engine's force, `f1/eta + 2 f2 R v/eta^2` a joule, on level.
        """
        vehicle, v = self.vehicle, self.config.v_ref
        resistance = float(vehicle.slope_force(np.zeros(1))[0]) + vehicle.drag * v**2
        joule = vehicle.fuel.f1 / vehicle.efficiency
        joule += 2.0 * vehicle.fuel.f2 * resistance * v / vehicle.efficiency**2
        return 0.5 * vehicle.inertial_mass * joule

    def _time_price(self, time: float, station: float) -> float:
        """Price of a second [kg/s] for which v_ref is the best speed on the level, with feedback.

        On the level the cost of a metre is `f0/v + f1 R/eta + f2 R^2 v/eta^2 + price/v` with
        R = m g c + k v^2; its derivative by v is zero at v_ref.
        """
        assert self._begun is not None
        vehicle, v = self.vehicle, self.config.v_ref
        fuel, eta = vehicle.fuel, vehicle.efficiency
        k = vehicle.drag
        resistance = float(vehicle.slope_force(np.zeros(1))[0]) + k * v**2
        slope = fuel.f1 * 2.0 * k * v / eta
        slope += fuel.f2 * (resistance**2 + 4.0 * k * v**2 * resistance) / eta**2
        price = max(slope * v**2 - fuel.f0, 0.0)
        lag = (time - self._begun[0]) - (station - self._begun[1]) / v
        return price * math.exp(float(np.clip(self.receding.feedback * lag, -3.0, 3.0)))

    def _fallback(
        self,
        road: RoadProfile,
        speed: float,
        fence: FloatArray,
        leader: Leader | None,
        reason: str,
    ) -> HorizonPlan:
        """The last plan while it starts here, covers 500 m and keeps the fence; or a cruise."""
        last = self._last
        if last is not None and last.station[-1] - road.station[0] > 500.0:
            held = np.interp(road.station, last.station, last.speed)
            times = np.concatenate([[0.0], np.cumsum(durations(np.maximum(held, 0.5), road))])
            starts = abs(held[0] - speed) < 1.0
            if starts and bool((times >= fence - 1.0).all()) and bool((held <= road.v_limit).all()):
                return HorizonPlan(SpeedProfile(road.station, held), "kept", reason, 0.0)
        v_set = self.config.v_ref if leader is None else min(self.config.v_ref, leader.speed)
        v_set = max(v_set, 1.0)
        limited = np.minimum(road.v_limit, v_set)
        try:
            held = cruise(self.vehicle, road, v_set, min(speed, v_set))
        except PlanningError:
            # Not even that can be driven: ask for the lower limits and let the truck do its best.
            held = limited
        self._last = None
        return HorizonPlan(SpeedProfile(road.station, held), "cruise", reason, 0.0)
