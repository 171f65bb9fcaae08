"""On line: the speed over the next 5 km, planned again and again, a vehicle ahead as fence.

A schedule of the whole trip (`controllers.pcc.schedule`) gives what the horizon cannot see: the
price of a second and the worth of speed at the horizon's end. So the plan on a free road is a piece
of the plan of the whole trip. A lag behind the schedule raises the price; a lasting one makes a new
schedule from here.

What is used, the first that holds: the optimum; the last plan while it starts here and keeps the
fence; the schedule; a cruise at v_ref within all limits. The last two need no optimizer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from controllers.pcc.fuel import FuelMap
from controllers.pcc.leader_constraint import Leader, approach_speeds, braking_speeds, fence_of
from controllers.pcc.planner import PccConfig, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import Bounds, Schedule, bounds_of, cruise_from, level_worth
from controllers.pcc.solver import Answer, Solver, Task
from controllers.pcc.trip import (
    LEAST_INTERVALS,
    LEAST_SPEED,
    Appointment,
    Begin,
    RecedingConfig,
    Trip,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import SpeedProfile
from iits_mj.parameters import TruckParameters

# --- What is driven where the optimizer has no answer: last plan, schedule, cruise; no solver
# needed
# The first that holds is taken: it begins at the truck's speed, keeps the limits and stays behind
# the vehicle ahead. The cruise at v_ref within all limits always does, as well as the truck can.

_KEEP = 500.0  # [m] that a kept plan must still cover
_KEEP_SPEED = 1.0  # [m/s] by which a kept plan may miss the truck's speed
_SOON = 1.0  # [s] by which a kept plan may pass the fence too early


def substitute(
    trip: Trip, road: RoadProfile, speed: float, leader: Leader | None, last: SpeedProfile | None
) -> tuple[FloatArray, str]:
    """Node speeds (n + 1,) of the first of last plan, schedule and cruise that holds, and its name.

    Args:
      trip: under way.
      road: ahead.
      speed: at its first node [m/s].
      leader: vehicle ahead, if any.
      last: the last plan, if any.
    """
    schedule, start = trip.ahead_of(float(road.station[0])), float(road.station[0])
    if last is not None and last.station[-1] - start > _KEEP:
        held = np.interp(road.station, last.station, last.speed)
        if _holds(trip, road, held, speed, leader):
            return held, "kept"
    if schedule is not None:
        held = np.asarray(schedule.speed_at(road.station))
        if _holds(trip, road, held, speed, leader):
            return held, "schedule"
    slowest = braking_speeds(trip.vehicle, road, speed)
    try:
        held = cruise_from(trip.vehicle, road, trip.config.v_ref, speed, slowest)
    except PlanningError:
        # Not even that can be driven: ask for the limits and let the truck do its best.
        held = np.minimum(road.v_limit, trip.config.v_ref)
    if leader is not None:
        held = np.minimum(held, approach_speeds(road, speed, leader, trip.receding.fence))
    return held, "cruise"


def _holds(
    trip: Trip, road: RoadProfile, held: FloatArray, speed: float, leader: Leader | None
) -> bool:
    """Whether speeds begin at the truck's, keep the limits and stay behind the leader."""
    near = abs(held[0] - speed) < _KEEP_SPEED
    lawful = bool((held[1:] <= road.v_limit[1:] + 1e-6).all())
    settings = trip.receding.fence
    if not (near and lawful) or leader is None:
        return near and lawful
    if leader.pace < settings.jam:
        return False
    try:
        fence = fence_of(trip.vehicle, road, speed, leader, settings)
    except PlanningError:
        return False
    return fence.kept(road, held, _SOON)


# --- On line: the speed over the next 5 km, planned again and again, a vehicle ahead as fence ---

_FULL = 0.98  # share of the greatest planned power that is all of it
_BESIDE = 100.0  # [m] that the truck may be off the road's ends: grids end before the road does
_FASTEST = 60.0  # [m/s] of any truck, backward as well
_MASSES = (0.5, 1.4)  # of the empty and of the fully laden truck's: an estimate may be wrong


@dataclass(frozen=True)
class HorizonPlan:
    """Outcome of one call.

    Attributes:
      profile: speed over station.
      status: "optimal", "kept" (the last plan), "schedule" or "cruise"; reason: why not optimal.
      solve_time: wall time of the solver [s].
      price: of a second [kg/s]; lag: behind the schedule [s], nan without one.
    """

    profile: SpeedProfile
    status: str
    reason: str
    solve_time: float
    price: float
    lag: float


