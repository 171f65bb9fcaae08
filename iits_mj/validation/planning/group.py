"""`iits-mj validate planning`: runs planner, tracking and predictive cruise control in order."""

from __future__ import annotations

from collections.abc import Callable

from iits_mj.core.progress import each
from iits_mj.core.results import Results
from iits_mj.validation.harness.config import ValidateConfig, check_folder
from iits_mj.validation.planning.path_tracking import run_path_tracking
from iits_mj.validation.planning.pcc_receding import run_receding
from iits_mj.validation.planning.pcc_replay import run_replay
from iits_mj.validation.planning.pcc_savings import run_savings
from iits_mj.validation.planning.planning_traffic import run_traffic
from iits_mj.validation.planning.situations import run_situations
from iits_mj.validation.planning.speed_tracking import run_speed_tracking

PARTS: dict[str, Callable[[ValidateConfig], Results]] = {
    "trajectory planner": run_situations,
    "path tracking": run_path_tracking,
    "speed tracking": run_speed_tracking,
    "speed planner": run_savings,
    "receding horizon": run_receding,
    "on the truck": run_replay,
    "in traffic": run_traffic,
}


def run(config: ValidateConfig) -> Results:
    """Runs every part in turn.

    Raises:
      InputError: `config.roads` is not a folder with roads, or a file in it cannot be read.
    """
    # Refuse unusable folders before the first measurement.
    missing = check_folder(config)
    results = Results("validate planning")
    for name in each(PARTS, "planning", str):
        found = PARTS[name](config)
        results.checks += found.checks
        results.figures |= {f"{name}: {title}": panels for title, panels in found.figures.items()}
        results.notes += [note for note in found.notes if note not in results.notes]
    if missing:
        results.notes.append(f"not measured, as --roads lacks them: {', '.join(missing)}")
    return results
