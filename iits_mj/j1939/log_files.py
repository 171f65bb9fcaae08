"""Log files of a bus: read in the formats of the common tools, written in five of them.

| suffix | of | read | written |
|---|---|---|---|
| `.asc`, `.blf` | Vector's tools | yes | yes |
| `.log` | `candump -l` | yes | yes |
| `.trc` | PEAK's tools | yes | yes |
| `.csv` | python-can's own table | yes | yes |
| `.db`, `.mf4` | python-can's SQLite, ASAM (needs the package asammdf) | yes | |
| `.txt` | candump's text on the console (`candump -ta`, `-tz`, `-tA`) | yes | |
| `.bin` | a data logger's 512-byte blocks | yes | |

The content determines how a file is read, not its suffix; `.gz` after the suffix of a text format
means that the file is compressed. Times are in seconds, to the microsecond: since 1970 if the file
has a date, else as in the file.

python-can does not read the last two formats. A line of candump's text is
` (000.000000)  can1  18F11031   [8]  00 00 FF`. A logger's block has the number of records (u32),
21 records of 24 bytes and 4 unused bytes. A record has seconds since 1970 (u32), the logger's own
clock in us (u32), microseconds in the lower 24 bits and the length in the upper 8 (u32), identifier
(u32), 8 data bytes, all little endian.
"""

from __future__ import annotations

import datetime
import io
import math
import re
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import can

from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError
from iits_mj.core.input_files import open_packed
from iits_mj.j1939.bus import from_can, to_can
from iits_mj.j1939.frame import Frame

WRITTEN = (".asc", ".blf", ".csv", ".log", ".trc")
_PACKED = (".asc", ".csv", ".log")
_HEAD = 4096
# 1990: earlier times are relative to the start of the log, not to 1970.
_FIRST_DATE = 631_152_000.0
_FIRST_YEAR = 1990
# Not every format can store later times, after the year 2286 [s].
_LAST_TIME = 1e10
_BY_PATH = ("db", "mf4")
# Formats that have a header even without a frame.
_HEADED = (".bin", ".blf", ".db", ".mf4")
_READERS: dict[str, Callable[..., Any]] = {
    "csv": can.CSVReader,
    "db": can.SqliteReader,
    "log": can.CanutilsLogReader,
    "mf4": can.MF4Reader,
    "trc": can.TRCReader,
}
_READABLE = "asc, blf, candump -l or console text, csv of python-can, db, logger blocks, mf4, trc"
_BLF_OBJECT, _BLF_HEADER = b"LOBJ", 16
_BLOCK = 512
_RECORDS = 21
_RECORD = struct.Struct("<IIII8s")
_HEADER = 4
_EXTENDED_IDS = 1 << 29

_CONSOLE = re.compile(
    r"\s*\((?P<time>[-\d]+ [\d:]+\.\d+|\d+\.\d+)\)\s+\S+\s+(?:[RT]X\s+[B-]\s+[E-]\s+)?"
    r"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(?P<length>\d{1,2})\]"
    r"(?P<rest>.*)"
)
_SHORT_ID = 3
_BYTE = re.compile("[0-9A-Fa-f]{2}")

# The first text that is not blank identifies a format.
_SIGNS: tuple[tuple[str, re.Pattern[bytes]], ...] = (
    ("blf", re.compile(rb"LOGG")),
    ("mf4", re.compile(rb"MDF     ")),
    ("db", re.compile(rb"SQLite format 3\0")),
    ("csv", re.compile(rb"timestamp,arbitration_id,")),
    ("trc", re.compile(rb";\$FILEVERSION=|;#{20,}|;-{4,}\+|\s*\d+\)\s+\d")),
    (
        "asc",
        re.compile(
            rb"(//.*\s+)*(date\s+\w+\s|base\s+(hex|dec)\b|begin\s+triggerblock\b)", re.IGNORECASE
        ),
    ),
    ("log", re.compile(rb"\(\d+(\.\d+)?\)\s+\S+\s+[0-9A-Fa-f]+#")),
    ("console", re.compile(rb"\([-\d: .]+\)\s+\S+\s+.*\[\d{1,2}\]")),
)


