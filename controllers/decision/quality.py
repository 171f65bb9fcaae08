"""Quality of a trip beyond its speed: what lane changes impose on others, and the use of lanes.

One definition for both worlds: the full chain calls `QualityLog`, and the fast world has the same
figures in compiled form (iits_mj/kernels/fast_world.cc). New leader and new follower are those of
`Neighbors.leader_in_lane` and `Neighbors.follower_in_lane` at the instant at which a change begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from iits_mj.core.messages import PlanMode, Scene, Trajectory

if TYPE_CHECKING:
    from iits_mj.road import Route

# A new follower that brakes harder [m/s2] within this time [s] of a change was made to. Braking
# counts when it lasts [s]: a vehicle of SUMO may lose 1 m/s in one step, with gentle braking before
# and after it, when the truck enters its lane. The time step of the fast world is as long.
IMPOSED, IMPOSED_TIME, LASTS = 2.0, 8.0, 0.2
# Below this speed a time gap has no meaning [m/s].
SLOWEST = 1.0


@dataclass
class Quality:
    """Figures of a trip.

    Attributes:
      right_time: in which the truck keeps or enters the rightmost lane [s].
      beside_time: in which a vehicle in a neighboring lane overlaps the truck's length [s].
      imposed_brakings: changes whose new follower brakes harder than `IMPOSED` within
        `IMPOSED_TIME` of the change's start.
      imposed_deceleration: the new follower's hardest braking within that time [m/s2], positive,
        summed over the changes; a change without a follower adds zero. It counts as far as it lasts
        for `LASTS`.
      collision_time_front, collision_time_rear: least time to a collision with the new leader and
        of the new follower with the truck, at constant speeds, at the start of a change [s]; inf
        if they never close in.
      change_time_gap_front, change_time_gap_rear: least time gap of the truck to the new leader and
        of the new follower to the truck, at the start of a change [s]; inf without one.
    """

    right_time: float = 0.0
    beside_time: float = 0.0
    imposed_brakings: int = 0
    imposed_deceleration: float = 0.0
    collision_time_front: float = math.inf
    collision_time_rear: float = math.inf
    change_time_gap_front: float = math.inf
    change_time_gap_rear: float = math.inf


class QualityLog:
    """Measures the figures of a trip.

    Attributes:
      quality: of the trip so far.
    """

    def __init__(self) -> None:
        self.quality = Quality()
        self._lane: int | None = None
        self._watched = ""
        self._until = self._braking = 0.0
        self._recent: list[float] = []

    def add_plan(self, scene: Scene, route: Route, plan: Trajectory, seconds: float) -> None:
        """Adds some seconds of a drive, from the scene and the plan at their begin."""
        lane = plan.target_lane
        if plan.mode is PlanMode.LANE_CHANGE and self._lane not in (None, lane):
            self.begin_change(scene, route, lane)
        self._lane = lane
        self.add(scene, lane, seconds)

    def begin_change(self, scene: Scene, route: Route, lane: int) -> None:
        """Notes the vehicles ahead and behind in the lane of a change that begins."""
        figures, speed = self.quality, scene.ego.speed
        leader = scene.neighbors.leader_in_lane(route, lane)
        follower = scene.neighbors.follower_in_lane(route, lane)
        if leader is not None:
            time, time_gap = _times(leader.gap, speed, leader.speed)
            figures.collision_time_front = min(figures.collision_time_front, time)
            figures.change_time_gap_front = min(figures.change_time_gap_front, time_gap)
        if follower is not None:
            time, time_gap = _times(follower.gap, follower.speed, speed)
            figures.collision_time_rear = min(figures.collision_time_rear, time)
            figures.change_time_gap_rear = min(figures.change_time_gap_rear, time_gap)
        self._watched = "" if follower is None else follower.id
        self._until, self._braking = scene.time + IMPOSED_TIME, 0.0
        self._recent.clear()

    def add(self, scene: Scene, lane: int, seconds: float) -> None:
        """Adds some seconds.

        Args:
          scene: in them.
          lane: that the truck keeps or enters.
          seconds: their number.
        """
        figures, neighbors = self.quality, scene.neighbors
        figures.right_time += seconds * (lane == 0)
        beside = (neighbors.gap < 0.0) & (neighbors.lane >= 0) & (abs(neighbors.lane - lane) == 1)
        figures.beside_time += seconds * bool(np.any(beside))
        if self._watched:
            self._note_braking(scene, seconds)

    def _note_braking(self, scene: Scene, seconds: float) -> None:
        figures, neighbors = self.quality, scene.neighbors
        if self._watched in neighbors.ids:
            place = neighbors.ids.index(self._watched)
            self._recent.append(-float(neighbors.acceleration[place]))
            count = max(1, round(LASTS / seconds))
            braking = min(self._recent[-count:]) if len(self._recent) >= count else 0.0
            if braking > self._braking:
                figures.imposed_brakings += self._braking <= IMPOSED < braking
                figures.imposed_deceleration += braking - self._braking
                self._braking = braking
        if scene.time >= self._until:
            self._watched = ""


def _times(gap: float, speed: float, ahead: float) -> tuple[float, float]:
    """Returns the time to a collision and the time gap of a vehicle behind another one [s]."""
    time = gap / (speed - ahead) if speed > ahead else math.inf
    return time, gap / speed if speed > SLOWEST else math.inf
