"""Lane changes: the lanes that the truck may change to, and the quintic that leads there.

The duration of a change follows from speed, curvature, cross-slope, payload and rollover margin:
the trailer's lateral acceleration may not exceed shares of the static rollover threshold, one for
the change alone, one for change and road together. The limit of the steer axle's path is lower by
the rearward amplification. For an empty truck comfort is the stricter limit.
"""

from __future__ import annotations

from dataclasses import dataclass

from controllers.planning.config import LaneChangeConfig, PlannerConfig
from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.rollover_limits import RollMargin
from controllers.planning.trajectory import Quintic, shortest_to_zero
from iits_mj.core.messages import Decision, EgoState

# Length of a lane's path behind the truck [m].
BEHIND = 150.0
# Least duration of a return to a lane's middle [s].
_BACK_MIN = 2.5


@dataclass(slots=True)
class Change:
    """A lane change under way.

    Attributes:
      origin_offset: of the lane that the truck leaves [m]; size: lateral distance [m].
      passed_id: stopped vehicle that the change passes, "" for an ordinary change.
      aborted: the truck returns to its lane.
    """

    origin_offset: float
    size: float
    passed_id: str = ""
    aborted: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """Result of one cycle of `Maneuver`.

    Attributes:
      path: of the lane kept or changed to; reason: of a deviation from the decision, or "".
      refused: the decision refused; unsafe: because of a vehicle.
      wanted: path of the lane that the truck must reach but that is not free, or None.
    """

    path: LanePath
    reason: str = ""
    refused: Decision = Decision.KEEP
    unsafe: bool = False
    wanted: LanePath | None = None


class LaneChoice:
    """Paths of lanes, and the lanes that the truck may change to regardless of traffic."""

    def __init__(self, preview: RoadPreview, config: PlannerConfig) -> None:
        self._preview = preview
        self._config = config
        # Paths by lane, for this row of the road's tables.
        self._known: dict[int, LanePath] = {}
        self._row = -1

    def follow(self, lane: int, ego: EgoState) -> LanePath:
        """The path of a lane around the truck; the same object until the truck's row changes."""
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
        """The side to change to because the lane ends soon; otherwise KEEP."""
        change = self._config.change
        # At least the cruise speed: a truck that slows down for a gap still has to leave the lane.
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
        passing: bool,
        since: float,
        finding: bool,
    ) -> tuple[LanePath | None, str]:
        """Path of the wanted lane, and the reason other than traffic not to change to it, or "".

        Args:
          ego: the truck.
          path: of its lane.
          wanted: the side.
          forced: the truck's lane ends.
          passing: the change passes a stopped vehicle at low speed.
          since: time since the last change [s].
          finding: the truck is still on its way to its lane's middle.
        """
        change = self._config.change
        lane = path.lane - int(wanted)
        if not self._preview.lane_exists(lane, ego.station):
            return None, f"there is no lane to the {wanted.name.lower()}"
        if not forced and lane not in self._config.lanes:
            return None, f"lane {lane} is not one the truck may use"
        if ego.speed < change.speed_min and not forced and not passing:
            return None, f"speed {ego.speed:.1f} m/s is below {change.speed_min:g} m/s"
        target = self.follow(lane, ego)
        # A truck at rest beside its lane's middle starts passing from there.
        if finding and not passing:
            return target, "the truck is still finding its lane"
        if since < change.pause and not forced:
            return target, f"the last change was {since:.1f} s ago, {change.pause:g} s must pass"
        needed = max(ego.speed, 10.0) * change.duration_max + change.lane_left
        left = target.end - ego.station
        if left < needed and not forced:
            return target, f"the lane ends in {left:.0f} m, {needed:.0f} m are needed"
        return target, ""


def lateral_limit(margin: RollMargin, speed: float, felt: float, config: LaneChangeConfig) -> float:
    """Lateral acceleration that a change may add to the path [m/s2]; no change if not positive.

    Args:
      margin: of the truck with its load.
      speed: [m/s].
      felt: greatest lateral acceleration by curvature and cross-slope along the change [m/s2], a
        magnitude.
      config: limits.
    """
    amplified = margin.amplified(speed)
    own = config.change_share * margin.threshold / amplified
    left = (config.total_share * margin.threshold - felt) / amplified
    return min(own, left, config.comfort_acceleration)


def quintic_change(
    station: float,
    size: float,
    slope: float,
    bend: float,
    speed: float,
    limit: float,
    config: LaneChangeConfig,
) -> Quintic | None:
    """The shortest comfortable change to another lane's path, or None when there is none.

    Args:
      station: start [m].
      size: offset from the target lane's path [m].
      slope: first derivative of the offset [1].
      bend: second derivative of the offset [1/m].
      speed: greatest during the change [m/s].
      limit: see `lateral_limit`.
      config: limits.
    """
    if limit <= 0.0:
        return None
    bounds = limit, config.jerk, config.duration_min, config.duration_max, config.length_min
    return shortest_to_zero(station, size, slope, bend, speed, *bounds)


def quintic_back(
    station: float,
    value: float,
    slope: float,
    bend: float,
    speed: float,
    config: LaneChangeConfig,
    limit: float | None = None,
) -> Quintic:
    """The quick return to a lane's middle for aborts and recoveries; there is always one.

    The arguments are those of `quintic_change`; `value` is the offset from the lane's path [m] and
    `limit` the greatest lateral acceleration here [m/s2], None if it is not known.
    """
    bearable, longest = config.abort_acceleration, 3.0 * config.duration_max
    if limit is not None:
        bearable = min(bearable, max(limit, 0.25 * bearable))
    bounds = bearable, config.abort_jerk, _BACK_MIN, longest, config.length_min
    found = shortest_to_zero(station, value, slope, bend, speed, *bounds)
    if found is None:
        length = max(longest * speed, config.length_min)
        found = Quintic.to_zero(station, length, value, slope, bend)
    return found
