"""Hold the truck against closed-form solutions, standards and the paper's figures.

Exit code 0 when every check holds, 1 when one falls short; the table says which.
"""

from __future__ import annotations

from dataclasses import dataclass

from iits_mj import validation
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.options import option
from iits_mj.results import Results
from iits_mj.validation import ValidateConfig


@dataclass(frozen=True, kw_only=True)
class Options(ValidateConfig, ResultOptions):
    """Flags of `iits-mj validate`."""

    what: str = option(
        "all",
        help="what to validate",
        choices=("all", *validation.COMMANDS),
        positional=True,
        metavar="WHAT",
    )


def run(options: Options) -> int:
    """Runs one group of checks, or all of them."""
    return finish(options, lambda: measure(options))


def measure(options: Options) -> Results:
    """The checks asked for, as one set of results."""
    if options.what != "all":
        return validation.COMMANDS[options.what](options)
    return Results.merged(
        "validate", [command(options) for command in validation.COMMANDS.values()]
    )
