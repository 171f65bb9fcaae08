"""Figures of trials, cell by cell: estimates, paired differences, verdicts, checks and tables."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from iits_mj.core.results import Check, Findings, Results
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.hulls import (
    Comparison,
    against_hull,
    is_hull_rule,
    mean_over_cells,
)
from iits_mj.evaluation.quality import quality_figures
from iits_mj.evaluation.trials import EMPTY, LEFT_RANGE, Trial
from iits_mj.validation.harness.statistics import Estimate, Paired, estimate, holm, paired

WORLD_TEXT = {
    "fast": "fast world: point-mass truck in IDM and MOBIL traffic that {lanes}, no SUMO, no "
    "MuJoCo",
    "full": "full chain: MuJoCo truck, planner and tracking in SUMO traffic that {lanes} and "
    "reacts to it, built-in highway, reference 16.67 m/s, start at the traffic's limit",
}
LANES_TEXT = {"free": "fills both lanes", "right": "keeps right"}


def world_text(config: EvaluateConfig) -> str:
    """Returns the world of the trials in words."""
    text = WORLD_TEXT[config.world].format(lanes=LANES_TEXT[config.lane_discipline])
    return text if config.plant == "full" else f"{text}, with the plant {config.plant}"


# The paper's table: speed loss [%] of its methods in each cell. The 10.0 of aggressive in sparse 15
# is as printed; it is probably a misprint of 1.0.
PAPER_LOSS_PERCENT = {
    ("dense", 12.5): {"conservative": 38.9, "neutral": 28.5, "aggressive": 24.5, "ddqn": 24.0},
    ("dense", 15.0): {"conservative": 30.9, "neutral": 20.1, "aggressive": 18.8, "ddqn": 17.3},
    ("medium", 12.5): {"conservative": 14.1, "neutral": 13.8, "aggressive": 6.6, "ddqn": 8.0},
    ("medium", 15.0): {"conservative": 4.4, "neutral": 1.6, "aggressive": 1.6, "ddqn": 1.4},
    ("sparse", 12.5): {"conservative": 5.9, "neutral": 3.4, "aggressive": 4.4, "ddqn": 3.4},
    ("sparse", 15.0): {"conservative": 1.0, "neutral": 1.0, "aggressive": 10.0, "ddqn": 1.0},
}
RULES = ("conservative", "neutral", "aggressive")
# Stronger rules of this project; they show whether a cell has room for improvement.
STRONGER = ("mobil", "lookahead")
POLICY, RIVAL = "ddqn", "lookahead"
SIGNIFICANT = 0.05
# A cell is trivial if even the empty road gains less than this over the best rule [% points]: no
# decision maker can win there, but a difference of this size in the other direction loses.
ROOM_MIN = 0.3
FEWEST = 10  # trips; with fewer, a difference within chance has no meaning


@dataclass(frozen=True)
class CellFigures:
    """Figures of one traffic cell.

    Attributes:
      density, speed: of the cell; trials: of each method, sorted by seed.
      loss [%], changes: estimates by method.
      against: loss of the policy less that of another method over the same trips, by method
        [% points].
      more_changes: the same difference of lane changes.
      stronger: loss of each of `STRONGER` less that of the best rule over the same trips.
      swept: trials of the rules of the sweep that are not among the methods.
      floor: loss without traffic [%], nan if unknown.
      best: the best of the paper's three rules, "" without trials of one; holm: p of the policy
        against it, corrected for the number of cells.
      verdict: one or two words; reason: a sentence.
    """

    density: str
    speed: float
    trials: Mapping[str, tuple[Trial, ...]]
    loss: Mapping[str, Estimate]
    changes: Mapping[str, Estimate]
    against: Mapping[str, Paired]
    more_changes: Mapping[str, Estimate]
    stronger: Mapping[str, Paired]
    swept: Mapping[str, tuple[Trial, ...]]
    floor: float
    best: str = ""
    holm: float = math.nan
    verdict: str = ""
    reason: str = ""

    @property
    def name(self) -> str:
        """Density and speed limit in m/s."""
        return f"{self.density} {self.speed:g}"

    @property
    def room(self) -> float:
        """Gain of a truck on an empty road over the best rule [% points]."""
        return self.loss[self.best].mean - self.floor if self.best else math.nan

    @functools.cached_property
    def comparisons(self) -> list[Comparison]:
        """The methods beside the hull of the rules, without the rules themselves."""
        everything = {**self.trials, **self.swept}
        found = (against_hull(everything, n) for n in self.trials if not is_hull_rule(n))
        return [one for one in found if one is not None]

    @property
    def trivial(self) -> bool:
        """Whether the cell leaves no room for improvement."""
        return self.verdict == "trivial"

    @property
    def winnable(self) -> bool:
        """Whether a stronger rule beats the best rule beyond chance, or has no trials.

        The tests are not corrected for their number, in favor of a winnable cell.
        """
        others = self.stronger.values()
        if self.trivial or not others or any(d.count < FEWEST for d in others):
            return not self.trivial
        return any(d.mean < 0.0 and min(d.t_p, d.wilcoxon_p) < SIGNIFICANT for d in others)


def figures(
    trials: Sequence[Trial], cells: Sequence[tuple[str, float]], methods: Sequence[str]
) -> list[CellFigures]:
    """Figures of the cells with trials, and their verdicts."""
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
    """Loss of one method less that of another over the same trips of all cells [% points]."""
    pairs = [
        pair
        for cell in cells
        if first in cell.trials and second in cell.trials
        for pair in same_seeds(cell.trials[first], cell.trials[second])
    ]
    return _losses(pairs) if pairs else None


def same_seeds(first: Sequence[Trial], second: Sequence[Trial]) -> list[tuple[Trial, Trial]]:
    """Pairs of trials with the same seed, and so with the same traffic."""
    others = {trial.seed: trial for trial in second}
    return [(trial, others[trial.seed]) for trial in first if trial.seed in others]


def _cell(
    trials: Sequence[Trial], density: str, speed: float, methods: Sequence[str]
) -> CellFigures:
    driven: dict[str, list[Trial]] = {}
    for trial in sorted(trials, key=lambda trial: trial.seed):
        if (trial.density, trial.traffic_speed) == (density, speed):
            driven.setdefault(trial.method, []).append(trial)
    own = {name: tuple(driven.pop(name)) for name in methods if name in driven}
    swept = {name: tuple(rows) for name, rows in driven.items()}
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
        swept if own else {},
        float(np.mean(free)) if free else math.nan,
        best,
    )


def _loss(trial: Trial) -> float:
    return 100.0 * trial.speed_loss


def _losses(pairs: Sequence[tuple[Trial, Trial]]) -> Paired:
    return paired([_loss(a) for a, _ in pairs], [_loss(b) for _, b in pairs])


def _judge(cell: CellFigures) -> CellFigures:
    """Adds the verdict and its reason."""
    versus = cell.against[cell.best]
    policy, best = cell.loss[POLICY], cell.loss[cell.best]
    significant = cell.holm < SIGNIFICANT
    apart = policy.high < best.low or best.high < policy.low
    matters = not (cell.room < ROOM_MIN and versus.mean < ROOM_MIN)
    difference = (
        f"{versus.mean:+.2f} ± {versus.half:.2f} points against {cell.best}, p = {cell.holm:.2g}"
    )
    if (significant or apart) and versus.mean > 0.0 and matters:
        verdict, reason = "loses", difference
    elif cell.room < ROOM_MIN:
        verdict = "trivial"
        reason = (
            f"{cell.best} loses {best.mean:.2f} %, the free road {cell.floor:.2f} %: "
            f"{cell.room:.2f} points are all that is left to gain, {ROOM_MIN:g} would count"
        )
    elif (significant or apart) and versus.mean < 0.0:
        verdict, reason = "wins", difference
    elif versus.count < FEWEST:
        verdict, reason = "too few trips", difference
    else:
        verdict, reason = "level", difference
        if cell.stronger:
            room = "there is more to win" if cell.winnable else "no stronger rule wins"
            reason += f"; {room}: {stronger_text(cell)}"
    return replace(cell, verdict=verdict, reason=reason)


def stronger_text(cell: CellFigures) -> str:
    """Differences of the stronger rules from the best rule."""
    return ", ".join(f"{n} {d.mean:+.2f} ± {d.half:.2f}" for n, d in cell.stronger.items())


def difference_text(difference: Paired) -> str:
    """A paired difference of speed losses with its tests."""
    return (
        f"{difference.mean:+.2f} ± {difference.half:.2f} points over {difference.count} trips, "
        f"p = {difference.t_p:.2g} (t), {difference.wilcoxon_p:.2g} (Wilcoxon)"
    )


def summarize(trials: Sequence[Trial], config: EvaluateConfig) -> tuple[Results, list[CellFigures]]:
    """Checks and tables of trials, and the figures of the cells."""
    cells = figures(trials, config.chosen_cells(), config.names())
    results = Results("evaluate", seed=config.seed)
    results.notes.append(
        f"{world_text(config)}; load {config.used_payload() / 1000.0:g} t, physics in steps "
        f"of {1000.0 * config.timestep:g} ms; {config.seeds} seeds, the same for all methods"
    )
    left = sum(LEFT_RANGE in trial.ended for trial in trials)
    if left:
        results.notes.append(f"in {left} of {len(trials)} trips the plant left its valid range")
    for cell in cells:
        _check_cell(results, cell)
        results.notes += ["", *_cell_table(cell)]
    verdicts = [f"{cell.name}: {cell.verdict}: {cell.reason}" for cell in cells if cell.verdict]
    results.notes += ["", *verdicts]
    level = over_all(cells, POLICY, RIVAL)
    if level is not None:
        # The policy is level with the look-ahead if it is not worse by more than chance.
        label = f"all cells: speed loss, {POLICY} less {RIVAL}"
        tests = f"±{level.half:.2f}, p {level.t_p:.2g}, Wilcoxon {level.wilcoxon_p:.2g}"
        results.checks += [
            Check(label, level.mean, "% points", tests),
            Check(f"{label}, lower end of the interval", level.low, "% points", None, "<= 0"),
        ]
        results.notes.append(f"all cells, {POLICY} less {RIVAL}: {difference_text(level)}")
    for method, known in hull_means(cells).items():
        label = f"mean of the cells: speed loss, {method} less the hull of the rules"
        results.checks.append(Check(label, known.mean, "% points", f"±{known.half:.2f}"))
        results.notes.append(
            f"mean of the cells that are not trivial, {method} less the hull of the rules: "
            f"{known.mean:+.2f} ± {known.half:.2f} points"
        )
    return results, cells


def hull_means(cells: Sequence[CellFigures]) -> dict[str, Estimate]:
    """Mean difference of each method from the hull over the cells that are not trivial."""
    found: dict[str, list[Comparison]] = {}
    for cell in cells:
        for one in () if cell.trivial else cell.comparisons:
            found.setdefault(one.method, []).append(one)
    return {method: mean_over_cells(rows) for method, rows in found.items()}


def _check_cell(results: Results, cell: CellFigures) -> None:
    paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
    for name, rows in cell.trials.items():
        found = Findings(f"{cell.name}, {name}")
        found.check("speed loss", cell.loss[name].mean, "%", paper.get(name))
        found.check("lane changes", cell.changes[name].mean, "1")
        found.check("collisions", sum(t.collisions for t in rows), "1", must="<= 0")
        found.check("trips that failed", sum(t.failures for t in rows), "1", must="<= 0")
        for figure in quality_figures(rows):
            if math.isfinite(figure.value):
                found.check(figure.name, figure.value, figure.unit)
        results.add("", found)
    if not cell.verdict:
        return
    found, versus = Findings(cell.name), cell.against[cell.best]
    title = f"speed loss, {POLICY} less {cell.best}"
    found.check(
        title + (" (trivial cell)" if cell.trivial else ""),
        versus.mean,
        "% points",
        f"±{versus.half:.2f}",
        f"<= {ROOM_MIN:g}" if cell.trivial else "< 0",
    )
    found.check(
        title + ", p" + ("" if cell.winnable or cell.trivial else " (no stronger rule wins)"),
        cell.holm,
        "1",
        f"t {versus.t_p:.2g}, Wilcoxon {versus.wilcoxon_p:.2g}",
        f"< {SIGNIFICANT:g}" if cell.winnable else "",
    )
    if (more := cell.more_changes.get("aggressive")) is not None:
        title = f"lane changes, {POLICY} less aggressive"
        found.check(title, more.mean, "1", f"±{more.half:.2f}", "<= 0")
    results.add("", found)


def _cell_table(cell: CellFigures) -> list[str]:
    """Table of a cell in at most 100 columns; a long name of a method makes it wider."""
    counts = sorted({len(rows) for rows in cell.trials.values()})
    shown = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
    width = max(13, *map(len, cell.trials))
    lines = [
        f"{cell.name} m/s, {shown} trips; free road {cell.floor:.2f} %",
        f"  {'method':{width}s} paper   loss [%]  95 %     std   changes  95 %   refused  unsafe  "
        "collisions",
    ]
    for name, rows in cell.trials.items():
        loss, changes = cell.loss[name], cell.changes[name]
        reference = f"{paper[name]:5.1f}" if name in paper else "     "
        refused, unsafe = (sum(t.refused for t in rows), sum(t.unsafe for t in rows))
        lines.append(
            f"  {name:{width}s} {reference} {loss.mean:10.2f} ±{loss.half:5.2f} {loss.std:7.2f} "
            f"{changes.mean:9.2f} ±{changes.half:5.2f} {refused / len(rows):8.2f} "
            f"{unsafe / len(rows):7.2f} {sum(t.collisions for t in rows):11d}"
        )
    return [*lines, *_quality_table(cell, width)]


def _quality_table(cell: CellFigures, width: int) -> list[str]:
    """Table of the quality of a cell's trips; empty if no trip has its figures."""
    found = {name: quality_figures(rows) for name, rows in cell.trials.items()}
    rows = {name: figures for name, figures in found.items() if figures}
    if not rows:
        return []
    heads = [(f.short, f"[{f.unit}]") for f in next(iter(rows.values()))]
    columns = [max(6, *map(len, head)) for head in heads]

    def line(name: str, cells: Sequence[str]) -> str:
        shown = (f"{cell:>{size}s}" for cell, size in zip(cells, columns, strict=True))
        return f"  {name:{width}s} {' '.join(shown)}"

    return [
        line("method", [head for head, _ in heads]),
        line("", [unit for _, unit in heads]),
        *(line(name, [f.text for f in figures]) for name, figures in rows.items()),
    ]
