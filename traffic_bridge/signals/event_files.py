"""Events of a TOML file.

    [[events]]
    event = "lane_closure"
    lane = 0
    start = 900.0
    end = 1100.0
    at_time = 20.0
    until = 120.0

The fields are those of the classes in `traffic_bridge.signals.events`.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from iits_mj.errors import InputError
from traffic_bridge.signals.events import Event, event_of


def read_events(path: str | Path) -> tuple[Event, ...]:
    """The events of a file, in its order; the fields are those of the events' classes.

    Args:
      path: of a TOML file with one table `[[events]]` an event, each with its name as `event`.

    Raises:
      InputError: the file cannot be read or is not TOML, or an event is not usable; the message
        has the file, the event's number and what is allowed.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read: it is not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from error
    unknown = [name for name in content if name != "events"]
    if unknown:
        raise InputError(f"{path}: {unknown[0]!r} is unknown; the file has tables [[events]]")
    entries = content.get("events", [])
    if not isinstance(entries, list) or any(not isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: 'events' must be tables [[events]]")
    events = []
    for number, entry in enumerate(entries, start=1):
        try:
            events.append(event_of(entry))
        except InputError as error:
            raise InputError(f"{path}: event {number}: {error}") from error
    return tuple(events)
