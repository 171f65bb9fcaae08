"""Places where the truck has to stop: lights, bends, lane ends, and behind stopped vehicles.

Each of them gives a station and a deceleration. The speed plan stops at the nearest; the others
bound the speed on the way.

The planner judges lights again in every cycle; only the choice to stop lasts, until the light is
green. At yellow the truck stops if 2 m/s2 are enough and passes otherwise (the dilemma of Gazis,
Herman and Maradudin 1960). It also stops for a green that ends before it arrives. It approaches a
red whose end is known slowly, without a stop. At a green arrow it stops, then continues when the
crossing is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from controllers.planning.config import LightConfig, PlannerConfig
from controllers.planning.crossing import is_free
from controllers.planning.lane_change import Change
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.speed_plan import HOLD_REACH
from controllers.planning.stopped_vehicle import stopped_leader
from controllers.planning.tight_bend_yield import DECELERATION, RESTS, TightBends
from iits_mj.core.arrays import FloatArray
from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, LightState, Scene, TrafficLight
from iits_mj.parameters import TruckParameters

# Stop lines nearer together than this are one [m].
_SAME = 3.0
# The least distance to a line at which a stop counts as before it [m].
_LEAST = 0.3
# Speed below which a stop needs hardly any braking, and below which the truck is at rest [m/s].
_CRAWLS, _AT_REST = 0.3, 0.1


@dataclass(frozen=True)
class LightDemand:
    """Demand of a light on the speed plan.

    Attributes:
      stop: station at which the front bumper has to stop at the latest, inf for none [m].
      deceleration: towards it, positive [m/s2].
      speed: on arrival, inf for any [m/s]; the truck slows down to it at `arrival_deceleration`.
      reason: in words, "" for none.
    """

    stop: float = math.inf
    deceleration: float = LightConfig.deceleration
    speed: float = math.inf
    reason: str = ""


class LightStop:
    """Chooses at each line whether to stop; the choice to stop lasts until the light is green."""

    def __init__(self, config: LightConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Clears all choices."""
        self._line = -math.inf
        self._stops = self._arrives = self._released = False
        self._deceleration = self.config.deceleration
        self._stood: float | None = None

    def demand(
        self,
        light: TrafficLight | None,
        front: float,
        speed: float,
        time: float = 0.0,
        free: Callable[[float], bool] = math.isfinite,
    ) -> LightDemand:
        """The demand of the next light.

        Args:
          light: the next one, or the one that the front has just crossed; None for none.
          front: station of the front bumper [m].
          speed: [m/s].
          time: now [s].
          free: whether nothing crosses behind the line at a station; default: nothing does.

        Raises:
          InputError: the light's station or time is not finite, or its state is not a `LightState`.
        """
        config = self.config
        if light is not None:
            _check(light)
        if light is None or not -config.overshoot <= light.station - front < config.sight:
            self.reset()
            return LightDemand()
        if abs(light.station - self._line) > _SAME:
            self.reset()
        self._line = light.station
        if light.state is LightState.STOP:
            # The light releases a truck that has waited for long enough if nothing crosses.
            waits = speed <= _AT_REST and light.station - front <= config.stop_before + _SAME
            stood = time if self._stood is None else self._stood
            self._stood = stood if waits else None
            if waits and time - stood >= config.stand_time - 1e-6 and free(light.station):
                self._released = True
        if self._goes(light, front, speed):
            self._stops = self._arrives = False
            self._deceleration = config.deceleration
            return LightDemand()
        self._choose(light, front, speed)
        return self._stop(light, front, speed) if self._stops else LightDemand()

    def _goes(self, light: TrafficLight, front: float, speed: float) -> bool:
        """Whether the light is green for long enough, or releases the truck after its stop."""
        if light.state is LightState.STOP:
            return self._released
        self._released = False
        return light.state is LightState.GREEN and not self._over_on_arrival(light, front, speed)

    def _over_on_arrival(self, light: TrafficLight, front: float, speed: float) -> bool:
        """Whether a green ends before the truck arrives."""
        if light.next_switch is None or light.next_state in (LightState.GREEN, LightState.STOP):
            return False
        room = light.station - self.config.stop_before - front
        return room > light.next_switch * max(speed, self.config.slow_speed)

    def _choose(self, light: TrafficLight, front: float, speed: float) -> None:
        """Chooses to stop where it is possible, and the deceleration."""
        config = self.config
        red = light.state in (LightState.RED, LightState.STOP)
        room = light.station - front
        most = config.red_deceleration if red else config.yellow_deceleration
        easy = room > 0.0 and (speed < _CRAWLS or (red and speed < config.creep_speed))
        if not self._stops:
            needed = _needed(room - _LEAST - config.reaction_time * speed, speed)
            self._stops = easy or needed <= most
            wanted = _needed(room - config.stop_before - config.reaction_time * speed, speed)
        else:
            wanted = _needed(room - config.stop_before, speed)
        if self._stops and speed > config.creep_speed:
            wanted = min(wanted, config.red_deceleration)
            self._deceleration = max(self._deceleration, wanted)

    def _stop(self, light: TrafficLight, front: float, speed: float) -> LightDemand:
        """The demand to stop, or to arrive slowly if the change to green is known."""
        config = self.config
        stop = light.station - config.stop_before
        room = stop - front
        reason = f"{light.state.value} light in {max(room, 0.0):.0f} m"
        if light.state is LightState.RED and light.next_state is LightState.GREEN:
            arriving = self._arriving(light, room, speed)
            self._arrives = self._arrives or arriving > config.slow_speed
            if self._arrives:
                late = max(self._deceleration, config.yellow_deceleration)
                return LightDemand(stop, late, max(arriving, config.slow_speed), reason)
        return LightDemand(stop, self._deceleration, math.inf, reason)

    def _arriving(self, light: TrafficLight, room: float, speed: float) -> float:
        """Speed with which the truck arrives some time after the change [m/s]; 0 for none.

        It brakes at `b` to the speed `v - u` and keeps it: `room = (v - u) T + u^2 / (2 b)`.
        """
        config = self.config
        if light.next_switch is None or room <= 0.0:
            return 0.0
        left, b = light.next_switch + config.arrival_reserve, config.arrival_deceleration
        if speed * left <= room:
            return room / left
        root = (b * left) ** 2 - 2.0 * b * (speed * left - room)
        return 0.0 if root < 0.0 else speed - b * left + math.sqrt(root)


