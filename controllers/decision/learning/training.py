"""Training of the decision maker, as the command line and Python call it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from controllers.decision.learning.collection import MakeDrivers, WorldFactory
from controllers.decision.learning.config import TrainConfig
from controllers.decision.learning.log import LOG
from iits_mj.core.errors import InputError


@dataclass(frozen=True)
class TrainSummary:
    """Outcome.

    Attributes:
      weights: file of the best policy, None when no validation was without a collision.
      score: its validation score, -inf without one; log: the table.
      decisions: of the whole training; wall_time: of the same [s].
    """

    weights: Path | None
    log: Path
    score: float
    decisions: int
    wall_time: float


def train(
    config: TrainConfig,
    out: str | Path,
    progress: Callable[[int, int], None] | None = None,
    command: str = "",
    world: WorldFactory | None = None,
    note: Callable[[str], None] | None = None,
    drivers: MakeDrivers | None = None,
) -> TrainSummary:
    """Trains; leaves `ddqn.npz`, `policies/`, `training.csv` and `checkpoint.pt` in `out`.

    Args:
      config: settings.
      out: folder, made when missing.
      progress: called with (decisions done, decisions in all).
      command: the command line, recorded in the weights' metadata.
      world: picklable, makes the world of the second stage in a worker; None for the fast world.
      note: called with sentences for people.
      drivers: makes those who drive the trips; default: `config.jobs` processes of this machine.

    Raises:
      InputError: torch is missing, the folder is not usable, or the checkpoint does not fit.
      Error: a trip failed, its worker died, or the training diverged.
      KeyboardInterrupt: Ctrl-C, after a checkpoint was written.
    """
    try:
        import torch

        from controllers.decision.learning.training_loop import BEST, Training
    except ImportError as error:
        raise InputError("training needs torch: pip install 'iits-mj[train]'") from error
    torch.set_num_threads(1)
    if world is not None and config.fast_decisions >= config.decisions:
        raise InputError(
            f"fast-decisions {config.fast_decisions} is not allowed; use less than decisions "
            f"({config.decisions}), or train in the fast world alone"
        )
    training = Training(config, Path(out), command, world, note, drivers)
    training.run(progress)
    weights = Path(out) / BEST if math.isfinite(training.best) else None
    return TrainSummary(weights, Path(out) / LOG, training.best, training.decisions, training.wall)


__all__ = ["TrainConfig", "TrainSummary", "train"]
