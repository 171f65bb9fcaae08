"""Log files of a bus: read in the formats of the common tools, written in five of them.

| suffix | of | read | written |
|---|---|---|---|
| `.asc`, `.blf` | Vector's tools | yes | yes |
| `.log` | `candump -l` | yes | yes |
| `.trc` | PEAK's tools | yes | yes |
| `.csv` | python-can's own table | yes | yes |
| `.db`, `.mf4` | python-can's SQLite, ASAM (needs the package asammdf) | yes | |
| `.txt` | candump's text on the console (`candump -ta`, `-tz`, `-tA`) | yes | |
| `.bin` | a data logger's 512-byte blocks (`log_formats`) | yes | |

Reading goes by the content, so a wrong suffix does no harm; `.gz` after the suffix of a text format
means that it is packed. Times are in seconds, to the microsecond: since 1970 where the file knows
the date, as in the file where it does not.
"""

from __future__ import annotations

import gzip
import io
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TextIO, cast

import can

from iits_mj.closing import Closing
from iits_mj.errors import BusError
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.log_formats import console_frames, format_of, logger_frames
from iits_mj.j1939.python_can import from_can, to_can

WRITTEN = (".asc", ".blf", ".csv", ".log", ".trc")
_PACKED = (".asc", ".csv", ".log")
_HEAD = 4096
_GZIP = b"\x1f\x8b"
# 1990: earlier times are seconds since some start, not a date.
_FIRST_DATE = 631_152_000.0
_FIRST_YEAR = 1990
# Later ones, of the year 2286 and beyond, do not fit into every format [s].
_LAST_TIME = 1e10
_BY_PATH = ("db", "mf4")
# Without a frame, too, these have a header.
_HEADED = (".bin", ".blf", ".db", ".mf4")
_READERS: dict[str, Callable[..., Any]] = {
    "blf": can.BLFReader,
    "csv": can.CSVReader,
    "db": can.SqliteReader,
    "log": can.CanutilsLogReader,
    "mf4": can.MF4Reader,
    "trc": can.TRCReader,
}
_READABLE = "asc, blf, candump -l or console text, csv of python-can, db, logger blocks, mf4, trc"


def read_log(path: str | Path) -> Iterator[Frame]:
    """Frames of a log file in file order, read as they are asked for.

    11-bit, CAN FD, remote and error frames are left out.

    Args:
      path: of the file; see the module's table.

    Raises:
      BusError: the file is missing, is no such log, or is broken at some place.
    """
    frames = _frames(Path(path))
    while True:
        # What python-can's parsers raise on a broken file is of any type.
        try:
            frame = next(frames)
        except StopIteration:
            return
        except Exception as error:
            why = str(error) or type(error).__name__
            raise BusError(f"CAN log {str(path)!r} cannot be read: {why}") from error
        if not math.isfinite(frame.time):
            why = f"frame {frame.can_id:08X} at time {frame.time!r}"
            raise BusError(f"CAN log {str(path)!r} cannot be read: {why}")
        yield frame


