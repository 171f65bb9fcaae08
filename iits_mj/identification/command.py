"""`iits-mj identify`: its options, and its figures in the one shape of all commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj import options
from iits_mj.errors import InputError
from iits_mj.identification.identify import DEFAULT, Identification, identify
from iits_mj.identification.log import Log
from iits_mj.options import option
from iits_mj.parameters import TruckParameters
from iits_mj.results import Check, Line, Panel, Results


@dataclass(frozen=True, kw_only=True)
class IdentifyConfig:
    """What to identify from which log."""

    log: Path = option(help="telemetry table of a drive", metavar="LOG.csv", positional=True)
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
    names = DEFAULT if config.mass is None else (*DEFAULT, "engine_torque_scale")
    found = identify(Log.from_csv(config.log), parameters, names=names, mass=config.mass)
    if config.output is not None:
        if not found.overlay():
            raise InputError(f"log {str(config.log)!r} shows no parameter: nothing written")
        found.write_toml(config.output)
    return results(found)


def results(found: Identification) -> Results:
    """Checks, figure and notes of an identification."""
    report = Results("identify")
    for e in found.estimates:
        if e.identifiable:
            report.checks.append(Check(e.name, e.value, e.unit, e.prior))
            report.notes.append(f"{e.name}: {e.value:.5g} +/- {e.half_width:.2g} {e.unit} (95 %)")
        else:
            report.notes.append(f"{e.name}: not identifiable, {e.reason}; kept {e.prior:.5g}")
    error = found.speed_after - found.recorded
    spread = np.linalg.norm(found.recorded - found.recorded.mean())
    fit = 100.0 * (1.0 - np.linalg.norm(error) / spread) if spread > 0.0 else float("nan")
    report.checks.append(Check("fit of the model's speed", float(fit), "%", None, ">= 90"))
    report.figures["identification"] = [
        Panel(
            "Speed in the windows of the log",
            "time [s]",
            "speed [m/s]",
            (
                Line("recorded", found.time, found.recorded, "reference"),
                Line("before", found.time, found.speed_before),
                Line("after", found.time, found.speed_after, "simulation"),
            ),
        )
    ]
    return report
