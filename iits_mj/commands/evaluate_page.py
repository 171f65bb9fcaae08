"""Writes the page of `iits-mj evaluate`, as HTML and as Markdown with the pictures beside it."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import iits_mj
from controllers.decision.trip import SPAWN_PROBABILITY, TRAFFIC_SPEEDS
from iits_mj.core.results import Results
from iits_mj.evaluation.evaluate import EvaluateConfig
from iits_mj.evaluation.figures import PAPER_LOSS_PERCENT, CellFigures
from iits_mj.evaluation.page import sections
from iits_mj.evaluation.results import shortfall
from iits_mj.evaluation.tables import Section
from iits_mj.evaluation.trials import Trial
from iits_mj.render import plots
from iits_mj.render import report as page
from iits_mj.render.plots import GRID, INK, PALETTE
from iits_mj.render.report import Report
from iits_mj.validation.harness.statistics import Estimate

# --- Pictures of `iits-mj evaluate`: every trip by method, and speed loss over lane changes ---

_COLORS = {
    "conservative": PALETTE[5],
    "neutral": PALETTE[2],
    "aggressive": PALETTE[3],
    "mobil": PALETTE[4],
    "lookahead": PALETTE[0],
    "ddqn": PALETTE[1],
    "keep": "#8a949e",
}
_SPREAD = 0.28  # of a method's dots to both sides
# Room above and below all trips, in parts of their range: a figure of the paper that is farther
# away is written at the panel's edge.
_ROOM = 0.25
_UP, _DOWN = "\u2191", "\u2193"
_BEYOND: dict[str, Any] = {
    "xycoords": ("data", "axes fraction"),
    "ha": "center",
    "fontsize": 8,
    "color": INK,
}
_BAR: dict[str, Any] = {"color": INK, "elinewidth": 1.6, "capsize": 4, "zorder": 4}
_PAPER: dict[str, Any] = {
    "marker": "D",
    "markerfacecolor": "white",
    "markeredgecolor": INK,
    "markersize": 6,
}


def draw_trips(cells: Sequence[CellFigures], methods: Sequence[str]) -> Figure:
    """Speed loss of every trip by method, a panel a cell, with means and the paper's figures."""

    def panel(ax: Axes, cell: CellFigures) -> None:
        paper = PAPER_LOSS_PERCENT[cell.density, cell.speed]
        low, high = _range(cell)
        for i, name in enumerate(methods):
            if name in paper and low <= paper[name] <= high:
                ax.plot(i, paper[name], linestyle="", zorder=5, **_PAPER)
            elif name in paper:
                above = paper[name] > high
                text = f"{paper[name]:g} " + (_UP if above else _DOWN)
                place = (i, 0.98 if above else 0.02)
                ax.annotate(text, place, va="top" if above else "bottom", **_BEYOND)
            if name not in cell.trials:
                continue
            loss = [100.0 * t.speed_loss for t in cell.trials[name]]
            ax.scatter(
                i + _swarm(loss), loss, s=13, color=_COLORS[name], alpha=0.55, linewidth=0, zorder=3
            )
            known = cell.loss[name]
            ax.errorbar(i, known.mean, _bar(known), fmt="_", markersize=15, **_BAR)
        ax.axhline(cell.floor, color="#8a949e", linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xticks(range(len(methods)), methods, rotation=35, ha="right", rotation_mode="anchor")
        ax.set_xlim(-0.6, len(methods) - 0.4)
        ax.set_ylim(low, high)

    handles = [
        _handle("a trip", marker="o", color=PALETTE[5], linestyle=""),
        _handle("mean with 95 % interval", marker="_", color=INK, linestyle="", markersize=15),
        _handle(f"the paper's figure ({_UP} {_DOWN} beyond the panel)", linestyle="", **_PAPER),
        _handle("free road", color="#8a949e", linestyle="--"),
    ]
    return _grid(cells, panel, "speed loss [%]", "", handles)


def draw_balance(cells: Sequence[CellFigures], methods: Sequence[str]) -> Figure:
    """Mean speed loss over mean lane changes with 95 % intervals; better is down and left."""

    def panel(ax: Axes, cell: CellFigures) -> None:
        for name in methods:
            if name not in cell.trials:
                continue
            changes, loss = cell.changes[name], cell.loss[name]
            ax.errorbar(
                changes.mean,
                loss.mean,
                xerr=_bar(changes),
                yerr=_bar(loss),
                fmt="o",
                markersize=6,
                color=_COLORS[name],
                elinewidth=1.4,
                capsize=3,
                zorder=3,
            )
        ax.axhline(cell.floor, color="#8a949e", linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xlim(left=min(0.0, ax.get_xlim()[0]))
        ax.margins(y=0.15)

    handles = [_handle(name, marker="o", color=_COLORS[name], linestyle="") for name in methods]
    handles.append(_handle("free road", color="#8a949e", linestyle="--"))
    return _grid(cells, panel, "speed loss [%]", "lane changes a trip", handles)


def _grid(
    cells: Sequence[CellFigures],
    panel: Callable[[Axes, CellFigures], None],
    y_label: str,
    x_label: str,
    handles: Sequence[Line2D],
) -> Figure:
    """The paper's cells as panels: densities side by side, traffic speeds below each other."""
    densities = [d for d in SPAWN_PROBABILITY if any(cell.density == d for cell in cells)]
    speeds = [v for v in TRAFFIC_SPEEDS if any(cell.speed == v for cell in cells)]
    size = (3.3 * max(len(densities), 2) + 0.4, 3.1 * len(speeds) + 0.6)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(speeds), len(densities), squeeze=False)
    places = {(cell.density, cell.speed): cell for cell in cells}
    for row, speed in enumerate(speeds):
        for column, density in enumerate(densities):
            ax, cell = axes[row, column], places.get((density, speed))
            if cell is None:
                ax.set_visible(False)
                continue
            panel(ax, cell)
            _dress(ax, f"{density}, traffic {speed:g} m/s")
            if column == 0:
                ax.set_ylabel(y_label, color=INK)
            if x_label and row == len(speeds) - 1:
                ax.set_xlabel(x_label, color=INK)
    figure.legend(
        handles=list(handles), loc="outside lower center", ncols=7, fontsize=8, frameon=False
    )
    return figure


def _dress(ax: Axes, title: str) -> None:
    ax.set_title(title, loc="left", fontsize=10, color=INK, fontweight="bold")
    ax.grid(True, color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(colors=INK, labelsize=8)
    for name, spine in ax.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(GRID)


def _handle(label: str, **style: Any) -> Line2D:
    return Line2D([], [], label=label, **style)


def _range(cell: CellFigures) -> tuple[float, float]:
    """Lower and upper end of the axis of speed losses [%]."""
    losses = [100.0 * t.speed_loss for own in cell.trials.values() for t in own]
    if math.isfinite(cell.floor):
        losses.append(cell.floor)
    room = _ROOM * max(max(losses) - min(losses), 0.5)
    return min(losses) - room, max(losses) + room


def _bar(known: Estimate) -> float:
    return known.half if math.isfinite(known.half) else 0.0


def _swarm(values: Sequence[float]) -> np.ndarray:
    """Shifts to the side that part dots of one method: neighbors in value stand apart."""
    places = np.empty(len(values))
    # The golden ratio's multiples spread evenly however many there are.
    turns = (np.arange(len(values)) * 0.6180339887498949) % 1.0
    places[np.argsort(values, kind="stable")] = 2.0 * turns - 1.0
    return _SPREAD * places


# --- Writes the page of `iits-mj evaluate`, as HTML and as Markdown with the pictures beside it ---

TITLE = "Decision makers compared"
_BEFORE = "<h2>Checks</h2>"
_DPI = 100


def write_page(
    results: Results,
    cells: Sequence[CellFigures],
    trials: Sequence[Trial],
    config: EvaluateConfig,
    folder: Path,
) -> tuple[Path, Path]:
    """Writes `evaluate.html`, `evaluate.md` and the pictures of the latter; the two pages.

    Args:
      results: the checks.
      cells: what they are made of.
      trials: what was driven.
      config: settings.
      folder: exists.
    """
    parts = sections(cells, trials, config)
    names = config.names()
    pictures = {
        "Speed loss of every trip": plots.to_png(draw_trips(cells, names), _DPI),
        "Speed loss over lane changes": plots.to_png(draw_balance(cells, names), _DPI),
    }
    short = [check for check in results.checks if not check.ok]
    held = f"{len(results.checks) - len(short)} of {len(results.checks)} checks hold"
    lead = f"iits-mj {iits_mj.__version__}; {held}"
    stem = page.slug(results.command)
    web, text = folder / f"{stem}.html", folder / f"{stem}.md"
    report = Report(TITLE, lead, checks=results.checks, images=list(pictures.items()))
    content = report.to_html().replace(_BEFORE, "".join(map(_to_html, parts)) + _BEFORE, 1)
    plots.write_whole(web, content.encode())

    lines = [f"# {TITLE}", "", f"Made by {lead}.", ""]
    if short:
        lines += ["**Falls short:**", ""]
        lines += [f"- {shortfall(check)}" for check in short]
        lines += [""]
    for part in parts:
        lines += [*_to_markdown(part), ""]
    (folder / stem).mkdir(exist_ok=True)
    for caption, png in pictures.items():
        name = f"{page.slug(caption)}.png"
        plots.write_whole(folder / stem / name, png)
        lines += [f"## {caption}", "", f"![{caption}]({stem}/{name})", ""]
    lines += ["## Checks", "", *page.table(results.checks)]
    plots.write_whole(text, ("\n".join(lines).rstrip() + "\n").encode())
    return web, text


def _to_markdown(part: Section) -> list[str]:
    lines = [f"## {part.title}", ""]
    for sentence in part.sentences:
        lines += [sentence, ""]
    if part.rows:
        lines += [_row(part.header), "|" + "---|" * len(part.header), *map(_row, part.rows)]
    return lines


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _to_html(part: Section) -> str:
    text = f"<h2>{_inline(part.title)}</h2>\n"
    text += "".join(f"<p>{_inline(sentence)}</p>\n" for sentence in part.sentences)
    if part.rows:
        rows = "".join(_html_row(row, "td") for row in part.rows)
        head = _html_row(part.header, "th")
        text += (
            '<div style="overflow-x: auto"><table><thead>'
            f"{head}</thead><tbody>{rows}</tbody></table></div>\n"
        )
    return text


def _html_row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in cells) + "</tr>"


def _inline(text: str) -> str:
    """Escaped text with the two marks of Markdown that the sections use."""
    shown = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", html.escape(text, quote=True))
    return re.sub(r"`(.+?)`", r"<code>\1</code>", shown)
