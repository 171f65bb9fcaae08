"""Pictures of sweeps: maps of the outcomes over two values, or measures over one."""

from __future__ import annotations

import itertools
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
from iits_mj.render.plots import GRID, INK, PALETTE

COLORS = dict(
    zip(OUTCOMES, (PALETTE[1], PALETTE[4], PALETTE[3], "#b8bfc6", PALETTE[2]), strict=True)
)
_MAP = ListedColormap(list(COLORS.values()))
PANELS_MAX, VALUES_MAX = 9, 6  # of values: as panels, and in pairs
TEXTS_MAX = 160  # cells of a map with numbers
_PIXELS = 240  # of a side of an interpolated map
NUMBERS = "Numbers: speed of the impact [km/h], else the least time to collision [s]."
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
    counts = {n: len({values[n] for values, _, _ in judged}) for n in list(sweep.swept)}
    varied = [name for name in list(sweep.swept) if counts[name] > 1] or list(list(sweep.swept)[:1])
    full = len(runs) == math.prod(counts.values()) and boundary is None
    label = sweep.label
    if len(varied) == 1:
        return _lines(judged, varied[0], label(varied[0]), config), ""
    if len(varied) == 2:
        figure, ((ax,),) = _figure(1, 1)
        _map(ax, judged, varied, label, full, boundary)
        return figure, NUMBERS if full and len(judged) <= TEXTS_MAX else ""
    few = min(varied, key=lambda name: counts[name])
    if len(varied) == 3 and full and counts[few] <= PANELS_MAX:
        rest = [name for name in varied if name != few]
        texts = sorted({values[few] for values, _, _ in judged}, key=_order)
        columns = min(3, len(texts))
        figure, axes = _figure(math.ceil(len(texts) / columns), columns)
        for ax, text in itertools.zip_longest(axes.flat, texts):
            if text is None:
                ax.set_visible(False)
                continue
            _map(ax, [each for each in judged if each[0][few] == text], rest, label, full, None)
            ax.set_title(f"{few} = {text}", fontsize=9, color=INK)
        return figure, ""
    varied = varied[:VALUES_MAX]
    figure, axes = _figure(len(varied) - 1, len(varied) - 1)
    for row, column in itertools.product(range(len(varied) - 1), repeat=2):
        if column > row:
            axes[row, column].set_visible(False)
        else:
            _map(axes[row, column], judged, [varied[column], varied[row + 1]], label, full, None)
    last = "" if full else "; worse outcomes are drawn last"
    return figure, f"Each place has the worst outcome over the other values{last}."


def _order(text: str) -> tuple[float, str]:
    try:
        return float(text), text
    except ValueError:
        return math.inf, text


def _figure(rows: int, columns: int) -> tuple[Figure, np.ndarray]:
    scale = 1.0 if rows * columns == 1 else 0.62
    figure = Figure(figsize=(7.2 * scale * columns + 0.6, 5.2 * scale * rows + 0.6))
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    handles = [Patch(color=color, label=name) for name, color in COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return figure, figure.subplots(rows, columns, squeeze=False)


def _scale(judged: Sequence[Judged], name: str) -> tuple[list[str], np.ndarray, bool]:
    """The different texts of a value in their order, their places, and whether they are numbers."""
    texts = sorted({values[name] for values, _, _ in judged}, key=_order)
    numbers = all(math.isfinite(_order(text)[0]) for text in texts)
    return texts, np.array([float(t) for t in texts] if numbers else range(len(texts))), numbers


def _map(
    ax: Axes,
    judged: Sequence[Judged],
    names: Sequence[str],
    label: Callable[[str], str],
    full: bool,
    boundary: Boundary | None,
) -> None:
    """Draws the worst outcome over two values: cells of a grid, places, or an interpolated map."""
    scales = [_scale(judged, name) for name in names]
    worst: dict[tuple[int, ...], Judged] = {}
    for each in sorted(judged, key=lambda each: -OUTCOMES.index(each[2])):
        key = tuple(scale[0].index(each[0][n]) for n, scale in zip(names, scales, strict=True))
        worst[key] = each
    (_, x, _), (_, y, _) = scales
    if full:
        codes = np.full((len(y), len(x)), math.nan)
        for (i, j), each in worst.items():
            codes[j, i] = OUTCOMES.index(each[2])
            if len(worst) <= TEXTS_MAX and len(worst) == len(judged):
                ax.text(x[i], y[j], _number(each[1]), ha="center", va="center", fontsize=7)
        ax.pcolormesh(_edges(x), _edges(y), codes, cmap=_MAP, vmin=0, vmax=4, edgecolors="white")
    else:
        if boundary is not None:
            box = x[0], x[-1], y[0], y[-1]
            steps = (np.arange(_PIXELS) + 0.5) / _PIXELS
            shares = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
            codes = np.array([OUTCOMES.index(name) for name in boundary.predicted(shares)])
            image = codes.reshape(_PIXELS, _PIXELS)
            style: dict[str, Any] = {
                "cmap": _MAP,
                "vmin": 0,
                "vmax": 4,
                "alpha": 0.55,
                "aspect": "auto",
            }
            ax.imshow(image, extent=box, origin="lower", interpolation="nearest", **style)
        colors = [COLORS[each[2]] for each in worst.values()]
        at = np.array(list(worst))
        size = 14 if boundary is not None else 30
        ax.scatter(x[at[:, 0]], y[at[:, 1]], s=size, c=colors, edgecolors="white", linewidths=0.5)
    for (texts, places, numbers), axis in zip(scales, (ax.xaxis, ax.yaxis), strict=True):
        if not numbers:
            axis.set_ticks(places, texts)
    ax.set_xlabel(label(names[0]), color=INK)
    ax.set_ylabel(label(names[1]), color=INK)
    ax.tick_params(colors=INK, labelsize=8)


def _number(run: SweepRun) -> str:
    if math.isfinite(run.impact_speed):
        return f"{3.6 * run.impact_speed:.0f}"
    return f"{run.ttc:.1f}" if math.isfinite(run.ttc) else ""


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
    curves: Sequence[tuple[str, Sequence[tuple[str, str, float | None]]]] = (
        (
            "time [s]",
            (("time to collision", "ttc", config.near_ttc), ("time gap", "time_gap", None)),
        ),
        (
            "deceleration [m/s²]",
            (
                ("to avoid a crash (DRAC)", "drac", config.near_drac),
                ("of the truck", "deceleration", config.near_deceleration),
            ),
        ),
        ("gap [m], speed [m/s]", (("least gap", "gap", None), ("impact", "impact_speed", None))),
    )
    for ax, (y_label, lines) in zip(axes[:, 0], curves, strict=True):
        for k, (low, high) in enumerate(itertools.pairwise(edges)):
            ax.axvspan(low, high, color=COLORS[judged[k][2]], alpha=0.25, linewidth=0)
        for k, (title, measure, limit) in enumerate(lines):
            color = PALETTE[0] if k == 0 else PALETTE[5]
            values = np.array([getattr(run, measure) for _, run, _ in judged], float)
            values[~np.isfinite(values)] = math.nan
            ax.plot(x, values, color=color, marker="o", ms=3, label=title)
            if limit is not None:
                ax.axhline(limit, color=color, linestyle="--", linewidth=1.0)
        plots.dress(ax, "")
        ax.grid(True, color=GRID)
        ax.set_ylabel(y_label, color=INK)
        ax.legend(loc="best", fontsize=8, frameon=False)
        ax.set_xlim(edges[0], edges[-1])
        if not numbers:
            ax.set_xticks(x, texts)
    axes[-1, 0].set_xlabel(label, color=INK)
    return figure
