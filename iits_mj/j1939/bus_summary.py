"""All frames of a bus with names and units: as a summary, or as a table of all signals.

This includes messages of several frames and unknown groups.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from iits_mj.core.errors import BusError
from iits_mj.core.output_files import OutputFile, unwritable
from iits_mj.j1939.database import name_of
from iits_mj.j1939.diagnostics import LONG_GROUPS, LongGroup, read_group
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.groups import Status, layouts
from iits_mj.j1939.transport import CONNECTION, TRANSFER, Reassembler

OK = "ok"
UNKNOWN = "unknown group"
PACKET = "part of a long message"
INVALID = "wrong length"
_TRANSPORT = {CONNECTION: "TP.CM", TRANSFER: "TP.DT"}
_LONG_NAMES = {kind.PGN: kind.MESSAGE for kind in LONG_GROUPS}
# Limits of a signal's texts, in the table of a summary and altogether.
_SHOWN_TEXTS, _MAX_TEXTS = 3, 100
COLUMNS = (
    *("time_s", "priority", "pgn", "message", "source", "destination"),
    *("signal", "spn", "value", "unit", "status"),
)


class Entry(NamedTuple):
    """A signal of a frame or message.

    Attributes:
      signal: name; "data" for raw bytes in hex, which are not decoded.
      spn: its number, 0 for our own; unit: of the number.
      value: a number or text if `status` is `OK`, else raw bytes or None.
      status: `OK`, "not available", "error", "out of range", `UNKNOWN`, `PACKET`, `INVALID`.
    """

    signal: str
    spn: int
    value: float | str | None
    unit: str
    status: str


@dataclass(frozen=True, slots=True)
class Reading:
    """A decoded frame, or a long message after its last frame.

    Attributes:
      time: [s]; source, destination: addresses.
      priority: 0 to 7; None for a long message, whose packets do not contain it.
      pgn: parameter group number.
      message: name of the group; empty if unknown.
      entries: its signals.
    """

    time: float
    priority: int | None
    pgn: int
    message: str
    source: int
    destination: int
    entries: tuple[Entry, ...]


class BusReader:
    """Decodes all frames of a bus; never raises.

    Attributes:
      transport: reassembles long messages and counts the failed ones.
    """

    def __init__(self) -> None:
        self.transport = Reassembler()

    def read(self, frame: Frame) -> Iterator[Reading]:
        """The readings of the frame and of the long message that it completes."""
        pgn, source, destination = frame.pgn, frame.source, frame.destination
        if pgn in _TRANSPORT:
            message, entries = _TRANSPORT[pgn], _raw(frame.data, PACKET)
        else:
            message, entries = _content(pgn, frame.data)
        yield Reading(frame.time, frame.priority, pgn, message, source, destination, entries)
        whole = self.transport.receive(frame) if pgn in _TRANSPORT else None
        if whole is not None:
            name, entries = _content(whole.pgn, whole.data)
            ends = (whole.source, whole.destination)
            yield Reading(whole.time, None, whole.pgn, name, *ends, entries)


def _content(pgn: int, data: bytes) -> tuple[str, tuple[Entry, ...]]:
    try:
        group = read_group(pgn, data)
    except BusError:
        return name_of(pgn) or _LONG_NAMES[pgn], _raw(data, INVALID)
    if group is None:
        return "", _raw(data, UNKNOWN)
    if isinstance(group, LongGroup):
        long = (_entry(name, spn, "", value) for name, spn, value in group.entries())
        return group.MESSAGE, tuple(long)
    signals = zip(group.items(), _signals(group.MESSAGE), strict=True)
    return group.MESSAGE, tuple(_entry(n, spn, unit, v) for (n, v), (spn, unit) in signals)


def _entry(name: str, spn: int, unit: str, value: float | str | Status) -> Entry:
    if isinstance(value, Status):
        return Entry(name, spn, None, unit, value.value)
    return Entry(name, spn, value, unit, OK)


def _raw(data: bytes, status: str) -> tuple[Entry, ...]:
    return (Entry("data", 0, data.hex(), "hex", status),)


@functools.cache
def _signals(message: str) -> tuple[tuple[int, str], ...]:
    """SPN and unit of a message's signals, in the order of the DBC."""
    signals = layouts().get_message_by_name(message).signals
    return tuple((signal.spn or 0, signal.unit or "") for signal in signals)


@dataclass(slots=True)
class SignalRange:
    """A signal over the log.

    Attributes:
      unit: of its numbers; minimum, maximum: of the numbers, infinite if there are none.
      texts: the different texts, at most 100.
      missing: number of occurrences without a value.
    """

    unit: str
    minimum: float = math.inf
    maximum: float = -math.inf
    texts: list[str] = field(default_factory=list)
    missing: int = 0

    def add(self, entry: Entry) -> None:
        """Adds the signal's next value."""
        if isinstance(entry.value, float):
            self.minimum = min(self.minimum, entry.value)
            self.maximum = max(self.maximum, entry.value)
        elif entry.value is None:
            self.missing += 1
        elif entry.value not in self.texts and len(self.texts) < _MAX_TEXTS:
            self.texts.append(entry.value)

    def as_dict(self) -> dict[str, Any]:
        """The content for JSON; bounds are None if there are no numbers."""
        known = self.minimum <= self.maximum
        return {
            "unit": self.unit,
            "minimum": self.minimum if known else None,
            "maximum": self.maximum if known else None,
            "texts": self.texts,
            "missing": self.missing,
        }

    def __str__(self) -> str:
        if self.minimum <= self.maximum:
            return f"{self.minimum:g} .. {self.maximum:g} {self.unit}".rstrip()
        more = ", ..." if len(self.texts) > _SHOWN_TEXTS else ""
        return ", ".join(map(repr, self.texts[:_SHOWN_TEXTS])) + more


