"""Scripted events of the traffic: settings that are stored in recordings and files.

An event begins once: at a traffic time, when the truck reaches a station of its route, or, with
neither, at the beginning. It ends at a traffic time (`until`) or some time after its beginning
(`duration`), or never. `traffic_bridge.signals.controller` carries the events out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from iits_mj.core.checks import did_you_mean, in_range, is_whole, make_plain, plain, shown
from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_toml
from traffic_bridge.vehicles.types import check_changes

LONGEST = 1e6  # [m], [s]
LIGHT_LETTERS = "rRyYgGuoOs"
EVENTS_MAX = 1000  # of a file


@dataclass(frozen=True, kw_only=True)
class Event:
    """Begin and end of an event; subclasses define what happens.

    Attributes:
      at_time: traffic time at which it begins [s].
      at_station: station of the truck's steer axle at which it begins [m].
      until: traffic time at which it ends [s].
      duration: time after which it ends [s].

    Raises:
      InputError: a value is out of its range, or two of them contradict each other.
    """

    name: ClassVar[str] = ""

    at_time: float | None = None
    at_station: float | None = None
    until: float | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
        """Checks the times, then the subclass's values."""
        for field in ("at_time", "at_station", "until", "duration"):
            if getattr(self, field) is not None:
                self._number(field, 0.0, LONGEST)
        if self.at_time is not None and self.at_station is not None:
            raise InputError(f"{self.name}: give at_time or at_station, not both")
        if self.until is not None and self.duration is not None:
            raise InputError(f"{self.name}: give until or duration, not both")
        begin = self.at_time if self.at_time is not None else 0.0
        if self.until is not None and self.until <= begin:
            raise InputError(
                f"{self.name}: until = {self.until:g} s must be after its beginning at {begin:g} s"
            )
        if self.duration == 0.0:
            raise InputError(f"{self.name}: duration = 0 s: must be positive")
        self._check()
        make_plain(self)

    def _check(self) -> None:
        """Checks the subclass's own values."""

    def _number(self, field: str, low: float, high: float) -> None:
        in_range(f"{self.name}: {field}", getattr(self, field), low, high)

    def _whole(self, field: str, low: int, high: int) -> None:
        value = getattr(self, field)
        if not is_whole(value) or not low <= value <= high:
            raise InputError(
                f"{self.name}: {field} = {value!r}: allowed is a whole number from {low} to {high}"
            )

    def _text(self, field: str) -> None:
        value = getattr(self, field)
        if not isinstance(value, str) or not value:
            raise InputError(f"{self.name}: {field} = {value!r}: must be a name")

    def as_dict(self) -> dict[str, Any]:
        """Values for a file, without those that are None; `event_of` is the inverse."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {"event": self.name} | {n: v for n, v in values.items() if v is not None}


@dataclass(frozen=True, kw_only=True)
class LightOverride(Event):
    """Overrides the state of a traffic light; then the program that ran before continues.

    Of several events of one light the newest one that has not ended holds.

    Attributes:
      light: its name.
      state: one letter per link, or one for all, see `TrafficLights.set_state`.
    """

    name: ClassVar[str] = "light_state"

    light: str
    state: str

    def _check(self) -> None:
        self._text("light")
        self._text("state")
        if any(letter not in LIGHT_LETTERS for letter in self.state):
            raise InputError(f"{self.name}: state = {self.state!r}: letters of {LIGHT_LETTERS!r}")


@dataclass(frozen=True, kw_only=True)
class LightProgramRun(Event):
    """Runs another program of a traffic light; it ends as `LightOverride` does.

    Attributes:
      light: its name; program: of the light.
      phases: of a new program: duration [s] and state of each phase; empty: it exists already.
    """

    name: ClassVar[str] = "light_program"

    light: str
    program: str
    phases: tuple[tuple[float, str], ...] = ()

    def _check(self) -> None:
        self._text("light")
        self._text("program")
        try:
            phases = tuple((float(duration), str(state)) for duration, state in self.phases)
        except (TypeError, ValueError):
            raise InputError(
                f"{self.name}: phases = {self.phases!r}: must be pairs of duration and state"
            ) from None
        object.__setattr__(self, "phases", phases)


@dataclass(frozen=True, kw_only=True)
class SpeedLimit(Event):
    """A variable speed limit on a stretch of the route.

    Attributes:
      limit: [m/s]; start, end: stations [m]; lane: from the right, None: all lanes.
    """

    name: ClassVar[str] = "speed_limit"

    limit: float
    start: float = 0.0
    end: float = LONGEST
    lane: int | None = None

    def _check(self) -> None:
        self._number("limit", 1.0, 70.0)
        _check_stretch(self)
        if self.lane is not None:
            self._whole("lane", 0, 20)


@dataclass(frozen=True, kw_only=True)
class LaneClosure(Event):
    """A lane closed by standing safety trucks, which disappear at the end.

    Attributes:
      lane: from the right; start, end: stations [m].
      notice: distance before the closure at which drivers begin to leave the lane [m].
    """

    name: ClassVar[str] = "lane_closure"

    lane: int
    start: float
    end: float
    notice: float = 400.0

    def _check(self) -> None:
        self._whole("lane", 0, 20)
        _check_stretch(self)
        self._number("notice", 0.0, 5_000.0)


@dataclass(frozen=True, kw_only=True)
class StoppedVehicle(Event):
    """A stopped vehicle on a lane; at the end it drives on.

    It appears as soon as its place is free and vehicles behind can still stop.

    Attributes:
      station: of its front bumper [m]; lane: from the right; type: name of its type.
      hazard: with hazard lights, which others see at the distance `notice` [m]; without them, they
        treat it as any standing vehicle.
    """

    name: ClassVar[str] = "stopped_vehicle"

    station: float
    lane: int = 0
    type: str = "car"
    hazard: bool = True
    notice: float = 200.0

    def _check(self) -> None:
        self._number("station", 0.0, LONGEST)
        self._whole("lane", 0, 20)
        self._text("type")
        self._number("notice", 0.0, 5_000.0)
        if not isinstance(self.hazard, bool):
            raise InputError(f"{self.name}: hazard = {self.hazard!r}: allowed are true and false")


@dataclass(frozen=True, kw_only=True)
class SlowConvoy(Event):
    """Slow vehicles that keep their lane; at the end they drive like the others.

    Attributes:
      station: of the first one's front bumper at the beginning [m]; lane: from the right.
      count: number of vehicles; type: name of their type; speed: [m/s].
    """

    name: ClassVar[str] = "slow_convoy"

    station: float
    speed: float
    lane: int = 0
    count: int = 3
    type: str = "truck"

    def _check(self) -> None:
        self._number("station", 0.0, LONGEST)
        self._number("speed", 0.5, 70.0)
        self._whole("lane", 0, 20)
        self._whole("count", 1, 100)
        self._text("type")


@dataclass(frozen=True, kw_only=True)
class VehicleChange(Event):
    """Changes parameters of a vehicle or a type until the end.

    Of several events that change a parameter the newest one that has not ended holds. An event for
    a vehicle that is not on the road waits for it, but not beyond the event's end.

    Attributes:
      target: name of a type or a vehicle; parameters: name and value, see `Vehicles.change`.
    """

    name: ClassVar[str] = "vehicle_change"

    target: str
    parameters: tuple[tuple[str, Any], ...]

    def _check(self) -> None:
        self._text("target")
        given = self.parameters
        try:
            pairs = dict(given.items() if isinstance(given, Mapping) else given)
        except (TypeError, ValueError):
            raise InputError(
                f"{self.name}: parameters = {given!r}: must be names with values"
            ) from None
        check_changes(self.target, pairs)
        object.__setattr__(self, "parameters", plain(list(pairs.items())))


EVENTS: dict[str, type[Event]] = {
    kind.name: kind
    for kind in (
        *(LightOverride, LightProgramRun, SpeedLimit, LaneClosure),
        *(StoppedVehicle, SlowConvoy, VehicleChange),
    )
}


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
    for field in given:
        if field not in fields:
            raise InputError(
                f"{name}: {field!r} is unknown{did_you_mean(field, fields)}; the fields are "
                f"{', '.join(fields)}"
            )
    required = [f.name for f in fields.values() if f.default is dataclasses.MISSING]
    missing = [field for field in required if field not in given]
    if missing:
        raise InputError(f"{name}: {', '.join(missing)} is missing")
    return EVENTS[name](**given)


def _check_stretch(event: SpeedLimit | LaneClosure) -> None:
    for field in ("start", "end"):
        event._number(field, 0.0, LONGEST)
    if event.end <= event.start:
        raise InputError(
            f"{event.name}: start = {event.start:g} m must be before end = {event.end:g} m"
        )


def read_events(path: str | Path) -> tuple[Event, ...]:
    """The events of a TOML file, in its order; the fields are those of the events' classes.

        [[events]]
        event = "lane_closure"
        lane = 0
        start = 900.0
        end = 1100.0
        at_time = 20.0
        until = 120.0

    Raises:
      InputError: the file cannot be read or is not TOML, or an event is not usable; the message
        has the file, the event's number and what is allowed.
    """
    path = Path(path)
    content = read_toml(path, "file of events")
    unknown = [name for name in content if name != "events"]
    if unknown:
        raise InputError(f"{path}: {unknown[0]!r} is unknown; the file has tables [[events]]")
    entries = content.get("events", [])
    if not isinstance(entries, list) or any(not isinstance(entry, dict) for entry in entries):
        raise InputError(f"{path}: 'events' must be tables [[events]]")
    if len(entries) > EVENTS_MAX:
        raise InputError(f"{path}: {len(entries)} events are more than {EVENTS_MAX} allowed")
    events = []
    for number, entry in enumerate(entries, start=1):
        try:
            events.append(event_of(entry))
        except InputError as error:
            raise InputError(f"{path}: event {number}: {error}") from error
    return tuple(events)