class RecedingPlanner:
    """Speed planner for a drive along one road; call `plan` every second or as it suits.

    Attributes:
      vehicle: the point mass that is planned for; trip: its end and schedule.
    """

    def __init__(
        self,
        road: RoadProfile,
        parameters: TruckParameters | None = None,
        mass: float = 55_000.0,
        config: PccConfig | None = None,
        receding: RecedingConfig | None = None,
        appointment: Appointment | None = None,
    ) -> None:
        """Prepares the planner.

        Args:
          road: the whole road, of any grid.
          parameters: of the truck.
          mass: gross [kg].
          config: set speed and band.
          receding: settings.
          appointment: where the trip ends, and when; default: at the road's end, in the time of a
            cruise at v_ref.

        Raises:
          InputError: the mass is not this truck's, empty or laden.
        """
        self.config, self.receding = config or PccConfig(), receding or RecedingConfig()
        parameters = parameters or TruckParameters.load()
        least = _MASSES[0] * parameters.gross_mass(0.0)
        most = _MASSES[1] * parameters.gross_mass(parameters.payload.mass_max)
        if not least <= mass <= most:
            raise InputError(
                f"speed planner: mass {mass!r} kg is not this truck's: {least:.0f} to {most:.0f} "
                "is allowed"
            )
        vehicle = make_vehicle(parameters, FuelMap(parameters), mass, self.config)
        power = self.receding.power_share * vehicle.power_max
        self.vehicle = replace(vehicle, power_max=power)
        end = appointment or Appointment(float(road.station[-1]))
        self.trip = Trip(self.vehicle, road, self.config, self.receding, end)
        self._time_limit = min(self.receding.time_limit, 1e6)
        self._solvers: dict[tuple[int, bool], Solver] = {}
        self._last: SpeedProfile | None = None

    def reset(self) -> None:
        """Forgets the last plan and the trip so far."""
        self._last = None
        self.trip.reset()

    @property
    def schedule(self) -> Schedule | None:
        """Of the trip, None where there is none."""
        return self.trip.schedule

    def plan(
        self,
        station: float,
        speed: float,
        time: float,
        leader: Leader | None = None,
        flow: float = math.inf,
    ) -> HorizonPlan:
        """Speed over the horizon from a station [m] at a speed [m/s] and time [s].

        Args:
          station: of the truck's reference point; the plan is to be followed by it.
          speed: now.
          time: now, for the lag behind the schedule.
          leader: vehicle ahead in the lane, if any.
          flow: greatest speed that the traffic allows on the whole [m/s], see `Flow`.

        Raises:
          InputError: a number is not finite, the truck is not on the road or faster than any, or
            the vehicle ahead is not ahead.
        """
        self._check(station, speed, time, leader, flow)
        self.trip.flow = flow
        arriving = self._arriving(station)
        if arriving is not None:
            return arriving
        speed = self._start_speed(station, max(speed, LEAST_SPEED))
        # Behind a vehicle a plan begins here; else at the next node, so that it is the schedule's.
        begin = self.trip.next_node(station, speed, time, self._last)
        self.trip.keep_schedule(begin)
        sight = self.receding.horizon
        if leader is not None:
            begin, sight = Begin(station, speed, time), min(sight, self.receding.fence.horizon)
        road = self.trip.horizon(begin, sight, free=leader is None)
        price, lag = self.trip.price(begin)
        status, reason, solve_time = "optimal", "", 0.0
        try:
            nodes, solve_time = self._optimize(road, begin.speed, price, leader)
        except PlanningError as error:
            nodes, status = substitute(self.trip, road, begin.speed, leader, self._last)
            reason = str(error)
        asked = self._asked(road, nodes) if status == "optimal" else nodes
        stations = road.station
        if begin.station > station:
            stations = np.concatenate([[station], stations])
            more = asked[0] - nodes[0]
            nodes, asked = np.concatenate([[speed], nodes]), np.concatenate([[speed + more], asked])
        self._last = SpeedProfile(stations, nodes)
        return HorizonPlan(SpeedProfile(stations, asked), status, reason, solve_time, price, lag)

    def _check(
        self, station: float, speed: float, time: float, leader: Leader | None, flow: float
    ) -> None:
        """Refuses states that cannot be, by name."""
        for name, value in (("station", station), ("speed", speed), ("time", time)):
            if not math.isfinite(value):
                raise InputError(f"speed planner: {name} is {value!r}: must be finite")
        first, last = float(self.trip.road.station[0]), float(self.trip.road.station[-1])
        if not first - _BESIDE <= station <= last + _BESIDE:
            raise InputError(
                f"speed planner: station {station:g} m is off the road, which goes from {first:g} "
                f"to {last:g} m"
            )
        if abs(speed) > _FASTEST:
            raise InputError(
                f"speed planner: speed {speed:g} m/s is no truck's: at most {_FASTEST:g} is allowed"
            )
        if math.isnan(flow) or flow < 0.0:
            raise InputError(f"speed planner: flow is {flow!r}: must be 0 or more, or inf")
        if leader is not None and leader.rear < station:
            raise InputError(
                f"speed planner: gap {leader.rear - station:g} m to the vehicle ahead: must be 0 "
                "or more"
            )

    def _asked(self, road: RoadProfile, nodes: FloatArray) -> FloatArray:
        """What the truck is asked for: a little more where the plan takes all power it counts on.

        There the truck shall give what it has; what it wins makes a second cheaper later.
        """
        full = self.vehicle.power(nodes, road) > _FULL * self.vehicle.power_max
        asked = nodes.copy()
        near = np.concatenate([full[:1], full[1:] | full[:-1], full[-1:]])
        asked += np.where(near, self.receding.surplus, 0.0)
        return np.asarray(np.minimum(asked, np.maximum(road.v_limit, nodes)))

    def _arriving(self, station: float) -> HorizonPlan | None:
        """The last plan once more, where the trip ends so soon that there is nothing to plan."""
        last, schedule = self._last, self.trip.schedule
        if last is None or schedule is None or not schedule.covers(station):
            return None
        near = LEAST_INTERVALS * self.receding.step
        reaches = last.station[0] <= station and last.station[-1] > schedule.end - near
        if schedule.end - station >= near or not reaches:
            return None
        return HorizonPlan(last, "kept", "the trip ends here", 0.0, schedule.price, math.nan)

    def _start_speed(self, station: float, speed: float) -> float:
        """The last plan's speed here, as long as the truck keeps near it: plans do not jump."""
        if self._last is None or not self._last.station[0] <= station <= self._last.station[-1]:
            return speed
        reach = self.receding.resync
        return float(
            np.clip(self._last.at(station), max(speed - reach, LEAST_SPEED), speed + reach)
        )

    # The horizon --------------------------------------------------------------------------------

    def _optimize(
        self, road: RoadProfile, speed: float, price: float, leader: Leader | None
    ) -> tuple[FloatArray, float]:
        """Node speeds, and the time that took [s]."""
        settings = self.receding.fence
        slowest = braking_speeds(self.vehicle, road, speed)
        bounds = bounds_of(self.vehicle, road, speed, slowest, self.config)
        if leader is not None and leader.pace < settings.jam:
            raise PlanningError(f"the vehicle ahead drives {leader.pace:.1f} m/s: a jam")
        low, high = bounds.low.copy(), bounds.high.copy()
        worth = self._terminal(road, low, high, bounds)
        task = Task(
            road,
            low,
            high,
            math.inf,
            np.zeros(road.station.size),
            k_a=1e-3 * self.config.k_a,
            price_time=price,
            price_energy=worth,
        )
        answer = self._solve(task, bounds)
        if leader is None:
            return answer.speed, answer.wall_time
        fence = fence_of(self.vehicle, road, speed, leader, settings)
        if fence.kept(road, answer.speed):
            return answer.speed, answer.wall_time
        high[-1] = max(float(high[-1]), float(fence.slowest[-1]) ** 2)
        low = np.minimum(fence.slowest**2, high)
        behind = self._solve(replace(task, b_low=low, b_high=high, fence=fence.time), bounds)
        return behind.speed, answer.wall_time + behind.wall_time

    def _solve(self, task: Task, bounds: Bounds) -> Answer:
        """The optimum of a task, with numbers that are finite."""
        low, high = np.sqrt(task.b_low), np.sqrt(task.b_high)
        guess = np.minimum(bounds.fastest, self.config.v_ref)
        if self._last is not None:
            guess = np.interp(task.road.station, self._last.station, self._last.speed)
        solver = self._solver(task.road.intervals, bool(task.fence.any()))
        answer = solver.solve(task, np.clip(guess, low, high))
        if not np.isfinite(answer.speed).all():
            raise PlanningError("the speed optimization gave speeds that are not finite")
        return answer

    def _terminal(
        self, road: RoadProfile, low: FloatArray, high: FloatArray, bounds: Bounds
    ) -> float:
        """Worth of the last v^2 [kg/(m2/s2)]; a wanted end speed is written into the bounds."""
        schedule, last = self.trip.ahead_of(float(road.station[0])), float(road.station[-1])
        if schedule is None:
            return level_worth(self.vehicle, self.config.v_ref)
        wanted = self.trip.appointment.speed
        if wanted is None or last < schedule.end - 1.0:
            return schedule.worth_at(last)
        low[-1] = high[-1] = min(wanted**2, float(bounds.fastest[-1]) ** 2, float(high[-1]))
        return 0.0

    def _solver(self, intervals: int, fenced: bool) -> Solver:
        key = (intervals, fenced)
        if key not in self._solvers:
            self._solvers[key] = Solver(
                self.vehicle, intervals, self.receding.step, fenced, self._time_limit
            )
        return self._solvers[key]
