"""Traffic lights: stop at the line, or pass it, and drive so that a red one is green on arrival.

A choice is made once for a line and a phase. At yellow the truck stops when 2 m/s2 will do and
passes when not (the dilemma of Gazis, Herman and Maradudin 1960). A green that will be over on
arrival is a stop as well. A red whose end is known is approached slowly instead of stopped at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from iits_mj.errors import InputError
from iits_mj.messages import LightState, TrafficLight

# Stop lines nearer together than this are one [m].
_SAME = 5.0


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
      slow_speed: below it, stopping is better than arriving slowly [m/s].
    """

    sight: float = 300.0
    stop_before: float = 0.5
    deceleration: float = 0.8
    yellow_deceleration: float = 2.0
    red_deceleration: float = 3.5
    reaction_time: float = 0.5
    arrival_reserve: float = 3.0
    slow_speed: float = 3.0


@dataclass(frozen=True)
class LightDemand:
    """What a light asks for.

    Attributes:
      stop: station of the front bumper at which to stand at the latest, infinite for none [m].
      deceleration: towards it, positive [m/s2].
      speed: not to be exceeded on the way there, infinite for any [m/s].
      reason: in words, "" for none.
    """

    stop: float = math.inf
    deceleration: float = 0.8
    speed: float = math.inf
    reason: str = ""


class LightStop:
    """Decides for each line whether to stop; remembers the choice until the light is green."""

    def __init__(self, config: LightConfig) -> None:
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forgets all choices."""
        self._line = -math.inf
        self._stops: bool | None = None
        self._deceleration = self.config.deceleration

    def demand(self, light: TrafficLight | None, front: float, speed: float) -> LightDemand:
        """What the next light asks for.

        Args:
          light: the next one, None where there is none.
          front: station of the front bumper [m].
          speed: [m/s].

        Raises:
          InputError: the light's station or time is not finite, or its state is none.
        """
        if light is not None:
            _check(light)
        if light is None or not -_SAME < light.station - front < self.config.sight:
            self.reset()
            return LightDemand()
        if abs(light.station - self._line) > _SAME:
            self.reset()
        self._line = light.station
        room = light.station - self.config.stop_before - front
        if light.state is LightState.GREEN and not self._over_on_arrival(light, room, speed):
            self._stops = None
            return LightDemand()
        if self._stops is None:
            self._choose(light, room, speed)
        if not self._stops:
            return LightDemand()
        return self._stop(light, room)

    def _over_on_arrival(self, light: TrafficLight, room: float, speed: float) -> bool:
        """A green that ends before the truck gets there."""
        if light.next_switch is None or light.next_state is LightState.GREEN:
            return False
        return room > light.next_switch * max(speed, self.config.slow_speed)

    def _choose(self, light: TrafficLight, room: float, speed: float) -> None:
        config = self.config
        left = room - config.reaction_time * speed
        needed = speed**2 / (2.0 * left) if left > 0.0 else math.inf
        if speed < 0.5 and room > -config.stop_before:
            needed = 0.0
        most = config.red_deceleration
        if light.state is not LightState.RED:
            most = config.yellow_deceleration
        self._stops = needed <= most
        self._deceleration = min(max(needed, config.deceleration), config.red_deceleration)

    def _stop(self, light: TrafficLight, room: float) -> LightDemand:
        config = self.config
        stop = light.station - config.stop_before
        reason = f"{light.state.value} light in {max(room, 0.0):.0f} m"
        known = light.state is LightState.RED and light.next_state is LightState.GREEN
        if known and light.next_switch is not None:
            arriving = room / (light.next_switch + config.arrival_reserve)
            if arriving > config.slow_speed:
                late = max(self._deceleration, config.yellow_deceleration)
                return LightDemand(stop, late, arriving, reason)
        return LightDemand(stop, self._deceleration, math.inf, reason)


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
