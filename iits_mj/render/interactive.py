"""Plots of HTML pages, which answer: their data, and plotly.js from the installed package.

`templates/page.js` draws them. A page carries plotly.js itself, compressed to 2 MB: a page that is
copied or sent alone still works, also without a network. Every array is stored once, as float32
rounded to a fine grid, and all of them are compressed together.
"""

from __future__ import annotations

import base64
import functools
import gzip
import importlib.util
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.results import Line, Panel

# Axis labels of a plan view, which is drawn to scale.
MAP = ("x [m]", "y [m]")
# Roles of lines that have a color of their own, roles of closed outlines, which are filled, and of
# other lines, with the number of their color.
ROLES = ("reference", "edge", "mark")
BODIES = {"tractor": 0, "trailer": 5, "vehicle": 3}
SHOWN = {"simulation": 0, "second": 1, "difference": 4}
COLORS = 6
SYMBOLS = ("circle", "diamond", "square", "triangle-up")
# Values are multiples of a power of two that is at most this share of the range of their array.
_GRID = 2.0**-17
_FLAT = 1e-6  # A range smaller than this share of the values is drawn as a constant.


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot of a page.

    Attributes:
      panels: the same lines over each of the axes that the reader may choose.
    """

    panels: tuple[Panel, ...]

    def __post_init__(self) -> None:
        shapes = {tuple(line.label for line in panel.lines) for panel in self.panels}
        if len(shapes) != 1:
            raise InputError("nothing to draw: a plot needs the same lines over each of its axes")
        for panel in self.panels:
            for line in panel.lines:
                check_line(line, panel)

    @property
    def panel(self) -> Panel:
        """The plot over its first axis."""
        return self.panels[0]

    @property
    def plan(self) -> bool:
        """Whether the plot is a plan view, which is drawn to scale."""
        return (self.panel.x_label, self.panel.y_label) == MAP

    @property
    def whole(self) -> bool:
        """Whether every value is a whole number, such as a gear."""
        values = np.concatenate([np.asarray(line.y, dtype=float) for line in self.panel.lines])
        return np.array_equal(values, np.round(values), equal_nan=True)

    def table(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Header and rows of a table that says in numbers what the plot shows."""
        panel = self.panel
        at = f"at {panel.x_label}"
        y = panel.y_label
        header = ("line", f"first {y}", "last", "least", at, "greatest", at, "mean")
        rows = []
        for line in panel.lines:
            x, values = np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float)
            kept = np.isfinite(values)
            x, values = x[kept], values[kept]
            if not len(values):
                continue
            low, high = int(np.argmin(values)), int(np.argmax(values))
            numbers = (values[0], values[-1], values[low], x[low], values[high], x[high])
            rows.append((line.label or "value", *map(shown, (*numbers, float(values.mean())))))
        return header, rows


def check_line(line: Line, panel: Panel) -> None:
    """Checks that x and y of a line match.

    Raises:
      InputError: they do not.
    """
    if np.shape(line.x) != np.shape(line.y) or np.ndim(line.x) != 1:
        raise InputError(
            f"line {line.label!r} of panel {panel.title!r}: x has shape {np.shape(line.x)}, "
            f"y {np.shape(line.y)}; both must be (n,)"
        )


def shown(value: float) -> str:
    """A number with four digits, without an exponent where it is readable without."""
    if 1e4 <= abs(value) < 1e7:
        return f"{value:.0f}"
    return f"{value:.4g}".replace("-", "\u2212")


def style_of(line: Line, place: int) -> str:
    """Name of the line's color in the style sheet; `place` counts the lines of its plot."""
    if line.role in ROLES:
        return line.role
    return f"c{(BODIES | SHOWN).get(line.role, place % COLORS)}"


