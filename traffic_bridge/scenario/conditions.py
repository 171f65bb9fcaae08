"""Conditions on truck and traffic, and the triggers of events that are made of them.

The terms are those of ASAM OpenSCENARIO XML: a trigger is a list of groups, one of which must
hold; a group is a list of conditions, all of which must hold; a condition has an edge and a delay.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from iits_mj.core.checks import check_fields, in_range, is_number, make_plain, one_of, shown
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoFootprint, EgoState
from iits_mj.core.neighbors import ALONG, Neighbors
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route

TRUCK = "truck"
SIGNAL = "signal "  # begins the variables that are the states of the map's lights
# Neighbors of the truck by role: lanes to the left of the truck's own, and whether it is ahead.
ROLES: dict[str, tuple[int, bool]] = {
    "leader": (0, True),
    "follower": (0, False),
    "left_leader": (1, True),
    "left_follower": (1, False),
    "right_leader": (-1, True),
    "right_follower": (-1, False),
}
GAPS = ("gap", "time_gap", "ttc")  # measures of a gap
EDGES = ("none", "rising", "falling", "either")
STATES = ("begun", "ended")
SLOWEST = 0.1  # [m/s] below which there is no time gap
MOST = 20  # conditions of a trigger
FARTHEST = 1e8  # [m]: coordinates of points
ROUNDING = 1e-9  # [s]: times of steps are sums of tenths


class Body(NamedTuple):
    """The truck or a vehicle along the route.

    Attributes:
      name: id of the vehicle, or "truck".
      front, rear: stations of its ends [m]; offset: of its center [m]; width: across the road [m].
      lane: index from the outside, -1 off the lanes.
      speed: [m/s]; pace: its part along the route [m/s]; acceleration: [m/s2].
      x, y: of its reference point: a vehicle's center, the truck's steer axle [m].
      yaw: [rad]; reach: from its reference point to its front [m].
    """

    name: str
    front: float
    rear: float
    offset: float
    width: float
    lane: int
    speed: float
    pace: float
    acceleration: float
    x: float
    y: float
    yaw: float
    reach: float

    @property
    def length(self) -> float:
        """[m]."""
        return self.front - self.rear


@dataclass(frozen=True)
class Situation:
    """Truck and traffic at one instant.

    Attributes:
      time: of the traffic [s].
      route: the truck's road; footprint: of the truck.
      ego: the truck, None without one; vehicles: the traffic.
      events: state of the events by name, one of `STATES`; missing before their beginning.
      values: of the variables that events have set.
      step: of the traffic [s].
    """

    time: float
    route: Route
    footprint: EgoFootprint
    ego: EgoState | None
    vehicles: VehicleFrame
    events: Mapping[str, str] = dataclasses.field(default_factory=dict)
    values: Mapping[str, float | str] = dataclasses.field(default_factory=dict)
    step: float = 0.0

    @functools.cached_property
    def truck(self) -> Body | None:
        """The truck, None without one."""
        ego = self.ego
        if ego is None:
            return None
        front = ego.station + self.footprint.front_overhang
        return Body(
            TRUCK,
            front,
            front - self.footprint.length,
            ego.offset,
            self.footprint.width,
            self.route.lane_at(ego.station, ego.offset),
            ego.speed,
            ego.speed,
            ego.acceleration,
            ego.x,
            ego.y,
            ego.yaw,
            self.footprint.front_overhang,
        )

    @functools.cached_property
    def bodies(self) -> dict[str, Body]:
        """The vehicles by their ids."""
        frame = self.vehicles
        if not len(frame):
            return {}
        station, length, width, yaw = frame.columns("station", "length", "width", "yaw")
        turn = yaw - self.route.heading(station)
        cosine, sine = np.cos(turn), np.sin(turn)
        # A body that drives along the road, also one that changes lanes, counts as parallel to it.
        turned = np.abs(sine) > math.sin(ALONG)
        along, across = np.abs(cosine), np.abs(sine)
        half = 0.5 * np.where(turned, length * along + width * across, length)
        across = np.where(turned, length * across + width * along, width)
        names = ("offset", "speed", "acceleration", "x", "y")
        offset, speed, acceleration, x, y = frame.columns(*names)
        columns = (station + half, station - half, offset, across)
        rest = (speed, speed * cosine, acceleration, x, y, yaw, 0.5 * length)
        rows = np.column_stack((*columns, *rest)).tolist()
        return {
            name: Body._make((name, *row[:4], lane, *row[4:]))
            for name, lane, row in zip(frame.ids, frame.lanes.tolist(), rows, strict=True)
        }

    @functools.cached_property
    def _neighbors(self) -> Neighbors | None:
        return None if self.ego is None else Neighbors(self.ego, self.vehicles, self.footprint)

    def find(self, name: str) -> Body | None:
        """The truck, the vehicle of a role, or the vehicle with an id; None if there is none."""
        if name == TRUCK:
            return self.truck
        if name not in ROLES:
            return self.bodies.get(name)
        if self._neighbors is None or self.truck is None or self.truck.lane < 0:
            return None
        side, ahead = ROLES[name]
        lane = self.truck.lane + side
        if not 0 <= lane < self.route.lane_count(self.truck.front):
            return None
        query = self._neighbors.leader_in_lane if ahead else self._neighbors.follower_in_lane
        found = query(self.route, lane)
        return None if found is None else self.bodies[found.id]


def gap(a: Body, b: Body, freespace: bool = True, shift: float = 0.0) -> float:
    """Gap of two bodies along the route [m].

    It is between the bumpers, 0 side by side; without `freespace` between the front bumpers, with a
    shift of the way from `a` to `b` [m].
    """
    if not freespace:
        return abs(b.front - a.front + shift)
    return max(b.rear - a.front, a.rear - b.front, 0.0)


def clearance(a: Body, b: Body) -> float:
    """Greatest gap of two bodies along the road and across it [m], 0 where they touch."""
    return max(gap(a, b), abs(b.offset - a.offset) - 0.5 * (a.width + b.width), 0.0)


def time_gap(a: Body, b: Body, freespace: bool = True, shift: float = 0.0) -> float:
    """Time in which `a` covers its gap to `b` ahead of it [s]; inf if it never does."""
    if b.front + shift <= a.front or a.pace <= SLOWEST:
        return math.inf
    return gap(a, b, freespace, shift) / a.pace


def time_to_collision(a: Body, b: Body, freespace: bool = True, shift: float = 0.0) -> float:
    """Gap over closing speed of two bodies [s]; inf where they do not close in.

    J. C. Hayward, "Near-miss determination through use of a scale of danger", Highway Research
    Record 384 (1972).
    """
    behind, ahead = (a, b) if b.front + shift > a.front else (b, a)
    closing = behind.pace - ahead.pace
    return gap(a, b, freespace, shift) / closing if closing > 0.0 else math.inf


class Measure(NamedTuple):
    """A quantity that a condition compares; `value` takes one body, or `of` and `to`."""

    unit: str
    bodies: int
    value: Callable[..., float]


MEASURES: dict[str, Measure] = {
    "time": Measure("s", 0, lambda: math.nan),
    "station": Measure("m", 1, lambda a: a.front),
    "lane": Measure("", 1, lambda a: a.lane),
    "offset": Measure("m", 1, lambda a: a.offset),
    "speed": Measure("m/s", 1, lambda a: a.speed),
    "acceleration": Measure("m/s2", 1, lambda a: a.acceleration),
    "gap": Measure("m", 2, gap),
    "clearance": Measure("m", 2, clearance),
    "ahead": Measure("m", 2, lambda a, b: b.front - a.front),
    "distance": Measure("m", 2, lambda a, b: math.hypot(b.x - a.x, b.y - a.y)),
    "time_gap": Measure("s", 2, time_gap),
    "ttc": Measure("s", 2, time_to_collision),
    "speed_difference": Measure("m/s", 2, lambda a, b: b.speed - a.speed),
}


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A comparison of a measure or of a variable, or the state of another event.

    A condition on a body that is not there does not hold.

    Attributes:
      measure: one of `MEASURES`. "station" is that of the front bumper; "gap" is between the
        bumpers along the route, 0 side by side; "clearance" is the greater one of the gaps along
        the route and across it, 0 where they touch; "ahead" is how far the front bumper of `to` is
        ahead of that of `of`; "time_gap" is that of `of` behind `to`; "speed_difference" is the
        speed of `to` minus that of `of`; "distance" is in the plane, between the centers.
      above, below, equals: the value is compared with one or both limits, or with one number.
      of: "truck", a role of `ROLES`, or the id of a vehicle; to: the second body of the measure.
      point: x and y of the map [m], instead of `to` of a "distance": from the middle of the front
        bumper, or `back` behind it [m], and the least one since the last step of the traffic.
      event: name of an event, instead of a measure; state: that it has reached, of `STATES`.
      variable: name of a variable, instead of a measure, see `actions.SetValue`: its number is
        compared, or with `text` its text.
      edge: "none": the comparison holds; "rising": it holds now and did not one step before;
        "falling": the reverse; "either": it changed.
      delay: time after which the condition follows the comparison [s].
      lasting: time for which the comparison must have held [s].
      freespace: the gap of a measure in `GAPS` is between the bumpers; false: between the front
        bumpers, from that of `of` to that of `to`, with `shift` added [m].

    Raises:
      InputError: a value is not allowed, missing, or has no meaning for the measure.
    """

    measure: str | None = None
    above: float | None = None
    below: float | None = None
    equals: float | None = None
    of: str = TRUCK
    to: str | None = None
    point: tuple[float, float] | None = None
    back: float = 0.0
    event: str | None = None
    variable: str | None = None
    text: str | None = None
    state: str = "ended"
    edge: str = "none"
    delay: float = 0.0
    lasting: float = 0.0
    freespace: bool = True
    shift: float = 0.0

    def __post_init__(self) -> None:
        """Checks every value."""
        one_of("when: edge", self.edge, EDGES)
        in_range("when: delay", self.delay, 0.0, 1e4, "s")
        in_range("when: lasting", self.lasting, 0.0, 1e4, "s")
        limits = [n for n in ("above", "below", "equals") if getattr(self, n) is not None]
        subjects = [n for n in ("measure", "event", "variable") if getattr(self, n) is not None]
        if len(subjects) != 1:
            raise InputError("when: give a measure or an event or a variable, and not both")
        (subject,) = subjects
        if subject == "measure":
            self._check_bodies()
        else:
            _name(f"when: {subject}", getattr(self, subject))
            self._unused(subject, "to", "point")
        if subject != "variable":
            self._unused(str(self.measure or subject), "text")
        if subject == "event":
            one_of("when: state", self.state, STATES)
            self._unused("event", *limits)
        else:
            for limit in limits:
                if not is_number(value := getattr(self, limit)):
                    raise InputError(f"when: {limit} = {shown(value)}: must be a number")
            compared = len(limits) + (self.text is not None)
            if not compared or (compared > 1 and limits != ["above", "below"]):
                what = self.measure or f"variable {self.variable}"
                raise InputError(f"when: {what} needs above, below or both, or equals alone")
        make_plain(self)

    def _unused(self, what: str, *names: str) -> None:
        for name in names:
            if getattr(self, name) is not None:
                raise InputError(f"when: {name} is not used with {_article(what)}")

    def _check_bodies(self) -> None:
        """Checks the bodies of a measure."""
        if not isinstance(self.freespace, bool):
            raise InputError(f"when: freespace = {shown(self.freespace)}: allowed are true, false")
        needed = MEASURES[one_of("when: measure", self.measure, MEASURES)].bodies
        _name("when: of", self.of)
        in_range("when: back", self.back, -100.0, 100.0, "m")
        in_range("when: shift", self.shift, -100.0, 100.0, "m")
        if self.point is not None:
            if self.measure != "distance" or self.to is not None:
                raise InputError("when: point is for the measure distance, instead of `to`")
            object.__setattr__(self, "point", point_of("when: point", self.point, 2))
        elif (self.to is not None) != (needed == 2):
            use = "needs `to`, the other body" if needed == 2 else "has no `to`"
            raise InputError(f"when: {self.measure} {use}")
        if self.to is not None:
            _name("when: to", self.to)

    def holds(self, situation: Situation) -> bool:
        """Whether the comparison holds now, without edge and delay."""
        if self.event is not None:
            found = situation.events.get(self.event)
            return found == self.state or (self.state == "begun" and found is not None)
        if self.text is not None:
            return situation.values.get(str(self.variable)) == self.text
        value = self.value(situation)
        if math.isnan(value):
            return False
        if self.equals is not None:
            return abs(value - self.equals) <= ROUNDING
        low = -math.inf if self.above is None else self.above
        high = math.inf if self.below is None else self.below
        if self.measure == "time":
            return low - ROUNDING <= value <= high + ROUNDING
        return low < value < high or (value == math.inf and self.below is None)

    def value(self, situation: Situation) -> float:
        """The measure now, in its unit, or the variable; NaN where it is missing."""
        if self.variable is not None:
            found_value = situation.values.get(self.variable)
            return found_value if isinstance(found_value, float) else math.nan
        if self.point is not None:
            body = situation.find(self.of)
            return math.nan if body is None else _passed(body, self, situation.step)
        measure = MEASURES[str(self.measure)]
        if measure.bodies == 0:
            return situation.time
        names = (self.of,) if measure.bodies == 1 else (self.of, str(self.to))
        found: list[Any] = [situation.find(name) for name in names]
        if None in found:
            return math.nan
        if not self.freespace and self.measure in GAPS:
            found += [False, self.shift]
        return float(measure.value(*found))

    def as_dict(self) -> dict[str, Any]:
        """The fields that differ from their defaults; `condition_of` is the inverse."""
        fields = dataclasses.fields(self)
        return {f.name: v for f in fields if (v := getattr(self, f.name)) != f.default}


