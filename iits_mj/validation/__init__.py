"""Manoeuvres, references and standards: what the truck model is worth, in figures.

`COMMANDS` names what `iits-mj validate` can run; each takes a `ValidateConfig` and gives `Results`.
"""

from collections.abc import Callable

from iits_mj.core.results import Results
from iits_mj.validation.handling import lateral, standards, step_size
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal import group as longitudinal
from iits_mj.validation.planning import group as planning
from iits_mj.validation.traffic import group as traffic

COMMANDS: dict[str, Callable[[ValidateConfig], Results]] = {
    "lateral": lateral.run,
    "longitudinal": longitudinal.run,
    "standards": standards.run,
    "step-size": step_size.run,
    "traffic": traffic.run,
    "planning": planning.run,
}

__all__ = ["COMMANDS", "ValidateConfig"]
