"""Calibration to recorded pairs, and its errors on other pairs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.results import Findings, Line
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
# Kesting and Treiber (2008): gap errors of drivers with individual parameters, 11 to 29 %.
PUBLISHED_ERROR = "11 .. 29"
UNSEEN_ERROR = 25.0  # [%], goal for drivers of whom only the first gap and speed are known


@dataclass(frozen=True, eq=False)
class Fit:
    """Results of the calibration.

    Attributes:
      default: the package's car; common: one set of parameters, fitted to half of the pairs.
      kept: a set whose drivers keep the headway of their first gap for a while.
      headways: sets with individual time headways for the pairs of that half.
      fitted: pairs of that half; judged: test pairs of the other half.
    """

    default: IdmParameters
    common: Calibration
    kept: Calibration
    headways: list[Calibration]
    fitted: Sequence[Pair]
    judged: Sequence[Pair]


def calibrated(found: Sequence[Pair]) -> Fit:
    """Calibrates to the earlier half of the pairs; later pairs of other vehicles are the test set.

    Raises:
      InputError: there are too few pairs, or no later pairs of other vehicles.
    """
    ordered = sorted(found, key=lambda pair: (float(pair.time[0]), pair.follower))
    fitted = ordered[: (len(ordered) + 1) // 2]
    known = {name for pair in fitted for name in (pair.follower, pair.leader)}
    judged = [p for p in ordered[len(fitted) :] if not {p.follower, p.leader} & known]
    if not judged:
        raise InputError(
            f"{len(ordered)} pairs are too few to fit some and judge by others, of other vehicles"
        )
    common = calibrate(fitted)
    kept = calibrate(fitted, with_memory=True)
    headways = calibrate_headways(fitted, common.parameters)
    car = next(kind for kind in default_types() if kind.name == "car")
    speed = car.desired_speed_mean * DEFAULT_SPEED
    return Fit(IdmParameters.of_type(car, speed), common, kept, headways, fitted, judged)


def compare(fit: Fit) -> Findings:
    """Gap errors before and after, on pairs fitted to and on others; the parameters found."""
    before = evaluate(fit.judged, fit.default).error
    after = evaluate(fit.judged, fit.common.parameters).error
    with_first = evaluate(fit.judged, fit.kept.parameters, memory=fit.kept.memory).error
    own = float(np.mean([entry.error for entry in fit.headways]))
    first, second = zip(*(_halves(pair) for pair in fit.judged), strict=True)
    moved = calibrate_headways(first, fit.common.parameters)
    transferred = [
        evaluate([pair], entry.parameters).error for pair, entry in zip(second, moved, strict=True)
    ]
    kept = [evaluate([pair], fit.common.parameters).error for pair in second]
    found = Findings()
    for name, error, reference, must in (
        ("of the default car, pairs not fitted to", before, None, ""),
        ("of one set, pairs fitted to", fit.common.error, None, ""),
        ("of one set, pairs not fitted to", after, 100.0 * before, f"< {100.0 * before:.4g}"),
        ("of one set and first headways, pairs fitted to", fit.kept.error, None, ""),
        (
            "of one set and first headways, pairs not fitted to",
            with_first,
            UNSEEN_ERROR,
            f"< {100.0 * after:.4g}",
        ),
        ("of one set and own headways, pairs fitted to", own, PUBLISHED_ERROR, ""),
        ("of one set, second halves of pairs not fitted to", np.mean(kept), None, ""),
        (
            "of one set and own headways of their first halves, second halves of pairs not fitted "
            "to",
            np.mean(transferred),
            None,
            "",
        ),
    ):
        found.check(f"gap error {name}", 100.0 * error, "%", reference, must)
    if fit.kept.memory is not None:
        found.check("first headways: time constant of the return", fit.kept.memory, "s")
    _parameters(found, "one set", fit.common.parameters.as_array())
    headways = [entry.parameters.time_headway for entry in fit.headways]
    found.check("own headways: mean", np.mean(headways), "s")
    found.check("own headways: standard deviation", np.std(headways), "s")
    _error_panel(found, fit)
    return found


def compare_each(each: Sequence[Calibration]) -> Findings:
    """Gap errors and parameters of drivers fitted one by one."""
    found = Findings()
    errors = 100.0 * np.array([entry.error for entry in each])
    found.check("gap error of five own parameters, mean", errors.mean(), "%", PUBLISHED_ERROR)
    _parameters(found, "own parameters, median", np.median(parameter_table(each), axis=0))
    return found


def _parameters(found: Findings, label: str, values: FloatArray) -> None:
    units = ("m/s", "s", "m", "m/s2", "m/s2")
    for name, value, unit in zip(PARAMETERS, values, units, strict=True):
        found.check(f"{label}: {name.replace('_', ' ')}", value, unit)


def _halves(pair: Pair) -> tuple[Pair, Pair]:
    """A pair's first and second half in time."""
    middle = len(pair.time) // 2
    arrays: dict[str, Any] = {
        name: array for name, array in vars(pair).items() if isinstance(array, np.ndarray)
    }
    return (
        dataclasses.replace(pair, **{name: array[:middle] for name, array in arrays.items()}),
        dataclasses.replace(pair, **{name: array[middle:] for name, array in arrays.items()}),
    )


def _error_panel(found: Findings, fit: Fit) -> None:
    """Adds the distribution of the gap error over the test pairs."""
    grid = np.linspace(0.0, 100.0, 200)

    def curve(label: str, errors: Sequence[float], role: str = "") -> Line:
        values = 100.0 * np.asarray(errors)
        share = distribution(values, np.ones(len(values)), grid)
        return Line(label, grid, 100.0 * share, role)

    default = evaluate(fit.judged, fit.default).pair_errors
    common = evaluate(fit.judged, fit.common.parameters).pair_errors
    own = [e.error for e in calibrate_headways(fit.judged, fit.common.parameters)]
    found.panel(
        "Gap error of pairs that were not fitted to",
        "gap error [%]",
        "share of pairs [%]",
        curve("default car", list(default), "reference"),
        curve("one calibrated set", list(common)),
        curve("and headways fitted to them", own),
    )