def point_of(what: str, value: Any, *sizes: int) -> tuple[float, ...]:
    """A point of finite numbers, as many as one of the sizes; InputError if it is none."""
    wanted = " or ".join(map(str, sizes))
    if not isinstance(value, (list, tuple)) or len(value) not in sizes:
        raise InputError(f"{what} = {shown(value)}: must be {wanted} numbers")
    for number in value:
        if not is_number(number) or abs(number) > FARTHEST:
            raise InputError(f"{what} = {shown(value)}: each must be a number up to {FARTHEST:g}")
    return tuple(float(number) for number in value)


def _passed(body: Body, condition: Condition, step: float) -> float:
    """Least distance of a body's front, or behind it, to a point within the last step [m]."""
    assert condition.point is not None
    x, y = condition.point
    cosine, sine = math.cos(body.yaw), math.sin(body.yaw)
    ahead = body.reach - condition.back
    dx, dy = x - body.x - ahead * cosine, y - body.y - ahead * sine
    behind = -(dx * cosine + dy * sine)
    back = min(max(behind, 0.0), max(body.speed, 0.0) * step)
    return math.hypot(dx + back * cosine, dy + back * sine)


def _article(word: str) -> str:
    return f"an {word}" if word[0] in "aeiou" else f"a {word}"