class LogWriter(Closing):
    """Writes frames to a log that CAN tools read; a context manager.

    Times are written to the microsecond and come back as they were. A frame that is older than the
    one before it gets that one's time, since logs run forward.

    Args:
      path: of the file; its suffix picks the format: .asc, .blf, .csv, .log, .trc, or .asc.gz,
        .csv.gz, .log.gz.

    Raises:
      BusError: another suffix, or the file cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = str(path)
        suffixes = [suffix.lower() for suffix in Path(path).suffixes]
        packed = suffixes[-1:] == [".gz"]
        suffix = "".join(suffixes[-2:-1] if packed else suffixes[-1:])
        if suffix not in (_PACKED if packed else WRITTEN):
            raise BusError(
                f"CAN log {self._path!r} cannot be written: its suffix must be one of "
                f"{', '.join(WRITTEN)}, or of {', '.join(_PACKED)} with .gz"
            )
        self._closed = False
        self._last: float | None = None
        try:
            self._writer = can.Logger(self._path)
        except (OSError, ValueError, can.CanError) as error:
            raise BusError(f"CAN log {self._path!r} cannot be written: {error}") from error

    def write(self, frame: Frame) -> None:
        """Appends one frame; BusError when its time cannot stand in a log or the file is full."""
        if not 0.0 <= frame.time <= _LAST_TIME:
            raise BusError(
                f"frame {frame.can_id:08X} at time {frame.time!r} s: 0 to {_LAST_TIME:g} allowed"
            )
        if self._closed:
            raise BusError(f"CAN log {self._path!r} is closed")
        try:
            if self._last is None:
                _start(self._writer, _epoch(frame.time))
                self._last = frame.time
            self._last = max(self._last, frame.time)
            message = to_can(frame)
            message.timestamp = round(self._last, 6)
            self._writer(message)
        except (OSError, ValueError, OverflowError) as error:
            raise BusError(f"CAN log {self._path!r} cannot be written: {error}") from error

    def close(self) -> None:
        """Finishes the file; may be called again."""
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.stop()
        except OSError as error:
            raise BusError(f"CAN log {self._path!r} cannot be finished: {error}") from error


def _epoch(time: float) -> float:
    """Time that a file's own times count from: a whole second, so that no digit is lost."""
    return math.floor(time) if time >= _FIRST_DATE else 0.0


def _start(writer: can.io.generic.MessageWriter, epoch: float) -> None:
    """Fixes that time; otherwise python-can takes the first frame's, cut to milliseconds."""
    if isinstance(writer, can.ASCWriter):
        writer.log_event("// times count from the trigger", epoch)
    elif isinstance(writer, can.BLFWriter):
        writer.start_timestamp = epoch
    elif isinstance(writer, can.TRCWriter):
        writer.first_timestamp = epoch
        writer.write_header(epoch)


def _frames(path: Path) -> Iterator[Frame]:
    with path.open("rb") as raw:
        packed = raw.read(len(_GZIP)) == _GZIP
    with _open(path, packed) as file:
        head = file.read(_HEAD)
    kind = format_of(head)
    if kind is None:
        if not head.strip() and path.suffix.lower() not in _HEADED:
            return
        raise BusError(f"its content is none of: {_READABLE}" if head.strip() else "it is empty")
    if kind in _BY_PATH:
        yield from _messages(_READERS[kind](str(path)))
        return
    with _open(path, packed) as file:
        if kind == "logger":
            yield from logger_frames(file)
        elif kind == "blf":
            yield from _messages(can.BLFReader(file))
        else:
            yield from _text_frames(kind, head, _text(file))


def _text_frames(kind: str, head: bytes, text: TextIO) -> Iterator[Frame]:
    if kind == "console":
        yield from console_frames(text)
    elif kind == "asc":
        if re.search(rb"timestamps\s+relative", head, re.IGNORECASE):
            raise BusError("its times are relative to the line before; absolute ones are wanted")
        yield from _messages(can.ASCReader(text, relative_timestamp=not _has_date(head)))
    else:
        yield from _messages(_READERS[kind](text))


def _messages(reader: can.io.generic.MessageReader) -> Iterator[Frame]:
    with reader:
        for message in reader:
            frame = from_can(message)
            if frame is not None:
                yield Frame(frame.can_id, frame.data, round(frame.time, 6))


def _open(path: Path, packed: bool) -> BinaryIO:
    return cast(BinaryIO, gzip.open(path, "rb") if packed else path.open("rb"))


def _text(file: BinaryIO) -> TextIO:
    return io.TextIOWrapper(file, encoding="utf-8", errors="replace")


def _has_date(head: bytes) -> bool:
    """Whether an ASC file's trigger, or else its header, names a date."""
    years = re.findall(
        rb"^\s*(?:begin\s+triggerblock|date)\b.*\b(\d{4})\s*$", head, re.IGNORECASE | re.MULTILINE
    )
    return bool(years) and int(years[-1]) >= _FIRST_YEAR
