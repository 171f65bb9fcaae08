"""Log of a training: `training.csv` and TensorBoard's event files.

The table has a row for each validation, with means since the previous row. The event files have the
same figures, those of the learner once per round.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from controllers.decision.trip import RewardTerms, TripSummary

LOG, EVENTS = "training.csv", "tensorboard"
TERMS = tuple(field.name for field in fields(RewardTerms))
LEARNER = ("decisions_per_s", "loss", "mean_q", "td_error")
PROGRESS = ("epsilon", "replay_size", "updates", "trips")
TRIPS = (
    *("score_per_s", "speed_loss", "changes_per_trip", "unsafe_per_trip", "collisions"),
    *(f"{name}_per_s" for name in TERMS),
)
_GROUPS = (("training", (*PROGRESS, *LEARNER, *TRIPS)), ("validation", TRIPS))
COLUMNS = (
    "decisions",
    "wall_s",
    *(f"{group}_{name}" for group, names in _GROUPS for name in names),
)
NO_EVENTS = "no event files: pip install 'tensorboard>=2.17' to write them"


def trip_figures(summaries: list[TripSummary]) -> dict[str, float]:
    """Returns means over trips, by the names of `TRIPS`; reward terms are per second."""

    def mean(figure: Callable[[TripSummary], float]) -> float:
        return float(np.mean([figure(summary) for summary in summaries]))

    figures = {
        "score_per_s": mean(lambda s: s.reward.total / s.time),
        "speed_loss": mean(lambda s: s.speed_loss),
        "changes_per_trip": mean(lambda s: s.changes),
        "unsafe_per_trip": mean(lambda s: s.dangerous),
        "collisions": mean(lambda s: s.collisions),
    }
    for term in TERMS:
        figures[f"{term}_per_s"] = mean(lambda s, t=term: getattr(s.reward, t) / s.time)  # type: ignore[misc]
    return figures


class Means:
    """Weighted means by name; a checkpoint stores their sums."""

    def __init__(self, sums: dict[str, list[float]] | None = None) -> None:
        self.sums = sums or {}

    def add(self, figures: dict[str, float], weight: float = 1.0) -> None:
        """Adds values with a weight."""
        self.join(Means({name: [weight * value, weight] for name, value in figures.items()}))

    def join(self, other: Means) -> None:
        """Adds the values of other means."""
        for name, (value, weight) in other.sums.items():
            total = self.sums.setdefault(name, [0.0, 0.0])
            total[0] += value
            total[1] += weight

    def take(self) -> dict[str, float]:
        """Returns the means so far and clears them."""
        means = {name: total / weight for name, (total, weight) in self.sums.items()}
        self.sums = {}
        return means


class TrainLog:
    """Writes both files.

    Args:
      out: folder; rows: of the table so far, without header; decisions: so far. Later entries of
        an interrupted training are removed.
      note: called with a sentence if TensorBoard is not installed.
    """

    def __init__(
        self, out: Path, rows: list[str], decisions: int, note: Callable[[str], None] | None
    ) -> None:
        self.rows = list(rows)
        self._path = out / LOG
        lines = [",".join(COLUMNS), *self.rows]
        self._path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        self._events: Any = None
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            if note is not None:
                note(NO_EVENTS)
        else:
            self._events = SummaryWriter(str(out / EVENTS), purge_step=decisions + 1)

    def scalars(self, group: str, decisions: int, figures: dict[str, float]) -> None:
        """Writes figures to the event files."""
        if self._events is not None:
            for name, value in figures.items():
                self._events.add_scalar(f"{group}/{name}", value, decisions)
            self._events.flush()

    def row(
        self, decisions: int, wall: float, training: dict[str, float], validation: dict[str, float]
    ) -> None:
        """Writes a row of the table; the cell of a missing figure is empty."""
        cells = [str(decisions), f"{wall:.1f}"]
        for (_, names), figures in zip(_GROUPS, (training, validation), strict=True):
            cells += [f"{figures[name]:.6g}" if name in figures else "" for name in names]
        self.rows.append(",".join(cells))
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(self.rows[-1] + "\n")

    def close(self) -> None:
        """Closes the event file."""
        if self._events is not None:
            self._events.close()
