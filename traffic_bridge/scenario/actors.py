"""Road users that move on a plan, or without one drive by a car-following model."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from iits_mj.core.angles import wrap_angle
from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.neighbors import ALONG, LEVEL_OVER_ROAD
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from iits_mj.road.reference_line import RoadPoint
from traffic_bridge.scenario.conditions import Body
from traffic_bridge.scenario.paths import Path
from traffic_bridge.vehicles.idm import IdmParameters, acceleration
from traffic_bridge.vehicles.types import VehicleType

DIMENSIONS = ("length", "width", "height")

# Below this speed a box does not turn further with its lateral motion [m/s].
TIGHT_TURN = 2.0
# Greatest acceleration of a vehicle that drives to its place for a cut-in [m/s2], the times in
# which it may arrive there, and their spacing [s].
APPROACH, LONGEST_APPROACH, TIMES = 2.5, 120.0, 0.5
SETTLING = 2.0  # [s] in which a vehicle returns to its lane's center
HARDEST = 9.0  # [m/s2]: braking of the car-following model is no harder than a dry road allows
REST = 0.05  # [m/s]: a slower vehicle that brakes stands
END = 1.0  # [m] before the end of the route, where vehicles leave
# A lane's center that moves by more than a distance [m] and a slope is another lane's (judgement).
LANE_SHIFT, STEEPEST_LANE = 0.3, 0.3
# [m] ahead and aside within which a vehicle on a road of its own sees others
VIEW, ASIDE = 300.0, 30.0

Track = Route | Path


def on_road(
    route: Route, id: str, station: float, offset: float, turn: float = 0.0, **more: Any
) -> TrackedVehicle:
    """A vehicle on the road's surface.

    Args:
      route: the truck's road.
      id: of the vehicle.
      station: of its center [m].
      offset: of its center [m].
      turn: of its heading against the road's [rad].
      **more: further fields of `TrackedVehicle`.
    """
    pose = _pose(route.evaluate(station, offset), turn)
    lane = route.lane_at(station, offset)
    values = {"station": station, "offset": offset, "lane": lane, **pose, **more}
    return TrackedVehicle(id, **values)


def beside_road(
    route: Route, id: str, point: RoadPoint, turn: float, near: float | None, **more: Any
) -> TrackedVehicle:
    """A vehicle at a point of another road or path.

    It is in a lane of the route unless it drives against it or on another level.

    Args:
      route: the truck's road.
      id: of the vehicle.
      point: of its center.
      turn: of its heading against the point's [rad].
      near: station on the route near which it is, if known [m].
      **more: further fields of `TrackedVehicle`.
    """
    pose = _pose(point, turn)
    station, offset = route.locate(pose["x"], pose["y"], near)
    road = route.evaluate(station, offset)
    against = math.cos(pose["yaw"] - float(road.heading))
    inside = 0.0 <= station <= route.length and abs(pose["z"] - float(road.z)) < LEVEL_OVER_ROAD
    lane = route.lane_at(station, offset) if inside and against > -math.cos(ALONG) else -1
    return TrackedVehicle(
        id, **{"station": station, "offset": offset, "lane": lane, **pose, **more}
    )


def _pose(point: RoadPoint, turn: float) -> dict[str, float]:
    """The pose of a vehicle on a surface, which is turned against the surface's heading [rad]."""
    rise, bank = float(point.grade), math.tan(float(point.superelevation))
    cosine, sine = math.cos(turn), math.sin(turn)
    return {
        "x": float(point.x),
        "y": float(point.y),
        "z": float(point.z),
        "yaw": float(point.heading) + turn,
        "pitch": -math.atan(cosine * rise + sine * bank),
        "roll": math.atan(cosine * bank - sine * rise),
    }


@dataclass
class Plan:
    """A motion of an actor along the road or across it.

    Attributes:
      done: it is over or was replaced; then: called when it is over.
      duration: of a plan over time [s]; elapsed: since its beginning [s].
    """

    done: bool = False
    then: Callable[[], None] = lambda: None
    duration: float = 0.0
    elapsed: float = 0.0

    def tick(self, step: float) -> float:
        """Ends a step of a plan over time; returns the time since its beginning [s]."""
        self.elapsed = min(self.elapsed + step, self.duration)
        self.done = self.elapsed >= self.duration - 1e-9
        return self.elapsed


