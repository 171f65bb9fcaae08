"""Road users that move on a plan, or without one drive by a car-following model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.road import Route
from traffic_bridge.scenario.conditions import Body
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
    point = route.evaluate(station, offset)
    rise, bank = float(point.grade), math.tan(float(point.superelevation))
    cosine, sine = math.cos(turn), math.sin(turn)
    place: dict[str, Any] = {
        "x": float(point.x),
        "y": float(point.y),
        "z": float(point.z),
        "yaw": float(point.heading) + turn,
        "pitch": -math.atan(cosine * rise + sine * bank),
        "roll": math.atan(cosine * bank - sine * rise),
        "lane": route.lane_at(station, offset),
    }
    return TrackedVehicle(id, station=station, offset=offset, **(place | more))


@dataclass
class Plan:
    """A motion of an actor along the road or across it.

    Attributes:
      done: it is over or was replaced; then: called when it is over.
    """

    done: bool = False
    then: Callable[[], None] = lambda: None


@dataclass
class SpeedPlan(Plan):
    """A change to a speed with bounded acceleration and jerk, or that speed held.

    Attributes:
      target: [m/s]; rate: greatest acceleration [m/s2]; jerk: [m/s3]; held: it does not end.
      follow: target by the situation's bodies, None where it stays.
      profile: speed at a time since the beginning, instead of rate and jerk; duration: of it [s].
    """

    target: float = 0.0
    rate: float = 1.5
    jerk: float = 5.0
    held: bool = False
    follow: Callable[[Iterable[Body]], float | None] | None = None
    profile: Callable[[float], float] | None = None
    duration: float = 0.0
    elapsed: float = 0.0

    def next(self, speed: float, before: float, step: float) -> float:
        """Acceleration of the next step [m/s2]; `before` is that of the last one."""
        if self.profile is not None:
            self.elapsed = min(self.elapsed + step, self.duration)
            self.done = self.elapsed >= self.duration - 1e-9
            return (self.profile(self.elapsed) - speed) / step
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
class Approach(Plan):
    """The way to a place beside the truck: a cubic of time relative to the truck's front bumper.

    Attributes:
      gap, closing: from the truck's front bumper to the actor's rear [m], and its rate [m/s], at
        the beginning; goal, final: the same at the end; duration: [s].
    """

    gap: float = 0.0
    closing: float = 0.0
    goal: float = 0.0
    final: float = 0.0
    duration: float = 0.0
    elapsed: float = 0.0

    @classmethod
    def of(cls, gap: float, closing: float, goal: float, final: float, speed: float) -> Approach:
        """The shortest way that vehicles can drive; `speed` is the truck's [m/s]."""
        made = cls(gap=gap, closing=closing, goal=goal, final=final)
        if abs(gap - goal) < 0.05 and abs(closing - final) < 0.05:
            return made
        for k in range(1, round(LONGEST_APPROACH / TIMES) + 1):
            made.duration = k * TIMES
            rates = [made.at(0.05 * i * made.duration) for i in range(21)]
            if max(abs(made.at(t)[2]) for t in (0.0, made.duration)) <= APPROACH and all(
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
      shift: the distance at a time since the beginning [m]; duration: [s].
    """

    shift: Callable[[float], float] = lambda _: 0.0
    duration: float = 0.0
    elapsed: float = 0.0


class Actor:
    """A vehicle on a lane of the route.

    Args:
      row: the vehicle at the beginning.
      route: the truck's road.
      lane: index of its lane.
      driver: parameters of its car-following model, with its desired speed; None: it keeps its
        speed.

    Attributes:
      name: id; station: of its center [m]; speed: along the road [m/s]; acceleration: [m/s2].
      lane: that it keeps or changes to; shift: to the left of that lane's center [m].
      speed_plan, lateral_plan: the motions now, None without one.
    """

    def __init__(
        self, row: TrackedVehicle, route: Route, lane: int, driver: IdmParameters | None
    ) -> None:
        self.name = row.id
        self.row = row
        self.route = route
        self.lane = lane
        self.driver = driver
        self.station, self.speed, self.acceleration = row.station, row.speed, row.acceleration
        self.speed_plan: SpeedPlan | Approach | None = None
        self.lateral_plan: LateralPlan | None = None
        self.shift = 0.0
        self.to_lane(lane, row.offset)
        self._lateral_speed = 0.0

    @property
    def front(self) -> float:
        """Station of the front bumper [m]."""
        return self.station + 0.5 * self.row.length

    @property
    def gone(self) -> bool:
        """Whether it has reached the end of the route."""
        return self.front >= self.route.length - END

    @property
    def offset(self) -> float:
        """Of its center [m]."""
        return float(self.route.lane_offset(self.lane, self.station)) + self.shift

    @property
    def desired_speed(self) -> float:
        """[m/s]; without a car-following model its speed."""
        return self.speed if self.driver is None else self.driver.desired_speed

    @desired_speed.setter
    def desired_speed(self, speed: float) -> None:
        if self.driver is not None:
            values = vars(self.driver) | {"desired_speed": max(speed, REST)}
            self.driver = IdmParameters(**values)

    def to_lane(self, lane: int, offset: float) -> None:
        """Makes a lane its own, in which it is at an offset, and lets it settle in its center."""
        self.lane = lane
        self.shift = start = offset - float(self.route.lane_offset(lane, self.station))
        self.plan_shift(lambda t: start * (0.5 + 0.5 * math.cos(math.pi * t / SETTLING)), SETTLING)

    def plan_shift(self, shift: Callable[[float], float], duration: float) -> LateralPlan:
        """Replaces its motion across the road; see `LateralPlan`."""
        if self.lateral_plan is not None:
            self.lateral_plan.done = True
        self.lateral_plan = LateralPlan(shift=shift, duration=duration)
        return self.lateral_plan

    def plan_speed(self, plan: SpeedPlan | Approach | None) -> None:
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
        before = self.offset
        plan, speed = self.speed_plan, self.speed
        if isinstance(plan, Approach) and truck is not None:
            plan.elapsed = min(plan.elapsed + step, plan.duration)
            gap, rate, self.acceleration = plan.at(plan.elapsed)
            self.speed = max(truck.speed + rate, 0.0)
            self.station = truck.front + gap + 0.5 * self.row.length
            plan.done = plan.elapsed >= plan.duration - 1e-9
        else:
            if isinstance(plan, SpeedPlan):
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
        lateral = self.lateral_plan
        if lateral is not None:
            lateral.elapsed = min(lateral.elapsed + step, lateral.duration)
            self.shift = lateral.shift(lateral.elapsed)
            lateral.done = lateral.elapsed >= lateral.duration - 1e-9
        self._lateral_speed = (self.offset - before) / step
        if plan is not None and plan.done:
            self.speed_plan = None
            plan.then()
        if lateral is not None and lateral.done:
            if self.lateral_plan is lateral:
                self.lateral_plan = None
            lateral.then()

    def _move(self, distance: float) -> None:
        """Advances its station by a way at its offset."""
        curvature = float(self.route.evaluate(self.station).curvature)
        self.station += distance / max(1.0 - curvature * self.offset, 0.2)

    def _follow(self, bodies: Iterable[Body], step: float) -> float:
        """Acceleration of the car-following model behind the nearest body in its way [m/s2]."""
        assert self.driver is not None
        if self.driver.desired_speed <= REST:
            return -self.speed / step
        gap, leader = math.inf, self.speed
        front, offset, half = self.front, self.offset, 0.5 * self.row.width
        for body in bodies:
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
        return _placed(
            self.row,
            self.route,
            (self.station, self.offset, turn),
            speed=self.speed,
            acceleration=self.acceleration,
            lateral_speed=self._lateral_speed,
        )


class Crosser:
    """A pedestrian, or another road user, who crosses the road on a straight path.

    Args:
      row: the road user at the beginning.
      route: the truck's road.
      left: whether the path leads to the left.
      distance: length of the path [m]; stays: whether the road user stays at its end.
    """

    def __init__(
        self, row: TrackedVehicle, route: Route, left: bool, distance: float, stays: bool
    ) -> None:
        self.name, self.row, self.route = row.id, row, route
        self.speed, self.offset, self.station = row.speed, row.offset, row.station
        self.lane = -1
        self.left, self.remaining, self.stays = left, distance, stays
        self.plan = Plan()

    @property
    def gone(self) -> bool:
        """Whether it has reached the other side."""
        return self.remaining <= 0.0 and not self.stays

    def advance(self, step: float, bodies: Iterable[Body], truck: Body | None) -> None:
        """Moves it by one step; see `Actor.advance`."""
        del bodies, truck
        way = min(self.row.speed * step, self.remaining)
        self.remaining -= way
        self.offset += way if self.left else -way
        self.speed = way / step
        self.plan.done = self.remaining <= 0.0

    def vehicle(self) -> TrackedVehicle:
        """The road user now."""
        turn = 0.5 * math.pi if self.left else -0.5 * math.pi
        sideways = self.speed if self.left else -self.speed
        place = self.station, self.offset, turn
        return _placed(self.row, self.route, place, speed=self.speed, lateral_speed=sideways)


def _placed(
    row: TrackedVehicle, route: Route, place: tuple[float, float, float], **more: Any
) -> TrackedVehicle:
    """A row at another station, offset and turn."""
    return on_road(route, row.id, *place, **(size_of(row) | more))


def size_of(body: TrackedVehicle | VehicleType) -> dict[str, Any]:
    """Kind, length, width and height [m] of a road user or of its type, as `on_road` takes them."""
    return {name: getattr(body, name) for name in ("kind", *DIMENSIONS)}


class Actors:
    """The actors of a running traffic, as a source of vehicles for SUMO's replay.

    Attributes:
      members: by name.
    """

    def __init__(self) -> None:
        self.members: dict[str, Actor | Crosser] = {}
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
            lanes[row] = self.members[name].lane
        return VehicleFrame(frame.ids, frame.kinds, lanes, frame.values.T)

    @property
    def duration(self) -> float:
        """The actors last as long as the traffic [s]."""
        return math.inf
