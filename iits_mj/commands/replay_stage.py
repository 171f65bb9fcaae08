"""Run one module of a recorded drive on its recorded inputs and compare its outputs.

'iits-mj drive --bag DIR' writes the bag. With the same code and settings the outputs are equal bit
for bit. --truck, --payload and the options of the parts, such as --decision and --lateral, change
the module; the table then shows how far its outputs are from the recorded ones in the same
situations. Exit code 0 when all outputs are equal, else 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from iits_mj.bag.mcap_file import read_bag
from iits_mj.bag.stages import STAGES, Comparison, run_stage
from iits_mj.commands.output import ResultOptions, finish
from iits_mj.core.options import option, part_option
from iits_mj.core.own_parts import AnyPart
from iits_mj.core.progress import each
from iits_mj.core.results import Check, Results
from iits_mj.parameters import AnyTruck, payload_option, truck_option
from iits_mj.simulation.config import PARTS

# Number of differing quantities to show, in alphabetical order.
_SHOWN = 12


def part(name: str) -> Any:
    """Returns a dataclass field for a part that replaces the recorded one."""
    return part_option(None, PARTS[name], f"{PARTS[name].name} that replaces the recorded one")


@dataclass(frozen=True, kw_only=True)
class Options(ResultOptions):
    """Flags of `iits-mj replay-stage`."""

    bag: Path = option(help="bag of the drive", positional=True, metavar="DIR")
    stage: str = option("all", help="module to run", choices=("all", *STAGES), group="run")
    map: Path | None = option(
        None,
        help="OpenDRIVE map of the drive; without it the built-in highway",
        metavar="FILE",
        group="road",
    )
    decision: AnyPart | None = part("decision")
    planner: AnyPart | None = part("planner")
    lateral: AnyPart | None = part("lateral")
    longitudinal: AnyPart | None = part("longitudinal")
    speed_planner: AnyPart | None = part("speed_planner")
    traffic_mode: AnyPart | None = part("traffic_mode")
    truck: AnyTruck | None = truck_option(
        "truck that replaces the recorded one", "the recorded one"
    )
    payload: float | None = payload_option(help="load that replaces the recorded one")


def run(options: Options) -> int:
    """Runs the stages and shows their differences; returns the exit code."""
    return finish(options, lambda: compare(options))


def compare(options: Options) -> Results:
    """Returns one check for each stage, and the greatest differences as notes."""
    bag = read_bag(options.bag)
    changes: dict[str, Any] = {
        name: getattr(options, name)
        for name in (*PARTS, "truck", "payload")
        if getattr(options, name) is not None
    }
    stages: tuple[str, ...] = STAGES if options.stage == "all" else (options.stage,)
    if options.stage == "all" and bag.options["traffic_mode"] == "none":
        stages = tuple(name for name in stages if name != "traffic")
    results = Results("replay-stage", seed=int(bag.options["seed"]))
    for name in each(stages, "running", str):
        _add(results, run_stage(bag, name, options.map, **changes))
    return results


def _add(results: Results, found: Comparison) -> None:
    name = f"{found.stage}: outputs that differ, of {found.count}"
    results.checks.append(Check(name, float(found.differing), "1", 0.0, "<= 0"))
    if found.first is None:
        return
    results.notes.append(f"{found.stage}: differs first at t = {found.first:.2f} s")
    for quantity in sorted(found.largest)[:_SHOWN]:
        results.notes.append(f"  {quantity}: at most {found.largest[quantity]:.4g} apart")
    left = len(found.largest) - _SHOWN
    if left > 0:
        results.notes.append(f"  and {left} more quantities")
