"""How long a lane change takes: from speed, curvature, payload and roll-over margin."""

from __future__ import annotations

from dataclasses import dataclass

from controllers.quintic import Quintic, shortest_to_zero

EMPTY_MASS, LADEN_MASS = 19_000.0, 55_000.0


@dataclass(frozen=True)
class LaneChangeConfig:
    """Limits of lane changes.

    Attributes:
      acceleration_empty: lateral, of the change alone, empty truck [m/s2].
      acceleration_laden: the same at 55 t [m/s2]; rearward amplification acts on it.
      acceleration_total: lateral, change and road curve together [m/s2].
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

    acceleration_empty: float = 0.85
    acceleration_laden: float = 0.6
    acceleration_total: float = 1.6
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
    merge_time: float = 18.0
    merge_distance: float = 200.0


def lateral_limit(mass: float, speed: float, curvature: float, config: LaneChangeConfig) -> float:
    """Lateral acceleration that a change may use [m/s2].

    Args:
      mass: of the combination [kg]; the limit falls linearly from empty to laden.
      speed: [m/s].
      curvature: greatest magnitude along the change [1/m].
      config: limits.
    """
    share = min(max((mass - EMPTY_MASS) / (LADEN_MASS - EMPTY_MASS), 0.0), 1.0)
    own = config.acceleration_empty + share * (
        config.acceleration_laden - config.acceleration_empty
    )
    return min(own, config.acceleration_total - speed**2 * abs(curvature))


def quintic_change(
    station: float,
    size: float,
    slope: float,
    bend: float,
    speed: float,
    mass: float,
    curvature: float,
    config: LaneChangeConfig,
) -> Quintic | None:
    """The shortest comfortable change of `size` metres, or None when the curve leaves no room."""
    limit = lateral_limit(mass, speed, curvature, config)
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
) -> Quintic:
    """Back to a lane's middle, briskly: for aborts and recoveries. Always gives a curve."""
    found = shortest_to_zero(
        station,
        value,
        slope,
        bend,
        speed,
        config.abort_acceleration,
        config.abort_jerk,
        2.5,
        3.0 * config.duration_max,
        config.length_min,
    )
    if found is None:
        length = max(3.0 * config.duration_max * speed, config.length_min)
        found = Quintic.to_zero(station, length, value, slope, bend)
    return found
