"""Reads a data set; recognizes the format by the content."""

from __future__ import annotations

import inspect
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from iits_mj.core.errors import InputError
from iits_mj.core.input_files import open_packed
from traffic_bridge.datasets import fcd, highd, ngsim
from traffic_bridge.datasets.recordings import of_recording
from traffic_bridge.datasets.table import Table, plain, read_csv, read_parquet, read_text
from traffic_bridge.datasets.trajectories import Trajectories
from traffic_bridge.recording.recording import Recording

FORMATS = (
    "our recordings (.npz), SUMO's floating-car data (XML, CSV, Parquet; .gz), NGSIM tables (CSV, "
    "text), reconstructed NGSIM pairs (Parquet), highD-like tracks (CSV)"
)
_HEAD = 1 << 16


def read_trajectories(path: str | Path, **options: Any) -> Trajectories:
    """The trajectories of a file of any known format.

    Args:
      path: the file; for a highD-like recording the tracks file, with the other two beside it.
      **options: `units`, `main_lanes`, `location` for NGSIM tables (see
        `traffic_bridge.datasets.ngsim`), `direction` for highD-like recordings, `types` for
        floating-car data, `route` for recordings of ours. None: the format's default.

    Raises:
      InputError: it cannot be read, has an unknown format or an impossible value (the message
        names file, line and column), or the format does not have an option.
    """
    path = Path(path)
    given = {name: value for name, value in options.items() if value is not None}
    head = _head(path)
    if head.startswith(b"PK"):
        route = given.pop("route", None)
        _refuse(given, path, "a recording of ours")
        return of_recording(Recording.load(path), f"recording {path}", route)
    if head.startswith(b"PAR1"):
        return _read_table(read_parquet(path), path, given)
    if head.lstrip().startswith(b"<"):
        return _call(fcd.read_fcd, fcd.read_fcd_xml(path), path, given)
    first = _first_line(head, path)
    if not any(mark.isalpha() for mark in first):
        if len(first.split()) != len(ngsim.TEXT_COLUMNS):
            raise _unknown(path)
        return _call(ngsim.read_ngsim, read_text(path, ngsim.TEXT_COLUMNS), path, given)
    delimiter = max(",;\t", key=first.count)
    if delimiter not in first or not _known([plain(name) for name in first.split(delimiter)]):
        raise _unknown(path)
    return _read_table(read_csv(path, delimiter), path, given)


def _read_table(table: Table, path: Path, given: dict[str, Any]) -> Trajectories:
    reader = _known([plain(name) for name in table.names])
    if reader is None:
        raise _unknown(path)
    return _call(reader, table, path, given)


def _known(names: list[str]) -> Callable[..., Trajectories] | None:
    """The reader for a table with these columns, or None."""
    names = [name.strip('"').strip("\ufeff") for name in names]

    def has(marks: tuple[str, ...]) -> bool:
        return all(plain(mark) in names for mark in marks)

    if has(ngsim.PAIR_MARKS):
        return ngsim.read_ngsim_pairs
    if has(fcd.MARKS):
        return fcd.read_fcd
    if all(any(plain(mark) in names for mark in marks) for marks in ngsim.MARKS):
        return ngsim.read_ngsim
    return highd.read_highd if has(highd.MARKS) else None


def _call(
    reader: Callable[..., Trajectories], table: Table, path: Path, given: dict[str, Any]
) -> Trajectories:
    allowed = [
        name
        for name, parameter in inspect.signature(reader).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    ]
    _refuse({name: v for name, v in given.items() if name not in allowed}, path, "of a format that")
    return reader(table, path, **given)


def _refuse(given: dict[str, Any], path: Path, what: str) -> None:
    if given:
        raise InputError(f"data set {path}: {what} has no option {', '.join(sorted(given))}")


def _head(path: Path) -> bytes:
    """The beginning of the content, uncompressed."""
    try:
        with open_packed(path) as file:
            head = file.read(_HEAD)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"data set {path}: cannot be read: {reason}") from error
    if not head.strip():
        raise InputError(f"data set {path}: is empty")
    return head


def _first_line(head: bytes, path: Path) -> str:
    try:
        return head.splitlines()[0].decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _unknown(path) from error


def _unknown(path: Path) -> InputError:
    return InputError(f"data set {path}: of no known format; known are {FORMATS}")
