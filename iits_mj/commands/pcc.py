"""Plan a fuel-optimal speed profile and compare it with two cruises, each in equal time.

The first may roll to the top of the band downhill, as cruise controls do; the second brakes at its
set speed, as the paper's. The first saving is that of a fleet, the second reproduces the paper's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from controllers.pcc import PccConfig, RoadProfile
from iits_mj.commands.output import ResultOptions, finish, prepare_file, prepare_folder
from iits_mj.core import options as option_fields
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError, PlanningError
from iits_mj.core.options import option
from iits_mj.core.progress import Report, task
from iits_mj.core.results import Check, Results
from iits_mj.core.tables import write_table
from iits_mj.core.units import KMH
from iits_mj.parameters import AnyTruck, TruckParameters, truck_option
from iits_mj.road.route_choice import route_option
from iits_mj.simulation.parts import load_map
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.planning.pcc_accuracy import (
    ELEMENTS_MAX,
    EQUAL_TIME,
    FINE_STEP,
    PAPER_SECONDS,
    Elements,
    bound_checks,
    convergence_checks,
    element_checks,
    energy_checks,
    equal_times,
    finite_elements,
    panels,
    warm_up,
)
from iits_mj.validation.planning.pcc_atlas import atlas_results, compute_atlas
from iits_mj.validation.planning.pcc_case import (
    BRAKING,
    PAPER_SAVING_PERCENT,
    ROLLING,
    SolvedPlan,
    solve,
)
from iits_mj.validation.planning.pcc_joint import (
    INTERVALS_MAX,
    compare_jointly,
    joint_checks,
    plan_to_drive,
)
from iits_mj.validation.planning.pcc_replay import profile_case, route_case
from iits_mj.validation.planning.replay_drives import run_ahead
from iits_mj.validation.planning.speed_tracking import gear_changes

METHODS = ("distance", "hermite", "both")
# Shares of the time that have passed after each part, for the time left.
_SHARES = {"road": 0.15, "distance": 0.2, "elements": 0.75}


@dataclass(frozen=True, kw_only=True)
class Options(ResultOptions):
    """Flags of `iits-mj pcc`."""

    road: Path | None = option(
        None,
        help="map (.xodr, .osm, .net.xml) or CSV table (columns s_m, z_m); without it the built-in "
        "highway",
        positional=True,
        metavar="MAP_OR_PROFILE",
    )
    route: str | None = route_option()
    truck: AnyTruck | None = truck_option("truck to plan for")
    mass: float | None = option(
        None,
        help="gross mass; without it that of the truck with its greatest load",
        unit="kg",
        low=5_000.0,
        high=200_000.0,
        group="truck",
    )
    v_ref: float = option(
        72.0, help="set speed of the cruise", unit="km/h", low=10.0, high=130.0, group="decision"
    )
    v_min: float = option(
        45.0, help="lowest planned speed", unit="km/h", low=4.0, high=130.0, group="decision"
    )
    v_max: float = option(
        90.0,
        help="highest planned speed, to which the cruise may roll downhill; the EU's speed limiter "
        "holds heavy trucks at 90 km/h",
        unit="km/h",
        low=10.0,
        high=200.0,
        group="decision",
    )
    mean_speed: bool = option(
        False,
        help="take --v-ref as the mean speed of the cruise instead of its set speed",
        group="decision",
    )
    limits: bool = option(
        True, help="obey the map's speed limits and the limits in curves", group="road"
    )
    k_a: float = option(
        0.5,
        help="weight of acceleration squared; 0.5 is the paper's",
        low=0.0,
        high=100.0,
        group="decision",
    )
    step: float = option(
        50.0, help="distance between two grid points", unit="m", low=5.0, high=1_000.0, group="road"
    )
    start: float | None = option(
        None, help="first station; without it the road's first", unit="m", group="road"
    )
    length: float | None = option(
        None,
        help="length to plan; without it to the end of the road",
        unit="m",
        low=100.0,
        group="road",
    )
    method: str = option(
        "both",
        help="distance: optimize over distance; hermite: by the paper's Hermite finite elements in "
        "time; both: compare the two",
        choices=METHODS,
        group="decision",
    )
    profile: Path | None = option(
        None,
        help="table to write: planned speed over station, for 'iits-mj drive --speed-profile'",
        metavar="FILE.csv",
        group="output",
    )
    gears: bool = option(
        False,
        help="with --profile or --driven: plan gears and eco-roll with the speed; the truck drives "
        "in the planned gears",
        group="decision",
    )
    driven: bool = option(
        False,
        help="drive cruise and plan too, with the truck's gearbox, controllers and fuel meter, on "
        "its kinematic plant: the saving to expect",
    )

    atlas: bool = option(
        False,
        help="the savings on twelve roads, by mass, band and wind, instead of one road's plan",
        group="road",
    )
    every: bool = option(
        False, help="with --atlas: all 27 cells of a road, not the 7 around its middle"
    )
    roads: Path | None = option(
        None, help="with --atlas: folder with the roads that the package lacks", metavar="DIR"
    )
    runs: Path | None = option(
        None, help="with --atlas: folder that keeps finished cells", metavar="DIR"
    )

    minutes: float | None = option(
        None,
        help="with --atlas: time after which no further cell is begun",
        unit="min",
        low=0.0,
        high=10_000.0,
    )
    page: Path | None = option(
        None,
        help="with --atlas: page to write; picture and table lie beside it",
        metavar="FILE.md",
        group="output",
    )

    def __post_init__(self) -> None:
        option_fields.check(self)
        given = (self.roads, self.runs, self.minutes, self.page)
        if not self.atlas and (self.every or any(value is not None for value in given)):
            raise InputError(
                "--every, --roads, --runs, --minutes and --page belong to --atlas: give --atlas too"
            )
        if self.gears and not (self.profile or self.driven):
            raise InputError("--gears belongs to --profile or --driven: give one of them too")
        if self.gears and self.method == "hermite":
            raise InputError("--gears plans over distance: leave --method hermite out")
        if self.driven and not self.limits:
            raise InputError("--driven obeys the map's limits: leave --no-limits out")
        if self.page is not None and self.page.suffix != ".md":
            raise InputError(f"--page {str(self.page)!r} is not a Markdown file: name FILE.md")
        if not self.v_min <= self.v_ref <= self.v_max:
            raise InputError(
                f"band --v-min {self.v_min:g} km/h, --v-ref {self.v_ref:g} km/h, --v-max "
                f"{self.v_max:g} km/h: use v-min <= v-ref <= v-max"
            )


def run(options: Options) -> int:
    """Plans and shows the saving; returns the exit code."""
    if options.atlas:
        # The atlas has its own roads, masses and bands.
        return finish(options, lambda: _atlas(options))
    if options.profile is not None:
        prepare_folder(options.profile.parent, "profile")
    return finish(options, lambda: measure(options))


def _atlas(options: Options) -> Results:
    if options.page is not None:
        prepare_file(options.page, "--page")
    config = ValidateConfig(roads=options.roads, runs=options.runs)
    minutes = np.inf if options.minutes is None else options.minutes
    atlas = compute_atlas(config, every=options.every, minutes=minutes)
    if options.page is not None:
        # Load matplotlib only for pages.
        from iits_mj.validation.planning.atlas_page import write_page

        write_page(atlas, options.page)
    return atlas_results(atlas)


def measure(config: Options) -> Results:
    """Plans a speed profile and compares it with the cruise.

    Raises:
      InputError: the road or an option is not usable. MapError: the map cannot be read.
      PlanningError: no plan exists; the message has the reason.
    """
    with task("planning the speed", 1.0) as report:
        return _measured(config, report)


def _measured(config: Options, report: Report) -> Results:
    report(0.0, "reading the road")
    road = load_profile(config)
    settings = PccConfig(
        v_ref=config.v_ref * KMH,
        v_min=config.v_min * KMH,
        v_max=config.v_max * KMH,
        mean_speed=config.mean_speed,
        k_a=config.k_a,
    )
    warm_up(settings)
    parameters = TruckParameters.load(config.truck)
    mass = parameters.gross_mass() if config.mass is None else config.mass
    report(_SHARES["road"], "optimizing over distance")
    case = solve(road, settings, mass, parameters)
    braking = solve(road, replace(settings, rolls=False), mass, parameters)
    elements = Elements(None)
    if config.method != "distance":
        report(_SHARES["distance"], "finite elements")
        elements = finite_elements(case, ELEMENTS_MAX if config.method == "both" else np.inf)
        if config.method == "hermite" and elements.answer is None:
            raise PlanningError(elements.reason)
    report(_SHARES["elements"], "checking the plan")
    results = Results("pcc", checks=checks(case, braking, config, elements))
    if config.driven:
        results.checks += driven_checks(config, road, settings, mass, parameters)
    if config.profile is not None:
        speed, gears = case.solution.plan.speed, None
        if config.method == "hermite" and elements.answer is not None:
            speed = elements.answer.speed
        if config.gears:
            found = plan_to_drive(case)
            speed, gears = found.speed, found.gear
        write_profile(road, speed, case.solution.baseline.speed, config.profile, gears)
    results.figures["speed plan"] = panels(case, elements)
    results.notes = [
        f"road {road.name}: {road.length / 1e3:.2f} km, grades {100 * road.grade.min():+.1f} to "
        f"{100 * road.grade.max():+.1f} %, {road.intervals} intervals of {road.step:g} m",
        f"band {config.v_min:g} to {config.v_max:g} km/h, {mass:.0f} kg; the cruises have the same "
        f"engine, brakes and limits; the rolling one has a set speed of "
        f"{case.solution.v_set / KMH:.1f} km/h, the braking one {braking.solution.v_set / KMH:.1f}",
        "speed, gear and eco-roll planned together: by the engine's map in the plan's gears, "
        "against the rolling cruise in its best gears; the reference is the plan of speed alone in "
        "its best gears",
        "the saving against the rolling cruise is what a fleet gains: cruise controls of today's "
        "trucks roll above their set speed downhill. The plan of each comparison takes the trip "
        "time of its cruise",
        f"{PAPER_SAVING_PERCENT} % and 60 s are the paper's figures for its own road and solver, "
        "against a cruise that brakes at its set speed; most of that saving is the energy that "
        "this cruise loses in the brakes",
    ]
    if not equal_times(case):
        results.notes.append(
            "no plan within the band takes as long as the cruise, so the saving is not at equal "
            f"time; use a --v-min below {config.v_min:g} km/h"
        )
    if not config.limits and not np.isfinite(road.v_limit).any() and _is_table(config):
        results.notes.append("a CSV road has no speed limits: --no-limits changes nothing")
    if elements.reason:
        results.notes.append(elements.reason)
    return results


def driven_checks(
    config: Options,
    road: RoadProfile,
    settings: PccConfig,
    mass: float,
    parameters: TruckParameters,
) -> list[Check]:
    """Returns the figures of cruise and plan as the truck drives them on its kinematic plant.

    Raises:
      InputError: the mass is none of the truck's, or the route is too short. PlanningError: there
        is no plan.
    """
    payload = mass - parameters.gross_mass(0.0)
    if config.road is not None and _is_table(config):
        case = profile_case(road.name, road, road, settings, payload)
    else:
        route, start = load_map(config.road).route(along=config.route), config.start or 0.0
        case = route_case(
            road.name,
            route,
            settings,
            payload,
            start=start,
            length=config.length,
            step=config.step,
        )
    driven = run_ahead(replace(case, truck=config.truck, joint=config.gears))
    plan, base = driven.plan, driven.cruise
    what = "speed and gear" if config.gears else "speed alone"
    return [
        Check(f"driven: saving, {ROLLING}, {what}, fuel meter", 100.0 * driven.saving, "%"),
        Check("driven: fuel of the plan", plan.fuel, "kg"),
        Check("driven: fuel of the rolling cruise", base.fuel, "kg"),
        Check("driven: trip time of the plan over the cruise's", plan.time / base.time, "1", 1.0),
        Check(
            "driven: changes of gear of the plan",
            gear_changes(plan.record),
            "1",
            float(gear_changes(base.record)),
        ),
    ]


def load_profile(config: Options) -> RoadProfile:
    """Returns the requested road: a CSV table by its suffix, else a route on a map."""
    if config.road is not None and _is_table(config):
        if config.route is not None:
            raise InputError(f"--route is for maps; {config.road} is a table of one road")
        return RoadProfile.from_csv(config.road, config.step, config.length, config.start)
    route = load_map(config.road).route(along=config.route)
    start = 0.0 if config.start is None else config.start
    road = RoadProfile.from_route(route, start, config.length, config.step)
    if config.limits:
        return road
    free = np.full(road.station.size, np.inf)
    return RoadProfile(road.station, road.height, free, road.name)


def _is_table(config: Options) -> bool:
    return config.road is not None and config.road.suffix.lower() == ".csv"


def checks(
    case: SolvedPlan, braking: SolvedPlan, config: Options, elements: Elements
) -> list[Check]:
    """Returns the figures; equal time and end speed have bounds, savings have none.

    Args:
      case: the plan against the rolling cruise.
      braking: the plan against the braking cruise.
      config: of the command.
      elements: the finite elements of `case`.
    """
    solution = case.solution
    plan, base, paper = solution.plan, solution.baseline, braking.solution
    rows = [
        Check(f"saving, {ROLLING}, engine map with gears", solution.map_saving_percent, "%"),
        Check(f"saving, {ROLLING}, optimizer's fuel model", solution.saving_percent, "%"),
        Check(
            f"saving, {BRAKING}, engine map with gears",
            paper.map_saving_percent,
            "%",
            PAPER_SAVING_PERCENT,
        ),
        Check(
            f"saving, {BRAKING}, optimizer's fuel model",
            paper.saving_percent,
            "%",
            PAPER_SAVING_PERCENT,
        ),
        Check("fuel of the plan, engine map", float(plan.map_fuel.sum()), "kg"),
        Check("fuel of the rolling cruise, engine map", float(base.map_fuel.sum()), "kg"),
        Check(
            "trip time of the plan over the cruise's",
            plan.time / base.time,
            "1",
            1.0,
            f"{1.0 - EQUAL_TIME:g} .. {1.0 + EQUAL_TIME:g}",
        ),
        Check("mean speed", solution.road.length / plan.time / KMH, "km/h"),
        Check(
            "end speed difference",
            abs(float(plan.speed[-1] - base.speed[-1])),
            "m/s",
            0.0,
            "<= 0.001",
        ),
        Check("price of a second of trip time", 1e3 * solution.time_price, "g/s"),
        Check("fit of the fuel model, rms", 100.0 * case.vehicle.fuel.error, "%", None, "<= 3"),
        *energy_checks(case),
    ]
    rows += bound_checks(case, gap_max=1.0)
    if case.road.intervals <= INTERVALS_MAX:
        rows += joint_checks(compare_jointly(case))
    if config.step > FINE_STEP:
        # The same stretch: the coarse grid ends at its last whole step.
        start, length = float(case.road.station[0]), case.road.length
        fine = load_profile(replace(config, step=FINE_STEP, start=start, length=length))
        rows += convergence_checks(case, fine)
    rows += element_checks(case, elements)
    seconds = solution.optimum.solve_time
    return [*rows, Check("plan: set-up and solve", seconds, "s", PAPER_SECONDS)]


def write_profile(
    road: RoadProfile,
    speed: FloatArray,
    cruise: FloatArray,
    path: Path,
    gears: NDArray[np.int64] | None = None,
) -> None:
    """Writes planned and cruise speed [m/s] at the nodes as CSV with units in the header.

    `gears` are those of the intervals, 0 in neutral; the last node repeats the last one.
    """
    names: tuple[str, ...] = ("station_m", "height_m", "speed_mps", "cruise_speed_mps")
    rows = zip(road.station, road.height, speed, cruise, strict=True)
    texts = [[f"{value:.4f}" for value in row] for row in rows]
    if gears is not None:
        names = (*names, "gear")
        texts = [[*row, str(gear)] for row, gear in zip(texts, [*gears, gears[-1]], strict=True)]
    write_table(path, names, (dict(zip(names, row, strict=True)) for row in texts), "speeds")
