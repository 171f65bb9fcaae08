"""Rows of one dataclass as a CSV file: runs that are stopped go on with what they have."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError

# --- Columns of numbers from a CSV file, by name: roads, cycles, speed profiles ---
# The first row that is neither empty nor a comment (`#`) holds the names, in capitals or not. A
# byte order mark, empty rows and further columns do no harm.


def read_columns(
    path: str | Path, what: str, names: Sequence[tuple[str, ...]], rows: int = 2
) -> list[FloatArray]:
    """Reads columns, each of shape (n,), in the order of `names`.

    Args:
      path: of the file.
      what: it is, for error messages: "road profile".
      names: of each column, in small letters, the preferred one first.
      rows: that are wanted at least.

    Raises:
      InputError: unreadable file, a missing column, a cell that is no finite number, too few rows.
    """
    found, table = _table(Path(path), what)
    places = [next((found.index(n) for n in choice if n in found), -1) for choice in names]
    if min(places) < 0:
        wanted = " and ".join(choice[0] for choice in names)
        raise InputError(f"{what} {str(path)!r}: columns {wanted} are wanted, found {found[:12]}")
    values = np.empty((len(table), len(places)))
    for number, row in enumerate(table):
        try:
            values[number] = [float(row[i]) for i in places]
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{what} {str(path)!r}: not a number in row {number + 1} below the names: {error}"
            ) from error
    if len(values) < rows:
        raise InputError(f"{what} {str(path)!r} has fewer than {rows} rows")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise InputError(
            f"{what} {str(path)!r} holds numbers that are not finite, the first in row "
            f"{bad[0] + 1} below the names"
        )
    return list(values.T)


def read_names(path: str | Path, what: str) -> list[str]:
    """Names of the columns, in small letters; InputError where the file cannot be read."""
    return _table(Path(path), what)[0]


def _table(file: Path, what: str) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and the rows below them."""
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(line for line in stream if not line.startswith("#")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{what} {str(file)!r} cannot be read: {error}") from error
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    names = [cell.strip().lower() for cell in rows[0]] if rows else []
    return names, rows[1:]


# --- Rows of one dataclass as a CSV file: runs that are stopped go on with what they have ---

Row = TypeVar("Row")
_KINDS = {"str": str, "int": int, "float": float}


def read_rows(path: Path, row_type: type[Row], what: str) -> list[Row]:
    """The rows of a file; none when it does not exist. Lines that begin with # are skipped.

    Args:
      path: of the file.
      row_type: a dataclass of str, int and float.
      what: the rows are, for error messages.

    Raises:
      InputError: the file is not one of these.
    """
    if not path.exists():
        return []
    kinds: dict[str, Any] = {f.name: _KINDS[str(f.type)] for f in fields(row_type)}  # type: ignore[arg-type]
    rows = []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            reader = csv.DictReader(line for line in stream if not line.startswith("#"))
            if reader.fieldnames != list(kinds):
                raise InputError(f"{str(path)!r} is not a file of {what}: its columns differ")
            for row in reader:
                # A kill in the middle of a write leaves a short last row: it is driven again.
                if None not in row.values():
                    rows.append(row_type(**{name: kinds[name](row[name]) for name in kinds}))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"file of {what} {str(path)!r} cannot be read: {error}") from error
    return rows


def write_rows(path: Path, row_type: type[Row], rows: Iterable[Row], what: str) -> None:
    """Writes a file anew, with its header; the older one stays until it is complete.

    Raises:
      InputError: it cannot be written.
    """
    names = [f.name for f in fields(row_type)]  # type: ignore[arg-type]
    write_table(path, names, (asdict(row) for row in rows), what)  # type: ignore[call-overload]


def write_table(
    path: Path, names: Sequence[str], rows: Iterable[Mapping[str, Any]], what: str
) -> None:
    """Writes rows with these columns as `write_rows` does.

    Raises:
      InputError: it cannot be written.
    """
    beside = path.with_suffix(".part")
    try:
        with beside.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, names)
            writer.writeheader()
            writer.writerows(rows)
        beside.replace(path)
    except OSError as error:
        raise InputError(f"file of {what} {str(path)!r} cannot be written: {error}") from error
