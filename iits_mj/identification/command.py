"""`iits-mj identify`: its options and its results."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.core import options
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.results import Check, Line, Panel, Results
from iits_mj.identification.identify import Identification, identify, overlay, write_toml
from iits_mj.identification.log import Log, read, read_grade
from iits_mj.identification.longitudinal import payload_of
from iits_mj.identification.replay import replay
from iits_mj.parameters import AnyTruck, TruckParameters, truck_option

# Least accuracy of the truck with identified values: 100 (1 - mean |v - v_rec| / mean v_rec) [%].
_ACCURACY = 97.0


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """Options of an identification."""

    log: Path = option(
        help="telemetry table (.csv) or CAN log (candump .log, .asc, .blf) of a drive",
        metavar="LOG",
        positional=True,
    )
    signals: str = option(
        "",
        help="use these signals only; name=title for a column with another title",
        metavar="NAME,...",
        group="data",
    )
    grade: str = option(
        "",
        help="grade of the road: a number, or a table of station and grade (CSV)",
        metavar="GRADE|FILE.csv",
        files=re.compile(r".*\.[A-Za-z]+\Z"),
        group="road",
    )
    truck: AnyTruck | None = truck_option("truck with the prior values")
    parameters: Path | None = option(
        None,
        help="overlay of the truck with other prior values",
        metavar="FILE.toml",
        group="truck",
    )
    mass: float | None = option(
        None,
        help="known gross mass; fits the torque scale instead",
        unit="kg",
        low=5e3,
        high=1.2e5,
        group="truck",
    )
    replay: bool = option(
        False,
        help="drive the truck with the log's commands, with prior and identified values",
        group="run",
    )
    output: Path | None = option(
        None, help="where to write the identified overlay", metavar="FILE.toml", group="output"
    )

    def __post_init__(self) -> None:
        options.check(self)


def run(config: IdentifyConfig) -> Results:
    """Identifies the parameters, writes the overlay if requested, and reports a check for each.

    Raises:
      InputError: the log or the overlay cannot be used, or the log shows no parameter.
    """
    parameters = TruckParameters.load(config.truck, config.parameters)
    log = _load_log(config, parameters)
    found = identify(log, parameters, mass=config.mass)
    report = _results(found)
    if config.output is not None:
        write_toml(found, config.output)
    if config.replay:
        _add_replay(report, log, found, config)
    return report


def _load_log(config: IdentifyConfig, parameters: TruckParameters) -> Log:
    """The log with the grade and the signals that the options name."""
    wanted = [part.strip() for part in config.signals.split(",") if part.strip()]
    names = dict(part.split("=", 1) for part in wanted if "=" in part)
    log = read(config.log, parameters, names)
    if config.grade:
        log = read_grade(config.grade, log)
    kept = [part.split("=", 1)[0] for part in wanted]
    return log.only(kept) if kept else log


def _results(found: Identification) -> Results:
    """Checks, figure and notes of an identification."""
    report = Results("identify")
    for e in found.estimates:
        if e.identifiable:
            report.checks.append(Check(e.name, e.value, e.unit, e.prior))
        report.notes.append(str(e))
    if not any(e.identifiable for e in found.estimates):
        raise InputError("the log shows no parameter: " + found.estimates[0].reason)
    motion = found.motion
    if len(motion.time):
        for name, speed in (("before", motion.before), ("after", motion.after)):
            error = float(np.sqrt(np.mean((speed - motion.recorded) ** 2)))
            report.checks.append(Check(f"point mass {name}: speed error", error, "m/s", None))
        lines = (
            Line("recorded", motion.time, motion.recorded, "reference"),
            Line("before", motion.time, motion.before),
            Line("after", motion.time, motion.after, "simulation"),
        )
        panel = Panel("Point mass in the windows of the log", "time [s]", "speed [m/s]", lines)
        report.figures["identification"] = [panel]
    return report


def _add_replay(report: Results, log: Log, found: Identification, config: IdentifyConfig) -> None:
    """Drives the truck with prior and identified values; adds its speed accuracy and a plot.

    With prior values, the truck has the given mass, or half its payload.
    """
    given = None if any(e.name == "mass" for e in found.estimates) else found.mass
    p = found.parameters
    before = replay(log, p, payload_of(p, given))
    known = [] if config.parameters is None else [config.parameters]
    fitted = TruckParameters.load(config.truck, [*known, overlay(found)])
    after = replay(log, fitted, None if found.mass else payload_of(p, None))
    must = {"before": "", "after": f">= {_ACCURACY:g}"}
    for name, drive in (("before", before), ("after", after)):
        report.checks += [
            Check(f"truck {name}: speed accuracy", drive.accuracy(), "%", None, must[name]),
            Check(f"truck {name}: NRMSE fit of the speed", drive.fit(), "%"),
        ]
    lines = (
        Line("recorded", after.time, after.smoothed(), "reference"),
        Line("before", before.time, before.simulated),
        Line("after", after.time, after.simulated, "simulation"),
    )
    title = "The truck with the recorded commands, from start to end"
    report.figures["replay"] = [Panel(title, "time [s]", "speed [m/s]", lines)]