@dataclass
class PageData:
    """Collects the plots of a page as numbers, for its script.

    Attributes:
      plots: what the script needs of each plot.
      extra: further entries for the script, such as the clock of a film.
    """

    plots: list[dict[str, Any]] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    _arrays: dict[bytes, int] = field(default_factory=dict)

    def array(self, values: Any) -> int:
        """Adds an array of numbers, once; returns its place."""
        content = rounded(np.asarray(values, dtype=float)).tobytes()
        return self._arrays.setdefault(content, len(self._arrays))

    def add(self, plot: Plot, group: str) -> int:
        """Adds a plot, whose cursor and zoom are those of its group; returns its number."""
        first = plot.panel
        panels = [panel.lines for panel in plot.panels]
        lines = []
        for place, same in enumerate(zip(*panels, strict=True)):
            line = same[0]
            lines.append(
                {
                    "label": line.label,
                    "style": style_of(line, place),
                    "dash": "dash" if line.role in ("reference", "mark", "second") else "solid",
                    "fill": line.role in BODIES,
                    "marks": line.role == "point" or (len(line.x) <= 2 and line.role not in ROLES),
                    "symbol": SYMBOLS[place % len(SYMBOLS)],
                    "x": [self.array(each.x) for each in same],
                    "y": [self.array(each.y) for each in same],
                }
            )
        # Only over a quantity that never decreases is there one value at a cursor.
        series = not plot.plan and all(
            len(each.x) > 2 and bool((np.diff(each.x) >= 0.0).all())
            for panel in panels
            for each in panel
        )
        self.plots.append(
            {
                "title": first.title,
                "x": [panel.x_label for panel in plot.panels],
                "y": first.y_label,
                "group": group,
                "plan": plot.plan,
                "series": series,
                "whole": plot.whole,
                "step": _whole_step(first.lines) if plot.whole else None,
                "range": flat_range(first.lines),
                "lines": lines,
            }
        )
        return len(self.plots) - 1

    def to_json(self) -> str:
        """The plots, and the lengths of the arrays, for a script element."""
        sizes = [len(content) // 4 for content in self._arrays]
        text = json.dumps({"plots": self.plots, "sizes": sizes, **self.extra}, allow_nan=False)
        return text.replace("<", "\\u003c")

    def to_base64(self) -> str:
        """All arrays, one behind the other: float32, gzip, base64."""
        return _packed(b"".join(self._arrays))


def rounded(values: FloatArray) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Values as little-endian float32 on a grid of at most 2^-17 of their range; others are NaN.

    The grid is a power of two, so that the last bits are zero and compress well.
    """
    finite = np.where(np.isfinite(values), values, np.nan)
    if np.isnan(finite).all():
        return finite.astype("<f4")
    spread = float(np.nanmax(finite) - np.nanmin(finite))
    if spread > 0.0:
        step = 2.0 ** math.floor(math.log2(spread * _GRID))
        finite = np.round(finite / step) * step
    return (finite + 0.0).astype("<f4")


def _whole_step(lines: Sequence[Line]) -> int:
    """Step between ticks of whole numbers, so that there are at most about six."""
    values = np.concatenate([np.asarray(line.y, dtype=float) for line in lines])
    spread = float(np.nanmax(values) - np.nanmin(values)) if np.isfinite(values).any() else 0.0
    return max(1, math.ceil(spread / 6.0))


def flat_range(lines: Sequence[Line]) -> tuple[float, float] | None:
    """A range for a constant quantity, so that rounding noise stays invisible; else None.

    The range of a quantity without negative values, such as a pressure, does not go below 0.
    """
    values = np.concatenate([np.asarray(line.y, dtype=float) for line in lines])
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    if high - low >= _FLAT * max(1.0, abs(low), abs(high)):
        return None
    middle = 0.5 * (low + high)
    return max(middle - 1.0, min(low, 0.0)), middle + 1.0


@functools.cache
def plotly_base64() -> str:
    """Returns plotly.js of the installed package: gzip, base64.

    Raises:
      InputError: plotly is not installed.
    """
    # Importing plotly takes longer than everything else here, and only its file is needed.
    spec = importlib.util.find_spec("plotly")
    folders = list(spec.submodule_search_locations or []) if spec else []
    for folder in folders:
        path = Path(folder) / "package_data" / "plotly.min.js"
        if path.is_file():
            return _packed(path.read_bytes())
    raise InputError("the plots of HTML pages need plotly: pip install 'plotly>=6'")


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()
