"""Plan a fuel-optimal speed profile and compare it with a constant-speed cruise, in equal time."""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj.commands.output import ResultOptions, finish, prepare_folder
from iits_mj.validation.planning import pcc_command


@dataclass(frozen=True, kw_only=True)
class Options(pcc_command.PccCommandConfig, ResultOptions):
    """Flags of `iits-mj pcc`."""


def run(options: Options) -> int:
    """Plans and shows what is saved."""
    if options.profile is not None:
        prepare_folder(options.profile.parent, "profile")
    return finish(options, lambda: pcc_command.run(options))
