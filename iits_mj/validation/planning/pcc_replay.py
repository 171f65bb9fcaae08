"""The fuel-optimal plan on the MuJoCo truck: its saving with gears and brakes, on several roads.

The ordinary planner and tracker drive plan and cruise; the truck's meter gives the fuel. Each road
is driven with two cruises: one may roll to the top of the band downhill, the paper's brakes at its
set speed. The plan takes the time of its cruise. Trip times agree within 0.1 %, speeds at the end
nearly. The remaining differences are corrected by their price and worth in the plan's own optimum;
the saving without the correction is reported as well.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

from controllers.pcc.joint import gears_at
from controllers.pcc.planner import FuelMap, PccConfig, evaluate
from controllers.pcc.profile import RoadProfile
from controllers.pcc.vehicle import PointMass, cruise, durations
from controllers.planning.speed_plan import SpeedConfig
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.results import Findings, Line, Panel, Results
from iits_mj.core.timing import CONTROL_PERIOD, TIMESTEP
from iits_mj.core.units import KMH
from iits_mj.road import RoadMap, Route
from iits_mj.road.measured import Lanes, measured_route
from iits_mj.validation.harness.config import (
    CYCLE_55,
    CYCLE_65,
    PAPER_ROAD,
    ValidateConfig,
    find_road,
    laden,
)
from iits_mj.validation.harness.run_cache import runs_folder
from iits_mj.validation.planning import closed_loop, replay_drives, speed_tracking
from iits_mj.validation.planning.pcc_case import PAPER_SAVING_PERCENT
from iits_mj.validation.planning.pcc_roads import read_cycle
from iits_mj.validation.planning.pcc_savings import BAND, MPH, PAPER_LENGTH, STEP
from iits_mj.validation.planning.replay_drives import (
    DRIVES,
    RUN_IN,
    RUN_OUT,
    CruiseAndPlan,
    ReplayCase,
    joint_task,
    reference_profile,
)

_QUICK_LENGTH, _QUICK_STEP = 300.0, 0.005
# Allowed errors of the drive ahead: saving [points], trip times of cruise and plan [%].
_EXPECTED_POINTS, _CRUISE_TIME, _PLAN_TIME = 1.0, 1.0, 3.0
_PART = "pcc-replay"
_PLOT_ROWS = 25
# Limit without a speed limiter: 100 km/h for trucks on Chinese expressways such as the paper's road
# (regulation on the road traffic safety law, article 78).
_CHINA = 100.0 * KMH
# Gear choice by load and for power: a second is worth far more than fuel. With the published shift
# speeds the truck has 50 kW less on climbs, so that a mean of 72 km/h needs a set speed near the
# band's end.
_FOR_POWER = {
    "gearbox": {
        "shift_strategy": "adaptive",
        "shifting": {"adaptive_climb_speed": 0.92, "adaptive_time_price": 1.0},
    }
}
# On the cycles: 5 mph above and 15 mph below the cycle's speed.
_ABOVE, _BELOW = 5.0 * MPH, 15.0 * MPH
# Length of a route after the measured stretch: the planner stops before a visible road end [m].
_LEFT = 600.0
# Speed limit of the route of a road profile: the limits of the plan apply instead [m/s].
_UNLIMITED = 40.0


def run_replay(config: ValidateConfig) -> Results:
    """Drives every road of the form and compares plan and cruise."""
    results = Results("planning replay")
    modules = (sys.modules[__name__], replay_drives, closed_loop)
    folder = runs_folder(config, _PART, *modules)
    cases = [valley_case(_QUICK_LENGTH, _QUICK_STEP)] if config.quick else full_cases(config)
    known: dict[tuple[float, str], PointMass] = {}
    for case in cases:
        truck = case.payload, repr(case.overlay)
        drives, guess = 1 if config.quick else DRIVES, known.get(truck)
        ahead = None if config.quick else replay_drives.run_ahead(case, folder, known=guess)
        replay = replay_drives.run(case, folder, drives, guess)
        known.setdefault(truck, replay.vehicle)
        found = Findings(title(case), panels=panels(replay), notes=[note(replay)])
        check_drives(found, replay, equal=not config.quick)
        if ahead is not None:
            explain(found, replay)
            check_expected(found, replay, ahead)
        results.add(title(case), found)
    if not config.quick and config.roads is None:
        results.notes.append("the paper's road and the cycles are driven with --roads DIR only")
    return results


def full_cases(config: ValidateConfig) -> list[ReplayCase]:
    """Returns the cases of the full form whose files exist, the paper's road first.

    Each comes with the rolling and with the braking cruise, and with the rolling one again with
    gears and eco-roll planned too. Against the braking cruise the paper's saving must be reached
    with gears by load: at 72 km/h mean within the limit of Chinese law, and at 72 km/h set within
    the speed limiter. The other cases show the effect of the band and of gear changes at the
    published speeds. A payload in the configuration selects the cases with that load.
    """
    mean = dataclasses.replace(BAND, mean_speed=True)
    wide = dataclasses.replace(mean, v_max=_CHINA)
    cases = [
        paper_case(config, wide, by_load=True, must=True),
        paper_case(config, by_load=True, must=True),
        paper_case(config, mean, by_load=True),
        paper_case(config),
        paper_case(config, wide),
        paper_case(config, payload=0.0),
        highway_case(),
        cycle_case(config, CYCLE_55),
        cycle_case(config, CYCLE_65),
    ]
    step = TIMESTEP if config.timestep is None else config.timestep
    driven = [
        dataclasses.replace(
            case,
            timestep=step,
            config=dataclasses.replace(case.config, rolls=rolls),
            paper=case.paper and not rolls,
        )
        for case in cases
        for rolls in (True, False)
        if case is not None and config.payload in (None, case.payload)
    ]
    joint = [dataclasses.replace(case, joint=True) for case in driven if case.config.rolls]
    return driven + joint


def paper_case(
    config: ValidateConfig,
    settings: PccConfig = BAND,
    payload: float | None = None,
    by_load: bool = False,
    must: bool = False,
) -> ReplayCase | None:
    """Returns the paper's road at a set or a mean speed; None without its file.

    Args:
      config: with the folder of roads.
      settings: speeds and band.
      payload: [kg]; default: the greatest.
      by_load: gears by load and for power, not by the published shift speeds.
      must: whether the paper's saving must be reached.
    """
    path = find_road(config, PAPER_ROAD)
    if path is None:
        return None
    road = RoadProfile.from_csv(path, STEP, PAPER_LENGTH)
    # The truck drives the measured heights every 10 m, the planner sees every fifth.
    fine = RoadProfile.from_csv(path, 10.0, PAPER_LENGTH + 200.0)
    kind = "mean" if settings.mean_speed else "set"
    speeds = f"{settings.v_ref / KMH:.0f} km/h {kind}, up to {settings.v_max / KMH:.0f}"
    name = f"the paper's road, {speeds}" + (", gears by load" if by_load else "")
    case = profile_case(name, road, fine, settings, laden() if payload is None else payload)
    return dataclasses.replace(case, overlay=_FOR_POWER if by_load else {}, paper=must)


def cycle_case(config: ValidateConfig, name: str) -> ReplayCase | None:
    """Returns a certification cycle's grades at the cycle's own speed; None without the file."""
    path = find_road(config, name)
    if path is None:
        return None
    cycle = read_cycle(path, STEP)
    settings = PccConfig(v_ref=cycle.speed, v_min=cycle.speed - _BELOW, v_max=cycle.speed + _ABOVE)
    words = {CYCLE_55: "EPA GEM 55 mph", CYCLE_65: "EPA GEM 65 mph"}.get(name, name)
    return profile_case(words, cycle.road, cycle.road, settings, laden())


def highway_case(length: float | None = None) -> ReplayCase:
    """Returns the built-in highway with its limits and curves, set speed 72 km/h."""
    return route_case("our highway", RoadMap.builtin().route(), BAND, laden(), length=length)


def route_case(
    name: str,
    route: Route,
    settings: PccConfig,
    payload: float,
    *,
    start: float = 0.0,
    length: float | None = None,
    step: float = STEP,
) -> ReplayCase:
    """Returns a route with its limits and curves, without its first 300 m and its last 600 m.

    Args:
      name: for reports.
      route: on its map.
      settings: speeds and band.
      payload: [kg].
      start: first station, moved to the end of the run-in [m].
      length: default: up to the last 600 m [m].
      step: distance between two grid points [m].

    Raises:
      InputError: nothing is left of the route.
    """
    first = max(start, RUN_IN)
    left = route.length - first - _LEFT
    if left < step:
        raise InputError(
            f"{name} is too short to be driven: {route.length:g} m, of which {RUN_IN:g} m are the "
            f"run-in and {_LEFT:g} m follow"
        )
    wanted = left if length is None else min(length, left)
    road = RoadProfile.from_route(
        route, first, wanted, step, lateral_acceleration=SpeedConfig.curve_acceleration
    )
    return ReplayCase(name, route, road, 0.0, settings, payload)


def valley_case(length: float, timestep: float, depth: float = 0.04) -> ReplayCase:
    """Returns a road that first falls and then rises, for the quick form."""
    fine = np.arange(0.0, length + 1.0, 10.0)
    height = -depth * (length - fine) * fine / length
    road = RoadProfile.from_heights(fine, height, STEP, name="valley")
    return profile_case("a valley", road, road, BAND, 0.0, timestep)


def profile_case(
    name: str,
    road: RoadProfile,
    fine: RoadProfile,
    settings: PccConfig,
    payload: float,
    timestep: float = TIMESTEP,
) -> ReplayCase:
    """Returns a straight road with these heights, extended on its first and last grade.

    Args:
      name: for reports.
      road: what the planner sees.
      fine: heights that the truck drives.
      settings: speeds and band.
      payload: [kg].
      timestep: of the physics [s].
    """
    before = np.arange(-RUN_IN, -1e-6, fine.step)
    after = np.arange(fine.step, RUN_OUT + _LEFT, fine.step)
    first, last = float(fine.grade[0]), float(fine.grade[-1])
    station = fine.station - fine.station[0]
    height = np.concatenate(
        [fine.height[0] + first * before, fine.height, fine.height[-1] + last * after]
    )
    stations = np.concatenate([before, station, station[-1] + after])
    lanes = Lanes(speed_limit=_UNLIMITED)
    route = measured_route(stations, height, lanes=lanes, name=Path(road.name).stem)
    return ReplayCase(
        name, route, road, RUN_IN - float(road.station[0]), settings, payload, timestep
    )


def title(case: ReplayCase) -> str:
    """Returns name of the road, gross mass and kind of the cruise."""
    mass = case.parameters().gross_mass(case.payload)
    kind = "rolling" if case.config.rolls else "braking"
    joint = ", gears planned" if case.joint else ""
    return f"{case.name}, {mass / 1e3:.0f} t, {kind} cruise{joint}"


def check_drives(found: Findings, replay: CruiseAndPlan, *, equal: bool) -> None:
    """Adds the figures of both drives of a road.

    Fuel and trip times are compared only if `equal`: a single drive of the plan does not make the
    trip times agree.
    """
    base, plan = replay.cruise, replay.plan
    record = plan.record
    reference = reference_profile(replay.case, replay.vehicle, replay.schedule, replay.vehicle_max)
    wanted = np.interp(record["station"], reference.station, reference.speed)
    distortion = _rms((record["planned"] - wanted)[speed_tracking.within_power(record)])
    if equal:
        saving, paper = "saving on the truck", PAPER_SAVING_PERCENT
        bound = (paper, f">= {paper}") if replay.case.paper else (None, "")
        by_map = replay.model_plan.map_fuel.sum() / replay.model_cruise.map_fuel.sum()
        found.check(saving, 100.0 * replay.saving, "%", *bound)
        found.check(f"{saving}, by the meter alone", 100.0 * replay.raw_saving, "%")
        found.check(
            "saving by the planner's map, for the driven speeds", 100.0 * (1.0 - by_map), "%"
        )
    late, faster = 100.0 * (plan.time / base.time - 1.0), plan.end_speed - base.end_speed
    error = _rms(speed_tracking.tracking_error(record))
    found.check("trip time of the plan against the cruise's", late, "%", 0.0, "-0.1 .. 0.1" * equal)
    found.check(
        "end speed of the plan less the cruise's", faster, "m/s", 0.0, "-0.5 .. 0.5" * equal
    )
    found.check("speed error where power suffices, rms", error, "m/s", 0.0, "<= 0.3")
    found.check("trajectory against the profile there, rms", distortion, "m/s")
    for kind, drive in (("cruise", base), ("plan", plan)):
        record, gained = drive.record, speed_tracking.gained
        for label, value, unit in (
            ("fuel", drive.fuel, "kg"),
            ("gear changes", speed_tracking.gear_changes(record), "1"),
            ("time at full load", 100.0 * speed_tracking.full_load_share(record), "%"),
            ("friction work", gained(record, "brake_work") / 1e6, "MJ"),
            ("retarder work", gained(record, "retarder_work") / 1e6, "MJ"),
            ("pedal and brake take turns", speed_tracking.reversals_per_km(record), "1/km"),
        ):
            found.check(f"{label}, {kind}", value, unit)


def explain(found: Findings, replay: CruiseAndPlan) -> None:
    """Adds the differences of the planner's point mass and the truck at the same speeds."""
    for kind, drive, model in (
        ("cruise", replay.cruise, replay.model_cruise),
        ("plan", replay.plan, replay.model_plan),
    ):
        record = drive.record
        power = record["engine_torque"] * record["engine_speed"]
        work = float(np.maximum(power, 0.0).sum()) * CONTROL_PERIOD
        times = durations(model.speed, replay.case.road)
        planned = float((np.maximum(model.power, 0.0) * times).sum())
        fuel = float(model.map_fuel.sum())
        found.check(f"fuel of the truck over the map's, {kind}", drive.fuel / fuel, "1", 1.0)
        found.check(f"of it more engine work, {kind}", work / planned, "1", 1.0)
        per_work = drive.fuel / fuel * planned / work
        found.check(f"of it more fuel a work, {kind}", per_work, "1", 1.0)
    share = replay.vehicle.power_max / replay.vehicle_max.power_max
    found.check("power on climbs over the engine's greatest", share, "1")


