"""Pictures of `iits-mj evaluate`: every trip by method, and speed loss over lane changes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from controllers.decision.trip import SPAWN_PROBABILITY, TRAFFIC_SPEEDS
from iits_mj.evaluation.figures import PAPER_LOSS_PERCENT, CellFigures
from iits_mj.evaluation.hulls import family, is_hull_rule, lower_hull, points
from iits_mj.render import plots
from iits_mj.render.plots import INK, PALETTE
from iits_mj.validation.harness.statistics import Estimate

_GRAY = "#8a949e"
_COLORS = {
    "conservative": PALETTE[5],
    "neutral": PALETTE[2],
    "aggressive": PALETTE[3],
    "mobil": PALETTE[4],
    "lookahead": PALETTE[0],
    "ddqn": PALETTE[1],
    "keep": _GRAY,
}
# Of rules with options, and of your own decision makers.
_OTHERS = ("#117a65", "#a0522d", "#6c3483", "#b7950b", "#cb4335", "#2e4053")
_SPREAD = 0.28  # greatest sideways shift of the dots of a method
# Margin above and below all trips, as a share of their range. A figure of the paper beyond it is
# written at the edge of the panel.
_MARGIN = 0.25
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
_HULL: dict[str, Any] = {"color": INK, "linestyle": "--", "linewidth": 1.8, "zorder": 3}


def draw_trips(cells: Sequence[CellFigures], methods: Sequence[str]) -> Figure:
    """Speed loss of every trip by method, one panel for each cell, with means and the paper's."""

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
                i + _swarm(loss),
                loss,
                s=13,
                color=_color(name, methods),
                alpha=0.55,
                linewidth=0,
                zorder=3,
            )
            known = cell.loss[name]
            ax.errorbar(i, known.mean, _bar(known), fmt="_", markersize=15, **_BAR)
        ax.axhline(cell.floor, color=_GRAY, linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xticks(range(len(methods)), methods, rotation=35, ha="right", rotation_mode="anchor")
        ax.set_xlim(-0.6, len(methods) - 0.4)
        ax.set_ylim(low, high)

    handles = [
        _handle("a trip", marker="o", color=PALETTE[5], linestyle=""),
        _handle("mean with 95 % interval", marker="_", color=INK, linestyle="", markersize=15),
        _handle(f"the paper's figure ({_UP} {_DOWN} beyond the panel)", linestyle="", **_PAPER),
        _handle("free road", color=_GRAY, linestyle="--"),
    ]
    return _grid(cells, panel, "", handles)


def draw_balance(cells: Sequence[CellFigures], methods: Sequence[str]) -> Figure:
    """Mean speed loss over mean lane changes with 95 % intervals; lower left is better."""

    def panel(ax: Axes, cell: CellFigures) -> None:
        for name in methods:
            if name not in cell.trials:
                continue
            _point(ax, cell, name, "o", _color(name, methods))
        ax.axhline(cell.floor, color=_GRAY, linestyle="--", linewidth=1.2, zorder=1)
        ax.set_xlim(left=min(0.0, ax.get_xlim()[0]))
        ax.margins(y=0.15)

    handles = [
        _handle(name, marker="o", color=_color(name, methods), linestyle="") for name in methods
    ]
    handles.append(_handle("free road", color=_GRAY, linestyle="--"))
    return _grid(cells, panel, "lane changes a trip", handles)


def draw_hulls(cells: Sequence[CellFigures]) -> Figure:
    """Swept rules, their lower hull, and the other methods with 95 % intervals, for each cell."""
    families = sorted({f for cell in cells for f in map(family, {**cell.trials, **cell.swept})})
    rules = [name for name in families if is_hull_rule(name.partition(" ")[0])]
    others = [name for cell in cells for name in cell.trials if not is_hull_rule(name)]
    others = list(dict.fromkeys(others))
    colors = dict(zip(rules, itertools.cycle(PALETTE), strict=False))

    def panel(ax: Axes, cell: CellFigures) -> None:
        known = points({**cell.trials, **cell.swept})
        for name in rules:
            own = [point for point in known if family(point.method) == name]
            place = [p.changes for p in own], [p.loss for p in own]
            ax.plot(*place, "o-", color=colors[name], markersize=3.5, linewidth=1.0, zorder=2)
        hull = lower_hull(known)
        ax.plot([p.changes for p in hull], [p.loss for p in hull], **_HULL)
        for name in others:
            if name in cell.trials:
                _point(ax, cell, name, "D", _color(name, others))
        # The truck that never changes lanes is far above all others.
        moving = [point.loss for point in known if point.changes > 0.0]
        if moving:
            least = min([*moving, *(cell.loss[name].mean for name in cell.loss if name in others)])
            ax.set_ylim(least - 0.1 * (max(moving) - least) - 0.1, max(moving) + 0.5)

    handles = [
        *(_handle(name, marker="o", color=colors[name], markersize=4) for name in rules),
        _handle("lower hull", **_HULL),
        *(_handle(n, marker="D", color=_color(n, others), linestyle="") for n in others),
    ]
    return _grid(cells, panel, "lane changes a trip", handles)


def _grid(
    cells: Sequence[CellFigures],
    panel: Callable[[Axes, CellFigures], None],
    x_label: str,
    handles: Sequence[Line2D],
) -> Figure:
    """The cells as panels: a column for each density, a row for each traffic speed."""
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
            plots.dress(ax, f"{density}, traffic {speed:g} m/s")
            if column == 0:
                ax.set_ylabel("speed loss [%]", color=INK)
            if x_label and row == len(speeds) - 1:
                ax.set_xlabel(x_label, color=INK)
    figure.legend(
        handles=list(handles), loc="outside lower center", ncols=7, fontsize=8, frameon=False
    )
    return figure


def _point(ax: Axes, cell: CellFigures, name: str, marker: str, color: str) -> None:
    """Draws a method's means of lane changes and speed loss with their intervals."""
    changes, loss = cell.changes[name], cell.loss[name]
    ax.errorbar(
        *(changes.mean, loss.mean),
        xerr=_bar(changes),
        yerr=_bar(loss),
        fmt=marker,
        markersize=6,
        color=color,
        elinewidth=1.4,
        capsize=3,
        zorder=4,
    )


def _color(name: str, methods: Sequence[str]) -> str:
    others = [method for method in methods if method not in _COLORS]
    return _COLORS.get(name) or _OTHERS[others.index(name) % len(_OTHERS)]


def _handle(label: str, **style: Any) -> Line2D:
    return Line2D([], [], label=label, **style)


def _range(cell: CellFigures) -> tuple[float, float]:
    """Lower and upper end of the axis of speed losses [%]."""
    losses = [100.0 * t.speed_loss for own in cell.trials.values() for t in own]
    if math.isfinite(cell.floor):
        losses.append(cell.floor)
    margin = _MARGIN * max(max(losses) - min(losses), 0.5)
    return min(losses) - margin, max(losses) + margin


def _bar(known: Estimate) -> float:
    return known.half if math.isfinite(known.half) else 0.0


def _swarm(values: Sequence[float]) -> np.ndarray:
    """Sideways shifts that separate the dots of one method, shape (n,)."""
    places = np.empty(len(values))
    # Multiples of the golden ratio spread evenly, however many there are.
    turns = (np.arange(len(values)) * 0.6180339887498949) % 1.0
    places[np.argsort(values, kind="stable")] = 2.0 * turns - 1.0
    return _SPREAD * places
