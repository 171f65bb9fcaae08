"""Scripted events of the traffic: settings that are stored in recordings and files.

An event begins once: at a traffic time, when the truck reaches a station of its route, when its
conditions hold, or, with none of them, at the beginning. It ends at a traffic time (`until`) or
some time after its beginning (`duration`), or never. `traffic_bridge.signals.controller` carries
out the events of this module, `traffic_bridge.scenario` those of vehicles that move on a plan.
`traffic_bridge.scenario.reading` reads them from files.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from iits_mj.core.checks import in_range, is_whole, make_plain, one_of, plain
from iits_mj.core.errors import InputError
from traffic_bridge.scenario.conditions import Groups, groups_of
from traffic_bridge.vehicles.types import check_changes

LONGEST = 1e6  # [m], [s]
LIGHT_LETTERS = "rRyYgGuoOs"
REQUIRED = dataclasses.MISSING  # default of a field that has none
_CHECK = "check"


def number(default: Any, low: float, high: float) -> Any:
    """A field of an event that is a number within bounds, or None if that is its default."""
    return _checked(default, lambda event, name: event._number(name, low, high))


def whole(default: Any, low: int, high: int) -> Any:
    """A field that is a whole number within bounds, or None if that is its default."""
    return _checked(default, lambda event, name: event._whole(name, low, high))


def text(default: Any) -> Any:
    """A field that is a name, or None if that is its default."""
    return _checked(default, lambda event, name: event._text(name))


def choice(default: Any, allowed: Iterable[str]) -> Any:
    """A field that is one of the allowed texts."""
    return _checked(
        default, lambda event, name: one_of(f"{event.kind}: {name}", getattr(event, name), allowed)
    )


def _checked(default: Any, check: Callable[[Any, str], object]) -> Any:
    return dataclasses.field(default=default, metadata={_CHECK: check})


@dataclass(frozen=True, kw_only=True)
class Event:
    """Begin and end of an event; subclasses define what happens.

    Attributes:
      kind: of the event, the same for all of a class; ends: fields that may give its end.
      name: of this event, for conditions of others and for reports; None: its kind.
      at_time: traffic time at which it begins [s].
      at_station: station of the truck's steer axle at which it begins [m].
      when: conditions on which it begins; see `traffic_bridge.scenario.conditions.groups_of`.
      until: traffic time at which it ends [s].
      duration: time after which it ends [s].

    Raises:
      InputError: a value is out of its range, or two of them contradict each other.
    """

    kind: ClassVar[str] = ""
    ends: ClassVar[tuple[str, ...]] = ("until", "duration")

    name: str | None = None
    at_time: float | None = None
    at_station: float | None = None
    when: Groups | None = None
    until: float | None = None
    duration: float | None = None

    def __post_init__(self) -> None:
        """Checks the times, then the subclass's values."""
        for field in ("at_time", "at_station", "until", "duration"):
            if getattr(self, field) is not None:
                self._number(field, 0.0, LONGEST)
        begins = [n for n in ("at_time", "at_station", "when") if getattr(self, n) is not None]
        if len(begins) > 1:
            raise InputError(f"{self.kind}: give {begins[0]} or {begins[1]}, not both")
        if self.name is not None:
            self._text("name")
        if self.when is not None:
            object.__setattr__(self, "when", self._groups())
        for field in ("until", "duration"):
            if getattr(self, field) is not None and field not in self.ends:
                raise InputError(f"{self.kind}: has no {field}")
        if self.until is not None and self.duration is not None:
            raise InputError(f"{self.kind}: give until or duration, not both")
        begin = self.at_time if self.at_time is not None else 0.0
        if self.until is not None and self.until <= begin:
            raise InputError(
                f"{self.kind}: until = {self.until:g} s must be after its beginning at {begin:g} s"
            )
        if self.duration == 0.0:
            raise InputError(f"{self.kind}: duration = 0 s: must be positive")
        for given in dataclasses.fields(self):
            value, check = getattr(self, given.name), given.metadata.get(_CHECK)
            if isinstance(given.default, bool) and not isinstance(value, bool):
                raise InputError(
                    f"{self.kind}: {given.name} = {value!r}: allowed are true and false"
                )
            if check is not None and not (value is None and given.default is None):
                check(self, given.name)
        self._check()
        make_plain(self)

    def _check(self) -> None:
        """Checks the subclass's own values."""

    def _groups(self) -> Groups:
        try:
            return groups_of(self.when)
        except InputError as error:
            raise InputError(f"{self.kind}: {error}") from None

    @property
    def title(self) -> str:
        """Its name, else its kind."""
        return self.name or self.kind

    def _number(self, field: str, low: float, high: float) -> None:
        in_range(f"{self.kind}: {field}", getattr(self, field), low, high)

    def _whole(self, field: str, low: int, high: int) -> None:
        value = getattr(self, field)
        if not is_whole(value) or not low <= value <= high:
            raise InputError(
                f"{self.kind}: {field} = {value!r}: allowed is a whole number from {low} to {high}"
            )

    def _text(self, field: str) -> None:
        value = getattr(self, field)
        if not isinstance(value, str) or not value:
            raise InputError(f"{self.kind}: {field} = {value!r}: must be a name")

    def as_dict(self) -> dict[str, Any]:
        """Values for a file, without those that are None; `reading.event_of` is the inverse."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        if self.when is not None:
            values["when"] = [[c.as_dict() for c in group] for group in self.when]
        return {"event": self.kind} | {n: v for n, v in values.items() if v is not None}


@dataclass(frozen=True, kw_only=True)
class LightOverride(Event):
    """Overrides the state of a traffic light; then the program that ran before continues.

    Of several events of one light the newest one that has not ended holds.

    Attributes:
      light: its name.
      state: one letter per link, or one for all, see `TrafficLights.set_state`.
    """

    kind: ClassVar[str] = "light_state"

    light: str = text(REQUIRED)
    state: str = text(REQUIRED)

    def _check(self) -> None:
        if any(letter not in LIGHT_LETTERS for letter in self.state):
            raise InputError(f"{self.kind}: state = {self.state!r}: letters of {LIGHT_LETTERS!r}")


@dataclass(frozen=True, kw_only=True)
class LightProgramRun(Event):
    """Runs another program of a traffic light; it ends as `LightOverride` does.

    Attributes:
      light: its name; program: of the light.
      phases: of a new program: duration [s] and state of each phase; empty: it exists already.
    """

    kind: ClassVar[str] = "light_program"

    light: str = text(REQUIRED)
    program: str = text(REQUIRED)
    phases: tuple[tuple[float, str], ...] = ()

    def _check(self) -> None:
        try:
            phases = tuple((float(duration), str(state)) for duration, state in self.phases)
        except (TypeError, ValueError):
            raise InputError(
                f"{self.kind}: phases = {self.phases!r}: must be pairs of duration and state"
            ) from None
        object.__setattr__(self, "phases", phases)


@dataclass(frozen=True, kw_only=True)
class SpeedLimit(Event):
    """A variable speed limit on a stretch of the route.

    Attributes:
      limit: [m/s]; start, end: stations [m]; lane: from the outside, None: all lanes.
    """

    kind: ClassVar[str] = "speed_limit"

    limit: float = number(REQUIRED, 1.0, 70.0)
    start: float = 0.0
    end: float = LONGEST
    lane: int | None = whole(None, 0, 20)

    def _check(self) -> None:
        _check_stretch(self)


@dataclass(frozen=True, kw_only=True)
class LaneClosure(Event):
    """A lane closed by standing safety trucks, which disappear at the end.

    Attributes:
      lane: from the outside; start, end: stations [m].
      notice: distance before the closure at which drivers begin to leave the lane [m].
    """

    kind: ClassVar[str] = "lane_closure"

    lane: int = whole(REQUIRED, 0, 20)
    start: float
    end: float
    notice: float = number(400.0, 0.0, 5_000.0)

    def _check(self) -> None:
        _check_stretch(self)


@dataclass(frozen=True, kw_only=True)
class StoppedVehicle(Event):
    """A stopped vehicle on a lane; at the end it drives on.

    It appears as soon as its place is free and vehicles behind can still stop.

    Attributes:
      station: of its front bumper [m]; lane: from the outside; type: name of its type.
      hazard: with hazard lights, which others see at the distance `notice` [m]; without them, they
        treat it as any standing vehicle.
    """

    kind: ClassVar[str] = "stopped_vehicle"

    station: float = number(REQUIRED, 0.0, LONGEST)
    lane: int = whole(0, 0, 20)
    type: str = text("car")
    hazard: bool = True
    notice: float = number(200.0, 0.0, 5_000.0)


@dataclass(frozen=True, kw_only=True)
class SlowConvoy(Event):
    """Slow vehicles that keep their lane; at the end they drive like the others.

    Attributes:
      station: of the first one's front bumper at the beginning [m]; lane: from the outside.
      count: number of vehicles; type: name of their type; speed: [m/s].
    """

    kind: ClassVar[str] = "slow_convoy"

    station: float = number(REQUIRED, 0.0, LONGEST)
    speed: float = number(REQUIRED, 0.5, 70.0)
    lane: int = whole(0, 0, 20)
    count: int = whole(3, 1, 100)
    type: str = text("truck")


@dataclass(frozen=True, kw_only=True)
class VehicleChange(Event):
    """Changes parameters of a vehicle or a type until the end.

    Of several events that change a parameter the newest one that has not ended holds. An event for
    a vehicle that is not on the road waits for it, but not beyond the event's end.

    Attributes:
      target: name of a type or a vehicle; parameters: name and value, see `Vehicles.change`.
    """

    kind: ClassVar[str] = "vehicle_change"

    target: str = text(REQUIRED)
    parameters: tuple[tuple[str, Any], ...]

    def _check(self) -> None:
        given = self.parameters
        try:
            pairs = dict(given.items() if isinstance(given, Mapping) else given)
        except (TypeError, ValueError):
            raise InputError(
                f"{self.kind}: parameters = {given!r}: must be names with values"
            ) from None
        check_changes(self.target, pairs)
        object.__setattr__(self, "parameters", plain(list(pairs.items())))


def _check_stretch(event: SpeedLimit | LaneClosure) -> None:
    for field in ("start", "end"):
        event._number(field, 0.0, LONGEST)
    if event.end <= event.start:
        raise InputError(
            f"{event.kind}: start = {event.start:g} m must be before end = {event.end:g} m"
        )
