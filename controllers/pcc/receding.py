"""Receding-horizon plan: the speed over the next 5 km in traffic, planned repeatedly.

With `RecedingConfig.gears` a dynamic program then chooses gears and eco-roll around this plan.
A schedule of the whole trip (`controllers.pcc.schedule`) gives the price of a second and the worth
of speed at the horizon's end. A lag behind it raises the price; a large lag makes a new schedule.

If the optimizer has no solution, `fallback_plan` takes the first of these that begins at the
truck's speed, keeps the limits and stays behind the vehicle ahead: the last plan, the schedule, a
cruise at v_ref within all limits. The cruise needs no check: it does so as well as the truck can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from controllers.pcc.fuel import FuelMap
from controllers.pcc.joint import (
    NEUTRAL,
    GearTables,
    JointPlan,
    JointTask,
    joint_drive,
    joint_values,
)
from controllers.pcc.leader_constraint import (
    Leader,
    approach_speeds,
    braking_speeds,
    constraint_behind,
)
from controllers.pcc.planner import PccConfig, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import Bounds, Schedule, bounds_of, level_worth
from controllers.pcc.solver import solve
from controllers.pcc.task import Solution, SpeedTask
from controllers.pcc.trip import (
    LEAST_INTERVALS,
    LEAST_SPEED,
    Appointment,
    PccTrip,
    PlanStart,
    RecedingConfig,
)
from controllers.pcc.vehicle import cruise
from iits_mj.core.arrays import FloatArray
from iits_mj.core.checks import in_range
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import SpeedProfile, TransmissionMode
from iits_mj.parameters import TruckParameters

_FULL = 0.98  # share of the greatest planned power that counts as full power
_OFF_ROAD = 100.0  # [m] that the truck may be beyond the road's ends: grids end before the road
_FASTEST = 60.0  # [m/s] of any truck, forward and backward
_MASSES = (0.5, 1.4)  # over the mass of the empty and of the laden truck: an estimate may be wrong
_KEEP = 500.0  # [m] that a kept plan must still cover
_KEEP_SPEED = 1.0  # [m/s] by which a kept plan may differ from the truck's speed
_TUBE = 3.0  # [m/s] around the convex plan in which the plan with gears is sought
_STATES = 30  # of v^2 in this range
_SOON = 1.0  # [s] by which a kept plan may pass a node behind the leader too early


@dataclass(frozen=True)
class HorizonPlan:
    """Result of `RecedingPlanner.plan`.

    Attributes:
      profile: speed over station.
      status: "optimal", "kept" (the last plan), "schedule" or "cruise".
      reason: why the plan is not optimal, else "".
      solve_time: wall time of the solver [s].
      price: of a second [kg/s]; lag: behind the schedule [s], NaN without one.
    """

    profile: SpeedProfile
    status: str
    reason: str
    solve_time: float
    price: float
    lag: float


class RecedingPlanner:
    """Speed planner for a drive along one road; call `plan` about every second.

    Attributes:
      vehicle: the point mass of the plans; trip: destination and schedule.
      last: the last plan as optimized, None before the first.
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
        """Prepares plans for a truck of a gross mass [kg] on a whole road of any grid.

        The default appointment is the road's end in the time of a cruise at v_ref.

        Raises:
          InputError: no load of the truck gives this mass.
        """
        self.config, self.receding = config or PccConfig(), receding or RecedingConfig()
        parameters = parameters or TruckParameters.load()
        least = _MASSES[0] * parameters.gross_mass(0.0)
        most = _MASSES[1] * parameters.gross_mass(parameters.payload_max)
        in_range("speed planner: mass [kg]", mass, least, most)
        vehicle = make_vehicle(parameters, FuelMap(parameters), mass, self.config)
        power = self.receding.power_share * vehicle.power_max
        self.vehicle = replace(vehicle, power_max=power)
        end = appointment or Appointment(float(road.station[-1]))
        self.trip = PccTrip(self.vehicle, road, self.config, self.receding, end)
        self.last: SpeedProfile | None = None

        self._tables: GearTables | None = None
        if self.receding.gears:
            self._tables = GearTables.of(
                parameters,
                self.config.v_min,
                self.config.v_max,
                power_share=self.receding.power_share,
            )
        self._gears: tuple[FloatArray, JointPlan] | None = None

    def reset(self) -> None:
        """Clears the last plan and the trip so far."""
        self.last = self._gears = None
        self.trip.reset()

    @property
    def schedule(self) -> Schedule | None:
        """Schedule of the trip, None if there is none."""
        return self.trip.schedule

    def plan(
        self,
        station: float,
        speed: float,
        time: float,
        leader: Leader | None = None,
        flow: float = math.inf,
    ) -> HorizonPlan:
        """Plans the speed over the horizon.

        Args:
          station: of the truck's reference point, which follows the plan [m].
          speed: now [m/s].
          time: now, for the lag behind the schedule [s].
          leader: vehicle ahead in the lane, or None.
          flow: greatest mean speed that the traffic allows [m/s], see `Flow`.

        Raises:
          InputError: a number is not finite, the station is not on the road, the speed is above
            60 m/s, or the leader is behind the truck.
        """
        first, last = (float(self.trip.road.station[end]) for end in (0, -1))
        in_range("speed planner: station [m]", station, first - _OFF_ROAD, last + _OFF_ROAD)
        in_range("speed planner: speed [m/s]", speed, -_FASTEST, _FASTEST)
        if not math.isfinite(time):
            raise InputError(f"speed planner: time is {time!r}: must be finite")
        if math.isnan(flow) or flow < 0.0:
            raise InputError(f"speed planner: flow is {flow!r}: must be 0 or more, or inf")
        if leader is not None and leader.rear < station:
            raise InputError(
                f"speed planner: gap {leader.rear - station:g} m to the vehicle ahead: must be 0 "
                "or more"
            )
        self.trip.flow = flow
        arriving = self._arriving(station)
        if arriving is not None:
            return arriving
        speed = self._start_speed(station, max(speed, LEAST_SPEED))
        # A plan behind a vehicle starts here, any other at the next node of the schedule.
        start = self.trip.next_node(station, speed, time, self.last)
        self.trip.keep_schedule(start)
        sight = self.receding.horizon
        if leader is not None:
            start, sight = PlanStart(station, speed, time), min(sight, self.receding.leader.horizon)
        road = self.trip.horizon(start, sight, free=leader is None)
        price, lag = self.trip.price(start)
        status, reason, solve_time = "optimal", "", 0.0
        try:
            nodes, solve_time = self._optimize(road, start.speed, price, leader)
        except PlanningError as error:
            nodes, status = fallback_plan(self.trip, road, start.speed, leader, self.last)
            reason = str(error)
        modes = None
        if self._tables is not None and leader is None and status == "optimal":
            began = perf_counter()
            nodes, modes = self._in_gears(road, nodes, price, self._tables)
            solve_time += perf_counter() - began
        else:
            self._gears = None
        asked = self._asked(road, nodes) if status == "optimal" else nodes
        stations = road.station
        if start.station > station:
            stations = np.concatenate([[station], stations])
            more = asked[0] - nodes[0]
            nodes, asked = np.concatenate([[speed], nodes]), np.concatenate([[speed + more], asked])
            modes = None if modes is None else np.concatenate([modes[:1], modes])
        self.last = SpeedProfile(stations, nodes)
        profile = SpeedProfile(stations, asked, modes)
        return HorizonPlan(profile, status, reason, solve_time, price, lag)

    def _in_gears(
        self, road: RoadProfile, nodes: FloatArray, price: float, tables: GearTables
    ) -> tuple[FloatArray, NDArray[np.int64]]:
        """Returns node speeds and requests to the gearbox, (n + 1,), of the plan with gears.

        It is sought around the convex optimum `nodes`, at the same prices of time and end speed.
        """
        bounds = bounds_of(self.vehicle, road, float(nodes[0]), self.config)
        low = np.maximum(bounds.low, np.maximum(nodes - _TUBE, LEAST_SPEED) ** 2)
        high = np.maximum(np.minimum(bounds.high, (nodes + _TUBE) ** 2), low)
        low[0] = high[0] = nodes[0] ** 2
        worth = self._terminal(road, low, high, bounds)
        task = JointTask(
            self.vehicle,
            road,
            tables,
            low,
            np.maximum(high, low),
            max(price, 0.0),
            k_a=1e-3 * self.config.k_a,
            states=_STATES,
            worth=worth,
        )
        gear = None
        if self._gears is not None:
            station, last = self._gears
            interval = int(station.searchsorted(road.station[0] - 1e-6, "right")) - 1
            if 0 <= interval < last.gear.size:
                gear = int(last.gear[interval])
        found = joint_drive(task, joint_values(task), gear)
        self._gears = road.station, found
        # The plan is made anew every second. The truck would change forward gears too often.
        neutral = np.append(found.gear == NEUTRAL, False)
        return found.speed, np.where(neutral, TransmissionMode.NEUTRAL, TransmissionMode.DRIVE)

    def _asked(self, road: RoadProfile, nodes: FloatArray) -> FloatArray:
        """Returns the speeds for the truck (n + 1,): above the plan where it takes full power.

        There the truck shall use its full power; the time that it gains lowers the price later.
        """
        full = self.vehicle.power(nodes, road) > _FULL * self.vehicle.power_max
        asked = nodes.copy()
        near = np.concatenate([full[:1], full[1:] | full[:-1], full[-1:]])
        asked += np.where(near, self.receding.surplus, 0.0)
        return np.asarray(np.minimum(asked, np.maximum(road.v_limit, nodes)))

    def _arriving(self, station: float) -> HorizonPlan | None:
        """Returns the last plan if the rest of the trip is too short to plan, else None."""
        last, schedule = self.last, self.trip.schedule
        if last is None or schedule is None or not schedule.covers(station):
            return None
        near = LEAST_INTERVALS * self.receding.step
        reaches = last.station[0] <= station and last.station[-1] > schedule.end - near
        if schedule.end - station >= near or not reaches:
            return None
        return HorizonPlan(last, "kept", "the trip ends here", 0.0, schedule.price, math.nan)

    def _start_speed(self, station: float, speed: float) -> float:
        """Returns the last plan's speed at a station, limited to a range around the truck's."""
        if self.last is None or not self.last.station[0] <= station <= self.last.station[-1]:
            return speed
        reach = self.receding.resync
        return min(max(self.last.at(station), speed - reach, LEAST_SPEED), speed + reach)

    def _optimize(
        self, road: RoadProfile, speed: float, price: float, leader: Leader | None
    ) -> tuple[FloatArray, float]:
        """Returns node speeds and the solver's time [s]; PlanningError if there is no optimum."""
        settings = self.receding.leader
        bounds = bounds_of(self.vehicle, road, speed, self.config)
        if leader is not None and leader.pace < settings.jam:
            raise PlanningError(f"the vehicle ahead drives {leader.pace:.1f} m/s: a jam")
        low, high = bounds.low.copy(), bounds.high.copy()
        worth = self._terminal(road, low, high, bounds)
        task = SpeedTask(
            self.vehicle,
            road,
            low,
            high,
            k_a=1e-3 * self.config.k_a,
            price_time=price,
            price_energy=worth,
        )
        free = self._solve(task, bounds)
        if leader is None:
            return free.speed, free.solve_time
        constraint = constraint_behind(leader, self.vehicle, road, speed, settings)
        if constraint.kept(road, free.speed):
            return free.speed, free.solve_time
        high[-1] = max(float(high[-1]), float(constraint.slowest[-1]) ** 2)
        low = np.minimum(constraint.slowest**2, high)
        task = replace(task, b_low=low, b_high=high, earliest=constraint.earliest)
        behind = self._solve(task, bounds)
        return behind.speed, free.solve_time + behind.solve_time

    def _solve(self, task: SpeedTask, bounds: Bounds) -> Solution:
        """Returns the optimum of a task; PlanningError if its speeds are not finite."""
        if self.last is None:
            guess = np.minimum(bounds.fastest, self.config.v_ref)
        else:
            guess = np.interp(task.road.station, self.last.station, self.last.speed)
        found = solve(task, guess, time_limit=self.receding.time_limit)
        if not np.isfinite(found.speed).all():
            raise PlanningError("the speed optimization gave speeds that are not finite")
        return found

    def _terminal(
        self, road: RoadProfile, low: FloatArray, high: FloatArray, bounds: Bounds
    ) -> float:
        """Returns the worth of the last v^2; writes a wanted end speed into the bounds."""
        schedule, last = self.trip.ahead_of(float(road.station[0])), float(road.station[-1])
        if schedule is None:
            return level_worth(self.vehicle, self.config.v_ref)
        wanted = self.trip.appointment.speed
        if wanted is None or last < schedule.end - 1.0:
            return schedule.worth_at(last)
        low[-1] = high[-1] = min(wanted**2, float(bounds.fastest[-1]) ** 2, float(high[-1]))
        return 0.0


