"""Drives a cruise at a set speed and the fuel-optimal plan on the MuJoCo truck.

The cruise is driven first; for a given mean speed its set speed is corrected and the cruise is
driven again. The plan gets the trip time of the cruise and its speeds at both ends. The time budget
of the plan is then corrected until the *driven* trip times agree, because the planner does not know
the time lost by gear changes: by the difference, and by interpolation once a drive was early and
another late. The plan's multipliers price the remaining difference.

The planner's point mass gets the power with which its own cruise takes as long as the driven one.
That is less than the engine's greatest power: gear changes interrupt the pull, the turbocharger
must catch up after them, and the gearbox shifts down at some 1200 rpm.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.pcc.fuel import FuelMap
from controllers.pcc.joint import GearTables, JointPlan, JointTask, plan_in_time
from controllers.pcc.planner import Drive, PccConfig, evaluate, make_vehicle
from controllers.pcc.profile import RoadProfile
from controllers.pcc.schedule import Schedule, bounds_of, make_schedule
from controllers.pcc.vehicle import (
    PointMass,
    brakeable,
    cruise,
    durations,
    fastest_below,
    passing_times,
)
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.messages import SpeedProfile, TransmissionMode
from iits_mj.core.timing import CONTROL_PERIOD, TIMESTEP
from iits_mj.parameters import AnyTruck, TruckParameters
from iits_mj.road import Route
from iits_mj.validation.harness.config import laden
from iits_mj.validation.planning.closed_loop import DriveTask, Record, drive
from iits_mj.validation.planning.pcc_roads import on_finer_road
from iits_mj.validation.planning.speed_tracking import FLOORED

# Road before the measured stretch, until the engine pulls steadily [m], and after it [m].
RUN_IN, RUN_OUT = 300.0, 30.0
_LATEST = 4.0  # time limit of a drive over its time at the set speed
_START = 100.0
# Distance from the set speed of the run-in to the first speed of the plan [m].
_ONSET = 1.0
# Greatest difference of trip times that agree [1], and greatest number of drives. One gear change
# changes the driven time by a second or two, so that the correction may need several drives.
TIME_TOLERANCE, DRIVES = 9e-4, 5
# Tolerance of the mean speed [1], and greatest number of drives to find the set speed for it.
MEAN_TOLERANCE, MEAN_DRIVES = 1e-3, 3
_GRID = 10.0
# Time in which the engine's torque builds up, and least time of climbing for an estimate [s].
_TORQUE_TIME, _CLIMBING = 6.0, 30.0
# Least estimated power over the power with built-up torque; a greater delay has other causes [1].
_LEAST_SHARE = 0.6
# Share of its power from which a plan uses all of it [1].
_ALL = 0.98
# Plant and physics of a drive ahead; the savings of the full truck differ by tenths of a point.
_AHEAD, _AHEAD_STEP = "kinematic", 0.005
_HALVINGS = 30


@dataclass(frozen=True)
class ReplayCase:
    """Road, truck and band of a comparison.

    Attributes:
      name: for reports; route: the road; road: the same road for the planner, with stations from
        `origin` on the route [m].
      config: band and set speed, which is searched for if `mean_speed`; with `rolls` the cruise
        may roll up to the top of the band downhill; payload: [kg].
      timestep: of the physics [s]; plant: see `Truck.load`.
      truck: default: the shipped one; overlay: of its parameters, such as another strategy of gear
        changes.
      paper: whether the paper's saving must be reached.
      joint: whether gears and neutral are planned with the speed.
    """

    name: str
    route: Route
    road: RoadProfile
    origin: float
    config: PccConfig
    payload: float = dataclasses.field(default_factory=laden)
    timestep: float = TIMESTEP
    plant: str = "full"
    truck: AnyTruck | None = None
    overlay: dict[str, Any] = dataclasses.field(default_factory=dict)
    paper: bool = False
    joint: bool = False

    @property
    def top(self) -> float | None:
        """Speed up to which the cruise rolls downhill [m/s]; None: it brakes at its set speed."""
        return self.config.v_max if self.config.rolls else None

    @property
    def first(self) -> float:
        """First station of the measured stretch on the route [m]."""
        return self.origin + float(self.road.station[0])

    @property
    def last(self) -> float:
        """Last station of the measured stretch on the route [m]."""
        return self.origin + float(self.road.station[-1])

    def parameters(self) -> TruckParameters:
        """Returns the parameters of the truck."""
        return TruckParameters.load(self.truck, overlay=self.overlay)


@dataclass(frozen=True)
class MeasuredDrive:
    """A drive over the measured stretch.

    Attributes:
      record: of the stretch; fuel: by the truck's meter [kg]; time: [s].
      start_speed, end_speed: [m/s].
    """

    record: Record
    fuel: float
    time: float
    start_speed: float
    end_speed: float

    @classmethod
    def of(cls, record: Record, case: ReplayCase) -> MeasuredDrive:
        """Returns the part of a record on the case's measured stretch."""

        def gained(name: str) -> float:
            return record.at(case.last, name) - record.at(case.first, name)

        return cls(
            record.between(case.first, case.last),
            gained("fuel_used"),
            gained("time"),
            record.at(case.first, "speed"),
            record.at(case.last, "speed"),
        )


