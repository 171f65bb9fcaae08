"""`iits-mj validate step-size`: do the results depend on the time step of the physics?

Every figure of `validate lateral` and `validate standards` is measured at 1, 2 and 5 ms. Peaks,
steady values and thresholds must agree within 0.5 % of the figure at 1 ms. A figure that is a
difference from a reference is compared on the scale of that reference: percentages in points,
phases in parts of a radian, and distances from a path or a model in parts of a meter.

In bends and starts on slippery roads wheels lose and find grip, and controls act on it: within 1 %
at 2 ms and 3 % at 5 ms, with and without slip control.

Some maneuvers scatter by themselves. In a stop with ABS on split friction the least change of the
start shifts the phase of each wheel's cycle against the others, and with it the peaks of yaw rate
and steering. In a start on ice without slip control the gearbox hunts between two gears while the
wheels spin. These are repeated from slightly different speeds, or on slightly different ice, and
their means are compared with those at 0.5 ms: within 1 % and 3 %, plus twice the standard error of
the difference. The single ones are for information. Yaw rate and hitch angle of a stop count above
15 km/h, below which UN R13 allows locked wheels. The notes name other causes of changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.results import Check, Findings, Line, Results
from iits_mj.parameters import TruckParameters
from iits_mj.validation.handling import braking_stability, drive_slip
from iits_mj.validation.handling.group import name_of, run_lateral, run_standards
from iits_mj.validation.harness.config import ValidateConfig

_NOTES = (
    "The reference column gives the figure itself at the finest step.",
    "Bends and starts on slippery roads, with and without slip control: the bound is 1 % at 2 ms "
    "and 3 % at 5 ms.",
    "Stops with ABS on split friction, and starts on ice without slip control: means of seven, "
    "against the mean at the finest step. Twice the standard error of the difference widens the "
    "bound.",
    "Circle: the limit is searched in steps of speed, so that what is found there jumps.",
)
STEPS = (0.001, 0.002, 0.005)
AGREEMENT = 0.5
# Allowed changes [%] by step on slippery roads, and finest step of the means [s].
ON_SLIPPERY = {0.002: 1.0, 0.005: 3.0}
FINEST = 0.0005
# Repeated maneuvers: changes of a stop's starting speed [m/s], and factors on the friction of ice.
STARTS = tuple(0.05 * k for k in range(-3, 4))
ICES = tuple(1.0 + 0.01 * k for k in range(-3, 4))
_REPEATED = ("split friction", "all axles, ABS", drive_slip.WITHOUT)
_SLIPPERY = "slip of the driven wheels"
# Scale of a difference from a reference, by unit.
_SCALES = {"%": 100.0, "deg": float(np.rad2deg(1.0)), "m": 1.0, "km/h": 80.0}
_DIFFERENCES = ("error", "fit", "path of the trailer")


def run(config: ValidateConfig) -> Results:
    """All figures at all steps; quick: the quick figures of `validate lateral` at 2 and 5 ms."""
    results, found = Results(name_of("step-size", config)), Findings()
    steps, sources = list(STEPS), [run_lateral, run_standards]
    if config.quick:
        steps, sources = steps[1:], sources[:1]
        config = replace(config, payload=config.payloads()[0])
    figures = {
        step: {
            check.name: check
            for source in sources
            for check in source(replace(config, timestep=step)).checks
        }
        for step in steps
    }
    changes: dict[float, list[float]] = {step: [] for step in steps[1:]}
    for name, check in figures[steps[0]].items():
        # Eigenvalues of an analytic model do not depend on a step.
        free = check.reference == "eigenvalues" or any(word in name for word in _REPEATED)
        for step in steps[1:]:
            allowed = ON_SLIPPERY[step] if _SLIPPERY in name else AGREEMENT
            must = "" if free else f"<= {allowed:g}"
            change = difference(check, figures[step][name])
            changes[step].append(change)
            found.check(step_title(step, steps[0], name), change, "%", check.value, must)
    change_panel(found, changes, steps[0])
    results.add("step_size", found)
    if not config.quick:
        for payload in config.payloads():
            results.add("", compare_means(config.parameters, payload))
    results.notes += _NOTES
    return results


def compare_means(parameters: TruckParameters, payload: float) -> Findings:
    """Means over repeated stops and starts at coarse steps against those at the finest one."""
    found = Findings(f"means of {len(STARTS)}, {payload / 1e3:g} t")
    for repeat in (_stops, _starts):
        fine = repeat(parameters, payload, FINEST)
        for step, allowed in ON_SLIPPERY.items():
            coarse = repeat(parameters, payload, step)
            for name, values in fine.items():
                mean, other = float(np.mean(values)), coarse[name]
                spread = math.sqrt((np.var(values, ddof=1) + np.var(other, ddof=1)) / len(values))
                change = 100.0 * abs(float(np.mean(other)) / mean - 1.0)
                must = f"<= {allowed + 200.0 * spread / abs(mean):.3g}"
                found.check(step_title(step, FINEST, name), change, "%", mean, must)
    return found


def _stops(parameters: TruckParameters, payload: float, step: float) -> dict[str, FloatArray]:
    """Figures of stops with a driver on split friction, each of shape (starts,)."""
    rows = []
    for change in STARTS:
        speed = braking_stability.SPLIT_SPEED + change
        held = braking_stability.stop_on(
            parameters,
            payload,
            braking_stability.HIGH,
            braking_stability.LOW,
            step,
            driver=True,
            duration=30.0,
            speed=speed,
        )
        figures = {"stopping distance": braking_stability.path_length(held)}
        more = braking_stability.split_figures(parameters, held)
        rows.append(figures | {name: value for name, (value, _, _) in more.items()})
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _starts(parameters: TruckParameters, payload: float, step: float) -> dict[str, FloatArray]:
    """Figures of starts on ice without slip control, each of shape (starts,)."""
    truck = drive_slip.without_control(parameters)
    found: dict[str, list[float]] = {}
    for name, grips, _ in drive_slip.STARTS:
        for ice in ICES:
            record = drive_slip.start(truck, payload, step, grips, ice * drive_slip.ICE)
            figures = drive_slip.start_figures(parameters, record)
            for title, value in zip(drive_slip.start_titles(name), figures, strict=True):
                found.setdefault(title + drive_slip.WITHOUT, []).append(value)
    return {title: np.array(values) for title, values in found.items()}


def difference(fine: Check, coarse: Check) -> float:
    """Change of a figure with the step [%]; NaN when either value is not finite."""
    change = abs(coarse.value - fine.value)
    if any(word in fine.name.rsplit(": ", 1)[-1] for word in _DIFFERENCES):
        return 100.0 * change / _SCALES.get(fine.unit, 1.0)
    scale = abs(fine.value)
    return 100.0 * change / scale if scale > 0.0 else (0.0 if change == 0.0 else float("nan"))


def step_title(step: float, finest: float, name: str) -> str:
    """Name of the check that compares a figure at two steps [s]."""
    return f"{step * 1e3:g} ms against {finest * 1e3:g} ms: {name}"


def change_panel(found: Findings, changes: Mapping[float, Sequence[float]], finest: float) -> None:
    """Adds a panel with the sorted changes [%] of all figures by step [s]."""
    count = np.arange(1.0, max(map(len, changes.values())) + 1.0)
    lines = [
        Line(f"{step * 1e3:g} ms", count, np.sort(np.array(change)))
        for step, change in changes.items()
    ]
    allowed = Line("allowed", count[[0, -1]], np.full(2, AGREEMENT), "reference")
    title = f"Change of every figure against {finest * 1e3:g} ms, in order"
    found.panel(title, "figures", "change [%]", allowed, *lines)
