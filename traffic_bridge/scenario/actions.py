"""Events that move vehicles on a plan, or change the truck's world or its parts.

The events of a vehicle take an `actor`: a role such as "left_follower" (see `conditions.ROLES`),
the vehicle that has this role when the event begins; or the id of a vehicle, such as the name of
a `PlaceVehicle`. An event begins when its conditions hold and its actor is there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from iits_mj.core.checks import in_range, is_number, one_of
from iits_mj.core.errors import InputError
from iits_mj.road.route_choice import read_words
from traffic_bridge.scenario.conditions import TRUCK, point_of
from traffic_bridge.signals.events import LONGEST, REQUIRED, Event, choice, number, text, whole

SPEED_MAX = 70.0  # [m/s]
# Share of a change that is complete after a share of its time, by OpenSCENARIO's names of shapes.
SHAPES: dict[str, Callable[[float], float]] = {
    "sinusoidal": lambda x: 0.5 * (1.0 - math.cos(math.pi * x)),
    "cubic": lambda x: x * x * (3.0 - 2.0 * x),
    "linear": lambda x: x,
}
# Greatest rate of change of the shapes, over the time of the change.
STEEPEST = {"sinusoidal": 0.5 * math.pi, "cubic": 1.5, "linear": 1.0}
# Greatest second derivative; a linear change takes as long as a sinusoidal one.
BENDS = {"sinusoidal": 0.5 * math.pi**2, "cubic": 6.0, "linear": 0.5 * math.pi**2}
SIDES = ("left", "right")
WINDS = ("gust", "steady")
FRAMES = ("map", "route")  # of points: x, y and maybe z of the map; station and offset
POINTS_MAX = 10_000
SWARM_MAX = 500  # vehicles

Points = Sequence[Sequence[float]]


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


@dataclass(frozen=True, kw_only=True)
class PlaceVehicle(SceneEvent):
    """A vehicle that appears as soon as its place is free, and disappears at the event's end.

    It keeps its lane and its speed. `name` is the vehicle's id. With `along` it drives on a road of
    its own, such as an oncoming one; with `points` it moves on a path from the first point.

    Attributes:
      gap: between the bumpers, positive ahead of the truck, negative behind it [m].
      station: of its front bumper, instead of `gap` [m].
      relative_lane: lanes to the left of the truck's; lane: from the outside, instead of it.
      speed: [m/s]; speed_difference: to the truck's speed, instead of it [m/s].
      type: name of its type; reactive: it brakes for vehicles ahead.
      offset: to the left of its lane's center, which it keeps; None: it drives in the center [m].
      length, width, height: other than those of its type [m].
      along: its road in the words of `iits_mj.road.route_choice`, where `station` and `lane` are;
        None: the truck's.
      points, frame, stays: see `FollowPath`.
    """

    kind: ClassVar[str] = "place_vehicle"

    gap: float | None = number(None, -2_000.0, 2_000.0)
    station: float | None = number(None, 0.0, LONGEST)
    relative_lane: int | None = whole(None, -5, 20)
    lane: int | None = whole(None, 0, 20)
    speed: float | None = number(None, 0.0, SPEED_MAX)
    speed_difference: float | None = number(None, -SPEED_MAX, SPEED_MAX)
    type: str = text("car")
    reactive: bool = True
    offset: float | None = number(None, -100.0, 100.0)
    length: float | None = number(None, 0.1, 100.0)
    width: float | None = number(None, 0.1, 10.0)
    height: float | None = number(None, 0.1, 10.0)
    along: str | None = None
    points: Points | None = None
    frame: str = choice("map", FRAMES)
    stays: bool = False

    def _check(self) -> None:
        self._text("name")
        self._either("gap", "station", "points")
        _check_way(self)
        if self.along is not None and (self.station is None or self.lane is None):
            raise InputError(f"{self.kind}: along needs station and lane")
        if self.points is not None and (self.lane, self.relative_lane) != (None, None):
            raise InputError(f"{self.kind}: lane has no meaning with points")
        self._either("relative_lane", "lane", needed=False)
        self._either("speed", "speed_difference", needed=False)


@dataclass(frozen=True, kw_only=True)
class Maneuver(SceneEvent):
    """An event of one vehicle, which ends by itself.

    Afterwards the vehicle keeps its lane and drives at its desired speed by the Intelligent Driver
    Model, and so brakes for the truck and for other vehicles.

    Attributes:
      actor: role or id.
    """

    ends: ClassVar[tuple[str, ...]] = ("duration",)

    actor: str = text(REQUIRED)


@dataclass(frozen=True, kw_only=True)
class LateralManeuver(Maneuver):
    """A maneuver to the side.

    Attributes:
      duration: of the motion to the side [s]; shape: of it, one of `SHAPES`.
      lateral_speed: greatest speed of the motion, which gives the duration [m/s].
      lateral_acceleration: greatest one, which gives it [m/s2].
      distance: driven meanwhile at the speed of the beginning, which gives the duration [m].
    """

    duration: float | None = number(None, 0.1, 60.0)
    shape: str = choice("sinusoidal", SHAPES)
    lateral_speed: float | None = number(None, 0.01, 20.0)
    lateral_acceleration: float | None = number(None, 0.01, 20.0)
    distance: float | None = number(None, 0.1, 2_000.0)

    def _check(self) -> None:
        given = ("duration", "lateral_speed", "lateral_acceleration", "distance")
        self._either(*given, needed=False)
        if all(getattr(self, name) is None for name in given):
            object.__setattr__(self, "duration", 3.0)


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

    gap: float | None = number(None, 0.0, 500.0)
    speed_difference: float | None = number(None, -SPEED_MAX, SPEED_MAX)


@dataclass(frozen=True, kw_only=True)
class ChangeLane(LateralManeuver):
    """A lane change, such as a merge from a ramp or a cut-out.

    Attributes:
      relative_lane: lanes to the left; lane: from the outside of its road, instead of it.
      to: "truck" or id of the vehicle to whose lane `relative_lane` refers; None: its own lane.
    """

    kind: ClassVar[str] = "change_lane"

    relative_lane: int | None = whole(None, -5, 20)
    lane: int | None = whole(None, 0, 20)
    to: str | None = text(None)

    def _check(self) -> None:
        super()._check()
        self._either("relative_lane", "lane")


@dataclass(frozen=True, kw_only=True)
class Swerve(LateralManeuver):
    """A motion to the side and back.

    Attributes:
      offset: greatest distance from the lane's center, positive to the left [m].
      back: whether it moves back; false: it stays there.
    """

    kind: ClassVar[str] = "swerve"

    offset: float = number(REQUIRED, -10.0, 10.0)
    back: bool = True


@dataclass(frozen=True, kw_only=True)
class Drift(Maneuver):
    """A slow motion out of the lane, as of a driver who falls asleep, and the jerk back.

    Attributes:
      lateral_speed: [m/s]; offset: at which the driver wakes, positive to the left [m].
      recovery: duration of the motion back [s]; 0: the vehicle stays there.
    """

    kind: ClassVar[str] = "drift"
    ends: ClassVar[tuple[str, ...]] = ()

    offset: float = number(REQUIRED, -20.0, 20.0)
    lateral_speed: float = number(0.3, 0.01, 5.0)
    recovery: float = number(1.5, 0.0, 30.0)


@dataclass(frozen=True, kw_only=True)
class ChangeSpeed(Maneuver):
    """A change to a speed, which becomes the desired one; with `duration` only for that time.

    Attributes:
      speed: [m/s]; speed_difference: to the truck's speed at the beginning, instead of it [m/s];
        speed_factor: of the truck's speed, instead of it.
      to: id of the vehicle that replaces the truck in these; continuous: the speed follows that of
        the truck or of this vehicle until another maneuver changes it.
      acceleration: greatest magnitude [m/s2]; deceleration: of a lower speed, None: the same
        [m/s2]; jerk: greatest magnitude [m/s3].
      shape: course of the speed over time, one of `SHAPES`, or "step" for a change within one step
        of the traffic, instead of a jerk; time: of the change [s]; distance: driven meanwhile,
        instead of it [m]; neither: the speed changes with the acceleration as its mean.
    """

    kind: ClassVar[str] = "change_speed"

    speed: float | None = number(None, 0.0, SPEED_MAX)
    speed_difference: float | None = number(None, -SPEED_MAX, SPEED_MAX)
    speed_factor: float | None = number(None, 0.0, 10.0)
    to: str = text(TRUCK)
    continuous: bool = False
    acceleration: float = number(1.5, 0.05, 15.0)
    deceleration: float | None = number(None, 0.05, 15.0)
    jerk: float = number(5.0, 0.1, 1_000.0)
    shape: str | None = None
    time: float | None = number(None, 0.01, 1e4)
    distance: float | None = number(None, 0.1, 1e5)

    def _check(self) -> None:
        self._either("speed", "speed_difference", "speed_factor")
        if self.continuous and self.speed is not None:
            raise InputError(f"{self.kind}: continuous has no meaning with speed")
        if self.shape is not None:
            one_of(f"{self.kind}: shape", self.shape, (*SHAPES, "step"))
        self._either("time", "distance", needed=False)
        if (self.time or self.distance) is not None and self.shape in (None, "step"):
            names = "time" if self.distance is None else "distance"
            raise InputError(f"{self.kind}: {names} needs a shape: use one of {', '.join(SHAPES)}")
        if self.continuous and self.shape in SHAPES:
            raise InputError(f"{self.kind}: continuous is only for the shape step or a jerk")


@dataclass(frozen=True, kw_only=True)
class FollowSpeeds(Maneuver):
    """Speeds at times, linear between them; the last one becomes the desired speed.

    Attributes:
      speeds: rows of the time since the beginning [s], rising and positive, and the speed [m/s].
      relative: the speeds are differences to that of `to` at the beginning; to: id of a vehicle.
    """

    kind: ClassVar[str] = "follow_speeds"

    speeds: Points = ()
    relative: bool = False
    to: str = text(TRUCK)

    def _check(self) -> None:
        what = f"{self.kind}: speeds"
        given = self.speeds
        if not isinstance(given, (list, tuple)) or not 0 < len(given) <= POINTS_MAX:
            raise InputError(f"{what}: must be 1 to {POINTS_MAX} rows of a time and a speed")
        rows = tuple(point_of(what, row, 2) for row in given)
        before, low = 0.0, -SPEED_MAX if self.relative else 0.0
        for time, speed in rows:
            if not before < time <= LONGEST:
                raise InputError(f"{what}: time {time:g} s after {before:g} s: must rise from 0")
            in_range(f"{what}: speed", speed, low, SPEED_MAX, "m/s")
            before = time
        object.__setattr__(self, "speeds", rows)


@dataclass(frozen=True, kw_only=True)
class KeepDistance(Maneuver):
    """A distance behind another vehicle, or ahead of the truck, by a bounded acceleration.

    The acceleration is proportional to the errors of the distance and of the speed, as of an
    adaptive cruise control with a constant time gap: R. Rajamani, "Vehicle Dynamics and Control",
    2nd ed., 2012, section 6.4. A place ahead of the truck is reached as that of a `CutIn`.

    Attributes:
      ahead: of the truck, at a `gap` that is not continuous, by a bounded `acceleration`.
      speed_difference: to the truck's speed when the place ahead is reached [m/s].
      to: "truck" or id of the vehicle ahead; freespace: the gap is between the bumpers; false:
        between the front bumpers.
      gap: [m]; time_gap: [s], instead of it.
      continuous: until another maneuver changes the speed; false: until the distance is reached.
      acceleration, deceleration: greatest magnitudes [m/s2]; fastest: [m/s].
    """

    kind: ClassVar[str] = "keep_distance"
    ends: ClassVar[tuple[str, ...]] = ()

    to: str = text(TRUCK)
    gap: float | None = number(None, 0.0, 2_000.0)
    time_gap: float | None = number(None, 0.0, 100.0)
    freespace: bool = True
    continuous: bool = True
    acceleration: float = number(2.0, 0.05, 100.0)
    deceleration: float = number(5.0, 0.05, 100.0)
    fastest: float = number(SPEED_MAX, 0.0, SPEED_MAX)
    ahead: bool = False
    speed_difference: float = number(0.0, -SPEED_MAX, SPEED_MAX)

    def _check(self) -> None:
        self._either("gap", "time_gap")
        plain = self.to == TRUCK and self.gap is not None and self.freespace
        if self.ahead and (self.continuous or not plain):
            raise InputError(f"{self.kind}: ahead needs a gap to the truck that is not continuous")
        if self.speed_difference and not self.ahead:
            raise InputError(f"{self.kind}: speed_difference needs ahead")


@dataclass(frozen=True, kw_only=True)
class ActivateDriver(Maneuver):
    """The car-following model drives the vehicle from now on, or does not: it keeps its speed.

    It has the desired speed that it last had. A vehicle that is not `reactive` has no such model.

    Attributes:
      active: whether it drives.
    """

    kind: ClassVar[str] = "activate_driver"
    ends: ClassVar[tuple[str, ...]] = ()

    active: bool = True


@dataclass(frozen=True, kw_only=True)
class Synchronize(Maneuver):
    """An arrival at a station when another vehicle arrives at another one.

    The acceleration is that of a cubic of time over the remaining way, planned again in every step
    for the other's speed; it is bounded by what a dry road allows.

    Attributes:
      station: of its front bumper at the end, on its own road [m].
      to: "truck" or id of the other vehicle; to_station: of that one's front bumper [m].
      speed: at the end [m/s]; speed_difference: to the other's speed, instead of it [m/s]; neither:
        it changes its speed at a constant rate.
      tolerance: the event ends where it is so near to its station [m]; to_tolerance: or the other.
    """

    kind: ClassVar[str] = "synchronize"
    ends: ClassVar[tuple[str, ...]] = ()

    station: float = number(REQUIRED, 0.0, LONGEST)
    to_station: float = number(REQUIRED, 0.0, LONGEST)
    to: str = text(TRUCK)
    speed: float | None = number(None, 0.0, SPEED_MAX)
    speed_difference: float | None = number(None, -SPEED_MAX, SPEED_MAX)
    tolerance: float = number(0.5, 0.0, 100.0)
    to_tolerance: float = number(0.5, 0.0, 100.0)

    def _check(self) -> None:
        self._either("speed", "speed_difference", needed=False)


@dataclass(frozen=True, kw_only=True)
class FollowPath(Maneuver):
    """A motion on a path through points, or on another road, at a speed that other events change.

    The road user is first where the path is nearest to it; its distance from the path vanishes
    within 2 s. At the path's end it drives on if it is in a lane of the truck's route, and
    otherwise disappears.

    Attributes:
      points: x and y, or x, y and z [m], or station and offset on the truck's route [m];
        along: a road in the words of `iits_mj.road.route_choice`, instead of them.
      frame: of the points, one of `FRAMES`.
      times: of the first points since the beginning, at which it is there [s]; None: it moves at
        its speed.
      goal: number of the point at which the event ends, from 0; None: the last one, or the last one
        with a time.
      stays: it stands at the end of the path.
    """

    kind: ClassVar[str] = "follow_path"
    ends: ClassVar[tuple[str, ...]] = ()

    points: Points | None = None
    along: str | None = None
    frame: str = choice("map", FRAMES)
    times: Sequence[float] | None = None
    goal: int | None = None
    stays: bool = False

    def _check(self) -> None:
        self._either("points", "along")
        _check_way(self)
        count = len(self.points or ())
        if self.goal is not None:
            self._whole("goal", 1, max(count - 1, 1))
        if self.times is None:
            return
        times = self.times
        if not isinstance(times, (list, tuple)) or not 2 <= len(times) <= count:
            raise InputError(f"{self.kind}: times: give 2 or more, not more than there are points")
        if not all(is_number(time) and 0.0 <= time <= LONGEST for time in times) or any(
            before >= after for before, after in itertools.pairwise(times)
        ):
            raise InputError(f"{self.kind}: times must be rising numbers from 0 s")
        object.__setattr__(self, "times", tuple(map(float, times)))


@dataclass(frozen=True, kw_only=True)
class Teleport(Maneuver):
    """A road user is at another place at once, and drives on there as before.

    Attributes:
      station: of its front bumper [m]; lane: from the outside.
      offset: to the left of its center [m].
      along: its road in the words of `iits_mj.road.route_choice`; None: the truck's.
    """

    kind: ClassVar[str] = "teleport"
    ends: ClassVar[tuple[str, ...]] = ()

    station: float = number(REQUIRED, 0.0, LONGEST)
    lane: int = whole(REQUIRED, 0, 20)
    offset: float = number(0.0, -100.0, 100.0)
    along: str | None = None

    def _check(self) -> None:
        _check_along(self)


@dataclass(frozen=True, kw_only=True)
class Brake(Maneuver):
    """Braking to a speed, which the vehicle keeps; with `duration` it then drives on.

    Attributes:
      deceleration: [m/s2]; jerk: with which it rises and falls [m/s3]; to_speed: [m/s].
    """

    kind: ClassVar[str] = "brake"

    deceleration: float = number(6.0, 0.05, 15.0)
    jerk: float = number(30.0, 0.1, 1_000.0)
    to_speed: float = number(0.0, 0.0, SPEED_MAX)


@dataclass(frozen=True, kw_only=True)
class LoseCargo(Maneuver):
    """A box of 1.2 m x 0.8 m x 0.8 m falls off the rear of a vehicle and slides to a stop.

    `name` is the id of the box, which disappears after `duration`.

    Attributes:
      deceleration: of the sliding box [m/s2].
    """

    kind: ClassVar[str] = "lose_cargo"

    deceleration: float = number(5.0, 0.5, 15.0)

    def _check(self) -> None:
        self._text("name")


@dataclass(frozen=True, kw_only=True)
class RemoveVehicle(Maneuver):
    """A road user disappears; the event that placed it ends."""

    kind: ClassVar[str] = "remove_vehicle"
    ends: ClassVar[tuple[str, ...]] = ()


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

    gap: float | None = number(None, 0.0, 2_000.0)
    station: float | None = number(None, 0.0, LONGEST)
    side: str = choice("right", SIDES)
    speed: float = number(1.4, 0.1, 20.0)
    distance: float | None = number(None, 0.1, 100.0)
    type: str = text("pedestrian")

    def _check(self) -> None:
        self._text("name")
        self._either("gap", "station")


@dataclass(frozen=True, kw_only=True)
class Swarm(SceneEvent):
    """Vehicles on all driving lanes in an ellipse around a body, outside of a circle.

    They drive by the Intelligent Driver Model, each straight on along its own road. A vehicle that
    leaves the ellipse disappears, and another one appears in the ring between circle and ellipse.
    The traffic's seed decides where. `name` begins the ids, such as "swarm.7".

    Attributes:
      count: of vehicles; fewer where there is no room for more.
      inner: radius of the circle [m].
      half_length, half_width: of the ellipse, in the direction of the body and across it [m];
        ahead: from the body to the ellipse's center [m].
      speed: desired [m/s].
      mix: weights of the types by name; None: cars.
      to: "truck" or id of the body.
    """

    kind: ClassVar[str] = "swarm"

    count: int = whole(REQUIRED, 1, SWARM_MAX)
    inner: float = number(REQUIRED, 0.0, 10_000.0)
    half_length: float = number(REQUIRED, 1.0, 10_000.0)
    half_width: float = number(REQUIRED, 1.0, 10_000.0)
    speed: float = number(REQUIRED, 0.1, SPEED_MAX)
    ahead: float = number(0.0, -10_000.0, 10_000.0)
    mix: Mapping[str, float] | None = None
    to: str = text(TRUCK)

    def _check(self) -> None:
        self._text("name")
        mix = {"car": 1.0} if self.mix is None else self.mix
        weights = list(mix.values()) if isinstance(mix, Mapping) else []
        if not weights or not all(is_number(w) and 0.0 <= w < 1e6 for w in weights):
            raise InputError(f"{self.kind}: mix = {mix!r}: give types with their weights")
        if sum(weights) <= 0.0:
            raise InputError(f"{self.kind}: mix = {mix!r}: one weight must be positive")
        object.__setattr__(self, "mix", {str(n): float(w) for n, w in mix.items()})


@dataclass(frozen=True, kw_only=True)
class Milestone(SceneEvent):
    """Nothing happens; conditions of other events refer to it by its name."""

    kind: ClassVar[str] = "milestone"
    ends: ClassVar[tuple[str, ...]] = ()

    def _check(self) -> None:
        self._text("name")


@dataclass(frozen=True, kw_only=True)
class SetValue(SceneEvent):
    """A variable gets a value, a number or a text; conditions compare it.

    Attributes:
      variable: its name; value: new one.
      change: "add" or "multiply": the number changes the variable's one, which is 0 if it has none.
    """

    kind: ClassVar[str] = "set_value"
    ends: ClassVar[tuple[str, ...]] = ()

    variable: str = text(REQUIRED)
    value: float | str
    change: str | None = choice(None, ("add", "multiply"))

    def changed(self, before: float | str | None) -> float | str:
        """Returns the value after the event, of that before it."""
        if self.change is None or isinstance(self.value, str):
            return self.value
        number = before if isinstance(before, float) else 0.0
        return number + self.value if self.change == "add" else number * self.value

    def _check(self) -> None:
        if is_number(self.value):
            object.__setattr__(self, "value", float(self.value))
        elif not isinstance(self.value, str):
            raise InputError(f"{self.kind}: value = {self.value!r}: must be a number or a text")
        elif self.change is not None:
            raise InputError(f"{self.kind}: value = {self.value!r}: {self.change} needs a number")


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

    friction: float = number(REQUIRED, 0.0, 2.0)
    friction_right: float | None = number(None, 0.0, 2.0)
    split: float = number(0.0, -50.0, 50.0)
    start: float = number(0.0, 0.0, LONGEST)
    end: float = number(LONGEST, 0.0, LONGEST)

    def _check(self) -> None:
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

    speed: float = number(REQUIRED, 0.0, 60.0)
    direction: float = number(90.0, -360.0, 360.0)
    shape: str = choice("gust", WINDS)

    def _check(self) -> None:
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
    *(
        PlaceVehicle,
        CutIn,
        ChangeLane,
        ChangeSpeed,
        FollowSpeeds,
        Brake,
        Swerve,
        Drift,
        LoseCargo,
        CrossRoad,
    ),
    *(FollowPath, KeepDistance, ActivateDriver, Synchronize, Swarm, RemoveVehicle, Teleport),
    *(Milestone, SetValue, EndDrive, FrictionChange, Wind, Puncture, BrakeLeak, StuckSpeedSensor),
)


def _check_way(event: PlaceVehicle | FollowPath) -> None:
    """Checks `along`, `points`, `frame` and `stays`."""
    kind, points = event.kind, event.points
    _check_along(event)
    if points is None:
        return
    if not isinstance(points, (list, tuple)) or not 2 <= len(points) <= POINTS_MAX:
        raise InputError(f"{kind}: points: give a list of 2 to {POINTS_MAX} points")
    sizes = (2, 3) if event.frame == "map" else (2,)
    made = tuple(point_of(f"{kind}: points", point, *sizes) for point in points)
    if len({len(point) for point in made}) > 1:
        raise InputError(f"{kind}: points: all have a height, or none")
    if any(before[:2] == after[:2] for before, after in itertools.pairwise(made)):
        raise InputError(f"{kind}: points: two equal points follow each other")
    object.__setattr__(event, "points", made)


def _check_along(event: PlaceVehicle | FollowPath | Teleport) -> None:
    if event.along is None:
        return
    event._text("along")
    try:
        read_words(event.along)
    except InputError as error:
        raise InputError(f"{event.kind}: along: {error}") from None
