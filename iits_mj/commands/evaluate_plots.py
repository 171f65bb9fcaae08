"""Pictures of `iits-mj evaluate`: every trip by method, and speed loss over lane changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from controllers.decision.trip import SPAWN_PROBABILITY, TRAFFIC_SPEEDS
from iits_mj.render.plots import GRID, INK, PALETTE
from iits_mj.validation.evaluate_figures import PAPER_LOSS_PERCENT, CellFigures

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
# A figure of the paper this far beyond all trips is written at the panel's edge.
_BEYOND_SHARE = 2.5
_BEYOND: dict[str, Any] = {
    "xycoords": ("data", "axes fraction"),
    "ha": "center",
    "va": "top",
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
        greatest = max(100.0 * t.speed_loss for own in cell.trials.values() for t in own)
        top = _BEYOND_SHARE * greatest
        for i, name in enumerate(methods):
            if name in paper and paper[name] <= top:
                ax.plot(i, paper[name], linestyle="", zorder=5, **_PAPER)
            elif name in paper:
                ax.annotate(f"{paper[name]:g} \u2191", (i, 0.97), **_BEYOND)
            if name not in cell.trials:
                continue
            loss = [100.0 * t.speed_loss for t in cell.trials[name]]
            ax.scatter(
                i + _swarm(loss), loss, s=13, color=_COLORS[name], alpha=0.55, linewidth=0, zorder=3
            )
            known = cell.loss[name]
            ax.errorbar(i, known.mean, known.half, fmt="_", markersize=15, **_BAR)
        ax.axhline(cell.floor, color="#8a949e", linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xticks(range(len(methods)), methods, rotation=35, ha="right", rotation_mode="anchor")
        ax.set_xlim(-0.6, len(methods) - 0.4)
        beyond = any(paper[name] > top for name in methods if name in paper)
        ax.set_ylim(min(0.0, ax.get_ylim()[0]), (1.15 if beyond else 1.0) * ax.get_ylim()[1])

    handles = [
        _handle("a trip", marker="o", color=PALETTE[5], linestyle=""),
        _handle("mean with 95 % interval", marker="_", color=INK, linestyle="", markersize=15),
        _handle("the paper's figure", linestyle="", **_PAPER),
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
                xerr=changes.half,
                yerr=loss.half,
                fmt="o",
                markersize=6,
                color=_COLORS[name],
                elinewidth=1.4,
                capsize=3,
                zorder=3,
            )
        ax.axhline(cell.floor, color="#8a949e", linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xlim(left=min(0.0, ax.get_xlim()[0]))
        ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))

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


def _swarm(values: Sequence[float]) -> np.ndarray:
    """Shifts to the side that part dots of one method: neighbors in value stand apart."""
    places = np.empty(len(values))
    # The golden ratio's multiples spread evenly however many there are.
    turns = (np.arange(len(values)) * 0.6180339887498949) % 1.0
    places[np.argsort(values, kind="stable")] = 2.0 * turns - 1.0
    return _SPREAD * places
