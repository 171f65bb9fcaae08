"""`iits-mj validate pbs`: the Performance-Based Standards, as an assessor's tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from iits_mj.core.progress import each
from iits_mj.core.results import Findings, Results
from iits_mj.core.timing import TIMESTEP
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.pbs.assessment import Assessment, assess, level_text
from iits_mj.validation.pbs.limits import STANDARDS, reached

NOTES = (
    "The worse value of the laden and the empty truck counts on paths and in the pulse steer; the "
    "laden truck sets off, climbs, accelerates, tilts and gives the amplification.",
    "Predicted: low-speed turn by the tractrix chain, lane change by the yaw-plane model, damping "
    "by the yaw-roll model, rollover by statics of the roll plane, grades and speed on 1 % by the "
    "balance of forces.",
    "The amplification is that of the rearmost units coupled in roll, by mass times height, over "
    "the rollover threshold of the weakest group of units.",
)


def run(config: ValidateConfig) -> Results:
    """Assesses one truck, or all shipped ones if neither truck nor payload is chosen.

    The quick form assesses only the default truck.
    """
    results = Results("validate pbs")
    every = config.truck is None and config.payload is None and not config.quick
    trucks = [TruckParameters.load(name) for name in shipped_trucks()]
    settings = [replace(config, truck=truck) for truck in trucks] if every else [config]
    step = config.timestep or TIMESTEP
    found = [
        assess(one.parameters, one.payloads(), step)
        for one in each(settings, "assessing", lambda one: one.parameters.name)
    ]
    if len(found) > 1:
        results.tables["levels"] = _overview(found)
    for truck in found:
        _add(results, truck)
    results.notes += NOTES
    return results


def _add(results: Results, truck: Assessment) -> None:
    """Adds the values, the table and the panels of a truck; an assessment has no bounds."""
    findings = Findings(truck.truck)
    for name, value in truck.values.items():
        standard = STANDARDS[name]
        findings.check(standard.name, value, standard.unit, truck.predicted.get(name))
    for title, value in zip(("roll-coupled units", "last unit"), truck.amplification, strict=False):
        findings.check(f"rearward amplification of the {title}", value, "1")
    findings.panels = truck.panels
    results.add(truck.truck, findings)
    results.tables[f"{truck.truck}: level {level_text(truck.level)}"] = truck.rows()


def _overview(found: Sequence[Assessment]) -> list[Sequence[str]]:
    """A row for each measure with the value and the level of each truck."""
    rows: list[Sequence[str]] = [("measure", "unit", *(truck.truck for truck in found))]
    levels = [reached(truck.values)[0] for truck in found]
    for name, standard in STANDARDS.items():
        cells = [
            f"{truck.values[name]:.3g} ({level_text(own[name])})" if name in own else ""
            for truck, own in zip(found, levels, strict=True)
        ]
        rows.append((standard.name, standard.unit, *cells))
    rows.append(("level of the truck", "", *(level_text(truck.level) for truck in found)))
    return rows