def saving_by_map(replay: CruiseAndPlan) -> float:
    """Returns the saving by the engine's map at the planned speeds [%], without a drive.

    Cruise and plan have one mean power on climbs. The price of a second corrects the fuel to equal
    trip times.
    """
    case, vehicle, schedule = replay.case, replay.vehicle, replay.schedule
    fuel_map = FuelMap(case.parameters())
    start = min(case.config.v_ref, replay.cruise.start_speed)
    steady = cruise(vehicle, case.road, case.config.v_ref, start, top=case.top)
    base = evaluate(vehicle, fuel_map, case.road, steady)
    plan = evaluate(vehicle, fuel_map, case.road, schedule.speed)
    burnt = [float(found.map_fuel.sum()) for found in (base, plan)]
    if replay.gears is not None:
        ends = float(schedule.speed[0]), float(schedule.speed[-1])
        task = joint_task(case, replay.vehicle_max, ends).at_price(max(schedule.price, 0.0))
        burnt = [float(found.fuel.sum()) for found in (gears_at(task, steady), replay.gears)]
    fuel = burnt[1] + schedule.price * (plan.time - base.time)
    return 100.0 * (1.0 - fuel / burnt[0])


def check_expected(found: Findings, replay: CruiseAndPlan, ahead: CruiseAndPlan) -> None:
    """Adds saving and trip times of the drives ahead beside those of the full truck."""
    saved, driven = 100.0 * ahead.saving, 100.0 * replay.saving
    points = f"-{_EXPECTED_POINTS:g} .. {_EXPECTED_POINTS:g}"
    found.check("saving expected by the drive ahead", saved, "%", driven)
    found.check("that less the driven", saved - driven, "%", 0.0, points)
    for kind, model, drive, most in (
        ("cruise", ahead.cruise, replay.cruise, _CRUISE_TIME),
        ("plan", ahead.plan, replay.plan, _PLAN_TIME),
    ):
        apart = 100.0 * (model.time / drive.time - 1.0)
        name = f"trip time of its {kind} against the driven"
        found.check(name, apart, "%", 0.0, f"-{most:g} .. {most:g}")
    found.check("saving by the planner's map alone", saving_by_map(replay), "%", driven)


