"""Compare truck, traffic and planning with theory, standards and the paper's figures.

Truck: closed-form solutions, standards and the paper. Traffic: the theory of its model and, with
--data, recorded traffic. Planning: its limits and bounds and the truck itself, with --roads on
other roads, too. Groups aeb, emergency braking by UN R131, alks, lane keeping by UN R157,
credibility, and measured, which needs --measured, are not part of all. --truck measures another
truck: all groups but those that drive the default truck only; group truck has its main figures on
one page. Exit code 0 when every check holds, 1 when a check falls short.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from iits_mj import validation
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core.errors import InputError
from iits_mj.core.options import option
from iits_mj.core.progress import each, task
from iits_mj.core.results import Results
from iits_mj.validation import ValidateConfig
from iits_mj.validation.traffic.group import MISSING

# Processor time of the groups [s], in full and in the quick form, for the time left.
SECONDS = {
    "lateral": (16.0, 8.0),
    "longitudinal": (65.0, 18.0),
    "standards": (83.0, 16.0),
    "pbs": (100.0, 14.0),
    "step-size": (170.0, 8.0),
    "plant": (80.0, 12.0),
    "traffic": (20.0, 3.0),
    "planning": (40.0, 7.0),
    "measured": (40.0, 10.0),
    "credibility": (280.0, 75.0),
    "aeb": (600.0, 25.0),
    "alks": (600.0, 15.0),
}


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

    All groups are those without "truck", whose figures are among them, "credibility", "aeb" and
    "alks", which take long, and "measured", which needs a file; of another truck than the default
    one also without `validation.DEFAULT_ONLY`. The quick form uses the laden truck only and leaves
    out the step sizes, which repeat the same figures.

    Raises:
      InputError: the group drives the default truck only, and another one is chosen.
    """
    other = not options.default_truck
    if options.measured is not None and options.what not in ("all", "measured"):
        raise InputError(
            f"validate {options.what} has no use for --measured: leave out one of both"
        )
    if options.measured is not None:
        options = replace(options, what="measured")
    if options.what != "all":
        if other and options.what in validation.DEFAULT_ONLY:
            allowed = [name for name in validation.COMMANDS if name not in validation.DEFAULT_ONLY]
            raise InputError(
                f"validate {options.what} drives the default truck: leave out --truck, or choose "
                f"one of {', '.join(allowed)}"
            )
        usual = SECONDS[options.what][options.quick] if options.what in SECONDS else None
        with task(f"validating {options.what}", usual=usual):
            return validation.COMMANDS[options.what](options)
    alone = {"truck", "credibility", "aeb", "alks", "measured"}
    left_out = alone | set(validation.DEFAULT_ONLY if other else ())
    if options.quick:
        left_out.add("step-size")
        options = replace(options, payload=options.payloads()[0])
    commands = {name: run for name, run in validation.COMMANDS.items() if name not in left_out}
    order = each(commands, "validating", str, lambda name: SECONDS[name][options.quick])
    whole = Results.merged("validate", [commands[name](options) for name in order])
    if other:
        names = ", ".join(validation.DEFAULT_ONLY)
        whole.command += f" {options.parameters.name}"
        whole.notes.append(f"Left out, as they drive the default truck only: {names}.")
    return whole
