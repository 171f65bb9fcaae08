"""The page of `iits-mj evaluate`: sections of text and tables as HTML and Markdown."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import iits_mj
from iits_mj.core.results import Results
from iits_mj.core.units import DIESEL_DENSITY
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.figures import (
    PAPER_LOSS_PERCENT,
    POLICY,
    RIVAL,
    ROOM_MIN,
    RULES,
    STRONGER,
    CellFigures,
    difference_text,
    hull_means,
    over_all,
    stronger_text,
    world_text,
)
from iits_mj.evaluation.pictures import draw_balance, draw_hulls, draw_trips
from iits_mj.evaluation.quality import EXPLANATION, quality_figures
from iits_mj.evaluation.trials import CLOSE, Trial, codes_of
from iits_mj.parameters import TruckParameters, label_of
from iits_mj.render import plots
from iits_mj.render.pages import (
    Page,
    Section,
    check_section,
    picture_section,
    slug,
    write_pictures,
)
from iits_mj.validation.harness.statistics import Estimate, Paired

TITLE = "Decision makers compared"
_DPI = 100
# Settings that do not select trials.
_NOT_SHOWN = ("jobs", "file", "drive")


def write_page(
    results: Results,
    cells: Sequence[CellFigures],
    trials: Sequence[Trial],
    config: EvaluateConfig,
    folder: Path,
) -> tuple[Path, Path]:
    """Writes `evaluate.html`, `evaluate.md` and the latter's pictures; returns the two pages.

    Args:
      results: the checks.
      cells: figures of the cells.
      trials: all trials.
      config: settings.
      folder: exists.
    """
    parts, names = sections(cells, trials, config), config.names()
    stem = slug(results.command)
    pictures = {
        "Speed loss of every trip": plots.to_png(draw_trips(cells, names), _DPI),
        "Speed loss over lane changes": plots.to_png(draw_balance(cells, names), _DPI),
    }
    if config.sweep:
        pictures["Hulls of the rules"] = plots.to_png(draw_hulls(cells), _DPI)
    lead = f"iits-mj {iits_mj.__version__}; {results.count_text()}"
    shown = [picture_section(caption, png) for caption, png in pictures.items()]
    web = Page(TITLE, lead, [*parts, Section("Checks", checks=results.checks), *shown])
    write_pictures(
        folder / stem, [(f"{slug(caption)}.png", png) for caption, png in pictures.items()]
    )
    linked = [picture_section(caption, f"{stem}/{slug(caption)}.png") for caption in pictures]
    text = Page(
        TITLE,
        f"Made by {lead}.",
        [*parts, *linked, check_section(results.checks, "Checks")],
        results.short(),
    )
    return web.write(folder / f"{stem}.html"), text.write(folder / f"{stem}.md")


def sections(
    cells: Sequence[CellFigures], trials: Sequence[Trial], config: EvaluateConfig
) -> list[Section]:
    """All sections of the page with text and tables, in their order."""
    return [
        _origin(trials, config),
        _paper_table(cells, config.names()),
        _verdicts(cells),
        _pairs(cells),
        _hulls(cells, config),
        _details(cells),
        _safety(cells),
        *_quality(cells),
        _effort(cells),
    ]


def command_of(config: EvaluateConfig) -> str:
    """The command line of these trials, without settings that have their default."""
    words = ["iits-mj evaluate"]
    for field in dataclasses.fields(EvaluateConfig):
        value = getattr(config, field.name)
        if value == field.default or field.name in _NOT_SHOWN:
            continue
        shown = value.name if isinstance(value, (Path, TruckParameters)) else str(value)
        words.append(f"--{field.name.replace('_', '-')} {shown}")
    return " ".join(words)


def _origin(trials: Sequence[Trial], config: EvaluateConfig) -> Section:
    counts = {name: [t for t in trials if t.method == name] for name in config.names()}
    versions = codes_of(trials)
    weights = sorted({t.weights for t in trials if t.weights})
    sentences = [
        f"World: {world_text(config)}. Truck: {label_of(config.truck)}.",
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
    return Section("What these figures are", sentences=sentences)


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
            own = _estimate(cell.loss[name])
            own = f"**{own}**" if name == lowest else own
            row.append(f"{paper[name]:.1f} / {own}" if name in paper else own)
        rows.append(row)
    header = " | ".join(("cell [m/s]", "free road", *names))
    return _table("The paper's table and ours", [sentence], header, rows)


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
                _difference(versus),
                f"{versus.t_p:.2g}",
                f"{versus.wilcoxon_p:.2g}",
                f"{cell.holm:.2g}",
                f"{cell.room:.2f}",
                stronger_text(cell),
                cell.reason if cell.trivial else "",
            )
        )
    header = (
        f"cell | verdict | best rule | {POLICY} less it [points] | p (t) | p (Wilcoxon) | "
        "p (t, Holm) | room [points] | stronger rules less it [points] | why"
    )
    return _table("Verdicts", sentences, header, rows)


def _pairs(cells: Sequence[CellFigures]) -> Section:
    names = list(dict.fromkeys(name for cell in cells for name in cell.against))
    compared = [(cell.name, cell.against) for cell in cells if cell.against]
    if compared:
        compared.append(("all", {n: d for n in names if (d := over_all(cells, POLICY, n))}))

    def text(difference: Paired | None) -> str:
        if difference is None:
            return ""
        return f"{_difference(difference)} ({difference.t_p:.2g}; {difference.wilcoxon_p:.2g})"

    rows = [(title, *(text(against.get(name)) for name in names)) for title, against in compared]
    sentence = (
        f"Speed loss of {POLICY} less the other's over the same trips, in points, with half of "
        "the 95 % interval, and p of the paired t-test and of Wilcoxon's signed ranks, not "
        "corrected. Below zero the policy is better."
    )
    return _table(f"{POLICY} against each", [sentence], " | ".join(("cell", *names)), rows)


def _hulls(cells: Sequence[CellFigures], config: EvaluateConfig) -> Section:
    rows = [
        (
            cell.name,
            one.method,
            f"{one.changes:.2f}",
            f"{one.loss:.2f}",
            f"{one.hull:.2f}",
            " and ".join(one.ends),
            _difference(one.difference),
        )
        for cell in cells
        for one in cell.comparisons
    ]
    rows += [
        ("mean of the cells that are not trivial", method, "", "", "", "", _difference(known))
        for method, known in hull_means(cells).items()
    ]
    rules = "swept rules" if config.sweep else "rules among these methods"
    sentence = (
        f"Speed loss [%] beside the lower hull of the {rules}, at the method's own number of lane "
        "changes: a point of the hull is a mixture of trips by the two rules. The difference is "
        "that over the same trips, in points, with half of its 95 % interval. Below zero the "
        "method is better. The hull's rules are chosen by these trips, which favors the rules."
    )
    header = "cell | method | changes | loss | hull | between | difference"
    return _table("Against the hull of the rules", [sentence], header, rows)


def _details(cells: Sequence[CellFigures]) -> Section:
    def row(cell: CellFigures, name: str, own: tuple[Trial, ...]) -> list[str]:
        loss, changes = cell.loss[name], cell.changes[name]
        more = cell.more_changes.get(name)
        return [
            str(len(own)),
            _estimate(loss),
            f"{loss.std:.2f}",
            f"{loss.mean - cell.floor:.2f}",
            _estimate(changes),
            f"{changes.std:.2f}",
            "" if more is None else _difference(more),
        ]

    header = (
        "trips | loss [%] | std | above the free road | changes a trip | "
        f"std | changes, {POLICY} less it"
    )
    return _by_method("Speed loss and lane changes", [], header, cells, row)


def _safety(cells: Sequence[CellFigures]) -> Section:
    def row(_: CellFigures, __: str, own: tuple[Trial, ...]) -> list[str]:
        way = sum(t.distance for t in own) / 1e5
        close = sum(t.close_share * t.time for t in own) / sum(t.time for t in own)
        return [
            str(sum(t.collisions for t in own)),
            str(sum(t.failures for t in own)),
            f"{sum(t.unsafe for t in own) / way:.2f}",
            f"{sum(t.refused for t in own) / way:.2f}",
            f"{min(t.time_gap for t in own):.2f}",
            f"{np.median([t.time_gap for t in own]):.2f}",
            f"{100.0 * close:.2f}",
            f"{min(t.box_distance for t in own):.2f}",
        ]

    sentence = (
        "Unsafe: decisions to change that the planner refused because of a vehicle; refused: "
        "all that it refused. The time gap is the bumper gap to the vehicle ahead in the "
        "truck's way over the truck's speed, above 1 m/s, looked at every 0.1 s. One that cuts "
        "in counts from the instant its box reaches into the truck's width, so that the least "
        "time gap is often another driver's doing, and not the policy's; the share of the time "
        f"under {CLOSE:g} s shows how long it lasted."
    )
    header = (
        "collisions | failed trips | unsafe per 100 km | refused per 100 km | least time gap [s] | "
        f"its median over trips | time under {CLOSE:g} s [%] | closest box [m]"
    )
    return _by_method("Safety", [sentence], header, cells, row)


def _quality(cells: Sequence[CellFigures]) -> list[Section]:
    """The section about lane changes and use of lanes, if the trips have its figures."""
    found = [
        (cell.name, name, figures)
        for cell in cells
        for name, own in cell.trials.items()
        if (figures := quality_figures(own))
    ]
    if not found:
        return []
    heads = [f"{figure.name} [{figure.unit}]" for figure in found[0][2]]
    rows = [(cell, name, *(f.text for f in figures)) for cell, name, figures in found]
    header = " | ".join(("cell", "method", *heads))
    return [_table("Lane changes and use of lanes", [EXPLANATION], header, rows)]


def _effort(cells: Sequence[CellFigures]) -> Section:
    def row(_: CellFigures, __: str, own: tuple[Trial, ...]) -> list[str]:
        fuel = sum(t.fuel for t in own) / DIESEL_DENSITY
        rates = np.mean([t.reward_rates for t in own], axis=0)
        return [
            f"{fuel / (sum(t.distance for t in own) / 1e5):.1f}",
            f"{np.mean([t.distance for t in own]) / 1e3:.2f}",
            f"{np.mean([t.time for t in own]):.0f}",
            *(f"{rate:.3f}" for rate in rates),
            f"{np.mean([t.wall_time for t in own]):.0f}",
        ]

    sentence = (
        "Reward: its terms a second, means over the trips, not discounted. Wall time: of a "
        "trip on the computer that drove it, whatever else it did."
    )
    header = (
        "fuel [l/100 km] | distance [km] | time [s] | reward: changes | danger | speed | "
        "wall time [s]"
    )
    return _by_method("Fuel, time and reward", [sentence], header, cells, row)


def _by_method(
    title: str,
    sentences: Sequence[str],
    header: str,
    cells: Sequence[CellFigures],
    row: Callable[[CellFigures, str, tuple[Trial, ...]], list[str]],
) -> Section:
    """A section with a row of figures for every method in every cell."""
    rows = [
        [cell.name, name, *row(cell, name, own)]
        for cell in cells
        for name, own in cell.trials.items()
    ]
    return _table(title, sentences, f"cell | method | {header}", rows)


def _table(
    title: str, sentences: Sequence[str], header: str, rows: Sequence[Sequence[str]]
) -> Section:
    """A section with a table, if it has rows; bars separate the names of the columns."""
    names = header.split(" | ") if rows else ()
    return Section(title, sentences=sentences, header=names, rows=rows)


def _estimate(value: Estimate) -> str:
    return f"{value.mean:.2f} ± {value.half:.2f}"


def _difference(value: Estimate) -> str:
    return f"{value.mean:+.2f} ± {value.half:.2f}"
