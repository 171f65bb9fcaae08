"""How fast the traffic ahead drives: an estimate from the vehicles in sight.

A plan that counts on being fast downhill, where others drive, is late: it meets them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields

from iits_mj.errors import InputError
from iits_mj.messages import TrackedVehicle


@dataclass(frozen=True)
class FlowConfig:
    """How the flow is judged.

    Attributes:
      sight: vehicles of the road's lanes so far ahead count [m].
      memory: time constant of the estimate [s].
      margin: that a truck can be faster than the others by passing some of them [m/s].
      presence: share of the time with somebody in sight from which on there is a flow, 0 to 1.
    """

    sight: float = 300.0
    memory: float = 30.0
    margin: float = 1.0
    presence: float = 0.5

    def __post_init__(self) -> None:
        """Refuses numbers that are not finite or not above 0."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value) or value <= 0.0:
                raise InputError(f"{field.name} = {value!r} is not allowed: use a number above 0")


class Flow:
    """The mean speed of the vehicles ahead, remembered for a while."""

    def __init__(self, config: FlowConfig | None = None) -> None:
        self.config = config or FlowConfig()
        self.reset()

    def reset(self) -> None:
        """Knows of no traffic."""
        self._speed = self._present = 0.0
        self._time = -math.inf

    def update(self, time: float, station: float, vehicles: Iterable[TrackedVehicle]) -> float:
        """Greatest speed that the traffic allows on the whole [m/s]; inf where there is none.

        Args:
          time: now [s].
          station: of the truck [m].
          vehicles: those in sight.
        """
        config = self.config
        ahead = [
            v.speed
            for v in vehicles
            if v.lane >= 0 and 0.0 < v.station - station < config.sight and math.isfinite(v.speed)
        ]
        # The first look counts in full.
        weight = 1.0 - math.exp(-max(time - self._time, 0.0) / config.memory)
        self._time = time
        self._present += weight * (float(bool(ahead)) - self._present)
        if ahead:
            mean = max(sum(ahead) / len(ahead), 0.0)
            fresh = self._speed <= 0.0
            self._speed = mean if fresh else self._speed + weight * (mean - self._speed)
        return self._speed + config.margin if self._present > config.presence else math.inf