@dataclass(frozen=True)
class CruiseAndPlan:
    """Cruise and plan on the truck, and the expectation of the optimizer.

    Attributes:
      case: of the comparison; vehicle: the planner's point mass, with the truck's power on climbs.
      vehicle_max: the same with the engine's greatest power.
      schedule: the plan; cruise, plan: both trips.
      gears: the plan of speed and gear that the truck drove, None without `case.joint`.
      model_cruise, model_plan: the planner's figures for the speeds that the truck drove.
    """

    case: ReplayCase
    vehicle: PointMass
    vehicle_max: PointMass
    schedule: Schedule
    cruise: MeasuredDrive
    plan: MeasuredDrive
    model_cruise: Drive
    model_plan: Drive
    gears: JointPlan | None = None

    @property
    def speed_worth(self) -> float:
        """Worth in fuel of the plan's greater speed at the end, less that at its start [kg].

        By the optimum's costate of v^2 on this road, at equal trip time.
        """
        worth = self.schedule.worth
        ends = self.plan.end_speed**2 - self.cruise.end_speed**2
        starts = self.plan.start_speed**2 - self.cruise.start_speed**2
        return float(worth[-1] * ends - worth[0] * starts)

    @property
    def time_worth(self) -> float:
        """Fuel that the plan saved by its longer trip time, at the optimum's price [kg]."""
        return self.schedule.price * (self.plan.time - self.cruise.time)

    @property
    def raw_saving(self) -> float:
        """Saving of the plan against the cruise by the fuel meter alone [1]."""
        return 1.0 - self.plan.fuel / self.cruise.fuel

    @property
    def saving(self) -> float:
        """The same, corrected to equal end speeds and trip time by their worth [1]."""
        return 1.0 - (self.plan.fuel - self.speed_worth + self.time_worth) / self.cruise.fuel


def run(
    case: ReplayCase,
    folder: Path | None = None,
    drives: int = DRIVES,
    known: PointMass | None = None,
) -> CruiseAndPlan:
    """Drives the cruise and the plan; finished drives in `folder` are not repeated.

    Args:
      case: of the comparison.
      folder: of finished drives.
      drives: greatest number of drives of the plan, until the trip times agree.
      known: point mass of this truck with its power on climbs, to guess a set speed by.

    Raises:
      InputError: the truck does not reach the end.
      PlanningError: the plan has no solution.
    """
    parameters = case.parameters()
    fuel_map = FuelMap(parameters)
    mass = parameters.gross_mass(case.payload)
    strongest = make_vehicle(parameters, fuel_map, mass, case.config)
    if case.config.mean_speed:
        case = _at_mean_speed(case, strongest, known or strongest, folder)
    config = case.config
    cruise = MeasuredDrive.of(_driven(case, None, folder), case)
    vehicle = with_power_of(
        strongest, case, cruise.record, config.v_ref, cruise.start_speed, cruise.time
    )
    budget, best = cruise.time, None
    late: dict[float, float] = {}  # of each driven budget
    for _ in range(drives):
        schedule = make_schedule(
            vehicle,
            case.road,
            config,
            cruise.start_speed,
            0.0,
            arrival=budget,
            end_speed=cruise.end_speed,
        )
        gears, pulling = None, vehicle
        if case.joint:
            gears, pulling = plan_with_gears(case, strongest, schedule, budget), strongest
            clock = passing_times(gears.speed, case.road)
            schedule = dataclasses.replace(schedule, speed=gears.speed, clock=clock)
        profile = reference_profile(case, pulling, schedule, strongest)
        if gears is not None:
            profile = with_modes(case, profile, gears)
        plan = MeasuredDrive.of(_driven(case, profile, folder), case)
        if best is None or abs(plan.time - cruise.time) < abs(best[1].time - cruise.time):
            best = schedule, plan, gears
        # With less time, a plan that cannot be any faster stays the same.
        if abs(plan.time / cruise.time - 1.0) <= TIME_TOLERANCE or schedule.late > 0.0:
            break
        late[budget] = plan.time - cruise.time
        budget = _on_time(late, budget)
    assert best is not None
    schedule, plan, gears = best
    model_cruise, model_plan = (
        evaluate(vehicle, fuel_map, case.road, _node_speeds(case, trip.record))
        for trip in (cruise, plan)
    )
    return CruiseAndPlan(
        case, vehicle, strongest, schedule, cruise, plan, model_cruise, model_plan, gears
    )


