"""`iits-mj identify`: its options, and its figures in the one shape of all commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj import options
from iits_mj.errors import InputError
from iits_mj.identification.grade import read_grade
from iits_mj.identification.identify import Identification, identify
from iits_mj.identification.log import Log
from iits_mj.identification.overlay import write_toml
from iits_mj.identification.sources import read
from iits_mj.options import option
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel, Results


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """What to identify from which log."""

    log: Path = option(
        help="telemetry table (.csv) or CAN log (candump .log, .asc, .blf) of a drive",
        metavar="LOG",
        positional=True,
    )
    signals: str = option(
        "",
        help="use these signals only; name=title where a table calls one otherwise",
        metavar="NAME,...",
    )
    grade: str = option(
        "",
        help="grade of the road: a number, or a table of station and grade (CSV)",
        metavar="GRADE|FILE.csv",
    )
    parameters: Path | None = option(None, help="overlay with prior values", metavar="FILE.toml")
    mass: float | None = option(
        None,
        help="gross mass when known; fits the torque scale instead",
        unit="kg",
        low=5e3,
        high=1.2e5,
    )
    output: Path | None = option(
        None, help="where to write the identified overlay", metavar="FILE.toml"
    )

    def __post_init__(self) -> None:
        options.check(self)


def run(config: IdentifyConfig) -> Results:
    """Identifies, writes the overlay when asked, and reports one check a parameter.

    Raises:
      InputError: the log or the overlay cannot be used.
    """
    parameters = TruckParameters.load(overlay=config.parameters)
    found = identify(load_log(config, parameters), parameters, mass=config.mass)
    if config.output is not None:
        write_toml(found, config.output)
    return results(found)


def load_log(config: IdentifyConfig, parameters: TruckParameters) -> Log:
    """The log with the grade and the signals that the options name."""
    wanted = [part.strip() for part in config.signals.split(",") if part.strip()]
    names = dict(part.split("=", 1) for part in wanted if "=" in part)
    log = read(config.log, parameters, names)
    if config.grade:
        log = read_grade(config.grade, log)
    kept = [part.split("=", 1)[0] for part in wanted]
    return log.only(kept) if kept else log


def results(found: Identification) -> Results:
    """Checks, figure and notes of an identification."""
    report = Results("identify")
    for e in found.estimates:
        if e.identifiable:
            report.checks.append(Check(e.name, e.value, e.unit, e.prior))
            report.notes.append(f"{e.name}: {e.value:.5g} +/- {e.half_width:.2g} {e.unit} (95 %)")
        else:
            report.notes.append(f"{e.name}: not identifiable, {e.reason}; kept {e.prior:.5g}")
    if not any(e.identifiable for e in found.estimates):
        raise InputError("the log shows no parameter: " + found.estimates[0].reason)
    motion = found.motion
    if len(motion.time):
        error = motion.after - motion.recorded
        spread = np.linalg.norm(motion.recorded - motion.recorded.mean())
        fit = 100.0 * (1.0 - np.linalg.norm(error) / spread) if spread > 0.0 else float("nan")
        report.checks.append(Check("fit of the model's speed", float(fit), "%", None, ">= 90"))
        report.figures["identification"] = [
            Panel(
                "Speed in the windows of the log",
                "time [s]",
                "speed [m/s]",
                (
                    Line("recorded", motion.time, motion.recorded, "reference"),
                    Line("before", motion.time, motion.before),
                    Line("after", motion.time, motion.after, "simulation"),
                ),
            )
        ]
    return report
