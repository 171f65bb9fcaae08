"""The fuel-optimal plan on the MuJoCo truck: what is left of its saving with gears and brakes.

Plan and cruise are driven by the ordinary planner and tracker; fuel is the truck's own meter's.
Trip times agree within 0.1 %, speeds at the end nearly; what is left is corrected by its price and
its worth in the plan's own optimum, and the saving stands there without that, too.
"""

from __future__ import annotations

import sys

import numpy as np

from controllers.pcc.planner import FuelMap, evaluate
from controllers.pcc.vehicle import PointMass, cruise, durations
from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.core.timing import CONTROL_PERIOD
from iits_mj.core.units import KMH
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.harness.run_cache import runs_folder
from iits_mj.validation.planning import closed_loop, replay_drives, speed_tracking
from iits_mj.validation.planning import replay_drives as replay_match
from iits_mj.validation.planning.pcc_case import PAPER_SAVING_PERCENT
from iits_mj.validation.planning.replay_cases import full_cases, valley_case
from iits_mj.validation.planning.replay_drives import Case, Replay, Trip, reference_profile

_QUICK_LENGTH, _QUICK_STEP = 300.0, 0.005
# How far off the planner may be: saving [points], trip times of cruise and plan [%]. The plan leans
# on the power on climbs more than the cruise does from which that is known.
_EXPECTED_POINTS, _CRUISE_TIME, _PLAN_TIME = 1.0, 1.0, 3.0
_PART = "pcc-replay"
_PLOT_ROWS = 25


def run_replay(config: ValidateConfig) -> Results:
    """Drives every road of the form and compares plan and cruise."""
    results = Results("planning replay")
    drivers = (sys.modules[__name__], replay_drives, replay_match, closed_loop)
    folder = runs_folder(config, _PART, *drivers)
    cases = [valley_case(_QUICK_LENGTH, _QUICK_STEP)] if config.quick else full_cases(config)
    drives = 1 if config.quick else replay_drives.DRIVES
    known: dict[tuple[float, str], PointMass] = {}
    for case in cases:
        truck = case.payload, repr(case.overlay)
        replay = replay_drives.run(case, folder, drives, known.get(truck))
        known.setdefault(truck, replay.vehicle)
        results.checks += checks(replay, equal=not config.quick)
        if not config.quick:
            results.checks += explanation(replay)
        results.figures[title(case)] = panels(replay)
        results.notes.append(note(replay))
    if not config.quick and config.roads is None:
        results.notes.append("the paper's road and the cycles are driven with --roads DIR only")
    return results


def title(case: Case) -> str:
    """Road and mass in words."""
    mass = case.parameters().gross_mass(case.payload)
    return f"{case.name}, {mass / 1e3:.0f} t"


def checks(replay: Replay, *, equal: bool = True) -> list[Check]:
    """The figures of one road.

    Args:
      replay: both drives.
      equal: whether the trip times were made to agree; one drive of the plan is not enough.
    """
    cruise_, plan, name = replay.cruise, replay.plan, title(replay.case)
    road = plan.record
    reference = reference_profile(replay.case, replay.vehicle, replay.schedule, replay.vehicle_max)
    wanted = np.interp(road["station"], reference.station, reference.speed)
    follows = speed_tracking.within_power(road)
    distortion = _rms((road["planned"] - wanted)[follows])
    saving = f"{name}: saving on the truck"
    must = replay.case.paper
    savings = [
        Check(
            saving,
            100.0 * replay.saving,
            "%",
            PAPER_SAVING_PERCENT if must else None,
            f">= {PAPER_SAVING_PERCENT}" if must else "",
        ),
        Check(f"{saving}, by the meter alone", 100.0 * replay.raw_saving, "%"),
        Check(f"{name}: saving by the planner's map, for the driven speeds", _map(replay), "%"),
    ]
    return [
        # A few hundred metres, driven once, say nothing on fuel.
        *(savings if equal else []),
        Check(
            f"{name}: trip time of the plan against the cruise's",
            100.0 * (plan.time / cruise_.time - 1.0),
            "%",
            0.0,
            "-0.1 .. 0.1" if equal else "",
        ),
        Check(
            f"{name}: end speed of the plan less the cruise's",
            plan.end_speed - cruise_.end_speed,
            "m/s",
            0.0,
            "-0.5 .. 0.5" if equal else "",
        ),
        Check(f"{name}: speed error where power suffices, rms", _error(plan), "m/s", 0.0, "<= 0.3"),
        Check(f"{name}: trajectory against the profile there, rms", distortion, "m/s"),
        *(
            Check(f"{name}: {label}, {kind}", value, unit)
            for kind, trip in (("cruise", cruise_), ("plan", plan))
            for label, value, unit in _use(trip)
        ),
    ]


def explanation(replay: Replay) -> list[Check]:
    """Where the planner's point mass and the truck differ, on the same speeds."""
    name, rows = title(replay.case), []
    parts = (
        ("cruise", replay.cruise, replay.model_cruise),
        ("plan", replay.plan, replay.model_plan),
    )
    for kind, trip, model in parts:
        record = trip.record
        power = record["engine_torque"] * record["engine_speed"]
        work = float(np.maximum(power, 0.0).sum()) * CONTROL_PERIOD
        planned = float((np.maximum(model.power, 0.0) * _durations(replay, model.speed)).sum())
        fuel = float(model.map_fuel.sum())
        rows += [
            Check(f"{name}: fuel of the truck over the map's, {kind}", trip.fuel / fuel, "1", 1.0),
            Check(f"{name}: of it more engine work, {kind}", work / planned, "1", 1.0),
            Check(
                f"{name}: of it more fuel a work, {kind}",
                trip.fuel / fuel * planned / work,
                "1",
                1.0,
            ),
        ]
    greatest = replay.vehicle_max.power_max
    rows.append(
        Check(
            f"{name}: power on climbs over the engine's greatest",
            replay.vehicle.power_max / greatest,
            "1",
        )
    )
    return [*rows, *expected(replay)]