@dataclass
class SpeedPlan(Plan):
    """A change to a speed with bounded acceleration and jerk, or that speed held.

    Attributes:
      target: [m/s]; rate: greatest acceleration [m/s2]; jerk: [m/s3]; held: it does not end.
      follow: target by the situation's bodies, None where it stays.
      profile: speed at a time since the beginning, instead of rate and jerk.
    """

    target: float = 0.0
    rate: float = 1.5
    jerk: float = 5.0
    held: bool = False
    follow: Callable[[Iterable[Body]], float | None] | None = None
    profile: Callable[[float], float] | None = None

    def next(self, speed: float, before: float, step: float) -> float:
        """Acceleration of the next step [m/s2]; `before` is that of the last one."""
        if self.profile is not None:
            return (self.profile(self.tick(step)) - speed) / step
        missing = self.target - speed
        change = self.jerk * step
        # The acceleration from which equal steps down to zero add up to the missing speed.
        landing = 0.5 * change * (math.sqrt(1.0 + 8.0 * abs(missing) / (change * step)) - 1.0)
        wanted = math.copysign(min(self.rate, landing), missing)
        found = min(max(wanted, before - change), before + change)
        if found * missing >= 0.0 and abs(missing) <= max(abs(found) * step, REST * step):
            self.done = not self.held
            return missing / step
        return found


@dataclass
class Law(Plan):
    """An acceleration that depends on the road users.

    Attributes:
      acceleration: by the bodies and the step [s], in m/s2; None: the speed stays.
    """

    acceleration: Callable[[Iterable[Body], float], float | None] = lambda *_: None


@dataclass
class Timetable(Plan):
    """A place on a path for each time.

    Attributes:
      at: station on the path [m] at a time since the beginning [s].
    """

    at: Callable[[float], float] = lambda _: 0.0


@dataclass
class Course(Plan):
    """The way along a path up to a station of it, the goal [m]."""

    goal: float = 0.0


@dataclass
class Approach(Plan):
    """The way to a place beside the truck: a cubic of time relative to the truck's front bumper.

    Attributes:
      gap, closing: from the truck's front bumper to the actor's rear [m], and its rate [m/s], at
        the beginning; goal, final: the same at the end.
    """

    gap: float = 0.0
    closing: float = 0.0
    goal: float = 0.0
    final: float = 0.0

    @classmethod
    def of(
        cls,
        gap: float,
        closing: float,
        goal: float,
        final: float,
        speed: float,
        hardest: float = APPROACH,
    ) -> Approach:
        """The shortest way that vehicles can drive.

        `speed` is the truck's [m/s], `hardest` the greatest acceleration relative to it [m/s2].
        """
        made = cls(gap=gap, closing=closing, goal=goal, final=final)
        if abs(gap - goal) < 0.05 and abs(closing - final) < 0.05:
            return made
        for k in range(1, round(LONGEST_APPROACH / TIMES) + 1):
            made.duration = k * TIMES
            rates = [made.at(0.05 * i * made.duration) for i in range(21)]
            if max(abs(made.at(t)[2]) for t in (0.0, made.duration)) <= hardest and all(
                speed + rate >= 0.0 for _, rate, _ in rates
            ):
                break
        return made

    def at(self, time: float) -> tuple[float, float, float]:
        """Gap [m], its rate [m/s] and the acceleration [m/s2] at a time since the beginning."""
        span, u0, u1 = self.duration, self.closing, self.final
        way = self.goal - self.gap
        square = (3.0 * way - span * (2.0 * u0 + u1)) / span**2
        cubic = (span * (u0 + u1) - 2.0 * way) / span**3
        return (
            self.gap + time * (u0 + time * (square + time * cubic)),
            u0 + time * (2.0 * square + 3.0 * time * cubic),
            2.0 * square + 6.0 * time * cubic,
        )


@dataclass
class LateralPlan(Plan):
    """Distance to the left of the lane's center over time.

    Attributes:
      shift: the distance at a time since the beginning [m].
    """

    shift: Callable[[float], float] = lambda _: 0.0


