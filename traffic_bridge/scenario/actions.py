"""Events that move vehicles on a plan, or change the truck's world or its parts.

The events of a vehicle take an `actor`: a role such as "left_follower" (see `conditions.ROLES`),
the vehicle that has this role when the event begins; or the id of a vehicle, such as the name of
a `PlaceVehicle`. An event begins when its conditions hold and its actor is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from iits_mj.core.checks import one_of
from iits_mj.core.errors import InputError
from traffic_bridge.scenario.conditions import TRUCK
from traffic_bridge.signals.events import LONGEST, Event

SPEED_MAX = 70.0  # [m/s]
# Share of a change that is complete after a share of its time, by OpenSCENARIO's names of shapes.
SHAPES: dict[str, Callable[[float], float]] = {
    "sinusoidal": lambda x: 0.5 * (1.0 - math.cos(math.pi * x)),
    "cubic": lambda x: x * x * (3.0 - 2.0 * x),
    "linear": lambda x: x,
}
SIDES = ("left", "right")
WINDS = ("gust", "steady")


@dataclass(frozen=True, kw_only=True)
class TruckEvent(Event):
    """An event of the truck's world or parts, which the simulation of the truck carries out."""


@dataclass(frozen=True, kw_only=True)
class SceneEvent(Event):
    """An event of road users that move on a plan."""

    def _either(self, *names: str, needed: bool = True) -> None:
        """Checks that one of several fields is given, at most or exactly."""
        given = [name for name in names if getattr(self, name) is not None]
        if len(given) > 1 or (needed and not given):
            raise InputError(f"{self.kind}: give {' or '.join(names)}, not both or none")

    def _optional(self, field: str, low: float, high: float) -> None:
        if getattr(self, field) is not None:
            self._number(field, low, high)


@dataclass(frozen=True, kw_only=True)
class PlaceVehicle(SceneEvent):
    """A vehicle that appears as soon as its place is free, and disappears at the event's end.

    It keeps its lane and its speed. `name` is the vehicle's id.

    Attributes:
      gap: between the bumpers, positive ahead of the truck, negative behind it [m].
      station: of its front bumper, instead of `gap` [m].
      relative_lane: lanes to the left of the truck's; lane: from the right, instead of it.
      speed: [m/s]; speed_difference: to the truck's speed, instead of it [m/s].
      type: name of its type; reactive: it brakes for vehicles ahead.
      offset: to the left of its lane's center, which it keeps; None: it drives in the center [m].
      length, width, height: other than those of its type [m].
    """

    kind: ClassVar[str] = "place_vehicle"

    gap: float | None = None
    station: float | None = None
    relative_lane: int | None = None
    lane: int | None = None
    speed: float | None = None
    speed_difference: float | None = None
    type: str = "car"
    reactive: bool = True
    offset: float | None = None
    length: float | None = None
    width: float | None = None
    height: float | None = None

    def _check(self) -> None:
        self._text("name")
        self._either("gap", "station")
        self._either("relative_lane", "lane", needed=False)
        self._either("speed", "speed_difference", needed=False)
        self._optional("gap", -2_000.0, 2_000.0)
        self._optional("station", 0.0, LONGEST)
        self._optional("speed", 0.0, SPEED_MAX)
        self._optional("speed_difference", -SPEED_MAX, SPEED_MAX)
        for field, low in (("lane", 0), ("relative_lane", -5)):
            if getattr(self, field) is not None:
                self._whole(field, low, 20)
        self._text("type")
        _flag(self, "reactive")
        self._optional("offset", -100.0, 100.0)
        for field, high in (("length", 100.0), ("width", 10.0), ("height", 10.0)):
            self._optional(field, 0.1, high)


@dataclass(frozen=True, kw_only=True)
class Maneuver(SceneEvent):
    """An event of one vehicle, which ends by itself.

    Afterwards the vehicle keeps its lane and drives at its desired speed by the Intelligent Driver
    Model, and so brakes for the truck and for other vehicles.

    Attributes:
      actor: role or id.
    """

    ends: ClassVar[tuple[str, ...]] = ("duration",)

    actor: str

    def _check(self) -> None:
        self._text("actor")
        self._check_maneuver()

    def _check_maneuver(self) -> None:
        """Checks the subclass's own values."""


