"""What a training says of itself: `training.csv`, and TensorBoard's event files.

The table has a row for each validation, with means since the row before it; the event files have
the same figures, those of the learner once a round.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import fields
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from controllers.decision.trip import RewardTerms, TripSummary
from iits_mj.core.context import Closing

# --- Ctrl-C where it does no harm: only while waiting, never in the middle of a change of state ---

T = TypeVar("T")
_POLL = 0.2


class Interrupted(KeyboardInterrupt):
    """The first Ctrl-C, told at the next wait: the state is whole."""


class Interruption(Closing):
    """Takes Ctrl-C over until closed. A second one is told at once, as Python does.

    Python hands signals to the main thread only; in another one, nothing is taken over.
    """

    def __init__(self) -> None:
        self._asked = False
        self._main = threading.current_thread() is threading.main_thread()
        if self._main:
            self._before = signal.signal(signal.SIGINT, self._ask)

    def wait(self, outcome: Future[T]) -> T:
        """The outcome, or its error; `Interrupted` when Ctrl-C was pressed."""
        while True:
            if self._asked:
                raise Interrupted
            try:
                return outcome.result(timeout=_POLL)
            except TimeoutError:
                if outcome.done():
                    raise

    def close(self) -> None:
        """Gives Ctrl-C back."""
        if self._main:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        if self._asked:
            raise KeyboardInterrupt
        self._asked = True


# --- What a training says of itself: `training.csv`, and TensorBoard's event files ---

LOG, EVENTS = "training.csv", "tensorboard"
TERMS = tuple(field.name for field in fields(RewardTerms))
LEARNER = ("decisions_per_s", "loss", "mean_q", "td_error")
PROGRESS = ("epsilon", "replay_size", "updates", "trips")
TRIPS = (
    *("score_per_s", "speed_loss", "changes_per_trip", "unsafe_per_trip", "collisions"),
    *(f"{name}_per_s" for name in TERMS),
)
_GROUPS = (
    ("training", (*PROGRESS, *LEARNER, *TRIPS)),
    ("validation", TRIPS),
)
COLUMNS = (
    "decisions",
    "wall_s",
    *(f"{group}_{name}" for group, names in _GROUPS for name in names),
)
NO_EVENTS = "no event files are written: pip install 'tensorboard>=2.17' brings what does it"


def trip_figures(summaries: list[TripSummary]) -> dict[str, float]:
    """Means over trips, by the names of `TRIPS`; terms of the reward are per second."""

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
    """Running means by name, to be read and begun anew; a checkpoint keeps them."""

    def __init__(self, sums: dict[str, list[float]] | None = None) -> None:
        self.sums = sums or {}

    def add(self, figures: dict[str, float], weight: float = 1.0) -> None:
        """Takes up values, counted `weight` times."""
        for name, value in figures.items():
            total = self.sums.setdefault(name, [0.0, 0.0])
            total[0] += weight * value
            total[1] += weight

    def join(self, other: Means) -> None:
        """Takes up what another one has."""
        for name, (value, weight) in other.sums.items():
            total = self.sums.setdefault(name, [0.0, 0.0])
            total[0] += value
            total[1] += weight

    def take(self) -> dict[str, float]:
        """The means; begins anew."""
        means = {name: total / weight for name, (total, weight) in self.sums.items()}
        self.sums = {}
        return means


class TrainLog:
    """Writes both files.

    Args:
      out: folder; rows: of the table so far, without header; decisions: so far. What the files of
        an interrupted training hold beyond these is dropped.
      note: called with a sentence when TensorBoard's package is missing.
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
        """Figures for the event files."""
        if self._events is not None:
            for name, value in figures.items():
                self._events.add_scalar(f"{group}/{name}", value, decisions)
            self._events.flush()

    def row(
        self, decisions: int, wall: float, training: dict[str, float], validation: dict[str, float]
    ) -> None:
        """A row of the table; a figure that is not there yet is left empty."""
        cells = [str(decisions), f"{wall:.1f}"]
        for (_, names), figures in zip(_GROUPS, (training, validation), strict=True):
            cells += [f"{figures[name]:.6g}" if name in figures else "" for name in names]
        self.rows.append(",".join(cells))
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(self.rows[-1] + "\n")

    def close(self) -> None:
        """Ends the event file."""
        if self._events is not None:
            self._events.close()
