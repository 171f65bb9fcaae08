"""Rows of one dataclass as a CSV file: runs that are stopped go on with what they have."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from iits_mj.errors import InputError

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