class Actor:
    """A road user on a lane of the truck's route, of another one, or on a path.

    Args:
      row: the road user at the beginning.
      route: the truck's road.
      lane: index of its lane.
      driver: parameters of its car-following model, with its desired speed; None: it keeps its
        speed.
      track: its own road or path; None: the route.
      place: station and offset of its center on that track [m]; None: those on the route.
      stays: it stands at the end of its path; otherwise it drives on in its lane of the route, and
        leaves where it is on none.

    Attributes:
      name: id; station: of its center on its track [m]; speed: along it [m/s]; acceleration:
        [m/s2].
      lane: that it keeps or changes to, of its track; shift: to the left of that lane's center or
        of its path [m].
      speed_plan, lateral_plan, course: the motions now, None without one.
    """

    def __init__(
        self,
        row: TrackedVehicle,
        route: Route,
        lane: int,
        driver: IdmParameters | None,
        track: Track | None = None,
        place: tuple[float, float] | None = None,
        stays: bool = False,
    ) -> None:
        self.name = row.id
        self.row = row
        self.route = route
        self.driver = self._model = driver
        self.speed, self.acceleration = row.speed, row.acceleration
        self.speed_plan: SpeedPlan | Law | Timetable | Approach | None = None
        self.lateral_plan: LateralPlan | None = None
        self.course: Course | None = None
        self._near: float | None = row.station
        place = (row.station, row.offset) if place is None else place
        self.take(route if track is None else track, place, lane, stays)

    def take(
        self, track: Track, place: tuple[float, float], lane: int = 0, stays: bool = False
    ) -> None:
        """Leads it onto a track, on which its center has a station and an offset [m]."""
        if self.course is not None:
            self.course.done = True
        self.course, self.track, self.stays = None, track, stays
        self.station = place[0]
        self._lateral_speed = 0.0
        self.to_lane(lane, place[1])

    @property
    def front(self) -> float:
        """Station of the front bumper on its track [m]."""
        return self.station + 0.5 * self.row.length

    @property
    def gone(self) -> bool:
        """Whether it has reached the end of its track."""
        if isinstance(self.track, Path):
            return self.station >= self.track.length and not self.stays
        return self.front >= self.track.length - END

    @property
    def route_lane(self) -> int:
        """Lane of the route that it keeps or changes to, -1 on another track."""
        return self.lane if self.track is self.route else self.row.lane

    @property
    def offset(self) -> float:
        """Of its center on its track [m]."""
        return float(self.track.lane_offset(self.lane, self.station)) + self.shift

    @property
    def desired_speed(self) -> float:
        """[m/s]; without a car-following model its speed."""
        return self.speed if self.driver is None else self.driver.desired_speed

    @desired_speed.setter
    def desired_speed(self, speed: float) -> None:
        if self.driver is not None:
            values = vars(self.driver) | {"desired_speed": max(speed, REST)}
            self.driver = IdmParameters(**values)

    def activate(self, active: bool) -> None:
        """Lets its car-following model drive, if it has one, or lets it keep its speed."""
        self._model = self.driver or self._model
        self.driver = self._model if active else None
        if active:
            self.plan_speed(None)

    def to_lane(self, lane: int, offset: float) -> None:
        """Makes a lane its own, in which it is at an offset, and lets it settle in its center."""
        self.lane = lane
        self.shift = start = offset - float(self.track.lane_offset(lane, self.station))
        self.plan_shift(lambda t: start * (0.5 + 0.5 * math.cos(math.pi * t / SETTLING)), SETTLING)

    def plan_shift(self, shift: Callable[[float], float], duration: float) -> LateralPlan:
        """Replaces its motion across the road; see `LateralPlan`."""
        if self.lateral_plan is not None:
            self.lateral_plan.done = True
        self.lateral_plan = LateralPlan(shift=shift, duration=duration)
        return self.lateral_plan

    def stay_aside(self, shift: float) -> None:
        """Keeps it at a distance to the left of its lane's center [m]."""
        self.shift = shift
        self.plan_shift(lambda _: shift, math.inf)

    def plan_speed(self, plan: SpeedPlan | Law | Timetable | Approach | None) -> None:
        """Replaces its motion along the road; None: drives by the car-following model."""
        if self.speed_plan is not None:
            self.speed_plan.done = True
        self.speed_plan = plan

    def advance(self, step: float, bodies: Iterable[Body], truck: Body | None) -> None:
        """Moves it by one step.

        Args:
          step: [s].
          bodies: truck and vehicles at the beginning of the step.
          truck: the truck at the end of the step.
        """
        before, place, center = self.offset, self.station, self.offset - self.shift
        plan, speed = self.speed_plan, self.speed
        if isinstance(plan, Approach) and truck is not None:
            gap, rate, self.acceleration = plan.at(plan.tick(step))
            self.speed = max(truck.speed + rate, 0.0)
            self.station = truck.front + gap + 0.5 * self.row.length
        elif isinstance(plan, Timetable):
            station = plan.at(plan.tick(step))
            self.speed = (station - self.station) / step
            self.acceleration = (self.speed - speed) / step
            self.station = station
        else:
            if isinstance(plan, Law):
                law = plan.acceleration(bodies, step)
                found = 0.0 if law is None else law
            elif isinstance(plan, SpeedPlan):
                if plan.follow is not None:
                    target = plan.follow(bodies)
                    plan.target = plan.target if target is None else target
                found = plan.next(speed, self.acceleration, step)
                if not plan.held or plan.follow is not None:
                    self.desired_speed = plan.target
            elif self.driver is not None:
                found = self._follow(bodies, step)
            else:
                found = 0.0
            self.speed = max(speed + found * step, 0.0)
            if found <= 0.0 and self.speed < REST:
                self.speed = 0.0
            self.acceleration = (self.speed - speed) / step
            self._move(0.5 * (speed + self.speed) * step)
        moved = float(self.track.lane_offset(self.lane, self.station)) - center
        if abs(moved) > LANE_SHIFT + STEEPEST_LANE * abs(self.station - place):
            # Lanes begin or end beside it, which changes their numbers: it stays where it is.
            self.to_lane(self._lane_at(before), before)
        lateral = self.lateral_plan
        if lateral is not None:
            self.shift = lateral.shift(lateral.tick(step))
        self._lateral_speed = (self.offset - before) / step
        self._follow_course()
        if plan is not None and plan.done:
            self.speed_plan = None
            plan.then()
        if lateral is not None and lateral.done:
            if self.lateral_plan is lateral:
                self.lateral_plan = None
            lateral.then()

    def _lane_at(self, offset: float) -> int:
        """The lane of its track nearest to an offset."""
        if isinstance(self.track, Path):
            return self.lane
        lanes = range(self.track.lane_count(self.station))
        there = [k for k in lanes if self.track.lane_exists(k, self.station)] or [self.lane]
        center = self.track.lane_offset
        return min(there, key=lambda k: abs(float(center(k, self.station)) - offset))

    def _move(self, distance: float) -> None:
        """Advances its station by a way at its offset, with the curvature in the middle of it."""
        curvature = float(self.track.evaluate(self.station + 0.5 * distance).curvature)
        self.station += distance / max(1.0 - curvature * self.offset, 0.2)

    def _follow_course(self) -> None:
        """Ends its course at the goal, and its motion at the end of its path."""
        if self.course is not None and self.station >= self.course.goal - 1e-6:
            self.course.done = True
        if isinstance(self.track, Path) and self.station >= self.track.length:
            self.station = self.track.length
            if self.stays:
                self.plan_speed(None)
                self.driver, self.speed, self.acceleration = None, 0.0, 0.0
            else:
                self.join_route()

    def join_route(self) -> bool:
        """Leads it from its own track onto the lane of the route in which it is; False: none."""
        row = self.vehicle()
        turn = row.yaw - float(self.route.heading(row.station))  # type: ignore[arg-type]
        if row.lane < 0 or abs(wrap_angle(turn)) > ALONG:
            return False
        self.take(self.route, (row.station, row.offset), row.lane)
        return True

    def sees(self, bodies: Iterable[Body]) -> Iterable[Body]:
        """The bodies with their places on its own track."""
        if self.track is self.route:
            yield from bodies
            return
        own = self.row
        cosine, sine = math.cos(own.yaw), math.sin(own.yaw)
        for body in bodies:
            dx, dy = body.x - own.x, body.y - own.y
            ahead, aside = dx * cosine + dy * sine, dy * cosine - dx * sine
            # A road bends away by less than its way from here.
            if not -body.length <= ahead <= VIEW or abs(aside) > ASIDE + ahead:
                continue
            station, offset = self.track.locate(body.x, body.y, self.station)
            turn = body.yaw - float(self.track.evaluate(station).heading)
            ends = [station + math.cos(turn) * x for x in (body.reach, body.reach - body.length)]
            pace = body.speed * math.cos(turn)
            yield body._replace(front=max(ends), rear=min(ends), offset=offset, pace=pace)

    def _follow(self, bodies: Iterable[Body], step: float) -> float:
        """Acceleration of the car-following model behind the nearest body in its way [m/s2]."""
        assert self.driver is not None
        if self.driver.desired_speed <= REST:
            return -self.speed / step
        gap, leader = math.inf, self.speed
        front, offset, half = self.front, self.offset, 0.5 * self.row.width
        for body in self.sees(bodies):
            if body.name == self.name or body.front <= front:
                continue
            if abs(body.offset - offset) < half + 0.5 * body.width and body.rear - front < gap:
                gap, leader = body.rear - front, max(body.pace, 0.0)
        # A leader that is far away does not count: its gap is infinite.
        found = float(acceleration(self.driver.as_array(), min(gap, 1e12), self.speed, leader))
        return max(found, -HARDEST)

    def vehicle(self) -> TrackedVehicle:
        """The vehicle now."""
        turn = math.atan2(self._lateral_speed, max(self.speed, TIGHT_TURN))
        more = {**size_of(self.row), "speed": self.speed, "acceleration": self.acceleration}
        if self.track is self.route:
            place = self.station, self.offset, turn
            lateral = self._lateral_speed
            return on_road(self.route, self.name, *place, lateral_speed=lateral, **more)
        point = self.track.evaluate(self.station, self.offset)
        row = beside_road(self.route, self.name, point, turn, self._near, **more)
        self._near = row.station
        heading = float(self.route.heading(row.station))  # type: ignore[arg-type]
        sideways = self.speed * math.sin(row.yaw - heading)
        self.row = dataclasses.replace(row, lateral_speed=sideways)
        return self.row


