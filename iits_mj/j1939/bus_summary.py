"""What was on a bus: groups by sender, how often, and within which bounds their signals were."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from iits_mj.core.errors import BusError
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Status
from iits_mj.j1939.readings import INVALID, BusReader, Entry, Reading
from iits_mj.j1939.transport import Reassembler

_SHOWN_TEXTS = 3
_MAX_TEXTS = 100


@dataclass(slots=True)
class SignalRange:
    """A signal over the log.

    Attributes:
      unit: of its numbers; minimum, maximum: of them, infinite while there was none.
      texts: the different texts, at most 100.
      missing: how often it carried no value.
    """

    unit: str
    minimum: float = math.inf
    maximum: float = -math.inf
    texts: list[str] = field(default_factory=list)
    missing: int = 0

    def add(self, entry: Entry) -> None:
        """Takes the signal's next value."""
        if isinstance(entry.value, float):
            self.minimum = min(self.minimum, entry.value)
            self.maximum = max(self.maximum, entry.value)
        elif entry.value is None:
            self.missing += 1
        elif entry.value not in self.texts and len(self.texts) < _MAX_TEXTS:
            self.texts.append(entry.value)

    def as_dict(self) -> dict[str, Any]:
        """Everything for JSON; bounds are None while there was no number."""
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
    """A group of one sender.

    Attributes:
      message: its name, empty when not known; count: of its frames or long messages.
      first, last: times [s]; invalid: how many were of the wrong length.
      signals: by name; empty for what is not decoded.
    """

    message: str
    first: float
    last: float
    count: int = 0
    invalid: int = 0
    signals: dict[str, SignalRange] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """Mean time between two [s]; NaN for a single one."""
        return (self.last - self.first) / (self.count - 1) if self.count > 1 else math.nan


class BusSummary:
    """Counts readings.

    Attributes:
      traffic: by PGN, source and destination.
      transport: the reassembly of the long messages, once the log has ended.
    """

    def __init__(self) -> None:
        self.traffic: dict[tuple[int, int, int], Traffic] = {}
        self.transport: Reassembler | None = None

    def add(self, reading: Reading) -> None:
        """Takes the next reading."""
        key = (reading.pgn, reading.source, reading.destination)
        traffic = self.traffic.get(key)
        if traffic is None:
            traffic = Traffic(reading.message, reading.time, reading.time)
            self.traffic[key] = traffic
        traffic.count += 1
        traffic.last = reading.time
        for entry in reading.entries:
            _add(traffic, entry)

    def text(self) -> str:
        """The summary as a table for people, in the order of the PGNs."""
        lines = [f"{'PGN':>6} {'message':<14} {'from':>4} {'to':>4} {'count':>8} {'period':>10}"]
        for (pgn, source, destination), traffic in sorted(self.traffic.items()):
            period = "" if traffic.count < 2 else f"{traffic.period * 1e3:.1f} ms"
            wrong = f"  {traffic.invalid} of the wrong length" if traffic.invalid else ""
            lines.append(
                f"{pgn:>6} {traffic.message or '-':<14} {source:>4} {destination:>4} "
                f"{traffic.count:>8} {period:>10}{wrong}"
            )
            lines += [f"{'':>8}{n:<40} {s}" for n, s in traffic.signals.items() if str(s)]
        return "\n".join(lines + self._transport_lines())

    def as_dict(self) -> dict[str, Any]:
        """Everything for JSON, in the order of the PGNs; the period of a single one is None."""
        groups = [
            {
                "pgn": pgn,
                "message": traffic.message,
                "source": source,
                "destination": destination,
                "count": traffic.count,
                "period_s": traffic.period if traffic.count > 1 else None,
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

    def _transport_lines(self) -> list[str]:
        if self.transport is None:
            return []
        lines = [f"long messages put together: {self.transport.messages}"]
        failures = sorted(self.transport.failures.items(), key=lambda item: item[0].name)
        return lines + [f"long messages, {why.value}: {count}" for why, count in failures]


def summarize(frames: Iterable[Frame]) -> BusSummary:
    """The summary of a log's frames; BusError where they cannot be read."""
    reader, summary = BusReader(), BusSummary()
    for frame in frames:
        for reading in reader.read(frame):
            summary.add(reading)
    reader.transport.finish()
    summary.transport = reader.transport
    return summary


def _add(traffic: Traffic, entry: Entry) -> None:
    if entry.unit == "hex":
        traffic.invalid += entry.status == INVALID
        return
    signal = traffic.signals.get(entry.signal)
    if signal is None:
        signal = traffic.signals[entry.signal] = SignalRange(entry.unit)
    signal.add(entry)


# --- A bus log as a table: one row a signal, in the long form that data tools like ---

_MISSING = Status.NOT_AVAILABLE.value
COLUMNS = (
    "time_s",
    "priority",
    "pgn",
    "message",
    "source",
    "destination",
    "signal",
    "spn",
    "value",
    "unit",
    "status",
)


def write_table(
    frames: Iterable[Frame], path: str | Path, *, only_values: bool = False
) -> BusSummary:
    """Writes the decoded table of a log, frame by frame, whatever its length.

    Columns: see `COLUMNS`. `value` is empty where the signal carries none (`status` says why); a
    group that is not known, a packet of a long message and a frame of the wrong length are one row
    with their bytes in hex. A long message comes after its last packet, without a priority.

    Args:
      frames: of the log, as `read_log` gives them.
      path: of the CSV file.
      only_values: leave out the signals that say "not available".

    Returns:
      What was on the bus.

    Raises:
      BusError: the file cannot be written, or the frames cannot be read; what was written until
        then is taken away, as it is when the writing is interrupted.
    """
    path = Path(path)
    reader, summary = BusReader(), BusSummary()
    try:
        file = path.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise BusError(f"table {str(path)!r} cannot be written: {error}") from error
    try:
        with file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            for frame in frames:
                for reading in reader.read(frame):
                    summary.add(reading)
                    writer.writerows(_rows(reading, only_values))
    except OSError as error:
        _abandon(path)
        raise BusError(f"table {str(path)!r} cannot be written: {error}") from error
    except BaseException:
        # Interrupted, too.
        _abandon(path)
        raise
    reader.transport.finish()
    summary.transport = reader.transport
    return summary


def _abandon(path: Path) -> None:
    """Takes away half a table, but never a device or what leads to one, as /dev/stdout."""
    if path.is_file() and not path.is_symlink():
        path.unlink()


def _rows(reading: Reading, only_values: bool) -> Iterator[tuple[object, ...]]:
    head = (
        f"{reading.time:.6f}",
        "" if reading.priority is None else reading.priority,
        reading.pgn,
        reading.message,
        reading.source,
        reading.destination,
    )
    for entry in reading.entries:
        if not (only_values and entry.status == _MISSING):
            yield *head, entry.signal, entry.spn or "", _shown(entry), entry.unit, entry.status


def _shown(entry: Entry) -> str:
    if entry.value is None:
        return ""
    # Twelve digits hold a signal of 32 bits on its grid.
    return entry.value if isinstance(entry.value, str) else f"{entry.value:.12g}"