def run_ahead(
    case: ReplayCase,
    folder: Path | None = None,
    drives: int = DRIVES,
    known: PointMass | None = None,
) -> CruiseAndPlan:
    """Drives cruise and plan of a case ahead, on the kinematic plant: the saving to expect.

    It has the truck's own gearbox, engine and controllers, which no plan has, and takes no figure
    from the drives of the full truck. Arguments and errors are those of `run`.
    """
    ahead = dataclasses.replace(case, plant=_AHEAD, timestep=_AHEAD_STEP)
    return run(ahead, folder, drives, known)


def _on_time(late: dict[float, float], last: float) -> float:
    """Returns the budget that should be on time, from the delays of the driven budgets [s]."""
    early = [(delay, budget) for budget, delay in late.items() if delay < 0.0]
    behind = [(delay, budget) for budget, delay in late.items() if delay >= 0.0]
    if not early or not behind:
        return last - late[last]
    # The nearest of either side: a gear change more or less makes the delay jump.
    (low, first), (high, second) = max(early), min(behind)
    return first + (second - first) * low / (low - high)


def joint_task(case: ReplayCase, vehicle: PointMass, ends: tuple[float, float]) -> JointTask:
    """Returns the task of speed and gear of a case.

    Args:
      case: with the road and the band.
      vehicle: the planner's point mass, with the engine's greatest power.
      ends: speeds at both ends [m/s].
    """
    bounds = bounds_of(vehicle, case.road, ends[0], case.config)
    b_low, b_high = bounds.low.copy(), bounds.high.copy()
    b_low[-1] = b_high[-1] = min(ends[1] ** 2, float(bounds.fastest[-1]) ** 2)
    low, high = math.sqrt(b_low.min()), math.sqrt(b_high.max())
    tables = GearTables.of(case.parameters(), low, high, slows=True)
    return JointTask(vehicle, case.road, tables, b_low, b_high)


def plan_with_gears(
    case: ReplayCase, vehicle: PointMass, schedule: Schedule, budget: float
) -> JointPlan:
    """Returns the joint plan between a schedule's end speeds, within a time [s]."""
    ends = float(schedule.speed[0]), float(schedule.speed[-1])
    return plan_in_time(joint_task(case, vehicle, ends), budget)


def with_modes(case: ReplayCase, profile: SpeedProfile, gears: JointPlan) -> SpeedProfile:
    """Returns the profile with the gears of a joint plan, and the stretches in neutral."""
    place = (profile.station - case.first) / case.road.step + 1e-9
    interval = np.clip(np.floor(place).astype(int), 0, case.road.intervals - 1)
    within = (place >= 0.0) & (place < case.road.intervals)
    modes = np.where(within, gears.transmission_mode[interval], TransmissionMode.DRIVE)
    return dataclasses.replace(profile, transmission_mode=modes)