@dataclass(frozen=True, kw_only=True)
class LateralManeuver(Maneuver):
    """A maneuver to the side.

    Attributes:
      duration: of the motion to the side [s]; shape: of it, one of `SHAPES`.
    """

    duration: float | None = 3.0
    shape: str = "sinusoidal"

    def _check(self) -> None:
        self._number("duration", 0.1, 60.0)
        one_of(f"{self.kind}: shape", self.shape, SHAPES)
        super()._check()


@dataclass(frozen=True, kw_only=True)
class CutIn(LateralManeuver):
    """A change to the truck's lane ahead of it, by one lane or more.

    With `gap` the vehicle first drives to this gap beside the truck, relative to the truck's own
    motion; there it has the speed difference, with which it then changes lanes at constant speed.

    Attributes:
      gap: from the truck's front bumper to its rear when the change begins [m]; None: as it is.
      speed_difference: of the vehicle to the truck then [m/s]; None: 0 with a gap, else its speed
        stays. It becomes the desired speed.
    """

    kind: ClassVar[str] = "cut_in"

    gap: float | None = None
    speed_difference: float | None = None

    def _check_maneuver(self) -> None:
        self._optional("gap", 0.0, 500.0)
        self._optional("speed_difference", -SPEED_MAX, SPEED_MAX)


@dataclass(frozen=True, kw_only=True)
class ChangeLane(LateralManeuver):
    """A lane change, such as a merge from a ramp or a cut-out.

    Attributes:
      relative_lane: lanes to the left; lane: from the right, instead of it.
      to: "truck" or id of the vehicle to whose lane `relative_lane` refers; None: its own lane.
    """

    kind: ClassVar[str] = "change_lane"

    relative_lane: int | None = None
    lane: int | None = None
    to: str | None = None

    def _check_maneuver(self) -> None:
        self._either("relative_lane", "lane")
        for field, low in (("lane", 0), ("relative_lane", -5)):
            if getattr(self, field) is not None:
                self._whole(field, low, 20)
        if self.to is not None:
            self._text("to")


@dataclass(frozen=True, kw_only=True)
class Swerve(LateralManeuver):
    """A motion to the side and back.

    Attributes:
      offset: greatest distance from the lane's center, positive to the left [m].
      back: whether it moves back; false: it stays there.
    """

    kind: ClassVar[str] = "swerve"

    offset: float
    back: bool = True

    def _check_maneuver(self) -> None:
        self._number("offset", -10.0, 10.0)
        _flag(self, "back")


@dataclass(frozen=True, kw_only=True)
class Drift(Maneuver):
    """A slow motion out of the lane, as of a driver who falls asleep, and the jerk back.

    Attributes:
      lateral_speed: [m/s]; offset: at which the driver wakes, positive to the left [m].
      recovery: duration of the motion back [s]; 0: the vehicle stays there.
    """

    kind: ClassVar[str] = "drift"
    ends: ClassVar[tuple[str, ...]] = ()

    offset: float
    lateral_speed: float = 0.3
    recovery: float = 1.5

    def _check_maneuver(self) -> None:
        self._number("offset", -20.0, 20.0)
        self._number("lateral_speed", 0.01, 5.0)
        self._number("recovery", 0.0, 30.0)