@dataclass(slots=True)
class Traffic:
    """All messages of a group from one sender to one destination.

    Attributes:
      message: name of the group, empty if unknown; count: of frames or long messages.
      first, last: times [s]; invalid: number of messages of the wrong length.
      signals: by name; empty for a group that is not decoded.
    """

    message: str
    first: float
    last: float
    count: int = 0
    invalid: int = 0
    signals: dict[str, SignalRange] = field(default_factory=dict)

    @property
    def period(self) -> float | None:
        """Mean time between two messages [s]; None for a single message."""
        return (self.last - self.first) / (self.count - 1) if self.count > 1 else None


class BusSummary:
    """Counts readings.

    Attributes:
      traffic: by PGN, source and destination.
      transport: the reassembly of the long messages; None until the end of the log.
    """

    def __init__(self) -> None:
        self.traffic: dict[tuple[int, int, int], Traffic] = {}
        self.transport: Reassembler | None = None

    def add(self, reading: Reading) -> None:
        """Adds the next reading."""
        key = (reading.pgn, reading.source, reading.destination)
        if key not in self.traffic:
            self.traffic[key] = Traffic(reading.message, reading.time, reading.time)
        traffic = self.traffic[key]
        traffic.count += 1
        traffic.last = reading.time
        for entry in reading.entries:
            if entry.unit == "hex":
                traffic.invalid += entry.status == INVALID
                continue
            signal = traffic.signals.get(entry.signal)
            if signal is None:
                signal = traffic.signals[entry.signal] = SignalRange(entry.unit)
            signal.add(entry)

    def text(self) -> str:
        """The summary as a readable table, in the order of the PGNs."""
        lines = [f"{'PGN':>6} {'message':<14} {'from':>4} {'to':>4} {'count':>8} {'period':>10}"]
        for (pgn, source, destination), traffic in sorted(self.traffic.items()):
            period = "" if traffic.period is None else f"{traffic.period * 1e3:.1f} ms"
            wrong = f"  {traffic.invalid} of the wrong length" if traffic.invalid else ""
            lines.append(
                f"{pgn:>6} {traffic.message or '-':<14} {source:>4} {destination:>4} "
                f"{traffic.count:>8} {period:>10}{wrong}"
            )
            lines += [f"{'':>8}{n:<40} {s}" for n, s in traffic.signals.items() if str(s)]
        if self.transport is not None:
            lines.append(f"long messages put together: {self.transport.messages}")
            failures = sorted(self.transport.failures.items(), key=lambda item: item[0].name)
            lines += [f"long messages, {why.value}: {count}" for why, count in failures]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """The content for JSON, in the order of the PGNs."""
        groups = [
            {
                "pgn": pgn,
                "message": traffic.message,
                "source": source,
                "destination": destination,
                "count": traffic.count,
                "period_s": traffic.period,
                "wrong_length": traffic.invalid,
                "signals": {name: signal.as_dict() for name, signal in traffic.signals.items()},
            }
            for (pgn, source, destination), traffic in sorted(self.traffic.items())
        ]
        long = self.transport
        failures = {} if long is None else {why.value: n for why, n in long.failures.items()}
        return {
            "groups": groups,
            "long_messages": 0 if long is None else long.messages,
            "long_message_failures": failures,
        }


def summarize(frames: Iterable[Frame]) -> BusSummary:
    """The summary of a log's frames; BusError if they cannot be read."""
    summary = BusSummary()
    for _ in _readings(frames, summary):
        pass
    return summary


def _readings(frames: Iterable[Frame], summary: BusSummary) -> Iterator[Reading]:
    """Adds the readings of all frames to the summary and yields them."""
    reader = BusReader()
    for frame in frames:
        for reading in reader.read(frame):
            summary.add(reading)
            yield reading
    reader.transport.finish()
    summary.transport = reader.transport


def write_table(
    frames: Iterable[Frame], path: str | Path, *, only_values: bool = False
) -> BusSummary:
    """Writes the decoded table of a log of any length and returns its summary.

    The columns are `COLUMNS`. `value` is empty if the signal has none (`status` gives the reason).
    An unknown group, a packet of a long message and a frame of the wrong length have one row with
    their bytes in hex. A long message follows its last packet, without a priority.

    Args:
      frames: of the log, from `read_log`.
      path: of the CSV file.
      only_values: whether to omit the signals that are not available.

    Raises:
      InputError: the file cannot be written. BusError: the frames cannot be read. An older file
        stays as it was then, also after an interruption.
    """
    path = Path(path)
    summary = BusSummary()
    with _output(path) as place, place.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for reading in _readings(frames, summary):
            writer.writerows(_rows(reading, only_values))
    return summary


@contextlib.contextmanager
def _output(path: Path) -> Iterator[Path]:
    """Yields the place to write a table to: a device, or a link to one, is written directly."""
    if not path.exists() or path.is_file():
        with OutputFile(path.resolve(), "table") as partial:
            yield partial
        return
    try:
        yield path
    except OSError as error:
        raise unwritable("table", path, error) from error


def _rows(reading: Reading, only_values: bool) -> Iterator[tuple[object, ...]]:
    head = (
        f"{reading.time:.6f}",
        "" if reading.priority is None else reading.priority,
        reading.pgn,
        reading.message,
        reading.source,
        reading.destination,
    )
    for name, spn, value, unit, status in reading.entries:
        if only_values and status == Status.NOT_AVAILABLE.value:
            continue
        # Twelve digits are enough for a signal of 32 bits.
        shown = f"{value:.12g}" if isinstance(value, float) else value or ""
        yield *head, name, spn or "", shown, unit, status
