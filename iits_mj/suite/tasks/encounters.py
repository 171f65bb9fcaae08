"""Tasks with another vehicle, which scripted events move: a cut-in, an emergency stop."""

from __future__ import annotations

import abc
import math
from typing import Any, ClassVar

import mujoco

from iits_mj.core.messages import EgoState, TrackedVehicle
from iits_mj.simulation.gaps import nearest_box_distance
from iits_mj.suite import scene
from iits_mj.suite.physics import WITHOUT_GEAR, Observed, Physics
from iits_mj.suite.tasks.base import DrivingTask, tolerance
from traffic_bridge import Brake, CutIn, EventSim, Mirror, PlaceVehicle, TrafficConfig
from traffic_bridge.scenario.conditions import groups_of
from traffic_bridge.signals.events import Event

SIGHT = 150.0  # [m]: a vehicle that is farther ahead is not seen
# The wanted gap of a constant time-gap policy, and its gain: R. Rajamani, "Vehicle Dynamics and
# Control", 2nd ed., 2012, section 6.4.
STANDSTILL, TIME_GAP, GAIN = 3.0, 1.5, 0.2  # [m], [s], [1/s]
OTHER = "other"


def wanted_speed(target: float, gap: float, speed_other: float, in_way: bool) -> float:
    """Returns the speed at which to follow [m/s].

    Args:
      target: without a vehicle in the way [m/s].
      gap: to the vehicle ahead [m].
      speed_other: its speed [m/s].
      in_way: whether it is in the truck's way.
    """
    if not in_way:
        return target
    follow = speed_other + GAIN * (gap - STANDSTILL - TIME_GAP * speed_other)
    return min(max(follow, 0.0), target)


class Encounter(DrivingTask):
    """Base class: a straight road, and one car on it that events move.

    Attributes:
      vehicle: the car now; None: it is not there.
    """

    time_limit = 20.0
    target = 22.0
    actions: ClassVar[tuple[str, ...]] = ("drive",)
    road = staticmethod(scene.flat)
    observed: ClassVar[dict[str, Observed]] = {
        **WITHOUT_GEAR,
        "speed_error": Observed(5.0, "m/s", "speed minus the wanted one", "speed, car"),
        "gap": Observed(
            50.0, "m", "front bumper to the car's rear, along the road; 150 without it", "car"
        ),
        "closing_speed": Observed(10.0, "m/s", "speed minus the car's; 0 without it", "car"),
        "car_acceleration": Observed(4.0, "m/s2", "of the car; 0 without it", "car"),
        "beside": Observed(4.0, "m", "car's middle left of the truck's; 0 without it", "car"),
    }
    terms: ClassVar[dict[str, str]] = {
        "speed": "within 0.5 m/s of the wanted speed; 0.5 at 2 m/s more, 0.1 at 18 m/s more. The "
        "wanted speed is 22 m/s; behind a car in the way at most the car's, and 0.2 m/s more "
        "or less for each meter that the gap is wider or narrower than 3 m and 1.5 s",
        "clear": "at least 0.8 s to a car in the way, and 3.2 m; 0.1 at the car. A collision ends "
        "the episode",
        "comfort": "within 2 m/s2 along; 0.1 at 4 m/s2 more",
    }
    vehicle: TrackedVehicle | None = None

    def __init__(self, random: Any = None) -> None:
        super().__init__(random)
        self._traffic: EventSim | None = None
        self._states: list[EgoState] = []  # of the truck at the steps of the traffic
        self._mirror = _mirror()

    def __getstate__(self) -> dict[str, Any]:
        # The traffic is made again from its events and the truck's states.
        traffic = None if self._traffic is None else (self._traffic.route, self._traffic.config)
        return vars(self) | {"_traffic": traffic}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self._traffic is not None:
            first, *others = self._states
            self._traffic = EventSim(*state["_traffic"])
            self._traffic.reset(first)
            for ego in others:
                self._traffic.step(ego)

    @classmethod
    def edit_spec(cls, spec: mujoco.MjSpec) -> None:
        """Adds the car, a mocap body that each step moves; its contacts exert no force."""
        _mirror().add_to(spec)

    @abc.abstractmethod
    def events(self, speed: float) -> tuple[Event, ...]:
        """Draws the events of an episode with a truck at a speed [m/s]."""

    def initialize_episode(self, physics: Physics) -> None:
        """At 20 to 24 m/s in the right lane, with new events."""
        speed = self.random.uniform(20.0, 24.0)
        route = physics.route
        physics.place(300.0, float(route.lane_offset(0, 300.0)), speed)
        self._mirror.bind(physics.model.ptr)
        config = TrafficConfig(
            density="empty", footprint=physics.truck.footprint, events=self.events(speed)
        )
        self._traffic = EventSim(route, config)
        self._states = [physics.ego()]
        self._see(physics, self._traffic.reset(self._states[0]).find(OTHER))
        super().initialize_episode(physics)

    def after_step(self, physics: Physics) -> None:
        """Moves the car."""
        if self._traffic is not None:
            self._states.append(physics.ego())
            self._see(physics, self._traffic.step(self._states[-1]).find(OTHER))
        super().after_step(physics)

    def _see(self, physics: Physics, vehicle: TrackedVehicle | None) -> None:
        self.vehicle = vehicle
        ego, seen = physics.ego(), [] if vehicle is None else [vehicle]
        self._mirror.update(physics.data.ptr, seen, (ego.x, ego.y))

    def gap(self, physics: Physics) -> float:
        """Returns the distance from the front bumper to the car's rear [m]."""
        if self.vehicle is None:
            return SIGHT
        front = physics.station() + physics.truck.footprint.front_overhang
        return min(self.vehicle.station - 0.5 * self.vehicle.length - front, SIGHT)

    def closing_speed(self, physics: Physics) -> float:
        """Returns the speed minus the car's [m/s]."""
        return 0.0 if self.vehicle is None else physics.speed() - self.vehicle.speed

    def car_acceleration(self, physics: Physics) -> float:
        """Returns the acceleration of the car [m/s2]."""
        del physics
        return 0.0 if self.vehicle is None else self.vehicle.acceleration

    def beside(self, physics: Physics) -> float:
        """Returns how far the car's middle is left of the truck's [m]."""
        return 0.0 if self.vehicle is None else self.vehicle.offset - physics.offset()

    def in_way(self, physics: Physics) -> bool:
        """Whether the car is ahead, and its box would touch the truck's."""
        if self.vehicle is None or not -self.vehicle.length < self.gap(physics) < SIGHT:
            return False
        width = physics.truck.footprint.width + self.vehicle.width
        return abs(self.beside(physics)) < 0.5 * width

    def speed_error(self, physics: Physics) -> float:
        """Returns the speed minus the wanted one [m/s]."""
        other = 0.0 if self.vehicle is None else self.vehicle.speed
        wanted = wanted_speed(self.target, self.gap(physics), other, self.in_way(physics))
        return physics.speed() - wanted

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """Returns `speed`: near the wanted one; `clear`: not too near; `comfort`."""
        speed = tolerance(self.speed_error(physics), -0.5, 0.5, 18.0, sigmoid="reciprocal")
        time_gap = max(self.gap(physics), 0.0) / max(physics.speed(), 4.0)
        clear = tolerance(time_gap, 0.8, math.inf, 0.8) if self.in_way(physics) else 1.0
        return {
            "speed": speed,
            "clear": clear,
            "comfort": tolerance(physics.acceleration(), -2.0, 2.0, 4.0),
        }

    def get_termination(self, physics: Physics) -> float | None:
        """Ends with discount 0 after a collision."""
        if self.vehicle is None:
            return None
        near = nearest_box_distance(physics.ego(), [self.vehicle], physics.truck.parameters)
        return 0.0 if near == 0.0 else None


