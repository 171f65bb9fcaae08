"""The receding-horizon planner on the point mass, against the plan of the whole trip.

The optimizer's own point mass follows each plan for a second, so that the difference is the cost of
the short horizon alone. `pcc_replay` and `planning_traffic` use the MuJoCo truck.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from controllers.pcc import (
    Appointment,
    PccConfig,
    RecedingConfig,
    RecedingPlanner,
    RoadProfile,
    plan,
)
from controllers.pcc.vehicle import PointMass, durations
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap
from iits_mj.validation.harness.config import PAPER_ROAD, ValidateConfig, find_road
from iits_mj.validation.planning.pcc_case import GROSS_MASS

STEP = 0.1  # [s] of the plant
FINE = 10.0  # [m], grid on which drives are compared
STALL = 0.1  # [m/s]: below it the drive ends


@dataclass(frozen=True)
class FreeDrive:
    """A drive of the point mass; arrays over time.

    Attributes:
      station: [m]; speed: [m/s]; time: [s]; lag: behind the schedule [s].
      plan_time: CPU time of each optimized plan [s]; plans: number by status.
    """

    station: FloatArray
    speed: FloatArray
    time: FloatArray
    lag: FloatArray
    plan_time: FloatArray
    plans: dict[str, int]


def drive(
    planner: RecedingPlanner,
    start: float,
    end: float,
    speed: float,
    period: float = 1.0,
    held: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> FreeDrive:
    """Drives from start to end [m], planning once a period [s].

    Args:
      planner: its plans are followed exactly.
      start: station [m].
      end: station [m].
      speed: at the start [m/s].
      period: between two plans [s].
      held: first and last station [m] of a stretch, and the speed [m/s] to which traffic that the
        planner does not know holds the truck there.
    """
    station, time, next_plan = start, 0.0, 0.0
    rows, plan_time, plans = [], [], dict[str, int]()
    while station < end and speed > STALL:
        if time >= next_plan - 0.5 * STEP:
            began = process_time()
            found = planner.plan(station, speed, time)
            took = process_time() - began
            plans[found.status] = plans.get(found.status, 0) + 1
            if found.status == "optimal":
                plan_time.append(took)
            next_plan += period
        rows.append((station, speed, time, found.lag))
        profile = found.profile
        # v^2 is linear between nodes; the distance of a step depends on its end speed.
        after = speed
        for _ in range(2):
            ahead = station + 0.5 * (speed + after) * STEP
            after = math.sqrt(float(np.interp(ahead, profile.station, profile.speed**2)))
        if held[0] <= station < held[1]:
            after = max(min(after, held[2]), speed - STEP)
        station += 0.5 * (speed + after) * STEP
        speed, time = after, time + STEP
    rows.append((station, speed, time, found.lag))
    table = np.array(rows)
    return FreeDrive(table[:, 0], table[:, 1], table[:, 2], table[:, 3], np.array(plan_time), plans)


def fuel_on(
    vehicle: PointMass, road: RoadProfile, station: FloatArray, speed: FloatArray, end: float
) -> tuple[float, float, float]:
    """Returns fuel [kg], time [s] and end speed [m/s] of a drive up to a station, on 10 m."""
    first = float(road.station[0])
    count = math.floor((end - first) / FINE + 1e-6) + 1
    grid = np.asarray(first + FINE * np.arange(count), dtype=np.float64)
    fine = RoadProfile(
        grid, np.interp(grid, road.station, road.height), np.full(grid.size, np.inf), road.name
    )
    held = np.sqrt(np.interp(grid, station, speed**2))
    fuel, time = vehicle.fuel_of(held, fine), durations(held, fine)
    return float(fuel.sum()), float(time.sum()), float(held[-1])


def run_receding(config: ValidateConfig) -> Results:
    """Compares the receding drive with the offline optimum, on every available road."""
    results = Results("validate planning receding")
    length = 4_000.0 if config.quick else None
    roads = [RoadProfile.from_route(RoadMap.builtin().route(), length=length)]
    paper = find_road(config, PAPER_ROAD)
    if paper is not None and not config.quick:
        roads.append(RoadProfile.from_csv(paper, length=15_000.0))
    for road in roads:
        results.add(f"receding, {road.name}", _compare(road, config.quick))
    results.notes.append(
        f"receding horizon: point mass of {GROSS_MASS:.0f} kg that follows each plan exactly, a "
        "plan a second over 5 km; fuel by the optimizer's model on a grid of 10 m, corrected for "
        "kinetic energy and trip time at the optimum's own prices"
    )
    return results


def _compare(road: RoadProfile, quick: bool) -> Findings:
    found = Findings(f"receding, {road.name}")
    parameters, settings = TruckParameters.load(), PccConfig(v_ref=20.0)
    solution = plan(road, parameters, GROSS_MASS, settings)
    whole, first, last = solution.plan, float(road.station[0]), float(road.station[-1])
    start, end = float(whole.speed[0]), last - FINE
    trip = Appointment(last, whole.time, float(whole.speed[-1]))
    receding = RecedingConfig(time_limit=math.inf, power_share=1.0, surplus=0.0, reserve=0.0)
    planner = RecedingPlanner(road, parameters, GROSS_MASS, settings, receding, trip)
    vehicle = planner.vehicle
    driven = drive(planner, first, last, start)
    best_fuel, best_time, best_speed = fuel_on(vehicle, road, road.station, whole.speed, end)
    fuel, time, speed = fuel_on(vehicle, road, driven.station, driven.speed, end)
    energy = 0.5 * vehicle.inertial_mass * (speed**2 - best_speed**2)
    worth = energy * vehicle.fuel.f1 / vehicle.efficiency
    fuel = fuel - worth + (time - best_time) * solution.time_price
    took = 1e3 * driven.plan_time
    over = 100.0 * (fuel / best_fuel - 1.0)
    others = sum(count for status, count in driven.plans.items() if status == "cruise")
    found.check("fuel over the offline optimum's", over, "%", 0.0, "<= 0.5")
    found.check("arrival, late by", time - best_time, "s", 0.0, "-1 .. 1")
    found.check("plans without optimizer", others, "1", None, "<= 0")
    found.check("CPU time of a plan, median", np.median(took), "ms", None, "<= 15")
    found.check("CPU time of a plan, 95 % within", np.quantile(took, 0.95), "ms")
    geared = RecedingPlanner(
        road, parameters, GROSS_MASS, settings, replace(receding, gears=True), trip
    )
    took = 1e3 * drive(geared, first, last, start).plan_time
    name = "CPU time of a plan with gears and eco-roll"
    found.check(f"{name}, median", np.median(took), "ms", None, "<= 15")
    found.check(f"{name}, 95 % within", np.quantile(took, 0.95), "ms")
    if quick:
        return found
    planner.reset()
    delayed = drive(planner, first, last, start, held=(first + 3_000.0, first + 4_000.0, 14.0))
    late = fuel_on(vehicle, road, delayed.station, delayed.speed, end)[1] - best_time
    lost = float(np.nanmax(delayed.lag))
    name = f"arrival after {lost:.0f} s lost in 1 km at 50 km/h, late by"
    found.check(name, late, "s", 0.0, "-3 .. 3")
    drives = (("receding horizon", driven, "simulation"), ("held up on the way", delayed, ""))
    speeds = [Line("plan of the whole trip", road.station / 1e3, whole.speed / KMH, "reference")]
    speeds += [Line(label, d.station / 1e3, d.speed / KMH, role) for label, d, role in drives]
    lags = [Line(label, d.station / 1e3, d.lag, role) for label, d, role in drives]
    place = "station [km]"
    found.panels += [
        Panel("Speed", place, "speed [km/h]", tuple(speeds)),
        Panel("Lag behind the schedule", place, "lag [s]", tuple(lags)),
    ]
    return found
