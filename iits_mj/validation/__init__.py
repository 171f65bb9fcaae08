"""Manoeuvres, references and standards: what the truck model is worth, in figures.

`COMMANDS` names what `iits-mj validate` can run; each takes a `ValidateConfig` and gives `Results`.
"""

from collections.abc import Callable

from iits_mj.results import Results
from iits_mj.validation import lateral, longitudinal, planning, standards, step_size, traffic
from iits_mj.validation.config import ValidateConfig

COMMANDS: dict[str, Callable[[ValidateConfig], Results]] = {
    "lateral": lateral.run,
    "longitudinal": longitudinal.run,
    "standards": standards.run,
    "step-size": step_size.run,
    "traffic": traffic.run,
    "planning": planning.run,
}

__all__ = ["COMMANDS", "ValidateConfig"]
