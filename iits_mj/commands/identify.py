"""Fit the truck's parameters to a recorded log, for instance the telemetry of a drive."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.commands.output import ResultOptions, finish
from iits_mj.identification import command


@dataclass(frozen=True, kw_only=True)
class Options(command.IdentifyConfig, ResultOptions):
    """Flags of `iits-mj identify`."""


def run(options: Options) -> int:
    """Identifies and shows each parameter with its confidence."""
    return finish(options, lambda: command.run(options))