@dataclass(frozen=True, kw_only=True)
class ChangeSpeed(Maneuver):
    """A change to a speed, which becomes the desired one; with `duration` only for that time.

    Attributes:
      speed: [m/s]; speed_difference: to the truck's speed at the beginning, instead of it [m/s];
        speed_factor: of the truck's speed, instead of it.
      to: id of the vehicle that replaces the truck in these; continuous: the speed follows that of
        the truck or of this vehicle until another maneuver changes it.
      acceleration: greatest magnitude [m/s2]; jerk: greatest magnitude [m/s3].
      shape: course of the speed over time, one of `SHAPES`, or "step" for a change within one step
        of the traffic, instead of a jerk; time: of the change [s]; None: the speed changes with the
        acceleration as its mean.
    """

    kind: ClassVar[str] = "change_speed"

    speed: float | None = None
    speed_difference: float | None = None
    speed_factor: float | None = None
    to: str = TRUCK
    continuous: bool = False
    acceleration: float = 1.5
    jerk: float = 5.0
    shape: str | None = None
    time: float | None = None

    def _check_maneuver(self) -> None:
        self._either("speed", "speed_difference", "speed_factor")
        self._optional("speed", 0.0, SPEED_MAX)
        self._optional("speed_difference", -SPEED_MAX, SPEED_MAX)
        self._optional("speed_factor", 0.0, 10.0)
        self._text("to")
        _flag(self, "continuous")
        if self.continuous and self.speed is not None:
            raise InputError(f"{self.kind}: continuous has no meaning with speed")
        if self.shape is not None:
            one_of(f"{self.kind}: shape", self.shape, (*SHAPES, "step"))
        self._optional("time", 0.01, 1e4)
        if self.time is not None and self.shape in (None, "step"):
            raise InputError(f"{self.kind}: time needs a shape: use one of {', '.join(SHAPES)}")
        if self.continuous and self.shape in SHAPES:
            raise InputError(f"{self.kind}: continuous is only for the shape step or a jerk")
        self._number("acceleration", 0.05, 15.0)
        self._number("jerk", 0.1, 1_000.0)


@dataclass(frozen=True, kw_only=True)
class Brake(Maneuver):
    """Braking to a speed, which the vehicle keeps; with `duration` it then drives on.

    Attributes:
      deceleration: [m/s2]; jerk: with which it rises and falls [m/s3]; to_speed: [m/s].
    """

    kind: ClassVar[str] = "brake"

    deceleration: float = 6.0
    jerk: float = 30.0
    to_speed: float = 0.0

    def _check_maneuver(self) -> None:
        self._number("deceleration", 0.05, 15.0)
        self._number("jerk", 0.1, 1_000.0)
        self._number("to_speed", 0.0, SPEED_MAX)


@dataclass(frozen=True, kw_only=True)
class LoseCargo(Maneuver):
    """A box of 1.2 m x 0.8 m x 0.8 m falls off the rear of a vehicle and slides to a stop.

    `name` is the id of the box, which disappears after `duration`.

    Attributes:
      deceleration: of the sliding box [m/s2].
    """

    kind: ClassVar[str] = "lose_cargo"

    deceleration: float = 5.0

    def _check_maneuver(self) -> None:
        self._text("name")
        self._number("deceleration", 0.5, 15.0)


@dataclass(frozen=True, kw_only=True)
class CrossRoad(SceneEvent):
    """A pedestrian or a cyclist who crosses the road from its edge, at constant speed.

    `name` is the id.

    Attributes:
      gap: from the truck's front bumper to the path [m]; station: of the path, instead of it [m].
      side: edge of the road at which it begins; speed: [m/s].
      distance: length of the path, where it ends and the road user stays [m]; None: to the other
        edge, where the road user disappears.
      type: "pedestrian", "bicycle" or the name of a vehicle type.
    """

    kind: ClassVar[str] = "cross_road"
    ends: ClassVar[tuple[str, ...]] = ()

    gap: float | None = None
    station: float | None = None
    side: str = "right"
    speed: float = 1.4
    distance: float | None = None
    type: str = "pedestrian"

    def _check(self) -> None:
        self._text("name")
        self._either("gap", "station")
        self._optional("gap", 0.0, 2_000.0)
        self._optional("station", 0.0, LONGEST)
        one_of(f"{self.kind}: side", self.side, SIDES)
        self._number("speed", 0.1, 20.0)
        self._optional("distance", 0.1, 100.0)
        self._text("type")