class CutInTask(Encounter):
    """Slow down for a car that cuts in, and follow it.

    The car changes from the left lane to 8 to 30 m before the truck, up to 6 m/s slower than the
    truck, and brakes once more later.
    """

    brake_max = 6.0
    tags = ("easy",)

    def events(self, speed: float) -> tuple[Event, ...]:
        """Draws the place, the time and the haste of the cut-in, and the braking."""
        draw = self.random.uniform
        gap, slower, begin = draw(8.0, 30.0), draw(0.0, 6.0), draw(1.0, 4.0)
        pause, brake, to_speed, lasts = draw(0.0, 3.0), draw(1.0, 4.0), draw(8.0, 14.0), draw(3, 6)
        return (
            PlaceVehicle(name=OTHER, gap=gap, relative_lane=1, speed=speed, reactive=False),
            CutIn(
                actor=OTHER,
                at_time=begin,
                gap=gap,
                speed_difference=-slower,
                duration=draw(2.0, 4.0),
            ),
            Brake(
                actor=OTHER,
                when=groups_of({"event": "cut_in", "delay": pause}),
                deceleration=brake,
                to_speed=to_speed,
                duration=lasts,
            ),
        )


class EmergencyStop(Encounter):
    """Stop behind a car that brakes hard for no visible reason.

    The car drives 1.2 to 2.5 s before the truck and brakes with 4 to 8 m/s2, mostly to a stop.
    """

    brake_max = 7.0
    tags = ("hard",)

    def events(self, speed: float) -> tuple[Event, ...]:
        """Draws the time gap, and when and how hard the car brakes."""
        draw = self.random.uniform
        gap, begin, brake = speed * draw(1.2, 2.5), draw(1.0, 4.0), draw(4.0, 8.0)
        to_speed = 0.0 if draw(0.0, 1.0) < 0.7 else draw(3.0, 10.0)
        return (
            PlaceVehicle(name=OTHER, gap=gap, relative_lane=0, speed=speed, reactive=False),
            Brake(actor=OTHER, at_time=begin, deceleration=brake, to_speed=to_speed),
        )


def _mirror() -> Mirror:
    """A pool of one car."""
    return Mirror({"car": 1}, road_users=False)
