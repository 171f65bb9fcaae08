"""The checks of `iits-mj evaluate`, and its tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from iits_mj.core.results import Check, Results
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.figures import (
    PAPER_LOSS_PERCENT,
    POLICY,
    RIVAL,
    ROOM_MIN,
    SIGNIFICANT,
    CellFigures,
    figures,
    over_all,
)
from iits_mj.evaluation.trials import Trial
from iits_mj.validation.harness.statistics import Paired

WORLD_TEXT = {
    "fast": "fast world: point-mass truck in numpy IDM and MOBIL traffic, no SUMO, no MuJoCo",
    "full": "full chain: MuJoCo truck, planner and tracking in SUMO traffic that fills both lanes "
    "and reacts to it, built-in highway, reference 16.67 m/s, start at the traffic's limit",
}


def summarize(trials: Sequence[Trial], config: EvaluateConfig) -> tuple[Results, list[CellFigures]]:
    """Checks and tables of trials, and the figures they are made of."""
    cells = figures(trials, config.chosen_cells(), config.names())
    results = Results("evaluate", seed=config.seed)
    for cell in cells:
        results.checks += _cell_checks(cell)
    results.checks += _average_checks(cells)
    results.notes = [
        f"{WORLD_TEXT[config.world]}; load {config.payload / 1000.0:g} t, physics in steps of "
        f"{1000.0 * config.timestep:g} ms; {config.seeds} seeds, the same for all methods"
    ]
    for cell in cells:
        results.notes += ["", *cell_text(cell)]
    results.notes += ["", *verdict_text(cells)]
    return results, cells


def cell_text(cell: CellFigures) -> list[str]:
    """A cell's table, 100 columns at most."""
    counts = sorted({len(rows) for rows in cell.trials.values()})
    shown = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
    lines = [
        f"{cell.name} m/s, {shown} trips; free road {cell.floor:.2f} %",
        "  method        paper   loss [%]  95 %     std   changes  95 %   refused  unsafe  "
        "collisions",
    ]
    for name, rows in cell.trials.items():
        loss, changes = cell.loss[name], cell.changes[name]
        reference = f"{paper[name]:5.1f}" if name in paper else "     "
        refused, unsafe = (sum(t.refused for t in rows), sum(t.unsafe for t in rows))
        lines.append(
            f"  {name:13s} {reference} {loss.mean:10.2f} ±{loss.half:5.2f} {loss.std:7.2f} "
            f"{changes.mean:9.2f} ±{changes.half:5.2f} {refused / len(rows):8.2f} "
            f"{unsafe / len(rows):7.2f} {sum(t.collisions for t in rows):11d}"
        )
    return lines


def verdict_text(cells: Sequence[CellFigures]) -> list[str]:
    """Who wins where, and the policy against the look-ahead over all cells."""
    lines = [f"{cell.name}: {cell.verdict}: {cell.reason}" for cell in cells if cell.verdict]
    level = over_all(cells, POLICY, RIVAL)
    if level is not None:
        lines.append(f"all cells, {POLICY} less {RIVAL}: {difference_text(level)}")
    return lines


def difference_text(difference: Paired) -> str:
    """A paired difference of speed losses with its tests."""
    return (
        f"{difference.mean:+.2f} ± {difference.half:.2f} points over {difference.count} trips, "
        f"p = {difference.t_p:.2g} (t), {difference.wilcoxon_p:.2g} (Wilcoxon)"
    )


def shortfall(check: Check) -> str:
    """A check that does not hold, in words."""
    unit = "" if check.unit == "1" else f" {check.unit}"
    return f"{check.name}: {check.value:.4g}{unit}, must be {check.must}"


def _cell_checks(cell: CellFigures) -> list[Check]:
    checks = []
    paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
    for name, rows in cell.trials.items():
        label = f"{cell.name}, {name}: "
        checks += [
            Check(label + "speed loss", cell.loss[name].mean, "%", paper.get(name)),
            Check(label + "lane changes", cell.changes[name].mean, "1"),
            Check(label + "collisions", float(sum(t.collisions for t in rows)), "1", None, "<= 0"),
            Check(
                label + "trips that failed", float(sum(t.failures for t in rows)), "1", None, "<= 0"
            ),
        ]
    if not cell.verdict:
        return checks
    versus = cell.against[cell.best]
    label = f"{cell.name}: speed loss, {POLICY} less {cell.best}"
    checks += [
        Check(
            label + (" (trivial cell)" if cell.trivial else ""),
            versus.mean,
            "% points",
            f"±{versus.half:.2f}",
            f"<= {ROOM_MIN:g}" if cell.trivial else "< 0",
        ),
        Check(
            label + ", p" + ("" if cell.winnable or cell.trivial else " (no stronger rule wins)"),
            cell.holm,
            "1",
            f"t {versus.t_p:.2g}, Wilcoxon {versus.wilcoxon_p:.2g}",
            f"< {SIGNIFICANT:g}" if cell.winnable else "",
        ),
    ]
    if (more := cell.more_changes.get("aggressive")) is not None:
        checks.append(
            Check(
                f"{cell.name}: lane changes, {POLICY} less aggressive",
                more.mean,
                "1",
                f"±{more.half:.2f}",
                "<= 0",
            )
        )
    return checks


def _average_checks(cells: Sequence[CellFigures]) -> list[Check]:
    """The policy is level with the look-ahead when it is not worse by more than chance."""
    level = over_all(cells, POLICY, RIVAL)
    if level is None:
        return []
    label = f"all cells: speed loss, {POLICY} less {RIVAL}"
    shown = f"p {level.t_p:.2g}, Wilcoxon {level.wilcoxon_p:.2g}"
    return [
        Check(label, level.mean, "% points", f"±{level.half:.2f}, {shown}"),
        Check(label + ", lower end of the interval", level.low, "% points", None, "<= 0"),
    ]
