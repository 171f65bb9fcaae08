"""Two formats of bus logs that python-can does not read, and how a log's format is recognized.

- candump's console text, one line a frame: ` (000.000000)  can1  18F11031   [8]  00 00 FF`.
- A data logger's blocks of 512 bytes: the number of records (u32), 21 records of 24 bytes, 4 bytes
  that are left alone. A record: seconds since 1970 (u32), the logger's own clock in us (u32),
  microseconds in the lower 24 bits and the length in the upper 8 (u32), identifier (u32), 8 data
  bytes; everything little endian.
"""

from __future__ import annotations

import datetime
import re
import struct
from collections.abc import Iterable, Iterator
from typing import BinaryIO

from iits_mj.errors import BusError
from iits_mj.j1939.frame import Frame

BLOCK = 512
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

# The first text that is not blank tells a format; a foreign file matches none.
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


def format_of(head: bytes) -> str | None:
    """Format of a log by its first bytes; None when it is none of those known.

    Args:
      head: the first bytes of the file, a block of `BLOCK` or more where the file has them.
    """
    text = head.lstrip()
    for name, sign in _SIGNS:
        if sign.match(text):
            return name
    return "logger" if _is_block(head[:BLOCK]) else None


def console_frames(lines: Iterable[str]) -> Iterator[Frame]:
    """Extended data frames of candump's console text; 11-bit, CAN FD and error frames are left out.

    A last line without its end, as a power cut leaves it, is dropped where it is not whole.

    Raises:
      BusError: a line is not of that text.
    """
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        match = _CONSOLE.match(line)
        data = _bytes_of(match) if match else None
        if match is None or data is None:
            if line.endswith("\n"):
                raise BusError(
                    f"line {number} is not a frame as candump shows it: {line.strip()!r}"
                )
            return
        can_id = int(match["id"], 16)
        # Above 29 bits are candump's flags: an error frame.
        foreign = len(match["id"]) == _SHORT_ID or can_id >= _EXTENDED_IDS
        if not foreign and isinstance(data, bytes):
            yield Frame(can_id, data, _console_time(match["time"]))


def logger_frames(file: BinaryIO) -> Iterator[Frame]:
    """Frames of a logger's 512-byte blocks.

    Raises:
      BusError: a block is cut off or is none.
    """
    number = 0
    while block := file.read(BLOCK):
        if len(block) != BLOCK:
            raise BusError(f"block {number} is cut off after {len(block)} of its {BLOCK} bytes")
        if not _is_block(block):
            raise BusError(f"block {number} does not hold a logger's records")
        (count,) = struct.unpack_from("<I", block)
        for i in range(count):
            second, _, packed, can_id, data = _RECORD.unpack_from(block, _HEADER + _RECORD.size * i)
            time = round(second + (packed & 0xFFFFFF) * 1e-6, 6)
            yield Frame(can_id, data[: packed >> 24], time)
        number += 1


def _bytes_of(match: re.Match[str]) -> bytes | str | None:
    """Data of a console line: the bytes; a word for a frame without; None where it is cut off."""
    length, rest = int(match["length"]), match["rest"].split()
    if len(match["length"]) > 1:
        return "CAN FD"
    if rest[:2] == ["remote", "request"]:
        return "remote"
    shown = rest[:length]
    if len(shown) < length or length > 8 or any(not _is_byte(text) for text in shown):
        return None
    return bytes(int(text, 16) for text in shown)


def _is_byte(text: str) -> bool:
    return len(text) == 2 and all(digit in "0123456789abcdefABCDEF" for digit in text)


def _console_time(text: str) -> float:
    if " " in text:
        try:
            return datetime.datetime.fromisoformat(text).timestamp()
        except ValueError as error:
            raise BusError(f"time stamp {text!r}: {error}") from error
    return float(text)


def _is_block(block: bytes) -> bool:
    """Whether the numbers in a block can be those of a logger."""
    if len(block) != BLOCK:
        return False
    (count,) = struct.unpack_from("<I", block)
    if not 1 <= count <= _RECORDS:
        return False
    records = (_RECORD.unpack_from(block, _HEADER + _RECORD.size * i) for i in range(count))
    return all(
        packed >> 24 <= 8 and packed & 0xFFFFFF < 1_000_000 and can_id < _EXTENDED_IDS
        for _, _, packed, can_id, _ in records
    )
