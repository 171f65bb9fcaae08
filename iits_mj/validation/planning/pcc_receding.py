"""The receding-horizon planner on the point mass: does it drive the plan of the whole trip?

The plant is the optimizer's own point mass that follows each plan for a second, so that what is
measured is what the short horizon costs, and nothing else. The MuJoCo truck follows in
`pcc_replay` and `planning_traffic`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.core.units import KMH
from iits_mj.parameters import TruckParameters
from iits_mj.road import RoadMap
from iits_mj.validation.harness.config import PAPER_ROAD, ValidateConfig, find_road

MASS = 55_000.0
STEP = 0.1  # [s] of the plant
FINE = 10.0  # [m], grid on which drives are compared
STALL = 0.1  # [m/s]: slower, the drive is over


@dataclass(frozen=True)
class FreeDrive:
    """A drive of the point mass; arrays over time.

    Attributes:
      station: [m]; speed: [m/s]; time: [s]; lag: behind the schedule [s].
      plan_time: CPU time of every plan that was optimized [s]; plans: number by status.
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
      planner: that is followed exactly.
      start: station [m].
      end: station [m].
      speed: at the start [m/s].
      period: between two plans [s].
      held: from and to station [m] where the truck is held to a speed [m/s], as by traffic that
        the planner does not hear of.
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
        # v^2 is linear between the nodes of a plan; the way of the step depends on its end speed.
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
    """Fuel [kg], time [s] and end speed [m/s] of a drive, on a grid of 10 m up to a station."""
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
    """Holds the receding drive against the offline optimum, on every road there is."""
    results = Results("validate planning receding")
    length = 4_000.0 if config.quick else None
    roads = [RoadProfile.from_route(RoadMap.builtin().route(), length=length)]
    paper = find_road(config, PAPER_ROAD)
    if paper is not None and not config.quick:
        roads.append(RoadProfile.from_csv(paper, length=15_000.0))
    for road in roads:
        _compare(results, road, config.quick)
    results.notes.append(
        f"receding horizon: point mass of {MASS:.0f} kg that follows each plan exactly, a plan a "
        "second over 5 km; fuel by the optimizer's model on a grid of 10 m, corrected for kinetic "
        "energy and trip time at the optimum's own prices"
    )
    return results


def _compare(results: Results, road: RoadProfile, quick: bool) -> None:
    parameters, settings = TruckParameters.load(), PccConfig(v_ref=20.0)
    solution = plan(road, parameters, MASS, settings)
    first, last = float(road.station[0]), float(road.station[-1])
    trip = Appointment(last, solution.plan.time, float(solution.plan.speed[-1]))
    planner = RecedingPlanner(
        road,
        parameters,
        MASS,
        settings,
        RecedingConfig(time_limit=math.inf, power_share=1.0, surplus=0.0, reserve=0.0),
        trip,
    )
    driven = drive(planner, first, last, float(solution.plan.speed[0]))
    vehicle = planner.vehicle
    end = last - FINE
    whole = fuel_on(vehicle, road, road.station, solution.plan.speed, end)
    found = fuel_on(vehicle, road, driven.station, driven.speed, end)
    energy = 0.5 * vehicle.inertial_mass * (found[2] ** 2 - whole[2] ** 2)
    worth = energy * vehicle.fuel.f1 / vehicle.efficiency
    fuel = found[0] - worth + (found[1] - whole[1]) * solution.time_price
    name = f"receding, {road.name}: "
    took = 1e3 * driven.plan_time
    others = sum(count for status, count in driven.plans.items() if status == "cruise")
    results.checks += [
        Check(
            name + "fuel over the offline optimum's",
            100.0 * (fuel / whole[0] - 1.0),
            "%",
            0.0,
            "<= 0.5",
        ),
        Check(name + "arrival, late by", found[1] - whole[1], "s", 0.0, "-1 .. 1"),
        Check(name + "plans without optimizer", float(others), "1", None, "<= 0"),
        Check(name + "CPU time of a plan, median", float(np.median(took)), "ms", None, "<= 15"),
        Check(name + "CPU time of a plan, 95 % within", float(np.quantile(took, 0.95)), "ms"),
    ]
    if quick:
        return
    hold = (first + 3_000.0, first + 4_000.0, 14.0)
    planner.reset()
    delayed = drive(planner, first, last, float(solution.plan.speed[0]), held=hold)
    late = fuel_on(vehicle, road, delayed.station, delayed.speed, end)[1] - whole[1]
    lost = float(np.nanmax(delayed.lag))
    results.checks.append(
        Check(
            name + f"arrival after {lost:.0f} s lost in 1 km at 50 km/h, late by",
            late,
            "s",
            0.0,
            "-3 .. 3",
        )
    )
    results.figures[f"receding, {road.name}"] = [
        Panel(
            "Speed",
            "station [km]",
            "speed [km/h]",
            (
                Line(
                    "plan of the whole trip",
                    road.station / 1e3,
                    solution.plan.speed / KMH,
                    "reference",
                ),
                Line("receding horizon", driven.station / 1e3, driven.speed / KMH, "simulation"),
                Line("held up on the way", delayed.station / 1e3, delayed.speed / KMH),
            ),
        ),
        Panel(
            "Lag behind the schedule",
            "station [km]",
            "lag [s]",
            (
                Line("receding horizon", driven.station / 1e3, driven.lag, "simulation"),
                Line("held up on the way", delayed.station / 1e3, delayed.lag),
            ),
        ),
    ]