def _at_mean_speed(
    case: ReplayCase, strongest: PointMass, guess: PointMass, folder: Path | None
) -> ReplayCase:
    """Returns the case with the set speed at which the *truck's* mean speed is v_ref."""
    config, road = case.config, case.road
    wanted = config.v_ref
    v_set = set_speed(guess, case, wanted)
    best, least = case, np.inf
    for _ in range(MEAN_DRIVES):
        found = dataclasses.replace(config, v_ref=v_set, mean_speed=False)
        tried = dataclasses.replace(case, config=found)
        trip = MeasuredDrive.of(_driven(tried, None, folder), tried)
        mean = road.length / trip.time
        if abs(mean - wanted) < least:
            best, least = tried, abs(mean - wanted)
        if least <= MEAN_TOLERANCE * wanted:
            break
        # By as much as in the model whose cruise takes as long as the driven one.
        model = with_power_of(strongest, case, trip.record, v_set, trip.start_speed, trip.time)
        v_set += set_speed(model, case, wanted) - set_speed(model, case, mean)
        v_set = min(max(v_set, config.v_min), config.v_max)
    return best


def reference_profile(
    case: ReplayCase, vehicle: PointMass, schedule: Schedule, strongest: PointMass | None = None
) -> SpeedProfile:
    """Returns the plan over the route's stations every 10 m.

    Where the plan uses all of its power, which is the mean over a climb, the truck must give all of
    its own: less than the mean after a gear change, more later. `strongest` has the engine's
    greatest power; without it the plan is not changed.

    Between the plan's nodes its forces are held, on the heights that the truck drives. The run-in
    is that of the cruise, at the set speed, so that both drives start with the same state of engine
    and gearbox.
    """
    road = case.road
    count = round(road.length / _GRID)
    station = np.linspace(road.station[0], road.station[-1], count + 1)

    def height(at: FloatArray) -> FloatArray:
        return np.asarray(case.route.evaluate(case.origin + at).z)

    # Only the height above straight lines between the nodes counts: the datum may differ.
    above = height(station) - np.interp(station, road.station, height(road.station))
    fine = RoadProfile(
        station,
        np.interp(station, road.station, road.height) + above,
        _lower_limits(road, station),
        road.name,
    )
    speed = on_finer_road(vehicle, road, schedule.speed, fine, case.config.v_max)
    if strongest is not None:
        speed = with_all_power(vehicle, strongest, fine, speed, case.config.v_max)
    begin = case.origin + station[0]
    return SpeedProfile(
        np.concatenate([[begin - RUN_IN, begin - _ONSET], case.origin + station]),
        np.concatenate([[case.config.v_ref, case.config.v_ref], speed]),
    )


def climbing_power(record: Record) -> float | None:
    """Returns the mean engine power at full pedal and built-up torque [W]; None without climbs."""
    pulling = (record["pedal"] >= FLOORED) & (record["shift"] == 0.0)
    # Samples since the last one at which the engine did not pull.
    rows = np.arange(pulling.size)
    since = rows - np.maximum.accumulate(np.where(pulling, 0, rows))
    built_up = since * CONTROL_PERIOD > _TORQUE_TIME
    if np.count_nonzero(built_up) * CONTROL_PERIOD < _CLIMBING:
        return None
    return float(np.mean((record["engine_torque"] * record["engine_speed"])[built_up]))


def with_power_of(
    vehicle: PointMass, case: ReplayCase, record: Record, v_set: float, v_start: float, time: float
) -> PointMass:
    """Returns the point mass whose cruise takes as long as the driven one.

    Args:
      vehicle: with the engine's greatest power.
      case: road and cruise.
      record: of the driven cruise.
      v_set: its set speed [m/s].
      v_start: its speed at the road's beginning [m/s].
      time: its trip time [s].
    """
    built_up = climbing_power(record)
    if built_up is None:
        return vehicle
    high = min(built_up, vehicle.power_max)
    low = _LEAST_SHARE * high

    def with_power(power: float) -> PointMass:
        return dataclasses.replace(vehicle, power_max=power)

    return with_power(
        _bisect(
            low, high, lambda power: cruise_time(with_power(power), case, v_set, v_start) > time
        )
    )


