"""One truck's share of a platoon: keep the lane and the gap to the truck ahead."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from dm_control.utils import rewards

from iits_mj.suite.physics import Observed, Physics
from iits_mj.suite.tasks.base import Observations
from iits_mj.suite.tasks.lane_keep import LaneKeep

# Gap at standstill [m].
STANDSTILL_GAP = 5.0


class Platoon(LaneKeep):
    """Keep the right lane of a winding road, and the gap to the truck ahead or the set speed.

    It has no episode of its own: `iits_mj.envs.platoon` places the trucks and sets speeds.

    Args:
      ahead: physics of the truck ahead; None for the first.
      time_gap: to the truck ahead [s], beside 5 m.
      random: seed or `numpy.random.RandomState`.

    Attributes:
      target: speed to hold [m/s]: the one that is set, or that of the truck ahead.
    """

    observed: ClassVar[dict[str, Observed]] = {
        **LaneKeep.observed,
        "speed_error": Observed(
            5.0, "m/s", "speed less the set speed, or that of the truck ahead", "speeds"
        ),
        "gap_error": Observed(
            10.0, "m", "gap ahead less the wanted one; 0 for the first", "bodies `tractor`, road"
        ),
        "gap": Observed(30.0, "m", "to the rear of the truck ahead; 0 for the first", "the same"),
        "acceleration_ahead": Observed(
            2.0, "m/s2", "of the truck ahead; 0 for the first", "sensor `tractor_acceleration`"
        ),
    }
    terms: ClassVar[dict[str, str]] = {
        name: meaning for name, meaning in LaneKeep.terms.items() if name != "speed"
    } | {
        "spacing": "gap within 1 m of the wanted one, 0.1 at 10 m more; for the first, speed "
        "within 1 m/s of the set one, 0.1 at 8 m/s more",
    }

    def __init__(self, ahead: Physics | None, time_gap: float, random: Any = None) -> None:
        super().__init__(random=random)
        self._ahead = ahead
        self._time_gap = time_gap

    def wanted_gap(self, speed: float) -> float:
        """To the truck ahead [m] at a speed [m/s]."""
        return STANDSTILL_GAP + self._time_gap * speed

    def gap(self, physics: Physics) -> float:
        """From the front bumper to the rear end of the truck ahead [m]; 0 for the first."""
        if self._ahead is None:
            return 0.0
        footprint = self._ahead.truck.footprint
        rear = self._ahead.station() + footprint.front_overhang - footprint.length
        return rear - physics.station() - physics.truck.footprint.front_overhang

    def gap_error(self, physics: Physics) -> float:
        """Gap less the wanted one [m]; 0 for the first."""
        if self._ahead is None:
            return 0.0
        return self.gap(physics) - self.wanted_gap(physics.speed())

    def get_observation(self, physics: Physics) -> Observations:
        """What keeping the lane has, the gap, and what the truck ahead does."""
        if self._ahead is not None:
            self.target = self._ahead.speed()
        found = super().get_observation(physics)
        found["gap_error"] = np.array([self.gap_error(physics)])
        found["gap"] = np.array([self.gap(physics)])
        ahead = 0.0 if self._ahead is None else self._ahead.acceleration()
        found["acceleration_ahead"] = np.array([ahead])
        return found

    def reward_terms(self, physics: Physics) -> dict[str, float]:
        """`lane`, `trailer`, `comfort` of keeping the lane; `spacing` in the place of `speed`."""
        found = super().reward_terms(physics)
        speed = found.pop("speed")
        if self._ahead is None:
            return {**found, "spacing": speed}
        error = self.gap_error(physics)
        return {**found, "spacing": float(rewards.tolerance(error, (-1.0, 1.0), margin=10.0))}
