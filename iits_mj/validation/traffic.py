"""`iits-mj validate traffic`: simulated traffic against recorded traffic, and against its theory.

The paper's figure is the distribution of speeds of recorded and simulated traffic for three
densities. Here are speed, spacing and time headway, with their distances, before and after the
car-following model is calibrated to the recorded pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.results import Check, Line, Panel, Results
from iits_mj.validation import traffic_conditions as conditions_of
from iits_mj.validation import traffic_replay, traffic_theory
from iits_mj.validation.config import ValidateConfig
from iits_mj.validation.traffic_flow import (
    FlowSamples,
    distribution,
    kolmogorov_smirnov,
    lane_change_rate,
    levels,
    matched,
    wasserstein,
    weighted_mean,
)
from traffic_bridge.datasets import Pair, Trajectories, pairs, read_trajectories
from traffic_bridge.vehicles.calibration import (
    Calibration,
    calibrate,
    calibrate_each,
    calibrate_headways,
    evaluate,
    parameter_table,
    trimmed,
)
from traffic_bridge.vehicles.idm import PARAMETERS, IdmParameters
from traffic_bridge.vehicles.types import default_types

MISSING = (
    "recorded traffic was not compared: give --data FILE, trajectories that the data-set readers "
    "know, for instance the reconstructed NGSIM pairs"
)
# Desired speed of the uncalibrated car: 65 mph, the limit of the Californian freeway of NGSIM.
DEFAULT_SPEED = 29.06
QUANTITIES = {"speed": "m/s", "spacing": "m", "time_headway": "s"}
# Kesting and Treiber (2008): gap errors of single drivers, 11 to 29 %; a set of one's own for each.
PUBLISHED_ERROR = "11 .. 29"
SPEED_BOUND = "<= 1"  # [m/s]: the goal for calibrated traffic in the recorded conditions
QUICK_WINDOWS, QUICK_EACH = 1, 12


@dataclass(frozen=True, eq=False)
class Fit:
    """What calibration found: the default, one set for all, and a headway for each driver.

    Attributes:
      default: the package's car; common: fitted to half of the pairs.
      headways: of the same half, by pair; fitted: those pairs; judged: the other half.
    """

    default: IdmParameters
    common: Calibration
    headways: list[Calibration]
    fitted: Sequence[Pair]
    judged: Sequence[Pair]


def run(config: ValidateConfig) -> Results:
    """Theory and replay always; the recorded set where there is one.

    Raises:
      InputError: the recorded set cannot be read, or has no pairs to calibrate to.
    """
    results = Results("validate traffic")
    data = None if config.data is None else read_trajectories(config.data)
    checks, diagram, stability = traffic_theory.compare(config.quick)
    results.checks += checks
    results.figures["fundamental_diagram"] = diagram
    results.figures["string_stability"] = stability
    results.checks += traffic_replay.own_recording()
    results.checks += traffic_replay.lane_changes(config.quick)
    if data is None:
        results.notes.append(MISSING)
        return results
    results.notes += [f"data: {note}" for note in data.notes]
    _recorded(results, data, config.quick)
    return results


def _recorded(results: Results, data: Trajectories, quick: bool) -> None:
    changes, driven = lane_change_rate(data)
    rate = changes / driven if driven > 0.0 else 0.0
    results.checks.append(Check("lane changes per vehicle and km, recorded", rate, "1/km"))
    results.checks += traffic_replay.laid(data)
    found = trimmed(pairs(data))
    fit = calibrated(found)
    results.checks += _calibration_checks(fit)
    results.figures["calibration"] = [_error_panel(fit)]
    each = calibrate_each(
        fit.fitted[:: max(1, len(fit.fitted) // QUICK_EACH)] if quick else found,
        begin=fit.common.parameters,
    )
    results.checks += _each_checks(each)
    _compare_flows(results, data, found, fit, quick)


def calibrated(found: Sequence[Pair]) -> Fit:
    """Calibrates to every second pair, in the order of their times."""
    ordered = sorted(found, key=lambda pair: (float(pair.time[0]), pair.follower))
    fitted, judged = ordered[::2], ordered[1::2]
    common = calibrate(fitted)
    headways = calibrate_headways(fitted, common.parameters)
    car = next(kind for kind in default_types() if kind.name == "car")
    speed = car.desired_speed_mean * DEFAULT_SPEED
    return Fit(IdmParameters.of_type(car, speed), common, headways, fitted, judged)


def _calibration_checks(fit: Fit) -> list[Check]:
    before = evaluate(fit.judged, fit.default).error
    after = evaluate(fit.judged, fit.common.parameters).error
    own = float(np.mean([entry.error for entry in fit.headways]))
    other = calibrate_headways(fit.judged, fit.common.parameters)
    own_judged = float(np.mean([entry.error for entry in other]))
    checks = [
        Check("gap error of the default car, pairs not fitted to", 100.0 * before, "%"),
        Check("gap error of one set, pairs fitted to", 100.0 * fit.common.error, "%"),
        Check(
            "gap error of one set, pairs not fitted to",
            100.0 * after,
            "%",
            100.0 * before,
            f"< {100.0 * before:.4g}",
        ),
        Check("gap error of one set and own headways, pairs fitted to", 100.0 * own, "%"),
        Check(
            "gap error of one set and own headways, pairs not fitted to",
            100.0 * own_judged,
            "%",
            PUBLISHED_ERROR,
        ),
    ]
    values = fit.common.parameters.as_array()
    checks += [
        Check(f"one set: {name.replace('_', ' ')}", float(value), unit)
        for name, value, unit in zip(PARAMETERS, values, _UNITS, strict=True)
    ]
    headways = [entry.parameters.time_headway for entry in fit.headways]
    checks.append(Check("own headways: mean", float(np.mean(headways)), "s"))
    checks.append(Check("own headways: standard deviation", float(np.std(headways)), "s"))
    return checks


_UNITS = ("m/s", "s", "m", "m/s2", "m/s2")


def _each_checks(each: Sequence[Calibration]) -> list[Check]:
    errors = 100.0 * np.array([entry.error for entry in each])
    checks = [
        Check("gap error of five own parameters, mean", float(errors.mean()), "%", PUBLISHED_ERROR)
    ]
    middle = np.median(parameter_table(each), axis=0)
    checks += [
        Check(f"own parameters, median: {name.replace('_', ' ')}", float(value), unit)
        for name, value, unit in zip(PARAMETERS, middle, _UNITS, strict=True)
    ]
    return checks


def _error_panel(fit: Fit) -> Panel:
    grid = np.linspace(0.0, 100.0, 200)

    def curve(label: str, errors: Sequence[float], role: str = "") -> Line:
        values = 100.0 * np.asarray(errors)
        share = distribution(values, np.ones(len(values)), grid)
        return Line(label, grid, 100.0 * share, role)

    default = evaluate(fit.judged, fit.default).pair_errors
    common = evaluate(fit.judged, fit.common.parameters).pair_errors
    own = [e.error for e in calibrate_headways(fit.judged, fit.common.parameters)]
    return Panel(
        "Gap error of pairs that were not fitted to",
        "gap error [%]",
        "share of pairs [%]",
        (
            curve("default car", list(default), "reference"),
            curve("one calibrated set", list(common)),
            curve("and own headways", own),
        ),
    )


def _compare_flows(
    results: Results, data: Trajectories, found: Sequence[Pair], fit: Fit, quick: bool
) -> None:
    recorded = FlowSamples.of_pairs(found)
    length = float(np.mean(data.length))
    conditions = conditions_of.Conditions.of(recorded, FlowSamples.of_leaders(found), length)
    windows = conditions.windows()[: QUICK_WINDOWS if quick else None]
    reference = conditions_of.compared(recorded, conditions)
    by_lane: dict[int, list[IdmParameters]] = {}
    for entry, pair in zip(fit.headways, fit.fitted, strict=True):
        by_lane.setdefault(pair.lane, []).append(entry.parameters)

    def own(lane: int, rng: np.random.Generator) -> IdmParameters:
        choices = by_lane.get(lane) or [entry.parameters for entry in fit.headways]
        return choices[int(rng.integers(len(choices)))]

    drivers: dict[str, conditions_of.Drivers] = {
        "default": lambda _lane, _rng: fit.default,
        "calibrated": lambda _lane, _rng: fit.common.parameters,
        "own headways": own,
    }
    flows = {
        name: conditions_of.compared(
            FlowSamples.joined([conditions_of.drive(conditions, who, w) for w in windows]),
            conditions,
        )
        for name, who in drivers.items()
    }
    cells = levels(reference)
    for name, flow in flows.items():
        bound = SPEED_BOUND if name == "calibrated" else ""
        ours, theirs = matched(reference, flow)
        results.checks += _distances(f"{name}, all", ours, theirs, bound)
        for lane in range(conditions.lanes):
            mine = theirs.select((theirs.lane == lane) & np.isfinite(theirs.spacing))
            if not len(mine):
                continue
            flow_found = weighted_mean(mine, "speed") / weighted_mean(mine, "spacing")
            recorded_flow = 3600.0 * float(conditions.flow[lane])
            label = f"{name}, lane {lane}: flow"
            results.checks.append(Check(label, 3600.0 * flow_found, "1/h", recorded_flow))
            a, b = (part.select(part.lane == lane) for part in (ours, theirs))
            results.checks += _distances(f"{name}, lane {lane}", a, b, "", only_speed=True)
        for level, members in cells.items():
            a, b = (part.select(np.isin(part.cells(), members)) for part in (ours, theirs))
            results.checks += _distances(f"{name}, {level}", a, b, "")
    for quantity, unit in QUANTITIES.items():
        results.figures[quantity] = _panels(quantity, unit, reference, flows, cells)
    covered = ", ".join(f"{100.0 * share:.0f} %" for share in conditions.covered)
    results.notes.append(
        f"somebody was recorded in {covered} of the time, by lane from the right; in between place "
        "and speed of the boundary are interpolated"
    )


def _distances(
    name: str, ours: FlowSamples, theirs: FlowSamples, bound: str, only_speed: bool = False
) -> list[Check]:
    if not (len(ours) and len(theirs)):
        return []
    checks = []
    for quantity, unit in QUANTITIES.items():
        if only_speed and quantity != "speed":
            continue
        label = f"{name}: {quantity.replace('_', ' ')}"
        must = bound if quantity == "speed" else ""
        distance = wasserstein(ours, theirs, quantity)
        gap = kolmogorov_smirnov(ours, theirs, quantity)
        checks.append(Check(f"{label}, Wasserstein", distance, unit, None, must))
        checks.append(Check(f"{label}, Kolmogorov-Smirnov", gap, "1"))
        reference = weighted_mean(ours, quantity)
        checks.append(Check(f"{label}, mean", weighted_mean(theirs, quantity), unit, reference))
    return checks


def _panels(
    quantity: str,
    unit: str,
    reference: FlowSamples,
    flows: dict[str, FlowSamples],
    cells: dict[str, np.ndarray],
) -> list[Panel]:
    """One density of probability a level: recorded, simulated before, simulated after."""
    values = reference.quantity(quantity)
    top = float(np.nanpercentile(values, 99.5)) * 1.15
    edges = np.linspace(0.0, top, 41)
    middle = 0.5 * (edges[1:] + edges[:-1])
    panels = []
    for level, members in cells.items():
        lines = []
        for name, flow in ({"recorded": reference} | flows).items():
            ours, theirs = matched(reference, flow)
            part = ours if name == "recorded" else theirs
            part = part.select(np.isin(part.cells(), members))
            known = np.isfinite(part.quantity(quantity))
            if not known.any():
                continue
            share, _ = np.histogram(
                part.quantity(quantity)[known], edges, weights=part.weight[known], density=True
            )
            role = {"recorded": "reference", "calibrated": "simulation"}.get(name, "")
            lines.append(Line(name, middle, share, role))
        title = f"{level.capitalize()} traffic"
        panels.append(
            Panel(title, f"{quantity.replace('_', ' ')} [{unit}]", "density of probability",
                  tuple(lines))
        )  # fmt: skip
    return panels
