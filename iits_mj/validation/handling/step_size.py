"""`iits-mj validate step-size`: do the figures depend on the time step of the physics?

Every figure of `validate lateral` and `validate standards` is taken at 1, 2 and 5 ms. Peaks, steady
values and thresholds must agree within 0.5 % of the figure at 1 ms. A figure that is itself a
difference from a reference is compared on the scale of what it is a difference of: percentages in
points, phases in parts of a radian, and distances from a path or a model in parts of a metre.

What ABS does on a slippery road cannot agree so well: it opens and closes valves at the step where
a wheel's slip passes a threshold, and a stop has many such events. These figures are held to the
same bound, which they may miss. The notes say what is known of the causes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.validation.handling import lateral, standards
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
_SOURCES: tuple[Callable[[ValidateConfig], Results], ...] = (lateral.run, standards.run)
# Scale of a difference from a reference, by unit.
_SCALES = {"%": 100.0, "deg": float(np.rad2deg(1.0)), "m": 1.0, "km/h": 80.0}
_DIFFERENCES = ("error", "fit", "path of the trailer")


def run(config: ValidateConfig) -> Results:
    """All figures at all steps; quick: the quick figures of `validate lateral` at 2 and 5 ms."""
    results = Results("validate step-size")
    steps, sources = (STEPS[1:], _SOURCES[:1]) if config.quick else (STEPS, _SOURCES)
    if config.quick:
        config = replace(config, payload=config.payloads()[0])
    figures = {step: _figures(sources, replace(config, timestep=step)) for step in steps}
    fine = figures[steps[0]]
    spread: dict[float, list[float]] = {step: [] for step in steps[1:]}
    for name, check in fine.items():
        for step in steps[1:]:
            change = difference(check, figures[step][name])
            spread[step].append(change)
            title = f"{step * 1e3:g} ms against {steps[0] * 1e3:g} ms: {name}"
            must = f"<= {AGREEMENT:g}" if _simulated(check) else ""
            results.checks.append(Check(title, change, "%", float(check.value), must))
    count = np.arange(1.0, len(fine) + 1.0)
    limit = Line("allowed", count[[0, -1]], np.full(2, AGREEMENT), "reference")
    lines = tuple(
        Line(f"{step * 1e3:g} ms", count, np.sort(np.array(changes)), "")
        for step, changes in spread.items()
    )
    panel = Panel(
        f"Change of every figure against {steps[0] * 1e3:g} ms, in order",
        "figures",
        "change [%]",
        (limit, *lines),
    )
    results.figures["step_size"] = [panel]
    results.notes += _NOTES
    return results


def difference(fine: Check, coarse: Check) -> float:
    """Change of a figure by the step [%]; NaN when either is not finite."""
    change = abs(coarse.value - fine.value)
    if any(word in fine.name.rsplit(": ", 1)[-1] for word in _DIFFERENCES):
        return 100.0 * change / _SCALES.get(fine.unit, 1.0)
    scale = abs(fine.value)
    return 100.0 * change / scale if scale > 0.0 else (0.0 if change == 0.0 else float("nan"))


def _figures(
    sources: tuple[Callable[[ValidateConfig], Results], ...], config: ValidateConfig
) -> dict[str, Check]:
    checks = [check for source in sources for check in source(config).checks]
    return {check.name: check for check in checks}


def _simulated(check: Check) -> bool:
    """False for figures of an analytic model, which know no step."""
    return check.reference != "eigenvalues"
