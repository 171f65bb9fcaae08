"""How long a lane change takes: from speed, curvature, cross-slope, payload and roll-over margin.

The trailer's lateral acceleration may not exceed shares of the truck's static roll-over threshold:
one for the change alone, one for change and road together. On the steer axle's path that is less
by the rearward amplification. Comfort bounds what an empty truck could bear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from controllers.planning.road_preview import LanePath, RoadPreview
from controllers.planning.rollover_limits import RollMargin
from controllers.planning.trajectory import Quintic, shortest_to_zero
from iits_mj.core.messages import Decision, EgoState

# --- What the state machine across the road remembers and says: a change, and a step ---


@dataclass(slots=True)
class Change:
    """A lane change under way: direction, the lane it left, its size [m], given up or not.

    `passes`: pulling out from low speed past who stands there, "" for an ordinary change.
    """

    direction: Decision
    origin_offset: float
    size: float
    aborted: bool = False
    mandatory: bool = False
    passes: str = ""

    @property
    def pull_out(self) -> bool:
        """Whether it passes somebody who stands."""
        return bool(self.passes)


@dataclass(frozen=True, slots=True)
class Step:
    """What the state machine says in one cycle.

    Attributes:
      path: of the lane kept or changed to; reason: why not as decided, "" for nothing to say.
      refused: the decision refused; unsafe: because of a vehicle.
      wanted: path of the lane that must be reached but is not free, None for none.
    """

    path: LanePath
    reason: str = ""
    refused: Decision = Decision.KEEP
    unsafe: bool = False
    wanted: LanePath | None = None


# --- Which lane the truck may go to, apart from traffic: one that is there, allowed, long enough

if TYPE_CHECKING:
    from controllers.planning.config import PlannerConfig

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


# --- How long a lane change takes: from speed, curvature, cross-slope, payload and roll-over margin


@dataclass(frozen=True)
class LaneChangeConfig:
    """Limits of lane changes.

    Attributes:
      comfort_acceleration: lateral, of the change alone, whatever the truck could bear [m/s2].
      change_share: of the roll-over threshold, for the trailer's acceleration by the change alone;
        0.18 of 0.39 g gives a 55 t truck at 60 km/h 0.68 m/s2, which takes 6 s.
      total_share: the same for change and road together; a third of the threshold lifts no wheel of
        a laden truck, at 0.42 some load is left on all of them.
      jerk: lateral [m/s3].
      duration_min: [s].
      duration_max: [s].
      length_min: for slow driving: the trailer needs room to follow [m].
      abort_acceleration: lateral, when giving up or finding the lane again [m/s2].
      abort_jerk: lateral [m/s3].
      abort_share: share of the way after which a change is finished whatever comes.
      pause: between two changes [s].
      speed_min: below it nothing but a lane's end makes the truck change [m/s].
      side_gap: beside the vehicle being overtaken [m].
      lane_left: of the target lane beyond the change [m].
      merge_time: before its lane's end the truck looks for a gap [s].
      merge_distance: the same as way [m].
    """

    comfort_acceleration: float = 0.85
    change_share: float = 0.18
    total_share: float = 0.42
    jerk: float = 1.3
    duration_min: float = 4.5
    duration_max: float = 9.0
    length_min: float = 45.0
    abort_acceleration: float = 1.1
    abort_jerk: float = 3.0
    abort_share: float = 0.4
    pause: float = 3.0
    speed_min: float = 4.0
    side_gap: float = 0.4
    lane_left: float = 100.0
    merge_time: float = 24.0
    merge_distance: float = 300.0


def lateral_limit(margin: RollMargin, speed: float, felt: float, config: LaneChangeConfig) -> float:
    """Lateral acceleration of the path that a change may add [m/s2]; not positive: none.

    Args:
      margin: of the truck with its load.
      speed: [m/s].
      felt: greatest lateral acceleration that the road gives along the change [m/s2], by curvature
        and cross-slope, a magnitude.
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
    """The shortest comfortable change of `size` metres, or None when there is none.

    Args:
      station: start [m].
      size: distance to the target lane's path [m]; slope [1] and bend [1/m]: its derivatives.
      slope: see size.
      bend: see size.
      speed: greatest during the change [m/s].
      limit: see `lateral_limit`.
      config: limits.
    """
    if limit <= 0.0:
        return None
    return shortest_to_zero(
        station,
        size,
        slope,
        bend,
        speed,
        limit,
        config.jerk,
        config.duration_min,
        config.duration_max,
        config.length_min,
    )


def quintic_back(
    station: float,
    value: float,
    slope: float,
    bend: float,
    speed: float,
    config: LaneChangeConfig,
    limit: float | None = None,
) -> Quintic:
    """Back to a lane's middle, briskly: for aborts and recoveries. Always gives a curve.

    Args:
      station: start [m].
      value: offset from the path there [m]; slope [1] and bend [1/m]: its derivatives.
      slope: see value.
      bend: see value.
      speed: greatest during the manoeuvre [m/s].
      config: limits.
      limit: lateral acceleration that the truck can bear here, if that is known [m/s2].
    """
    bearable = config.abort_acceleration
    if limit is not None:
        bearable = min(bearable, max(limit, 0.25 * bearable))
    found = shortest_to_zero(
        station,
        value,
        slope,
        bend,
        speed,
        bearable,
        config.abort_jerk,
        2.5,
        3.0 * config.duration_max,
        config.length_min,
    )
    if found is None:
        length = max(3.0 * config.duration_max * speed, config.length_min)
        found = Quintic.to_zero(station, length, value, slope, bend)
    return found
