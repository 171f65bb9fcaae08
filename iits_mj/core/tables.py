"""Reads TOML files, and reads and writes CSV tables: columns of numbers, rows of a dataclass.

The first row of a CSV table that is neither empty nor a comment (`#`) holds the column names. A
byte order mark and empty rows are ignored.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.output_files import OutputFile

Row = TypeVar("Row")
_KINDS = {"str": str, "int": int, "float": float}


def read_table(path: str | Path, what: str) -> tuple[list[str], list[list[str]]]:
    """Returns the column names and the cells of the rows below; both empty for an empty file.

    Args:
      path: of the file.
      what: what the file is, for error messages: "road profile".

    Raises:
      InputError: the file cannot be read.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.reader(line for line in stream if not line.startswith("#")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{what} {str(path)!r} cannot be read: {error}") from error
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    return (rows[0], rows[1:]) if rows else ([], [])


def read_names(path: str | Path, what: str) -> list[str]:
    """Returns the column names in lower case; errors as of `read_table`."""
    return [cell.strip().lower() for cell in read_table(path, what)[0]]


def read_columns(
    path: str | Path, what: str, names: Sequence[tuple[str, ...]], rows: int = 2
) -> list[FloatArray]:
    """Reads columns of numbers, each of shape (n,), in the order of `names`.

    Args:
      path: of the file, which may have further columns.
      what: what the file is, for error messages.
      names: allowed names of each column in lower case, the preferred one first. The names in the
        file may be in upper case.
      rows: least number of rows.

    Raises:
      InputError: unreadable file, a missing column, a cell that is not a finite number, too few
        rows.
    """
    header, table = read_table(path, what)
    found = [cell.strip().lower() for cell in header]
    places = [next((found.index(n) for n in choice if n in found), -1) for choice in names]
    if min(places) < 0:
        wanted = " and ".join(choice[0] for choice in names)
        raise InputError(f"{what} {str(path)!r}: columns {wanted} are needed, found {found[:12]}")
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


def read_rows(path: Path, row_type: type[Row], what: str) -> list[Row]:
    """Reads rows of a dataclass; returns none when the file does not exist.

    A row with too few cells is skipped: an interrupted write can leave one at the end.

    Args:
      path: of the file.
      row_type: a dataclass whose fields are str, int or float; they are the columns. The file may
        lack those that have a default.
      what: what the rows are, for error messages.

    Raises:
      InputError: the file has other columns, or cannot be read.
    """
    if not path.exists():
        return []
    kinds: dict[str, Any] = {f.name: _KINDS[str(f.type)] for f in fields(row_type)}  # type: ignore[arg-type]
    names, table = read_table(path, f"file of {what}")
    if not are_columns(names, row_type):
        raise InputError(f"{str(path)!r} is not a file of {what}: its columns differ")
    try:
        return [
            row_type(**{n: kinds[n](cell) for n, cell in zip(names, row, strict=False)})
            for row in table
            if len(row) >= len(names)
        ]
    except ValueError as error:
        raise InputError(f"file of {what} {str(path)!r} cannot be read: {error}") from error


def are_columns(names: Sequence[str], row_type: type[Any]) -> bool:
    """Returns whether names are the columns of a dataclass; those with a default may be missing."""
    needed = [f.name for f in fields(row_type) if f.default is MISSING or f.name in names]
    return list(names) == needed


def write_rows(path: Path, row_type: type[Row], rows: Iterable[Row], what: str) -> None:
    """Writes rows of a dataclass with a header; errors as of `write_table`."""
    names = [f.name for f in fields(row_type)]  # type: ignore[arg-type]
    write_table(path, names, (asdict(row) for row in rows), what)  # type: ignore[call-overload]


def write_table(
    path: Path, names: Sequence[str], rows: Iterable[Mapping[str, Any]], what: str
) -> None:
    """Writes rows with these columns; an older file stays until the new one is complete.

    Raises:
      InputError: the file cannot be written.
    """
    with (
        OutputFile(path, f"file of {what}") as partial,
        partial.open("w", newline="", encoding="utf-8") as stream,
    ):
        writer = csv.DictWriter(stream, names)
        writer.writeheader()
        writer.writerows(rows)