def size_of(body: TrackedVehicle | VehicleType) -> dict[str, Any]:
    """Kind, length, width and height [m] of a road user or of its type, as `on_road` takes them."""
    return {name: getattr(body, name) for name in ("kind", *DIMENSIONS)}


class Actors:
    """The actors of a running traffic, as a source of vehicles for SUMO's replay.

    Attributes:
      members: by name.
    """

    def __init__(self) -> None:
        self.members: dict[str, Actor] = {}
        self._time = 0.0
        self._frame = VehicleFrame.empty()

    def advance(self, time: float, step: float, bodies: list[Body], truck: Body | None) -> None:
        """Moves all by one step, see `Actor.advance`, which ends at a time [s].

        Those that left the road are removed.
        """
        self._time = time
        for member in self.members.values():
            member.advance(step, bodies, truck)
        for name in [name for name, member in self.members.items() if member.gone]:
            del self.members[name]
        self.show()

    def show(self) -> VehicleFrame:
        """Makes the frame of the actors as they are now."""
        self._frame = VehicleFrame.of(member.vehicle() for member in self.members.values())
        return self._frame

    def at(self, time: float) -> VehicleFrame:
        """The actors now; for a later time with the lanes to which they change."""
        frame = self._frame
        if time <= self._time + 1e-6 or not len(frame):
            return frame
        lanes = frame.lanes.copy()
        for row, name in enumerate(frame.ids):
            lanes[row] = self.members[name].route_lane
        return VehicleFrame(frame.ids, frame.kinds, lanes, frame.values.T)

    @property
    def duration(self) -> float:
        """The actors last as long as the traffic [s]."""
        return math.inf
