"""How long a lane change takes: from speed, curvature, cross-slope, payload and roll-over margin.

The trailer's lateral acceleration may not exceed shares of the truck's static roll-over threshold:
one for the change alone, one for change and road together. On the steer axle's path that is less
by the rearward amplification. Comfort bounds what an empty truck could bear.
"""

from __future__ import annotations

from dataclasses import dataclass

from controllers.lateral_limits import RollMargin
from controllers.quintic import Quintic, shortest_to_zero


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
