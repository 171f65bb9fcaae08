"""Results of a measurement: checks for people and machines, curves for pictures, and notes.

A test gathers its `Findings`; the findings of many tests make the `Results` of a command, which are
printed as a table, as JSON, or as a page.
"""

from __future__ import annotations

import json
import operator
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.errors import InputError

_OPERATORS = {
    ">=": operator.ge,
    "<=": operator.le,
    ">": operator.gt,
    "<": operator.lt,
    "==": operator.eq,
}
# Column headings of a table of checks; the last column holds the verdict.
COLUMNS = ("check", "value", "unit", "reference", "must", "")


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells as plain text with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


@dataclass(frozen=True, slots=True)
class Check:
    """A measured value with its bound.

    Attributes:
      name: of the quantity; value: the measurement; unit: of value and reference.
      reference: the reference's value or its name, or None.
      must: the bound as text, for instance ">= 97", "<= 0.5", "0.33 .. 0.40"; "" for information.
    """

    name: str
    value: float
    unit: str
    reference: float | str | None = None
    must: str = ""

    @property
    def ok(self) -> bool:
        """True when the value is finite and inside the bound."""
        if not np.isfinite(self.value):
            return False
        text = self.must.strip()
        if not text:
            return True
        if ".." in text:
            low, high = (float(part) for part in text.split(".."))
            return low <= self.value <= high
        for symbol, compare in _OPERATORS.items():
            if text.startswith(symbol):
                return bool(compare(self.value, float(text[len(symbol) :])))
        raise InputError(f"bound {text!r} of check {self.name!r}: use '>= x', '<= x' or 'a .. b'")

    def cells(self) -> tuple[str, str, str, str, str]:
        """The check as text for the first five of `COLUMNS`."""
        reference = self.reference
        shown = f"{reference:.4g}" if isinstance(reference, float) else str(reference or "")
        return self.name, f"{self.value:.4g}", self.unit, shown, self.must

    def shortfall(self) -> str:
        """Returns a failed check in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name}: {self.value:.4g}{unit}, must be {self.must}"

    def as_dict(self) -> dict[str, Any]:
        """The check as an object for JSON; a value that is not finite becomes null."""
        value = float(self.value) if np.isfinite(self.value) else None
        return {**asdict(self), "value": value, "ok": self.ok}


@dataclass(frozen=True, slots=True)
class Line:
    """A curve of a panel: x and y of shape (n,).

    Role is "reference", "simulation", "second" of two simulations, their "difference", or "". In a
    plan view it may also be "edge" or "mark" of a road, single places ("point"), or the outline of
    a "tractor", a "trailer" or another "vehicle".
    """

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    role: str = ""


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes of a figure; the labels carry the units."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]


@dataclass(slots=True)
class Findings:
    """Checks, panels and notes of one test; the label precedes the name of every check."""

    label: str = ""
    checks: list[Check] = field(default_factory=list)
    panels: list[Panel] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def check(
        self,
        name: str,
        value: SupportsFloat,
        unit: str,
        reference: float | str | None = None,
        must: str = "",
    ) -> None:
        """Adds a check; see `Check`."""
        if isinstance(reference, np.floating):
            reference = float(reference)
        self.checks.append(Check(self._title(name), float(value), unit, reference, must))

    def panel(self, name: str, x_label: str, y_label: str, *lines: Line) -> None:
        """Adds a panel; without a name its title is the label alone."""
        self.panels.append(Panel(self._title(name), x_label, y_label, lines))

    def history(self, name: str, y_label: str, time: Any, values: Any) -> None:
        """Adds a panel with one quantity of the simulated truck over time [s]."""
        self.panel(name, "time [s]", y_label, Line("truck", time, values, "simulation"))

    def extend(self, other: Findings) -> None:
        """Adds everything that another test found."""
        self.checks += other.checks
        self.panels += other.panels
        self.notes += other.notes

    def _title(self, name: str) -> str:
        return f"{self.label}: {name}" if self.label and name else self.label or name


@dataclass(slots=True)
class Results:
    """Results of a command.

    Attributes:
      tables: rows of text by title, the first row with the headings.
      parts: the results from which these were merged.
    """

    command: str
    seed: int = 0
    checks: list[Check] = field(default_factory=list)
    tables: dict[str, list[Sequence[str]]] = field(default_factory=dict)
    figures: dict[str, list[Panel]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    parts: list[Results] = field(default_factory=list)

    @classmethod
    def merged(cls, command: str, parts: list[Results]) -> Results:
        """Returns the contents of several results as one; pages show them part by part."""
        whole = cls(command, parts=parts)
        for part in parts:
            name = part.command.removeprefix(command).strip()
            whole.checks += part.checks
            whole.notes += part.notes
            whole.tables |= part.tables
            whole.figures |= {f"{name}: {title}": panels for title, panels in part.figures.items()}
        return whole

    def add(self, figure: str, findings: Findings) -> None:
        """Adds the findings of a test; their panels become the figure of this name."""
        self.checks += findings.checks
        self.notes += findings.notes
        if findings.panels:
            self.figures[figure] = findings.panels

    @property
    def ok(self) -> bool:
        """True when every check holds."""
        return not self.short()

    def short(self) -> list[Check]:
        """The checks that do not hold."""
        return [check for check in self.checks if not check.ok]

    def count_text(self) -> str:
        """Returns in words how many checks hold."""
        held = len(self.checks) - len(self.short())
        return f"{held} of {len(self.checks)} checks hold"

    def to_json(self, version: str) -> str:
        """One JSON object: {"command", "version", "seed", "checks": [...]}."""
        return json.dumps(
            {
                "command": self.command,
                "version": version,
                "seed": self.seed,
                "checks": [check.as_dict() for check in self.checks],
            },
            allow_nan=False,
        )

    def to_table(self) -> str:
        """The tables, one with a line for each check, and the notes as plain text."""
        rows: list[Sequence[str]] = [COLUMNS]
        rows += [(*check.cells(), "ok" if check.ok else "FALLS SHORT") for check in self.checks]
        lines = [aligned(rows)] if self.checks or not self.tables else []
        for title, table in self.tables.items():
            lines += ["", title, aligned(table)]
        return "\n".join([*lines, *self.notes])
