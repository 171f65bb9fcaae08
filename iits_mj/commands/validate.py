"""Compare truck, traffic and planning with theory, standards and the paper's figures.

Truck: closed-form solutions, standards and the paper. Traffic: the theory of its model and, with
--data, recorded traffic. Planning: its limits and bounds and the truck itself, with --roads on
other roads, too. Exit code 0 when every check holds, 1 when a check falls short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from iits_mj import validation
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.results import Results
from iits_mj.validation import ValidateConfig
from iits_mj.validation.traffic.group import MISSING


@dataclass(frozen=True, kw_only=True)
class Options(ValidateConfig, ResultOptions):
    """Flags of `iits-mj validate`."""

    what: str = option(
        "all",
        help="group of checks",
        choices=("all", *validation.COMMANDS),
        positional=True,
        metavar="WHAT",
    )


def run(options: Options) -> int:
    """Runs one group of checks, or all groups; returns the exit code.

    Raises:
      InputError: group "traffic" without --data, after the checks that need no data.
    """
    code = finish(options, lambda: measure(options))
    if options.what == "traffic" and options.data is None:
        raise InputError(MISSING)
    return code


def measure(options: Options) -> Results:
    """Returns the selected checks as one set of results.

    The quick form of all groups uses the laden truck only and leaves out the step sizes, which
    repeat the same figures.
    """
    if options.what != "all":
        return validation.COMMANDS[options.what](options)
    commands = dict(validation.COMMANDS)
    if options.quick:
        del commands["step-size"]
        options = replace(options, payload=options.payloads()[0])
    return Results.merged("validate", [command(options) for command in commands.values()])