Groups = tuple[tuple[Condition, ...], ...]


def condition_of(values: Mapping[str, Any]) -> Condition:
    """The condition of a mapping; InputError if a key is unknown or a value is not allowed."""
    check_fields("when", values, (field.name for field in dataclasses.fields(Condition)))
    return Condition(**values)


def groups_of(given: Any) -> Groups:
    """The groups of a trigger: of a condition, a list of them, or a list of such lists.

    Raises:
      InputError: it is none of them, or a condition is not usable.
    """
    if isinstance(given, (Condition, Mapping)):
        given = [given]
    if not isinstance(given, (list, tuple)) or not given:
        raise InputError(f"when = {shown(given)}: must be a condition or a list of them")
    if all(isinstance(entry, (list, tuple)) for entry in given):
        found = tuple(_group(entry) for entry in given)
    else:
        found = (_group(given),)
    if sum(map(len, found)) > MOST:
        raise InputError(f"when: {sum(map(len, found))} conditions are more than {MOST} allowed")
    return found


def _group(entries: Iterable[Any]) -> tuple[Condition, ...]:
    made = []
    for entry in entries:
        if isinstance(entry, Mapping):
            entry = condition_of(entry)
        if not isinstance(entry, Condition):
            raise InputError(f"when: {shown(entry)} is no condition")
        made.append(entry)
    if not made:
        raise InputError("when: a group has no condition")
    return tuple(made)


