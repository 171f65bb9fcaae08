"""Which lane the truck may go to, apart from traffic: one that is there, allowed, long enough."""

from __future__ import annotations

from typing import TYPE_CHECKING

from controllers.road_preview import LanePath, RoadPreview
from iits_mj.messages import Decision, EgoState

if TYPE_CHECKING:
    from controllers.planner_config import PlannerConfig

# How far back the path of a lane reaches [m].
BEHIND = 150.0


class LaneChoice:
    """Paths of lanes, and what speaks against going there.

    Args:
      preview: of the road.
      config: settings of the planner.
    """

    def __init__(self, preview: RoadPreview, config: PlannerConfig) -> None:
        self._preview = preview
        self._config = config
        # Paths by lane, and the row of the road's tables that they are about.
        self._known: dict[int, LanePath] = {}
        self._row = -1

    def follow(self, lane: int, ego: EgoState) -> LanePath:
        """The path of a lane around the truck; the same one until the truck is a row further."""
        row = self._preview.index(ego.station)
        if row != self._row:
            self._known, self._row = {}, row
        path = self._known.get(lane)
        if path is None:
            sight = self._config.speed.preview
            path = self._known[lane] = self._preview.follow(lane, ego.station, sight, BEHIND)
        return path

    def around(self, ego: EgoState, path: LanePath) -> Decision:
        """The side with a lane that the truck may use, the left one first."""
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = path.lane - int(side)
            if lane in self._config.lanes and self._preview.lane_exists(lane, ego.station):
                return side
        return Decision.KEEP

    def mandatory(self, ego: EgoState, path: LanePath) -> Decision:
        """The way out of a lane that ends, when it is near."""
        change = self._config.change
        # Not of the speed alone: who slows down for a gap is still about to leave the lane.
        speed = max(ego.speed, self._config.speed.cruise_speed)
        reach = max(speed * change.merge_time, change.merge_distance)
        if path.end - ego.station > reach or path.end >= self._preview.station[-1]:
            return Decision.KEEP
        best, choice = path.end, Decision.KEEP
        for side in (Decision.LEFT, Decision.RIGHT):
            lane = path.lane - int(side)
            if self._preview.lane_exists(lane, ego.station):
                end = self.follow(lane, ego).end
                if end > best:
                    best, choice = end, side
        return choice

    def target(
        self,
        ego: EgoState,
        path: LanePath,
        wanted: Decision,
        *,
        forced: bool,
        pull_out: bool,
        since: float,
        finding: bool,
    ) -> tuple[LanePath | None, str]:
        """Path of the wanted lane and why it may not be taken, apart from traffic.

        Args:
          ego: the truck.
          path: of its lane.
          wanted: the side.
          forced: its lane ends.
          pull_out: from low speed, past somebody who stands.
          since: the last change [s].
          finding: the truck is still on its way to its lane's middle.
        """
        change = self._config.change
        lane = path.lane - int(wanted)
        if not self._preview.lane_exists(lane, ego.station):
            return None, f"there is no lane to the {wanted.name.lower()}"
        if not forced and lane not in self._config.lanes:
            return None, f"lane {lane} is not one the truck may use"
        if ego.speed < change.speed_min and not forced and not pull_out:
            return None, f"speed {ego.speed:.1f} m/s is below {change.speed_min:g} m/s"
        target = self.follow(lane, ego)
        # Who stands beside its lane's middle pulls out from there.
        if finding and not pull_out:
            return target, "the truck is still finding its lane"
        if since < change.pause and not forced:
            return target, f"the last change was {since:.1f} s ago, {change.pause:g} s must pass"
        needed = max(ego.speed, 10.0) * change.duration_max + change.lane_left
        if target.end - ego.station < needed and not forced:
            left = target.end - ego.station
            return target, f"the lane ends in {left:.0f} m, {needed:.0f} m are needed"
        return target, ""
