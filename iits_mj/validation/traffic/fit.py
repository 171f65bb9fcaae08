"""Calibration to recorded pairs: what it finds, and how well it does on pairs it has not seen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from iits_mj.core.errors import InputError
from iits_mj.core.results import Check, Line, Panel
from iits_mj.validation.traffic.flow import distribution
from traffic_bridge.datasets import Pair
from traffic_bridge.vehicles.calibration import (
    Calibration,
    calibrate,
    calibrate_headways,
    evaluate,
    parameter_table,
)
from traffic_bridge.vehicles.idm import PARAMETERS, IdmParameters
from traffic_bridge.vehicles.types import default_types

# Desired speed of the uncalibrated car: 65 mph, the limit of the Californian freeway of NGSIM.
DEFAULT_SPEED = 29.06
# Kesting and Treiber (2008): gap errors of single drivers, 11 to 29 %; a set of one's own for each.
PUBLISHED_ERROR = "11 .. 29"


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


def calibrated(found: Sequence[Pair]) -> Fit:
    """Calibrates to the earlier half of the pairs; later ones of other vehicles are to judge.

    Raises:
      InputError: there are too few pairs, or none of other vehicles.
    """
    ordered = sorted(found, key=lambda pair: (float(pair.time[0]), pair.follower))
    fitted = ordered[: (len(ordered) + 1) // 2]
    known = {name for pair in fitted for name in (pair.follower, pair.leader)}
    judged = [p for p in ordered[len(fitted) :] if not {p.follower, p.leader} & known]
    if not judged:
        raise InputError(
            f"{len(ordered)} pairs: too few to fit to some and judge by others, of other vehicles"
        )
    common = calibrate(fitted)
    headways = calibrate_headways(fitted, common.parameters)
    car = next(kind for kind in default_types() if kind.name == "car")
    speed = car.desired_speed_mean * DEFAULT_SPEED
    return Fit(IdmParameters.of_type(car, speed), common, headways, fitted, judged)


def calibration_checks(fit: Fit) -> list[Check]:
    """Gap errors before and after, on pairs fitted to and on others, and what was found."""
    before = evaluate(fit.judged, fit.default).error
    after = evaluate(fit.judged, fit.common.parameters).error
    own = float(np.mean([entry.error for entry in fit.headways]))
    first, second = zip(*(_halves(pair) for pair in fit.judged), strict=True)
    moved = calibrate_headways(first, fit.common.parameters)
    transferred = float(
        np.mean(
            [
                evaluate([pair], entry.parameters).error
                for pair, entry in zip(second, moved, strict=True)
            ]
        )
    )
    kept = float(np.mean([evaluate([p], fit.common.parameters).error for p in second]))
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
        Check(
            "gap error of one set and own headways, pairs fitted to",
            100.0 * own,
            "%",
            PUBLISHED_ERROR,
        ),
        Check("gap error of one set, second halves of pairs not fitted to", 100.0 * kept, "%"),
        Check(
            "gap error of one set and own headways of their first halves, second halves of pairs "
            "not fitted to",
            100.0 * transferred,
            "%",
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


def _halves(pair: Pair) -> tuple[Pair, Pair]:
    """A pair's first and second half in time."""
    middle = len(pair.time) // 2
    arrays = [
        entry.name
        for entry in dataclasses.fields(pair)
        if isinstance(getattr(pair, entry.name), np.ndarray)
    ]
    return (
        dataclasses.replace(pair, **{name: getattr(pair, name)[:middle] for name in arrays}),
        dataclasses.replace(pair, **{name: getattr(pair, name)[middle:] for name in arrays}),
    )


_UNITS = ("m/s", "s", "m", "m/s2", "m/s2")


def each_checks(each: Sequence[Calibration]) -> list[Check]:
    """Gap errors and parameters of drivers fitted one by one."""
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


def error_panel(fit: Fit) -> Panel:
    """Distribution of the gap error over the pairs that were not fitted to."""
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
            curve("and headways fitted to them", own),
        ),
    )
