"""Hold the truck against closed-form solutions, standards and the paper's figures.

The traffic is held against the theory of its model and, with --data, against recorded traffic; the
planning against its limits, bounds and the truck itself, with --roads on roads of others as well.
Exit code 0 when every check holds, 1 when one falls short; the table says which.
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
        help="what to validate",
        choices=("all", *validation.COMMANDS),
        positional=True,
        metavar="WHAT",
    )


def run(options: Options) -> int:
    """Runs one group of checks, or all of them.

    Raises:
      InputError: asked for the traffic alone, without recorded trajectories; what needs none has
        been checked and shown then.
    """
    code = finish(options, lambda: measure(options))
    if options.what == "traffic" and options.data is None:
        raise InputError(MISSING)
    return code


def measure(options: Options) -> Results:
    """The checks asked for, as one set of results.

    The quick form of all of them takes the laden truck, and leaves out the step sizes, which ask
    the same figures again.
    """
    if options.what != "all":
        return validation.COMMANDS[options.what](options)
    commands = dict(validation.COMMANDS)
    if options.quick:
        del commands["step-size"]
        options = replace(options, payload=options.payloads()[0])
    return Results.merged("validate", [command(options) for command in commands.values()])