def _needed(room: float, speed: float) -> float:
    """Constant deceleration that stops within a distance, positive [m/s2]."""
    return speed**2 / (2.0 * room) if room > 0.0 else math.inf


def _check(light: TrafficLight) -> None:
    """Raises InputError for a light with a number that is not finite or an unknown state."""
    times = 0.0 if light.next_switch is None else light.next_switch
    if not (math.isfinite(light.station) and math.isfinite(times)):
        raise InputError(
            f"traffic light at station {light.station} that switches in {light.next_switch} s: "
            "both must be finite"
        )
    if not isinstance(light.state, LightState):
        raise InputError(f"traffic light: state {light.state!r} is none of {list(LightState)}")


class Stops:
    """Finds the places to stop at, in every cycle.

    Attributes:
      light: demand of the next light; bend_reason: of waiting before a bend, or "".
    """

    def __init__(
        self, preview: RoadPreview, config: PlannerConfig, parameters: TruckParameters
    ) -> None:
        self._preview = preview
        self._config = config
        self._line = LightStop(config.light)
        self.bends = TightBends(preview, parameters)
        self.reset()

    def reset(self) -> None:
        """Clears choices and waits."""
        self._line.reset()
        self.bends.reset()
        self.light = LightDemand()
        self.bend_reason = ""
        self._bend = self._room = math.inf
        self._held: float | None = None

    def look(
        self, scene: Scene, path: LanePath, cap: FloatArray, change: Change | None
    ) -> FloatArray:
        """Finds all places but the lane's end; returns the bound on the speed, bends included.

        Args:
          scene: the truck, the traffic and the signs.
          path: of the lane kept or changed to.
          cap: bound on the speed so far, shape of path.station [m/s].
          change: under way, or None.
        """
        self.light = self._line.demand(
            scene.signals.light,
            scene.neighbors.front,
            scene.ego.speed,
            scene.time,
            lambda line: is_free(scene, self._preview, line),
        )
        self._room = self._keeps_room(scene, path, change)
        cap, self._bend, self.bend_reason = self.bends.demand(scene, path, cap)
        return cap

    def nearest(
        self, scene: Scene, path: LanePath, cap: FloatArray, waits: bool
    ) -> tuple[float, float, FloatArray]:
        """Station of the steer axle's next stop [m], its deceleration [m/s2], bound on the speed.

        Args:
          scene: the truck.
          path: of the lane.
          cap: bound on the speed so far, shape of path.station [m/s].
          waits: the lane ends and the next one is not free yet.
        """
        (stop, deceleration), *further = self._places(scene, path, waits)
        for place, braking in further:
            left = np.maximum(place - path.station, 0.0)
            cap = np.minimum(cap, np.sqrt(2.0 * braking * left))
        light, ego = self.light, scene.ego
        if math.isfinite(light.speed):
            way = np.maximum(path.station - ego.station, 0.0)
            square = ego.speed**2 - 2.0 * self._config.light.arrival_deceleration * way
            arriving = np.sqrt(np.maximum(square, light.speed**2))
            before = path.station < light.stop - scene.footprint.front_overhang
            cap = np.minimum(cap, np.where(before, arriving, np.inf))
        return stop, deceleration, cap

    def holds(self, stop: float, ego: EgoState) -> bool:
        """Whether the truck has come to rest at a stop and does not creep on."""
        if self._held is not None and stop > self._held + HOLD_REACH:
            self._held = None
        left = stop - ego.station
        rests = left < HOLD_REACH and ego.speed < (RESTS if left > 0.0 else 2.0 * RESTS)
        if self._held is None and rests:
            self._held = stop
        return self._held is not None

    def _places(self, scene: Scene, path: LanePath, waits: bool) -> list[tuple[float, float]]:
        """Stations where the steer axle has to stop [m] with their decelerations [m/s2], sorted."""
        overhang, speed = scene.footprint.front_overhang, self._config.speed
        end = (path.end - speed.stop_gap - overhang, speed.following.preview_deceleration)
        if waits:
            merge = self._config.merge
            end = (path.end - merge.room - overhang, merge.stop_deceleration)
        stops = [end, (self.light.stop - overhang, self.light.deceleration)]
        stops.append((self._bend, DECELERATION))
        stops.append((self._room - overhang, 0.8 * self._config.passing.deceleration))
        return sorted(stop for stop in stops if math.isfinite(stop[0])) or [(math.inf, end[1])]

    def _keeps_room(self, scene: Scene, path: LanePath, change: Change | None) -> float:
        """Station of the front bumper behind a stopped vehicle that the truck passes later [m]."""
        ego, config = scene.ego, self._config.passing
        leader = stopped_leader(scene, path, config, self._config.speed.preview)
        if leader is None:
            return math.inf
        beside = (path.lane - 1, path.lane + 1)
        usable = [lane for lane in beside if lane in self._config.lanes]
        under_way = change is not None and not (change.passed_id and change.aborted)
        if under_way or not any(self._preview.lane_exists(i, ego.station) for i in usable):
            return math.inf
        front = scene.neighbors.front
        stop = front + leader.gap - config.gap
        can_stop = stop - front >= ego.speed**2 / (2.0 * config.deceleration) - 1.0
        return stop if can_stop else math.inf
