"""What trials come to, cell by cell: estimates, paired differences, and who wins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from iits_mj.validation.evaluate_statistics import Estimate, Paired, estimate, holm, paired
from iits_mj.validation.trials import EMPTY, Trial

# The paper's table: speed loss [%] of its methods per cell. "10.0" of sparse, 15, aggressive is as
# printed, probably 1.0.
PAPER_LOSS_PERCENT = {
    ("dense", 12.5): {"conservative": 38.9, "neutral": 28.5, "aggressive": 24.5, "ddqn": 24.0},
    ("dense", 15.0): {"conservative": 30.9, "neutral": 20.1, "aggressive": 18.8, "ddqn": 17.3},
    ("medium", 12.5): {"conservative": 14.1, "neutral": 13.8, "aggressive": 6.6, "ddqn": 8.0},
    ("medium", 15.0): {"conservative": 4.4, "neutral": 1.6, "aggressive": 1.6, "ddqn": 1.4},
    ("sparse", 12.5): {"conservative": 5.9, "neutral": 3.4, "aggressive": 4.4, "ddqn": 3.4},
    ("sparse", 15.0): {"conservative": 1.0, "neutral": 1.0, "aggressive": 10.0, "ddqn": 1.0},
}
RULES = ("conservative", "neutral", "aggressive")
POLICY, RIVAL = "ddqn", "lookahead"
SIGNIFICANT = 0.05
# A cell in which even a truck alone would gain less over the best rule says nothing of a decision
# maker [% points].
ROOM_MIN = 0.3
FEWEST = 10  # trips below which overlapping intervals only say that there are few


@dataclass(frozen=True)
class CellFigures:
    """One traffic cell.

    Attributes:
      density, speed: which; trials: of each method, by seed.
      loss [%], changes: estimates by method.
      against: the policy's loss less another method's, over the same trips, by method [% points].
      more_changes: the policy's lane changes less another method's, likewise.
      floor: loss without traffic [%], nan when unknown.
      best: of the paper's three rules, "" without one; holm: p of the policy against it, corrected
        for the number of cells.
      verdict: one word or two; reason: a sentence.
    """

    density: str
    speed: float
    trials: Mapping[str, tuple[Trial, ...]]
    loss: Mapping[str, Estimate]
    changes: Mapping[str, Estimate]
    against: Mapping[str, Paired]
    more_changes: Mapping[str, Estimate]
    floor: float
    best: str = ""
    holm: float = math.nan
    verdict: str = ""
    reason: str = ""

    @property
    def name(self) -> str:
        """Density and limit in m/s."""
        return f"{self.density} {self.speed:g}"

    @property
    def room(self) -> float:
        """What a truck alone on the road gains over the best rule [% points]."""
        return self.loss[self.best].mean - self.floor if self.best else math.nan

    @property
    def trivial(self) -> bool:
        """Whether no decision maker can show anything here."""
        return self.verdict == "trivial"


def figures(
    trials: Sequence[Trial], cells: Sequence[tuple[str, float]], methods: Sequence[str]
) -> list[CellFigures]:
    """The cells' figures, judged together; cells without a trial are left out."""
    found = [_cell(trials, density, speed, methods) for density, speed in cells]
    known = [cell for cell in found if cell.trials]
    compared = [cell for cell in known if cell.best and POLICY in cell.trials]
    corrected = holm([cell.against[cell.best].t_p for cell in compared])
    judged = {
        cell.name: _judge(replace(cell, holm=p))
        for cell, p in zip(compared, corrected, strict=True)
    }
    return [judged.get(cell.name, cell) for cell in known]


def over_all(cells: Sequence[CellFigures], first: str, second: str) -> Paired | None:
    """The loss of one method less another's over the same trips of all cells [% points]."""
    pairs = [
        pair
        for cell in cells
        if first in cell.trials and second in cell.trials
        for pair in _pairs(cell.trials[first], cell.trials[second])
    ]
    if not pairs:
        return None
    return paired([_loss(a) for a, _ in pairs], [_loss(b) for _, b in pairs])


def _cell(
    trials: Sequence[Trial], density: str, speed: float, methods: Sequence[str]
) -> CellFigures:
    own: dict[str, tuple[Trial, ...]] = {}
    for name in methods:
        rows = [
            t for t in trials if (t.density, t.traffic_speed, t.method) == (density, speed, name)
        ]
        if rows:
            own[name] = tuple(sorted(rows, key=lambda t: t.seed))
    loss = {name: estimate([_loss(t) for t in rows]) for name, rows in own.items()}
    pairs = {
        name: _pairs(own[POLICY], rows)
        for name, rows in own.items()
        if POLICY in own and name != POLICY
    }
    free = [_loss(t) for t in trials if t.density == EMPTY and t.traffic_speed == speed]
    rules = [name for name in RULES if name in own]
    return CellFigures(
        density,
        speed,
        own,
        loss,
        {name: estimate([t.changes for t in rows]) for name, rows in own.items()},
        {
            name: paired([_loss(a) for a, _ in both], [_loss(b) for _, b in both])
            for name, both in pairs.items()
        },
        {name: estimate([a.changes - b.changes for a, b in both]) for name, both in pairs.items()},
        float(np.mean(free)) if free else math.nan,
        min(rules, key=lambda name: loss[name].mean) if rules else "",
    )


def _loss(trial: Trial) -> float:
    return 100.0 * trial.speed_loss


def _pairs(first: Sequence[Trial], second: Sequence[Trial]) -> list[tuple[Trial, Trial]]:
    """Trials of the same traffic."""
    others = {trial.seed: trial for trial in second}
    return [(trial, others[trial.seed]) for trial in first if trial.seed in others]


def _judge(cell: CellFigures) -> CellFigures:
    """Says who wins, or why nobody can."""
    versus, rules = cell.against[cell.best], [name for name in RULES if name in cell.loss]
    four = [cell.loss[name] for name in (*rules, POLICY)]
    policy, best = cell.loss[POLICY], cell.loss[cell.best]
    together = max(e.low for e in four) <= min(e.high for e in four)
    told = cell.holm < SIGNIFICANT
    apart = versus.count > 1 and (policy.high < best.low or best.high < policy.low)
    difference = (
        f"{versus.mean:+.2f} ± {versus.half:.2f} points against {cell.best}, p = {cell.holm:.2g}"
    )
    if cell.room < ROOM_MIN:
        verdict = "trivial"
        reason = (
            f"{cell.best} loses {best.mean:.2f} %, the free road {cell.floor:.2f} %: "
            f"{cell.room:.2f} points are all that is left to gain, {ROOM_MIN:g} would count"
        )
    elif (told or apart) and versus.mean < 0.0:
        verdict, reason = "wins", difference
    elif (told or apart) and versus.mean > 0.0:
        verdict, reason = "loses", difference
    elif together and versus.count >= FEWEST:
        verdict, reason = "trivial", f"all four lie within each other's intervals; {difference}"
    elif versus.count < FEWEST:
        verdict, reason = "too few trips", difference
    else:
        verdict, reason = "level", difference
    return replace(cell, verdict=verdict, reason=reason)
