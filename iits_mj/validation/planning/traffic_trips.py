"""Trips of the full stack in traffic, with predictive cruise control and with a constant speed.

Both trips of a pair have the same seed. The cruise is driven first. PCC gets its arrival time and
its end speed, and knows nothing else of that trip.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.pcc import Appointment, PccConfig, PccReference, RecedingConfig
from controllers.pcc.fuel import FuelMap
from controllers.pcc.planner import make_vehicle
from controllers.pcc.schedule import level_worth
from controllers.stack import Stack
from iits_mj.core import tables
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, Observer, Simulation
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.parts import make_stack, pcc_config
from iits_mj.truck import Truck
from iits_mj.validation.harness.run_cache import drive_digest
from iits_mj.validation.planning.pcc_case import GROSS_MASS

DENSITIES = ("dense", "medium", "sparse")
TRAFFIC_SPEED = 15.0  # [m/s], the faster of the paper's two
SPEED = 60.0 / 3.6  # [m/s], the paper's reference
LENGTH = 5_000.0  # [m]
# Successive seeds use successive thirds of the 15 km highway.
STARTS = (60.0, 4_960.0, 9_860.0)  # [m]
TIME_MAX = 1_200.0  # [s]
PLANNERS = ("cruise", "pcc")


@dataclass(frozen=True)
class TripRow:
    """One trip.

    Attributes:
      density, seed, planner: of the trip; length: [m].
      time: [s]; fuel: [kg]; end_speed: [m/s]; changes: of lanes.
      failed: 1 for a collision, a roll-over or a trip that did not end in time.
      closest: least gap to a vehicle ahead [m]; friction: time with friction brakes on [s].
      plans: of PCC, optimal; other_plans: kept, schedule or cruise.
      solve_p50, solve_p95: wall time of a solve [s], nan without.
      code: digest of the code of the drive.
    """

    density: str
    seed: int
    planner: str
    length: float
    time: float
    fuel: float
    end_speed: float
    changes: int
    failed: int
    closest: float
    friction: float
    plans: int
    other_plans: int
    solve_p50: float
    solve_p95: float
    code: str = ""

    @property
    def key(self) -> tuple[str, int, str, float]:
        """Key of the trip in a table."""
        return (self.density, self.seed, self.planner, self.length)


class _TripEnd(Observer):
    """Stops the drive at a station and measures time, fuel and speed there."""

    def __init__(self, station: float) -> None:
        self._station = station
        self.reached = False
        self.friction = 0.0

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        ego = frame.ego
        if frame.command.xbr_demand < 0.0:
            self.friction += self.period
        beyond = ego.station - self._station
        if beyond < 0.0 or self.reached:
            return
        # Interpolated back to the station, which was passed within the last 100 ms.
        ago = beyond / max(ego.speed, 0.1)
        self.time, self.speed = frame.time - ago, ego.speed - ego.acceleration * ago
        self.fuel = ego.fuel_used - ego.fuel_rate * ago
        self.reached = True
        simulation.stop("reached the end of the trip")


def drive_trip(
    density: str,
    seed: int,
    planner: str,
    cruise: TripRow | None = None,
    length: float = LENGTH,
) -> TripRow:
    """Drives one trip of the MuJoCo truck in SUMO traffic.

    Args:
      density: of the traffic.
      seed: of the traffic; it also selects the start of the trip.
      planner: one of `PLANNERS`.
      cruise: the trip whose arrival time and end speed PCC must meet; default: those of a cruise on
        an empty road.
      length: of the trip [m].
    """
    start = STARTS[seed % len(STARTS)]
    config = DriveConfig(
        density=density,
        traffic_speed=TRAFFIC_SPEED,
        traffic_mode="none" if density == "empty" else "inter",
        decision="mobil",
        speed=SPEED,
        start_speed=TRAFFIC_SPEED,
        start_station=start,
        duration=TIME_MAX,
        seed=seed,
        speed_planner="cruise",
    )
    end = _TripEnd(start + length)
    reference: PccReference | None = None
    appointment = Appointment(start + length)
    if cruise is not None:
        appointment = Appointment(start + length, cruise.time, cruise.end_speed)

    def driver(route: Route, truck: Truck) -> Stack:
        nonlocal reference
        if planner == "pcc":
            receding = RecedingConfig(time_limit=math.inf)
            settings = pcc_config(config)
            reference = PccReference(route, settings, truck.parameters, receding, appointment)
        return make_stack(config, route, truck.parameters, reference)

    with Simulation(config, driver=driver, visuals=False) as simulation:
        summary = simulation.run([end])
    report = None if reference is None else reference.report()
    solves = np.array(report.solve_time if report else [math.nan])
    optimal = report.plans.get("optimal", 0) if report else 0
    return TripRow(
        density,
        seed,
        planner,
        length,
        end.time if end.reached else summary.duration,
        end.fuel if end.reached else math.nan,
        end.speed if end.reached else math.nan,
        summary.lane_changes,
        int(summary.failed or not end.reached),
        summary.closest_gap,
        round(end.friction, 1),
        optimal,
        sum(report.plans.values()) - optimal if report else 0,
        float(np.median(solves)),
        float(np.quantile(solves, 0.95)),
        trip_code(),
    )


def trip_code() -> str:
    """Returns the digest of the code that drives these trips."""
    return drive_digest(sys.modules[__name__])


def drive_pair(density: str, seed: int, folder: Path | None = None) -> list[TripRow]:
    """Drives the cruise, and PCC with the arrival time of the cruise.

    Finished pairs of this code in the folder are not driven again; None keeps no pairs.

    Raises:
      InputError: a kept pair cannot be read, or the pair cannot be written.
    """
    kept = None if folder is None else folder / f"{density}-{seed}.csv"
    if kept is not None:
        rows = [row for row in read_rows(kept) if row.code == trip_code()]
        if [row.key for row in rows] == [(density, seed, name, LENGTH) for name in PLANNERS]:
            return rows
    cruise = drive_trip(density, seed, "cruise")
    rows = [cruise, drive_trip(density, seed, "pcc", None if cruise.failed else cruise)]
    if kept is not None:
        write_rows(kept, rows)
    return rows


def worth_of_energy() -> float:
    """Returns the fuel that kinetic energy saves later [kg/J], on the level at the set speed."""
    config, parameters = (
        PccConfig(v_ref=SPEED, v_min=0.75 * SPEED, v_max=25.0),
        TruckParameters.load(),
    )
    vehicle = make_vehicle(parameters, FuelMap(parameters), GROSS_MASS, config)
    return level_worth(vehicle, SPEED) / (0.5 * vehicle.inertial_mass)


def read_rows(path: Path) -> list[TripRow]:
    """Returns the trips of a CSV file; none when it does not exist.

    Raises:
      InputError: the file is not a table of trips.
    """
    return tables.read_rows(path, TripRow, "trips")


def write_rows(path: Path, rows: list[TripRow]) -> None:
    """Writes the trips as CSV, ordered by density, seed and planner.

    Raises:
      InputError: the file cannot be written.
    """
    ordered = sorted(rows, key=lambda row: (DENSITIES.index(row.density), row.seed, row.planner))
    tables.write_rows(path, TripRow, ordered, "trips")