def read_log(path: str | Path) -> Iterator[Frame]:
    """Yields the frames of a log file in file order.

    11-bit, CAN FD, remote and error frames are omitted.

    Args:
      path: of the file; see the module's table.

    Raises:
      BusError: the file is missing, of another format, or damaged.
    """
    frames = _frames(Path(path))
    while True:
        # The parsers of python-can raise exceptions of any type on a damaged file.
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

    Times are written to the microsecond and read back unchanged. A frame that is older than the
    previous one gets the time of the previous one, since times in a log do not decrease.

    Args:
      path: of the file; its suffix selects the format: .asc, .blf, .csv, .log, .trc, or .asc.gz,
        .csv.gz, .log.gz.

    Raises:
      BusError: the suffix is unknown, or the file cannot be written.
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
        """Appends one frame; BusError for a time that a log cannot store, or a write error."""
        if not 0.0 <= frame.time <= _LAST_TIME:
            raise BusError(
                f"frame {frame.can_id:08X} at time {frame.time!r} s: 0 to {_LAST_TIME:g} allowed"
            )
        if self._closed:
            raise BusError(f"CAN log {self._path!r} is closed")
        try:
            if self._last is None:
                # Times in the file are relative to a whole second, so that no digit is lost.
                _start(self._writer, math.floor(frame.time) if frame.time >= _FIRST_DATE else 0.0)
                self._last = frame.time
            self._last = max(self._last, frame.time)
            message = to_can(frame)
            message.timestamp = round(self._last, 6)
            self._writer(message)
        except (OSError, ValueError, OverflowError) as error:
            raise BusError(f"CAN log {self._path!r} cannot be written: {error}") from error

    def close(self) -> None:
        """Completes the file; may be called again."""
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.stop()
        except OSError as error:
            raise BusError(f"CAN log {self._path!r} cannot be finished: {error}") from error


def _start(writer: can.io.generic.MessageWriter, epoch: float) -> None:
    """Sets the epoch of a file's times; python-can would use the first frame's milliseconds."""
    if isinstance(writer, can.ASCWriter):
        writer.log_event("// times count from the trigger", epoch)
    elif isinstance(writer, can.BLFWriter):
        writer.start_timestamp = epoch
    elif isinstance(writer, can.TRCWriter):
        writer.first_timestamp = epoch
        writer.write_header(epoch)


def _frames(path: Path) -> Iterator[Frame]:
    with open_packed(path) as file:
        head = file.read(_HEAD)
    kind = _format_of(head)
    if kind is None:
        if not head.strip() and path.suffix.lower() not in _HEADED:
            return
        raise BusError(f"its content is none of: {_READABLE}" if head.strip() else "it is empty")
    if kind in _BY_PATH:
        yield from _messages(_READERS[kind](str(path)))
        return
    with open_packed(path) as file:
        if kind == "logger":
            yield from _logger_frames(file)
        elif kind == "blf":
            yield from _messages(_BlfReader(file))
        else:
            text = io.TextIOWrapper(file, encoding="utf-8", errors="replace")
            yield from _text_frames(kind, head, text)


def _text_frames(kind: str, head: bytes, text: TextIO) -> Iterator[Frame]:
    if kind == "console":
        yield from _console_frames(text)
    elif kind == "asc":
        if re.search(rb"timestamps\s+relative", head, re.IGNORECASE):
            raise BusError("its times are relative to the previous line; absolute ones are needed")
        yield from _messages(can.ASCReader(text, relative_timestamp=not _has_date(head)))
    else:
        yield from _messages(_READERS[kind](text))


class _BlfReader(can.BLFReader):
    """Reads BLF logs; refuses the damaged ones that python-can would read without end."""

    def _parse_data(self, data: bytes) -> Iterator[can.Message]:
        _check_objects(data)
        yield from super()._parse_data(data)


