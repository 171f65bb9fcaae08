"""Fit the truck's parameters to a log, such as the telemetry of a drive."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.commands.output import ResultOptions, finish
from iits_mj.identification import command


@dataclass(frozen=True, kw_only=True)
class Options(command.IdentifyConfig, ResultOptions):
    """Flags of `iits-mj identify`."""


def run(options: Options) -> int:
    """Fits the parameters and shows each with its confidence; returns the exit code."""
    return finish(options, lambda: command.run(options))