def expected(replay: Replay) -> list[Check]:
    """What the optimizer, told of the truck's power on climbs, expects of the same trip.

    The planned trip time was corrected by what the driven ones differed; its price makes it equal.
    """
    case, vehicle = replay.case, replay.vehicle
    fuel_map = FuelMap(case.parameters())
    start = min(case.config.v_ref, replay.cruise.start_speed)
    steady = cruise(vehicle, case.road, case.config.v_ref, start)
    base = evaluate(vehicle, fuel_map, case.road, steady)
    plan = evaluate(vehicle, fuel_map, case.road, replay.schedule.speed)
    fuel = float(plan.map_fuel.sum()) + replay.schedule.price * (plan.time - base.time)
    saved = 100.0 * (1.0 - fuel / float(base.map_fuel.sum()))
    name = title(case)
    points = f"-{_EXPECTED_POINTS:g} .. {_EXPECTED_POINTS:g}"
    return [
        Check(f"{name}: saving that the planner expected", saved, "%", 100.0 * replay.saving),
        Check(f"{name}: that less the driven", saved - 100.0 * replay.saving, "%", 0.0, points),
        *(
            Check(
                f"{name}: trip time of its {kind} against the driven",
                100.0 * (model.time / trip.time - 1.0),
                "%",
                0.0,
                f"-{most:g} .. {most:g}",
            )
            for kind, model, trip, most in (
                ("cruise", base, replay.cruise, _CRUISE_TIME),
                ("plan", plan, replay.plan, _PLAN_TIME),
            )
        ),
    ]


def note(replay: Replay) -> str:
    """Band, speeds and fuels in one sentence."""
    config, case = replay.case.config, replay.case
    mean = case.road.length / replay.cruise.time
    return (
        f"{title(case)}: set speed {config.v_ref / KMH:.0f} km/h, mean {mean / KMH:.1f} km/h, band "
        f"{config.v_min / KMH:.0f} to {config.v_max / KMH:.0f} km/h; {replay.cruise.fuel:.3f} kg "
        f"against {replay.plan.fuel:.3f} kg; {-1e3 * replay.speed_worth:+.1f} g for the speeds at "
        f"the ends, {1e3 * replay.time_worth:+.1f} g for the trip time"
    )


def panels(replay: Replay) -> list[Panel]:
    """Speed planned and driven, gear, power and fuel over station."""
    case = replay.case
    reference = reference_profile(case, replay.vehicle, replay.schedule, replay.vehicle_max)
    cruise_, plan = replay.cruise.record, replay.plan.record

    def lines(kind: str) -> tuple[Line, ...]:
        rows = []
        for label, record, role in (
            ("cruise", cruise_, "reference"),
            ("plan", plan, "simulation"),
        ):
            x = (record["station"][::_PLOT_ROWS] - case.origin) / 1e3
            rows.append(Line(label, x, _values(record, kind)[::_PLOT_ROWS], role))
        return tuple(rows)

    station = (reference.station - case.origin) / 1e3
    profile = Line("profile", station, reference.speed / KMH)
    place = "station [km]"
    return [
        Panel("Speed", place, "speed [km/h]", (*lines("speed"), profile)),
        Panel("Gear", place, "gear [-]", lines("gear")),
        Panel("Engine power", place, "power [kW]", lines("power")),
        Panel("Fuel by the truck's meter", place, "fuel [g]", lines("fuel")),
    ]


def _values(record: closed_loop.Record, kind: str) -> FloatArray:
    if kind == "speed":
        return record["speed"] / KMH
    if kind == "gear":
        return record["gear"]
    if kind == "power":
        return record["engine_torque"] * record["engine_speed"] / 1e3
    return 1e3 * (record["fuel_used"] - record["fuel_used"][0])


def _use(trip: Trip) -> list[tuple[str, float, str]]:
    record = trip.record
    return [
        ("fuel", trip.fuel, "kg"),
        ("gear changes", float(speed_tracking.gear_changes(record)), "1"),
        ("time at full load", 100.0 * speed_tracking.full_load_share(record), "%"),
        ("friction work", speed_tracking.gained(record, "brake_work") / 1e6, "MJ"),
        ("retarder work", speed_tracking.gained(record, "retarder_work") / 1e6, "MJ"),
        ("pedal and brake take turns", speed_tracking.reversals_per_km(record), "1/km"),
    ]


def _map(replay: Replay) -> float:
    plan, base = replay.model_plan.map_fuel.sum(), replay.model_cruise.map_fuel.sum()
    return 100.0 * (1.0 - float(plan) / float(base))


def _durations(replay: Replay, speed: FloatArray) -> FloatArray:
    return durations(speed, replay.case.road)


def _error(trip: Trip) -> float:
    return _rms(speed_tracking.tracking_error(trip.record))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
