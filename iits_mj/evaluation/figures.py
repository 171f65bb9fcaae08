"""What trials come to, cell by cell: estimates, paired differences, and who wins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from iits_mj.evaluation.trials import EMPTY, Trial
from iits_mj.validation.harness.statistics import Estimate, Paired, estimate, holm, paired

# --- What trials come to, cell by cell: estimates, paired differences, and who wins ---

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
# Rules of our own, which show what a cell leaves to win.
STRONGER = ("mobil", "lookahead")
POLICY, RIVAL = "ddqn", "lookahead"
SIGNIFICANT = 0.05
# A cell in which even a truck alone would gain less over the best rule says nothing for a decision
# maker; it says something against one that loses as much [% points].
ROOM_MIN = 0.3
FEWEST = 10  # trips below which a difference within chance only says that there are few


@dataclass(frozen=True)
class CellFigures:
    """One traffic cell.

    Attributes:
      density, speed: which; trials: of each method, by seed.
      loss [%], changes: estimates by method.
      against: the policy's loss less another method's, over the same trips, by method [% points].
      more_changes: the policy's lane changes less another method's, likewise.
      stronger: loss of each of `STRONGER` less the best rule's, likewise.
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
    stronger: Mapping[str, Paired]
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

    @property
    def winnable(self) -> bool:
        """Whether a stronger rule is better than the best rule beyond chance, or none was driven.

        The tests are not corrected: in doubt there is something to win.
        """
        others = self.stronger.values()
        if self.trivial or not others or any(d.count < FEWEST for d in others):
            return not self.trivial
        return any(d.mean < 0.0 and min(d.t_p, d.wilcoxon_p) < SIGNIFICANT for d in others)


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
        for pair in same_seeds(cell.trials[first], cell.trials[second])
    ]
    return _losses(pairs) if pairs else None


def same_seeds(first: Sequence[Trial], second: Sequence[Trial]) -> list[tuple[Trial, Trial]]:
    """Trials of the same seeds: in one world, of the same traffic."""
    others = {trial.seed: trial for trial in second}
    return [(trial, others[trial.seed]) for trial in first if trial.seed in others]


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
        name: same_seeds(own[POLICY], rows)
        for name, rows in own.items()
        if POLICY in own and name != POLICY
    }
    free = [_loss(t) for t in trials if t.density == EMPTY and t.traffic_speed == speed]
    rules = [name for name in RULES if name in own]
    best = min(rules, key=lambda name: loss[name].mean) if rules else ""
    return CellFigures(
        density,
        speed,
        own,
        loss,
        {name: estimate([t.changes for t in rows]) for name, rows in own.items()},
        {name: _losses(both) for name, both in pairs.items()},
        {name: estimate([a.changes - b.changes for a, b in both]) for name, both in pairs.items()},
        {
            name: _losses(same_seeds(own[name], own[best]))
            for name in STRONGER
            if best and name in own
        },
        float(np.mean(free)) if free else math.nan,
        best,
    )


def _loss(trial: Trial) -> float:
    return 100.0 * trial.speed_loss


def _losses(pairs: Sequence[tuple[Trial, Trial]]) -> Paired:
    return paired([_loss(a) for a, _ in pairs], [_loss(b) for _, b in pairs])


def _judge(cell: CellFigures) -> CellFigures:
    """Says who wins, or why nobody can."""
    versus = cell.against[cell.best]
    policy, best = cell.loss[POLICY], cell.loss[cell.best]
    told = cell.holm < SIGNIFICANT
    apart = policy.high < best.low or best.high < policy.low
    matters = not (cell.room < ROOM_MIN and versus.mean < ROOM_MIN)
    difference = (
        f"{versus.mean:+.2f} ± {versus.half:.2f} points against {cell.best}, p = {cell.holm:.2g}"
    )
    if (told or apart) and versus.mean > 0.0 and matters:
        verdict, reason = "loses", difference
    elif cell.room < ROOM_MIN:
        verdict = "trivial"
        reason = (
            f"{cell.best} loses {best.mean:.2f} %, the free road {cell.floor:.2f} %: "
            f"{cell.room:.2f} points are all that is left to gain, {ROOM_MIN:g} would count"
        )
    elif (told or apart) and versus.mean < 0.0:
        verdict, reason = "wins", difference
    elif versus.count < FEWEST:
        verdict, reason = "too few trips", difference
    else:
        verdict, reason = "level", difference
        if cell.stronger:
            wins = "is more to win" if cell.winnable else "wins"
            who = "there" if cell.winnable else "no stronger rule"
            reason += f"; {who} {wins}: {stronger_text(cell)}"
    return replace(cell, verdict=verdict, reason=reason)


def stronger_text(cell: CellFigures) -> str:
    """What the stronger rules win over the best rule, or lose."""
    return ", ".join(f"{n} {d.mean:+.2f} ± {d.half:.2f}" for n, d in cell.stronger.items())
