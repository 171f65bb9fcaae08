"""What the page of `iits-mj evaluate` says: sections of sentences and tables, without a format."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from iits_mj.simulation.summary import DIESEL_DENSITY
from iits_mj.validation.evaluate import EvaluateConfig
from iits_mj.validation.evaluate_figures import (
    PAPER_LOSS_PERCENT,
    POLICY,
    RIVAL,
    ROOM_MIN,
    RULES,
    CellFigures,
    over_all,
)
from iits_mj.validation.evaluate_results import WORLD_TEXT, difference_text
from iits_mj.validation.trials import CLOSE, Trial, codes_of

# Settings that say where and how fast trials were driven, not which.
_NOT_SAID = ("jobs", "file", "drive")


@dataclass(frozen=True)
class Section:
    """A heading with sentences and perhaps a table below it."""

    title: str
    sentences: tuple[str, ...] = ()
    header: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()


def sections(
    cells: Sequence[CellFigures], trials: Sequence[Trial], config: EvaluateConfig
) -> list[Section]:
    """All sections of the page, in its order."""
    return [
        _origin(trials, config),
        _paper_table(cells, config.names()),
        _verdicts(cells),
        _pairs(cells),
        _details(cells),
        _safety(cells),
        _effort(cells),
    ]


def command_of(config: EvaluateConfig) -> str:
    """The command line that drives these trials, settings that are the default left out."""
    words = ["iits-mj evaluate"]
    for field in dataclasses.fields(EvaluateConfig):
        value = getattr(config, field.name)
        if value == field.default or field.name in _NOT_SAID:
            continue
        shown = value.name if isinstance(value, Path) else str(value)
        words.append(f"--{field.name.replace('_', '-')} {shown}")
    return " ".join(words)


def _origin(trials: Sequence[Trial], config: EvaluateConfig) -> Section:
    counts = {name: [t for t in trials if t.method == name] for name in config.names()}
    versions = codes_of(trials)
    weights = sorted({t.weights for t in trials if t.weights})
    sentences = [
        f"World: {WORLD_TEXT[config.world]}.",
        f"Trips: {config.trials} of each method in each cell, {config.length / 1e3:g} km or to the "
        f"road's end, {config.duration:g} s at most; the {config.seeds} seeds, set {config.seed}, "
        "the same traffic for all methods. "
        + ", ".join(f"{name} {len(rows)}" for name, rows in counts.items())
        + " trips were driven.",
        "The test seeds are used by neither training nor the choice of a policy."
        if config.seeds == "test"
        else "Validation seeds serve for choosing a policy: its figures here are too good.",
        f"Command: `{command_of(config)}`. The trips are of {len(versions)} version"
        f"{'' if len(versions) == 1 else 's'} of the code: {_versions(counts)}.",
    ]
    if weights:
        sentences.append(f"Weights of {POLICY}: SHA-256 {', '.join(weights)}...")
    return Section("What these figures are", tuple(sentences))


def _versions(counts: dict[str, list[Trial]]) -> str:
    methods: dict[str, list[str]] = {}
    for name, rows in counts.items():
        if rows:
            methods.setdefault(" and ".join(codes_of(rows)), []).append(name)
    return "; ".join(f"{codes} ({', '.join(names)})" for codes, names in methods.items())


def _paper_table(cells: Sequence[CellFigures], names: Sequence[str]) -> Section:
    sentence = (
        "Speed loss, the mean over time of (v_ref - v) / v_ref, in %: the paper's figure / ours "
        "with half of its 95 % interval (Student's t). Bold: the lowest of ours. The free road is "
        "the same drive without traffic: what hills and the start alone take."
    )
    rows = []
    for cell in cells:
        paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
        lowest = min(cell.loss, key=lambda name: cell.loss[name].mean)
        row = [cell.name, f"{cell.floor:.2f}"]
        for name in names:
            if name not in cell.loss:
                row.append("")
                continue
            own = f"{cell.loss[name].mean:.2f} ± {cell.loss[name].half:.2f}"
            own = f"**{own}**" if name == lowest else own
            row.append(f"{paper[name]:.1f} / {own}" if name in paper else own)
        rows.append(tuple(row))
    return Section(
        "The paper's table and ours",
        (sentence,),
        ("cell [m/s]", "free road", *names),
        tuple(rows),
    )


def _verdicts(cells: Sequence[CellFigures]) -> Section:
    sentences = [
        f"{POLICY} wins where its mean is the lowest of the paper's four and either the intervals "
        "of it and the best rule do not overlap, or the paired t-test over the same trips has "
        "p < 0.05 after Holm's correction for the number of cells. A cell is trivial when the best "
        f"of the paper's rules ({', '.join(RULES)}) loses less than {ROOM_MIN:g} points more than "
        "the free road, so that even no traffic at all would gain less than counts, or when the "
        "intervals of all four overlap and the test tells nothing.",
    ]
    level = over_all(cells, POLICY, RIVAL)
    if level is not None:
        sentences.append(f"All cells together, {POLICY} less {RIVAL}: {difference_text(level)}.")
    rows = []
    for cell in cells:
        if not cell.verdict:
            continue
        versus = cell.against[cell.best]
        rows.append(
            (
                cell.name,
                f"**{cell.verdict}**",
                cell.best,
                f"{versus.mean:+.2f} ± {versus.half:.2f}",
                f"{versus.t_p:.2g}",
                f"{versus.wilcoxon_p:.2g}",
                f"{cell.holm:.2g}",
                f"{cell.room:.2f}",
                cell.reason if cell.trivial else "",
            )
        )
    return Section(
        "Verdicts",
        tuple(sentences),
        (
            "cell",
            "verdict",
            "best rule",
            f"{POLICY} less it [points]",
            "p (t)",
            "p (Wilcoxon)",
            "p (t, Holm)",
            "room [points]",
            "why",
        ),
        tuple(rows),
    )


def _pairs(cells: Sequence[CellFigures]) -> Section:
    names = list(dict.fromkeys(name for cell in cells for name in cell.against))
    rows = [
        (
            cell.name,
            *(
                f"{cell.against[n].mean:+.2f} ± {cell.against[n].half:.2f} "
                f"({cell.against[n].t_p:.2g}; {cell.against[n].wilcoxon_p:.2g})"
                if n in cell.against
                else ""
                for n in names
            ),
        )
        for cell in cells
        if cell.against
    ]
    together = [over_all(cells, POLICY, n) for n in names]
    if rows:
        shown = [
            "" if d is None else f"{d.mean:+.2f} ± {d.half:.2f} ({d.t_p:.2g}; {d.wilcoxon_p:.2g})"
            for d in together
        ]
        rows.append(("all", *shown))
    return Section(
        f"{POLICY} against each",
        (
            f"Speed loss of {POLICY} less the other's over the same trips, in points, with half of "
            "the 95 % interval, and p of the paired t-test and of Wilcoxon's signed ranks, not "
            "corrected. Below zero the policy is better.",
        ),
        ("cell", *names),
        tuple(rows),
    )


def _details(cells: Sequence[CellFigures]) -> Section:
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            loss, changes = cell.loss[name], cell.changes[name]
            more = cell.more_changes.get(name)
            rows.append(
                (
                    cell.name,
                    name,
                    str(len(own)),
                    f"{loss.mean:.2f} ± {loss.half:.2f}",
                    f"{loss.std:.2f}",
                    f"{loss.mean - cell.floor:.2f}",
                    f"{changes.mean:.2f} ± {changes.half:.2f}",
                    f"{changes.std:.2f}",
                    "" if more is None else f"{more.mean:+.2f} ± {more.half:.2f}",
                )
            )
    return Section(
        "Speed loss and lane changes",
        (),
        (
            "cell",
            "method",
            "trips",
            "loss [%]",
            "std",
            "above the free road",
            "changes a trip",
            "std",
            f"changes, {POLICY} less it",
        ),
        tuple(rows),
    )


def _safety(cells: Sequence[CellFigures]) -> Section:
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            way = sum(t.distance for t in own) / 1e5
            rows.append(
                (
                    cell.name,
                    name,
                    str(sum(t.collisions for t in own)),
                    str(sum(t.failures for t in own)),
                    f"{sum(t.unsafe for t in own) / way:.2f}",
                    f"{sum(t.refused for t in own) / way:.2f}",
                    f"{min(t.time_gap for t in own):.2f}",
                    f"{np.median([t.time_gap for t in own]):.2f}",
                    f"{100.0 * _weighted(own, 'close_share'):.2f}",
                    f"{min(t.box_distance for t in own):.2f}",
                )
            )
    return Section(
        "Safety",
        (
            "Unsafe: decisions to change that the planner refused because of a vehicle; refused: "
            "all that it refused. The time gap is the bumper gap to the vehicle ahead in the "
            "truck's way over the truck's speed, above 1 m/s, looked at every 0.1 s. One that cuts "
            "in counts from the instant its box reaches into the truck's width, so that the least "
            "time gap is often another driver's doing, and not the policy's; the share of the time "
            f"under {CLOSE:g} s shows how long it lasted.",
        ),
        (
            "cell",
            "method",
            "collisions",
            "failed trips",
            "unsafe per 100 km",
            "refused per 100 km",
            "least time gap [s]",
            "its median over trips",
            f"time under {CLOSE:g} s [%]",
            "closest box [m]",
        ),
        tuple(rows),
    )


def _effort(cells: Sequence[CellFigures]) -> Section:
    rows = []
    for cell in cells:
        for name, own in cell.trials.items():
            fuel = sum(t.fuel for t in own) / DIESEL_DENSITY
            rates = np.mean([t.reward_rates for t in own], axis=0)
            rows.append(
                (
                    cell.name,
                    name,
                    f"{fuel / (sum(t.distance for t in own) / 1e5):.1f}",
                    f"{np.mean([t.distance for t in own]) / 1e3:.2f}",
                    f"{np.mean([t.time for t in own]):.0f}",
                    *(f"{rate:.3f}" for rate in rates),
                    f"{np.mean([t.wall_time for t in own]):.0f}",
                )
            )
    return Section(
        "Fuel, time and reward",
        (
            "Reward: its terms a second, means over the trips, not discounted. Wall time: of a "
            "trip on the computer that drove it, whatever else it did.",
        ),
        (
            "cell",
            "method",
            "fuel [l/100 km]",
            "distance [km]",
            "time [s]",
            "reward: changes",
            "danger",
            "speed",
            "wall time [s]",
        ),
        tuple(rows),
    )


def _weighted(trials: Sequence[Trial], name: str) -> float:
    """Mean of a share of the time over trips."""
    return sum(getattr(t, name) * t.time for t in trials) / sum(t.time for t in trials)
