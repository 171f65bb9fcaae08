"""Reads events: the table of all kinds, an event of a mapping, and the events of a TOML file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from iits_mj.core.checks import check_fields, did_you_mean, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from traffic_bridge.scenario.actions import SCENARIO_EVENTS
from traffic_bridge.scenario.conditions import ROLES, TRUCK, names_in
from traffic_bridge.scenario.parameters import (
    PARAMETERS_MAX,
    Parameter,
    parameter_of,
    resolved,
    scope_of,
)
from traffic_bridge.signals.events import (
    Event,
    LaneClosure,
    LightOverride,
    LightProgramRun,
    SlowConvoy,
    SpeedLimit,
    StoppedVehicle,
    VehicleChange,
)

EVENTS_MAX = 1000  # of a file

_CLASSES: tuple[type[Event], ...] = (
    *(LightOverride, LightProgramRun, SpeedLimit, LaneClosure),
    *(StoppedVehicle, SlowConvoy, VehicleChange, *SCENARIO_EVENTS),
)
EVENTS: dict[str, type[Event]] = {event.kind: event for event in _CLASSES}


def event_of(values: Mapping[str, Any]) -> Event:
    """The event of a mapping: `event` is its name, everything else a field of its class.

    Raises:
      InputError: the name or a field is unknown or missing, or a value is not allowed.
    """
    given = dict(values)
    name = given.pop("event", None)
    if not isinstance(name, str) or name not in EVENTS:
        raise InputError(
            f"event = {shown(name)}{did_you_mean(name, EVENTS)}: allowed are {', '.join(EVENTS)}"
        )
    fields = {field.name: field for field in dataclasses.fields(EVENTS[name])}
    check_fields(name, given, fields)
    required = [f.name for f in fields.values() if f.default is dataclasses.MISSING]
    missing = [field for field in required if field not in given]
    if missing:
        raise InputError(f"{name}: {', '.join(missing)} is missing")
    return EVENTS[name](**given)


def read_events(path: str | Path, given: Mapping[str, str] | None = None) -> tuple[Event, ...]:
    """The events of a TOML file, in its order; the fields are those of the events' classes.

        [parameters]
        opens = {default = 120.0, unit = "s", low = 30.0}

        [[events]]
        event = "lane_closure"
        lane = 0
        start = 900.0
        end = 1100.0
        at_time = 20.0
        until = "$opens"

    Args:
      path: of the file.
      given: values of parameters, as text by name; the others have their defaults.

    Raises:
      InputError: the file cannot be read or is not TOML, or a parameter or an event is not usable;
        the message has the file, the event's number and what is allowed.
    """
    path = Path(path)
    entries, parameters = _read(path)
    scope, used = scope_of(parameters, given or {}, str(path)), set[str]()
    events = []
    for number, entry in enumerate(entries, start=1):
        try:
            events.append(event_of(resolved(entry, scope, used)))
        except InputError as error:
            raise InputError(f"{path}: event {number}: {error}") from error
    for name in parameters:
        if name not in used:
            raise InputError(f'{path}: no event uses the parameter {name}: write "${name}"')
    return tuple(events)


def read_parameters(path: str | Path) -> dict[str, Parameter]:
    """The parameters of a TOML file of events by name; errors as of `read_events`."""
    return _read(Path(path))[1]


def _read(path: Path) -> tuple[list[dict[str, Any]], dict[str, Parameter]]:
    content = read_toml(path, "file of events")
    unknown = [name for name in content if name not in ("events", "parameters")]
    if unknown:
        raise InputError(
            f"{path}: {unknown[0]!r} is unknown; the file has tables [[events]] and [parameters]"
        )
    entries, declared = content.get("events", []), content.get("parameters", {})
    if not isinstance(entries, list) or any(not isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: 'events' must be tables [[events]]")
    if not isinstance(declared, dict):
        raise InputError(f"{path}: 'parameters' must be a table [parameters]")
    for what, found, most in (
        ("events", entries, EVENTS_MAX),
        ("parameters", declared, PARAMETERS_MAX),
    ):
        if len(found) > most:
            raise InputError(f"{path}: {len(found)} {what} are more than {most} allowed")
    try:
        return entries, {name: parameter_of(name, entry) for name, entry in declared.items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def check_references(events: Sequence[Event]) -> None:
    """Checks the names by which events refer to each other.

    Raises:
      InputError: two events have one name, or a condition names an event that is not there or is
        not the only one of its name.
    """
    titles = [event.title for event in events]
    placed = [event.name for event in events if event.name is not None]
    for name in placed:
        if placed.count(name) > 1:
            raise InputError(f"events: {placed.count(name)} of them have the name {name!r}")
        if name in ROLES or name == TRUCK:
            raise InputError(f"events: the name {name!r} has another meaning")
    for event in events:
        for name in sorted(names_in(event.when or ())[1]):
            if titles.count(name) != 1:
                found = "no event has" if name not in titles else "several events have"
                raise InputError(
                    f"{event.title}: when: event = {name!r}: {found} this name"
                    f"{did_you_mean(name, titles)}"
                )
