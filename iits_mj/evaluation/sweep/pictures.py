"""Pictures of sweeps: maps of the outcomes over two values, or measures over one."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from iits_mj.evaluation.sweep.boundary import Boundary
from iits_mj.evaluation.sweep.design import Sweep, SweepConfig
from iits_mj.evaluation.sweep.runs import OUTCOMES, SweepRun, outcome
from iits_mj.render import plots
from iits_mj.render.plots import INK, PALETTE

COLORS = dict(
    zip(OUTCOMES, (PALETTE[1], PALETTE[4], PALETTE[3], "#b8bfc6", PALETTE[2]), strict=True)
)
_STYLE: dict[str, Any] = {"cmap": ListedColormap(list(COLORS.values())), "vmin": 0, "vmax": 4}
PANELS_MAX, PAIRED_MAX = 9, 6  # maps over a third value; values whose pairs are drawn
TEXTS_MAX = 300  # cells of a map with numbers
_PIXELS = 240  # of a side of an interpolated map
Judged = tuple[Mapping[str, str], SweepRun, str]


def draw_sweep(
    sweep: Sweep, runs: Sequence[SweepRun], config: SweepConfig, boundary: Boundary | None = None
) -> tuple[Figure, str]:
    """Returns the picture of a sweep and a sentence that says how to read it.

    Args:
      sweep: that was driven.
      runs: of its points.
      config: has the thresholds.
      boundary: of an adaptive design.
    """
    judged: list[Judged] = [(dict(run.values), run, outcome(run, config)[0]) for run in runs]
    judged.sort(key=lambda each: -OUTCOMES.index(each[2]))
    counts = {name: len({values[name] for values, _, _ in judged}) for name in sweep.swept}
    full = len(runs) == math.prod(counts.values())
    varied = [name for name, count in counts.items() if count > 1] or list(counts)[:1]
    draw = functools.partial(_map, label=sweep.label, full=full)
    if len(varied) == 1:
        return _lines(judged, varied[0], sweep.label(varied[0]), config), ""
    if len(varied) == 2:
        figure, ((ax,),) = _figure(1, 1)
        numbers = full and len(judged) <= TEXTS_MAX
        draw(ax, judged, varied, boundary=boundary, numbers=numbers)
        text = "Numbers: speed of the impact [km/h], else the least time to collision [s]."
        return figure, text if numbers else ""
    few = min(varied, key=lambda name: counts[name])
    if len(varied) == 3 and full and counts[few] <= PANELS_MAX:
        rest, texts = [name for name in varied if name != few], _scale(judged, few)[0]
        figure, axes = _figure(1, len(texts))
        for ax, text in zip(axes[0], texts, strict=True):
            draw(ax, [each for each in judged if each[0][few] == text], rest)
            ax.set_title(f"{few} = {text}", fontsize=9, color=INK)
        return figure, ""
    varied = varied[:PAIRED_MAX]
    figure, axes = _figure(len(varied) - 1, len(varied) - 1)
    for (row, column), ax in np.ndenumerate(axes):
        ax.set_visible(column <= row)
        draw(ax, judged, [varied[column], varied[row + 1]])
    return figure, "Each place has the worst outcome over the other values."


def _figure(rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    scale = 1.0 if rows * columns == 1 else 0.6
    size = 7.2 * scale * columns + 0.6, 5.2 * scale * rows + 0.6
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    handles = [Patch(color=color, label=name) for name, color in COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _scale(judged: Sequence[Judged], name: str) -> tuple[list[str], np.ndarray, bool]:
    """The different texts of a value in their order, their places, and whether they are numbers."""
    texts = list(dict.fromkeys(values[name] for values, _, _ in judged))
    try:
        texts.sort(key=float)
        return texts, np.array([float(text) for text in texts]), True
    except ValueError:
        return sorted(texts), np.arange(float(len(texts))), False


def _map(
    ax: Axes,
    judged: Sequence[Judged],
    names: Sequence[str],
    *,
    label: Callable[[str], str],
    full: bool,
    boundary: Boundary | None = None,
    numbers: bool = False,
) -> None:
    """Draws the worst outcome over two values: cells of a grid, places, or an interpolated map."""
    (xs, x, _), (ys, y, _) = scales = [_scale(judged, name) for name in names]
    # The worst come last.
    worst = {(xs.index(v[names[0]]), ys.index(v[names[1]])): (r, o) for v, r, o in judged}
    codes = np.full((len(y), len(x)), math.nan)
    for (i, j), (_, name) in worst.items():
        codes[j, i] = OUTCOMES.index(name)
    if full and boundary is None:
        ax.pcolormesh(_edges(x), _edges(y), codes, edgecolors="white", **_STYLE)
    else:
        if boundary is not None:
            steps = (np.arange(_PIXELS) + 0.5) / _PIXELS
            shares = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
            found = np.array([OUTCOMES.index(name) for name in boundary.predicted(shares)])
            image = found.reshape(_PIXELS, _PIXELS)
            box = x[0], x[-1], y[0], y[-1]
            ax.imshow(image, extent=box, origin="lower", aspect="auto", alpha=0.55, **_STYLE)
        at = np.array(list(worst)).T
        size = 30 if boundary is None else 14
        ax.scatter(x[at[0]], y[at[1]], size, codes[at[1], at[0]], edgecolors=INK, lw=0.3, **_STYLE)
    for (i, j), (run, _) in worst.items() if numbers else ():
        hit = math.isfinite(run.impact_speed)
        text = f"{3.6 * run.impact_speed:.0f}" if hit else f"{run.ttc:.1f}"
        ax.text(x[i], y[j], text.replace("inf", ""), ha="center", va="center", fontsize=6.5)
    for (texts, places, are_numbers), axis in zip(scales, (ax.xaxis, ax.yaxis), strict=True):
        if not are_numbers:
            axis.set_ticks(places, texts)
    ax.set_xlabel(label(names[0]), color=INK)
    ax.set_ylabel(label(names[1]), color=INK)
    ax.tick_params(colors=INK, labelsize=8)


def _edges(places: np.ndarray) -> np.ndarray:
    """Ends of the cells around places, halfway between them, shape (n + 1,)."""
    if len(places) == 1:
        return places[0] + np.array([-0.5, 0.5])
    middles = 0.5 * (places[1:] + places[:-1])
    return np.array([2 * places[0] - middles[0], *middles, 2 * places[-1] - middles[-1]])


def _lines(judged: Sequence[Judged], name: str, label: str, config: SweepConfig) -> Figure:
    """The measures over one value, with the outcomes as background."""
    texts, x, numbers = _scale(judged, name)
    judged = sorted(judged, key=lambda each: texts.index(each[0][name]))
    figure, axes = _figure(3, 1)
    figure.set_size_inches(8.0, 7.2)
    edges = _edges(x)
    drac, braking = config.near_drac, config.near_deceleration
    curves: dict[str, Sequence[tuple[str, str, float | None]]] = {
        "time [s]": (("to collision", "ttc", config.near_ttc), ("time gap", "time_gap", None)),
        "deceleration [m/s²]": (("DRAC", "drac", drac), ("of the truck", "deceleration", braking)),
        "gap [m], speed [m/s]": (("least gap", "gap", None), ("impact", "impact_speed", None)),
    }
    for ax, (y_label, lines) in zip(axes[:, 0], curves.items(), strict=True):
        for each, low, high in zip(judged, edges, edges[1:], strict=False):
            ax.axvspan(low, high, color=COLORS[each[2]], alpha=0.25, linewidth=0)
        for (title, measure, limit), color in zip(lines, (PALETTE[0], PALETTE[5]), strict=True):
            values = np.array([getattr(run, measure) for _, run, _ in judged], float)
            values[~np.isfinite(values)] = math.nan
            ax.plot(x, values, color=color, marker="o", ms=3, label=title)
            if limit is not None:
                ax.axhline(limit, color=color, linestyle="--", linewidth=1.0)
        plots.dress(ax, "")
        ax.set_ylabel(y_label, color=INK)
        ax.legend(loc="best", fontsize=8, frameon=False)
        ax.set_xlim(edges[0], edges[-1])
        if not numbers:
            ax.set_xticks(x, texts)
    axes[-1, 0].set_xlabel(label, color=INK)
    return figure
