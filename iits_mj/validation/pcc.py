"""`iits-mj pcc`: a fuel-optimal speed profile beside the constant-speed cruise, in equal time."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from controllers.pcc import PccConfig, PccSolution, RoadProfile, plan
from iits_mj import options
from iits_mj.errors import InputError
from iits_mj.options import option
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel, Results
from iits_mj.road import RoadMap
from iits_mj.units import KMH

PAPER_SAVING_PERCENT = 21.68


@dataclass(frozen=True, kw_only=True)
class PccCommandConfig:
    """What road, what truck, what band."""

    road: Path | None = option(
        None,
        help="OpenDRIVE map, or CSV with columns s_m and z_m; without it the built-in highway",
        positional=True,
        metavar="MAP_OR_PROFILE",
    )
    mass: float = option(
        55_000.0, help="gross mass", unit="kg", low=5_000.0, high=80_000.0, metavar="KG"
    )
    v_ref: float = option(
        72.0, help="set speed of the cruise", unit="km/h", low=10.0, high=130.0, metavar="KMH"
    )
    v_min: float = option(
        45.0, help="least planned speed", unit="km/h", low=4.0, high=130.0, metavar="KMH"
    )
    v_max: float = option(
        85.0, help="greatest planned speed", unit="km/h", low=10.0, high=200.0, metavar="KMH"
    )
    mean_speed: bool = option(
        False, help="v-ref is the mean speed of the cruise instead of its set speed"
    )
    limits: bool = option(True, help="keep to the map's speed limits and curve speeds")
    k_a: float = option(0.5, help="weight of acceleration squared, as the paper's", low=0.0)
    step: float = option(50.0, help="grid", unit="m", low=5.0, high=1_000.0, metavar="M")
    start: float = option(0.0, help="first station of a map", unit="m", low=0.0, metavar="M")
    length: float | None = option(
        None, help="length to plan; without it to the end", unit="m", low=100.0, metavar="M"
    )
    profile: Path | None = option(
        None, help="file for the planned speed over station", metavar="FILE.csv"
    )

    def __post_init__(self) -> None:
        options.check(self)


def run(config: PccCommandConfig) -> Results:
    """Plans and compares.

    Raises:
      InputError: road file or numbers not usable.
      MapError: the map cannot be read.
      PlanningError: no plan exists; the message gives the reason.
    """
    road = load_profile(config)
    settings = PccConfig(
        v_ref=config.v_ref * KMH,
        v_min=config.v_min * KMH,
        v_max=config.v_max * KMH,
        mean_speed=config.mean_speed,
        k_a=config.k_a,
    )
    solution = plan(road, TruckParameters.load(), config.mass, settings)
    if config.profile is not None:
        write_profile(solution, config.profile)
    results = Results("pcc", checks=checks(solution))
    results.figures["speed plan"] = panels(solution)
    results.notes = [
        f"road {road.name}: {road.length / 1e3:.2f} km, grades {100 * road.grade.min():+.1f} to "
        f"{100 * road.grade.max():+.1f} %, {road.intervals} intervals of {road.step:g} m",
        f"band {config.v_min:g} to {config.v_max:g} km/h, {config.mass:.0f} kg; the cruise is held "
        f"to the same engine, brakes and limits, set speed {solution.v_set / KMH:.1f} km/h",
        f"{PAPER_SAVING_PERCENT} % and 60 s are the paper's figures for its own road and solver; "
        "the saving is what the cruise throws away in the brakes, so it depends on road and band",
    ]
    return results


def load_profile(config: PccCommandConfig) -> RoadProfile:
    """The road asked for: a CSV by its ending, else an OpenDRIVE map."""
    if config.road is not None and config.road.suffix.lower() == ".csv":
        return RoadProfile.from_csv(config.road, config.step, config.length)
    road_map = RoadMap.builtin() if config.road is None else RoadMap.from_opendrive(config.road)
    road = RoadProfile.from_route(road_map.route(), config.start, config.length, config.step)
    if config.limits:
        return road
    free = np.full(road.station.size, np.inf)
    return RoadProfile(road.station, road.height, free, road.name)


def checks(solution: PccSolution) -> list[Check]:
    """The figures; equal time and end speed are bounds, savings are information."""
    plan_, base = solution.plan, solution.baseline
    return [
        Check("saving, optimizer's fuel model", solution.saving_percent, "%", PAPER_SAVING_PERCENT),
        Check(
            "saving, engine map with gears", solution.map_saving_percent, "%", PAPER_SAVING_PERCENT
        ),
        Check("fuel of the plan, engine map", float(plan_.map_fuel.sum()), "kg"),
        Check("fuel of the cruise, engine map", float(base.map_fuel.sum()), "kg"),
        Check(
            "trip time of the plan over the cruise's", plan_.time / base.time, "1", 1.0, "<= 1.0001"
        ),
        Check("mean speed", solution.road.length / plan_.time / KMH, "km/h"),
        Check(
            "end speed difference",
            abs(float(plan_.speed[-1] - base.speed[-1])),
            "m/s",
            0.0,
            "<= 0.001",
        ),
        Check("price of a second of trip time", 1e3 * solution.time_price, "g/s"),
        Check("fit of the fuel model, rms", 100.0 * solution.willans.error, "%", None, "<= 3"),
        Check("solve time", solution.solve_time, "s", 60.0, "<= 6"),
        Check("time to set the problem up", solution.build_time, "s"),
    ]


def panels(solution: PccSolution) -> list[Panel]:
    """The paper's four panels: road, speed, engine power, accumulated fuel."""
    road = solution.road
    node = road.station / 1e3
    middle = 0.5 * (node[1:] + node[:-1])
    pair = (("cruise", solution.baseline, "reference"), ("plan", solution.plan, "simulation"))

    def lines(kind: str) -> tuple[Line, ...]:
        rows = []
        for label, drive, role in pair:
            if kind == "speed":
                rows.append(Line(label, node, drive.speed / KMH, role))
            elif kind == "power":
                rows.append(Line(label, middle, np.maximum(drive.power, 0.0) / 1e3, role))
            else:
                used = np.concatenate([[0.0], np.cumsum(drive.map_fuel)])
                rows.append(Line(label, node, 1e3 * used, role))
        return tuple(rows)

    return [
        Panel("Road", "station [km]", "height [m]", (Line("road", node, road.height),)),
        Panel("Speed", "station [km]", "speed [km/h]", lines("speed")),
        Panel("Engine power", "station [km]", "power [kW]", lines("power")),
        Panel("Accumulated fuel", "station [km]", "fuel [g]", lines("fuel")),
    ]


def write_profile(solution: PccSolution, path: Path) -> None:
    """Writes the planned speed as CSV with units in the header."""
    try:
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(["station_m", "height_m", "speed_mps", "cruise_speed_mps"])
            road = solution.road
            rows = zip(
                road.station,
                road.height,
                solution.plan.speed,
                solution.baseline.speed,
                strict=True,
            )
            writer.writerows([f"{value:.4f}" for value in row] for row in rows)
    except OSError as error:
        raise InputError(f"profile file {str(path)!r} cannot be written: {error}") from error