@dataclass(frozen=True, kw_only=True)
class Milestone(SceneEvent):
    """Nothing happens; conditions of other events refer to it by its name."""

    kind: ClassVar[str] = "milestone"
    ends: ClassVar[tuple[str, ...]] = ()

    def _check(self) -> None:
        self._text("name")


@dataclass(frozen=True, kw_only=True)
class EndDrive(TruckEvent):
    """The drive ends."""

    kind: ClassVar[str] = "end_drive"
    ends: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True, kw_only=True)
class FrictionChange(TruckEvent):
    """Another friction of the road's surface on a stretch of the route.

    Attributes:
      friction: coefficient, at the left of `split` if `friction_right` differs.
      friction_right: coefficient at the right of `split`; None: as `friction`.
      split: offset from the reference line [m]; start, end: stations [m].
    """

    kind: ClassVar[str] = "friction"

    friction: float
    friction_right: float | None = None
    split: float = 0.0
    start: float = 0.0
    end: float = LONGEST

    def _check(self) -> None:
        self._number("friction", 0.0, 2.0)
        if self.friction_right is not None:
            self._number("friction_right", 0.0, 2.0)
        self._number("split", -50.0, 50.0)
        self._number("start", 0.0, LONGEST)
        self._number("end", 0.0, LONGEST)
        if self.end <= self.start:
            raise InputError(
                f"{self.kind}: start = {self.start:g} m must be before end = {self.end:g} m"
            )


@dataclass(frozen=True, kw_only=True)
class Wind(TruckEvent):
    """Wind on the truck.

    Attributes:
      speed: greatest [m/s]; direction: where it comes from, counterclockwise from the truck's
        heading at the beginning [deg]: 0 ahead, 90 left.
      shape: "gust": the speed rises and falls as 1 - cos within `duration`, 3 s without one;
        "steady": constant.
    """

    kind: ClassVar[str] = "wind"

    speed: float
    direction: float = 90.0
    shape: str = "gust"

    def _check(self) -> None:
        self._number("speed", 0.0, 60.0)
        self._number("direction", -360.0, 360.0)
        one_of(f"{self.kind}: shape", self.shape, WINDS)
        if self.shape == "gust" and self.until is not None:
            raise InputError(f"{self.kind}: a gust has a duration, not until")
        if self.shape == "gust" and self.duration is None:
            object.__setattr__(self, "duration", 3.0)


@dataclass(frozen=True, kw_only=True)
class Fault(TruckEvent):
    """A part of the truck fails and stays so; see `iits_mj.truck.faults.Faults`."""

    ends: ClassVar[tuple[str, ...]] = ()


@dataclass(frozen=True, kw_only=True)
class Puncture(Fault):
    """A tire loses pressure; `wheel` and `lost` are those of `Faults.puncture`."""

    kind: ClassVar[str] = "puncture"

    wheel: str
    lost: float = 1.0


@dataclass(frozen=True, kw_only=True)
class BrakeLeak(Fault):
    """A brake circuit loses air; `circuit` and `rate` [1/s] are those of `Faults.leak`."""

    kind: ClassVar[str] = "brake_leak"

    circuit: str
    rate: float = 2.0


@dataclass(frozen=True, kw_only=True)
class StuckSpeedSensor(Fault):
    """A wheel-speed sensor shows the same `speed` [rad/s]; see `Faults.stick_speed_sensor`."""

    kind: ClassVar[str] = "stuck_speed_sensor"

    wheel: str
    speed: float = 0.0


SCENARIO_EVENTS: tuple[type[Event], ...] = (
    *(PlaceVehicle, CutIn, ChangeLane, ChangeSpeed, Brake, Swerve, Drift, LoseCargo, CrossRoad),
    *(Milestone, EndDrive, FrictionChange, Wind, Puncture, BrakeLeak, StuckSpeedSensor),
)


def _flag(event: Event, field: str) -> None:
    value = getattr(event, field)
    if not isinstance(value, bool):
        raise InputError(f"{event.kind}: {field} = {value!r}: allowed are true and false")
