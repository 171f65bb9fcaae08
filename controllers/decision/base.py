"""Decision makers: their input, and the one that always keeps its lane.

A decision maker decides about once a second: change to the left, keep, or change to the right.
It does not steer: the planner checks the decision again and may refuse it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from iits_mj.core.checks import is_number, shown
from iits_mj.core.errors import InputError
from iits_mj.core.messages import PROFILE_SPEED_MIN, Decision, Scene
from iits_mj.core.own_parts import part_name

if TYPE_CHECKING:
    from iits_mj.road import Route

Observation = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class DecisionContext:
    """Input of a decision at one instant.

    Attributes:
      scene: the truck and the traffic around it.
      route: the truck's road.
      lane: index of the lane that the truck keeps, or changes to, now (0 = outermost).
      lanes: indices of the lanes the truck may use; the paper limits it to two.
      reference_speed: of the speed planner here [m/s].
      observation: of shape (216,), see `controllers.decision.observation`.
      may_pass: whether the truck may pass on the left, see `controllers.planning.keep_right`.
    """

    scene: Scene
    route: Route
    lane: int
    lanes: tuple[int, ...]
    reference_speed: float
    observation: Observation
    may_pass: bool = True

    def may_use(self, lane: int) -> bool:
        """Whether a lane exists at the truck's station and the truck is allowed to use it."""
        if lane > self.lane and not self.may_pass:
            return False
        return lane in self.lanes and bool(self.route.lane_exists(lane, self.scene.ego.station))

    def sides(self) -> Iterator[tuple[Decision, int]]:
        """Yields the changes to lanes that the truck may use, left first: decision and lane."""
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = self.lane - int(side)
            if self.may_use(lane):
                yield side, lane


def speed_max_of(maker: object) -> float:
    """Returns the highest speed of a decision maker's last decision [m/s]; infinite without one.

    Raises:
      InputError: its `speed_max` is not allowed.
    """
    value = getattr(maker, "speed_max", math.inf)
    if value == math.inf or (is_number(value) and value >= PROFILE_SPEED_MIN):
        return float(value)
    title = getattr(maker, "title", f"decision maker {part_name(maker)}")
    raise InputError(f"{title}: speed_max is {shown(value)}; use {PROFILE_SPEED_MIN:g} m/s or more")


class Memoryless:
    """Base of decision makers without memory."""

    def reset(self) -> None:
        """Does nothing."""


class Keep(Memoryless):
    """Never changes lanes."""

    name = "keep"

    def decide(self, context: DecisionContext) -> Decision:
        """Returns `Decision.KEEP`."""
        del context
        return Decision.KEEP
