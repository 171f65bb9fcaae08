"""The one shape of every figure: checks for people and for machines, panels for pictures."""

from __future__ import annotations

import json
import operator
from dataclasses import dataclass, field
from typing import Any

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


@dataclass(frozen=True, slots=True)
class Check:
    """One figure with its bound.

    Attributes:
      name: what was measured; value: the measurement; unit: of both.
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

    def as_dict(self) -> dict[str, Any]:
        """The check as the JSON contract has it; a value that is not finite becomes null."""
        value = float(self.value)
        return {
            "name": self.name,
            "value": value if np.isfinite(value) else None,
            "unit": self.unit,
            "reference": self.reference,
            "must": self.must,
            "ok": self.ok,
        }


@dataclass(frozen=True, slots=True)
class Line:
    """A curve of a panel: x and y of shape (n,).

    Role is "reference", "simulation" or ""; seen from above also "edge" and "mark" of a road, and
    the outlines of a "tractor", a "trailer" or another "vehicle".
    """

    label: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    role: str = ""


@dataclass(frozen=True, slots=True)
class Panel:
    """One set of axes of a figure; labels carry the units."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]


@dataclass(slots=True)
class Results:
    """What validate, evaluate, pcc and bench give back; `parts` are what it was merged from."""

    command: str
    seed: int = 0
    checks: list[Check] = field(default_factory=list)
    figures: dict[str, list[Panel]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    parts: list[Results] = field(default_factory=list)

    @classmethod
    def merged(cls, command: str, parts: list[Results]) -> Results:
        """All checks, figures and notes of several results; pages show them part by part."""
        whole = cls(command, parts=parts)
        for part in parts:
            name = part.command.removeprefix(command).strip()
            whole.checks += part.checks
            whole.notes += part.notes
            whole.figures |= {f"{name}: {title}": panels for title, panels in part.figures.items()}
        return whole

    @property
    def ok(self) -> bool:
        """True when every check holds."""
        return all(check.ok for check in self.checks)

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
        """Plain-text table for people, one line a check."""
        rows = [("check", "value", "unit", "reference", "must", "")]
        for check in self.checks:
            reference = check.reference
            shown = f"{reference:.4g}" if isinstance(reference, float) else str(reference or "")
            verdict = "ok" if check.ok else "FALLS SHORT"
            rows.append((check.name, f"{check.value:.4g}", check.unit, shown, check.must, verdict))
        widths = [max(len(row[i]) for row in rows) for i in range(6)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join([*lines, *self.notes])
