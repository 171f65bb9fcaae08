"""A bus log as a table: one row a signal, in the long form that data tools like."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

from iits_mj.errors import BusError
from iits_mj.j1939.bus_summary import BusSummary
from iits_mj.j1939.frame import Frame
from iits_mj.j1939.group import Status
from iits_mj.j1939.readings import BusReader, Entry, Reading

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