def fallback_plan(
    trip: PccTrip, road: RoadProfile, speed: float, leader: Leader | None, last: SpeedProfile | None
) -> tuple[FloatArray, str]:
    """Returns the first valid of last plan, schedule and cruise: node speeds (n + 1,) and name.

    The road begins at the truck's station; speed [m/s] is the plan's first.
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
        held = cruise(trip.vehicle, road, trip.config.v_ref, speed, slowest)
    except PlanningError:
        # The truck cannot drive the cruise either: ask for the limits.
        held = np.minimum(road.v_limit, trip.config.v_ref)
    if leader is not None:
        held = np.minimum(held, approach_speeds(road, speed, leader, trip.receding.leader))
    return held, "cruise"


def _holds(
    trip: PccTrip, road: RoadProfile, held: FloatArray, speed: float, leader: Leader | None
) -> bool:
    """Returns whether node speeds begin at the truck's, keep the limits and the gap ahead."""
    settings, lawful = trip.receding.leader, (held[1:] <= road.v_limit[1:] + 1e-6).all()
    if not (abs(held[0] - speed) < _KEEP_SPEED and lawful):
        return False
    if leader is None or leader.pace < settings.jam:
        return leader is None
    try:
        constraint = constraint_behind(leader, trip.vehicle, road, speed, settings)
    except PlanningError:
        return False
    return constraint.kept(road, held, _SOON)
