"""The file of trials: rows are added as trials end, half a row is dropped, the end is sorted."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable
from dataclasses import asdict, fields
from pathlib import Path

from iits_mj.errors import InputError
from iits_mj.validation import row_files
from iits_mj.validation.trials import Task, Trial, order_of

_COLUMNS = [field.name for field in fields(Trial)]
_HEADER = (",".join(_COLUMNS) + "\r\n").encode()
_WHAT = "trials"


def read_trials(path: Path, say: Callable[[str], None]) -> dict[Task, Trial]:
    """The trials of a file by what was driven; none when it does not exist.

    Half a row at its end, left by a process that was killed, is taken out of the file.

    Args:
      path: of the file.
      say: is told of the half row.

    Raises:
      InputError: the file is not one of ours, or cannot be read or mended.
    """
    _mend(path, say)
    return {row.task: row for row in row_files.read_rows(path, Trial, _WHAT)}


def write_trials(path: Path, trials: Iterable[Trial]) -> None:
    """Writes the file anew, sorted, so that its bytes do not tell who ended first.

    Raises:
      InputError: it cannot be written.
    """
    row_files.write_rows(path, Trial, sorted(trials, key=order_of), _WHAT)


def append_trial(path: Path, trial: Trial) -> None:
    """Adds one row.

    Raises:
      InputError: it cannot be written.
    """
    try:
        with path.open("a", newline="", encoding="utf-8") as stream:
            csv.DictWriter(stream, _COLUMNS).writerow(asdict(trial))
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be written: {error}") from error


def _mend(path: Path, say: Callable[[str], None]) -> None:
    try:
        content = path.read_bytes() if path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole == len(content):
            return
        if _HEADER.startswith(content):
            path.unlink()
        elif content.startswith(_HEADER):
            with path.open("r+b") as stream:
                stream.truncate(whole)
        else:
            return
    except OSError as error:
        raise InputError(f"file of {_WHAT} {str(path)!r} cannot be read: {error}") from error
    say(f"{str(path)!r} ended with half a row: it was dropped, and is driven again")