def with_all_power(
    vehicle: PointMass, strongest: PointMass, road: RoadProfile, planned: FloatArray, v_max: float
) -> FloatArray:
    """Returns node speeds (n + 1,) [m/s] of a plan, raised where it uses all of its power.

    From the plan's speed at the beginning of such a stretch with the engine's greatest power, and
    back to the plan after its end by coasting. A stretch begins as much earlier as torque takes to
    build up, so that shorter breaks between two stretches are pulled through.

    Args:
      vehicle: of the plan.
      strongest: the same with the engine's greatest power.
      road: its profile.
      planned: node speeds (n + 1,) [m/s].
      v_max: of the band [m/s].
    """
    clock = passing_times(planned, road)[:-1]
    full = clock[vehicle.power(planned, road) >= _ALL * vehicle.power_max]
    next_full = np.append(full, np.inf)[np.searchsorted(full, clock)]
    raised = np.concatenate([[False], next_full - clock <= _TORQUE_TIME])
    cap = np.where(raised, np.maximum(np.minimum(road.v_limit, v_max), planned), planned) ** 2
    fastest = fastest_below(strongest, road, cap)
    coasting = np.sqrt(np.maximum(brakeable(strongest, road, fastest**2, 0.0), 0.0))
    return np.where(raised, np.maximum(planned, np.minimum(fastest, coasting)), planned)


def set_speed(vehicle: PointMass, case: ReplayCase, mean: float) -> float:
    """Returns the set speed at which the model's cruise has a mean speed, within the band [m/s]."""
    config, wanted = case.config, case.road.length / mean
    low = config.v_min if config.rolls else mean
    return _bisect(
        low, max(config.v_max, mean), lambda v: cruise_time(vehicle, case, v, v) > wanted
    )


def _bisect(low: float, high: float, too_low: Callable[[float], bool]) -> float:
    """Returns the least value that is not too low."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_low(middle) else (low, middle)
    return high


def cruise_time(vehicle: PointMass, case: ReplayCase, v_set: float, v_start: float) -> float:
    """Returns the trip time of the model's cruise [s]; inf if its power is too small."""
    try:
        speed = cruise(vehicle, case.road, v_set, min(v_set, v_start), top=case.top)
    except PlanningError:
        return math.inf
    return float(durations(speed, case.road).sum())


def _lower_limits(road: RoadProfile, station: FloatArray) -> FloatArray:
    """Returns the lower limit of the two nodes around each station [m/s]."""
    after = np.clip(np.searchsorted(road.station, station - 1e-6), 0, road.intervals)
    before = np.clip(np.searchsorted(road.station, station + 1e-6) - 1, 0, road.intervals)
    return np.asarray(np.minimum(road.v_limit[before], road.v_limit[after]))


def _driven(case: ReplayCase, profile: SpeedProfile | None, folder: Path | None) -> Record:
    path = None if folder is None else folder / _file_name(case, profile)
    if path is not None and path.is_file():
        return Record.load(path)
    start, end = case.first - RUN_IN + _START, case.last + RUN_OUT
    task = DriveTask(
        route=case.route,
        start=start,
        end=end,
        speed=case.config.v_ref,
        cruise_speed=case.config.v_ref,
        profile=profile,
        top=case.top,
        payload=case.payload,
        timestep=case.timestep,
        plant=case.plant,
        time_limit=_LATEST * (end - start) / case.config.v_ref,
    )
    if task.start < 0.0:
        raise InputError(f"{case.name}: the road must begin {RUN_IN:g} m before the first station")
    record = drive(task, case.parameters())
    if path is not None:
        record.save(path)
    return record


def _file_name(case: ReplayCase, profile: SpeedProfile | None) -> str:
    what: tuple[Any, ...] = (case.payload, case.timestep, case.overlay)
    what += (case.config.v_ref, case.first, case.last)
    what += (case.plant, case.truck)
    digest = hashlib.sha256(repr(what).encode())
    digest.update(case.route.table(10.0).tobytes())
    if profile is None:
        digest.update(repr(case.top).encode())
    else:
        digest.update(profile.station.tobytes() + profile.speed.tobytes())
        if profile.transmission_mode is not None:
            digest.update(profile.transmission_mode.tobytes())
    kind = "cruise" if profile is None else "plan"
    plain = "".join(c if c.isalnum() else "_" for c in case.road.name)
    return f"{plain}_{kind}_{digest.hexdigest()[:12]}.npz"


def _node_speeds(case: ReplayCase, record: Record) -> FloatArray:
    station = record["station"] - case.origin
    return np.asarray(np.interp(case.road.station, station, record["speed"]))