def _name(what: str, value: object) -> None:
    if not isinstance(value, str) or not value:
        raise InputError(f"{what} = {shown(value)}: must be a name")


class Trigger:
    """Evaluates groups of conditions step by step, with their edges and delays."""

    def __init__(self, groups: Groups) -> None:
        self._groups = [[_Watch(condition) for condition in group] for group in groups]

    def step(self, situation: Situation) -> bool:
        """Whether one of the groups holds; called once for every step of the traffic."""
        # Every condition keeps its history, so none may be left out.
        held = [[watch.step(situation) for watch in group] for group in self._groups]
        return any(all(group) for group in held)


class _Watch:
    """A condition with its history."""

    def __init__(self, condition: Condition) -> None:
        self._condition = condition
        self._last: bool | None = None
        self._since = math.nan
        self._history: deque[tuple[float, bool]] = deque()

    def step(self, situation: Situation) -> bool:
        condition, now = self._condition, self._condition.holds(situation)
        if condition.lasting > 0.0:
            if not now or math.isnan(self._since):
                self._since = situation.time if now else math.nan
            now = situation.time - self._since >= condition.lasting - ROUNDING
        before = now if self._last is None else self._last
        self._last = now
        value = {
            "none": now,
            "rising": now and not before,
            "falling": before and not now,
            "either": now != before,
        }[condition.edge]
        if condition.delay == 0.0:
            return value
        self._history.append((situation.time, value))
        due = situation.time - condition.delay + ROUNDING
        if self._history[0][0] > due:
            return False
        while len(self._history) > 1 and self._history[1][0] <= due:
            self._history.popleft()
        return self._history[0][1]


def names_in(groups: Sequence[Sequence[Condition]]) -> tuple[set[str], set[str]]:
    """Names of the bodies and of the events that conditions refer to."""
    conditions = [condition for group in groups for condition in group]
    bodies = {
        name
        for condition in conditions
        if condition.measure is not None and MEASURES[condition.measure].bodies
        for name in (condition.of, condition.to)
        if name is not None
    }
    return bodies, {c.event for c in conditions if c.event is not None}
