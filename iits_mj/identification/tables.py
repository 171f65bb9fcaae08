"""Logs and tables in CSV files, with units in their headings."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.errors import InputError
from iits_mj.identification.log import SIGNALS, Log, Series
from iits_mj.units import KMH, RPM

_TO_SI = {"rpm": RPM, "kPa": 1e3, "km/h": KMH, "deg": np.pi / 180.0, "deg/s": np.pi / 180.0}
_TO_SI |= {"%": 0.01, "bar": 1e5, "MPa": 1e6}


def read_table(path: str | Path, names: dict[str, str] | None = None) -> Log:
    """A telemetry table: one column a signal, titles `name [unit]`.

    Raises:
      InputError: unreadable file, a column asked for is not there, a cell that is no number.
    """
    titles = {title: name for name, title in (names or {}).items()}
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"log {str(path)!r} cannot be read: {error}") from error
    if not rows:
        raise InputError(f"log {str(path)!r} is empty")
    columns: dict[str, FloatArray | Series] = {}
    for index, heading in enumerate(rows[0]):
        title, _, unit = heading.partition("[")
        title = title.strip()
        name = titles.pop(title, title)
        if name in SIGNALS and not (name in (names or {}) and title == name):
            factor = _TO_SI.get(unit.strip(" ]"), 1.0)
            columns[name] = _column(rows[1:], index, title) * factor
    if titles:
        raise InputError(f"log {str(path)!r} has no column {next(iter(titles))!r}")
    if "time" not in columns:
        raise InputError(f"log {str(path)!r} lacks the column 'time'")
    return Log(columns)


def _column(rows: list[list[str]], index: int, title: str) -> FloatArray:
    try:
        return np.array([float(row[index]) for row in rows])
    except (ValueError, IndexError) as error:
        raise InputError(f"column {title!r} of the log has a cell that is no number") from error


def read_table_columns(path: str | Path, wanted: tuple[str, ...]) -> list[FloatArray]:
    """Columns of a CSV whose titles begin with these names."""
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"table {str(path)!r} cannot be read: {error}") from error
    titles = [heading.partition("[")[0].strip() for heading in (rows[0] if rows else [])]
    missing = [name for name in wanted if name not in titles]
    if missing:
        raise InputError(f"table {str(path)!r} lacks the column {missing[0]!r}")
    return [_column(rows[1:], titles.index(name), name) for name in wanted]
