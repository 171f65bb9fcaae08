"""Traffic lights: stop at the line, or pass it, and drive so that a red one is green on arrival.

Looked at anew in every cycle; only the choice to stop lasts, until the light is green. At yellow
the truck stops when 2 m/s2 will do and passes when not (the dilemma of Gazis, Herman and Maradudin
1960). A green that will be over on arrival is a stop as well. A red whose end is known is
approached slowly instead of stopped at. A green arrow wants a stop, then lets go when it is free.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from iits_mj.core.errors import InputError
from iits_mj.core.messages import LightState, TrafficLight

# Stop lines nearer together than this are one [m].
_SAME = 3.0
# The nearest to a line at which a stop still counts as one before it [m].
_LEAST = 0.3
# Slower than this a stop needs no brakes to speak of; slower than that the truck stands [m/s].
_CRAWLS, _STANDS = 0.3, 0.1


@dataclass(frozen=True)
class LightConfig:
    """How lights are obeyed.

    Attributes:
      sight: how far away a light is looked at [m].
      stop_before: from the front bumper to the line [m].
      deceleration: towards a line that is seen in time, positive [m/s2].
      yellow_deceleration: more than this is not braked for a yellow light, positive [m/s2].
      red_deceleration: more than this is not braked for a red one: it came too late, positive.
      reaction_time: until the brakes bite [s].
      arrival_reserve: after a known change to green the truck arrives [s].
      arrival_deceleration: at most, to arrive later, positive [m/s2].
      slow_speed: below it, stopping is better than arriving slowly [m/s].
      creep_speed: below it a red line that is not crossed yet is always stopped at [m/s].
      overshoot: a truck that stops and gets over the line by up to this much stays there [m].
      stand_time: at a line that wants a stop before going on [s].
    """

    sight: float = 300.0
    stop_before: float = 0.8
    deceleration: float = 0.8
    yellow_deceleration: float = 2.0
    red_deceleration: float = 3.5
    reaction_time: float = 0.5
    arrival_reserve: float = 3.0
    arrival_deceleration: float = 0.8
    slow_speed: float = 3.0
    creep_speed: float = 2.0
    overshoot: float = 2.0
    stand_time: float = 1.0


@dataclass(frozen=True)
class LightDemand:
    """What a light asks for.

    Attributes:
      stop: station of the front bumper at which to stand at the latest, infinite for none [m].
      deceleration: towards it, positive [m/s2].
      speed: to arrive with, infinite for any [m/s]; the way down to it is
        `arrival_deceleration`.
      reason: in words, "" for none.
    """

    stop: float = math.inf
    deceleration: float = 0.8
    speed: float = math.inf
    reason: str = ""


class LightStop:
    """Decides for each line whether to stop; a choice to stop lasts until the light is green."""

    def __init__(self, config: LightConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forgets all choices."""
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
        """What the next light asks for.

        Args:
          light: the next one, or the one that the front is just over; None where there is none.
          front: station of the front bumper [m].
          speed: [m/s].
          time: now [s].
          free: says of a line's station whether nobody crosses behind it; default: nobody does.

        Raises:
          InputError: the light's station or time is not finite, or its state is none.
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
            self._wait(light, front, speed, time, free)
        if self._goes(light, front, speed):
            self._stops = self._arrives = False
            self._deceleration = config.deceleration
            return LightDemand()
        self._choose(light, front, speed)
        return self._stop(light, front, speed) if self._stops else LightDemand()

    def _goes(self, light: TrafficLight, front: float, speed: float) -> bool:
        """A green that lasts, or an arrow whose stop was made."""
        if light.state is LightState.STOP:
            return self._released
        self._released = False
        return light.state is LightState.GREEN and not self._over_on_arrival(light, front, speed)

    def _over_on_arrival(self, light: TrafficLight, front: float, speed: float) -> bool:
        """A green that ends before the truck gets there."""
        if light.next_switch is None or light.next_state in (LightState.GREEN, LightState.STOP):
            return False
        room = light.station - self.config.stop_before - front
        return room > light.next_switch * max(speed, self.config.slow_speed)

    def _wait(
        self,
        light: TrafficLight,
        front: float,
        speed: float,
        time: float,
        free: Callable[[float], bool],
    ) -> None:
        """Lets the truck go that has stood at a line for long enough, when nobody crosses."""
        config = self.config
        if speed > _STANDS or light.station - front > config.stop_before + _SAME:
            self._stood = None
            return
        self._stood = time if self._stood is None else self._stood
        if time - self._stood >= config.stand_time - 1e-6 and free(light.station):
            self._released = True

    def _choose(self, light: TrafficLight, front: float, speed: float) -> None:
        """Stops where it can be done; what was decided to stop goes on to stop."""
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
        """Speed that brings the truck to the line some time after the change; 0 where none does.

        Braked at `b` to the speed `v - u`, then kept: `room = (v - u) T + u^2 / (2 b)`.
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
    """Constant deceleration that stops within a room, positive [m/s2]."""
    return speed**2 / (2.0 * room) if room > 0.0 else math.inf


def _check(light: TrafficLight) -> None:
    """Refuses a light that cannot be obeyed."""
    times = 0.0 if light.next_switch is None else light.next_switch
    if not (math.isfinite(light.station) and math.isfinite(times)):
        raise InputError(
            f"traffic light at station {light.station} that switches in {light.next_switch} s: "
            "both must be finite"
        )
    if not isinstance(light.state, LightState):
        raise InputError(f"traffic light: state {light.state!r} is none of {list(LightState)}")
