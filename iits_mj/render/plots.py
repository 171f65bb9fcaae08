"""Draws `iits_mj.core.results.Panel`s with matplotlib, as one figure with one column of axes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from iits_mj.core.errors import InputError
from iits_mj.core.results import Panel
from iits_mj.render.interactive import MAP, check_line, flat_range

PALETTE = ("#1f5fa8", "#d1495b", "#2a9d8f", "#e9a03b", "#6d597a", "#577590")
INK, GRID = "#22303c", "#d9dee3"
_ROLE_STYLE: dict[str, dict[str, Any]] = {
    "reference": {"color": "#8a949e", "linestyle": "--", "linewidth": 1.4, "zorder": 2},
    "simulation": {"color": PALETTE[0], "linestyle": "-", "linewidth": 1.8, "zorder": 3},
    "edge": {"color": "#5b6770", "linestyle": "-", "linewidth": 1.6, "zorder": 1},
    "mark": {"color": "#9aa5ae", "linestyle": (0, (8, 6)), "linewidth": 1.2, "zorder": 1},
}
# Roles of closed outlines in a plan view, which are filled.
_BODY_COLOR = {"tractor": PALETTE[0], "trailer": PALETTE[5], "vehicle": PALETTE[3]}


def draw(panels: Sequence[Panel], *, width: float = 9.5, panel_height: float = 2.3) -> Figure:
    """Returns a figure with one panel below the other; equal x labels share the x axis.

    Raises:
      InputError: no panel, or a line whose x and y do not match.
    """
    if not panels:
        raise InputError("nothing to draw: the figure has no panels")
    shared = len({panel.x_label for panel in panels}) == 1
    figure = Figure(figsize=(width, panel_height * len(panels) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, sharex=shared, squeeze=False)[:, 0]
    for i, (ax, panel) in enumerate(zip(axes, panels, strict=True)):
        _draw_panel(ax, panel)
        if not shared or i == len(panels) - 1:
            ax.set_xlabel(panel.x_label, color=INK)
    return figure


def dress(ax: Axes, title: str) -> None:
    """Gives axes their title, grid and colors."""
    ax.set_title(title, loc="left", fontsize=10, color=INK, fontweight="bold")
    ax.grid(True, color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(colors=INK, labelsize=8)
    for name, spine in ax.spines.items():
        spine.set_visible(name in ("left", "bottom"))
        spine.set_color(GRID)


def to_png(figure: Figure, dpi: int = 110) -> bytes:
    """Returns the content of a PNG file; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def _draw_panel(ax: Axes, panel: Panel) -> None:
    for i, line in enumerate(panel.lines):
        check_line(line, panel)
        if line.role in _BODY_COLOR:
            color = _BODY_COLOR[line.role]
            ax.fill(line.x, line.y, label=line.label, facecolor=color + "66", edgecolor=color)
            continue
        style = _ROLE_STYLE.get(
            line.role, {"color": PALETTE[i % len(PALETTE)], "linewidth": 1.6, "zorder": 3}
        )
        x = np.asarray(line.x, dtype=float)
        marker = "o" if x.size <= 2 and line.role not in ("edge", "mark") else ""
        ax.plot(x, np.asarray(line.y, dtype=float), label=line.label, **style, marker=marker, ms=4)
    if limits := flat_range(panel.lines):
        ax.set_ylim(limits)
    if (panel.x_label, panel.y_label) == MAP:
        ax.set_aspect("equal", adjustable="datalim")
    if all(np.array_equal(line.y, np.round(line.y)) for line in panel.lines):
        ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    dress(ax, panel.title)
    ax.set_ylabel(panel.y_label, color=INK)
    ax.margins(x=0.01)
    if len([line for line in panel.lines if line.label]) > 1:
        bodies = any(line.role in _BODY_COLOR for line in panel.lines)
        columns = min(3, len(panel.lines))
        ax.legend(loc="upper left" if bodies else "best", fontsize=8, frameon=False, ncols=columns)
