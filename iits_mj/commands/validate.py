"""Compare the truck with closed-form solutions, standards and the paper's figures.

The traffic is compared with the theory of its model and, with --data, with recorded traffic. The
planning is compared with its limits and bounds and with the truck itself; with --roads also on
other roads. Exit code 0 when every check holds, 1 when one falls short; the table shows which.
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
    """Runs one group of checks, or all of them.

    Raises:
      InputError: the traffic alone was validated without recorded trajectories; the checks that
        need none have been shown.
    """
    code = finish(options, lambda: measure(options))
    if options.what == "traffic" and options.data is None:
        raise InputError(MISSING)
    return code


def measure(options: Options) -> Results:
    """The chosen checks as one set of results.

    The quick form of all groups uses the laden truck, and leaves out the step sizes, which repeat
    the same figures.
    """
    if options.what != "all":
        return validation.COMMANDS[options.what](options)
    commands = dict(validation.COMMANDS)
    if options.quick:
        del commands["step-size"]
        options = replace(options, payload=options.payloads()[0])
    return Results.merged("validate", [command(options) for command in commands.values()])