def _check_objects(data: bytes) -> None:
    """Raises BusError for an object of a BLF container that is smaller than its own header.

    python-can would read it again and again.
    """
    place = data.find(_BLF_OBJECT, 0, 8)
    while 0 <= place <= len(data) - _BLF_HEADER:
        size = int.from_bytes(data[place + 8 : place + 12], "little")
        if size < _BLF_HEADER:
            raise BusError(f"an object of {size} bytes: at least {_BLF_HEADER} are needed")
        place = data.find(_BLF_OBJECT, place + size, place + size + 8)


def _messages(reader: can.io.generic.MessageReader) -> Iterator[Frame]:
    with reader:
        for message in reader:
            frame = from_can(message)
            if frame is not None:
                yield Frame(frame.can_id, frame.data, round(frame.time, 6))


def _has_date(head: bytes) -> bool:
    """Whether the trigger block or the header of an ASC file has a date."""
    years = re.findall(
        rb"^\s*(?:begin\s+triggerblock|date)\b.*\b(\d{4})\s*$", head, re.IGNORECASE | re.MULTILINE
    )
    return bool(years) and int(years[-1]) >= _FIRST_YEAR


def _format_of(head: bytes) -> str | None:
    """Format of a log by its first bytes, at least `_BLOCK` of a longer file; None if unknown."""
    text = head.lstrip()
    for name, sign in _SIGNS:
        if sign.match(text):
            return name
    return "logger" if _records(head[:_BLOCK]) else None


def _console_frames(lines: Iterable[str]) -> Iterator[Frame]:
    """Yields the extended data frames of candump's console text; BusError for any other line.

    An incomplete last line, as a power cut causes it, is dropped.
    """
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        match = _CONSOLE.match(line)
        data = _bytes_of(match) if match else None
        if match is None or data is None:
            if line.endswith("\n"):
                raise BusError(f"line {number} is no frame in candump's format: {line.strip()!r}")
            return
        can_id = int(match["id"], 16)
        # candump marks an error frame above the 29 bits.
        extended = len(match["id"]) > _SHORT_ID and can_id < _EXTENDED_IDS
        if extended and isinstance(data, bytes):
            yield Frame(can_id, data, _console_time(match["time"]))


def _logger_frames(file: BinaryIO) -> Iterator[Frame]:
    """Yields the frames of a logger's 512-byte blocks; BusError for any other block."""
    number = 0
    while block := file.read(_BLOCK):
        if len(block) != _BLOCK:
            raise BusError(f"block {number} is cut off after {len(block)} of its {_BLOCK} bytes")
        records = _records(block)
        if not records:
            raise BusError(f"block {number} does not hold a logger's records")
        for second, _, packed, can_id, data in records:
            time = round(second + (packed & 0xFFFFFF) * 1e-6, 6)
            yield Frame(can_id, data[: packed >> 24], time)
        number += 1


def _bytes_of(match: re.Match[str]) -> bytes | str | None:
    """Data of a console line; a word for a CAN FD or remote frame, None if incomplete."""
    length, rest = int(match["length"]), match["rest"].split()
    if len(match["length"]) > 1:
        return "CAN FD"
    if rest[:2] == ["remote", "request"]:
        return "remote"
    shown = rest[:length]
    if len(shown) < length or length > 8 or not all(map(_BYTE.fullmatch, shown)):
        return None
    return bytes.fromhex("".join(shown))


def _console_time(text: str) -> float:
    if " " in text:
        try:
            return datetime.datetime.fromisoformat(text).timestamp()
        except ValueError as error:
            raise BusError(f"time stamp {text!r}: {error}") from error
    return float(text)


def _records(block: bytes) -> list[tuple[Any, ...]]:
    """The records of a logger's block; none if its numbers are not plausible."""
    if len(block) != _BLOCK:
        return []
    (count,) = struct.unpack_from("<I", block)
    if not 1 <= count <= _RECORDS:
        return []
    records = list(_RECORD.iter_unpack(block[_HEADER : _HEADER + _RECORD.size * count]))
    plausible = all(
        packed >> 24 <= 8 and packed & 0xFFFFFF < 1_000_000 and can_id < _EXTENDED_IDS
        for _, _, packed, can_id, _ in records
    )
    return records if plausible else []
