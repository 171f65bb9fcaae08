"""What the page of `iits-mj evaluate` says: sections of sentences and tables, without a format."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from iits_mj.evaluation import tables
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.figures import (
    PAPER_LOSS_PERCENT,
    POLICY,
    RIVAL,
    ROOM_MIN,
    RULES,
    STRONGER,
    CellFigures,
    over_all,
    stronger_text,
)
from iits_mj.evaluation.results import WORLD_TEXT, difference_text
from iits_mj.evaluation.tables import Section
from iits_mj.evaluation.trials import Trial, codes_of

# Settings that say where and how fast trials were driven, not which.
_NOT_SAID = ("jobs", "file", "drive")


def sections(
    cells: Sequence[CellFigures], trials: Sequence[Trial], config: EvaluateConfig
) -> list[Section]:
    """All sections of the page, in its order."""
    return [
        _origin(trials, config),
        _paper_table(cells, config.names()),
        _verdicts(cells),
        _pairs(cells),
        tables.details(cells),
        tables.safety(cells),
        tables.effort(cells),
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
        "the same drive without traffic: what the start, hills and the stop before the road's end "
        "take. The paper's 10.0 of aggressive in sparse 15 is as printed, probably 1.0."
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
        "the free road, so that even no traffic at all would gain less than counts, and the policy "
        "does not lose that much more. Where neither of the stronger rules "
        f"({', '.join(STRONGER)}) is better than the best rule beyond chance (p < 0.05 in either "
        "test, not corrected), nothing is shown to be left to win, and no p is asked for; the "
        "lowest mean is.",
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
                stronger_text(cell),
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
            "stronger rules less it [points]",
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
