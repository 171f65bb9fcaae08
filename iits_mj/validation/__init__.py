"""Validation of the truck, the traffic and the planning against references and standards.

`COMMANDS` names the groups of `iits-mj validate`; each takes a `ValidateConfig` and returns
`Results`.
"""

from collections.abc import Callable

from iits_mj.core.results import Results
from iits_mj.validation import measured
from iits_mj.validation.aeb import group as aeb
from iits_mj.validation.alks import group as alks
from iits_mj.validation.handling import credibility, plants, step_size
from iits_mj.validation.handling.group import run_lateral, run_standards
from iits_mj.validation.harness.config import ValidateConfig
from iits_mj.validation.longitudinal import group as longitudinal
from iits_mj.validation.pbs import group as pbs
from iits_mj.validation.planning import group as planning
from iits_mj.validation.traffic import group as traffic
from iits_mj.validation.truck import run as run_truck

COMMANDS: dict[str, Callable[[ValidateConfig], Results]] = {
    "lateral": run_lateral,
    "longitudinal": longitudinal.run,
    "standards": run_standards,
    "pbs": pbs.run,
    "step-size": step_size.run,
    "plant": plants.run,
    "traffic": traffic.run,
    "planning": planning.run,
    "aeb": aeb.run,
    "alks": alks.run,
    "truck": run_truck,
    "credibility": credibility.run,
    "measured": measured.run,
}
# Groups of the default truck and its surroundings: they refuse another truck.
DEFAULT_ONLY = ("plant", "traffic", "planning")

__all__ = ["COMMANDS", "DEFAULT_ONLY", "ValidateConfig"]