def note(replay: CruiseAndPlan) -> str:
    """Returns a sentence with band, speeds and fuels."""
    config, case = replay.case.config, replay.case
    mean = case.road.length / replay.cruise.time
    return (
        f"{title(case)}: set speed {config.v_ref / KMH:.0f} km/h, mean {mean / KMH:.1f} km/h, band "
        f"{config.v_min / KMH:.0f} to {config.v_max / KMH:.0f} km/h; {replay.cruise.fuel:.3f} kg "
        f"against {replay.plan.fuel:.3f} kg; {-1e3 * replay.speed_worth:+.1f} g for the speeds at "
        f"the ends, {1e3 * replay.time_worth:+.1f} g for the trip time"
    )


def panels(replay: CruiseAndPlan) -> list[Panel]:
    """Returns panels of planned and driven speed, gear, power and fuel over station."""
    case = replay.case
    reference = reference_profile(case, replay.vehicle, replay.schedule, replay.vehicle_max)
    lines: list[list[Line]] = [[], [], [], []]
    for label, record, role in (
        ("cruise", replay.cruise.record, "reference"),
        ("plan", replay.plan.record, "simulation"),
    ):
        x = (record["station"][::_PLOT_ROWS] - case.origin) / 1e3
        power = record["engine_torque"] * record["engine_speed"]
        values = (
            record["speed"] / KMH,
            record["gear"],
            power / 1e3,
            1e3 * (record["fuel_used"] - record["fuel_used"][0]),
        )
        for curves, value in zip(lines, values, strict=True):
            curves.append(Line(label, x, value[::_PLOT_ROWS], role))
    station = (reference.station - case.origin) / 1e3
    lines[0].append(Line("profile", station, reference.speed / KMH))
    names = (
        ("Speed", "speed [km/h]"),
        ("Gear", "gear [-]"),
        ("Engine power", "power [kW]"),
        ("Fuel by the truck's meter", "fuel [g]"),
    )
    return [
        Panel(name, "station [km]", y_label, tuple(curves))
        for (name, y_label), curves in zip(names, lines, strict=True)
    ]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
