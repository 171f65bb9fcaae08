"""`iits-mj validate step-size`: do the results depend on the time step of the physics?

Every figure of `validate lateral` and `validate standards` is measured at 1, 2 and 5 ms. Peaks,
steady values and thresholds must agree within 0.5 % of the figure at 1 ms. A figure that is a
difference from a reference is compared on the scale of that reference: percentages in points,
phases in parts of a radian, and distances from a path or a model in parts of a meter.

ABS on a slippery road cannot agree so well: it switches valves at the step where the slip of a
wheel passes a threshold, and a stop has many such events. These figures have the same bound, which
they may miss. The notes name the known causes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from iits_mj.core.results import Check, Findings, Line, Results
from iits_mj.validation.handling.group import name_of, run_lateral, run_standards
from iits_mj.validation.harness.config import ValidateConfig

_NOTES = (
    "The reference column gives the figure itself at the finest step.",
    "Braking: stops and bends with ABS change by its valves, which switch at the step where a "
    "wheel's slip passes a threshold. A stop on the same road with so mild a demand that ABS stays "
    "off changes by less than a tenth of a percent.",
    "Transient off-tracking and phases of the frequency response: the change grows in proportion "
    "to the step, as with first-order integration; it is a few millimetres on a path of one and a "
    "half metres, and a third of a degree.",
    "Circle: the limit is searched in steps of speed, so that what is found there jumps.",
)
STEPS = (0.001, 0.002, 0.005)
AGREEMENT = 0.5
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
        must = "" if check.reference == "eigenvalues" else f"<= {AGREEMENT:g}"
        for step in steps[1:]:
            change = difference(check, figures[step][name])
            changes[step].append(change)
            found.check(step_title(step, steps[0], name), change, "%", check.value, must)
    change_panel(found, changes, steps[0])
    results.add("step_size", found)
    results.notes += _NOTES
    return results


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
